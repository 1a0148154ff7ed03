"""The error that the planner predicts of an image's samples and shadow maps. Pure.

Each constant is fitted to measurements against the ray tracer and kept above them; `benchmarks/heldout.py` holds the
predictions against scenes that no constant was fitted to.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..base.constants import AU_M
from ..scene.detail.height_field import Relief
from ..view.view import FINE_FOOTPRINT, BodyView

# Error of noise over that of an edge of the same contrast [1]: four rough shapes with 0.1 to 300 facets a sample.
_NOISE_GAIN = 0.85
NOISE_FACETS = 20.0
"""Facets a sample from which rough facets are noise."""
# Share of the squared error at the edges of cast shadows, per radian of phase, and at most: round choices.
_SHADOW_EDGES_PER_RAD = 0.1
_MOST_SHADOW_EDGES = 0.2
# Flux that leaks through a shadow map, times its texels, at 90 deg: four shapes, creases of 0.06 to 0.31 rad, 30 to
# 150 deg, 256 to 4096 texels.
_LEAK = 1.9
_LEAK_POWERS = (1.2, 1.57)
_LEAK_CREASE_RAD = 0.146
# Half a step of float32 coordinates [1], and RMS error [1/px] for each pixel that they are off: a sphere's facets seen
# from 1e-6 to 1e-8 of their size, and a bar of 1e6 times its width, have 0.012 to 0.04.
_FLOAT32 = 0.5 * float(np.finfo(np.float32).eps)
_ROUNDING_ERROR = 0.1
# RMS error of rays over radii that a pixel sees [1]: a pillar's shadow on a slab has 0.0055 at 5e-6 radii.
_RAY_ROUNDING = 3e-8
FEWEST_CENTROIDS = 10_000
"""Facets from which a shape is drawn by centroids: fewer are soon clipped."""
SMOOTH_PER_RAD = 3.0
"""Relative change of radiance with the direction of view [1/rad] up to which a plane holds it: highlights have more."""
FACETS_SEEN = 0.83
"""Facets that a pixel sees times squared size over all facets: half face it, on 0.6 of the square."""
CRESCENT_RAD = 2.1
"""Phase angle [rad] from which light falls in narrow crescents: at 143 deg 2 x 2 first samples lead to 1.4
times the error of 4 x 4."""
# Phase angle [rad] from which samples miss some of a crescent's light.
_SLIVERS_RAD = 2.55
# Error over the estimate of an image, per radian of phase beyond it: 24 crescents at 136 to 162 deg, 40 to 300 px.
_CRESCENTS_PER_RAD = 2.5


@dataclass(frozen=True, kw_only=True)
class BodyTraits:
    """The traits of a body that the planner needs.

    Attributes
    ----------
    radius_m : float [m]
    is_convex : bool
    law : str
        Or laws, of a body of materials.
    max_phase_rad : float [rad]
        Up to which all of them hold.
    n_facets : int
    crease_rad : float [rad]
        RMS angle between neighbouring facets.
    relief : Relief or None
        Surface detail.
    detail_slope : float [1]
        RMS slope of the detail that is drawn.
    longest_side_m : float [m]
        Of any facet.
    view_slope : callable
        (phase angle [rad]) gives the relative change of its radiance with the direction that it is seen from [1/rad].
    facet_m : float [m]
        Side of facets, by their areas; infinite where a facet is not as bright everywhere: with a texture, smooth
        normals or surface detail.
    is_of_one_look : bool
        Whether one law is that of all facets.
    """

    radius_m: float
    is_convex: bool
    law: str
    max_phase_rad: float
    n_facets: int
    crease_rad: float
    relief: Relief | None = None
    detail_slope: float = 0.0
    longest_side_m: float = 0.0
    view_slope: Callable[[float], float] = lambda phase_rad: 0.0
    facet_m: float = math.inf
    is_of_one_look: bool = True

    def breaks_highlights(self, phase_rad: float) -> bool:
        """Whether flat facets turn from one to the next by more than half the width of a highlight."""
        slope = self.view_slope(phase_rad) if math.isfinite(self.facet_m) else 0.0
        return slope > SMOOTH_PER_RAD and 2.0 * slope * self.crease_rad > 1.0

    @property
    def slope(self) -> float:
        """RMS angle of creases [rad] that err as its own and its surface detail do, at most."""
        return math.hypot(self.crease_rad, self.detail_slope)


def rounding_px(view: BodyView, traits: BodyTraits, is_relative: bool) -> float:
    """Errors [px] of the nearest points by OpenGL's float32 coordinates, about the body's origin or the camera.

    Relative to it the ends of long facets are off, and all that is between them.
    """
    reach_m = traits.radius_m
    if is_relative:
        reach_m = min(max(traits.longest_side_m, view.depth_m[0]), 2.0 * reach_m)
    return _FLOAT32 * reach_m / view.footprint_m if view.is_visible else 0.0


def rounding_error(view: BodyView, traits: BodyTraits, is_relative: bool) -> float:
    """RMS error of places that are off by `rounding_px`.

    Of a sphere's facets seen from 1e-6 to 1e-8 of their size, and of a bar of 1e6 times its width, it is 0.012 to 0.04
    for each pixel.
    """
    return min(_ROUNDING_ERROR * rounding_px(view, traits, is_relative), 1.0)


def ray_rounding_error(view: BodyView, traits: BodyTraits) -> float:
    """RMS error of Embree's float32 coordinates, and of how far off facets rays start (`rays`).

    Of a pillar's shadow on a slab it is 0.0055 where a pixel sees 5e-6 radii; facets of which a pixel would see less
    than `FINE_FOOTPRINT` have coordinates about the camera.
    """
    return _RAY_ROUNDING / max(view.footprint_m / traits.radius_m, FINE_FOOTPRINT)


def parallel_error(view: BodyView, traits: BodyTraits) -> float:
    """Error of one direction to the Sun, and one distance from it, for all of a body."""
    return traits.radius_m / (view.sun_distance_au * AU_M)


def lit_share(phase_rad: float, least: float = 1e-3) -> float:
    """The share of a sphere's disc that is lit at a phase angle, and a least."""
    return max(0.5 * (1.0 + math.cos(phase_rad)), least)


def centroids(crease_rad: float) -> str:
    """The way to draw facets by their centroids: many of a rough limb are hidden or shaded in part."""
    return "rough centroids" if noise_gain(crease_rad, NOISE_FACETS) > 1.0 else "centroids"


def noise_gain(crease_rad: float, facets_per_sample: float) -> float:
    """Error over that of edges of the same contrast: rough facets much smaller than samples are noise.

    The range of nine samples of noise is three of its deviations, and an edge's error is a sixth of
    its height. Of four rough shapes with 0.1 to 300 facets a sample the truth has 1.1, 1.2, 1.3, 1.7 times an edge's at
    0.6, 2, 6, 20.
    """
    rough = min(max((crease_rad - 0.15) / 0.25, 0.0), 1.0)
    return 1.0 + _NOISE_GAIN * rough * math.sqrt(min(facets_per_sample / NOISE_FACETS, 1.0))


def noise_power(gain: float) -> float:
    """Power of the samples along a pixel's side that divides the squared error: 3 for edges, 2 for noise."""
    return 3.0 - (gain - 1.0) / _NOISE_GAIN


def crescent_gain(phase_rad: float) -> float:
    """Error over the estimate from an image's contrast: thin crescents have light between samples, which none shows.

    Of 24 crescents at 136 to 162 deg, 40 to 300 px, those beyond 150 deg had up to 1.5 times the estimated error.
    """
    return 1.0 + _CRESCENTS_PER_RAD * max(phase_rad - _SLIVERS_RAD, 0.0)


def facets_per_px(view: BodyView, n_facets: int) -> float:
    """Facets that a pixel of a body sees, about."""
    return FACETS_SEEN * n_facets / min(max(view.size_px, 1.0), 1e5) ** 2


def shadow_share(view: BodyView, shadow_map_px: int, may_be_eclipsed: bool = False) -> float:
    """Share of one sample's squared error that the texels of a shadow map leave at the edges of shadows."""
    return usual_edges(view, may_be_eclipsed) * (view.finest_px / shadow_map_px) ** 3


def usual_edges(view: BodyView, may_be_eclipsed: bool) -> float:
    """Share of one sample's squared error at the edges of cast shadows."""
    # A part of a body, or the part that another body's shadow leaves, may consist of edges alone.
    is_usual = view.is_whole and not may_be_eclipsed
    return min(_SHADOW_EDGES_PER_RAD * view.phase_rad, _MOST_SHADOW_EDGES) if is_usual else 1.0


def leaked_flux(view: BodyView, traits: BodyTraits, shadow_map_px: int) -> float:
    """Share of the flux that leaks through what the texels of a shadow map cannot see.

    The lower the Sun and the rougher the facets, the more. Measured on four shapes with creases of 0.06 to
    0.31 rad at 30 to 150 deg with 256 to 4096 texels across, kept above.
    """
    tangent = math.tan(min(0.5 * view.phase_rad, 1.5))
    roughness = max(traits.crease_rad / _LEAK_CREASE_RAD, 1.0)
    return _LEAK * max(tangent**_LEAK_POWERS[0], tangent**_LEAK_POWERS[1]) * roughness**1.5 / shadow_map_px
