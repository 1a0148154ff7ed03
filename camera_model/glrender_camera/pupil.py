"""Diffraction of an aberrated pupil, and Zernike's polynomials on it.

The Fourier integral over the pupil is summed at Gauss points of chords, in the image points that
are asked for: no grid of the pupil whose edge is a staircase, no period that wings could fold back
into. For a pupil without aberrations it equals Airy's closed form to 1e-9.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

# Nodes of a Gauss rule beyond those that the phase needs: exp(i c x) needs c/2 nodes and a few more.
_SPARE_NODES = 24


def zernike(noll: int, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Zernike's polynomial of unit RMS on the unit disc.

    Parameters
    ----------
    noll : int, >= 1
        Noll's index: 1 piston, 2 and 3 tilt in x and y, 4 defocus, 5 and 6 astigmatism, 7 and 8
        coma in y and x, 11 spherical.
    x, y : (...) float [1]
        Pupil coordinates over the outer radius; x to the right, y down.

    Source: Noll (1976), J. Opt. Soc. Am. 66, 207, table I.
    """
    n, m = noll_orders(noll)
    r, angle = np.hypot(x, y), np.arctan2(y, x)
    radial = sum((-1) ** k * math.comb(n - k, k) * math.comb(n - 2 * k, (n - abs(m)) // 2 - k) * r ** (n - 2 * k)
                 for k in range((n - abs(m)) // 2 + 1))
    if m == 0:
        return math.sqrt(n + 1.0) * radial
    return math.sqrt(2.0 * (n + 1.0)) * radial * (np.cos(m * angle) if m > 0 else np.sin(-m * angle))


def noll_orders(noll: int) -> tuple[int, int]:
    """Radial order n and azimuthal order m (negative: sine) of Noll's index."""
    n = int((math.sqrt(8.0 * noll - 7.0) - 1.0) / 2.0)
    place = noll - n * (n + 1) // 2 - 1
    m = 2 * ((place + 1 - n % 2) // 2) + n % 2
    return n, m if noll % 2 == 0 else -m


def intensity(pixels: np.ndarray, offsets_px: np.ndarray, *, lambda_n_px: np.ndarray, weights: np.ndarray,
              obscuration: float, phase: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> np.ndarray:
    """Point spread function at the points `pixels + offsets_px` of both axes.

    Parameters
    ----------
    pixels : (P,) int [px]
        One after the other.
    offsets_px : (Q,) float [px]
        Added to each pixel.
    lambda_n_px, weights : (N,) float [px], [1]
        Wavelengths times f-number, and their shares of the light.
    obscuration : float [1], 0..0.95
    phase : function of x, y (...) [1] -> (...) [rad]
        Wavefront in the pupil at the first wavelength; it falls with the wavelength. A rising phase
        moves the image towards positive coordinates.

    Returns
    -------
    (P Q, P Q) float64 [1/px2]
        Row: y. Its integral over the plane is the sum of the weights.

    Source: Fraunhofer diffraction integral, Born & Wolf, Principles of Optics, section 8.3.3; weights
    of the chords: Gauss-Chebyshev of the second kind.
    """
    wavenumbers = math.pi / np.asarray(lambda_n_px)
    # The farthest points are on the diagonal.
    reach = math.sqrt(2.0) * (np.abs(pixels).max() + np.abs(offsets_px).max())
    shrinkage = lambda_n_px[0] / np.asarray(lambda_n_px)
    n = math.ceil(0.5 * (wavenumbers.max() * reach + shrinkage.max() * _steepness(phase))) + _SPARE_NODES
    # An annulus is the disc less its inner disc.
    discs = [_nodes(radius, n) for radius in (1.0, obscuration)[:1 + (obscuration > 0.0)]]
    phases = [phase(np.broadcast_to(x[:, None], y.shape), y) for x, y, _ in discs]
    area = math.pi * (1.0 - obscuration**2)
    total = 0.0
    for wavenumber, weight, shrunk in zip(wavenumbers, weights, shrinkage, strict=True):
        field = sum(sign * _transform(pixels, offsets_px, wavenumber, disc, shrunk * wavefront)
                    for sign, disc, wavefront in zip((1.0, -1.0), discs, phases, strict=False))
        # Parseval: pupil coordinates are in radii, so frequencies in 1 / (2 lambda N).
        total = total + weight * (wavenumber / (2.0 * math.pi)) ** 2 / area * (field.real**2 + field.imag**2)
    return total


def _nodes(radius: float, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Chords of a disc: x (n,), y on each (n, n), and weights (n, n) of an integral over it."""
    angle = np.arange(1, n + 1) * (math.pi / (n + 1))
    node, node_weight = np.polynomial.legendre.leggauss(n)
    weight = math.pi / (n + 1) * (radius * np.sin(angle)[:, None]) ** 2 * node_weight
    return radius * np.cos(angle), radius * np.sin(angle)[:, None] * node, weight


def _transform(pixels, offsets_px, wavenumber, disc, phase):
    """Integral of exp(i phase - i k r x) over a disc, at all points."""
    x, y, weight = disc
    pupil = weight * np.exp(1j * phase)
    # exp(-i k y (p + q)) is a product, and the pixels are a row of numbers: few exponentials for many points.
    at_pixel = np.empty((len(x), len(pixels), y.shape[1]), complex)
    at_pixel[:, 0] = np.exp(-1j * wavenumber * pixels[0] * y)
    at_pixel[:, 1:] = np.exp(-1j * wavenumber * y)[:, None, :]
    np.cumprod(at_pixel, axis=1, out=at_pixel)
    at_offset = np.exp(-1j * wavenumber * y[:, :, None] * offsets_px) * pupil[:, :, None]
    chords = (at_pixel @ at_offset).reshape(len(x), -1)
    points = (pixels[:, None] + offsets_px).ravel()
    return chords.T @ np.exp(-1j * wavenumber * x[:, None] * points)


def _steepness(phase) -> float:
    """Largest slope of the phase on the pupil [rad per radius]."""
    line = np.linspace(-1.0, 1.0, 65)
    x, y = np.meshgrid(line, line)
    inside = np.hypot(x, y) <= 1.0
    slopes = np.gradient(np.where(inside, phase(x, y), np.nan), line, line)
    return float(np.nanmax(np.hypot(*slopes)))
