"""Images of convex bodies as sums over their facets: visible area times radiance, cut at the pixels' sides."""

from __future__ import annotations

import numpy as np
from glrender import frames
from glrender.base.constants import AU_M
from views import SOLAR_IRRADIANCE_W_M2


def facet_image(shape, state, camera, law) -> np.ndarray:
    """Irradiance (rows, columns) float64 [W/m2] of a convex body at the origin, the Sun a point.

    Each facet is as bright all over as in its middle.
    """
    r_camera, r_sun = state.spacecraft.r_inertial_m, state.r_sun_inertial_m
    middle = shape.vertices_m[shape.facets].mean(axis=1)
    to_camera, sun = r_camera - middle, r_sun / np.linalg.norm(r_sun)
    to_camera /= np.linalg.norm(to_camera, axis=1)[:, None]
    seen = np.flatnonzero((shape.facet_normals @ sun > 0.0) & ((shape.facet_normals * to_camera).sum(axis=1) > 0.0))
    normal = shape.facet_normals[seen]
    solar = SOLAR_IRRADIANCE_W_M2 / (np.linalg.norm(r_sun) / AU_M) ** 2
    radiance = solar * law.brdf(sun, to_camera[seen], normal) * (normal @ sun)
    seen_m = (shape.vertices_m - r_camera) @ frames.dcm(state.spacecraft.q_from_inertial).T
    image, places = np.zeros((camera.height_px, camera.width_px)), camera.project(seen_m)
    cosine = (seen_m[:, 2] / np.linalg.norm(seen_m, axis=1))[shape.facets[seen]].mean(axis=1)
    light = radiance * cosine**3 / camera.focal_length_px**2
    for corners, value in zip(places[shape.facets[seen]], light, strict=True):
        for row in _pixels(corners[:, 1], camera.height_px):
            strip = _cut(_cut(corners, 1, row - 0.5, 1.0), 1, row + 0.5, -1.0)
            for column in _pixels(strip[:, 0], camera.width_px):
                image[row, column] += value * _area(_cut(_cut(strip, 0, column - 0.5, 1.0), 0, column + 0.5, -1.0))
    return image


def _pixels(places: np.ndarray, count: int) -> range:
    """Pixels that places along an axis [px] reach over."""
    if not len(places):
        return range(0)
    return range(max(int(np.floor(places.min() + 0.5)), 0), min(int(np.floor(places.max() + 0.5)), count - 1) + 1)


def _cut(corners: np.ndarray, axis: int, edge: float, sign: float) -> np.ndarray:
    """What is left of a polygon (N, 2) on the greater side of an edge, or, with -1, the lesser: Sutherland-Hodgman."""
    kept = []
    for one, other in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        here, there = sign * (one[axis] - edge), sign * (other[axis] - edge)
        if here >= 0.0:
            kept.append(one)
        if here * there < 0.0:
            kept.append(one + here / (here - there) * (other - one))
    return np.array(kept).reshape(-1, 2)


def _area(corners: np.ndarray) -> float:
    x, y = corners.T
    return 0.5 * abs(float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))))
