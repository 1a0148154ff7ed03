"""What a camera model is given: bad input, frame transfer, faulty pixels, nonlinearity, presets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cameras import BUSY, SIMPLE, camera_model, disc, flat, irradiance_of
from glrender_camera import CameraModel, ConfigError, Detector, Optics, PointSources
from glrender_camera.presets import PRESETS

# Bad input


@pytest.mark.parametrize("value, rule", [(np.nan, "finite"), (np.inf, "finite"), (-np.inf, "finite"),
                                         (-1e-15, "negative")])
def test_a_bad_pixel_is_refused_with_its_place(value, rule):
    image = np.full((20, 30), 1e-9, np.float32)
    image[4, 17] = value
    with pytest.raises(ConfigError, match=rule) as error:
        camera_model().expose(image, 1)
    assert error.value.path == "irradiance_W_m2[4, 17]"


def test_rounding_noise_below_zero_is_clipped():
    """-1e-13 of the maximum counts as 0 (issue 5)."""
    image = np.full((20, 30), 1e-9, np.float32)
    image[3, 3] = -1e-22
    assert camera_model().expose(image, 1).electrons[3, 3] == 0.0


@pytest.mark.parametrize("field, value", [
    ("quantum_efficiency", 1.2), ("quantum_efficiency", np.nan), ("quantum_efficiency", [[500, 0.5]]),
    ("quantum_efficiency", [[500, 0.5], [400, 0.5]]), ("full_well_electrons", 0.0),
    ("gain_DN_per_electron", 0), ("bit_depth", 17), ("bit_depth", 8.5), ("read_noise_electrons", -1),
    ("dark_current_electrons_per_s", np.inf), ("photo_response_nonuniformity", 0.5), ("sensor_seed", -1),
    ("temperature_K", 0.0), ("offset_DN", "many")])
def test_a_bad_detector_is_refused_by_field(field, value):
    with pytest.raises(ConfigError) as error:
        Detector(**(SIMPLE | {field: value}))
    assert error.value.path.startswith(field)


@pytest.mark.parametrize("keys, value, path", [
    (("optics", "aperture_m"), 1.0, "optics.aperture_m"),
    (("optics", "aperture_diameter_m"), 0.0, "optics.aperture_diameter_m"),
    (("optics", "band_nm"), [900, 400], "optics.band_nm"),
    (("optics", "psf_sigma_px"), -0.1, "optics.psf_sigma_px"),
    (("detector", "gain"), 1.0, "detector.gain"), (("exposure_s",), 0.0, "exposure_s"),
    (("exposure_s",), "automatic", "exposure_s"), (("shutter",), "open", "shutter"),
    (("optics",), 3, "optics"), (("auto_exposure",), {"min_s": 1e-3, "max_s": 1e-4}, "auto_exposure.max_s")])
def test_a_bad_table_is_refused_with_the_path(keys, value, path):
    table = {"optics": {"aperture_diameter_m": 0.01}, "detector": dict(SIMPLE), "exposure_s": 0.1}
    target = table
    for key in keys[:-1]:
        target = target[key]
    target[keys[-1]] = value
    with pytest.raises(ConfigError) as error:
        CameraModel.from_dict(table)
    assert error.value.path == path


@pytest.mark.parametrize("arguments, path", [
    (dict(exposure_s=0.0), "exposure_s"), (dict(exposure_s=np.nan), "exposure_s"), (dict(seed=-1), "seed"),
    (dict(seed=2**64), "seed"), (dict(roi=(0, 0, 9, 5)), "roi[2]"), (dict(roi=(1, 2, 3)), "roi"),
    (dict(roi=5), "roi"), (dict(points=[(1.0, 2.0)]), "points"), (dict(previous=0.1), "previous"),
    (dict(margin_px=4), "margin_px"), (dict(margin_px=-1), "margin_px"),
    (dict(relative_illumination=np.ones((8, 9))), "relative_illumination")])
def test_a_bad_request_is_refused_by_field(arguments, path):
    with pytest.raises(ConfigError) as error:
        camera_model().expose(np.zeros((8, 8), np.float32), **arguments)
    assert error.value.path == path


@pytest.mark.parametrize("image", [np.zeros(5, np.float32), np.zeros((3, 3), int),
                                   np.zeros((0, 3), np.float32)])
def test_what_is_no_image_is_refused(image):
    with pytest.raises(ConfigError, match="array of floats"):
        camera_model().expose(image, 1)


def test_the_input_is_left_as_it_was():
    model = camera_model(optics=dict(psf_sigma_px=1.0), **BUSY)
    image = disc(model=model)
    before = image.tobytes()
    image.setflags(write=False)
    model.expose(image, 1)
    assert image.tobytes() == before


# Frame transfer, hot pixels, nonlinearity


def test_frame_transfer_smears_the_column_by_its_sum():
    """A source of 1e5 e- on 1e-5 s a row and 0.1 s: 10 e- on each other pixel of its column, 5 sigma."""
    model = camera_model(frame_transfer_row_s=1e-5)
    image = np.zeros((101, 40), np.float32)
    image[50, 20] = irradiance_of(9e4, model)
    electrons = np.mean([model.expose(image, seed).electrons for seed in range(100)], axis=0, dtype=np.float64)
    column = np.delete(electrons[:, 20], 50)
    np.testing.assert_allclose(column.mean(), 9.0, atol=5.0 * np.sqrt(9.0 / 100 / 100))
    assert not np.delete(electrons, 20, axis=1).any()


def test_hot_pixels_are_the_sensors_and_scale_with_time_and_warmth():
    """Share exact, mean rate within 5 sigma of the exponential; twice the time and 8 K: four times."""
    fields = dict(hot_pixel_fraction=0.01, hot_pixel_electrons_per_s=1000.0)
    dark = np.zeros((400, 500), np.float32)
    cold = camera_model(**fields).expose(dark, 1, exposure_s=1.0).electrons
    warm = camera_model(**fields, temperature_K=301.15).expose(dark, 2, exposure_s=2.0).electrons
    lit = cold > 0.0
    np.testing.assert_allclose(cold.sum() / (0.01 * dark.size), 1000.0, atol=5.0 * 1000.0 / np.sqrt(2000.0))
    assert 1900 < np.count_nonzero(lit) <= 2000
    np.testing.assert_allclose(warm[lit].sum() / cold[lit].sum(), 4.0, rtol=0.01)
    assert np.count_nonzero(warm[~lit]) < 10


@pytest.mark.parametrize("prnu", [0.0, 0.02])
def test_dead_pixels_are_the_sensors_and_see_no_light(prnu):
    """1 % of the pixels stay dark in every frame, other seeds have others; dark current is theirs all the same."""
    model = camera_model(dead_pixel_fraction=0.01, photo_response_nonuniformity=prnu, dark_current_electrons_per_s=3e3)
    frames = [model.expose(flat(model, 40000.0), seed) for seed in (1, 2)]
    dead = [frame.electrons < 1000.0 for frame in frames]
    np.testing.assert_array_equal(dead[0], dead[1])
    assert dead[0].sum() == round(0.01 * 256 * 256)
    np.testing.assert_allclose(frames[0].electrons[dead[0]].mean(), 300.0, rtol=0.02)
    other = camera_model(dead_pixel_fraction=0.01, sensor_seed=5).expose(flat(model, 40000.0), 1)
    assert ((other.electrons < 1000.0) & dead[0]).sum() < 30


def test_the_nonlinearity_table_acts_before_rounding():
    """A linear table is no table; a bent one maps the mean through its straight pieces."""
    image = flat(camera_model(), 50000.0)
    straight = camera_model(nonlinearity_DN=[[0, 0], [4095, 4095]]).expose(image, 3)
    np.testing.assert_array_equal(straight.dn, camera_model().expose(image, 3).dn)
    bent = camera_model(nonlinearity_DN=[[0, 0], [2000, 2000], [4000, 3800]]).expose(image, 3)
    expected = 2000.0 + 0.9 * (0.04 * bent.electrons.astype(np.float64) + 50.0 - 2000.0)
    np.testing.assert_allclose(bent.dn, expected, atol=0.501)


@pytest.mark.parametrize("field, value", [
    ("hot_pixel_fraction", 0.2), ("dead_pixel_fraction", 0.2), ("frame_transfer_row_s", -1e-6),
    ("nonlinearity_DN", [[0, 0]]),
    ("nonlinearity_DN", [[0, 0], [10, -1]]), ("nonlinearity_DN", "none")])
def test_bad_extras_are_refused_by_field(field, value):
    with pytest.raises(ConfigError) as error:
        Detector(**(SIMPLE | {field: value}))
    assert error.value.path == field


# Presets


def test_a_preset_is_a_start_whose_fields_can_be_replaced():
    model = CameraModel.from_dict({"preset": "generic_navigation_camera", "exposure_s": 0.1,
                                   "detector": {"read_noise_electrons": 20.0}})
    assert model.exposure_s == 0.1 and model.detector.read_noise_electrons == 20.0
    assert model.detector.bit_depth == 12 and model.optics.psf_sigma_px == 0.7
    # photometry.md 1.6's worked example, the well aside.
    electrons = 3.1619e-8 * model.optics.aperture_area_m2 * model.electrons_per_joule * model.exposure_s
    np.testing.assert_allclose(electrons, 7.54e5, rtol=0.01)


@pytest.mark.parametrize("name, missing", [
    ("dawn_framing_camera", {"full_well_electrons": 2e5}), ("hayabusa_amica", {"quantum_efficiency": 0.3}),
    ("rosetta_navcam", {"gain_DN_per_electron": 0.04}), ("rosetta_navcam_attenuated", {"gain_DN_per_electron": 0.04})])
def test_a_preset_asks_for_what_no_source_gives(name, missing):
    (field,) = missing
    with pytest.raises(ConfigError) as error:
        CameraModel.from_dict({"preset": name})
    assert error.value.path == f"detector.{field}" and error.value.rule == "missing"
    frame = CameraModel.from_dict({"preset": name, "detector": missing}).expose(np.full((16, 16), 1e-8, np.float32), 1)
    assert frame.dn.max() > 0


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_a_presets_dark_frame_holds_its_read_noise(name):
    """Its digital numbers scatter as read noise and rounding do (EMVA 1288); cut off at 0 it would lose 0.4."""
    given = {"quantum_efficiency": 0.3, "full_well_electrons": 7e4, "gain_DN_per_electron": 0.1, "bit_depth": 12}
    own = PRESETS[name]["detector"]
    model = CameraModel.from_dict({"preset": name, "exposure_s": 1e-3, "detector": {
        **{key: value for key, value in given.items() if key not in own}, "dark_signal_nonuniformity_electrons": 0.0}})
    frame = model.expose(np.zeros((300, 300), np.float32), 1)
    sigma_DN = model.detector.read_noise_electrons * model.detector.gain_DN_per_electron
    np.testing.assert_allclose(frame.dn.std(), np.hypot(sigma_DN, 12**-0.5) if sigma_DN else 0.0, rtol=0.1)
    assert "clipped" not in frame.stages["read_noise"]


def test_read_noise_that_is_cut_off_is_told(caplog):
    """Without an offset a half of it is, and the mean of the rest is sigma / sqrt(2 pi)."""
    cut = camera_model(read_noise_electrons=50.0, gain_DN_per_electron=1.0, offset_DN=0.0)
    frame = cut.expose(np.zeros((300, 300), np.float32), 1)
    np.testing.assert_allclose(frame.dn.mean(), 50.0 / np.sqrt(2.0 * np.pi), rtol=0.02)
    assert frame.stages["read_noise"].startswith("50 e-; 50% of the noise is clipped at 0 DN")
    assert "read noise of 50 e-: 50% of the noise is clipped" in caplog.text
    assert "offset_DN of 150 or more" in caplog.text
    whole = replace(cut, detector=replace(cut.detector, offset_DN=150.0))
    assert whole.expose(np.zeros((300, 300), np.float32), 1).stages["read_noise"] == "50 e-"


@pytest.mark.parametrize("name, low, high", [("rosetta_navcam", 0.50, 0.55), ("rosetta_navcam_attenuated", 0.65, 0.70)])
def test_a_star_keeps_in_its_pixel_what_navcams_description_says(name, low, high):
    model = CameraModel.from_dict({"preset": name, "detector": {"gain_DN_per_electron": 0.04}})
    star = np.zeros((31, 31), np.float32)
    star[15, 15] = 1.0
    assert low < model.optics.spread(star, is_points=True)[15, 15] < high


def test_navcams_attenuation_is_580_times():
    bright, dim = (CameraModel.from_dict({"preset": name, "detector": {"gain_DN_per_electron": 0.04}})
                   for name in ("rosetta_navcam", "rosetta_navcam_attenuated"))
    light = [m.optics.aperture_area_m2 * m.electrons_per_joule for m in (bright, dim)]
    np.testing.assert_allclose(light[0] / light[1], 580.0, rtol=1e-9)


@pytest.mark.parametrize("table, path", [
    ({"preset": "kodak"}, "preset"), ({"preset": "generic_navigation_camera", "optics": 1}, "optics"),
    ({"preset": "generic_navigation_camera", "detector": {"well": 1}}, "detector.well"),
    ({"preset": ["a"]}, "preset")])
def test_a_bad_preset_is_refused_by_field(table, path):
    with pytest.raises(ConfigError) as error:
        CameraModel.from_dict(table)
    assert error.value.path == path


def test_a_stars_centroid_survives_the_whole_chain():
    """Shared out bilinearly to four pixels; mean of 16 frames' centroids within 0.01 px (issue 5)."""
    model = camera_model(optics=dict(psf_sigma_px=1.1), read_noise_electrons=5.0, offset_DN=100.0,
                         gain_DN_per_electron=0.25, full_well_electrons=16000.0, dark_current_electrons_per_s=5.0)
    y, x, dy, dx = 20, 17, 0.3, 0.65
    image = np.zeros((41, 37), np.float32)
    image[y:y + 2, x:x + 2] = irradiance_of(60000.0, model) * np.outer([1 - dy, dy], [1 - dx, dx])
    frames = np.mean([model.expose(image, seed).dn for seed in range(16)], axis=0)
    window = np.s_[y - 7:y + 9, x - 7:x + 9]
    light = frames[window] - np.median(frames)
    rows, columns = np.indices(light.shape)
    centroid = np.array([(light * rows).sum(), (light * columns).sum()]) / light.sum() + (y - 7, x - 7)
    np.testing.assert_allclose(centroid, [y + dy, x + dx], atol=0.01)


@pytest.mark.parametrize("optics, detector, path, ranges", [
    ({"transmission": [[1100.0, 0.5], [1700.0, 0.6]]}, {}, "transmission", ("450 to 950 nm", "1100 to 1700 nm")),
    ({}, {"quantum_efficiency": [[200.0, 0.5], [400.0, 0.6]]}, "detector.quantum_efficiency",
     ("450 to 950 nm", "200 to 400 nm")),
    ({}, {"quantum_efficiency": [[0.45, 0.5], [0.95, 0.6]]}, "detector.quantum_efficiency",
     ("450 to 950 nm", "0.45 to 0.95 nm")),
    ({"transmission": [[400.0, 0.0], [1000.0, 0.0], [1100.0, 0.5]]}, {}, "transmission",
     ("450 to 950 nm", "400 to 1100 nm"))])
def test_a_curve_that_misses_the_band_is_refused_with_both_ranges(optics, detector, path, ranges):
    """Also one in micrometres, and one that is zero in the band."""
    with pytest.raises(ConfigError) as error:
        CameraModel(optics=Optics(aperture_diameter_m=0.0151, **optics), detector=Detector(**(SIMPLE | detector)),
                    exposure_s=0.1)
    assert error.value.path == path
    assert all(each in str(error.value) for each in ranges)


def test_negative_irradiance_of_points_is_told():
    with pytest.raises(ConfigError, match=r"irradiance_W_m2: must be finite, irradiances >= 0, got \[-1.0\]"):
        PointSources([[0.0, 0.0], [1.0, 1.0]], [2.0, -1.0])
    with pytest.raises(ConfigError, match=r"xy_px: must be finite"):
        PointSources([[np.nan, 0.0]], [1.0])


@pytest.mark.parametrize("got, shown", [(np.float64(-5.0), "-5.0"), (np.int64(3), "3"), (np.bool_(True), "True"),
                                        ([np.float32(0.5), 2], "[0.5, 2]"), (np.array([1.0, 2.0]), "array([1., 2.])")])
def test_an_error_shows_a_number_as_a_user_writes_it(got, shown):
    assert str(ConfigError("field", "must be another", got)) == f"field: must be another, got {shown}"
