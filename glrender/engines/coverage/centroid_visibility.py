"""Facets of a body that are lit or dark as their centroids are: for facets far smaller than pixels.

Source: Max (1988), Horizon mapping; rays decide where a horizon does not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from glrender_camera import PinholeCamera

from ...planner.error_model import FLUX_SHARE
from ...view.view import BodyView, between
from ..rays.engine import RayEngine
from . import accumulate, facet_loops
from .boundary_clip import FacetCutter
from .brdf_tables import BrdfTables
from .facet_tables import FacetTables
from .sub_triangles import FacetParts, projected

# Bisections by which the edges of other bodies are found within facets.
_BISECTIONS = 3
# Area of a facet over the squared radius of another body that may stand before it, from which its edge is looked for
# anyway, and least [px2]; largest part that is clipped [px2]; most divisions.
_LARGE = 0.06
_LEAST_PX = 0.25
_PART_PX = 6.0
_MOST_DIVISIONS = 5
# Error over what boundary facets tell [1], and the power of small facets' areas in it: 2900 images of five shapes with
# 49k to 197k facets, 30 to 480 px, 20 to 120 deg, beside clipped ones; it is less in 98.9 %, 0.28 to 0.64 in half.
_BOUNDARY_ERROR = 0.42
_ALIKE = 0.6
# Error of several bodies over that [1]: pairs of 1 to 4 px (tests/planner/test_small_bodies.py).
_SEVERAL = 1.5
# One facet of so many tells of boundaries: an odd number, as divided shapes come in fours.
_SAMPLED = 3


def centroid_error(boundaries: Sequence[np.ndarray]) -> float:
    """RMS error [1] over the mean of the lit pixels, by what `facet_loops.lit_edges` tells of each body (4,)."""
    area, light, squared, of_area = np.sum(boundaries, axis=0)
    if not squared:
        return 0.0
    # Errors of small facets next to each other are alike.
    pixels = _BOUNDARY_ERROR * math.sqrt(squared * min(of_area / squared, 1.0) ** _ALIKE * area) / light
    # One facet in a few was asked: all of them have as many times the light, and the root of it as error of the flux.
    flux = _BOUNDARY_ERROR * math.sqrt(of_area / _SAMPLED) / (FLUX_SHARE * light)
    return max(pixels * (1.0 if len(boundaries) == 1 else _SEVERAL), flux)


class CentroidVisibility:
    """The facets of one body that a frame shows, each all lit or all dark.

    Parameters
    ----------
    facets : FacetTables
        With horizons of their centroids.
    view : BodyView
        Of the body: all of it is before the camera.
    views : list of BodyView
        Of all bodies.
    camera : PinholeCamera
    rays : RayEngine
    brdf_tables : BrdfTables

    Attributes
    ----------
    boundary : (4,) float64
        What facets at the boundary of light tell: `facet_loops.lit_edges`.
    """

    def __init__(self, facets: FacetTables, view: BodyView, views: list[BodyView], camera: PinholeCamera,
                 rays: RayEngine, brdf_tables: BrdfTables):
        self._facets, self._view, self._camera = facets, view, camera
        # At the edges of other bodies: points, and of each number of corners the polygons and their radiance.
        self._points_m, self._polygons = np.zeros((3, 0)), []
        self._xy = projected(facets.vertices_m, view, camera)
        self._radiance = self._shaded(rays, brdf_tables)
        self.boundary = facet_loops.lit_edges(
            facets.horizons.facets, self._radiance, facets.neighbours, facets.corners, self._xy, _SAMPLED,
            view.sun_direction_body, view.r_camera_body_m)
        if len(views) > 1:
            self._cut_by_others(views, rays)

    def _shaded(self, rays: RayEngine, brdf_tables: BrdfTables) -> np.ndarray:
        """Radiance (F,) in 1/sr of the Sun's irradiance at 1 au: 0 of facets that are dark, or not seen."""
        facets, view = self._facets, self._view
        radiance, asked, (is_seen, is_lit) = facets.horizons.shade(
            view.sun_direction_body, view.r_camera_body_m,
            *brdf_tables.of(facets.surface, view, facets.solid.radius_m, view.sun_distance_au**-2))
        centroid_m, number = facets.horizons.facets[asked, 3:].T.astype(float), facets.number.take(asked)
        # Where neither was in doubt, both are so.
        sees = rays.in_view(facets.solid, centroid_m, number, view, [view], is_seen) | ~is_seen
        sees &= rays.in_light(facets.solid, centroid_m, number, view, [view], is_lit & sees) | ~is_lit
        radiance[asked[~sees]] = 0.0
        return radiance

    def _cut_by_others(self, views: list[BodyView], rays: RayEngine) -> None:
        """Leave what no other body hides or shades; facets on either side of such edges are cut there."""
        facets, view = self._facets, self._view
        others = [other for other in views if other is not view]
        radii_m = np.array([rays.solid(other.name).radius_m for other in others])
        shown = facet_loops.may_be_hidden(
            facets.horizons.facets, self._radiance, view.sun_direction_body, view.r_camera_body_m,
            np.stack([between(other, view)[1] for other in others], axis=1),
            facets.longest_side_m + radii_m)
        centroid_m, number = facets.horizons.facets[shown, 3:].T.astype(float), facets.number.take(shown)
        # Their own body was asked.
        is_open = np.ones(len(shown), bool)
        is_free = rays.in_view(facets.solid, centroid_m, number, view, views, is_open, is_open)
        is_free = rays.in_light(facets.solid, centroid_m, number, view, views, is_free, is_open)
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
        """Add the facets to an accumulation buffer, as `SunlitAreas.add_to` does.

        Parameters
        ----------
        changes : (rows, columns + 2) complex128
        origin_px : (2,) float64 [px]
        per_px : (2,) float64 [1/px]
        """
        facets = self._facets
        accumulate.in_two_images(changes, facets.n_facets, lambda image, *turn: accumulate.add_facets(
            image, self._xy, facets.corners, facets.neighbours, self._radiance, *turn, origin_px, per_px))
        points_xy = projected(self._points_m, self._view, self._camera)
        for corner, radiance in self._polygons:
            accumulate.add_polygons(changes, points_xy, corner, radiance + 1j, origin_px, per_px)
