"""The edges of a mesh, and the sides of facets that run along each."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from .facet_geometry import counted


class Edges:
    """Edges of facets (F, 3), each passed by sides of facets, of which those of a facet follow each other.

    Attributes
    ----------
    start, end : (3 F,) int
        Vertices of the sides.
    order, begin, size : (3 F,), (E,), (E,) int
        Sides sorted by their edges, where each edge's begin among them, and how many it has.
    """

    def __init__(self, facets: np.ndarray):
        # Keys of edges need more than int32 has.
        facets = facets.astype(np.int64, copy=False)
        self.start, self.end = facets.ravel(), np.roll(facets, -1, axis=1).ravel()
        key = np.minimum(self.start, self.end) * (facets.max(initial=0) + 1) + np.maximum(self.start, self.end)
        self.order = np.argsort(key, kind="stable")
        key = key[self.order]
        self.begin = np.flatnonzero(np.concatenate([[True], key[1:] != key[:-1]]))
        self.size = np.diff(np.append(self.begin, len(key)))

    def of_sides(self) -> np.ndarray:
        """Number (3 F,) of each side's edge."""
        edge = np.empty(len(self.order), np.int64)
        edge[self.order] = np.repeat(np.arange(len(self.size)), self.size)
        return edge

    def sides(self, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Sides (N,) of edges that are chosen (E,), and the edges (N,)."""
        edge = np.repeat(np.flatnonzero(chosen), self.size[chosen])
        return self.order[self.begin[edge] + counted(self.size[chosen])], edge

    def pairs(self) -> tuple[np.ndarray, np.ndarray]:
        """The two sides (N,), (N,) of each edge that has two."""
        first = self.begin[self.size == 2]
        return self.order[first], self.order[first + 1]


def connected(a: np.ndarray, b: np.ndarray, count: int) -> tuple[int, np.ndarray]:
    """Groups of things that pairs (N,), (N,) of their numbers connect: how many, and the number (count,) of each's."""
    pairs = coo_array((np.ones(len(a), bool), (a, b)), shape=(count, count))
    n_groups, group = connected_components(pairs, directed=False)
    return int(n_groups), group
