"""The planner: the cheapest configuration that meets an error budget. Pure: no GL, no images.

Its error model is the measurement in `docs/planner.md`; a test compares its predictions
with ray-traced truth.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from glrender_camera import PinholeCamera

from .lod_flux import FluxRatio
from .refine import SAMPLE_COUNTS
from .view import BodyView

MAX_SAMPLES = 16
"""Most samples along a pixel's side."""
SHADOW_SIZES_PX = (256, 512, 1024, 2048, 4096)
# Error of one sample a pixel: limb and terminator, and creases between facets (docs/planner.md).
_LIMB_ERROR, _LIT_POWER = 0.43, 1.15
_CREASE_ERROR, _CROWDING_POWER, _MOST_FACETS_PER_PX = 0.34, 0.35, 2.06
# What noise has more than edges of the same contrast.
_NOISE_GAIN = 0.85
# Share of the squared error that sits at the edges of cast shadows, per radian of phase, at most.
_SHADOW_EDGES_PER_RAD, _MOST_SHADOW_EDGES = 0.1, 0.2
# Of the budget, what the shadow map may take.
_SHADOW_SHARE = 0.4
# A body that is smaller has a grid of its own, with so many samples across.
_SMALL_PX = 4.0
_LEAST_ACROSS, _MOST_ACROSS = 64, 192
# Of the budget, what a level of detail may take, of the image and of the flux.
_LEVEL_SHARE, _FLUX_SHARE = 0.7, 0.1
_LEVEL_ERROR, _FLUX_SCATTERS = 0.5, 2.5
# Share of the sunlit surface in cast shadow, per radian of phase (engine.md: 6 % at 10 deg).
_SHADOWED_PER_RAD = 0.34
# Cost of a sample passed over, in samples that are shaded; and of a ray that meets nothing, in rays that do.
_PASSED_OVER_COST, _MISS_COST = 0.15, 0.15
# Nanoseconds of a call whatever it draws: of OpenGL, of rays in NumPy.
_RASTER_CALL_NS, _RAYS_CALL_NS = 5e5, 1.5e6
# Flux of N samples across a body is within this times N^-1.5 (engine.md).
_FLUX_SCATTER = 2.0


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
    """

    n_facets: int
    crease_rad: float
    deviation_m: float = 0.0
    flux_ratio: FluxRatio | None = None


@dataclass(frozen=True, kw_only=True)
class BodyTraits:
    """What the planner must know of a body."""

    radius_m: float
    is_convex: bool
    law: str
    max_phase_rad: float
    levels: tuple[LevelTraits, ...]


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
    """Side of the shadow map [px]; None where nothing can cast on it."""
    shadow_map_reused: bool
    relative_to_camera: bool
    normal_lookup: bool
    size_px: float
    """Larger side of the outline's box [px]."""
    flux_ratio: float = 1.0
    """Of the full shape over the level: the level's irradiance is multiplied by it."""
    modelling_error: float = 0.0
    """RMS error that samples do not cure: of the level, of the shadow map's texels."""


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
    sampling_budget : float [1]
        Sampling error above which pixels are drawn again with more samples; infinite for never.
    modelling_error : float [1]
        What samples do not cure: levels of detail, texels of shadow maps.
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
    sampling_budget: float
    modelling_error: float
    noise: tuple[float, float]
    predicted_error: float
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
    """

    camera: str
    max_error: float
    roi: tuple[int, int, int, int]
    windows: tuple[WindowPlan, ...]
    predicted_error: float
    bodies: tuple[BodyPlan, ...]
    left_out: tuple[str, ...] = field(default=())
    warnings: tuple[str, ...] = field(default=())

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
    if predicted > frame.max_error * (1.0 + 1e-6) and any(math.isfinite(w.sampling_budget) for w in windows):
        warnings += (f"the budget of {frame.max_error:g} is not met: {predicted:.2g} with {MAX_SAMPLES} x "
                     f"{MAX_SAMPLES} samples; the raytrace backend can",)
    return replace(frame, windows=windows, predicted_error=predicted, warnings=warnings)


def plan_body(view: BodyView, traits: BodyTraits, camera: PinholeCamera, has_casters: bool, budget: float,
              level: int | None) -> BodyPlan:
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
    """
    footprint_m = view.depth_m[0] / camera.focal_length_px
    used = choose_level(view, traits, footprint_m, budget) if level is None else min(level, len(traits.levels) - 1)
    chosen = traits.levels[used]
    ratio, _ = (1.0, 0.0) if chosen.flux_ratio is None else chosen.flux_ratio.at(view.phase_rad)
    squared = level_error(view, chosen, footprint_m) ** 2
    shadow_px = None
    if view.is_visible:
        shadow_px = plan_shadow(view, chosen, traits.is_convex, has_casters, budget)
        if shadow_px is not None:
            squared += shadow_error(view, chosen, shadow_px) ** 2
    return BodyPlan(
        name=view.name, is_visible=view.is_visible, n_facets=chosen.n_facets, level=used, law=traits.law,
        shadow_map_px=shadow_px, shadow_map_reused=False,
        relative_to_camera=is_close(view, traits.radius_m, footprint_m),
        normal_lookup=footprint_m < 2e-4 * traits.radius_m, size_px=view.size_px, flux_ratio=ratio,
        modelling_error=math.sqrt(squared))


def choose_level(view: BodyView, traits: BodyTraits, footprint_m: float, budget: float) -> int:
    """The coarsest level of detail whose error leaves most of the budget to the samples."""
    fit = [index for index, level in enumerate(traits.levels)
           if level_error(view, level, footprint_m) <= _LEVEL_SHARE * budget
           and level_flux_error(view, level) <= _FLUX_SHARE * budget]
    return max(fit, default=0)


def level_error(view: BodyView, level: LevelTraits, footprint_m: float) -> float:
    """RMS error of a level of detail, shaded with the normals of the full shape.

    Measured on eight shapes at 5 to 500 px and 5 to 150 deg: half of them within 50 %, one in ten
    above by more than a half (docs/planner.md).
    """
    if not level.deviation_m:
        return 0.0
    tilt = (0.4 + min(math.tan(0.5 * view.phase_rad), 30.0) ** 2) ** 0.64
    diameter = min(max(view.size_px, 1.0), 1e5)
    return (_LEVEL_ERROR * level.crease_rad * tilt * (level.deviation_m / footprint_m) ** 0.074
            * max(level.n_facets / diameter**2, 0.01) ** -0.1)


def level_flux_error(view: BodyView, level: LevelTraits) -> float:
    """Error of the flux after the mean over aspects is put right; one aspect in ten has more."""
    return 0.0 if level.flux_ratio is None else _FLUX_SCATTERS * level.flux_ratio.at(view.phase_rad)[1]


def squared_errors(view: BodyView, level: LevelTraits) -> tuple[float, float]:
    """Squared RMS error of one sample a pixel: of outlines, and of creases.

    n x n samples have n^-3 of it. Measured on twelve shapes at 12 to 1000 px and 5 to 150 deg: within 30 %.
    """
    diameter = min(max(view.size_px, 1.0), 1e5)
    lit = max(0.5 * (1.0 + math.cos(view.phase_rad)), 1e-3)
    noise = noise_gain(level.crease_rad, facets_per_px(view, level.n_facets)) ** 2
    crowding = min(facets_per_px(view, level.n_facets), _MOST_FACETS_PER_PX) ** _CROWDING_POWER
    tilt = (0.02 + min(math.tan(0.5 * view.phase_rad), 30.0) ** 2) ** 0.71
    return (_LIMB_ERROR / diameter * lit**-_LIT_POWER,
            _CREASE_ERROR * level.crease_rad**2 * crowding * tilt * noise)


def noise_gain(crease_rad: float, facets_per_sample: float) -> float:
    """Error over that of edges of the same contrast: rough facets smaller than samples are noise.

    The range of nine samples of noise is three of its deviations, and an edge's error is a sixth of
    its height.
    """
    rough = min(max((crease_rad - 0.15) / 0.25, 0.0), 1.0)
    return 1.0 + _NOISE_GAIN * rough * math.sqrt(min(facets_per_sample, 1.0))


def shadow_error(view: BodyView, level: LevelTraits, shadow_map_px: int) -> float:
    """RMS error that the texels of a shadow map make at the edges of shadows."""
    edges = min(_SHADOW_EDGES_PER_RAD * view.phase_rad, _MOST_SHADOW_EDGES)
    texel_px = min(view.size_px, 1e5) / shadow_map_px
    return math.sqrt(edges * sum(squared_errors(view, level)) * texel_px**3)


def noise_power(gain: float) -> float:
    """Power of the samples along a pixel's side that divides the squared error: 3 for edges, 2 for noise."""
    return 3.0 - (gain - 1.0) / _NOISE_GAIN


def facets_per_px(view: BodyView, n_facets: int) -> float:
    """Facets that a pixel of a body sees, about: half of them on the face of an outline."""
    diameter = min(max(view.size_px, 1.0), 1e5)
    return 0.5 * n_facets / (0.6 * diameter**2)


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
                 for members in _touching(views, camera))


def _plan_window(members: list[BodyView], traits: dict[str, BodyTraits], plans: dict[str, BodyPlan],
                 camera: PinholeCamera, budget: float, error_gain: float, costs: EngineCosts,
                 samples: int | None) -> WindowPlan:
    names = tuple(view.name for view in members)
    roi = region(members, camera)
    x0, y0, x1, y1 = roi
    floor = max(plans[name].modelling_error for name in names)
    passes = sum(plans[name].n_facets * (1.0 if plans[name].shadow_map_px is None else 2.0) for name in names)
    setup_ns = _RASTER_CALL_NS + passes * costs.facet_ns
    across = samples_across(budget)
    if samples is None and len(members) == 1 and members[0].size_px < _SMALL_PX:
        left, top, right, bottom = members[0].bounds_px
        margin = 0.02 * members[0].size_px
        grid = tuple(max(math.ceil(across * side / members[0].size_px), 8) for side in (right - left, bottom - top))
        is_rays = _RAYS_CALL_NS + grid[0] * grid[1] * costs.ray_ns < setup_ns + grid[0] * grid[1] * costs.sample_ns
        floor = 0.0 if is_rays else floor
        return WindowPlan(
            bodies=names, engine="rays" if is_rays else "raster", roi=roi, samples=0, grid=grid,
            bounds_px=(float(left - margin), float(top - margin), float(right + margin), float(bottom + margin)),
            sampling_budget=math.inf, modelling_error=floor, noise=(0.0, 0.0),
            predicted_error=error_gain * math.hypot(floor, _FLUX_SCATTER * across**-1.5))
    box_px = (x1 - x0) * (y1 - y0)
    n_px = min(sum(0.6 * min(view.size_px, 1e5) ** 2 for view in members), box_px)
    least = min(math.ceil(across / max(max(view.size_px for view in members), 1.0)), MAX_SAMPLES)
    # OpenGL, with the levels of detail and the shadow maps that were planned.
    raster_budget = math.sqrt(max(budget**2 - floor**2, (0.3 * budget) ** 2))
    errors = _worst([squared_errors(view, traits[view.name].levels[plans[view.name].level]) for view in members])
    facets_ns = sum(plans[name].n_facets for name in names) * costs.facet_ns
    shown = [(traits[view.name].levels[plans[view.name].level], view) for view in members]
    noise = (max(level.crease_rad for level, _ in shown),
             max(facets_per_px(view, level.n_facets) for level, view in shown))
    power = noise_power(noise_gain(*noise))
    shaded, count = first_samples(*errors, power, n_px, facets_ns / costs.sample_ns, _PASSED_OVER_COST, least,
                                  raster_budget)
    raster_ns = shaded * costs.sample_ns + setup_ns - facets_ns
    engine, sampling_budget = "raster", raster_budget
    # Rays, at the full shape.
    full = _worst([squared_errors(view, traits[view.name].levels[0]) for view in members])
    full_noise = (max(traits[view.name].levels[0].crease_rad for view in members),
                  max(facets_per_px(view, traits[view.name].levels[0].n_facets) for view in members))
    rays_ns, ray_count = first_samples(*full, noise_power(noise_gain(*full_noise)), n_px, 0.0, 0.0, least, budget)
    rays_ns = rays_ns * costs.ray_ns + _RAYS_CALL_NS + _MISS_COST * (box_px - n_px) * ray_count**2 * costs.ray_ns
    if samples is not None:
        count, sampling_budget = samples, math.inf
    elif rays_ns < raster_ns or (floor > budget and math.isfinite(rays_ns)):
        engine, count, errors, noise, floor, sampling_budget = "rays", ray_count, full, full_noise, 0.0, budget
    return WindowPlan(
        bodies=names, engine=engine, noise=noise, roi=roi, samples=count,
        bounds_px=(x0 - 0.5, y0 - 0.5, x1 - 0.5, y1 - 0.5),
        grid=((x1 - x0) * count, (y1 - y0) * count), sampling_budget=sampling_budget, modelling_error=floor,
        predicted_error=error_gain * math.hypot(floor, math.sqrt(sum(errors) * count**-3)))


def samples_across(budget: float) -> int:
    """Samples across a small body that keep its flux within a tenth of a budget."""
    return min(max(math.ceil((_FLUX_SCATTER / (0.1 * budget)) ** (2.0 / 3.0)), _LEAST_ACROSS), _MOST_ACROSS)


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
        if limb / first**3 + creases / first**power <= budget**2 or first == MAX_SAMPLES:
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
                max_error: float) -> int | None:
    """Side of the shadow map [px], or None when nothing can cast on what is seen.

    Two things ask for texels: the place of a shadow's edge, and what a texel cannot see, which leaks
    light, the more the lower the Sun: the second rule keeps the flux within a tenth of the budget
    (measured on Itokawa, `docs/planner.md`).
    """
    if not has_casters:
        if is_convex:
            return None
        if _SHADOWED_PER_RAD * view.phase_rad < 0.1 * max_error:
            return None
    low_sun = 1.9 * math.tan(min(0.5 * view.phase_rad, 1.5)) ** 1.57 * (0.02 / max_error)
    texels = min(view.size_px, 1e5) * max(1.0, low_sun)
    return next((size for size in SHADOW_SIZES_PX
                 if size >= texels and shadow_error(view, level, size) <= _SHADOW_SHARE * max_error),
                SHADOW_SIZES_PX[-1])


def region(views: list[BodyView], camera: PinholeCamera) -> tuple[int, int, int, int]:
    """x0, y0, x1, y1 [px] of the pixels that visible bodies may touch."""
    frame = np.array([camera.width_px, camera.height_px])
    if any(view.bounds_px is None for view in views):
        return (0, 0, camera.width_px, camera.height_px)
    bounds = np.array([view.bounds_px for view in views])
    # Pixel k covers k - 1/2 to k + 1/2.
    low = np.clip(np.floor(bounds[:, :2].min(axis=0) + 0.5), 0, frame)
    high = np.clip(np.floor(bounds[:, 2:].max(axis=0) + 0.5) + 1, 0, frame)
    return tuple(int(x) for x in (*low, *high))


def _touching(views: list[BodyView], camera: PinholeCamera) -> list[list[BodyView]]:
    """Visible bodies in groups whose regions share no pixel."""
    groups: list[list[BodyView]] = []
    for view in views:
        if not view.is_visible:
            continue
        group = [view]
        while True:
            touches = [other for other in groups if _overlap(region(group, camera), region(other, camera))]
            if not touches:
                break
            group = sum(touches, group)
            groups = [other for other in groups if other not in touches]
        groups.append(sorted(group, key=views.index))
    return groups


def _overlap(a: tuple[int, int, int, int], b: tuple[int, int, int, int]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def union(regions: list[tuple[int, int, int, int]]) -> tuple[int, int, int, int]:
    """The box around regions; all zero around none."""
    if not regions:
        return (0, 0, 0, 0)
    boxes = np.array(regions)
    return tuple(int(x) for x in (*boxes[:, :2].min(axis=0), *boxes[:, 2:].max(axis=0)))


def is_close(view: BodyView, radius_m: float, footprint_m: float) -> bool:
    """Whether body-fixed float32 coordinates, good to 6e-8 radii, are too coarse for what is seen."""
    depth_m = view.depth_m[0]
    return depth_m < 0.05 * radius_m or (footprint_m < 2e-5 * radius_m and depth_m < 0.5 * radius_m)


def depth_groups(views: list[BodyView]) -> list[tuple[float, float, list[BodyView]]]:
    """Bodies that share a depth range, farthest first: (near, far, bodies) [m].

    A fitted range keeps a 24-bit depth buffer exact to 1e9 radii; bodies whose ranges do not
    overlap are drawn one behind the other.
    """
    groups: list[tuple[float, float, list[BodyView]]] = []
    for view in sorted((v for v in views if v.is_visible), key=lambda v: v.depth_m[1], reverse=True):
        near, far = view.depth_m
        if groups and far >= groups[-1][0]:
            last_near, last_far, members = groups[-1]
            groups[-1] = (min(near, last_near), last_far, [*members, view])
        else:
            groups.append((near, far, [view]))
    return groups


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
