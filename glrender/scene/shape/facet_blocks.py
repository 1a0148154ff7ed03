"""Boxes around runs of facets, by which the facets near a place are found without a look at each."""

from __future__ import annotations

import numpy as np

# Facets of a run: 100,000 boxes hold those of a large shape, and a run of a terrain's row is not long.
_RUN = 64
# Runs that are looked at first.
_NEAREST = 8
# Runs at once, of some 70 bytes a corner.
_RUNS_AT_ONCE = 1 << 10


class FacetBlocks:
    """A surface's facets in runs, in the order that they have.

    Parameters
    ----------
    vertices_m : (V, 3) float64 [m]
    facets : (F, 3) int
    """

    def __init__(self, vertices_m: np.ndarray, facets: np.ndarray):
        self._vertices_m, self._facets = vertices_m, facets
        low_m, high_m = [], []
        for first in range(0, len(facets), _RUN * _RUNS_AT_ONCE):
            corners = vertices_m.take(facets[first:first + _RUN * _RUNS_AT_ONCE].ravel(), axis=0)
            start = np.arange(0, len(corners), 3 * _RUN)
            low_m.append(np.minimum.reduceat(corners, start, axis=0))
            high_m.append(np.maximum.reduceat(corners, start, axis=0))
        self._low_m, self._high_m = np.concatenate(low_m), np.concatenate(high_m)

    @property
    def memory_bytes(self) -> int:
        """Memory [byte] of the boxes."""
        return self._low_m.nbytes + self._high_m.nbytes

    def distance_m(self, point_m: np.ndarray) -> float:
        """Distance [m] from a point (3,) to the nearest point of any facet."""
        to_box, best_m = self._to_boxes_m(point_m), np.inf
        order, first, count = np.argsort(to_box, kind="stable"), 0, _NEAREST
        # The nearest boxes first, as a run from a row's end to the next one's start has a box as long as a row.
        while first < len(order) and to_box[order[first]] < best_m:
            best_m = min(best_m, float(self._distances_m(order[first:first + count], point_m)[1].min()))
            first, count = first + count, 2 * count
        return best_m

    def within(self, point_m: np.ndarray, reach_m: float) -> tuple[np.ndarray, np.ndarray]:
        """Facets (N,) int, in their order, that have a point within a reach of a point (3,), and distances (N,) [m]."""
        facet, distance_m = self._distances_m(np.flatnonzero(self._to_boxes_m(point_m) <= reach_m), point_m)
        near = np.flatnonzero(distance_m <= reach_m)
        return facet.take(near), distance_m.take(near)

    def _to_boxes_m(self, point_m: np.ndarray) -> np.ndarray:
        beside = np.maximum(np.maximum(self._low_m - point_m, point_m - self._high_m), 0.0)
        return np.sqrt(np.einsum("bx,bx->b", beside, beside))

    def _distances_m(self, run: np.ndarray, point_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Facets (N,) of runs, and their distances (N,) [m] from a point."""
        facet = (run[:, None] * _RUN + np.arange(_RUN)).ravel()
        facet = facet[facet < len(self._facets)]
        return facet, facet_distances_m(self._vertices_m[self._facets[facet]], point_m)


def facet_distances_m(corners_m: np.ndarray, point_m: np.ndarray) -> np.ndarray:
    """Distances (N,) [m] from a point (3,) to the nearest points of facets with corners (N, 3, 3)."""
    a, u, v = corners_m[:, 0], corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0]
    w = point_m - a
    uu, uv, vv = (np.einsum("ij,ij->i", *pair) for pair in ((u, u), (u, v), (v, v)))
    wu, wv = np.einsum("ij,ij->i", w, u), np.einsum("ij,ij->i", w, v)
    determinant = np.maximum(uu * vv - uv * uv, np.finfo(float).tiny)
    s, t = (vv * wu - uv * wv) / determinant, (uu * wv - uv * wu) / determinant
    inside = (s >= 0.0) & (t >= 0.0) & (s + t <= 1.0)
    found = np.where(inside, np.linalg.norm(w - s[:, None] * u - t[:, None] * v, axis=1), np.inf)
    for start, direction in ((w, u), (w, v), (w - u, v - u)):
        along = np.einsum("ij,ij->i", start, direction) / np.einsum("ij,ij->i", direction, direction)
        beside = start - np.clip(along, 0.0, 1.0)[:, None] * direction
        found = np.minimum(found, np.linalg.norm(beside, axis=1))
    return found
