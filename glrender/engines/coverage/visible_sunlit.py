"""What both the camera and the Sun see of a body: its facets, cut where that ends.

Rays tell it of the facets' corners. Between corners that differ runs the edge of a shadow, or of what hides the rest:
nearly straight within a small triangle, so that such facets are divided where it matters and then cut where bisection
finds it.
"""

from __future__ import annotations

import math

import numpy as np
from glrender_camera import PinholeCamera, threads

from ...view.view import BodyView
from ..rays.engine import RayEngine
from ..rays.mesh import dot
from . import accumulate, facet_loops
from .boundary_clip import LOW_SUN_RAD, FacetCutter
from .facet_tables import FacetTables
from .sub_triangles import FacetParts, projected

# Fitted to 35 low-poly and 12 finer shapes at 20 to 160 deg beside rays (test_coverage_engine.py,
# benchmarks/heldout.py), all dimensionless unless they say otherwise.
# Squared error of a facet clipped by 1, 2, 3 bisections, over its squared light in a pixel.
_CUT_ERRORS = (0.066, 0.0205, 0.018)
# Share of a pixel that a crowd of facets far smaller than one errs as: they err together.
_CROWD = 0.2
# Share of their light that clipped facets are too dark by, after 1, 2, 3 bisections at 60 deg.
_CUT_BIASES = (0.015, 0.003, 0.0)
# Share of the squared light of the largest facet that another body may take between its corners unseen.
_OF_LARGEST = 0.1
# Safety factor of the estimate: with many clipped facets; times the root of their number, of few; at most.
_SPREAD = 0.5
_SPREAD_OF_FEW = 7.0
_MOST_SPREAD = 3.0
# The same for a low Sun: more by this, from a phase angle [rad] on, over so many radians.
_LOW_SPREAD = 0.5
_LOW_SPREAD_RAD = 2.0
_OVER_RAD = 0.52
# Clipped facets from which subdivision finds what passes between corners: the factor then, and bisections.
_MANY_CUTS = 1000.0
_SPREAD_OF_MANY = 0.4
_BISECTIONS_OF_MANY = 2
# Factor of open shapes over the share of open edges, and at most: sheets and blades are thin, terrain is not.
_OPEN_SPREAD = 10.0
_MOST_OPEN = 1.0
# Squared error of boundaries that pass between corners that agree, over that of clipped facets: before subdivision, and
# what is left after it.
_MISSED = 0.0065
_STILL_MISSED = 1.8e-4
# What may be missed after a subdivision: over what it found, over what the one before found, over itself each time, and
# of whole facets.
_OF_FOUND = 0.6
_OF_EARLIER = 0.4
_OF_LOOK = 0.5
_WHOLE_ERROR = 0.1
# Squared light of a facet over the squared tolerance of all, from which it is divided first: of large facets with more
# than a share of all light, of others, and of all that may have light between dark corners.
_LARGE = 2.0
_LARGE_SHARE = 2e-3
_OTHERS = 60.0
_TORN = 0.25
# Share of the error that is left undivided, and of the tolerance that division aims at; most divisions.
_UNDIVIDED = 0.25
_LEAST_LEFT = 0.1
_MOST_DIVISIONS = 6
# Facets that are few, and too many to subdivide again; most subdivisions; share of the tolerance that may be missed.
_FEW = 3000
_MANY = 120_000
_MOST_LOOKS = 4
_ENOUGH = 0.5
# Mean of max(0, u + t) over the Sun's disc and over u from -1 to 0, in units of the Sun's radius: closed form.
_MEAN_SET = 0.0625
# RMS error of a hard edge over that of the ramp in its place: Itokawa at 60 and 120 deg (test_penumbra.py).
_PENUMBRA = 0.65
# Facets that a thread looks at in a turn, and that it shades.
_FOUND_AT_ONCE = 1 << 16
_SHADED_AT_ONCE = 1 << 14
# Facets from which two threads draw, on an image each: so many, and so many for each cell.
_TWO_IMAGES = 20_000
_OF_CELLS = 0.125


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
        # Parts of large facets that are lit or dark as far as is known.
        self._even = FacetParts(np.zeros((3, 0), np.intp), np.zeros(0, np.intp), np.zeros(0))
        self._is_alone = len(views) == 1
        self._cutter = FacetCutter(facets, view, views, rays, facing)
        self._facing, self._corner = facing, self._cutter.corner
        n_lit, n_seen = (of.take(self._corner).sum(axis=0) for of in (self._cutter.points.is_lit,
                                                                      self._cutter.points.is_seen))
        # Where the camera sees one end, in shadow, the Sun may see the other, and both what is between: of few facets.
        self._is_torn = np.zeros(facets.n_facets, bool)
        self._is_torn[facing[(n_lit == 0) & (n_seen > 0) & (n_seen < 3) & (facets.n_facets < 2 * _FEW)]] = True
        mixed = np.flatnonzero((n_lit > 0) & (n_lit < 3))
        whole = np.flatnonzero(n_lit == 3)
        self._whole = facing[whole]
        self._shade(facing[n_lit > 0])
        self._mixed = self._of_facets(mixed)
        facet = np.concatenate([self._whole, self._mixed.facet])
        area_px = np.concatenate([self._facet_px(self._whole), self._mixed.area_px * n_lit.take(mixed) / 3.0])
        area_px *= np.concatenate([shown.take(whole), shown.take(mixed)])
        self.area_px, self.n_areas, self.has_facing = float(area_px.sum()), len(area_px), bool(
            len(facing) or self._set_px)
        # No product of matrices here: BLAS keeps threads of its own spinning, which takes the time of others' frames.
        self.light = float((area_px * self._radiance[facet]).sum())
        self._spread = self._spread_of(_n_bringing(self._light_squared(self._mixed)), _SPREAD)

    def refine(self, most_squared: float, flux_weight: float) -> float:
        """Cut, and look closer and divide before, until the pixels' squared errors are below this, if they can be.

        A squared error of all light counts as so many times that of pixels. Returns what their sum is then, in units of
        radiance squared; infinite, and nothing is cut, if too much light is in too few facets.
        """
        if not self._divide_large(most_squared):
            return math.inf
        told = self._cut(most_squared, flux_weight)
        self._cutter.keep_lit(self._even)
        return told

    def _find_facing(self, bounds_px: np.ndarray, sun_radius_rad: float) -> tuple[np.ndarray, ...]:
        """Facets (N,) that face camera and Sun, cosines (N,) of incidence, and the share (N,) that is shown, about."""
        facets, view = self._facets, self._view
        found = threads.run_in_parts(lambda part: facet_loops.facing(
            facets.normal, facets.offset_m, part.start, part.stop, view.sun_direction_body, sun_radius_rad,
            view.r_camera_body_m, self._xy, facets.corners, bounds_px), facets.n_facets, _FOUND_AT_ONCE)
        *found, set_px = zip(*found, strict=True)
        self._set_px = sum(set_px)
        return tuple(np.concatenate(each) for each in found)

    def _cut(self, most_squared: float, flux_weight: float) -> float:
        """Clip partially visible facets, with those that subdivision finds."""
        triangles = self._mixed
        light = float((self._radiance.take(triangles.facet) * triangles.area_px).sum())
        light_squared = self._light_squared(triangles)
        squared = self._spread**2 * float(light_squared.sum())
        unseen = _MISSED * squared + self._behind_others()
        for n, (error, bias) in enumerate(zip(_CUT_ERRORS, _CUT_BIASES, strict=True), 1):
            told = error * squared + unseen + flux_weight * (bias * light) ** 2
            if told <= most_squared:
                self._cutter.cut_off(triangles, n)
                return told
        n_bisections, n_cuts = len(_CUT_ERRORS), _n_bringing(light_squared)
        if n_cuts > _MANY_CUTS:
            n_bisections, self._spread = _BISECTIONS_OF_MANY, self._spread_of(n_cuts, _SPREAD_OF_MANY)
            squared = self._spread**2 * float(light_squared.sum())
        cut_error = _CUT_ERRORS[n_bisections - 1]
        triangles, told = self._closer(triangles, _STILL_MISSED * squared, most_squared)
        left = []
        allowed = told if told > most_squared else max(most_squared - told, _LEAST_LEFT * most_squared)
        for _ in range(_MOST_DIVISIONS):
            squared = cut_error * self._squared(triangles)
            if squared.sum() <= allowed:
                break
            order = np.argsort(-squared)
            n = len(order) - int(np.searchsorted(np.cumsum(squared[order[::-1]]), _UNDIVIDED * allowed))
            left.append(triangles.at(order[n:]))
            rest = float(squared[order[n:]].sum())
            told, allowed = told + rest, allowed - rest
            triangles = self._cutter.keep_even(self._cutter.quarters(triangles.at(order[:n])))
        told += cut_error * float(self._squared(triangles).sum())
        self._cutter.cut_off(FacetParts.joined([*left, triangles]), n_bisections)
        return told

    def penumbra(self) -> float:
        """Squared error of hard edges of shadows in place of penumbras, in units of radiance squared.

        A ramp as wide as the Sun's angle times the distance of what shades, along the edges in facets whose corners
        differ; wider where the Sun is low. Within a pixel it has the light of a hard edge, and errs where the
        pixels' sides cross it: the mean over how they lie, as one that lies along a ramp may cross all of it. To be
        asked for before anything is cut.
        """
        mixed, view, points = self._mixed, self._view, self._cutter.points
        is_dark = (points.is_seen & ~points.is_lit).take(mixed.corner)
        chosen = np.flatnonzero(is_dark.any(axis=0))
        corner = np.argmax(is_dark[:, chosen], axis=0)
        r_body_m, facet = points.r_m.take(mixed.corner[corner, chosen], axis=1), mixed.facet.take(chosen)
        range_m = self._rays.shade_ranges(self._facets.solid, r_body_m, self._facets.number.take(facet), view,
                                          self._views)
        depth_m = dot(view.camera_from_body[2], r_body_m - view.r_camera_body_m[:, None])
        angle = 2.0 * view.sun_radius_rad
        wide_px = (np.where(np.isfinite(range_m), range_m.clip(0.0), 0.0) * angle * self._camera.focal_length_px
                   / (depth_m * np.sqrt(np.maximum(self._cos_incidence.take(facet), angle))))
        squared = (self._radiance.take(facet) ** 2 * np.sqrt(mixed.area_px.take(chosen))
                   * wide_px * np.minimum(wide_px, 1.0) ** 2)
        return _PENUMBRA**2 * float(squared.sum()) / 12.0

    def low_sun(self) -> tuple[float, float]:
        """What a Sun without a disc misses of facets that part of its disc lights: squared error, and light.

        A facet at which the Sun's middle stands as high as a share u of its radius has the mean of max(0, u + t) over
        the disc (closed form) in place of u. Those for which it has set are taken to be alike, with the mean over u.
        """
        angle, cosines = self._view.sun_radius_rad, self._cos_incidence
        facet = np.concatenate([self._whole, self._mixed.facet])
        area_px = np.concatenate([self._facet_px(self._whole), self._mixed.area_px])
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
            return radiance + 1j

        facets, whole = self._facets, self._whole
        shown = np.zeros(facets.n_facets, complex)
        shown[whole] = values(whole)
        points_xy = projected(self._cutter.points.r_m, self._view, self._camera)
        # Two halves always, whatever the number of threads: the same bytes.
        is_much = len(whole) > max(_TWO_IMAGES, _OF_CELLS * changes.size)
        halves = [changes, np.zeros_like(changes)] if is_much else [changes]

        def add(half: int) -> None:
            def part(n: int) -> slice:
                return slice(n * half // len(halves), n * (half + 1) // len(halves))

            accumulate.add_facets(halves[half], self._xy, facets.corners, facets.neighbours, whole[part(len(whole))],
                                shown, origin_px, per_px)
            for corner, facet in self._cutter.polygons:
                some = part(len(facet))
                accumulate.add_polygons(halves[half], points_xy, corner[:, some], values(facet[some]), origin_px,
                                        per_px)

        threads.run(add, range(len(halves)), threads.N_CORES)
        for other in halves[1:]:
            changes += other

    def _divide_large(self, most_squared: float) -> bool:
        """Divide facets that have more light than may be missed, coarse ones sooner: small parts find what is between.

        Returns whether none is left.
        """
        def squared(facet: np.ndarray, area_px: np.ndarray, radiance: np.ndarray | float) -> np.ndarray:
            is_large = self._facets.is_coarse.take(facet) & (
                self._facet_px(facet) * radiance > _LARGE_SHARE * self.light)
            least = np.where(is_large | may_all, _LARGE, _OTHERS)
            return _pixels_squared(radiance, area_px) / np.where(self._is_torn.take(facet), of_torn, least)

        if self._cutter.is_free:
            return True
        # All that are torn may be lit.
        of_torn = _TORN / max(int(self._is_torn.sum()), 1)
        # Another body may be before any of few facets.
        may_all = not self._is_alone and len(self._facing) < _FEW
        area_px = self._facet_px(self._facing)
        large = np.flatnonzero(squared(self._facing, area_px, float(self._radiance.max())) > most_squared)
        facet = self._facing[large]
        self._shade(facet)
        large = large[squared(facet, area_px[large], self._radiance[facet]) > most_squared]
        if not len(large):
            return True
        is_large, parts = np.zeros(self._facets.n_facets, bool), self._of_facets(large)
        is_large[self._facing[large]] = True
        mixed = self._mixed.at(np.flatnonzero(~is_large.take(self._mixed.facet)))
        self._whole = self._whole[~is_large.take(self._whole)]
        self._facing, self._corner = (np.delete(each, large, axis=-1) for each in (self._facing, self._corner))
        small = []
        for _ in range(_MOST_DIVISIONS):
            if len(parts.facet) > _MANY:
                return False
            parts = self._cutter.quarters(parts)
            is_small = squared(parts.facet, parts.area_px, self._radiance[parts.facet]) <= most_squared
            small.append(parts.at(np.flatnonzero(is_small)))
            parts = parts.at(np.flatnonzero(~is_small))
            if not len(parts.facet):
                break
        else:
            return False
        small = FacetParts.joined(small)
        is_mixed = self._cutter.are_mixed(small)
        self._mixed = FacetParts.joined([mixed, small.at(np.flatnonzero(is_mixed))])
        self._even = small.at(np.flatnonzero(~is_mixed))
        return True

    def _closer(self, triangles: FacetParts, told: float, most_squared: float) -> tuple[FacetParts, float]:
        """Mixed parts of what seemed to be even, with those of others; and what may be missed still, squared."""
        whole = self._worth_a_look(triangles)
        large, n_looks = self._even, _MOST_LOOKS
        if len(whole.facet) + len(large.facet) > _MANY:
            self._cutter.keep_lit(large)
            large, n_looks = large.at(np.zeros(0, np.intp)), 1
        even = FacetParts.joined([whole, large])
        was_lit = self._cutter.points.is_lit.take(even.corner[0])
        # Of each part which of these it is within; and which of them were found to be mixed.
        parts, within = even, np.arange(len(was_lit))
        is_found = np.zeros(len(was_lit), bool)
        # What is thin, or another body, may pass between corners at every look.
        of_look = _OF_LOOK if self._facets.is_closed and self._is_alone else 1.0
        found, looked, missed = [triangles], 0.0, told
        for look in range(n_looks):
            parts, within = self._cutter.quarters(parts), np.tile(within, 4)
            is_new = np.zeros(len(was_lit), bool)
            is_new[within[(self._cutter.are_lit(parts) != was_lit.take(within)).any(axis=0)]] = True
            is_found |= is_new
            of_new, new = is_new.take(within), even.at(np.flatnonzero(is_new))
            self._shade(new.facet)
            found.append(self._cutter.keep_even(parts.at(np.flatnonzero(of_new))))
            looked = _OF_EARLIER**2 * looked + _WHOLE_ERROR * float(
                _pixels_squared(self._radiance[new.facet], new.area_px / 4.0**look).sum())
            missed = of_look ** (2 * look) * (told + (_OF_FOUND * self._spread) ** 2 * looked)
            rest = np.flatnonzero(~of_new)
            parts, within = parts.at(rest), within.take(rest)
            if len(rest) > (_FEW if missed <= _ENOUGH * most_squared else _MANY):
                break
        is_cut = np.zeros(self._facets.n_facets, bool)
        is_cut[whole.facet[is_found[:len(whole.facet)]]] = True
        self._whole = self._whole[~is_cut.take(self._whole)]
        self._even = large.at(np.flatnonzero(~is_found[len(whole.facet):]))
        return FacetParts.joined(found), missed

    def _behind_others(self) -> float:
        """Squared error of what other bodies may hide or shade between corners that agree."""
        if self._is_alone:
            return 0.0
        facet = np.concatenate([self._whole, self._even.facet])
        area = np.concatenate([self._facet_px(self._whole), self._even.area_px])
        return _OF_LARGEST * float(_pixels_squared(self._radiance.take(facet), area).max(initial=0.0))

    def _worth_a_look(self, triangles: FacetParts) -> FacetParts:
        """Facets, none of which has any of the mixed triangles, in which light may end all the same.

        Those beside mixed ones and below what rises over an edge and faces away; all where they are few or the Sun is
        low.
        """
        facets, facing = self._facets, self._facing
        is_mixed = np.zeros(facets.n_facets, bool)
        is_mixed[triangles.facet] = True
        chosen = ~is_mixed.take(facing)
        if self._view.phase_rad < LOW_SUN_RAD and len(facing) > _FEW:
            touched = np.zeros(facets.vertices_m.shape[1], bool)
            touched[facets.corners[:, is_mixed]] = True
            faces = np.zeros(facets.n_facets + 1, bool)
            faces[facing] = True
            below = facets.rises.take(facing, axis=1) & ~faces.take(facets.neighbours.take(facing, axis=1))
            chosen &= touched.take(facets.corners.take(facing, axis=1)).any(axis=0) | below.any(axis=0)
        return self._of_facets(np.flatnonzero(chosen))

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

        threads.run_in_parts(work, len(facet), _SHADED_AT_ONCE)

    def _spread_of(self, n_cuts: float, least: float) -> float:
        """Safety factor of the estimate from so many clipped facets: it falls with their number."""
        low = min(max((self._view.phase_rad - _LOW_SPREAD_RAD) / _OVER_RAD, 0.0), 1.0)
        return ((1.0 + _LOW_SPREAD * low) * (1.0 + min(_OPEN_SPREAD * self._facets.open_share, _MOST_OPEN))
                * min(least + _SPREAD_OF_FEW / math.sqrt(max(n_cuts, 1.0)), _MOST_SPREAD))

    def _squared(self, triangles: FacetParts) -> np.ndarray:
        """Squared errors (N,), over those of cuts, in units of radiance squared."""
        return self._spread**2 * self._light_squared(triangles)

    def _light_squared(self, triangles: FacetParts) -> np.ndarray:
        """Squared light (N,) of triangles, of a pixel's share of each: what cuts' errors are in proportion to."""
        area = triangles.area_px
        crowd = _CROWD * min(float(area.sum()) / max(self.area_px, 1e-300), 1.0)
        return self._radiance.take(triangles.facet) ** 2 * area * np.clip(area, crowd, 1.0)

    def _of_facets(self, chosen: np.ndarray) -> FacetParts:
        """Whole facets, by their numbers (N,) among those that face camera and Sun."""
        facet = self._facing.take(chosen)
        return FacetParts(self._corner.take(chosen, axis=1), facet, self._facet_px(facet))

    def _facet_px(self, facet: np.ndarray) -> np.ndarray:
        """Areas (N,) of facets in the image [px2]."""
        return facet_loops.areas(self._xy, self._facets.corners, facet)


def _n_bringing(squared: np.ndarray) -> float:
    """How many of some squared errors (N,), in any unit, bring their sum."""
    return float(squared.sum()) ** 2 / max(float((squared * squared).sum()), 1e-300)


def _pixels_squared(radiance: np.ndarray | float, area_px: np.ndarray) -> np.ndarray:
    """Squared light (N,) of areas (N,), of a pixel's share of each."""
    return radiance**2 * area_px * np.minimum(area_px, 1.0)
