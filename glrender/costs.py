"""What drawing costs on a machine, as the planner reckons it. Pure."""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass

from .ray_engine import RAYS_AT_ONCE

RASTER_CALL_NS, RAYS_CALL_NS, AREAS_CALL_NS, MIDDLES_CALL_NS = 1.2e6, 4e5, 9e5, 1.5e5
"""Nanoseconds whatever is drawn, of a pass of OpenGL (an image, a shadow map), of rays, of areas or of middles."""
# Of areas, in a machine's unit: each facet, one that faces both camera and Sun, a pixel along its sides, a pixel of the
# body, and the edges of shadows at a budget of 1 and 90 deg of phase, by the angle between facets [rad]; and pixels
# below which the flux asks for more than they do. 336 frames of three shapes, 10 to 500 px, 20 to 140 deg, budgets of
# 0.01 to 0.1: 0.4 to 1.0 of what they took in eight of ten, median 0.7; of OpenGL 0.45 to 1.0, 0.7; of rays 0.35 to
# 1.4, 0.8.
_ANY_FACET, _FACING, _LINE, _PIXEL, _EDGES, _MOST_EDGES, _FLUX_PX = 0.4, 2.4, 1.9, 0.08, 0.39, 1e3, 100.0
# Of facets as lit as their middles, in the same unit: each facet, one that faces both, a pixel along its sides; and
# rays for each of those. What drawing one of them takes of it.
_ANY_MIDDLE, _MIDDLE, _MIDDLE_LINE, _MIDDLE_RAYS, _DRAWN = 0.03, 0.3, 0.15, 0.08, 0.12
# Of points that stand for them: each, and one that faces both.
_ANY_POINT, _POINT = 0.05, 0.45
# What a ray costs more for each doubling of the facets over the rays: memory that the ray before did not need. Itokawa
# with 49k to 3.1M facets at 20 to 2000 px.
_APART = 0.45


@dataclass(frozen=True, kw_only=True)
class EngineCosts:
    """Nanoseconds that drawing takes on a machine: measured by `engine_costs`.

    Attributes
    ----------
    facet_ns : float
        Of a facet in a pass of OpenGL, whether seen or not.
    sample_ns : float
        Of a sample that OpenGL shades.
    ray_ns : float
        Of a sample that meets a body, with its ray to the Sun, by all threads; infinite without rays.
    lone_ray_ns : float
        Of one among few, which a single thread casts.
    area_ns : float
        Unit of areas: less than half of a facet that faces camera and Sun; infinite without rays.
    """

    facet_ns: float
    sample_ns: float
    ray_ns: float
    lone_ray_ns: float = 0.0
    area_ns: float = math.inf

    @property
    def text(self) -> str:
        """The five in this order, as $GLRENDER_ENGINE_COSTS takes them."""
        return " ".join(f"{ns:.6g}" for ns in astuple(self))

    def rays_ns(self, n_rays: float, n_facets: float = 0.0) -> float:
        """Of a window with so many samples that meet a body, and so many facets that they may meet."""
        each = 1.0 + _APART * math.log2(1.0 + n_facets / max(n_rays, 1.0))
        return RAYS_CALL_NS + each * max(n_rays * self.ray_ns, min(n_rays, RAYS_AT_ONCE) * self.lone_ray_ns)

    def areas_ns(self, n_facets: float, n_facing: float, n_px: float = 0.0, facet_px: float = 0.0,
                 crease_rad: float = 0.0, phase_rad: float = 0.0, budget: float = 1.0) -> float:
        """Of a window by areas; by numbers of facets alone, the least that it may be.

        Parameters
        ----------
        n_facets, n_facing : float
            Of the bodies, and those in the window that face both camera and Sun.
        n_px : float [px]
            Of the bodies.
        facet_px : float [px]
            Side of the facets that face both, in the image.
        crease_rad : float [rad]
            Between neighbours.
        phase_rad : float [rad]
        budget : float [1]
        """
        lit_px = 0.5 * (1.0 + math.cos(phase_rad)) * n_px
        asked = budget * math.sqrt(min(max(lit_px / _FLUX_PX, 1e-6), 1.0))
        edges = min(_EDGES * crease_rad * math.tan(0.5 * phase_rad) ** 2 / asked, _MOST_EDGES)
        each = _FACING + _LINE * facet_px + edges
        return AREAS_CALL_NS + (_ANY_FACET * n_facets + _PIXEL * n_px + each * n_facing) * self.area_ns

    def middles_ns(self, n_facets: float, n_facing: float, n_px: float, facet_px: float,
                   shaded_share: float = 1.0) -> float:
        """The same of facets as lit as their middles: of a share of frames they are shaded anew."""
        shaded = ((_ANY_MIDDLE * n_facets + (_MIDDLE - _DRAWN) * n_facing) * self.area_ns
                  + self.rays_ns(_MIDDLE_RAYS * n_facing, n_facets))
        drawn = (_PIXEL * n_px + (_DRAWN + _MIDDLE_LINE * facet_px) * n_facing) * self.area_ns
        return MIDDLES_CALL_NS + drawn + shaded_share * shaded

    def points_ns(self, n_points: float, n_facing: float) -> float:
        """The same of points that stand for middles, of which some face both."""
        return MIDDLES_CALL_NS + (_ANY_POINT * n_points + _POINT * n_facing) * self.area_ns
