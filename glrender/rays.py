"""Rays against a shape: Embree finds the facet in float32, the point is worked out again in float64.

Vectors stand in columns (3, N) here: NumPy then reads memory in order, several times as fast as rows.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from .errors import DeviceError

# Of the bounding sphere, in radii: what passes beyond meets nothing, and float32 has no room for a start far off.
_REACH = 1.01
# Float32 rays start no farther than this from where they pass the middle, in radii.
_NEARBY = 1.5


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar products (N,) of columns (3, N), or (3, 1) that broadcast."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@dataclass(frozen=True, kw_only=True, eq=False)
class Hits:
    """Where rays first meet a shape.

    Attributes
    ----------
    place : (K,) int
        Which of the rays.
    facet : (K,) int
    distance_m : (K,) float64 [m]
    ray, normal : (3, K) float64 [1]
        Unit vectors: of the rays, and outwards of the facets.
    """

    place: np.ndarray
    facet: np.ndarray
    distance_m: np.ndarray
    ray: np.ndarray
    normal: np.ndarray

    def at(self, chosen: np.ndarray) -> Hits:
        """Those of given numbers (M,)."""
        return Hits(**{field.name: getattr(self, field.name).take(chosen, axis=-1) for field in fields(self)})


class RayMesh:
    """A shape's acceleration structure, in units of its radius.

    Parameters
    ----------
    vertices_m : (V, 3) float64 [m]
    facets : (F, 3) int
        Counter-clockwise from outside.

    Raises
    ------
    DeviceError
        embreex is not installed.
    """

    def __init__(self, vertices_m: np.ndarray, facets: np.ndarray):
        try:
            from embreex import rtcore_scene
            from embreex.mesh_construction import TriangleMesh
        except ImportError as error:
            raise DeviceError("rays need embreex: pip install 'glrender[raytrace]'") from error
        self.facets = facets
        self.radius_m = float(np.linalg.norm(vertices_m, axis=1).max())
        corners = vertices_m[facets]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        self._corner, self._normal = (np.ascontiguousarray(rows.T) for rows in (corners[:, 0], normals))
        self._scene = rtcore_scene.EmbreeScene()
        TriangleMesh(self._scene, (corners / self.radius_m).astype(np.float32))
        # Embree builds its tree at the first call: here, before two threads could ask for it.
        self._scene.run(*np.zeros((2, 0, 3), np.float32))

    @property
    def normals(self) -> np.ndarray:
        """(F, 3) float64 outward unit normals of the facets."""
        return self._normal.T

    def hit(self, origin_m: np.ndarray, ray: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Facet (N,) or -1, and distance (N,) float64 [m] or infinity, of rays (N, 3) from a point or points."""
        hits = self.first(np.transpose(origin_m), ray.T)
        facet, distance = np.full(len(ray), -1), np.full(len(ray), np.inf)
        facet[hits.place], distance[hits.place] = hits.facet, hits.distance_m
        return facet, distance

    def first(self, origin_m: np.ndarray, ray: np.ndarray) -> Hits:
        """What rays (3, N) from a point (3,) [m], or from points (3, N), meet first."""
        origin_m = origin_m.reshape(3, -1)
        origin = origin_m / self.radius_m
        along = -dot(ray, origin)
        # On the bounding sphere, about, where the origin is beyond it.
        ahead = np.maximum(along - _NEARBY, 0.0)
        start = origin + ray * ahead
        near = np.flatnonzero((dot(start, start) - (along - ahead) ** 2 < _REACH**2) & (along > -_REACH))
        facet = self._scene.run(*(columns.take(near, axis=1).astype(np.float32).T for columns in (start, ray)))
        found = np.flatnonzero(facet >= 0)
        place, facet = near.take(found), facet.take(found).astype(np.intp)
        ray, normal = ray.take(place, axis=1), self._normal.take(facet, axis=1)
        from_m = origin_m if origin_m.shape[1] == 1 else origin_m.take(place, axis=1)
        distance_m = dot(self._corner.take(facet, axis=1) - from_m, normal) / dot(ray, normal)
        return Hits(place=place, facet=facet, distance_m=distance_m, ray=ray, normal=normal)

    def blocks(self, start_m: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Whether rays from points (N, 3) [m] towards one direction (3,), or one each (N, 3), meet the shape."""
        start, direction = start_m.T / self.radius_m, np.transpose(direction).reshape(3, -1)
        result = np.zeros(start.shape[1], bool)
        near = np.arange(len(result))
        if (dot(start, start) > _REACH**2).any():
            # Far sunward or beside the bounding sphere there is nothing to meet.
            along = dot(start, direction)
            beside = start - along * direction
            near = np.flatnonzero((dot(beside, beside) < _REACH**2) & (along < _REACH))
            direction = direction if direction.shape[1] == 1 else direction.take(near, axis=1)
            start = start.take(near, axis=1) + direction * np.maximum(-along.take(near) - _NEARBY, 0.0)
        result[near] = self._scene.run(start.astype(np.float32).T, direction.astype(np.float32).T,
                                       query="OCCLUDED") >= 0
        return result
