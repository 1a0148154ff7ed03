"""From a client's request to a camera-modelled uint8 frame, through a server in its own process.

The reach: Itokawa (49k facets), 1024 x 1024, Hapke, one sample, 60 ms or less. Prints one JSON line;
`make bench` keeps it as service.json.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from bench_frame import scene_and_state
from glrender_client import Client

N_FRAMES, N_WARM_UP = 60, 5
SCENE = """
max_error = 1.0
[[bodies]]
name = "body"
shape = "body.obj"
length_unit = "m"
brdf = {{ law = "hapke", single_scattering_albedo = 0.42, b = 0.35, c = 1.0, shoe_amplitude = 0.87, \
shoe_width = 0.01, roughness_deg = 26.0 }}
[[cameras]]
name = "navcam"
width_px = 1024
height_px = 1024
focal_length_px = {focal_length_px}
[cameras.model]
exposure_s = "auto"
optics = {{ aperture_diameter_m = 0.003, psf_sigma_px = 0.7 }}
detector = {{ quantum_efficiency = 0.5, full_well_electrons = 30000.0, gain_DN_per_electron = 0.008, bit_depth = 8, \
offset_DN = 5.0, read_noise_electrons = 40.0, dark_current_electrons_per_s = 100.0, \
photo_response_nonuniformity = 0.01 }}
"""


def main() -> None:
    scene, state = scene_and_state("49k", "hapke", 1024)
    record = {"benchmark": "service", "image_px": [1024, 1024], "facets": len(scene.bodies[0].shape.facets)}
    with tempfile.TemporaryDirectory() as folder:
        scene.bodies[0].shape.to_file(Path(folder) / "body.obj")
        file = Path(folder) / "scene.toml"
        file.write_text(SCENE.format(focal_length_px=scene.cameras[0].focal_length_px))
        process = subprocess.Popen([sys.executable, "-m", "glrender_server", str(file), "--zmq", "tcp://127.0.0.1:*"],
                                   stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        try:
            endpoint = process.stdout.readline().split()[3]
            with Client(endpoint, timeout_s=60.0) as client:
                record["gl_renderer"] = client.hello()["gl_renderer"]
                table = state.to_dict()
                for case in ("fresh", "reused"):
                    milliseconds, stages = [], []
                    for k in range(N_FRAMES + N_WARM_UP):
                        if case == "fresh":
                            # The body turns by half a degree a frame: every shadow map is new.
                            half = 0.5 * np.radians(0.5 * k)
                            table["bodies"]["body"]["q_from_inertial"] = [np.cos(half), 0.0, 0.0, np.sin(half)]
                        began = time.perf_counter()
                        reply = client.render(table, camera="navcam", output="dn", samples=1, seed=k)
                        milliseconds.append(1e3 * (time.perf_counter() - began))
                        stages.append(reply.header["timings_ms"])
                    assert reply.pixels.dtype == np.uint8
                    kept = np.array(milliseconds[N_WARM_UP:])
                    names = stages[-1].keys()
                    split = {name: float(np.median([s.get(name, 0.0) for s in stages[N_WARM_UP:]])) for name in names}
                    split["transport"] = float(np.median(kept - [s["total"] for s in stages[N_WARM_UP:]]))
                    record[case] = {**{f"p{q}": float(np.percentile(kept, q)) for q in (50, 95, 99)},
                                    "max": float(kept.max()), "stages_ms": split}
        finally:
            process.terminate()
            process.wait(timeout=20.0)
    sys.stdout.write(json.dumps(record) + "\n")


if __name__ == "__main__":
    main()
