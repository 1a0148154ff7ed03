"""Depth of a frame: offsets from a prior surface along its rays, tried by how well its neighbours then agree."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from .frames import LEAST_COS_EMISSION, PosedFrame, angle_rad
from .mesh import Mesh

# Neighbours: near enough to look alike, far enough to tell depth.
_NEIGHBOURS_RAD = (np.radians(8.0), np.radians(24.0))
_N_NEIGHBOURS = 4
# The best of the neighbours count: in others the place is hidden or in shadow.
_N_BEST = 2
# Least root of the signal over that of white [1].
_LEAST_LIGHT = 0.2
# Variance of the same in a window: below it is noise alone.
_LEAST_VARIANCE = 0.3 / 3600.0
_LEAST_CORRELATION = 0.7
_LEAST_PIXELS = 500
_MARGIN_PX = 8


class Pass(NamedTuple):
    """One sweep of all frames: how far offsets go to both sides of the prior surface, their steps, and the voxel of the
    surface of the depths, in pixels on the ground of the nearest frame; `window` is a side in pixels of the frame."""

    reach_px: float
    step_px: float
    window: int
    voxel_px: float


PASSES = (Pass(reach_px=20.0, step_px=2.0, window=9, voxel_px=2.0),
          Pass(reach_px=5.0, step_px=0.8, window=7, voxel_px=1.3))
"""About the surface of sparse points, and about what that gives."""


def depth_map(frames: Sequence[PosedFrame], index: int, prior: Mesh, plan: Pass, px_m: float) -> np.ndarray | None:
    """Depths (height, width) float32 [m] of a frame along its boresight, 0 where there is none; None of one of no use.

    They are about the prior surface; `px_m` [m] is the pixel on the ground of the nearest frame.
    """
    frame, root = frames[index], frames[index].root
    neighbours = _neighbours(frames, index)
    depth_m, facet = frame.depth(prior)
    hit = (facet >= 0) & (root > _LEAST_LIGHT)
    if not neighbours or hit.sum() < _LEAST_PIXELS:
        return None
    rows, columns = np.flatnonzero(hit.any(axis=1)), np.flatnonzero(hit.any(axis=0))
    cut = np.s_[max(rows[0] - _MARGIN_PX, 0):rows[-1] + _MARGIN_PX + 1,
                max(columns[0] - _MARGIN_PX, 0):columns[-1] + _MARGIN_PX + 1]
    y, x = (each[cut] for each in np.indices(hit.shape))
    hit, facet = hit[cut], facet[cut]
    start_m = np.where(facet >= 0, depth_m[cut], np.median(depth_m[cut][hit])).astype(np.float32)
    unit = frame.camera.direction(np.stack([x, y], axis=-1))
    cos_emission = np.abs((unit @ frame.camera_from_body * prior.facet_normals[facet]).sum(axis=-1))
    ray = (unit / unit[..., 2:]).astype(np.float32)
    offsets_m = (np.arange(-plan.reach_px, plan.reach_px + plan.step_px / 2.0, plan.step_px) * px_m).astype(np.float32)
    window = _Window(root[cut], plan.window)
    warps = [(frames[k].root, _Warp(frame, frames[k], ray, start_m)) for k in neighbours]
    volume = np.empty((len(offsets_m), *start_m.shape), np.float32)
    for k, offset_m in enumerate(offsets_m):
        scores = [window.correlation(warp.image(other, offset_m, plan.window)) for other, warp in warps]
        volume[k] = np.mean(np.sort(scores, axis=0)[-_N_BEST:], axis=0)
    best = volume.argmax(axis=0)
    inner = np.clip(best, 1, len(offsets_m) - 2)
    low, top, high = (np.take_along_axis(volume, (inner + k)[None], 0)[0] for k in (-1, 0, 1))
    bend = low - 2.0 * top + high
    # The vertex of the parabola through three scores.
    part = np.clip(0.5 * (low - high) / np.where(np.abs(bend) > 1e-6, bend, np.float32(1e9)), -1.0, 1.0)
    step_m = np.float32(plan.step_px * px_m)
    found_m = (start_m + offsets_m[inner] + part * step_m).astype(np.float32)
    good = hit & (volume.max(axis=0) > _LEAST_CORRELATION) & (best == inner) & (cos_emission > LEAST_COS_EMISSION)
    # Lone pixels off the median of those around them are wrong.
    good &= np.abs(found_m - cv2.medianBlur(found_m, 5)) < 0.6 * step_m + 0.7 * px_m
    whole_m = np.zeros(root.shape, np.float32)
    whole_m[cut] = np.where(good, found_m, 0.0)
    return whole_m


def _neighbours(frames: Sequence[PosedFrame], index: int) -> list[int]:
    """Numbers of the frames nearest to the middle of the angles that are good."""
    low, high = _NEIGHBOURS_RAD
    apart = {k: angle_rad(frames[index], frame) for k, frame in enumerate(frames) if k != index}
    near = [k for k, angle in apart.items() if low <= angle <= high]
    return sorted(near, key=lambda k: abs(apart[k] - 0.5 * (low + high)))[:_N_NEIGHBOURS]


class _Window:
    """Normalised correlation of an image with others, in a window about each pixel."""

    def __init__(self, image: np.ndarray, size: int):
        self._image, self._size = image, (size, size)
        self._mean, variance = self._moments(image)
        self._inverse = 1.0 / np.sqrt(np.maximum(variance, _LEAST_VARIANCE))

    def _moments(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        mean = cv2.blur(image, self._size)
        return mean, cv2.blur(image * image, self._size) - mean * mean

    def correlation(self, other: np.ndarray) -> np.ndarray:
        """(height, width) float32, -1 where the other image is flat."""
        mean, variance = self._moments(other)
        shared = cv2.blur(self._image * other, self._size) - self._mean * mean
        return np.where(variance > _LEAST_VARIANCE,
                        shared * self._inverse / np.sqrt(np.maximum(variance, _LEAST_VARIANCE)), np.float32(-1.0))


class _Warp:
    """Where the pixels of a frame lie in another one, by their depth: linear in it before the projection."""

    def __init__(self, frame: PosedFrame, other: PosedFrame, ray: np.ndarray, start_m: np.ndarray):
        turn = (other.camera_from_body @ frame.camera_from_body.T).astype(np.float32)
        along = ray @ turn.T
        begin = along * start_m[..., None] + other.to_camera(frame.r_camera_body_m).astype(np.float32)
        self._along, self._begin = (np.ascontiguousarray(np.moveaxis(each, -1, 0)) for each in (along, begin))
        self._f = np.float32(other.camera.focal_length_px)
        self._center = np.array(other.camera.principal_point_px, np.float32)

    def image(self, other: np.ndarray, offset_m: np.float32, window: int) -> np.ndarray:
        """The other image as the frame has it at an offset."""
        x, y, z = self._begin + self._along * offset_m
        scale = self._f / z
        kind = cv2.INTER_LINEAR if window > PASSES[1].window else cv2.INTER_CUBIC
        return cv2.remap(other, x * scale + self._center[0], y * scale + self._center[1], kind)
