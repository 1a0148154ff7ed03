"""The vectorised Poisson numbers are Poisson numbers: counts against the law, steps against quantiles."""

from __future__ import annotations

import numpy as np
import pytest
from glrender_camera import poisson
from scipy.special import ndtr, ndtri, pdtr, pdtrc
from scipy.stats import chisquare
from scipy.stats import poisson as law


def generator(seed=11):
    return np.random.Generator(np.random.SFC64(seed))


def p_value(counts: np.ndarray, mean: float) -> float:
    """Chi-square of counts against the Poisson law, bins of fewer than ten expected joined."""
    low, high = int(law.ppf(1e-6, mean)), int(law.ppf(1.0 - 1e-6, mean))
    expected = law.pmf(np.arange(low, high + 1), mean)
    expected[0], expected[-1] = law.cdf(low, mean), law.sf(high - 1, mean)
    expected *= counts.size
    seen = np.bincount(np.clip(counts, low, high).astype(int) - low, minlength=expected.size)
    many = expected >= 10.0
    expected, seen = (np.append(x[many], x[~many].sum()) for x in (expected, seen))
    if expected[-1] < 10.0:
        expected, seen = (np.append(x[:-2], x[-2:].sum()) for x in (expected, seen))
    return chisquare(seen, expected * (seen.sum() / expected.sum())).pvalue


@pytest.mark.parametrize("mean", [0.003, 0.125, 0.77, 3.3, 9.99, 31.97, 32.0, 47.3, 100.0, 1234.5, 20000.0])
def test_counts_follow_the_poisson_law(mean):
    """Chi-square of 1e6 numbers against scipy's law; fixed seed, p > 1e-3."""
    mean = float(np.float32(mean))
    assert p_value(poisson.draw(generator(), np.full(10**6, mean, np.float32)), mean) > 1e-3


@pytest.mark.parametrize("mean", [0.0625, 0.5, 7.1, 31.9])
def test_pixels_that_share_a_mean_follow_the_poisson_law(mean):
    """The shared table's numbers, chi-square as above."""
    mean = float(np.float32(mean))
    counts = poisson.draw(generator(), np.full(10**6, mean, np.float32), common_mean=np.float32(mean))
    assert p_value(counts, mean) > 1e-3


def test_the_check_sees_a_normal_in_a_poissons_place():
    """The same chi-square refuses rounded normals at a mean of 100, where their skew is missing."""
    counts = np.rint(generator().normal(100.0, 10.0, 10**6))
    assert p_value(counts, 100.0) < 1e-12


def test_a_mixture_of_means_keeps_each_pixels_law():
    """Dark, dim and bright pixels in one call: each third against its own law."""
    mean = np.tile(np.array([0.0, 0.4, 5.3, 60.0, 0.0, 900.0], np.float32), 10**5)
    counts = poisson.draw(generator(), mean, common_mean=np.float32(0.4)).reshape(-1, 6)
    assert not counts[:, [0, 4]].any()
    for column, value in ((1, 0.4), (2, 5.3), (3, 60.0), (5, 900.0)):
        assert p_value(counts[:, column], float(np.float32(value))) > 1e-3


class Deviates:
    """Stands for a generator whose normal deviates are chosen."""

    def __init__(self, w):
        self.w = w

    def standard_normal(self, out, dtype):
        assert out.size == self.w.size and out.dtype == dtype == self.w.dtype
        out[...] = self.w


@pytest.mark.parametrize("mean", [32.0, 35.5, 50.0, 100.0, 300.0, 1e3, 1e4, 1e5])
def test_each_step_of_the_distribution_is_where_it_belongs(mean):
    """The float32 deviates next below and above every exact step, |w| < 6: the count is that of the exact quantile.

    The steps are where the series has to be right or to know that it may be wrong.
    """
    root = np.sqrt(mean)
    k = np.unique(np.clip(np.arange(np.floor(mean - 7 * root), np.ceil(mean + 7 * root),
                                    max(1.0, np.round(root / 40))), 0, None))
    lower, upper = pdtr(k, mean), pdtrc(k, mean)
    w = np.where(lower < 0.5, ndtri(lower), -ndtri(upper))
    k, w = k[np.abs(w) < 6.0], w[np.abs(w) < 6.0]
    means = np.full(w.size, mean, np.float32)
    near = w.astype(np.float32)
    below = np.where(near.astype(np.float64) < w, near, np.nextafter(near, np.float32(-np.inf)))
    np.testing.assert_array_equal(poisson.draw(Deviates(below), means), k)
    np.testing.assert_array_equal(poisson.draw(Deviates(np.nextafter(below, np.float32(np.inf))), means), k + 1.0)


@pytest.mark.parametrize("mean", [32.0, 700.0])
def test_the_quantile_is_found_from_any_guess(mean):
    """Least k with P(k) > Phi(w), against scipy's ppf, from guesses 9 too low and 9 too high."""
    w = np.linspace(-5.9, 5.9, 101)
    exact = np.where(w < 0, law.ppf(ndtr(w), mean), law.isf(ndtr(-w), mean))
    for guess in (exact - 9.0, exact + 9.0):
        np.testing.assert_array_equal(poisson._quantile(np.full(w.size, mean), w, guess), exact)


def test_mean_and_variance_at_an_overfull_well():
    """A million electrons: variance over mean is 1 within 5 sigma (numpy fails at 1e15)."""
    counts = poisson.draw(generator(), np.full(10**6, 1e6, np.float32)).astype(np.float64)
    np.testing.assert_allclose(counts.var() / 1e6, 1.0, atol=5.0 * np.sqrt(2e-6))
    np.testing.assert_allclose(counts.mean(), 1e6, atol=5.0)
