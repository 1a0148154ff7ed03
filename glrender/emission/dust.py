"""From dust to light: cross-section, albedo and phase function give radiance.

A coma is described by its weight K = k r^2 [m]: k [1/m] is the geometric cross-section of dust in a unit of
volume, r the distance from the body's origin. K is what varies slowly: it is constant in a coma that flows
out evenly. The radiance of an optically thin column is

    L = p phi(phase) / pi * F_sun * integral k ds          [W m^-2 sr^-1]

p the grains' geometric albedo and phi their phase function, 1 at zero phase.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from glrender_camera.validate import positive, within

from ..base.errors import ConfigError
from .phase_function import HenyeyGreenstein, PhaseFunction

# Least efficiency q: below it float32 has (1 - exp(-q N)) / q as 0 / 0.
_LEAST_EFFICIENCY = 1e-6


@dataclass(frozen=True, kw_only=True)
class Dust:
    """Dust grains scatter light by this size, albedo and phase function.

    Parameters
    ----------
    geometric_albedo : float [1], > 0 and <= 1
    phase_function : PhaseFunction
    extinction_efficiency : float [1], 0 or 1e-6..4
        Light taken out of a beam over geometric cross-section; 2 for grains larger than the wavelength.
        0 leaves extinction out.
    """

    geometric_albedo: float = 0.05
    phase_function: PhaseFunction = field(default_factory=HenyeyGreenstein)
    extinction_efficiency: float = 0.0

    def __post_init__(self):
        albedo = positive("geometric_albedo", self.geometric_albedo)
        object.__setattr__(self, "geometric_albedo", within("geometric_albedo", albedo, 0.0, 1.0))
        efficiency = within("extinction_efficiency", self.extinction_efficiency, 0.0, 4.0)
        if 0.0 < efficiency < _LEAST_EFFICIENCY:
            raise ConfigError("extinction_efficiency", f"must be 0 or at least {_LEAST_EFFICIENCY:g}", efficiency)
        object.__setattr__(self, "extinction_efficiency", efficiency)
        if not isinstance(self.phase_function, PhaseFunction):
            raise ConfigError("phase_function", "must be a phase function", self.phase_function)

    def radiance_per_column(self, phase_rad: np.ndarray) -> np.ndarray:
        """Radiance [1/sr] of a column of 1, over the solar irradiance."""
        return self.geometric_albedo / math.pi * self.phase_function(phase_rad)

    def weight_m(self, afrho_m: float) -> float:
        """Mean of K [m] over directions of a coma whose A(0) f rho, at zero phase, is `afrho_m` [m].

        Source: A'Hearn et al. (1984), A = 4 p phi(phase); k = K / r^2 has a column of pi K / rho, the
        columns within rho cover f = 2 pi K / rho of the aperture, so A f rho = 8 pi p K.
        """
        return afrho_m / (8.0 * math.pi * self.geometric_albedo)

    def thin(self, column: np.ndarray) -> np.ndarray:
        """The column that is seen of one [1], where the grains hide each other.

        Source and absorber are the same grains: integral k exp(-q tau) ds = (1 - exp(-q column)) / q.
        """
        q = self.extinction_efficiency
        return column if q == 0.0 else -np.expm1(-q * column) / q

    def transmission(self, column: np.ndarray) -> np.ndarray:
        """Share of the light from behind a column [1] that passes."""
        return np.exp(-self.extinction_efficiency * column)
