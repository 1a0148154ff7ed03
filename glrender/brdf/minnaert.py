"""Minnaert's law."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from glrender_camera.validate import within

from .curve import Table
from .geometry import Geometry
from .lommel_seeliger import WithPhaseFunction


@dataclass(frozen=True, kw_only=True)
class Minnaert(WithPhaseFunction):
    """A power law: I/F = A f(g) mu0^k mu^(k - 1), k = exponent + exponent_per_deg g.

    Parameters
    ----------
    normal_albedo : float [1], 0..1
        A.
    exponent : float [1], 0..2
        k at zero phase: 1 is Lambert's law, 0.5 a dark body's flat disc at full phase. Below 1 the
        radiance grows without bound towards the limb; the cosines are held at 1e-6.
    exponent_per_deg : float [1/deg], -0.01..0.01
    phase_function : sequence of float or table, optional
        f(g): see `PhaseFunction`; 1 by default.

    Source: Minnaert (1941).
    Twin: shaders/brdf/minnaert.glsl, rtol 1e-5.
    """

    normal_albedo: float
    exponent: float
    exponent_per_deg: float = 0.0
    phase_function: Table | tuple[float, ...] | None = None

    glsl: ClassVar[str] = "minnaert"

    def __post_init__(self):
        self._check("normal_albedo")
        object.__setattr__(self, "exponent", within("exponent", self.exponent, 0.0, 2.0))
        object.__setattr__(self, "exponent_per_deg",
                           within("exponent_per_deg", self.exponent_per_deg, -0.01, 0.01))

    def lit_brdf(self, geometry: Geometry) -> np.ndarray:
        phase_deg = geometry.phase_deg
        cosines = geometry.cos_incidence * geometry.cos_emission
        power = self.exponent - 1.0 + self.exponent_per_deg * phase_deg
        return self.normal_albedo / np.pi * self._phase_function(phase_deg) * cosines**power

    @property
    def uniform_fields(self) -> dict[str, str]:  # type: ignore[override]
        return {**super().uniform_fields, "law_exponent": "vec2"}

    def uniforms(self) -> dict[str, Any]:
        return {**self._uniforms(self.normal_albedo),
                "law_exponent": (self.exponent - 1.0, self.exponent_per_deg)}
