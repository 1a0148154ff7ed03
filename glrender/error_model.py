"""How wrong an image will be: what the planner predicts of samples, levels of detail and shadow maps.

Fitted to measurements against rays and kept above them (docs/planner.md); pure functions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from .constants import AU_M
from .level_tables import AreaLevel
from .lod_flux import FluxRatio
from .relief import Relief
from .view import FINE_FOOTPRINT, BodyView

# Squared error of one sample a pixel: limb and terminator, and creases between facets; as measured
# (docs/planner.md: 0.43, 0.34), times the square of what predictions are kept above the truth by.
_LIMB_ERROR, _LIT_POWER = 0.62, 1.15
_CREASE_ERROR, _CROWDING_POWER, _MOST_FACETS_PER_PX = 0.49, 0.35, 2.06
# Of surface detail's slope, which no layer has finer than two pixels: three kinds at 30 and 70 deg have 0.07 to 0.2.
_DETAIL_ERROR = 0.25
# What noise has more than edges of the same contrast, and facets a sample from which rough ones are noise.
_NOISE_GAIN, NOISE_FACETS = 0.85, 20.0
# Share of the squared error that sits at the edges of cast shadows, per radian of phase, at most.
_SHADOW_EDGES_PER_RAD, _MOST_SHADOW_EDGES = 0.1, 0.2
# Of shadows without penumbras, at a phase of 1 rad and 1 au.
_PENUMBRA_ERROR, _PENUMBRA_POWER, _PENUMBRA_PX = 0.006, 1.2, 300.0
_THIN_PENUMBRA = 75.0
# Width over the body's size: the Sun's angle times a tenth of it.
_PENUMBRA_WIDTH = 1e-3
# Leaked flux times texels, at 90 deg.
_LEAK, _LEAK_POWERS, _LEAK_CREASE_RAD = 1.9, (1.2, 1.57), 0.146
# Half a step of float32 coordinates, and RMS error for each pixel that they are off.
_FLOAT32, _ROUNDING_ERROR = 2.0**-24, 0.1
# RMS error of rays, over radii that a pixel sees.
_RAY_ROUNDING = 3e-8
# RMS error of a level of detail, and its flux error over the scatter of the ratio between aspects.
_LEVEL_ERROR, _OUTLINE_ERROR, _FLUX_SCATTERS = 0.5, 1.2, 2.5
# Facets that a pixel sees, about, times squared size over all of them: half of them face it, on 0.6 of the square.
FACETS_SEEN = 0.5 / 0.6
# What slivers between samples add to the error that an image tells, per radian beyond a phase angle.
_SLIVERS_PER_RAD, _SLIVERS_FROM_RAD = 2.5, 2.55


@dataclass(frozen=True, kw_only=True)
class LevelTraits:
    """What the planner must know of a level of detail; the first is the full shape.

    Attributes
    ----------
    n_facets : int
    crease_rad : float [rad]
        RMS angle between neighbouring facets of what is shaded.
    deviation_m : float [m]
        RMS distance from the full shape.
    flux_ratio : FluxRatio or None
        Of the full shape over the level.
    detail_slope : float [1]
        RMS, of the surface detail that is drawn on it.
    """

    n_facets: int
    crease_rad: float
    deviation_m: float = 0.0
    flux_ratio: FluxRatio | None = None
    detail_slope: float = 0.0

    @property
    def slope(self) -> float:
        """RMS angle of creases [rad] that err as its own and its surface detail do."""
        return math.hypot(self.crease_rad, _DETAIL_ERROR * self.detail_slope / math.sqrt(_CREASE_ERROR))


@dataclass(frozen=True, kw_only=True)
class BodyTraits:
    """What the planner must know of a body."""

    radius_m: float
    is_convex: bool
    law: str
    max_phase_rad: float
    levels: tuple[LevelTraits, ...]
    longest_side_m: float = 0.0
    """Of any facet."""
    relief: Relief | None = None
    area_levels: tuple[AreaLevel, ...] = ()
    """Of the levels after the first, by areas: none where facets are not as bright everywhere."""
    even_facet_m: float = math.inf
    """Side of facets, each as bright everywhere, by their areas; infinite with a texture, smooth normals or detail."""
    reflectance: float = 1.0
    """BRDF [1/sr] with the Sun 30 deg off the camera overhead."""


def rounding_px(view: BodyView, traits: BodyTraits, is_relative: bool) -> float:
    """How far [px] OpenGL's float32 coordinates put what is nearest, about the body's origin or relative to the camera.

    Relative to it the ends of long facets are off, and all that is between them.
    """
    reach_m = traits.radius_m
    if is_relative:
        reach_m = min(max(traits.longest_side_m, view.depth_m[0]), 2.0 * reach_m)
    return _FLOAT32 * reach_m / view.footprint_m if view.is_visible else 0.0


def rounding_error(view: BodyView, traits: BodyTraits, is_relative: bool) -> float:
    """RMS error of what `rounding_px` tells of.

    Of a sphere's facets seen from 1e-6 to 1e-8 of their size, and of a bar of 1e6 times its width, it is 0.012 to 0.04
    for each pixel.
    """
    return min(_ROUNDING_ERROR * rounding_px(view, traits, is_relative), 1.0)


def ray_rounding_error(view: BodyView, traits: BodyTraits) -> float:
    """RMS error of Embree's float32 coordinates, and of how far off facets rays start (`rays`).

    Of a pillar's shadow on a slab it is 0.0055 where a pixel sees 5e-6 radii; with less, rays are cast in float64.
    """
    if view.footprint_m <= FINE_FOOTPRINT * traits.radius_m:
        return 0.0
    return _RAY_ROUNDING * traits.radius_m / view.footprint_m


def parallel_error(view: BodyView, traits: BodyTraits) -> float:
    """Error of one direction to the Sun, and one distance from it, for all of a body."""
    return traits.radius_m / (view.sun_distance_au * AU_M)


def level_error(view: BodyView, level: LevelTraits, footprint_m: float) -> float:
    """RMS error of a level of detail, shaded with the normals of the full shape.

    Facets' normals on eight shapes at 5 to 500 px and 5 to 150 deg, and outlines that moved on four at 100 to
    1000 px and 20 to 90 deg, Lambert and Lommel-Seeliger: the truth is within in 96 %, its median 0.65 of it
    (docs/planner.md).
    """
    if not level.deviation_m:
        return 0.0
    tilt = (0.4 + min(math.tan(0.5 * view.phase_rad), 30.0) ** 2) ** 0.64
    diameter = min(max(view.size_px, 1.0), 1e5)
    deviation_px = level.deviation_m / footprint_m
    normals = (_LEVEL_ERROR * level.crease_rad * tilt * deviation_px**0.074
               * max(level.n_facets / diameter**2, 0.01) ** -0.1)
    lit = lit_share(view.phase_rad)
    return math.hypot(normals, _OUTLINE_ERROR * (deviation_px / math.sqrt(diameter)) ** 0.75 / lit)


def lit_share(phase_rad: float, least: float = 1e-3) -> float:
    """Of a sphere's disc, what is lit at a phase angle, and a least."""
    return max(0.5 * (1.0 + math.cos(phase_rad)), least)


def level_flux_error(view: BodyView, level: LevelTraits) -> float:
    """Error of the flux after the mean over aspects is put right; one aspect in ten has more."""
    return 0.0 if level.flux_ratio is None else _FLUX_SCATTERS * level.flux_ratio.at(view.phase_rad)[1]


def squared_errors(view: BodyView, level: LevelTraits) -> tuple[float, float]:
    """Squared RMS error of one sample a pixel: of outlines, and of creases.

    n x n samples have n^-3 of it. Measured on twelve shapes at 12 to 1000 px and 5 to 150 deg: within 30 %.
    """
    diameter = min(max(view.size_px, 1.0), 1e5)
    lit = lit_share(view.phase_rad)
    noise = noise_gain(level.crease_rad, facets_per_px(view, level.n_facets)) ** 2
    crowding = min(facets_per_px(view, level.n_facets), _MOST_FACETS_PER_PX) ** _CROWDING_POWER
    tilt = (0.02 + min(math.tan(0.5 * view.phase_rad), 30.0) ** 2) ** 0.71
    return (_LIMB_ERROR / diameter * lit**-_LIT_POWER,
            (_CREASE_ERROR * level.crease_rad**2 * crowding * noise + (_DETAIL_ERROR * level.detail_slope) ** 2) * tilt)


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


def sliver_gain(phase_rad: float) -> float:
    """Error over what an image tells of itself: thin crescents have light between samples that nothing tells.

    Of 24 crescents at 136 to 162 deg, 40 to 300 px, those beyond 150 deg had up to 1.5 times the error that was told.
    """
    return 1.0 + _SLIVERS_PER_RAD * max(phase_rad - _SLIVERS_FROM_RAD, 0.0)


def facets_per_px(view: BodyView, n_facets: int) -> float:
    """Facets that a pixel of a body sees, about."""
    return FACETS_SEEN * n_facets / min(max(view.size_px, 1.0), 1e5) ** 2


def shadow_share(view: BodyView, shadow_map_px: int, may_be_eclipsed: bool = False) -> float:
    """Share of one sample's squared error that the texels of a shadow map leave at the edges of shadows."""
    # Of a part of a body, or of what another body's shadow leaves of it, its edges of shadows may be all that there is.
    is_usual = view.is_whole and not may_be_eclipsed
    return (usual_edges(view) if is_usual else 1.0) * texel_share(view, shadow_map_px)


def usual_edges(view: BodyView) -> float:
    """Share of one sample's squared error at the edges of cast shadows, of a whole body."""
    return min(_SHADOW_EDGES_PER_RAD * view.phase_rad, _MOST_SHADOW_EDGES)


def texel_share(view: BodyView, shadow_map_px: int) -> float:
    """Squared error at the edges of shadows, with the texels of a shadow map over one sample a pixel."""
    return (view.finest_px / shadow_map_px) ** 3


def leaked_flux(view: BodyView, level: LevelTraits, shadow_map_px: int) -> float:
    """Share of the flux that leaks through what the texels of a shadow map cannot see.

    The lower the Sun and the rougher the facets, the more. Measured on four shapes with creases of 0.06 to
    0.31 rad at 30 to 150 deg with 256 to 4096 texels across, kept above.
    """
    tangent = math.tan(min(0.5 * view.phase_rad, 1.5))
    roughness = max(level.crease_rad / _LEAK_CREASE_RAD, 1.0)
    return _LEAK * max(tangent**_LEAK_POWERS[0], tangent**_LEAK_POWERS[1]) * roughness**1.5 / shadow_map_px


@dataclass(frozen=True, kw_only=True)
class Penumbra:
    """Of a body's shadows on itself, where the Sun has a disc.

    Attributes
    ----------
    error : float [1]
        RMS error of hard edges in its place.
    width_px : float [px]
        Of the widest.
    """

    error: float
    width_px: float


NO_PENUMBRA = Penumbra(error=0.0, width_px=0.0)


def own_penumbra(view: BodyView) -> Penumbra:
    """Of a body's shadows on itself.

    Measured on Itokawa, 500 px across at 1 au: 0.0041 at 60 deg, 0.0094 at 120; a contact binary has
    half as much again. Flux within 1e-4. It grows no more
    where penumbras are wider than pixels.
    """
    sharpness = min(view.finest_px / _PENUMBRA_PX, 1.0)
    error = _PENUMBRA_ERROR * view.phase_rad**_PENUMBRA_POWER * sharpness / math.sqrt(view.sun_distance_au)
    return Penumbra(error=error, width_px=_PENUMBRA_WIDTH * view.finest_px / view.sun_distance_au)


def thin_penumbra(view: BodyView) -> float:
    """Ten times the relative flux error of hard edges on a thin crescent, where the Sun is as low as it is wide.

    A rough binary at 172, 175, 177 deg: 0.6, 3, 6 % of the flux.
    """
    angle = view.sun_radius_rad
    return _THIN_PENUMBRA * (angle / max(math.pi - view.phase_rad, angle)) ** 2
