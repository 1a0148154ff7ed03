"""A body's facets in columns: corners, normals, and which share edges. Neighbours are neighbours in memory."""

from __future__ import annotations

import numpy as np

from ...base.morton import morton_order
from ...planner.error_model import FEWEST_CENTROIDS
from ...scene.scene import Body
from ...scene.surface import Surface
from ..rays.mesh import RayMesh, dot
from . import facet_loops
from .centroid_horizons import CentroidHorizons

# Height over the radius [1] by which a facet of a convex body may rise above its neighbour's plane: a round choice,
# far above float64's rounding.
_FLAT = 1e-7


class FacetTables:
    """Constant tables of a body's facets; vectors in columns, facets and vertices in an order of their own.

    Of 786k facets in the order of their file a frame takes 1.3 times as long.

    Parameters
    ----------
    body : Body
    solid : RayMesh
        Of the same facets.

    Attributes
    ----------
    surface : Surface
    number, vertex_number : (F,) int, (V,) int
        Of facets and vertices, in the shape.
    n_facets : int
    longest_side_m : float [m]
        Of any facet.
    solid : RayMesh
        As it was given.
    is_convex : bool
        Without a dip: the hull's word is good to a thousandth of its volume.
    crease_rad : float [rad]
        RMS angle between neighbouring facets.
    horizons : CentroidHorizons or None
        Of the centroids of a shape that may be drawn by them.
    vertices_m : (3, V) float64 [m]
    corners : (3, F) int
        Vertices, counter-clockwise from outside.
    normal : (3, F) float64
        Outward unit vectors.
    shading_normal : (3, F) float64
        The same, or of a smooth body those of the facets' middles.
    albedo_scale : (F,) float64 [1]
        Factor of the texture on the law's albedo, the mean of the corners'.
    offset_m : (F,) float64 [m]
        Of the facets' planes from the body's origin, along the normal.
    neighbours : (3, F) int32
        Facets across the edges from each corner to the next, or -1.
    """

    def __init__(self, body: Body, solid: RayMesh):
        shape = body.drawn_shape
        self.surface = Surface(body)
        self.n_facets = len(shape.facets)
        self.longest_side_m = shape.longest_side_m
        columns_m, corners = np.ascontiguousarray(shape.vertices_m.T), np.ascontiguousarray(shape.facets.T, np.intp)
        middle_m = facet_loops.centroids(columns_m, corners)
        self.number = morton_order(middle_m.T)
        # Vertices as facets come to them.
        self.vertex_number, _, self.corners = facet_loops.vertices_of(
            corners, self.number, len(shape.vertices_m))
        self.vertices_m = columns_m.take(self.vertex_number, axis=1)
        self.normal = np.ascontiguousarray(shape.facet_normals.take(self.number, axis=0).T)
        self.shading_normal = self.normal
        if self.surface.body.smooth_normals:
            self.shading_normal = np.ascontiguousarray(self.surface.normals(self.number).T)
        self.albedo_scale = np.broadcast_to(1.0, self.n_facets)
        if not self.surface.is_even:
            self.albedo_scale = np.mean([self.surface.albedo_scale(self.number, np.tile(at, (self.n_facets, 1)))
                                         for at in np.eye(3)], axis=0)
        self.solid, self.crease_rad = solid, shape.crease_rad
        self.offset_m = dot(self.normal, self.vertices_m.take(self.corners[0], axis=1))
        # Now: a first frame that had to wait for them would be late.
        self.neighbours = facet_loops.neighbours(self.corners, len(shape.vertices_m))
        middle_m = middle_m.take(self.number, axis=1)
        self.is_convex = body.hull.is_convex and bool((self.neighbours >= 0).all()) and all(
            float((dot(self.normal, middle_m.take(across, axis=1)) - self.offset_m).max()) <= _FLAT * body.hull.radius_m
            for across in self.neighbours)
        self.horizons = None
        if self.n_facets >= FEWEST_CENTROIDS and self.surface.body.brdf is not None:
            self.horizons = CentroidHorizons.of(middle_m, self.normal, solid, not shape.is_moved)

    def face(self, place_m: np.ndarray) -> np.ndarray:
        """Facets (F,) bool in front of whose planes a place (3,) [m] lies."""
        return dot(self.normal, place_m[:, None]) > self.offset_m

    def corner_m(self, facet: np.ndarray) -> np.ndarray:
        """Corners (3, 3, N) [m] of facets (N,): corner, axis, facet."""
        return np.stack([self.vertices_m.take(corner[facet], axis=1) for corner in self.corners])
