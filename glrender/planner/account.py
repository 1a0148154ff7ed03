"""The account of a drawn frame: what was left out, the errors to expect, and where the tolerance was missed. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..scene.tolerance import by_unit
from ..view.regions import Group, union
from .error_budget import Budget
from .error_model import BodyTraits, parallel_error
from .frame_plan import FramePlan
from .plan import ONE_DIRECTION, BodyPlan, RenderPlan, WindowPlan
from .predicted import frame_errors, with_eclipse
from .request import Request
from .seen import Seen

# The way out of an error by light that a lens moves.
_BEHIND_THE_LENS = ("a lens moves the light of a rectilinear image, which blurs edges: the backend \"auto\" draws "
                    "behind the lens what has no coma")


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
    request, drawn_so = plan.request, list(zip(plan.groups, drawn.windows, strict=True))
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
    windows = tuple(_reported(window, error_gain) for window in drawn.windows)
    if isinstance(rms, Mapping):
        rms = min([window.budget.tolerance for window in windows] + [1.0])
    has_tolerance = any(math.isfinite(window.budget.tolerance) for window in windows)
    made = RenderPlan(camera=request.camera.name, max_error=rms, roi=union([window.roi for window in windows]),
                      windows=windows, bodies=tuple(bodies), left_out=tuple(left_out),
                      predicted_error=max((window.predicted_error for window in windows), default=0.0),
                      navigation=_by_unit(plan.seen, drawn_so, error_gain), asked=by_unit(request.max_error),
                      promised=frame_errors([(group, window.how, 0.0, 0.0) for group, window in drawn_so], error_gain),
                      way_out=_way_out(request, drawn.is_late) if has_tolerance else "")
    return replace(made, warnings=(*warnings, *made.misses().values()))


def restated(image: RenderPlan, *, cells: int = 1, **errors: Any) -> RenderPlan:
    """The plan of a frame that a camera makes of an image: the frame has other errors, and misses of its own.

    Where the image's plan is silent about a miss, as of samples that were asked for, so is the frame's.

    Parameters
    ----------
    image : RenderPlan
    cells : int
        Cells of the image along the side of a pixel of the frame.
    **errors
        The frame's `max_error`, `predicted_error`, `asked` and `navigation`.
    """
    made = replace(image, promised=in_pixels(image.promised, 1.0 / cells), **errors)
    before, now = image.misses().values(), made.misses()
    # By light that a lens moved: else a frame errs by no more than its image.
    if "rms" in made.missed and "rms" not in image.missed:
        now["rms"] = made.miss("rms", _BEHIND_THE_LENS)
    return replace(made, warnings=(*(text for text in image.warnings if text not in before), *now.values()))


def in_pixels(errors: Mapping[str, float], cells: float) -> dict[str, float]:
    """Errors by unit, those in pixels of another size, of which one has so many cells along its side."""
    return {unit: error * cells if unit.endswith("_px") else error for unit, error in errors.items()}


def _by_unit(seen: Sequence[Seen], drawn: Sequence[tuple[Group, WindowPlan]], error_gain: float) -> dict[str, float]:
    """Predicted errors of the frame in each unit but `rms`."""
    regions = []
    for group, window in drawn:
        # The Sun's direction and distance along a body have laws of their own.
        modelled = {cause: error for cause, error in window.modelled.items() if cause != ONE_DIRECTION}
        modelling = Budget(tolerance=1.0).rms_of(modelled, window.modelled_flux)
        regions.append((group, window.how, math.hypot(modelling, *window.drawn.values()), modelling))
    found = frame_errors(regions, error_gain)
    found["flux"] = math.hypot(found["flux"], max((parallel_error(body.view, body.traits) for body in seen
                                                   if body.view.is_visible), default=0.0))
    for group, window in drawn:
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
    if seen.traits.breaks_highlights(seen.view.phase_rad):
        found.append(f"highlights of a smooth {name}: flat facets turn by more than a highlight is wide")
    if seen.traits.relief is not None:
        found.append(_detail_left_out(body, seen.traits))
    return found


def _reported(window: WindowPlan, error_gain: float) -> WindowPlan:
    """A window with the part of its errors, and of its budget, that a point spread function leaves."""
    modelled, drawn = ({cause: error_gain * error for cause, error in errors.items()}
                       for errors in (window.modelled, window.drawn))
    budget = replace(window.budget, tolerance=error_gain * window.budget.tolerance)
    return replace(window, budget=budget, modelled=modelled, drawn=drawn)


def _detail_left_out(body: BodyPlan, traits: BodyTraits) -> str:
    if body.detail_m is None:
        return f"{body.name}: surface detail: no pixel resolves it"
    finer = "" if body.detail_m <= traits.relief.scales_m().min() else f" below {body.detail_m:.3g} m, and"
    return f"{body.name}: of surface detail what is{finer} its shadows"
