"""The plan of each body: the features that are modelled. Pure: no GL, no images."""

from __future__ import annotations

import math

from glrender_camera import PinholeCamera

from ..view.view import BodyView
from .error_budget import SHADOW_MAP_SHARE, Budget
from .error_model import BodyTraits, leaked_flux, rounding_error, usual_edges
from .plan import HARD, LEAK, BodyPlan
from .seen import Seen

SHADOW_SIZES_PX = tuple(2**k for k in range(8, 17))
"""Texels across a body; float32 coordinates have 256 steps in the finest."""
MAX_SHADOW_SIDE_PX = 4096
"""Most texels along a side of a shadow map."""
# Squared error [1] of one sample a pixel: twelve shapes at 100 to 1000 px, 30 to 120 deg, have 0.002 to 0.05.
_ONE_SAMPLE = 0.015
# RMS error [1] of light that leaks over that of the flux: the data of `error_model.leaked_flux`.
_LEAK_RMS = 2.0
# Share of the sunlit surface in cast shadow, per radian of phase: 6 % at 10 deg.
_SHADOWED_PER_RAD = 0.34


def plan_body(body: Seen, camera: PinholeCamera, budget: Budget | None) -> BodyPlan:
    """The features of a body that are modelled; there is a budget for each body in view."""
    view, traits, casters = body.view, body.traits, body.casters
    footprint_m = view.depth_m[0] / camera.focal_length_px
    is_relative = is_close(view, traits.radius_m, footprint_m)
    seen_share, shadow_px = _seen_share(view, traits, camera), None
    if budget is not None:
        shadow_px = plan_shadow(view, traits, bool(casters), budget, seen_share)
    modelled = {"coordinates": rounding_error(view, traits, is_relative)}
    if shadow_px is not None:
        modelled |= {LEAK: min(_LEAK_RMS * leaked_flux(view, traits, shadow_px), 1.0),
                     HARD: body.penumbra.hard_error}
    return BodyPlan(
        name=view.name, is_visible=view.is_visible, n_facets=traits.n_facets, law=traits.law,
        shadow_map_px=shadow_px, shadow_map_reused=False, relative_to_camera=is_relative,
        normal_lookup=footprint_m < 2e-4 * traits.radius_m, size_px=view.size_px, modelled=modelled,
        penumbra=body.penumbra, casters=casters, detail_m=body.detail_m, detail_layers=body.detail_layers)


def plan_shadow(view: BodyView, traits: BodyTraits, has_casters: bool, budget: Budget,
                seen_share: float = 1.0) -> int | None:
    """Texels of the shadow map across the body, or None when nothing can cast on what is seen.

    Two things ask for texels: the place of a shadow's edge, and light that leaks past what a texel cannot resolve, the
    more the lower the Sun. The flux stays within a tenth of the tolerance. A map has at most 4096 texels along a side;
    of a body of which a part is seen it covers that part only.
    """
    if not has_casters:
        if traits.is_convex:
            return None
        if _SHADOWED_PER_RAD * view.phase_rad < budget.flux:
            return None
    # n texels a pixel leave n^-3 of the squared error at edges.
    finer = math.cbrt(_ONE_SAMPLE * usual_edges(view, has_casters) / (SHADOW_MAP_SHARE * budget.tolerance) ** 2)
    texels = max(view.finest_px * max(finer, 1.0), leaked_flux(view, traits, 1) / budget.flux)
    sizes = [size for size in SHADOW_SIZES_PX if size * seen_share <= MAX_SHADOW_SIDE_PX]
    return next((size for size in sizes if size >= texels), sizes[-1])


def _seen_share(view: BodyView, traits: BodyTraits, camera: PinholeCamera) -> float:
    """Side of what the shadow map must cover over that of the body, about: no farther than a sphere's horizon."""
    if view.is_whole:
        return 1.0
    horizon_m = min(math.sqrt(view.depth_m[0] * (view.depth_m[0] + 2.0 * traits.radius_m)), view.depth_m[1])
    ideal = camera.rectilinear
    diagonal = math.hypot(ideal.width_px, ideal.height_px) / ideal.focal_length_px
    return min(0.5 * diagonal * horizon_m / traits.radius_m, 1.0)


def is_close(view: BodyView, radius_m: float, footprint_m: float) -> bool:
    """Whether body-fixed float32 coordinates, good to 6e-8 radii, are too coarse for what is seen."""
    depth_m = view.depth_m[0]
    return depth_m < 0.05 * radius_m or (footprint_m < 2e-5 * radius_m and depth_m < 0.5 * radius_m)
