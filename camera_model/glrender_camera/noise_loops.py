"""The detector's loops over pixels, compiled by Numba when this is imported, once on a machine.

Random numbers are a hash of a frame's key and of the pixel's place in it: bytes depend neither on threads nor on
blocks. Upper and lower half of a pixel's 64 bits are the charge's and the read noise's; where 32 are too few, more
follow from the pixel's own.
"""

from __future__ import annotations

import math

import numpy as np
from numba.types import boolean, float32, float64, intp, uint8, uint16, uint64, void

from .numba_loops import compiled, inlined, read, write

# Below this mean [e-] counts are of a table, above of a series. `noise` makes the tables.
SMALL = 12
LEVELS_PER_ELECTRON = 16
CELL_BITS = 11
N_COUNTS = 64
"""Counts that a table has, the last for all above it: P(n > 63) is 1e-24 at a mean of 12."""
UNDECIDED = 255
DEVIATE_BITS = 12
"""Equally likely cells of a normal deviate, in powers of two; each has a cubic."""
OUTER_DEVIATE = 3.0972690781987844
"""Deviate [sigma] beyond which the tails begin: the share of each is 1 / 1024."""
# Pixels at a time: what is known of them stays in a core's first cache.
_CHUNK = 512
_STEP = np.uint64(0x9E3779B97F4A7C15)
_REST_BITS = 32 - CELL_BITS
# A float32 has no odd whole number beyond it: which of two neighbours a count is makes no difference.
_WHOLE = 2.0**24
# Below it Stirling's series with three terms is more than 1e-12 off.
_STIRLING = 16.0


@inlined
def _bits(counter, key):
    """64 random bits of a counter; the key keeps frames apart whose counters meet.

    Finaliser of SplitMix64: Steele, Lea and Flood (2014), Fast splittable pseudorandom number generators.
    """
    x = counter ^ key
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@inlined
def _next(x):
    """64 more bits, of the last ones."""
    return _bits(x + _STEP, np.uint64(0))


@inlined
def _fraction(x):
    """53 of 64 bits as a number in [0, 1)."""
    return np.float64(np.int64(x >> np.uint64(11))) * 2.0**-53


@inlined
def _normal(half, cubics):
    """Normal deviate of 32 bits, of which the upper choose an equally likely cell; NaN in the outermost."""
    cell = (half >> np.uint64(32 - DEVIATE_BITS)) << np.uint64(2)
    t = np.float32(np.int32(half << np.uint64(DEVIATE_BITS))) * np.float32(2.0**-31)
    return cubics[cell] + t * (cubics[cell + np.uint64(1)] + t * (cubics[cell + np.uint64(2)]
                                                                  + t * cubics[cell + np.uint64(3)]))


@inlined
def _tail(x, half):
    """Normal deviate beyond the inner edge of the outermost cells; the sign is that of the 32 bits.

    Source: Marsaglia (1964), Generating a variable from the tail of the normal distribution.
    """
    x = x ^ half
    while True:
        x = _next(x)
        w = -math.log(1.0 - _fraction(x)) / OUTER_DEVIATE
        x = _next(x)
        if -2.0 * math.log(1.0 - _fraction(x)) > w * w:
            break
    return math.copysign(OUTER_DEVIATE + w, np.float64(np.int64(half)) - 2.0**31)


@inlined
def _row(mean):
    """First cell of the next lower tabulated mean, and of the rest's numbers those at which the remainder adds nothing.

    exp(-x) >= 1 - x: a remainder x has a count of 0 wherever a uniform number is below 1 - x.
    """
    level = np.intp(mean * LEVELS_PER_ELECTRON)
    return level << CELL_BITS, np.int64((1.0 - (mean - level * (1.0 / LEVELS_PER_ELECTRON))) * 2.0**_REST_BITS)


@inlined
def _tabulated(half, count_of_cell, begin, sure):
    """Count of 32 bits, or -1 where `_small` has to be asked."""
    k = count_of_cell[begin + np.intp(half >> np.uint64(_REST_BITS))]
    is_sure = k != UNDECIDED and np.int64(half & np.uint64(2**_REST_BITS - 1)) < sure
    return np.float32(k) if is_sure else np.float32(-1.0)


@inlined
def _small(half, mean, count_of_cell, cumulative, x):
    """Count of a mean below `SMALL`: that of the next lower tabulated mean, plus that of the remainder.

    The bits that do not choose a cell say nothing of the count of a decided cell: a second, independent number.
    """
    level = np.intp(mean * LEVELS_PER_ELECTRON)
    remainder = mean - level * (1.0 / LEVELS_PER_ELECTRON)
    cell, rest = np.intp(half >> np.uint64(_REST_BITS)), np.int64(half & np.uint64(2**_REST_BITS - 1))
    count = np.int64(count_of_cell[(level << CELL_BITS) + cell])
    x = _next(x)
    uniform = (rest + _fraction(x)) * 2.0**-_REST_BITS
    if count == UNDECIDED:
        uniform, count = (cell + uniform) * 2.0**-CELL_BITS, 0
        while count < N_COUNTS - 1 and cumulative[level, count] <= uniform:
            count += 1
        uniform = _fraction(_next(x))
    term = math.exp(-remainder)
    extra, reached = 0, term
    while uniform >= reached and extra < N_COUNTS:
        extra += 1
        term *= remainder / extra
        reached += term
    return np.float64(count + extra)


@inlined
def _probability(mean, k):
    """Poisson's, of one count; Loader (2000), Fast and accurate computation of binomial probabilities."""
    if k < _STIRLING:
        return math.exp(k * math.log(mean) - mean - math.lgamma(k + 1.0))
    d, kk = (k - mean) / mean, 1.0 / (k * k)
    stirling = (1.0 / 12.0 - kk * (1.0 / 360.0 - kk * (1.0 / 1260.0 - kk / 1680.0))) / k
    return math.exp(mean * (d - (1.0 + d) * math.log1p(d)) - stirling) / math.sqrt(2.0 * math.pi * k)


@inlined
def _is_below(mean, k, w):
    """Whether the quantile of a normal deviate is above count k; by the smaller tail, as 1 - 1e-17 is 1."""
    tail = 0.5 * math.erfc(abs(w) * math.sqrt(0.5))
    if w < 0.0:
        total = term = _probability(mean, k)
        while k > 0.0 and term > 1e-17 * total:
            term *= k / mean
            total += term
            k -= 1.0
        return total <= tail
    k += 1.0
    total = term = _probability(mean, k)
    while term > 1e-17 * total:
        k += 1.0
        term *= mean / k
        total += term
    return total >= tail


@inlined
def _series(mean, w):
    """Count of a mean of `SMALL` or more at a normal deviate's probability, and whether it is in doubt.

    A Cornish-Fisher series gives a real number, whose whole part is the count unless a whole number lies within the
    series' doubt; there the distribution itself decides. The bound of the doubt is half as much again as Giles's: right
    for |w| < 6, and beyond it exceeds 1/2 wherever the series fails.

    Source: Giles (2016), Algorithm 955: approximation of the inverse Poisson cumulative distribution function.
    """
    root, ww = math.sqrt(mean), w * w
    inverse = 1.0 / root
    x = mean + root * w + (2.0 + ww) * (1.0 / 6.0 - w * inverse * (1.0 / 72.0))
    k = np.floor(x)
    doubt = (3.0 / 80.0 + ww * (3.0 / 160.0 + ww * (3.0 / 320.0))) * inverse * inverse
    return k, not abs(x - k - 0.5) + doubt <= 0.5


@inlined
def _large(mean, w):
    """Count of a mean of `SMALL` or more: the quantile at a normal deviate's probability."""
    k, is_doubtful = _series(mean, w)
    if is_doubtful and mean < _WHOLE:
        k = max(k, 0.0)
        while _is_below(mean, k, w):
            k += 1.0
        while k > 0.0 and not _is_below(mean, k - 1.0, w):
            k -= 1.0
    return k


@inlined
def _interpolated(number, pairs):
    """The straight lines that join pairs (N, 2), held beyond the ends."""
    if number <= pairs[0, 0]:
        return pairs[0, 1]
    for i in range(1, pairs.shape[0]):
        if number < pairs[i, 0]:
            share = (number - pairs[i - 1, 0]) / (pairs[i, 0] - pairs[i - 1, 0])
            return pairs[i - 1, 1] + share * (pairs[i, 1] - pairs[i - 1, 1])
    return pairs[pairs.shape[0] - 1, 1]


@compiled(float64[:](read(float64, 1), read(float64, 1)))
def quantiles(means, deviates):
    """Counts (N,) of means (N,) of `SMALL` or more [1] at the probabilities of normal deviates (N,) [sigma]."""
    counts = np.empty(means.size)
    for i in range(means.size):
        counts[i] = _large(means[i], deviates[i])
    return counts


_VALUES = read(float32, 1)


@inlined
def _means(signal, response, dark, dark_scale, most, mean):
    """Signal times response plus dark times its scale; how many are 0, are below `SMALL`, are as the first."""
    n = signal.size
    for i in range(n):
        # The Sun may be infinite.
        mean[i] = signal[i] if signal[i] < most else most
    if response.size:
        for i in range(n):
            mean[i] *= response[i]
    if dark.size:
        for i in range(n):
            mean[i] += dark_scale * dark[i]
    else:
        for i in range(n):
            mean[i] += dark_scale
    n_none = n_small = n_alike = 0
    for i in range(n):
        mean[i] = mean[i] if mean[i] < most else most
    for i in range(n):
        n_none += mean[i] <= 0.0
        n_small += mean[i] < SMALL
        n_alike += mean[i] == mean[0]
    return n_none, n_small, n_alike


@inlined
def _charge(mean, n_small, n_alike, bits, count_of_cell, cumulative, cubics, count):
    """Poisson numbers of means, of which some are below `SMALL`: by what is quick, then what is marked with -1."""
    n, w = count.size, np.empty(_CHUNK)
    if n_small < n:
        for i in range(n):
            w[i] = _normal(bits[i] >> np.uint64(32), cubics)
        for i in range(n):
            k, is_doubtful = _series(mean[i], w[i])
            count[i] = -1.0 if is_doubtful else k
    if n_alike == n_small == n:
        # The sky: one row of the table.
        begin, sure = _row(mean[0])
        counts = count_of_cell[begin:begin + (1 << CELL_BITS)]
        for i in range(n):
            count[i] = _tabulated(bits[i] >> np.uint64(32), counts, 0, sure)
    elif n_small:
        for i in range(n):
            if mean[i] < SMALL:
                begin, sure = _row(mean[i])
                count[i] = _tabulated(bits[i] >> np.uint64(32), count_of_cell, begin, sure)
    for i in range(n):
        if count[i] < 0.0:
            half = bits[i] >> np.uint64(32)
            if mean[i] < SMALL:
                count[i] = _small(half, mean[i], count_of_cell, cumulative, bits[i])
            else:
                count[i] = _large(mean[i], _tail(bits[i], half) if math.isnan(w[i]) else w[i])


@compiled(void(_VALUES, _VALUES, _VALUES, _VALUES, _VALUES, float64, float64, float64, float64, float64, float64,
               uint16, read(float64, 2), read(uint64, 1), intp, read(uint8, 1), read(float64, 2), _VALUES,
               write(float32, 1), write(uint16, 1), write(boolean, 1)))
def read_out(signal, response, dark, extra, offset, dark_scale, most, well, read_noise, gain, offset_DN, largest,
             nonlinearity, key, first, count_of_cell, cumulative, cubics, electrons, dn, saturated):
    """Charge of pixels (N,), and the electrons and digital numbers that are read of it.

    `first` is the place in the frame of the first pixel. Response and dark, where they are empty, are 1 everywhere;
    extra charge and offset are 0.
    """
    mean, number, bits = np.empty(_CHUNK), np.empty(_CHUNK), np.empty(_CHUNK, np.uint64)
    noise = np.empty(_CHUNK, np.float32)
    counter = key[0] + np.uint64(first) * _STEP
    top, sigma = np.float64(largest), np.float32(read_noise)
    for start in range(0, signal.size, _CHUNK):
        # Views count from 0: of a sum Numba does not know that it is no negative index.
        part = slice(start, start + _CHUNK)
        value, is_full = electrons[part], saturated[part]
        n = value.size
        n_none, n_small, n_alike = _means(signal[part], response[part], dark[part], dark_scale, most, mean)
        if n_none < n or read_noise > 0.0:
            for i in range(n):
                bits[i] = _bits(counter, key[1])
                counter += _STEP
        else:
            counter += _STEP * np.uint64(n)
        if n_none == n:
            value[:] = 0.0
        else:
            _charge(mean, n_small, n_alike, bits, count_of_cell, cumulative, cubics, value)
        if extra.size:
            added = extra[part]
            for i in range(n):
                value[i] += added[i]
        for i in range(n):
            is_full[i] = value[i] >= well
            value[i] = value[i] if value[i] < well else well
        if offset.size:
            fixed = offset[part]
            for i in range(n):
                value[i] += fixed[i]
        if read_noise > 0.0:
            for i in range(n):
                noise[i] = _normal(bits[i] & np.uint64(2**32 - 1), cubics)
            for i in range(n):
                if math.isnan(noise[i]):
                    noise[i] = _tail(bits[i], bits[i] & np.uint64(2**32 - 1))
            for i in range(n):
                value[i] += sigma * noise[i]
        for i in range(n):
            number[i] = np.float64(value[i]) * gain + offset_DN
        if nonlinearity.size:
            for i in range(n):
                number[i] = _interpolated(number[i], nonlinearity)
        whole = dn[part]
        for i in range(n):
            # Halves to even, as floor would take half a digital number from every pixel.
            v = np.rint(number[i])
            v = v if v > 0.0 else 0.0
            v = v if v < top else top
            whole[i] = np.uint16(np.int32(v))
            is_full[i] |= v == top
