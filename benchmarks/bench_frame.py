"""Frames per second by shape size, image size and law, split into the stages of a frame.

Run by `make bench`: `pytest benchmarks/bench_frame.py --benchmark-json=...`, then `chart.py`.
The scene is peers.md's: phase 60 degrees, the body's outline about half the frame's width.
Each case is timed fresh (a new shadow map each frame) and reused, and beside Embree rays of the
same region in the same run: these machines are noisy, so read ratios.
"""

from __future__ import annotations

import sys
import time
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from glrender import Body, PinholeCamera, Pose, Renderer, Scene, Shape, State, frames, generate
from glrender.base.constants import AU_M
from glrender.brdf import Hapke, Lambert, LunarLambert

sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "support"))
from raytracer import Tracer

ITOKAWA = Path(__file__).parents[1] / "tests" / "data" / "itokawa" / "itokawa_64q_49152_uv.obj"
LAWS = {
    "lambert": Lambert(normal_albedo=0.3),
    "lunar_lambert": LunarLambert(normal_albedo=0.3, weight="mcewen"),
    "hapke": Hapke(single_scattering_albedo=0.42, b=0.35, c=1.0, shoe_amplitude=0.87, shoe_width=0.01,
                   roughness_deg=26.0),
    "hapke_full": Hapke(single_scattering_albedo=0.42, b=0.3, c=0.4, shoe_amplitude=0.87, shoe_width=0.05,
                        cboe_amplitude=0.2, cboe_width=0.02, roughness_deg=26.0, filling_factor=0.3,
                        multiple_scattering="anisotropic"),
}
SIZES = {"5k": 4, "20k": 5, "49k": None, "197k": 1, "786k": 2, "3146k": 3}


@cache
def shape(size: str) -> Shape:
    """49k is Itokawa; the larger ones are it with seeded relief."""
    if size in ("5k", "20k"):
        return generate.contact_binary(radius_m=300.0, seed=1, subdivisions=SIZES[size])
    if size == "49k":
        return Shape.from_file(ITOKAWA, length_unit="km")
    return generate.subdivide_with_relief(shape("49k"), levels=SIZES[size], seed=1)


def scene_and_state(size: str, law: str, size_px: int) -> tuple[Scene, State]:
    body = Body(name="body", shape=shape(size), brdf=LAWS[law])
    direction = np.array([0.2, -0.95, 0.25]) / np.linalg.norm([0.2, -0.95, 0.25])
    range_m = 2000.0 * body.shape.radius_m / 300.0
    focal_length_px = 0.5 * size_px / (2.0 * body.shape.radius_m / range_m)
    camera = PinholeCamera(name="navcam", width_px=size_px, height_px=size_px, focal_length_px=focal_length_px)
    q = frames.look_at(range_m * direction, np.zeros(3))
    right = frames.dcm(q)[0]
    r_sun = AU_M * (np.cos(np.pi / 3) * direction + np.sin(np.pi / 3) * right)
    state = State(r_sun_inertial_m=r_sun, spacecraft=Pose(r_inertial_m=range_m * direction, q_from_inertial=q),
                  bodies={"body": Pose(r_inertial_m=np.zeros(3))})
    return Scene(bodies=[body], cameras=[camera]), state


def medians(timings: list[dict[str, float]]) -> dict[str, float]:
    return {name: float(np.median([timing[name] for timing in timings])) for name in timings[0]}


@pytest.mark.parametrize("is_reused", [False, True], ids=["fresh", "reused"])
@pytest.mark.parametrize("size, law, size_px", [
    *((size, "hapke", 1024) for size in SIZES),
    *(("49k", law, 1024) for law in LAWS if law != "hapke"),
    *(("49k", "hapke", size_px) for size_px in (512, 2048)),
])
@pytest.mark.parametrize("samples", [1, 2])
def test_frame(benchmark, size, law, size_px, samples, is_reused):
    scene, state = scene_and_state(size, law, size_px)
    timings = []
    with Renderer(scene) as renderer:

        def forget():
            if not is_reused:
                renderer.forget_shadow_maps()

        def frame():
            timings.append(renderer.render(state, samples=samples).timings_ms)

        frame()
        rounds = 5 if scene.bodies[0].shape.facets.shape[0] > 500_000 else 15
        benchmark.pedantic(frame, setup=forget, rounds=rounds, warmup_rounds=1)
        benchmark.extra_info.update(
            facets=len(scene.bodies[0].shape.facets), law=law, size_px=size_px, samples=samples,
            is_reused=is_reused, stages_ms=medians(timings[2:]), gl_renderer=renderer.info["gl_renderer"],
            shadow_map_px=renderer.render(state, samples=1).plan.bodies[0].shadow_map_px)


@pytest.mark.parametrize("size", ["49k", "786k"])
def test_embree(benchmark, size):
    """The peer: Embree rays of the same region, float64 shading, one sample a pixel."""
    scene, state = scene_and_state(size, "hapke", 1024)
    body, camera = scene.bodies[0], scene.cameras[0]
    with Renderer(scene) as renderer:
        x0, y0, x1, y1 = renderer.render(state, samples=1).roi
    region = PinholeCamera(name="region", width_px=x1 - x0, height_px=y1 - y0, focal_length_px=camera.focal_length_px,
                           principal_point_px=(camera.principal_point_px[0] - x0, camera.principal_point_px[1] - y0))
    began = time.perf_counter()
    tracer = Tracer([("body", body.shape.vertices_m, body.shape.facets, body.brdf)], region, state)
    build_ms = 1e3 * (time.perf_counter() - began)
    benchmark.pedantic(lambda: tracer.irradiance(scene.solar_irradiance_1au_W_m2, 1), rounds=5, warmup_rounds=1)
    benchmark.extra_info.update(facets=len(body.shape.facets), law="hapke", size_px=1024, samples=1,
                                build_ms=build_ms)
