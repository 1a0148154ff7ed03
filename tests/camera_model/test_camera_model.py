"""The camera model against photometry.md's worked values, closed forms and its bad-input rules."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from glrender_camera import (
    AutoExposure,
    CameraModel,
    ConfigError,
    Detector,
    Optics,
    PinholeCamera,
    PointSources,
    StrayLight,
    spectrum,
)
from glrender_camera.presets import PRESETS
from scipy.integrate import dblquad, quad

SIMPLE = dict(quantum_efficiency=0.5, full_well_electrons=1e5, gain_DN_per_electron=0.04, bit_depth=12,
              offset_DN=50.0)


def camera_model(exposure_s=0.1, optics=None, **detector):
    return CameraModel(optics=Optics(aperture_diameter_m=0.0151, transmission=0.8, **(optics or {})),
                       detector=Detector(**(SIMPLE | detector)), exposure_s=exposure_s)


def irradiance_of(electrons, model):
    """Irradiance [W/m2] that gives so many mean electrons in the model's exposure."""
    return electrons / (model.optics.aperture_area_m2 * model.electrons_per_joule * model.exposure_s)


def flat(model, electrons, shape=(256, 256)):
    return np.full(shape, irradiance_of(electrons, model), np.float32)


# Radiometry


def test_electrons_of_the_worked_example():
    """photometry.md 1.6: 3.1619e-8 W/m2, D 15.1 mm, tau 0.8, 0.1 s, QE 0.5: 7.54e5 e-; black body 1 %."""
    model = camera_model(optics=dict(band_nm=(450.0, 950.0)))
    electrons = 3.1619e-8 * model.optics.aperture_area_m2 * 0.1 * model.electrons_per_joule
    np.testing.assert_allclose(electrons, 7.54e5, rtol=0.01)


@pytest.mark.parametrize("band_nm, watts, photons", [
    ((400.0, 700.0), 530.105, 1.45384e21), ((400.0, 1000.0), 841.264, 2.76047e21),
    ((350.0, 1000.0), 893.920, 2.86006e21), ((500.0, 600.0), 184.878, 5.11473e20),
    ((300.0, 1100.0), 999.519, 3.27511e21)])
def test_photons_per_joule_against_the_solar_spectrum(band_nm, watts, photons):
    """ASTM E490-00a integrals (photometry.md 1.6); a black body stands in for the lines: 1 %."""
    np.testing.assert_allclose(spectrum.electrons_per_joule(band_nm, 1.0, 1.0), photons / watts, rtol=0.01)


def test_a_quantum_efficiency_curve_is_integrated_over_the_band():
    """Against scipy's adaptive quadrature of the docstring's formula, 1e-7."""
    curve = ((400.0, 0.2), (550.0, 0.6), (800.0, 0.45), (1000.0, 0.05))
    knots = [w for w, _ in curve]
    h, c, k, t = 6.62607015e-34, 299792458.0, 1.380649e-23, 5772.0

    def sun(w):
        return w**-5 / np.expm1(h * c / (w * 1e-9 * k * t))

    def counted(w):
        return sun(w) * np.interp(w, *np.array(curve).T, left=0.0, right=0.0) * w * 1e-9 / (h * c)

    expected = (quad(counted, 380.0, 1020.0, points=knots, limit=200)[0] / quad(sun, 380.0, 1020.0)[0])
    np.testing.assert_allclose(spectrum.electrons_per_joule((380.0, 1020.0), 1.0, curve), expected, rtol=1e-7)
    # Transmission and quantum efficiency play the same part.
    np.testing.assert_allclose(spectrum.electrons_per_joule((380.0, 1020.0), curve, 1.0), expected, rtol=1e-7)


def test_mean_signal_is_linear_in_exposure_and_aperture():
    """Without noise sources but the Poisson draw: 1e5 pixels' mean, 5 sigma."""
    for exposure_s, diameter in ((0.1, 0.0151), (0.2, 0.0151), (0.1, 0.0302)):
        model = CameraModel(optics=Optics(aperture_diameter_m=diameter, transmission=0.8),
                            detector=Detector(**SIMPLE), exposure_s=exposure_s)
        irradiance = np.full((300, 300), irradiance_of(1000.0, camera_model()), np.float32)
        expected = 1000.0 * exposure_s / 0.1 * (diameter / 0.0151) ** 2
        mean = model.expose(irradiance, 1).electrons.mean(dtype=np.float64)
        np.testing.assert_allclose(mean, expected, atol=5.0 * np.sqrt(expected) / 300.0)


# Optics


@pytest.mark.parametrize("sigma_px", [0.3, 0.5, 0.8])
def test_the_gaussian_is_integrated_over_the_pixel(sigma_px):
    """Kernel against scipy's quadrature of the Gaussian over pixels, 1e-9; peaks of photometry.md 4.5."""
    kernel = Optics(aperture_diameter_m=0.01, psf_sigma_px=sigma_px).psf_kernel
    centre = kernel.size // 2
    for i, j in ((0, 0), (0, 1), (1, 1), (2, 1)):
        density = lambda y, x: np.exp(-(x**2 + y**2) / (2 * sigma_px**2)) / (2 * np.pi * sigma_px**2)  # noqa: E731
        expected = dblquad(density, i - 0.5, i + 0.5, j - 0.5, j + 0.5, epsabs=1e-11)[0]
        np.testing.assert_allclose(kernel[centre + i] * kernel[centre + j], expected, atol=1e-9)
    np.testing.assert_allclose(kernel[centre] ** 2, {0.3: 0.818, 0.5: 0.466, 0.8: 0.219}[sigma_px], atol=5e-4)


def test_the_kernel_has_the_variance_of_gaussian_and_pixel():
    """sigma^2 + 1/12, 1e-6 (photometry.md 4.5)."""
    kernel = Optics(aperture_diameter_m=0.01, psf_sigma_px=1.3).psf_kernel
    offset = np.arange(kernel.size) - kernel.size // 2
    np.testing.assert_allclose(np.sum(kernel * offset**2), 1.3**2 + 1.0 / 12.0, rtol=1e-5)


def test_spreading_conserves_flux_and_centroid_and_does_not_wrap():
    """A point in the open: flux 1e-6, centroid 1e-6 px; a point in a corner puts nothing opposite."""
    optics = Optics(aperture_diameter_m=0.01, psf_sigma_px=2.0)
    image = np.zeros((101, 121), np.float32)
    image[40, 70] = 1.0
    spread = optics.spread(image).astype(np.float64)
    np.testing.assert_allclose(spread.sum(), 1.0, atol=1e-6)
    y, x = np.indices(image.shape)
    centroid = [(spread * y).sum(), (spread * x).sum()] / spread.sum()
    np.testing.assert_allclose(centroid, [40.0, 70.0], atol=1e-6)
    corner = np.zeros((64, 64), np.float32)
    corner[0, 0] = 1.0
    assert not optics.spread(corner)[32:].any() and not optics.spread(corner)[:, 32:].any()


def test_energy_cut_by_the_kernel_is_reported():
    """Less than float32's rounding, and what is missing from the kernel's sum."""
    optics = Optics(aperture_diameter_m=0.01, psf_sigma_px=1.0)
    assert 0.0 <= optics.psf_energy_cut < 1e-7
    assert "energy cut" in camera_model(optics=dict(psf_sigma_px=1.0)).expose(
        np.ones((8, 8), np.float32) * 1e-9, 1).stages["psf"]


# Order of the chain


def test_noise_is_drawn_after_the_point_spread_function():
    """Flat field: variance over mean is 1 within 5 sigma; noise before a PSF of 1 px would leave 8 %."""
    model = camera_model(optics=dict(psf_sigma_px=1.0))
    electrons = model.expose(flat(model, 400.0), 3).electrons[8:-8, 8:-8].astype(np.float64)
    n = electrons.size
    np.testing.assert_allclose(electrons.var() / electrons.mean(), 1.0, atol=5.0 * np.sqrt(2.0 / n))


@pytest.mark.parametrize("quantum_efficiency", [0.1, 0.5])
def test_shot_noise_is_of_electrons_not_photons(quantum_efficiency):
    """Poisson(photons) x QE would have variance / mean = QE (photometry.md 4.6); 5 sigma."""
    model = camera_model(quantum_efficiency=quantum_efficiency)
    electrons = model.expose(flat(model, 300.0), 3).electrons.astype(np.float64)
    n = electrons.size
    np.testing.assert_allclose(electrons.var() / electrons.mean(), 1.0, atol=5.0 * np.sqrt(2.0 / n))


def test_rounding_takes_nothing_from_the_mean():
    """Electrons spread over many DN: mean(dn) = K electrons + offset within 5 sigma of 1/12; floor: -0.5."""
    model = camera_model(gain_DN_per_electron=0.013, read_noise_electrons=300.0)
    frame = model.expose(flat(model, 40000.0), 5)
    difference = frame.dn - (frame.electrons.astype(np.float64) * 0.013 + 50.0)
    np.testing.assert_allclose(difference.mean(), 0.0, atol=5.0 * np.sqrt(1.0 / 12.0 / difference.size))
    np.testing.assert_allclose(difference.var(), 1.0 / 12.0, rtol=0.03)


def test_full_well_comes_before_the_converter():
    """A pixel a hundred wells deep reads the well, not the converter's end; both are marked."""
    deep = camera_model(full_well_electrons=20000.0)
    frame = deep.expose(flat(deep, 2e6), 1)
    assert frame.saturated.all() and (frame.dn == 20000 * 0.04 + 50).all()
    shallow = camera_model(full_well_electrons=1e6)
    frame = shallow.expose(flat(shallow, 2e5), 1)
    assert frame.saturated.all() and (frame.dn == 4095).all()
    assert not camera_model().expose(flat(camera_model(), 500.0), 1).saturated.any()


def test_the_sun_in_the_field_of_view_saturates():
    """1e30 W/m2 is a saturated pixel; its neighbours stay finite."""
    image = np.zeros((32, 32), np.float32)
    image[16, 16] = 1e30
    frame = camera_model(optics=dict(psf_sigma_px=1.0)).expose(image, 1)
    assert frame.saturated[16, 16] and np.isfinite(frame.electrons).all() and frame.dn[16, 16] == 4050


def test_dark_current_doubles_with_warmth():
    """8 K warmer: twice the mean; mean and variance agree, 5 sigma (one Poisson draw)."""
    for warmer_K, factor in ((0.0, 1.0), (8.0, 2.0), (-16.0, 0.25)):
        model = camera_model(dark_current_electrons_per_s=200.0, temperature_K=293.15 + warmer_K)
        dark = model.expose(np.zeros((300, 300), np.float32), 2).electrons.astype(np.float64)
        np.testing.assert_allclose(dark.mean(), 20.0 * factor, atol=5.0 * np.sqrt(20.0 * factor) / 300.0)
        np.testing.assert_allclose(dark.var() / dark.mean(), 1.0, atol=5.0 * np.sqrt(2.0) / 300.0 * 1.1)


@pytest.mark.parametrize("bit_depth, dtype", [(1, np.uint8), (8, np.uint8), (10, np.uint16), (16, np.uint16)])
def test_type_of_the_numbers_follows_the_bit_depth(bit_depth, dtype):
    model = camera_model(bit_depth=bit_depth, gain_DN_per_electron=1.0, offset_DN=0.5)
    frame = model.expose(np.zeros((8, 8), np.float32), 1)
    assert frame.dn.dtype == dtype and frame.dn.max() <= 2**bit_depth - 1


# Seeds, regions and threads

BUSY = dict(hot_pixel_fraction=1e-3, hot_pixel_electrons_per_s=500.0, frame_transfer_row_s=1e-6,
            nonlinearity_DN=((0.0, 0.0), (4095.0, 4090.0)), read_noise_electrons=10.0,
            dark_current_electrons_per_s=5.0, photo_response_nonuniformity=0.01,
            dark_signal_nonuniformity_electrons=3.0, dark_current_nonuniformity=0.1,
            cosmic_ray_hits_per_px_s=1e-3, dead_pixel_fraction=0.02)


def disc(shape=(300, 400), peak_electrons=5000.0, model=None):
    y, x = np.indices(shape)
    height = np.clip(1.0 - ((x - 180.5) ** 2 + (y - 140.2) ** 2) / 60.0**2, 0.0, None) ** 0.5
    return (irradiance_of(peak_electrons, model) * height).astype(np.float32)


def test_equal_seeds_give_equal_bytes_and_a_region_changes_none():
    model = camera_model(optics=dict(psf_sigma_px=1.2), **BUSY)
    image = disc(model=model)
    frames = [model.expose(image, 7), model.expose(image, 7), model.expose(image, 7, roi=(100, 60, 260, 230)),
              model.expose(image, 7, roi=(0, 0, 400, 300))]
    for frame in frames[1:]:
        assert frame.dn.tobytes() == frames[0].dn.tobytes()
        assert frame.electrons.tobytes() == frames[0].electrons.tobytes()
    assert model.expose(image, 8).dn.tobytes() != frames[0].dn.tobytes()


def test_bytes_do_not_depend_on_the_number_of_threads():
    """One processor allowed against all, in processes of their own."""
    code = ("import os, sys, hashlib, numpy as np\n"
            "if sys.argv[1] == 'one':\n"
            "    os.cpu_count = lambda: 1\n"
            "    import cv2; cv2.setNumThreads(1)\n"
            "from glrender_camera import CameraModel\n"
            "lens = {'aperture_diameter_m': 0.01, 'f_number': 8.0, 'pixel_pitch_m': 5e-6}\n"
            "m = CameraModel.from_dict({'optics': lens,"
            " 'detector': {'quantum_efficiency': 0.5, 'full_well_electrons': 1e5, 'bit_depth': 12,"
            " 'gain_DN_per_electron': 0.04, 'read_noise_electrons': 9.0,"
            " 'dark_current_electrons_per_s': 20.0},"
            " 'exposure_s': 0.1})\n"
            "e = np.linspace(0, 1e-7, 400 * 500, dtype=np.float32).reshape(400, 500)\n"
            "sys.stdout.write(hashlib.sha256(m.expose(e, 5).dn.tobytes()).hexdigest())\n")
    hashes = [subprocess.run([sys.executable, "-c", code, how], capture_output=True, text=True, timeout=120,
                             check=True, env=os.environ).stdout for how in ("one", "all")]
    assert hashes[0] == hashes[1] and len(hashes[0]) == 64


def test_the_fixed_pattern_belongs_to_the_sensor_and_noise_to_the_frame():
    """Mean frames of two seeds share the sensor's pattern; another sensor's is unrelated."""
    model = camera_model(photo_response_nonuniformity=0.05)
    image = flat(model, 50000.0, (64, 64))
    first, second = (np.mean([model.expose(image, seed).electrons for seed in seeds], axis=0)
                     for seeds in (range(8), range(8, 16)))
    assert np.corrcoef(first.ravel(), second.ravel())[0, 1] > 0.95
    other = camera_model(photo_response_nonuniformity=0.05, sensor_seed=1)
    third = np.mean([other.expose(image, seed).electrons for seed in range(8)], axis=0)
    assert abs(np.corrcoef(first.ravel(), third.ravel())[0, 1]) < 0.08


def test_sensor_and_frame_streams_differ_when_the_seeds_are_equal():
    """PRNU map and read noise of seed 5 in both: correlation of 64k pixels below 5 sigma."""
    detector = Detector(**(SIMPLE | dict(photo_response_nonuniformity=0.1, read_noise_electrons=1.0,
                                         sensor_seed=5)))
    noise = detector.read(np.zeros((256, 256), np.float32), 1.0, 5)[1]
    response = detector.fixed_pattern((256, 256)).response
    assert abs(np.corrcoef(noise.ravel(), response.ravel())[0, 1]) < 5.0 / 256.0


# Exposure


def test_automatic_exposure_puts_the_percentile_at_its_target():
    """Flat disc: its electrons at 0.5 of full scale within 1 %, from any brightness; no light: longest."""
    model = CameraModel(optics=Optics(aperture_diameter_m=0.0151), detector=Detector(**SIMPLE),
                        exposure_s="auto",
                        auto_exposure=AutoExposure(percentile=50.0, target=0.5, min_s=1e-3, max_s=4.0))
    y, x = np.indices((200, 200))
    disc = ((x - 90) ** 2 + (y - 110) ** 2 < 40**2).astype(np.float32)
    full_scale = min(1e5, (4095 - 50) / 0.04)
    for level in (1e-9, 1e-8, 1e-7):
        frame = model.expose(disc * np.float32(level), 1)
        np.testing.assert_allclose(np.median(frame.electrons[disc > 0]), 0.5 * full_scale, rtol=0.01)
    assert model.expose(disc * np.float32(1e-3), 1).exposure_s == 1e-3
    assert model.expose(disc * np.float32(1e-14), 1).exposure_s == 4.0
    assert model.expose(np.zeros((8, 8), np.float32), 1).exposure_s == 4.0
    assert model.expose(disc, 1, exposure_s=0.5).exposure_s == 0.5


@pytest.mark.parametrize("start_s, most_frames", [(0.003, 1), (1e-3, 1), (1e-4, 3), (10.0, 7)])
def test_the_exposure_follows_the_last_frame(start_s, most_frames):
    """The median of a steady disc reaches 0.5 of full scale within 1 % and stays; no step above 4."""
    rule = AutoExposure(percentile=50.0, target=0.5, min_s=1e-4, max_s=20.0, max_step=4.0)
    model = CameraModel(optics=Optics(aperture_diameter_m=0.0151), detector=Detector(**SIMPLE), exposure_s="auto",
                        auto_exposure=rule)
    y, x = np.indices((200, 200))
    disc = ((x - 90) ** 2 + (y - 110) ** 2 < 40**2).astype(np.float32) * np.float32(1e-7)
    full_scale = min(1e5, (4095 - 50) / 0.04)
    frames = [model.expose(disc, 0, exposure_s=start_s)]
    for seed in range(1, most_frames + 3):
        frames.append(model.expose(disc, seed, previous=frames[-1]))
        assert 0.2499 < frames[-1].exposure_s / frames[-2].exposure_s < 4.001
    for frame in frames[most_frames:]:
        np.testing.assert_allclose(np.median(frame.electrons[disc > 0]), 0.5 * full_scale, rtol=0.01)


def test_darkness_and_saturation_move_the_exposure_by_the_largest_step():
    rule = AutoExposure(max_step=3.0, min_s=0.01, max_s=1.0)
    model = replace(camera_model(read_noise_electrons=10.0, dark_current_electrons_per_s=200.0),
                    exposure_s="auto", auto_exposure=rule)
    dark = np.zeros((64, 64), np.float32)
    frame = model.expose(dark, 1, exposure_s=0.2)
    assert model.expose(dark, 2, previous=frame).exposure_s == pytest.approx(0.6)
    frame = model.expose(dark + np.float32(1e-3), 1, exposure_s=0.2)
    assert frame.saturated.all()
    assert model.expose(dark, 2, previous=frame).exposure_s == pytest.approx(0.2 / 3.0)
    assert model.expose(dark, 2, previous=frame, exposure_s=0.5).exposure_s == 0.5
    assert model.expose(dark, 2, previous=model.expose(dark, 1, exposure_s=0.9)).exposure_s == 1.0
    with pytest.raises(ConfigError, match="max_step: must be > 1, got 1"):
        AutoExposure(max_step=1.0)


def test_stages_say_what_was_skipped_and_why():
    stages = camera_model().expose(np.zeros((8, 8), np.float32), 1).stages
    assert stages["psf"] == "skipped: no pixel is lit"
    assert stages["read_noise"] == "skipped: it is zero"
    assert stages["stray_light"] == "skipped: no pixel is lit"
    stray = StrayLight(wing_fraction=0.01, veiling_glare=0.002)
    busy = camera_model(optics=dict(psf_sigma_px=1.0, stray_light=stray), **BUSY)
    points = PointSources([[3.0, 4.0]], [1.0])
    stages = busy.expose(np.ones((8, 8), np.float32), 1, points=points).stages
    assert not [name for name, text in stages.items() if text.startswith("skipped")]


def test_a_pinhole_camera_foreshortens_its_aperture():
    """cos(theta) at the frame's edge, 30 degrees off axis: 0.866 within 5 sigma of the flat's mean."""
    model = camera_model()
    half = 100
    camera = PinholeCamera(name="wide", width_px=2 * half + 1, height_px=3,
                           focal_length_px=half / np.tan(np.radians(30.0)), model=model)
    image = flat(model, 2000.0, (3, 2 * half + 1))
    frames = np.mean([camera.expose(image, seed).electrons[1] for seed in range(400)], axis=0)
    np.testing.assert_allclose(frames[[0, half, -1]] / 2000.0, [0.8660, 1.0, 0.8660],
                               atol=5.0 / np.sqrt(2000.0 * 400))


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
    (("optics",), 3, "optics"), (("auto_exposure",), {"max_s": 1e-9}, "auto_exposure.max_s")])
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
    assert frame.stages["read_noise"].startswith("50 e-; 50% of it is clipped at 0 DN")
    assert "read noise of 50 e-: 50% of it is clipped" in caplog.text and "offset_DN of 150 or more" in caplog.text
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
