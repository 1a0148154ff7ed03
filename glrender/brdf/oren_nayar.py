"""Oren and Nayar's law."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from glrender_camera.validate import finite, within

from ..base.errors import ConfigError
from .geometry import Geometry
from .law import Law


@dataclass(frozen=True, kw_only=True)
class OrenNayar(Law):
    """Lambertian V-grooves: bright surfaces that are rough. The qualitative model. ::

        f = A/pi [a + b max(0, cos(azimuth)) sin(larger angle) tan(smaller angle)]
        a = 1 - s^2/2/(s^2 + 0.33),  b = 0.45 s^2/(s^2 + 0.09),  s in radians

    Parameters
    ----------
    normal_albedo : float [1], 0..1
        Albedo of the grooves' sides; the surface's own is `a` times that.
    roughness_deg : float [deg], 0 <= roughness < 90
        Standard deviation of the slopes; 0 is Lambert's law.

    Source: Oren and Nayar (1994).
    Twin: shaders/brdf/oren_nayar.glsl, rtol 1e-6.
    """

    normal_albedo: float
    roughness_deg: float

    glsl: ClassVar[str] = "oren_nayar"
    uniform_fields: ClassVar[dict[str, str]] = {"law_albedo": "float", "law_roughness": "vec2"}

    def __post_init__(self):
        object.__setattr__(self, "normal_albedo", within("normal_albedo", self.normal_albedo, 0.0, 1.0))
        object.__setattr__(self, "roughness_deg", finite("roughness_deg", self.roughness_deg))
        if not 0.0 <= self.roughness_deg < 90.0:
            raise ConfigError("roughness_deg", "must be >= 0 and < 90", self.roughness_deg)

    @property
    def _factors(self) -> tuple[float, float]:
        s2 = np.radians(self.roughness_deg) ** 2
        return 1.0 - 0.5 * s2 / (s2 + 0.33), 0.45 * s2 / (s2 + 0.09)

    def lit_brdf(self, geometry: Geometry) -> np.ndarray:
        constant, slope = self._factors
        # sin i sin e cos(azimuth) over the larger cosine: neither azimuth nor tangent is ever formed.
        aligned = np.maximum(np.sum(geometry.sun_side * geometry.camera_side, axis=-1), 0.0)
        groove = aligned / np.maximum(geometry.cos_incidence, geometry.cos_emission)
        return self.normal_albedo / np.pi * (constant + slope * groove)

    def uniforms(self) -> dict[str, Any]:
        return {"law_albedo": self.normal_albedo, "law_roughness": self._factors}
