"""Focal planes in millimetres, turned into cameras: the lens is inverted, and the residual reported."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from glrender_camera import BrownConrady, PinholeCamera
from scipy.spatial.transform import Rotation

from ...base.attitude import from_spice
from ...base.errors import ConfigError
from .lens import Lens

MAX_RESIDUAL_PX = 1.0
"""A camera whose lens fits less well is refused."""
TOLD_RESIDUAL_PX = 0.05
"""A residual that is warned of: what centroids are measured to."""
TOLD_SHIFT = 0.02
"""A shift that is warned of, as a share of the width: few narrow cameras have it, and wrong units do."""
# Nodes on each axis of the fit, and others, between them, for its residual.
_FIT, _TEST = 17, 90
# A fit that needs no more terms.
_WELL_PX = 1e-4


@dataclass(frozen=True, kw_only=True, eq=False)
class FocalPlane:
    """The detector of a camera, in the sensor's frame whose +Z is the boresight.

    Parameters
    ----------
    width_px, height_px : int [px]
    focal_length_mm : float [mm], > 0
    centre_px : (2,) float [px]
        Column and row of the boresight's image without distortion, (0, 0) the centre of the first pixel.
    px_from_mm : (2, 2) float [px/mm]
        Columns and rows per mm along the sensor's X and Y.
    lens : Lens, optional
        From distorted to ideal places [mm].
    """

    width_px: int
    height_px: int
    focal_length_mm: float
    centre_px: np.ndarray
    px_from_mm: np.ndarray
    lens: Lens | None = None

    @property
    def is_mirrored(self) -> bool:
        """Whether rows count upwards: ISIS counts lines from the bottom where a FITS file does."""
        return bool(np.linalg.det(self.px_from_mm) < 0.0)

    def ratios(self, pixel: np.ndarray) -> np.ndarray:
        """X / Z, Y / Z in the sensor's frame (..., 2) [1] of pixels (..., 2) [px], rows as the file counts them."""
        distorted = (np.asarray(pixel, float) - self.centre_px) @ np.linalg.inv(self.px_from_mm).T
        return (distorted if self.lens is None else self.lens(distorted)) / self.focal_length_mm

    def camera(self, name: str, **more: Any) -> FittedCamera:
        """The camera in the sensor's frame, fitted to the whole detector.

        Its rows count downwards: of a mirrored focal plane row r is the file's row height - 1 - r.

        Parameters
        ----------
        name : str
        **more
            A field of `PinholeCamera`: the model.

        Raises
        ------
        ConfigError
            A lens that the camera's distortion does not follow within `MAX_RESIDUAL_PX`.
        """
        axes = self._axes()
        fit, residual_px = self._fitted(axes)
        # A residual that is not finite is none within.
        if not residual_px <= MAX_RESIDUAL_PX:
            raise ConfigError("lens", f"must be followed by radial and tangential terms within {MAX_RESIDUAL_PX:g} px "
                              "all over the detector", round(residual_px, 3),
                              'check its coefficients, or give another `lens`, or lens.model = "none"')
        camera = PinholeCamera(
            name=name, width_px=self.width_px, height_px=self.height_px, focal_length_px=fit.focal_length_px,
            principal_point_px=fit.centre_px, distortion=fit.distortion,
            q_camera_from_spacecraft=from_spice(axes), **more)
        pixels, ratios = self._samples(_FIT, axes)
        straight = ratios * fit.focal_length_px + fit.centre_px
        return FittedCamera(camera=camera, residual_px=residual_px, is_mirrored=self.is_mirrored,
                            shift_px=float(np.hypot(*(straight - pixels).T).max()))

    def _fitted(self, axes: np.ndarray) -> tuple[_Fit, float]:
        """The fit with the fewest terms that does, or the best of all, and its residual between the nodes [px]."""
        nodes, between = self._samples(_FIT, axes), self._samples(_TEST, axes)
        found: list[tuple[_Fit, float]] = []
        for n_radial in (1, 2, 3) if self.lens is not None else (0,):
            fit = _fit(*nodes, n_radial)
            found.append((fit, float(np.nan_to_num(_residuals_px(fit, *between), nan=np.inf).max())))
            if found[-1][1] <= _WELL_PX:
                break
        return min(found, key=lambda pair: pair[1])

    def _axes(self) -> np.ndarray:
        """Camera axes right, down, boresight (3, 3) as rows in the sensor's frame: the nearest to the detector's."""
        right_down = self.px_from_mm * ([[1.0], [-1.0]] if self.is_mirrored else 1.0)
        u, _, v = np.linalg.svd(right_down)
        axes = np.eye(3)
        axes[:2, :2] = u @ v
        return Rotation.from_matrix(axes).as_matrix()

    def _samples(self, count: int, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (N, 2) over the whole detector, edges included, and X / Z, Y / Z in camera axes."""
        x, y = (np.linspace(-0.5, size - 0.5, count) for size in (self.width_px, self.height_px))
        pixels = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        ratios = self.ratios(pixels) @ axes[:2, :2].T
        if not np.isfinite(ratios).all():
            raise ConfigError("lens", "images no direction to some of the detector",
                              hint="check coefficients and their unit, 1/mm^2 and 1/mm^4")
        if self.is_mirrored:
            pixels[:, 1] = self.height_px - 1.0 - pixels[:, 1]
        return pixels, ratios


@dataclass(frozen=True, kw_only=True, eq=False)
class FittedCamera:
    """A camera made of a focal plane.

    Parameters
    ----------
    camera : PinholeCamera
        Mounted on the sensor's frame.
    residual_px : float [px]
        Largest distance between a pixel and the image of its direction.
    shift_px : float [px]
        Largest distance by which the lens moves a place.
    is_mirrored : bool
        Whether the file counts rows upwards, and the camera's rows are turned round.
    """

    camera: PinholeCamera
    residual_px: float
    shift_px: float
    is_mirrored: bool

    def notes(self) -> list[str]:
        """Warnings, in sentences."""
        warnings = []
        if self.residual_px > TOLD_RESIDUAL_PX:
            warnings.append(f"camera {self.camera.name!r}: its distortion follows the instrument's to "
                            f"{self.residual_px:.2g} px at the worst place")
        if self.shift_px > TOLD_SHIFT * self.camera.width_px:
            warnings.append(f"camera {self.camera.name!r}: its lens moves places by up to {self.shift_px:.3g} px; if "
                            'that is too much, give another `lens`, or lens.model = "none"')
        if self.is_mirrored:
            warnings.append(f"camera {self.camera.name!r}: the file counts lines upwards; row r is its line "
                            f"{self.camera.height_px - 1} - r, as FITS viewers show it")
        return warnings


@dataclass(frozen=True, kw_only=True, eq=False)
class _Fit:
    focal_length_px: float
    centre_px: np.ndarray
    distortion: BrownConrady | None


def _fit(pixels: np.ndarray, ratios: np.ndarray, n_radial: int) -> _Fit:
    """Focal length, principal point and distortion by linear least squares.

    With f k1, f k2, ... as unknowns Brown and Conrady's model is linear.
    """
    scale = float(np.hypot(*ratios.T).max())
    x, y = (ratios / scale).T
    r2, zero, one = x * x + y * y, np.zeros_like(x), np.ones_like(x)
    columns = [(one, zero), (zero, one), (x, y), *((x * r2**k, y * r2**k) for k in range(1, n_radial + 1))]
    if n_radial:
        columns += [(2.0 * x * y, r2 + 2.0 * y * y), (r2 + 2.0 * x * x, 2.0 * x * y)]
    matrix = np.concatenate([np.stack(part, axis=1) for part in zip(*columns, strict=True)])
    found = np.linalg.lstsq(matrix, pixels.T.ravel(), rcond=None)[0]
    focal_length_px = float(found[2] / scale)
    if not focal_length_px > 0.0:
        raise ConfigError("lens", "turns the image round", hint="check its coefficients and their unit")
    distortion = None
    if n_radial:
        radial = found[3:-2] / found[2] / scale ** (2.0 * np.arange(1, n_radial + 1))
        p1, p2 = found[-2:] / found[2] / scale
        distortion = BrownConrady(**dict(zip(("k1", "k2", "k3"), radial, strict=False)), p1=p1, p2=p2)
    return _Fit(focal_length_px=focal_length_px, centre_px=found[:2], distortion=distortion)


def _residuals_px(fit: _Fit, pixels: np.ndarray, ratios: np.ndarray) -> np.ndarray:
    """Distances (N,) [px] from pixels to where their light lands; NaN beyond the distortion's fold."""
    if fit.distortion is not None:
        ratios = fit.distortion.distort(ratios)
    return np.hypot(*(fit.focal_length_px * ratios + fit.centre_px - pixels).T)
