"""What a reflectance law is: a float64 BRDF and the GLSL twin's structure and values."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np


class Law(ABC):
    """A reflectance law, as a frozen keyword-only dataclass of its parameters.

    The twin is `shaders/brdf/<glsl>.glsl`, which defines ::

        float brdf(vec3 to_sun, vec3 to_camera, vec3 normal, float albedo_scale)

    [1/sr] on unit vectors, 0 where cos_incidence <= 0 or cos_emission <= 0.
    """

    glsl: ClassVar[str]
    """Name of the twin's file."""
    uniform_fields: ClassVar[Mapping[str, str]]
    """Members of the uniform block `Law`: name (starting with ``law_``) to GLSL type."""

    @abstractmethod
    def brdf(self, to_sun: np.ndarray, to_camera: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """BRDF of unit vectors.

        Parameters
        ----------
        to_sun, to_camera, normal : (..., 3) float [1]
            Away from the surface; broadcast together.

        Returns
        -------
        (...) float64 [1/sr]
            0 where the surface is unlit or unseen.
        """

    def defines(self) -> dict[str, int]:
        """Preprocessor switches: which terms are compiled in. Structure only."""
        return {}

    @abstractmethod
    def uniforms(self) -> dict[str, Any]:
        """Values of `uniform_fields`, worked out in float64 once per law, not per pixel."""
