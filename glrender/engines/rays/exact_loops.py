"""Loops of float64 rays, compiled by Numba when this is imported, once on a machine. Vectors are in columns.

Boxes around facets are a complete binary tree: of node n the children are 2 n and 2 n + 1, the root is 1. Where rays
meet a facet is found as by Woop, Benthin and Wald (2013), Watertight ray/triangle intersection: facets that share
vertices leave no gap.
"""

from __future__ import annotations

import math

import numpy as np
from glrender_camera.numba_loops import PLACE, POINTS, TABLE, compiled, inlined, read, write
from numba.types import Tuple, boolean, float64, intp, void

# Facets that rays meet: all, those that face where rays begin, and those that face where they go.
ALL_SIDES, FACING, TURNED = 0, 1, -1
# Deeper than any tree: of 2^60 facets.
_DEPTH = 64
# Share [1] of the distance of the farthest corner by which a ray may miss a box or an edge and still counts as a hit:
# four roundings of float64, of places and unit vectors. A ray that is aimed at a corner meets it.
_ROUNDING = 4.0 * 2.0**-52


@inlined
def _across(u, v, w):
    """Two unit vectors across a third: Duff and others (2017), Building an orthonormal basis, revisited."""
    sign = math.copysign(1.0, w)
    a = -1.0 / (sign + w)
    b = u * v * a
    return (1.0 + sign * u * u * a, sign * b, -sign * u), (b, sign + v * v * a, -v)


@inlined
def _towards(corners, i, first, place, axis):
    """A coordinate of a facet's corner, from a place along an axis."""
    return ((corners[i, first] - place[0]) * axis[0] + (corners[i, first + 1] - place[1]) * axis[1]
            + (corners[i, first + 2] - place[2]) * axis[2])


@inlined
def _lowest(a, b, c):
    return min(a, min(b, c))


@inlined
def _highest(a, b, c):
    return max(a, max(b, c))


@inlined
def _distance(corners, i, place, axes, sides):
    """Distance along a ray to facet i of some (F, 9) from a place; infinite where it misses a side of it.

    The axes are the ray and two across it.
    """
    ray, right, down = axes
    ax, bx, cx = (_towards(corners, i, 0, place, right), _towards(corners, i, 3, place, right),
                  _towards(corners, i, 6, place, right))
    ay, by, cy = (_towards(corners, i, 0, place, down), _towards(corners, i, 3, place, down),
                  _towards(corners, i, 6, place, down))
    u, v, w = bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx
    area, found = u + v + w, math.inf
    least = _lowest(u, v, w) if area > 0.0 else -_highest(u, v, w)
    low_x, high_x, low_y, high_y = _lowest(ax, bx, cx), _highest(ax, bx, cx), _lowest(ay, by, cy), _highest(ay, by, cy)
    az, bz, cz = (_towards(corners, i, 0, place, ray), _towards(corners, i, 3, place, ray),
                  _towards(corners, i, 6, place, ray))
    low_z, high_z = _lowest(az, bz, cz), _highest(az, bz, cz)
    far = _ROUNDING * max(max(high_x, -low_x), max(max(high_y, -low_y), max(high_z, -low_z)))
    # A side is no longer than the box across the ray; a place outside the box is on no side.
    if (least >= -far * (high_x - low_x + high_y - low_y) and low_x <= far and high_x >= -far and low_y <= far
            and high_y >= -far and sides * area <= 0.0):
        # A facet that is seen edge-on makes the quotient noise: the place is between its corners all the same.
        found = min(max(az + (v * (bz - az) + w * (cz - az)) / area, low_z), high_z)
    return found


@compiled(Tuple((intp, float64))(TABLE, TABLE, intp, PLACE, PLACE, float64, intp, boolean, write(intp, 1)))
def _walk(boxes, corners, n_leaves, place, ray, reach, sides, is_any, stack):
    """The first facet that a ray meets within a reach, or any, and how far off; -1 if it meets none."""
    inverse = (1.0 / ray[0] if ray[0] != 0.0 else math.inf, 1.0 / ray[1] if ray[1] != 0.0 else math.inf,
               1.0 / ray[2] if ray[2] != 0.0 else math.inf)
    right, down = _across(ray[0], ray[1], ray[2])
    axes = (ray, right, down)
    n_stacked, hit, nearest = 1, -1, reach
    stack[0] = 1
    n_facets, far = len(corners), 0.0
    for axis in range(3):
        far = max(far, max(boxes[1, axis + 3] - place[axis], place[axis] - boxes[1, axis]))
    far *= _ROUNDING
    while n_stacked:
        n_stacked -= 1
        node = stack[n_stacked]
        begin, end = 0.0, nearest
        for axis in range(3):
            low, high = boxes[node, axis] - place[axis] - far, boxes[node, axis + 3] - place[axis] + far
            if ray[axis] == 0.0:
                if low > 0.0 or high < 0.0:
                    end = -1.0
            else:
                one, other = low * inverse[axis], high * inverse[axis]
                begin, end = max(begin, min(one, other)), min(end, max(one, other))
        if begin > end:
            continue
        if node < n_leaves:
            stack[n_stacked], stack[n_stacked + 1] = 2 * node, 2 * node + 1
            n_stacked += 2
            continue
        leaf = node - n_leaves
        for i in range(leaf * n_facets // n_leaves, (leaf + 1) * n_facets // n_leaves):
            distance = _distance(corners, i, place, axes, sides)
            if 0.0 < distance < nearest:
                hit, nearest = i, distance
                if is_any:
                    return hit, nearest
    return hit, nearest


@compiled(void(TABLE, TABLE, intp, POINTS, POINTS, intp, write(intp, 1), write(float64, 1)))
def find_first(boxes, corners, n_leaves, start_m, direction, sides, facet, distance_m):
    """Write which facets (N,) rays from points (3, 1 or N) in directions (3, N) meet first, or -1, and how far off."""
    stack = np.empty(_DEPTH, np.intp)
    for i in range(direction.shape[1]):
        j = i if start_m.shape[1] > 1 else 0
        facet[i], distance_m[i] = _walk(boxes, corners, n_leaves, (start_m[0, j], start_m[1, j], start_m[2, j]),
                                        (direction[0, i], direction[1, i], direction[2, i]), math.inf, sides, False,
                                        stack)


@compiled(void(TABLE, TABLE, intp, POINTS, POINTS, read(float64, 1), intp, write(boolean, 1)))
def find_blocked(boxes, corners, n_leaves, start_m, direction, reach_m, sides, found):
    """Write whether rays from points (3, N) in directions (3, 1 or N) meet a facet within a reach (1 or N,)."""
    stack = np.empty(_DEPTH, np.intp)
    for i in range(start_m.shape[1]):
        j, k = i if direction.shape[1] > 1 else 0, i if len(reach_m) > 1 else 0
        found[i] = _walk(boxes, corners, n_leaves, (start_m[0, i], start_m[1, i], start_m[2, i]),
                         (direction[0, j], direction[1, j], direction[2, j]), reach_m[k], sides, True, stack)[0] >= 0
