"""Where rays meet triangles, in float64."""

from __future__ import annotations

import numpy as np

# Of the distance of a triangle's farthest corner, how far outside an edge a ray may pass: what float64 leaves of places
# and of unit vectors. A ray that is aimed at a corner meets it.
_ROUNDING = 4.0 * np.finfo(float).eps


def intersect(corners: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """(N, K) distances of rays (N, 3) from the origin to triangles (K, 3, 3); infinite beside them. Both sides count."""
    return distances(corners[None], rays[:, None])


def distances(corners: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Distances (...) of unit rays (..., 3) from the origin to triangles (..., 3, 3), or infinity: one to one.

    Triangles that share corners leave no gap: across the ray, corners have the same places for all of them.

    Source: Woop, Benthin and Wald (2013), Watertight ray/triangle intersection.
    """
    right, down = _across(rays)
    x, y, z = (_dot(corners, axis[..., None, :]) for axis in (right, down, rays))
    side_x, side_y = (np.roll(place, -2, axis=-1) - np.roll(place, -1, axis=-1) for place in (x, y))
    # Twice the areas between the ray and each side, opposite of corners 0, 1, 2; and how far off it is the line.
    part = np.stack([x[..., 1] * y[..., 2] - x[..., 2] * y[..., 1], x[..., 2] * y[..., 0] - x[..., 0] * y[..., 2],
                     x[..., 0] * y[..., 1] - x[..., 1] * y[..., 0]], axis=-1)
    farthest = np.sqrt((corners * corners).sum(axis=-1).max(axis=-1))[..., None]
    least = _ROUNDING * farthest * np.hypot(side_x, side_y)
    area = part.sum(axis=-1)
    inside = (part >= -least).all(axis=-1) & (area > 0.0) | (part <= least).all(axis=-1) & (area < 0.0)
    # Beside a far end of a long side the line is not the side.
    reach = _ROUNDING * farthest
    for place in (x, y):
        inside &= ((place >= -reach).any(axis=-1)) & ((place <= reach).any(axis=-1))
    with np.errstate(divide="ignore", invalid="ignore"):
        t = z[..., 0] + (part[..., 1] * (z[..., 1] - z[..., 0]) + part[..., 2] * (z[..., 2] - z[..., 0])) / area
    # Of one that is seen edge-on the quotient is noise: it is between its corners all the same.
    t = np.clip(t, z.min(axis=-1), z.max(axis=-1))
    return np.where(inside & (t > 0.0), t, np.inf)


def _across(rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors (..., 3) across each of some: Duff and others (2017), Building an orthonormal basis, revisited."""
    u, v, w = np.moveaxis(rays, -1, 0)
    sign = np.copysign(1.0, w)
    a = -1.0 / (sign + w)
    b = u * v * a
    return (np.stack([1.0 + sign * u * u * a, sign * b, -sign * u], axis=-1),
            np.stack([b, sign + v * v * a, -v], axis=-1))


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar products; always in one order, for what two triangles share to be the same for both."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]
