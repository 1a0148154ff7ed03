"""Sides, areas and vertices of facets, for meshes of millions."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from itertools import accumulate

import numpy as np


def area_vectors(vertices: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Vectors (F, 3) across facets (F, 3) between vertices (V, 3), outwards, twice as long as their areas."""
    # By columns: rows of three cost several times as much.
    corners = np.ascontiguousarray(facets.T, np.intp)
    sides = []
    for axis in vertices.T:
        a, b, c = np.ascontiguousarray(axis).take(corners)
        sides.append((b - a, c - a))
    found = np.empty(facets.shape)
    for k in range(3):
        (u, v), (w, x) = sides[(k + 1) % 3], sides[(k + 2) % 3]
        found[:, k] = u * x - w * v
    return found


def longest_sides(vertices: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Longest sides (F,) of facets (F, 3) between vertices (V, 3)."""
    a, b, c = (vertices.take(corner, axis=0) for corner in facets.T)
    return np.sqrt(np.maximum.reduce([np.einsum("fx,fx->f", side, side) for side in (b - a, c - b, a - c)]))


class FacetSizes:
    """Sizes of the facets (F, 3) of a mesh between vertices (V, 3), worked out once for all who ask.

    Attributes
    ----------
    vectors : (F, 3) float64
        As `area_vectors` has them.
    twice_areas, longest_sides : (F,) float64
    normals : (F, 3) float64
        Outward unit vectors.
    """

    def __init__(self, vertices: np.ndarray, facets: np.ndarray):
        self._mesh = vertices, facets

    @cached_property
    def vectors(self) -> np.ndarray:
        return area_vectors(*self._mesh)

    @cached_property
    def twice_areas(self) -> np.ndarray:
        return np.linalg.norm(self.vectors, axis=1)

    @cached_property
    def normals(self) -> np.ndarray:
        return self.vectors / self.twice_areas[:, None]

    @cached_property
    def longest_sides(self) -> np.ndarray:
        return longest_sides(*self._mesh)


def renumbered(facets: np.ndarray, n_vertices: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (N,) that facets (F, 3) use, in their order, and the facets by their numbers among them."""
    is_used = np.zeros(n_vertices, bool)
    is_used[facets] = True
    return np.flatnonzero(is_used), (np.cumsum(is_used) - 1)[facets]


def joined(meshes: Iterable[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) and facets (F, 3) of one mesh or more, each of which has vertices and facets, in one."""
    vertices, facets = zip(*meshes, strict=True)
    begins = accumulate(map(len, vertices[:-1]), initial=0)
    return np.concatenate(vertices), np.concatenate([own + begin for own, begin in zip(facets, begins, strict=True)])


def counted(counts: np.ndarray) -> np.ndarray:
    """0, 1, ... of each of some counts (N,), one after the other."""
    return np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
