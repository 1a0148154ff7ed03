"""Noise of the detector is a pixel's, a frame's and a seed's own, whatever shares the work; read noise is normal."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from cameras import BUSY, camera_model, flat
from glrender_camera import noise, threads
from glrender_camera.pattern import FRAME, seed_of
from scipy.stats import kstest, norm

SHAPE = (2000, 2000)
FLAT = {"dark_scale": 0.0, "most": 1e9}


def drawn(key, mean=0.0, shape=SHAPE, **more):
    """Standardised noise (H, W) float64 of a flat frame."""
    values = noise.read_out(np.full(shape, mean, np.float32), key, **FLAT, **more)[0].astype(np.float64)
    return (values - mean) / np.sqrt(mean or 1.0)


@pytest.fixture(scope="module")
def deviates():
    return drawn(noise.key_of(5), read_noise=1.0)


def test_read_noise_follows_the_normal_law(deviates):
    """4e6 numbers: Kolmogorov and Smirnov p > 1e-3; mean, variance and kurtosis within 5 sigma."""
    n = deviates.size
    assert kstest(deviates.ravel(), norm.cdf).pvalue > 1e-3
    np.testing.assert_allclose(deviates.mean(), 0.0, atol=5.0 / np.sqrt(n))
    np.testing.assert_allclose(deviates.var(), 1.0, atol=5.0 * np.sqrt(2.0 / n))
    np.testing.assert_allclose((deviates**4).mean(), 3.0, atol=5.0 * np.sqrt(96.0 / n))


@pytest.mark.parametrize("limit", [2.8, 3.0, 3.09, 3.11, 3.2, 4.0, 4.5])
def test_the_tails_are_whole(deviates, limit):
    """About where the cells end, at 3.1 sigma, and beyond: as many on each side as there should be, 5 sigma."""
    expected = deviates.size * norm.sf(limit)
    for side in (deviates > limit, deviates < -limit):
        np.testing.assert_allclose(side.sum(), expected, atol=5.0 * np.sqrt(expected) + 1.0)


@pytest.mark.parametrize("mean", [0.0, 0.3, 8.0, 4000.0])
def test_no_pixel_knows_of_another(mean):
    """Neighbours in a row and in a column, two apart, diagonal; a row of 2048 px, a counter of a power of two: 5 sigma.

    The signs' products see what a correlation does not: magnitudes that go together.
    """
    image = drawn(noise.key_of(3), mean, (2048, 2048), read_noise=0.0 if mean else 1.0)
    for values in (image, (image - image.mean()) ** 2):
        values = (values - values.mean()) / values.std()
        for down, right in ((0, 1), (0, 2), (0, 3), (1, 0), (2, 0), (1, 1), (16, 0), (0, 512), (64, 64)):
            a, b = values[down:, right:], values[:2048 - down, :2048 - right]
            assert abs(np.mean(a * b)) < 5.0 / np.sqrt(a.size), (down, right)


@pytest.mark.parametrize("mean", [0.0, 0.3, 8.0, 4000.0])
def test_neighbouring_seeds_and_frames_share_nothing(mean):
    """Seeds s and s + 1, frames of one seed, keys of one half: correlation below 5 sigma, also of one pixel aside."""
    key = noise.key_of(7, FRAME)
    keys = [noise.key_of(seed, FRAME) for seed in (0, 1, 2, 2**63, 2**64 - 1)]
    keys += [noise.key_of(seed_of(0, frame), FRAME) for frame in (0, 1)]
    keys += [key, key + np.array([0, 1], np.uint64), key ^ np.array([0, 2**63], np.uint64)]
    images = [drawn(each, mean, (1000, 1000), read_noise=0.0 if mean else 1.0) for each in keys]
    for a, b in pairwise(images):
        for values in ((a, b), (a[:, 1:], b[:, :-1])):
            assert abs(np.corrcoef(*(each.ravel() for each in values))[0, 1]) < 5e-3


def test_charge_and_read_noise_of_a_pixel_are_independent():
    """Both are of one 64-bit number: below 5 sigma, in value and in square."""
    light = np.full(SHAPE, 4000.0, np.float32)
    charge = noise.read_out(light, noise.key_of(4), **FLAT)[0].astype(np.float64)
    read = noise.read_out(light, noise.key_of(4), **FLAT, read_noise=50.0)[0] - charge
    assert read.std() > 49.0
    for power in (1, 2):
        pair = [(each.ravel() - each.mean()) ** power for each in (charge, read)]
        assert abs(np.corrcoef(*pair)[0, 1]) < 5.0 / np.sqrt(light.size)


@pytest.mark.parametrize("block_px", [1, 7, 511, 513, 1000, 10**6])
def test_bytes_depend_on_no_block(monkeypatch, block_px):
    model = camera_model(optics=dict(psf_sigma_px=1.2), **BUSY)
    image = flat(model, 50.0, (31, 37)) * np.linspace(0.0, 3.0, 37, dtype=np.float32)
    fault = [{"kind": "sun_blinding"}, {"kind": "dust"}]
    whole = model.expose(image, 3, faults=fault)
    monkeypatch.setattr(noise, "_BLOCK_PX", block_px)
    parts = model.expose(image, 3, faults=fault)
    for name in ("dn", "electrons", "saturated"):
        assert getattr(parts, name).tobytes() == getattr(whole, name).tobytes(), name


def test_a_pixels_noise_is_of_its_own_light_alone(monkeypatch):
    """Other pixels brighter or dark, a frame of more rows, one thread: the same bytes where the light is the same."""
    monkeypatch.setattr(noise, "_BLOCK_PX", 1000)
    model = camera_model(read_noise_electrons=10.0, dark_current_electrons_per_s=5.0)
    image = flat(model, 300.0, (120, 100))
    plain = model.expose(image, 3)
    image[:60] *= 50.0
    image[60:62] = 0.0
    monkeypatch.setattr(threads.run, "__defaults__", (1,))
    np.testing.assert_array_equal(model.expose(image, 3).electrons[62:], plain.electrons[62:])
    longer = model.expose(flat(model, 300.0, (150, 100)), 3)
    np.testing.assert_array_equal(longer.electrons[:120], plain.electrons)


def test_an_image_of_any_layout_is_read():
    """Every second column of columns first, as a view: the frame of its copy."""
    detector = camera_model(**BUSY).detector
    image = np.asfortranarray(np.linspace(0.0, 900.0, 64 * 80, dtype=np.float32).reshape(64, 80))[:, ::2]
    for a, b in zip(detector.read(image, 0.1, 2), detector.read(image.copy("C"), 0.1, 2), strict=True):
        np.testing.assert_array_equal(a, b)


def test_numbers_are_rounded_halves_to_even_and_held_at_both_ends():
    """No noise: 0.5, 1.5, 2.5 DN and what lies beyond the ends, with and without a nonlinearity of known values."""
    charge = np.zeros((1, 7), np.float32)
    extra = np.array([[-9.0, 0.5, 1.5, 2.5, 6.0, 7.4, 1e30]], np.float32)
    dn, full = noise.read_out(charge, noise.key_of(1), **FLAT, extra=extra, gain=1.0, largest=7)[1:]
    assert dn.tolist() == [[0, 0, 2, 2, 6, 7, 7]] and full.tolist() == [[False] * 5 + [True] * 2]
    bent = np.array([[0.0, 1.0], [2.0, 2.0], [4.0, 6.0]])
    dn = noise.read_out(charge, noise.key_of(1), **FLAT, extra=extra, gain=1.0, largest=7, nonlinearity=bent)[1]
    assert dn.tolist() == [[1, 1, 2, 3, 6, 6, 6]]
