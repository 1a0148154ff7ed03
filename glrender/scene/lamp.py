"""Lamps that are fixed to the spacecraft."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from glrender_camera.validate import name_of, position, vector, within

from ..base.errors import ConfigError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

_ORIGIN: Any = (0.0, 0.0, 0.0)
_AHEAD: Any = (0.0, 0.0, 1.0)
ALL_ROUND_DEG, _WIDEST_CONE_DEG = 180.0, 90.0
_MOST_W_SR = 1e12
FAINT = 1e-4
"""Light over the brightest [1] below which its samples may all be off: a twentieth of the flux that 2 % allow."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Lamp:
    """A lamp is a point on the spacecraft that shines into a cone with a hard edge, or all round.

    Parameters
    ----------
    name : str
    intensity_W_sr : float [W/sr], 0..1e12
        In the band of the camera.
    r_spacecraft_m : (3,) float [m]
    direction : (3,) float
        Middle of the cone, in the spacecraft's axes: of any length but zero.
    half_angle_deg : float [deg], > 0..90, or 180
        Of the cone; 180 is all round.
    """

    name: str
    intensity_W_sr: float
    r_spacecraft_m: np.ndarray = field(default=_ORIGIN)
    direction: np.ndarray = field(default=_AHEAD)
    half_angle_deg: float = ALL_ROUND_DEG

    if TYPE_CHECKING:  # lists of numbers go in, arrays come out
        def __init__(self, *, name: str, intensity_W_sr: float, r_spacecraft_m: ArrayLike = ...,
                     direction: ArrayLike = ..., half_angle_deg: float = ...) -> None: ...

    def __post_init__(self):
        name_of("name", self.name)
        set_ = object.__setattr__
        set_(self, "intensity_W_sr", within("intensity_W_sr", self.intensity_W_sr, 0.0, _MOST_W_SR))
        set_(self, "r_spacecraft_m", position("r_spacecraft_m", self.r_spacecraft_m))
        direction = vector("direction", self.direction)
        if not direction.any():
            raise ConfigError("direction", "must not be zero", self.direction, "[0, 0, 1] is the spacecraft's +Z")
        set_(self, "direction", direction / np.linalg.norm(direction))
        half_angle_deg = within("half_angle_deg", self.half_angle_deg, 0.0, ALL_ROUND_DEG)
        if not 0.0 < half_angle_deg <= _WIDEST_CONE_DEG and half_angle_deg != ALL_ROUND_DEG:
            raise ConfigError("half_angle_deg", "must be within 0 to 90, or 180 for all round", self.half_angle_deg)
        set_(self, "half_angle_deg", half_angle_deg)

    @property
    def least_cosine(self) -> float:
        """Cosine of the cone's half angle; -1 all round."""
        return math.cos(math.radians(self.half_angle_deg))
