"""Surface detail: what it costs, and how like Cycles' geometry OpenGL's shading is: one JSON line and a picture.

    python benchmarks/bench_detail.py ITOKAWA.obj [PICTURE.png]
"""

from __future__ import annotations

import json
import sys
import time

import cv2
import numpy as np
from glrender import (
    Body,
    Boulders,
    Craters,
    Detail,
    DeviceError,
    Noise,
    PinholeCamera,
    Pose,
    Renderer,
    Scene,
    State,
    frames,
)
from glrender.brdf import Hapke
from glrender.engines.cycles import Cycles

LAW = Hapke(single_scattering_albedo=0.42, b=0.35, c=1.0, roughness_deg=26.0)
DETAIL = Detail(seed=3, noise=Noise(amplitude_m=0.15, longest_m=6.0, shortest_m=0.1),
                craters=Craters(largest_m=6.0, smallest_m=0.75, coverage=0.05),
                boulders=Boulders(largest_m=4.0, smallest_m=0.25, coverage=0.06))
RANGE_M, SIZE_PX, FOCAL_PX, ROUNDS = 700.0, 512, 2500.0, 7


def main() -> None:
    direction = np.array([0.3, -0.8, 0.4]) / np.linalg.norm([0.3, -0.8, 0.4])
    camera = PinholeCamera(name="navcam", width_px=SIZE_PX, height_px=SIZE_PX, focal_length_px=FOCAL_PX)
    q = frames.look_at(RANGE_M * direction, np.zeros(3))
    aside = frames.dcm(q)[0]
    told, panels = {}, []
    for phase_deg in (30.0, 60.0, 80.0):
        phase = np.radians(phase_deg)
        state = State(r_sun_inertial_m=1.5e11 * (np.cos(phase) * direction + np.sin(phase) * aside),
                      spacecraft=Pose(r_inertial_m=RANGE_M * direction, q_from_inertial=q),
                      bodies={"itokawa": Pose(r_inertial_m=np.zeros(3))})
        row, images = {}, {}
        for name, detail in (("without", None), ("with", DETAIL)):
            body = Body.from_file(sys.argv[1], name="itokawa", length_unit="km", brdf=LAW, detail=detail)
            scene = Scene(bodies=[body], cameras=[camera])
            with Renderer(scene) as renderer:
                renderer.render(state, samples=2)
                times = []
                for _ in range(ROUNDS):
                    began = time.perf_counter()
                    image = renderer.render(state, samples=2)
                    times.append(1e3 * (time.perf_counter() - began))
                images[name] = image.irradiance_W_m2.astype(np.float64)
                row[f"{name}_ms"] = round(float(np.median(times)), 1)
        row["layers"] = image.plan.bodies[0].detail_layers
        row["slope"] = round(image.plan.bodies[0].detail_slope, 3)
        row["flux"] = round(images["with"].sum() / images["without"].sum() - 1.0, 4)
        if phase_deg == 60.0 or len(sys.argv) < 3:
            try:
                with Cycles(scene, bounces=0) as cycles:
                    began = time.perf_counter()
                    truth = cycles.render(state, samples=4).irradiance_W_m2.astype(np.float64)
            except DeviceError:
                truth = None
            if truth is not None:
                lit = truth > 0.0
                row |= {"cycles_s": round(time.perf_counter() - began, 1),
                        "correlation": round(float(np.corrcoef(images["with"][lit], truth[lit])[0, 1]), 4),
                        "flux_to_cycles": round(images["with"].sum() / truth.sum() - 1.0, 4)}
                panels = [images["without"], images["with"], truth]
        told[str(phase_deg)] = row
    print(json.dumps({"size_px": SIZE_PX, "samples": 2, "phase_deg": told}))
    if len(sys.argv) > 2 and panels:
        white = np.percentile(np.concatenate(panels), 99.7)
        cv2.imwrite(sys.argv[2], np.hstack([np.clip(255.0 * panel / white, 0.0, 255.0) for panel in panels]))


main()
