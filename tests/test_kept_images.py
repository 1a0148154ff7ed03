"""Rays at large shapes that are small in the image, cast at nodes: as exact as anew, whatever came before."""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np
import pytest
import views
from glrender import Pose, Renderer, frames, kept_images, kept_nodes
from glrender.brdf import Hapke, Lambert
from glrender.costs import EngineCosts
from glrender.grouping import region
from glrender.ray_engine import RayEngine
from glrender.view import view_bodies

GREY = Lambert(normal_albedo=0.3)
ROUGH_LAW = Hapke(single_scattering_albedo=0.1, b=0.3, c=0.5, shoe_amplitude=1.0, shoe_width=0.05, roughness_deg=20.0)
RAYS = EngineCosts(facet_ns=1e4, sample_ns=1e4, ray_ns=1.0, lone_ray_ns=1.0, area_ns=math.inf)


class Frames:
    """A rough body of 82,000 facets as a large one, some 24 px across: its frames by rays; how often any were cast."""

    def __init__(self, monkeypatch, law=GREY, bodies=(), camera=None, **scene):
        monkeypatch.setattr(kept_images, "FEWEST_KEPT", 10_000)
        # Nothing is looked for in spare time: it is counted.
        monkeypatch.setattr(kept_nodes, "_MOST_AHEAD", 0)
        self.camera = camera or views.camera(96, 500.0)
        self.scene = views.scene([replace(views.rough_body(GREY), brdf=law), *bodies], [self.camera], **scene)
        self.renderer = Renderer(self.scene)
        monkeypatch.setattr(self.renderer, "_costs", RAYS)
        self.rays = RayEngine(self.scene)
        self.n_cast, irradiance = 0, RayEngine.irradiance

        def counted(*given):
            self.n_cast += 1
            return irradiance(*given)

        monkeypatch.setattr(RayEngine, "irradiance", counted)

    def __call__(self, phase_deg=60.0, budget=0.02, state=None, apart_px=0.0, **given):
        state = state or views.state(phase_deg=phase_deg, **{"range_m": 4000.0} | given)
        image = self.renderer.render(state, max_error=budget, apart_px=apart_px)
        assert {window.engine for window in image.plan.windows} == {"rays"}
        return image

    def truth(self, state, samples=40):
        """Rays of the frame's own camera, none of them kept."""
        seen = view_bodies(state, self.camera, self.scene.hulls)
        x0, y0, x1, y1 = region(seen, self.camera)
        x, y = (low - 0.5 + (np.arange((high - low) * samples) + 0.5) / samples for low, high in ((x0, x1), (y0, y1)))
        count = np.arange(samples)
        draw = np.tile(count[:, None] * samples + count, (y1 - y0, x1 - x0)).ravel()
        light = self.rays.irradiance(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2), self.camera, seen, draw)
        whole = np.zeros((self.camera.height_px, self.camera.width_px))
        whole[y0:y1, x0:x1] = light.reshape(y1 - y0, samples, x1 - x0, samples).mean(axis=(1, 3))
        return whole


@pytest.fixture
def made(monkeypatch):
    kept = []

    def make(**given):
        kept.append(Frames(monkeypatch, **given))
        return kept[-1]

    yield make
    for each in kept:
        each.renderer.close()


def test_what_is_kept_serves_frames_nearby_and_none_depends_on_those_before(made):
    drawn = made(sun_disc=False)
    first = drawn(50.0).irradiance_W_m2
    n_cast = drawn.n_cast
    near = drawn(50.001, target=(3.0, 0.0, 7.0)).irradiance_W_m2
    assert drawn.n_cast == n_cast, "the same samples, elsewhere in the image"
    assert near.sum() == pytest.approx(first.sum(), rel=2e-3) and near.tobytes() != first.tobytes()
    assert drawn(50.2).irradiance_W_m2.tobytes() != first.tobytes() and drawn.n_cast == 2 * n_cast
    assert drawn(50.0).irradiance_W_m2.tobytes() == first.tobytes() and drawn.n_cast == 2 * n_cast
    drawn.renderer.forget_shadow_maps()
    assert drawn(50.001, target=(3.0, 0.0, 7.0)).irradiance_W_m2.tobytes() == near.tobytes()
    assert drawn(50.0).irradiance_W_m2.tobytes() == first.tobytes() and drawn.n_cast == 3 * n_cast


@pytest.mark.parametrize("has_disc", [False, True], ids=["point", "disc"])
@pytest.mark.parametrize("law", [GREY, ROUGH_LAW], ids=["grey", "Hapke"])
@pytest.mark.parametrize("budget", [0.1, 0.05, 0.02, 0.01])
def test_errors_are_within_what_is_told(made, law, has_disc, budget):
    """Beside many rays of the camera's own, which is turned about its boresight, and looks past the body."""
    drawn = made(law=law, sun_disc=has_disc)
    rng = np.random.default_rng(5)
    for phase_deg, range_m in ((20.0041, 3000.0), (60.0, 4000.3), (89.9963, 7000.0), (120.0037, 4000.0)):
        state = views.state(phase_deg=phase_deg, range_m=range_m, direction=tuple(rng.normal(size=3)))
        place_m = state.spacecraft.r_inertial_m
        q = frames.look_at(place_m, rng.uniform(-150.0, 150.0, 3), up=rng.normal(size=3))
        state = replace(state, spacecraft=Pose(r_inertial_m=place_m, q_from_inertial=q))
        image, truth = drawn(budget=budget, state=state), drawn.truth(state)
        told = image.plan.predicted_error
        assert views.relative_rms(image.irradiance_W_m2, truth) < min(told, budget), phase_deg
        assert image.irradiance_W_m2.sum() == pytest.approx(truth.sum(), rel=0.1 * budget), phase_deg
        centre = views.centroid_px(image.irradiance_W_m2) - views.centroid_px(truth)
        assert np.abs(centre).max() < 1.5 * budget, phase_deg


def test_the_node_s_own_error_is_told(made):
    drawn = made(sun_disc=False)
    for phase_deg in np.linspace(100.0, 100.03, 7):
        image = drawn(phase_deg, 0.01)
        truth = drawn.truth(views.state(phase_deg=phase_deg, range_m=4000.0))
        assert image.plan.predicted_error > 2e-3
        assert views.relative_rms(image.irradiance_W_m2, truth) < image.plan.predicted_error


def test_the_suns_and_the_bodys_distance_are_those_of_the_frame(made):
    drawn = made(sun_disc=False)
    near = views.state(phase_deg=60.0, range_m=4000.0)
    image = drawn(state=near).irradiance_W_m2
    n_cast = drawn.n_cast
    farther = drawn(state=replace(near, r_sun_inertial_m=1.0001 * near.r_sun_inertial_m)).irradiance_W_m2
    assert farther.sum() == pytest.approx(image.sum() / 1.0001**2, rel=1e-6)
    smaller = drawn(range_m=4002.0).irradiance_W_m2
    assert smaller.sum() == pytest.approx(image.sum() * (4000.0 / 4002.0) ** 2, rel=3e-4)
    assert drawn.n_cast == n_cast


def test_a_camera_that_looks_past_the_body_has_its_pixels_solid_angles(made):
    """At 15 degrees off the boresight they are 10 % smaller, and the body is stretched."""
    drawn = made(camera=views.camera(512, 800.0), sun_disc=False)
    state = views.state(phase_deg=60.0, range_m=6000.0)
    place_m = state.spacecraft.r_inertial_m
    across = np.cross(place_m, [0.0, 0.0, 1.0])
    for tangent in (0.0, 0.27):
        q = frames.look_at(place_m, tangent * across)
        aside = replace(state, spacecraft=Pose(r_inertial_m=place_m, q_from_inertial=q))
        image, truth = drawn(state=aside), drawn.truth(aside)
        assert views.relative_rms(image.irradiance_W_m2, truth) < 0.02
        assert image.irradiance_W_m2.sum() == pytest.approx(truth.sum(), rel=5e-4), tangent
        assert np.abs(views.centroid_px(image.irradiance_W_m2) - views.centroid_px(truth)).max() < 0.015


def test_a_body_s_own_grid_is_kept_as_well(made):
    """As a detector's frame has it: points at their own places."""
    drawn = made(sun_disc=False)
    state = views.state(phase_deg=60.0, range_m=6000.0)
    small, = drawn(state=state, apart_px=24.0).small_bodies
    n_cast, truth = drawn.n_cast, drawn.truth(state)
    assert small.irradiance_W_m2 == pytest.approx(truth.sum(), rel=2e-3)
    assert small.xy_px == pytest.approx(views.centroid_px(truth), abs=0.01)
    n_cast = drawn.n_cast
    again, = drawn(60.0005, range_m=6000.5, apart_px=24.0).small_bodies
    assert drawn.n_cast == n_cast and again.xy_px == pytest.approx(small.xy_px, abs=0.01)


def test_what_cannot_be_kept_is_cast_as_ever(made):
    """Near full phase, off the frame, close, large in the image, tight budgets, and with another body."""
    drawn = made(sun_disc=False)
    for given in ({"phase_deg": 1.0}, {"target": (0.0, 0.0, 400.0)}, {"range_m": 1300.0}, {"budget": 0.003}):
        drawn(**given)
        n_cast = drawn.n_cast
        drawn(**given)
        assert drawn.n_cast == 2 * n_cast, given
        drawn.n_cast = 0
    moon = made(bodies=[views.sphere(GREY, subdivisions=2, radius_m=5.0, name="moon")], sun_disc=False)
    state = views.state(phase_deg=60.0, range_m=4000.0, bodies=("body", "moon"))
    state = replace(state, bodies=state.bodies | {"moon": Pose(r_inertial_m=np.array([0.0, 0.0, 250.0]))})
    moon(state=state)
    n_cast = moon.n_cast
    moon(state=state)
    assert moon.n_cast == 2 * n_cast


def test_the_next_node_is_found_in_spare_time_with_the_same_bytes(made, monkeypatch):
    drawn = made(sun_disc=False)
    monkeypatch.setattr(kept_nodes, "_MOST_AHEAD", 64)
    step_deg = 1.5 / 4096 * 57.3
    images = []
    for n in range(7):
        before = drawn.n_cast
        images.append(drawn(60.0 + n * step_deg).irradiance_W_m2.tobytes())
        during = drawn.n_cast - before
        time.sleep(0.5)
    assert during == 0, "the last frame found its node"
    drawn.renderer.forget_shadow_maps()
    assert images == [drawn(60.0 + n * step_deg).irradiance_W_m2.tobytes() for n in range(7)]
