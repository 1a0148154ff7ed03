"""Which facets of a shape camera and Sun see the middles of, and how bright they are; kept where that takes long.

Which they are changes little while Sun and camera hardly move about the body, as its shadow map does.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass, replace

import numpy as np
from glrender_camera import threads

from . import facet_loops
from .facet_relief import FacetRelief
from .facet_tables import FacetTables
from .level_tables import is_kept
from .ray_engine import RayEngine
from .surface import Surface
from .view import BodyView, phase_angle, snapped

# Steps of a table of BRDF by a normal's place out of the plane of Sun and camera; and by the root of the distance of
# their unit vectors, which is a phase angle [rad], about.
_STEPS, _CHORD = 24, 0.03
# Least angle off the limb and the terminator [rad], and least part of a normal.
_EDGE_ON = 1e-6
# Cosine beyond the terminator at which no light is left: relief has some on it.
_BEYOND = 0.02
# Facets in a turn, and where hardly anything is done with most.
_BLOCK, _SCANNED = 1 << 12, 1 << 17
# Steps of the grid of directions in 1 rad, and of ranges in a factor e: a shadow 100 px long moves by 0.07 px.
_DIRECTIONS, _RANGES = 512, 64
# How many there are at a time.
_MOST_KEPT = 8


@dataclass(frozen=True, kw_only=True, eq=False)
class _Seen:
    """Facets (N,) int32 whose middles Sun and camera see, and how bright (N,) float32, at a phase angle.

    Radiance over the cosine of incidence and `_BEYOND`.
    """

    facet: np.ndarray
    brightness: np.ndarray
    phase_rad: float


class KeptMiddles:
    """The radiance of shapes' facets as their middles are lit; of large shapes, what is kept from frame to frame."""

    def __init__(self):
        self._kept: OrderedDict[tuple, _Seen] = OrderedDict()

    def forget(self) -> None:
        """Look anew in the next frame; no image changes."""
        self._kept.clear()

    def radiance(self, facets: FacetTables, view: BodyView, rays: RayEngine, *, has_relief: bool,
                 brightness: float) -> np.ndarray:
        """BRDF [1/sr] times the cosine of incidence, and a brightness (F,): 0 of what is dark, or not seen.

        Parameters
        ----------
        facets : FacetTables
            With horizons of their middles.
        view : BodyView
            Of the body: all of it is before the camera.
        rays : RayEngine
        has_relief : bool
            Whether facets are as bright as what they stand for.
        brightness : float
        """
        if not is_kept(facets.n_facets, view, facets.solid.radius_m):
            return _radiance(facets, view, rays, has_relief, brightness)
        seen = self._seen(facets, _at_node(view, facets.solid.radius_m), rays, has_relief)
        found = np.zeros(facets.n_facets)
        gain = brightness * (_symmetric_brdf(facets.surface, view.phase_rad)
                             / _symmetric_brdf(facets.surface, seen.phase_rad))

        def light(part: slice) -> None:
            facet_loops.light(facets.middles.facets, seen.facet, seen.brightness, part.start, part.stop,
                              view.sun_direction_body, view.r_camera_body_m, gain, _BEYOND, found)

        threads.run_in_parts(light, len(seen.facet), _BLOCK)
        return found

    def _seen(self, facets: FacetTables, node: BodyView, rays: RayEngine, has_relief: bool) -> _Seen:
        key = (facets, has_relief, *node.sun_direction_body.tolist(), *node.r_camera_body_m.tolist())
        if key not in self._kept:
            radiance = _radiance(facets, node, rays, has_relief, 1.0)

            # No product of NumPy's: threads spin for a while after those.
            def find(part: slice) -> tuple[np.ndarray, np.ndarray]:
                return facet_loops.seen(facets.middles.facets, radiance, part.start, part.stop,
                                        node.sun_direction_body, _BEYOND)

            found = threads.run_in_parts(find, facets.n_facets, _SCANNED)
            facet, brightness = (np.concatenate(arrays) for arrays in zip(*found, strict=True))
            self._kept[key] = _Seen(facet=facet, brightness=brightness, phase_rad=node.phase_rad)
            if len(self._kept) > _MOST_KEPT:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return self._kept[key]


def _at_node(view: BodyView, radius_m: float) -> BodyView:
    """The view from the nearest nodes of Sun and camera: which they are does not depend on frames before."""
    to_sun = snapped(view.sun_direction_body, _DIRECTIONS)
    range_m = radius_m * math.exp(round(math.log(view.range_m / radius_m) * _RANGES) / _RANGES)
    to_camera = snapped(view.r_camera_body_m / view.range_m, _DIRECTIONS)
    return replace(view, sun_direction_body=to_sun, r_camera_body_m=range_m * to_camera, range_m=range_m,
                   phase_rad=phase_angle(to_sun, to_camera))


def _symmetric_brdf(surface: Surface, phase_rad: float) -> float:
    """BRDF [1/sr] where incidence and emission are half of the phase angle."""
    half = 0.5 * phase_rad
    to_sun, to_camera = (np.array([sign * math.sin(half), 0.0, math.cos(half)]) for sign in (1.0, -1.0))
    return float(surface.brdf(to_sun, to_camera[None], np.array([[0.0, 0.0, 1.0]]), np.ones(1))[0])


def _radiance(facets: FacetTables, view: BodyView, rays: RayEngine, has_relief: bool, brightness: float) -> np.ndarray:
    roots = chord_roots(view, facets.solid.radius_m)
    radiance, asked, (is_seen, is_lit) = facets.middles.shade(
        view.sun_direction_body, view.r_camera_body_m, brightness * brdf_table(facets.surface, roots), roots)
    middle_m, number = facets.middles.facets[asked, 3:].T.astype(float), facets.number.take(asked)
    # Where neither was in doubt, both are so.
    sees = rays.in_view(facets.solid, middle_m, number, view, [view], is_seen) | ~is_seen
    sees &= rays.in_light(facets.solid, middle_m, number, view, [view], is_lit & sees) | ~is_lit
    radiance[asked[~sees]] = 0.0
    if has_relief:
        relief = FacetRelief.of(facets.level, facets.surface, view)
        lit = np.flatnonzero(radiance)

        def add(part: slice) -> None:
            some = lit[part]
            added = relief.added(facets.number.take(some), facets.normal.take(some, axis=1))
            radiance[some] = np.maximum(radiance[some] + added * brightness, 0.0)

        threads.run_in_parts(add, len(lit), _BLOCK)
    return radiance


def brdf_table(surface: Surface, roots: np.ndarray) -> np.ndarray:
    """BRDF [1/sr] of facets times the cosines of incidence and emission, as `horizon_loops.shade_middles` takes it.

    By the roots of distances (C,) of the unit vectors to Sun and camera, the places around a square in their plane, and
    the parts of the normal in it. Beyond the terminator and the limb as on them.
    """
    place, part = np.meshgrid(np.arange(-_STEPS, _STEPS + 1) / _STEPS, np.arange(_STEPS + 1) / _STEPS, indexing="ij")
    angle, part = np.arctan2(place, 1.0 - np.abs(place)), np.maximum(part, _EDGE_ON)
    to_camera, found = np.array([[1.0, 0.0, 0.0]]), []
    for root in roots:
        phase_rad = 2.0 * math.asin(min(0.5 * root**2, 1.0))
        to_sun = np.array([math.cos(phase_rad), math.sin(phase_rad), 0.0])
        both = np.clip(angle, phase_rad - 0.5 * math.pi + _EDGE_ON, 0.5 * math.pi - _EDGE_ON)
        normal = np.stack([part * np.cos(both), part * np.sin(both), np.sqrt(1.0 - part * part)], axis=-1)
        brdf = surface.brdf(to_sun, to_camera, normal.reshape(-1, 3), np.ones(place.size)).reshape(place.shape)
        found.append(brdf * (normal @ (to_sun + to_camera[0])))
    return np.stack(found)


def chord_roots(view: BodyView, radius_m: float) -> np.ndarray:
    """Roots of distances of the unit vectors to Sun and camera, as seen from anywhere on the body, in even steps.

    Close to 0 surfaces surge, and steps are small.
    """
    aside = math.asin(min(radius_m / view.range_m, 1.0))
    ends = [math.sqrt(2.0 * math.sin(0.5 * min(max(view.phase_rad + turn, 0.0), math.pi))) for turn in (-aside, aside)]
    return np.linspace(*ends, 2 + math.ceil((ends[1] - ends[0]) / _CHORD))
