"""The planner: the cheapest configuration that meets an error budget. Pure: no GL, no images.

What it expects of an image is in `error_model.py`; benchmarks/heldout.py holds it against rays.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from glrender_camera import PinholeCamera

from . import grouping
from .eclipses import NO_ECLIPSE, Eclipse
from .error_model import (
    NO_PENUMBRA,
    BodyTraits,
    LevelTraits,
    Penumbra,
    leaked_flux,
    level_error,
    level_flux_error,
    parallel_error,
    ray_rounding_error,
    rounding_error,
    shadow_share,
    squared_errors,
)
from .render_plan import BodyPlan, RenderPlan, WindowPlan
from .view import BodyView

SHADOW_SIZES_PX = tuple(2**k for k in range(8, 17))
"""Texels across a body; float32 coordinates have 256 steps in the finest."""
MAX_SHADOW_SIDE_PX = 4096
"""Most texels along a side of a shadow map."""
# Of the budget, what the shadow map may take; and the RMS error of light that leaks, over that of the flux.
_SHADOW_SHARE, _LEAK_RMS = 0.4, 2.0
# Of the budget, what a level of detail may take, of the image and of the flux.
_LEVEL_SHARE, _FLUX_SHARE = 0.7, 0.1
# Share of the sunlit surface in cast shadow, per radian of phase (engine.md: 6 % at 10 deg).
_SHADOWED_PER_RAD = 0.34


def plan_body(view: BodyView, traits: BodyTraits, camera: PinholeCamera, casters: Sequence[str], budget: float,
              level: int | None, *, shown_share: float = 1.0, seen_share: float = 1.0,
              penumbra: Penumbra = NO_PENUMBRA, eclipse: Eclipse = NO_ECLIPSE) -> BodyPlan:
    """What is modelled of a body.

    Parameters
    ----------
    view : BodyView
    traits : BodyTraits
    camera : PinholeCamera
    casters : sequence of str
        Other bodies that may cast a shadow on it.
    budget : float [1]
        RMS error over the mean of the lit pixels, before the camera's PSF.
    level : int or None
        Level of detail that is asked for.
    shown_share : float [1]
        Of the facets, those in chunks that the image may show.
    seen_share : float [1]
        Side of what the shadow map must cover over that of the body.
    penumbra : Penumbra
        Of its shadows on itself.
    eclipse : Eclipse
        By the casters.
    """
    footprint_m = view.depth_m[0] / camera.focal_length_px
    used = choose_level(view, traits, footprint_m, budget) if level is None else min(level, len(traits.levels) - 1)
    chosen = traits.levels[used]
    ratio, _ = (1.0, 0.0) if chosen.flux_ratio is None else chosen.flux_ratio.at(view.phase_rad)
    is_relative = is_close(view, traits.radius_m, footprint_m)
    squared = level_error(view, chosen, footprint_m) ** 2 + rounding_error(view, traits, is_relative) ** 2
    shadow_px, penumbra_error = None, 0.0
    if view.is_visible:
        shadow_px = plan_shadow(view, chosen, traits.is_convex, bool(casters), budget, seen_share)
        if shadow_px is not None:
            penumbra_error = math.hypot(penumbra.error, eclipse.error)
            squared += shadow_share(view, shadow_px, bool(casters)) * sum(squared_errors(view, chosen))
            squared += (_LEAK_RMS * leaked_flux(view, chosen, shadow_px)) ** 2 + penumbra_error**2
    detail_m, active, detail_slope = None, [], 0.0
    if traits.relief is not None and view.is_visible and (active := traits.relief.active(footprint_m)):
        detail_m = float(max(traits.relief.scales_m()[active].min(), 2.0 * footprint_m))
        detail_slope = traits.relief.slope_rms(footprint_m)
    return BodyPlan(
        name=view.name, is_visible=view.is_visible, n_facets=chosen.n_facets, level=used,
        law=traits.law, shadow_map_px=shadow_px, shadow_map_reused=False,
        relative_to_camera=is_relative,
        normal_lookup=footprint_m < 2e-4 * traits.radius_m, size_px=view.size_px, flux_ratio=ratio,
        modelling_error=math.sqrt(squared), penumbra_px=max(penumbra.width_px, eclipse.width_px),
        penumbra_error=penumbra_error, eclipse=eclipse, shown_share=shown_share,
        shadow_map_drawn_px=(0, 0) if shadow_px is None else (math.ceil(shadow_px * seen_share),) * 2,
        detail_m=detail_m, detail_layers=len(active), detail_slope=detail_slope,
        casters=tuple(casters))


def choose_level(view: BodyView, traits: BodyTraits, footprint_m: float, budget: float) -> int:
    """The coarsest level of detail whose error leaves most of the budget to the samples."""
    fit = [index for index, level in enumerate(traits.levels)
           if level_error(view, level, footprint_m) <= _LEVEL_SHARE * budget
           and level_flux_error(view, level) <= _FLUX_SHARE * budget]
    return max(fit, default=0)


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
    one_sample = shadow_share(view, 1, has_casters) * sum(squared_errors(view, level))
    texels = max(view.finest_px, leaked_flux(view, level, 1) / (_FLUX_SHARE * max_error),
                 math.cbrt(one_sample / (_SHADOW_SHARE * max_error) ** 2))
    sizes = [size for size in SHADOW_SIZES_PX if size * seen_share <= MAX_SHADOW_SIDE_PX]
    return next((size for size in sizes if size >= texels), sizes[-1])


def is_close(view: BodyView, radius_m: float, footprint_m: float) -> bool:
    """Whether body-fixed float32 coordinates, good to 6e-8 radii, are too coarse for what is seen."""
    depth_m = view.depth_m[0]
    return depth_m < 0.05 * radius_m or (footprint_m < 2e-5 * radius_m and depth_m < 0.5 * radius_m)


def without_maps(bodies: Sequence[BodyPlan], windows: Sequence[WindowPlan]) -> list[BodyPlan]:
    """Bodies as their windows draw them by OpenGL: rays and areas need no shadow map, and cast those of full shapes."""
    by_rays = {name for window in windows if window.engine != "raster" for name in window.bodies}
    return [replace(body, level=0, shadow_map_px=None, shadow_map_drawn_px=(0, 0), shadow_map_reused=False,
                    flux_ratio=1.0, modelling_error=0.0) if body.name in by_rays else body for body in bodies]


def told_plan(camera: PinholeCamera, max_error: float, views: Sequence[BodyView], traits: Mapping[str, BodyTraits],
              bodies: Sequence[BodyPlan], windows: Sequence[WindowPlan], has_sun_disc: bool) -> RenderPlan:
    """The frame's plan as its windows were drawn: what was left out, and where the budget was not met."""
    engines = {name: window.engine for window in windows for name in window.bodies}
    by_areas = {name: level for window in windows if window.levels
                for name, level in zip(window.bodies, window.levels, strict=True)}
    done, left_out, warnings = [], [], []
    for view, body in zip(views, without_maps(bodies, windows), strict=True):
        known = traits[view.name]
        if view.name in by_areas:
            if n_points := by_areas[view.name].n_points:
                left_out.append(f"{view.name}: all of the surface but {n_points} points")
            elif by_areas[view.name].by_middles:
                left_out.append(f"{view.name}: where light ends within facets: all of one is as lit as its middle")
            body = replace(body, level=by_areas[view.name].number, flux_ratio=by_areas[view.name].flux_ratio)
        done.append(replace(body, n_facets=known.levels[body.level].n_facets))
        if not view.is_visible:
            left_out.append(f"{view.name}: out of view")
            continue
        if view.phase_rad > known.max_phase_rad:
            phase_deg, limit_deg = np.degrees([view.phase_rad, known.max_phase_rad])
            warnings.append(f"{known.law} of {view.name} at a phase of {phase_deg:.1f} deg: "
                            f"it holds to {limit_deg:.1f} deg")
        engine = engines.get(view.name, "raster")
        if has_sun_disc and (body.shadow_map_px is not None or engine == "areas"):
            left_out.append(f"{view.name}: the Sun's disc: shadows have hard edges")
        if body.shadow_map_px is None and engine == "raster":
            left_out.append(f"shadows on {view.name}: nothing can cast on what is seen")
        if known.relief is not None:
            left_out.append(_detail_left_out(body, known))
        if body.level:
            left_out.append(f"{view.name}: {known.levels[body.level].n_facets} of {known.levels[0].n_facets} facets")
    left_out += [f"{', '.join(window.bodies)}: samples for a flux within a tenth of the budget: it may be off by up to "
                 f"{window.flux_error:.2g}" for window in windows if window.flux_error]
    parallel = max((parallel_error(view, traits[view.name]) for view in views if view.is_visible), default=0.0)
    by_rays = max((ray_rounding_error(view, traits[view.name]) for view in views
                   if view.is_visible and engines.get(view.name) in ("rays", "areas")), default=0.0)
    predicted = math.hypot(max((window.predicted_error for window in windows), default=0.0), parallel, by_rays)
    if predicted > max_error * (1.0 + 1e-6) and any(math.isfinite(window.budget) for window in windows):
        warnings.append(f"the budget of {max_error:g} is not met: {predicted:.2g} is expected; "
                        "allow_slow has a slow backend draw it")
    return RenderPlan(camera=camera.name, max_error=max_error, roi=grouping.union([w.roi for w in windows]),
                      windows=tuple(windows), bodies=tuple(done), left_out=tuple(left_out),
                      warnings=tuple(warnings), predicted_error=predicted)


def _detail_left_out(body: BodyPlan, traits: BodyTraits) -> str:
    if body.detail_m is None:
        return f"{body.name}: surface detail: no pixel resolves it"
    finer = "" if body.detail_m <= traits.relief.scales_m().min() else f" below {body.detail_m:.3g} m, and"
    return f"{body.name}: of surface detail what is{finer} its shadows"
