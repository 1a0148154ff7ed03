"""Frames a second on a GPU, and its images beside llvmpipe's: `python benchmarks/gpu.py`; see gpu.sh.

Irradiance by OpenGL and by the planner's choice for shapes of 49,152, 786,432 and 3.1 million facets, and frames of
8-bit digital numbers that a server answers. Without a GPU it says so and fails.
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
model = {{ preset = "generic_navigation_camera", exposure_s = 0.01 }}
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


def irradiance(facets: str, side_px: int) -> dict:
    """Frames a second of one scene, and the RMS difference of its image from llvmpipe's [1]."""
    scene, state = build(Case(name="gpu", facets=facets, frame_px=side_px, body_px=0.5 * side_px, phase_deg=60.0))
    states = [replace(state, t_s=float(k)) for k in range(2)]
    with Renderer(scene) as renderer:
        info, image = renderer.info, renderer.render(state, samples=2).irradiance_W_m2.astype(float)
        row = {"facets": facets, "side_px": side_px, "gl_renderer": info["gl_renderer"],
               "raster_per_s": rate(lambda: renderer.render(states[0], engine="raster")),
               "planned_per_s": rate(lambda: renderer.render(states[1]))}
    code = ("import sys, numpy as np; sys.path.insert(0, 'benchmarks'); from gpu import save_image; "
            f"save_image({facets!r}, {side_px}, sys.argv[1])")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "llvmpipe.npy")
        made = subprocess.run([sys.executable, "-c", code, str(file)], check=False, capture_output=True, text=True,
                              env={**os.environ, "LIBGL_ALWAYS_SOFTWARE": "1",
                                   "__EGL_VENDOR_LIBRARY_FILENAMES": "/usr/share/glvnd/egl_vendor.d/50_mesa.json"})
        if made.returncode == 0:
            other = np.load(file).astype(float)
            lit = other > 0.0
            row["rms_beside_llvmpipe"] = float(np.sqrt(np.mean((image - other)[lit] ** 2)) / other[lit].mean())
        else:
            row["llvmpipe"] = made.stderr.strip().splitlines()[-1:]
    return row


def save_image(facets: str, side_px: int, file: str) -> None:
    """Draw the same image in another process, by the OpenGL that its environment names."""
    scene, state = build(Case(name="gpu", facets=facets, frame_px=side_px, body_px=0.5 * side_px, phase_deg=60.0))
    with Renderer(scene) as renderer:
        np.save(file, renderer.render(state, samples=2).irradiance_W_m2)


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
    arguments = parser.parse_args()
    rows = []
    for facets in arguments.facets:
        for side_px in SIDES_PX:
            rows.append(irradiance(facets, side_px))
            sys.stdout.write(json.dumps(rows[-1]) + "\n")
            if "llvmpipe" in rows[-1]["gl_renderer"] and not arguments.anyway:
                sys.exit(f"no GPU here: OpenGL is {rows[-1]['gl_renderer']}")
    rows += [served(side_px) for side_px in SIDES_PX]
    sys.stdout.write(json.dumps(rows[-2:]) + "\n")
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(json.dumps(rows, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
