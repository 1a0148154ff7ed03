"""Whether a closed surface bends outwards at each of its edges: a dip as small as a boulder casts a shadow."""

from __future__ import annotations

import numpy as np

from .edges import Edges, connected
from .facet_geometry import area_vectors

# Sine of the angle by which facets may rise above one another: the digits of a shape's file leave as much.
_LEAST_SINE = 2e-3


def bends_outwards(vertices_m: np.ndarray, facets: np.ndarray) -> bool:
    """Whether a surface (F, 3) between vertices (V, 3) [m] is one closed shell, and no facet rises above its neighbour.

    Volumes and areas do not show features far smaller than the body. Edges within 2e-3 rad of flat are not
    tested.
    """
    edges = Edges(facets)
    if (edges.size != 2).any():
        return False
    one, other = edges.pairs()
    if connected(one // 3, other // 3, len(facets))[0] > 1:
        return False
    normal = area_vectors(vertices_m, facets)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    # The corner across the edge, from the edge's begin: its height over the facet, and its distance from the edge.
    begin, along = vertices_m[edges.start[one]], vertices_m[edges.end[one]] - vertices_m[edges.start[one]]
    across = vertices_m[facets[other // 3, (other + 2) % 3]] - begin
    height = np.einsum("ij,ij->i", normal[one // 3], across)
    distance = np.linalg.norm(np.cross(along, across), axis=1) / np.linalg.norm(along, axis=1)
    return bool((height <= _LEAST_SINE * distance).all())
