"""The account of a drawn frame: what was left out, the errors to expect, and where the tolerance was missed. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from glrender_camera import PinholeCamera

from ..scene.tolerance import by_unit
from ..view import regions as grouping
from ..view.view import BodyView
from .error_model import BodyTraits, parallel_error
from .plan import ONE_DIRECTION, BodyPlan, RenderPlan, WindowPlan
from .predicted import frame_errors, with_eclipse


def account(camera: PinholeCamera, max_error: float | Mapping[str, float], error_gain: float,
            views: Sequence[BodyView], traits: Mapping[str, BodyTraits], bodies: Sequence[BodyPlan],
            windows: Sequence[WindowPlan], has_sun_disc: bool, remedy: str = "") -> RenderPlan:
    """The frame's plan as its windows were drawn, whose errors are before the camera's point spread function.

    That leaves `error_gain` [1] of them. The warning of a miss ends with a `remedy`, if there is one.
    """
    drawn = {name: window for window in windows for name in window.bodies}
    done, left_out, warnings = [], [], []
    for view, body in zip(views, bodies, strict=True):
        known, window = traits[view.name], drawn.get(view.name)
        by_raster = window is not None and window.engine == "raster"
        if not by_raster:
            body = replace(body, shadow_map_px=None, shadow_map_drawn_px=(0, 0), shadow_map_reused=False, modelled={})
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
    members = [[view for view in views if view.name in window.bodies] for window in windows]
    # The Sun's direction and distance along a body have laws of their own.
    others = [replace(window, modelled={cause: error for cause, error in window.modelled.items()
                                        if cause != ONE_DIRECTION}) for window in windows]
    drawn_so = [(each, window.how, window.predicted_error, window.modelling_error)
                for each, window in zip(members, others, strict=True)]
    navigation = frame_errors(drawn_so, camera, error_gain)
    navigation["flux"] = math.hypot(navigation["flux"], max(
        (parallel_error(view, traits[view.name]) for view in views if view.is_visible), default=0.0))
    for each, window in zip(members, windows, strict=True):
        navigation = with_eclipse(navigation, each, camera, window.flux_error)
    rms = max_error
    if isinstance(max_error, Mapping):
        rms = min([error_gain * window.budget.tolerance for window in windows] + [1.0])
    reported = tuple(_reported(window, error_gain) for window in windows)
    made = RenderPlan(camera=camera.name, max_error=rms, roi=grouping.union([w.roi for w in windows]),
                      windows=reported, bodies=tuple(done), left_out=tuple(left_out),
                      predicted_error=max((window.predicted_error for window in reported), default=0.0),
                      navigation=navigation, asked=by_unit(max_error))
    if any(math.isfinite(window.budget.tolerance) for window in windows):
        least = frame_errors([(each, how, 0.0, 0.0) for each, how, *_ in drawn_so], camera, error_gain)
        for unit, text in made.misses().items():
            out = remedy
            if made.asked[unit] <= least.get(unit, 0.0):
                out = f"no frame of this view is promised less than {least[unit]:.2g}"
            warnings.append(text + (f"; {out}" if out else ""))
    return replace(made, warnings=tuple(warnings))


def _reported(window: WindowPlan, error_gain: float) -> WindowPlan:
    """A window with the part of its errors that a point spread function leaves."""
    modelled, drawn = ({cause: error_gain * error for cause, error in errors.items()}
                       for errors in (window.modelled, window.drawn))
    return replace(window, modelled=modelled, drawn=drawn)


def _detail_left_out(body: BodyPlan, traits: BodyTraits) -> str:
    if body.detail_m is None:
        return f"{body.name}: surface detail: no pixel resolves it"
    finer = "" if body.detail_m <= traits.relief.scales_m().min() else f" below {body.detail_m:.3g} m, and"
    return f"{body.name}: of surface detail what is{finer} its shadows"
