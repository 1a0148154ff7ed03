"""Normal deviates out of cells: against the law, in the tails too, and the same for the same stream."""

from __future__ import annotations

import numpy as np
import pytest
from glrender_camera.deviates import random_bits, standard_normal
from scipy.stats import kstest, norm


def stream(seed):
    return np.random.Generator(np.random.SFC64(seed))


@pytest.fixture(scope="module")
def deviates():
    return standard_normal(stream(5), np.empty((2000, 2000), np.float32)).astype(np.float64).ravel()


def test_they_follow_the_normal_law(deviates):
    """4e6 numbers: Kolmogorov and Smirnov p > 1e-3; mean, variance and kurtosis within 5 sigma."""
    n = deviates.size
    assert kstest(deviates, norm.cdf).pvalue > 1e-3
    np.testing.assert_allclose(deviates.mean(), 0.0, atol=5.0 / np.sqrt(n))
    np.testing.assert_allclose(deviates.var(), 1.0, atol=5.0 * np.sqrt(2.0 / n))
    np.testing.assert_allclose((deviates**4).mean(), 3.0, atol=5.0 * np.sqrt(96.0 / n))


@pytest.mark.parametrize("limit", [3.2, 4.0, 4.5])
def test_the_tails_are_whole(deviates, limit):
    """Beyond where the cells end, at 3.1 sigma: as many on each side as there should be, 5 sigma."""
    expected = deviates.size * norm.sf(limit)
    for side in (deviates > limit, deviates < -limit):
        np.testing.assert_allclose(side.sum(), expected, atol=5.0 * np.sqrt(expected) + 1.0)


def test_neighbours_are_not_correlated(deviates):
    """Numbers out of one 64-bit draw, 1 to 4 apart: 5 sigma."""
    for lag in range(1, 5):
        np.testing.assert_allclose(np.mean(deviates[lag:] * deviates[:-lag]), 0.0, atol=5.0 / np.sqrt(deviates.size))


def test_equal_streams_give_equal_deviates():
    a, b = (standard_normal(stream(9), np.empty((3, 5), np.float32)) for _ in range(2))
    np.testing.assert_array_equal(a, b)
    assert not np.array_equal(a, standard_normal(stream(10), np.empty((3, 5), np.float32)))


@pytest.mark.parametrize("dtype, n", [(np.uint16, 7), (np.uint32, 5), (np.uint64, 3)])
def test_every_bit_is_random(dtype, n):
    assert random_bits(stream(1), n, dtype).shape == (n,)
    bits = random_bits(stream(2), 10**5, dtype)
    share = [np.mean((bits >> dtype(k)) & dtype(1)) for k in range(8 * np.dtype(dtype).itemsize)]
    np.testing.assert_allclose(share, 0.5, atol=5.0 * 0.5 / np.sqrt(10**5))
