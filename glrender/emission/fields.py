"""Weights K = k r^2 [m] of a coma as tables that a GPU reads, and the same interpolation in float64.

K rather than k is interpolated: trilinear k of a 1/r^2 coma is 5 % too large 1.5 cells from the origin.
Linear interpolation lies between its nodes, so no density is negative.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..base.errors import ConfigError

# Their values fit a processor's cache: 2.5 times faster than all at once.
_PLACES_AT_ONCE = 4096


@dataclass(frozen=True, kw_only=True, eq=False)
class SphericalField:
    """K by direction (an octahedral map) and logarithm of distance: the same detail at all distances.

    Parameters
    ----------
    values_m : (n_r, n, n) or (n_r, n, n, F) float32 [m]
        Node (k, j, i) is at `nodes(...)`; F fields that differ in nothing else.
    inner_m : float [m]
        Distance of shell 0; nearer, K is that of shell 0.
    shells_per_octave : float
    is_cut : bool
        Whether there is nothing beyond the last shell; otherwise K goes on as it is there.
    least_m : float [m]
        Distance below which all is inside the body.
    """

    values_m: np.ndarray
    inner_m: float
    shells_per_octave: float
    is_cut: bool
    least_m: float

    @property
    def outer_m(self) -> float:
        """Distance [m] of the last shell."""
        return self.inner_m * 2.0 ** ((len(self.values_m) - 1) / self.shells_per_octave)

    @property
    def radius_m(self) -> float:
        """Distance [m] beyond which there is nothing."""
        return self.outer_m if self.is_cut else math.inf

    def texels(self) -> np.ndarray:
        """(n_r, n + 2, n + 2) float32 with the map's neighbours across its edges."""
        n = self.values_m.shape[1]
        padded = np.empty((len(self.values_m), n + 2, n + 2, *self.values_m.shape[3:]), np.float32)
        padded[:, 1:-1, 1:-1] = self.values_m
        # Half of each edge of the octahedral map is glued to its other half.
        padded[:, 0, 1:-1], padded[:, -1, 1:-1] = self.values_m[:, 0, ::-1], self.values_m[:, -1, ::-1]
        padded[:, 1:-1, 0], padded[:, 1:-1, -1] = self.values_m[:, ::-1, 0], self.values_m[:, ::-1, -1]
        padded[:, 0, 0], padded[:, -1, -1] = self.values_m[:, -1, -1], self.values_m[:, 0, 0]
        padded[:, 0, -1], padded[:, -1, 0] = self.values_m[:, -1, 0], self.values_m[:, 0, -1]
        return padded

    @property
    def texel_counts(self) -> tuple[int, int, int]:
        """The texture's size, x first."""
        n_r, n, _ = self.values_m.shape
        return n + 2, n + 2, n_r

    @cached_property
    def _padded(self) -> np.ndarray:
        return self.texels()

    def weight(self, r_m: np.ndarray) -> np.ndarray:
        """K (...) float64 [m] at points (..., 3) [m]; (..., F) of F fields."""
        distance = np.maximum(np.linalg.norm(r_m, axis=-1), 1e-9 * self.inner_m)
        n_r, n = self.values_m.shape[:2]
        shell = np.clip(np.log2(distance / self.inner_m) * self.shells_per_octave, 0.0, n_r - 1.0)
        place = octahedral_from_direction(r_m) * n + 0.5
        value = trilinear(self._padded, np.stack([shell, place[..., 1], place[..., 0]], axis=-1))
        is_within = distance <= self.radius_m
        return np.where(is_within.reshape(is_within.shape + (1,) * (value.ndim - is_within.ndim)), value, 0.0)

    def span(self, closest_m: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances [m] along rays, from their point closest to the origin, where the field begins and ends."""
        half_squared = self.radius_m**2 - np.sum(closest_m**2, axis=-1)
        half = np.sqrt(np.maximum(half_squared, 0.0))
        return -half, half


@dataclass(frozen=True, kw_only=True, eq=False)
class CartesianField:
    """K in cells of a box.

    Parameters
    ----------
    values_m : (n_x, n_y, n_z) float32 [m]
        At the middles of the cells.
    low_m, high_m : (3,) float64 [m]
        Corners of the box, from the body's origin.
    least_m : float [m]
        Distance below which all is inside the body.
    """

    values_m: np.ndarray
    low_m: np.ndarray
    high_m: np.ndarray
    least_m: float

    def __post_init__(self):
        if not (self.high_m > self.low_m).all():
            raise ConfigError("high_m", "must be above low_m", self.high_m.tolist())

    @property
    def cell_m(self) -> np.ndarray:
        """(3,) float64 [m] sides of a cell."""
        return (self.high_m - self.low_m) / self.values_m.shape

    @property
    def texel_counts(self) -> tuple[int, int, int]:
        """The texture's size, x first."""
        return self.values_m.shape

    def texels(self) -> np.ndarray:
        """(n_z, n_y, n_x) float32: x varies fastest, as a texture has it."""
        return np.ascontiguousarray(self.values_m.transpose(2, 1, 0))

    def weight(self, r_m: np.ndarray) -> np.ndarray:
        """K (...) float64 [m] at points (..., 3) [m]."""
        value = trilinear(self.values_m, (r_m - self.low_m) / self.cell_m - 0.5)
        return np.where(((r_m >= self.low_m) & (r_m <= self.high_m)).all(axis=-1), value, 0.0)

    def span(self, closest_m: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances [m] along rays, from their point closest to the origin, where the box begins and ends."""
        # A component of 0 would make 0 / 0 on a face: 1e-30 puts both faces at infinity.
        safe = np.where(np.abs(direction) < 1e-30, 1e-30, direction)
        a, b = (self.low_m - closest_m) / safe, (self.high_m - closest_m) / safe
        enter, leave = np.minimum(a, b).max(axis=-1), np.maximum(a, b).min(axis=-1)
        return enter, np.maximum(leave, enter)

    def cropped(self) -> CartesianField:
        """Without the empty cells around: a ray then skips them."""
        occupied = np.argwhere(self.values_m > 0.0)
        if not len(occupied):
            raise ConfigError("grid", "must hold some dust: all of its cells are 0")
        first = np.maximum(occupied.min(axis=0) - 1, 0)
        last = np.minimum(occupied.max(axis=0) + 2, self.values_m.shape)
        return CartesianField(values_m=self.values_m[tuple(slice(*x) for x in zip(first, last, strict=True))],
                              low_m=self.low_m + first * self.cell_m, high_m=self.low_m + last * self.cell_m,
                              least_m=self.least_m)


Field = SphericalField | CartesianField


def octahedral_from_direction(direction: np.ndarray) -> np.ndarray:
    """(..., 2) in 0..1 of the octahedral map, of vectors (..., 3) of any length > 0."""
    unit = direction / np.maximum(np.abs(direction).sum(axis=-1, keepdims=True), np.finfo(float).tiny)
    x, y, z = unit[..., 0], unit[..., 1], unit[..., 2]
    folded_x, folded_y = (1.0 - np.abs(y)) * np.where(x < 0, -1.0, 1.0), (1.0 - np.abs(x)) * np.where(y < 0, -1.0, 1.0)
    return 0.5 + 0.5 * np.stack([np.where(z < 0, folded_x, x), np.where(z < 0, folded_y, y)], axis=-1)


def direction_from_octahedral(place: np.ndarray) -> np.ndarray:
    """Unit vectors (..., 3) of places (..., 2) in 0..1 of the octahedral map."""
    x, y = np.moveaxis(2.0 * np.asarray(place) - 1.0, -1, 0)
    z = 1.0 - np.abs(x) - np.abs(y)
    folded = np.maximum(-z, 0.0)
    direction = np.stack([x - np.where(x < 0, -folded, folded), y - np.where(y < 0, -folded, folded), z], axis=-1)
    return direction / np.linalg.norm(direction, axis=-1, keepdims=True)


def spherical_nodes(n_r: int, n: int, inner_m: float, shells_per_octave: float) -> np.ndarray:
    """(n_r, n, n, 3) float64 [m] points of a SphericalField's nodes."""
    middle = (np.arange(n) + 0.5) / n
    direction = direction_from_octahedral(np.stack(np.meshgrid(middle, middle, indexing="xy"), axis=-1))
    distance = inner_m * 2.0 ** (np.arange(n_r) / shells_per_octave)
    return distance[:, None, None, None] * direction


def trilinear(values: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Values (..., *others) float64 between nodes of (a, b, c, *others) at places (..., 3) in nodes.

    Beyond the edge they are the edge's.
    """
    size = np.array(values.shape[:3])
    stride = np.array([size[1] * size[2], size[2], 1])
    to_next = np.where(size > 1, stride, 0)
    flat = np.ascontiguousarray(values).reshape(-1, *values.shape[3:])
    places, result = place.reshape(-1, 3), np.empty((place.size // 3, *values.shape[3:]))
    for start in range(0, len(places), _PLACES_AT_ONCE):
        here = np.clip(places[start:start + _PLACES_AT_ONCE], 0.0, size - 1.0)
        first = np.minimum(here.astype(np.int64), np.maximum(size - 2, 0))
        part, base, total = here - first, first @ stride, 0.0
        for corner in np.ndindex(2, 2, 2):
            x, y, z = (part[:, k] if corner[k] else 1.0 - part[:, k] for k in range(3))
            share = (x * y * z).reshape(-1, *(1,) * (flat.ndim - 1))
            total = total + share * flat.take(base + to_next @ corner, axis=0)
        result[start:start + _PLACES_AT_ONCE] = total
    return result.reshape(*place.shape[:-1], *values.shape[3:])
