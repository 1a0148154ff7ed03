"""An independent truth for few facets: float64 rays against every facet; backs hide nothing, and cast shadows."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation


def _distances(start, direction, corners):
    """Distances (N,) along rays to a facet (3, 3), infinite beside it, and whether they meet its front (N,)."""
    a, (u, v) = corners[0], (corners[1] - corners[0], corners[2] - corners[0])
    normal = np.cross(u, v)
    along = direction @ normal
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (a - start) @ normal / along
        place = start + distance[:, None] * direction - a
    s, t = np.linalg.solve([[u @ u, u @ v], [u @ v, v @ v]], [place @ u, place @ v])
    return np.where((s >= 0.0) & (t >= 0.0) & (s + t <= 1.0), distance, np.inf), along < 0.0


def light(bodies, camera, state, solar_irradiance_1au_W_m2, samples=6):
    """Irradiance (H, W) [W/m2] of one point-like Sun's light, at samples x samples places a pixel.

    Parameters
    ----------
    bodies : list of (corners (F, 3, 3) [m], law)
        At the inertial origin, at 1 au.
    """
    facets = [(triangle, law) for corners, law in bodies for triangle in corners]
    offset = (np.arange(samples) + 0.5) / samples - 0.5
    y = (np.arange(camera.height_px)[:, None] + offset).ravel()
    x = (np.arange(camera.width_px)[:, None] + offset).ravel()
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    # Each row is aside of the others, so that no upright edge falls between the same places all along.
    grid[..., 0] += ((0.618034 * np.arange(len(y))) % 1.0 - 0.5)[:, None] / samples
    grid = grid.reshape(-1, 2) - camera.principal_point_px
    rays = np.column_stack([grid, np.full(len(grid), camera.focal_length_px)])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    cos_boresight = rays[:, 2].copy()
    rays = rays @ Rotation.from_quat(state.spacecraft.q_from_inertial, scalar_first=True).as_matrix()
    start, nearest, which = state.spacecraft.r_inertial_m, np.full(len(rays), np.inf), np.full(len(rays), -1)
    for number, (triangle, _) in enumerate(facets):
        # Rays within the facet's circle alone.
        middle = triangle.mean(axis=0) - start
        radius, range_m = np.linalg.norm(triangle - start - middle, axis=1).max(), np.linalg.norm(middle)
        near = np.flatnonzero(rays @ (middle / range_m) > np.sqrt(max(1.0 - (radius / range_m) ** 2, 0.0)))
        distance, is_front = _distances(start, rays[near], triangle)
        is_nearer = is_front & (distance > 0.0) & (distance < nearest[near])
        nearest[near[is_nearer]], which[near[is_nearer]] = distance[is_nearer], number
    to_sun, value = state.r_sun_inertial_m / np.linalg.norm(state.r_sun_inertial_m), np.zeros(len(rays))
    for number, (triangle, law) in enumerate(facets):
        mine = np.flatnonzero(which == number)
        normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
        normal /= np.linalg.norm(normal)
        if not len(mine) or not normal @ to_sun > 0.0:
            continue
        # Off the facet by far more than float64 errs and far less than is seen.
        place = start + nearest[mine, None] * rays[mine] + 1e-9 * normal
        toward, is_free = np.broadcast_to(to_sun, place.shape), np.ones(len(mine), bool)
        for other, _ in facets:
            distance, _ = _distances(place, toward, other)
            is_free &= ~((distance > 0.0) & np.isfinite(distance))
        value[mine] = is_free * (normal @ to_sun) * law.brdf(toward, -rays[mine], np.broadcast_to(normal, place.shape))
    value *= solar_irradiance_1au_W_m2 * cos_boresight**3 / camera.focal_length_px**2
    return value.reshape(camera.height_px, samples, camera.width_px, samples).mean(axis=(1, 3))
