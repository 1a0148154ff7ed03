"""The ROLO law of the Moon."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ..base.errors import ConfigError
from .curve import MAX_FACTOR, SAMPLED_DEG, bounded, polynomial, table_or_terms, vec4_pair
from .geometry import Geometry
from .law import Law


@dataclass(frozen=True, kw_only=True)
class Rolo(Law):
    """Lommel-Seeliger with an empirical phase function: I/F = mu0/(mu0 + mu) A(g). ::

        A(g) = C0 exp(-C1 g) + A0 + A1 g + A2 g^2 + A3 g^3 + A4 g^4,  g in degrees

    Parameters
    ----------
    surge : (2,) float [1], [1/deg]
        C0 and C1 >= 0.
    coefficients : (1..5) float [1/deg^n]
        A0, A1, ...; A(g) must stay within ±1e6. Some authors tabulate 1/pi of these: check
        I/F(0, 0, 0) = (C0 + A0) / 2.

    Source: Hillier et al. (1999), Buratti et al. (2011).
    Twin: shaders/brdf/rolo.glsl, rtol 1e-5.
    """

    surge: tuple[float, float]
    coefficients: tuple[float, ...]

    glsl: ClassVar[str] = "rolo"
    uniform_fields: ClassVar[dict[str, str]] = {"law_surge": "vec2", "law_terms_low": "vec4",
                                                "law_terms_high": "vec4"}

    def __post_init__(self):
        for name, rule, allowed in (("surge", "must be 2 numbers, the second >= 0", (2,)),
                                    ("coefficients", "must be 1 to 5 numbers", range(1, 6))):
            terms = table_or_terms(name, getattr(self, name))
            if not isinstance(terms, tuple) or len(terms) not in allowed:
                raise ConfigError(name, rule, getattr(self, name))
            object.__setattr__(self, name, terms)
        if not self.surge[1] >= 0.0:
            raise ConfigError("surge", "must be 2 numbers, the second >= 0", self.surge)
        bounded("coefficients", self._curve(SAMPLED_DEG), MAX_FACTOR)

    def _curve(self, phase_deg: np.ndarray) -> np.ndarray:
        return self.surge[0] * np.exp(-self.surge[1] * phase_deg) + polynomial(self.coefficients, phase_deg)

    def lit_brdf(self, geometry: Geometry) -> np.ndarray:
        return self._curve(geometry.phase_deg) / (np.pi * (geometry.cos_incidence + geometry.cos_emission))

    def uniforms(self) -> dict[str, Any]:
        return {"law_surge": (self.surge[0], -self.surge[1] * np.log2(np.e)),
                **vec4_pair("law_terms", self.coefficients)}
