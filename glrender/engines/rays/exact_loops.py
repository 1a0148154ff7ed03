"""Loops of float64 rays, compiled by Numba when this is imported, once on a machine. Vectors are in columns.

Boxes around facets are a complete binary tree: of node n the children are 2 n and 2 n + 1, the root is 1. Where rays
meet a facet is found as by Woop, Benthin and Wald (2013), Watertight ray/triangle intersection: facets that share
vertices leave no gap.
"""

from __future__ import annotations

import math

import numpy as np
from numba.types import Tuple, UniTuple, boolean, float64, intp, void

from ...base.numba_loops import compiled, inlined, read, write

# Deeper than any tree: of 2^60 facets.
_DEPTH = 64
# A box is met a little beyond its sides: three roundings of float64, of distances of both ends.
_ROUNDED = 1.0 + 4e-15
_POINTS, _BOXES, _CORNERS = read(float64, 2, "A"), read(float64, 2), read(float64, 2)
_PLACE = UniTuple(float64, 3)


@inlined
def _across(u, v, w):
    """Two unit vectors across a third: Duff and others (2017), Building an orthonormal basis, revisited."""
    sign = math.copysign(1.0, w)
    a = -1.0 / (sign + w)
    b = u * v * a
    return (1.0 + sign * u * u * a, sign * b, -sign * u), (b, sign + v * v * a, -v)


@inlined
def _towards(corners, i, first, place, axis):
    """Of a facet's corner, from a place along an axis."""
    return ((corners[i, first] - place[0]) * axis[0] + (corners[i, first + 1] - place[1]) * axis[1]
            + (corners[i, first + 2] - place[2]) * axis[2])


@inlined
def _distance(corners, i, place, ray, right, down):
    """From a place along a ray to facet i of some (F, 9); infinite beside it."""
    ax, bx, cx = (_towards(corners, i, 0, place, right), _towards(corners, i, 3, place, right),
                  _towards(corners, i, 6, place, right))
    ay, by, cy = (_towards(corners, i, 0, place, down), _towards(corners, i, 3, place, down),
                  _towards(corners, i, 6, place, down))
    u, v, w = bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx
    found = math.inf
    if (u >= 0.0 and v >= 0.0 and w >= 0.0) or (u <= 0.0 and v <= 0.0 and w <= 0.0):
        area = u + v + w
        if area != 0.0:
            az, bz, cz = (_towards(corners, i, 0, place, ray), _towards(corners, i, 3, place, ray),
                          _towards(corners, i, 6, place, ray))
            found = az + (v * (bz - az) + w * (cz - az)) / area
            # Of one seen edge-on the quotient is noise: it is between its corners all the same.
            found = min(max(found, min(az, min(bz, cz))), max(az, max(bz, cz)))
    return found


@compiled(Tuple((intp, float64))(_BOXES, _CORNERS, intp, _PLACE, _PLACE, float64, boolean, write(intp, 1)))
def _walk(boxes, corners, n_leaves, place, ray, reach, is_any, stack):
    """The first facet that a ray meets within a reach, or any, and how far off; -1 if it meets none."""
    inverse = (1.0 / ray[0] if ray[0] != 0.0 else math.inf, 1.0 / ray[1] if ray[1] != 0.0 else math.inf,
               1.0 / ray[2] if ray[2] != 0.0 else math.inf)
    right, down = _across(ray[0], ray[1], ray[2])
    n_stacked, hit, nearest = 1, -1, reach
    stack[0] = 1
    n_facets = len(corners)
    while n_stacked:
        n_stacked -= 1
        node = stack[n_stacked]
        begin, end = 0.0, nearest
        for axis in range(3):
            low, high = boxes[node, axis] - place[axis], boxes[node, axis + 3] - place[axis]
            if ray[axis] == 0.0:
                if low > 0.0 or high < 0.0:
                    end = -1.0
            else:
                one, other = low * inverse[axis], high * inverse[axis]
                begin, end = max(begin, min(one, other)), min(end, max(one, other) * _ROUNDED)
        if begin > end:
            continue
        if node < n_leaves:
            stack[n_stacked], stack[n_stacked + 1] = 2 * node, 2 * node + 1
            n_stacked += 2
            continue
        leaf = node - n_leaves
        for i in range(leaf * n_facets // n_leaves, (leaf + 1) * n_facets // n_leaves):
            distance = _distance(corners, i, place, ray, right, down)
            if 0.0 < distance < nearest:
                hit, nearest = i, distance
                if is_any:
                    return hit, nearest
    return hit, nearest


@compiled(void(_BOXES, _CORNERS, intp, _POINTS, _POINTS, write(intp, 1), write(float64, 1)))
def find_first(boxes, corners, n_leaves, start_m, direction, facet, distance_m):
    """Write which facets (N,) rays from points (3, 1 or N) in directions (3, N) meet first, or -1, and how far off."""
    stack = np.empty(_DEPTH, np.intp)
    for i in range(direction.shape[1]):
        j = i if start_m.shape[1] > 1 else 0
        facet[i], distance_m[i] = _walk(boxes, corners, n_leaves, (start_m[0, j], start_m[1, j], start_m[2, j]),
                                        (direction[0, i], direction[1, i], direction[2, i]), math.inf, False, stack)


@compiled(void(_BOXES, _CORNERS, intp, _POINTS, _POINTS, read(float64, 1), write(boolean, 1)))
def find_blocked(boxes, corners, n_leaves, start_m, direction, reach_m, found):
    """Write whether rays from points (3, N) in directions (3, 1 or N) meet a facet within a reach (1 or N,)."""
    stack = np.empty(_DEPTH, np.intp)
    for i in range(start_m.shape[1]):
        j, k = i if direction.shape[1] > 1 else 0, i if len(reach_m) > 1 else 0
        found[i] = _walk(boxes, corners, n_leaves, (start_m[0, i], start_m[1, i], start_m[2, i]),
                         (direction[0, j], direction[1, j], direction[2, j]), reach_m[k], True, stack)[0] >= 0
