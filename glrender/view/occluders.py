"""Bodies that may cast shadows on each other, and the width of the penumbra of such a shadow. No side effects."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from ..base import rotations as frames
from ..scene.shape.convex_hull import Hull
from .view import BodyView, between

# Brightness of a sphere's middle at full phase over the mean of its disc by Lambert's law [1]: where a shadow may fall.
_HARD_EDGE = 1.5


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
