"""This module finds the visible, sunlit part of a body's facets, and estimates the error of what it finds.

Rays decide at the facets' corners. Between corners that differ runs the edge of a shadow, or of what hides the rest,
which is nearly straight within a small triangle: such facets are divided where the error asks for it, then clipped.
"""

from __future__ import annotations

import math

import numpy as np
from glrender_camera import PinholeCamera, threads

from ...planner.error_budget import HIDDEN_SHARE, MISSED_SHARE, STILL_MISSED_SHARE, UNDIVIDED_SHARE
from ...view.view import BodyView, between
from ..rays.engine import RayEngine
from ..rays.mesh import dot
from . import accumulate, facet_loops
from .boundary_clip import FacetCutter
from .facet_tables import FacetTables
from .sub_triangles import FACETS_AT_ONCE, FacetParts, projected

# Errors are estimated from the light of triangles that are clipped: 35 low-poly and 12 finer shapes at 20 to 160 deg
# beside rays (test_coverage_engine.py, benchmarks/heldout.py).
_BISECTIONS = 2
# Squared error of a clipped triangle over its squared light [1].
_CLIPPED_ERROR = 0.0265
# Share [1] of their light that clipped triangles are too dark by, at 60 deg.
_CLIPPED_BIAS = 0.003
# Safety factor [1] of the estimate: of many clipped triangles, what it has more over the root of their number, at most.
_SAFETY = 0.5
_SAFETY_OF_FEW = 8.0
_MOST_SAFETY = 3.0
# Squared error of boundaries that pass between corners that agree, over squared light of clipped triangles [1] up to
# 60 deg, per radian between neighbouring facets, of this much at least: 100 frames of seven shapes beside rays.
_MISSED_PER_RAD = 5e-3
_LEAST_CREASE_RAD = 0.2
# The part of it that is left where the facets beside boundary ones are divided too [1]; and the angle between
# neighbours [rad] from which they are: bumps are then as small as facets, and 67P, with 0.5, errs half as much at the
# same time. Itokawa has 0.15.
_STILL_MISSED = 0.36
_ROUGH_RAD = 0.3
# The part that each division more leaves of that [1], the most divisions, and the most parts: 12 frames at tolerances
# of 0.004 to 0.01 beside rays; 1 s.
_STILL_MISSED_LATER = 0.5
_MOST_BESIDE = 3
_MOST_PARTS = 2_500_000
# Share of the squared light of the brightest facet that another body may take between its corners unseen [1].
_MISSED_BEHIND = 0.1
# Squared light of a facet over the squared tolerance from which it is divided first [1]: of few facets, and of many.
_LARGE = 0.15
_LARGE_OF_MANY = 20.0
# Most divisions of a triangle by four.
_MOST_DIVISIONS = 6
# Facets that are few, and triangles that are too many to be divided again.
_FEW = 3000
_MANY = 120_000
# Mean [1] of max(0, u + t) over the Sun's disc and over u from -1 to 0, in units of the Sun's radius: closed form.
_MEAN_SET = 0.0625
# RMS error of a hard edge over that of the ramp in its place [1]: Itokawa at 60 and 120 deg (test_penumbra.py).
_PENUMBRA = 0.65


class SunlitAreas:
    """The sunlit areas of one body that a camera sees, and their radiance.

    Parameters
    ----------
    facets : FacetTables
    view : BodyView
        All of the body is before the camera.
    views : list of BodyView
        Of all bodies.
    camera : PinholeCamera
    bounds_px : (float, float, float, float) [px]
        Beside which nothing is wanted.
    rays : RayEngine
    has_disc : bool
        Whether the Sun has one.
    """

    def __init__(self, facets: FacetTables, view: BodyView, views: list[BodyView], camera: PinholeCamera,
                 bounds_px: tuple[float, float, float, float], rays: RayEngine, has_disc: bool):
        self._facets, self._view, self._views, self._camera, self._rays = facets, view, views, camera, rays
        self._xy = projected(facets.vertices_m, view, camera)
        facing, cos_incidence, shown = self._find_facing(np.array(bounds_px, float),
                                                         view.sun_radius_rad if has_disc else 0.0)
        self._radiance, self._off_axis, self._cos_incidence = np.zeros((3, facets.n_facets))
        self._cos_incidence[facing] = cos_incidence
        # Parts of divided facets whose corners agree.
        self._uniform = FacetParts(np.zeros((3, 0), np.intp), np.zeros(0, np.intp), np.zeros(0))
        self._cutter = FacetCutter(facets, view, views, rays, facing)
        self._facing, self._corner = facing, self._cutter.corner
        n_lit, n_seen = (of.take(self._corner).sum(axis=0) for of in (self._cutter.points.is_lit,
                                                                      self._cutter.points.is_seen))
        # Where the camera sees one end of a facet in shadow, the Sun may see the other, and both what is between.
        self._may_hide_light = np.zeros(facets.n_facets, bool)
        self._may_hide_light[facing[(n_lit == 0) & (n_seen > 0) & (n_seen < 3) & (len(facing) <= _FEW)]] = True
        boundary = np.flatnonzero((n_lit > 0) & (n_lit < 3))
        whole = np.flatnonzero(n_lit == 3)
        self._whole = facing[whole]
        self._shade(facing[n_lit > 0])
        self._boundary = self._of_facets(boundary)
        facet = np.concatenate([self._whole, self._boundary.facet])
        area_px = np.concatenate([self._facet_px(self._whole), self._boundary.area_px * n_lit.take(boundary) / 3.0])
        area_px *= np.concatenate([shown.take(whole), shown.take(boundary)])
        self.area_px, self.n_areas, self.has_facing = float(area_px.sum()), len(area_px), bool(
            len(facing) or self._set_px)
        # No product of matrices here: BLAS keeps threads of its own spinning, which takes the time of others' frames.
        self.light = float((area_px * self._radiance[facet]).sum())
        self._safety_squared = 1.0
        self._safety_squared = _safety(self._squared(self._boundary)) ** 2

    def refine(self, most_squared: float, flux_weight: float) -> float:
        """Clip facets, and divide them before, until the estimated squared error of all pixels is small enough.

        Parameters
        ----------
        most_squared : float
            The largest sum of squared errors, in units of radiance squared times pixels.
        flux_weight : float
            Weight of the squared error of the total light in that sum.

        Returns
        -------
        float
            The estimated sum; infinite, and nothing is clipped, if too much light is in too few facets.
        """
        if not self._divide_large(most_squared):
            return math.inf
        error = self._clip(most_squared, flux_weight)
        self._cutter.keep_lit(self._uniform)
        return error

    def _find_facing(self, bounds_px: np.ndarray, sun_radius_rad: float) -> tuple[np.ndarray, ...]:
        """Facets (N,) that face camera and Sun, cosines (N,) of incidence, and the share (N,) that is shown, about."""
        facets, view = self._facets, self._view
        found = threads.run_in_parts(lambda part: facet_loops.facing(
            facets.normal, facets.offset_m, part.start, part.stop, view.sun_direction_body, sun_radius_rad,
            view.r_camera_body_m, self._xy, facets.corners, bounds_px), facets.n_facets, FACETS_AT_ONCE)
        *found, set_px = zip(*found, strict=True)
        self._set_px = sum(set_px)
        return tuple(np.concatenate(each) for each in found)

    def _clip(self, most_squared: float, flux_weight: float) -> float:
        """Clip triangles that are partly visible and sunlit, divided before as far as the tolerance asks for it."""
        triangles = self._boundary
        squared = float(self._squared(triangles).sum())
        bias = _CLIPPED_BIAS * float((self._radiance.take(triangles.facet) * triangles.area_px).sum())
        missed, behind = self._missed(squared / self._safety_squared), self._missed_behind()
        error = _CLIPPED_ERROR * squared + missed + behind + flux_weight * bias**2
        if error > most_squared:
            is_rough = self._facets.crease_rad > _ROUGH_RAD
            if len(self._views) > 1 or is_rough or missed > MISSED_SHARE * most_squared:
                triangles, missed = self._with_beside(triangles, missed, STILL_MISSED_SHARE * most_squared - behind)
            triangles, error = self._divide(triangles, missed + behind, most_squared)
        self._cutter.cut_off(triangles, _BISECTIONS)
        return error

    def _with_beside(self, triangles: FacetParts, missed: float, most_left: float) -> tuple[FacetParts, float]:
        """Mixed parts of boundary triangles and of the facets beside them, and what is still missed: boundaries bend.

        The facets beside are divided once, and both again until no more is left than may be, or parts are too many.
        """
        facets, facing = self._facets, self._facing
        is_boundary, touched = np.zeros(facets.n_facets, bool), np.zeros(facets.vertices_m.shape[1], bool)
        is_boundary[triangles.facet] = True
        touched[facets.corners[:, is_boundary]] = True
        beside = self._of_facets(np.flatnonzero(~is_boundary.take(facing) & touched.take(
            facets.corners.take(facing, axis=1)).any(axis=0)))
        self._whole = np.setdiff1d(self._whole, beside.facet)
        self._shade(beside.facet)
        beside, missed = self._cutter.quarters(beside), _STILL_MISSED * missed
        for _ in range(_MOST_BESIDE - 1):
            if missed <= most_left or 4 * (len(triangles.facet) + len(beside.facet)) > _MOST_PARTS:
                break
            triangles, beside = self._cutter.quarters(triangles), self._cutter.quarters(beside)
            missed *= _STILL_MISSED_LATER
        return self._cutter.keep_even(FacetParts.joined([triangles, beside])), missed

    def _divide(self, triangles: FacetParts, missed: float, most_squared: float) -> tuple[FacetParts, float]:
        """Divide triangles until clipping them, with what is missed, errs by no more than a square; and their error."""
        left, error = [], missed
        allowed = missed if missed > most_squared else most_squared - missed
        for _ in range(_MOST_DIVISIONS):
            squared = _CLIPPED_ERROR * self._squared(triangles)
            if squared.sum() <= allowed:
                break
            # The dimmest ones stay as they are.
            order = np.argsort(squared)
            n_left = int(np.searchsorted(np.cumsum(squared[order]), UNDIVIDED_SHARE * allowed))
            left.append(triangles.at(order[:n_left]))
            rest = float(squared[order[:n_left]].sum())
            error, allowed = error + rest, allowed - rest
            triangles = self._cutter.keep_even(self._cutter.quarters(triangles.at(order[n_left:])))
        error += _CLIPPED_ERROR * float(self._squared(triangles).sum())
        return FacetParts.joined([*left, triangles]), error

    def penumbra(self) -> float:
        """Squared error of hard edges of shadows in place of penumbras, in units of radiance squared.

        A ramp as wide as the Sun's angle times the distance of what shades, along the edges in facets whose corners
        differ; wider where the Sun is low. Within a pixel it has the light of a hard edge, and errs where the
        pixels' sides cross it: the mean over how they lie, as one that lies along a ramp may cross all of it. To be
        asked for before anything is cut.
        """
        parts, view, points = self._boundary, self._view, self._cutter.points
        is_dark = (points.is_seen & ~points.is_lit).take(parts.corner)
        chosen = np.flatnonzero(is_dark.any(axis=0))
        corner = np.argmax(is_dark[:, chosen], axis=0)
        r_body_m, facet = points.r_m.take(parts.corner[corner, chosen], axis=1), parts.facet.take(chosen)
        range_m = self._rays.shade_ranges(r_body_m, self._facets.number.take(facet), view, self._views)
        depth_m = dot(view.camera_from_body[2], r_body_m - view.r_camera_body_m[:, None])
        angle = 2.0 * view.sun_radius_rad
        wide_px = (np.where(np.isfinite(range_m), range_m.clip(0.0), 0.0) * angle * self._camera.focal_length_px
                   / (depth_m * np.sqrt(np.maximum(self._cos_incidence.take(facet), angle))))
        squared = (self._radiance.take(facet) ** 2 * np.sqrt(parts.area_px.take(chosen))
                   * wide_px * np.minimum(wide_px, 1.0) ** 2)
        return _PENUMBRA**2 * float(squared.sum()) / 12.0

    def low_sun(self) -> tuple[float, float]:
        """Facets that part of the Sun's disc lights, drawn with a Sun without a disc: squared error, and light.

        A facet at which the Sun's middle stands as high as a share u of its radius has the mean of max(0, u + t) over
        the disc (closed form) in place of u. Those for which it has set are taken to be alike, with the mean over u.
        """
        angle, cosines = self._view.sun_radius_rad, self._cos_incidence
        facet = np.concatenate([self._whole, self._boundary.facet])
        area_px = np.concatenate([self._facet_px(self._whole), self._boundary.area_px])
        brdf = self._radiance.take(facet) / np.maximum(cosines.take(facet), 1e-9 * angle)
        set_light = self._set_px * _MEAN_SET * angle * float((brdf * area_px).sum()) / max(self.area_px, 1e-300)
        low = np.flatnonzero(cosines.take(facet) < angle)
        u, area_px = cosines.take(facet[low]) / angle, area_px.take(low)
        root = np.sqrt(np.maximum(1.0 - u * u, 0.0))
        missed = u * ((u * root + np.arcsin(np.minimum(u, 1.0))) / np.pi - 0.5) + 2.0 / (3.0 * np.pi) * root**3
        light = brdf.take(low) * angle * missed
        # Of pixels, those of both are alike.
        squared = float(_pixels_squared(light, area_px).sum()) + set_light**2 / max(self._set_px, 1.0)
        return squared, float((light * area_px).sum()) + set_light

    def add_to(self, changes: np.ndarray, origin_px: np.ndarray, per_px: np.ndarray, off_axis_power: float) -> None:
        """Add what the areas change in the cells of an image: `accumulate`.

        The real part is of radiance, in 1/sr of the Sun's irradiance at 1 au, times a power of the cosine of the
        facets' angles off the boresight; the imaginary one is of cover, which is 1 where there is any.

        Parameters
        ----------
        changes : (rows, columns + 2) complex128
        origin_px : (2,) float64 [px]
            Where the first cell begins.
        per_px : (2,) float64 [1/px]
            Cells.
        off_axis_power : float
        """
        def values(facet: np.ndarray) -> np.ndarray:
            radiance = self._radiance.take(facet)
            if off_axis_power:
                radiance *= self._off_axis.take(facet) ** off_axis_power
            return radiance

        facets = self._facets
        radiance = np.zeros(facets.n_facets)
        radiance[self._whole] = values(self._whole)
        accumulate.in_two_images(changes, len(self._whole), lambda image, *turn: accumulate.add_facets(
            image, self._xy, facets.corners, facets.neighbours, radiance, *turn, origin_px, per_px))
        points_xy = projected(self._cutter.points.r_m, self._view, self._camera)
        for corner, facet in self._cutter.polygons:
            accumulate.add_polygons(changes, points_xy, corner, values(facet) + 1j, origin_px, per_px)

    def _divide_large(self, most_squared: float) -> bool:
        """Divide facets that have more light than may be missed, few facets sooner: parts find what is between.

        Returns whether none is left.
        """
        if self._cutter.is_free:
            return True
        least = _LARGE if len(self._facing) <= _FEW else _LARGE_OF_MANY
        always = _LARGE_OF_MANY if len(self._views) == 1 else least
        of_hidden = HIDDEN_SHARE / max(int(self._may_hide_light.sum()), 1)

        def are_large(facet: np.ndarray, area_px: np.ndarray, radiance: np.ndarray | float, least: float
                      ) -> np.ndarray:
            most = np.where(self._may_hide_light.take(facet), of_hidden, least) * most_squared
            return _pixels_squared(radiance, area_px) > most

        area_px = self._facet_px(self._facing)
        large = np.flatnonzero(are_large(self._facing, area_px, float(self._radiance.max()), least))
        facet = self._facing[large]
        self._shade(facet)
        large = large[are_large(facet, area_px[large], self._radiance[facet], least)]
        if not len(large):
            return True
        is_large, parts = np.zeros(self._facets.n_facets, bool), self._of_facets(large)
        is_large[self._facing[large]] = True
        boundary = self._boundary.at(np.flatnonzero(~is_large.take(self._boundary.facet)))
        self._whole = self._whole[~is_large.take(self._whole)]
        self._facing, self._corner = (np.delete(each, large, axis=-1) for each in (self._facing, self._corner))
        small = []
        for _ in range(_MOST_DIVISIONS):
            if len(parts.facet) > _MANY:
                return False
            parts = self._cutter.quarters(parts)
            # A boundary that passes between corners that agree goes on in a part beside them whose corners differ, but
            # for those that another body, or a far part, makes in the middle of a facet.
            is_beside = np.zeros(self._cutter.points.r_m.shape[1], bool)
            for each in (parts, boundary):
                is_beside[each.corner[:, self._cutter.are_mixed(each)]] = True
            light = parts.facet, parts.area_px, self._radiance[parts.facet]
            goes_on = are_large(*light, least) & (
                is_beside.take(parts.corner).any(axis=0) | are_large(*light, always))
            small.append(parts.at(np.flatnonzero(~goes_on)))
            parts = parts.at(np.flatnonzero(goes_on))
            if not len(parts.facet):
                break
        else:
            return False
        small = FacetParts.joined(small)
        is_boundary = self._cutter.are_mixed(small)
        self._boundary = FacetParts.joined([boundary, small.at(np.flatnonzero(is_boundary))])
        self._uniform = small.at(np.flatnonzero(~is_boundary))
        return True

    def _missed(self, squared: float) -> float:
        """Squared error of boundaries that pass between corners that agree, of the squared light of clipped triangles.

        The lower the Sun, the longer are the shadows of what no corner tells of.
        """
        low_sun = max(math.tan(min(0.5 * self._view.phase_rad, 1.5)) / math.tan(math.radians(30.0)), 1.0)
        return _MISSED_PER_RAD * max(self._facets.crease_rad, _LEAST_CREASE_RAD) * low_sun * squared

    def _missed_behind(self) -> float:
        """Squared error of what other bodies that are smaller than facets may hide or shade between corners."""
        if not any(self._may_stand_before(other) for other in self._views if other is not self._view):
            return 0.0
        facet = np.concatenate([self._whole, self._uniform.facet])
        area = np.concatenate([self._facet_px(self._whole), self._uniform.area_px])
        return _MISSED_BEHIND * float(_pixels_squared(self._radiance.take(facet), area).max(initial=0.0))

    def _may_stand_before(self, other: BodyView) -> bool:
        """Whether another body is smaller than facets, and may be between this one and the Sun or the camera."""
        radius_m, view = self._rays.solid(other.name).radius_m, self._view
        if radius_m > self._facets.longest_side_m:
            return False
        place_m, reach_m = between(other, view)[1], self._facets.solid.radius_m + radius_m
        ways = (view.sun_direction_body, view.r_camera_body_m / view.range_m)
        return any(place_m @ way > -reach_m and np.linalg.norm(np.cross(place_m, way)) < reach_m for way in ways)

    def _shade(self, facet: np.ndarray) -> None:
        """Evaluate the radiance at the centroids of facets (N,): in 1/sr of the Sun's irradiance at 1 au."""
        facets, surface, view = self._facets, self._facets.surface, self._view

        def work(part: slice) -> None:
            some = facet[part]
            to_camera = facet_loops.to_camera(facets.vertices_m, facets.corners, some, view.r_camera_body_m)
            brdf = surface.brdf(view.sun_direction_body, to_camera.T, facets.normal.take(some, axis=1).T,
                                surface.albedo_scale(facets.number.take(some)))
            value = brdf * self._cos_incidence.take(some)
            self._radiance[some] = value / view.sun_distance_au**2
            self._off_axis[some] = -dot(view.camera_from_body[2], to_camera)

        threads.run_in_parts(work, len(facet), FACETS_AT_ONCE)

    def _squared(self, triangles: FacetParts) -> np.ndarray:
        """Squared light (N,) of triangles with the safety factor: their errors are in proportion to it."""
        return self._safety_squared * _pixels_squared(self._radiance.take(triangles.facet), triangles.area_px)

    def _of_facets(self, chosen: np.ndarray) -> FacetParts:
        """Whole facets, by their numbers (N,) among those that face camera and Sun."""
        facet = self._facing.take(chosen)
        return FacetParts(self._corner.take(chosen, axis=1), facet, self._facet_px(facet))

    def _facet_px(self, facet: np.ndarray) -> np.ndarray:
        """Areas (N,) of facets in the image [px2]."""
        return facet_loops.areas(self._xy, self._facets.corners, facet)


def _safety(squared: np.ndarray) -> float:
    """Safety factor of an estimate from some squared lights (N,): it falls with the number of those that matter."""
    n_clipped = float(squared.sum()) ** 2 / max(float((squared * squared).sum()), 1e-300)
    return min(_SAFETY + _SAFETY_OF_FEW / math.sqrt(max(n_clipped, 1.0)), _MOST_SAFETY)


def _pixels_squared(radiance: np.ndarray | float, area_px: np.ndarray) -> np.ndarray:
    """Squared light (N,) of areas (N,), of a pixel's share of each."""
    return radiance**2 * area_px * np.minimum(area_px, 1.0)
