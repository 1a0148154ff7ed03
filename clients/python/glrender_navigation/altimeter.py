"""Estimator by a laser altimeter: measured ranges against those of the believed scene."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .believed import grown, is_anothers_ground
from .body import BelievedBody
from .camera import Camera, Sight, StateLike, others_px
from .checks import array, number, refuse, whole
from .measurement import Estimator, Measurement, NotFound

# Standard deviation across the surface's normals, over the believed range [1]: nothing is known there.
_UNKNOWN = 10.0
_LEAST_GROUND = 9


class Altimeter(Estimator):
    """Ranges along fixed beams against the believed scene's `range` at the same pixels.

    Where the camera's place errs by d, a range errs by n.d / n.b, with the ground's normal n and the beam b: one beam
    measures along its normal, some beams on ground of several slopes measure all. The normal is that of a plane through
    the ground within `reach_px`, and what the ground departs from the plane is an error of the range.

    Parameters
    ----------
    camera : Camera
        Whose frame and place the beams have.
    body : BelievedBody
    beams_px : (N, 2) int [px], optional
        Pixels that the beams go through; the one nearest to the principal point by default.
    sigma_m : float [m], optional
        Standard deviation of a range.
    reach_px : int [px], optional
        How far the believed place may be off in the image.

    Raises
    ------
    ValueError
        With the field: a beam out of the image, or a value that is no number.
    """

    name = "altimeter"

    def __init__(self, camera: Camera, body: BelievedBody, *, beams_px: np.ndarray | None = None, sigma_m: float = 1.0,
                 reach_px: int = 8):
        super().__init__(camera, body)
        beams_px = array("beams_px", [camera.principal_point_px] if beams_px is None else beams_px, (None, 2),
                         "give x and y of each beam")
        self._beams_px, size = np.rint(beams_px).astype(int), (camera.width_px, camera.height_px)
        if ((self._beams_px < 0) | (self._beams_px >= size)).any():
            raise refuse("beams_px", f"must be within the image of {size[0]} x {size[1]} px", beams_px,
                         "ranges are believed at the camera's pixels")
        self._sigma_m, self._reach_px = number("sigma_m", sigma_m, "give metres"), whole("reach_px", reach_px)

    @property
    def directions_camera(self) -> np.ndarray:
        """Beams (N, 3), unit vectors in `camera`: of `Client.range`."""
        return self.camera.direction(self._beams_px)

    def _measured(self, frame: np.ndarray, believed: StateLike, here: Sight,
                  render: Callable[..., Any]) -> Measurement:
        information, sums, used = np.eye(3) / (_UNKNOWN * here.range_m)**2, np.zeros(3), 0
        reach, size = self._reach_px, np.array([self.camera.width_px, self.camera.height_px])
        low = np.clip(self._beams_px.min(axis=0) - reach, 0, size - 1)
        high = np.clip(self._beams_px.max(axis=0) + reach + 1, low + 1, size)
        others = others_px(believed, self.camera, self.body.name)
        products = ["range", "r_body"] if others else ["range"]
        arrays = render(believed, products=products, roi=[*map(int, low), *map(int, high)]).arrays
        ranges, is_near_other = arrays["range"], np.zeros(arrays["range"].shape, bool)
        if others:
            is_near_other = grown(is_anothers_ground(arrays, low, self.camera, here, self.body), reach)
        rays = self.camera.direction(np.stack(np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1])), -1))
        places = rays * ranges[..., None]
        for range_m, (x, y) in zip(frame, self._beams_px - low, strict=True):
            near = (slice(max(y - reach, 0), y + reach + 1), slice(max(x - reach, 0), x + reach + 1))
            ground = places[near][np.isfinite(ranges[near])]
            # Nothing returned, or is believed to; or another body is near, whose range it may be.
            if is_near_other[y, x] or not np.isfinite(range_m - ranges[y, x]) or len(ground) < _LEAST_GROUND:
                continue
            _, sizes, axes = np.linalg.svd(ground - ground.mean(axis=0), full_matrices=False)
            slant = rays[y, x] @ axes[2]
            # Ground seen from its edge says little.
            if not abs(slant) > 0.1:
                continue
            row = axes[2] / slant
            variance_m2 = self._sigma_m**2 + (self.body.shape_error_m**2 + sizes[2]**2 / len(ground)) / slant**2
            information += np.outer(row, row) / variance_m2
            sums += row * (range_m - ranges[y, x]) / variance_m2
            used += 1
        if not used:
            raise NotFound(f"none of {len(self._beams_px)} beams has both a return and believed ground, clear of other "
                           "bodies")
        covariance = np.linalg.inv(information)
        return Measurement.of_place(self.camera, here.r_body_camera_m + covariance @ sums, covariance, is_by_size=False)

    def _checked(self, frame: np.ndarray) -> np.ndarray:
        """Ranges (N,) [m], NaN where nothing returned."""
        ranges = np.atleast_1d(np.asarray(frame, float))
        if ranges.shape != (len(self._beams_px),):
            raise ValueError(f"frame: must have one range [m] for each of {len(self._beams_px)} beams, got shape "
                             f"{ranges.shape}")
        return ranges
