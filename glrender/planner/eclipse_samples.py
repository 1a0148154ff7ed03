"""The error of samples that meet one point of the Sun's disc each, on a body in another's penumbra. Pure.

A pixel whose samples agree may still have other points of the disc: where few points are hidden, or few are free,
most pixels show none of these. The share that an eclipse leaves is therefore taken from more than a pixel.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from .adaptive_samples import Refinement, pixel_means, plan_refinement
from .error_model import lit_share

ECLIPSE_POWER = 2.5
"""Power of the samples along a pixel's side that divides the squared error."""
# Error of n x n samples of a pixel, times n^1.25, over the deviation of one [1], and error of the total over that of
# independent samples [1]: a sphere of 2 to 40 px in three penumbras, 2 to 192 samples, against closed forms
# (tests/planner/test_eclipse_samples.py).
_PIXEL_ERROR = 1.3
_FLUX_ERROR = 1.5
# Width of a penumbra [px] below which places in a pixel have eclipses of their own, and what that costs at most [1]:
# the same data.
_NARROW_PX, _MOST_GAIN = 3.0, 2.0
# Side of the square in which the share that is left is even, over the penumbra's width [1], and at least [px].
_EVEN_SHARE, _LEAST_EVEN_PX = 0.25, 1.5
# Samples across a small body's own grid by which its light without an eclipse is known to 0.2 %, at full phase.
_BARE_SAMPLES = 96
# Times that a tolerance is halved for the total's sake, at most.
_MOST_HALVINGS = 6


def sample_variances(samples: np.ndarray, bare: np.ndarray, count: int, width_px: float
                     ) -> tuple[np.ndarray, np.ndarray]:
    """Variance (height, width) float32 of one sample of a pixel by the point of the Sun's disc that it meets.

    And the share (height, width) float32 of its light that the penumbra leaves: that of all where none near is lit.

    Parameters
    ----------
    samples : (height * count, width * count) float32
    bare : (height * count, width * count) float32
        The same without the bodies that cast the penumbra.
    count : int
        Samples along each side of a pixel.
    width_px : float [px]
        Of the penumbra.
    """
    # In units of the brightest sample: a square must not underflow.
    scale = float(bare.max()) or 1.0
    reach = int(min(0.5 * count * max(_EVEN_SHARE * width_px, _LEAST_EVEN_PX), max(bare.shape)))
    left, light = (cv2.blur(each / scale, (2 * reach + 1,) * 2, borderType=cv2.BORDER_CONSTANT)
                   for each in (samples, bare))
    left = np.clip(left / np.maximum(light, 1e-12), 0.0, 1.0)
    variance = scale**2 * pixel_means(np.square(bare / scale) * left * (1.0 - left), count)
    of_all = min(float(samples.sum(dtype=float) / bare.sum(dtype=float)), 1.0) if bare.any() else 1.0
    return variance, pixel_means(np.where(light > 1e-12, left, np.float32(of_all)), count)


def pixel_errors(variance: np.ndarray, count: int, width_px: float) -> np.ndarray:
    """Error (height, width) of pixels of n x n samples, of the variance of one and the penumbra's width [px]."""
    gain = min(max(_NARROW_PX / width_px, 1.0), _MOST_GAIN)
    return gain * _PIXEL_ERROR * count ** (-0.5 * ECLIPSE_POWER) * np.sqrt(variance)


def flux_error(mean: np.ndarray, variance: np.ndarray, count: np.ndarray | int) -> float:
    """Relative error of the total [1] of pixels (height, width) of n x n samples, n in each or in all."""
    total = float(mean.sum(dtype=np.float64))
    squared = float((variance / np.square(count, dtype=np.float64)).sum(dtype=np.float64))
    return _FLUX_ERROR * math.sqrt(squared) / total if total > 0.0 else 0.0


def grid_flux_error(samples: np.ndarray, bare: np.ndarray) -> float:
    """Relative error of the total [1] of a grid of samples, of which another grid has the light without an eclipse.

    0 where no sample has light, and 1 where those without an eclipse have none.
    """
    light, left = float(bare.mean(dtype=np.float64)), float(samples.mean(dtype=np.float64))
    if not left > 0.0:
        return 0.0
    if not light > 0.0:
        return 1.0
    scatter = float(np.square(bare / light, dtype=np.float64).mean())
    # If no lit sample is hidden, the hidden share is taken as that of one sample.
    dark_over_lit = max(light / left - 1.0, 1.0 / np.count_nonzero(bare))
    return _FLUX_ERROR * math.sqrt(scatter * dark_over_lit / samples.size)


def grid_pixel_error(flux_error: float, size_px: float, phase_rad: float) -> float:
    """RMS error [1] over the mean of the lit pixels, of a body of so many pixels whose total errs by `flux_error` [1].

    Pixels err on their own: of n that are lit each errs by the root of n times the total's error, or all as it does.
    """
    return flux_error * math.sqrt(1.0 + 0.25 * math.pi * size_px**2 * lit_share(phase_rad))


def bare_samples(phase_rad: float, most: tuple[int, int]) -> tuple[int, int]:
    """Columns and rows of samples by which a small body's light without an eclipse is known well enough.

    The light of a crescent needs more, in proportion to its narrowness: `small_body_grid.sampling_errors`.
    """
    return tuple(min(n, math.ceil(_BARE_SAMPLES / lit_share(phase_rad))) for n in most)


def counts(refinement: Refinement | None, count: int) -> np.ndarray | int:
    """Samples along the side of each pixel (height, width) float32 after a refinement, or one number for all."""
    if refinement is None:
        return count
    return np.where(refinement.mask > 0, np.float32(refinement.samples), np.float32(count))


def holding_flux(refinement: Refinement | None, mean: np.ndarray, error: np.ndarray, variance: np.ndarray, count: int,
                 tolerance: float, flux_tolerance: float, most: float) -> Refinement | None:
    """A refinement by which the error of the total is within a tolerance [1] too, or the best there is.

    Parameters
    ----------
    refinement : Refinement or None
        By `plan_refinement`, for a tolerance of the RMS error; the other arguments are that function's.
    variance : (height, width) float32
        Of `sample_variances`.
    """
    for _ in range(_MOST_HALVINGS):
        is_best = refinement is not None and refinement.predicted_error > tolerance
        if is_best or flux_error(mean, variance, counts(refinement, count)) <= flux_tolerance:
            break
        tolerance *= 0.5
        refinement = plan_refinement(mean, error, count, tolerance, ECLIPSE_POWER, most) or refinement
    return refinement
