"""Measured errors, without times: `python benchmarks/scene_errors.py [--scenes PART...]`.

The scenes are the chart's and thin crescents. The Sun has its disc, as scenes have by default. Writes
out/scene_errors.{json,md}; benchmarks/RESULTS.md has the table.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from accuracy import scenes
from accuracy.metrics import errors
from accuracy.truth import truth
from glrender import Renderer

OUT = Path(__file__).parent.parent / "out"
BUDGETS = (0.05, 0.02, 0.01)
CRESCENTS = tuple(scenes.Case(name=f"crescent {phase} deg, 200 px", facets="49k", frame_px=320, body_px=200.0,
                              phase_deg=float(phase)) for phase in (150, 155, 160, 165, 170, 175))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", nargs="*", metavar="PART", help="only scenes whose name holds one of these")
    parser.add_argument("--rays", type=float, default=30e6, help="of the truth, for each scene")
    parser.add_argument("--out", type=Path, default=OUT)
    arguments = parser.parse_args()
    rows = []
    for case in (*scenes.CASES, *CRESCENTS):
        if arguments.scenes is None or any(part in case.name for part in arguments.scenes):
            rows += measured(case, arguments.rays)
            sys.stderr.write(json.dumps(rows[-1]) + "\n")
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "scene_errors.json").write_text(json.dumps(rows, indent=1), encoding="utf-8")
    (arguments.out / "scene_errors.md").write_text(table(rows), encoding="utf-8")
    sys.stdout.write(table(rows))


def measured(case: scenes.Case, n_rays: float) -> list[dict]:
    """A row for each tolerance; ``rms`` has the truth's own sampling error taken out."""
    scene, state = scenes.build(case)
    scene = replace(scene, sun_disc=True)
    exact, rows = truth(scene, state, n_rays), []
    with Renderer(scene) as renderer:
        for max_error in BUDGETS:
            image = renderer.render(state, max_error=max_error)
            found, window = errors(image.irradiance_W_m2, exact), image.plan.windows[0]
            rows.append({"scene": case.name, "max_error": max_error, **found, "truth_error": exact.own_error,
                         "rms": float(np.sqrt(max(found["rms"]**2 - exact.own_error**2, 0.0))),
                         "predicted": image.plan.predicted_error,
                         "engine": "centroids" if window.by_centroids else window.engine})
    return rows


def table(rows: list[dict]) -> str:
    """Markdown."""
    lines = ["| scene | max_error | drawn by | predicted | RMS | flux [%] | centre [px] | RMS of the truth |",
             "|" + "---|" * 8]
    lines += [f"| {row['scene']} | {row['max_error']:g} | {row['engine']} | {row['predicted']:.4f} | "
              f"{row['rms']:.4f} | {100.0 * row['flux']:+.3f} | {row['centroid_px']:.3f} | {row['truth_error']:.4f} |"
              for row in rows]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
