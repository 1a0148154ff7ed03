"""The Lunar-Lambert law."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from ..base.errors import ConfigError
from .curve import SAMPLED_DEG, Table, bounded, polynomial, table_or_terms, vec4_pair
from .geometry import Geometry
from .lommel_seeliger import WithPhaseFunction

MCEWEN = (1.0, -0.019, 2.42e-4, -1.46e-6)
"""L(g) of the Moon in powers of g [deg]; McEwen (1991, 1996)."""
GASKELL_DEG = 60.0
"""L(g) = exp(-g / 60 deg) of Gaskell's stereophotoclinometry."""
MAX_WEIGHT = 1e3
"""|L(g)| beyond this is a mistake."""
MIN_WEIGHT = -0.05
"""A polynomial is held from the phase at which it falls through this: the best weights of Hapke bodies
stay above it at all phases, and McEwen's cubic, let go, makes a whole
sphere negative beyond 132.67 deg."""


@dataclass(frozen=True, kw_only=True)
class LunarLambert(WithPhaseFunction):
    """A blend of Lommel-Seeliger and Lambert: I/F = A f(g) [2 L mu0/(mu0 + mu) + (1 - L) mu0].

    The factor 2 makes I/F(0, 0, 0) = A whatever L is; with L = 0 the law is Lambert's.

    Parameters
    ----------
    normal_albedo : float [1], 0..1
        A.
    weight : "mcewen", "gaskell", sequence of float, or table
        L(g): coefficients in powers of g in DEGREES, constant first, at most 8; or a table of
        `phase_deg` and `value`. A polynomial is held from where it falls through -0.05, a table
        beyond its ends. L must stay within ±1e3.
    phase_function : sequence of float or table, optional
        f(g): see `PhaseFunction`; 1 by default.

    Source: McEwen (1991).
    Twin: shaders/brdf/lunar_lambert.glsl, rtol 1e-5.
    """

    normal_albedo: float
    weight: str | Table | tuple[float, ...] = "mcewen"
    phase_function: Table | tuple[float, ...] | None = None

    glsl: ClassVar[str] = "lunar_lambert"

    def __post_init__(self):
        self._check("normal_albedo")
        if isinstance(self.weight, str):
            if self.weight not in ("mcewen", "gaskell"):
                raise ConfigError("weight", "must be 'mcewen', 'gaskell', coefficients or a table",
                                  self.weight)
            return
        object.__setattr__(self, "weight", table_or_terms("weight", self.weight))
        if not self._is_table and not self.weight:
            raise ConfigError("weight", "must be one coefficient or more", self.weight)
        bounded("weight", self.weight_at(SAMPLED_DEG), MAX_WEIGHT)
        if not self._is_table and len(self.weight) > 1 and self.weight[0] < 0.3:
            warnings.warn(f"LunarLambert.weight starts with {self.weight[0]:g}: is the constant term, "
                          "usually 1, missing?", stacklevel=3)

    @property
    def _is_table(self) -> bool:
        return isinstance(self.weight, Table)

    @property
    def _terms(self) -> tuple[float, ...]:
        """Polynomial of L, or of its natural logarithm for Gaskell's."""
        if self.weight == "gaskell":
            return (0.0, -1.0 / GASKELL_DEG)
        return MCEWEN if self.weight == "mcewen" else () if self._is_table else self.weight

    @cached_property
    def _held_deg(self) -> float:
        """Phase angle from which a polynomial weight is held [deg]."""
        if self._is_table or self.weight == "gaskell":
            return 180.0
        phase = np.linspace(0.0, 180.0, 18001)
        below = polynomial(self._terms, phase) < MIN_WEIGHT
        if not below.any():
            return 180.0
        first = int(np.argmax(below))
        if first == 0:
            return 0.0
        low, high = phase[first - 1], phase[first]
        for _ in range(60):
            middle = 0.5 * (low + high)
            if polynomial(self._terms, np.float64(middle)) < MIN_WEIGHT:
                high = middle
            else:
                low = middle
        return float(low)

    @property
    def max_phase(self) -> float:
        weight = self.weight.max_phase if self._is_table else math.radians(self._held_deg)
        return min(super().max_phase, weight)

    def weight_at(self, phase_deg: np.ndarray) -> np.ndarray:
        """L [1] at phase angles [deg]."""
        if self._is_table:
            return np.interp(phase_deg, self.weight.phase_deg, self.weight.value)
        value = polynomial(self._terms, np.minimum(phase_deg, self._held_deg))
        return np.exp(value) if self.weight == "gaskell" else value

    def lit_brdf(self, geometry: Geometry) -> np.ndarray:
        phase_deg = geometry.phase_deg
        weight = self.weight_at(phase_deg)
        blend = 2.0 * weight / (geometry.cos_incidence + geometry.cos_emission) + 1.0 - weight
        return self.normal_albedo / np.pi * self._phase_function(phase_deg) * blend

    def _knots(self):
        own = self.weight.knots(np.array(self.weight.value)) if self._is_table else np.empty((0, 4))
        return np.concatenate([super()._knots(), own])

    @property
    def uniform_fields(self) -> dict[str, str]:  # type: ignore[override]
        return {**super().uniform_fields, "law_weight_low": "vec4", "law_weight_high": "vec4"}

    def defines(self) -> dict[str, int]:
        return {**super().defines(), "LAW_WEIGHT_KNOTS": len(self.weight.value) if self._is_table else 0,
                "LAW_WEIGHT_EXPONENTIAL": int(self.weight == "gaskell")}

    def uniforms(self) -> dict[str, Any]:
        scale = math.log2(math.e) if self.weight == "gaskell" else 1.0
        return {**self._uniforms(self.normal_albedo, self._held_deg),
                **vec4_pair("law_weight", [scale * term for term in self._terms])}
