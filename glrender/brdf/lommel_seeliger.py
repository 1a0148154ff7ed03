"""Lommel-Seeliger's law."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from glrender_camera.validate import within

from .curve import PHASE_FIELDS, PhaseFunction, Table
from .geometry import Geometry
from .law import Law


class WithPhaseFunction(Law):
    """A law whose albedo varies with phase; it is a dataclass with a field `phase_function`."""

    phase_function: Table | tuple[float, ...] | None

    def _check(self, *albedos: str) -> None:
        for name in albedos:
            object.__setattr__(self, name, within(name, getattr(self, name), 0.0, 1.0))
        object.__setattr__(self, "phase_function", PhaseFunction(self.phase_function).value)

    @cached_property
    def _phase_function(self) -> PhaseFunction:
        return PhaseFunction(self.phase_function)

    @property
    def max_phase(self) -> float:
        return self._phase_function.max_phase

    def _knots(self) -> np.ndarray:
        return self._phase_function.knots()

    @property
    def uniform_fields(self) -> dict[str, str]:  # type: ignore[override]
        knots = {"law_knots": f"vec4[{len(self._knots())}]"} if len(self._knots()) else {}
        return {"law_albedo": "float", "law_parameter": "float", **PHASE_FIELDS, **knots}

    def defines(self) -> dict[str, int]:
        return self._phase_function.defines()

    def _uniforms(self, albedo: float, parameter: float = 0.0) -> dict:
        knots = {"law_knots": self._knots()} if len(self._knots()) else {}
        return {"law_albedo": albedo, "law_parameter": parameter, **self._phase_function.uniforms(), **knots}


@dataclass(frozen=True, kw_only=True)
class LommelSeeliger(WithPhaseFunction):
    """Single scattering in a dark, porous surface: I/F = w/4 f(g) mu0/(mu0 + mu).

    Parameters
    ----------
    single_scattering_albedo : float [1], 0..1
        Isotropic scattering of this w has geometric albedo w/8.
    phase_function : sequence of float or table, optional
        f(g): see `PhaseFunction`; 1 by default.

    Source: Hapke (2012).
    Twin: shaders/brdf/lommel_seeliger.glsl, rtol 1e-6.
    """

    single_scattering_albedo: float
    phase_function: Table | tuple[float, ...] | None = None

    glsl: ClassVar[str] = "lommel_seeliger"

    def __post_init__(self):
        self._check("single_scattering_albedo")

    def lit_brdf(self, geometry: Geometry) -> np.ndarray:
        return (self.single_scattering_albedo / (4.0 * np.pi) * self._phase_function(geometry.phase_deg)
                / (geometry.cos_incidence + geometry.cos_emission))

    def uniforms(self) -> dict[str, Any]:
        return self._uniforms(self.single_scattering_albedo)
