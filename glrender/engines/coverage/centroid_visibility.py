"""Facets of a body that are lit or dark as their centroids are: for facets far smaller than pixels.

Source: Max (1988), Horizon mapping; rays decide where a horizon does not.
"""

from __future__ import annotations

import math

import numpy as np

from ...planner.error_budget import FLUX_SHARE
from ...planner.error_model import FEWEST_CENTROIDS
from ...view.view import BodyView
from ..rays.engine import RayEngine
from . import facet_loops, outlines
from .brdf_tables import BrdfTables
from .centroid_horizons import MOST_HORIZONS
from .facet_tables import FacetTables
from .image_cells import ImageCells
from .sub_triangles import projected
from .sunlit_error import CoverageError

# Error over the estimate by boundary facets [1], and the power of small facets' areas in it: 2900 images of five shapes
# with 49k to 197k facets, 30 to 480 px, 20 to 120 deg, against clipped ones; less in 98.9 %, 0.28 to 0.64 in half.
_BOUNDARY_ERROR = 0.42
_ALIKE = 0.6
# One facet in so many is tested for a boundary: an odd number, as divided shapes come in fours.
_SAMPLED = 3


def centroid_error(boundary: np.ndarray, flux_share: float, one_in: int) -> CoverageError:
    """The estimated error by what `facet_loops.lit_edges` finds (4,) of one facet in so many.

    The share is the tolerance of the total light over that of the RMS error [1].
    """
    area, light, squared, of_area = boundary
    if not squared:
        return CoverageError(0.0, 0.0)
    # Errors of small facets next to each other are alike.
    pixels = _BOUNDARY_ERROR * math.sqrt(squared * min(of_area / squared, 1.0) ** _ALIKE * area) / light
    # All facets have as many times the light, and the root of that as error of the flux.
    flux = _BOUNDARY_ERROR * math.sqrt(of_area / one_in) / light
    return CoverageError(max(pixels, flux / flux_share), max(pixels, flux / FLUX_SHARE))


def first_looks(n_facets: int) -> tuple[int, ...]:
    """The shares, one facet in so many, that are looked at in turn: where each costs rays, few show if all will do.

    They are as many as centroids need, of the smallest such shape, and as many rows of a larger one.
    """
    few = MOST_HORIZONS // FEWEST_CENTROIDS * math.isqrt(n_facets // MOST_HORIZONS)
    return (few, 1) if few else (1,)


class CentroidVisibility:
    """The facets of one body that a frame shows, each all lit or all dark.

    Parameters
    ----------
    facets : FacetTables
        With horizons of their centroids.
    view : BodyView
        Of the body, which is wholly before the camera.
    cells : ImageCells
        Beyond whose edges no ray is cast.
    rays : RayEngine
    brdf_tables : BrdfTables
    one_in : int
        One facet in so many is looked at: enough for the error, if not for an image.
    """

    def __init__(self, facets: FacetTables, view: BodyView, cells: ImageCells, rays: RayEngine,
                 brdf_tables: BrdfTables, one_in: int = 1):
        self._facets, self._view, self._bounds_px = facets, view, cells.bounds_px
        self._xy = projected(facets.vertices_m, view, cells.camera)
        self._radiance = self._shaded(rays, brdf_tables, one_in)
        self._one_in = one_in

    def error(self, flux_share: float) -> CoverageError:
        """The estimated error; the share is the tolerance of the total light over that of the RMS error [1]."""
        facets, view, every = self._facets, self._view, _SAMPLED if self._one_in == 1 else 1
        return centroid_error(facet_loops.lit_edges(
            facets.horizons.facets, self._radiance, facets.neighbours, facets.corners, self._xy, self._bounds_px,
            every, view.sun_direction_body, view.r_camera_body_m), flux_share, every * self._one_in)

    def _shaded(self, rays: RayEngine, brdf_tables: BrdfTables, one_in: int) -> np.ndarray:
        """Radiance (F,) in 1/sr of the Sun's irradiance at 1 au: 0 of facets that are dark, or not seen."""
        facets, view = self._facets, self._view
        radiance, asked, (is_seen, is_lit) = facets.horizons.shade(
            view.sun_direction_body, view.r_camera_body_m,
            brdf_tables.of(facets.surface, view, facets.solid.radius_m, view.sun_distance_au**-2), one_in)
        xy = self._xy.take(facets.corners.take(asked, axis=1), axis=1)
        is_shown = (xy.max(axis=1) > self._bounds_px[:2, None]) & (xy.min(axis=1) < self._bounds_px[2:, None])
        shown = np.flatnonzero(is_shown.all(axis=0))
        asked, is_seen, is_lit = asked[shown], is_seen[shown], is_lit[shown]
        centroid_m, number = facets.horizons.facets[asked, 3:].T.astype(float, order="C"), facets.number.take(asked)
        # Where neither was in doubt, both are so.
        sees = rays.in_view(centroid_m, number, view, [view], is_seen) | ~is_seen
        sees &= rays.in_light(centroid_m, number, view, [view], is_lit & sees) | ~is_lit
        radiance[asked[~sees]] = 0.0
        return radiance

    def add_to(self, changes: np.ndarray, cells: ImageCells) -> None:
        """Add the facets to an accumulation buffer (rows, columns + 2) complex128, as `SunlitAreas.add_to` does."""
        outlines.add_facets(changes, cells, self._facets, self._view, self._xy, self._radiance)
