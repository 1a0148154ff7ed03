"""A body's facets as lit as their middles are: of facets far smaller than pixels, without looking where light ends."""

from __future__ import annotations

import math

import numpy as np
from glrender_camera import PinholeCamera, threads

from . import coverage, facet_loops
from .facet_cutter import FacetCutter
from .facet_parts import FacetParts
from .facet_relief import FacetRelief
from .facet_tables import FacetTables
from .ray_engine import RayEngine
from .render_plan import LevelPlan
from .surface import Surface
from .view import BodyView, between

# Steps of a table of BRDF by a normal's place out of the plane of Sun and camera; and by the root of the distance of
# their unit vectors, which is a phase angle [rad], about.
_STEPS, _CHORD = 24, 0.03
# Least angle off the limb and the terminator [rad], and least part of a normal.
_EDGE_ON = 1e-6
# Facets in a turn of each of the two images that are made at once.
_BLOCK = 1 << 12
# Steps in which the edges of others are found along facets' sides.
_BISECTIONS = 3
# Areas of facets in which they are looked for anyway, over the squared radius of what may be there, and least [px2];
# largest parts that are cut [px2], and most divisions.
_LARGE, _LEAST_PX, _PART_PX, _MOST_DIVISIONS = 0.06, 0.25, 6.0, 5


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
    """

    def __init__(self, facets: FacetTables, view: BodyView, views: list[BodyView], camera: PinholeCamera,
                 rays: RayEngine, level: LevelPlan):
        self._facets, self._view, self._camera = facets, view, camera
        roots = chord_roots(view, facets.solid.radius_m)
        self._xy = self._project(facets.vertices_m)
        brightness = level.flux_ratio / view.sun_distance_au**2
        table = brightness * brdf_table(facets.surface, roots)
        self._radiance, asked, (is_seen, is_lit) = facets.middles.shade(
            view.sun_direction_body, view.r_camera_body_m, table, roots)
        middle_m, number = facets.middles.facets[asked, 3:].T.astype(float), facets.number.take(asked)
        # Where neither was in doubt, both are so.
        sees = rays.in_view(facets.solid, middle_m, number, view, [view], is_seen) | ~is_seen
        sees &= rays.in_light(facets.solid, middle_m, number, view, [view], is_lit & sees) | ~is_lit
        self._radiance[asked[~sees]] = 0.0
        if level.has_relief:
            relief = FacetRelief.of(facets.level, facets.surface, view)
            lit = np.flatnonzero(self._radiance)

            def add(part: slice) -> None:
                some = lit[part]
                added = relief.added(facets.number.take(some), facets.normal.take(some, axis=1))
                self._radiance[some] = np.maximum(self._radiance[some] + added * brightness, 0.0)

            threads.run_in_parts(add, len(lit), _BLOCK)
        # What others cut: points, and of each number of corners the polygons and their radiance.
        self._points_m, self._polygons = np.zeros((3, 0)), []
        if len(views) > 1:
            self._cut_by_others(views, rays)

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
        facets = self._facets
        # Two always, whatever the number of threads: the same bytes.
        images = [changes, np.zeros_like(changes)]

        def add(k: int) -> None:
            coverage.add_lit(images[k], self._xy, facets.corners, facets.neighbours, self._radiance, k * _BLOCK, _BLOCK,
                             len(images) * _BLOCK, origin_px, per_px)

        threads.run(add, range(len(images)), threads.N_CORES)
        changes += images[1]
        points_xy = self._project(self._points_m)
        for corner, radiance in self._polygons:
            coverage.add_polygons(changes, points_xy, corner, radiance + 1j, origin_px, per_px)

    def _project(self, r_body_m: np.ndarray) -> np.ndarray:
        """Places (2, N) [px] of points (3, N) [m]."""
        return facet_loops.projected(r_body_m, self._view.camera_from_body, self._view.r_camera_body_m,
                                     self._camera.focal_length_px, np.array(self._camera.principal_point_px, float))


def brdf_table(surface: Surface, roots: np.ndarray) -> np.ndarray:
    """BRDF [1/sr] of facets times the cosines of incidence and emission, as `horizon_loops.shade_middles` takes it.

    By the roots of distances (C,) of the unit vectors to Sun and camera, the places around a square in their plane, and
    the parts of the normal in it. Beyond the terminator and the limb as on them.
    """
    place, part = np.meshgrid(np.arange(-_STEPS, _STEPS + 1) / _STEPS, np.arange(_STEPS + 1) / _STEPS, indexing="ij")
    angle, part = np.arctan2(place, 1.0 - np.abs(place)), np.maximum(part, _EDGE_ON)
    to_camera, found = np.array([[1.0, 0.0, 0.0]]), []
    for root in roots:
        phase_rad = 2.0 * math.asin(min(0.5 * root**2, 1.0))
        to_sun = np.array([math.cos(phase_rad), math.sin(phase_rad), 0.0])
        both = np.clip(angle, phase_rad - 0.5 * math.pi + _EDGE_ON, 0.5 * math.pi - _EDGE_ON)
        normal = np.stack([part * np.cos(both), part * np.sin(both), np.sqrt(1.0 - part * part)], axis=-1)
        brdf = surface.brdf(to_sun, to_camera, normal.reshape(-1, 3), np.ones(place.size)).reshape(place.shape)
        found.append(brdf * (normal @ (to_sun + to_camera[0])))
    return np.stack(found)


def chord_roots(view: BodyView, radius_m: float) -> np.ndarray:
    """Roots of distances of the unit vectors to Sun and camera, as seen from anywhere on the body, in even steps.

    Close to 0 surfaces surge, and steps are small.
    """
    aside = math.asin(min(radius_m / view.range_m, 1.0))
    ends = [math.sqrt(2.0 * math.sin(0.5 * min(max(view.phase_rad + turn, 0.0), math.pi))) for turn in (-aside, aside)]
    return np.linspace(*ends, 2 + math.ceil((ends[1] - ends[0]) / _CHORD))
