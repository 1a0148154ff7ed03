"""What both the camera and the Sun see of a body: its facets, cut where that ends.

Rays tell it of the facets' corners. Between corners that differ runs the edge of a shadow, or of what hides the rest:
straight within a small triangle, so that such facets are divided where it matters and then cut between two places
that bisection finds.
"""

from __future__ import annotations

import math

import numpy as np
from glrender_camera import PinholeCamera, threads

from . import coverage, facet_loops
from .facet_parts import FacetParts
from .facet_tables import FacetTables
from .ray_engine import RayEngine
from .rays import dot
from .view import BodyView

# Squared error of what 1, 2, 3 bisections cut off a triangle, over its light squared: times its area in pixels, or the
# square of it, and of a crowd of small ones, which err together, more.
_CUT_ERRORS, _CROWD = (0.085, 0.032, 0.018), 0.2
# All that is told is times: a least, and one over the root of the number of facets that bring the error, as the sum of
# few scatters; at most; and more from a phase angle on, over so many radians: edges pass between corners that agree.
_SPREAD, _SPREAD_OF_FEW, _MOST_SPREAD = 0.5, 7.0, 3.0
_LOW_SPREAD, _LOW_SPREAD_RAD, _OVER_RAD = 0.5, 2.0, 0.52
# Error of edges that pass between corners that agree: over that of three bisections; and where they are asked for, over
# that and over what was found, at first and at last.
_MISSED, _STILL_MISSED, _OF_FOUND, _OF_EARLIER, _WHOLE_ERROR = 0.6, 0.1, 0.6, 0.4, 0.1
# Squared light of a facet over the squared error that is allowed for all, from which it is divided first: of one that
# has more than a share of all light, and of others.
_LARGE, _LARGE_SHARE, _OTHERS = 2.0, 2e-3, 60.0
# What may be left of the error when the triangles that are divided are chosen, and of the budget for them.
_UNDIVIDED, _LEAST_LEFT, _MOST_DIVISIONS = 0.25, 0.1, 6
# Phase angle from which facets are looked at more closely everywhere: they are few, and light falls in slivers; and how
# many are few, and too many to look again. Most looks, and of the budget, what may be missed without another.
_LOW_SUN_RAD, _FEW, _MANY, _MOST_LOOKS, _ENOUGH = 1.5, 3000, 40_000, 4, 0.5
# What hard edges cost over a ramp's error, as measured (docs/planner.md).
_PENUMBRA = 0.65
# Facets that a thread shades in a turn.
_SHADED_AT_ONCE = 1 << 14


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
    """

    def __init__(self, facets: FacetTables, view: BodyView, views: list[BodyView], camera: PinholeCamera,
                 bounds_px: tuple[float, float, float, float], rays: RayEngine):
        self._facets, self._view, self._views, self._camera, self._rays = facets, view, views, camera, rays
        self._xy = self._project(facets.vertices_m)
        facing, cos_incidence = facet_loops.facing(facets.normal, facets.offset_m, view.sun_direction_body,
                                                   view.r_camera_body_m)
        self._radiance, self._off_axis, self._cos_incidence = np.zeros((3, facets.n_facets))
        self._cos_incidence[facing] = cos_incidence
        # Of each facet that faces both, the share that the window shows, about.
        shown = np.ones(facets.n_facets)
        if not view.is_within(bounds_px):
            for axis, low, high in zip(self._xy, bounds_px[:2], bounds_px[2:], strict=True):
                ends = axis.take(facets.corners.take(facing, axis=1))
                first, last = ends.min(axis=0), ends.max(axis=0)
                shown[facing] *= (np.minimum(last, high) - np.maximum(first, low)).clip(0.0) / (last - first)
            facing = facing[shown.take(facing) > 0.0]
        self._polygons: list[tuple[np.ndarray, np.ndarray]] = []
        self._is_free = facets.is_convex and len(views) == 1
        is_seen, is_lit = self._of_corners(facing)
        self._facing, self._is_seen, self._is_lit = facing, is_seen, is_lit
        n_lit = is_lit.sum(axis=0)
        mixed = np.flatnonzero((n_lit > 0) & (n_lit < 3))
        self._whole = facing[n_lit == 3]
        self._shade(facing[n_lit > 0])
        self._mixed = self._of_facets(mixed)
        facet = np.concatenate([self._whole, self._mixed.facet])
        area_px = np.concatenate([self._facet_px(self._whole), self._mixed.area_px * self._mixed.n_lit / 3.0])
        area_px *= shown.take(facet)
        self.area_px, self.n_areas, self.has_facing = float(area_px.sum()), len(area_px), len(facing) > 0
        # No product of matrices here: BLAS keeps threads of its own spinning, which takes the time of others' frames.
        self.light = float((area_px * self._radiance[facet]).sum())
        self._spread = self._spread_of(self._light_squared(self._mixed))

    def refine(self, most_squared: float) -> float:
        """Cut, and look closer and divide before, until the pixels' squared errors are below this, if they can be.

        Returns what their sum is then, in units of radiance squared.
        """
        least = self._divide_large(most_squared)
        triangles = self._mixed
        errors = [float(self._squared(triangles, n).sum()) for n in (1, 2, 3)]
        for n, error in enumerate(errors, 1):
            missed = _MISSED**2 * errors[-1]
            if error + missed <= most_squared:
                self._cut_off(triangles, n)
                return max(error + missed, least)
        triangles, told = self._closer(triangles, _STILL_MISSED**2 * errors[-1], most_squared)
        left = []
        allowed = told if told > most_squared else max(most_squared - told, _LEAST_LEFT * most_squared)
        for _ in range(_MOST_DIVISIONS):
            squared = self._squared(triangles, 3)
            if squared.sum() <= allowed:
                break
            order = np.argsort(-squared)
            n = len(order) - int(np.searchsorted(np.cumsum(squared[order[::-1]]), _UNDIVIDED * allowed))
            left.append(triangles.at(order[n:]))
            rest = float(squared[order[n:]].sum())
            told, allowed = told + rest, allowed - rest
            triangles = self._mixed_of(self._quarters(triangles.at(order[:n])))
        told += float(self._squared(triangles, 3).sum())
        self._cut_off(FacetParts.joined([*left, triangles]), 3)
        return max(told, least)

    def penumbra(self) -> float:
        """Squared error of hard edges of shadows in place of penumbras, in units of radiance squared.

        A ramp as wide as the Sun's angle times the distance of what shades, along the edges in facets whose corners
        differ; wider where the Sun is low. To be asked for before anything is cut.
        """
        mixed, view = self._mixed, self._view
        is_dark = mixed.is_seen & ~mixed.is_lit
        chosen = np.flatnonzero(is_dark.any(axis=0))
        corner = np.argmax(is_dark[:, chosen], axis=0)
        r_body_m, facet = mixed.corner_m[corner, :, chosen].T, mixed.facet.take(chosen)
        range_m = self._rays.shade_ranges(r_body_m, self._facets.number.take(facet), view, self._views)
        depth_m = dot(view.camera_from_body[2], r_body_m - view.r_camera_body_m[:, None])
        angle = 2.0 * view.sun_radius_rad
        wide_px = (np.where(np.isfinite(range_m), range_m.clip(0.0), 0.0) * angle * self._camera.focal_length_px
                   / (depth_m * np.sqrt(np.maximum(self._cos_incidence.take(facet), angle))))
        squared = (self._radiance.take(facet) ** 2 * np.sqrt(mixed.area_px.take(chosen))
                   * wide_px * np.minimum(wide_px, 1.0))
        return _PENUMBRA**2 * float(squared.sum()) / 12.0

    def add_to(self, changes: np.ndarray, origin_px: np.ndarray, per_px: np.ndarray, off_axis_power: float) -> None:
        """Add what the areas change in the cells of an image: `coverage`.

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
            return radiance + 1j

        facets, whole = self._facets, self._whole
        shown = np.zeros(facets.n_facets, complex)
        shown[whole] = values(whole)
        # Two halves always, whatever the number of threads: the same bytes.
        halves = [changes, np.zeros_like(changes)] if len(whole) > max(_MANY, changes.size) else [changes]

        def add(half: int) -> None:
            part = slice(len(whole) * half // len(halves), len(whole) * (half + 1) // len(halves))
            coverage.add_facets(halves[half], self._xy, facets.corners, facets.neighbours, whole[part], shown,
                                origin_px, per_px)

        threads.run(add, range(len(halves)), threads.N_CORES)
        for other in halves[1:]:
            changes += other
        for corner_m, facet in self._polygons:
            xy = np.stack([self._project(corner) for corner in corner_m])
            coverage.add_polygons(changes, xy, values(facet), origin_px, per_px)

    def _of_corners(self, facing: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Whether the corners (3, N) of facets are seen, and in sunlight as well."""
        vertices_m = self._facets.vertices_m
        # Lifted off the surface by the normal of one of their facets.
        vertex, of, corner = facet_loops.vertices_of(self._facets.corners, facing, vertices_m.shape[1])
        is_seen, is_lit = self._told(vertices_m.take(vertex, axis=1), of, None, vertex)
        return is_seen.take(corner), is_lit.take(corner)

    def _divide_large(self, most_squared: float) -> float:
        """Divide facets that have more light than may be missed, coarse ones sooner: small parts find what is between.

        Returns the squared error of the largest part that is left, if it is too large.
        """
        def squared(facet: np.ndarray, area_px: np.ndarray, radiance: np.ndarray | float) -> np.ndarray:
            is_large = self._facets.is_coarse.take(facet) & (
                self._facet_px(facet) * radiance > _LARGE_SHARE * self.light)
            return radiance**2 * area_px * np.minimum(area_px, 1.0) / np.where(is_large, _LARGE, _OTHERS)

        if self._is_free:
            return 0.0
        area_px = self._facet_px(self._facing)
        large = np.flatnonzero(squared(self._facing, area_px, float(self._radiance.max())) > most_squared)
        facet = self._facing[large]
        self._shade(facet)
        large = large[squared(facet, area_px[large], self._radiance[facet]) > most_squared]
        if not len(large):
            return 0.0
        is_large, parts = np.zeros(self._facets.n_facets, bool), self._of_facets(large)
        is_large[self._facing[large]] = True
        mixed = [self._mixed.at(np.flatnonzero(~is_large.take(self._mixed.facet)))]
        self._whole = self._whole[~is_large.take(self._whole)]
        self._facing, self._is_seen, self._is_lit = (
            np.delete(each, large, axis=-1) for each in (self._facing, self._is_seen, self._is_lit))
        for _ in range(_MOST_DIVISIONS):
            parts = self._quarters(parts, are_small=False)
            is_small = squared(parts.facet, parts.area_px, self._radiance[parts.facet]) <= most_squared
            mixed.append(self._mixed_of(parts.at(np.flatnonzero(is_small))))
            parts = parts.at(np.flatnonzero(~is_small))
            if not len(parts.facet):
                break
        self._mixed = FacetParts.joined([*mixed, self._mixed_of(parts)])
        return float(squared(parts.facet, parts.area_px, self._radiance[parts.facet]).max(initial=0.0))

    def _closer(self, triangles: FacetParts, told: float, most_squared: float) -> tuple[FacetParts, float]:
        """Mixed parts of facets whose corners agree, with those of others; and what may be missed still, squared.

        They are looked for beside mixed facets and below what rises over an edge and faces away, and everywhere where
        facets are few or the Sun is low.
        """
        facets, facing = self._facets, self._facing
        corners = facets.corners.take(facing, axis=1)
        is_mixed = np.zeros(facets.n_facets, bool)
        is_mixed[triangles.facet] = True
        touched = np.zeros(facets.vertices_m.shape[1], bool)
        touched[facets.corners[:, is_mixed]] = True
        is_even, chosen = ~is_mixed.take(facing), True
        if self._view.phase_rad < _LOW_SUN_RAD and len(facing) > _FEW:
            faces = np.zeros(len(is_mixed) + 1, bool)
            faces[facing] = True
            below = facets.rises.take(facing, axis=1) & ~faces.take(facets.neighbours.take(facing, axis=1))
            chosen = touched.take(corners).any(axis=0) | below.any(axis=0)
        chosen = np.flatnonzero(is_even & chosen)
        parts = self._of_facets(chosen)
        was_lit = np.zeros(len(is_mixed), bool)
        was_lit[self._whole] = True
        found, looked, missed = [triangles], 0.0, told
        for look in range(_MOST_LOOKS):
            parts = self._quarters(parts)
            differs = (parts.is_lit != was_lit.take(parts.facet)).any(axis=0)
            hit = np.zeros(len(is_mixed), bool)
            hit[parts.facet[differs]] = True
            of_hit = hit.take(parts.facet)
            facet = np.flatnonzero(hit)
            self._shade(facet)
            self._whole = self._whole[~hit.take(self._whole)]
            found.append(self._mixed_of(parts.at(np.flatnonzero(of_hit))))
            area = self._facet_px(facet) / 4.0**look
            looked = _OF_EARLIER**2 * looked + _WHOLE_ERROR * float(
                (self._radiance[facet] ** 2 * area * np.minimum(area, 1.0)).sum())
            missed = told + (_OF_FOUND * self._spread) ** 2 * looked
            parts = parts.at(np.flatnonzero(~of_hit))
            if len(parts.facet) > (_FEW if missed <= _ENOUGH * most_squared else _MANY):
                break
        return FacetParts.joined(found), missed

    def _told(self, r_body_m: np.ndarray, facet: np.ndarray, is_seen: np.ndarray | None = None,
              vertex: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Whether points (3, N) [m] of facets (N,) are seen, and in sunlight as well.

        No ray is cast for those that are known to be seen (N,): between three that are; nor at vertices (N,) from which
        the line is above the horizon.
        """
        if self._is_free:
            return np.ones((2, len(facet)), bool)
        view, horizons = self._view, self._facets.horizons
        is_open = [None, None]
        if self._facets.is_convex:
            is_open = [np.ones(len(facet), bool)] * 2
        elif vertex is not None and horizons is not None:
            number = self._facets.vertex_number.take(vertex)
            is_open = [horizons.are_open(number, view.r_camera_body_m, True),
                       horizons.are_open(number, view.sun_direction_body, False)]
        is_asked, number = np.ones(len(facet), bool) if is_seen is None else ~is_seen, self._facets.number.take(facet)
        seen = self._rays.in_view(r_body_m, number, view, self._views, is_asked, is_open[0])
        if is_seen is not None:
            seen |= is_seen
        return seen, self._rays.in_light(r_body_m, number, view, self._views, seen, is_open[1])

    def _shade(self, facet: np.ndarray) -> None:
        """Work out radiance at the middles of facets (N,): in 1/sr of the Sun's irradiance at 1 au."""
        facets, surface, view = self._facets, self._facets.surface, self._view

        def work(part: slice) -> None:
            some = facet[part]
            to_camera = facet_loops.to_camera(facets.vertices_m, facets.corners, some, view.r_camera_body_m)
            brdf = surface.brdf(view.sun_direction_body, to_camera.T, facets.normal.take(some, axis=1).T,
                                surface.albedo_scale(facets.number.take(some)))
            self._radiance[some] = brdf * self._cos_incidence.take(some) / view.sun_distance_au**2
            self._off_axis[some] = -dot(view.camera_from_body[2], to_camera)

        threads.run_in_parts(work, len(facet), _SHADED_AT_ONCE)

    def _spread_of(self, squared: np.ndarray) -> float:
        """Error over what is told by squared errors (N,), in any unit: they are as good as they are many."""
        n = float(squared.sum()) ** 2 / max(float((squared * squared).sum()), 1e-300)
        low = min(max((self._view.phase_rad - _LOW_SPREAD_RAD) / _OVER_RAD, 0.0), 1.0)
        return (1.0 + _LOW_SPREAD * low) * min(_SPREAD + _SPREAD_OF_FEW / math.sqrt(max(n, 1.0)), _MOST_SPREAD)

    def _squared(self, triangles: FacetParts, n_bisections: int) -> np.ndarray:
        """Squared errors (N,) that cuts leave, in units of radiance squared."""
        return _CUT_ERRORS[n_bisections - 1] * self._spread**2 * self._light_squared(triangles)

    def _light_squared(self, triangles: FacetParts) -> np.ndarray:
        """Squared light (N,) of triangles, of a pixel's share of each: what cuts' errors are in proportion to."""
        area = triangles.area_px
        crowd = _CROWD * min(float(area.sum()) / max(self.area_px, 1e-300), 1.0)
        return self._radiance.take(triangles.facet) ** 2 * area * np.clip(area, crowd, 1.0)

    def _of_facets(self, chosen: np.ndarray) -> FacetParts:
        """Whole facets, by their numbers (N,) among those that face camera and Sun."""
        facet = self._facing.take(chosen)
        return FacetParts(self._facets.corner_m(facet), facet, self._is_seen.take(chosen, axis=1),
                          self._is_lit.take(chosen, axis=1), self._facet_px(facet))

    def _quarters(self, triangles: FacetParts, are_small: bool = True) -> FacetParts:
        """Each divided in four between the middles of its sides; nothing hides a small one but not its corners."""
        a, b, c = triangles.corner_m
        between = 0.5 * np.stack([a + b, b + c, c + a])
        known = np.tile(triangles.is_seen.all(axis=0) & are_small, 3)
        told = self._told(np.concatenate(list(between), axis=1), np.tile(triangles.facet, 3), known)
        # Corners 0, 1, 2; between them 3, 4, 5.
        corner_m, is_seen, is_lit = (
            np.concatenate([had, made.reshape(had.shape)]) for had, made in
            zip((triangles.corner_m, triangles.is_seen, triangles.is_lit), (between, *told), strict=True))
        return FacetParts.joined([
            FacetParts(corner_m[three], triangles.facet, is_seen[three], is_lit[three], 0.25 * triangles.area_px)
            for three in ([0, 3, 5], [3, 1, 4], [5, 4, 2], [4, 5, 3])])

    def _mixed_of(self, triangles: FacetParts) -> FacetParts:
        """Those that are mixed; the others are done."""
        is_mixed = triangles.is_mixed
        done = np.flatnonzero(~is_mixed & triangles.is_lit[0])
        self._polygons.append((triangles.corner_m.take(done, axis=-1), triangles.facet.take(done)))
        return triangles.at(np.flatnonzero(is_mixed))

    def _cut_off(self, triangles: FacetParts, n_bisections: int) -> None:
        """Cut triangles between the corner that differs and the two others."""
        n = len(triangles.facet)
        is_one = triangles.n_lit == 1
        odd, every = np.argmax(triangles.is_lit == is_one, axis=0), np.arange(n)
        first, *others = (triangles.corner_m[(odd + j) % 3, :, every].T for j in range(3))
        known, facet = np.tile(triangles.is_seen.all(axis=0), 2), np.tile(triangles.facet, 2)
        low, high = np.zeros((2, n)), np.ones((2, n))
        ways = np.stack([other - first for other in others])
        for _ in range(n_bisections):
            places = first + 0.5 * (low + high)[:, None] * ways
            _, lit = self._told(np.concatenate(list(places), axis=1), facet, known)
            is_before = lit.reshape(2, n) == is_one
            low, high = np.where(is_before, 0.5 * (low + high), low), np.where(is_before, high, 0.5 * (low + high))
        ends = first + 0.5 * (low + high)[:, None] * ways
        for chosen, corners in ((np.flatnonzero(is_one), [first, *ends]),
                                (np.flatnonzero(~is_one), [ends[0], *others, ends[1]])):
            self._polygons.append((np.stack(corners).take(chosen, axis=-1), triangles.facet.take(chosen)))

    def _facet_px(self, facet: np.ndarray) -> np.ndarray:
        """Areas (N,) of facets in the image [px2]."""
        return facet_loops.areas(self._xy, self._facets.corners, facet)

    def _project(self, r_body_m: np.ndarray) -> np.ndarray:
        """Places (2, N) [px] of points (3, N) [m]."""
        return facet_loops.projected(r_body_m, self._view.camera_from_body, self._view.r_camera_body_m,
                                     self._camera.focal_length_px, np.array(self._camera.principal_point_px, float))
