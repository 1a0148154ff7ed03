"""Bodies that may cast shadows on each other, and the width of the penumbra of such a shadow. No side effects."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..base import rotations as frames
from ..base.rotations import sun_from_body
from ..scene.shape.convex_hull import Hull
from .sun_disc import on_disc
from .view import BodyView, between

# Brightness of a sphere's middle at full phase over the mean of its disc by Lambert's law [1]: where a shadow may fall.
_HARD_EDGE = 1.5
# Points of the lit part of a sphere's image in which an eclipse is looked at, and half the distance of neighbours over
# its radius [1] at full phase.
_POINTS = 400
_POINT = 0.5 * math.sqrt(math.pi / _POINTS)
# How far a shadow may be from where a sphere's is, towards its light, over its radius [1]: bodies are no spheres.
_ASIDE = (0.0, -0.3, 0.3)


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


def cast_penumbra(receiver: BodyView, cast: Sequence[tuple[str, np.ndarray]], hulls: Mapping[str, Hull],
                  footprint_m: float, sun_radius_rad: float) -> tuple[float, float]:
    """RMS error [1] of hard edges in place of the casters' penumbras, over the mean of the lit pixels; widest [px].

    Each edge is taken to be as long as the outline of the smaller body, and the receiver to be lit as a sphere is.

    Parameters
    ----------
    receiver : BodyView
    cast : sequence of (str, (4, 4) array)
        From `casters`.
    hulls : mapping of str to Hull
    footprint_m : float [m]
        Side of a pixel at the receiver.
    sun_radius_rad : float [rad]
        Angular radius of the Sun; 0 for a point.
    """
    squared = widest_px = 0.0
    radius_px = hulls[receiver.name].radius_m / footprint_m
    for name, receiver_from_caster in cast:
        sunward_m = max(float(receiver_from_caster[:3, 3] @ receiver.sun_direction_body), 0.0)
        caster_px = hulls[name].radius_m / footprint_m
        wide_px = min(2.0 * sun_radius_rad * sunward_m / footprint_m, 2.0 * max(caster_px, 1e-9))
        edge_px = 2.0 * math.pi * min(caster_px, radius_px)
        squared += _HARD_EDGE**2 * edge_px * wide_px * min(wide_px, 1.0) ** 2 / 12.0
        widest_px = max(widest_px, wide_px)
    lit_px = 0.5 * math.pi * radius_px**2 * (1.0 + math.cos(receiver.phase_rad))
    return min(math.sqrt(squared / max(lit_px, 1e-9)), 1.0), widest_px


@dataclass(frozen=True, kw_only=True)
class Eclipse:
    """The effect of other bodies' penumbras on a body's light, all being spheres.

    Attributes
    ----------
    left : float [1]
        Share of the light in view that they leave.
    hard_flux : float [1]
        Error of the total light with hard edges of shadows in place of penumbras.
    width_m : float [m]
        Of the widest: the Sun's angle times the distance, however small the body that casts it.
    """

    left: float = 1.0
    hard_flux: float = 0.0
    width_m: float = 0.0


NO_ECLIPSE = Eclipse()


def eclipse(receiver: BodyView, cast: Sequence[tuple[str, np.ndarray]], hulls: Mapping[str, Hull],
            sun_radius_rad: float) -> Eclipse:
    """The eclipse of a body by casters: arguments as of `cast_penumbra`. The receiver is as bright as Lambert's sphere.

    Hard edges err where a penumbra ends beside the part that is seen and lit, and where that is not evenly bright.
    """
    if not cast:
        return NO_ECLIPSE
    hull, sun = hulls[receiver.name], receiver.sun_direction_body
    point_m, light = _lit_points(receiver, hull.radius_m)
    edge_m = hull.radius_m * max(_POINT * math.cos(0.5 * receiver.phase_rad), 1.0 / _POINTS)
    (soft, hard), width_m = np.ones((2, len(_ASIDE), len(light))), 0.0
    for name, receiver_from_caster in cast:
        offset_m, caster_m = receiver_from_caster[:3, 3], hulls[name].radius_m
        to_caster_m = offset_m - point_m
        sunward_m = np.maximum(to_caster_m @ sun, 0.0)
        aside_m = to_caster_m - np.outer(to_caster_m @ sun, sun)
        to_light = light @ aside_m
        moved_m = np.multiply.outer(_ASIDE, hull.radius_m * to_light / max(np.linalg.norm(to_light), 1e-300))
        apart_m = np.linalg.norm(aside_m + moved_m[:, None], axis=-1)
        half_m = np.maximum(sun_radius_rad * sunward_m, 1e-9 * caster_m)
        is_shaded = sunward_m > 0.0
        for left, disc_m in ((soft, half_m), (hard, np.minimum(half_m, edge_m))):
            left *= 1.0 - is_shaded * shared_area(caster_m, disc_m, apart_m) / (math.pi * disc_m**2)
        width_m = max(width_m, 2.0 * float(half_m.max()))
    total = float(light.sum())
    if not total > 0.0:
        return Eclipse(width_m=width_m)
    soft, hard = soft @ light / total, hard @ light / total
    return Eclipse(left=float(soft[0]), hard_flux=float(np.max(np.abs(soft - hard) / np.maximum(soft, 1e-3))),
                   width_m=width_m)


def _lit_points(receiver: BodyView, radius_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) [m] of a sphere that camera and Sun see, evenly in the image, and their light (N,) [1]."""
    x, y = on_disc(_POINTS).T
    camera_from_body = sun_from_body(receiver.r_camera_body_m / receiver.range_m)
    sun = camera_from_body @ receiver.sun_direction_body
    # From the terminator to the limb, the Sun being towards x.
    x = 0.5 * ((1.0 + sun[2]) * x + (1.0 - sun[2]) * np.sqrt(np.maximum(1.0 - y**2, 0.0)))
    length = math.hypot(sun[0], sun[1])
    towards_x, towards_y = sun[:2] / length if length > 0.0 else (1.0, 0.0)
    normal = np.stack([towards_x * x - towards_y * y, towards_y * x + towards_x * y,
                       np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0))], axis=-1)
    return radius_m * normal @ camera_from_body, np.maximum(normal @ sun, 0.0)


def shared_area(one: float, other: np.ndarray | float, apart: np.ndarray) -> np.ndarray:
    """Area that two discs share, by their radii and the distances (...) of their middles: closed form, in squares."""
    small, gap = np.minimum(one, other), np.abs(one - other)
    # Circles that touch from within or without are those that are nearest and farthest.
    d = np.clip(apart, np.maximum(gap, 1e-12 * small), one + other)
    triangle = (one + other - d) * (d + one - other) * (d - one + other) * (one + other + d)
    root = np.sqrt(np.maximum(triangle, 0.0))
    # An arc cosine is good to 1e-8 rad, which is more than all of a small disc by the edge of a large one.
    angle_one, angle_other = (np.arctan2(root, (d - b) * (d + b) + a**2) for a, b in ((one, other), (other, one)))
    shared = one**2 * angle_one + other**2 * angle_other - 0.5 * root
    return np.where(apart <= gap, math.pi * small**2, shared)
