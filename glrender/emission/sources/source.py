"""Every source of dust around a nucleus gives weights K = k r^2 that add up, each times its activity."""

from __future__ import annotations

import math
from typing import Protocol, runtime_checkable

import numpy as np

from ..fields import CartesianField


class Source(Protocol):
    """Dust that leaves a body, as a sum of components whose strengths follow the Sun.

    Attributes
    ----------
    feature_rad : float [rad]
        Smallest angle over which K changes; infinite for a source that is the same in all directions.
    reach_m : float [m]
        Distance beyond which there is none.
    most_directions : int
        Directions along a side of the octahedral map that are worth their time, at most.
    """

    feature_rad: float
    reach_m: float
    most_directions: int

    def components(self, r_m: np.ndarray) -> np.ndarray:
        """K (C, N) [m] of each component, fully active, at points (N, 3) [m], body-fixed."""

    def activity(self, sun_direction_body: np.ndarray) -> np.ndarray:
        """Activity (C,) [1] of the components."""


@runtime_checkable
class OwnField(Protocol):
    """Dust that has a field of its own, whose axes need not be the body's."""

    def field(self, least_m: float) -> CartesianField:
        """The field, and `least_m` the least distance [m] from the body's middle at which it is asked for."""

    def field_from_body(self, body_from_inertial: np.ndarray, sun_direction_body: np.ndarray) -> np.ndarray:
        """(3, 3) float64 rotation from the body's axes into the field's."""


EVERYWHERE = math.inf
"""The reach of a source without an end."""
