"""Jitter of a given spectrum: its power in each band, and no repetition, whatever the frames' cadence."""

from __future__ import annotations

import numpy as np
import pytest
from glrender.scenario import Jitter
from scipy.integrate import quad
from scipy.signal import welch

# Jitter of reaction wheels: a floor over decades, and a tone of a hundred times its density.
WIDE = ([0.02, 0.2, 2.0, 2.9, 3.0, 3.1, 10.0], [1e-8, 1e-9, 1e-11, 1e-11, 1e-9, 1e-11, 1e-12])


@pytest.fixture(scope="module")
def spectrum():
    """Frequencies [Hz] and mean density [rad2/Hz] of three axes, by Welch's method, of 400 s."""
    jitter = Jitter(frequency_hz=WIDE[0], density_rad2_hz=WIDE[1], seed=4, lines=800)
    angles, _ = jitter.angles(np.arange(0.0, 400.0, 0.04))
    rate, power = welch(angles, 25.0, window="hann", nperseg=len(angles) // 2, detrend=False, axis=0)
    return rate, power.mean(axis=1)


@pytest.mark.parametrize("band_hz", [(0.02, 0.06), (0.06, 0.2), (0.2, 1.0), (1.0, 2.8), (2.8, 3.2), (3.2, 10.0)])
def test_each_band_has_its_power(spectrum, band_hz):
    """Against the integral of the density, 20 %: the estimate of so few periods at the lowest has no more."""
    rate, density = spectrum
    found = density[(rate >= band_hz[0]) & (rate < band_hz[1])].sum() * rate[1]
    inside = [f for f in WIDE[0] if band_hz[0] < f < band_hz[1]]
    expected, _ = quad(lambda f: np.interp(f, *WIDE), *band_hz, points=inside or None)
    np.testing.assert_allclose(found, expected, rtol=0.2)


@pytest.mark.parametrize("cadence_s", [0.5, 2.0, 10.0, 60.0, 600.0, 1234.5])
@pytest.mark.parametrize("low_hz, high_hz", [(0.01, 100.0), (3.0, 7.0), (10.0, 50.0), (99.0, 100.0)])
def test_no_frame_has_the_jitter_of_another(low_hz, high_hz, cadence_s):
    """The RMS of 60 frames is the spectrum's within a factor of 1.5, and neighbours are not alike.

    Sines of even distances d repeat after 1 / d: frames at multiples of that had one and the same angles.
    """
    jitter = Jitter(frequency_hz=[low_hz, high_hz], density_rad2_hz=[1e-10, 1e-10], seed=11)
    sigma = np.sqrt(1e-10 * (high_hz - low_hz))
    angles, _ = jitter.angles(cadence_s * np.arange(60))
    rms = np.sqrt((angles**2).mean(axis=0)) / sigma
    assert (rms > 1.0 / 1.5).all() and (rms < 1.5).all(), rms
    pairs = np.linalg.norm(angles[:, None] - angles, axis=-1)[np.triu_indices(60, 1)] / sigma
    assert pairs.min() > 1e-2


def test_rates_are_those_of_the_angles():
    """Central differences over 1e-5 s of 0.5 to 20 Hz: 1e-6 of the rates."""
    jitter = Jitter(frequency_hz=[0.5, 20.0], density_rad2_hz=[1e-10, 3e-10], seed=2)
    t = np.linspace(3.0, 9.0, 7)
    rates = (jitter.angles(t + 5e-6)[0] - jitter.angles(t - 5e-6)[0]) / 1e-5
    np.testing.assert_allclose(jitter.angles(t)[1], rates, atol=1e-6 * np.abs(rates).max())


def test_an_axis_without_power_stands_still():
    jitter = Jitter(frequency_hz=[1.0, 2.0, 3.0, 4.0], density_rad2_hz=[[0.0, 0.0, 1e-9], [0.0, 1e-9, 0.0],
                    [0.0, 0.0, 0.0], [0.0, 0.0, 1e-9]], seed=5)
    angles, _ = jitter.angles(np.linspace(0.0, 300.0, 4000))
    # Triangles: 1e-9 of 1 to 3 Hz, and two halves of that with none between 2 and 3 Hz.
    np.testing.assert_allclose(angles.var(axis=0), [0.0, 1e-9, 1e-9], rtol=0.05)
