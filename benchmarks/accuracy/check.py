"""One held-out scene: is the true error within the predicted one, and is the plan the faster way?"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from glrender import GlrenderError, Renderer
from glrender.planner.plan import RenderPlan

from .metrics import errors
from .random_scenes import Draw
from .truth import truth

# Full fidelity, whatever the scene: the full shape, 8 x 8 samples everywhere, a shadow map for 1 %.
FIXED = {"samples": 8, "max_error": 0.01}


def check(case: Draw, n_rays: float = 10e6, rounds: int = 5) -> dict[str, Any] | None:
    """A row of the table; None when nothing is lit. With no rounds nothing is timed.

    Returns
    -------
    dict
        ``rms`` is the RMS error over the mean of the lit pixels with the truth's own sampling error taken out,
        ``flux`` the relative flux error, ``predicted`` and ``max_error`` the plan's; ``fresh``, ``reused``: the
        plan's time over that of the fixed full-fidelity path, `FIXED`, whose own errors are ``fixed_rms`` and
        ``fixed_flux``.
    """
    row = {"body": case.body, "law": case.law, "body_px": case.body_px, "phase_deg": case.phase_deg,
           "max_error": case.max_error, "n_facets": len(case.scene.bodies[0].shape.facets)}
    try:
        exact = truth(case.scene, case.state, n_rays)
        if not (exact.irradiance_W_m2 > 0.0).any():
            return None
        with Renderer(case.scene) as renderer:
            image = renderer.render(case.state, max_error=case.max_error)
            full = errors(renderer.render(case.state, **FIXED).irradiance_W_m2, exact)
            times = _times(renderer, case, rounds) if rounds else {}
    except GlrenderError as error:
        return {**row, "failure": str(error)}
    found = errors(image.irradiance_W_m2, exact)
    plan = image.plan
    return {
        **row, **found, "rms": float(np.sqrt(max(found["rms"]**2 - exact.own_error**2, 0.0))),
        "fixed_rms": full["rms"], "fixed_flux": full["flux"], "truth_error": exact.own_error,
        "n_lit_px": int((exact.irradiance_W_m2 > 0.0).sum()),
        "facets_per_px": 0.5 * row["n_facets"] / (0.6 * case.body_px**2), "predicted": plan.predicted_error,
        "engine": _engine(plan), "samples": plan.samples,
        "shadow_map_px": plan.bodies[0].shadow_map_px or 0, "warnings": list(plan.warnings),
        **times}


def _engine(plan: RenderPlan) -> str:
    """The engine that drew the frame's only body."""
    window = plan.windows[0]
    return "centroids" if window.by_centroids else window.engine


def is_within(row: dict[str, Any]) -> bool:
    """The prediction holds: RMS within it, flux within a tenth of it."""
    return row["rms"] <= row["predicted"] and abs(row["flux"]) <= 0.1 * row["predicted"]


def _times(renderer: Renderer, case: Draw, rounds: int) -> dict[str, float]:
    ways = {"plan": {"max_error": case.max_error}, "fixed": FIXED}
    laps: dict[tuple[str, str], list[float]] = {(way, label): [] for way in ways for label in ("fresh", "reused")}
    for way in ways.values():
        renderer.render(case.state, **way)
    for _ in range(rounds):
        for name, way in ways.items():
            renderer.forget_shadow_maps()
            for label in ("fresh", "reused"):
                start = time.perf_counter()
                renderer.render(case.state, **way)
                laps[name, label].append(time.perf_counter() - start)
    return {label: float(np.median(laps["plan", label]) / np.median(laps["fixed", label]))
            for label in ("fresh", "reused")}
