"""An image of one body gives its centre of brightness, and by its lit limb its centre, radius and range."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

_NAN = float("nan")
# Rays from the centre of brightness, to both sides of the Sun's direction: beyond, the limb meets the terminator.
_N_RAYS, _HALF_ARC_RAD, _STEP_PX = 181, math.radians(75.0), 0.25
# Light counts above this share of the brightest pixel, and above so many standard deviations of the read noise.
_FLOOR_SHARE, _FLOOR_SIGMAS = 0.02, 5.0
_MIN_POINTS, _MIN_RADIUS_PX, _MAX_RESIDUAL_SHARE = 20, 3.0, 0.1
# An edge's steepest place is searched so far around the outermost light [px].
_EDGE_PX = 3.0


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Measurements of one frame; NaN where the image has none.

    Attributes
    ----------
    brightness_px, limb_px : (2,) float [px]
        Centre of brightness, and the image of the centre of the sphere whose limb was found: x right, y down.
    limb_radius_px : float [px]
        Focal length times the tangent of the sphere's angular radius.
    limb_residual_px : float [px]
        RMS distance of the limb's points from the fit: what an irregular body leaves.
    range_m : float [m]
        From the camera to the centre.
    """

    brightness_px: tuple[float, float] = (_NAN, _NAN)
    limb_px: tuple[float, float] = (_NAN, _NAN)
    limb_radius_px: float = _NAN
    limb_residual_px: float = _NAN
    range_m: float = _NAN

    @property
    def is_valid(self) -> bool:
        """Whether a limb was found, and is that of a body near a sphere."""
        return self.limb_residual_px <= _MAX_RESIDUAL_SHARE * self.limb_radius_px


def measured(dn: np.ndarray, camera: Mapping[str, Any], sun_direction_camera: Sequence[float],
             radius_m: float) -> Measured:
    """Measure an image.

    Parameters
    ----------
    dn : (height, width) int [DN]
    camera : mapping
        As `hello` describes it: `focal_length_px`, `principal_point_px` and `detector`.
    sun_direction_camera : (3,) float
        From the body towards the Sun, of any length.
    radius_m : float [m]
        Of the body, for its range.

    Source of the fit: Christian & Robinson (2016), "Noniterative horizon-based optical navigation by Cholesky
    factorization", for a sphere: each line of sight u to the limb has u . n = 1, and n leads to the centre.
    """
    detector = camera["detector"]
    light = dn - float(detector["offset_DN"])
    noise_DN = detector["read_noise_electrons"] * detector["gain_DN_per_electron"]
    floor = max(_FLOOR_SHARE * light.max(), _FLOOR_SIGMAS * noise_DN)
    y, x = np.nonzero(light > floor)
    if not len(x):
        return Measured()
    weights = light[y, x]
    brightness_px = float(weights @ x / weights.sum()), float(weights @ y / weights.sum())
    points_px = _limb(light, floor, brightness_px, math.atan2(sun_direction_camera[1], sun_direction_camera[0]))
    return _fitted(points_px, camera["focal_length_px"], camera["principal_point_px"], radius_m, brightness_px)


def _limb(light: np.ndarray, floor: float, centre_px: tuple[float, float], towards_sun_rad: float) -> np.ndarray:
    """Places (N, 2) [px] where light falls steepest behind the outermost light of each ray that ends in the image."""
    height, width = light.shape
    angles = towards_sun_rad + np.linspace(-_HALF_ARC_RAD, _HALF_ARC_RAD, _N_RAYS)
    directions = np.stack((np.cos(angles), np.sin(angles)), axis=-1)
    along_px = np.arange(0.0, math.hypot(width, height), _STEP_PX)
    x, y = (centre_px[k] + directions[:, k, None] * along_px for k in (0, 1))
    is_inside = (x >= 0.0) & (x <= width - 1.0) & (y >= 0.0) & (y <= height - 1.0)
    values = np.where(is_inside, _interpolated(light, np.clip(x, 0.0, width - 1.0), np.clip(y, 0.0, height - 1.0)), 0.0)
    reach = round(1.0 / _STEP_PX)
    falls = np.zeros_like(values)
    falls[:, reach:-reach] = values[:, :-2 * reach] - values[:, 2 * reach:]
    found = []
    for fall, value, inside, direction in zip(falls, values, is_inside, directions, strict=True):
        lit = np.flatnonzero(value > floor)
        if not len(lit):
            continue
        around = round(_EDGE_PX / _STEP_PX)
        first, last = max(lit[-1] - around, reach), lit[-1] + around
        if last + reach >= len(value) or not inside[last + reach]:
            continue  # the body leaves the image there
        k = first + int(fall[first:last].argmax())
        before, here, after = fall[k - reach], fall[k], fall[k + reach]
        bend = before - 2.0 * here + after
        offset = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
        found.append(centre_px + direction * (along_px[k] + offset))
    return np.array(found).reshape(-1, 2)


def _interpolated(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Bilinear values at places inside."""
    x0, y0 = (np.minimum(v.astype(int), n - 2) for v, n in ((x, image.shape[1]), (y, image.shape[0])))
    fx, fy = x - x0, y - y0
    upper = image[y0, x0] * (1.0 - fx) + image[y0, x0 + 1] * fx
    return upper * (1.0 - fy) + (image[y0 + 1, x0] * (1.0 - fx) + image[y0 + 1, x0 + 1] * fx) * fy


def _fitted(points_px: np.ndarray, focal_px: float, principal_px: Sequence[float], radius_m: float,
            brightness_px: tuple[float, float]) -> Measured:
    nothing = Measured(brightness_px=brightness_px)
    lines = np.column_stack(((points_px - np.asarray(principal_px)) / focal_px, np.ones(len(points_px))))
    lines /= np.linalg.norm(lines, axis=1)[:, None]
    is_used = np.ones(len(lines), bool)
    for _ in range(4):
        if is_used.sum() < _MIN_POINTS:
            return nothing
        normal = np.linalg.lstsq(lines[is_used], np.ones(is_used.sum()), rcond=None)[0]
        length = float(np.linalg.norm(normal))
        if not (length > 1.0 and normal[2] > 0.0):
            return nothing
        # A line that misses the limb by an angle d has u . n - 1 = -d times the tangent of the angular radius.
        tangent = math.sqrt(length**2 - 1.0)
        off_px = focal_px * (lines @ normal - 1.0) / tangent
        spread_px = 1.4826 * float(np.median(np.abs(off_px[is_used])))
        is_used = np.abs(off_px) <= max(3.0 * spread_px, 0.1)
    if not focal_px * tangent >= _MIN_RADIUS_PX:
        return nothing
    limb_px = np.asarray(principal_px) + focal_px * normal[:2] / normal[2]
    return Measured(brightness_px=brightness_px, limb_px=tuple(map(float, limb_px)),
                    limb_radius_px=focal_px * tangent, limb_residual_px=float(np.sqrt(np.mean(off_px[is_used]**2))),
                    range_m=radius_m * length / tangent)
