"""Frames of a body that turns, in real time: how long each takes, of a large shape beside a small one: JSON lines.

    python benchmarks/bench_moving.py [--hours 12] [--every-s 1] [--frames 60]
"""

from __future__ import annotations

import argparse
import json
import math
import time
from dataclasses import replace

import numpy as np
from accuracy import scenes
from glrender import Renderer
from scipy.spatial.transform import Rotation

NAMES = ("middle 500 px, 49k", "middle 500 px, 3.1M")
BUDGETS = (0.1, 0.05, 0.02, 0.01)
AXIS = np.array([0.3, 0.2, 1.0]) / np.linalg.norm([0.3, 0.2, 1.0])
# Frames of which motion is not known yet.
FIRST = 8


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=12.0, help="in which the body turns once")
    parser.add_argument("--every-s", type=float, default=1.0, help="from frame to frame, of the clock and of the body")
    parser.add_argument("--frames", type=int, default=60)
    given = parser.parse_args()
    for name in NAMES:
        scene, state = scenes.build(next(case for case in scenes.CASES if case.name == name))
        pose = state.bodies["body"]
        start = Rotation.from_quat(pose.q_from_inertial, scalar_first=True)
        with Renderer(scene) as renderer:
            for budget in BUDGETS:
                taken_ms, begin_s = [], time.perf_counter()
                for n in range(FIRST + given.frames):
                    turned = Rotation.from_rotvec(-2.0 * math.pi * n * given.every_s / (3600.0 * given.hours) * AXIS)
                    at = replace(pose, q_from_inertial=(turned * start).as_quat(scalar_first=True))
                    time.sleep(max(begin_s + n * given.every_s - time.perf_counter(), 0.0))
                    asked_s = time.perf_counter()
                    renderer.render(replace(state, bodies={"body": at}), max_error=budget)
                    taken_ms.append(1e3 * (time.perf_counter() - asked_s))
                quantiles = np.percentile(taken_ms[FIRST:], [50, 95, 100])
                print(json.dumps({"scene": name, "budget": budget, "hours": given.hours, "every_s": given.every_s,
                                  **dict(zip(("p50_ms", "p95_ms", "max_ms"), quantiles.round(1).tolist(), strict=True)),
                                  "mean_ms": round(float(np.mean(taken_ms[FIRST:])), 1)}), flush=True)


if __name__ == "__main__":
    main()
