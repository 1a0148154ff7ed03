"""Intersections of rays and triangles, in float64."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

# Of the distance of a triangle's farthest corner, how far outside an edge a ray may pass: what float64 leaves of places
# and of unit vectors. A ray that is aimed at a corner meets it.
_ROUNDING = 4.0 * np.finfo(float).eps


def intersect(corners: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """(N, K) distances of rays (N, 3) from the origin to both sides of triangles (K, 3, 3); infinite beside them."""
    return distances([corners[:, k].T[:, None] for k in range(3)], rays.T[:, :, None])


def distances(corners: Sequence[np.ndarray], rays: np.ndarray) -> np.ndarray:
    """Distances (...) of unit rays (3, ...) from the origin to triangles of three corners (3, ...), or infinity.

    Triangles that share corners leave no gap: across the ray, corners have the same places for all of them.

    Source: Woop, Benthin and Wald (2013), Watertight ray/triangle intersection.
    """
    right, down = _across(*rays)
    (ax, bx, cx), (ay, by, cy), (az, bz, cz) = (
        [corner[0] * axis[0] + corner[1] * axis[1] + corner[2] * axis[2] for corner in corners]
        for axis in (right, down, rays))
    u, v, w = bx * cy - cx * by, cx * ay - ax * cy, ax * by - bx * ay
    area = u + v + w
    low_x, high_x, low_y, high_y, low_z, high_z = (
        pick(pick(a, b), c) for a, b, c in ((ax, bx, cx), (ay, by, cy), (az, bz, cz))
        for pick in (np.minimum, np.maximum))
    # A side is no longer than the box across the ray; nor is what is beside the box on a side.
    far = _ROUNDING * np.maximum.reduce([np.abs(each) for each in (low_x, high_x, low_y, high_y, low_z, high_z)])
    least = far * (high_x - low_x + high_y - low_y)
    turned = np.copysign(1.0, area)
    inside = (np.minimum(np.minimum(turned * u, turned * v), turned * w) >= -least) & (area != 0.0)
    inside &= (low_x <= far) & (high_x >= -far) & (low_y <= far) & (high_y >= -far)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = az + (v * (bz - az) + w * (cz - az)) / area
    # Of one that is seen edge-on the quotient is noise: it is between its corners all the same.
    t = np.clip(t, low_z, high_z)
    return np.where(inside & (t > 0.0), t, np.inf)


def _across(u: np.ndarray, v: np.ndarray, w: np.ndarray) -> tuple[tuple, tuple]:
    """Two unit vectors across others (...): Duff and others (2017), Building an orthonormal basis, revisited."""
    sign = np.copysign(1.0, w)
    a = -1.0 / (sign + w)
    b = u * v * a
    return (1.0 + sign * u * u * a, sign * b, -sign * u), (b, sign + v * v * a, -v)
