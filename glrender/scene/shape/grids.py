"""Triangles between posts of grids: of one, of squares around one another without cracks, of a cube's faces."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from glrender_camera.validate import positive, vector

from ...base.errors import ShapeError

WHOLE_FACETS = 1_000_000
"""Facets of a whole map, unless others are asked for."""
# Rings, and posts of half a square's side, at most.
_MOST_RINGS, _MOST_POSTS = 32, 1e6
# Gap between a square and the one within over its posts [1], at least: the triangles between are no slivers.
_GAP = 0.5


def cells(number: np.ndarray) -> np.ndarray:
    """Facets (F, 3) of a grid of vertices' numbers, counter-clockwise where its second axis is left of the first."""
    a, b, c, d = (each.ravel() for each in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def n_facets_of(rings: Sequence[tuple[float, float]]) -> float:
    """Number of facets that `nested` makes of rings; infinite where it is beyond all bounds."""
    is_finite = max(out_m / posts_m for out_m, posts_m in rings) < _MOST_POSTS
    return sum(8 * (last**2 - first**2) for first, last in _sizes(rings)) if is_finite else math.inf


def checked_rings(rings: object, max_facets: int) -> list[tuple[float, float]]:
    """Rings as `nested` takes them, that grow outwards and make so many facets at most.

    Raises
    ------
    ConfigError, ShapeError
    """
    if not isinstance(rings, Sequence | np.ndarray) or isinstance(rings, str) or not 0 < len(rings) <= _MOST_RINGS:
        raise ShapeError("rings", f"must be 1 to {_MOST_RINGS} pairs [out to, posts], in metres", rings)
    made: list[tuple[float, float]] = []
    for index, ring in enumerate(rings):
        out_m, posts_m = (positive(f"rings[{index}]", each) for each in vector(f"rings[{index}]", ring, 2))
        if made and not (out_m > made[-1][0] and posts_m >= made[-1][1]):
            raise ShapeError(f"rings[{index}]", "must reach farther than the ring within, with posts no nearer", ring,
                             "begin with the innermost")
        made.append((out_m, posts_m))
    if (count := n_facets_of(made)) > max_facets:
        raise ShapeError("rings", f"must make at most {max_facets} facets", count,
                         "set posts farther apart, or end sooner")
    return made


def _sizes(rings: Sequence[tuple[float, float]]) -> list[tuple[int, int]]:
    """Posts from the middle to the first and to the last of each ring; the first begins at 0."""
    sizes, within_m = [], None
    for out_m, posts_m in rings:
        first = 0 if within_m is None else math.ceil(within_m / posts_m + _GAP)
        sizes.append((first, max(math.ceil(out_m / posts_m), first)))
        within_m = sizes[-1][1] * posts_m
    return sizes


def nested(rings: Sequence[tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Posts (2, N) [m] along two axes and facets (F, 3), counter-clockwise, of squares around one another.

    Parameters
    ----------
    rings : sequence of (float, float) [m]
        Half a square's side and the distance of its posts, from the innermost outwards.
    """
    places, facets, count, inner = [], [], 0, None
    for (_, posts_m), (first, last) in zip(rings, _sizes(rings), strict=True):
        x, y = np.meshgrid(*[np.arange(-last, last + 1)] * 2, indexing="ij")
        is_there = np.maximum(abs(x), abs(y)) >= first
        number = np.cumsum(is_there.ravel()).reshape(is_there.shape) + (count - 1)
        places.append(posts_m * np.stack([x[is_there], y[is_there]]))
        is_outside = np.maximum(*(abs(each[:-1, :-1] + 0.5) for each in (x, y))).ravel() > first
        facets.append(cells(number)[np.tile(is_outside, 2)])
        if inner is not None:
            middle = slice(last - first, last + first + 1)
            facets.append(_joined(inner, _rim(number[middle, middle])))
        count, inner = count + places[-1].shape[1], _rim(number)
    return np.concatenate(places, axis=1), np.concatenate(facets)


def _rim(number: np.ndarray) -> np.ndarray:
    """Numbers around a grid, counter-clockwise from its first."""
    return np.concatenate([number[:-1, 0], number[-1, :-1], number[:0:-1, -1], number[0, :0:-1]])


def _joined(inner: np.ndarray, outer: np.ndarray) -> np.ndarray:
    """Facets (F, 3) between the rims of two squares: each side of one with the other's vertex next to its middle."""
    n, m = len(inner), len(outer)
    i, j = np.arange(n), np.arange(m)
    beyond, within = ((2 * i + 1) * m + n - 1) // (2 * n), ((2 * j + 1) * n + m) // (2 * m)
    return np.concatenate([np.stack([inner[(i + 1) % n], inner, outer[beyond % m]], axis=1),
                           np.stack([outer, outer[(j + 1) % m], inner[within % n]], axis=1)])


def cube(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions (3, N) and facets (12 n^2, 3), outwards, of a cube's faces cut into n x n equal angles."""
    one, two = np.meshgrid(*[np.arange(n + 1)] * 2, indexing="ij")
    places, facets, number = [], [], np.arange(one.size).reshape(one.shape)
    for axis, side in np.ndindex(3, 2):
        places.append(np.roll(np.stack([np.full(one.size, side * n), one.ravel(), two.ravel()]), axis, axis=0))
        facets.append(cells(number + len(facets) * one.size)[:, ::2 * side - 1])
    # Faces share their edges.
    place, same = np.unique(np.concatenate(places, axis=1), axis=1, return_inverse=True)
    return np.tan(0.25 * np.pi * (2.0 * place / n - 1.0)), same.ravel()[np.concatenate(facets)]
