"""Point spread functions against the optical transfer function, closed forms and SciPy's convolution."""

from __future__ import annotations

import numpy as np
import pytest
from glrender_camera import Aberrations, CameraModel, ConfigError, Detector, Optics, psf
from glrender_camera.convolution import Convolution, FieldConvolution
from glrender_camera.expected import changed_electrons, gathered_weights
from scipy.integrate import dblquad, quad
from scipy.ndimage import convolve as scipy_convolve
from scipy.special import j0, j1


def airy(lambda_n_px, radius_px, obscuration=0.0, sigma_px=0.0):
    """Kernel of one wavelength whose lambda N is so many pixels."""
    return psf.diffraction_kernel(np.array([lambda_n_px * 1e-6]), np.ones(1), f_number=1.0, pixel_pitch_m=1e-6,
                                  central_obscuration=obscuration, sigma_px=sigma_px, radius_px=radius_px)


def kernel_from_transfer_function(lambda_n_px, sigma_px, n=512):
    """The same by another road: transfer function of a disc, Gaussian and pixel, summed over aliases."""
    reach = int(np.ceil(1.0 / lambda_n_px))
    f = np.arange(-reach * n, reach * n) / n
    f = f[:, None]
    fx, fy = f, f.T
    v = np.minimum(np.hypot(fx, fy) * lambda_n_px, 1.0)
    transfer = 2.0 / np.pi * (np.arccos(v) - v * np.sqrt(1.0 - v**2))
    transfer = transfer * np.exp(-2.0 * np.pi**2 * sigma_px**2 * (fx**2 + fy**2)) * np.sinc(fx) * np.sinc(fy)
    folded = transfer.reshape(2 * reach, n, 2 * reach, n).sum(axis=(0, 2))
    return np.fft.fftshift(np.fft.ifft2(folded).real)[n // 2 - 5:n // 2 + 6, n // 2 - 5:n // 2 + 6]


@pytest.mark.parametrize("lambda_n_px, sigma_px", [(0.4, 0.0), (1.0, 0.0), (1.7, 0.0), (1.0, 0.5), (0.5, 0.9)])
def test_diffraction_against_the_transfer_function(lambda_n_px, sigma_px):
    """Pixel by pixel, 2e-6: what the 512 px period of the Fourier side folds back of its wings."""
    kernel = airy(lambda_n_px, 5, sigma_px=sigma_px) if sigma_px == 0.0 else \
        airy(lambda_n_px, 40, sigma_px=sigma_px)[35:46, 35:46]
    np.testing.assert_allclose(kernel, kernel_from_transfer_function(lambda_n_px, sigma_px), atol=2e-6)


@pytest.mark.parametrize("lambda_n_px", [0.4, 1.0, 2.0])
def test_energy_cut_lies_between_the_closed_forms_of_two_circles(lambda_n_px):
    """J0^2 + J1^2 outside the circles in and around the square kernel; 16 % at the first dark ring."""
    def outside(radius_px):
        x = np.pi * radius_px / lambda_n_px
        return j0(x) ** 2 + j1(x) ** 2

    np.testing.assert_allclose(outside(1.22 * lambda_n_px), 0.162, atol=1e-3)
    for radius in (7, 15, 31):
        cut = 1.0 - airy(lambda_n_px, radius).sum()
        assert outside(np.sqrt(2.0) * (radius + 0.5)) < cut < outside(radius + 0.5)


def test_energy_of_the_square_kernel_against_quadrature():
    """Radial quadrature of Airy's pattern over the square's arcs, 1e-7."""
    lambda_n_px, half = 1.0, 7.5
    def density(r):
        x = np.pi * r / lambda_n_px
        return np.pi / (4.0 * lambda_n_px**2) * (2.0 * j1(x) / x) ** 2 if r > 0.0 else np.pi / 4.0

    def arc(r):
        return r * (2.0 * np.pi - (8.0 * np.arccos(half / r) if r > half else 0.0))

    total = sum(quad(lambda r: density(r) * arc(r), a, b, limit=400, epsabs=1e-10)[0]
                for a, b in ((0.0, 2.0), (2.0, half), (half, half * np.sqrt(2.0))))
    np.testing.assert_allclose(airy(lambda_n_px, 7).sum(), total, atol=1e-7)


def test_an_annular_pupil_against_quadrature():
    """Three pixels of a 40 % obscured pupil, 1e-8; nearly all light within 100 pixels."""
    def density(y, x):
        v = max(np.pi * np.hypot(x, y) / 1.3, 1e-9)
        return np.pi / (4 * 1.3**2 * (1 - 0.16)) * (2 * j1(v) / v - 0.16 * 2 * j1(0.4 * v) / (0.4 * v)) ** 2

    kernel = airy(1.3, 6, obscuration=0.4)
    for i, j in ((0, 0), (0, 2), (3, 1)):
        expected = dblquad(density, i - 0.5, i + 0.5, j - 0.5, j + 0.5, epsabs=1e-10)[0]
        np.testing.assert_allclose(kernel[6 + j, 6 + i], expected, atol=1e-8)
    assert 0.99 < airy(1.3, 100, obscuration=0.4).sum() < 1.0


def test_nine_wavelengths_are_enough_for_the_band():
    """450-950 nm at f/8 on 5.5 um pixels: 9 against 99 wavelengths, 2e-4 of the light in any pixel."""
    from glrender_camera.spectrum import photon_weights

    kernels = [psf.diffraction_kernel(*photon_weights((450.0, 950.0), 1.0, n), f_number=8.0,
                                      pixel_pitch_m=5.5e-6, central_obscuration=0.0, sigma_px=0.0, radius_px=10)
               for n in (9, 99)]
    np.testing.assert_allclose(kernels[0], kernels[1], atol=2e-4)


@pytest.mark.parametrize("sigmas, method", [((1.3,), "1 separable"), ((0.8, 4.0), "2 separable"),
                                            (tuple(np.linspace(0.5, 5.0, 40)), "Fourier")])
def test_a_sum_of_gaussians_is_convolved_by_as_many_passes(sigmas, method):
    """The cheapest way is taken, and it is exact: SciPy's sum within 1e-6 of the maximum, flux 1e-6."""
    y, x = np.indices((31, 31)) - 15
    rng = np.random.default_rng(4)
    kernel = sum(np.exp(-((x - dx) ** 2 + (y - dy) ** 2) / (2.0 * s * s)) / (s * s)
                 for s, dx, dy in zip(sigmas, rng.random(len(sigmas)), rng.random(len(sigmas)), strict=True))
    kernel /= kernel.sum()
    image = np.zeros((90, 300), np.float32)
    image[16:-16, 16:-16] = rng.random((58, 268))
    convolution = Convolution(kernel)
    assert convolution.method == method
    spread = convolution(image)
    np.testing.assert_allclose(spread, scipy_convolve(image.astype(np.float64), kernel, mode="constant"), atol=1e-6)
    np.testing.assert_allclose(spread.sum(dtype=np.float64), image.sum(dtype=np.float64), rtol=1e-6)


def test_fourier_transforms_of_all_sizes_do_not_wrap_around():
    """Ten sizes of image behind one kernel, light at every edge: SciPy's sum, 2e-6 of the maximum."""
    rng = np.random.default_rng(5)
    kernel = rng.random((17, 13))
    kernel /= kernel.sum()
    convolution = Convolution(kernel)
    assert convolution.method == "Fourier"
    for shape in [(300, 50), *rng.integers(1, 120, (9, 2))]:
        image = rng.random(shape).astype(np.float32)
        expected = scipy_convolve(image.astype(np.float64), kernel, mode="constant")
        np.testing.assert_allclose(convolution(image), expected, atol=2e-6)


def test_a_large_kernel_is_not_decomposed_in_vain():
    """511 px: prepared in less than a second, where a decomposition of its 261,121 numbers takes longer."""
    import time
    began = time.perf_counter()
    assert Convolution(np.random.default_rng(1).random((511, 511))).method == "Fourier"
    assert time.perf_counter() - began < 1.0
    axis = psf.gaussian_axis(10.0, 55)
    assert Convolution(np.outer(axis, axis)).method == "1 separable"


@pytest.mark.parametrize("shape", [(3, 5), (11, 7), (15, 15), (31, 31)])
def test_convolution_against_scipy(shape):
    """An asymmetric kernel, direct sum and Fourier transform, 2e-6 of the maximum; never negative."""
    rng = np.random.default_rng(2)
    kernel = rng.random(shape)
    kernel /= kernel.sum()
    image = np.zeros((90, 110), np.float32)
    image[rng.integers(0, 90, 40), rng.integers(0, 110, 40)] = rng.random(40) * 1e-8
    expected = scipy_convolve(image.astype(np.float64), kernel, mode="constant")
    spread = Convolution(kernel)(image)
    np.testing.assert_allclose(spread, expected, atol=2e-6 * float(image.max()))
    assert spread.min() >= 0.0


def test_a_measured_kernel_keeps_its_orientation():
    """A ghost below and to the right of the light in the kernel stays there in the image."""
    optics = Optics(aperture_diameter_m=0.01, psf_measured=[[0, 0, 0], [0, 0.7, 0.2], [0, 0, 0.05]])
    image = np.zeros((9, 9), np.float32)
    image[4, 4] = 1.0
    spread = optics.spread(image, is_points=True)
    np.testing.assert_allclose([spread[4, 4], spread[4, 5], spread[5, 5], spread[3, 3]], [0.7, 0.2, 0.05, 0.0],
                               atol=1e-7)
    np.testing.assert_allclose(optics.psf_energy_cut, 0.05, atol=1e-12)
    spread = optics.spread(image)
    assert spread[4, 4] > spread[4, 5] > spread[5, 5] > 0.0 and spread[3, 3] == 0.0
    np.testing.assert_allclose(spread.sum(), 0.95, rtol=1e-6)


def test_a_point_behind_diffraction_keeps_its_centroid():
    """Through the Fourier road: 1e-4 px."""
    optics = Optics(aperture_diameter_m=0.01, f_number=8.0, pixel_pitch_m=5.5e-6, psf_sigma_px=0.3)
    image = np.zeros((64, 80), np.float32)
    image[30, 41] = 1.0
    spread = optics.spread(image).astype(np.float64)
    y, x = np.indices(image.shape)
    centroid = np.array([(spread * y).sum(), (spread * x).sum()]) / spread.sum()
    np.testing.assert_allclose(centroid, [30.0, 41.0], atol=1e-4)
    np.testing.assert_allclose(spread.sum(), 1.0 - optics.psf_energy_cut, atol=1e-6)


def test_an_obscuration_takes_its_area():
    full, half = (Optics(aperture_diameter_m=0.1, central_obscuration=x).aperture_area_m2 for x in (0.0, 0.5))
    np.testing.assert_allclose(half / full, 0.75, rtol=1e-12)


@pytest.mark.parametrize("fields, path", [
    (dict(f_number=8.0), "pixel_pitch_m"), (dict(pixel_pitch_m=5e-6), "f_number"),
    (dict(f_number=1.0, pixel_pitch_m=1e-5), "f_number"), (dict(central_obscuration=1.0), "central_obscuration"),
    (dict(psf_measured=[[1.0, 0.0]]), "psf_measured"), (dict(psf_measured=[[1.1]]), "psf_measured"),
    (dict(psf_measured=[[-0.1, 0.5, 0.1]]), "psf_measured"), (dict(psf_measured="airy"), "psf_measured"),
    (dict(psf_measured=[[float("nan")]]), "psf_measured"), (dict(psf_radius_px=0), "psf_radius_px"),
    (dict(psf_measured=[[1.0]], f_number=8.0, pixel_pitch_m=5e-6), "psf_measured"),
    (dict(psf_measured=[[1.0]], aberrations=Aberrations(defocus_nm=1.0)), "f_number"),
    (dict(stray_light=0.1), "stray_light")])
def test_a_bad_point_spread_function_is_refused_by_field(fields, path):
    with pytest.raises(ConfigError) as error:
        Optics(aperture_diameter_m=0.01, **fields)
    assert error.value.path == path


# A point spread function that varies over the frame


def field_kernels(n_rows=3, n_columns=4, size=15):
    """Gaussians that widen from the centre outwards and lean away from it."""
    y, x = np.indices((size, size)) - size // 2
    kernels = np.empty((n_rows, n_columns, size, size))
    for i, j in np.ndindex(n_rows, n_columns):
        u, v = 2.0 * j / (n_columns - 1) - 1.0, 2.0 * i / (n_rows - 1) - 1.0
        sigma = 0.8 + 0.5 * np.hypot(u, v)
        kernels[i, j] = np.exp(-((x - 0.7 * u) ** 2 + (y - 0.7 * v) ** 2) / (2.0 * sigma**2))
        kernels[i, j] /= kernels[i, j].sum()
    return kernels


def test_equal_kernels_over_the_field_are_one_kernel():
    """Partition of unity: a grid of one kernel equals its plain convolution, 1e-6 of the maximum: no seam."""
    kernel = airy(1.0, 5)
    image = np.random.default_rng(4).random((70, 90)).astype(np.float32)
    varying = FieldConvolution(np.tile(kernel, (3, 4, 1, 1)))(image, (0, 0), image.shape)
    np.testing.assert_allclose(varying, Convolution(kernel)(image), atol=1e-6)


def test_a_varying_kernel_against_the_sum_over_points():
    """Each point spread by the bilinear mixture of the four kernels around it, in float64, 2e-6."""
    kernels, shape = field_kernels(), (60, 80)
    rng = np.random.default_rng(5)
    image, expected = np.zeros(shape, np.float32), np.zeros((shape[0] + 14, shape[1] + 14))
    for row, column in [(0, 0), (59, 79), (30, 41), (12, 70), (29, 26), *rng.integers(0, 60, (20, 2))]:
        image[row, column] += 1.0
        gi, gj = row / 59.0 * 2.0, column / 79.0 * 3.0
        i, j = min(int(gi), 1), min(int(gj), 2)
        a, b = gi - i, gj - j
        mixture = ((1 - a) * (1 - b) * kernels[i, j] + (1 - a) * b * kernels[i, j + 1]
                   + a * (1 - b) * kernels[i + 1, j] + a * b * kernels[i + 1, j + 1])
        expected[row:row + 15, column:column + 15] += mixture
    spread = FieldConvolution(kernels)(image, (0, 0), shape)
    np.testing.assert_allclose(spread, expected[7:-7, 7:-7], atol=2e-6)


def test_a_varying_kernel_conserves_flux():
    """Light 7 px from the edges at least: total within 1e-6."""
    image = np.zeros((120, 100), np.float32)
    image[7:-7, 7:-7] = np.random.default_rng(6).random((106, 86))
    spread = FieldConvolution(field_kernels())(image, (0, 0), image.shape)
    np.testing.assert_allclose(spread.sum(dtype=np.float64), image.sum(dtype=np.float64), rtol=1e-6)


def test_a_region_of_a_varying_field_knows_its_place():
    """The frame's bytes do not depend on the region hint, and a part equals the whole within 1e-6."""
    shape = (80, 100)
    image = np.zeros(shape, np.float32)
    image[20:50, 60:90] = np.random.default_rng(7).random((30, 30))
    kernels = field_kernels()
    whole = FieldConvolution(kernels)(image, (0, 0), shape)
    part = FieldConvolution(kernels)(image[13:57, 53:97], (13, 53), shape)
    np.testing.assert_allclose(part, whole[13:57, 53:97], atol=1e-6)
    model = CameraModel(
        optics=Optics(aperture_diameter_m=0.01, psf_measured=kernels),
        detector=Detector(quantum_efficiency=0.5, full_well_electrons=1e5, gain_DN_per_electron=0.04, bit_depth=12),
        exposure_s=0.1)
    frames = [model.expose(image * np.float32(1e-8), 1, roi=roi) for roi in (None, (60, 20, 90, 50))]
    assert frames[0].dn.tobytes() == frames[1].dn.tobytes() and frames[0].dn.max() > 50
    assert "3 x 4 nodes over the frame" in frames[0].stages["psf"]


def test_weights_of_electrons_are_gathered_as_light_is_spread():
    """Of a skew kernel, of a dimmer edge and of smear: both sums of products are the same."""
    generator = np.random.default_rng(3)
    kernel = generator.random((3, 5))
    detector = Detector(quantum_efficiency=0.6, full_well_electrons=5e4, gain_DN_per_electron=0.08, bit_depth=12,
                        frame_transfer_row_s=1e-5)
    model = CameraModel(optics=Optics(aperture_diameter_m=0.02, psf_measured=kernel / kernel.sum()), detector=detector,
                        exposure_s=0.01)
    options = {"relative_illumination": generator.random((20, 30)).astype(np.float32)}
    weights, light = generator.normal(size=(2, 1, 20, 30))
    spread = changed_electrons(model, light.astype(np.float32), 0.01, **options)
    gathered = gathered_weights(model, weights, 0.01, **options)
    scale = np.linalg.norm(weights) * np.linalg.norm(spread)
    assert abs((weights * spread).sum() - (gathered * light).sum()) < 1e-3 * scale
    assert abs((weights * spread).sum()) > 0.01 * scale
