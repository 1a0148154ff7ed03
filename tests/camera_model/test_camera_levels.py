"""Black and white of pictures for the eye: a dark sky and a bright body, whatever the offset and the body's size.

Truth is the scene that each image is made of: sky at a known level with normal noise, a body of known brightness.
"""

from __future__ import annotations

import numpy as np
import pytest
from glrender_camera.levels import black_and_white
from scipy.ndimage import gaussian_filter

SHAPE = (512, 512)


def image(offset, sigma, amplitude, side, dtype=np.uint16, seed=0):
    made = np.random.default_rng(seed).normal(offset, sigma, SHAPE)
    made[250:250 + side, 250:250 + side] += amplitude
    return np.clip(np.rint(made), 0, np.iinfo(dtype).max).astype(dtype)


def grey(value, levels):
    black, white = levels
    return 255.0 * np.clip((value - black) / (white - black), 0.0, 1.0) ** (1.0 / 2.2)


@pytest.mark.parametrize("offset, sigma, amplitude, side", [
    (50, 2, 1450, 1), (50, 2, 1450, 4), (50, 2, 1450, 45), (50, 2, 1450, 500), (50, 2, 60, 10), (200, 20, 40000, 3),
    (0, 1.5, 3000, 20), (100, 0.2, 3000, 100), (1000, 3, 200, 300)])
def test_the_sky_is_dark_and_the_body_bright(offset, sigma, amplitude, side):
    levels = black_and_white([image(offset, sigma, amplitude, side)])
    assert levels[0] == pytest.approx(offset, abs=max(1.0, 0.2 * sigma))
    assert grey(offset, levels) < 80.0 and grey(offset + amplitude, levels) > 170.0


def test_8_bits():
    levels = black_and_white([image(20, 1, 150, 10, np.uint8)])
    assert levels[0] == pytest.approx(20, abs=1.0) and 160.0 < levels[1] < 180.0


@pytest.mark.parametrize("offset, sigma", [(0, 0), (10, 0.2), (50, 2), (4000, 30)])
def test_a_sky_without_light_stays_dark(offset, sigma):
    dark = image(offset, sigma, 0, 1)
    for offset_DN in (None, offset):
        assert grey(np.median(dark), black_and_white([dark], offset_DN)) < 80.0


def test_a_body_without_sky_is_shown_whole():
    """A ramp over the whole image, from 400 to 2400 DN: its darkest thousandth is black."""
    ramp = np.tile(np.linspace(400, 2400, SHAPE[1]), (SHAPE[0], 1)).astype(np.uint16)
    black, white = black_and_white([ramp])
    assert 400 <= black <= 410 and 2390 <= white <= 2400


def filled(mean, sigma, noise, sky_rows=0):
    """Smooth relief of a body over the whole image, bell-shaped as a body's slopes are, but for a few rows of sky."""
    rng = np.random.default_rng(3)
    relief = gaussian_filter(rng.standard_normal(SHAPE), 12.0)
    made = rng.normal(mean + sigma * relief / relief.std(), noise)
    made[:sky_rows] = rng.normal(50.0, 2.0, (sky_rows, SHAPE[1]))
    return np.clip(np.rint(made), 0, 4095).astype(np.uint16)


@pytest.mark.parametrize("offset_DN", [None, 50.0])
@pytest.mark.parametrize("sky_rows", [0, 5, 20, 60])
@pytest.mark.parametrize("mean, sigma, noise", [(3425.0, 240.0, 17.0), (300.0, 20.0, 5.0)])
def test_a_body_that_fills_the_image_is_no_sky(mean, sigma, noise, sky_rows, offset_DN):
    made = filled(mean, sigma, noise, sky_rows)
    levels = black_and_white([made], offset_DN)
    assert levels[1] <= np.quantile(made, 0.9995)
    assert grey(mean - 0.5 * sigma, levels) > 100.0 and grey(mean + sigma, levels) > 170.0
    assert not sky_rows or grey(50.0, levels) < 80.0


@pytest.mark.parametrize("dtype, largest", [(np.uint8, 255), (np.uint16, 1023), (np.uint16, 4095), (np.uint16, 65535)])
def test_a_frame_that_is_saturated_all_over_is_white(dtype, largest):
    for offset_DN in (None, 50.0):
        assert grey(largest, black_and_white([np.full(SHAPE, largest, dtype)], offset_DN)) == 255.0


@pytest.mark.parametrize("level, noise", [(4051, 1.0), (2000, 14.0)])
def test_above_a_known_offset_even_light_is_light(level, noise):
    """At the full well, which may be below the largest digital number, and of a flat field."""
    assert grey(level, black_and_white([image(level, noise, 0, 1)], 50.0)) > 240.0


def test_a_sky_with_a_slope_is_darker_than_a_small_body():
    made = (image(50, 2, 1450, 10) + np.linspace(0.0, 40.0, SHAPE[1])).astype(np.uint16)
    for offset_DN in (None, 50.0):
        levels = black_and_white([made], offset_DN)
        assert grey(70.0, levels) < 80.0 and grey(1500.0, levels) > 170.0


def test_images_share_the_darkest_sky_and_the_brightest_light():
    faint, bright = image(50, 2, 300, 20), image(60, 2, 1000, 20, seed=1)
    black, white = black_and_white([faint, bright])
    assert black == pytest.approx(50, abs=1.0) and white == pytest.approx(1060, abs=10.0)


def test_irradiance_is_black_at_zero():
    light = np.zeros(SHAPE, np.float32)
    light[:2, :3] = 3e-9
    assert black_and_white([light]) == (0.0, pytest.approx(3e-9))
    assert black_and_white([np.zeros(SHAPE, np.float32)]) == (0.0, 1.0)


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_white_is_above_black_in_the_least_images(dtype):
    for made in ([np.zeros((1, 1), dtype)], [np.full((1, 1), 7, dtype)], []):
        black, white = black_and_white(made)
        assert white > black
