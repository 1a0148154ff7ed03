"""The gradient of a weighted sum of a frame's pixels with respect to a body's shape and albedo, in one pass.

It follows the lines of the frame as its derivatives do, the other way: from the weights of the cells that a line
crosses to the places of its ends, and from these to vertices: of the facet that they lie on, and of the facet that
shades or hides what lies beyond a cut.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from glrender_camera import PinholeCamera

from ...base.errors import ConfigError
from ...brdf import Lambert
from ...planner.account import Drawn
from ...scene.scene import Scene
from ...scene.shape.shape import Shape
from ...view.view import BodyView
from ..coverage.facet_tables import FacetTables
from ..coverage.image_cells import ImageCells
from ..coverage.sub_triangles import projected
from ..coverage.sunlit_areas import SunlitAreas
from ..raster.surface_pass import Frame
from ..rays.engine import RayEngine
from ..rays.mesh import cross, dot
from . import loops
from .moving_lines import LEAST_COSINE, Cuts, in_camera
from .radiance_rates import Shading

Weights = np.ndarray | Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, kw_only=True, eq=False)
class ShapeGradient:
    """Derivatives of a weighted sum of pixels by one body's shape and albedo, in the sum's unit.

    Attributes
    ----------
    vertices_m : (V, 3) float64 [1/m]
        By the shape's vertices, in the body's frame.
    heights_m : (V,) float64 [1/m]
        By their heights along the shape's vertex normals.
    albedo : (F,) float64 [1]
        By a factor on the light of each facet, which is 1.
    """

    vertices_m: np.ndarray
    heights_m: np.ndarray
    albedo: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class Gradient(Mapping[str, ShapeGradient]):
    """Derivatives of the sum of weights times a frame's irradiance, by each body's name.

    Attributes
    ----------
    irradiance_W_m2 : (height, width) float32 [W/m2]
        The frame.
    bodies : dict of str to ShapeGradient
    """

    irradiance_W_m2: np.ndarray
    bodies: dict[str, ShapeGradient]

    def __getitem__(self, name: str) -> ShapeGradient:
        return self.bodies[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.bodies)

    def __len__(self) -> int:
        return len(self.bodies)


def checked_weights(weights: Any, shape: tuple[int, int]) -> np.ndarray:
    """Weights (height, width) float64 of an image's pixels.

    Raises
    ------
    ConfigError
        Of another shape, or not finite.
    """
    try:
        if (weights := np.asarray(weights)).dtype.kind not in "biuf":
            raise TypeError
        weights = weights.astype(np.float64, copy=False)
    except (TypeError, ValueError):
        raise ConfigError("weights", f"must be numbers of shape {shape}", weights) from None
    if weights.shape != shape:
        raise ConfigError("weights", f"must be of the image's shape {shape}", weights.shape)
    if not np.isfinite(weights).all():
        row, column = np.argwhere(~np.isfinite(weights))[0]
        raise ConfigError(f"weights[{row}, {column}]", "must be finite", float(weights[row, column]))
    return weights


def gradient_of(weights: Weights, drawn: Drawn, frame: Frame, rays: RayEngine) -> Gradient:
    """The gradient of a drawn frame's pixels, by checked weights (height, width), or by what makes some of it."""
    light_W_m2, scene = drawn.irradiance_W_m2, rays.scene
    if callable(weights):
        weights = checked_weights(weights(light_W_m2), light_W_m2.shape)
    found = {body.name: _Body(body.drawn_shape) for body in scene.bodies}
    for window, (by_points, _) in zip(drawn.windows, drawn.areas, strict=True):
        left, top, right, bottom = window.roi
        cells = ImageCells(frame.camera, window.bounds_px, window.grid)
        scaled = weights[top:bottom, left:right] * (_scales(cells, scene) / max(len(by_points), 1))
        sums = np.zeros((bottom - top, right - left + 1))
        sums[:, :-1] = np.cumsum(scaled[:, ::-1], axis=1)[:, ::-1]
        for areas in (one for of_point in by_points for one in of_point):
            found[areas.seen.view.name].add(areas, scaled, sums, cells, list(frame.views), rays)
    return Gradient(irradiance_W_m2=light_W_m2, bodies={name: body.gradient() for name, body in found.items()})


def _scales(cells: ImageCells, scene: Scene) -> np.ndarray:
    """Irradiance (rows, columns) [W/m2] of pixels full of a radiance of one Sun's irradiance at 1 au."""
    across, down = cells.tangents_squared
    scale, slant = scene.solar_irradiance_of(cells.camera), 1.0 + across + down[:, None]
    scale /= cells.camera.focal_length_px**2
    return scale / (slant * np.sqrt(slant))


class _Body:
    """Sums of the derivatives by one body's vertices (V, 3) and by the light of its facets (F,)."""

    def __init__(self, shape: Shape):
        self._shape, self._vertices_m = shape, np.zeros_like(shape.vertices_m)
        self._albedo = np.zeros(len(shape.facets))

    def gradient(self) -> ShapeGradient:
        return ShapeGradient(vertices_m=self._vertices_m, albedo=self._albedo,
                             heights_m=dot(self._vertices_m.T, self._shape.vertex_normals.T))

    def add(self, areas: SunlitAreas, weights: np.ndarray, right: np.ndarray, cells: ImageCells,
            views: list[BodyView], rays: RayEngine) -> None:
        """Add what areas have, by the weights (rows, columns) of their pixels, and sums of these along the rows."""
        seen, facets, view, camera = areas.seen, areas.seen.facets, areas.seen.view, cells.camera
        drawn = areas.facets()
        radiance, of_radiance = np.zeros((2, facets.n_facets))
        radiance[drawn] = seen.radiance.of(drawn)
        whole = np.zeros_like(radiance)
        whole[areas.whole] = radiance[areas.whole]
        of_places = np.zeros_like(seen.xy_px)
        loops.facets_gradient(weights, right, seen.xy_px, facets.corners, facets.neighbours, whole, *cells.origin_px,
                              of_places, of_radiance)
        by_vertex = _lifted(of_places, facets.vertices_m, view, camera)
        points_m = seen.cutter.points.r_m
        points_xy, of_places = projected(points_m, view, camera), np.zeros((2, points_m.shape[1]))
        lies_on = np.full(points_m.shape[1], -1)
        for corner, facet in areas.polygons:
            lies_on[corner] = facet
            loops.polygons_gradient(weights, right, points_xy, corner, facet, radiance, *cells.origin_px, of_places,
                                    of_radiance)
        used = np.flatnonzero(lies_on >= 0)
        of_points = _lifted(of_places.take(used, axis=1), points_m.take(used, axis=1), view, camera)
        _spread(by_vertex, of_points, points_m.take(used, axis=1), lies_on[used], facets)
        _add_cuts(by_vertex, Cuts.of(areas, rays, views, True), radiance, weights, right, cells, facets, view)
        _add_radiance(by_vertex, of_radiance.take(drawn), drawn, radiance.take(drawn), facets, view)
        self._vertices_m[facets.vertex_number] += by_vertex.T
        self._albedo[facets.number] += of_radiance * radiance


def _add_cuts(by_vertex: np.ndarray, cuts: Cuts, radiance: np.ndarray, weights: np.ndarray, right: np.ndarray,
              cells: ImageCells, facets: FacetTables, view: BodyView) -> None:
    """Add derivatives by vertices (3, V) of cuts: how they move more than the places on the body where they are."""
    steps, of_places = radiance[cuts.facet[:len(cuts.facet) // 2]], np.zeros((2, len(cuts.facet)))
    loops.cuts_gradient(weights, right, projected(cuts.r_m, view, cells.camera), steps, *cells.origin_px, of_places)
    table = np.empty(facets.n_facets, np.intp)
    table[facets.number] = np.arange(facets.n_facets)
    made = np.flatnonzero(cuts.by >= 0)
    is_hidden = np.isfinite(cuts.hides_m.take(made))
    at_m, facet, by = cuts.r_m.take(made, axis=1), cuts.facet.take(made), table.take(cuts.by.take(made))
    of_place = _lifted(of_places.take(made, axis=1), at_m, view, cells.camera)
    way_m = view.r_camera_body_m[:, None] - at_m
    towards = np.where(is_hidden, way_m / np.sqrt(dot(way_m, way_m)), view.sun_direction_body[:, None])
    by_m = at_m + towards * np.where(is_hidden, cuts.hides_m.take(made), cuts.shades_m.take(made))
    # What hides moves the cut as it moves itself in the image; what shades moves the shadow along the plane.
    of_hidden = _lifted(of_places.take(made, axis=1), by_m, view, cells.camera)
    normal, to_sun = facets.normal.take(facet, axis=1), view.sun_direction_body[:, None]
    cosine = np.maximum(dot(normal, to_sun), LEAST_COSINE)
    of_shaded = of_place - normal * (dot(to_sun, of_place) / cosine)
    _spread(by_vertex, np.where(is_hidden, of_hidden, of_shaded), by_m, by, facets)
    _spread(by_vertex, -np.where(is_hidden, of_place, of_shaded), at_m, facet, facets)


def _add_radiance(by_vertex: np.ndarray, of_radiance: np.ndarray, facet: np.ndarray, radiance: np.ndarray,
                  facets: FacetTables, view: BodyView) -> None:
    """Add derivatives by vertices (3, V) of the radiance of facets (N,): their normals turn, their middles move."""
    shading = Shading(facets, view, facet, radiance)
    of_normal, normal, corner_m = of_radiance * shading.by_normal(), facets.normal.take(facet, axis=1), facets.corner_m(
        facet)
    of_middle = np.zeros_like(of_normal)
    if not isinstance(shading.law, Lambert):
        of_middle = -of_radiance * shading.by_camera() / 3.0
    twice_m2 = dot(normal, cross(corner_m[1] - corner_m[0], corner_m[2] - corner_m[0]))
    for k in range(3):
        # A corner that rises tilts the normal away from it, by the slope of its share of the facet.
        slope = cross(normal, corner_m[(k + 2) % 3] - corner_m[(k + 1) % 3]) / twice_m2
        _scatter(by_vertex, of_middle - normal * dot(slope, of_normal), facets.corners[k].take(facet))


def _lifted(of_places: np.ndarray, r_body_m: np.ndarray, view: BodyView, camera: PinholeCamera) -> np.ndarray:
    """Derivatives (3, N) [1/m] by points (3, N) [m] in the body's frame, of those by their places (2, N) [px]."""
    x, y, z = in_camera(r_body_m, view)
    per_m = camera.focal_length_px / z
    along = -(x * of_places[0] + y * of_places[1]) / z
    return np.einsum("ij,ik->jk", view.camera_from_body, np.stack([of_places[0], of_places[1], along]) * per_m)


def _spread(by_vertex: np.ndarray, of_points: np.ndarray, r_m: np.ndarray, facet: np.ndarray, facets: FacetTables
            ) -> None:
    """Add derivatives (3, N) by points (3, N) [m] that lie on facets (N,) to those by the facets' corners."""
    corner_m = facets.corner_m(facet)
    across = cross(corner_m[1] - corner_m[0], corner_m[2] - corner_m[0])
    squared = dot(across, across)
    # Rays that graze a facet meet it beyond its corners.
    shares = np.stack([dot(across, cross(corner_m[(k + 1) % 3] - r_m, corner_m[(k + 2) % 3] - r_m)) / squared
                       for k in range(3)]).clip(0.0, 1.0)
    shares /= shares.sum(axis=0)
    for k in range(3):
        _scatter(by_vertex, shares[k] * of_points, facets.corners[k].take(facet))


def _scatter(by_vertex: np.ndarray, values: np.ndarray, vertex: np.ndarray) -> None:
    """Add values (3, N) to those of vertices (N,) among (3, V)."""
    for axis in range(3):
        by_vertex[axis] += np.bincount(vertex, values[axis], by_vertex.shape[1])
