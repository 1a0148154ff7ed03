"""Noise and fixed patterns are a camera's own, a frame's own and a seed's own; the same request gives the same bytes.

Truth is independence: the correlation of N pairs of independent pixels is 0 within 5 / sqrt(N).
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from cameras import camera_model, flat
from glrender_camera import ConfigError, MosaicModel, Optics, PinholeCamera
from glrender_camera.pattern import seed_of

SHAPE = (128, 160)
LIMIT = 5.0 / np.sqrt(SHAPE[0] * SHAPE[1])
NAMES = ("left", "right", "Left", "left ", "Náv 2", "カメラ", "a" * 128)
SOURCES = {"read noise": {"read_noise_electrons": 300.0},
           "shot noise": {"dark_current_electrons_per_s": 1e5},
           "fixed offset": {"dark_signal_nonuniformity_electrons": 300.0},
           "response": {"photo_response_nonuniformity": 0.1},
           "dark current": {"dark_current_nonuniformity": 0.3, "dark_current_electrons_per_s": 1e5},
           "hot pixels": {"hot_pixel_fraction": 0.01, "hot_pixel_electrons_per_s": 2e5},
           "dead pixels": {"dead_pixel_fraction": 0.05},
           "cosmic rays": {"cosmic_ray_hits_per_px_s": 0.01, "cosmic_ray_depth_px": 5.0}}


def camera(name, model):
    return PinholeCamera(name=name, width_px=SHAPE[1], height_px=SHAPE[0], focal_length_px=300.0, model=model)


def alike(a, b):
    return abs(np.corrcoef(a.electrons.ravel(), b.electrons.ravel())[0, 1])


@pytest.mark.parametrize("source", SOURCES)
def test_cameras_of_one_type_share_no_noise(source):
    model = camera_model(**SOURCES[source])
    # The light without its fall-off to the corners, which frames have in common.
    light = flat(model, 3e4, SHAPE) / camera("a", model).cos_field_angle
    taken = [camera(name, model).expose(light, 5) for name in NAMES]
    assert all(frame.seed == 5 for frame in taken)
    assert max(alike(a, b) for a, b in combinations(taken, 2)) < LIMIT
    again = camera("left", model).expose(light, 5)
    np.testing.assert_array_equal(again.dn, taken[0].dn)


def test_cameras_share_no_faults():
    model = camera_model()
    faults = [{"kind": "lost_lines", "n_lines": 1}, {"kind": "dead_columns", "n_columns": 1}]
    truths = [camera(f"c{k}", model).expose(flat(model, 100.0, SHAPE), 5, faults=faults).faults for k in range(8)]
    for number in range(2):
        assert len({str(truth[number]) for truth in truths}) > 6


def test_the_bands_of_a_mosaic_are_read_by_one_sensor_and_that_is_the_cameras_own():
    model = camera_model(dark_signal_nonuniformity_electrons=300.0)
    optics = {letter: Optics(aperture_diameter_m=0.0151) for letter in "RGB"}
    mosaic = MosaicModel(optics=optics, detector=model.detector, exposure_s=0.1)
    dark = {letter: np.zeros(SHAPE, np.float32) for letter in "RGB"}
    left, right, again = (camera(name, mosaic).expose(dark, seed) for name, seed in
                          (("left", 5), ("right", 5), ("left", 6)))
    assert alike(left, right) < LIMIT
    # The fixed pattern stays from frame to frame.
    np.testing.assert_array_equal(left.electrons, again.electrons)


def test_the_fixed_pattern_stays_and_the_noise_does_not():
    model = camera_model(dark_signal_nonuniformity_electrons=300.0, read_noise_electrons=300.0)
    dark = np.zeros(SHAPE, np.float32)
    frames = [camera("left", model).expose(dark, seed) for seed in range(4)]
    for a, b in combinations(frames, 2):
        assert alike(a, b) == pytest.approx(0.5, abs=LIMIT)


def test_neighbouring_seeds_and_frames_share_no_noise():
    """Frame k + 1 of seed s is not frame k of seed s + 1, nor is any other of a block of seeds and frames."""
    seeds = [seed_of(seed, frame) for seed in range(40) for frame in range(40)]
    assert len(set(seeds)) == len(seeds) and not set(seeds) & set(range(100))
    assert max(seeds) < 2**53 and min(seeds) >= 0
    model = camera_model(read_noise_electrons=300.0)
    taken = [camera("c", model).expose(np.zeros(SHAPE, np.float32), seed_of(seed, frame))
             for seed in (0, 1, 2) for frame in (0, 1, 2)]
    assert max(alike(a, b) for a, b in combinations(taken, 2)) < LIMIT


def test_keys_of_seeds_are_apart_by_kind_and_length():
    """A number of NumPy is that number; none is a name, though "a" has the byte 97; lengths of names count."""
    for kind in (np.int64, np.uint8, np.int32):
        assert seed_of(3, kind(97)) == seed_of(3, 97)
    keys = [0, 1, 97, 2**32, 2**64, "", "a", "a\0", "\0", "aa", "97", "\x01", "é", "カ"]
    assert len({seed_of(3, key) for key in keys}) == len(keys)
    with pytest.raises(TypeError):
        seed_of(3, 1.5)
    assert seed_of(3, np.str_("a")) == seed_of(3, "a") != seed_of(np.int64(4), "a")


def test_the_largest_seed_is_taken_and_others_are_refused():
    model = camera_model(read_noise_electrons=10.0)
    dark = np.zeros(SHAPE, np.float32)
    assert camera("c", model).expose(dark, 2**64 - 1).seed == 2**64 - 1
    for seed in (-1, 2**64, 0.5):
        with pytest.raises(ConfigError, match="seed"):
            camera("c", model).expose(dark, seed)
