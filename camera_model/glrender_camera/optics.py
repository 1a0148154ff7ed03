"""The optics: how much light is gathered, and how a point is spread."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from scipy.special import erf

from .spectrum import Curve, band, curve
from .validate import known_keys, positive, within

# Energy beyond 5.5 sigma is 4e-8 an axis: below float32's own rounding of the sum.
_KERNEL_RADIUS_SIGMAS = 5.5
MAX_PSF_SIGMA_PX = 100.0


@dataclass(frozen=True, kw_only=True)
class Optics:
    """Aperture, transmission and point spread function.

    Parameters
    ----------
    aperture_diameter_m : float [m], > 0
        Of the entrance pupil, a disc.
    transmission : float or pairs (wavelength [nm], value) [1], 0..1
        Of lenses and filter together.
    band_nm : (low, high) float [nm]
        The wavelengths that the irradiance image spans.
    psf_sigma_px : float [px], 0..100
        Standard deviation of the Gaussian point spread function before integration over the
        pixel; 0 is none.

    Raises
    ------
    ConfigError
    """

    aperture_diameter_m: float
    transmission: Curve = 1.0
    band_nm: tuple[float, float] = (450.0, 950.0)
    psf_sigma_px: float = 0.0

    def __post_init__(self):
        put = lambda name, value: object.__setattr__(self, name, value)  # noqa: E731 (frozen dataclass)
        put("aperture_diameter_m", positive("aperture_diameter_m", self.aperture_diameter_m))
        put("transmission", curve("transmission", self.transmission, 0.0, 1.0))
        put("band_nm", band("band_nm", self.band_nm))
        put("psf_sigma_px", within("psf_sigma_px", self.psf_sigma_px, 0.0, MAX_PSF_SIGMA_PX))

    @classmethod
    def from_dict(cls, table: Mapping[str, Any]) -> Optics:
        """From plain data; unknown keys are refused by name."""
        known_keys("", table, [f.name for f in fields(cls)], required=("aperture_diameter_m",))
        return cls(**table)

    @property
    def aperture_area_m2(self) -> float:
        """Area of the entrance pupil [m2]."""
        return math.pi / 4.0 * self.aperture_diameter_m**2

    @cached_property
    def psf_kernel(self) -> np.ndarray:
        """One axis of the pixel-integrated Gaussian, not renormalised.

        Returns
        -------
        (2 r + 1,) float64 [1]
            Fraction of a point's light, at a pixel's centre, that falls into each pixel along
            one axis; r covers 5.5 sigma.
        """
        if self.psf_sigma_px == 0.0:
            return np.ones(1)
        radius = math.ceil(_KERNEL_RADIUS_SIGMAS * self.psf_sigma_px)
        edges = np.arange(-radius, radius + 2) - 0.5
        return np.diff(erf(edges / (math.sqrt(2.0) * self.psf_sigma_px))) / 2.0

    @property
    def psf_energy_cut(self) -> float:
        """Fraction of a point's light that falls outside the kernel, and is lost."""
        return max(0.0, 1.0 - float(self.psf_kernel.sum()) ** 2)

    def spread(self, image: np.ndarray) -> np.ndarray:
        """Convolve with the point spread function; darkness beyond the edges, no wrap-around.

        Parameters
        ----------
        image : (H, W) float32

        Returns
        -------
        (H, W) float32
        """
        if self.psf_sigma_px == 0.0:
            return image
        kernel = self.psf_kernel.astype(np.float32)
        return cv2.sepFilter2D(image, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_CONSTANT)
