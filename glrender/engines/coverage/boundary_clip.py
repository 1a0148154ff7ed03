"""Triangles within facets, divided and cut by the visibility of their corners."""

from __future__ import annotations

import numpy as np

from ...view.view import BodyView
from ..rays.engine import RayEngine
from . import facet_loops
from .facet_tables import FacetTables
from .sub_triangles import FacetParts, Points

# What light leaves at a lit and at a dark corner, over what Gauss' rule of two places finds, of natural shapes
# (test_facet_cutter.py).
_BEYOND = 1.01, 1.02

Polygons = tuple[np.ndarray, np.ndarray]
"""Corners (K, M) among points, counter-clockwise as the facets (M,) that they are in."""


class FacetCutter:
    """Finds where light ends in the facets of one body.

    Parameters
    ----------
    facets : FacetTables
    view : BodyView
        Of the body.
    views : list of BodyView
        Of all bodies.
    rays : RayEngine
    facing : (N,) int
        Facets that face camera and Sun.

    Attributes
    ----------
    points : Points
        The facets' vertices first, then what divides and cuts them.
    corner : (3, N) int
        The facets' corners among the points.
    is_free : bool
        Nothing hides or shades any part.
    """

    def __init__(self, facets: FacetTables, view: BodyView, views: list[BodyView], rays: RayEngine,
                 facing: np.ndarray):
        self._facets, self._view, self._views, self._rays = facets, view, views, rays
        self.is_free = facets.is_convex and len(views) == 1
        # Lifted off the surface by the normal of one of their facets.
        vertex, of, self.corner = facet_loops.vertices_of(facets.corners, facing, facets.vertices_m.shape[1])
        self._cut: list[tuple[np.ndarray, ...]] = []
        r_m = facets.vertices_m.take(vertex, axis=1)
        self.points = Points(r_m, *self._seen_and_lit(r_m, of))

    def are_lit(self, triangles: FacetParts) -> np.ndarray:
        """Whether the corners (3, N) of triangles are lit."""
        return self.points.is_lit.take(triangles.corner)

    def are_mixed(self, triangles: FacetParts) -> np.ndarray:
        """Whether the corners of triangles (N,) differ in light."""
        is_lit = self.are_lit(triangles)
        return (is_lit != is_lit[0]).any(axis=0)

    def sorted(self, triangles: FacetParts) -> tuple[FacetParts, FacetParts]:
        """Triangles whose corners are all lit, and those whose corners differ."""
        is_lit = self.are_lit(triangles)
        n_lit = is_lit.sum(axis=0)
        return tuple(triangles.at(np.flatnonzero(chosen)) for chosen in (n_lit == 3, (n_lit > 0) & (n_lit < 3)))

    def quarters(self, triangles: FacetParts) -> FacetParts:
        """Each divided in four between the midpoints of its sides."""
        corner = triangles.corner
        made = self._middles(corner.ravel(), corner[[1, 2, 0]].ravel(), np.tile(triangles.facet, 3))
        # Corners 0, 1, 2; between them 3, 4, 5.
        corner = np.concatenate([corner, made.reshape(3, -1)])
        return FacetParts.joined([FacetParts(corner[three], triangles.facet, 0.25 * triangles.area_px)
                                  for three in ([0, 3, 5], [3, 1, 4], [5, 4, 2], [4, 5, 3])])

    def halves(self, triangles: FacetParts) -> FacetParts:
        """Each divided in two by the midpoint of its longest side."""
        every = np.arange(len(triangles.facet))
        longest = np.argmax(triangles.sides_squared(self.points.r_m), axis=0)
        begin, end, beyond = (triangles.corner[(longest + j) % 3, every] for j in range(3))
        middle = self._middles(begin, end, triangles.facet)
        return FacetParts.joined([FacetParts(np.stack(corner), triangles.facet, 0.5 * triangles.area_px)
                                  for corner in ([begin, middle, beyond], [middle, end, beyond])])

    def _middles(self, begin: np.ndarray, end: np.ndarray, facet: np.ndarray) -> np.ndarray:
        """Points (N,) midway between points (N,) of facets (N,); one where two facets share it."""
        points = self.points
        ends, first, side = facet_loops.distinct_pairs(begin, end)
        r_m = 0.5 * (points.r_m.take(ends[0], axis=1) + points.r_m.take(ends[1], axis=1))
        return points.add(r_m, *self._seen_and_lit(r_m, facet.take(first))).take(side)

    def cut_off(self, triangles: FacetParts, n_bisections: int) -> list[Polygons]:
        """The lit rest of triangles that are cut between the corner that differs and the two others.

        The part cut off has a straight edge, and the area that the bent edge of light would leave dark.
        """
        points = self.points
        is_lit = self.are_lit(triangles)
        is_one = is_lit.sum(axis=0) == 1
        odd, every = np.argmax(is_lit == is_one, axis=0), np.arange(len(is_one))
        corner, *others = (triangles.corner[(odd + j) % 3, every] for j in range(3))
        is_known = points.is_seen.take(triangles.corner).all(axis=0)
        begin_m = points.r_m.take(corner, axis=1)
        sides_m = [points.r_m.take(other, axis=1) - begin_m for other in others]
        # Ways from the odd corner through Gauss' two places of the side beyond, by their distance from its middle: the
        # share that is cut off is the mean of the squares of how far it reaches along them.
        gauss = 12.0**-0.5
        ways_m = np.concatenate([(0.5 + gauss) * one + (0.5 - gauss) * other
                                 for one, other in (sides_m, sides_m[::-1])], axis=1)
        reach = self._reach(*(np.tile(each, 2) for each in (begin_m, triangles.facet, is_known, is_one)), ways_m,
                            n_bisections).reshape(2, -1)
        share = np.minimum(np.where(is_one, *_BEYOND) * 0.5 * (reach[0] ** 2 + reach[1] ** 2), 1.0)
        # A straight end as far from the corner as leaves that share, and as oblique as they are.
        end = np.clip(np.sqrt(share) * (reach[0] / reach[1]) ** (0.25 / gauss), share, 1.0)
        made = [points.add(begin_m + part * side_m, True, True)
                for part, side_m in zip((end, share / end), sides_m, strict=True)]
        self._cut.append((*made, *others, corner, is_one, triangles.facet))
        return [(np.stack(corners).take(chosen, axis=1), triangles.facet.take(chosen))
                for chosen, corners in ((np.flatnonzero(is_one), [corner, *made]),
                                        (np.flatnonzero(~is_one), [made[0], *others, made[1]]))]

    def cuts(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where light was cut off: points (2 N,) at which lines begin, then those at which they end, as polygons run.

        With the dark corner towards which each was found, and the facet.
        """
        found = [[] for _ in range(3)]
        for one, other, first, last, corner, is_one, facet in self._cut:
            begins, ends = (one, np.where(is_one, first, corner)), (other, np.where(is_one, last, corner))
            for k in range(2):
                found[k].append(np.where(is_one, [begins[k], ends[k]], [ends[k], begins[k]]))
            found[2].append(np.tile(facet, (2, 1)))
        return tuple(np.concatenate([np.zeros((2, 0), np.intp), *each], axis=1).ravel() for each in found)

    def _reach(self, begin_m: np.ndarray, facet: np.ndarray, is_seen: np.ndarray, is_lit: np.ndarray,
               way_m: np.ndarray, n_bisections: int) -> np.ndarray:
        """Parts (N,) of ways (3, N) [m] in facets up to which it is as at their begin: lit, or dark."""
        part, step = np.full(len(facet), 0.5), 0.25
        for _ in range(n_bisections):
            _, found = self._seen_and_lit(begin_m + part * way_m, facet, is_seen)
            part += np.where(found == is_lit, step, -step)
            step *= 0.5
        return part

    def _seen_and_lit(self, r_body_m: np.ndarray, facet: np.ndarray, is_seen: np.ndarray | None = None
                      ) -> tuple[np.ndarray, np.ndarray]:
        """Whether points (3, N) [m] of facets (N,) are seen, and in sunlight as well.

        No ray is cast at a body that is convex by its own points, nor for points that are known to be seen (N,).
        """
        if self.is_free:
            return np.ones((2, len(facet)), bool)
        view, is_open = self._view, None
        if self._facets.is_convex:
            is_open = np.ones(len(facet), bool)
        is_asked, number = np.ones(len(facet), bool) if is_seen is None else ~is_seen, self._facets.number.take(facet)
        seen = self._rays.in_view(r_body_m, number, view, self._views, is_asked, is_open)
        if is_seen is not None:
            seen |= is_seen
        return seen, self._rays.in_light(r_body_m, number, view, self._views, seen, is_open)
