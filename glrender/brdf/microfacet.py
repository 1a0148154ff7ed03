"""Microfacets: metals, and paints under a clear coat, with a highlight."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import numpy as np
from glrender_camera.validate import within

from .geometry import Geometry
from .law import Law

# Reflectance of a paint's coat seen square on [1]: glTF 2.0, Appendix B, for an index of refraction of 1.5.
_COAT = 0.04
# Roots of the cosine at which `_left` knows what a coat leaves; its half vectors along and around the normal: to 3e-4.
_ROOTS, _HALF_VECTORS = np.linspace(0.0, 1.0, 33), 128


@dataclass(frozen=True, kw_only=True)
class Microfacet(Law):
    """Mirrors that lean at random: GGX, separable Smith shadowing, Schlick's reflectance. ::

        metal = D G [f0 + (1 - f0) (1 - cos(phase/2))^5],  f0 = base_albedo
        paint = the same with f0 = 0.04, and base_albedo/pi left(mu0) left(mu) / mean(left) from below
        f = metalness metal + (1 - metalness) paint

    `left` is the share that a paint's coat does not reflect: a white paint returns all light. A metal scatters once,
    and loses 8 % and more at roughness 0.5, 42 % and more at 1.

    Parameters
    ----------
    base_albedo, metalness : float [1], 0..1
        A metal's reflectance seen square on, or a paint's albedo below its coat; 1 of a metal, 0 of a paint.
    roughness : float [1], 0.1..1
        Root of GGX' alpha; below, the lobe is narrower than the Sun.

    Source: Khronos (2021), glTF 2.0, Appendix B; Walter et al. (2007); Kelemen and Szirmay-Kalos (2001).
    Twin: shaders/brdf/microfacet.glsl, rtol 1e-4.
    """

    base_albedo: float
    metalness: float
    roughness: float

    glsl: ClassVar[str] = "microfacet"
    uniform_fields: ClassVar[dict[str, str]] = {
        **dict.fromkeys(("law_base_albedo", "law_metalness", "law_alpha2", "law_mean_left"), "float"),
        "law_left": "vec4[32]"}

    def __post_init__(self):
        for name, least in (("base_albedo", 0.0), ("metalness", 0.0), ("roughness", 0.1)):
            object.__setattr__(self, name, within(name, getattr(self, name), least, 1.0))

    def lit_brdf(self, geometry: Geometry) -> np.ndarray:
        cosines, alpha2 = (geometry.cos_incidence, geometry.cos_emission), self.roughness**4
        # 1 - cos^2 of the angle from normal to bisector, without cancelling near the highlight.
        aside = geometry.sun_side + geometry.camera_side
        tail = np.sum(aside * aside, axis=-1) / np.maximum(geometry.bisector, 1e-150) ** 2
        lobe = alpha2 / np.pi / (tail + alpha2 * (1.0 - tail)) ** 2 * np.prod([_smith(mu, alpha2) for mu in cosines], 0)
        grazing, (left, mean) = (1.0 - np.minimum(0.5 * geometry.bisector, 1.0)) ** 5, _left(self.roughness)
        below = np.prod([np.interp(np.sqrt(mu), _ROOTS, left) for mu in cosines], axis=0) / (np.pi * mean)
        metal, paint = (lobe * (f0 + (1.0 - f0) * grazing) for f0 in (self.base_albedo, _COAT))
        return self.metalness * metal + (1.0 - self.metalness) * (paint + self.base_albedo * below)

    def uniforms(self) -> dict[str, Any]:
        left, mean = _left(self.roughness)
        return {"law_base_albedo": self.base_albedo, "law_metalness": self.metalness, "law_alpha2": self.roughness**4,
                "law_mean_left": mean, "law_left": np.stack([left[:-1], *[left[1:]] * 3], axis=1)}


def _smith(mu: np.ndarray | float, alpha2: float) -> np.ndarray:
    """Share of the mirrors that is seen at a cosine, over twice the cosine."""
    return 1.0 / (mu + np.sqrt(alpha2 + (1.0 - alpha2) * mu * mu))


@cache
def _left(roughness: float) -> tuple[np.ndarray, float]:
    """Shares (33,) of light that a coat leaves at roots of the cosine, and their mean: by half vectors of its lobe."""
    alpha2, (place, weight) = roughness**4, np.polynomial.legendre.leggauss(_HALF_VECTORS)
    place, turn = 0.5 * (place + 1.0)[:, None], (np.arange(_HALF_VECTORS) + 0.5) * np.pi / _HALF_VECTORS
    height, left = np.sqrt((1.0 - place) / (1.0 + place * (alpha2 - 1.0))), []
    for mu0 in np.maximum(_ROOTS**2, 1e-6):
        along = np.sqrt(1.0 - height**2) * np.cos(turn) * np.sqrt(1.0 - mu0 * mu0) + height * mu0
        mu = np.maximum(2.0 * along * height - mu0, 0.0)
        coat = _COAT + (1.0 - _COAT) * (1.0 - np.clip(along, 0.0, 1.0)) ** 5
        lobe = 4.0 * mu * _smith(mu0, alpha2) * _smith(mu, alpha2) * np.maximum(along, 0.0) / height
        left.append(1.0 - float(0.5 * weight @ (lobe * coat).mean(axis=1)))
    fine = np.linspace(0.0, 1.0, 2049)
    return np.array(left), float(np.trapezoid(np.interp(fine, _ROOTS, left) * 4.0 * fine**3, fine))
