"""Errors of estimates that a shape's own error makes: heights that are off at random, alike nearby."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from glrender_camera.validate import finite
from scipy.spatial.distance import cdist

from ...base.errors import ConfigError

# Vertices within a cube of this share of the correlation length [1] have one height: it is the same to 1 %.
_CELL = 0.25
# Correlation lengths beyond which heights do not go together [1]: they are alike by 4e-6 there.
_REACH = 5.0
# Vertices whose distances from others are known at once: 64 MiB of 16,000 others.
_AT_ONCE = 512


def checked_shape_sigma(shape_sigma: object) -> tuple[float, float]:
    """The height and the correlation length [m] of a shape's error.

    Raises
    ------
    ConfigError
    """
    if isinstance(shape_sigma, (str, Mapping)) or not isinstance(shape_sigma, (Sequence, np.ndarray)) or len(
            shape_sigma) != 2:
        raise ConfigError("shape_sigma", "must be two lengths, of height and correlation [m]", shape_sigma,
                          "as (2.0, 30.0); leave it out where the shape is known")
    height_m, length_m = (finite(f"shape_sigma[{k}]", value) for k, value in enumerate(shape_sigma))
    if height_m < 0.0:
        raise ConfigError("shape_sigma[0]", "must be >= 0", height_m)
    if length_m <= 0.0:
        raise ConfigError("shape_sigma[1]", "must be > 0", length_m, "for heights without correlation a short length")
    return height_m, length_m


def shape_covariance(weights: np.ndarray, gradient: Callable[[np.ndarray], Any], vertices_m: Mapping[str, np.ndarray],
                     shape_sigma: tuple[float, float]) -> np.ndarray:
    """The covariance (K, K) of K weighted sums of pixels, by heights of bodies' vertices that are off at random.

    Heights along the vertex normals are normally distributed, with a correlation of exp(-d^2 / (2 l^2)) over a
    distance d, of each body on its own.

    Parameters
    ----------
    weights : (K, height, width) float64
    gradient : callable
        `Gradient` of a sum by its weights.
    vertices_m : mapping of str to (V, 3) array [m]
        By bodies.
    shape_sigma : (float, float) [m]
        Standard deviation of the heights, and correlation length l.
    """
    height_m, length_m = shape_sigma
    if not height_m:
        return np.zeros((len(weights), len(weights)))
    gradients = [gradient(each) for each in weights]
    return height_m**2 * sum(_correlated(np.array([each[name].heights_m for each in gradients]), r_m, length_m)
                             for name, r_m in vertices_m.items())


def _correlated(of_heights: np.ndarray, r_m: np.ndarray, length_m: float) -> np.ndarray:
    """Sums (K, K) of products of derivatives (K, V) by the heights of all pairs of vertices (V, 3), by correlation."""
    used = np.flatnonzero(of_heights.any(axis=0))
    if not len(used):
        return np.zeros((len(of_heights), len(of_heights)))
    r_m, of_heights = r_m[used], of_heights[:, used]
    cells, of_cell = np.unique(np.floor(r_m / (_CELL * length_m)), axis=0, return_inverse=True)
    count, reach = np.bincount(of_cell.ravel()), cells[:, 0]
    place, sums = ([np.bincount(of_cell.ravel(), each) for each in rows] for rows in (r_m.T, of_heights))
    place, sums = np.stack(place, axis=1) / count[:, None] / length_m, np.stack(sums)
    total = np.zeros((len(sums), len(sums)))
    for first in range(0, len(place), _AT_ONCE):
        part = slice(first, min(first + _AT_ONCE, len(place)))
        begin = np.searchsorted(reach, reach[part.start] - _REACH / _CELL)
        end = np.searchsorted(reach, reach[part.stop - 1] + _REACH / _CELL, side="right")
        alike = np.exp(-0.5 * cdist(place[part], place[begin:end], "sqeuclidean"))
        total += np.einsum("ip,jp->ij", sums[:, part], np.einsum("pq,jq->jp", alike, sums[:, begin:end]))
    return total
