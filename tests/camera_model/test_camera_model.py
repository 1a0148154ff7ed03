"""The camera model against photometry.md's worked values and closed forms."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from cameras import BUSY, SIMPLE, camera_model, disc, flat, irradiance_of
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
from glrender_camera.camera import checked_exposure
from scipy.integrate import dblquad, quad

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
    stages = busy.expose(np.ones((8, 8), np.float32), 1, points=points, faults=[{"kind": "lost_lines"}]).stages
    assert [name for name, text in stages.items() if text.startswith("skipped")] == ["compression"]
    assert stages["compression"] == "skipped: none given"


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


def test_an_exposure_that_is_text_is_told_of_auto():
    with pytest.raises(ConfigError, match='exposure_s: must be "auto" or a number of seconds, got \'atuo\''):
        checked_exposure("exposure_s", "atuo")
