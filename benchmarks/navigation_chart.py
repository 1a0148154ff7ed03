"""Navigation error against time: `make chart`, or `python benchmarks/navigation_chart.py [--frames N] [--size-px N]`.

Left, the camera's frames are drawn to 0.1 %, and the believed scene at budgets from 0.3 to 0.003 or with fixed
samples, as an on-board renderer would: error of each estimator against its processor time. Right, the believed scene is
drawn to 3 %, and the simulated camera's frames at those budgets: how far that moves what an estimator finds from where
it finds it in the frame drawn to 0.1 % with the same noise, which is the renderer's own bias. A knee is the largest
budget, or the fewest samples, that leaves the error within 20 % of the best one's, or whose bias adds no more than 20 %
to the error. The world is that of examples/navigation; it writes navigation_chart.png and .json.
"""

from __future__ import annotations

import argparse
import io
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from glrender_navigation import ESTIMATORS, sight
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from peers.environment import REPOSITORY
from PIL import Image

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
COLOURS = dict(zip(RENDERING, ("#0072b2", "#009e73", "#d55e00", "#cc79a7"), strict=True))
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
        return drawn[1:], float(np.median(times_ms[1:]))

    def measured(self, name: str, seen: list[np.ndarray], setting: dict[str, Any]) -> np.ndarray:
        """Errors right and down [px] and of the range [%], and processor time [ms], of each frame; NaN where lost."""
        estimator, rows = ESTIMATORS[name](self.camera, self.body), []

        def render(state, **options):
            return self.local.render(state, **{**options, **setting})

        # The first is drawn twice: what is kept from frame to frame is there then.
        for (true, believed), frame in zip((self.views[0], *self.views), (seen[0], *seen), strict=True):
            began = time.process_time()
            found = estimator.measure(frame, believed, render)
            took_ms = 1e3 * (time.process_time() - began)
            if found is None:
                rows.append([np.nan] * 3 + [took_ms])
                continue
            here = sight(true, self.camera, "body")
            rows.append([*np.subtract(found.center_px, self.camera.project(here.r_body_camera_m)),
                         100.0 * (found.range_m / here.range_m - 1.0), took_ms])
        return np.array(rows[1:])


def summed(errors: np.ndarray) -> dict[str, float]:
    """RMS of the centre [px] and of the range [%], median processor time [ms], frames lost."""
    right, down, percent, took_ms = errors.T
    return {"px": float(np.sqrt(np.nanmean(right**2 + down**2))), "percent": float(np.sqrt(np.nanmean(percent**2))),
            "ms": float(np.median(took_ms)), "lost": int(np.isnan(percent).sum())}


def rows(bench: Bench) -> list[dict[str, Any]]:
    """One a point of the chart."""
    found, (seen, _) = [], bench.frames(TRUE)
    for name in ALONE:
        found.append({"side": "belief", "estimator": name, **summed(bench.measured(name, seen, FINE))})
    for name in RENDERING:
        for setting in SETTINGS:
            errors = bench.measured(name, seen, setting)
            found.append({"side": "belief", "estimator": name, **setting, **summed(errors)})
            _say(found[-1])
    return found + camera_rows(bench, seen)


def camera_rows(bench: Bench, true_frames: list[np.ndarray]) -> list[dict[str, Any]]:
    """Rows of the camera's frames drawn at a tolerance, and of each estimator's whole error, which has no setting."""
    found, exact = [], {name: bench.measured(name, true_frames, FINE) for name in RENDERING}
    for name, errors in exact.items():
        found.append({"side": "camera", "estimator": name, **summed(errors)})
    for setting in SETTINGS:
        seen, frame_ms = bench.frames(setting)
        for name in RENDERING:
            bias = summed(bench.measured(name, seen, FINE) - exact[name])
            found.append({"side": "camera", "estimator": name, **setting, **bias, "ms": frame_ms})
            _say(found[-1])
    return found


def knee(points: list[dict[str, Any]], quantity: str, floor: float | None) -> dict[str, Any]:
    """The first of points, coarse to fine, that is good enough: beside the best, or beside an error it adds to."""
    if floor is None:
        most = _KNEE * min(point[quantity] for point in points)
    else:
        most = max(floor * (_KNEE**2 - 1.0)**0.5, min(point[quantity] for point in points))
    return next(point for point in points if point[quantity] <= most)


def draw(found: list[dict[str, Any]], out: Path, title: str) -> None:
    figure = Figure(figsize=(11.0, 7.0), layout="constrained")
    axes = figure.subplots(2, 2, sharex="col")
    for row, (quantity, of) in enumerate((("px", "centre"), ("percent", "range"))):
        unit = quantity.replace("percent", "%")
        for column, side in enumerate(("belief", "camera")):
            axis = axes[row, column]
            for name in RENDERING:
                _curves(axis, [p for p in found if p["side"] == side and p["estimator"] == name], name, quantity)
            for point in (p for p in found if p["side"] == side and p["estimator"] in ALONE):
                axis.axhline(point[quantity], color="0.5", lw=1.2, ls=":")
                axis.annotate(f"{point['estimator']} renders nothing: {point['ms']:.1f} ms", (0.99, point[quantity]),
                              xycoords=("axes fraction", "data"), ha="right", va="bottom", fontsize=7, color="0.35")
            axis.set(xscale="log", yscale="log")
            axis.set_ylabel(f"{of}: RMS error [{unit}]" if column == 0 else f"{of}: RMS bias by the renderer [{unit}]")
            axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axis.xaxis.set_minor_formatter(NullFormatter())
            axis.grid(True, which="major", alpha=0.3)
    axes[0, 0].set_title("on-board: the believed scene at a budget", fontsize=10)
    axes[0, 1].set_title("simulator: the camera's frame at a budget", fontsize=10)
    axes[1, 0].set_xlabel("processor time of a measurement, its rendering included [ms]")
    axes[1, 1].set_xlabel("processor time of drawing the frame [ms]")
    lines = [Line2D([], [], color=COLOURS[name], marker="o", ms=4, label=name) for name in RENDERING]
    lines += [Line2D([], [], color="0.3", marker="o", ms=4, label="budgets " + ", ".join(f"{b:g}" for b in BUDGETS)),
              Line2D([], [], color="0.3", marker="x", ls="--", lw=0.7, label="fixed samples 1, 2, 4, 8 a side"),
              Line2D([], [], color="0.3", marker="o", ls="", ms=12, mfc="none", label="knee: more does not help"),
              Line2D([], [], color="0.3", ls=":", label="right: the estimator's whole error")]
    figure.legend(handles=lines, loc="outside lower center", ncols=4, fontsize=8)
    figure.suptitle(title, fontsize=11)
    with io.BytesIO() as drawn:
        figure.savefig(drawn, dpi=90)
        Image.open(drawn).convert("RGB").quantize(128).save(out, optimize=True)


def _curves(axis, points: list[dict[str, Any]], name: str, quantity: str) -> None:
    floor = next((p[quantity] for p in points if "max_error" not in p and "samples" not in p), None)
    if floor is not None:
        axis.axhline(floor, color=COLOURS[name], lw=1.0, ls=":")
    for key, style in (("max_error", {"marker": "o", "ms": 4}), ("samples", {"marker": "x", "ls": "--", "lw": 0.7})):
        chosen = [p for p in points if key in p and np.isfinite(p[quantity])]
        chosen = sorted(chosen, key=lambda p: p[key] if key == "samples" else -p[key])
        axis.plot([p["ms"] for p in chosen], [p[quantity] for p in chosen], color=COLOURS[name], **style)
        if not chosen:
            # Every frame was lost.
            continue
        best = knee(chosen, quantity, floor)
        axis.plot(best["ms"], best[quantity], "o", ms=12, mfc="none", color=COLOURS[name])
        axis.annotate(f"{best[key]:g}", (best["ms"], best[quantity]), xytext=(8, 5), textcoords="offset points",
                      fontsize=8, color=COLOURS[name])


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
