"""Exact Poisson numbers for a whole image, several times faster than one call per pixel.

Two methods, chosen per pixel by its mean, both exact but for the rounding of the random numbers that
they start from (32-bit fractions refined where it matters, float32 normal deviates); no normal
approximation anywhere. `Generator.poisson` costs 30 to 90 ms per
megapixel on the machines this was written for; these are vectorised and take about a fifth.
"""

from __future__ import annotations

from functools import cache, lru_cache

import numpy as np
from scipy.special import ndtr, pdtr, pdtrc

from .deviates import random_bits
from .threads import Scratch

# Below this mean by table, above by the series of `_large`, whose doubts are rare there.
_SMALL = 32
_LEVELS_PER_ELECTRON = 16
_CELL_BITS = 11
_CELLS = 2**_CELL_BITS
# P(n > 96) is 1e-19 at mean 32: beyond what a float64 in [0, 1) can ask for.
_N_COUNTS = 96
_UNDECIDED = 255
# Random bits of 32 that do not choose a cell.
_REST_BITS = 32 - _CELL_BITS
# Normal deviates beyond it, one in two thousand, go the long way.
_USUAL_W = 3.5

_scratch = Scratch()


@lru_cache(maxsize=_SMALL * _LEVELS_PER_ELECTRON + 64)
def _table(mean: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cumulative probabilities (_N_COUNTS,) of a mean < 32; least count in each cell (_CELLS,) of [0, 1); the count.

    A cell that a step of the distribution cuts has an undecided count.
    """
    cumulative = pdtr(np.arange(_N_COUNTS), mean)
    edges = np.arange(_CELLS + 1) / _CELLS
    least = np.searchsorted(cumulative, edges[:-1], side="right")
    decided = np.searchsorted(cumulative, edges[1:], side="left") == least
    return cumulative, least.astype(np.uint8), np.where(decided, least, _UNDECIDED).astype(np.uint8)


@cache
def _levels() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The tables of all levels, one after the other."""
    tables = [_table(i / _LEVELS_PER_ELECTRON) for i in range(_SMALL * _LEVELS_PER_ELECTRON)]
    return tuple(np.concatenate([table[i] for table in tables]) for i in range(3))


def _counted(cumulative: np.ndarray, row: np.ndarray | int, least: np.ndarray, uniform: np.ndarray) -> np.ndarray:
    """Counts (N,) uint8 at uniform numbers, from the least that each may be; distributions begin at `row`."""
    count, left = least.copy(), np.arange(uniform.size)
    row = np.broadcast_to(row, uniform.shape)
    while (left := left[cumulative[row[left] + count[left]] <= uniform[left]]).size:
        count[left] += 1
    return count


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
    least = float(mean.min(initial=np.inf))
    if least >= _SMALL:
        return _large(rng, mean)
    common = mean == common_mean
    n_common = np.count_nonzero(common)
    large = mean >= _SMALL
    n_large = np.count_nonzero(large)
    if n_common == mean.size:
        return _same(rng, float(common_mean), n_common)
    if not n_common and not n_large:
        return _small(rng, mean)
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
    cumulative, least, count_of_cell = _table(mean)
    cell = random_bits(rng, n, np.uint16)
    cell >>= np.uint16(16 - _CELL_BITS)
    place = _scratch.array("place", (n,), np.intp)
    np.copyto(place, cell)
    count = count_of_cell.take(place, mode="clip")
    undecided = np.flatnonzero(count == _UNDECIDED)
    # A second number chooses the place in the cell.
    uniform = (place[undecided] + rng.random(undecided.size)) / _CELLS
    count[undecided] = _counted(cumulative, 0, least[place[undecided]], uniform)
    return count.astype(np.float32)


def _small(rng: np.random.Generator, mean: np.ndarray) -> np.ndarray:
    """0 <= mean < 32: the number at the next lower tabulated mean, plus that of the remainder."""
    cumulative, least, count_of_cell = _levels()
    n = mean.size
    level, remainder, rest = (_scratch.array(name, (n,)) for name in ("level", "remainder", "rest"))
    np.multiply(mean, np.float32(_LEVELS_PER_ELECTRON), out=remainder)
    np.floor(remainder, out=level)
    remainder -= level
    remainder *= np.float32(1.0 / _LEVELS_PER_ELECTRON)
    # Eleven of 32 random bits choose the cell. The others say nothing about the count of a decided cell, and serve as a
    # second, independent number. Bits below the last are drawn where they are needed.
    bits = random_bits(rng, n, np.uint32)
    cell, row = _scratch.array("cell", (n,), np.uint32), _scratch.array("row", (n,), np.int32)
    np.right_shift(bits, np.uint32(_REST_BITS), out=cell)
    bits &= np.uint32(2**_REST_BITS - 1)
    np.copyto(rest, bits, casting="unsafe")
    rest *= np.float32(2.0**-_REST_BITS)
    np.copyto(row, level, casting="unsafe")
    row <<= np.int32(_CELL_BITS)
    cell += row.view(np.uint32)
    place = _scratch.array("place", (n,), np.intp)
    np.copyto(place, cell)
    count = count_of_cell.take(place, mode="clip")
    undecided = np.flatnonzero(count == _UNDECIDED)
    if undecided.size:
        where = place[undecided]
        uniform = (where % _CELLS + (bits[undecided] + rng.random(undecided.size)) * 2.0**-_REST_BITS) / _CELLS
        count[undecided] = _counted(cumulative, where // _CELLS * _N_COUNTS, least[where], uniform)
    fresh = rng.random(undecided.size)
    rest[undecided] = fresh
    out = count.astype(np.float32)
    # exp(-x) >= 1 - x spares the exponential of all that surely add nothing.
    np.add(rest, remainder, out=rest)
    index = np.flatnonzero(rest >= np.float32(1.0 - 2.0 ** (1 - _REST_BITS)))
    if index.size:
        rate = remainder[index].astype(np.float64)
        uniform = (bits[index] + rng.random(index.size)) * 2.0**-_REST_BITS
        if undecided.size:
            which = np.minimum(np.searchsorted(undecided, index), undecided.size - 1)
            uniform = np.where(undecided[which] == index, fresh[which], uniform)
        out[index] += _by_search(rate, uniform)
    return out


def _by_search(rate: np.ndarray, uniform: np.ndarray) -> np.ndarray:
    """Poisson numbers (N,) float32 of small rates at uniform numbers, term by term."""
    extra = np.zeros(rate.size, np.float32)
    left, term = np.arange(rate.size), np.exp(-rate)
    cumulative, k = term.copy(), 0
    while k < _N_COUNTS:
        more = uniform[left] >= cumulative
        left, term, cumulative = left[more], term[more], cumulative[more]
        if not left.size:
            break
        k += 1
        extra[left] = k
        term = term * (rate[left] / k)
        cumulative = cumulative + term
    return extra


def _large(rng: np.random.Generator, mean: np.ndarray) -> np.ndarray:
    """mean >= 32: the quantile at a normal deviate's probability, by a series with a known bound.

    The Cornish-Fisher series gives a real number whose integer part is the count unless it lies near an integer. In
    float32 "near" holds for one in a hundred; those are worked out again in float64, and the few that lie within the
    series' own doubt are looked up in the distribution itself.
    """
    n = mean.size
    w, root, x, near, whole = (_scratch.array(f"large {i}", (n,)) for i in range(5))
    rng.standard_normal(out=w, dtype=np.float32)
    np.sqrt(mean, out=root)
    np.floor(mean, out=whole)
    # mean + root w + (2 + w^2) (1 / 6 - w / (72 root)); the whole part of the mean is added last.
    np.divide(w, root, out=x)
    x *= np.float32(-1.0 / 72.0)
    x += np.float32(1.0 / 6.0)
    np.multiply(w, w, out=near)
    near += np.float32(2.0)
    x *= near
    is_far = near > np.float32(_USUAL_W**2 + 2.0)
    root *= w
    x += root
    np.subtract(mean, whole, out=root)
    x += root
    k = np.floor(x)
    x -= k
    x -= np.float32(0.5)
    np.abs(x, out=x)
    np.divide(np.float32(_doubt(_USUAL_W)), mean, out=near)
    x += near
    k += whole
    # Error of float32 in the sum: 2^-24 of its largest term, for each of four roundings.
    rounding = 2.0**-22 * (_USUAL_W * float(mean.max()) ** 0.5 + 1.0)
    is_far |= x > np.float32(0.5 - rounding)
    index = np.flatnonzero(is_far)
    if index.size:
        k[index] = _refined(mean[index].astype(np.float64), w[index].astype(np.float64))
    return k


def _refined(mean: np.ndarray, w: np.ndarray) -> np.ndarray:
    """The series in float64, and the distribution itself within the series' doubt."""
    root, ww = np.sqrt(mean), w * w
    x = mean + root * w + (2.0 + ww) * (1.0 / 6.0 - w / (72.0 * root))
    k = np.floor(x)
    index = np.flatnonzero(np.abs(x - k - 0.5) + _doubt(w) / mean > 0.5)
    k[index] = _quantile(mean[index], w[index], k[index])
    return k


def _doubt(w: np.ndarray | float) -> np.ndarray | float:
    """Bound of the series' error times the mean.

    Half as much again as Giles's bound: right for all |w| < 6 from a mean of 32 (tested), and beyond 6 it exceeds 1/2
    wherever the series fails.
    """
    ww = w * w
    return 3.0 / 80.0 + ww * (3.0 / 160.0 + ww * 3.0 / 320.0)


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
