"""Frames a second on a GPU, and its images beside llvmpipe's: `python benchmarks/gpu.py`; see gpu.sh.

Irradiance by OpenGL and by the planner's choice for shapes of 49,152, 786,432 and 3.1 million facets, and frames of
8-bit digital numbers that a server answers. Without a GPU it says so and fails. Images lie beside the figures:
`python benchmarks/gpu.py --compare out/gpu` draws them by another machine's OpenGL, llvmpipe for one.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from accuracy.scenes import Case, build
from glrender import Renderer
from glrender_client import Client

SIDES_PX = (512, 1024)
_SERVER_SCENE = """
[[bodies]]
name = "body"
generated = {{ kind = "contact_binary", radius_m = 300.0, seed = 1, subdivisions = 6 }}
brdf = {{ law = "lambert", normal_albedo = 0.3 }}

[[cameras]]
name = "navcam"
width_px = {side}
height_px = {side}
focal_length_px = {focal}
model = {{ preset = "generic_navigation_camera", exposure_s = 3e-5 }}
"""


def rate(draw, seconds: float = 3.0) -> float:
    """Calls a second: the median over some seconds, after three to warm up."""
    for _ in range(3):
        draw()
    laps, end = [], time.perf_counter() + seconds
    while time.perf_counter() < end:
        begin = time.perf_counter()
        draw()
        laps.append(time.perf_counter() - begin)
    return 1.0 / float(np.median(laps))


def irradiance(facets: str, side_px: int, folder: Path) -> dict:
    """Frames a second of one scene; its image is saved in the folder."""
    scene, state = build(Case(name="gpu", facets=facets, frame_px=side_px, body_px=0.5 * side_px, phase_deg=60.0))
    states = [replace(state, t_s=float(k)) for k in range(2)]
    with Renderer(scene) as renderer:
        info, image = renderer.info, renderer.render(state, samples=2).irradiance_W_m2
        row = {"facets": facets, "side_px": side_px, "gl_renderer": info["gl_renderer"],
               "raster_per_s": rate(lambda: renderer.render(states[0], engine="raster")),
               "planned_per_s": rate(lambda: renderer.render(states[1])),
               "planned": [window.engine for window in renderer.render(states[1]).plan.windows]}
    np.save(folder / f"{facets}_{side_px}.npy", image)
    return row


def compare(folder: Path) -> list[dict]:
    """Draw each saved image by this machine's OpenGL: the RMS difference over the mean of what is lit [1]."""
    rows = []
    for file in sorted(folder.glob("*.npy")):
        facets, side_px = file.stem.split("_")
        scene, state = build(Case(name="gpu", facets=facets, frame_px=int(side_px), body_px=0.5 * int(side_px),
                                  phase_deg=60.0))
        with Renderer(scene) as renderer:
            own = renderer.render(state, samples=2).irradiance_W_m2.astype(float)
        there, lit = np.load(file).astype(float), own > 0.0
        rows.append({"facets": facets, "side_px": int(side_px), "beside": renderer.info["gl_renderer"],
                     "rms": float(np.sqrt(np.mean((there - own)[lit] ** 2)) / own[lit].mean()),
                     "flux": float(there.sum() / own.sum() - 1.0)})
    return rows


def served(side_px: int) -> dict:
    """Frames of 8-bit digital numbers a second that a server of one process answers."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "scene.toml").write_text(_SERVER_SCENE.format(side=side_px, focal=5.0 * side_px), encoding="utf-8")
        endpoint = f"ipc://{folder}/glrender"
        server = subprocess.Popen([sys.executable, "-m", "glrender_server", str(Path(folder, "scene.toml")), "--zmq",
                                   endpoint], env=dict(os.environ))
        try:
            with Client(endpoint, timeout_s=60.0) as client:
                state = {"r_sun_inertial_m": [1.2e11, 0.0, -0.7e11],
                         "spacecraft": {"r_inertial_m": [0.0, 0.0, -6000.0]},
                         "bodies": {"body": {"r_inertial_m": [0.0, 0.0, 0.0]}}}
                return {"side_px": side_px, "served_per_s": rate(lambda: client.render(state, output="dn", seed=1))}
        finally:
            server.terminate()
            server.wait(timeout=20)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/gpu.json"))
    parser.add_argument("--anyway", action="store_true", help="without a GPU too: to try the script")
    parser.add_argument("--facets", nargs="+", default=["49k", "786k", "3146k"])
    parser.add_argument("--compare", type=Path, metavar="FOLDER", help="draw its images here, and print the difference")
    arguments = parser.parse_args()
    if arguments.compare:
        sys.stdout.write("".join(json.dumps(row) + "\n" for row in compare(arguments.compare)))
        return
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    rows = []
    for facets in arguments.facets:
        for side_px in SIDES_PX:
            rows.append(irradiance(facets, side_px, arguments.out.parent))
            sys.stdout.write(json.dumps(rows[-1]) + "\n")
            if "llvmpipe" in rows[-1]["gl_renderer"] and not arguments.anyway:
                sys.exit(f"no GPU here: OpenGL is {rows[-1]['gl_renderer']}")
    rows += [served(side_px) for side_px in SIDES_PX]
    sys.stdout.write(json.dumps(rows[-2:]) + "\n")
    arguments.out.write_text(json.dumps(rows, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
