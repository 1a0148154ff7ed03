"""Lambert's law, darkening with phase: BRDF = A / pi exp(-g / scale)."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from glrender.brdf import GlslText, Law
from glrender_camera.validate import positive, within

TWIN = """
#include "brdf/angles.glsl"
float brdf(vec3 to_sun, vec3 to_camera, vec3 normal, float albedo_scale)
{
    bool lit = dot(normal, to_sun) > 0.0 && dot(normal, to_camera) > 0.0;
    vec3 difference = to_sun - to_camera, bisector = to_sun + to_camera;
    float phase = phase_angle(dot(difference, difference), dot(bisector, bisector));
    float albedo = clamp(law_normal_albedo * albedo_scale, 0.0, 1.0);
    return lit ? albedo / PI * exp(-phase * law_per_rad) : 0.0;
}
"""


@dataclass(frozen=True, kw_only=True)
class DustyLambert(Law):
    normal_albedo: float
    scale_deg: float

    glrender_api: ClassVar[int] = 1
    glsl: ClassVar[str] = GlslText("dusty_lambert", TWIN)
    uniform_fields: ClassVar[dict] = {"law_normal_albedo": "float", "law_per_rad": "float"}

    def __post_init__(self):
        within("normal_albedo", self.normal_albedo, 0.0, 1.0)
        positive("scale_deg", self.scale_deg)

    def lit_brdf(self, geometry):
        return self.normal_albedo / np.pi * np.exp(-geometry.phase / np.radians(self.scale_deg))

    def uniforms(self):
        return {"law_normal_albedo": self.normal_albedo, "law_per_rad": 1.0 / np.radians(self.scale_deg)}
