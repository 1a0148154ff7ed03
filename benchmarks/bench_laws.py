"""Cost of a law over that of Lambert: frames of two renderers in turn, so that a noisy machine is noisy for both.

Itokawa (49k facets), 1024 x 1024, phase 60 degrees; ratios of medians, fresh and reused shadow map. Prints
one JSON line.
"""

from __future__ import annotations

import json
import sys
import time

import numpy as np
from bench_frame import LAWS, scene_and_state
from glrender import Renderer

N_FRAMES, N_WARM_UP = 41, 3


def main() -> None:
    record = {"benchmark": "laws", "frames": N_FRAMES}
    renderers = {}
    try:
        for law in LAWS:
            scene, state = scene_and_state("49k", law, 1024)
            renderers[law] = Renderer(scene)
        for samples in (1, 2):
            for is_reused in (False, True):
                milliseconds = {law: [] for law in LAWS}
                for _ in range(N_FRAMES + N_WARM_UP):
                    for law, renderer in renderers.items():
                        if not is_reused:
                            renderer.forget_shadow_maps()
                        began = time.perf_counter()
                        renderer.render(state, samples=samples)
                        milliseconds[law].append(1e3 * (time.perf_counter() - began))
                medians = {law: float(np.median(times[N_WARM_UP:])) for law, times in milliseconds.items()}
                record[f"{samples}x{samples} {'reused' if is_reused else 'fresh'}"] = {
                    "median_ms": medians,
                    "over_lambert": {law: medians[law] / medians["lambert"] for law in LAWS if law != "lambert"}}
    finally:
        for renderer in renderers.values():
            renderer.close()
    sys.stdout.write(json.dumps(record) + "\n")


if __name__ == "__main__":
    main()
