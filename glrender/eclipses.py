"""Which bodies cast shadows on which, and what those leave of a body's light. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from glrender_camera import PinholeCamera

from . import frames
from .hull import Hull
from .view import BodyView, between

# Ways by which an outline is told in the Sun's plane, (2, W).
_WAYS = np.array([np.cos(np.arange(32) * np.pi / 16), np.sin(np.arange(32) * np.pi / 16)])
# Places of a body's disc, and of a shadow on it: along a side, and all of them, (2, N) of the box.
_PLACES = 24
_GRID = (np.indices((_PLACES, _PLACES)).reshape(2, -1)[::-1] + 0.5) / _PLACES
SUN_STEPS = ((4, 0.4), (8, 0.25))
"""Points of the Sun's disc in whose light areas are drawn, and what steps of so many leave of a penumbra's error."""
PENUMBRA_SHARE = 0.7
"""Of the budget, what penumbras may cost areas."""
LEAST_LEFT = 0.02
"""Share of a body's light below which what is left is not told apart: hulls and places tell no less."""
# What squared errors of hard edges are told more than places have it; and the width of penumbras [px] of which pixels
# leave half.
_SPARE, _HALF_PX = 1.6, 4.5
# RMS error that is told of as much error of the flux: ten, and what grazing shadows of bodies that are no spheres move.
_FLUX = 15.0
# Of a body's side, how far beside the image a place may be whose penumbra is in it: a body is no sphere.
_BESIDE = 0.1
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
        Of the widest penumbra, or of a narrower body that casts it.
    """

    left: float = 1.0
    noise: float = 0.0
    error: float = 0.0
    width_px: float = 0.0


NO_ECLIPSE = Eclipse()


def sun_steps(error: float, budget: float) -> tuple[int, float] | None:
    """The fewest points of the Sun's disc, and their share, with which a penumbra's error fits; None if none do."""
    return next(((n_points, share) for n_points, share in SUN_STEPS if share * error <= PENUMBRA_SHARE * budget), None)


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
    shadows = [shadow for name, receiver_from_caster in cast
               if (shadow := _Shadow(hulls[name], receiver_from_caster, disc, sun_radius_rad)).is_cast]
    if not shadows:
        return NO_ECLIPSE
    places_m, cell_m2, _ = _grid(disc.low_m, disc.high_m)
    bright, rise = disc.light(places_m)
    total, area_m2 = cell_m2 * float(bright.sum()), cell_m2 * float((bright / np.maximum(rise, _LEAST_RISE)).sum())
    if not receiver.is_whole:
        # Of a body that is much larger than the image no place may be in it.
        in_image = float(bright[disc.beside(places_m, rise) < 0.0].sum() / bright.sum())
        shown = min(camera.width_px * camera.height_px * footprint_m**2 / area_m2, 1.0, in_image or 1.0)
        total, area_m2 = shown * total, shown * area_m2
    lost = ramps = edges = gained = width_m = 0.0
    for index, shadow in enumerate(shadows):
        for is_umbra, (low_m, high_m) in shadow.boxes():
            places_m, cell_m2, step_m = _grid(low_m, high_m)
            bright, rise = disc.light(places_m)
            is_inside = True
            if not receiver.is_whole:
                beside_image = disc.beside(places_m, rise)
                is_inside, bright = beside_image < 0.0, bright * (beside_image < _BESIDE)
            covers = [each.at(places_m, rise, 0.5 * step_m) for each in shadows]
            # What others leave of each place; and those before it, so that what two take counts once.
            before, beside = (math.prod((1.0 - other.taken for other in some), start=np.ones_like(bright))
                              for some in (covers[:index], covers[:index] + covers[index + 1:]))
            own = covers[index]
            light = cell_m2 * bright * (1.0 if is_umbra is None else own.is_dark == is_umbra)
            lost += float((light * is_inside * before * own.taken).sum())
            ramps += float((light * own.share * rise * beside * own.taken * (1.0 - own.taken)).sum())
            # Within a pixel, or within a body that is smaller, ramps and hard edges have nearly the same light.
            wide_px = 2.0 * own.half_m / (footprint_m * min(max(receiver.size_px, 1e-9), 1.0))
            more = light * own.share * beside * (own.taken - own.is_dark)
            edges += _SPARE * float((more * (own.taken - own.is_dark) * rise * wide_px / (wide_px + _HALF_PX)).sum())
            gained += float(more.sum())
            width_m = max(width_m, 2.0 * float((own.narrow_m * (bright > 0.0)).max()))
    left = max(1.0 - lost / total, 0.0)
    seen = max(left, LEAST_LEFT)
    return Eclipse(left=left, noise=disc.side_m * math.sqrt(ramps) / (seen * total),
                   error=min(max(math.sqrt(area_m2 * edges / seen), _FLUX * abs(gained) / seen) / total, 1.0),
                   width_px=width_m / footprint_m)


class _Cover(NamedTuple):
    """What a body takes of places (N,): of the Sun's disc, and of its middle.

    `share` of a ramp narrower than steps, which is told by one as wide, is there; `half_m` is half the width of the
    Sun's disc there [m], `narrow_m` no more than the body's radius.
    """

    taken: np.ndarray
    is_dark: np.ndarray
    share: np.ndarray
    half_m: np.ndarray
    narrow_m: np.ndarray


class _Shadow:
    """Of a body, in the Sun's plane of another; `is_cast` where it may fall on that."""

    def __init__(self, hull: Hull, receiver_from_caster: np.ndarray, disc: _Disc, sun_radius_rad: float):
        self._disc, self._sun_radius_rad = disc, sun_radius_rad
        self._gap_m = max(float(receiver_from_caster[:3, 3] @ disc.sunward), 0.0)
        self._reach_m = sun_radius_rad * self._gap_m
        corners_m = receiver_from_caster[:3, :3] @ hull.extreme_m + receiver_from_caster[:3, 3:]
        outline_m = disc.plane @ corners_m
        self._low_m, self._high_m = outline_m.min(axis=1), outline_m.max(axis=1)
        self._edge_m = (_WAYS.T @ outline_m).max(axis=1)[:, None]
        self._radius_m = 0.25 * float((self._high_m - self._low_m).sum())
        # Of a body that reaches beyond the receiver's middle, all of it is taken to be sunward.
        self.is_cast = (float((disc.sunward @ corners_m).max()) > disc.height_m
                        and bool(np.less(*self._box(self._reach_m)).all()))

    def boxes(self) -> list[tuple[bool | None, tuple[np.ndarray, np.ndarray]]]:
        """Where it is dark by the Sun's middle (True), where it is not, and both where one grid is fine enough."""
        wide = self._box(self._reach_m)
        if self._reach_m <= self._radius_m:
            return [(None, wide)]
        narrow = self._box(0.0)
        return [(False, wide), *([(True, narrow)] if np.less(*narrow).all() else [])]

    def _box(self, reach_m: float) -> tuple[np.ndarray, np.ndarray]:
        return (np.maximum(self._low_m - reach_m, self._disc.low_m),
                np.minimum(self._high_m + reach_m, self._disc.high_m))

    def at(self, places_m: np.ndarray, rise: np.ndarray, least_m: float) -> _Cover:
        """Of places (2, N) [m], with the cosines of the Sun's height there; ramps are at least so wide."""
        outside_m = (_WAYS.T @ places_m - self._edge_m).max(axis=0)
        half_m = self._sun_radius_rad * np.maximum(self._gap_m - 0.5 * self._disc.side_m * rise, 0.0)
        # A body narrower than the Sun's disc takes as much as it covers, all over a disc as wide.
        narrow_m = np.minimum(half_m, self._radius_m)
        wide_m = np.maximum(narrow_m, least_m)
        ramp = np.clip(0.5 - 0.5 * (outside_m - (half_m - narrow_m)) / wide_m, 0.0, 1.0)
        depth = np.where(half_m > 0.0, narrow_m / np.maximum(half_m, 1e-300), 1.0) ** 2
        return _Cover(taken=depth * ramp, is_dark=outside_m < 0.0, half_m=half_m, narrow_m=narrow_m,
                      share=np.where((ramp > 0.0) & (ramp < 1.0), narrow_m / wide_m, 1.0))


class _Disc:
    """A body as the Sun sees it, and what of its light the camera does."""

    def __init__(self, view: BodyView, hull: Hull, camera: PinholeCamera):
        self._view, self._camera, sun_from_body = view, camera, frames.sun_from_body(view.sun_direction_body)
        self.plane, self.sunward = sun_from_body[:2], sun_from_body[2]
        outline_m, heights_m = self.plane @ hull.extreme_m, self.sunward @ hull.extreme_m
        self._from_sun, self.height_m = sun_from_body.T, 0.5 * float(heights_m.min() + heights_m.max())
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

    def beside(self, places_m: np.ndarray, rise: np.ndarray) -> np.ndarray:
        """How far beside the image places (N,) are, in sides of the body: below 0 within, inf behind the camera."""
        points_m = self._from_sun @ np.vstack([places_m, self.height_m + 0.5 * self.side_m * rise])
        x, y, depth = self._view.camera_from_body @ (points_m - self._view.r_camera_body_m[:, None])
        ahead = np.maximum(depth, 1e-9 * self.side_m)
        (x0, y0, x1, y1), (cx, cy) = self._camera.bounds_px, self._camera.principal_point_px
        left, top, right, bottom = ((edge - middle) / self._camera.focal_length_px * ahead for edge, middle in zip(
            (x0, y0, x1, y1), (cx, cy, cx, cy), strict=True))
        return np.where(depth > 0.0, np.max([left - x, x - right, top - y, y - bottom], axis=0) / self.side_m, np.inf)


def _grid(low_m: np.ndarray, high_m: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Places (2, N) [m] within a box, the area of each [m2], and the longer step [m]."""
    side_m = high_m - low_m
    return low_m[:, None] + _GRID * side_m[:, None], float(side_m.prod()) / _PLACES**2, float(side_m.max()) / _PLACES
