"""Poisson numbers of the detector are Poisson numbers: counts against the law, steps against quantiles."""

from __future__ import annotations

import numpy as np
import pytest
from glrender_camera import noise
from scipy.special import ndtr, ndtri, pdtr, pdtrc
from scipy.stats import chisquare
from scipy.stats import poisson as law

KEY = noise.key_of(11)
SHAPE = (1000, 1000)


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


MEANS = [0.003, 0.01, 0.0625, 0.125, 0.77, 3.3, 9.99, 11.999, 12.0, 12.03, 20.7, 32.0, 47.3, 100.0, 1234.5, 2e4, 1e5]


@pytest.mark.parametrize("mean", MEANS)
def test_counts_follow_the_poisson_law(mean):
    """Chi-square of 1e6 numbers against scipy's law, p > 1e-3; mean and variance within 5 sigma. Fixed seed."""
    mean = float(np.float32(mean))
    counts = noise.poisson(np.full(SHAPE, mean, np.float32), KEY).astype(np.float64)
    assert p_value(counts.ravel(), mean) > 1e-3
    np.testing.assert_allclose(counts.mean(), mean, atol=5.0 * np.sqrt(mean / counts.size))
    # The fourth central moment is mean + 3 mean^2.
    np.testing.assert_allclose(counts.var(), mean, atol=5.0 * np.sqrt((mean + 2.0 * mean**2) / counts.size))


@pytest.mark.parametrize("mean", [0.55, 5.0, 200.0])
def test_dark_current_and_light_are_one_poisson_number(mean):
    """A third of the mean is dark current, with a map and without, the rest light on a response of 0.8."""
    dark = float(np.float32(mean / 3.0))
    light, response = np.full(SHAPE, mean / 1.2, np.float32), np.full(SHAPE, 0.8, np.float32)
    for more in ({"dark_scale": dark}, {"dark_scale": 1.0, "dark": np.full(SHAPE, dark, np.float32)}):
        counts = noise.read_out(light, KEY, response=response, most=1e9, **more)[0]
        assert p_value(counts.ravel(), float(light[0, 0]) * float(response[0, 0]) + dark) > 1e-3


def test_the_check_sees_a_normal_in_a_poissons_place():
    """The same chi-square refuses rounded normals at a mean of 100, where their skew is missing."""
    counts = np.rint(np.random.default_rng(11).normal(100.0, 10.0, 10**6))
    assert p_value(counts, 100.0) < 1e-12


def test_a_mixture_of_means_keeps_each_pixels_law():
    """Dark, dim and bright pixels in turn: each against its own law."""
    values = [0.0, 0.4, 5.3, 60.0, 11.97, 900.0]
    counts = noise.poisson(np.tile(np.array(values, np.float32), (1000, 200)), KEY).reshape(-1, 6)
    assert not counts[:, 0].any()
    for column, value in enumerate(values[1:], 1):
        assert p_value(counts[:, column], float(np.float32(value))) > 1e-3


@pytest.mark.parametrize("mean", [12.0, 12.3, 14.9, 20.0, 32.0, 35.5, 50.0, 100.0, 300.0, 1e3, 1e4, 1e5])
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
    means, near = np.full(w.size, mean), w.astype(np.float32)
    below = np.where(near.astype(np.float64) < w, near, np.nextafter(near, np.float32(-np.inf)))
    above = np.nextafter(below, np.float32(np.inf))
    quantiles = noise.loops().quantiles
    np.testing.assert_array_equal(quantiles(means, below.astype(np.float64)), k)
    np.testing.assert_array_equal(quantiles(means, above.astype(np.float64)), k + 1.0)


@pytest.mark.parametrize("mean", [12.0, 17.3, 32.0, 700.0])
def test_the_quantile_is_scipys_everywhere(mean):
    """Least k with P(k) > Phi(w), by the smaller of scipy's tails, on deviates to 7.5 sigma."""
    w = np.linspace(-7.5, 7.5, 3001)
    k = noise.loops().quantiles(np.full(w.size, mean), w)
    tail = ndtr(-np.abs(w))
    above = np.where(w < 0.0, pdtr(k, mean) > tail, pdtrc(k, mean) < tail)
    below = np.where(w < 0.0, (k == 0.0) | (pdtr(k - 1.0, mean) <= tail), pdtrc(k - 1.0, mean) >= tail)
    assert above.all() and below.all()


@pytest.mark.parametrize("mean", [1e6, 1e9, 1e12])
def test_mean_and_variance_at_an_overfull_well(mean):
    """Far beyond float32's whole numbers: variance over mean is 1 within 5 sigma, of which NumPy fails at 1e15."""
    mean = float(np.float32(mean))
    counts = noise.poisson(np.full(SHAPE, mean, np.float32), KEY).astype(np.float64)
    # Rounded to float32: a variance of a twelfth of its step squared.
    step = float(np.spacing(np.float32(mean)))
    expected = mean + step**2 / 12.0
    np.testing.assert_allclose(counts.var(), expected, rtol=max(5.0 * np.sqrt(2e-6), 0.1 * step**2 / mean))
    np.testing.assert_allclose(counts.mean(), mean, atol=5.0 * np.sqrt(expected / counts.size))
