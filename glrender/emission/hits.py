"""Where parallel rays meet a body: by Embree where it is installed, else by NumPy."""

from __future__ import annotations

import numpy as np

from ..base.errors import DeviceError
from ..engines.rays.mesh import RayMesh
from ..scene.shape.ray_triangle import intersect
from ..scene.shape.shape import Shape
from .measuring import Hits


def body_hits(shape: Shape) -> Hits:
    """Distances along rays at which they first meet a shape."""
    try:
        mesh = RayMesh(shape.vertices_m, shape.facets)
    except DeviceError:
        corners = shape.vertices_m[shape.facets]
        return lambda place_m, direction: first_hits(place_m, direction, corners)
    back = 4.0 * mesh.radius_m

    def hits(place_m: np.ndarray, direction: np.ndarray) -> np.ndarray:
        return mesh.hit(place_m - back * direction, direction)[1] - back

    return hits


def first_hits(place_m: np.ndarray, direction: np.ndarray, corners_m: np.ndarray) -> np.ndarray:
    """Where rays (N, 3), from far before places (N, 3) [m], first meet facets (F, 3, 3) [m]: (N,) [m] or infinity."""
    back = 4.0 * float(np.linalg.norm(corners_m, axis=-1).max())
    return np.array([intersect(corners_m - (place - back * ray), ray[None]).min() - back
                     for place, ray in zip(place_m, direction, strict=True)])
