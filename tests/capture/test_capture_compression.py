"""Compression of a frame of the comet's fly-by as the renderer and the generic camera make it: rates and bounds."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from glrender import open_renderer, take_frame
from glrender.scenario import scenario_of_table
from glrender_camera import CameraModel
from glrender_camera.compression import CODECS, Compression, decode, noise_DN, psnr_db

EXAMPLE = Path(__file__).parents[2] / "examples" / "scenarios" / "comet_flyby.toml"
CAMERA = {"name": "navcam", "width_px": 512, "height_px": 512, "focal_length_px": 1750.0,
          "model": {"preset": "generic_navigation_camera", "exposure_s": 0.0035}}


@pytest.fixture(scope="module")
def flown():
    """The frame at the closest approach, without compression, and the scenario's state."""
    table = tomllib.loads(EXAMPLE.read_text()) | {"cameras": [CAMERA]}
    scenario = scenario_of_table({**table, "encounter": {**table["encounter"], "frames": 3}})
    state = list(scenario.iter_states())[1]
    with open_renderer(scenario.scene) as renderer:
        return take_frame(renderer, state, seed=12).frame


@pytest.fixture(scope="module")
def detector():
    return CameraModel.from_dict(CAMERA["model"]).detector


def sent(frame, **table):
    compression = Compression.from_dict(table)
    stream = compression.encode(frame.dn, 12, noise_DN(frame.dn, offset_DN=50.0, gain_DN_per_electron=0.04,
                                                       read_noise_electrons=10.0))
    made = decode(stream, compression.codec, frame.dn.shape, 12)
    return made, 8.0 * len(stream) / frame.dn.size


def test_the_frame_has_body_and_sky(flown):
    lit = flown.dn > 100
    assert 0.05 < lit.mean() < 0.5 and flown.dn.max() > 300 and not flown.saturated.any()


@pytest.mark.parametrize("codec", CODECS)
def test_without_loss_it_is_byte_equal_and_small(flown, codec):
    made, rate = sent(flown, codec=codec)
    np.testing.assert_array_equal(made, flown.dn)
    assert rate <= {"jpeg_ls": 3.0}.get(codec, 3.6)


def test_bounds_of_digital_numbers_hold_and_buy_rate(flown):
    rates = []
    for bound in (2, 5, 10):
        made, rate = sent(flown, codec="jpeg_ls", max_error_DN=bound)
        assert 0 < np.abs(made.astype(int) - flown.dn).max() <= bound
        rates.append(rate)
    assert rates[0] > rates[1] > rates[2] and rates[2] < 1.0


def test_half_the_noise_is_half_of_what_two_exposures_differ_by(flown, detector):
    """Noise by the detector's numbers alone: shot noise of the mean signal, read noise, rounding."""
    lit = flown.dn > 100
    signal = (flown.dn[lit] - detector.offset_DN).mean() / detector.gain_DN_per_electron
    noise = np.sqrt(detector.gain_DN_per_electron**2 * (signal + detector.read_noise_electrons**2) + 1.0 / 12.0)
    made, _ = sent(flown, codec="jpeg_ls", share_of_noise=0.5)
    assert 0.2 <= np.std((made.astype(float) - flown.dn)[lit]) / noise <= 0.55


@pytest.mark.parametrize("codec", ["jpeg_2000", "jpeg_xl"])
def test_rates_and_psnr_are_met(flown, codec):
    for wanted in (0.5, 1.0):
        assert sent(flown, codec=codec, rate_bpp=wanted)[1] == pytest.approx(wanted, rel=0.1)
    assert psnr_db(sent(flown, codec=codec, psnr_db=56.0)[0], flown.dn, 12) == pytest.approx(56.0, abs=1.0)
