"""Rays against a shape: Embree finds the facet in float32, the point is worked out again in float64.

Vectors stand in columns (3, N) here: NumPy then reads memory in order, several times as fast as rows.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from ...base.errors import DeviceError
from ...brdf import geometry
from ...scene.shape.facet_blocks import FacetBlocks
from ...scene.shape.facet_geometry import FacetSizes
from .embree import EmbreeMesh
from .exact_loops import ALL_SIDES

try:
    from . import loops as ray_loops
except DeviceError:
    # Without embreex no `RayMesh` is made: `EmbreeMesh` says so.
    ray_loops = None

LIFT = 6e-7
"""A ray that asks what hides a facet, or a corner of it, starts this far off it and more (`RayMesh.lift_m`), in radii
of the bounding sphere: ten float32 steps."""
LEAST_LIFT = 2e-7
"""One from where a ray of an image met a facet, the same: what starts higher sees over the foot of what rises."""
# Error of float32 off a facet [1]: times its longest side, and the ratio of that side to the facet's height; at most
# the second number, in radii, as thinner gaps hold no light.
_UNSURE, MOST_UNSURE = 6e-8, 2e-5
ANY_REACH = np.array([np.inf])
"""The reach of rays that end nowhere [m]."""


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Scalar products (N,) of columns (3, N), or (3, 1) that broadcast."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Vector products (3, N) of columns (3, N): NumPy's own takes several times as long."""
    return geometry.cross(a.T, b.T).T


@dataclass(frozen=True, kw_only=True, eq=False)
class Hits:
    """First hits of rays on a shape.

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
        """Hits of given numbers (M,)."""
        return Hits(**{field.name: getattr(self, field.name).take(chosen, axis=-1) for field in fields(self)})


class RayMesh:
    """A shape's acceleration structure, in units of its radius.

    Parameters
    ----------
    vertices_m : (V, 3) float64 [m]
    facets : (F, 3) int
        Counter-clockwise from outside.
    has_backs : bool
        Rays may meet facets from behind: of shells that are open, and of panels with both sides.
    sizes : FacetSizes, optional
        Of the facets.

    Attributes
    ----------
    facets : (F, 3) int
    radius_m : float [m]
    normals : (F, 3) float64 [1]
    offset_m : (F,) float64 [m]
        Of the facets' planes from the origin, along the normals.
    vertices_m : (V, 3) float64 [m]

    Raises
    ------
    DeviceError
        embreex is not installed.
    """

    def __init__(self, vertices_m: np.ndarray, facets: np.ndarray, has_backs: bool = False,
                 sizes: FacetSizes | None = None):
        self.facets, self.has_backs = facets, has_backs
        self.radius_m = float(np.linalg.norm(vertices_m, axis=1).max())
        sizes = sizes or FacetSizes(vertices_m, facets)
        self.unsure_m = np.minimum(_UNSURE * sizes.longest_sides**3 / sizes.twice_areas, MOST_UNSURE * self.radius_m)
        self.normals = sizes.normals
        self.offset_m = dot(self.normals.T, vertices_m.take(facets[:, 0], axis=0).T)
        self._mesh = EmbreeMesh(vertices_m / self.radius_m, facets, has_backs)
        self.vertices_m = vertices_m

    @cached_property
    def facet_blocks(self) -> FacetBlocks:
        """Boxes around its facets."""
        return FacetBlocks(self.vertices_m, self.facets)

    def lift_m(self, r_body_m: np.ndarray, facet: np.ndarray, least: float) -> np.ndarray:
        """Distances (N,) [m] off facets (N,) at which rays start from points (3, N) [m] of them.

        A least, in radii, and float32's error there.
        """
        return least * self.radius_m + self.unsure_m.take(facet)

    def raised(self, r_body_m: np.ndarray, facet: np.ndarray, normal: np.ndarray, least: float) -> np.ndarray:
        """Points (3, N) [m] of facets (N,) as far off their planes as `lift_m` has it.

        However far the points' own rounding, which is that of the range, has put them off.
        """
        height_m = dot(normal, r_body_m) - self.offset_m.take(facet)
        return r_body_m + normal * (self.lift_m(r_body_m, facet, least) - height_m)

    def first(self, origin_m: np.ndarray, ray: np.ndarray, sides: int = ALL_SIDES) -> Hits:
        """First hits of rays (3, N) from a point (3,) [m], or from points (3, N), on facets of some sides."""
        place, facet, distance_m, ray, normal = ray_loops.find_first(
            self._mesh.scene, origin_m.reshape(3, -1), ray, self.radius_m, self.normals.T, self.offset_m,
            ray_loops.FILTERS[self.has_backs * sides])
        return Hits(place=place, facet=facet, distance_m=distance_m, ray=ray, normal=normal)

    def blocks(self, start_m: np.ndarray, direction: np.ndarray, reach_m: np.ndarray = ANY_REACH,
               sides: int = ALL_SIDES) -> np.ndarray:
        """Whether rays from points (N, 3) [m] in one direction (3,), or one each (N, 3), meet the shape: (N,) bool.

        Within a reach [m] of all (1,), or of each (N,), on facets of some sides: `exact_loops`.
        """
        is_blocked = np.zeros(len(start_m), bool)
        ray_loops.find_blocked(self._mesh.scene, start_m.T, np.transpose(direction).reshape(3, -1), reach_m,
                               self.radius_m, ray_loops.FILTERS[self.has_backs * sides], is_blocked)
        return is_blocked

    def heights(self, points_m: np.ndarray, normals: np.ndarray, axes: np.ndarray, azimuths: np.ndarray,
                unknown: int, found: np.ndarray) -> None:
        """Write how high the shape stands around points (3, N) [m] of its surface: `ray_loops.find_heights`."""
        ray_loops.find_heights(self._mesh.scene, self.radius_m, points_m, normals, axes, LIFT * self.radius_m,
                                 azimuths, unknown, found)
