"""Point spread functions on the pixel grid.

A kernel holds the fraction of a point's light, at a pixel's centre, that falls into each pixel. It
is not renormalised: the light that it misses goes farther, and its share is reported.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import scipy
from scipy.special import erf, ive, j1

from .pupil import intensity

# Gauss-Legendre nodes on one pixel and axis: exact to 1e-9 while a pixel holds less than about
# three periods of the diffraction pattern, lambda N >= 0.3 px.
_NODES = 8
MIN_LAMBDA_N_PX = 0.3


def gaussian_axis(sigma_px: float, radius_px: int, offset_px: float = 0.0) -> np.ndarray:
    """Pixel-integrated Gaussian along one axis, its centre so far from the middle pixel's.

    Parameters
    ----------
    sigma_px : float [px], >= 0
    radius_px : int [px]

    Returns
    -------
    (2 radius + 1,) float64 [1]
    """
    return gaussian_weights(np.array([offset_px]), sigma_px, radius_px)[:, 0]


def blurred(kernel: np.ndarray, sigma_px: float, radius_px: int) -> np.ndarray:
    """A kernel that already holds the pixel, blurred by a Gaussian that must not count it again.

    The discrete Gaussian exp(-s^2) I_n(s^2) adds exactly s^2 to the variance, sums to 1 and is
    nowhere negative.

    Parameters
    ----------
    kernel : (..., n, m) float64
    sigma_px : float [px], >= 0
    radius_px : int [px]

    Returns
    -------
    (..., n + 2 radius, m + 2 radius) float64

    Source: Lindeberg (1990), IEEE Trans. Pattern Anal. Mach. Intell. 12, 234.
    """
    axis = ive(np.abs(np.arange(-radius_px, radius_px + 1)), sigma_px**2)
    wide = np.pad(kernel, [(0, 0)] * (kernel.ndim - 2) + [(radius_px, radius_px)] * 2)
    for direction in (-2, -1):
        wide = scipy.ndimage.convolve1d(wide, axis, axis=direction, mode="constant")
    return wide


def diffraction_kernel(wavelengths_m: np.ndarray, weights: np.ndarray, **options: Any) -> np.ndarray:
    """Diffraction of a round or annular pupil, blurred by a Gaussian and integrated over the pixels.

    `diffraction_kernels` through `gaussian_weights` alone: (2 radius + 1, 2 radius + 1) float64 [1].
    """
    return diffraction_kernels(wavelengths_m, weights, **options)[0]


def diffraction_kernels(wavelengths_m: np.ndarray, weights: np.ndarray, *, f_number: float, pixel_pitch_m: float,
                        central_obscuration: float, sigma_px: float, radius_px: int,
                        opd_m: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None, n_nodes: int = _NODES,
                        windows: Sequence[Callable] | None = None) -> np.ndarray:
    """Diffraction of a round or annular pupil, blurred by a Gaussian and gathered under each pixel's windows.

    Parameters
    ----------
    wavelengths_m, weights : (N,) float [m], [1]
        The weights sum to 1.
    f_number : float [1]
        Focal length over the pupil's outer diameter.
    pixel_pitch_m : float [m]
    central_obscuration : float [1], 0..0.95
        Inner over outer diameter of the pupil.
    sigma_px : float [px], >= 0
        Width of the Gaussian: jitter, residual aberrations.
    radius_px : int [px]
    opd_m : function of x, y (...) [1] -> (...) [m], optional
        Optical path difference over the pupil; by default none: Airy's pattern.
    n_nodes : int
        Points per pixel and axis, even.
    windows : functions of (x_px, sigma_px, radius_px), optional
        Shares of the light at x for the pixels, as of `gaussian_weights`, the default.

    Returns
    -------
    (windows, 2 radius + 1, 2 radius + 1) float64 [1]

    Source: Born & Wolf, Principles of Optics, section 8.6.2 (annular aperture).
    """
    node, node_weight = np.polynomial.legendre.leggauss(n_nodes)
    pixels = np.arange(-radius_px, radius_px + 1)
    x = (pixels[:, None] + 0.5 * node).ravel()
    if opd_m is None:
        # The pattern is even: one quadrant is enough.
        half = x[x.size // 2:]
        r = np.hypot(half[:, None], half[None, :])
        quadrant = np.zeros_like(r)
        for wavelength_m, weight in zip(wavelengths_m, weights, strict=True):
            quadrant += weight * _annular(r, wavelength_m * f_number / pixel_pitch_m, central_obscuration)
        rows = np.concatenate([quadrant[::-1], quadrant])
        pattern = np.concatenate([rows[:, ::-1], rows], axis=1)
    else:
        wavelengths_m = np.asarray(wavelengths_m)
        pattern = intensity(pixels, 0.5 * node, lambda_n_px=wavelengths_m * (f_number / pixel_pitch_m),
                            weights=weights, obscuration=central_obscuration,
                            phase=lambda px, py: 2.0 * math.pi / wavelengths_m[0] * opd_m(px, py))
    blurs = [window(x, sigma_px, radius_px) * np.tile(0.5 * node_weight, pixels.size)
             for window in windows or (gaussian_weights,)]
    return np.array([blur @ pattern @ blur.T for blur in blurs])


def _annular(r_px: np.ndarray, lambda_n_px: float, obscuration: float) -> np.ndarray:
    """Point spread function [1/px2] of an annular pupil; its integral over the plane is 1."""
    x = np.maximum(np.pi * r_px / lambda_n_px, 1e-9)
    amplitude = 2.0 * j1(x) / x
    if obscuration > 0.0:
        inner = obscuration * x
        amplitude = amplitude - obscuration**2 * 2.0 * j1(inner) / inner
    return np.pi / (4.0 * lambda_n_px**2 * (1.0 - obscuration**2)) * amplitude**2


def gaussian_weights(x_px: np.ndarray, sigma_px: float, radius_px: int) -> np.ndarray:
    """(2 radius + 1, N): share of the light at each x that a Gaussian blur puts into each pixel."""
    edges = np.arange(-radius_px, radius_px + 2)[:, None] - 0.5 - x_px[None, :]
    step = np.sign(edges) if sigma_px == 0.0 else erf(edges / (math.sqrt(2.0) * sigma_px))
    return np.diff(step, axis=0) / 2.0
