"""One scene of the chart: glrender's configurations, the planner's own choices and the peers, as rows."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from glrender import Renderer, Scene, State, open_renderer
from peers.environment import frames_of
from peers.from_glrender import peer_scene

from .metrics import errors
from .timing import interleaved, percentiles
from .truth import Truth, truth

SAMPLES = (1, 2, 4, 8)
BUDGETS = (0.1, 0.05, 0.02, 0.01)
RAY_SAMPLES = (1, 2)


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits of a scene's time: rounds of glrender's frames, and seconds for these and for each peer.

    The truth has a least number of rays, and more where its own error is above a limit.
    """

    least: int = 5
    most: int = 25
    ours_s: float = 40.0
    peer_s: float = 10.0
    n_rays: float = 30e6
    truth_error: float = 0.002


def measure(scene: Scene, state: State, limits: Limits, peers: list[str]) -> dict[str, Any]:
    """Rows of times and errors, the truth they are measured against, and the peers that failed."""
    exact = truth(scene, state, limits.n_rays, limits.truth_error)
    rows = _glrender(scene, state, exact, limits) + _rays(scene, state, exact, limits)
    failed = {}
    given = peer_scene(scene, state, scene.cameras[0]) if peers else None
    for name in peers:
        try:
            made = frames_of(name, given, limits.peer_s)
        except RuntimeError as error:
            failed[name] = str(error)
            continue
        for samples, image in made.images.items():
            gain = 1.0
            if made.is_relative:
                gain = float((image * exact.irradiance_W_m2).sum() / np.square(image).sum())
            rows.append({"engine": name, "config": f"{samples} x {samples}", "samples": samples, "map": "",
                         **errors(gain * image, exact), **percentiles(made.times_ms[samples].tolist())})
    return {"rows": rows, "failed": failed, "truth_samples": exact.samples, "truth_error": exact.own_error}


def _glrender(scene: Scene, state: State, exact: Truth, limits: Limits) -> list[dict[str, Any]]:
    configs: dict[str, dict[str, Any]] = {f"{n} x {n}": {"samples": n, "max_error": 0.02} for n in SAMPLES}
    configs |= {f"plan {budget:g}": {"max_error": budget} for budget in BUDGETS}
    rows = []
    with Renderer(scene) as renderer:
        images = {name: renderer.render(state, **config, products=("facet_id", "sunlit"))
                  for name, config in configs.items()}
        jobs = {name: _FrameTwice(renderer, state, config) for name, config in configs.items()}
        interleaved(jobs, least=limits.least, most=limits.most, budget_s=limits.ours_s)
        for name, image in images.items():
            found = errors(image.irradiance_W_m2, exact, image.products)
            for label, times_ms in jobs[name].times_ms.items():
                rows.append({
                    "engine": "plan" if "plan" in name else "fixed", "config": name, "map": label, **found,
                    **percentiles(times_ms),
                    "samples": image.plan.samples, "predicted": image.plan.predicted_error,
                    "max_error": image.plan.max_error,
                    "shadow_map_px": max((body.shadow_map_px or 0 for body in image.plan.bodies), default=0)})
    return rows


def _rays(scene: Scene, state: State, exact: Truth, limits: Limits) -> list[dict[str, Any]]:
    """The slow exact engine as a user may choose it."""
    with open_renderer(scene, backend="raytrace") as tracer:
        jobs = {n: (lambda n=n: tracer.render(state, samples=n)) for n in RAY_SAMPLES}
        found = {n: errors(job().irradiance_W_m2, exact) for n, job in jobs.items()}
        times = interleaved(jobs, least=3, most=limits.most, budget_s=0.2 * limits.ours_s)
    return [{"engine": "raytrace", "config": f"{n} x {n}", "samples": n, "map": "", **found[n], **times[n]}
            for n in RAY_SAMPLES]


class _FrameTwice:
    """A frame that must draw its shadow map, and the same once more, which finds it."""

    def __init__(self, renderer: Renderer, state: State, config: dict[str, Any]):
        self._renderer, self._state, self._config = renderer, state, config
        self.times_ms: dict[str, list[float]] = {"fresh": [], "reused": []}

    def __call__(self) -> None:
        self._renderer.forget_shadow_maps()
        for times in self.times_ms.values():
            start = time.perf_counter()
            self._renderer.render(self._state, **self._config)
            times.append(1e3 * (time.perf_counter() - start))
