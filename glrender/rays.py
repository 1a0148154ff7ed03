"""Rays against a shape: Embree finds the facet in float32, the point is worked out again in float64."""

from __future__ import annotations

import numpy as np

from .errors import DeviceError


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
        self._corner = corners[:, 0]
        self.normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
        self._scene = rtcore_scene.EmbreeScene()
        TriangleMesh(self._scene, (corners / self.radius_m).astype(np.float32))

    def hit(self, origin_m: np.ndarray, ray: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Facet (N,) or -1, and distance (N,) float64 [m] or infinity, of rays (N, 3) from a point or points."""
        origin_m = np.broadcast_to(origin_m, ray.shape)
        along = -np.einsum("ij,ij->i", ray, origin_m)
        nearest = origin_m + ray * along[:, None]
        # What passes the bounding sphere meets nothing: float32 has no room for a start far off, and would.
        reach_m = 1.01 * self.radius_m
        near = np.flatnonzero((np.linalg.norm(nearest, axis=1) < reach_m) & (along > -reach_m))
        # Float32 rays start close by: on the bounding sphere where the origin is beyond it.
        start = nearest[near] - ray[near] * np.minimum(along[near], 1.5 * self.radius_m)[:, None]
        facet = np.full(len(ray), -1)
        if len(near):
            facet[near] = self._scene.run(np.ascontiguousarray(start / self.radius_m, np.float32),
                                          np.ascontiguousarray(ray[near], np.float32))
        distance = np.full(len(ray), np.inf)
        found = np.flatnonzero(facet >= 0)
        normal = self.normals[facet[found]]
        distance[found] = (np.einsum("ij,ij->i", self._corner[facet[found]] - origin_m[found], normal)
                           / np.einsum("ij,ij->i", ray[found], normal))
        return facet, distance

    def blocks(self, start_m: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Whether rays from points (N, 3) [m] towards one direction (3,), or one each (N, 3), meet the shape."""
        if not len(start_m):
            return np.zeros(0, bool)
        direction = np.broadcast_to(direction, start_m.shape)
        along = np.einsum("ij,ij->i", start_m, direction)
        away = np.linalg.norm(start_m - along[:, None] * direction, axis=1)
        # Far sunward or beside the bounding sphere there is nothing to meet, and float32 no room for it.
        near = np.flatnonzero((away < 1.01 * self.radius_m) & (along < 1.01 * self.radius_m))
        start = start_m[near] + direction[near] * np.maximum(-along[near] - 1.5 * self.radius_m, 0.0)[:, None]
        result = np.zeros(len(start_m), bool)
        if len(near):
            result[near] = self._scene.run(np.ascontiguousarray(start / self.radius_m, np.float32),
                                           np.ascontiguousarray(direction[near], np.float32)) >= 0
        return result
