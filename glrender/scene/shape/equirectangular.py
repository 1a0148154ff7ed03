"""Texture coordinates of maps of longitudes and latitudes, as most are published: from a shape's own places."""

from __future__ import annotations

import numpy as np
from glrender_camera.validate import known_keys, one_of, within

# Distance from the axis over that from the origin [1] below which a corner is a pole, and has no longitude.
_POLE = 1e-9


def left_edge_of(projection: object) -> float:
    """Longitude [deg] of a map's left edge, -360..360: of a table with the keys `kind` and `left_edge_deg`.

    Raises
    ------
    ConfigError
    """
    known_keys("", projection, ("kind", "left_edge_deg"), required=("kind",))
    one_of("kind", projection["kind"], ("equirectangular",))
    return within("left_edge_deg", projection.get("left_edge_deg", -180.0), -360.0, 360.0)


def corner_coordinates(vertices_m: np.ndarray, facets: np.ndarray, left_edge_deg: float) -> np.ndarray:
    """Texture coordinates (F, 3, 2) float32 of facets' corners on a map of planetocentric places, east to the right.

    A facet across the map's edge goes on beyond it, where the map repeats; at a pole a corner has the mean longitude
    of the others.

    Parameters
    ----------
    vertices_m : (V, 3) float64 [m]
        Body-fixed, about the centre of the map's longitudes and latitudes; +z is north.
    facets : (F, 3) int
    left_edge_deg : float [deg]
        Longitude of the left edge, east of +x.
    """
    x, y, z = vertices_m.T
    aside = np.hypot(x, y)
    turn = ((np.degrees(np.arctan2(y, x)) - left_edge_deg) / 360.0)[facets]
    is_pole = (aside <= _POLE * np.hypot(aside, z))[facets]
    known = np.take_along_axis(turn, np.argmin(is_pole, axis=1)[:, None], axis=1)
    turn += np.round(known - turn) - np.floor(known)
    others = np.where(is_pole, 0.0, turn).sum(axis=1) / np.maximum((~is_pole).sum(axis=1), 1)
    height = 0.5 + np.degrees(np.arctan2(z, aside))[facets] / 180.0
    return np.stack([np.where(is_pole, others[:, None], turn), height], axis=-1).astype(np.float32)
