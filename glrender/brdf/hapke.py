"""Hapke's law in full."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from glrender_camera.validate import finite, one_of, within

from ..base.errors import ConfigError
from .geometry import Geometry, cross, dot
from .law import Law

MAX_FILLING_FACTOR = 0.752
"""K = -ln(1 - 1.209 phi^(2/3)) / (1.209 phi^(2/3)) has its pole at phi = 0.75225."""
# Below this mean slope the terms are left out: they change the BRDF by less than 1e-7 up to
# 89.99 deg of incidence.
_SMOOTH_DEG = 1e-3
MAX_B, MAX_ANISOTROPIC_B = 0.999, 0.97
"""A lobe of b = 0.999 is 0.1 deg wide. The averaged phase function's series holds to b = 0.97: 1e-6
against 2e-4 at 0.99."""
MAX_ROUGHNESS_DEG = 75.0
"""The shader is within 1e-5 up to 60 deg, 1e-4 at 75, 2e-4 at 85 and 1e-3 at 89."""
_MAX_C = 10.0
_MAX_AMPLITUDE = 1e3
_WIDTHS = (1e-9, 1e6)
# Chebyshev terms of the averaged phase function that the shader may carry: enough for 1e-7 at b = 0.9.
_MAX_CHEBYSHEV_TERMS = 48


@dataclass(frozen=True, kw_only=True)
class Hapke(Law):
    """Hapke's bidirectional reflectance with all its terms, each only where it is asked for. ::

        r / cos(i) = K w/(4 pi) mu0e/(mu0e + mue) [p (1 + Bs0 Bs) + M] (1 + Bc0 Bc) S / cos(i)

    Parameters
    ----------
    single_scattering_albedo : float [1], 0..1
    b : float [1], 0..0.999
        Width of both Henyey-Greenstein lobes; at most 0.97 with anisotropic multiple scattering.
    c : float [1], normally -1..1, at most 10 either way
        Weight: (1 + c) / 2 of the back-scattering lobe (c > 0 scatters back), (1 - c) / 2 of the
        forward one. c = 1 is a single backward lobe, the one-term function with asymmetry -b
        (see `one_term`). Some authors print (1 + c) / 2 as "c": convert.
    shoe_amplitude, shoe_width : float [1], amplitude 0..1000, width 0 or 1e-9..1e6
        Shadow-hiding opposition effect Bs = 1 / (1 + tan(g/2) / width); off while either is 0
        (a width of 0 is 0 at every phase but 0).
    cboe_amplitude, cboe_width : float [1], as above
        Coherent-backscatter opposition effect; off while either is 0.
    roughness_deg : float [deg], 0..75
        Mean slope theta-bar of the macroscopic roughness; a warning above 60.
    filling_factor : float [1], 0..0.752
        Volume fraction of solids; 0 leaves porosity out (K = 1).
    h_function : {"2002", "1981"}
        Approximation of Chandrasekhar's H: within 1 % or within 4 %.
    multiple_scattering : {"isotropic", "anisotropic"}
        H H - 1 of 1981, or the anisotropic approximation of 2002.

    Source: Hapke (1981), (1984) eqs 45-58, (2002), (2008), (2012).
    Twin: shaders/brdf/hapke.glsl, rtol 1e-5 to 89 deg of incidence (1e-4 above 60 deg of roughness),
    5e-4 beyond.
    """

    single_scattering_albedo: float
    b: float
    c: float
    shoe_amplitude: float = 0.0
    shoe_width: float = 0.0
    cboe_amplitude: float = 0.0
    cboe_width: float = 0.0
    roughness_deg: float = 0.0
    filling_factor: float = 0.0
    h_function: str = "2002"
    multiple_scattering: str = "isotropic"

    glsl: ClassVar[str] = "hapke"

    def __post_init__(self):
        def checked(name, check, *limits):
            object.__setattr__(self, name, check(name, getattr(self, name), *limits))

        checked("single_scattering_albedo", within, 0.0, 1.0)
        checked("b", finite)
        if not 0.0 <= self.b <= MAX_B:
            raise ConfigError("b", f"must be between 0 and {MAX_B:g}", self.b,
                              "a one-term asymmetry xi < 0 is b = -xi, c = 1: see Hapke.one_term")
        checked("c", within, -_MAX_C, _MAX_C)
        for name in ("shoe_amplitude", "cboe_amplitude"):
            checked(name, within, 0.0, _MAX_AMPLITUDE)
        for name in ("shoe_width", "cboe_width"):
            checked(name, finite)
            if getattr(self, name) != 0.0:
                checked(name, within, *_WIDTHS)
        checked("roughness_deg", within, 0.0, MAX_ROUGHNESS_DEG)
        checked("filling_factor", within, 0.0, MAX_FILLING_FACTOR)
        checked("h_function", one_of, ("2002", "1981"))
        checked("multiple_scattering", one_of, ("isotropic", "anisotropic"))
        if self.is_anisotropic and self.b > MAX_ANISOTROPIC_B:
            raise ConfigError("b", f"must be <= {MAX_ANISOTROPIC_B:g} with anisotropic multiple scattering", self.b)
        for is_odd, text in (
                (self.b > 0.9, "b > 0.9: the lobe is a spike that no facet model resolves"),
                (abs(self.c) > 1.0, "|c| > 1: the phase function turns negative, the BRDF is held at 0"),
                (self.roughness_deg > 60.0, "roughness_deg > 60: the roughness model is not meant for it")):
            if is_odd:
                warnings.warn(f"Hapke with {text}", stacklevel=3)

    @classmethod
    def one_term(cls, *, asymmetry: float, **parameters: Any) -> Hapke:
        """Hapke with a one-term Henyey-Greenstein function.

        Parameters
        ----------
        asymmetry : float [1], -0.999..0.999
            Mean cosine of the scattering angle; < 0 scatters back, as for all small bodies.
        **parameters
            The others.
        """
        asymmetry = finite("asymmetry", asymmetry)
        return cls(b=abs(asymmetry), c=-1.0 if asymmetry > 0.0 else 1.0, **parameters)

    # Structure.

    @property
    def has_shoe(self) -> bool:
        return self.shoe_amplitude > 0.0 and self.shoe_width > 0.0

    @property
    def has_cboe(self) -> bool:
        return self.cboe_amplitude > 0.0 and self.cboe_width > 0.0

    @property
    def has_roughness(self) -> bool:
        return self.roughness_deg >= _SMOOTH_DEG

    @property
    def is_anisotropic(self) -> bool:
        """Whether the anisotropic form differs from the isotropic one: p is not even in cos(phase)."""
        return self.multiple_scattering == "anisotropic" and self.b > 0.0 and self.c != 0.0

    # Values.

    @cached_property
    def porosity_factor(self) -> float:
        """K of Hapke (2008) [1], 1 at a filling factor of 0."""
        x = 1.209 * self.filling_factor ** (2.0 / 3.0)
        return 1.0 if x == 0.0 else -math.log1p(-x) / x

    @property
    def _tan_roughness(self) -> float:
        return math.tan(math.radians(self.roughness_deg))

    @property
    def _chi(self) -> float:
        return 1.0 / math.sqrt(1.0 + math.pi * self._tan_roughness**2) if self.has_roughness else 1.0

    @cached_property
    def _legendre(self) -> tuple[np.ndarray, float]:
        """Legendre series of P(x) - 1 and the constant P of Hapke (2002), eqs 23-27."""
        # b^n < 1e-17 ends the series; a_n falls as n^-1.5 besides.
        n_terms = int(min(math.ceil(math.log(1e-17) / math.log(self.b)), 4000)) + 2
        series = np.zeros(n_terms + 1)
        constant, a = 1.0, -0.5
        for n in range(1, n_terms + 1, 2):
            if n > 1:
                a *= (2.0 - n) / (n + 1.0)
            b_n = self.c * (2 * n + 1) * self.b**n
            series[n] = a * b_n
            constant += a * a * b_n
        return series, constant

    @cached_property
    def _chebyshev(self) -> np.ndarray:
        """P(x) - 1 on 0..1 as a Chebyshev series in 2 x - 1, which float32 bears where powers do not."""
        series, _ = self._legendre
        return np.polynomial.chebyshev.chebinterpolate(
            lambda y: np.polynomial.legendre.legval(0.5 * (y + 1.0), series), 127)

    # Terms.

    def phase_function(self, geometry: Geometry) -> np.ndarray:
        """Two-term Henyey-Greenstein p(g) [1]; its mean over the sphere is 1."""
        # 1 + b^2 -+ 2 b cos g without its cancellation at b -> 1.
        base = (1.0 - self.b) ** 2
        back = (base + self.b * geometry.distance**2) ** -1.5
        forward = (base + self.b * geometry.bisector**2) ** -1.5
        return 0.5 * (1.0 - self.b**2) * ((1.0 + self.c) * back + (1.0 - self.c) * forward)

    def _h_minus_1(self, x: np.ndarray) -> np.ndarray:
        """H(x) - 1 [1], in a form without cancellation for dark surfaces."""
        w = self.single_scattering_albedo
        gamma = math.sqrt(1.0 - w)
        one_minus_gamma = w / (1.0 + gamma)
        if self.h_function == "1981":
            return 2.0 * x * one_minus_gamma / (1.0 + 2.0 * x * gamma)
        r0 = one_minus_gamma / (1.0 + gamma)
        x = np.maximum(x, 1e-300)
        u = w * x * (r0 + (0.5 - r0 * x) * np.log1p(1.0 / x))
        return u / (1.0 - u)

    def _averaged_phase_function(self, x: np.ndarray) -> np.ndarray:
        """P(x) of Hapke (2002) [1]: p averaged over the hemisphere that light comes from."""
        return 1.0 + np.polynomial.chebyshev.chebval(2.0 * x - 1.0, self._chebyshev)

    def _multiple_scattering(self, x0: np.ndarray, x: np.ndarray) -> np.ndarray:
        h0, h = self._h_minus_1(x0), self._h_minus_1(x)
        if self.is_anisotropic:
            return (self._averaged_phase_function(x0) * h + self._averaged_phase_function(x) * h0
                    + self._legendre[1] * h0 * h)
        return h0 + h + h0 * h

    def _roughness(self, geometry: Geometry) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Effective cosines over chi, steeper angle first, and S mu_e over both and cos(incidence).

        Both branches of Hapke (1984) are one in terms of the smaller and the larger of incidence and
        emission: reciprocity by construction, and no switch at i = e.
        """
        tan_slope = self._tan_roughness
        cos_small = np.maximum(geometry.cos_incidence, geometry.cos_emission)
        cos_large = np.minimum(geometry.cos_incidence, geometry.cos_emission)
        side, camera_side = geometry.sun_side, geometry.camera_side
        sin_i, sin_e = np.sqrt(dot(side, side)), np.sqrt(dot(camera_side, camera_side))
        sin_small, sin_large = np.minimum(sin_i, sin_e), np.maximum(sin_i, sin_e)
        # At the zenith the azimuth means nothing and every term with it is 0.
        sines = np.maximum(sin_i * sin_e, 1e-300)
        x = dot(side, camera_side) / sines
        y = np.abs(dot(geometry.normal, cross(geometry.to_sun, geometry.to_camera))) / sines
        azimuth = np.arctan2(y, x)
        # 1.6e16 at most, at pi: f is 0 there. The other functions of the azimuth by it cost a tenth of theirs.
        tan_half = np.tan(0.5 * azimuth)
        f = np.exp(-2.0 * tan_half)
        cos2_half = 1.0 / (1.0 + tan_half * tan_half)
        sin2_half = tan_half * tan_half * cos2_half
        e1_small, e2_small = self._slope_terms(cos_small, sin_small)
        e1_large, e2_large = self._slope_terms(cos_large, sin_large)
        # Floors for 0/0 where Sun and camera graze from opposite sides.
        denominator = np.maximum(2.0 - e1_large - azimuth / np.pi * e1_small, 1e-14)
        mu_small = np.maximum(cos_small + sin_small * tan_slope * (
            (cos2_half - sin2_half) * e2_large + sin2_half * e2_small) / denominator, 1e-14)
        mu_large = np.maximum(
            cos_large + sin_large * tan_slope * (e2_large - sin2_half * e2_small) / denominator, 1e-14)
        eta_small = cos_small + sin_small * tan_slope * e2_small / (2.0 - e1_small)
        eta_large = cos_large + sin_large * tan_slope * e2_large / (2.0 - e1_large)
        return mu_small, mu_large, 1.0 / (eta_large * ((1.0 - f) * eta_small + f * cos_small))

    def _slope_terms(self, cosine: np.ndarray, sine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """E1 and E2 of Hapke (1984) [1]."""
        z = cosine / np.maximum(sine, 1e-10) / self._tan_roughness
        return np.exp(-2.0 / np.pi * z), np.exp(-z * z / np.pi)

    def lit_brdf(self, geometry: Geometry) -> np.ndarray:
        if self.has_roughness:
            mu_small, mu_large, shadowing = self._roughness(geometry)
            spread = mu_small * mu_large / (mu_small + mu_large) * shadowing
        else:
            mu_small, mu_large = geometry.cos_incidence, geometry.cos_emission
            spread = 1.0 / (mu_small + mu_large)
        to_h = self._chi / self.porosity_factor
        single = self.phase_function(geometry)
        tan_half_phase = geometry.tan_half_phase
        if self.has_shoe:
            surge = self.shoe_width / (self.shoe_width + tan_half_phase)
            single = single * (1.0 + self.shoe_amplitude * surge)
        total = np.maximum(single + self._multiple_scattering(to_h * mu_small, to_h * mu_large), 0.0)
        if self.has_cboe:
            z = np.maximum(tan_half_phase / self.cboe_width, 1e-300)
            total = total * (1.0 + self.cboe_amplitude * (1.0 - np.expm1(-z) / z) / (2.0 * (1.0 + z) ** 2))
        return self.porosity_factor * self.single_scattering_albedo / (4.0 * np.pi) * spread * total

    # The twin's side.

    @cached_property
    def _shader_chebyshev(self) -> np.ndarray:
        """The terms that float32 sees, in groups of 4, highest last."""
        terms = self._chebyshev
        tail = np.cumsum(np.abs(terms[::-1]))[::-1]
        needed = int(np.count_nonzero(tail > 2e-8))
        n_groups = min(max(-(-needed // 4), 1), _MAX_CHEBYSHEV_TERMS // 4)
        return terms[: 4 * n_groups].reshape(n_groups, 4)

    def defines(self) -> dict[str, int]:
        return {
            "LAW_BACK_LOBE": int(self.b > 0.0 and self.c != -1.0),
            "LAW_FORWARD_LOBE": int(self.b > 0.0 and self.c != 1.0),
            "LAW_SHOE": int(self.has_shoe),
            "LAW_CBOE": int(self.has_cboe),
            "LAW_ROUGHNESS": int(self.has_roughness),
            "LAW_H_1981": int(self.h_function == "1981"),
            "LAW_ANISOTROPIC": len(self._shader_chebyshev) if self.is_anisotropic else 0,
        }

    @property
    def uniform_fields(self) -> dict[str, str]:  # type: ignore[override]
        fields = dict.fromkeys(("law_surface", "law_lobes", "law_opposition", "law_more"), "vec4")
        if self.is_anisotropic:
            fields["law_averaged_phase"] = f"vec4[{len(self._shader_chebyshev)}]"
        return fields

    def uniforms(self) -> dict[str, Any]:
        w, b, c = self.single_scattering_albedo, self.b, self.c
        gamma = math.sqrt(1.0 - w)
        h = 2.0 * gamma if self.h_function == "1981" else (w / (1.0 + gamma)) ** 2
        # b = 0 compiles no lobe in.
        lobe = 0.5 * (1.0 - b * b) / max(b, 1e-9) ** 1.5
        scale = self.porosity_factor / (4.0 * math.pi)
        values: dict[str, Any] = {
            "law_surface": (h, 0.5 * w, self._chi / self.porosity_factor, self._tan_roughness),
            "law_lobes": ((1.0 + c) * lobe, (1.0 - c) * lobe, (1.0 - b) ** 2 / max(b, 1e-9), scale * w),
            "law_opposition": (self.shoe_amplitude * self.shoe_width, self.shoe_width,
                               0.5 * self.cboe_amplitude,
                               1.0 / self.cboe_width if self.has_cboe else 0.0),
            "law_more": (scale, self._legendre[1] if self.is_anisotropic else 1.0, 0.0, 0.0),
        }
        if self.is_anisotropic:
            values["law_averaged_phase"] = self._shader_chebyshev
        return values
