"""Loops over horizons, compiled by Numba when this is imported, once on a machine. Vectors are in columns."""

from __future__ import annotations

import math

import numpy as np
from numba.types import UniTuple, boolean, float32, float64, intp, uint8, void

from .compiled import compiled, inlined, read, write

N_AZIMUTHS = 16
# Height that is not known, of 255 steps of its sine.
UNKNOWN = 255
_LAST = N_AZIMUTHS - 1
# Levels of a tree that a stack has room for.
_DEEPEST = 64
# Of 255 parts of a sine: rays start a little off the surface, and in float32.
_MARGIN = 1.0
# Sine that a horizon has at least: it leaves out what is far and level.
_LEAST = 0.05
# Sine of the angle that a box takes up, about, below which what is in it is not looked at.
_SMALL = 0.2
# Of 255 parts of a sine: how near heights between azimuths are to those of both, about.
_NEAR = 3.0
# Sine of the phase angle below which a place around does not matter.
_LEAST_SINE = 1e-4
_TABLE, _VECTOR, _HEIGHTS = read(float64, 2), read(float64, 1, "A"), write(float64, 1)
_POINTS, _TABLES = read(float64, 2, "A"), read(float64, 3)
_PLACE, _TURN = UniTuple(float64, 3), UniTuple(float64, 9)


@inlined
def _across(x, y, z):
    """Two unit vectors across a third. Source: Duff et al. (2017), Building an orthonormal basis, revisited."""
    sign = math.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    return 1.0 + sign * x * x * a, sign * b, -sign * x, b, sign + y * y * a, -y


@inlined
def _azimuth(s, t):
    """Where a direction is around, in sectors: by its place on a square, which needs no angle.

    Without a branch: of many facets the next one's quarter is not known.
    """
    around = abs(s) + abs(t)
    part = t / around if around > 0.0 else 0.0
    ahead = part + 4.0 if t < 0.0 else part
    return (ahead if s >= 0.0 else 2.0 - part) * (N_AZIMUTHS / 4)


@compiled(intp(float64, float64))
def _sector(s, t):
    """Which sector of azimuth a direction is in."""
    return int(_azimuth(s, t)) % N_AZIMUTHS


@compiled(boolean(_HEIGHTS, float64, float64, float64, float64, float64, boolean))
def _is_above(heights, s, t, u, v, sine, raises):
    """Whether a sine is above the heights of sectors from (s, t) counter-clockwise to (u, v); they may be raised."""
    first = _sector(s, t)
    is_above = False
    for k in range((_sector(u, v) - first) % N_AZIMUTHS + 1):
        sector = (first + k) % N_AZIMUTHS
        is_above |= heights[sector] < sine
        if raises:
            heights[sector] = max(heights[sector], sine)
    return is_above


@compiled(_PLACE(_TABLE, intp, float64, float64, float64, _TURN))
def _turned(points_m, k, x, y, z, turn):
    """Where one of some points (3, N) [m] is from (x, y, z): across the normal twice, and along it."""
    u, v, w = points_m[0, k] - x, points_m[1, k] - y, points_m[2, k] - z
    return (u * turn[0] + v * turn[1] + w * turn[2], u * turn[3] + v * turn[4] + w * turn[5],
            u * turn[6] + v * turn[7] + w * turn[8])


@compiled(float64(_PLACE))
def _sine(place):
    return place[2] / math.sqrt(place[0] * place[0] + place[1] * place[1] + place[2] * place[2])


@compiled(boolean(_HEIGHTS, float64, float64, float64, float64, float64))
def _may_rise(heights, s, t, height, half, radius):
    """Whether a box may rise above heights: its middle at (s, t) over the plane and so high, and half as high itself.

    It is in a ball of a radius around. If that looks small, the heights are raised over all of it instead.
    """
    top, flat = height + half, s * s + t * t
    squared = flat + height * height
    if squared <= radius * radius:
        return top > 0.0
    distance = math.sqrt(squared)
    sine, of_ball = height / distance, radius / distance
    cosine = math.sqrt(1.0 - of_ball * of_ball)
    highest = 1.0 if sine >= cosine else sine * cosine + math.sqrt(max(1.0 - sine * sine, 0.0)) * of_ball
    highest = min(highest, top / (distance - radius))
    if highest <= _LEAST:
        return False
    if flat <= radius * radius:
        return heights.min() < highest
    turn = radius / math.sqrt(flat)
    straight = math.sqrt(1.0 - turn * turn)
    is_small = of_ball < _SMALL
    return _is_above(heights, s * straight + t * turn, t * straight - s * turn, s * straight - t * turn,
                     t * straight + s * turn, highest, is_small) and not is_small


@compiled(float64(_PLACE, _PLACE))
def _highest(a, b):
    """Largest sine of the elevation along a line between two places: across the normal twice, and along it."""
    here, there = a[0] * a[0] + a[1] * a[1] + a[2] * a[2], b[0] * b[0] + b[1] * b[1] + b[2] * b[2]
    if not (here > 0.0 and there > 0.0):
        # One is where this is looked from.
        return max(a[2], b[2]) / math.sqrt(max(here, there))
    highest = max(a[2] / math.sqrt(here), b[2] / math.sqrt(there))
    x, y, z = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    along, length = a[0] * x + a[1] * y + a[2] * z, x * x + y * y + z * z
    rise = z * along - a[2] * length
    part = (a[2] * along - z * here) / rise
    if 0.0 < part < 1.0:
        s, t, h = a[0] + part * x, a[1] + part * y, a[2] + part * z
        highest = max(highest, h / math.sqrt(s * s + t * t + h * h))
    return highest


@compiled(void(_HEIGHTS, float64, float64, float64, float64, float64))
def _raise_between(heights, s, t, u, v, sine):
    """Raise heights from (s, t) to (u, v), the shorter way."""
    if s * v - t * u >= 0.0:
        _is_above(heights, s, t, u, v, sine, True)
    else:
        _is_above(heights, u, v, s, t, sine, True)


@compiled(void(_HEIGHTS, _PLACE, _PLACE, _PLACE))
def _raise_over(heights, a, b, c):
    """Raise heights over a facet, of corners across the normal twice, and along it: none of them on the normal."""
    highest = max(_highest(a, b), _highest(b, c), _highest(c, a))
    if highest <= _LEAST:
        return
    of_a, of_b, of_c = b[0] * c[1] - b[1] * c[0], c[0] * a[1] - c[1] * a[0], a[0] * b[1] - a[1] * b[0]
    if (of_a >= 0.0 and of_b >= 0.0 and of_c >= 0.0) or (of_a <= 0.0 and of_b <= 0.0 and of_c <= 0.0):
        if a[0] == a[1] == a[2] == 0.0:
            _raise_between(heights, b[0], b[1], c[0], c[1], highest)
        elif b[0] == b[1] == b[2] == 0.0:
            _raise_between(heights, c[0], c[1], a[0], a[1], highest)
        elif c[0] == c[1] == c[2] == 0.0:
            _raise_between(heights, a[0], a[1], b[0], b[1], highest)
        else:
            # It is around the normal.
            heights[:] = 1.0
        return
    _raise_between(heights, a[0], a[1], b[0], b[1], highest)
    _raise_between(heights, b[0], b[1], c[0], c[1], highest)
    _raise_between(heights, c[0], c[1], a[0], a[1], highest)


@compiled(void(_TABLE, _TABLE, read(intp, 2), _TABLE, _TABLE, read(float64, 1), read(intp, 1), intp, intp,
               write(uint8, 2)))
def find_horizons(vertices_m, normals, corners, middles_m, halves_m, radii_m, begins, first, last, found):
    """Write how high a mesh stands around vertices first to last, over the plane across their normals (3, V).

    (V, sectors) uint8: 255 times the sine, rounded up, with a margin. The mesh is in a binary tree of boxes: `tree`.
    """
    n_leaves = len(begins) - 1
    heights, stack = np.empty(N_AZIMUTHS), np.empty(_DEEPEST, np.intp)
    for vertex in range(first, last):
        a, b, c = normals[0, vertex], normals[1, vertex], normals[2, vertex]
        turn = (*_across(a, b, c), a, b, c)
        x, y, z = vertices_m[0, vertex], vertices_m[1, vertex], vertices_m[2, vertex]
        heights[:] = _LEAST
        stack[0], n = 1, 1
        while n:
            n -= 1
            node = stack[n]
            s, t, height = _turned(middles_m, node, x, y, z, turn)
            half = abs(a) * halves_m[0, node] + abs(b) * halves_m[1, node] + abs(c) * halves_m[2, node]
            if not _may_rise(heights, s, t, height, half, radii_m[node]):
                continue
            if node < n_leaves:
                # The higher one first: it hides more.
                one, other = 2 * node, 2 * node + 1
                if _sine(_turned(middles_m, one, x, y, z, turn)) > _sine(_turned(middles_m, other, x, y, z, turn)):
                    one, other = other, one
                stack[n], stack[n + 1] = one, other
                n += 2
                continue
            for facet in range(begins[node - n_leaves], begins[node - n_leaves + 1]):
                i, j, k = corners[0, facet], corners[1, facet], corners[2, facet]
                _raise_over(heights, _turned(vertices_m, i, x, y, z, turn), _turned(vertices_m, j, x, y, z, turn),
                            _turned(vertices_m, k, x, y, z, turn))
        for k in range(N_AZIMUTHS):
            found[vertex, k] = min(math.ceil(255.0 * heights[k] + _MARGIN), 255.0)


@compiled(void(_TABLE, _TABLE, read(uint8, 2), read(intp, 1), _VECTOR, boolean, write(boolean, 1)))
def find_open(vertices_m, normals, horizons, vertices, towards, is_place, is_open):
    """Whether vertices (N,) see a direction or a place [m] (3,) above their horizons for certain."""
    u, v, w = towards[0], towards[1], towards[2]
    for i in range(len(vertices)):
        k = vertices[i]
        if is_place:
            u, v, w = towards[0] - vertices_m[0, k], towards[1] - vertices_m[1, k], towards[2] - vertices_m[2, k]
            length = math.sqrt(u * u + v * v + w * w)
            u, v, w = u / length, v / length, w / length
        a, b, c = normals[0, k], normals[1, k], normals[2, k]
        ax, ay, az, bx, by, bz = _across(a, b, c)
        sector = _sector(u * ax + v * ay + w * az, u * bx + v * by + w * bz)
        is_open[i] = 255.0 * min(u * a + v * b + w * c, 1.0) > horizons[k, sector]


@compiled(write(float64, 2)(_POINTS))
def axes_across(normals):
    """The axes (6, N) across normals (3, N) from which azimuths count: two unit vectors."""
    found = np.empty((6, normals.shape[1]))
    for i in range(normals.shape[1]):
        axes = _across(normals[0, i], normals[1, i], normals[2, i])
        for k in range(6):
            found[k, i] = axes[k]
    return found


@inlined
def _told(heights, facet, towards):
    """Whether a direction is above a facet's horizon: 1, below it: 0, or a ray has to be asked: -1.

    That is where it is between the heights of the azimuths on either side, or near them, or near where what rises
    towards them from beyond would meet, or where they are not known.
    """
    s, t, sine = towards
    sector = intp(_azimuth(s, t))
    one, other = float(heights[facet, sector & _LAST]), float(heights[facet, (sector + 1) & _LAST])
    # What `min` and `max` compile to takes 1.2 times as long.
    low, high = one if one < other else other, other if one < other else one
    rise = one - float(heights[facet, (sector - 1) & _LAST])
    fall = other - float(heights[facet, (sector + 2) & _LAST])
    meet = one + rise * min(max((other + fall - one) / (rise + fall), 0.0), 1.0)
    top = meet if (rise > 0.0) & (fall > 0.0) & (meet > high) else high
    # A ray is blocked at the height itself, and free a step above.
    height = 255.0 * sine - 0.5
    is_below = (high > 0.0) & (high < UNKNOWN) & (height < low - _NEAR)
    return 0 if is_below else 1 if (high == 0.0) | (height > top + _NEAR) else -1


@inlined
def _is_above_curve(heights, point, towards):
    """Whether a direction is above a point's horizon, which is a curve between azimuths.

    Source: Catmull and Rom (1974), A class of local interpolating splines.
    """
    s, t, sine = towards
    around, last = _azimuth(s, t) * (heights.shape[1] / N_AZIMUTHS), heights.shape[1] - 1
    sector = intp(around)
    one, other = float(heights[point, sector & last]), float(heights[point, (sector + 1) & last])
    before, after = float(heights[point, (sector - 1) & last]), float(heights[point, (sector + 2) & last])
    part = around - sector
    bend = (1.0 - part) * (2.0 * one - before - other) + part * (2.0 * other - one - after)
    height = one + part * (other - one) + 0.5 * part * (1.0 - part) * bend
    # A ray is blocked at the height itself, and free a step above.
    return (255.0 * sine - 0.5 > height) | ((one == 0.0) & (other == 0.0))


@inlined
def _faces(facets, facet, to_sun, r_camera_m):
    """Whether a facet faces both Sun and camera."""
    a, b, c = float(facets[facet, 0]), float(facets[facet, 1]), float(facets[facet, 2])
    return (a * to_sun[0] + b * to_sun[1] + c * to_sun[2] > 0.0) & (
        a * (r_camera_m[0] - facets[facet, 3]) + b * (r_camera_m[1] - facets[facet, 4])
        + c * (r_camera_m[2] - facets[facet, 5]) > 0.0)


@inlined
def _look(facets, facet, to_sun, r_camera_m):
    """Of a facet's middle, across the normal twice and along it: unit vectors to camera and Sun.

    And the squared distance of both.
    """
    a, b, c = float(facets[facet, 0]), float(facets[facet, 1]), float(facets[facet, 2])
    u, v, w = r_camera_m[0] - facets[facet, 3], r_camera_m[1] - facets[facet, 4], r_camera_m[2] - facets[facet, 5]
    per_length = 1.0 / math.sqrt(u * u + v * v + w * w)
    u, v, w = u * per_length, v * per_length, w * per_length
    ax, ay, az, bx, by, bz = _across(a, b, c)
    x, y, z = to_sun[0] - u, to_sun[1] - v, to_sun[2] - w
    return ((u * ax + v * ay + w * az, u * bx + v * by + w * bz, a * u + b * v + c * w),
            (to_sun[0] * ax + to_sun[1] * ay + to_sun[2] * az, to_sun[0] * bx + to_sun[1] * by + to_sun[2] * bz,
             a * to_sun[0] + b * to_sun[1] + c * to_sun[2]), x * x + y * y + z * z)


@inlined
def _between(table, root, around, out):
    """What a table has at a place, in steps of each of its axes."""
    i = min(max(intp(root), 0), table.shape[0] - 2)
    j, k = min(intp(around), table.shape[1] - 2), min(intp(out), table.shape[2] - 2)
    a, b, c = root - i, around - j, out - k
    found = 0.0
    for step in range(2):
        here = ((1.0 - b) * ((1.0 - c) * table[i + step, j, k] + c * table[i + step, j, k + 1])
                + b * ((1.0 - c) * table[i + step, j + 1, k] + c * table[i + step, j + 1, k + 1]))
        found += (a if step else 1.0 - a) * here
    return found


@inlined
def _radiance(incidence, emission, squared, brdf, least_root, per_root):
    """That of a facet by its cosines and the squared distance of the unit vectors to Sun and camera."""
    cosine = 1.0 - 0.5 * squared
    aside = (incidence - emission * cosine) / math.sqrt(max(1.0 - cosine * cosine, _LEAST_SINE**2))
    return incidence / (incidence + emission) * _between(
        brdf, (math.sqrt(math.sqrt(squared)) - least_root) * per_root,
        (aside / (emission + abs(aside)) + 1.0) * 0.5 * (brdf.shape[1] - 1),
        min(math.sqrt(emission * emission + aside * aside), 1.0) * (brdf.shape[2] - 1))


@compiled(intp(read(float32, 2), read(uint8, 2), intp, intp, _VECTOR, _VECTOR, _TABLES, float64, float64,
               write(float64, 1), write(intp, 1), write(boolean, 2)))
def shade_middles(facets, heights, first, last, to_sun, r_camera_m, brdf, least_root, per_root, found, asked, is_asked):
    """Write the radiance of facets first to last, each as lit as its middle is: 0 of those that are dark or not seen.

    Facets (F, 6) float32 have normals and middles [m], and heights (F, sectors) of the horizon. Their BRDF times the
    sum of the cosines of incidence and emission, which is smooth at the limb, is in a table (C, 2 S + 1, S + 1):
    by the root of the distance of the unit vectors to Sun and camera; by the normal's place around a square in the
    plane of both, from -1 to 1; by its part in that plane, from 0 to 1.

    Returns how many (N,) are `asked`, whether they are seen or lit `is_asked` (2, N): they are shaded as if they were.

    In three turns, each over what is left, that have no branches: what a facet is would be guessed wrong half the time.
    """
    left, how, light = np.empty(last - first, np.intp), np.empty(last - first, np.intp), np.empty((last - first, 3))
    n_facing, n_shown, n_asked = 0, 0, 0
    for facet in range(first, last):
        found[facet] = 0.0
        left[n_facing] = facet
        n_facing += _faces(facets, facet, to_sun, r_camera_m)
    for i in range(n_facing):
        facet = left[i]
        camera, sun, squared = _look(facets, facet, to_sun, r_camera_m)
        seen, lit = _told(heights, facet, camera), _told(heights, facet, sun)
        left[n_shown], how[n_shown] = facet, (seen < 0) + 2 * (lit < 0)
        light[n_shown, 0], light[n_shown, 1], light[n_shown, 2] = sun[2], camera[2], squared
        n_shown += (seen != 0) & (lit != 0)
    for i in range(n_shown):
        facet = left[i]
        found[facet] = _radiance(light[i, 0], light[i, 1], light[i, 2], brdf, least_root, per_root)
        asked[first + n_asked] = facet
        is_asked[0, first + n_asked], is_asked[1, first + n_asked] = how[i] & 1, how[i] & 2
        n_asked += how[i] != 0
    return n_asked


@compiled(void(read(float32, 2), read(uint8, 2), intp, intp, intp, _VECTOR, _VECTOR, _TABLES, float64, float64, _POINTS,
               float64, _VECTOR, _VECTOR, _VECTOR, write(float64, 2)))
def light_points(points, heights, first, block, every, to_sun, r_camera_m, brdf, least_root, per_root, camera_from_body,
                 focal_length_px, principal_point_px, origin, per_px, image):
    """Add to cells the light of points that stand for 1 m2 of the surface each: radiance times solid angle.

    Points (N, 6) float32 have normals and places [m], heights (N, azimuths) of the horizon and a BRDF as of
    `shade_middles`: in blocks of so many from a first one on, so many apart. In turns, as there.
    """
    turn, left, light = camera_from_body, np.empty(block, np.intp), np.empty((block, 3))
    for begin in range(first, len(points), every):
        n_facing, n_shown = 0, 0
        for point in range(begin, min(begin + block, len(points))):
            left[n_facing] = point
            n_facing += _faces(points, point, to_sun, r_camera_m)
        for i in range(n_facing):
            point = left[i]
            camera, sun, squared = _look(points, point, to_sun, r_camera_m)
            left[n_shown], light[n_shown, 0], light[n_shown, 1], light[n_shown, 2] = point, sun[2], camera[2], squared
            n_shown += _is_above_curve(heights, point, camera) & _is_above_curve(heights, point, sun)
        for i in range(n_shown):
            point = left[i]
            u, v = points[point, 3] - r_camera_m[0], points[point, 4] - r_camera_m[1]
            w = points[point, 5] - r_camera_m[2]
            across = focal_length_px / (turn[2, 0] * u + turn[2, 1] * v + turn[2, 2] * w)
            x = principal_point_px[0] + across * (turn[0, 0] * u + turn[0, 1] * v + turn[0, 2] * w)
            y = principal_point_px[1] + across * (turn[1, 0] * u + turn[1, 1] * v + turn[1, 2] * w)
            column, row = math.floor((x - origin[0]) * per_px[0]), math.floor((y - origin[1]) * per_px[1])
            if 0 <= row < image.shape[0] and 0 <= column < image.shape[1]:
                image[row, column] += light[i, 1] / (u * u + v * v + w * w) * _radiance(
                    light[i, 0], light[i, 1], light[i, 2], brdf, least_root, per_root)
