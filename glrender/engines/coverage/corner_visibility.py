"""The facets of a body that face camera and Sun, sorted by rays at their corners: whole, boundary, dark."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from glrender_camera import threads

from ...view.view import BodyView, between
from ..rays.engine import RayEngine
from ..rays.mesh import dot
from . import facet_loops, sunlit_error
from .boundary_clip import FacetCutter
from .facet_radiance import FacetRadiance
from .facet_tables import FacetTables
from .image_cells import ImageCells
from .sub_triangles import FACETS_AT_ONCE, FacetParts, projected

# Facets of a body that are few.
FEW = 3000


class HardEdges(NamedTuple):
    """The parts of a body that hard edges of shadows cross, in place of penumbras."""

    parts: FacetParts
    squared: np.ndarray
    """Squared errors (N,) of the parts: `sunlit_error.hard_edges`."""
    wide_px: float
    """Mean width of the penumbras [px]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CornerVisibility:
    """The facets of one body that face camera and Sun in one frame, by what rays show of their corners.

    Attributes
    ----------
    facets : FacetTables
    view : BodyView
    xy_px : (2, V) float64 [px]
        Places of the facets' vertices.
    radiance : FacetRadiance
    cutter : FacetCutter
    facing : (N,) int
        Facets that face camera and Sun and are not divided.
    corner : (3, N) int
        Their corners, among the cutter's points.
    whole : (W,) int
        Those all of whose corners are lit.
    boundary : FacetParts
        Those of which some are, and parts of divided facets likewise.
    uniform : FacetParts
        Parts of divided facets whose corners agree.
    may_hide_light : (F,) bool
        Facets all of whose corners are dark, of which the camera sees some.
    light : float
        Light of all, in units of radiance times pixels, about.
    area_px : float [px2]
        Area of those in light, about.
    set_px : float [px2]
        Area of facets that face the camera, and for which the Sun's middle has set by less than its radius.
    is_alone : bool
        The scene has no other body.
    may_stand_before : bool
        Another body, smaller than facets, may be between this one and the Sun or the camera.
    safety_squared : float [1]
        Squared safety factor of errors that are estimated from the boundary's light.
    """

    facets: FacetTables
    view: BodyView
    xy_px: np.ndarray
    radiance: FacetRadiance
    cutter: FacetCutter
    facing: np.ndarray
    corner: np.ndarray
    whole: np.ndarray
    boundary: FacetParts
    uniform: FacetParts
    may_hide_light: np.ndarray
    light: float
    area_px: float
    set_px: float
    is_alone: bool
    may_stand_before: bool
    safety_squared: float

    @property
    def n_areas(self) -> int:
        """Facets in light."""
        return len(self.whole) + len(self.boundary.facet)

    @property
    def has_facing(self) -> bool:
        """Whether any facet faces the camera, and any of the Sun's disc."""
        return bool(len(self.facing) or self.set_px)

    @property
    def brightest(self) -> float:
        """Radiance of the brightest facet in light."""
        return float(self.radiance.of(np.concatenate([self.whole, self.boundary.facet])).max(initial=0.0))

    def facet_px(self, facet: np.ndarray) -> np.ndarray:
        """Areas (N,) of facets in the image [px2]."""
        return facet_loops.areas(self.xy_px, self.facets.corners, facet)

    def parts_of(self, chosen: np.ndarray) -> FacetParts:
        """Whole facets, by their numbers (N,) among those that face camera and Sun."""
        facet = self.facing.take(chosen)
        return FacetParts(self.corner.take(chosen, axis=1), facet, self.facet_px(facet))

    def whole_facets(self) -> tuple[FacetParts, np.ndarray]:
        """Facets that no boundary crosses, and whether each (N,) touches one that a boundary crosses."""
        facets = self.facets
        is_boundary, touched = np.zeros(facets.n_facets, bool), np.zeros(facets.vertices_m.shape[1], bool)
        is_boundary[self.boundary.facet] = True
        touched[facets.corners[:, is_boundary]] = True
        chosen = np.flatnonzero(~is_boundary.take(self.facing))
        is_next = touched.take(facets.corners.take(self.facing.take(chosen), axis=1)).any(axis=0)
        return self.parts_of(chosen), is_next

    def beside_boundary(self) -> FacetParts:
        """Facets that touch those that a boundary crosses."""
        parts, is_next = self.whole_facets()
        return parts.at(np.flatnonzero(is_next))

    def squared_light(self, parts: FacetParts) -> np.ndarray:
        """Squared light (N,) of parts with the safety factor: errors are in proportion to it."""
        return self.safety_squared * sunlit_error.pixels_squared(self.radiance.of(parts.facet), parts.area_px)

    def hard_edges(self, rays: RayEngine, views: list[BodyView], focal_length_px: float
                   ) -> HardEdges:
        """Parts with hard edges of shadows in place of penumbras.

        A penumbra is as wide as the Sun's angle times the distance of what shades, along the edges in facets whose
        corners differ; wider where the Sun is low.
        """
        parts, view, points = self.boundary, self.view, self.cutter.points
        is_dark = (points.is_seen & ~points.is_lit).take(parts.corner)
        chosen = np.flatnonzero(is_dark.any(axis=0))
        corner, parts = np.argmax(is_dark[:, chosen], axis=0), parts.at(chosen)
        r_body_m = points.r_m.take(parts.corner[corner, np.arange(len(chosen))], axis=1)
        range_m, _ = rays.shades(r_body_m, self.facets.number.take(parts.facet), view, views)
        depth_m = dot(view.camera_from_body[2], r_body_m - view.r_camera_body_m[:, None])
        angle = 2.0 * view.sun_radius_rad
        wide_px = (np.where(np.isfinite(range_m), range_m.clip(0.0), 0.0) * angle * focal_length_px
                   / (depth_m * np.sqrt(np.maximum(self.radiance.cos_incidence(parts.facet), angle))))
        squared = sunlit_error.hard_edges(self.radiance.of(parts.facet), parts.area_px, wide_px)
        return HardEdges(parts, squared, float((squared * wide_px).sum()) / max(float(squared.sum()), 1e-300))

    def low_sun(self) -> tuple[float, float]:
        """Squared error, and light, of facets that part of the Sun's disc lights: `sunlit_error.low_sun`."""
        facet = np.concatenate([self.whole, self.boundary.facet])
        area_px = np.concatenate([self.facet_px(self.whole), self.boundary.area_px])
        angle, cosines = self.view.sun_radius_rad, self.radiance.cos_incidence(facet)
        brdf = self.radiance.of(facet) / np.maximum(cosines, 1e-9 * angle)
        return sunlit_error.low_sun(brdf, cosines, area_px, angle, self.set_px, self.area_px)

    def in_low_sun(self) -> np.ndarray:
        """Facets (N,) that face the camera, and are lit by part of the Sun's disc."""
        facets, view = self.facets, self.view
        cosines = dot(facets.normal, view.sun_direction_body[:, None])
        return np.flatnonzero((np.abs(cosines) < view.sun_radius_rad) & facets.face(view.r_camera_body_m))


def look(facets: FacetTables, view: BodyView, views: list[BodyView], cells: ImageCells, rays: RayEngine,
         sun_radius_rad: float) -> CornerVisibility:
    """Cast rays from the corners of a body's facets.

    Parameters
    ----------
    facets : FacetTables
    view : BodyView
        All of the body is before the camera.
    views : list of BodyView
        Of all bodies.
    cells : ImageCells
        Beyond whose edges nothing is wanted.
    rays : RayEngine
    sun_radius_rad : float [rad]
        0 for a Sun without a disc.
    """
    xy_px = projected(facets.vertices_m, view, cells.camera)
    found = threads.run_in_parts(lambda part: facet_loops.facing(
        facets.normal, facets.offset_m, part.start, part.stop, view.sun_direction_body, sun_radius_rad,
        view.r_camera_body_m, xy_px, facets.corners, cells.bounds_px), facets.n_facets, FACETS_AT_ONCE)
    *found, set_px = zip(*found, strict=True)
    facing, cos_incidence, shown = (np.concatenate(each) for each in found)
    radiance = FacetRadiance(facets, view, facing, cos_incidence)
    cutter = FacetCutter(facets, view, views, rays, facing)
    corner = cutter.corner
    n_lit, n_seen = (of.take(corner).sum(axis=0) for of in (cutter.points.is_lit, cutter.points.is_seen))
    # Where the camera sees one end of a facet in shadow, the Sun may see the other, and both the part between.
    may_hide_light = np.zeros(facets.n_facets, bool)
    may_hide_light[facing[(n_lit == 0) & (n_seen > 0) & (n_seen < 3) & (len(facing) <= FEW)]] = True
    mixed, lit = np.flatnonzero((n_lit > 0) & (n_lit < 3)), np.flatnonzero(n_lit == 3)
    whole = facing[lit]
    boundary = FacetParts(corner.take(mixed, axis=1), facing[mixed],
                          facet_loops.areas(xy_px, facets.corners, facing[mixed]))
    area_px = np.concatenate([facet_loops.areas(xy_px, facets.corners, whole) * shown.take(lit),
                              boundary.area_px * n_lit.take(mixed) / 3.0 * shown.take(mixed)])
    # In one call, as threads share the call; no product of matrices, since BLAS keeps threads of its own spinning,
    # which takes the time of others' frames.
    light = float((area_px * radiance.of(np.concatenate([whole, boundary.facet]))).sum())
    return CornerVisibility(
        facets=facets, view=view, xy_px=xy_px, radiance=radiance, cutter=cutter, facing=facing, corner=corner,
        whole=whole, boundary=boundary, uniform=FacetParts.none(), may_hide_light=may_hide_light, light=light,
        area_px=float(area_px.sum()), set_px=sum(set_px), is_alone=len(views) == 1, may_stand_before=any(
            _may_stand_before(other, view, facets, rays) for other in views if other is not view),
        safety_squared=sunlit_error.safety_squared(sunlit_error.pixels_squared(
            radiance.of(boundary.facet), boundary.area_px)))


def _may_stand_before(other: BodyView, view: BodyView, facets: FacetTables, rays: RayEngine) -> bool:
    """Whether another body is smaller than facets, and may be between them and the Sun or the camera."""
    radius_m = rays.solid(other.name).radius_m
    if radius_m > facets.longest_side_m:
        return False
    place_m, reach_m = between(other, view)[1], facets.solid.radius_m + radius_m
    ways = (view.sun_direction_body, view.r_camera_body_m / view.range_m)
    return any(place_m @ way > -reach_m and np.linalg.norm(np.cross(place_m, way)) < reach_m for way in ways)
