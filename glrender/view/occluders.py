"""Bodies that may cast shadows on each other. No side effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..scene.shape.convex_hull import Hull
from .view import BodyView, between


class Caster(NamedTuple):
    """A body whose shadow may fall on another one, the receiver, and how it stands in the receiver's frame."""

    name: str
    rotation: np.ndarray
    """(3, 3) from its own frame."""
    shift_m: np.ndarray
    """(3,) [m] of its origin."""


def casters(receiver: BodyView, views: Sequence[BodyView], hulls: Mapping[str, Hull],
            sun_radius_rad: float = 0.0) -> list[Caster]:
    """Other bodies whose shadow may fall on the receiver."""
    found, radius_m = [], hulls[receiver.name].radius_m
    for other in views:
        if other.name == receiver.name:
            continue
        rotation, shift_m = between(other, receiver)
        sunward_m = float(shift_m @ receiver.sun_direction_body)
        aside_m = float(np.linalg.norm(shift_m - sunward_m * receiver.sun_direction_body))
        reach_m = radius_m + hulls[other.name].radius_m
        if aside_m < reach_m + sun_radius_rad * max(sunward_m, 0.0) and sunward_m > -reach_m:
            found.append(Caster(other.name, rotation, shift_m))
    return found
