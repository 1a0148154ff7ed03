"""Frames of the hardest states within a time: `python benchmarks/deadline.py [--states N] [--of M] [--deadline-s S]`.

Of M random states (`accuracy/random_scenes.py`, at 0.5 %) those that take the most processor time are drawn again and
again with `deadline_s`. Prints one line of JSON: the share of frames within the time and a third more, by the clock and
by processor time, percentiles [ms], and the frames whose predicted error is below the true one against ray-traced
truth, whose own error is subtracted in squares. Times by the clock hold on an idle machine alone.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time

import numpy as np
from accuracy.metrics import errors
from accuracy.random_scenes import draw
from accuracy.truth import truth
from glrender import Renderer

MAX_ERROR, GRACE, FIRST_SEED = 0.005, 4.0 / 3.0, 90000
"""Tolerance [1] that keeps engines at work; time allowed over the deadline [1]; seeds that nothing was fitted to."""


def frames_of(seed: int, count: int, deadline_s: float | None) -> tuple[list[dict], list]:
    """Times [s] of a state's frames by clock and processor, after one that fills the caches; and the images."""
    case, rows, images = draw(seed), [], []
    with Renderer(case.scene) as renderer:
        renderer.render(case.state, max_error=MAX_ERROR)
        for _ in range(count):
            clock, processor = time.perf_counter(), time.process_time()
            image = renderer.render(case.state, max_error=MAX_ERROR, deadline_s=deadline_s)
            rows.append({"clock_s": time.perf_counter() - clock, "processor_s": time.process_time() - processor})
            images.append(image)
    return rows, images


def judged(seed: int, images: list, n_rays: float) -> list[dict]:
    """Predicted and true RMS errors of a state's images; the same image once."""
    case = draw(seed)
    exact, found = truth(case.scene, case.state, n_rays), {}
    for image in images:
        squared = errors(image.irradiance_W_m2, exact)["rms"]**2 - exact.own_error**2
        found[image.irradiance_W_m2.tobytes()] = {"seed": seed, "predicted": image.plan.predicted_error,
                                                  "true": float(np.sqrt(max(squared, 0.0)))}
    return list(found.values())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--states", type=int, default=100)
    parser.add_argument("--of", type=int, default=400)
    parser.add_argument("--frames", type=int, default=10, help="of each state")
    parser.add_argument("--deadline-s", type=float, default=0.03)
    parser.add_argument("--rays", type=float, default=30e6, help="of the truth; 0 leaves errors out")
    arguments = parser.parse_args()
    seeds = range(FIRST_SEED, FIRST_SEED + arguments.of)
    cost = {seed: frames_of(seed, 1, None)[0][0]["processor_s"] for seed in seeds}
    hardest = sorted(seeds, key=cost.get)[-arguments.states:]
    rows, errs = [], []
    for seed in hardest:
        timed, images = frames_of(seed, arguments.frames, arguments.deadline_s)
        rows += timed
        errs += judged(seed, images, arguments.rays) if arguments.rays else []
    limit_s, below = GRACE * arguments.deadline_s, [row for row in errs if row["true"] > row["predicted"]]
    times = {name: np.array([row[name] for row in rows]) for name in ("clock_s", "processor_s")}
    sys.stdout.write(json.dumps({
        "states": len(hardest), "of": arguments.of, "frames": len(rows), "deadline_ms": 1e3 * arguments.deadline_s,
        "without_ms": [round(1e3 * cost[seed], 1) for seed in (hardest[0], hardest[-1])],
        "within": {name: float((each <= limit_s).mean()) for name, each in times.items()},
        "p50_p95_p99_max_ms": {name: (1e3 * np.percentile(each, [50, 95, 99, 100])).round(1).tolist()
                               for name, each in times.items()},
        "images": len(errs), "predicted_below_true": below, "load": os.getloadavg()[0],
        "cores": len(os.sched_getaffinity(0))}) + "\n")


if __name__ == "__main__":
    main()
