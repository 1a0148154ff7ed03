"""Cost of a coma against its error: 1024 x 1024, 67P in view, a grid of 128^3; prints JSON, writes a chart.

    python benchmarks/bench_coma.py SHAPE.obj [--out CHART.png] [--rounds N] [--truth CACHE.npz]

`adds_ms` is the median of the frame's lap `emission`: all that is done for the coma and not without it (its plan, the
bodies' depths, nodes, columns, light, their transfer). `extra_ms`, the median difference of a frame with and one
without in turns, has the noise of both besides. The error is RMS over the mean, of columns averaged over a pixel's area
against float64 sums of 512 steps along rays that the full shape ends, by Embree: nothing of OpenGL is in it.
`edge_error` is of the pixels at the nucleus' edge alone, over the same mean.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import cv2
import matplotlib
import numpy as np
from glrender import Body, PinholeCamera, Pose, Renderer, Scene, State
from glrender.brdf import Lambert
from glrender.emission import Coma, Dust, drawing
from glrender.emission.column import columns
from glrender.emission.layers import Layers
from glrender.emission.planning import Sampling
from glrender.emission.sources.haser import Haser
from glrender.emission.sources.jets import Jet, Jets, surface_point
from glrender.emission.sources.volume import Volume
from glrender.engines.rays.exact_rays import ExactMesh

matplotlib.use("Agg")
import matplotlib.pyplot as plt

SIZE, RANGE_M, CELLS, HALF_M = 1024, 120e3, 128, 12e3
EDGE_M = 400.0
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
    parser.add_argument("--truth", type=Path, help="where the truth is kept, or taken from")
    arguments = parser.parse_args()
    body = Body.from_file(arguments.shape, name="67p", length_unit="km", brdf=Lambert(normal_albedo=0.06))
    camera = PinholeCamera(name="camera", width_px=SIZE, height_px=SIZE, focal_length_px=10500.0)
    dust = Dust()
    coma = Coma(body="67p", sources=[grid(body, dust)], dust=dust)
    state = State(t_s=0.0, r_sun_inertial_m=1.9e11 * SUN,
                  spacecraft=Pose(r_inertial_m=[0.0, 0.0, -RANGE_M], q_from_inertial=[1.0, 0.0, 0.0, 0.0]),
                  bodies={"67p": Pose(r_inertial_m=[0.0, 0.0, 0.0], q_from_inertial=[1.0, 0.0, 0.0, 0.0])})
    settings = {"bodies": [body], "cameras": [camera], "max_error": 0.02}
    truth = _truth(coma, body, state, camera, arguments.truth)
    with Renderer(Scene(**settings)) as bare, Renderer(Scene(**settings, emission=[coma])) as renderer:
        rows = []
        plan, planned = drawing.choose, []
        chosen = [(steps, per_node) for per_node in (1, 2, 4, 8) for steps in (16, 32, 64, 128)]
        for steps, per_node in chosen:
            drawing.choose = lambda *_, s=steps, n=per_node: Sampling(
                steps=s, front_steps=s, pixels_per_node=n, front_pixels_per_node=max(n // 2, 1),
                far_pixels_per_node=0 if n == 1 else max(n, 4), predicted_error=0.0)
            rows.append(_measure(renderer, bare, state, truth, 3))
        drawing.choose = plan
        for budget in (0.1, 0.05, 0.02, 0.01):
            planned.append({"max_error": budget,
                            **_measure(renderer, bare, state, truth, arguments.rounds, budget)})
        report = {"gl_renderer": renderer.info["gl_renderer"], "image_px": SIZE, "cells": CELLS,
                  "planned": planned, "grid": rows}
    sys.stdout.write(json.dumps(report) + "\n")
    _chart(report, arguments.out)


def _captured(renderer: Renderer, state: State, **options):
    """An image, and the columns that were drawn of its coma."""
    taken, original = [], drawing.ComaDrawing._columns

    def columns_of(self, *inputs):
        made = original(self, *inputs)
        taken.append(made[0].copy())
        return made

    drawing.ComaDrawing._columns = columns_of
    try:
        image = renderer.render(state, **options)
    finally:
        drawing.ComaDrawing._columns = original
    return image, taken[0]


@dataclass(frozen=True)
class Truth:
    """Means over pixels at (y, x) of columns, how many pixels of the image each speaks for, and which are at edges."""

    y: np.ndarray
    x: np.ndarray
    column: np.ndarray
    weight: np.ndarray
    is_edge: np.ndarray


def _truth(coma: Coma, body: Body, state: State, camera: PinholeCamera, kept: Path | None) -> Truth:
    if kept is not None and kept.exists():
        return Truth(**np.load(kept))
    field = Layers(coma.sources, body.shape).at(state.r_sun_inertial_m)[0].field
    mesh, r_camera = ExactMesh(body.shape.vertices_m, body.shape.facets), np.array([0.0, 0.0, -RANGE_M])

    def ranges(pixel: np.ndarray) -> np.ndarray:
        return mesh.hit(r_camera, camera.directions(pixel))[1]

    y, x = (axis.ravel() for axis in np.mgrid[:SIZE, :SIZE])
    depth = np.minimum(ranges(np.stack([x, y], axis=1).astype(np.float64)), 2.0 * RANGE_M).reshape(SIZE, SIZE)
    edge = cv2.dilate(depth, np.ones((3, 3))) - cv2.erode(depth, np.ones((3, 3))) > EDGE_M
    made = []
    # Few pixels are at edges, and have most of the error: more of them are taken, each by more rays.
    for is_in, every, samples in ((edge.ravel(), 3, 8), (~edge.ravel(), 97, 2)):
        chosen = np.flatnonzero(is_in)[::every]
        offsets = (np.arange(samples) + 0.5) / samples - 0.5
        place = np.stack([x, y], axis=1)[chosen]
        mean = np.zeros(len(chosen))
        for dx, dy in product(offsets, offsets):
            pixel = place + (dx, dy)
            mean += columns(field, r_camera, camera.directions(pixel), 512, ranges(pixel)) / samples**2
        made.append((y[chosen], x[chosen], mean, np.full(len(chosen), is_in.sum() / len(chosen)),
                     np.full(len(chosen), samples > 2)))
    truth = Truth(*(np.concatenate(part) for part in zip(*made, strict=True)))
    if kept is not None:
        np.savez(kept, **vars(truth))
    return truth


def _measure(renderer, bare, state, truth: Truth, rounds, budget=0.02) -> dict:
    options = {"max_error": budget}
    image, column = _captured(renderer, state, **options)
    error, whole = column[truth.y, truth.x] - truth.column, truth.weight.sum()
    mean = np.sum(truth.weight * truth.column) / whole
    rms = lambda part: float(np.sqrt(np.sum((truth.weight * error**2)[part]) / whole) / mean)  # noqa: E731
    apart, own, alone = [], [], []
    for _ in range(rounds):
        began = time.perf_counter()
        made = renderer.render(state, **options)
        between = time.perf_counter()
        bare.render(state, **options)
        ended = time.perf_counter()
        apart.append(1e3 * (2.0 * between - began - ended))
        alone.append(1e3 * (ended - between))
        own.append(made.timings_ms["emission"])
    told = image.plan.emission[0]
    return {**{name: value for name, value in told.modelled["fields"][0].items() if "steps" in name or "node" in name},
            "adds_ms": round(statistics.median(own), 2), "adds_most_ms": round(max(own), 2),
            "extra_ms": round(statistics.median(apart), 2), "frame_ms": round(statistics.median(alone), 2),
            "error": rms(slice(None)), "edge_error": rms(truth.is_edge), "predicted_error": told.predicted_error,
            "flux_error": float(np.sum(truth.weight * error) / (mean * whole))}


def _chart(report: dict, out: Path) -> None:
    figure, axes = plt.subplots(figsize=(7.5, 5.0))
    for per_node in sorted({row["pixels_per_node"] for row in report["grid"]}):
        rows = [row for row in report["grid"] if row["pixels_per_node"] == per_node]
        rows.sort(key=lambda row: row["steps"])
        axes.loglog([row["adds_ms"] for row in rows], [100.0 * row["error"] for row in rows], "o-",
                    label=f"a node every {per_node} px; {', '.join(str(row['steps']) for row in rows)} steps")
    axes.loglog([row["adds_ms"] for row in report["planned"]], [100.0 * row["error"] for row in report["planned"]],
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
