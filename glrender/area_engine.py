"""Exact area sampling: the sunlit areas of facets, each pixel's share of them by area.

Source: Catmull (1978), A hidden-surface algorithm with anti-aliasing, which clips polygons by pixels; what hides and
shades them is found by rays here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType

import numpy as np
from glrender_camera import PinholeCamera, threads

from .eclipses import PENUMBRA_SHARE, sun_steps
from .error_model import sliver_gain
from .facet_relief import LevelShape
from .facet_tables import FacetTables, point_counts
from .frames import sun_from_body
from .kept_nodes import KeptAtNodes, camera_at_node
from .level_tables import is_kept
from .ray_engine import RayEngine
from .rays import RayMesh, longest_sides_m
from .render_plan import LevelPlan
from .scene import Scene
from .shape import Shape
from .surface import Surface
from .view import BodyView

# Share of the budget for pixels over that for the flux.
_FLUX = 10.0
# Share of a cell that must be covered twice to be seen; and of what is too much then, what is taken off at least of a
# closed surface that is alone: as much is missing where its areas are cut too small, of which nothing tells.
_OVERLAP, _EXCESS = 1e-3, 0.5
# Rows that a thread adds up in a turn.
_ROWS = 64
# Cells that a facet covers where it is far smaller than one.
_FINE = 0.15
# Of the squared budget, what is left for areas that turn out to be covered twice.
_AIM = 0.9
# Longest side of a facet, in those of the scene's smallest, from which it is coarse.
_COARSE = 2.0
# Least error that is told: a facet's light at its middle for all of it, and rays in float32.
_LEAST = 5e-4
# Of large shapes, steps of the grid of Sun and camera at which sunlit areas are kept: of directions in 1 rad, of ranges
# in a factor e, and of budgets in a factor 2; what the farthest from a node errs by, the least
# budget for it, and the largest phase angle [rad] anywhere on the body. The least range in its radii, since close to it
# a step of the grid is not small, and the least cosine off the boresight, along which areas are larger by its cube.
_DIRECTIONS, _RANGES, _BUDGETS, _NODE_ERROR, _LEAST_KEPT, _KEPT_RAD = 8192, 1024, 8, 1.2e-3, 4e-3, 2.5
_NEAREST, _LEAST_COS = 3.0, 0.95


class AreaEngine:
    """Draws a scene's bodies by the areas of their facets, in float64.

    Parameters
    ----------
    scene : Scene
    rays : RayEngine
        Of the same scene.
    levels : mapping of str to sequence of LevelShape, optional
        Of bodies of the scene: levels of detail, finest first.
    keeps_areas : bool
        Whether sunlit areas of large shapes are kept from frame to frame; of middles it always is.
    """

    def __init__(self, scene: Scene, rays: RayEngine,
                 levels: Mapping[str, Sequence[LevelShape]] = MappingProxyType({}), keeps_areas: bool = True):
        # Not before there is a scene: their loops are compiled, or read, at the first import.
        from . import coverage, kept_middles, lit_middles, lit_triangles, sunlit_areas, surface_points

        self._coverage, self._lit_middles, self._sunlit_areas = coverage, lit_middles, sunlit_areas
        self._lit_triangles = lit_triangles
        self._scene, self._rays, self._kept_middles = scene, rays, kept_middles.KeptMiddles()
        self._kept_cuts = KeptAtNodes(_DIRECTIONS, _RANGES) if keeps_areas else None
        sides_m = {body.name: longest_sides_m(body.drawn_shape.vertices_m, body.shape.facets) for body in scene.bodies}
        smallest_m = min(each[each > 0.0].min() for each in sides_m.values())
        # Areas of bodies, of shells and of surfaces that are there twice overlap where nothing is missing for it.
        self._is_one_surface = len(scene.bodies) == 1 and _is_one_surface(scene.bodies[0].shape)
        # Of each body that can be drawn so: the full shape, and its levels of detail.
        self._facets, self._points = {}, {}
        for body in scene.bodies:
            if Surface(body).is_even:
                made = levels.get(body.name, ())
                full = FacetTables(body, sides_m[body.name] > _COARSE * smallest_m, rays.solid(body.name),
                                   with_middles=bool(made))
                # What a level of detail does not know of is measured.
                self._facets[body.name] = [full, *(
                    FacetTables(replace(body, shape=level.shape), np.zeros(len(level.shape.facets), bool),
                                RayMesh(level.shape.vertices_m, level.shape.facets), is_closed=full.is_closed,
                                level=level, with_middles=True)
                    for level in made)]
                # They are for bodies that are alone.
                if len(scene.bodies) == 1 and full.middles is not None and point_counts(full.n_facets):
                    self._points[body.name] = surface_points.SurfacePoints(full)

    def close(self) -> None:
        """Release the tables."""
        # First what looks at the tables in spare time.
        self._kept_middles.close()
        if self._kept_cuts is not None:
            self._kept_cuts.close()
        self._facets.clear()
        self._points.clear()

    def forget(self) -> None:
        """Look anew at what is kept of frames before; no image changes."""
        self._kept_middles.forget()
        if self._kept_cuts is not None:
            self._kept_cuts.forget()

    def draw(self, names: Sequence[str], camera: PinholeCamera, views: list[BodyView],
             bounds_px: tuple[float, float, float, float], grid: tuple[int, int], budget: float,
             levels: Mapping[str, LevelPlan] = MappingProxyType({}), may_be_dark: bool = False,
             eclipse_error: float = 0.0) -> tuple[np.ndarray, float]:
        """Means over the cells of a grid (rows, columns) float64 [W/m2 per pixel], and their expected error.

        Of facets as bright all over: what that costs close up is for the planner to know.

        Nothing is drawn, and the error is infinite, where rays have to look: no corner is lit of facets that may be,
        too few facets have too much of the light, or hard edges in place of penumbras cost more than the budget allows.
        Facets as lit as their middles have the error that they have, whatever the budget: told before they are drawn.

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
        budget : float [1]
            RMS error of pixels over the mean of the lit ones; that of levels of detail is not in it.
        levels : mapping of str to LevelPlan, optional
            What is drawn of bodies: the full shape of others.
        may_be_dark : bool
            Whether they are not drawn where that is more than the budget.
        eclipse_error : float [1]
            Of hard edges in place of the penumbras of other bodies (`Eclipse`): of the flux facets' edges do not tell.
        """
        level = levels.get(names[0], LevelPlan())
        if level.n_points:
            cells = _Cells(camera, bounds_px, grid)
            return self._scene.solar_irradiance_of(camera) * self._points[names[0]].image(
                level.n_points, views[0], camera, level.flux_ratio / views[0].sun_distance_au**2,
                cells.corner, cells.per_px, grid), 0.0
        if level.by_middles:
            return self._by_middles(names, camera, views, bounds_px, grid, levels,
                                    budget if may_be_dark else math.inf)

        def made(views: list[BodyView], budget: float, has_disc: bool) -> tuple[np.ndarray, float, float]:
            return self._drawn(names, camera, views, bounds_px, grid, budget, levels, has_disc)

        means, penumbra = np.zeros(grid[::-1]), eclipse_error
        if eclipse_error <= PENUMBRA_SHARE * budget:
            means, told, penumbra = made(views, math.sqrt(budget**2 - eclipse_error**2), self._scene.sun_disc)
            if penumbra <= PENUMBRA_SHARE * budget:
                return means, math.hypot(told, eclipse_error)
            penumbra = math.hypot(penumbra, eclipse_error)
        # Steps in place of a ramp: by points of the Sun's disc, each with hard edges.
        steps = sun_steps(penumbra, budget)
        if steps is None:
            return means, math.inf
        n_points, share = steps
        left = math.sqrt(budget**2 - (share * penumbra) ** 2)
        sums, total = np.zeros(grid[::-1]), 0.0
        for point in _on_disc(n_points):
            means, told, _ = made(_lit_from(views, point), left, False)
            if math.isinf(told):
                return means, told
            sums += means
            total += told
        return sums / n_points, math.hypot(total / n_points, share * penumbra)

    def _by_middles(self, names: Sequence[str], camera: PinholeCamera, views: list[BodyView],
                    bounds_px: tuple[float, float, float, float], grid: tuple[int, int],
                    levels: Mapping[str, LevelPlan], most: float) -> tuple[np.ndarray, float]:
        """Means over cells of bodies by their facets' middles, and what they tell of their error; dark beyond a most.

        What that costs of levels of detail, and beside others' edges, is for the planner to know.
        """
        bodies = [self._lit_middles.LitMiddles(self._facets[view.name][levels[view.name].number], view, views, camera,
                                               self._rays, levels[view.name], self._kept_middles)
                  for view in views if view.name in names]
        told = max(body.error for body in bodies)
        if told > most:
            return np.zeros(grid[::-1]), told
        cells, images = _Cells(camera, bounds_px, grid), []
        for body in bodies:
            changes = self._coverage.no_changes(grid[::-1])
            body.add_to(changes, cells.corner, cells.per_px)
            # Each body's own cover: a bright one must not be dimmed by what is left of a dark one behind it.
            images.append(self._added_up(changes, cells, camera, 1.0, 1.0)[0])
        return sum(images[1:], start=images[0]), told

    def _drawn(self, names: Sequence[str], camera: PinholeCamera, views: list[BodyView],
               bounds_px: tuple[float, float, float, float], grid: tuple[int, int], budget: float,
               levels: Mapping[str, LevelPlan], has_disc: bool) -> tuple[np.ndarray, float, float]:
        """The same with hard edges of shadows, and what they cost if the Sun has a disc.

        Nothing is drawn if that is too much.
        """
        cells = _Cells(camera, bounds_px, grid)
        cut = self._cut_from_node(names, camera, views, budget, levels, has_disc)
        if cut is None:
            cut = self._cut([view for view in views if view.name in names and view.is_visible], camera, views,
                            bounds_px, budget, levels, has_disc)
        if not cut.parts:
            return np.zeros(grid[::-1]), cut.squared, cut.penumbra
        # A pixel's solid angle falls off as cos^3 of its angle from the boresight: told of facets that are far smaller.
        is_fine = cut.n_px * cells.per_px.prod() < _FINE * cut.n_areas
        changes = self._coverage.no_changes(grid[::-1])
        for add_to in cut.parts:
            add_to(changes, cells.corner, cells.per_px, 3.0 if is_fine else 0.0)
        # Where areas overlap, one that is hidden was taken to be seen: which of them is not known.
        excess = _EXCESS if self._is_one_surface else 1.0
        means, unsure = self._added_up(changes, cells, camera, 1.0 + _OVERLAP, excess, is_even=is_fine)
        squared = cut.squared + unsure / cells.per_px.prod() ** 2
        return means, math.hypot(cut.per_root * math.sqrt(squared), _LEAST), cut.penumbra

    def _cut(self, members: Sequence[BodyView], camera: PinholeCamera, views: list[BodyView],
             bounds_px: tuple[float, float, float, float], budget: float, levels: Mapping[str, LevelPlan],
             has_disc: bool) -> _Cut:
        """The sunlit areas of bodies, as far as the image shows them."""
        areas = [self._sunlit_areas.SunlitAreas(self._facets[view.name][level.number], view, views, camera, bounds_px,
                                                self._rays, level)
                 for view, level in ((view, levels.get(view.name, LevelPlan())) for view in members)]
        light, n_px = sum(body.light for body in areas), sum(body.area_px for body in areas)
        if not light > 0.0:
            # Light between corners that are all dark is for others to find.
            return _Cut(squared=math.inf if any(body.has_facing for body in areas) else 0.0)
        # Of the root of a sum of squares: RMS over the lit pixels over their mean, or ten times the flux.
        slivers = sliver_gain(max(view.phase_rad for view in members))
        per_root = slivers * max(math.sqrt(n_px), _FLUX) / light
        most = max(budget**2 - _LEAST**2, 0.0) / per_root**2
        # By pixels alone, whatever the root is times: they take no flux, and what crescents lose is the planner's.
        penumbras = sum(body.penumbra() for body in areas) * min(n_px / _FLUX**2, 1.0) if has_disc else 0.0
        penumbra = per_root * math.sqrt(penumbras)
        if penumbra > PENUMBRA_SHARE * budget:
            return _Cut(squared=math.inf, penumbra=penumbra)
        flux_weight = (_FLUX / (per_root * light)) ** 2
        squared = penumbras + sum(body.refine(_AIM * (most - penumbras) / len(areas), flux_weight) for body in areas)
        if math.isinf(squared):
            return _Cut(squared=squared, penumbra=penumbra)
        return _Cut(squared=squared, penumbra=penumbra, per_root=per_root, n_px=n_px,
                    n_areas=sum(body.n_areas for body in areas), bodies=tuple(areas),
                    parts=tuple(body.add_to for body in areas))

    def _cut_from_node(self, names: Sequence[str], camera: PinholeCamera, views: list[BodyView], budget: float,
                       levels: Mapping[str, LevelPlan], has_disc: bool) -> _Cut | None:
        """The same of a large shape that is alone, from the nearest node of Sun and camera; None of others."""
        view, level = views[0], levels.get(names[0], LevelPlan())
        facets = self._facets[names[0]][level.number]
        radius_m = facets.solid.radius_m
        is_alone = len(views) == 1 and view.is_whole and view.cos_off_axis > _LEAST_COS
        if (self._kept_cuts is None or not is_alone or not is_kept(facets.n_facets, view, radius_m)
                or view.range_m < _NEAREST * radius_m or budget < _LEAST_KEPT
                or view.phase_rad + radius_m / view.range_m > _KEPT_RAD):
            return None
        at_most = 2.0 ** (math.floor(math.log2(math.sqrt(budget**2 - _NODE_ERROR**2)) * _BUDGETS) / _BUDGETS)

        def make(node: BodyView) -> _Cut:
            everywhere = -math.inf, -math.inf, math.inf, math.inf
            cut = self._cut([node], camera_at_node(camera.focal_length_px), [node], everywhere, at_most,
                            {names[0]: replace(level, flux_ratio=1.0)}, has_disc)
            return replace(cut, bodies=tuple(self._lit_triangles.LitTriangles(*body.triangles(), facets, node)
                                             for body in cut.bodies), parts=())

        node, cut = self._kept_cuts.at(view, radius_m, (facets, level.has_relief, camera.focal_length_px, at_most,
                                                        has_disc), make)
        # What is too little for this budget may do for the one that was asked.
        if math.isinf(cut.squared):
            return None
        if not cut.bodies:
            return cut
        brightness = level.flux_ratio * (node.sun_distance_au / view.sun_distance_au) ** 2
        # Triangles do not: pixels have the solid angles of their middles.
        return replace(cut, squared=cut.squared + (_NODE_ERROR / cut.per_root) ** 2, n_areas=0,
                       parts=tuple(partial(body.add_to, view, camera, brightness) for body in cut.bodies))

    def _added_up(self, changes: np.ndarray, cells: _Cells, camera: PinholeCamera, most_cover: float,
                  least_share: float, is_even: bool = False) -> tuple[np.ndarray, float]:
        """Means over cells (rows, columns), and what is unsure where areas overlap: `coverage.settle`.

        Of changes in radiance, or, if pixels are taken to have even solid angles, times a power of the cosine.
        """
        coverage = self._coverage
        image, cover = np.empty((2, len(changes), changes.shape[1] - 2))
        across, down = ((np.zeros_like(each) for each in cells.squared) if is_even else cells.squared)
        scale = self._scene.solar_irradiance_of(camera) / camera.focal_length_px**2

        least = coverage.ROUNDING * max(threads.run_in_parts(
            lambda part: coverage.means(changes, part.start, part.stop, image, cover), len(image), _ROWS))
        unsure = threads.run_in_parts(
            lambda part: coverage.settle(image, cover, part.start, part.stop, least, scale, across, down, most_cover,
                                         least_share), len(image), _ROWS)
        return image, sum(unsure)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Cut:
    """Sunlit areas that are cut as a budget asks: none where nothing is lit, or where rays have to look.

    Attributes
    ----------
    squared : float
        Squared error of the pixels, in units of radiance squared; infinite where rays have to look.
    penumbra : float [1]
        What hard edges of shadows cost.
    per_root : float
        Error over the root of the squared one.
    n_px, n_areas : float, int
        What they cover [px2], and how many there are that take a power of the cosine off the boresight.
    bodies : tuple
        The areas of each body.
    parts : tuple of callable
        What add those to an image.
    """

    squared: float
    penumbra: float = 0.0
    per_root: float = 0.0
    n_px: float = 0.0
    n_areas: int = 0
    bodies: tuple = ()
    parts: tuple = ()

    @property
    def n_bytes(self) -> int:
        return sum(body.n_bytes for body in self.bodies)


class _Cells:
    """Cells of a grid in a camera's image: where the first one begins (2,) [px], and how many are in a pixel (2,)."""

    def __init__(self, camera: PinholeCamera, bounds_px: tuple[float, float, float, float], grid: tuple[int, int]):
        self._camera, self._grid = camera, grid
        self.corner, far = np.reshape(np.array(bounds_px, float), (2, 2))
        self.per_px = np.array(grid) / (far - self.corner)

    @property
    def squared(self) -> list[np.ndarray]:
        """Squares of the tangents of angles off the boresight, of the cells' middles across (C,) and down (R,).

        A pixel's solid angle is (1 + both)^-1.5 of that on the boresight.
        """
        camera = self._camera
        return [np.square((self.corner[k] + (np.arange(self._grid[k]) + 0.5) / self.per_px[k]
                           - camera.principal_point_px[k]) / camera.focal_length_px) for k in range(2)]


def _is_one_surface(shape: Shape) -> bool:
    """Whether a shape is closed, of one shell, with two facets at each edge."""
    report = shape.report
    return report.is_watertight and report.n_shells == 1


def _on_disc(n_points: int) -> np.ndarray:
    """Points (K, 2) of a disc of radius 1: Vogel's spiral (1979), about its own middle."""
    k = np.arange(n_points)
    turn = k * np.pi * (3.0 - math.sqrt(5.0))
    points = np.sqrt((k + 0.5) / n_points) * np.array([np.cos(turn), np.sin(turn)])
    return (points - points.mean(axis=1, keepdims=True)).T


def _lit_from(views: list[BodyView], point: np.ndarray) -> list[BodyView]:
    """Views that are lit from a point (2,) of the Sun's disc of radius 1."""
    across = sun_from_body(views[0].camera_from_body @ views[0].sun_direction_body)[:2].T @ point
    lit = []
    for view in views:
        towards = view.sun_direction_body + view.camera_from_body.T @ across * view.sun_radius_rad
        lit.append(replace(view, sun_direction_body=towards / np.linalg.norm(towards)))
    return lit
