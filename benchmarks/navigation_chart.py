"""Navigation error against time: `make chart`, or `python benchmarks/navigation_chart.py [--frames N] [--size-px N]`.

Left, the camera's frames are drawn to 0.1 %, and the believed scene at budgets from 0.3 to 0.003 or with fixed
samples, as an on-board renderer would: error of each estimator against its processor time. Right, the believed scene is
drawn to 3 %, and the simulated camera's frames at those budgets: what a simulator's own errors do to the navigator,
against the processor time of its frame. A knee is the fastest budget within 20 % of the best one's error. The world is
that of examples/navigation; it writes navigation_chart.png and .json.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from glrender_navigation import ESTIMATORS, sight
from matplotlib.figure import Figure
from peers.environment import REPOSITORY

# An example, in no package.
sys.path.insert(0, str(REPOSITORY / "examples" / "navigation"))
import world

BUDGETS = (0.3, 0.1, 0.03, 0.01, 0.003)
SAMPLES = (1, 2, 4, 8)
SETTINGS = [{"max_error": budget} for budget in BUDGETS] + [{"samples": samples} for samples in SAMPLES]
TRUE, FINE = {"max_error": 0.001}, {"max_error": 0.03}
# Those that render; the others are lines.
RENDERING = ("model", "limb_shape", "templates", "landmarks")
ALONE = ("sphere", "limb_ellipse")
COLOURS = dict(zip((*RENDERING, *ALONE), ("#0072b2", "#009e73", "#d55e00", "#cc79a7", "0.55", "0.75"), strict=True))
_KNEE = 1.2


class Bench:
    """The frames of a flight, and what estimators make of them."""

    def __init__(self, n_frames: int, size_px: int):
        shape = world.shape()
        self.camera, self.body = world.camera(size_px), world.body(shape)
        self.views = list(world.views(n_frames))
        self.local = world.Local(world.scene(shape, size_px))

    def frames(self, setting: dict[str, Any]) -> tuple[list[np.ndarray], float]:
        """The camera's frames, with noise of equal seeds, and processor time of one [ms]."""
        drawn, times_ms = [], []
        for index, (true, _) in enumerate((self.views[0], *self.views)):
            began = time.process_time()
            # The sky and the detector take their time at any accuracy, so that the irradiance alone is timed.
            self.local.render(true, **setting)
            times_ms.append(1e3 * (time.process_time() - began))
            drawn.append(self.local.render(true, output="dn", exposure_s="auto", seed=index, **setting).pixels)
        return drawn[1:], float(np.mean(times_ms[1:]))

    def measured(self, name: str, seen: list[np.ndarray], setting: dict[str, Any]) -> dict[str, float]:
        """RMS errors of centre [px] and range [%], mean processor time [ms], frames lost."""
        estimator, rows, n_lost = ESTIMATORS[name](self.camera, self.body), [], 0

        def render(state, **options):
            return self.local.render(state, **{**options, **setting})

        # The first is drawn twice: what is kept from frame to frame is there then.
        for index, ((true, believed), frame) in enumerate(zip((self.views[0], *self.views), (seen[0], *seen),
                                                              strict=True)):
            began = time.process_time()
            found = estimator.measure(frame, believed, render)
            took_ms = 1e3 * (time.process_time() - began)
            if index == 0:
                continue
            if found is None:
                n_lost += 1
                continue
            here = sight(true, self.camera, "body")
            off = np.subtract(found.center_px, self.camera.project(here.r_body_camera_m))
            rows.append([off @ off, (100.0 * (found.range_m / here.range_m - 1.0))**2, took_ms])
        px2, percent2, took_ms = np.mean(rows, axis=0)
        return {"px": px2**0.5, "percent": percent2**0.5, "ms": took_ms, "lost": n_lost}


def rows(bench: Bench) -> list[dict[str, Any]]:
    """One a point of the chart."""
    found = []
    seen, _ = bench.frames(TRUE)
    for name in ALONE:
        found.append({"side": "belief", "estimator": name, **bench.measured(name, seen, FINE)})
    for name in RENDERING:
        for setting in SETTINGS:
            found.append({"side": "belief", "estimator": name, **setting, **bench.measured(name, seen, setting)})
            _say(found[-1])
    for setting in SETTINGS:
        seen, frame_ms = bench.frames(setting)
        for name in RENDERING:
            measured = bench.measured(name, seen, FINE)
            found.append({"side": "camera", "estimator": name, **setting, **measured, "ms": frame_ms})
            _say(found[-1])
    return found


def knee(points: list[dict[str, Any]], quantity: str) -> dict[str, Any]:
    """The fastest of points whose error is within 20 % of the best one's."""
    best = min(point[quantity] for point in points)
    return min((point for point in points if point[quantity] <= _KNEE * best), key=lambda point: point["ms"])


def draw(found: list[dict[str, Any]], out: Path, title: str) -> None:
    figure = Figure(figsize=(11.0, 7.2), layout="constrained")
    axes = figure.subplots(2, 2, sharex="col", sharey="row")
    for row, (quantity, label) in enumerate((("px", "centre: RMS error [px]"), ("percent", "range: RMS error [%]"))):
        for column, side in enumerate(("belief", "camera")):
            axis = axes[row, column]
            for name in RENDERING:
                _curve(axis, [p for p in found if p["side"] == side and p["estimator"] == name], name, quantity)
            for point in (p for p in found if p["side"] == side and p["estimator"] in ALONE):
                axis.axhline(point[quantity], color=COLOURS[point["estimator"]], lw=1.2, ls=":")
                axis.annotate(f"{point['estimator']}, {point['ms']:.1f} ms: renders nothing", (0.99, point[quantity]),
                              xycoords=("axes fraction", "data"), ha="right", va="bottom", fontsize=7, color="0.35")
            axis.set(xscale="log", yscale="log")
            axis.grid(True, which="both", alpha=0.2)
            if column == 0:
                axis.set_ylabel(label)
    axes[0, 0].set_title("on-board: the believed scene at a budget", fontsize=10)
    axes[0, 1].set_title("simulator: the camera's frame at a budget", fontsize=10)
    axes[1, 0].set_xlabel("processor time of a measurement, its rendering included [ms]")
    axes[1, 1].set_xlabel("processor time of drawing the frame [ms]")
    axes[0, 0].plot([], [], "o-", color="0.3", ms=4, label="budgets 0.3, 0.1, 0.03, 0.01, 0.003")
    axes[0, 0].plot([], [], "x--", color="0.3", lw=0.7, ms=5, label="fixed samples 1, 2, 4, 8")
    axes[0, 0].plot([], [], "o", color="0.3", ms=13, mfc="none", label="knee: its budget beside it")
    figure.legend(loc="outside lower center", ncols=4, fontsize=8)
    figure.suptitle(title, fontsize=11)
    figure.savefig(out, dpi=90)


def _curve(axis, points: list[dict[str, Any]], name: str, quantity: str) -> None:
    budgets = sorted((p for p in points if "max_error" in p), key=lambda p: -p["max_error"])
    samples = sorted((p for p in points if "samples" in p), key=lambda p: p["samples"])
    for chosen, style in ((budgets, {"marker": "o", "ms": 4, "label": name}),
                          (samples, {"marker": "x", "ls": "--", "lw": 0.7, "ms": 5})):
        axis.plot([p["ms"] for p in chosen], [p[quantity] for p in chosen], color=COLOURS[name], **style)
    best = knee(budgets, quantity)
    axis.plot(best["ms"], best[quantity], "o", ms=13, mfc="none", color=COLOURS[name])
    axis.annotate(f"{best['max_error']:g}", (best["ms"], best[quantity]), xytext=(0, 9), textcoords="offset points",
                  ha="center", fontsize=8, color=COLOURS[name])


def _say(row: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps({key: value if isinstance(value, str) else round(float(value), 4)
                                 for key, value in row.items()}) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=24)
    parser.add_argument("--size-px", type=int, default=256)
    parser.add_argument("--out", type=Path, default=REPOSITORY / "out")
    parser.add_argument("--redraw", action="store_true", help="of the last run's .json")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    table = arguments.out / "navigation_chart.json"
    if not arguments.redraw:
        table.write_text(json.dumps(rows(Bench(arguments.frames, arguments.size_px)), indent=1), encoding="utf-8")
    draw(json.loads(table.read_text(encoding="utf-8")), arguments.out / "navigation_chart.png",
         f"Navigation error against time: a contact binary of 81,920 facets, {arguments.size_px} px, "
         f"{arguments.frames} frames")
