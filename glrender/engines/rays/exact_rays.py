"""Rays in float64 against a shape: laser ranges, and facets so near and so long that float32 is too coarse for them."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np

from ...base.morton import morton_order
from ...scene.shape.shape import Shape
from . import exact_loops

_FACETS_PER_LEAF = 4


class ExactMesh:
    """A shape's acceleration structure in float64, in metres: some times as slow as Embree's.

    Parameters
    ----------
    vertices_m : (V, 3) float64 [m]
    facets : (F, 3) int
    """

    def __init__(self, vertices_m: np.ndarray, facets: np.ndarray):
        corners = vertices_m[facets]
        self._order = morton_order(corners.mean(axis=1))
        corners = corners[self._order]
        self._corners = np.ascontiguousarray(corners.reshape(-1, 9))
        self._n_leaves = n = 1 << max(int(np.ceil(np.log2(len(facets) / _FACETS_PER_LEAF))), 0)
        first = np.arange(n) * len(facets) // n
        self._boxes = boxes = np.empty((2 * n, 6))
        boxes[n:, :3] = np.minimum.reduceat(corners.min(axis=1), first)
        boxes[n:, 3:] = np.maximum.reduceat(corners.max(axis=1), first)
        while n > 1:
            n //= 2
            left, right = boxes[2 * n:4 * n:2], boxes[2 * n + 1:4 * n:2]
            boxes[n:2 * n, :3] = np.minimum(left[:, :3], right[:, :3])
            boxes[n:2 * n, 3:] = np.maximum(left[:, 3:], right[:, 3:])

    def first(self, origin_m: np.ndarray, ray: np.ndarray, sides: int = exact_loops.ALL_SIDES
              ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rays (K,) of (3, N) from points (3, 1 or N) [m] that meet the shape, their facets, and distances [m]."""
        facet, distance_m = np.empty(ray.shape[1], np.intp), np.empty(ray.shape[1])
        exact_loops.find_first(self._boxes, self._corners, self._n_leaves, origin_m, ray, sides, facet, distance_m)
        place = np.flatnonzero(facet >= 0)
        return place, self._order.take(facet.take(place)), distance_m.take(place)

    def hit(self, origin_m: np.ndarray, ray: np.ndarray, sides: int = exact_loops.ALL_SIDES
            ) -> tuple[np.ndarray, np.ndarray]:
        """Facet (N,) or -1, and distance (N,) [m] or infinity, of rays (N, 3) from a point or points (3,), (N, 3)."""
        place, met, distance_m = self.first(np.transpose(origin_m).reshape(3, -1), ray.T, sides)
        facet, distance = np.full(len(ray), -1), np.full(len(ray), np.inf)
        facet[place], distance[place] = met, distance_m
        return facet, distance

    def are_blocked(self, start_m: np.ndarray, direction: np.ndarray, reach_m: np.ndarray,
                    sides: int = exact_loops.ALL_SIDES) -> np.ndarray:
        """Whether rays (3, 1 or N) from points (3, N) [m] meet the shape within a reach (1 or N,) [m]: (N,) bool."""
        found = np.empty(start_m.shape[1], bool)
        exact_loops.find_blocked(self._boxes, self._corners, self._n_leaves, start_m, direction, reach_m, sides,
                                 found)
        return found


def exact_mesh(shape: Shape) -> ExactMesh:
    """The float64 acceleration structure of a shape: made once, kept as long as the shape is."""
    if shape not in _kept:
        _kept[shape] = ExactMesh(shape.vertices_m, shape.facets)
    return _kept[shape]


_kept: WeakKeyDictionary[Shape, ExactMesh] = WeakKeyDictionary()
