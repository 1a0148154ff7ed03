"""Exact area coverage: the visible, sunlit area of each facet, added to the pixels by the area that they share.

Source: Catmull (1978), A hidden-surface algorithm with anti-aliasing, which clips polygons by pixels; visibility and
shadows are found by rays here. Duff (1989), Polygon scan conversion by exact convolution.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from glrender_camera import PinholeCamera, threads

from ...planner.error_budget import FLUX_SHARE, OVERLAPS_LEFT, PENUMBRA_SHARE, Budget
from ...planner.error_model import crescent_gain
from ...planner.penumbra import sun_points
from ...scene.scene import Scene
from ...scene.shape.shape import Shape
from ...scene.surface import Surface
from ...view.sun_disc import lit_from, on_disc
from ...view.view import BodyView
from ..rays.engine import RayEngine
from ..rays.mesh import dot
from . import accumulate
from .brdf_tables import BrdfTables
from .centroid_visibility import CentroidVisibility
from .facet_tables import FacetTables
from .sub_triangles import projected
from .visible_sunlit import SunlitAreas

# Share of a cell covered twice from which it counts; and the part of the excess that is taken off a closed surface that
# is alone: as much is missing where its facets are clipped too small (tests/engines/coverage/test_coverage_engine.py).
_OVERLAP = 1e-3
_EXCESS = 0.5
# Rows that a thread adds up in a turn.
_ROWS = 64
# Cells that a facet covers, below which it is far smaller than one.
_FINE = 0.15
# Least error [1] that is estimated: a facet's radiance at its centroid for all of it, and rays in float32.
_LEAST = 5e-4


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

    def close(self) -> None:
        """Release the tables."""
        self._facets.clear()

    def draw(self, names: Sequence[str], camera: PinholeCamera, views: list[BodyView],
             bounds_px: tuple[float, float, float, float], grid: tuple[int, int], tolerance: float
             ) -> tuple[np.ndarray, float]:
        """Means over the cells of a grid (rows, columns) float64 [W/m2 per pixel], and their estimated error [1].

        Facets are clipped where their visible, sunlit part ends. Nothing is drawn, and the error is infinite, where
        rays have to look: no corner of facets that face Sun and camera is lit, too few facets have too much of the
        light, or hard edges in place of penumbras cost more than the tolerance allows.

        Parameters
        ----------
        names : sequence of str
            Bodies that are drawn, all of each before the camera; others may cast shadows.
        camera : PinholeCamera
        views : list of BodyView
            Of all bodies.
        bounds_px : (float, float, float, float) [px]
            Of the grid: x0, y0, x1, y1.
        grid : (int, int)
            Columns and rows.
        tolerance : float [1]
            RMS error of pixels over the mean of the lit ones.
        """
        def drawn(views: list[BodyView], tolerance: float, has_disc: bool) -> tuple[np.ndarray, float, float]:
            return self._clipped(names, camera, views, bounds_px, grid, tolerance, has_disc)

        means, error, penumbra = drawn(views, tolerance, self._scene.sun_disc)
        if penumbra <= PENUMBRA_SHARE * tolerance:
            return means, error
        points = sun_points(penumbra, tolerance)
        if points is None:
            return means, math.inf
        n_points, share = points
        left = Budget(tolerance=tolerance).left_after(share * penumbra)
        sums, total = np.zeros(grid[::-1]), 0.0
        for point in on_disc(n_points):
            means, error, _ = drawn(lit_from(views, point), left, False)
            if math.isinf(error):
                return means, error
            sums += means
            total += error
        return sums / n_points, math.hypot(total / n_points, share * penumbra)

    def draw_by_centroids(self, names: Sequence[str], camera: PinholeCamera, views: list[BodyView],
                          bounds_px: tuple[float, float, float, float], grid: tuple[int, int], tolerance: float
                          ) -> tuple[np.ndarray, float]:
        """The same of one body that no other hides or shades, with each facet lit or dark by its centroid.

        The error is estimated before anything is drawn; nothing is drawn, and it is infinite, where it exceeds the
        tolerance.
        """
        view = next(view for view in views if view.name in names)
        body = CentroidVisibility(self._facets[view.name], view, camera, np.array(bounds_px, float), self._rays,
                                  self._brdf_tables)
        if body.error > tolerance:
            return np.zeros(grid[::-1]), math.inf
        cells, changes = _Cells(camera, bounds_px, grid), accumulate.no_changes(grid[::-1])
        body.add_to(changes, cells.corner, cells.per_px)
        return self._added_up(changes, cells, camera, 1.0, 1.0)[0], body.error

    def may_be_lit(self, names: Sequence[str], camera: PinholeCamera, views: list[BodyView],
                   bounds_px: tuple[float, float, float, float], grid: tuple[int, int]) -> np.ndarray | None:
        """Cells (rows, columns) uint8 that a facet touches which faces the camera and any of the Sun's disc.

        None where a body is not drawn by coverage, or not all of it is before the camera.
        """
        members = [view for view in views if view.name in names and view.is_visible]
        if any(view.name not in self._facets or view.bounds_px is None for view in members):
            return None
        cells, changes = _Cells(camera, bounds_px, grid), accumulate.no_changes(grid[::-1])
        for view in members:
            facets, sun = self._facets[view.name], view.sun_direction_body[:, None]
            least = -view.sun_radius_rad if self._scene.sun_disc else 0.0
            faces = (dot(facets.normal, sun) > least) & (
                dot(facets.normal, view.r_camera_body_m[:, None]) > facets.offset_m)
            accumulate.add_facets(changes, projected(facets.vertices_m, view, camera), facets.corners,
                                  facets.neighbours, faces.astype(float), 0, facets.n_facets, facets.n_facets,
                                  cells.corner, cells.per_px)
        found, cover = np.empty((2, *grid[::-1]))
        largest = accumulate.means(changes, 0, len(found), found, cover)
        # A cell beside one that is touched may have what rounding, or another sample's place, leaves of it.
        return cv2.dilate((cover > accumulate.ROUNDING * largest).astype(np.uint8), np.ones((3, 3), np.uint8))

    def _clipped(self, names: Sequence[str], camera: PinholeCamera, views: list[BodyView],
                 bounds_px: tuple[float, float, float, float], grid: tuple[int, int], tolerance: float,
                 has_disc: bool) -> tuple[np.ndarray, float, float]:
        """Means with hard edges of shadows, their error, and what hard edges cost if the Sun has a disc.

        Nothing is drawn if that is too much.
        """
        dark, cells = np.zeros(grid[::-1]), _Cells(camera, bounds_px, grid)
        members = [view for view in views if view.name in names and view.is_visible]
        bodies = [SunlitAreas(self._facets[view.name], view, views, camera, bounds_px, self._rays, has_disc)
                  for view in members]
        light, n_px = sum(body.light for body in bodies), sum(body.area_px for body in bodies)
        if not light > 0.0:
            # Light between corners that are all dark is for rays to find.
            return dark, math.inf if any(body.has_facing for body in bodies) else 0.0, 0.0
        # Of the root of a sum of squares: RMS over the lit pixels over their mean, or the flux over its share.
        crescents = crescent_gain(max(view.phase_rad for view in members))
        per_root = crescents * max(math.sqrt(n_px), 1.0 / FLUX_SHARE) / light
        most = max(tolerance**2 - _LEAST**2, _LEAST**2) / per_root**2
        flux_weight = (FLUX_SHARE * per_root * light) ** -2
        penumbras = penumbra = 0.0
        if has_disc:
            low = [body.low_sun() for body in bodies]
            # By pixels alone: penumbras take no flux, a low Sun does.
            penumbras = sum(body.penumbra() for body in bodies) * min(n_px * FLUX_SHARE**2, 1.0) + max(
                sum(squared for squared, _ in low), flux_weight * sum(missed for _, missed in low) ** 2)
            penumbra = per_root * math.sqrt(penumbras)
        if penumbra > PENUMBRA_SHARE * tolerance:
            return dark, math.inf, penumbra
        allowed = OVERLAPS_LEFT * (most - penumbras) / len(bodies)
        squared = penumbras + sum(body.refine(allowed, flux_weight) for body in bodies)
        if math.isinf(squared):
            return dark, math.inf, penumbra
        # A pixel's solid angle falls off as cos^3 of its angle from the boresight: of facets that are far smaller.
        is_fine = n_px * cells.per_px.prod() < _FINE * sum(body.n_areas for body in bodies)
        changes = accumulate.no_changes(grid[::-1])
        for body in bodies:
            body.add_to(changes, cells.corner, cells.per_px, 3.0 if is_fine else 0.0)
        # Where areas overlap, one that is hidden was taken to be seen: which of them is not known.
        excess = _EXCESS if self._is_one_surface else 1.0
        means, unsure = self._added_up(changes, cells, camera, 1.0 + _OVERLAP, excess, is_even=is_fine)
        squared += unsure / cells.per_px.prod() ** 2
        return means, math.hypot(per_root * math.sqrt(squared), _LEAST), penumbra

    def _added_up(self, changes: np.ndarray, cells: _Cells, camera: PinholeCamera, most_cover: float,
                  least_share: float, is_even: bool = False) -> tuple[np.ndarray, float]:
        """Means over cells (rows, columns), and what is unsure where areas overlap: `accumulate.settle`.

        Of changes in radiance, or, if pixels are taken to have even solid angles, times a power of the cosine.
        """
        image, cover = np.empty((2, len(changes), changes.shape[1] - 2))
        across, down = ((np.zeros_like(each) for each in cells.squared) if is_even else cells.squared)
        scale = self._scene.solar_irradiance_of(camera) / camera.focal_length_px**2

        least = accumulate.ROUNDING * max(threads.run_in_parts(
            lambda part: accumulate.means(changes, part.start, part.stop, image, cover), len(image), _ROWS))
        unsure = threads.run_in_parts(
            lambda part: accumulate.settle(image, cover, part.start, part.stop, least, scale, across, down, most_cover,
                                         least_share), len(image), _ROWS)
        return image, sum(unsure)


class _Cells:
    """Cells of a grid in a camera's image: where the first one begins (2,) [px], and how many are in a pixel (2,)."""

    def __init__(self, camera: PinholeCamera, bounds_px: tuple[float, float, float, float], grid: tuple[int, int]):
        self._camera, self._grid = camera, grid
        self.corner, far = np.reshape(np.array(bounds_px, float), (2, 2))
        self.per_px = np.array(grid) / (far - self.corner)

    @property
    def squared(self) -> list[np.ndarray]:
        """Squares of the tangents of angles off the boresight, of the cells' centres across (C,) and down (R,).

        A pixel's solid angle is (1 + both)^-1.5 of that on the boresight.
        """
        camera = self._camera
        return [np.square((self.corner[k] + (np.arange(self._grid[k]) + 0.5) / self.per_px[k]
                           - camera.principal_point_px[k]) / camera.focal_length_px) for k in range(2)]


def _is_one_surface(shape: Shape) -> bool:
    """Whether a shape is closed, of one shell, with two facets at each edge."""
    report = shape.report
    return report.is_watertight and report.n_shells == 1
