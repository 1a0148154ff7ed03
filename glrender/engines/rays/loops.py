"""Loops over rays, compiled by Numba when this is imported, once on a machine. Vectors are in columns.

Rays are cast eight at a time, as processors with AVX2 work on as many at once: they share what they read of a mesh.
"""

from __future__ import annotations

import ctypes
import math

import numpy as np
from glrender_camera.numba_loops import PLACE, POINTS, compiled, inlined, read, write
from llvmlite import binding
from numba import carray, cfunc, types
from numba.extending import intrinsic
from numba.types import Tuple, boolean, float32, float64, int32, intp, uint8, uint32, uintp, void

from .embree import library

# Radius of the bounding sphere, in radii: rays beyond meet nothing, and float32 has no room for a start far off.
_REACH = 1.01
# Float32 rays start no farther than this from where they pass the middle, in radii.
_NEARBY = 1.5
_FAR = np.float32(1e30)
# Rays at once; of RTCRayHit, in rows of 32 bits: where rays begin, where to, where they end, and their mask; of hits,
# which primitive and geometry; and how many rows there are.
_LANES = 8
_NEAR, _TOWARDS, _END, _MASK, _PRIMITIVE, _GEOMETRY, _ROWS = 3, 4, 8, 9, 17, 18, 21
_NONE = np.uint32(0xFFFFFFFF)
# RTCIntersectArguments and RTCOccludedArguments, in words: that rays go the same way, that a filter is asked, and all
# that a mesh may have; and which pair of words is the filter.
_COHERENT, _FILTERED, _ALL, _FILTER, _ALIGNED_WORDS = 1 << 16, 1 << 1, 0xFFFFFFFF, 2, 16
# Points in a row that share what rays find where heights tell something else: each looks once in every other one of the
# spans between these steps of 255 of a sine, at and between azimuths; so much nearer a height they do not, nor between
# two.
_IN_A_ROW, _LOOKS, _AT, _BETWEEN = 8, tuple(range(12, 255, 20)), 2, 24
# First step from the height of the point before, four times as large each time.
_SPAN = 4

for _name in ("rtcOccluded8", "rtcIntersect8"):
    binding.add_symbol(_name, ctypes.cast(getattr(library(), _name), ctypes.c_void_p).value)
_rtc_occluded = types.ExternalFunction("rtcOccluded8", void(uintp, uintp, uintp, uintp))
_rtc_intersect = types.ExternalFunction("rtcIntersect8", void(uintp, uintp, uintp, uintp))
_RAYS, _VALID = write(float32, 2), write(int32, 1)


@intrinsic
def _floats_at(context, address):
    """The float32 numbers at an address."""
    pointer = types.CPointer(float32)
    return pointer(address), lambda target, builder, signature, args: builder.inttoptr(
        args[0], target.get_value_type(pointer))


def _filter(is_left_out):
    """A filter of Embree's that leaves hits out by the sign of the product of their normals and rays."""
    def leave_out(arguments):
        # RTCFilterFunctionNArguments: valid, two more, RTCRayN, RTCHitN, and how many there are.
        words = carray(arguments, 6, np.uint64)
        valid, ray, hit, n = _floats_at(words[0]), _floats_at(words[3]), _floats_at(words[4]), intp(words[5] & _ALL)
        for k in range(n):
            across = 0.0
            for axis in range(3):
                across += ray[(_TOWARDS + axis) * n + k] * hit[axis * n + k]
            if is_left_out * across > 0.0:
                valid[k] = float32(0.0)

    signature = void(types.voidptr)
    try:
        return cfunc(signature, cache=True)(leave_out)
    except Exception:  # where machine code cannot be kept: `numba_loops.compiled`
        return cfunc(signature)(leave_out)


_filters = [_filter(sign) for sign in (1.0, -1.0)]
FILTERS = (0, *(each.address for each in _filters))
"""Filters of hits by the sides of facets, as `exact_loops` counts them: 0, 1, -1."""


@compiled(write(uint32, 1)(intp))
def _aligned(n_words):
    """Words that are 0, as Embree takes them."""
    memory = np.zeros(n_words + _ALIGNED_WORDS, np.uint32)
    first = (-memory.ctypes.data // 4) % _ALIGNED_WORDS
    return memory[first:first + n_words]


@compiled(Tuple((_RAYS, write(uint32, 2), _VALID))())
def _new_rays():
    """Memory of an RTCRayHit of many rays, in float32 and uint32; and which rays are valid."""
    bits = _aligned(_ROWS * _LANES).reshape((_ROWS, _LANES))
    bits[_MASK] = _NONE
    return bits.view(np.float32), bits, _aligned(_LANES).view(np.int32)


@compiled(boolean(_RAYS, intp, PLACE, PLACE, float64))
def _aim(rays, lane, place, towards, reach):
    """Write a ray; whether it may meet a mesh of radius 1 within a distance."""
    x, y, z = place
    u, v, w = towards
    if x * x + y * y + z * z > _REACH**2:
        # Far sunward of the bounding sphere, or outside it, there is nothing to meet.
        along = x * u + y * v + z * w
        a, b, c = x - along * u, y - along * v, z - along * w
        if along >= _REACH or not a * a + b * b + c * c < _REACH**2:
            return False
        skipped = max(-along - _NEARBY, 0.0)
        x, y, z, reach = x + skipped * u, y + skipped * v, z + skipped * w, reach - skipped
    rays[0, lane], rays[1, lane], rays[2, lane], rays[_NEAR, lane] = x, y, z, 0.0
    rays[_TOWARDS, lane], rays[_TOWARDS + 1, lane], rays[_TOWARDS + 2, lane] = u, v, w
    rays[_END, lane] = min(max(reach, 0.0), _FAR)
    return True


@inlined
def _first_are_valid(valid, n):
    for lane in range(_LANES):
        valid[lane] = -1 if lane < n else 0


@inlined
def _arguments(flags, filter):
    """Embree's arguments of rays with a filter, or without one (0)."""
    arguments = _aligned(_ALIGNED_WORDS)
    arguments[0], arguments[1] = flags | (_FILTERED if filter else 0), _ALL
    arguments.view(np.uint64)[_FILTER] = filter
    return arguments


@inlined
def _look_for_blocks(scene, rays, valid, n, arguments):
    """See which of the first n rays meet a mesh: those end at minus infinity then."""
    _first_are_valid(valid, n)
    _rtc_occluded(valid.ctypes.data, scene, rays.ctypes.data, arguments)


@compiled(void(uintp, _RAYS, _VALID, read(intp, 1), intp, uintp, write(boolean, 1)))
def _tell_blocked(scene, rays, valid, which, n, arguments, found):
    """Write which points' rays, the first n, meet a mesh."""
    if n == 0:
        return
    _look_for_blocks(scene, rays, valid, n, arguments)
    for lane in range(n):
        if rays[_END, lane] < 0.0:
            found[which[lane]] = True


@compiled(void(uintp, POINTS, POINTS, read(float64, 1), float64, uintp, write(boolean, 1)))
def find_blocked(scene, start_m, direction, reach_m, radius_m, filter, found):
    """Whether rays from points (3, N) [m] in directions (3, 1 or N) meet a mesh within a reach (1 or N,) [m].

    The mesh is in units of its radius [m]; its facets count as one of the `FILTERS` has it.
    """
    (rays, _, valid), which, n = _new_rays(), np.empty(_LANES, np.intp), 0
    arguments = _arguments(0, filter)
    found[:] = False
    for i in range(start_m.shape[1]):
        j, k = i if direction.shape[1] > 1 else 0, i if len(reach_m) > 1 else 0
        which[n] = i
        n += _aim(rays, n, (start_m[0, i] / radius_m, start_m[1, i] / radius_m, start_m[2, i] / radius_m),
                  (direction[0, j], direction[1, j], direction[2, j]), reach_m[k] / radius_m)
        if n == _LANES:
            _tell_blocked(scene, rays, valid, which, n, arguments.ctypes.data, found)
            n = 0
    _tell_blocked(scene, rays, valid, which, n, arguments.ctypes.data, found)


@inlined
def _at_height(flat, normal, step):
    """Direction at a step of 255 of the sine over a plane."""
    sine = step / 255.0
    cosine = math.sqrt(1.0 - sine * sine)
    return (cosine * flat[0] + sine * normal[0], cosine * flat[1] + sine * normal[1],
            cosine * flat[2] + sine * normal[2])


@inlined
def _around(axes, i, s, t):
    """Unit vector along (s, t) of two axes across a normal, one of some (6, N)."""
    per_length = 1.0 / math.sqrt(s * s + t * t)
    s, t = s * per_length, t * per_length
    return s * axes[0, i] + t * axes[3, i], s * axes[1, i] + t * axes[4, i], s * axes[2, i] + t * axes[5, i]


@compiled(boolean(uintp, _RAYS, _VALID, PLACE, POINTS, intp, PLACE, read(float64, 2), intp, write(uint8, 2, "A")))
def _stands_else(scene, rays, valid, place, axes, i, normal, azimuths, in_row, heights):
    """Whether a few rays from point i, which is in a row of neighbours, find anything else than its heights predict."""
    # Each neighbour at places of its own in both.
    part, turn, n_azimuths = in_row / _IN_A_ROW, 3 * in_row % _IN_A_ROW, azimuths.shape[1]
    near = _BETWEEN if part else _AT
    is_below, n = np.empty(_LANES, np.bool_), 0
    for k in range(n_azimuths):
        other = (k + 1) % n_azimuths
        flat = _around(axes, i, (1.0 - part) * azimuths[0, k] + part * azimuths[0, other],
                       (1.0 - part) * azimuths[1, k] + part * azimuths[1, other])
        one, two = intp(heights[i, k]), intp(heights[i, other if part else k])
        low, high = min(one, two), max(one, two)
        for j in range((i + k) % 2, len(_LOOKS) - 1, 2):
            step = _LOOKS[j] + (_LOOKS[j + 1] - _LOOKS[j]) * turn // _IN_A_ROW
            if step > high + near or step < low - near:
                _aim(rays, n, place, _at_height(flat, normal, step), _FAR)
                is_below[n] = step < low
                n += 1
            if n == _LANES or n and k == n_azimuths - 1 and j + 2 >= len(_LOOKS) - 1:
                _look_for_blocks(scene, rays, valid, n, 0)
                for lane in range(n):
                    if (rays[_END, lane] < 0.0) != is_below[lane]:
                        return True
                n = 0
    return False


@compiled(void(uintp, float64, POINTS, POINTS, POINTS, float64, read(float64, 2), intp, write(uint8, 2, "A")))
def find_heights(scene, radius_m, points_m, normals, axes, lift_m, azimuths, unknown, found):
    """Write how high a mesh stands around points (3, N) [m] of its surface, over the plane across their normals (3, N).

    (N, K) uint8: of 255 steps of the sine, one at which a ray is blocked and a step above which it is free, in each of
    the azimuths (2, K), unit vectors along two axes across the normals (6, N); 0 where it is free at the first step.
    Some points in a row, which are neighbours, are all `unknown` if a few more rays find something else: above what is
    free, as an overhang, or between azimuths, as a peak. If that is 0, nothing is looked for.
    """
    (rays, _, valid), which = _new_rays(), np.empty(_LANES, np.intp)
    n_points, n_azimuths = points_m.shape[1], azimuths.shape[1]
    low, high = np.zeros(n_azimuths, np.intp), np.empty(n_azimuths, np.intp)
    step, span = np.empty(n_azimuths, np.intp), np.empty(n_azimuths, np.intp)
    for first in range(0, n_points, _IN_A_ROW):
        last = min(first + _IN_A_ROW, n_points)
        for i in range(first, last):
            normal = normals[0, i], normals[1, i], normals[2, i]
            place = ((points_m[0, i] + lift_m * normal[0]) / radius_m, (points_m[1, i] + lift_m * normal[1]) / radius_m,
                     (points_m[2, i] + lift_m * normal[2]) / radius_m)
            for k in range(n_azimuths):
                # Not far from that of the point before.
                step[k], span[k], low[k], high[k] = max(low[k], 1), _SPAN, 0, 255
            n_left = n_azimuths
            while n_left:
                n_left, n = 0, 0
                for k in range(n_azimuths + 1):
                    if k < n_azimuths and high[k] - low[k] > 1:
                        flat = _around(axes, i, azimuths[0, k], azimuths[1, k])
                        _aim(rays, n, place, _at_height(flat, normal, step[k]), _FAR)
                        which[n] = k
                        n, n_left = n + 1, n_left + 1
                    if n == _LANES or n and k == n_azimuths:
                        _look_for_blocks(scene, rays, valid, n, 0)
                        for lane in range(n):
                            m = which[lane]
                            if rays[_END, lane] < 0.0:
                                low[m] = step[m]
                                step[m] = min(low[m] + span[m], 254) if high[m] == 255 else (low[m] + high[m]) // 2
                            else:
                                high[m] = step[m]
                                step[m] = max(high[m] - span[m], 1) if low[m] == 0 else (low[m] + high[m]) // 2
                            span[m] *= 4
                        n = 0
            found[i] = low
            if unknown and _stands_else(scene, rays, valid, place, axes, i, normal, azimuths, i - first, found):
                found[first:last] = unknown
                break


@compiled(Tuple((write(intp, 1), write(intp, 1), write(float64, 1), write(float64, 2), write(float64, 2)))(
    uintp, POINTS, POINTS, float64, POINTS, read(float64, 1), uintp))
def find_first(scene, start_m, direction, radius_m, normals, offset_m, filter):
    """First hits on a mesh in units of its radius [m], by rays from points (3, 1 or N) [m] in directions (3, N).

    On facets as one of the `FILTERS` has it.

    Their numbers (K,), the facets (K,), distances (K,) [m] to the facets' planes, rays and normals (3, K).
    """
    n_rays = direction.shape[1]
    place, facet, distance_m = np.empty(n_rays, np.intp), np.empty(n_rays, np.intp), np.empty(n_rays)
    found_rays, normal = np.empty((3, n_rays)), np.empty((3, n_rays))
    (rays, bits, valid), which, arguments = _new_rays(), np.empty(_LANES, np.intp), _arguments(_COHERENT, filter)
    n, n_aimed = 0, 0
    for i in range(n_rays):
        j = i if start_m.shape[1] > 1 else 0
        which[n_aimed] = i
        n_aimed += _aim(rays, n_aimed, (start_m[0, j] / radius_m, start_m[1, j] / radius_m, start_m[2, j] / radius_m),
                        (direction[0, i], direction[1, i], direction[2, i]), _FAR)
        if n_aimed < _LANES and i < n_rays - 1 or n_aimed == 0:
            continue
        _first_are_valid(valid, n_aimed)
        bits[_GEOMETRY] = _NONE
        _rtc_intersect(valid.ctypes.data, scene, rays.ctypes.data, arguments.ctypes.data)
        for lane in range(n_aimed):
            if bits[_GEOMETRY, lane] == _NONE:
                continue
            ray, k = which[lane], np.intp(bits[_PRIMITIVE, lane])
            begin = ray if start_m.shape[1] > 1 else 0
            place[n], facet[n] = ray, k
            across, height = 0.0, offset_m[k]
            for axis in range(3):
                found_rays[axis, n], normal[axis, n] = direction[axis, ray], normals[axis, k]
                across += direction[axis, ray] * normals[axis, k]
                height -= start_m[axis, begin] * normals[axis, k]
            distance_m[n] = height / across
            n += 1
        n_aimed = 0
    return place[:n].copy(), facet[:n].copy(), distance_m[:n].copy(), found_rays[:, :n].copy(), normal[:, :n].copy()
