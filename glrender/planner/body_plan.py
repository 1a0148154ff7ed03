"""The plan of each body: features that are modelled, and their account in a frame's plan. Pure: no GL, no images."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from glrender_camera import PinholeCamera

from ..scene.tolerance import by_unit
from ..view import regions as grouping
from ..view.occluders import NO_ECLIPSE, Eclipse
from ..view.view import BodyView
from .error_model import (
    FLUX_SHARE,
    BodyTraits,
    leaked_flux,
    parallel_error,
    ray_rounding_error,
    rounding_error,
    usual_edges,
)
from .plan import BodyPlan, RenderPlan, WindowPlan
from .predicted import frame_errors, with_eclipse

SHADOW_SIZES_PX = tuple(2**k for k in range(8, 17))
"""Texels across a body; float32 coordinates have 256 steps in the finest."""
MAX_SHADOW_SIDE_PX = 4096
"""Most texels along a side of a shadow map."""
# Of the error tolerance [1], what the shadow map may take of the image.
_SHADOW_SHARE = 0.4
# Squared error [1] of one sample a pixel: twelve shapes at 100 to 1000 px, 30 to 120 deg, have 0.002 to 0.05.
_ONE_SAMPLE = 0.015
# RMS error [1] of light that leaks over that of the flux: the data of `error_model.leaked_flux`.
_LEAK_RMS = 2.0
# Share of the sunlit surface in cast shadow, per radian of phase: engine.md, 6 % at 10 deg.
_SHADOWED_PER_RAD = 0.34


def plan_body(view: BodyView, traits: BodyTraits, camera: PinholeCamera, casters: Sequence[str], tolerance: float,
              *, penumbra: tuple[float, float] = (0.0, 0.0), eclipse: Eclipse = NO_ECLIPSE) -> BodyPlan:
    """The features of a body that are modelled.

    Parameters
    ----------
    view : BodyView
    traits : BodyTraits
    camera : PinholeCamera
    casters : sequence of str
        Other bodies that may cast a shadow on it.
    tolerance : float [1]
        RMS error over the mean of the lit pixels, before the camera's PSF.
    penumbra : (float, float) [1], [px]
        RMS error of hard edges in place of penumbras, and the width of the widest.
    eclipse : Eclipse
        By the casters.
    """
    footprint_m = view.depth_m[0] / camera.focal_length_px
    error, width_px = penumbra
    is_relative = is_close(view, traits.radius_m, footprint_m)
    shadow_px, squared = None, rounding_error(view, traits, is_relative) ** 2
    if view.is_visible:
        shadow_px = plan_shadow(view, traits, bool(casters), tolerance, _seen_share(view, traits, camera))
    if shadow_px is None:
        error = 0.0
    else:
        squared += (_LEAK_RMS * leaked_flux(view, traits, shadow_px)) ** 2 + error**2
    detail_m, n_layers = None, 0
    if traits.relief is not None and view.is_visible and (active := traits.relief.active(footprint_m)):
        detail_m = float(max(traits.relief.scales_m()[active].min(), 2.0 * footprint_m))
        n_layers = len(active)
    return BodyPlan(
        name=view.name, is_visible=view.is_visible, n_facets=traits.n_facets, law=traits.law,
        shadow_map_px=shadow_px, shadow_map_reused=False, relative_to_camera=is_relative,
        normal_lookup=footprint_m < 2e-4 * traits.radius_m, size_px=view.size_px, modelling_error=math.sqrt(squared),
        penumbra_px=width_px, penumbra_error=error, penumbra_flux=eclipse.hard_flux,
        eclipse_px=eclipse.width_m / footprint_m, eclipse_left=eclipse.left, casters=tuple(casters), detail_m=detail_m,
        detail_layers=n_layers)


def plan_shadow(view: BodyView, traits: BodyTraits, has_casters: bool, tolerance: float,
                seen_share: float = 1.0) -> int | None:
    """Texels of the shadow map across the body, or None when nothing can cast on what is seen.

    Two things ask for texels: the place of a shadow's edge, and light that leaks past what a texel cannot resolve, the
    more the lower the Sun. The flux stays within a tenth of the tolerance. A map has at most 4096 texels along a side;
    of a body of which a part is seen it covers that part only.
    """
    if not has_casters:
        if traits.is_convex:
            return None
        if _SHADOWED_PER_RAD * view.phase_rad < FLUX_SHARE * tolerance:
            return None
    # n texels a pixel leave n^-3 of the squared error at edges.
    finer = math.cbrt(_ONE_SAMPLE * usual_edges(view, has_casters) / (_SHADOW_SHARE * tolerance) ** 2)
    texels = max(view.finest_px * max(finer, 1.0), leaked_flux(view, traits, 1) / (FLUX_SHARE * tolerance))
    sizes = [size for size in SHADOW_SIZES_PX if size * seen_share <= MAX_SHADOW_SIDE_PX]
    return next((size for size in sizes if size >= texels), sizes[-1])


def _seen_share(view: BodyView, traits: BodyTraits, camera: PinholeCamera) -> float:
    """Side of what the shadow map must cover over that of the body, about: no farther than a sphere's horizon."""
    if view.is_whole:
        return 1.0
    horizon_m = min(math.sqrt(view.depth_m[0] * (view.depth_m[0] + 2.0 * traits.radius_m)), view.depth_m[1])
    diagonal = math.hypot(camera.width_px, camera.height_px) / camera.focal_length_px
    return min(0.5 * diagonal * horizon_m / traits.radius_m, 1.0)


def is_close(view: BodyView, radius_m: float, footprint_m: float) -> bool:
    """Whether body-fixed float32 coordinates, good to 6e-8 radii, are too coarse for what is seen."""
    depth_m = view.depth_m[0]
    return depth_m < 0.05 * radius_m or (footprint_m < 2e-5 * radius_m and depth_m < 0.5 * radius_m)


def frame_plan(camera: PinholeCamera, max_error: float | Mapping[str, float], error_gain: float,
               views: Sequence[BodyView], traits: Mapping[str, BodyTraits], bodies: Sequence[BodyPlan],
               windows: Sequence[WindowPlan], has_sun_disc: bool, remedy: str = "") -> RenderPlan:
    """The frame's plan as its windows were drawn: what was left out, and where the tolerance was not met.

    The warning of that ends with a `remedy`, if there is one.
    """
    drawn = {name: window for window in windows for name in window.bodies}
    done, left_out, warnings = [], [], []
    for view, body in zip(views, bodies, strict=True):
        known, window = traits[view.name], drawn.get(view.name)
        by_raster = window is not None and window.engine == "raster"
        if not by_raster:
            body = replace(body, shadow_map_px=None, shadow_map_drawn_px=(0, 0), shadow_map_reused=False,
                           modelling_error=0.0)
        done.append(body)
        if not view.is_visible:
            left_out.append(f"{view.name}: out of view")
            continue
        if view.phase_rad > known.max_phase_rad:
            phase_deg, limit_deg = np.degrees([view.phase_rad, known.max_phase_rad])
            warnings.append(f"{known.law} of {view.name} at a phase of {phase_deg:.1f} deg: "
                            f"it holds to {limit_deg:.1f} deg")
        if window is not None and window.by_centroids:
            left_out.append(f"{view.name}: shadow boundaries inside facets: each facet is lit or dark by its centroid")
        if has_sun_disc and (body.shadow_map_px is not None or (window is not None and window.engine == "coverage")):
            left_out.append(f"{view.name}: the Sun's disc: shadows have hard edges, or those of a few of its points")
        if by_raster and body.shadow_map_px is None:
            left_out.append(f"shadows on {view.name}: nothing can cast on what is seen")
        if known.relief is not None:
            left_out.append(_detail_left_out(body, known))
    parallel = max((parallel_error(view, traits[view.name]) for view in views if view.is_visible), default=0.0)
    by_rays = max((ray_rounding_error(view, traits[view.name]) for view in views if view.is_visible
                   and view.name in drawn and drawn[view.name].engine != "raster"), default=0.0)
    predicted = math.hypot(max((window.predicted_error for window in windows), default=0.0), parallel, by_rays)
    rms = max_error
    if isinstance(max_error, Mapping):
        rms = min([error_gain * window.tolerance for window in windows] + [1.0])
    drawn_so = [([view for view in views if view.name in window.bodies], window.how,
                 window.predicted_error / error_gain, window.modelling_error) for window in windows]
    navigation = frame_errors(drawn_so, camera, error_gain)
    # The Sun's distance differs along a body.
    navigation["flux"] = math.hypot(navigation["flux"], parallel)
    for (members, *_), window in zip(drawn_so, windows, strict=True):
        navigation = with_eclipse(navigation, members, camera, window.flux_error)
    made = RenderPlan(camera=camera.name, max_error=rms, roi=grouping.union([w.roi for w in windows]),
                      windows=tuple(windows), bodies=tuple(done), left_out=tuple(left_out), predicted_error=predicted,
                      navigation=navigation, asked=by_unit(max_error))
    if any(math.isfinite(window.tolerance) for window in windows):
        least = frame_errors([(members, how, 0.0, 0.0) for members, how, *_ in drawn_so], camera, error_gain)
        for unit, text in made.misses().items():
            out = remedy
            if made.asked[unit] <= least.get(unit, 0.0):
                out = f"no frame of this view is promised less than {least[unit]:.2g}"
            warnings.append(text + (f"; {out}" if out else ""))
    return replace(made, warnings=tuple(warnings))


def _detail_left_out(body: BodyPlan, traits: BodyTraits) -> str:
    if body.detail_m is None:
        return f"{body.name}: surface detail: no pixel resolves it"
    finer = "" if body.detail_m <= traits.relief.scales_m().min() else f" below {body.detail_m:.3g} m, and"
    return f"{body.name}: of surface detail what is{finer} its shadows"
