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

MAX_SAMPLES = 64
"""Most samples along a pixel's side; a body of half a pixel then has 32 across."""
SHADOW_SIZES_PX = (256, 512, 1024, 2048, 4096)
# One sample a pixel: squared error = limb / diameter + relief * facets per pixel, at 60 deg of phase.
_LIMB_ERROR_PX = 1.4
_RELIEF_ERROR = 0.0125
# A body needs this many samples across for its flux (engine.md: sigma = 1..2 N^-1.5).
_SAMPLES_ACROSS = 32
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
class RenderPlan:
    """What a frame models, what it leaves out, and the error that is expected of it.

    Attributes
    ----------
    roi : (int, int, int, int) [px]
        Region drawn: x0, y0, x1, y1, one past the last; all zero when nothing is in view.
    samples : int
        Along each side of a pixel.
    predicted_error : float [1]
        RMS irradiance error over the mean of the lit pixels.
    left_out : tuple of str
    """

    camera: str
    max_error: float
    roi: tuple[int, int, int, int]
    samples: int
    predicted_error: float
    bodies: tuple[BodyPlan, ...]
    left_out: tuple[str, ...] = field(default=())

    def to_dict(self) -> dict[str, Any]:
        """Plain data, for the wire."""
        return asdict(self)


def plan_samples(view: BodyView, n_facets: int, max_error: float, error_gain: float) -> tuple[int, float]:
    """Samples along a pixel's side that meet a budget.

    Parameters
    ----------
    view : BodyView
    n_facets : int
    max_error : float [1]
    error_gain : float [1]
        What the camera's PSF leaves of an error that is independent from pixel to pixel.

    Returns
    -------
    (int, float)
        Samples, and the predicted error with them.
    """
    diameter = max(min(view.size_px, 1e5), 1e-3)
    facets_per_px = 0.5 * n_facets / (0.6 * diameter**2)
    lit = max(0.5 * (1.0 + math.cos(view.phase_rad)), 1e-3)
    squared = (_LIMB_ERROR_PX / diameter + _RELIEF_ERROR * min(facets_per_px, 4.0)) * (0.75 / lit) ** 1.2
    one_sample = error_gain * math.sqrt(squared)
    samples = max(1, math.ceil((one_sample / max_error) ** (2.0 / 3.0)), math.ceil(_SAMPLES_ACROSS / diameter))
    samples = min(samples, MAX_SAMPLES)
    return samples, one_sample * samples**-1.5


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


def region_of_interest(views: list[BodyView], camera: PinholeCamera) -> tuple[int, int, int, int]:
    """x0, y0, x1, y1 [px] of the pixels that a visible body may touch."""
    frame = np.array([0, 0, camera.width_px, camera.height_px])
    boxes = []
    for view in views:
        if view.is_visible and view.bounds_px is None:
            return tuple(int(x) for x in frame)
        if view.is_visible:
            # Pixel k covers k - 1/2 to k + 1/2.
            low = np.floor(view.bounds_px[:2] + 0.5)
            high = np.floor(view.bounds_px[2:] + 0.5) + 1
            boxes.append(np.concatenate([np.clip(low, 0, frame[2:]), np.clip(high, 0, frame[2:])]))
    if not boxes:
        return (0, 0, 0, 0)
    boxes = np.array(boxes)
    return tuple(int(x) for x in (*boxes[:, :2].min(axis=0), *boxes[:, 2:].max(axis=0)))


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
