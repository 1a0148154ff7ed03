"""Exact Poisson numbers for a whole image, several times faster than one call per pixel.

Two methods, chosen per pixel by its mean, both exact but for float64 rounding; no normal
approximation anywhere (photometry.md section 4.6). `Generator.poisson` costs 30 to 90 ms per
megapixel on the machines this was written for; these are vectorised and take about a fifth.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr, pdtr, pdtrc

# Below this mean by table, above by the series of `_large`, whose doubts are rare there.
_SMALL = 32
_LEVELS_PER_ELECTRON = 8
_CELLS = 2048
# P(n > 96) is 1e-19 at mean 32: beyond what a float64 in [0, 1) can ask for.
_N_COUNTS = 96
_UNDECIDED = 255


def _tables() -> tuple[np.ndarray, np.ndarray]:
    """Cumulative probabilities of each level's mean, and the count of each cell of [0, 1)."""
    means = np.arange(_SMALL * _LEVELS_PER_ELECTRON) / _LEVELS_PER_ELECTRON
    cumulative = pdtr(np.arange(_N_COUNTS)[None, :], means[:, None])
    edges = np.arange(_CELLS + 1) / _CELLS
    counts = np.array([np.searchsorted(row, edges, side="right") for row in cumulative])
    decided = np.array([np.searchsorted(row, edges[1:], side="left") for row in cumulative]) == counts[:, :-1]
    return cumulative, np.where(decided, counts[:, :-1], _UNDECIDED).astype(np.uint8).ravel()


_CUMULATIVE, _COUNT_OF_CELL = _tables()


def draw(rng: np.random.Generator, mean: np.ndarray) -> np.ndarray:
    """One Poisson number for each mean.

    Parameters
    ----------
    rng : Generator
    mean : (N,) float32 [1], 0..1e9
        Trusted: finite and not negative.

    Returns
    -------
    (N,) float32 [1]
        Integers; above 2**24 they are rounded to float32.

    Source: inversion; below a mean of 32 with the additivity of Poisson numbers, above after Giles
    (2016), "Algorithm 955: approximation of the inverse Poisson cumulative distribution function".
    """
    large = mean >= _SMALL
    n_large = np.count_nonzero(large)
    if n_large == mean.size:
        return _large(rng, mean)
    if n_large == 0 and mean.all():
        return _small(rng, mean)
    out = np.zeros(mean.shape, np.float32)
    if n_large:
        index = np.flatnonzero(large)
        out[index] = _large(rng, mean[index])
    index = np.flatnonzero((mean > 0.0) & ~large)
    if index.size:
        out[index] = _small(rng, mean[index])
    return out


def _small(rng: np.random.Generator, mean: np.ndarray) -> np.ndarray:
    """0 <= mean < 32: the number at the next lower tabulated mean, plus that of the remainder."""
    level = (mean * np.float32(_LEVELS_PER_ELECTRON)).astype(np.intp)
    remainder = mean - level * np.float32(1.0 / _LEVELS_PER_ELECTRON)
    uniform = rng.random(mean.size)
    second = uniform * _CELLS
    cell = second.astype(np.intp)
    # The place inside a decided cell says nothing about the count: a second, independent uniform.
    second -= cell
    cell += level * _CELLS
    count = _COUNT_OF_CELL.take(cell, mode="clip")
    undecided = np.flatnonzero(count == _UNDECIDED)
    if undecided.size:
        below = _CUMULATIVE[level[undecided]] <= uniform[undecided, None]
        count[undecided] = np.count_nonzero(below, axis=1)
        second[undecided] = rng.random(undecided.size)
    count = count.astype(np.float32)
    # exp(-x) >= 1 - x spares the exponential of all that surely add nothing.
    second += remainder
    index = np.flatnonzero(second >= 1.0)
    if index.size:
        rate = remainder[index].astype(np.float64)
        uniform = second[index] - rate
        term = np.exp(-rate)
        cumulative, extra, k = term.copy(), np.zeros(index.size, np.float32), 0
        while (more := uniform >= cumulative).any() and k < _N_COUNTS:
            extra += more
            k += 1
            term *= rate / k
            cumulative += term
        count[index] += extra
    return count


def _large(rng: np.random.Generator, mean: np.ndarray) -> np.ndarray:
    """mean >= 32: the quantile at a normal deviate's probability, by a series with a known bound.

    The Cornish-Fisher series gives a real number whose integer part is the count unless it lies
    within `doubt` of an integer; those few are looked up in the distribution itself.
    """
    mean = mean.astype(np.float64)
    w = rng.standard_normal(mean.size)
    root = np.sqrt(mean)
    ww = w * w
    # mean + root w + (2 + w^2) / 6 - w (2 + w^2) / (72 root)
    x = ww + 2.0
    series = w * x
    series /= root
    series *= -1.0 / 72.0
    x *= 1.0 / 6.0
    x += series
    np.multiply(root, w, out=series)
    x += series
    x += mean
    k = np.floor(x)
    x -= k
    x -= 0.5
    # Half as much again as Giles's bound: right for all |w| < 6 from a mean of 32 (tested), and
    # beyond 6 it exceeds 1/2 wherever the series fails.
    ww *= 3.0 / 320.0
    np.add(ww, 3.0 / 160.0, out=root)
    ww *= 320.0 / 3.0
    root *= ww
    root += 3.0 / 80.0
    root /= mean
    root += np.abs(x, out=x)
    index = np.flatnonzero(root > 0.5)
    if index.size:
        k[index] = _quantile(mean[index], w[index], k[index])
    return k.astype(np.float32)


def _quantile(mean: np.ndarray, w: np.ndarray, k: np.ndarray) -> np.ndarray:
    """Least k whose cumulative probability exceeds that of the normal deviate w, from a guess."""
    # The smaller tail, as 1 - 1e-17 is 1.
    tail, is_lower = ndtr(-np.abs(w)), w < 0.0

    def too_low(k, i):
        return np.where(is_lower[i], pdtr(k, mean[i]) <= tail[i], pdtrc(k, mean[i]) >= tail[i])

    k = np.maximum(k, 0.0)
    i = np.arange(k.size)
    while (i := i[too_low(k[i], i)]).size:
        k[i] += 1.0
    i = np.flatnonzero(k > 0.0)
    while (i := i[~too_low(k[i] - 1.0, i)]).size:
        k[i] -= 1.0
        i = i[k[i] > 0.0]
    return k
