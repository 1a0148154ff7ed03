"""A body's facets in columns: corners, normals, and which share edges. Neighbours are neighbours in memory."""

from __future__ import annotations

import numpy as np

from .facet_relief import LevelShape
from .horizons import Horizons
from .middle_horizons import Middles
from .morton import morton_order
from .rays import RayMesh, dot, longest_sides_m
from .scene import Body
from .shape import Shape
from .surface import Surface

# Of the radius, how far a facet may rise above its neighbour's plane on a body that is convex.
_FLAT = 1e-7
# Vertices of which a table of horizons is made.
_MOST_HORIZONS = 200_000
# Facets from which there are tables of the horizons of their middles: fewer are soon drawn as they are.
_FEWEST_MIDDLES = 10_000
# Points that may stand for a shape, and of how many facets each does at least.
_POINTS, _FACETS_PER_POINT = (98_304, 196_608, 393_216), 4


class FacetTables:
    """What does not change of a body's facets; vectors in columns, facets and vertices in an order of their own.

    Of 786k facets in the order of their file a frame takes 1.3 times as long.

    Parameters
    ----------
    body : Body
    is_coarse : (F,) bool
        Of the shape's facets: whether one is far larger than the smallest of the scene, so that there are things that
        it does not know of.
    solid : RayMesh
        Of the same facets.
    is_closed : bool
        Known of a level of detail, where decimation may leave out a facet.
    level : LevelShape, optional
        Where the body's shape is one.
    with_middles : bool
        Of a body whose levels of detail are measured.

    Attributes
    ----------
    surface : Surface
    number, vertex_number : (F,) int, (V,) int
        Of facets and vertices, in the shape.
    n_facets : int
    longest_side_m : float [m]
        Of any facet.
    is_coarse : (F,) bool
    solid : RayMesh
    level : LevelShape or None
        As they were given.
    is_closed : bool
        Every edge has two facets, or is taken to have.
    is_convex : bool
        Without a dip: the hull's word is good to a thousandth of its volume.
    horizons : Horizons or None
        Of the vertices of a body that is not, and not too large: a table takes longer to make than it is worth.
    middles : Middles or None
        If they are asked for, of a shape that is large enough.
    vertices_m : (3, V) float64 [m]
    corners : (3, F) int
        Vertices, counter-clockwise from outside.
    normal : (3, F) float64
        Outward unit vectors.
    offset_m : (F,) float64 [m]
        Of the facets' planes from the body's origin, along the normal.
    neighbours : (3, F) int32
        Facets across the edges from each corner to the next, or -1.
    rises : (3, F) bool
        Whether the facet across an edge rises above the plane of this one.
    """

    def __init__(self, body: Body, is_coarse: np.ndarray, solid: RayMesh, *, is_closed: bool = False,
                 level: LevelShape | None = None, with_middles: bool = False):
        # Not before there is a body: its loops are compiled, or read, at the first import.
        from . import facet_loops

        shape = body.drawn_shape
        self.surface = Surface(body)
        self.n_facets = len(shape.facets)
        self.longest_side_m = float(longest_sides_m(shape.vertices_m, shape.facets).max())
        self.number = morton_order(shape.vertices_m[shape.facets].mean(axis=1))
        # Vertices as facets come to them.
        self.vertex_number, _, self.corners = facet_loops.vertices_of(
            np.ascontiguousarray(shape.facets.T, np.intp), self.number, len(shape.vertices_m))
        self.vertices_m = np.ascontiguousarray(shape.vertices_m[self.vertex_number].T)
        self.normal = np.ascontiguousarray(shape.facet_normals[self.number].T)
        self.is_coarse, self.solid, self.level = is_coarse[self.number], solid, level
        self.offset_m = dot(self.normal, self.vertices_m.take(self.corners[0], axis=1))
        # Now: a first frame that had to wait for them would be late.
        self.neighbours = neighbours(self.corners, self.vertices_m.shape[1])
        middle_m = self.corner_m(slice(None)).mean(axis=0)
        height_m = np.stack([np.where(across < 0, 0.0, dot(self.normal, middle_m.take(across, axis=1)) - self.offset_m)
                             for across in self.neighbours])
        self.rises = height_m > 0.0
        self.is_closed = is_closed or bool((self.neighbours >= 0).all())
        is_flat = float(height_m.max()) <= _FLAT * body.hull.radius_m
        self.is_convex = self.is_closed and body.hull.is_convex and is_flat
        self.horizons = None if self.is_convex or len(shape.vertices_m) > _MOST_HORIZONS else Horizons(shape)
        self.middles = Middles.of(middle_m, self.normal, solid) if with_middles and has_middles(shape) else None

    def corner_m(self, facet: np.ndarray) -> np.ndarray:
        """Corners (3, 3, N) [m] of facets (N,): corner, axis, facet."""
        return np.stack([self.vertices_m.take(corner[facet], axis=1) for corner in self.corners])


def has_middles(shape: Shape) -> bool:
    """Whether there are tables of the horizons of a shape's facets."""
    return len(shape.facets) >= _FEWEST_MIDDLES


def point_counts(n_facets: int) -> tuple[int, ...]:
    """Numbers of points of which some may stand for a shape of so many facets: each twice the one before."""
    return tuple(count for count in _POINTS if _FACETS_PER_POINT * count <= n_facets)


def neighbours(corners: np.ndarray, n_vertices: int) -> np.ndarray:
    """Facets (3, F) int32 across the edges of facets, from each of their corners (3, F) to the next.

    -1 where an edge has not exactly two facets that run along it in opposite directions.
    """
    following = corners[[1, 2, 0]]
    key = (np.minimum(corners, following) * n_vertices + np.maximum(corners, following)).ravel()
    order = np.argsort(key, kind="stable")
    key = key[order]
    is_new = np.concatenate([[True], key[1:] != key[:-1]])
    first = np.flatnonzero(is_new)
    pairs = first[np.diff(np.append(first, len(key))) == 2]
    one, other = order[pairs], order[pairs + 1]
    goes_up = (corners < following).ravel()
    opposite = goes_up[one] != goes_up[other]
    one, other = one[opposite], other[opposite]
    found = np.full(len(key), -1, np.int32)
    found[one], found[other] = other % corners.shape[1], one % corners.shape[1]
    return found.reshape(3, -1)
