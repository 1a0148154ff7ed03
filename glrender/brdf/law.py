"""The base class of reflectance laws: a float64 BRDF and the GLSL twin's structure and values."""

from __future__ import annotations

import math
import re
import warnings
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from ..base.errors import ConfigError
from .geometry import Geometry, dot

MIN_COSINE = 1e-6
"""Cosines of incidence and emission are held at this (89.99994 deg): a BRDF may grow as 1 / (mu0 + mu)
towards double grazing, and float32 must not overflow. I/F still goes to 0 there with the true cosine."""


class GlslText(str):
    """Name of a law's twin together with its text: how a law from outside glrender brings its own.

    Parameters
    ----------
    name : str
        Small letters, digits and _; in replies it names the law.
    text : str
        GLSL as `Law` asks for; it may ``#include "brdf/angles.glsl"`` and what else is in `glrender/shaders`.
    """

    text: str

    def __new__(cls, name: str, text: str) -> GlslText:
        if not re.fullmatch(r"[a-z][a-z0-9_]*", name):
            raise ConfigError("glsl", "must be small letters, digits and _", name)
        made = super().__new__(cls, name)
        made.text = text
        return made

    def __getnewargs__(self) -> tuple[str, str]:  # type: ignore[override]
        return str(self), self.text


class Law(ABC):
    """A reflectance law, as a frozen keyword-only dataclass of its parameters.

    The twin is `shaders/brdf/<glsl>.glsl`, or the text of a `GlslText`, which defines ::

        float brdf(vec3 to_sun, vec3 to_camera, vec3 normal, float albedo_scale)

    [1/sr] on unit vectors, 0 where cos_incidence <= 0 or cos_emission <= 0. `albedo_scale` is
    a texture's factor on the law's albedo; the product is held within 0..1. A law whose twin
    compiles in the CPU's values of an albedo reads it only under ``HAS_ALBEDO_TEXTURE``.
    """

    glsl: ClassVar[str]
    """Name of the twin's file, or a `GlslText`."""
    uniform_fields: ClassVar[Mapping[str, str]]
    """Members of the uniform block `Law`: name (starting with ``law_``) to GLSL type."""

    @property
    def max_phase(self) -> float:
        """Largest phase angle [rad] at which the law is itself; beyond it a part is held."""
        return math.pi

    def brdf(self, to_sun: np.ndarray, to_camera: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """BRDF of unit vectors.

        Parameters
        ----------
        to_sun, to_camera, normal : (..., 3) float [1]
            Away from the surface; broadcast together.

        Returns
        -------
        (...) float64 [1/sr]
            0 where the surface is unlit or unseen; never negative.

        Warns
        -----
        UserWarning
            Lit points at phase angles beyond `max_phase`.
        """
        to_sun, to_camera, normal = (np.asarray(v, dtype=np.float64) for v in (to_sun, to_camera, normal))
        cos_incidence, cos_emission = dot(normal, to_sun), dot(normal, to_camera)
        lit = (cos_incidence > 0.0) & (cos_emission > 0.0)
        geometry = Geometry(to_sun=to_sun, to_camera=to_camera, normal=normal,
                            cos_incidence=np.where(lit, np.maximum(cos_incidence, MIN_COSINE), 1.0),
                            cos_emission=np.where(lit, np.maximum(cos_emission, MIN_COSINE), 1.0))
        if self.max_phase < math.pi and np.any(lit & (geometry.phase > self.max_phase)):
            warnings.warn(f"{type(self).__name__} is used beyond the phase of "
                          f"{math.degrees(self.max_phase):.4g} deg up to which it holds", stacklevel=2)
        return np.where(lit, np.maximum(self.lit_brdf(geometry), 0.0), 0.0)

    def lit_brdf(self, geometry: Geometry) -> np.ndarray:
        """BRDF (...) [1/sr] of points that are lit and seen; a law defines this, or `brdf` as a whole.

        Where a point is neither, the cosines are 1 and the value is thrown away.
        """
        raise NotImplementedError(f"{type(self).__name__} defines neither brdf nor lit_brdf")

    def defines(self) -> dict[str, int]:
        """Preprocessor switches: which terms are compiled in. Structure only."""
        return {}

    @abstractmethod
    def uniforms(self) -> dict[str, Any]:
        """Values of `uniform_fields`, worked out in float64 once per law, not per pixel."""
