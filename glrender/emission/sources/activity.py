"""The activity of a place on the surface, by its local time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from glrender_camera.validate import within


@dataclass(frozen=True, kw_only=True)
class Activity:
    """night + (1 - night) max(cos(incidence), 0)^exponent, the Sun as it stood a little earlier.

    Parameters
    ----------
    exponent : float [1], 0..10
        0 is the same all day.
    night : float [1], 0..1
        Activity at night over that at noon; 1 is the same day and night.
    lag_deg : float [deg], -180..180
        By which the body turned, about its +Z axis, between sunlight and activity.
    """

    exponent: float = 1.0
    night: float = 0.0
    lag_deg: float = 0.0

    def __post_init__(self):
        within("exponent", self.exponent, 0.0, 10.0)
        within("night", self.night, 0.0, 1.0)
        within("lag_deg", self.lag_deg, -180.0, 180.0)

    def __call__(self, normals: np.ndarray, sun_direction_body: np.ndarray) -> np.ndarray:
        """Activity (C,) [1] of places with outward normals (C, 3)."""
        # The body turns east: of what the Sun saw earlier, it now stands to the east.
        angle = np.radians(self.lag_deg)
        c, s = np.cos(angle), np.sin(angle)
        earlier = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ sun_direction_body
        cos_incidence = normals @ earlier
        day = np.where(cos_incidence > 0.0, np.maximum(cos_incidence, 0.0) ** self.exponent, 0.0)
        return self.night + (1.0 - self.night) * day
