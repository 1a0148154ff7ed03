"""One peer in a process of its own: `python -m peers.worker NAME SCENE.npz OUT.npz BUDGET_S`, in `benchmarks`.

Writes for each number of samples the image and the times of its frames. glrender is not needed here.
"""

from __future__ import annotations

import importlib
import sys
import time
from pathlib import Path

import numpy as np

from .peer_scene import PeerScene

PEERS = {"embree": "embree", "mitsuba": "mitsuba3", "open3d": "open3d_rays", "pyrender": "pyrender_gl",
         "pyvista": "pyvista_vtk", "cycles": "cycles"}
# Samples along a pixel's side that all scenes are rendered with; with more only where they are so many rays in all:
# seconds a frame tell no more.
_USUAL, _MOST_RAYS = 4, 30e6


def main(name: str, source: Path, out: Path, budget_s: float) -> None:
    module = importlib.import_module(f"peers.{PEERS[name]}")
    scene = PeerScene.load(source)
    began = time.perf_counter()
    render = module.prepare(scene)
    made = {"prepare_ms": 1e3 * (time.perf_counter() - began), "is_relative": getattr(module, "IS_RELATIVE", False)}
    x0, y0, x1, y1 = scene.region_px()
    for samples in module.SAMPLES:
        if samples > _USUAL and (x1 - x0) * (y1 - y0) * samples**2 > _MOST_RAYS:
            continue
        # The first frame compiles and builds.
        made[f"image_{samples}"] = np.asarray(render(samples), np.float64)
        times, began = [], time.perf_counter()
        while len(times) < 3 or (len(times) < 25 and time.perf_counter() - began < budget_s / len(module.SAMPLES)):
            start = time.perf_counter()
            render(samples)
            times.append(1e3 * (time.perf_counter() - start))
        made[f"times_ms_{samples}"] = np.array(times)
    np.savez(out, **made)


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]), float(sys.argv[4]))
