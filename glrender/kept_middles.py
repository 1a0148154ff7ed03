"""Which facets of a shape camera and Sun see the middles of, and how bright they are; kept where that takes long.

Which they are changes little while Sun and camera hardly move about the body, as its shadow map does.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from glrender_camera import threads

from . import facet_loops
from .facet_parts import projected
from .facet_relief import FacetRelief
from .facet_tables import FacetTables
from .kept_nodes import KeptAtNodes, camera_at_node
from .level_tables import is_kept
from .lit_triangles import LitTriangles
from .ray_engine import RayEngine
from .surface import Surface
from .view import BodyView

# Steps of a table of BRDF by a normal's place out of the plane of Sun and camera.
_STEPS = 24
# And by the root of the distance of their unit vectors, which is a phase angle [rad], about: close to 0, where surfaces
# surge, steps are small. Powers of 2, at least so many in a table: the same nodes in one frame and the next.
_LEAST_STEP, _MOST_STEP, _LEAST_STEPS = 2.0**-7, 2.0**-5, 4.0
# Least angle off the limb and the terminator [rad], and least part of a normal.
_EDGE_ON = 1e-6
# Facets in a turn; and one of so many tells of edges of light: an odd number, as divided shapes come in fours.
_BLOCK, _SAMPLED = 1 << 12, 3
# Steps of the grid of directions in 1 rad, and of ranges in a factor e: a shadow 100 px long moves by 0.07 px.
_DIRECTIONS, _RANGES = 512, 64


class KeptMiddles:
    """The radiance of shapes' facets as their middles are lit; of large shapes, what is kept from frame to frame."""

    def __init__(self):
        self._kept = KeptAtNodes(_DIRECTIONS, _RANGES)
        self._tables = BrdfTables()

    def forget(self) -> None:
        """Look anew in the next frame; no image changes."""
        self._kept.forget()

    def close(self) -> None:
        """Forget, and look for nothing any more."""
        self._kept.close()

    def triangles(self, facets: FacetTables, view: BodyView, rays: RayEngine, *, has_relief: bool
                  ) -> LitTriangles | None:
        """The facets of a large shape that are seen and lit, as bright as at a distance of 1 au; None of others.

        Parameters
        ----------
        facets : FacetTables
            With horizons of their middles.
        view : BodyView
            Of the body: all of it is before the camera.
        rays : RayEngine
        has_relief : bool
            Whether facets are as bright as what they stand for.
        """
        if not is_kept(facets.n_facets, view, facets.solid.radius_m):
            return None

        def make(node: BodyView) -> LitTriangles:
            radiance = _radiance(facets, node, rays, has_relief, 1.0, self._tables)
            lit = np.flatnonzero(radiance)
            vertex, _, corners = facet_loops.vertices_of(facets.corners, lit, facets.vertices_m.shape[1])
            return LitTriangles(facets.vertices_m.take(vertex, axis=1), corners, lit, radiance.take(lit), facets, node,
                                edges_of(facets, radiance,
                                         projected(facets.vertices_m, node, camera_at_node(1.0)), node))

        return self._kept.at(view, facets.solid.radius_m, (facets, has_relief), make)[1]

    def radiance(self, facets: FacetTables, view: BodyView, rays: RayEngine, *, has_relief: bool,
                 brightness: float) -> np.ndarray:
        """BRDF [1/sr] times the cosine of incidence, and a brightness (F,): 0 of what is dark, or not seen.

        The others as `triangles` takes them.
        """
        triangles = self.triangles(facets, view, rays, has_relief=has_relief)
        if triangles is None:
            return _radiance(facets, view, rays, has_relief, brightness, self._tables)
        found = np.zeros(facets.n_facets)
        found[triangles.facet] = triangles.radiance(view, brightness)
        return found


def edges_of(facets: FacetTables, radiance: np.ndarray, xy: np.ndarray, view: BodyView) -> np.ndarray:
    """`facet_loops.lit_edges` by vertices' places (2, V): of a part of the facets, as ratios of sums tell the error."""
    return facet_loops.lit_edges(facets.middles.facets, radiance, facets.neighbours, facets.corners, xy, _SAMPLED,
                                 view.sun_direction_body, view.r_camera_body_m)


def _radiance(facets: FacetTables, view: BodyView, rays: RayEngine, has_relief: bool, brightness: float,
              tables: BrdfTables) -> np.ndarray:
    radiance, asked, (is_seen, is_lit) = facets.middles.shade(
        view.sun_direction_body, view.r_camera_body_m,
        *tables.of(facets.surface, view, facets.solid.radius_m, brightness))
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


class BrdfTables:
    """BRDF of surfaces as `horizon_loops.shade_middles` takes it: what is worked out once serves all frames."""

    def __init__(self):
        self._made: dict[tuple[Surface, float], np.ndarray] = {}

    def of(self, surface: Surface, view: BodyView, radius_m: float, brightness: float
           ) -> tuple[np.ndarray, float, float]:
        """BRDF [1/sr] of facets times the cosines of incidence and emission, for all phase angles on a body.

        Beyond the terminator and the limb as on them.

        Parameters
        ----------
        surface : Surface
        view : BodyView
        radius_m : float [m]
        brightness : float
            What it is times as well.

        Returns
        -------
        table : (C, 2 S + 1, S + 1) float64
            By roots of the distance of the unit vectors to Sun and camera, by the normal's place around a square in
            their plane, and its part in that plane.
        first, step : float
            Of the roots.
        """
        aside = math.asin(min(radius_m / view.range_m, 1.0))
        first, last = (math.sqrt(2.0 * math.sin(0.5 * min(max(view.phase_rad + turn, 0.0), math.pi)))
                       for turn in (-aside, aside))
        step = max((last - first) / _LEAST_STEPS, _LEAST_STEP)
        step = min(2.0 ** math.floor(math.log2(step)), _MOST_STEP)
        node = math.floor(first / step)
        roots = [step * each for each in range(node, max(math.ceil(last / step), node + 1) + 1)]
        for root in roots:
            if (surface, root) not in self._made:
                self._made[surface, root] = _brdf_at(surface, root)
        return brightness * np.stack([self._made[surface, root] for root in roots]), roots[0], step


@cache
def _places() -> tuple[np.ndarray, ...]:
    """Of a table, angles in the plane, and parts of the normal in it and out of it."""
    place, part = np.meshgrid(np.arange(-_STEPS, _STEPS + 1) / _STEPS, np.arange(_STEPS + 1) / _STEPS, indexing="ij")
    part = np.maximum(part, _EDGE_ON)
    return np.arctan2(place, 1.0 - np.abs(place)), part, np.sqrt(1.0 - part * part)


def _brdf_at(surface: Surface, root: float) -> np.ndarray:
    """One root's part (2 S + 1, S + 1) of a table."""
    angle, part, aside = _places()
    phase_rad = 2.0 * math.asin(min(0.5 * root**2, 1.0))
    to_sun, to_camera = np.array([math.cos(phase_rad), math.sin(phase_rad), 0.0]), np.array([1.0, 0.0, 0.0])
    both = np.clip(angle, phase_rad - 0.5 * math.pi + _EDGE_ON, 0.5 * math.pi - _EDGE_ON)
    normal = np.stack([part * np.cos(both), part * np.sin(both), aside], axis=-1)
    brdf = surface.brdf(to_sun, to_camera[None], normal.reshape(-1, 3), np.ones(angle.size)).reshape(angle.shape)
    return brdf * (normal @ (to_sun + to_camera))
