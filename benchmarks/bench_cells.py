"""Processor time and errors of the main workloads: `python benchmarks/bench_cells.py [--truth] [--only PART...]`.

Twelve closed loops, in which the body turns by 0.083 deg from frame to frame, at three tolerances: Itokawa by Hapke
at 2 to 500 px and close up, a rough shape of 786,432 facets, Didymos with Dimorphos; the Sun has its disc. Prints
one JSON line a cell: median processor time of some frames after one to warm up, errors beside 12 million rays
that `--truth` makes first. To compare two commits, run it by turns with PYTHONPATH at each checkout.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from accuracy.scenes import HAPKE, Case, build
from glrender import Renderer
from scipy.spatial.transform import Rotation

TOLERANCES = (0.05, 0.02, 0.01)
_STEP_DEG = 0.083
_SIZES = (("49k", 1024, 500.0, 60.0), ("49k", 1024, 500.0, 120.0), ("49k", 1024, 500.0, 150.0),
          ("49k", 512, 2000.0, 60.0), ("786k", 1024, 500.0, 60.0), ("49k", 512, 40.0, 60.0), ("49k", 512, 20.0, 60.0),
          ("49k", 512, 10.0, 60.0), ("49k", 512, 5.0, 60.0), ("49k", 512, 2.0, 60.0), ("786k", 512, 20.0, 60.0))
CELLS = (*(Case(name=f"{facets} {size:g} px {phase:g} deg", facets=facets, frame_px=frame, body_px=size,
                phase_deg=phase) for facets, frame, size, phase in _SIZES),
         Case(name="pair 500 px 60 deg", facets="49k", frame_px=1024, body_px=500.0, phase_deg=60.0, is_pair=True))


def turned(state, k: int):
    """The state with its bodies turned by k steps."""
    turn = Rotation.from_rotvec([0.0, 0.0, math.radians(_STEP_DEG * k)])
    return replace(state, bodies={name: replace(pose, q_from_inertial=(
        Rotation.from_quat(pose.q_from_inertial, scalar_first=True) * turn).as_quat(scalar_first=True))
        for name, pose in state.bodies.items()})


def truth(scene, state, rays: float) -> np.ndarray:
    """Irradiance (height, width) by rays, some 12 million in all."""
    from glrender.engines.rays.engine import RayEngine
    from glrender.view.regions import region
    from glrender.view.view import view_bodies

    camera, engine = scene.cameras[0], RayEngine(scene)
    views = view_bodies(state, camera, scene.hulls)
    x0, y0, x1, y1 = region([view for view in views if view.is_visible], camera)
    n = min(max(int(math.sqrt(rays / ((x1 - x0) * (y1 - y0)))), 5), 400)
    x, y = (low - 0.5 + (np.arange((high - low) * n) + 0.5) / n for low, high in ((x0, x1), (y0, y1)))
    image = np.zeros((camera.height_px, camera.width_px))
    for row in range(y1 - y0):
        samples = engine.lattice(x, y[row * n:(row + 1) * n], camera, views, n)
        image[y0 + row, x0:x1] = samples.reshape(n, x1 - x0, n).mean(axis=(0, 2))
    return image


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="*", metavar="PART", help="cells whose name holds one of these")
    parser.add_argument("--frames", type=int, default=4)
    parser.add_argument("--truth", action="store_true", help="make the truths, and nothing else")
    parser.add_argument("--rays", type=float, default=12e6, help="of a truth")
    parser.add_argument("--folder", type=Path, default=Path(__file__).parent.parent / "out" / "cells", help="of truths")
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    for case in CELLS:
        if arguments.only and not any(part in case.name for part in arguments.only):
            continue
        scene, state = build(case)
        scene = replace(scene, bodies=[replace(body, brdf=HAPKE) for body in scene.bodies], sun_disc=True)
        file = arguments.folder / f"{case.name.replace(' ', '_')}_{arguments.frames}.npy"
        if arguments.truth:
            if not file.exists():
                np.save(file, truth(scene, turned(state, arguments.frames), arguments.rays))
            continue
        exact = np.load(file) if file.exists() else None
        with Renderer(scene) as renderer:
            for tolerance in TOLERANCES:
                sys.stdout.write(json.dumps({"cell": case.name, "tolerance": tolerance, **timed(
                    renderer, state, tolerance, arguments.frames, exact)}) + "\n")
                sys.stdout.flush()


def timed(renderer: Renderer, state, tolerance: float, n_frames: int, exact: np.ndarray | None) -> dict:
    """Processor time [ms] of a cell, its prediction, and its errors where there is a truth."""
    seconds = []
    for k in range(n_frames + 1):
        begin = time.process_time()
        image = renderer.render(turned(state, k), max_error=tolerance)
        seconds.append(time.process_time() - begin)
    row = {"cpu_ms": round(1e3 * float(np.median(seconds[1:])), 2),
           "predicted": round(image.plan.predicted_error, 4),
           "engines": [window.engine for window in image.plan.windows]}
    if exact is not None:
        off, lit = image.irradiance_W_m2.astype(float) - exact, exact > 0.0
        row |= {"rms": round(float(np.sqrt((off**2).sum() / lit.sum()) / exact[lit].mean()), 4),
                "flux": round(float(off.sum() / exact.sum()), 5)}
    return row


if __name__ == "__main__":
    main()
