"""Samples where they matter: the error of a first, coarse image by its contrast, and the pixels to draw again.

Most of a frame's sampling error sits in few of its pixels: limb, terminator, shadow edges,
creases. Contrast shows them: between neighbours when a pixel has one sample, between its
samples when it has more. Samples along an edge that lies along a row or a column of the image err alike.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from .engine_choice import MAX_SAMPLES
from .small_body_grid import SAMPLE_COUNTS

ERROR_PER_CONTRAST = 0.235
"""Error of a sample's area over the contrast within 3 x 3 samples [1]: 0.18 as measured against rays
(docs/accuracy.md), times 1.3, so that the truth is within."""
# Pixels in a row of which an edge crosses no row of samples.
_RUN_PX = 9
# Values by which pixels are sorted by their errors.
_BINS = 256


@dataclass(frozen=True, kw_only=True, eq=False)
class Refinement:
    """Pixels to be drawn again.

    Attributes
    ----------
    samples : int
        Along each side of a pixel.
    mask : (height, width) uint8
        1 where a pixel is drawn again.
    predicted_error : float [1]
        RMS error over the mean of the lit pixels, afterwards.
    """

    samples: int
    mask: np.ndarray
    predicted_error: float

    @property
    def share(self) -> float:
        """Shape of the window's pixels."""
        return float(self.mask.mean())


def pixel_errors(samples: np.ndarray, count: int, noise_gain: float = 1.0,
                 dark_sides: tuple[bool, bool, bool, bool] = (False,) * 4) -> tuple[np.ndarray, np.ndarray]:
    """Pixel means, and the error expected of each, (height, width) float32 in the samples' unit.

    Parameters
    ----------
    samples : (height * count, width * count) float32
    count : int
        Samples along each side of a pixel.
    noise_gain : float
        Error over that of an edge of the same contrast: `error_model.noise_gain`.
    dark_sides : (top, left, bottom, right)
        Beyond which it is known to be dark; beyond others it is taken to go on as it is.
    """
    padded = cv2.copyMakeBorder(samples, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    top, left, bottom, right = dark_sides
    for is_dark, edge in ((top, np.s_[0]), (left, np.s_[:, 0]), (bottom, np.s_[-1]), (right, np.s_[:, -1])):
        if is_dark:
            padded[edge] = 0.0
    # In place: new memory costs more than the computation.
    ranges = contrast(padded, padded)[1:-1, 1:-1]
    if count == 1:
        return samples, noise_gain * ERROR_PER_CONTRAST * ranges
    # Each sample errs by its own contrast, on its own: edges give n^-1.5, noise everywhere n^-1.
    # In units of the brightest sample: a square must not underflow.
    scale = float(samples.max()) or 1.0
    ranges *= 1.0 / scale
    squared = pixel_means(np.multiply(ranges, ranges, out=ranges), count)
    return pixel_means(samples, count), noise_gain * ERROR_PER_CONTRAST * scale / count * np.sqrt(squared)


def aligned_errors(mean: np.ndarray, count: int) -> np.ndarray:
    """Errors (height, width) float32 of pixels at edges along a row or a column; 0 elsewhere.

    All samples along such an edge are on the same side of it: their error falls as n^-1, and is the same in many
    pixels. Edges are those by which a run of pixels differs from what is at its sides, and not within itself.

    Parameters
    ----------
    mean : (height, width) float32
        Of `pixel_errors`.
    count : int
        Samples along each side of a pixel.
    """
    brightest = float(mean.max(initial=0.0))
    if not brightest > 0.0:
        return np.zeros(mean.shape, np.float32)
    level = cv2.convertScaleAbs(mean, alpha=np.iinfo(np.uint8).max / brightest)
    found, padded = np.zeros_like(level), cv2.copyMakeBorder(level, 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    for run, low, high in ((np.ones((1, _RUN_PX), np.uint8), padded[:-2, 1:-1], padded[2:, 1:-1]),
                           (np.ones((_RUN_PX, 1), np.uint8), padded[1:-1, :-2], padded[1:-1, 2:])):
        step, within = cv2.absdiff(high, low), cv2.subtract(cv2.dilate(level, run), cv2.erode(level, run))
        # One sample more or less in each row changes a mean by the step over the count; half of that is no edge's.
        is_run = step // min(2 * count, np.iinfo(np.uint8).max) > within
        cv2.max(found, step * cv2.dilate(is_run.view(np.uint8), run), dst=found)
    # RMS distance of a place from the middle of a sample's side; contrast across three pixels shows each edge in more
    # than one of them, 1.3 times in all.
    alike = 1.0 / math.sqrt(12.0) / 1.3
    return found * np.float32(alike * brightest / np.iinfo(np.uint8).max / count)


def contrast(values: np.ndarray, spare: np.ndarray | None = None) -> np.ndarray:
    """The range of values (height, width) within 3 x 3; a spare array, which may be theirs, is written over."""
    around = np.ones((3, 3), np.uint8)
    high = cv2.dilate(values, around)
    return cv2.subtract(high, cv2.erode(values, around, dst=spare), dst=high)


def pixel_means(samples: np.ndarray, count: int) -> np.ndarray:
    """Means (height, width) of count x count samples each."""
    size = (samples.shape[1] // count, samples.shape[0] // count)
    return cv2.resize(samples, size, interpolation=cv2.INTER_AREA)


def frame_error(mean: np.ndarray, error: np.ndarray) -> float:
    """RMS of the pixels' errors over the mean of the lit pixels [1]; 0 where nothing is lit."""
    n_lit, total = int(np.count_nonzero(mean > 0.0)), float(mean.sum(dtype=np.float64))
    if not total > 0.0:
        return 0.0
    # No product of vectors: BLAS keeps threads of its own spinning for a tenth of a second.
    return math.sqrt(float(np.square(error, dtype=np.float64).sum())) * math.sqrt(n_lit) / total


def plan_refinement(mean: np.ndarray, error: np.ndarray, count: int, tolerance: float,
                    power: float = 3.0, most: float = 0.0, is_aligned: np.ndarray | None = None) -> Refinement | None:
    """The cheapest refinement that meets a tolerance.

    Parameters
    ----------
    mean, error : (height, width) float32
        Of `pixel_errors`.
    count : int
        Samples along a pixel's side that `mean` was drawn with.
    tolerance : float [1]
        RMS error over the mean of the lit pixels.
    power : float
        n x n samples have n^-power of one sample's squared error: 3 at edges, 2 in noise.
    most : float
        Samples along a pixel's side that may be taken if they are more than 16.
    is_aligned : (height, width) bool, optional
        Pixels whose error is that of `aligned_errors`: n x n samples leave n^-2 of its square.

    Returns
    -------
    Refinement or None
        None where the tolerance is met, or nothing is lit. Where no refinement meets the tolerance, the
        best there is.
    """
    if frame_error(mean, error) <= tolerance:
        return None
    n_lit, largest = int(np.count_nonzero(mean > 0.0)), float(error.max())
    scale = n_lit * float(mean.sum(dtype=np.float64) / n_lit) ** 2
    # Bins even in the root of the error: fine where pixels are many.
    index = (np.sqrt(error / largest) * (_BINS - 1)).astype(np.uint8)
    population = np.bincount(index.ravel(), minlength=_BINS).astype(np.float64)
    squared = population * (largest * ((np.arange(_BINS) + 0.5) / (_BINS - 1)) ** 2) ** 2 / scale
    squared[0] = 0.0
    # Refined are the bins from k on, for each k and each count of samples.
    above = np.cumsum(squared[::-1])[::-1]
    of_aligned = np.zeros(_BINS)
    if is_aligned is not None and is_aligned.any():
        share = np.bincount(index[is_aligned], minlength=_BINS) / np.maximum(population, 1.0)
        of_aligned = np.cumsum((squared * share)[::-1])[::-1]
    refined = np.cumsum(population[::-1])[::-1]
    choices = []
    for samples in SAMPLE_COUNTS:
        if samples <= count or samples > max(MAX_SAMPLES, most):
            continue
        finer = count / samples
        left = above[0] - above + (above - of_aligned) * finer**power + of_aligned * finer**2
        meets = np.flatnonzero(left <= tolerance**2)
        first = int(meets[-1]) if len(meets) else 1
        cost = samples**2 * refined[first] if len(meets) else -samples
        choices.append((not len(meets), cost, samples, first, float(np.sqrt(left[first]))))
    if not choices:
        return None
    _, _, samples, first, reached = min(choices)
    return Refinement(samples=samples, mask=(index >= first).astype(np.uint8), predicted_error=reached)
