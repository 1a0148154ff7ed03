"""How high a shape stands around each of its vertices: what no ray has to be asked for.

Horizon maps, of Max (1988), Horizon mapping: shadows for bump-mapped surfaces; at vertices here, and never lower than
the shape, so that they tell what is free for certain.
"""

from __future__ import annotations

import math

import numpy as np
from glrender_camera import threads

from .cache import cached_bytes
from .morton import morton_order
from .shape import Shape

# Of vertices that a thread looks at in a turn.
_PART = 1 << 12
# Most facets of a leaf.
_LEAF = 4


class Horizons:
    """The horizons of a shape's vertices; made once in 0.1 to 0.3 ms a vertex, and kept on disk.

    Parameters
    ----------
    shape : Shape
    """

    def __init__(self, shape: Shape):
        from . import horizon_loops

        self._loops = horizon_loops
        self._vertices_m = np.ascontiguousarray(shape.vertices_m.T)
        normals = np.zeros_like(self._vertices_m)
        for corner in shape.facets.T:
            for axis in range(3):
                normals[axis] += np.bincount(corner, shape.facet_normals[:, axis], len(shape.vertices_m))
        length = np.sqrt((normals * normals).sum(axis=0))
        self._normals = normals / np.where(length > 0.0, length, 1.0)
        self._table = cached_bytes(f"horizons3-{shape.content_hash}", (len(length), horizon_loops.N_AZIMUTHS),
                                   lambda: self._made(shape))
        # Of no facet, or of facets that face all ways.
        self._table[length == 0.0] = 255

    def are_open(self, vertices: np.ndarray, towards: np.ndarray, is_place: bool) -> np.ndarray:
        """Whether vertices (N,) see a direction or a place [m] (3,) in the body's frame for certain, (N,) bool."""
        is_open = np.zeros(len(vertices), bool)

        def look(part: slice) -> None:
            self._loops.find_open(self._vertices_m, self._normals, self._table, vertices[part], towards, is_place,
                                  is_open[part])

        threads.run_in_parts(look, len(vertices), _PART)
        return is_open

    def _made(self, shape: Shape) -> np.ndarray:
        nodes = tree(shape)
        n_vertices = len(shape.vertices_m)
        found = np.empty((n_vertices, self._loops.N_AZIMUTHS), np.uint8)

        def look(part: slice) -> None:
            self._loops.find_horizons(self._vertices_m, self._normals, *nodes, part.start, part.stop, found)

        threads.run_in_parts(look, n_vertices, _PART)
        return found


def tree(shape: Shape) -> tuple[np.ndarray, ...]:
    """A binary tree of boxes: node 1 is the root, 2 k and 2 k + 1 are in node k, and the L last ones are the leaves.

    Facets' corners (3, F) int in the order of leaves; the boxes' middles (3, N), half their sides (3, N) and diagonals
    (N,) [m]; and where each leaf's facets begin (L + 1,).
    """
    corners_m = shape.vertices_m[shape.facets]
    order = morton_order(corners_m.mean(axis=1))
    n_leaves = 1 << max(math.ceil(math.log2(len(order) / _LEAF)), 0)
    begins = np.arange(n_leaves + 1) * len(order) // n_leaves
    ends_m = [np.minimum.reduceat(corners_m[order].min(axis=1), begins[:-1]),
              np.maximum.reduceat(corners_m[order].max(axis=1), begins[:-1])]
    levels = [ends_m]
    while len(levels[-1][0]) > 1:
        levels.append([join(ends[::2], ends[1::2]) for join, ends in
                       zip((np.minimum, np.maximum), levels[-1], strict=True)])
    # There is no node 0.
    lows, highs = (np.concatenate([np.zeros((1, 3)), *(level[k] for level in reversed(levels))]) for k in range(2))
    halves = 0.5 * (highs - lows)
    return (np.ascontiguousarray(shape.facets[order].T, np.intp), np.ascontiguousarray((lows + halves).T),
            np.ascontiguousarray(halves.T), np.linalg.norm(halves, axis=1), begins)
