"""Black and white of pictures for the eye: a dark sky and a bright body, whatever the offset and the body's size.

Truth is the scene that each image is made of: sky at a known level with normal noise, a body of known brightness.
"""

from __future__ import annotations

import numpy as np
import pytest
from glrender_camera.levels import black_and_white

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
    assert grey(np.median(dark), black_and_white([dark])) < 80.0


def test_a_body_without_sky_is_shown_whole():
    """A ramp over the whole image, from 400 to 2400 DN: its darkest thousandth is black."""
    ramp = np.tile(np.linspace(400, 2400, SHAPE[1]), (SHAPE[0], 1)).astype(np.uint16)
    black, white = black_and_white([ramp])
    assert 400 <= black <= 410 and 2390 <= white <= 2400


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
