"""Where rays meet triangles, in float64."""

from __future__ import annotations

import numpy as np

# A ray may pass this far outside a facet's edge, in its own barycentric coordinates: none slips between two.
_EDGE_TOLERANCE = 1e-12


def intersect(corners: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """(N, K) distances of rays (N, 3) from the origin to triangles (K, 3, 3); infinite beside them.

    Source: Moeller and Trumbore (1997), both sides of a facet.
    """
    a, edge1, edge2 = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(edge1, edge2)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / (rays @ normal.T)
        # Scalar triple products with the origin as the rays' start.
        u = (rays @ np.cross(edge2, a).T) * inverse
        v = (rays @ np.cross(a, edge1).T) * inverse
        t = np.einsum("ij,ij->i", a, normal) * inverse
        inside = (u >= -_EDGE_TOLERANCE) & (v >= -_EDGE_TOLERANCE) & (u + v <= 1.0 + _EDGE_TOLERANCE) & (t > 0.0)
    return np.where(inside, t, np.inf)
