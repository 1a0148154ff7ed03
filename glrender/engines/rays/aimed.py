"""Rays aimed at what faces Sun and camera: from points of facets, so that no sliver of light lies between rays.

Source: importance sampling over the facets' areas; Cranley and Patterson (1976), Randomization of number theoretic
methods for multiple integration: the scatter of shifted point sets is their mean's error.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property

import numpy as np
from glrender_camera import PinholeCamera, threads

from ...base.rotations import sun_from_body
from ...view.view import BodyView
from .engine import RayEngine
from .mesh import dot

# Point sets with shifts of their own; points of each in the first turn, and the most of all together: a minute.
_SETS, _FIRST_POINTS, _MOST_POINTS = 16, 1 << 12, 1 << 25
# Share of the points [1] that is the same for each body: the others may be hidden, and a small one all that is lit.
_SHARED_POINTS = 0.25
# Share of the light [1] that may be missed where a frame is taken to be dark.
_DARK = 1e-6
# Points that a tolerance may want over the most that there are: the first turn may err by as much.
_HOPELESS = 4.0
# Points of a set that are worked on together, of some 300 bytes.
_POINTS_AT_ONCE = 1 << 18
# Facets that a thread shades in a turn.
_FACETS_AT_ONCE = 1 << 13
# Steps of Roberts' sequence in four dimensions: two in the facet, two on the Sun's disc.
_R4 = 1.1673039782614187 ** -np.arange(1.0, 5.0)[:, None]
# Farthest over nearest corner of a facet [1], to which its points have about equal light.
_MOST_DEEP = 1.5
# Distance [px] by which rays in float32 may meet a facet outside its outline, and more.
_BESIDE_PX = 0.1
# Light of a facet that is not as bright all over, over that of its middle: so much of the mean of all.
_UNEVEN = 0.3
# Deviations by which the error of one frame of few pixels may exceed the usual.
_SURE = 1.5


class AimedRays:
    """The facets of a frame that face the camera and any of the Sun's disc, and rays from their points.

    Where there are lamps, those that face the camera: rays are aimed by the Sun alone, and at none then.

    Parameters
    ----------
    engine : RayEngine
    camera : PinholeCamera
    views : list of BodyView
        Of all bodies.
    roi : (x0, y0, x1, y1) int [px]
        Part of the image, one past the last.
    shared : callable, optional
        Pixels of another image that share an image (rows, columns) of the part: errors are those of them.
    """

    def __init__(self, engine: RayEngine, camera: PinholeCamera, views: list[BodyView], roi: tuple[int, int, int, int],
                 shared: Callable[[np.ndarray], np.ndarray] | None = None):
        self._roi, (x0, y0, x1, y1), self._has_lamps = roi, roi, bool(engine.scene.lamps)
        self._shared = shared
        self.shape = (y1 - y0, x1 - x0)
        self._bodies = [_FacingFacets(engine, camera, view, views, roi) for view in views if view.is_visible]

    @property
    def n_facets(self) -> int:
        """Facets that face both and may be in the part of the image."""
        return sum(len(body.facet) for body in self._bodies)

    @property
    def is_able(self) -> bool:
        """Whether each of these facets is at about one distance, so that its points are of about equal weight."""
        return not self._has_lamps and all(body.depth_ratio < _MOST_DEEP for body in self._bodies)

    def of_darkness(self, error: float) -> float:
        """A dark image's error [1]: all light, where there are facets and rays cannot be aimed, else as given."""
        return 1.0 if self.n_facets and not self.is_able else error

    @cached_property
    def may_be_lit(self) -> np.ndarray:
        """Pixels (rows, columns) bool of the part of the image that the facets may reach."""
        return sum((body.reached(self.shape) for body in self._bodies), np.zeros(self.shape, bool))

    @cached_property
    def unhidden(self) -> float:
        """Irradiance [W/m2] of the facets were none hidden or shaded, and the Sun at its highest."""
        return sum(body.unhidden for body in self._bodies)

    def until(self, tolerance: float, rng: np.random.Generator, report: Callable[[float], None] = lambda share: None,
              most_points: int = _MOST_POINTS) -> tuple[np.ndarray, float]:
        """Draw until the tolerance is met or the most points are spent.

        Parameters
        ----------
        tolerance : float [1]
        rng : Generator
        report : callable
            Called with the share done, 0..1.
        most_points : int

        Returns
        -------
        mean : (rows, columns) float64 [W/m2]
        error : float [1]
            RMS error over the mean of the lit pixels. In a dark frame, the share of `unhidden` that the points may have
            missed: by Laplace's rule of succession.
        """
        sums, n_points, n_each, done = np.zeros((_SETS, int(self.may_be_lit.sum()))), 0, _FIRST_POINTS, 0.0
        n_each = min(max(n_each, self.n_facets), most_points // _SETS)
        while True:
            for one in sums:
                one += n_each * self._drawn(n_each, rng)
            n_points += n_each
            mean, error = self._mean_of(sums / n_points, _SETS * n_points)
            is_over = _SETS * (n_points + 2 * n_each) > most_points
            # A tolerance out of reach is not paid for: the error falls by the points' power of 3/4, about.
            is_over |= _SETS * n_points * (error / tolerance) ** (4.0 / 3.0) > _HOPELESS * most_points and mean.any()
            if is_over or error <= (tolerance if mean.any() else _DARK):
                report(1.0)
                return mean, error
            done = max(done, min((tolerance / error) ** 1.5, 1.0), _SETS * n_points / most_points)
            report(done)
            n_each = n_points

    def _mean_of(self, sets: np.ndarray, n_points: int) -> tuple[np.ndarray, float]:
        """The image (rows, columns) and its error, of sets (S, K) of the pixels that may be lit."""
        image, mean = np.zeros(self.shape), sets.mean(axis=0)
        image[self.may_be_lit] = mean
        missed = 1.0 / (n_points + 2.0)
        if not mean.any():
            return image, missed if self.unhidden > 0.0 else 0.0
        if self._shared is not None:
            images = np.zeros((len(sets), *self.shape))
            images[:, self.may_be_lit] = sets
            sets = np.stack([self._shared(each).ravel() for each in images])
            mean = sets.mean(axis=0)
        variance = sets.var(axis=0, ddof=1) / len(sets)
        # Pixels, were those that scatter most alike: the fewer, the farther this frame may be from the usual.
        n_alike = float(variance.sum()) ** 2 / max(float((variance**2).sum()), 1e-300)
        sure = 1.0 + _SURE / math.sqrt(2.0 * max(n_alike, 1.0))
        # One more may be lit than points have met.
        level = float(mean.sum()) / math.sqrt(np.count_nonzero(mean) + 1)
        return image, math.hypot(sure * math.sqrt(variance.sum()), missed * self.unhidden) / level

    def _drawn(self, n_points: int, rng: np.random.Generator) -> np.ndarray:
        """Irradiance (K,) [W/m2] of the pixels that may be lit, by about so many points."""
        found = np.zeros(self.may_be_lit.size)
        for body in self._bodies:
            if body.unhidden > 0.0:
                share = max(body.unhidden / self.unhidden, _SHARED_POINTS / len(self._bodies))
                body.add_to(found, self.shape, n_points * share / body.unhidden, rng)
        return found[self.may_be_lit.ravel()]


class _FacingFacets:
    """Those of one body.

    Attributes
    ----------
    facet : (F,) int
    depth_ratio : float [1]
        The largest ratio of a facet's farthest to its nearest corner.
    """

    def __init__(self, engine: RayEngine, camera: PinholeCamera, view: BodyView, views: list[BodyView],
                 roi: tuple[int, int, int, int]):
        self._engine, self._camera, self._view, self._views, self._roi = engine, camera, view, views, roi
        solid = self._solid = engine.solid(view.name)
        self._sun_radius_rad = view.sun_radius_rad if engine.scene.sun_disc else 0.0
        may_be_lit = (solid.normals @ view.sun_direction_body > -self._sun_radius_rad) | bool(engine.scene.lamps)
        facing = np.flatnonzero(may_be_lit & (solid.normals @ view.r_camera_body_m > solid.offset_m))
        corner = solid.facets[facing].T
        from_camera = solid.vertices_m - view.r_camera_body_m
        depth_m = from_camera @ view.camera_from_body[2]
        # Facets that reach behind the camera have no box.
        safe_m = np.where(depth_m > 0.0, depth_m, np.nan)
        place = camera.places_px((from_camera @ view.camera_from_body[:2].T).T / safe_m)[:, corner]
        low, high = place.min(axis=1), place.max(axis=1)
        beside_px = _BESIDE_PX
        if camera.lens_map is not None:
            beside_px = beside_px + camera.lens_map.most_bent_px(high - low)
        low, high = low - beside_px, high + beside_px
        behind = np.isnan(low[0]) & (depth_m[corner] > 0.0).any(axis=0)
        x0, y0, x1, y1 = roi
        first, size = np.array([[x0], [y0]]), np.array([[x1 - x0], [y1 - y0]])
        # Pixels, from the first to one past the last.
        begin, end = (np.floor(edge + 0.5) - first for edge in (low, high))
        end += 1.0
        begin[:, behind], end[:, behind] = 0.0, np.inf
        within = np.flatnonzero(((begin < size) & (end > 0.0)).all(axis=0))
        self.facet, self._corner = facing[within], corner[:, within]
        self._begin = np.clip(begin[:, within], 0, size).astype(int)
        self._end = np.clip(end[:, within], 0, size).astype(int)
        range_m = np.linalg.norm(from_camera, axis=1)[self._corner]
        self.depth_ratio = float((range_m.max(axis=0) / range_m.min(axis=0)).max(initial=1.0))

    def reached(self, shape: tuple[int, int]) -> np.ndarray:
        """Pixels (rows, columns) bool in the facets' boxes."""
        rows, columns = shape
        change = np.zeros((rows + 1) * (columns + 1), int)
        for y, x, sign in ((self._begin[1], self._begin[0], 1), (self._end[1], self._begin[0], -1),
                           (self._begin[1], self._end[0], -1), (self._end[1], self._end[0], 1)):
            change += sign * np.bincount(y * (columns + 1) + x, minlength=len(change))
        return change.reshape(rows + 1, columns + 1).cumsum(axis=0).cumsum(axis=1)[:-1, :-1] > 0

    @cached_property
    def _area_m2(self) -> np.ndarray:
        a, b, c = self._solid.vertices_m[self._corner]
        return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)

    @cached_property
    def light(self) -> np.ndarray:
        """Irradiance (F,) [W/m2] of each facet, were it not hidden or shaded, and the Sun at its highest."""
        (found, solid_angle_sr), view = np.zeros((2, len(self.facet))), self._view

        def shade(part: slice) -> None:
            facet = self.facet[part]
            middle_m = self._solid.vertices_m[self._corner[:, part]].mean(axis=0).T
            normal = self._solid.normals[facet].T
            highest = view.sun_direction_body[:, None] + self._sun_radius_rad * normal
            to_sun = highest / np.sqrt(dot(highest, highest))
            to_camera = view.r_camera_body_m[:, None] - middle_m
            range_m = np.sqrt(dot(to_camera, to_camera))
            to_camera /= range_m
            if self._solid.surface.body.smooth_normals:
                found[part] = self._engine.mean_radiance(facet, to_sun, view, self._camera)
            else:
                found[part] = self._engine.radiance(facet, middle_m, normal, to_camera, to_sun, range_m, view,
                                                    self._camera)
            solid_angle_sr[part] = np.maximum(dot(normal, to_camera), 0.0) * self._area_m2[part] / range_m**2

        threads.run_in_parts(shade, len(found), _FACETS_AT_ONCE)
        if self._solid.is_uneven and len(found):
            # A facet that is dark in the middle may be bright elsewhere.
            found += _UNEVEN * found.mean()
        return found * solid_angle_sr

    @cached_property
    def unhidden(self) -> float:
        """Sum [W/m2] of `light`."""
        return float(self.light.sum())

    def add_to(self, image: np.ndarray, shape: tuple[int, int], points_per_light: float, rng: np.random.Generator
               ) -> None:
        """Add the light of points, so many for each W/m2 that a facet would send, to an image (rows x columns,)."""
        wanted = points_per_light * self.light
        count = np.floor(wanted + rng.random(len(wanted))).astype(int)
        # Facets with less than a point on average: the few that are drawn stand for all.
        share = np.where(wanted < 1.0, 1.0 / np.maximum(wanted, 1e-300), 1.0 / np.maximum(count, 1))
        shift, ends = rng.random((4, len(wanted))), np.cumsum(count)
        for first in range(0, int(ends[-1]) if len(ends) else 0, _POINTS_AT_ONCE):
            point = np.arange(first, min(first + _POINTS_AT_ONCE, ends[-1]))
            which = np.searchsorted(ends, point, side="right")
            turn = (shift[:, which] + _R4 * (point - (ends - count)[which])) % 1.0
            place, light = self._lit(which, turn)
            image += np.bincount(place, light * share[which], minlength=len(image) + 1)[:-1]

    def _lit(self, which: np.ndarray, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (N,), one past the last where there is none, and the light (N,) of facets from one point of each.

        By numbers (4, N) in 0..1 for the place in the facet and on the Sun's disc.
        """
        view, facet = self._view, self.facet[which]
        a, b, c = (self._solid.vertices_m[corner[which]].T for corner in self._corner)
        u, v = np.where(turn[0] + turn[1] > 1.0, 1.0 - turn[:2], turn[:2])
        r_body_m, normal = a + u * (b - a) + v * (c - a), self._solid.normals.take(facet, axis=0).T
        to_sun = np.broadcast_to(view.sun_direction_body[:, None], r_body_m.shape)
        if self._sun_radius_rad:
            root, angle = np.sqrt(turn[2]), 2.0 * np.pi * turn[3]
            to_sun = to_sun + self._sun_radius_rad * (sun_from_body(view.sun_direction_body)[:2].T
                                                      @ np.stack([root * np.cos(angle), root * np.sin(angle)]))
            to_sun /= np.sqrt(dot(to_sun, to_sun))
        to_camera = view.r_camera_body_m[:, None] - r_body_m
        range_m = np.sqrt(dot(to_camera, to_camera))
        to_camera /= range_m
        cos_emission, x0, y0 = dot(normal, to_camera), *self._roi[:2]
        along = -(view.camera_from_body @ to_camera)
        ahead = along[2] > 0.0
        column, row = np.rint(self._camera.places_px(along[:2] / np.where(ahead, along[2], 1.0))) - [[x0], [y0]]
        columns, rows = self._roi[2] - x0, self._roi[3] - y0
        is_asked = ahead & (column >= 0) & (row >= 0) & (column < columns) & (row < rows) & (cos_emission > 0.0) & (
            dot(normal, to_sun) > 0.0)
        is_asked &= self._engine.in_view(r_body_m, facet, view, self._views, is_asked)
        is_asked &= self._engine.in_light(r_body_m, facet, view, self._views, is_asked, to_sun=to_sun)
        lit = np.flatnonzero(is_asked)
        place, light = np.full(len(which), rows * columns), np.zeros(len(which))
        place[lit] = row[lit] * columns + column[lit]
        some = (each.take(lit, axis=-1) for each in (facet, r_body_m, normal, to_camera, to_sun, range_m))
        light[lit] = (self._engine.radiance(*some, view, self._camera) * cos_emission[lit]
                      * self._area_m2[which[lit]] / range_m[lit]**2)
        return place, light
