"""Images are averaged over their pixels once: limbs and flux against a fine scene in float64."""

from __future__ import annotations

import numpy as np
import pytest
from glrender_camera import Aberrations, Optics
from glrender_camera.image_kernel import gaussian_image_axis, non_negative, without_pixel
from scipy.special import erf

PHASES = np.linspace(-0.5, 0.5, 20, endpoint=False)
PIXEL = np.arange(-20, 21)


def half_planes(sigma_px):
    """Straight limbs between the pixels: what is drawn, and what a detector sees of it: closed forms (20, 41)."""
    def integral(x):
        z = x / sigma_px
        return x * 0.5 * (1.0 + erf(z / np.sqrt(2.0))) + sigma_px * np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi)

    right = PIXEL + 0.5 - PHASES[:, None]
    return np.clip(right, 0.0, 1.0), integral(right) - integral(right - 1.0)


def spread_limbs(optics, drawn, **options):
    """Each phase as an image of equal rows; its middle row."""
    rows = []
    for profile in drawn:
        image = np.pad(np.tile(profile, (41, 1)), 20, mode="edge").astype(np.float32)
        rows.append(optics.spread(image, **options)[40, 20:-20])
    return np.array(rows, np.float64)


@pytest.mark.parametrize("sigma_px, rms, bias, rms_of_points, bias_of_points", [
    (0.2, 0.026, 0.0093, 0.038, 0.0088), (0.5, 0.039, 0.018, 0.040, 0.020), (0.7, 0.027, 0.0070, 0.033, 0.018),
    (1.0, 0.016, 0.0030, 0.021, 0.010), (1.5, 0.0081, 0.0007, 0.011, 0.0041)])
def test_a_limb_is_as_sharp_as_the_point_spread_function(sigma_px, rms, bias, rms_of_points, bias_of_points):
    """Error of the pixels of a limb of unit brightness, and of its mean over places between the pixels; 5 %.

    What a point's kernel would give stands beside it. Below 0.6 px the pixels do not tell where in them the limb is.
    """
    optics = Optics(aperture_diameter_m=0.01, psf_sigma_px=sigma_px)
    drawn, seen = half_planes(sigma_px)
    for is_points, expected in ((False, (rms, bias)), (True, (rms_of_points, bias_of_points))):
        error = spread_limbs(optics, drawn, is_points=is_points) - seen
        found = np.sqrt((error**2).sum(axis=1).mean()), np.abs(error.mean(axis=0)).max()
        np.testing.assert_allclose(found, expected, rtol=0.05)


@pytest.mark.parametrize("sigma_px", [0.65, 0.7, 0.8, 1.0, 1.99, 2.01, 4.0])
def test_a_wide_kernel_has_the_variance_of_the_gaussian_alone(sigma_px):
    """sigma^2 within 0.006 px^2 from 0.65 px on, a fourteenth of the pixel's own; 1e-3 from 1 px on."""
    radius = int(np.ceil(5.5 * sigma_px))
    axis = gaussian_image_axis(sigma_px, radius)
    variance = np.sum(axis * np.arange(-radius, radius + 1) ** 2)
    np.testing.assert_allclose(variance, sigma_px**2, atol=0.006 if sigma_px < 0.8 else 1.5e-3)


@pytest.mark.parametrize("fields", [dict(psf_sigma_px=s) for s in (0.05, 0.3, 0.6, 0.9, 1.9, 2.1, 5.0)] + [
    dict(psf_measured=[[0.02, 0.1, 0.0], [0.1, 0.6, 0.1], [0.0, 0.06, 0.02]]), dict(psf_measured=[[1.0]]),
    dict(psf_measured=[[0.1, 0.8, 0.1]], psf_sigma_px=0.6)])
def test_flux_is_conserved_and_nothing_is_negative(fields):
    """An open image of random light, 1e-6."""
    optics = Optics(aperture_diameter_m=0.01, **fields)
    image = np.zeros((128, 130), np.float32)
    image[40:-40, 40:-40] = np.random.default_rng(3).random((48, 50))
    spread = optics.spread(image)
    np.testing.assert_allclose(spread.sum(dtype=np.float64), image.sum(dtype=np.float64), rtol=1e-6)
    assert optics.image_kernel.min() >= 0.0 and spread.min() >= 0.0
    np.testing.assert_allclose(optics.image_kernel.sum(), optics.psf_kernel.sum(), rtol=1e-7)


def crescent(n_px, fine):
    """A Lambert sphere at 50 degrees of phase, 31 px across, off the middle of a pixel, on `fine` cells a pixel."""
    x = (np.arange(n_px * fine) + 0.5) / fine - 0.5
    u, v = (x[None, :] - 31.3) / 15.6, (x[:, None] - 30.6) / 15.6
    rr = u * u + v * v
    return np.where(rr < 1.0, np.maximum(0.75 * u + 0.15 * v + 0.64 * np.sqrt(np.maximum(1.0 - rr, 0.0)), 0.0), 0.0)


def airy_transfer(lambda_n_px):
    def transfer(fx, fy):
        v = np.minimum(np.hypot(fx, fy) * lambda_n_px, 1.0)
        return 2.0 / np.pi * (np.arccos(v) - v * np.sqrt(1.0 - v * v))
    return transfer


PUPIL = dict(f_number=8.0, band_nm=(649.9, 650.1), psf_radius_px=31)


def gaussian_transfer(sigma_px):
    return lambda fx, fy: np.exp(-2.0 * np.pi**2 * sigma_px**2 * (fx**2 + fy**2))


@pytest.mark.parametrize("fields, transfer, limit, gain", [
    (dict(psf_sigma_px=0.5), gaussian_transfer(0.5), 0.010, 0.9),
    (dict(psf_sigma_px=0.7), gaussian_transfer(0.7), 0.006, 1.4),
    (dict(psf_sigma_px=1.0), gaussian_transfer(1.0), 0.003, 2.2),
    (dict(pixel_pitch_m=7.43e-6, **PUPIL), airy_transfer(0.7), 0.009, 1.3),
    (dict(pixel_pitch_m=3.467e-6, **PUPIL), airy_transfer(1.5), 0.009, 1.15)])
def test_a_crescent_against_the_continuous_optics(fields, transfer, limit, gain):
    """Sixteen cells a pixel, the optical transfer function, the pixel's area: RMS over the mean lit pixel.

    A point's kernel, which counts the pixel twice, is `gain` times as far off or more.
    """
    n, fine = 64, 16
    scene = crescent(n, fine)
    frequency = np.fft.fftfreq(n * fine, 1.0 / fine)
    continuous = np.fft.ifft2(np.fft.fft2(scene) * transfer(frequency[None, :], frequency[:, None])).real
    true, drawn = (x.reshape(n, fine, n, fine).mean(axis=(1, 3)) for x in (continuous, scene))
    optics, lit = Optics(aperture_diameter_m=0.01, **fields), drawn > 0.0

    def rms(is_points):
        error = optics.spread(drawn.astype(np.float32), is_points=is_points) - true
        return np.sqrt((error**2).sum() / lit.sum()) / drawn[lit].mean()

    assert rms(False) < limit and rms(True) > gain * rms(False)


def test_the_kernels_of_a_field_keep_the_light_of_their_points():
    """On every node of an aberrated lens: the same sum, nowhere negative, its centroid 0.01 px from the point's."""
    lens = Aberrations(coma_nm=60.0, tangential_nm=90.0, grid=(3, 3))
    optics = Optics(aperture_diameter_m=0.015, f_number=8.0, pixel_pitch_m=4.8e-6, band_nm=(599.0, 601.0),
                    psf_radius_px=9, aberrations=lens)
    points, images = optics.psf_kernel, optics.image_kernel
    assert points.shape == images.shape == (3, 3, 19, 19) and images.min() >= 0.0
    np.testing.assert_allclose(images.sum(axis=(-2, -1)), points.sum(axis=(-2, -1)), rtol=1e-12)
    y, x = np.indices((19, 19)) - 9
    for axis in (x, y):
        places = [(kernels * axis).sum(axis=(-2, -1)) / kernels.sum(axis=(-2, -1)) for kernels in (points, images)]
        np.testing.assert_allclose(places[1], places[0], atol=0.01)
    assert np.abs(images - points).max() > 0.01


def test_what_is_below_zero_is_filled_up_from_beside_it():
    """The sum stays, what was far away stays; a kernel without negatives is not touched."""
    kernel = np.zeros((9, 9))
    kernel[4, 4], kernel[4, 6], kernel[4, 5], kernel[0, 0] = 0.9, -0.02, 0.1, 0.02
    filled = non_negative(kernel)
    assert filled.min() == 0.0 and filled[0, 0] == pytest.approx(0.02)
    np.testing.assert_allclose([filled.sum(), filled[4, 5]], [1.0, 0.08], rtol=1e-12)
    np.testing.assert_array_equal(non_negative(np.abs(kernel)), np.abs(kernel))


def test_a_measured_kernel_loses_a_twelfth_of_a_square_pixel():
    """The pixel's own variance, 1e-6, where the kernel is wide enough; a kernel of one pixel stays one."""
    x = np.arange(-12, 13)
    axis = np.exp(-0.5 * (x / 1.6) ** 2)
    measured = np.outer(axis, axis) / axis.sum() ** 2
    variance = [(kernel.sum(axis=0) * x**2).sum() for kernel in (measured, without_pixel(measured))]
    np.testing.assert_allclose(variance[0] - variance[1], 1.0 / 12.0, atol=1e-6)
    np.testing.assert_allclose(without_pixel(np.eye(1, 25, 12).T @ np.eye(1, 25, 12)), np.eye(1, 25, 12).T
                               @ np.eye(1, 25, 12), atol=1e-12)
