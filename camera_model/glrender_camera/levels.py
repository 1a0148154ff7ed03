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
# Light is that much above the sky, in sigma; white is at least so far, that noise stays dark.
_LIT_SIGMA, _LEAST_SIGMA = 5.0, 20.0
# Of the noise's sigma: whole numbers have steps of this.
_LEAST_DN = 1.0
_BRIGHTEST = 0.999
_GOLDEN = 0.6180339887498949


def black_and_white(images: Iterable[np.ndarray]) -> tuple[float, float]:
    """The levels that are black and white in pictures of some images.

    Parameters
    ----------
    images : iterable of (height, width) array
        Digital numbers (of an integer type), or irradiance, whose black is 0.

    Returns
    -------
    black : float
        The sky: the least of all images'; the darkest thousandth where there is no sky.
    white : float
        Above black; what 0.1 % of the lit pixels of any image are above, be they few, and at least 20 sigma of the
        sky's noise from black.
    """
    found = [_levels(np.asarray(image)) for image in images]
    black = min((each[0] for each in found), default=0.0)
    white = max((each[1] for each in found), default=0.0)
    return black, white if white > black else black + 1.0


def _levels(image: np.ndarray) -> tuple[float, float]:
    if image.dtype.kind not in "iu":
        lit = image[image > 0.0]
        return 0.0, float(np.quantile(lit, _BRIGHTEST)) if lit.size else 0.0
    flat = image.ravel()
    sample = flat[::max(flat.size // _SAMPLE_PX, 1)].astype(np.float64)
    # Equal numbers are spread evenly over the step that was rounded away.
    values = np.sort(sample + np.arange(sample.size) * _GOLDEN % 1.0 - 0.5)
    sky = max(_sky(values), float(flat.min()))
    below = sky - values[:np.searchsorted(values, sky, side="right")]
    sigma = max(_SIGMA_OF_MEDIAN * float(np.median(below)), _LEAST_DN)
    lit = flat[flat > sky + _LIT_SIGMA * sigma]
    brightest = float(np.quantile(lit, _BRIGHTEST)) if lit.size else sky
    return sky, max(brightest, sky + _LEAST_SIGMA * sigma)


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
