"""A body's convex hull: few points that bound its outline, its depth and its shadow exactly.

Inside the hull (a neck, a crater) the surface itself decides.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from ...base.errors import ShapeError
from ...base.rotations import evenly_spread
from .convexity import bends_outwards
from .facet_blocks import FacetBlocks
from .facet_geometry import FacetSizes, area_vectors

# An outline or volume this close to the hull's is convex to float32 round-off of a shape file.
_CONVEX_VOLUME_RTOL = 1e-6
# So is its area: shells that overlap may have the hull's volume by chance.
_CONVEX_AREA_RTOL = 1e-4
# Least thickness of a hull over its extent [1]; thinner bodies, as panels, get it.
_FLAT_RTOL = 1e-6
# Distance from a hull over its radius [1] within which that of a surface with dips is measured.
_CLOSE = 0.02
# Difference of distances over them [1] by which facets are as near: those around an edge.
_NEAREST_RTOL = 1e-9
# Directions that give a hull's outlines.
_EXTREMES = 500


class Hull:
    """Convex hull of a closed surface, and exact answers close to it.

    Parameters
    ----------
    vertices_m : (V, 3) float64 [m]
    facets : (F, 3) int
        Counter-clockwise from outside.
    solid : (F,) bool, optional
        Facets of shells that have an inside; all by default. Open terrain and panels have none.
    centre_m : (3,) float64 [m], optional
        Body-fixed, of the vertices' origin: the body's own by default.
    sizes : FacetSizes, optional
        Of the facets.

    Attributes
    ----------
    centre_m : (3,) float64 [m]
    points_m : (3, H) float64 [m]
        Its corners.
    extreme_m : (3, N) float64 [m]
        Those farthest out in one of 500 directions: outlines within 0.4 % of the radius.
    radius_m : float [m]
        Of the farthest from the origin.
    inner_radius_m : float [m]
        Of the largest sphere about the origin that is within it; negative where the origin is outside.
    is_convex : bool
        Whether the surface is its hull: to a millionth of its volume, and at each of its edges.

    Raises
    ------
    ShapeError
        A body so thin, or so far from its origin, that float64 cannot separate its sides.
    """

    def __init__(self, vertices_m: np.ndarray, facets: np.ndarray, solid: np.ndarray | None = None,
                 centre_m: np.ndarray | None = None, sizes: FacetSizes | None = None):
        self.centre_m = np.zeros(3) if centre_m is None else centre_m
        try:
            hull = ConvexHull(_thickened(vertices_m))
        except QhullError as error:
            raise ShapeError("shape", f"has no convex hull: {str(error).splitlines()[0]}") from None
        points_m = hull.points[hull.vertices]
        self.points_m = np.ascontiguousarray(points_m.T)
        self.extreme_m = self.points_m
        if len(points_m) > _EXTREMES:
            directions = evenly_spread(np.arange(_EXTREMES), _EXTREMES)
            self.extreme_m = self.points_m[:, np.unique([np.argmax(way @ self.points_m) for way in directions])]
        self.radius_m = float(np.linalg.norm(points_m, axis=1).max())
        self._planes = hull.equations
        self.inner_radius_m = -float(hull.equations[:, 3].max())
        self._corners = (vertices_m, facets)
        self._solid = facets if solid is None else facets[solid]
        # Volumes relative to the hull's own centre, or a far-off origin would cancel digits.
        centre = points_m.mean(axis=0)
        sizes = sizes or FacetSizes(vertices_m, facets)
        volume = float(np.einsum("ij,ij->", vertices_m.take(facets[:, 0], axis=0) - centre, sizes.vectors)) / 6.0
        area = 0.5 * float(sizes.twice_areas.sum())
        self.is_convex = bool(abs(volume - hull.volume) <= _CONVEX_VOLUME_RTOL * hull.volume
                              and abs(area - hull.area) <= _CONVEX_AREA_RTOL * hull.area
                              and bends_outwards(vertices_m - centre, facets))

    def is_outside(self, point_m: np.ndarray) -> bool:
        """Whether a point (3,) [m] is outside the surface."""
        if np.linalg.norm(point_m) > self.radius_m or self._hull_distance(point_m) > 0.0:
            return True
        return not self.is_convex and winding_number(self._corners[0], self._solid, point_m) < 0.5

    @cached_property
    def solid_radius_m(self) -> float:
        """Radius [m] of the largest sphere about the origin that is within the surface; 0 where the origin is not."""
        if self.inner_radius_m <= 0.0 or self.is_outside(np.zeros(3)):
            return 0.0
        return self.inner_radius_m if self.is_convex else self.blocks.distance_m(np.zeros(3))

    def distance_m(self, point_m: np.ndarray) -> float:
        """A lower bound [m], > 0, of the distance from a point outside to the surface; exact in and near the hull."""
        distance = self._hull_distance(point_m)
        # Close to the hull the surface may be far behind it.
        if distance > (0.0 if self.is_convex else _CLOSE * self.radius_m):
            return distance
        return self.blocks.distance_m(point_m)

    def is_behind(self, point_m: np.ndarray) -> bool:
        """Whether all facets nearest to a point (3,) [m] turn away from it, as of one under ground."""
        facet, _ = self.blocks.within(point_m, (1.0 + _NEAREST_RTOL) * self.blocks.distance_m(point_m))
        vertices_m, facets = self._corners[0], self._corners[1][facet]
        outwards, towards_m = area_vectors(vertices_m, facets), point_m - vertices_m[facets[:, 0]]
        return bool((np.einsum("fx,fx->f", outwards, towards_m) < 0.0).all())

    @cached_property
    def blocks(self) -> FacetBlocks:
        """Boxes around the surface's facets."""
        return FacetBlocks(*self._corners)

    def is_met(self, point_m: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Whether rays from a point (3,) [m] along directions (N, 3) meet the hull: (N,) bool."""
        along, beyond = directions @ self._planes[:, :3].T, self._planes[:, :3] @ point_m + self._planes[:, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            at = -beyond / along
        enters = np.where(along < 0.0, at, np.where((along == 0.0) & (beyond > 0.0), np.inf, 0.0)).max(axis=1)
        return enters <= np.where(along > 0.0, at, np.inf).min(axis=1)

    def _hull_distance(self, point_m: np.ndarray) -> float:
        return float((self._planes[:, :3] @ point_m + self._planes[:, 3]).max())


def _thickened(vertices_m: np.ndarray) -> np.ndarray:
    """Points (N, 3) [m] that have a hull: those of a plane or a needle are doubled, on both of its sides."""
    centred = vertices_m - vertices_m.mean(axis=0)
    least = _FLAT_RTOL * float(np.ptp(centred, axis=0).max())
    for axis in np.linalg.eigh(centred.T @ centred)[1].T[:2]:
        if float(np.ptp(centred @ axis)) <= least:
            vertices_m = np.concatenate([vertices_m - 0.5 * least * axis, vertices_m + 0.5 * least * axis])
    return vertices_m


def winding_number(vertices_m: np.ndarray, facets: np.ndarray, point_m: np.ndarray) -> float:
    """Number of turns of a closed surface round a point: 1 inside, 0 outside.

    Source: Van Oosterom and Strackee (1983), solid angle of a triangle.
    """
    a, b, c = (vertices_m[facets[:, k]] - point_m for k in range(3))
    la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
    numerator = np.einsum("ij,ij->i", a, np.cross(b, c))
    dot = lambda x, y: np.einsum("ij,ij->i", x, y)  # noqa: E731
    denominator = la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb
    return float(np.arctan2(numerator, denominator).sum() / (2.0 * np.pi))
