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
from ...planner.error_budget import CELL_SHARE, FLUX_SHARE, LEAST_LEFT, OVERLAPS_LEFT, PENUMBRA_SHARE, Budget
from ...planner.error_model import FEWEST_CENTROIDS
from ...planner.penumbra import sun_points
from ...scene.scene import Scene
from ...scene.surface import Surface
from ...view.sun_disc import lit_from, on_disc
from ...view.view import BodyView
from ..rays.engine import RayEngine
from ..rays.mesh import dot
from . import accumulate, outlines
from .boundary_refinement import find_areas
from .brdf_tables import BrdfTables
from .centroid_visibility import CentroidVisibility, first_looks
from .corner_visibility import look
from .coverage_image import CoverageImage, LookedAt, overlapping, squared_errors
from .facet_tables import FacetTables
from .image_cells import ImageCells
from .sampling import SampledAreas
from .sub_triangles import projected
from .sunlit_error import NOTHING_DRAWN, CoverageError, ErrorScale

# Mean width [px] of penumbras that reach beyond the facets in which their edges are, above which rays draw all of the
# image: a round choice.
_WIDE_PX = 3.0
# Cells that a facet covers, below which it is far smaller than one: a round choice.
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
        # Uneven ones show what samples miss; large shapes have facets far smaller than their thinnest parts.
        self._facets = {body.name: FacetTables(body, rays.solid(body.name)) for body in scene.bodies
                        if Surface(body).n_uneven < max(len(body.shape.facets), FEWEST_CENTROIDS)}

    def facets(self, name: str) -> FacetTables | None:
        """A body's tables; None of one with many facets of which none is evenly bright."""
        return self._facets.get(name)

    def close(self) -> None:
        """Release the tables."""
        self._facets.clear()

    def draw(self, names: Sequence[str], views: list[BodyView], cells: ImageCells, budget: Budget,
             has_planes: bool = False, is_only: bool = False) -> CoverageImage:
        """Means over cells, and their estimated error.

        Facets are clipped where their visible, sunlit part ends. Where hard edges in place of penumbras cost more than
        the tolerance allows, the image is the mean of those of a few points of the Sun's disc.

        Parameters
        ----------
        names : sequence of str
            Bodies that are drawn, all of each before the camera; others may cast shadows.
        views : list of BodyView
            Of all bodies.
        cells : ImageCells
        budget : Budget
            Errors that the drawing may have.
        has_planes : bool
            Whether the radiance of a facet varies linearly, or is that of its centroid.
        is_only : bool
            No other engine draws penumbras: points of the Sun's disc do, however few.
        """
        looked = self._look(names, views, cells, budget, self._scene.sun_disc)
        penumbra = looked.penumbra.judged
        n_points, share = sun_points(penumbra, budget.tolerance)
        if n_points == 1:
            return self._clipped(looked, cells, budget, has_planes)
        left = budget.after(share * penumbra)

        def softer() -> CoverageImage:
            return CoverageImage.mean([
                self._clipped(self._look(names, lit_from(views, point), cells, left, False), cells, left, has_planes)
                for point in on_disc(n_points)], looked, share, cells)

        if share * penumbra <= PENUMBRA_SHARE * budget.tolerance or is_only:
            return softer()
        if looked.wide_px > _WIDE_PX:
            return CoverageImage.dark(cells, NOTHING_DRAWN)
        return replace(self._clipped(looked, cells, budget, has_planes), softer=softer)

    def draw_by_centroids(self, names: Sequence[str], views: list[BodyView], cells: ImageCells, budget: Budget
                          ) -> CoverageImage:
        """The same of one body that no other hides or shades, with each facet lit or dark by its centroid.

        The error is estimated before anything is drawn; nothing is drawn, and it is infinite, where it exceeds the
        tolerance, or where the table of the BRDF is too coarse for the law, as of a highlight.
        """
        view = next(view for view in views if view.name in names)
        facets = self._facets[view.name]
        rms, flux = self._brdf_tables.errors(facets.surface, view, facets.solid.radius_m)
        if rms > CELL_SHARE * budget.tolerance or flux > max(CELL_SHARE * budget.flux, CENTROIDS_LEAST):
            return CoverageImage.dark(cells, NOTHING_DRAWN)
        for one_in in first_looks(facets.n_facets):
            body = CentroidVisibility(facets, view, cells, self._rays, self._brdf_tables, one_in)
            error = body.error(budget.flux_share)
            # Few facets show the squared error to a factor of two.
            if error.judged > (1.0 if one_in == 1 else math.sqrt(2.0)) * budget.tolerance:
                return CoverageImage.dark(cells, NOTHING_DRAWN)
        changes = accumulate.no_changes(cells.shape)
        body.add_to(changes, cells)
        means, *_ = cells.light(changes, self._scene.solar_irradiance_of(cells.camera))
        return CoverageImage(means=means, error=error)

    def may_be_lit(self, names: Sequence[str], views: list[BodyView], cells: ImageCells) -> np.ndarray | None:
        """Cells (rows, columns) uint8 that a facet touches which faces the camera and any of the Sun's disc.

        None where a body has many uneven facets, or is not wholly before the camera.
        """
        members = self._members(names, views)
        return None if members is None else _may_be_lit(members, cells, self._scene.sun_disc)

    def sampled_areas(self, names: Sequence[str], views: list[BodyView], cells: ImageCells, is_crowded: bool
                      ) -> SampledAreas | None:
        """Exact areas that tell of the light that samples in each cell miss.

        None is known behind a lens, and of bodies of many facets that crowd the pixels, or vary within them.
        """
        members = self._members(names, views)
        if members is None or cells.camera.lens_map is not None or is_crowded and any(
                facets.n_facets >= FEWEST_CENTROIDS for facets, _ in members):
            return None
        return SampledAreas(members, views, cells, self._scene.solar_irradiance_of(cells.camera), self._rays)

    def _members(self, names: Sequence[str], views: list[BodyView]) -> list[tuple[FacetTables, BodyView]] | None:
        """Tables and views of bodies that are seen and wholly before the camera, or None where one has none."""
        members = [view for view in views if view.name in names and view.is_visible]
        if any(view.name not in self._facets or view.bounds_px is None for view in members):
            return None
        return [(self._facets[view.name], view) for view in members]

    def _look(self, names: Sequence[str], views: list[BodyView], cells: ImageCells, budget: Budget, has_disc: bool
              ) -> LookedAt:
        """The bodies by the visibility of their corners, and the cost of hard edges if the Sun has a disc."""
        members = [view for view in views if view.name in names and view.is_visible]
        bodies = [look(self._facets[view.name], view, views, cells, self._rays,
                       view.sun_radius_rad if has_disc else 0.0) for view in members]
        scale = ErrorScale(light=sum(body.light for body in bodies), n_px=sum(body.area_px for body in bodies),
                           phase_rad=max(view.phase_rad for view in members), flux_share=budget.flux_share)
        hard, low = [], []
        if has_disc and scale.light > 0.0:
            hard = [body.hard_edges(self._rays, views, cells.camera.focal_length_px) for body in bodies]
            low = [body.low_sun() for body in bodies]
        return LookedAt(bodies=bodies, scales=(scale, replace(scale, flux_share=FLUX_SHARE)), hard=hard, low=low)

    def _clipped(self, looked: LookedAt, cells: ImageCells, budget: Budget, has_planes: bool) -> CoverageImage:
        """The bodies with hard edges of shadows."""
        bodies, scales, penumbras = looked.bodies, looked.scales, looked.squared
        scale = scales[0]
        if not scale.light > 0.0:
            # Light between corners that are all dark is for rays to find.
            has_facing = any(body.has_facing for body in bodies)
            return CoverageImage.dark(cells, NOTHING_DRAWN if has_facing else CoverageError(0.0, 0.0))
        most = scale.most_squared(budget.tolerance)
        allowed = OVERLAPS_LEFT * max(most - penumbras[0], LEAST_LEFT**2 * most) / len(bodies)
        # A pixel's solid angle falls off as cos^3 of its angle from the boresight: of facets that are far smaller.
        is_fine = not has_planes and scale.n_px * cells.per_px.prod() < _FINE * sum(body.n_areas for body in bodies)
        found = [find_areas(body, allowed, scale.flux_weight) for body in bodies]
        changes, slopes = accumulate.no_changes(cells.shape), accumulate.no_changes(cells.shape) if has_planes else None
        for areas in found:
            if has_planes:
                areas.add_planes_to(changes, slopes, cells)
            else:
                areas.add_to(changes, cells, is_fine)
        # Where areas overlap, one that is hidden was taken to be seen: which one is not known.
        solar_W_m2 = self._scene.solar_irradiance_of(cells.camera)
        means, unsure, cover = cells.light(changes, solar_W_m2, is_fine, slopes)
        scales = tuple(each.over(np.count_nonzero(means) / cells.per_px.prod()) for each in scales)
        squared = sum(areas.squared for areas in found) + unsure / cells.per_px.prod() ** 2
        if has_planes:
            squared += sum(float(areas.uneven()[1].sum()) for areas in found)
        bias_squared = sum(areas.bias**2 for areas in found)
        error = CoverageError(*(each.error(of_penumbras + squared + each.flux_weight * bias_squared)
                                for each, of_penumbras in zip(scales, penumbras, strict=True)))
        unit_W_m2 = float(cells.per_px.prod()) * solar_W_m2 / cells.camera.focal_length_px**2
        return CoverageImage(means=means, error=error, scales=scales, unit_W_m2=unit_W_m2, areas=(tuple(found),),
                             squared_of_areas=lambda: (
            unit_W_m2**2 * squared_errors(looked, found, cells, has_planes) + overlapping(means, cover))
                             ).by_its_light()


def _may_be_lit(bodies: list[tuple[FacetTables, BodyView]], cells: ImageCells, has_disc: bool) -> np.ndarray:
    """Cells (rows, columns) uint8 that a facet touches which faces the camera and any of the Sun's disc."""
    changes = accumulate.no_changes(cells.shape)
    for facets, view in bodies:
        least = -view.sun_radius_rad if has_disc else 0.0
        faces = (dot(facets.normal, view.sun_direction_body[:, None]) > least) & facets.face(view.r_camera_body_m)
        outlines.add_facets(changes, cells, facets, view, projected(facets.vertices_m, view, cells.camera),
                            faces.astype(float))
    found, cover = np.empty((2, *cells.shape))
    largest = accumulate.means(changes, 0, len(found), found, cover)
    # A cell next to a touched one may have light by rounding, or at another sample's place.
    return cv2.dilate((cover > accumulate.ROUNDING * largest).astype(np.uint8), np.ones((3, 3), np.uint8))
