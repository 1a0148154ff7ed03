"""Kernels for images whose pixels hold the mean over their area: the point spread function without the pixel.

A rendered pixel has been averaged over once. A kernel that averages over it again, as a point's must, widens all by
1/12 px^2 an axis. Here is the kernel with the least error at a limb instead. Of edges at any place between the pixels,
whose power falls with the square of the frequency, the best linear estimate of what the detector sees interpolates the
pixels by a cubic spline, spreads that and reads it at the pixels' centres. Where the point spread function is
narrow, sigma < 0.7 px, that undershoots near an edge; light cannot, so pixels below zero are filled up from
their neighbours.

Source: Unser (1999), Splines: a perfect fit for signal and image processing, IEEE Signal Proc. Mag. 16(6), 22.
"""

from __future__ import annotations

import math

import numpy as np
import scipy
from scipy.special import erf

# From here on a Gaussian and the spline through its samples are the same within 4e-6 of its sum.
_SAMPLED_SIGMA_PX = 2.0
# The inverse of the spline's samples falls by 0.27 a pixel: 1e-9 beyond.
_SPLINE_REACH_PX = 16
_MOST_PASSES, _NEGLIGIBLE = 200, 1e-10
_BESIDE = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 1.0], [0.0, 1.0, 0.0]])


def gaussian_image_axis(sigma_px: float, radius_px: int) -> np.ndarray:
    """Gaussian along one axis, for images: (2 radius + 1,) float64 [1], its sum 1.

    Its variance is sigma^2 within 0.005 px^2 from 0.65 px on; up to 0.07 px^2 more below, where the pixels do not
    resolve more.

    Parameters
    ----------
    sigma_px : float [px], >= 0
    radius_px : int [px]
    """
    if sigma_px == 0.0:
        return np.eye(1, 2 * radius_px + 1, radius_px)[0]
    axis = from_splines(spline_weights(np.zeros(1), sigma_px, radius_px + _SPLINE_REACH_PX).T)[0]
    axis = axis[_SPLINE_REACH_PX:-_SPLINE_REACH_PX]
    return axis / axis.sum()


def spline_weights(x_px: np.ndarray, sigma_px: float, radius_px: int) -> np.ndarray:
    """(2 radius + 1, N): share of the light at each x, blurred by a Gaussian, under each pixel's cubic B-spline.

    The shares of an x sum to 1; `from_splines` makes a kernel of their sum over a point spread function.
    """
    offset = np.arange(-radius_px, radius_px + 1)[:, None] - np.asarray(x_px)[None, :]
    if sigma_px > _SAMPLED_SIGMA_PX:
        steps = ((1.0 / 6.0, -1.0), (4.0 / 6.0, 0.0), (1.0 / 6.0, 1.0))
        return sum(c * np.exp(-0.5 * ((offset + shift) / sigma_px) ** 2) for c, shift in steps) / (
            math.sqrt(2.0 * math.pi) * sigma_px)
    # A B-spline is the fourth difference of the cube; blurred, of the Gaussian's fourth integral.
    steps = zip((1.0, -4.0, 6.0, -4.0, 1.0), (2.0, 1.0, 0.0, -1.0, -2.0), strict=True)
    return np.maximum(sum(c * _fourth_integral(offset + shift, sigma_px) for c, shift in steps), 0.0)


def from_splines(weights: np.ndarray) -> np.ndarray:
    """The kernel (..., n, m) of a point spread function's light under each pixel's B-spline; no value is below 0."""
    kernel = np.asarray(weights, np.float64)
    for axis in (-2, -1):
        if kernel.shape[axis] > 1:
            kernel = scipy.ndimage.spline_filter1d(kernel, 3, axis=axis, mode="mirror")
    return non_negative(kernel)


def without_pixel(kernel: np.ndarray) -> np.ndarray:
    """A measured kernel (..., n, m), which holds the pixel, without it: 1/12 px^2 less an axis, while it is >= 0."""
    for axis in (-2, -1):
        # Reflected at the rim: no light leaves the kernel.
        kernel = scipy.ndimage.convolve1d(kernel, np.array([-1.0, 26.0, -1.0]) / 24.0, axis=axis, mode="reflect")
    return non_negative(kernel)


def measured_between(kernel: np.ndarray, parts: int) -> np.ndarray:
    """A measured kernel, known for points at pixel centres, at places so many a pixel and axis; for points anywhere.

    A cubic spline through it; what that undershoots is cut off, and sum and centre of light are put right.

    Parameters
    ----------
    kernel : (..., n, m) float64, >= 0
    parts : int
        Odd.

    Returns
    -------
    (..., parts (n + 3) + 1, parts (m + 3) + 1) float64
        The place k is k / parts - 2 px from the kernel's first pixel; a point between pixels has every
        `parts`-th.
    """
    leading, (n, m) = kernel.shape[:-2], kernel.shape[-2:]
    fine = np.zeros((*leading, parts * (n + 3) + 1, parts * (m + 3) + 1))
    steps = np.arange(-(parts // 2), parts // 2 + 1)
    for node in np.ndindex(leading):
        room = np.pad(kernel[node], _SPLINE_REACH_PX)
        splines = room
        for axis in (0, 1):
            splines = scipy.ndimage.spline_filter1d(splines, 3, axis=axis, mode="mirror")
        for i in steps:
            for j in steps:
                seen = scipy.ndimage.shift(splines, (i / parts, j / parts), order=3, mode="constant", prefilter=False)
                rim = _SPLINE_REACH_PX - 1
                fine[node][parts - i::parts, parts - j::parts][:n + 2, :m + 2] = _put_right(
                    seen[rim:-rim, rim:-rim], kernel[node], (i / parts, j / parts))
    return fine


def _put_right(seen: np.ndarray, kernel: np.ndarray, offset_px: tuple[float, float]) -> np.ndarray:
    """A kernel (n + 2, m + 2) of a point at an offset: none below 0, with the sum and the place of one (n, m)."""
    # A point's light reaches a pixel farther on its side alone.
    rows, columns = (slice(int(offset >= 0.0), n - (offset <= 0.0)) for offset, n in
                     zip(offset_px, seen.shape, strict=True))
    kept = np.zeros_like(seen)
    kept[rows, columns] = np.maximum(seen[rows, columns], 0.0)
    kept *= kernel.sum() / kept.sum()
    for axis, offset in enumerate(offset_px):
        lines = np.moveaxis(kept[rows, columns], axis, 0)
        light = lines.sum(axis=1)
        first = 1 - (rows, columns)[axis].start
        wanted = first + offset + _centre(np.moveaxis(kernel, axis, 0).sum(axis=1))
        step = (wanted - _centre(light)) * light.sum()
        back, on = (np.s_[:-1], np.s_[1:]) if step > 0.0 else (np.s_[1:], np.s_[:-1])
        if light[back].sum() > abs(step) > 0.0:
            moved = lines[back] * (abs(step) / light[back].sum())
            lines[back] -= moved
            lines[on] += moved
    return kept


def _centre(light: np.ndarray) -> float:
    return float(light @ np.arange(len(light)) / light.sum())


def non_negative(kernel: np.ndarray) -> np.ndarray:
    """Fill up weights below zero from their four neighbours, in equal parts as far as these have light.

    Parameters
    ----------
    kernel : (..., n, m) float64

    Returns
    -------
    (..., n, m) float64, >= 0
        Kernels of the same sum.
    """
    return np.array([_filled(part) for part in kernel.reshape(-1, *kernel.shape[-2:])]).reshape(kernel.shape)


def _filled(kernel: np.ndarray) -> np.ndarray:
    total = kernel.sum()
    for _ in range(_MOST_PASSES):
        debt = np.maximum(-kernel, 0.0)
        if debt.max() < _NEGLIGIBLE * total:
            break
        light = np.maximum(kernel, 0.0)
        n_payers = scipy.ndimage.convolve((light > 0.0).astype(float), _BESIDE, mode="constant")
        # A debt with no lit neighbour waits until light has come nearer.
        each = np.where(n_payers > 0.0, debt / np.maximum(n_payers, 1.0), 0.0)
        asked = scipy.ndimage.convolve(each, _BESIDE, mode="constant") * (light > 0.0)
        paid = np.divide(np.minimum(asked, light), asked, out=np.zeros_like(light), where=asked > 0.0)
        kernel = light - paid * asked - debt + each * scipy.ndimage.convolve(paid, _BESIDE, mode="constant")
    kernel = np.maximum(kernel, 0.0)
    return kernel * (total / kernel.sum())


def _fourth_integral(x: np.ndarray, sigma_px: float) -> np.ndarray:
    """The fourth integral of a Gaussian of unit area: x^3 / 6 far to its right."""
    if sigma_px == 0.0:
        return np.maximum(x, 0.0) ** 3 / 6.0
    z = x / sigma_px
    below = 0.5 * (1.0 + erf(z / math.sqrt(2.0)))
    density = np.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)
    return sigma_px**3 * ((z**3 + 3.0 * z) * below + (z * z + 2.0) * density) / 6.0
