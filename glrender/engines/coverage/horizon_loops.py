"""Loops over horizons, compiled by Numba when this is imported, once on a machine. Vectors are in columns."""

from __future__ import annotations

import math

import numpy as np
from glrender_camera.numba_loops import POINTS, VECTOR, compiled, inlined, read, write
from numba.types import boolean, float32, float64, intp, uint8

N_AZIMUTHS = 16
# Height that is not known, of 255 steps of its sine.
UNKNOWN = 255
# Difference of heights between azimuths from those of both, about, in 255 parts of a sine.
_NEAR = 3.0
# Sine of the phase angle below which a place around does not matter.
_LEAST_SINE = 1e-4


@inlined
def _across(x, y, z):
    """Two unit vectors across a third. Source: Duff et al. (2017), Building an orthonormal basis, revisited."""
    sign = math.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    return 1.0 + sign * x * x * a, sign * b, -sign * x, b, sign + y * y * a, -y


@inlined
def _azimuth(s, t):
    """The azimuth of a direction, in sectors: by its place on a square, which needs no angle.

    Without a branch: of many facets the next one's quarter is not known.
    """
    around = abs(s) + abs(t)
    part = t / around if around > 0.0 else 0.0
    ahead = part + 4.0 if t < 0.0 else part
    return (ahead if s >= 0.0 else 2.0 - part) * (N_AZIMUTHS / 4)


@compiled(write(float64, 2)(POINTS))
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
    sector, last = intp(_azimuth(s, t)), N_AZIMUTHS - 1
    one, other = float(heights[facet, sector & last]), float(heights[facet, (sector + 1) & last])
    # What `min` and `max` compile to takes 1.2 times as long.
    low, high = one if one < other else other, other if one < other else one
    rise = one - float(heights[facet, (sector - 1) & last])
    fall = other - float(heights[facet, (sector + 2) & last])
    meet = one + rise * min(max((other + fall - one) / (rise + fall), 0.0), 1.0)
    top = meet if (rise > 0.0) & (fall > 0.0) & (meet > high) else high
    # A ray is blocked at the height itself, and free a step above.
    height = 255.0 * sine - 0.5
    is_below = (high > 0.0) & (high < UNKNOWN) & (height < low - _NEAR)
    return 0 if is_below else 1 if (high == 0.0) | (height > top + _NEAR) else -1


@inlined
def _faces(facets, facet, to_sun, r_camera_m):
    """Whether a facet faces both Sun and camera."""
    a, b, c = float(facets[facet, 0]), float(facets[facet, 1]), float(facets[facet, 2])
    return (a * to_sun[0] + b * to_sun[1] + c * to_sun[2] > 0.0) & (
        a * (r_camera_m[0] - facets[facet, 3]) + b * (r_camera_m[1] - facets[facet, 4])
        + c * (r_camera_m[2] - facets[facet, 5]) > 0.0)


@inlined
def _look(facets, facet, to_sun, r_camera_m):
    """Unit vectors to camera and Sun from a facet's middle, across the normal twice and along it.

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
    """A table's value at a place, in steps of each of its axes."""
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
    """Radiance of a facet by its cosines and the squared distance of the unit vectors to Sun and camera."""
    cosine = 1.0 - 0.5 * squared
    aside = (incidence - emission * cosine) / math.sqrt(max(1.0 - cosine * cosine, _LEAST_SINE**2))
    return incidence / (incidence + emission) * _between(
        brdf, (math.sqrt(math.sqrt(squared)) - least_root) * per_root,
        (aside / (emission + abs(aside)) + 1.0) * 0.5 * (brdf.shape[1] - 1),
        min(math.sqrt(emission * emission + aside * aside), 1.0) * (brdf.shape[2] - 1))


@compiled(intp(read(float32, 2), read(uint8, 2), intp, intp, intp, VECTOR, VECTOR, read(float64, 3), float64, float64,
               boolean, write(float64, 1), write(intp, 1), write(boolean, 2)))
def shade_centroids(facets, heights, first, last, one_in, to_sun, r_camera_m, brdf, least_root, per_root, has_backs,
                    found, asked, is_asked):
    """Write the radiance of facets first to last, each lit or dark by its centroid: 0 if dark or not seen.

    Only one in so many is shaded, as many in a row, of which most have their neighbours there.

    Facets (F, 6) float32 have normals and centroids [m], and heights (F, sectors) of the horizon. Their BRDF times the
    sum of the cosines of incidence and emission, which is smooth at the limb, is in a table (C, 2 S + 1, S + 1):
    by the root of the distance of the unit vectors to Sun and camera; by the normal's place around a square in the
    plane of both, from -1 to 1; by its part in that plane, from 0 to 1.

    With `has_backs`, what stands before a facet may be a back, which hides nothing from the camera: that is asked too.

    Returns how many (N,) are `asked`, whether they are seen or lit `is_asked` (2, N): they are shaded as if they were.

    In three turns without branches, each over the facets left: a branch would be predicted wrongly half the time.
    """
    left, how, light = np.empty(last - first, np.intp), np.empty(last - first, np.intp), np.empty((last - first, 3))
    n_facing, n_shown, n_asked = 0, 0, 0
    for begin in range(first, last, one_in * one_in):
        for facet in range(begin, min(begin + one_in, last)):
            found[facet] = 0.0
            left[n_facing] = facet
            n_facing += _faces(facets, facet, to_sun, r_camera_m)
    for i in range(n_facing):
        facet = left[i]
        camera, sun, squared = _look(facets, facet, to_sun, r_camera_m)
        seen, lit = _told(heights, facet, camera), _told(heights, facet, sun)
        seen -= (seen == 0) & has_backs
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
