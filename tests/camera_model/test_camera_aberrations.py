"""Aberrated pupils against closed forms, another optics library and the theorem of the centroid."""

from __future__ import annotations

import numpy as np
import pytest
from cells import slow_but
from glrender_camera import Aberrations, CameraModel, ConfigError, Detector, Optics, PinholeCamera, psf, pupil
from glrender_camera.light import light_on_frame
from scipy.integrate import quad
from scipy.special import j0, j1

WAVE_NM = 600.0
OPTICS = dict(aperture_diameter_m=0.015, f_number=8.0, pixel_pitch_m=4.8e-6, band_nm=(599.9, 600.1))
LAMBDA_N_PX = 1.0


def on_axis(**terms):
    """Aberrations -> phase over the pupil on the axis [rad]."""
    lens = Aberrations(**terms)
    return lambda x, y: 2.0 * np.pi / WAVE_NM * lens.opd_nm(x, y)


def peak(phase, obscuration=0.0):
    return pupil.intensity(np.zeros(1, int), np.zeros(1), lambda_n_px=[LAMBDA_N_PX], weights=[1.0],
                           obscuration=obscuration, phase=phase)[0, 0]


def disc_nodes(n_radii=40, n_angles=96):
    """Points of the unit disc and weights that average over it."""
    node, weight = np.polynomial.legendre.leggauss(n_radii)
    r, angle = np.sqrt((node + 1.0) / 2.0)[:, None], np.arange(n_angles) * (2.0 * np.pi / n_angles)
    return r * np.cos(angle), r * np.sin(angle), np.tile(weight[:, None] / (2.0 * n_angles), n_angles)


def moments(kernel):
    """Centroid (x, y) and covariance of a kernel about its middle."""
    y, x = np.indices(kernel.shape) - np.array(kernel.shape)[:, None, None] // 2
    k = kernel / kernel.sum()
    cx, cy = (k * x).sum(), (k * y).sum()
    return np.array([cx, cy]), np.array([[(k * (x - cx) ** 2).sum(), (k * (x - cx) * (y - cy)).sum()],
                                         [(k * (x - cx) * (y - cy)).sum(), (k * (y - cy) ** 2).sum()]])


# The pupil


def test_zernikes_polynomials_are_orthonormal():
    """Noll's first 28 on the disc, 1e-12; defocus and x coma as Noll writes them."""
    x, y, weight = disc_nodes()
    terms = [pupil.zernike(noll, x, y) for noll in range(1, 29)]
    gram = np.array([[(weight * a * b).sum() for b in terms] for a in terms])
    np.testing.assert_allclose(gram, np.eye(28), atol=1e-12)
    r2 = x * x + y * y
    np.testing.assert_allclose(terms[3], np.sqrt(3.0) * (2.0 * r2 - 1.0), atol=1e-12)
    np.testing.assert_allclose(terms[7], np.sqrt(8.0) * (3.0 * r2 - 2.0) * x, atol=1e-12)


@pytest.mark.parametrize("lambda_n_px, obscuration, radius", [(0.4, 0.0, 15), (1.0, 0.35, 15), (2.0, 0.7, 31)])
def test_a_perfect_pupil_gives_airys_pattern(lambda_n_px, obscuration, radius):
    """The Fourier sum against the Bessel functions, 1e-10 of the peak, out to the corners."""
    pixels, offsets = np.arange(-radius, radius + 1), np.array([-0.4, 0.0, 0.3])
    summed = pupil.intensity(pixels, offsets, lambda_n_px=[lambda_n_px], weights=[1.0], obscuration=obscuration,
                             phase=lambda x, y: 0.0 * x)
    points = (pixels[:, None] + offsets).ravel()
    r = np.pi * np.hypot(points[:, None], points[None, :]) / lambda_n_px + 1e-12
    amplitude = 2.0 * j1(r) / r
    if obscuration:
        amplitude = amplitude - obscuration**2 * 2.0 * j1(obscuration * r) / (obscuration * r)
    closed = np.pi / (4.0 * lambda_n_px**2 * (1.0 - obscuration**2)) * amplitude**2
    np.testing.assert_allclose(summed, closed, atol=1e-10 * closed.max())


def test_encircled_energy_of_airys_pattern():
    """1 - J0^2 - J1^2 from radial integrals of the Fourier sum, 1e-8."""
    node, weight = np.polynomial.legendre.leggauss(64)
    for radius in (0.61, 1.22, 3.0, 10.0):
        r = 0.5 * radius * (node + 1.0)
        line = pupil.intensity(np.zeros(1, int), np.concatenate([[0.0], r]), lambda_n_px=[1.0], weights=[1.0],
                               obscuration=0.0, phase=lambda x, y: 0.0 * x)[0, 1:]
        inside = np.sum(0.5 * radius * weight * 2.0 * np.pi * r * line)
        np.testing.assert_allclose(inside, 1.0 - j0(np.pi * radius) ** 2 - j1(np.pi * radius) ** 2, atol=1e-8)


@pytest.mark.parametrize("waves_rms", [0.02, 0.1, 0.3, 1.0])
def test_strehl_ratio_of_defocus(waves_rms):
    """Closed form sinc^2 of the edge's defocus 2 sqrt(3) W_rms, at any size, 1e-9."""
    ratio = peak(on_axis(defocus_nm=waves_rms * WAVE_NM)) / peak(on_axis())
    np.testing.assert_allclose(ratio, np.sinc(2.0 * np.sqrt(3.0) * waves_rms) ** 2, atol=1e-9)


def test_strehl_ratio_of_spherical_aberration():
    """Radial quadrature of Noll's term 11, obscured as well, 1e-9."""
    waves, hole = 0.12, 0.3
    phase = lambda r: 2.0 * np.pi * waves * np.sqrt(5.0) * (6.0 * r**4 - 6.0 * r**2 + 1.0)  # noqa: E731
    real = quad(lambda r: 2.0 * r * np.cos(phase(r)), hole, 1.0)[0]
    imaginary = quad(lambda r: 2.0 * r * np.sin(phase(r)), hole, 1.0)[0]
    ratio = peak(on_axis(spherical_nm=waves * WAVE_NM), hole) / peak(on_axis(), hole)
    np.testing.assert_allclose(ratio, (real**2 + imaginary**2) / (1.0 - hole**2) ** 2, atol=1e-9)


def test_strehl_ratio_of_many_small_terms_is_marechals():
    """exp(-sigma^2) for 0.05 waves RMS over all terms, whatever they are: 2e-3."""
    terms = [(5, 10.0), (7, -12.0), (8, 9.0), (11, 15.0), (22, 14.0), (14, -10.0)]
    sigma = 2.0 * np.pi * np.sqrt(sum(value**2 for _, value in terms)) / WAVE_NM
    np.testing.assert_allclose(peak(on_axis(zernike_nm=terms)) / peak(on_axis()), np.exp(-sigma**2), atol=2e-3)


def test_another_optics_library_agrees():
    """prysm's matrix Fourier transform of the same wavefront on 1024 points: 2e-3 of the peak, its edge's staircase."""
    from prysm import coordinates, geometry, polynomials, propagation
    terms = [(4, 40.0), (6, -60.0), (7, 80.0), (8, 50.0), (11, 45.0)]
    n, oversampling, size = 1024, 4, 64
    x, y = coordinates.make_xy_grid(n, diameter=2.0)
    r, angle = coordinates.cart_to_polar(x, y)
    opd_nm = sum(value * polynomials.zernike_nm(*polynomials.noll_to_nm(noll), r, angle, norm=True)
                 for noll, value in terms)
    field = geometry.circle(1.0, r) * np.exp(2j * np.pi / WAVE_NM * opd_nm)
    # A pupil of 1 mm, focal length 1 mm: lambda N = 0.6 um is oversampling points.
    image = propagation.focus_fixed_sampling(field, 1.0 / n, 1.0, WAVE_NM * 1e-3, 0.6 / oversampling, size)
    theirs = np.abs(image) ** 2
    points = np.arange(-(size // 2), size // 2)
    ours = pupil.intensity(points, np.zeros(1), lambda_n_px=[oversampling], weights=[1.0], obscuration=0.0,
                           phase=on_axis(zernike_nm=terms))
    theirs = theirs * (ours.sum() / theirs.sum())
    # Which way a rising wavefront moves the image is a convention: prysm's is one of these two.
    error = min(np.abs(theirs - ours).max(), np.abs(theirs[1:, 1:][::-1, ::-1] - ours[1:, 1:]).max())
    assert error < 2e-3 * ours.max()
    wrong = pupil.intensity(points, np.zeros(1), lambda_n_px=[oversampling], weights=[1.0], obscuration=0.0,
                            phase=on_axis(zernike_nm=[*terms[:-1], (11, -45.0)]))
    assert np.abs(wrong - ours).max() > 0.05 * ours.max()


# The field


def kernel_at(field_xy, radius_px=20, **terms):
    lens = Aberrations(**terms)
    return psf.diffraction_kernel(np.array([WAVE_NM * 1e-9]), np.ones(1), f_number=8.0, pixel_pitch_m=4.8e-6,
                                  central_obscuration=0.0, sigma_px=0.0, radius_px=radius_px,
                                  opd_m=lambda x, y: 1e-9 * lens.opd_nm(x, y, field_xy))


@pytest.mark.parametrize("coma_nm", slow_but([60.0, -60.0], 0))
def test_coma_points_away_from_the_axis_and_grows_with_the_field(coma_nm):
    """Centroid by the mean slope of the wavefront, 2 N sqrt(8) h C outwards, 0.5 %.

    What the wings hold beyond a kernel of radius R falls as 1/R: two radii give the limit.
    """
    unit_px = 2.0 * 8.0 / 4800.0 * np.sqrt(8.0) * coma_nm
    for field in ((0.0, 0.0), (0.5, 0.0), (1.0, 0.0), (-0.6, 0.8), (0.0, -0.5)):
        near, far = (moments(kernel_at(field, radius, coma_nm=coma_nm))[0] for radius in (20, 41))
        np.testing.assert_allclose(2.0 * far - near, unit_px * np.array(field), atol=0.005 * abs(unit_px))
    # The tail: light is missing on its side of the brightest pixel, and present on the other.
    kernel = kernel_at((1.0, 0.0), coma_nm=coma_nm)
    tail = kernel[:, 23:].sum() - kernel[:, :18].sum()
    assert np.sign(tail) == np.sign(coma_nm) and abs(tail) > 0.02


def test_tangential_and_sagittal_foci_blur_their_own_direction():
    """Tangential defocus widens along the field, sagittal across it; equal ones are round, and defocus."""
    along = np.array([0.6, 0.8])
    across = np.array([-0.8, 0.6])
    for terms, wide, narrow in ((dict(tangential_nm=300.0), along, across), (dict(sagittal_nm=300.0), across, along)):
        _, covariance = moments(kernel_at(tuple(along), **terms))
        assert wide @ covariance @ wide > 3.0 * (narrow @ covariance @ narrow)
    equal = kernel_at((0.5, 0.0), tangential_nm=400.0, sagittal_nm=400.0)
    np.testing.assert_allclose(equal, kernel_at((0.0, 0.0), defocus_nm=100.0), atol=1e-12)
    np.testing.assert_allclose(equal, equal.T, atol=1e-12)


LENS = dict(coma_nm=60.0, tangential_nm=120.0, sagittal_nm=-40.0, spherical_nm=30.0)


def test_the_grid_has_the_frames_symmetry_and_height_one_in_the_corners():
    lens = Aberrations(**LENS, aspect=1.5, grid=(3, 5))
    np.testing.assert_allclose(np.linalg.norm(lens.nodes()[[0, 0, -1, -1], [0, -1, 0, -1]], axis=-1), 1.0, rtol=1e-12)
    assert not lens.nodes()[1, 2].any()
    kernels = Optics(**OPTICS, psf_radius_px=7, aberrations=lens).psf_kernel
    assert kernels.shape == (3, 5, 15, 15)
    np.testing.assert_allclose(kernels[:, ::-1, :, ::-1], kernels, atol=1e-12)
    np.testing.assert_allclose(kernels[::-1, :, ::-1, :], kernels, atol=1e-12)
    assert np.abs(kernels[0, 0] - kernels[1, 2]).max() > 0.05


def test_an_aberrated_field_conserves_flux():
    """All light but the energy that the kernels report as cut off; within it, 1e-6."""
    optics = Optics(**OPTICS, psf_radius_px=15, aberrations=Aberrations(**LENS))
    image = np.zeros((160, 200), np.float32)
    image[20:-20, 20:-20] = np.random.default_rng(6).random((120, 160))
    for is_points in (False, True):
        kept = optics.spread(image, is_points=is_points).sum(dtype=np.float64) / image.sum(dtype=np.float64)
        assert 0.0 < 1.0 - kept < optics.psf_energy_cut < 0.04
    optics = Optics(aperture_diameter_m=0.015, psf_measured=(optics.psf_kernel / optics.psf_kernel.sum(
        axis=(-2, -1), keepdims=True)).tolist())
    image[:20] = image[-20:] = image[:, :20] = image[:, -20:] = 0.0
    np.testing.assert_allclose(optics.spread(image).sum(dtype=np.float64), image.sum(dtype=np.float64), rtol=1e-6)


def test_between_nodes_the_mixture_is_near_the_lens():
    """A point in the middle of the outermost cell of the 5 x 5 grid: 7 % of the peak; 9 x 9: 2 %."""
    for n, tolerance in ((5, 0.07), (9, 0.02)):
        lens = Aberrations(**LENS, grid=(n, n))
        optics = Optics(**OPTICS, psf_radius_px=15, aberrations=lens)
        size = 16 * (n - 1) * 4 + 1
        image = np.zeros((size, size), np.float32)
        image[32, 32] = 1.0
        centre = (size - 1) / 2.0
        field = (32 - centre) / centre / np.sqrt(2.0)
        true = kernel_at((field, field), 15, **LENS)
        mixed = optics.spread(image, is_points=True)[17:48, 17:48]
        np.testing.assert_allclose(mixed, true, atol=tolerance * true.max())


# Several at once


def test_jitter_diffraction_and_aberrations_are_one_kernel():
    """Blurred inside the pixels, or by the transfer function after a pupil without aliases: 1e-4."""
    lens = Aberrations(defocus_nm=80.0, zernike_nm=[(8, 40.0)])
    slow = OPTICS | dict(f_number=16.0)
    plain = Optics(**slow, psf_radius_px=25, aberrations=lens).psf_kernel
    both = Optics(**slow, psf_radius_px=25, aberrations=lens, psf_sigma_px=1.5).psf_kernel
    frequency = np.fft.fftfreq(51)
    transfer = np.exp(-2.0 * np.pi**2 * 1.5**2 * (frequency[:, None] ** 2 + frequency**2))
    expected = np.fft.ifft2(np.fft.fft2(plain) * transfer).real
    np.testing.assert_allclose(both[8:-8, 8:-8], expected[8:-8, 8:-8], atol=1e-4 * expected.max())


@pytest.mark.parametrize("sigma_px", [0.2, 0.7, 2.0])
def test_a_gaussian_widens_a_measured_kernel_by_its_variance_alone(sigma_px):
    """The pixel is in the measurement and not counted again: sigma^2 to 1e-5."""
    measured = np.outer([0.2, 0.5, 0.3], [0.1, 0.8, 0.1])
    kernel = Optics(aperture_diameter_m=0.01, psf_measured=measured.tolist(), psf_sigma_px=sigma_px).psf_kernel
    centre, covariance = moments(measured)
    centre_after, covariance_after = moments(kernel)
    np.testing.assert_allclose(covariance_after - covariance, np.eye(2) * sigma_px**2, atol=1e-5)
    np.testing.assert_allclose(centre_after, centre, atol=1e-9)
    np.testing.assert_allclose(kernel.sum(), 1.0, atol=1e-7)
    assert (kernel >= 0.0).all()


def test_light_from_beyond_the_frame_enters_through_the_margin():
    """A frame with its margin equals the same part of a larger frame; without it the light is missing."""
    def model(shape):
        return CameraModel(optics=Optics(**OPTICS, psf_radius_px=9, aberrations=Aberrations(defocus_nm=70.0)),
                           detector=Detector(quantum_efficiency=0.5, full_well_electrons=1e5,
                                             gain_DN_per_electron=0.04, bit_depth=12), exposure_s=0.1)
    wide = np.zeros((72, 84), np.float32)
    wide[20:28, 30] = wide[40, 0:10] = 1e-9
    camera = model(wide.shape)
    whole = light_on_frame(camera.optics, wide).signal
    found = light_on_frame(camera.optics, wide, margin_px=12)
    cropped, lit = found.signal, found.lit
    assert cropped.shape == (48, 60)
    np.testing.assert_allclose(cropped, whole[12:-12, 12:-12], atol=1e-6 * whole.max())
    inside = np.zeros_like(cropped)
    inside[lit] = cropped[lit]
    np.testing.assert_array_equal(inside, cropped)
    assert cropped[28, 0] > 0.0
    frame = camera.expose(wide, 1, margin_px=12)
    assert frame.dn.shape == (48, 60)
    with pytest.raises(ConfigError, match="margin_px: must be an integer between 0 and 35, got 36"):
        camera.expose(wide, 1, margin_px=36)


@pytest.mark.parametrize("table, path", [
    (dict(defocus_nm=1e6), "defocus_nm"), (dict(coma_nm=float("nan")), "coma_nm"),
    (dict(zernike_nm=[(1, 5.0)]), "zernike_nm[0]"), (dict(zernike_nm=[(4, 5.0), (5,)]), "zernike_nm[1]"),
    (dict(zernike_nm=3), "zernike_nm"), (dict(aspect=0.0), "aspect"), (dict(grid=(1, 5)), "grid[0]"),
    (dict(astigmatism=1.0), "astigmatism")])
def test_bad_aberrations_are_refused_by_name(table, path):
    with pytest.raises(ConfigError) as error:
        Optics.from_dict({**OPTICS, "aberrations": table})
    assert error.value.path == f"aberrations.{path}"


def test_aberrations_need_a_pupil_and_a_kernel_of_bearable_size():
    with pytest.raises(ConfigError, match="f_number: missing: aberrations are the pupil's"):
        Optics(aperture_diameter_m=0.01, aberrations=Aberrations(defocus_nm=10.0))
    with pytest.raises(ConfigError, match="psf_radius_px: must be an integer between 1 and 63, got 64"):
        Optics(**OPTICS, psf_radius_px=64, aberrations=Aberrations(defocus_nm=10.0))


def test_an_aspect_that_is_not_the_frames_is_refused():
    """A wide frame with the square lens's grid would have its coma in the wrong place."""
    model = CameraModel(optics=Optics(**OPTICS, aberrations=Aberrations(coma_nm=30.0)), exposure_s=0.1,
                        detector=Detector(quantum_efficiency=0.5, full_well_electrons=1e5, gain_DN_per_electron=0.04,
                                          bit_depth=12))
    square = PinholeCamera(name="c", width_px=64, height_px=64, focal_length_px=100.0, model=model)
    assert square.with_margin(9).width_px == 82
    with pytest.raises(ConfigError, match=r"model.optics.aberrations.aspect: must be width / height, 1.5, within 5%"):
        PinholeCamera(name="c", width_px=96, height_px=64, focal_length_px=100.0, model=model)
