"""Lambert's law."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from glrender_camera.validate import within

from .geometry import Geometry
from .law import Law


@dataclass(frozen=True, kw_only=True)
class Lambert(Law):
    """The same radiance in every direction: I/F = normal_albedo * cos(incidence).

    Parameters
    ----------
    normal_albedo : float [1], 0..1
        I/F at incidence = emission = phase = 0.

    Source: Hapke (2012); geometric albedo 2/3 of the normal albedo.
    Twin: shaders/brdf/lambert.glsl, rtol 1e-6.
    """

    normal_albedo: float

    glsl: ClassVar[str] = "lambert"
    uniform_fields: ClassVar[dict[str, str]] = {"law_normal_albedo": "float"}

    def __post_init__(self):
        object.__setattr__(self, "normal_albedo", within("normal_albedo", self.normal_albedo, 0.0, 1.0))

    def lit_brdf(self, geometry: Geometry) -> np.ndarray:
        return np.full_like(geometry.cos_incidence, self.normal_albedo / np.pi)

    def uniforms(self) -> dict[str, Any]:
        return {"law_normal_albedo": self.normal_albedo}
