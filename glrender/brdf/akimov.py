"""Akimov's law without parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from .curve import Table
from .geometry import Geometry
from .lommel_seeliger import WithPhaseFunction


@dataclass(frozen=True, kw_only=True)
class Akimov(WithPhaseFunction):
    """An extremely rough dark surface, in photometric longitude and latitude: I/F = A f(g) D. ::

        D = cos(g/2) cos(pi/(pi - g) (longitude - g/2)) cos(latitude)^(g/(pi - g)) / cos(longitude)

    Parameters
    ----------
    normal_albedo : float [1], 0..1
        A; D is 1 everywhere at zero phase.
    phase_function : sequence of float or table, optional
        f(g): see `PhaseFunction`; 1 by default.

    Source: Akimov (1988); Shkuratov et al. (2011).
    Twin: shaders/brdf/akimov.glsl, rtol 1e-5.
    """

    normal_albedo: float
    phase_function: Table | tuple[float, ...] | None = None

    glsl: ClassVar[str] = "akimov"

    def __post_init__(self):
        self._check("normal_albedo")

    def lit_brdf(self, geometry: Geometry) -> np.ndarray:
        g = geometry.phase
        low = np.minimum(geometry.cos_incidence, geometry.cos_emission)
        difference = np.sum(geometry.normal * (geometry.to_sun - geometry.to_camera), axis=-1)
        across = np.abs(difference) / np.maximum(geometry.distance, 1e-300)
        along = (geometry.cos_incidence + geometry.cos_emission) / geometry.bisector
        # Longitude from the nearer of limb and terminator: the cosine in D is the sine of this, stretched,
        # and loses nothing where it vanishes.
        to_edge = np.arctan2(low * np.cos(0.5 * g), across + low * np.sin(0.5 * g))
        stretch = np.pi / np.maximum(np.pi - g, 1e-300)
        cos_latitude = np.minimum(np.hypot(across, along), 1.0)
        disk = np.cos(0.5 * g) * np.sin(np.minimum(stretch * to_edge, 0.5 * np.pi)) * cos_latitude**stretch
        return (self.normal_albedo / np.pi * self._phase_function(geometry.phase_deg) * disk
                / (geometry.cos_incidence * geometry.cos_emission))

    def uniforms(self) -> dict[str, Any]:
        return self._uniforms(self.normal_albedo)
