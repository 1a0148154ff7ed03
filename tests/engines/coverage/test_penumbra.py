"""The Sun's disc: penumbras in rays, against closed forms; the planner's word on what hard edges cost."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import solids
import sweeps
import views
from cells import slow_but
from glrender import Body, ConfigError, Pose, Renderer, Scene, State, frames
from glrender.base.constants import AU_M, SUN_RADIUS_M
from glrender.brdf import Lambert
from glrender.engines.rays.backend import RayTracer
from glrender.planner.penumbra import penumbra_of
from glrender.view.view import view_bodies

WHITE = Lambert(normal_albedo=1.0)


def below_a_wall(height_m, sun_distance_au=1.0):
    """A slab hangs above another, the Sun overhead; a camera sees the edge of its shadow from aside."""
    ground = Body(name="ground", shape=solids.slab(100.0), brdf=WHITE)
    roof = Body(name="roof", shape=solids.slab(40.0), brdf=WHITE)
    scene = views.scene([ground, roof], [views.camera(400, 400 / 20.0 * 1e6)])
    # Seen from aside, so that the roof is not in the way; 20 m around the edge of its shadow at x = 40 m.
    away = np.array([0.6, 0.0, 0.8]) * 1e6 + np.array([40.0, 0.0, 0.0])
    state = State(r_sun_inertial_m=np.array([0.0, 0.0, sun_distance_au * AU_M]),
                  spacecraft=Pose(r_inertial_m=away, q_from_inertial=frames.look_at(away, np.array([40.0, 0.0, 0.0]))),
                  bodies={"ground": Pose(r_inertial_m=np.zeros(3)),
                          "roof": Pose(r_inertial_m=np.array([0.0, 0.0, height_m]))})
    return scene, state


def visible_share(x_over_radius):
    """Share of a disc on one side of a straight edge at x radii from its middle: the area of a segment."""
    x = np.clip(x_over_radius, -1.0, 1.0)
    return (np.arccos(-x) + x * np.sqrt(1.0 - x**2)) / np.pi


@pytest.mark.parametrize("height_m, distance_au", slow_but([(500.0, 1.0), (1500.0, 1.0), (1500.0, 3.0)], 1))
def test_a_straight_edges_penumbra(height_m, distance_au):
    """Light across the edge is the share of the Sun's disc that shows: SUN_RADIUS / distance * height wide each way."""
    scene, state = below_a_wall(height_m, distance_au)
    with RayTracer(scene) as tracer:
        image = tracer.render(state, samples=6, products=["r_body", "body_id"])
    seen = image.products["body_id"] == 0
    x = image.products["r_body"][..., 0][seen]
    half = SUN_RADIUS_M / (distance_au * AU_M) * height_m
    light = image.irradiance_W_m2[seen] / image.irradiance_W_m2[seen].max()
    bins = np.linspace(40.0 - 1.5 * half, 40.0 + 1.5 * half, 13)
    which = np.digitize(x, bins)
    for index in range(1, len(bins)):
        here = which == index
        assert here.sum() > 100
        np.testing.assert_allclose(light[here].mean(), visible_share((x[here] - 40.0) / half).mean(), atol=0.02)


def test_a_point_sun_on_request():
    scene, state = below_a_wall(1500.0)
    point = Scene(bodies=scene.bodies, cameras=scene.cameras, sun_disc=False)
    with RayTracer(point) as tracer:
        light = tracer.render(state, samples=1).irradiance_W_m2
    lit = light > 0.5 * light.max()
    assert np.count_nonzero((light > 0.01 * light.max()) & ~lit) == 0
    with pytest.raises(ConfigError, match="sun_disc"):
        Scene(bodies=scene.bodies, cameras=scene.cameras, sun_disc="yes")


def eclipsed(sunward_m):
    """A moon so far sunward of a planet."""
    moon, planet = views.sphere(WHITE, 4, 30.0, "moon"), views.sphere(WHITE, 5, 100.0, "planet")
    base = views.state(phase_deg=30.0, range_m=2000.0, bodies=("moon", "planet"))
    sun = base.r_sun_inertial_m / np.linalg.norm(base.r_sun_inertial_m)
    state = replace(base, bodies={"planet": base.bodies["planet"], "moon": Pose(r_inertial_m=sunward_m * sun)})
    return views.scene([moon, planet], [views.camera(160, 1200.0)]), state


def test_an_eclipse_is_drawn_with_its_penumbra():
    """A moon far sunward: hard edges would cost more than the budget, and OpenGL's plan says so."""
    scene, state = eclipsed(3000.0)
    with Renderer(scene) as renderer, RayTracer(scene) as tracer:
        exact = tracer.render(state, samples=16).irradiance_W_m2.astype(float)
        image = renderer.render(state, max_error=0.02, products=["sunlit", "body_id"])
        fixed = renderer.render(state, samples=8)
    assert "raster" not in [window.engine for window in image.plan.windows if "planet" in window.bodies]
    dark = exact < 1e-6 * exact.max()
    umbra = (image.products["body_id"] == 1) & dark
    assert umbra.sum() > 100 and not image.products["sunlit"][umbra].any(), "products have their shadows all the same"
    errors = [views.relative_rms(drawn.irradiance_W_m2.astype(float), exact) for drawn in (image, fixed)]
    assert errors[0] < image.plan.predicted_error <= 0.02 < errors[1]
    assert errors[1] < fixed.plan.predicted_error, "what hard edges cost is in the prediction"
    assert any("disc" in line for line in fixed.plan.left_out)


def test_a_narrow_penumbra_of_an_eclipse_is_drawn_with_hard_edges():
    """A moon 1.5 radii sunward, by coverage: they cost less than the budget."""
    scene, state = eclipsed(150.0)
    with Renderer(scene) as renderer, RayTracer(scene) as tracer:
        exact = tracer.render(state, samples=12).irradiance_W_m2.astype(float)
        image = renderer.render(state, max_error=0.02)
    assert {window.engine for window in image.plan.windows} == {"coverage"}
    assert views.relative_rms(image.irradiance_W_m2.astype(float), exact) < image.plan.predicted_error <= 0.02


@pytest.mark.slow
@pytest.mark.parametrize("phase_deg", [60.0, 120.0])
def test_hard_edges_cost_less_than_predicted(phase_deg):
    """Of a body on itself: rays with a disc against rays without."""
    scene = views.scene([sweeps.binary(6)], [views.camera(400, 4000.0)])
    state = views.state(phase_deg=phase_deg)
    point = Scene(bodies=scene.bodies, cameras=scene.cameras, sun_disc=False, solar_irradiance_1au_W_m2=1000.0)
    images = []
    for each in (scene, point):
        with RayTracer(each) as tracer:
            images.append(tracer.render(state, samples=6).irradiance_W_m2.astype(float))
    disc, hard = images
    lit = disc > 0.0
    error = np.sqrt(np.mean((hard - disc)[lit] ** 2)) / disc[lit].mean()
    view = view_bodies(state, scene.cameras[0], {"body": scene.bodies[0].hull})[0]
    assert 1e-4 < error < penumbra_of(view, (), scene.hulls, view.sun_radius_rad).hard_error
    np.testing.assert_allclose(hard.sum(), disc.sum(), rtol=1e-3)


@pytest.mark.parametrize("phase_deg", slow_but([45.0, 95.0, 120.0], 1))
def test_coverage_tells_what_hard_edges_cost(phase_deg):
    """A rough binary at 1 %: by coverage, within the budget of rays with the disc."""
    scene = views.scene([sweeps.binary(6)], [views.camera(240, 2000.0)])
    state = views.state(phase_deg=phase_deg)
    with Renderer(scene) as renderer, RayTracer(scene) as tracer:
        image, tight = (renderer.render(state, max_error=budget) for budget in (0.01, 0.0007))
        exact = tracer.render(state, samples=16).irradiance_W_m2.astype(float)
    assert [window.engine for window in image.plan.windows] == ["coverage"]
    window, = tight.plan.windows
    assert window.engine == "coverage" and window.refined_share > 0.0, "hard edges cost more than that"
    assert views.relative_rms(image.irradiance_W_m2.astype(float), exact) < image.plan.predicted_error <= 0.01
    np.testing.assert_allclose(image.irradiance_W_m2.sum(), exact.sum(), rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("phase_deg", [100.0, 140.0])
def test_a_small_body_s_penumbras_cost_nothing(phase_deg):
    """Far narrower than a pixel they have a hard edge's light: one image, lit by the Sun's middle, does."""
    scene = views.scene([sweeps.binary(6)], [views.camera(40, 200.0)])
    state = views.state(phase_deg=phase_deg)
    with Renderer(scene) as renderer, RayTracer(scene) as tracer:
        image = renderer.render(state, max_error=0.01)
        exact = tracer.render(state, samples=120).irradiance_W_m2.astype(float)
    assert [window.engine for window in image.plan.windows] == ["coverage"]
    assert views.relative_rms(image.irradiance_W_m2.astype(float), exact) < image.plan.predicted_error <= 0.01
    np.testing.assert_allclose(image.irradiance_W_m2.sum(), exact.sum(), rtol=1e-3)


@pytest.mark.parametrize("max_error", [0.05, 0.02, 0.01])
def test_hard_edges_are_not_drawn_where_they_move_the_flux(max_error):
    """A sphere below a pixel of which a moon far sunward leaves a rim: half of the ramp falls beside the body."""
    bodies, state, exact, hard = _rim()
    assert abs(hard / exact - 1.0) > 0.05
    scene = views.scene(bodies, [views.camera(64, 4500.0)])
    with Renderer(scene) as renderer:
        image = renderer.render(state, max_error=max_error)
    planet_px = image.irradiance_W_m2[28:37, 28:37].sum(dtype=float)
    window = next(window for window in image.plan.windows if "planet" in window.bodies)
    assert abs(planet_px / exact - 1.0) < max(0.1 * max_error, 0.005), window


@cache
def _rim():
    """Both bodies, their state, and the planet's flux with the Sun's disc and with its middle alone."""
    bodies = [views.sphere(WHITE, 4, 128.0, "moon"), views.sphere(WHITE, 5, 100.0, "planet")]
    base = views.state(phase_deg=110.0, range_m=1e6, bodies=("moon", "planet"))
    sun = base.r_sun_inertial_m / np.linalg.norm(base.r_sun_inertial_m)
    aside = base.spacecraft.r_inertial_m - (base.spacecraft.r_inertial_m @ sun) * sun
    place = 3000.0 * sun + 140.0 * aside / np.linalg.norm(aside)
    state = replace(base, bodies={"planet": base.bodies["planet"], "moon": Pose(r_inertial_m=place)})
    return bodies, state, *(_flux(bodies, state, sun_disc) for sun_disc in (True, False))


def _flux(bodies, state, sun_disc):
    """Of the planet alone, 270 px across: the moon is beside the image."""
    scene = views.scene(bodies, [views.camera(400, 1.35e6)], sun_disc=sun_disc)
    with RayTracer(scene) as tracer:
        return float(tracer.render(state, samples=8).irradiance_W_m2.sum(dtype=float))


@pytest.mark.parametrize("across_m, max_error", slow_but([(10.0, 0.05), (10.0, 0.02), (20.0, 0.05)], 1))
def test_close_to_a_shadow_s_edge_hard_edges_cost_what_the_image_shows(across_m, max_error):
    """A moon of 3 m over a planet of 100 m, of which the image shows that shadow alone: 2 % of the whole body."""
    moon, planet = views.sphere(WHITE, 3, 3.0, "moon"), views.sphere(WHITE, 6, 100.0, "planet")
    base = views.state(phase_deg=40.0, range_m=2000.0, bodies=("moon", "planet"))
    sun = base.r_sun_inertial_m / np.linalg.norm(base.r_sun_inertial_m)
    camera, camera_m = views.camera(200, 200 / across_m * 1900.0), base.spacecraft.r_inertial_m
    state = replace(base, spacecraft=replace(base.spacecraft, q_from_inertial=frames.look_at(camera_m, 100.0 * sun)),
                    bodies={"planet": base.bodies["planet"], "moon": Pose(r_inertial_m=300.0 * sun)})
    with Renderer(views.scene([moon, planet], [camera])) as renderer:
        image = renderer.render(state, max_error=max_error)
    exact, hard = (_close(moon, planet, camera, state, sun_disc) for sun_disc in (True, False))
    assert views.relative_rms(hard, exact) > 0.05
    assert views.relative_rms(image.irradiance_W_m2.astype(float), exact) < image.plan.predicted_error <= max_error


def _close(moon, planet, camera, state, sun_disc):
    with RayTracer(views.scene([moon, planet], [camera], sun_disc=sun_disc)) as tracer:
        return tracer.render(state, samples=10).irradiance_W_m2.astype(float)


def mean_of_the_disc(u):
    """Mean of max(0, u + t) over a disc of radius 1, t along one axis: closed form, by the areas of its segments."""
    root = np.sqrt(max(1.0 - u * u, 0.0))
    return u * ((u * root + np.arcsin(u)) / np.pi + 0.5) + 2.0 / (3.0 * np.pi) * root**3


def on_the_terminator(u):
    """A plane seen from above, at which the Sun's middle stands u of its radius above the horizon; its light [W/m2]."""
    range_m, side_m, height = 1e5, 200.0, u * SUN_RADIUS_M / AU_M
    scene = views.scene([Body(name="body", shape=solids.slab(0.5 * side_m), brdf=WHITE)],
                        [views.camera(64, 50.0 / side_m * range_m)])
    place = np.array([0.0, 0.0, range_m])
    state = State(r_sun_inertial_m=AU_M * np.array([np.sqrt(1.0 - height**2), 0.0, height]),
                  spacecraft=Pose(r_inertial_m=place, q_from_inertial=frames.look_at(
                      place, np.zeros(3), np.array([0.0, 1.0, 0.0]))),
                  bodies={"body": Pose(r_inertial_m=np.zeros(3))})
    return scene, state, (views.SOLAR_IRRADIANCE_W_M2 / np.pi * SUN_RADIUS_M / AU_M * mean_of_the_disc(u)
                          * (side_m / range_m) ** 2)


@pytest.mark.parametrize("u", [-0.5, 0.0, 0.5, 1.0])
def test_rays_light_a_plane_on_the_terminator_by_the_sun_s_disc(u):
    """Also where its middle has set."""
    scene, state, expected = on_the_terminator(u)
    with RayTracer(scene) as tracer:
        light = tracer.render(state, samples=12).irradiance_W_m2.sum(dtype=float)
    assert light == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("engine", ["rays", None])
@pytest.mark.parametrize("u", [0.0, 0.5, 1.0])
def test_a_frame_of_a_plane_on_the_terminator_has_its_flux(u, engine):
    """By rays, and by the planner's choice: coverage, or rays where the disc's lower half matters."""
    scene, state, expected = on_the_terminator(u)
    with Renderer(scene) as renderer:
        image = renderer.render(state, max_error=0.01, engine=engine)
    assert image.irradiance_W_m2.sum(dtype=float) == pytest.approx(expected, rel=1e-3), image.plan.windows
