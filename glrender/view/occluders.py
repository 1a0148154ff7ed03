"""Bodies that may cast shadows on each other. No side effects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..scene.shape.convex_hull import Hull
from .view import BodyView, between


def casters(receiver: BodyView, views: Sequence[BodyView], hulls: Mapping[str, Hull],
            sun_radius_rad: float = 0.0) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Other bodies whose shadow may fall on the receiver: name, rotation (3, 3) and shift (3,) [m] to its frame."""
    found, radius_m = [], hulls[receiver.name].radius_m
    for other in views:
        if other.name == receiver.name:
            continue
        rotation, offset_m = between(other, receiver)
        sunward_m = float(offset_m @ receiver.sun_direction_body)
        aside_m = float(np.linalg.norm(offset_m - sunward_m * receiver.sun_direction_body))
        reach_m = radius_m + hulls[other.name].radius_m
        if aside_m < reach_m + sun_radius_rad * max(sunward_m, 0.0) and sunward_m > -reach_m:
            found.append((other.name, rotation, offset_m))
    return found
