"""Cost of a coma against its error: 1024 x 1024, 67P in view, a grid of 128^3; prints JSON, writes a chart.

    python benchmarks/bench_coma.py SHAPE.obj [--out CHART.png] [--rounds N]

Extra milliseconds are medians of frames with the coma less frames without, in turns. The error is RMS over the
mean, over pixels of which the float64 twin sums columns in 1024 steps.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from pathlib import Path

import matplotlib
import numpy as np
from glrender import Body, PinholeCamera, Pose, Renderer, Scene, State
from glrender.brdf import Lambert
from glrender.emission import Coma, Dust, drawing
from glrender.emission.column import columns
from glrender.emission.planning import Sampling
from glrender.emission.sources.haser import Haser
from glrender.emission.sources.jets import Jet, Jets, surface_point
from glrender.emission.sources.volume import Volume

matplotlib.use("Agg")
import matplotlib.pyplot as plt

SIZE, RANGE_M, CELLS, HALF_M = 1024, 120e3, 128, 12e3
SUN = np.array([0.8, 0.3, -0.52])


def grid(body: Body, dust: Dust) -> Volume:
    """A coma of jets on an even outflow, as densities in cells."""
    jets = []
    for latitude, longitude, width in ((15, 160, 14), (-30, 230, 20), (50, 40, 16), (-10, 300, 25), (70, 200, 18)):
        angles = np.radians([latitude, longitude])
        direction = np.array([np.cos(angles[0]) * np.cos(angles[1]), np.cos(angles[0]) * np.sin(angles[1]),
                              np.sin(angles[0])])
        vent, normal = surface_point(body.shape, direction)
        jets.append(Jet(vent_m=vent, normal=normal, axis=0.5 * normal + direction, weight_m=dust.weight_m(0.3),
                        half_width_deg=width, vent_radius_m=150.0))
    middle = (np.arange(CELLS) + 0.5) / CELLS * 2.0 * HALF_M - HALF_M
    r = np.stack(np.meshgrid(middle, middle, middle, indexing="ij"), axis=-1).reshape(-1, 3)
    total = Jets(jets=jets).components(r).sum(axis=0) + Haser(weight_m=dust.weight_m(1.0)).components(r)[0]
    density = total / np.sum(r**2, axis=1)
    return Volume(cross_section_per_m=density.reshape(CELLS, CELLS, CELLS), low_m=np.full(3, -HALF_M),
                  high_m=np.full(3, HALF_M))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("shape", type=Path, help="67P's shape, in km")
    parser.add_argument("--out", type=Path, default=Path("out/coma_cost.png"))
    parser.add_argument("--rounds", type=int, default=9)
    arguments = parser.parse_args()
    body = Body.from_file(arguments.shape, name="67p", length_unit="km", brdf=Lambert(normal_albedo=0.06))
    camera = PinholeCamera(name="camera", width_px=SIZE, height_px=SIZE, focal_length_px=10500.0)
    dust = Dust()
    coma = Coma(body="67p", sources=[grid(body, dust)], dust=dust)
    state = State(t_s=0.0, r_sun_inertial_m=1.9e11 * SUN,
                  spacecraft=Pose(r_inertial_m=[0.0, 0.0, -RANGE_M], q_from_inertial=[1.0, 0.0, 0.0, 0.0]),
                  bodies={"67p": Pose(r_inertial_m=[0.0, 0.0, 0.0], q_from_inertial=[1.0, 0.0, 0.0, 0.0])})
    settings = {"bodies": [body], "cameras": [camera], "max_error": 0.02}
    with Renderer(Scene(**settings)) as bare, Renderer(Scene(**settings, emission=[coma])) as renderer:
        truth, pixels = _truth(renderer, state, camera)
        rows = []
        plan, planned = drawing.choose, []
        chosen = [(steps, per_node) for per_node in (1, 2, 4, 8) for steps in (16, 32, 64, 128)]
        for steps, per_node in chosen:
            drawing.choose = lambda *_, s=steps, n=per_node: Sampling(
                steps=s, pixels_per_node=n, front_pixels_per_node=max(n // 2, 1), predicted_error=0.0)
            rows.append(_measure(renderer, bare, state, truth, pixels, 5))
        drawing.choose = plan
        for budget in (0.1, 0.05, 0.02, 0.01):
            planned.append({"max_error": budget,
                            **_measure(renderer, bare, state, truth, pixels, arguments.rounds, budget)})
        report = {"gl_renderer": renderer.info["gl_renderer"], "image_px": SIZE, "cells": CELLS,
                  "planned": planned, "grid": rows}
    sys.stdout.write(json.dumps(report) + "\n")
    _chart(report, arguments.out)


def _captured(renderer: Renderer, state: State, **options):
    """An image, and the columns that were drawn of its coma."""
    taken, original = {}, drawing.ComaDrawing._columns

    def columns_of(self, *inputs):
        made = original(self, *inputs)
        taken["columns"], taken["drawing"] = made[0].copy(), self
        return made

    drawing.ComaDrawing._columns = columns_of
    try:
        image = renderer.render(state, **options)
    finally:
        drawing.ComaDrawing._columns = original
    return image, taken["columns"], taken["drawing"]


def _truth(renderer: Renderer, state: State, camera: PinholeCamera) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    # The level of detail that frames use: its surface, too, ends the rays.
    image, _, drawn = _captured(renderer, state, products=["range"])
    y, x = (axis.ravel() for axis in np.mgrid[3:SIZE:7, 2:SIZE:7])
    range_m = image.products["range"][y, x]
    layer = drawn._volumes[0][0]
    directions = camera.directions(np.stack([x, y], axis=1).astype(np.float64))
    end = np.where(np.isnan(range_m), np.inf, range_m)
    return columns(layer.field, np.array([0.0, 0.0, -RANGE_M]), directions, 1024, end), (y, x)


def _measure(renderer, bare, state, truth, pixels, rounds, budget=0.02) -> dict:
    options = {"max_error": budget}
    image, column, _ = _captured(renderer, state, **options)
    error = column[pixels] - truth
    with_coma, without, own = [], [], []
    for _ in range(rounds):
        for target, into in ((renderer, with_coma), (bare, without)):
            began = time.perf_counter()
            made = target.render(state, **options)
            into.append(1e3 * (time.perf_counter() - began))
            if target is renderer:
                own.append(made.timings_ms["emission"])
    told = image.plan.emission[0]
    field = told.modelled["fields"][0]
    return {"steps": field["steps"], "pixels_per_node": field["pixels_per_node"],
            "front_pixels_per_node": field["front_pixels_per_node"],
            "extra_ms": round(statistics.median(with_coma) - statistics.median(without), 2),
            "emission_ms": round(statistics.median(own), 2), "frame_ms": round(statistics.median(without), 2),
            "error": float(np.sqrt(np.mean(error**2)) / truth.mean()),
            "flux_error": float(column[pixels].sum() / truth.sum() - 1.0), "predicted_error": told.predicted_error}


def _chart(report: dict, out: Path) -> None:
    figure, axes = plt.subplots(figsize=(7.5, 5.0))
    for per_node in sorted({row["pixels_per_node"] for row in report["grid"]}):
        rows = [row for row in report["grid"] if row["pixels_per_node"] == per_node]
        rows.sort(key=lambda row: row["steps"])
        axes.loglog([row["emission_ms"] for row in rows], [100.0 * row["error"] for row in rows], "o-",
                    label=f"a node every {per_node} px; {', '.join(str(row['steps']) for row in rows)} steps")
    axes.loglog([row["emission_ms"] for row in report["planned"]], [100.0 * row["error"] for row in report["planned"]],
                "k*", markersize=12, label="planner, budgets " + ", ".join(
                    f"{100.0 * row['max_error']:g} %" for row in report["planned"]))
    axes.axvline(60.0, color="0.5", linestyle=":")
    axes.axhline(1.0, color="0.5", linestyle=":")
    axes.set(xlabel="milliseconds that the coma adds", ylabel="RMS error over the mean [%]",
             title=f"Coma: {report['image_px']}$^2$ px, {report['cells']}$^3$ cells, nucleus in view\n"
                   f"{report['gl_renderer']}, 2 cores")
    axes.grid(True, which="both", alpha=0.3)
    axes.legend(fontsize=8)
    figure.tight_layout()
    out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out, dpi=110)


if __name__ == "__main__":
    main()
