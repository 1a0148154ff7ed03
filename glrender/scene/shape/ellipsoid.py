"""Longitudes, latitudes and heights on a planet's sphere or ellipsoid, by its radii at the equator and at the pole."""

from __future__ import annotations

import numpy as np


def degrees_towards(direction: np.ndarray, radii_m: tuple[float, float]) -> np.ndarray:
    """Longitudes and planetographic latitudes (2, N) [deg] of an ellipsoid in directions (3, N) from its centre."""
    x, y, z = direction
    return np.degrees([np.arctan2(y, x), np.arctan2(z * (radii_m[0] / radii_m[1]) ** 2, np.hypot(x, y))])


def places_m(degrees: np.ndarray, height_m: np.ndarray, radii_m: tuple[float, float]) -> np.ndarray:
    """Places (3, N) [m] of longitudes and latitudes (2, N) [deg] at heights (N,) [m] above an ellipsoid."""
    (lon, lat), (a_m, b_m) = np.radians(degrees), radii_m
    radius_m = a_m**2 / np.hypot(a_m * np.cos(lat), b_m * np.sin(lat))
    across_m = (radius_m + height_m) * np.cos(lat)
    return np.stack([across_m * np.cos(lon), across_m * np.sin(lon),
                     (radius_m * (b_m / a_m) ** 2 + height_m) * np.sin(lat)])


def east_north_up(degrees: np.ndarray) -> np.ndarray:
    """Unit vectors (3, 3) to the east, to the north and up at a longitude and latitude (2,) [deg]."""
    (x, w), (y, z) = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[-y, x, 0.0], [-z * x, -z * y, w], [w * x, w * y, z]])


def degrees_around(degrees: np.ndarray, away_m: np.ndarray, radii_m: tuple[float, float]) -> np.ndarray:
    """Longitudes and latitudes (2, N) [deg] of places east and north of one by (2, N) [m] along the ground.

    On an ellipsoid the distances are those of the sphere through the one, about the centre.
    """
    middle_m = places_m(degrees[:, None], np.zeros(1), radii_m)[:, 0]
    radius_m, east = np.linalg.norm(middle_m), east_north_up(degrees)[0]
    up, total_m = middle_m / radius_m, np.hypot(*away_m)
    along = np.sin(total_m / radius_m) / np.where(total_m > 0.0, total_m, 1.0) * away_m
    return degrees_towards(np.outer(up, np.cos(total_m / radius_m)) + np.outer(east, along[0])
                           + np.outer(np.cross(up, east), along[1]), radii_m)
