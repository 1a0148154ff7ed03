"""The light that an image's samples miss, by the exact areas of the facets that they meet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...planner.error_model import FEWEST_CENTROIDS
from ...view.view import BodyView
from ..rays.engine import RayEngine
from ..rays.mesh import dot
from . import accumulate, facet_loops, outlines
from .corner_visibility import look
from .facet_radiance import FacetRadiance
from .facet_tables import FacetTables
from .image_cells import ROWS, ImageCells
from .sub_triangles import projected


class SampledAreas:
    """Facets that face camera and Sun, also those that others hide or shade; of a shape of few, with a corner in light.

    Parameters
    ----------
    bodies : iterable of (FacetTables, BodyView)
        All of each before the camera, which has no lens.
    views : list of BodyView
        Of all bodies.
    cells : ImageCells
    solar_W_m2 : float [W/m2]
        Irradiance of the Sun at 1 au.
    rays : RayEngine

    Attributes
    ----------
    are_exact : bool
        Whether they are all that is lit: of a convex body alone whose facets are evenly bright, none of them by a part
        of the Sun's disc or by a lamp.
    """

    def __init__(self, bodies: Sequence[tuple[FacetTables, BodyView]], views: list[BodyView], cells: ImageCells,
                 solar_W_m2: float, rays: RayEngine):
        self.are_exact = len(views) == 1 and not rays.scene.lamps and all(
            facets.is_convex and facets.surface.is_even and facets.surface.body.relief is None
            and not (rays.scene.sun_disc and _has_low_sun(facets, view)) for facets, view in bodies)
        self._cells, self._scale = cells, solar_W_m2 / cells.camera.focal_length_px**2
        self._drawn: list[tuple[FacetTables, BodyView, np.ndarray, np.ndarray]] = []
        for facets, view in bodies:
            if facets.n_facets < FEWEST_CENTROIDS:
                seen = look(facets, view, views, cells, rays, 0.0)
                xy_px, lit, made = seen.xy_px, np.concatenate([seen.whole, seen.boundary.facet]), seen.radiance
            else:
                xy_px = projected(facets.vertices_m, view, cells.camera)
                lit, cosines, *_ = facet_loops.facing(
                    facets.normal, facets.offset_m, 0, facets.n_facets, view.sun_direction_body, 0.0,
                    view.r_camera_body_m, xy_px, facets.corners, cells.bounds_px)
                made = FacetRadiance(facets, view, lit, cosines)
            radiance = np.zeros(facets.n_facets)
            is_smooth = facets.surface.body.smooth_normals and facets.n_facets < FEWEST_CENTROIDS
            radiance[lit] = made.of(lit) if not is_smooth else rays.mean_radiance(
                facets.number.take(lit), view.sun_direction_body, view, cells.camera) / solar_W_m2
            self._drawn.append((facets, view, xy_px, radiance))

    def missed(self, count: int) -> np.ndarray:
        """Light (rows, columns) [W/m2 per pixel] of exact areas less that of count x count samples in each cell.

        Parts narrower than a sample, and edges along the samples' rows, show in it. 0 samples miss the areas' light.
        """
        cells, (rows, columns) = self._cells, self._cells.shape
        found, (left, top, right, _) = np.empty(cells.shape, np.float32), cells.bounds_px
        # All facets are visited for each band of rows, which takes no more memory than they do.
        at_once = max(ROWS, sum(len(radiance) for *_, radiance in self._drawn) // columns)
        for first in range(0, rows, at_once):
            last = min(first + at_once, rows)
            band = ImageCells(cells.camera, (left, top + first / cells.per_px[1], right, top + last / cells.per_px[1]),
                              (columns, last - first))
            found[first:last] = _missed(self._drawn, band, count) * self._scale
        if not count:
            # What rounding leaves in dark cells would count them as lit.
            found[found < accumulate.ROUNDING * found.max(initial=0.0)] = 0.0
        return found


def _has_low_sun(facets: FacetTables, view: BodyView) -> bool:
    """Whether a facet's horizon cuts the Sun's disc."""
    return bool((np.abs(dot(facets.normal, view.sun_direction_body[:, None])) < view.sun_radius_rad).any())


def _missed(drawn: list[tuple[FacetTables, BodyView, np.ndarray, np.ndarray]], cells: ImageCells, count: int
            ) -> np.ndarray:
    """Those of some rows, in radiance: of facets with their vertices (2, V) [px] and radiance (F,)."""
    changes = accumulate.no_changes(cells.shape)
    for facets, view, xy_px, radiance in drawn:
        outlines.add_facets(changes, cells, facets, view, xy_px, radiance)
        if count:
            accumulate.add_facets(changes, xy_px, facets.corners, facets.neighbours, radiance, 0, facets.n_facets,
                                  facets.n_facets, cells.origin_px, cells.per_px, count)
    missed, cover = np.empty((2, *cells.shape))
    accumulate.means(changes, 0, len(missed), missed, cover)
    across, down = cells.tangents_squared
    return missed * (1.0 + across + down[:, None]) ** -1.5
