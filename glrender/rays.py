"""Rays against a shape: Embree finds the facet in float32, the point is worked out again in float64.

Vectors stand in columns (3, N) here: NumPy then reads memory in order, several times as fast as rows.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from .embree import EmbreeMesh
from .errors import DeviceError

LIFT = 6e-7
"""A ray that asks what hides a facet, or a corner of it, starts this far off it and more (`RayMesh.lift_m`), in radii
of the bounding sphere: ten float32 steps."""
LEAST_LIFT = 2e-7
"""One from where a ray of an image met a facet, the same: what starts higher sees over the foot of what rises."""
# Of what float32 errs by off a facet: times its longest side, as often as that is as long as the facet is high. Most of
# it, in radii, as there is no light in what is thinner.
_UNSURE, _MOST_UNSURE = 6e-8, 2e-5


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar products (N,) of columns (3, N), or (3, 1) that broadcast."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def longest_sides_m(vertices_m: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Longest sides (F,) of facets (F, 3) between vertices (V, 3) [m]."""
    a, b, c = (vertices_m.take(corner, axis=0).T for corner in facets.T)
    return np.sqrt(np.maximum.reduce([dot(side, side) for side in (b - a, c - b, a - c)]))


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
    other_side : (F,) int, optional
        The facet that is the other side of each, in the same place, or -1: rays meet the one that they face.

    Attributes
    ----------
    facets : (F, 3) int
    radius_m : float [m]
    normals : (F, 3) float64 [1]

    Raises
    ------
    DeviceError
        embreex or numba is not installed.
    """

    def __init__(self, vertices_m: np.ndarray, facets: np.ndarray, other_side: np.ndarray | None = None):
        try:
            # Not before there is a mesh: it takes a third of a second.
            from . import ray_loops
        except ImportError as error:
            raise DeviceError(f"rays need embreex and numba: pip install 'glrender[raytrace]' ({error})") from error
        self._loops = ray_loops
        self.facets, self._other_side = facets, other_side
        self.radius_m = float(np.linalg.norm(vertices_m, axis=1).max())
        corners = vertices_m[facets]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        twice_area_m2 = np.linalg.norm(normals, axis=1, keepdims=True)
        normals /= twice_area_m2
        self._unsure_m = np.minimum(_UNSURE * longest_sides_m(vertices_m, facets)**3 / twice_area_m2[:, 0],
                                    _MOST_UNSURE * self.radius_m)
        # A facet's in one place in memory: rays meet them in no order.
        self.normals = normals
        self._offset_m = dot(normals.T, corners[:, 0].T)
        self._mesh = EmbreeMesh(vertices_m / self.radius_m, facets)

    def lift_m(self, facet: np.ndarray, least: float) -> np.ndarray:
        """How far (N,) [m] off facets (N,) rays start: a least, in radii, and what float32 errs by there."""
        return least * self.radius_m + self._unsure_m.take(facet)

    def hit(self, origin_m: np.ndarray, ray: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Facet (N,) or -1, and distance (N,) float64 [m] or infinity, of rays (N, 3) from a point or points."""
        hits = self.first(np.transpose(origin_m), ray.T)
        facet, distance = np.full(len(ray), -1), np.full(len(ray), np.inf)
        facet[hits.place], distance[hits.place] = hits.facet, hits.distance_m
        return facet, distance

    def first(self, origin_m: np.ndarray, ray: np.ndarray) -> Hits:
        """What rays (3, N) from a point (3,) [m], or from points (3, N), meet first."""
        place, facet, distance_m, ray, normal = self._loops.find_first(
            self._mesh.scene, origin_m.reshape(3, -1), ray, self.radius_m, self.normals.T, self._offset_m)
        return self._faced(Hits(place=place, facet=facet, distance_m=distance_m, ray=ray, normal=normal))

    def _faced(self, hits: Hits) -> Hits:
        """Hits of the sides that the rays face: of two in one place either may be met first."""
        if self._other_side is None:
            return hits
        other = self._other_side.take(hits.facet)
        is_turned = (other >= 0) & (dot(hits.ray, hits.normal) > 0.0)
        return replace(hits, facet=np.where(is_turned, other, hits.facet),
                       normal=np.where(is_turned, -hits.normal, hits.normal))

    def blocks(self, start_m: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """Whether rays from points (N, 3) [m] towards one direction (3,), or one each (N, 3), meet the shape."""
        is_blocked = np.zeros(len(start_m), bool)
        self._loops.find_blocked(self._mesh.scene, start_m.T, np.transpose(direction).reshape(3, -1), self.radius_m,
                                 is_blocked)
        return is_blocked

    def heights(self, points_m: np.ndarray, normals: np.ndarray, axes: np.ndarray, azimuths: np.ndarray,
                unknown: int, found: np.ndarray) -> None:
        """Write how high the shape stands around points (3, N) [m] of its surface: `ray_loops.find_heights`."""
        self._loops.find_heights(self._mesh.scene, self.radius_m, points_m, normals, axes, LIFT * self.radius_m,
                                 azimuths, unknown, found)

    def keep_free(self, own: RayMesh, turn: np.ndarray, shift_m: np.ndarray, r_body_m: np.ndarray, facet: np.ndarray,
                  towards: np.ndarray, is_place: bool, is_free: np.ndarray) -> None:
        """Of points of a shape's surface that are free, find those that this one hides something from.

        Parameters
        ----------
        own : RayMesh
            That shape's, from whose facets rays start: this one, or another.
        turn, shift_m : (3, 3), (3,) float64 [1], [m]
            To this shape's frame from that one's.
        r_body_m : (3, N) float64 [m]
            In that one's frame, on its facets.
        facet : (N,) int
        towards : (3,) float64
            In that one's frame: a unit vector, or a place [m].
        is_place : bool
        is_free : (N,) bool
            Only those that are true are asked for, and false is written.
        """
        self._loops.keep_free(self._mesh.scene, self.radius_m, turn, shift_m, r_body_m, facet, own.normals.T,
                              LIFT * own.radius_m, own._unsure_m, towards, is_place, is_free)
