"""The account of a drawn frame: what was left out, the errors to expect, and where the tolerance was missed. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..scene.tolerance import by_unit
from ..view.regions import union
from .error_model import BodyTraits, parallel_error
from .frame_plan import FramePlan
from .plan import ONE_DIRECTION, BodyPlan, RenderPlan, WindowPlan
from .predicted import frame_errors, with_eclipse
from .request import Request
from .seen import Seen


def account(plan: FramePlan, bodies: Sequence[BodyPlan], windows: Sequence[WindowPlan], has_sun_disc: bool,
            is_late: bool = False) -> RenderPlan:
    """The frame's plan as its windows were drawn, whose errors are before the camera's point spread function.

    Parameters
    ----------
    plan : FramePlan
    bodies : sequence of BodyPlan
        Those of the plan, with the shadow maps that were drawn.
    windows : sequence of WindowPlan
        For each group of the plan the one that was drawn, with its errors.
    has_sun_disc : bool
    is_late : bool
        Whether a deadline had passed before all was drawn.
    """
    camera, max_error, error_gain = plan.request.camera, plan.request.max_error, plan.request.use.error_gain
    drawn = {name: window for window in windows for name in window.bodies}
    done = [body if body.name in drawn and drawn[body.name].engine == "raster" else _without_map(body)
            for body in bodies]
    left_out, warnings = [], []
    for seen, body in zip(plan.seen, done, strict=True):
        left_out += _left_out(seen, body, drawn.get(body.name), has_sun_disc)
        if seen.view.is_visible and seen.view.phase_rad > seen.traits.max_phase_rad:
            phase_deg, limit_deg = np.degrees([seen.view.phase_rad, seen.traits.max_phase_rad])
            warnings.append(f"{seen.traits.law} of {body.name} at a phase of {phase_deg:.1f} deg: "
                            f"it holds to {limit_deg:.1f} deg")
    navigation = _by_unit(plan, windows)
    rms = max_error
    if isinstance(max_error, Mapping):
        rms = min([error_gain * window.budget.tolerance for window in windows] + [1.0])
    reported = tuple(_reported(window, error_gain) for window in windows)
    made = RenderPlan(camera=camera.name, max_error=rms, roi=union([w.roi for w in windows]),
                      windows=reported, bodies=tuple(done), left_out=tuple(left_out),
                      predicted_error=max((window.predicted_error for window in reported), default=0.0),
                      navigation=navigation, asked=by_unit(max_error))
    if any(math.isfinite(window.budget.tolerance) for window in windows):
        drawn_so = zip(plan.groups, windows, strict=True)
        least = frame_errors([(group, window.how, 0.0, 0.0) for group, window in drawn_so], error_gain)
        for unit, text in made.misses().items():
            out = _way_out(plan.request, is_late)
            if made.asked[unit] <= least.get(unit, 0.0):
                out = f"no frame of this view is promised less than {least[unit]:.2g}"
            warnings.append(f"{text}; {out}")
    return replace(made, warnings=tuple(warnings))


def _by_unit(plan: FramePlan, windows: Sequence[WindowPlan]) -> dict[str, float]:
    """Predicted errors of the frame in each unit but `rms`."""
    # The Sun's direction and distance along a body have laws of their own.
    others = [replace(window, modelled={cause: error for cause, error in window.modelled.items()
                                        if cause != ONE_DIRECTION}) for window in windows]
    found = frame_errors([(group, window.how, window.predicted_error, window.modelling_error)
                          for group, window in zip(plan.groups, others, strict=True)], plan.request.use.error_gain)
    found["flux"] = math.hypot(found["flux"], max((parallel_error(seen.view, seen.traits) for seen in plan.seen
                                                   if seen.view.is_visible), default=0.0))
    for group, window in zip(plan.groups, windows, strict=True):
        found = with_eclipse(found, group, window.flux_error)
    return found


def _way_out(request: Request, is_late: bool) -> str:
    """The caller's way out where the tolerance is missed."""
    if is_late:
        return "give more time than deadline_s"
    return "leave engine out" if request.engine is not None else "the backend \"raytrace\" draws it"


def _without_map(body: BodyPlan) -> BodyPlan:
    """A body that OpenGL did not draw."""
    return replace(body, shadow_map_px=None, shadow_map_drawn_px=(0, 0), shadow_map_reused=False, modelled={})


def _left_out(seen: Seen, body: BodyPlan, window: WindowPlan | None, has_sun_disc: bool) -> list[str]:
    """The features of a body that its window does not model."""
    name, found = body.name, []
    if window is None:
        return [f"{name}: out of view"]
    if window.by_centroids:
        found.append(f"{name}: shadow boundaries inside facets: each facet is lit or dark by its centroid")
    if has_sun_disc and (body.shadow_map_px is not None or window.engine == "coverage"):
        found.append(f"{name}: the Sun's disc: shadows have hard edges, or those of a few of its points")
    if window.engine == "raster" and body.shadow_map_px is None:
        found.append(f"shadows on {name}: nothing can cast on what is seen")
    if seen.traits.relief is not None:
        found.append(_detail_left_out(body, seen.traits))
    return found


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
