"""Loops over rays, compiled by Numba when this is imported, once on a machine. Vectors are in columns."""

from __future__ import annotations

import ctypes
import math

import numpy as np
from llvmlite import binding
from numba import types
from numba.types import Tuple, boolean, float32, float64, intp, uint8, uint32, uintp, void

from .compiled import compiled, inlined, read, write
from .embree import library

# Of the bounding sphere, in radii: what passes beyond meets nothing, and float32 has no room for a start far off.
_REACH = 1.01
# Float32 rays start no farther than this from where they pass the middle, in radii.
_NEARBY = 1.5
_FAR = np.float32(1e30)
# RTCRayHit in float32 words: where the ray begins, ends, its mask; of the hit, which primitive and geometry.
_NEAR, _TOWARDS, _END, _MASK, _PRIMITIVE, _GEOMETRY, _WORDS, _ALIGNED_WORDS = 3, 4, 8, 9, 17, 18, 32, 16
_NONE = np.uint32(0xFFFFFFFF)
# Points in a row that share what rays find where heights tell something else: each looks once in every other one of the
# spans between these steps of 255 of a sine, at and between azimuths; so much nearer a height they do not, nor between
# two.
_IN_A_ROW, _LOOKS, _AT, _BETWEEN = 8, (12, 24, 40, 64, 96, 128, 160, 192, 224, 245, 254), 2, 24
# First step from the height in the azimuth before, four times as large each time.
_SPAN = 4

for _name in ("rtcOccluded1", "rtcIntersect1"):
    binding.add_symbol(_name, ctypes.cast(getattr(library(), _name), ctypes.c_void_p).value)
_rtc_occluded = types.ExternalFunction("rtcOccluded1", void(uintp, uintp, uintp))
_rtc_intersect = types.ExternalFunction("rtcIntersect1", void(uintp, uintp, uintp))
_POINTS = read(float64, 2, "A")


@compiled(Tuple((write(float32, 1), write(uint32, 1)))())
def _new_ray():
    """Memory of an RTCRayHit, in float32 and uint32."""
    memory = np.zeros(_WORDS + _ALIGNED_WORDS, np.float32)
    first = (-memory.ctypes.data // 4) % _ALIGNED_WORDS
    ray = memory[first:first + _WORDS]
    bits = ray.view(np.uint32)
    bits[_MASK] = _NONE
    return ray, bits


@compiled(boolean(uintp, write(float32, 1), write(uint32, 1), float64, float64, float64, float64, float64, float64,
                  float64))
def _is_blocked(scene, ray, bits, x, y, z, u, v, w, reach):
    """Whether a ray from (x, y, z) towards (u, v, w) meets a mesh of radius 1 within a distance."""
    if x * x + y * y + z * z > _REACH**2:
        # Far sunward or beside the bounding sphere there is nothing to meet.
        along = x * u + y * v + z * w
        a, b, c = x - along * u, y - along * v, z - along * w
        if along >= _REACH or not a * a + b * b + c * c < _REACH**2:
            return False
        skipped = max(-along - _NEARBY, 0.0)
        x, y, z, reach = x + skipped * u, y + skipped * v, z + skipped * w, reach - skipped
    ray[0], ray[1], ray[2], ray[_NEAR] = x, y, z, 0.0
    ray[_TOWARDS], ray[_TOWARDS + 1], ray[_TOWARDS + 2] = u, v, w
    ray[_END] = min(max(reach, 0.0), _FAR)
    _rtc_occluded(scene, bits.ctypes.data, 0)
    # A ray that meets something ends at minus infinity.
    return ray[_END] < 0.0


@compiled(void(uintp, _POINTS, _POINTS, float64, write(boolean, 1, "A")))
def find_blocked(scene, start_m, direction, radius_m, found):
    """Whether rays from points (3, N) [m] in directions (3, 1 or N) meet a mesh in units of its radius [m]."""
    ray, bits = _new_ray()
    for i in range(start_m.shape[1]):
        j = i if direction.shape[1] > 1 else 0
        found[i] = _is_blocked(
            scene, ray, bits, start_m[0, i] / radius_m, start_m[1, i] / radius_m, start_m[2, i] / radius_m,
            direction[0, j], direction[1, j], direction[2, j], _FAR)


@compiled(void(uintp, float64, _POINTS, read(float64, 1), _POINTS, read(intp, 1, "A"), read(float64, 2), float64,
               read(float64, 1), boolean, write(boolean, 1, "A")))
def keep_free(scene, radius_m, turn, shift_m, points_m, facets, normals, lift_m, towards, is_place, is_free):
    """Of points (3, N) [m] of a surface that are free (N,), find those from which a mesh hides a direction or a place.

    They are lifted off the surface along the normals of their facets (N,). `turn` (3, 3) and `shift_m` (3,) lead to the
    mesh's frame from theirs; `towards` (3,) is in theirs, a unit vector or a place [m].
    """
    ray, bits = _new_ray()
    u, v, w = towards[0], towards[1], towards[2]
    for i in range(points_m.shape[1]):
        if not is_free[i]:
            continue
        k = facets[i]
        x, y, z = (points_m[0, i] + lift_m * normals[0, k], points_m[1, i] + lift_m * normals[1, k],
                   points_m[2, i] + lift_m * normals[2, k])
        reach = float(_FAR)
        if is_place:
            u, v, w = towards[0] - x, towards[1] - y, towards[2] - z
            reach_m = math.sqrt(u * u + v * v + w * w)
            u, v, w, reach = u / reach_m, v / reach_m, w / reach_m, reach_m / radius_m
        is_free[i] = not _is_blocked(
            scene, ray, bits,
            (turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z + shift_m[0]) / radius_m,
            (turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z + shift_m[1]) / radius_m,
            (turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z + shift_m[2]) / radius_m,
            turn[0, 0] * u + turn[0, 1] * v + turn[0, 2] * w, turn[1, 0] * u + turn[1, 1] * v + turn[1, 2] * w,
            turn[2, 0] * u + turn[2, 1] * v + turn[2, 2] * w, reach)


@inlined
def _is_high(scene, ray, bits, place, flat, normal, step):
    """Whether a mesh of radius 1 blocks a ray from a place at a step of 255 of the sine over a plane."""
    sine = step / 255.0
    cosine = math.sqrt(1.0 - sine * sine)
    return _is_blocked(scene, ray, bits, place[0], place[1], place[2], cosine * flat[0] + sine * normal[0],
                       cosine * flat[1] + sine * normal[1], cosine * flat[2] + sine * normal[2], _FAR)


@inlined
def _around(axes, i, s, t):
    """Unit vector along (s, t) of two axes across a normal, one of some (6, N)."""
    per_length = 1.0 / math.sqrt(s * s + t * t)
    s, t = s * per_length, t * per_length
    return s * axes[0, i] + t * axes[3, i], s * axes[1, i] + t * axes[4, i], s * axes[2, i] + t * axes[5, i]


@inlined
def _stands_else(scene, ray, bits, place, axes, normal, azimuths, i, in_row, heights):
    """Whether a few rays from point i, which is in a row of neighbours, find anything else than its heights tell."""
    # Each neighbour at places of its own in both.
    part, turn, n_azimuths = in_row / _IN_A_ROW, 3 * in_row % _IN_A_ROW, azimuths.shape[1]
    near = _BETWEEN if part else _AT
    for k in range(n_azimuths):
        other = (k + 1) % n_azimuths
        flat = _around(axes, i, (1.0 - part) * azimuths[0, k] + part * azimuths[0, other],
                       (1.0 - part) * azimuths[1, k] + part * azimuths[1, other])
        one, two = intp(heights[i, k]), intp(heights[i, other if part else k])
        low, high = min(one, two), max(one, two)
        for j in range((i + k) % 2, len(_LOOKS) - 1, 2):
            step = _LOOKS[j] + (_LOOKS[j + 1] - _LOOKS[j]) * turn // _IN_A_ROW
            if (step > high + near or step < low - near) and (
                    _is_high(scene, ray, bits, place, flat, normal, step) != (step < low)):
                return True
    return False


@compiled(void(uintp, float64, _POINTS, _POINTS, _POINTS, float64, read(float64, 2), intp, write(uint8, 2, "A")))
def find_heights(scene, radius_m, points_m, normals, axes, lift_m, azimuths, unknown, found):
    """Write how high a mesh stands around points (3, N) [m] of its surface, over the plane across their normals (3, N).

    (N, K) uint8: of 255 steps of the sine, one at which a ray is blocked and a step above which it is free, in each of
    the azimuths (2, K), unit vectors along two axes across the normals (6, N); 0 where it is free at the first step.
    Some points in a row, which are neighbours, are all `unknown` if a few more rays find something else: above what is
    free, as an overhang, or between azimuths, as a peak.
    """
    ray, bits = _new_ray()
    n_points, n_azimuths = points_m.shape[1], azimuths.shape[1]
    for first in range(0, n_points, _IN_A_ROW):
        last = min(first + _IN_A_ROW, n_points)
        for i in range(first, last):
            normal = normals[0, i], normals[1, i], normals[2, i]
            place = ((points_m[0, i] + lift_m * normal[0]) / radius_m, (points_m[1, i] + lift_m * normal[1]) / radius_m,
                     (points_m[2, i] + lift_m * normal[2]) / radius_m)
            low = 0
            for k in range(n_azimuths):
                flat = _around(axes, i, azimuths[0, k], azimuths[1, k])
                # Not far from the one before.
                step, span, low, high = max(low, 1), _SPAN, 0, 255
                while high - low > 1:
                    if _is_high(scene, ray, bits, place, flat, normal, step):
                        low = step
                        step = min(low + span, 254) if high == 255 else (low + high) // 2
                    else:
                        high = step
                        step = max(high - span, 1) if low == 0 else (low + high) // 2
                    span *= 4
                found[i, k] = low
            if _stands_else(scene, ray, bits, place, axes, normal, azimuths, i, i - first, found):
                found[first:last] = unknown
                break


@compiled(Tuple((write(intp, 1), write(intp, 1), write(float64, 1), write(float64, 2), write(float64, 2)))(
    uintp, _POINTS, _POINTS, float64, read(float64, 2), read(float64, 1)))
def find_first(scene, start_m, direction, radius_m, normals, offset_m):
    """What rays from points (3, 1 or N) [m] in directions (3, N) meet first of a mesh in units of its radius [m].

    Their numbers (K,), the facets (K,), distances (K,) [m] to the facets' planes, rays and normals (3, K).
    """
    n_rays = direction.shape[1]
    place, facet, distance_m = np.empty(n_rays, np.intp), np.empty(n_rays, np.intp), np.empty(n_rays)
    rays, normal = np.empty((3, n_rays)), np.empty((3, n_rays))
    ray, bits = _new_ray()
    n = 0
    for i in range(n_rays):
        j = i if start_m.shape[1] > 1 else 0
        u, v, w = direction[0, i], direction[1, i], direction[2, i]
        x, y, z = start_m[0, j] / radius_m, start_m[1, j] / radius_m, start_m[2, j] / radius_m
        along = -(x * u + y * v + z * w)
        # On the bounding sphere, about, where the origin is beyond it.
        ahead = max(along - _NEARBY, 0.0)
        x, y, z = x + ahead * u, y + ahead * v, z + ahead * w
        if along <= -_REACH or not x * x + y * y + z * z - (along - ahead) ** 2 < _REACH**2:
            continue
        ray[0], ray[1], ray[2], ray[_NEAR] = x, y, z, 0.0
        ray[_TOWARDS], ray[_TOWARDS + 1], ray[_TOWARDS + 2] = u, v, w
        ray[_END], bits[_GEOMETRY] = _FAR, _NONE
        _rtc_intersect(scene, bits.ctypes.data, 0)
        if bits[_GEOMETRY] == _NONE:
            continue
        k = np.intp(bits[_PRIMITIVE])
        place[n], facet[n] = i, k
        across, height = 0.0, offset_m[k]
        for axis in range(3):
            rays[axis, n], normal[axis, n] = direction[axis, i], normals[axis, k]
            across += direction[axis, i] * normals[axis, k]
            height -= start_m[axis, j] * normals[axis, k]
        distance_m[n] = height / across
        n += 1
    return place[:n].copy(), facet[:n].copy(), distance_m[:n].copy(), rays[:, :n].copy(), normal[:, :n].copy()
