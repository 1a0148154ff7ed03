"""The optics: how much light is gathered, and how a point is spread."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np

from . import psf
from .aberrations import Aberrations
from .convolution import Convolution, FieldConvolution
from .errors import ConfigError, error_path
from .image_kernel import from_splines, gaussian_image_axis, measured_between, spline_weights, without_pixel
from .spectrum import Curve, band, curve, photon_weights, require_overlap
from .straylight import StrayLight
from .validate import integer, known_keys, positive, within

# Energy beyond 5.5 sigma is 4e-8 an axis: below float32's own rounding of the sum.
_KERNEL_RADIUS_SIGMAS = 5.5
MAX_PSF_SIGMA_PX = 100.0
_MAX_F_NUMBER = 1000.0
_MAX_APERTURE_M, _LIKELY_APERTURE_M = 100.0, 2.0
# Detectors have pixels of 0.5 to 50 um.
_MAX_PITCH_M = 1e-3
_SMALLER = (("mm", 1e-3), ("um", 1e-6), ("nm", 1e-9))
# Below it no lens and no mirror works as the pupil's diffraction has it: X rays.
_LEAST_NM = 10.0
# Averaging diffraction over a band of 450-950 nm: 9 against 33 wavelengths differ by 1e-4; a narrower
# band needs fewer.
_N_WAVELENGTHS = 9
_WAVELENGTHS_PER_RELATIVE_WIDTH = 12.6
# A kernel of an aberrated pupil costs the fourth power of its radius: 63 px is seconds.
_MAX_ABERRATED_RADIUS_PX = 63
# Places a pixel and axis where a star's kernel is known; odd, so that a place is a cell's middle.
FINE = 5
_PARTS = {"aberrations": Aberrations, "stray_light": StrayLight}


@dataclass(frozen=True, kw_only=True)
class Optics:
    """Aperture, transmission and point spread function.

    Parameters
    ----------
    aperture_diameter_m : float [m], > 0, up to 100
        Outer diameter of the entrance pupil.
    transmission : float or pairs (wavelength [nm], value) [1], 0..1
        Transmission of lenses and filter together.
    band_nm : (low, high) float [nm]
        The wavelengths that the irradiance image spans.
    psf_sigma_px : float [px], 0..100
        Standard deviation of a Gaussian spread before integration over the pixel; 0 is none.
    f_number : float [1], > 0, up to 1000, optional
        Focal length over aperture diameter: adds the pupil's diffraction, averaged over the
        band's photons. Needs `pixel_pitch_m`.
    pixel_pitch_m : float [m], > 0, up to 1e-3, optional
    central_obscuration : float [1], 0..0.95
        Inner over outer diameter of an annular pupil, for diffraction and for the area.
    psf_radius_px : int [px], 1..255
        Half width of a diffraction kernel; what falls farther is lost and reported.
    aberrations : Aberrations, optional
        Wavefront error of the pupil; needs `f_number`. Where they vary over the field, the kernels are a grid.
    psf_measured : (n, m) or (rows, columns, n, m) numbers [1], optional
        Measured kernel, n and m odd, of non-negative shares that sum to at most 1; or a grid of
        kernels, evenly spaced from the frame's first pixel to its last, between which the light is
        shared out. It holds the optics' diffraction and the pixel: no `f_number` may be given with
        it; a Gaussian blurs it further, without counting the pixel again.
    stray_light : StrayLight, optional
        Wide wing and veil, over the whole frame.

    Raises
    ------
    ConfigError
    """

    aperture_diameter_m: float
    transmission: Curve = 1.0
    band_nm: tuple[float, float] = (450.0, 950.0)
    psf_sigma_px: float = 0.0
    f_number: float | None = None
    pixel_pitch_m: float | None = None
    central_obscuration: float = 0.0
    psf_radius_px: int = 15
    aberrations: Aberrations | None = None
    psf_measured: tuple | None = None
    stray_light: StrayLight | None = None

    def __post_init__(self):
        put = lambda name, value: object.__setattr__(self, name, value)  # noqa: E731 (frozen dataclass)
        put("aperture_diameter_m", _at_most("aperture_diameter_m", self.aperture_diameter_m, _MAX_APERTURE_M,
                                            _LIKELY_APERTURE_M))
        put("transmission", curve("transmission", self.transmission, 0.0, 1.0))
        put("band_nm", band("band_nm", self.band_nm))
        require_overlap("transmission", self.transmission, self.band_nm)
        put("psf_sigma_px", within("psf_sigma_px", self.psf_sigma_px, 0.0, MAX_PSF_SIGMA_PX))
        put("central_obscuration", within("central_obscuration", self.central_obscuration, 0.0, 0.95))
        put("psf_radius_px", integer("psf_radius_px", self.psf_radius_px, 1, 255))
        if (self.f_number is None) != (self.pixel_pitch_m is None):
            missing = "f_number" if self.f_number is None else "pixel_pitch_m"
            raise ConfigError(missing, "missing: diffraction needs both f_number and pixel_pitch_m")
        if self.is_diffracted:
            put("f_number", within("f_number", positive("f_number", self.f_number), 0.0, _MAX_F_NUMBER))
            put("pixel_pitch_m", _at_most("pixel_pitch_m", self.pixel_pitch_m, _MAX_PITCH_M, _MAX_PITCH_M))
            lambda_n_px = self.band_nm[0] * 1e-9 * self.f_number / self.pixel_pitch_m
            if not lambda_n_px >= psf.MIN_LAMBDA_N_PX:
                if 1e3 * lambda_n_px >= psf.MIN_LAMBDA_N_PX and self.band_nm[1] < _LEAST_NM:
                    raise ConfigError("band_nm", f"must reach beyond {_LEAST_NM:g} nm for diffraction", self.band_nm,
                                      f"in um? then write {[round(1e3 * x, 6) for x in self.band_nm]}")
                raise ConfigError("f_number", f"wavelength x f_number must be >= {psf.MIN_LAMBDA_N_PX} pixels, is "
                                  f"{lambda_n_px:.3g}", self.f_number, "leave diffraction out: it is invisible")
        for name, kind in _PARTS.items():
            if not isinstance(getattr(self, name), kind | None):
                raise ConfigError(name, f"must be {kind.__name__}", getattr(self, name))
        if self.aberrations is not None:
            if not self.is_diffracted:
                raise ConfigError("f_number", "missing: aberrations are the pupil's")
            integer("psf_radius_px", self.psf_radius_px, 1, _MAX_ABERRATED_RADIUS_PX)
        if self.psf_measured is not None:
            if self.is_diffracted:
                raise ConfigError("psf_measured", "holds the diffraction: give no f_number")
            put("psf_measured", _measured(self.psf_measured))

    @classmethod
    def from_dict(cls, table: Mapping[str, Any]) -> Optics:
        """From plain data; unknown keys are refused by name."""
        known_keys("", table, [f.name for f in fields(cls)], required=("aperture_diameter_m",))
        parts = dict(table)
        for name, kind in _PARTS.items():
            if name in parts:
                with error_path(name):
                    parts[name] = kind.from_dict(parts[name])
        return cls(**parts)

    @property
    def aperture_area_m2(self) -> float:
        """Area of the entrance pupil [m2]."""
        return math.pi / 4.0 * self.aperture_diameter_m**2 * (1.0 - self.central_obscuration**2)

    @property
    def is_diffracted(self) -> bool:
        """Whether the pupil's diffraction is part of the point spread function."""
        return self.f_number is not None

    @property
    def psf_kernel(self) -> np.ndarray:
        """Fraction of a point's light, at a pixel's centre, that falls into each pixel.

        Returns
        -------
        (2 r + 1,), (n, m) or (rows, columns, n, m) float64 [1]
            One axis of a separable kernel, the whole, or a grid over the frame; not renormalised.
        """
        return self._kernels[0]

    @property
    def image_kernel(self) -> np.ndarray:
        """Kernel for images whose pixels hold the mean over their area, made with `psf_kernel` (`image_kernel.py`)."""
        return self._kernels[1]

    @cached_property
    def _kernels(self) -> tuple[np.ndarray, np.ndarray]:
        """Kernels of points and of images."""
        gaussian_px = math.ceil(_KERNEL_RADIUS_SIGMAS * self.psf_sigma_px)
        if self.psf_measured is not None:
            measured = np.array(self.psf_measured)
            kernels = measured, without_pixel(measured)
            if self.psf_sigma_px > 0.0:
                kernels = tuple(psf.blurred(kernel, self.psf_sigma_px, gaussian_px + 2) for kernel in kernels)
            return kernels
        if not self.is_diffracted:
            return (psf.gaussian_axis(self.psf_sigma_px, gaussian_px),
                    gaussian_image_axis(self.psf_sigma_px, gaussian_px))
        point, splines = np.moveaxis(self._pupil_kernels(max(self.psf_radius_px, gaussian_px)), -3, 0)
        image = from_splines(splines)
        # Near the rim one holds a little more than the other.
        return point, image * (point.sum(axis=(-2, -1)) / image.sum(axis=(-2, -1)))[..., None, None]

    @cached_property
    def psf_fine_kernel(self) -> np.ndarray:
        """A pupil's or a measured kernel at places a fifth of a pixel apart, each the light of a whole pixel around it.

        Returns
        -------
        (n, m) or (rows, columns, n, m) float64 [1]
            Its middle and every fifth place from there are `psf_kernel`, of a pupil; n = 5 (2 r + 2) + 1. A measured
            one is a pixel wider on each side, r + 1 for r, so that its rim may be light.
        """
        if self.psf_measured is not None:
            return measured_between(self.psf_kernel, FINE)
        radius_px = self.psf_margin_px[0]
        fine = self._pupil_kernels(FINE * (radius_px + 1) + FINE // 2, FINE)[..., 0, :, :]
        # The sum over 5 x 5 cells around each place.
        total = np.cumsum(np.cumsum(np.pad(fine, [(0, 0)] * (fine.ndim - 2) + [(1, 0)] * 2), axis=-1), axis=-2)
        rows = total[..., FINE:, :] - total[..., :-FINE, :]
        return rows[..., FINE:] - rows[..., :-FINE]

    def _pupil_kernels(self, radius: int, parts: int = 1) -> np.ndarray:
        """(..., windows, n, n): kernels, or a grid of kernels: `radius` pixels to each side, `parts` cells a pixel."""
        relative_width = 2.0 * (self.band_nm[1] - self.band_nm[0]) / sum(self.band_nm)
        n_wavelengths = min(_N_WAVELENGTHS, math.ceil(_WAVELENGTHS_PER_RELATIVE_WIDTH * relative_width))
        wavelengths_m, weights = photon_weights(self.band_nm, self.transmission, n_wavelengths)

        def kernel(opd_m=None) -> np.ndarray:
            return psf.diffraction_kernels(
                wavelengths_m, weights, f_number=self.f_number, pixel_pitch_m=self.pixel_pitch_m / parts,
                central_obscuration=self.central_obscuration, sigma_px=self.psf_sigma_px * parts,
                radius_px=radius, opd_m=opd_m, n_nodes=8 if parts == 1 else 2,
                windows=(psf.gaussian_weights, spline_weights) if parts == 1 else None)

        lens = self.aberrations
        if lens is None:
            return kernel()
        if not lens.varies:
            return kernel(lambda x, y: 1e-9 * lens.opd_nm(x, y))
        at = lambda node: kernel(lambda x, y: 1e-9 * lens.opd_nm(x, y, tuple(node)))  # noqa: E731
        nodes = lens.nodes()
        if lens.zernike_nm:
            return np.array([[at(node) for node in row] for row in nodes])
        # Without terms of their own direction the field is its own mirror image: a quadrant is enough.
        rows, columns = lens.grid
        top = np.array([[at(node) for node in row[:(columns + 1) // 2]] for row in nodes[:(rows + 1) // 2]])
        left = np.concatenate([top, top[:rows // 2][::-1, ..., ::-1, :]])
        return np.concatenate([left, left[:, :columns // 2][:, ::-1, ..., ::-1]], axis=1)

    @property
    def psf_margin_px(self) -> tuple[int, int]:
        """Distance over which light is spread along rows' and columns' index [px]."""
        shape = self.psf_kernel.shape[-2:]
        return shape[0] // 2, shape[-1] // 2

    @cached_property
    def psf_energy_cut(self) -> float:
        """Fraction of a point's light that falls outside the kernel, and is lost; of a grid, the most."""
        kernel = self.psf_kernel
        total = kernel.sum() ** 2 if kernel.ndim == 1 else kernel.sum(axis=(-2, -1)).min()
        return max(0.0, 1.0 - float(total))

    @cached_property
    def psf_noise_gain(self) -> float:
        """Factor on the RMS of errors independent from pixel to pixel: sqrt(sum k^2), the largest of a grid."""
        kernel = self.image_kernel
        return float((kernel**2).sum() if kernel.ndim == 1 else np.sqrt((kernel**2).sum(axis=(-2, -1)).max()))

    @property
    def psf_text(self) -> str:
        """The point spread function in words; empty when there is none."""
        parts = []
        if self.psf_measured is not None:
            parts.append("measured")
        if self.is_diffracted:
            parts.append(f"diffraction at f/{self.f_number:g}, obscuration {self.central_obscuration:g}")
        if self.aberrations is not None:
            parts.append("aberrations")
        if self.psf_sigma_px > 0.0:
            parts.append(f"Gaussian of sigma {self.psf_sigma_px:g} px")
        if not parts:
            return ""
        rows, columns = (2 * margin + 1 for margin in self.psf_margin_px)
        grid = self.psf_kernel.shape[:-2]
        over = f" on {grid[0]} x {grid[1]} nodes over the frame" if grid else ""
        return f"{' and '.join(parts)}, kernel {rows} x {columns} px{over}, energy cut {self.psf_energy_cut:.2g}"

    def spread(self, image: np.ndarray, origin_px: tuple[int, int] = (0, 0),
               frame_shape: tuple[int, int] | None = None, *, is_points: bool = False) -> np.ndarray:
        """Convolve with the point spread function; darkness beyond the edges, no wrap-around.

        Parameters
        ----------
        image : (h, w) float32
            The frame, or a part with darkness elsewhere; each pixel the light of its area.
        origin_px : (row, column) int [px]
            Place of the part in the frame.
        frame_shape : (H, W) int [px], optional
            Default: the image is the frame.
        is_points : bool
            Whether the light is that of points at the pixels' centres instead.

        Returns
        -------
        (h, w) float32
        """
        convolution = self._convolutions[0 if is_points else 1]
        if isinstance(convolution, FieldConvolution):
            return convolution(image, origin_px, frame_shape or image.shape)
        return image if self.psf_kernel.size == 1 and self.psf_kernel.sum() == 1.0 else convolution(image)

    @cached_property
    def _convolutions(self) -> tuple[Convolution | FieldConvolution, ...]:
        return tuple((FieldConvolution if kernel.ndim == 4 else Convolution)(kernel) for kernel in self._kernels)


def _at_most(name: str, value: object, most_m: float, likely_m: float) -> float:
    """A length > 0 up to a limit; a larger one is refused with the unit in which it is likely."""
    number = positive(name, value)
    if not number <= most_m:
        meant = [f"in {unit}? then write {number * metres:.6g}" for unit, metres in _SMALLER
                 if number * metres <= likely_m]
        raise ConfigError(name, f"must be at most {most_m:g} m", value, "".join(meant[:1]))
    return number


def _measured(value: object) -> tuple[tuple[float, ...], ...]:
    try:
        kernel = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        kernel = np.empty(0)
    if kernel.ndim not in (2, 4) or kernel.size == 0 or kernel.shape[-2] % 2 == 0 or kernel.shape[-1] % 2 == 0:
        raise ConfigError("psf_measured", "must be a table of numbers, or a grid of tables, with odd numbers of "
                          "rows and columns")
    # A measured sum of 1 may be off by its own rounding, no more: a lens makes no light.
    sums = kernel.sum(axis=(-2, -1))
    if not (kernel >= 0.0).all() or not (sums > 0.0).all() or not (sums <= 1.0 + 1e-6).all():
        raise ConfigError("psf_measured", "must be >= 0 and sum to a fraction of the light, at most 1",
                          float(sums.max()))
    return _tuples(kernel.tolist())


def _tuples(nested: list) -> tuple:
    return tuple(_tuples(x) if isinstance(x, list) else x for x in nested)
