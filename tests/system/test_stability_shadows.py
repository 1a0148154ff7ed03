"""Where shadow maps fail: acne at low Sun, shadows that leave their boulder. benchmarks/RESULTS.md has the plots."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import sweeps
import views
from cells import slow_but
from glrender import Body, Pose, Renderer, Shape, State, frames, generate
from glrender.base.constants import AU_M
from glrender.brdf import Lambert
from glrender.engines.raster.gl.targets import ShadowMap
from glrender.engines.rays.backend import RayTracer


@pytest.mark.parametrize("size_px", [50.0, 200.0])
@pytest.mark.parametrize("phase_deg, share", slow_but(
    [(0.0, 5e-4), (30.0, 5e-4), (60.0, 5e-4), (90.0, 5e-4), (120.0, 5e-4), (150.0, 2e-3), (165.0, 1e-2), (175.0, 0.2)],
    0, 2, 5, 7))
def test_a_convex_body_casts_no_shadow_on_itself(phase_deg, size_px, share):
    """The goal is 0.05 % of the lit flux; from 150 deg on the low Sun costs what is stated here."""
    assert abs(sweeps.false_shadow(phase_deg, size_px, samples=4)) <= share


@pytest.mark.parametrize("phase_deg", slow_but([5.0, 30.0, 60.0, 90.0, 120.0, 150.0, 170.0, 175.0], 0, 2, 5, 7))
def test_a_shadow_stays_with_what_casts_it(phase_deg):
    """A pillar's shadow begins at its foot and ends where it must: its length within half a pixel."""
    assert abs(sweeps.pillar_shadow(phase_deg)) <= 0.5


def test_a_map_has_the_room_that_its_own_texels_ask_for(monkeypatch):
    """In one with more room, of frames before it, coordinates round otherwise: a pixel of a coma changed by 0.6 %."""
    asked, original = [], ShadowMap.texture_from_clip
    monkeypatch.setattr(ShadowMap, "texture_from_clip",
                        lambda self, size_px: asked.append((self.room_px, size_px)) or original(self, size_px))
    shape = generate.three_lobes(radius_m=100.0, subdivisions=4)
    body = Body(name="body", shape=shape, brdf=Lambert(normal_albedo=0.2))
    with Renderer(views.scene([body], [views.camera()])) as renderer:
        for budget in (0.01, 0.3):
            for phase_deg in range(40, 80, 4):
                renderer.render(views.state(phase_deg=float(phase_deg)), max_error=budget, engine="raster")
    rooms, sizes = zip(*asked, strict=True)
    assert len(set(rooms)) > 1
    assert [tuple(-(-side // 256) * 256 for side in size) for size in sizes] == list(rooms)


@pytest.mark.parametrize("aside, max_flux", [(0.3, 0.03), (1.0, 0.01)])
def test_the_shadow_of_a_far_body_falls_where_the_sun_casts_it(aside, max_flux):
    """From 30 radii away a map drawn for a Sun half a step beside the true one put it 0.06 radii off: flux -10 %."""
    bodies = [views.sphere(Lambert(normal_albedo=0.3), name=name) for name in ("near", "far")]
    scene = views.scene(bodies, [views.camera(128, 1000.0)], sun_disc=False)
    state = views.state(phase_deg=75.0, bodies=("near", "far"))
    to_sun = state.r_sun_inertial_m / np.linalg.norm(state.r_sun_inertial_m)
    across = np.cross(to_sun, [0.0, 0.0, 1.0])
    place = 3000.0 * to_sun + aside * 100.0 * across / np.linalg.norm(across)
    state = replace(state, bodies={"near": state.bodies["near"], "far": Pose(r_inertial_m=place)})
    with Renderer(scene) as renderer, RayTracer(scene) as tracer:
        light = renderer.render(state, samples=8, max_error=0.05).irradiance_W_m2.sum(dtype=float)
        truth = tracer.render(state, samples=8).irradiance_W_m2.sum(dtype=float)
    assert light == pytest.approx(truth, rel=max_flux)


def terrain(n=65):
    """A square of 100 m of open ground, hills of some 10 m: 8192 facets."""
    rng = np.random.default_rng(5)
    x, y = np.meshgrid(np.linspace(-50.0, 50.0, n), np.linspace(-50.0, 50.0, n))
    z = sum(rng.normal() * 14.0 / k * np.sin(k * (x * np.cos(a) + y * np.sin(a)) / 16.0 + p)
            for k in (1, 2, 3, 5, 8) for a, p in rng.uniform(0.0, 6.0, (3, 2)))
    corner = np.arange(n * n).reshape(n, n)
    a, b, c, d = (part.ravel() for part in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, :-1], corner[1:, 1:]))
    return Shape.from_arrays(np.stack([x, y, z], axis=-1).reshape(-1, 3),
                             np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)]))


@pytest.mark.parametrize("engine", ["raster", "coverage"])
@pytest.mark.parametrize("max_error", slow_but([0.05, 0.01], 1))
def test_open_ground_casts_its_shadow(engine, max_error):
    """The Sun sees backs of hills too: without them the flux was 23 % too large, and told as 1 %."""
    sun, place = np.array([0.9, 0.2, 0.38]), np.array([60.0, 20.0, 120.0])
    state = State(r_sun_inertial_m=AU_M * sun / np.linalg.norm(sun), bodies={"body": Pose(r_inertial_m=np.zeros(3))},
                  spacecraft=Pose(r_inertial_m=place, q_from_inertial=frames.look_at(place, np.zeros(3))))
    body = Body(name="body", shape=terrain(), brdf=Lambert(normal_albedo=0.3))
    with Renderer(views.scene([body], [views.camera(256, 240.0)])) as renderer:
        image = renderer.render(state, max_error=max_error, engine=engine)
        truth = renderer.render(state, max_error=0.003, engine="rays").irradiance_W_m2.astype(float)
    light = image.irradiance_W_m2.astype(float)
    assert views.relative_rms(light, truth) < 1.1 * image.plan.predicted_error
    assert light.sum() == pytest.approx(truth.sum(), rel=max(0.1 * max_error, 2e-3))
