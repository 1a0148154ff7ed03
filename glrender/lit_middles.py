"""A body's facets as lit as their middles are: of facets far smaller than pixels, without looking where light ends."""

from __future__ import annotations

import math

import numpy as np
from glrender_camera import PinholeCamera

from . import coverage, facet_loops
from .facet_cutter import FacetCutter
from .facet_parts import FacetParts, projected
from .facet_tables import FacetTables
from .kept_middles import KeptMiddles, edges_of
from .lit_triangles import add_small, in_two_images
from .ray_engine import RayEngine
from .render_plan import LevelPlan
from .view import BodyView, between

# Steps in which the edges of others are found within facets.
_BISECTIONS = 3
# Squared side of facets, times their number, over the squared diameter.
_FACETS_SQUARED = 1.2
# Areas of facets in which they are looked for anyway, over the squared radius of what may be there, and least [px2];
# largest parts that are cut [px2], and most divisions.
_LARGE, _LEAST_PX, _PART_PX, _MOST_DIVISIONS = 0.06, 0.25, 6.0, 5
# Error over what edges of light tell, and the power of small facets' areas in it: 2900 images of five shapes with 49k
# to 197k facets, 30 to 480 px, 20 to 120 deg, beside areas; it is less in 98.9 %, 0.28 to 0.64 of it in half.
_EDGE_ERROR, _ALIKE = 0.42, 0.6


class LitMiddles:
    """The facets of one body that a frame shows, each all lit or all dark.

    Parameters
    ----------
    facets : FacetTables
        With horizons of their middles.
    view : BodyView
        Of the body: all of it is before the camera.
    views : list of BodyView
        Of all bodies.
    camera : PinholeCamera
    rays : RayEngine
    level : LevelPlan
    kept : KeptMiddles

    Attributes
    ----------
    error : float [1]
        RMS error of pixels over the mean of the lit ones, as edges of light tell it; 0 of a level of detail, or where
        there are other bodies.
    """

    def __init__(self, facets: FacetTables, view: BodyView, views: list[BodyView], camera: PinholeCamera,
                 rays: RayEngine, level: LevelPlan, kept: KeptMiddles):
        self._facets, self._view, self._camera = facets, view, camera
        self._brightness = level.flux_ratio / view.sun_distance_au**2
        # What others cut: points, and of each number of corners the polygons and their radiance.
        self._points_m, self._polygons = np.zeros((3, 0)), []
        self._triangles, self.error = None, 0.0
        if len(views) == 1:
            self._triangles = kept.triangles(facets, view, rays, has_relief=level.has_relief)
        if self._triangles is None:
            self._xy = projected(facets.vertices_m, view, camera)
            self._radiance = kept.radiance(facets, view, rays, has_relief=level.has_relief,
                                           brightness=self._brightness)
        if len(views) > 1:
            self._cut_by_others(views, rays)
        elif level.tells_error:
            if self._triangles is None:
                self.error = _error(edges_of(facets, self._radiance, self._xy, view), 1.0)
            else:
                self.error = _error(self._triangles.edges, camera.focal_length_px**2 / view.cos_off_axis**3)

    def _cut_by_others(self, views: list[BodyView], rays: RayEngine) -> None:
        """Leave what no other body hides or shades; facets on either side of such edges are cut there."""
        facets, view = self._facets, self._view
        others = [other for other in views if other is not view]
        radii_m = np.array([rays.solid(other.name).radius_m for other in others])
        shown = facet_loops.may_be_hidden(
            facets.middles.facets, self._radiance, view.sun_direction_body, view.r_camera_body_m,
            np.stack([between(other, view)[1] for other in others], axis=1),
            facets.longest_side_m + radii_m)
        middle_m, number = facets.middles.facets[shown, 3:].T.astype(float), facets.number.take(shown)
        # Their own body was asked.
        is_open = np.ones(len(shown), bool)
        is_free = rays.in_view(facets.solid, middle_m, number, view, views, is_open, is_open)
        is_free = rays.in_light(facets.solid, middle_m, number, view, views, is_free, is_open)
        # Vertices of facets on both sides are at an edge.
        corner = facets.corners.take(shown, axis=1)
        touched = np.zeros((2, facets.vertices_m.shape[1]), bool)
        touched[0][corner[:, is_free]] = True
        touched[1][corner[:, ~is_free]] = True
        area_px = facet_loops.areas(self._xy, facets.corners, shown)
        large_px = max(_LARGE * (radii_m.min() * self._camera.focal_length_px / view.range_m) ** 2, _LEAST_PX)
        part_px = min(large_px, _PART_PX)
        chosen = touched.all(axis=0).take(corner).any(axis=0) | (area_px > large_px)
        edge, area_px = shown[chosen], area_px[chosen]
        light = self._radiance.take(edge)
        self._radiance[shown[~is_free | chosen]] = 0.0
        if not len(edge):
            return
        cutter, parts = FacetCutter(facets, view, views, rays, edge), []
        rest = FacetParts(cutter.corner, edge, area_px)
        # What is within a facet that no corner tells of is looked for as well.
        is_large = (area_px > part_px) | ~cutter.are_mixed(rest) & (cutter.are_lit(rest)[0] != is_free[chosen])
        for _ in range(_MOST_DIVISIONS):
            parts.append(rest.at(np.flatnonzero(~is_large)))
            rest = cutter.quarters(rest.at(np.flatnonzero(is_large)))
            is_large = rest.area_px > part_px
        cutter.cut_off(cutter.keep_even(FacetParts.joined([*parts, rest])), _BISECTIONS)
        self._points_m = cutter.points.r_m
        self._polygons = [(corner, light.take(np.searchsorted(edge, facet))) for corner, facet in cutter.polygons]

    def add_to(self, changes: np.ndarray, origin_px: np.ndarray, per_px: np.ndarray) -> None:
        """Add what the facets change in the cells of an image, as of `SunlitAreas.add_to`.

        Parameters
        ----------
        changes : (rows, columns + 2) complex128
        origin_px : (2,) float64 [px]
        per_px : (2,) float64 [1/px]
        """
        if self._triangles is not None:
            self._triangles.add_to(self._view, self._camera, self._brightness, changes, origin_px, per_px)
            return
        facets = self._facets
        # Large facets share lines; small ones are soon shared among the few cells that they have.
        size_px = 2.0 * facets.solid.radius_m * self._camera.focal_length_px / self._view.range_m
        if size_px * math.sqrt(_FACETS_SQUARED * per_px.prod() / facets.n_facets) < 1.0:
            add_small(changes, self._xy, facets.corners, self._radiance, origin_px, per_px)
        else:
            in_two_images(changes, facets.n_facets, lambda image, *turn: coverage.add_lit(
                image, self._xy, facets.corners, facets.neighbours, self._radiance, *turn, origin_px, per_px))
        points_xy = projected(self._points_m, self._view, self._camera)
        for corner, radiance in self._polygons:
            coverage.add_polygons(changes, points_xy, corner, radiance + 1j, origin_px, per_px)


def _error(edges: np.ndarray, px2: float) -> float:
    """Of edges of light, all on one side of a facet's middle or all on the other: areas are in so many pixels."""
    area, light, squared, of_area = edges * [px2, px2, px2, px2**2]
    if not squared:
        return 0.0
    # Of small facets the errors next to each other are alike.
    return _EDGE_ERROR * math.sqrt(squared * min(of_area / squared, 1.0) ** _ALIKE * area) / light
