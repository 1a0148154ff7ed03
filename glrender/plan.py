"""The planner: the cheapest configuration that meets an error budget. Pure: no GL, no images.

Its error model is the measurement in `docs/planner.md`; a test compares its predictions
with ray-traced truth.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from glrender_camera import PinholeCamera

from .view import BodyView

MAX_SAMPLES = 16
"""Most samples along a pixel's side."""
SHADOW_SIZES_PX = (256, 512, 1024, 2048, 4096)
# One sample a pixel: squared error = limb / diameter + relief * facets per pixel, at 60 deg of phase.
_LIMB_ERROR_PX = 1.4
_RELIEF_ERROR = 0.0125
# Samples across a body that is smaller than `_SMALL_PX`: its flux is then within 2 N^-1.5 = 0.4 %
# (engine.md), at any place within the pixel and at any size.
_SMALL_PX = 4.0
_SAMPLES_ACROSS_SMALL = 64
# Share of the sunlit surface in cast shadow, per radian of phase (engine.md: 6 % at 10 deg).
_SHADOWED_PER_RAD = 0.34


@dataclass(frozen=True, kw_only=True)
class BodyPlan:
    """What is modelled of one body."""

    name: str
    is_visible: bool
    n_facets: int
    law: str
    shadow_map_px: int | None
    """Side of the shadow map [px]; None where nothing can cast on it."""
    shadow_map_reused: bool
    relative_to_camera: bool
    normal_lookup: bool
    size_px: float
    """Larger side of the outline's box [px]."""


@dataclass(frozen=True, kw_only=True)
class WindowPlan:
    """One part of the image that is drawn at once: bodies whose outlines' boxes touch.

    Attributes
    ----------
    bodies : tuple of str
    roi : (int, int, int, int) [px]
        Pixels that it touches: x0, y0, x1, y1, one past the last.
    samples : int
        Along each side of a pixel; 0 for a body so small that it has a grid of its own.
    bounds_px : (float, float, float, float) [px]
        What is drawn: the region's edges, or the small body's box.
    grid : (int, int)
        Samples across and down.
    predicted_error : float [1]
    """

    bodies: tuple[str, ...]
    roi: tuple[int, int, int, int]
    samples: int
    bounds_px: tuple[float, float, float, float]
    grid: tuple[int, int]
    predicted_error: float


@dataclass(frozen=True, kw_only=True)
class RenderPlan:
    """What a frame models, what it leaves out, and the error that is expected of it.

    Attributes
    ----------
    roi : (int, int, int, int) [px]
        Region outside which the image is zero: x0, y0, x1, y1, one past the last; all zero when
        nothing is in view.
    windows : tuple of WindowPlan
        What is drawn of it.
    predicted_error : float [1]
        RMS irradiance error over the mean of the lit pixels.
    left_out : tuple of str
    warnings : tuple of str
        What is used beyond its range.
    """

    camera: str
    max_error: float
    roi: tuple[int, int, int, int]
    windows: tuple[WindowPlan, ...]
    predicted_error: float
    bodies: tuple[BodyPlan, ...]
    left_out: tuple[str, ...] = field(default=())
    warnings: tuple[str, ...] = field(default=())

    @property
    def samples(self) -> int:
        """Most samples along a pixel's side in any window."""
        return max((window.samples for window in self.windows), default=0)

    def to_dict(self) -> dict[str, Any]:
        """Plain data, for the wire."""
        return asdict(self)


def one_sample_error(view: BodyView, n_facets: int, error_gain: float) -> float:
    """Predicted error of a body drawn with one sample a pixel; n by n have n^-1.5 of it.

    Parameters
    ----------
    view : BodyView
    n_facets : int
    error_gain : float [1]
        What the camera's PSF leaves of an error that is independent from pixel to pixel.
    """
    diameter = min(max(view.size_px, 1.0), 1e5)
    facets_per_px = 0.5 * n_facets / (0.6 * diameter**2)
    lit = max(0.5 * (1.0 + math.cos(view.phase_rad)), 1e-3)
    squared = (_LIMB_ERROR_PX / diameter + _RELIEF_ERROR * min(facets_per_px, 4.0)) * (0.75 / lit) ** 1.2
    return error_gain * math.sqrt(squared)


def plan_windows(views: list[BodyView], n_facets: dict[str, int], camera: PinholeCamera, max_error: float,
                 error_gain: float, samples: int | None) -> tuple[WindowPlan, ...]:
    """Split the image into windows, each with the samples that its bodies need.

    Bodies far apart in the image are drawn apart, so that the cost follows their pixels; a body
    smaller than a few pixels is drawn on a grid of its own that fits its outline.
    """
    windows = []
    for members in _touching(views, camera):
        roi = region(members, camera)
        names = tuple(view.name for view in members)
        error = max(one_sample_error(view, n_facets[view.name], error_gain) for view in members)
        if samples is None and len(members) == 1 and members[0].size_px < _SMALL_PX:
            x0, y0, x1, y1 = members[0].bounds_px
            margin = 0.02 * members[0].size_px
            bounds = (x0 - margin, y0 - margin, x1 + margin, y1 + margin)
            grid = tuple(max(math.ceil(_SAMPLES_ACROSS_SMALL * side / members[0].size_px), 8)
                         for side in (x1 - x0, y1 - y0))
            windows.append(WindowPlan(bodies=names, roi=roi, samples=0, bounds_px=tuple(map(float, bounds)),
                                      grid=grid, predicted_error=2.0 * _SAMPLES_ACROSS_SMALL**-1.5))
            continue
        count = samples or min(max(1, math.ceil((error / max_error) ** (2.0 / 3.0) - 1e-9)), MAX_SAMPLES)
        x0, y0, x1, y1 = roi
        windows.append(WindowPlan(
            bodies=names, roi=roi, samples=count, bounds_px=(x0 - 0.5, y0 - 0.5, x1 - 0.5, y1 - 0.5),
            grid=((x1 - x0) * count, (y1 - y0) * count), predicted_error=error * count**-1.5))
    return tuple(windows)


def plan_shadow(view: BodyView, is_convex: bool, has_casters: bool, max_error: float) -> int | None:
    """Side of the shadow map [px], or None when nothing can cast on what is seen.

    Two things ask for texels. A shadow's place matters to the pixel: one and a half texels a
    pixel. And what a texel cannot see leaks light, the more the lower the Sun: the second term
    keeps the flux within a tenth of the budget (measured on Itokawa, `docs/planner.md`).
    """
    if not has_casters:
        if is_convex:
            return None
        if _SHADOWED_PER_RAD * view.phase_rad < 0.1 * max_error:
            return None
    low_sun = 1.9 * math.tan(min(0.5 * view.phase_rad, 1.5)) ** 1.57 * (0.02 / max_error)
    texels = min(view.size_px, 1e5) * max(1.5, low_sun)
    return next((size for size in SHADOW_SIZES_PX if size >= texels), SHADOW_SIZES_PX[-1])


def region(views: list[BodyView], camera: PinholeCamera) -> tuple[int, int, int, int]:
    """x0, y0, x1, y1 [px] of the pixels that visible bodies may touch."""
    frame = np.array([camera.width_px, camera.height_px])
    if any(view.bounds_px is None for view in views):
        return (0, 0, camera.width_px, camera.height_px)
    bounds = np.array([view.bounds_px for view in views])
    # Pixel k covers k - 1/2 to k + 1/2.
    low = np.clip(np.floor(bounds[:, :2].min(axis=0) + 0.5), 0, frame)
    high = np.clip(np.floor(bounds[:, 2:].max(axis=0) + 0.5) + 1, 0, frame)
    return tuple(int(x) for x in (*low, *high))


def _touching(views: list[BodyView], camera: PinholeCamera) -> list[list[BodyView]]:
    """Visible bodies in groups whose regions share no pixel."""
    groups: list[list[BodyView]] = []
    for view in views:
        if not view.is_visible:
            continue
        group = [view]
        while True:
            touches = [other for other in groups if _overlap(region(group, camera), region(other, camera))]
            if not touches:
                break
            group = sum(touches, group)
            groups = [other for other in groups if other not in touches]
        groups.append(sorted(group, key=views.index))
    return groups


def _overlap(a: tuple[int, int, int, int], b: tuple[int, int, int, int]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def union(regions: list[tuple[int, int, int, int]]) -> tuple[int, int, int, int]:
    """The box around regions; all zero around none."""
    if not regions:
        return (0, 0, 0, 0)
    boxes = np.array(regions)
    return tuple(int(x) for x in (*boxes[:, :2].min(axis=0), *boxes[:, 2:].max(axis=0)))


def is_close(view: BodyView, radius_m: float, footprint_m: float) -> bool:
    """Whether body-fixed float32 coordinates, good to 6e-8 radii, are too coarse for what is seen."""
    depth_m = view.depth_m[0]
    return depth_m < 0.05 * radius_m or (footprint_m < 2e-5 * radius_m and depth_m < 0.5 * radius_m)


def depth_groups(views: list[BodyView]) -> list[tuple[float, float, list[BodyView]]]:
    """Bodies that share a depth range, farthest first: (near, far, bodies) [m].

    A fitted range keeps a 24-bit depth buffer exact to 1e9 radii; bodies whose ranges do not
    overlap are drawn one behind the other.
    """
    groups: list[tuple[float, float, list[BodyView]]] = []
    for view in sorted((v for v in views if v.is_visible), key=lambda v: v.depth_m[1], reverse=True):
        near, far = view.depth_m
        if groups and far >= groups[-1][0]:
            last_near, last_far, members = groups[-1]
            groups[-1] = (min(near, last_near), last_far, [*members, view])
        else:
            groups.append((near, far, [view]))
    return groups


def snapped_sun(sun_direction_body: np.ndarray, shadow_map_px: int) -> np.ndarray:
    """The direction that a shadow map is drawn for: the nearest node of a grid finer than half a texel.

    Drawing for the node, not for the first direction asked for, makes the reuse of a map
    independent of history: the same request gives the same bytes.

    Parameters
    ----------
    sun_direction_body : (3,) float64 [1]
    shadow_map_px : int
        A texel is 2 R / size; relief of up to R moves its shadow by half of that in 1 / size rad.
    """
    largest = np.argmax(np.abs(sun_direction_body))
    face = sun_direction_body / abs(sun_direction_body[largest])
    snapped = np.round(face * shadow_map_px) / shadow_map_px
    return snapped / np.linalg.norm(snapped)
