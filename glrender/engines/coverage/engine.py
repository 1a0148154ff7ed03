"""Exact area coverage: the visible, sunlit area of each facet, added to the pixels by the area that they share.

Source: Catmull (1978), A hidden-surface algorithm with anti-aliasing, which clips polygons by pixels; visibility and
shadows are found by rays here. Duff (1989), Polygon scan conversion by exact convolution.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from ...planner.engine_choice import CENTROIDS_LEAST
from ...planner.error_budget import CELL_SHARE, FLUX_SHARE, OVERLAPS_LEFT, PENUMBRA_SHARE, Budget
from ...planner.penumbra import sun_points
from ...scene.scene import Scene
from ...scene.shape.shape import Shape
from ...scene.surface import Surface
from ...view.sun_disc import lit_from, on_disc
from ...view.view import BodyView
from ..rays.engine import RayEngine
from ..rays.mesh import dot
from . import accumulate, outlines
from .boundary_refinement import find_areas
from .brdf_tables import BrdfTables
from .centroid_visibility import CentroidVisibility
from .corner_visibility import look
from .facet_tables import FacetTables
from .image_cells import ImageCells
from .sub_triangles import projected
from .sunlit_error import NOTHING_DRAWN, CoverageError, ErrorScale

# The part of what overlaps that is taken off a closed surface that is alone [1]: as much is missing where its facets
# are clipped too small (tests/engines/coverage/test_coverage_engine.py).
_EXCESS = 0.5
# Cells that a facet covers, below which it is far smaller than one.
_FINE = 0.15


class CoverageEngine:
    """Draws a scene's bodies by exact area coverage, in float64.

    Parameters
    ----------
    scene : Scene
    rays : RayEngine
        Of the same scene.
    """

    def __init__(self, scene: Scene, rays: RayEngine):
        self._scene, self._rays, self._brdf_tables = scene, rays, BrdfTables()
        # Facets of several bodies, of shells and of surfaces that are there twice overlap with nothing missing for it.
        self._is_one_surface = len(scene.bodies) == 1 and _is_one_surface(scene.bodies[0].shape)
        self._facets = {body.name: FacetTables(body, rays.solid(body.name))
                        for body in scene.bodies if Surface(body).is_even}

    def facets(self, name: str) -> FacetTables | None:
        """A body's tables; None where its facets are not evenly bright."""
        return self._facets.get(name)

    def close(self) -> None:
        """Release the tables."""
        self._facets.clear()

    def draw(self, names: Sequence[str], views: list[BodyView], cells: ImageCells, budget: Budget
             ) -> tuple[np.ndarray, CoverageError]:
        """Means over cells (rows, columns) float64 [W/m2 per pixel], and their estimated error.

        Facets are clipped where their visible, sunlit part ends. Nothing is drawn, and the error is infinite, where
        rays have to look: no corner of facets that face Sun and camera is lit, too few facets have too much of the
        light, or hard edges in place of penumbras cost more than the tolerance allows.

        Parameters
        ----------
        names : sequence of str
            Bodies that are drawn, all of each before the camera; others may cast shadows.
        views : list of BodyView
            Of all bodies.
        cells : ImageCells
        budget : Budget
            Errors that the drawing may have.
        """
        means, error, penumbra = self._clipped(names, views, cells, budget, self._scene.sun_disc)
        if penumbra.judged <= PENUMBRA_SHARE * budget.tolerance:
            return means, error
        points = sun_points(penumbra.judged, budget.tolerance)
        if points is None:
            return means, NOTHING_DRAWN
        n_points, share = points
        left = budget.after(share * penumbra.judged)
        sums, errors = np.zeros(cells.shape), []
        for point in on_disc(n_points):
            means, error, _ = self._clipped(names, lit_from(views, point), cells, left, False)
            if math.isinf(error.judged):
                return means, error
            sums += means
            errors.append(error)
        return sums / n_points, CoverageError(*(
            math.hypot(sum(of_points) / n_points, share * at_once)
            for of_points, at_once in zip(zip(*errors, strict=True), penumbra, strict=True)))

    def draw_by_centroids(self, names: Sequence[str], views: list[BodyView], cells: ImageCells, budget: Budget
                          ) -> tuple[np.ndarray, CoverageError]:
        """The same of one body that no other hides or shades, with each facet lit or dark by its centroid.

        The error is estimated before anything is drawn; nothing is drawn, and it is infinite, where it exceeds the
        tolerance, or where the table of the BRDF is too coarse for the law, as of a highlight.
        """
        view = next(view for view in views if view.name in names)
        facets = self._facets[view.name]
        rms, flux = self._brdf_tables.errors(facets.surface, view, facets.solid.radius_m)
        if rms > CELL_SHARE * budget.tolerance or flux > max(CELL_SHARE * budget.flux, CENTROIDS_LEAST):
            return np.zeros(cells.shape), NOTHING_DRAWN
        body = CentroidVisibility(facets, view, cells, self._rays, self._brdf_tables, budget.flux_share)
        if body.error.judged > budget.tolerance:
            return np.zeros(cells.shape), NOTHING_DRAWN
        changes = accumulate.no_changes(cells.shape)
        body.add_to(changes, cells)
        return cells.light(changes, self._scene.solar_irradiance_of(cells.camera))[0], body.error

    def may_be_lit(self, names: Sequence[str], views: list[BodyView], cells: ImageCells) -> np.ndarray | None:
        """Cells (rows, columns) uint8 that a facet touches which faces the camera and any of the Sun's disc.

        None where a body is not drawn by coverage, or is not wholly before the camera.
        """
        members = [view for view in views if view.name in names and view.is_visible]
        if any(view.name not in self._facets or view.bounds_px is None for view in members):
            return None
        return _may_be_lit([(self._facets[view.name], view) for view in members], cells, self._scene.sun_disc)

    def _clipped(self, names: Sequence[str], views: list[BodyView], cells: ImageCells, budget: Budget,
                 has_disc: bool) -> tuple[np.ndarray, CoverageError, CoverageError]:
        """Means with hard edges of shadows, their error, and what hard edges cost if the Sun has a disc.

        Nothing is drawn if that is too much.
        """
        dark, no_error = np.zeros(cells.shape), CoverageError(0.0, 0.0)
        members = [view for view in views if view.name in names and view.is_visible]
        bodies = [look(self._facets[view.name], view, views, cells, self._rays,
                       view.sun_radius_rad if has_disc else 0.0) for view in members]
        light, n_px = sum(body.light for body in bodies), sum(body.area_px for body in bodies)
        if not light > 0.0:
            # Light between corners that are all dark is for rays to find.
            return dark, NOTHING_DRAWN if any(body.has_facing for body in bodies) else no_error, no_error
        scale = ErrorScale(light=light, n_px=n_px, phase_rad=max(view.phase_rad for view in members),
                           flux_share=budget.flux_share)
        scales = scale, replace(scale, flux_share=FLUX_SHARE)
        penumbras = [0.0 for _ in scales]
        if has_disc:
            hard = sum(body.hard_edges(self._rays, views, cells.camera.focal_length_px) for body in bodies)
            low = [body.low_sun() for body in bodies]
            penumbras = [each.of_penumbras(hard, low) for each in scales]
        penumbra = CoverageError(*(each.rms(squared) for each, squared in zip(scales, penumbras, strict=True)))
        if penumbra.judged > PENUMBRA_SHARE * budget.tolerance:
            return dark, NOTHING_DRAWN, penumbra
        allowed = OVERLAPS_LEFT * (scale.most_squared(budget.tolerance) - penumbras[0]) / len(bodies)
        # A pixel's solid angle falls off as cos^3 of its angle from the boresight: of facets that are far smaller.
        is_fine = n_px * cells.per_px.prod() < _FINE * sum(body.n_areas for body in bodies)
        changes, squared, bias_squared = accumulate.no_changes(cells.shape), 0.0, 0.0
        for body in bodies:
            areas = find_areas(body, allowed, scale.flux_weight)
            if areas is None:
                return dark, NOTHING_DRAWN, penumbra
            areas.add_to(changes, cells, is_fine)
            squared += areas.squared
            bias_squared += areas.bias**2
        # Where areas overlap, one that is hidden was taken to be seen: which one is not known.
        means, unsure = cells.light(changes, self._scene.solar_irradiance_of(cells.camera),
                                    _EXCESS if self._is_one_surface else 1.0, is_even=is_fine)
        squared += unsure / cells.per_px.prod() ** 2
        return means, CoverageError(*(each.error(of_penumbras + squared + each.flux_weight * bias_squared)
                                      for each, of_penumbras in zip(scales, penumbras, strict=True))), penumbra


def _may_be_lit(bodies: list[tuple[FacetTables, BodyView]], cells: ImageCells, has_disc: bool) -> np.ndarray:
    """Cells (rows, columns) uint8 that a facet touches which faces the camera and any of the Sun's disc."""
    changes = accumulate.no_changes(cells.shape)
    for facets, view in bodies:
        least = -view.sun_radius_rad if has_disc else 0.0
        faces = (dot(facets.normal, view.sun_direction_body[:, None]) > least) & (
            dot(facets.normal, view.r_camera_body_m[:, None]) > facets.offset_m)
        outlines.add_facets(changes, cells, facets, view, projected(facets.vertices_m, view, cells.camera),
                            faces.astype(float))
    found, cover = np.empty((2, *cells.shape))
    largest = accumulate.means(changes, 0, len(found), found, cover)
    # A cell next to a touched one may have light by rounding, or at another sample's place.
    return cv2.dilate((cover > accumulate.ROUNDING * largest).astype(np.uint8), np.ones((3, 3), np.uint8))


def _is_one_surface(shape: Shape) -> bool:
    """Whether a shape is closed, of one shell, with two facets at each edge."""
    report = shape.report
    return report.is_watertight and report.n_shells == 1
