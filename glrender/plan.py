"""The planner: the cheapest configuration that meets an error budget. Pure: no GL, no images.

What it expects of an image is in `error_model.py`; benchmarks/heldout.py holds it against rays.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from glrender_camera import PinholeCamera

from .emission_frame import EmissionPlan
from .error_model import (
    NO_PENUMBRA,
    BodyTraits,
    LevelTraits,
    Penumbra,
    facets_per_px,
    flux_error,
    leaked_flux,
    level_error,
    level_flux_error,
    noise_gain,
    noise_power,
    samples_across,
    shadow_share,
    squared_errors,
)
from .grouping import region, touching
from .refine import SAMPLE_COUNTS
from .view import BodyView

EMISSION_LEFT_OUT = "emission around"
"""How a plan begins to say that light which no surface scatters is not in the image."""
MAX_SAMPLES = 16
"""Most samples along a pixel's side."""
SHADOW_SIZES_PX = tuple(2**k for k in range(8, 17))
"""Texels across a body; float32 coordinates have 256 steps in the finest."""
MAX_SHADOW_SIDE_PX = 4096
"""Most texels along a side of a shadow map."""
# Of the budget, what the shadow map may take; and the RMS error of light that leaks, over that of the flux.
_SHADOW_SHARE, _LEAK_RMS = 0.4, 2.0
# A body that is smaller has a grid of its own.
_SMALL_PX = 4.0
# Error of its pixels over that of its flux, at most.
_SMALL_PIXELS = 4.0
# Of the budget, what a level of detail may take, of the image and of the flux.
_LEVEL_SHARE, _FLUX_SHARE = 0.7, 0.1
# Share of the sunlit surface in cast shadow, per radian of phase (engine.md: 6 % at 10 deg).
_SHADOWED_PER_RAD = 0.34
# Cost of a sample passed over, in samples that are shaded; and of a ray that meets nothing, in rays that do.
_PASSED_OVER_COST, _MISS_COST = 0.45, 0.15
# Cost of a texel of a shadow map, in samples (engine.md: 2.3 ns of 20).
_TEXEL_COST = 0.1
# Of the budget, what a guess may take that shall not need a second pass: where a pass costs more than its
# samples, and where it costs less.
_SURE, _LIKELY = 0.7, 0.85
# Fewest samples along a pixel's side of a low Sun's slivers, where the budget would notice one that is missed.
_SLIVER_SAMPLES, _SLIVER_PHASE_RAD, _SLIVER_BUDGET = 3, 1.4, 0.03
# Penumbras by rays are noise: creases and facets that say so; and fewest samples along a pixel's side.
_PENUMBRA_NOISE, _PENUMBRA_SAMPLES = (0.33, 1e4), 2
# Nanoseconds of a call whatever it draws: of OpenGL, of rays in NumPy.
_RASTER_CALL_NS, _RAYS_CALL_NS = 5e5, 1.5e6


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
        Of a sample that meets a body, with its ray to the Sun; infinite without rays.
    """

    facet_ns: float
    sample_ns: float
    ray_ns: float


@dataclass(frozen=True, kw_only=True)
class BodyPlan:
    """What is modelled of one body."""

    name: str
    is_visible: bool
    n_facets: int
    level: int
    """Level of detail: 0 is the full shape."""
    law: str
    shadow_map_px: int | None
    """Texels of the shadow map across the body; None where nothing can cast on it."""
    shadow_map_reused: bool
    relative_to_camera: bool
    normal_lookup: bool
    size_px: float
    """Larger side of the outline's box [px]."""
    flux_ratio: float = 1.0
    """Of the full shape over the level: the level's irradiance is multiplied by it."""
    modelling_error: float = 0.0
    """RMS error that samples do not cure: of the level, of the shadow map's texels."""
    penumbra_px: float = 0.0
    """Width of the widest penumbra [px]: rays have them, shadow maps have hard edges."""
    shown_share: float = 1.0
    """Of the facets, those in chunks that are not out of view."""
    shadow_map_drawn_px: tuple[int, int] = (0, 0)
    """Texels that there are of the shadow map: of what is seen of the body, along x and y."""


@dataclass(frozen=True, kw_only=True)
class WindowPlan:
    """One part of the image that is drawn at once: bodies whose outlines' boxes touch.

    Attributes
    ----------
    bodies : tuple of str
    engine : "raster" or "rays"
        Triangles drawn by OpenGL, or rays cast at them: whichever is faster here.
    roi : (int, int, int, int) [px]
        Pixels that it touches: x0, y0, x1, y1, one past the last.
    samples : int
        Along each side of a pixel; 0 for a body so small that it has a grid of its own.
    bounds_px : (float, float, float, float) [px]
        What is drawn: the region's edges, or the small body's box.
    grid : (int, int)
        Samples across and down.
    budget : float [1]
        Error above which pixels are drawn again with more samples; infinite for never.
    modelling_error : float [1]
        What samples do not cure: levels of detail, texels of shadow maps.
    shadow_share : float [1]
        Of one sample's squared error, as the image tells it: left by the shadow maps' texels.
    noise : (float, float) [rad], [1]
        Angle of the creases between facets, and facets a pixel: arguments of `noise_gain`.
    predicted_error : float [1]
    """

    bodies: tuple[str, ...]
    engine: str
    roi: tuple[int, int, int, int]
    samples: int
    bounds_px: tuple[float, float, float, float]
    grid: tuple[int, int]
    budget: float
    modelling_error: float
    noise: tuple[float, float]
    shadow_share: float
    predicted_error: float
    may_be_rays: bool = False
    """Whether rays take over where the image tells that its shadow maps are too coarse."""
    refined_samples: int = 0
    """Samples along the side of the pixels that were drawn again; 0 for none."""
    refined_share: float = 0.0
    """Of the region's pixels."""


@dataclass(frozen=True, kw_only=True)
class RenderPlan:
    """What a frame models, what it leaves out, and the error that is expected of it.

    Attributes
    ----------
    roi : (int, int, int, int) [px]
        Region outside which the image is zero: x0, y0, x1, y1, one past the last; all zero when
        nothing is in view.
    windows : tuple of WindowPlan
        What is drawn of it.
    predicted_error : float [1]
        RMS irradiance error over the mean of the lit pixels.
    left_out : tuple of str
    warnings : tuple of str
        What is used beyond its range.
    emission : tuple of EmissionPlan
        What plug-ins added to it.
    """

    camera: str
    max_error: float
    roi: tuple[int, int, int, int]
    windows: tuple[WindowPlan, ...]
    predicted_error: float
    bodies: tuple[BodyPlan, ...]
    left_out: tuple[str, ...] = field(default=())
    warnings: tuple[str, ...] = field(default=())
    emission: tuple[EmissionPlan, ...] = field(default=())

    @property
    def samples(self) -> int:
        """Most samples along a pixel's side in any window."""
        return max((window.samples for window in self.windows), default=0)

    def to_dict(self) -> dict[str, Any]:
        """Plain data, for the wire."""
        return asdict(self)


def without_passes(bodies: list[BodyPlan], windows: tuple[WindowPlan, ...],
                   traits: dict[str, BodyTraits]) -> list[BodyPlan]:
    """Bodies as their windows draw them: rays see the full shape, and need no shadow map."""
    by_rays = {name for window in windows if window.engine == "rays" for name in window.bodies}
    return [replace(body, level=0, n_facets=traits[body.name].levels[0].n_facets, shadow_map_px=None, flux_ratio=1.0,
                    modelling_error=0.0) if body.name in by_rays else body for body in bodies]


def with_windows(frame: RenderPlan, windows: tuple[WindowPlan, ...]) -> RenderPlan:
    """The plan with what drawing told of its windows; a warning where the budget was not met."""
    predicted = max((window.predicted_error for window in windows), default=0.0)
    warnings = frame.warnings
    if predicted > frame.max_error * (1.0 + 1e-6) and any(math.isfinite(w.budget) for w in windows):
        warnings += (f"the budget of {frame.max_error:g} is not met: {predicted:.2g} with {MAX_SAMPLES} x "
                     f"{MAX_SAMPLES} samples; allow_slow has a slow backend draw it",)
    return replace(frame, windows=windows, predicted_error=predicted, warnings=warnings)


def plan_body(view: BodyView, traits: BodyTraits, camera: PinholeCamera, has_casters: bool, budget: float,
              level: int | None, *, shown_share: float = 1.0, seen_share: float = 1.0,
              penumbra: Penumbra = NO_PENUMBRA) -> BodyPlan:
    """What is modelled of a body.

    Parameters
    ----------
    view : BodyView
    traits : BodyTraits
    camera : PinholeCamera
    has_casters : bool
        Whether other bodies may cast on it.
    budget : float [1]
        RMS error over the mean of the lit pixels, before the camera's PSF.
    level : int or None
        Level of detail that is asked for.
    shown_share : float [1]
        Of the facets, those in chunks that the image may show.
    seen_share : float [1]
        Side of what the shadow map must cover over that of the body.
    penumbra : Penumbra
        Of its shadows.
    """
    footprint_m = view.depth_m[0] / camera.focal_length_px
    used = choose_level(view, traits, footprint_m, budget) if level is None else min(level, len(traits.levels) - 1)
    chosen = traits.levels[used]
    ratio, _ = (1.0, 0.0) if chosen.flux_ratio is None else chosen.flux_ratio.at(view.phase_rad)
    squared = level_error(view, chosen, footprint_m) ** 2
    shadow_px = None
    if view.is_visible:
        shadow_px = plan_shadow(view, chosen, traits.is_convex, has_casters, budget, seen_share)
        if shadow_px is not None:
            squared += shadow_share(view, shadow_px) * sum(squared_errors(view, chosen))
            squared += (_LEAK_RMS * leaked_flux(view, shadow_px)) ** 2 + penumbra.error**2
    return BodyPlan(
        name=view.name, is_visible=view.is_visible, n_facets=chosen.n_facets, level=used,
        law=traits.law, shadow_map_px=shadow_px, shadow_map_reused=False,
        relative_to_camera=is_close(view, traits.radius_m, footprint_m),
        normal_lookup=footprint_m < 2e-4 * traits.radius_m, size_px=view.size_px, flux_ratio=ratio,
        modelling_error=math.sqrt(squared), penumbra_px=penumbra.width_px, shown_share=shown_share,
        shadow_map_drawn_px=(0, 0) if shadow_px is None else (math.ceil(shadow_px * seen_share),) * 2)


def choose_level(view: BodyView, traits: BodyTraits, footprint_m: float, budget: float) -> int:
    """The coarsest level of detail whose error leaves most of the budget to the samples."""
    fit = [index for index, level in enumerate(traits.levels)
           if level_error(view, level, footprint_m) <= _LEVEL_SHARE * budget
           and level_flux_error(view, level) <= _FLUX_SHARE * budget]
    return max(fit, default=0)


def plan_windows(views: list[BodyView], traits: dict[str, BodyTraits], bodies: list[BodyPlan],
                 camera: PinholeCamera, max_error: float, error_gain: float, costs: EngineCosts,
                 samples: int | None) -> tuple[WindowPlan, ...]:
    """Split the image into windows, each with the engine and the samples that its bodies need first.

    Bodies far apart in the image are drawn apart, so that the cost follows their pixels; a body
    smaller than a few pixels is drawn on a grid of its own that fits its outline.

    Parameters
    ----------
    error_gain : float [1]
        What the camera's PSF leaves of an error that is independent from pixel to pixel.
    costs : EngineCosts
    samples : int or None
        Asked for instead of the planner's choice: drawn by OpenGL.
    """
    plans = {body.name: body for body in bodies}
    return tuple(_plan_window(members, traits, plans, camera, max_error / error_gain, error_gain, costs, samples)
                 for members in touching(views, camera))


def _plan_window(members: list[BodyView], traits: dict[str, BodyTraits], plans: dict[str, BodyPlan],
                 camera: PinholeCamera, budget: float, error_gain: float, costs: EngineCosts,
                 samples: int | None) -> WindowPlan:
    names = tuple(view.name for view in members)
    roi = region(members, camera)
    x0, y0, x1, y1 = roi
    floor = max(plans[name].modelling_error for name in names)
    facets_ns = sum(plans[name].n_facets * plans[name].shown_share for name in names) * costs.facet_ns
    shadows_ns = sum(plans[name].n_facets * plans[name].shown_share * costs.facet_ns
                     + math.prod(plans[name].shadow_map_drawn_px) * _TEXEL_COST * costs.sample_ns
                     for name in names if plans[name].shadow_map_px is not None)
    setup_ns = _RASTER_CALL_NS + facets_ns + shadows_ns
    errors = _worst([squared_errors(view, traits[view.name].levels[plans[view.name].level]) for view in members])
    largest_px = max(view.size_px for view in members)
    phase_rad = max(view.phase_rad for view in members)
    across = samples_across(budget, phase_rad)
    if samples is None and len(members) == 1 and (largest_px < _SMALL_PX or across > MAX_SAMPLES * largest_px):
        left, top, right, bottom = members[0].bounds_px
        margin = 0.02 * largest_px
        grid = tuple(max(math.ceil(across * side / largest_px), 8) for side in (right - left, bottom - top))
        is_rays = _RAYS_CALL_NS + grid[0] * grid[1] * costs.ray_ns < setup_ns + grid[0] * grid[1] * costs.sample_ns
        is_rays |= floor > budget and math.isfinite(costs.ray_ns)
        floor = 0.0 if is_rays else floor
        sampling = _SMALL_PIXELS * max(flux_error(across, phase_rad),
                                       math.sqrt(sum(errors) * (largest_px / across) ** 3))
        return WindowPlan(
            bodies=names, engine="rays" if is_rays else "raster", roi=roi, samples=0, grid=grid,
            bounds_px=(float(left - margin), float(top - margin), float(right + margin), float(bottom + margin)),
            budget=budget, modelling_error=floor, noise=(0.0, 0.0), shadow_share=0.0,
            predicted_error=error_gain * math.hypot(floor, sampling))
    box_px = (x1 - x0) * (y1 - y0)
    n_px = min(sum(0.6 * min(view.size_px, 1e5) ** 2 for view in members), box_px)
    # Slivers of light between samples tell nothing of themselves.
    slivers = _SLIVER_SAMPLES if phase_rad > _SLIVER_PHASE_RAD and budget < _SLIVER_BUDGET else 1
    least = min(max(math.ceil(across / largest_px), slivers), MAX_SAMPLES)
    # OpenGL, with the levels of detail and the shadow maps that were planned.
    raster_budget = math.sqrt(max(budget**2 - floor**2, (0.3 * budget) ** 2))
    shown = [(traits[view.name].levels[plans[view.name].level], view) for view in members]
    noise = (max(level.crease_rad for level, _ in shown),
             max(facets_per_px(view, level.n_facets) for level, view in shown))
    shade = max(0.0 if plans[view.name].shadow_map_px is None else shadow_share(view, plans[view.name].shadow_map_px)
                for view in members)
    power = noise_power(noise_gain(*noise))
    shaded, count = first_samples(*errors, power, n_px, facets_ns / costs.sample_ns, _PASSED_OVER_COST, least,
                                  raster_budget)
    raster_ns = shaded * costs.sample_ns + setup_ns - facets_ns
    engine, asked = "raster", budget
    # Rays, at the full shape.
    full = _worst([squared_errors(view, traits[view.name].levels[0]) for view in members])
    full_noise = (max(traits[view.name].levels[0].crease_rad for view in members),
                  max(facets_per_px(view, traits[view.name].levels[0].n_facets) for view in members))
    if max(plans[name].penumbra_px for name in names) > 1.0:
        # A ramp of many samples that are each lit or not.
        full_noise, least = _PENUMBRA_NOISE, max(least, _PENUMBRA_SAMPLES)
    rays_ns, ray_count = first_samples(*full, noise_power(noise_gain(*full_noise)), n_px, 0.0, 0.0, least, budget)
    rays_ns = rays_ns * costs.ray_ns + _RAYS_CALL_NS + _MISS_COST * (box_px - n_px) * ray_count**2 * costs.ray_ns
    if samples is not None:
        count, asked = samples, math.inf
    elif rays_ns < raster_ns or (floor > budget and math.isfinite(rays_ns)):
        engine, count, errors, noise, floor = "rays", ray_count, full, full_noise, 0.0
    return WindowPlan(
        bodies=names, engine=engine, noise=noise, shadow_share=0.0 if engine == "rays" else shade, roi=roi,
        samples=count,
        bounds_px=(x0 - 0.5, y0 - 0.5, x1 - 0.5, y1 - 0.5),
        grid=((x1 - x0) * count, (y1 - y0) * count), budget=asked, modelling_error=floor,
        may_be_rays=math.isfinite(costs.ray_ns),
        predicted_error=error_gain * math.hypot(floor, math.sqrt(sum(errors) * count**-3)))


def _worst(errors: list[tuple[float, float]]) -> tuple[float, float]:
    limb, creases = zip(*errors, strict=True)
    return max(limb), max(creases)


def first_samples(limb: float, creases: float, power: float, n_px: float, setup: float, passed_over: float, least: int,
                  budget: float) -> tuple[float, int]:
    """Cost of drawing, and samples along a pixel's side before the image itself tells where more are needed.

    A second pass over few pixels cures outlines; creases are everywhere, and half of the pixels
    have nearly all of their error. The cheapest pair of passes that should meet the budget decides.

    Parameters
    ----------
    limb, creases : float [1]
        Squared errors of one sample a pixel.
    power : float
        n x n samples have n^-power of the squared error of creases; of outlines, n^-3.
    n_px : float [px]
        Of the bodies.
    setup, passed_over : float
        Cost of a pass, and of a sample that a second pass leaves out, in samples.
    least : int
        Fewest samples along a pixel's side.
    budget : float [1]
        RMS.
    """
    best = (math.inf, MAX_SAMPLES)
    edge_share = min(12.0 / math.sqrt(n_px), 1.0)
    for first in range(least, MAX_SAMPLES + 1):
        cost = setup + n_px * first**2
        if cost > best[0]:
            break
        enough = budget * (_SURE if setup > n_px * first**2 else _LIKELY)
        if limb / first**3 + creases / first**power <= enough**2 or first == MAX_SAMPLES:
            best = min(best, (cost, first))
            break
        for second in SAMPLE_COUNTS:
            room = budget**2 - limb / second**3
            kept = min(room * first**power / creases, 1.0) if creases > 0.0 else 1.0
            if second <= first or room <= 0.0 or kept < (first / second) ** power:
                continue
            share = min(edge_share + 0.5 * (1.0 - kept) ** 2, 1.0)
            best = min(best, (cost + setup + n_px * second**2 * (share + passed_over), first))
    return best


def plan_shadow(view: BodyView, level: LevelTraits, is_convex: bool, has_casters: bool,
                max_error: float, seen_share: float = 1.0) -> int | None:
    """Texels of the shadow map across the body, or None when nothing can cast on what is seen.

    Two things ask for texels: the place of a shadow's edge, and what a texel cannot see, which leaks
    light, the more the lower the Sun: the second rule keeps the flux within a tenth of the budget
    (measured on Itokawa, `docs/planner.md`). Of a body of which
    a part is seen there are texels of that part only: a map has at most 4096 along a side.
    """
    if not has_casters:
        if is_convex:
            return None
        if _SHADOWED_PER_RAD * view.phase_rad < 0.1 * max_error:
            return None
    texels = max(view.finest_px, leaked_flux(view, 1) / (_FLUX_SHARE * max_error))
    one_sample = sum(squared_errors(view, level))
    sizes = [size for size in SHADOW_SIZES_PX if size * seen_share <= MAX_SHADOW_SIDE_PX]
    return next((size for size in sizes if size >= texels
                 and shadow_share(view, size) * one_sample <= (_SHADOW_SHARE * max_error) ** 2), sizes[-1])


def is_close(view: BodyView, radius_m: float, footprint_m: float) -> bool:
    """Whether body-fixed float32 coordinates, good to 6e-8 radii, are too coarse for what is seen."""
    depth_m = view.depth_m[0]
    return depth_m < 0.05 * radius_m or (footprint_m < 2e-5 * radius_m and depth_m < 0.5 * radius_m)


def snapped_sun(sun_direction_body: np.ndarray, shadow_map_px: int) -> np.ndarray:
    """The direction that a shadow map is drawn for: the nearest node of a grid finer than half a texel.

    Drawing for the node, not for the first direction asked for, makes the reuse of a map
    independent of history: the same request gives the same bytes.

    Parameters
    ----------
    sun_direction_body : (3,) float64 [1]
    shadow_map_px : int
        A texel is 2 R / size; relief of up to R moves its shadow by half of that in 1 / size rad.
    """
    largest = np.argmax(np.abs(sun_direction_body))
    face = sun_direction_body / abs(sun_direction_body[largest])
    snapped = np.round(face * shadow_map_px) / shadow_map_px
    return snapped / np.linalg.norm(snapped)
