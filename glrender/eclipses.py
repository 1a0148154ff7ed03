"""Which bodies cast shadows on which, and what those leave of a body's light. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from glrender_camera import PinholeCamera

from . import frames
from .hull import Hull
from .view import BodyView, between

# Ways by which an outline is told in the Sun's plane, (2, W).
_WAYS = np.array([np.cos(np.arange(32) * np.pi / 16), np.sin(np.arange(32) * np.pi / 16)])
# Places along a side of a body's disc, and of a shadow on it.
_PLACES = 24
LEAST_LEFT = 0.02
"""Share of a body's light below which what is left is not told apart: hulls and places tell no less."""
# What squared errors of hard edges are told more than places have it; and the width of penumbras [px] of which pixels
# leave half.
_SPARE, _HALF_PX = 1.6, 4.5
# RMS error that is told of as much error of the flux: ten, and what grazing shadows of bodies that are no spheres move.
_FLUX = 15.0
# Steps between places that one beside the image may be within it: a body is not a sphere.
_BESIDE_STEPS = 1.5
# Least cosine of the Sun's height that an area is told by.
_LEAST_RISE = 0.1


@dataclass(frozen=True, kw_only=True)
class Eclipse:
    """What the shadows of other bodies do to a body's light.

    Attributes
    ----------
    left : float [1]
        Share of it that they leave, as the camera sees it, rather too little: all bodies are as wide as their hulls.
    noise : float [1]
        RMS error of the flux, over what is left, with one sample across the body that meets one point of the Sun's
        disc: N^-1 with N.
    error : float [1]
        RMS error of hard edges in place of penumbras, over the mean of what is left, or fifteen times that of the flux.
    width_px : float [px]
        Of the widest penumbra.
    """

    left: float = 1.0
    noise: float = 0.0
    error: float = 0.0
    width_px: float = 0.0


NO_ECLIPSE = Eclipse()


def casters(receiver: BodyView, views: Sequence[BodyView], hulls: Mapping[str, Hull],
            sun_radius_rad: float = 0.0) -> list[tuple[str, np.ndarray]]:
    """Other bodies whose shadow may fall on the receiver: (name, receiver_from_caster as (4, 4))."""
    found, radius_m = [], hulls[receiver.name].radius_m
    for other in views:
        if other.name == receiver.name:
            continue
        rotation, offset_m = between(other, receiver)
        sunward_m = float(offset_m @ receiver.sun_direction_body)
        aside_m = float(np.linalg.norm(offset_m - sunward_m * receiver.sun_direction_body))
        reach_m = radius_m + hulls[other.name].radius_m
        if aside_m < reach_m + sun_radius_rad * max(sunward_m, 0.0) and sunward_m > -reach_m:
            found.append((other.name, frames.transform(rotation, offset_m)))
    return found


def eclipse(receiver: BodyView, cast: Sequence[tuple[str, np.ndarray]], hulls: Mapping[str, Hull],
            camera: PinholeCamera, sun_radius_rad: float) -> Eclipse:
    """What the shadows of `casters` do to the receiver: a sphere by Lambert's law, stretched to its outline.

    Of a body of which the image shows a part, what they do there.

    Parameters
    ----------
    receiver : BodyView
    cast : sequence of (str, (4, 4) array)
        From `casters`.
    hulls : mapping of str to Hull
    camera : PinholeCamera
    sun_radius_rad : float [rad]
        Angular radius of the Sun; 0 for one without a disc.
    """
    if not cast:
        return NO_ECLIPSE
    disc, footprint_m = _Disc(receiver, hulls[receiver.name], camera), receiver.depth_m[0] / camera.focal_length_px
    places_m, cell_m2, _ = _grid(disc.low_m, disc.high_m)
    bright, rise = disc.light(places_m)
    total, area_m2 = cell_m2 * float(bright.sum()), cell_m2 * float((bright / np.maximum(rise, _LEAST_RISE)).sum())
    if not receiver.is_whole:
        shown = min(camera.width_px * camera.height_px * footprint_m**2 / area_m2, 1.0)
        total, area_m2 = shown * total, shown * area_m2
    lost = ramps = edges = gained = width_m = 0.0
    for name, receiver_from_caster in cast:
        gap_m = float(receiver_from_caster[:3, 3] @ receiver.sun_direction_body)
        if gap_m <= 0.0:
            continue
        outline_m = disc.plane @ (receiver_from_caster[:3, :3] @ hulls[name].points_m + receiver_from_caster[:3, 3:])
        reach_m = sun_radius_rad * gap_m
        low_m = np.maximum(outline_m.min(axis=1) - reach_m, disc.low_m)
        high_m = np.minimum(outline_m.max(axis=1) + reach_m, disc.high_m)
        if (high_m <= low_m).any():
            continue
        places_m, cell_m2, step_m = _grid(low_m, high_m)
        bright, rise = disc.light(places_m)
        if not receiver.is_whole:
            bright = bright * disc.is_in_image(places_m, rise, _BESIDE_STEPS * step_m)
        outside_m = (_WAYS.T @ places_m - (_WAYS.T @ outline_m).max(axis=1)[:, None]).max(axis=0)
        half_m = sun_radius_rad * np.maximum(gap_m - 0.5 * disc.side_m * rise, 0.0)
        width_m = max(width_m, 2.0 * float(half_m.max()))
        # A ramp narrower than steps is told by one as wide.
        wide_m = np.maximum(half_m, 0.5 * step_m)
        sunlit = np.clip(0.5 + 0.5 * outside_m / wide_m, 0.0, 1.0)
        lost += cell_m2 * float((bright * (1.0 - sunlit)).sum())
        ramp, more = cell_m2 * half_m / wide_m * bright, (sunlit > 0.5) - sunlit
        ramps += float((ramp * rise * sunlit * (1.0 - sunlit)).sum())
        # Within a pixel, or within a body that is smaller, ramps and hard edges have nearly the same light.
        wide_px = 2.0 * half_m / (footprint_m * min(max(receiver.size_px, 1e-9), 1.0))
        edges += _SPARE * float((ramp * rise * wide_px / (wide_px + _HALF_PX) * more**2).sum())
        gained += float((ramp * more).sum())
    left = max(1.0 - lost / total, 0.0)
    seen = max(left, LEAST_LEFT)
    return Eclipse(left=left, noise=disc.side_m * math.sqrt(ramps) / (seen * total),
                   error=min(max(math.sqrt(area_m2 * edges / seen), _FLUX * abs(gained) / seen) / total, 1.0),
                   width_px=width_m / footprint_m)


class _Disc:
    """A body as the Sun sees it, and what of its light the camera does."""

    def __init__(self, view: BodyView, hull: Hull, camera: PinholeCamera):
        self._view, self._camera, sun_from_body = view, camera, frames.sun_from_body(view.sun_direction_body)
        self.plane = sun_from_body[:2]
        outline_m, heights_m = self.plane @ hull.points_m, sun_from_body[2] @ hull.points_m
        self._from_sun, self._height_m = sun_from_body.T, 0.5 * float(heights_m.min() + heights_m.max())
        self.low_m, self.high_m = outline_m.min(axis=1), outline_m.max(axis=1)
        self.side_m = float((self.high_m - self.low_m).max())
        self._centre_m = 0.5 * (self.low_m + self.high_m)[:, None]
        self._extent_m = (_WAYS.T @ (outline_m - self._centre_m)).max(axis=1)[:, None]
        to_camera = view.r_camera_body_m / max(view.range_m, 1e-300)
        self._aside, self._ahead = self.plane @ to_camera, float(view.sun_direction_body @ to_camera)

    def light(self, places_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Light from places (2, N) [m] of the Sun's plane, over its area there, and cosine of the Sun's height."""
        beside_m = places_m - self._centre_m
        radius = (_WAYS.T @ beside_m / self._extent_m).max(axis=0)
        rise = np.sqrt(np.maximum(1.0 - radius**2, 0.0))
        way = beside_m / np.maximum(np.linalg.norm(beside_m, axis=0), 1e-300)
        bright = np.maximum(radius * (self._aside @ way) + rise * self._ahead, 0.0)
        # Where a crescent is between places the disc tells.
        return (bright + 1e-6) * (radius < 1.0), rise

    def is_in_image(self, places_m: np.ndarray, rise: np.ndarray, beside_m: float) -> np.ndarray:
        """Which places (N,) are in the image, or so far beside it [m]."""
        points_m = self._from_sun @ np.vstack([places_m, self._height_m + 0.5 * self.side_m * rise])
        x, y, depth = self._view.camera_from_body @ (points_m - self._view.r_camera_body_m[:, None])
        ahead = np.maximum(depth, 1e-9 * self.side_m)
        (x0, y0, x1, y1), (cx, cy) = self._camera.bounds_px, self._camera.principal_point_px
        left, top, right, bottom = ((edge - middle) / self._camera.focal_length_px * ahead for edge, middle in zip(
            (x0, y0, x1, y1), (cx, cy, cx, cy), strict=True))
        return ((depth > 0.0) & (x > left - beside_m) & (x < right + beside_m)
                & (y > top - beside_m) & (y < bottom + beside_m))


def _grid(low_m: np.ndarray, high_m: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Places (2, N) [m] within a box, the area of each [m2], and the longer step [m]."""
    step_m = (high_m - low_m) / _PLACES
    x, y = low_m[:, None] + (np.arange(_PLACES) + 0.5) * step_m[:, None]
    return np.stack([axis.ravel() for axis in np.meshgrid(x, y)]), float(step_m.prod()), float(step_m.max())
