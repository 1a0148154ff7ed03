"""Where parallel rays meet a body: by Embree where it is installed, else by NumPy on a coarse shape."""

from __future__ import annotations

import numpy as np

from ..errors import DeviceError
from ..lod import levels_of_detail
from ..rays import RayMesh
from ..shape import Shape
from .measuring import Hits


def body_hits(shape: Shape) -> Hits:
    """Distances along rays at which they first meet a shape."""
    try:
        mesh = RayMesh(shape.vertices_m, shape.facets)
    except DeviceError:
        coarse = next(iter(levels_of_detail(shape)[-1:]), shape)
        corners = coarse.vertices_m[coarse.facets]
        return lambda place_m, direction: first_hits(place_m, direction, corners)
    back = 4.0 * mesh.radius_m

    def hits(place_m: np.ndarray, direction: np.ndarray) -> np.ndarray:
        return mesh.hit(place_m - back * direction, direction)[1] - back

    return hits


def first_hits(place_m: np.ndarray, direction: np.ndarray, corners_m: np.ndarray) -> np.ndarray:
    """Where rays (N, 3), from far before places (N, 3) [m], first meet facets (F, 3, 3) [m]: (N,) [m] or infinity.

    Source: Moeller and Trumbore (1997).
    """
    a, u, v = corners_m[:, 0], corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0]
    nearest = np.full(len(place_m), np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        for index, (place, ray) in enumerate(zip(place_m, direction, strict=True)):
            p, offset = np.cross(ray, v), place - a
            determinant = np.einsum("ij,ij->i", u, p)
            first = np.einsum("ij,ij->i", offset, p) / determinant
            q = np.cross(offset, u)
            second = q @ ray / determinant
            hit = (first >= 0.0) & (second >= 0.0) & (first + second <= 1.0)
            if hit.any():
                nearest[index] = (np.einsum("ij,ij->i", v, q) / determinant)[hit].min()
    return nearest
