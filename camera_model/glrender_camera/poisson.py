"""Exact Poisson numbers for a whole image, several times faster than one call per pixel.

Two methods, chosen per pixel by its mean, both exact but for float64 rounding; no normal
approximation anywhere (photometry.md section 4.6). `Generator.poisson` costs 30 to 90 ms per
megapixel on the machines this was written for; these are vectorised and take about a fifth.
"""

from __future__ import annotations

from functools import cache, lru_cache

import numpy as np
from scipy.special import ndtr, pdtr, pdtrc

# Below this mean by table, above by the series of `_large`, whose doubts are rare there.
_SMALL = 32
_LEVELS_PER_ELECTRON = 8
_CELLS = 2048
# P(n > 96) is 1e-19 at mean 32: beyond what a float64 in [0, 1) can ask for.
_N_COUNTS = 96
_UNDECIDED = 255


@lru_cache(maxsize=_SMALL * _LEVELS_PER_ELECTRON + 64)
def _table(mean: float) -> tuple[np.ndarray, np.ndarray]:
    """Cumulative probabilities (_N_COUNTS,) of a mean < 32, and the count (_CELLS,) of each cell of [0, 1).

    A cell that a step of the distribution cuts is undecided.
    """
    cumulative = pdtr(np.arange(_N_COUNTS), mean)
    edges = np.arange(_CELLS + 1) / _CELLS
    count = np.searchsorted(cumulative, edges[:-1], side="right")
    decided = np.searchsorted(cumulative, edges[1:], side="left") == count
    return cumulative, np.where(decided, count, _UNDECIDED).astype(np.uint8)


@cache
def _levels() -> tuple[np.ndarray, np.ndarray]:
    """The tables of all levels, one after the other."""
    tables = [_table(i / _LEVELS_PER_ELECTRON) for i in range(_SMALL * _LEVELS_PER_ELECTRON)]
    return np.array([row for row, _ in tables]), np.concatenate([counts for _, counts in tables])


def draw(rng: np.random.Generator, mean: np.ndarray, common_mean: float = 0.0) -> np.ndarray:
    """One Poisson number for each mean.

    Parameters
    ----------
    rng : Generator
    mean : (N,) float32 [1], 0..1e9
        Trusted: finite and not negative.
    common_mean : float [1]
        A mean that many pixels share, as the dark current's: they cost half. It changes which
        random numbers are drawn, not their law.

    Returns
    -------
    (N,) float32 [1]
        Integers; above 2**24 they are rounded to float32.

    Source: inversion; below a mean of 32 with the additivity of Poisson numbers, above after Giles
    (2016), "Algorithm 955: approximation of the inverse Poisson cumulative distribution function".
    """
    common = mean == common_mean
    n_common = np.count_nonzero(common)
    large = mean >= _SMALL
    n_large = np.count_nonzero(large)
    if n_large == mean.size:
        return _large(rng, mean)
    if n_common == mean.size:
        return _same(rng, float(common_mean), n_common)
    out = np.zeros(mean.shape, np.float32)
    if n_common and common_mean > 0.0 and not common_mean >= _SMALL:
        out[common] = _same(rng, float(common_mean), n_common)
    if n_large:
        out[large] = _large(rng, mean[large])
    small = np.flatnonzero(~(common | large) & (mean > 0.0))
    if small.size:
        out[small] = _small(rng, mean[small])
    return out


def _same(rng: np.random.Generator, mean: float, n: int) -> np.ndarray:
    """0 <= mean < 32, one for all."""
    if mean == 0.0:
        return np.zeros(n, np.float32)
    cumulative, count_of_cell = _table(mean)
    uniform = rng.random(n)
    count = count_of_cell.take((uniform * _CELLS).astype(np.intp), mode="clip")
    undecided = np.flatnonzero(count == _UNDECIDED)
    count[undecided] = np.searchsorted(cumulative, uniform[undecided], side="right")
    return count.astype(np.float32)


def _small(rng: np.random.Generator, mean: np.ndarray) -> np.ndarray:
    """0 <= mean < 32: the number at the next lower tabulated mean, plus that of the remainder."""
    cumulative_of_level, count_of_cell = _levels()
    level = (mean * np.float32(_LEVELS_PER_ELECTRON)).astype(np.intp)
    remainder = mean - level * np.float32(1.0 / _LEVELS_PER_ELECTRON)
    uniform = rng.random(mean.size)
    second = uniform * _CELLS
    cell = second.astype(np.intp)
    # The place inside a decided cell says nothing about the count: a second, independent uniform.
    second -= cell
    cell += level * _CELLS
    count = count_of_cell.take(cell, mode="clip")
    undecided = np.flatnonzero(count == _UNDECIDED)
    if undecided.size:
        below = cumulative_of_level[level[undecided]] <= uniform[undecided, None]
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
