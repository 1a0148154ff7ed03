"""Black and white of pictures for the eye: from the sky, wherever the offset puts it, to the brightest light."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

# Pixels that the sky is found of, spread over the image.
_SAMPLE_PX = 100_000
# Shares of the pixels, sorted: the sky's darkest, and where the search for its middle begins.
_LOW, _START = 0.001, 0.05
# The mirror's distance above the middle over that of the darkest below: where all values are as frequent, as on a body
# without sky, the search ends at the darkest.
_MIRROR, _STEPS = 0.9, 64
# The median distance below the middle of a normal distribution is its sigma over this.
_SIGMA_OF_MEDIAN = 1.4826
# A sky's pixels differ from their neighbours as much as from each other, to this factor of sigma; those of a body that
# fills the frame do not. The differences of two normal values have a median of this times sigma.
_ALIKE, _MEDIAN_DIFFERENCE = 1.4, 0.9539
# A sky is at most so far above the detector's offset, of the way to the largest number: dark signal and stray light.
_MOST_SKY = 0.25
# Depths of detectors [bit] whose largest number, where most pixels have it, is light.
_BIT_DEPTHS = range(8, 17)
# Light is that much above the sky, in sigma; white is at least so far, that noise stays dark.
_LIT_SIGMA, _LEAST_SIGMA = 5.0, 20.0
# Least sigma of the noise [DN]: the step of whole numbers.
_LEAST_DN = 1.0
_BRIGHTEST = 0.999
_GOLDEN = 0.6180339887498949


def black_and_white(images: Iterable[np.ndarray], offset_DN: float | None = None) -> tuple[float, float]:
    """The levels that are black and white in pictures of some images.

    Parameters
    ----------
    images : iterable of (height, width) array
        Digital numbers (of an integer type), or irradiance, whose black is 0.
    offset_DN : float [DN], optional
        Offset of the detector, where it is known. Without it a frame that light fills evenly may be taken for sky.

    Returns
    -------
    black : float
        The sky: the least of all images'. Where there is none, the offset, or else the darkest thousandth; 0 where
        the whole image is saturated.
    white : float
        Above black; what 0.1 % of the lit pixels of any image are above, be they few, and at least 20 sigma of a
        sky's noise from it.
    """
    found = [_levels(np.asarray(image), offset_DN) for image in images]
    black = min((each[0] for each in found), default=0.0)
    white = max((each[1] for each in found), default=0.0)
    return black, white if white > black else black + 1.0


def _levels(image: np.ndarray, offset_DN: float | None) -> tuple[float, float]:
    if image.dtype.kind not in "iu":
        lit = image[image > 0.0]
        return 0.0, float(np.quantile(lit, _BRIGHTEST)) if lit.size else 0.0
    rows = image[::max(image.size // _SAMPLE_PX, 1)].astype(np.float64)
    # Equal numbers are spread evenly over the step that was rounded away.
    rows += np.arange(rows.size).reshape(rows.shape) * _GOLDEN % 1.0 - 0.5
    values = np.sort(rows, axis=None)
    darkest, largest = float(image.min()), float(image.max())
    black = max(_sky(values), darkest)
    below = black - values[:np.searchsorted(values, black, side="right")]
    sigma = max(_SIGMA_OF_MEDIAN * float(np.median(below)), _LEAST_DN)
    is_sky = sigma <= _ALIKE * _noise(rows) and (
        black not in [2**bits - 1 for bits in _BIT_DEPTHS] if offset_DN is None
        else black - offset_DN <= max(_MOST_SKY * (largest - offset_DN), _LIT_SIGMA * sigma))
    lit = image[image > black + _LIT_SIGMA * sigma]
    brightest = float(np.quantile(lit if lit.size else image, _BRIGHTEST))
    if is_sky:
        return black, max(brightest, black + _LEAST_SIGMA * sigma)
    if offset_DN is None:
        offset_DN = max(values[int(_LOW * len(values))], darkest)
    # Light that is the same all over the image has nothing darker than itself.
    return offset_DN if offset_DN < brightest else 0.0, brightest


def _noise(rows: np.ndarray) -> float:
    """The sigma [DN] of pixels (rows, columns) about their neighbours in the row."""
    steps = np.abs(np.diff(rows, axis=1))
    return max(float(np.median(steps)) / _MEDIAN_DIFFERENCE if steps.size else 0.0, _LEAST_DN)


def _sky(values: np.ndarray) -> float:
    """The middle of the darkest pixels: the median of those that a mirror at it leaves as far above as below.

    Parameters
    ----------
    values : (N,) float, rising
    """
    low, sky = values[int(_LOW * len(values))], values[int(_START * len(values))]
    for _ in range(_STEPS):
        middle = max(values[(np.searchsorted(values, sky + _MIRROR * (sky - low), side="right") - 1) // 2], low)
        if middle == sky:
            break
        sky = middle
    return float(sky)
