"""Minnaert's law."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from glrender_camera.validate import finite

from .curve import Table
from .lommel_seeliger import WithPhaseFunction

MIN_COSINES = 1e-6
"""Floor of cos(incidence) cos(emission): an exponent below 1 is infinite at the limb and the terminator,
float32 is not. It acts within 0.06 deg of either (and there where both are within 3 deg)."""


@dataclass(frozen=True, kw_only=True)
class Minnaert(WithPhaseFunction):
    """A power law: I/F = A f(g) mu0^k mu^(k - 1), k = exponent + exponent_per_deg g.

    Parameters
    ----------
    normal_albedo : float [1], 0..1
        A.
    exponent : float [1]
        k at zero phase: 1 is Lambert's law, 0.5 a dark body's flat disc at full phase.
    exponent_per_deg : float [1/deg]
    phase_function : sequence of float or table, optional
        f(g): see `PhaseFunction`; 1 by default.

    Source: Minnaert (1941); photometry.md section 1.2.
    Twin: shaders/brdf/minnaert.glsl, rtol 1e-5.
    """

    normal_albedo: float
    exponent: float
    exponent_per_deg: float = 0.0
    phase_function: Table | tuple[float, ...] | None = None

    glsl: ClassVar[str] = "minnaert"

    def __post_init__(self):
        self._check("normal_albedo")
        for name in ("exponent", "exponent_per_deg"):
            object.__setattr__(self, name, finite(name, getattr(self, name)))

    def lit_brdf(self, geometry):
        phase_deg = geometry.phase_deg
        cosines = np.maximum(geometry.cos_incidence * geometry.cos_emission, MIN_COSINES)
        power = self.exponent - 1.0 + self.exponent_per_deg * phase_deg
        return self.normal_albedo / np.pi * self._phase_function(phase_deg) * cosines**power

    @property
    def uniform_fields(self):
        return {**super().uniform_fields, "law_exponent": "vec2"}

    def uniforms(self):
        return {**self._uniforms(self.normal_albedo, MIN_COSINES),
                "law_exponent": (self.exponent - 1.0, self.exponent_per_deg)}
