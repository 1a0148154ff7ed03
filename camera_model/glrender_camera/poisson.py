"""Exact Poisson numbers for a whole image, several times faster than one call per pixel.

Two methods, chosen per pixel by its mean, both exact but for float64 rounding; no normal
approximation anywhere (photometry.md section 4.6). `Generator.poisson` costs 30 to 90 ms per
megapixel on the machines this was written for; these are vectorised and take about a fifth.
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaln, pdtr

# Below this mean by table, above by transformed rejection, whose hat needs a mean >= 10.
_SMALL = 10
_LEVELS_PER_ELECTRON = 8
_CELLS = 2048
# P(n > 60) is 1e-28 at mean 10: beyond what a float64 in [0, 1) can ask for.
_N_COUNTS = 60
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

    Source: additivity of Poisson numbers and inversion below a mean of 10; Hörmann (1993),
    "The transformed rejection method for generating Poisson random variables" (PTRS), above.
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
    """0 <= mean < 10: the number at the next lower tabulated mean, plus that of the remainder."""
    level = (mean * np.float32(_LEVELS_PER_ELECTRON)).astype(np.int32)
    remainder = mean - level * np.float32(1.0 / _LEVELS_PER_ELECTRON)
    uniform = rng.random(mean.size)
    scaled = uniform * _CELLS
    cell = scaled.astype(np.int32)
    # The place inside a decided cell says nothing about the count: a second, independent uniform.
    second = scaled - cell
    count = _COUNT_OF_CELL[level * _CELLS + cell]
    undecided = np.flatnonzero(count == _UNDECIDED)
    if undecided.size:
        below = _CUMULATIVE[level[undecided]] <= uniform[undecided, None]
        count[undecided] = np.count_nonzero(below, axis=1)
        second[undecided] = rng.random(undecided.size)
    count = count.astype(np.float32)
    # exp(-x) >= 1 - x spares the exponential of all that surely add nothing.
    index = np.flatnonzero(second >= 1.0 - remainder)
    if index.size:
        rate, uniform = remainder[index].astype(np.float64), second[index]
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
    """mean >= 10: Hörmann's PTRS; what it rejects starts afresh, in NumPy's own."""
    mean = mean.astype(np.float64)
    b = np.sqrt(mean)
    b *= 2.53
    b += 0.931
    a = 0.02483 * b
    a -= 0.059
    u = rng.random(mean.size)
    v = rng.random(mean.size, dtype=np.float32)
    u -= 0.5
    us = np.abs(u)
    np.subtract(0.5, us, out=us)
    k = a / us
    k *= 2.0
    k += b
    k *= u
    k += mean
    k += 0.43
    np.floor(k, out=k)
    squeeze = 3.6224 / (b - 2.0)
    np.subtract(0.9277, squeeze, out=squeeze)
    index = np.flatnonzero(~((us >= 0.07) & (v <= squeeze)))
    if index.size:
        a, b, us, v, m, n = a[index], b[index], us[index], v[index].astype(np.float64), mean[index], k[index]
        possible = (n >= 0.0) & ~((us < 0.013) & (v > us))
        # 1e-300 stands for the zeros that `random` may give; the logarithm then accepts, as it should.
        left = np.log(np.maximum(v, 1e-300)) + np.log(1.1239 + 1.1328 / (b - 3.4))
        left -= np.log(a / np.maximum(us, 1e-300) ** 2 + b)
        accept = possible & (left <= -m + n * np.log(m) - gammaln(np.maximum(n, 0.0) + 1.0))
        rejected = index[~accept]
        k[rejected] = rng.poisson(mean[rejected])
    return k.astype(np.float32)
