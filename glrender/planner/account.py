"""The account of a drawn frame: what was left out, the errors to expect, and where the tolerance was missed. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..scene.tolerance import by_unit
from ..view.regions import Group, union
from .error_budget import FLUX_SHARE
from .error_model import BodyTraits, parallel_error
from .frame_plan import FramePlan
from .plan import CENTROIDS, ONE_DIRECTION, SLIVERS, BodyPlan, RenderPlan, WindowPlan
from .predicted import frame_errors, with_eclipse
from .request import Request
from .seen import Seen

_PROMISED = "no frame of this view is promised less than"


@dataclass(frozen=True, kw_only=True, eq=False)
class Drawn:
    """A frame of surfaces as it was drawn, of which `account` makes its plan.

    Attributes
    ----------
    irradiance_W_m2 : (height, width) float32 [W/m2]
    small_bodies : tuple of SmallBody
    windows : tuple of WindowPlan
        For each group of the plan the one that was drawn, with its errors before the camera's point spread function.
    bodies : tuple of BodyPlan
        Those of the plan, with the shadow maps that were drawn.
    is_late : bool
        Whether a deadline had passed before all was drawn.
    areas : tuple of sequence
        With derivatives, of each window: the areas that were drawn, and their error [1].
    """

    irradiance_W_m2: np.ndarray
    small_bodies: tuple[Any, ...]
    windows: tuple[WindowPlan, ...]
    bodies: tuple[BodyPlan, ...]
    is_late: bool
    areas: tuple[Any, ...] = ()


def account(plan: FramePlan, drawn: Drawn, always: tuple[str, ...] = ()) -> RenderPlan:
    """The frame's plan as it was drawn: what was left out, the errors after the point spread function, and misses.

    `always` is left out of each frame of the scene.
    """
    request, way_out = plan.request, _way_out(plan.request, drawn.is_late)
    by_name = {name: window for window in drawn.windows for name in window.bodies}
    bodies = [body if body.name in by_name and by_name[body.name].engine == "raster" else _without_map(body)
              for body in drawn.bodies]
    left_out, warnings = [*always], []
    for seen, body in zip(plan.seen, bodies, strict=True):
        left_out += _left_out(seen, body, by_name.get(body.name), request.has_sun_disc)
        if seen.view.is_visible and seen.view.phase_rad > seen.traits.max_phase_rad:
            phase_deg, limit_deg = np.degrees([seen.view.phase_rad, seen.traits.max_phase_rad])
            warnings.append(f"{seen.traits.law} of {body.name} at a phase of {phase_deg:.1f} deg: "
                            f"it holds to {limit_deg:.1f} deg")
    error_gain, rms = request.use.error_gain, request.max_error
    if isinstance(rms, Mapping):
        rms = min([error_gain * window.budget.tolerance for window in drawn.windows] + [1.0])
    windows = tuple(_reported(window, error_gain) for window in drawn.windows)
    drawn_so = list(zip(plan.groups, drawn.windows, strict=True))
    made = RenderPlan(camera=request.camera.name, max_error=rms, roi=union([window.roi for window in windows]),
                      windows=windows, bodies=tuple(bodies), left_out=tuple(left_out),
                      predicted_error=max((window.predicted_error for window in windows), default=0.0),
                      navigation=_by_unit(plan.seen, drawn_so, error_gain), asked=by_unit(request.max_error))
    if any(math.isfinite(window.budget.tolerance) for window in windows):
        least = frame_errors([(group, window.how, 0.0, 0.0) for group, window in drawn_so], error_gain)
        warnings += missed(made, least, way_out)
    return replace(made, warnings=tuple(warnings))


def missed(plan: RenderPlan, least: Mapping[str, float], way_out: str) -> list[str]:
    """Warnings of a plan's misses: each with the way out, or with the least error [unit] that a frame is promised."""
    return [f"{text}; " + (f"{_PROMISED} {least[unit]:.2g}" if plan.asked[unit] <= least.get(unit, 0.0) else way_out)
            for unit, text in plan.misses().items()]


def restated(image: RenderPlan, *, cells: int = 1, moved: float = 0.0, **errors: Any) -> RenderPlan:
    """The plan of a frame that a camera makes of an image: the frame has other errors, and misses of its own.

    Where the image's plan is silent about a miss, as of samples that were asked for, so is the frame's.

    Parameters
    ----------
    image : RenderPlan
    cells : int
        Cells of the image along the side of a pixel of the frame.
    moved : float [1]
        RMS error of their light where a lens moves it.
    **errors
        The frame's `max_error`, `predicted_error`, `asked` and `navigation`.
    """
    made, warnings = replace(image, **errors), []
    before, now = image.misses(), made.misses()
    for text in image.warnings:
        unit = next((unit for unit, miss in before.items() if text.startswith(miss)), None)
        if unit is None:
            warnings.append(text)
        elif unit in now:
            way_out, promised, least = text.removeprefix(before[unit]).partition(f"{_PROMISED} ")
            if promised:
                least = f"{float(least) / (cells if unit.endswith('_px') else 1):.2g}"
            warnings.append(now[unit] + way_out + promised + least)
    if "rms" in now and "rms" not in before and moved > made.max_error:
        warnings.append(f"{now['rms']}; a lens moves the light of a rectilinear image, which blurs edges: the backend "
                        "\"auto\" draws behind the lens what has no coma")
    return replace(made, warnings=tuple(warnings))


def _by_unit(seen: Sequence[Seen], drawn: Sequence[tuple[Group, WindowPlan]], error_gain: float) -> dict[str, float]:
    """Predicted errors of the frame in each unit but `rms`."""
    # The Sun's direction and distance along a body have laws of their own.
    others = [(group, replace(window, modelled={cause: _before_gain(cause, error, window) for cause, error
                                                in window.modelled.items() if cause != ONE_DIRECTION}))
              for group, window in drawn]
    found = frame_errors([(group, window.how, window.predicted_error, window.modelling_error)
                          for group, window in others], error_gain)
    found["flux"] = math.hypot(found["flux"], max((parallel_error(body.view, body.traits) for body in seen
                                                   if body.view.is_visible), default=0.0))
    for group, window in drawn:
        found = with_eclipse(found, group, window.flux_error)
    return found


def _before_gain(cause: str, error: float, window: WindowPlan) -> float:
    """An error whose `FLUX_SHARE` is that of the flux: slivers' and centroids' follow from the flux's own tolerance."""
    return error * window.budget.flux_share / FLUX_SHARE if cause in (SLIVERS, CENTROIDS) else error


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
    if seen.traits.breaks_highlights(seen.view.phase_rad):
        found.append(f"highlights of a smooth {name}: flat facets turn by more than a highlight is wide")
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
