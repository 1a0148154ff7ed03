"""The line integral in float64: columns of dust along rays, by any number of steps. Twin of `shaders/coma_march`.

Along a ray, s is the distance from its point closest to the origin, at distance rho. With s = a tan(theta),
a = rho, the column of k = K / r^2 is

    integral k ds = 1/a integral K dtheta

so equal steps of the angle theta are exact for an even coma, however near the nucleus, and see each jet at the
same resolution. Within `least_m` of the origin, where only the body is, a stays at `least_m`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .fields import Field


def columns(field: Field, r_camera_m: np.ndarray, directions: np.ndarray, steps: int,
            end_m: np.ndarray | float = np.inf, lit: Callable[[np.ndarray], np.ndarray] | None = None) -> np.ndarray:
    """Columns of dust, cross-section over area.

    Parameters
    ----------
    field : Field, or anything with its `weight`, `span` and `least_m`
    r_camera_m : (3,) float64 [m]
        In the field's frame, from the body's origin.
    directions : (N, 3) float64 [1]
        Unit vectors away from the camera.
    steps : int
    end_m : (N,) float64 [m]
        Distance from the camera at which a surface ends the ray.
    lit : callable, optional
        (N, 3) points [m] to (N,) share of sunlight: the body's shadow.

    Returns
    -------
    (N,) float64 [1]
    """
    along, closest, a = ray_geometry(field, r_camera_m, directions)
    low, high = angles(field, closest, directions, a, along, end_m)
    width = (high - low) / steps
    total, last = np.zeros(len(directions)), None
    for k in range(steps):
        s = a * np.tan(low + (k + 0.5) * width)
        r = closest + s[:, None] * directions
        squared = np.sum(closest**2, axis=1) + s**2
        value = field.weight(r) * (a**2 + s**2) / np.maximum(squared, a**2)
        if lit is not None:
            # A step is in the shadow as its middle is: where the edge is between two, the wrong part is corrected.
            is_lit, bare = lit(r) > 0.5, value
            value = bare * is_lit
            if last is not None and (at := np.flatnonzero(is_lit != last[0])).size:
                rays = (each[at] for each in (closest, directions, a, low + k * width, width, last[0]))
                beyond = _edges(lit, *rays)
                # K is linear there, and a sum of middles that ends there lacks K' / 24.
                rise, k_border = (bare - last[1])[at], 0.5 * (bare + last[1])[at]
                total[at] += np.where(last[0][at], 1.0, -1.0) * (
                    k_border * beyond + rise * (0.5 * beyond**2 + 1.0 / 24.0))
            last = is_lit, bare
        total += value
    return total * width / a


def _edges(lit: Callable[[np.ndarray], np.ndarray], closest: np.ndarray, directions: np.ndarray, a: np.ndarray,
           border: np.ndarray, width: np.ndarray, is_low_lit: np.ndarray) -> np.ndarray:
    """The ends of shadows (N,), in steps of a width [rad] from the border of two, are found to a 32nd of one."""
    low, high = np.full(len(a), -0.5), np.full(len(a), 0.5)
    for _ in range(4):
        middle = 0.5 * (low + high)
        s = a * np.tan(border + middle * width)
        is_like_low = (lit(closest + s[:, None] * directions) > 0.5) == is_low_lit
        low, high = np.where(is_like_low, middle, low), np.where(is_like_low, high, middle)
    return 0.5 * (low + high)


def ray_geometry(field: Field, r_camera_m: np.ndarray,
                 directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rays are given by the camera's s (N,), the point closest to the origin (N, 3), and a (N,), all [m]."""
    along = directions @ r_camera_m
    closest = r_camera_m - along[:, None] * directions
    return along, closest, np.maximum(np.linalg.norm(closest, axis=1), field.least_m)


def angles(field: Field, closest: np.ndarray, directions: np.ndarray, a: np.ndarray, along: np.ndarray,
           end_m: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    """Angles theta [rad] at which the dust along a ray begins and ends; equal where there is none."""
    enter, leave = field.span(closest, directions)
    enter = np.maximum(enter, along)
    leave = np.maximum(np.minimum(leave, along + end_m), enter)
    return np.arctan(enter / a), np.arctan(leave / a)
