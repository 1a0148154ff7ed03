"""The image depends on no inertial frame, and the camera may stand where bodies surround it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import sweeps
import views
from cells import slow_but
from glrender import Body, Pose, Renderer, State, frames
from glrender.engines.rays.backend import RayTracer


@pytest.mark.parametrize("seed", slow_but(range(4), 0))
@pytest.mark.parametrize("shift_m", [0.0, 3e11], ids=["at the body", "two au away"])
def test_the_inertial_frame_does_not_show(seed, shift_m):
    """The whole scene turned at random and shifted: a sample at an edge may change, the light may not.

    Float64 positions at 3e11 m are good to 3e-5 m, 3e-7 of the body.
    """
    rng = np.random.default_rng(seed)
    q = rng.standard_normal(4)
    state = views.state(phase_deg=70.0)
    body = Body(name="body", shape=views.binary(3, 5), brdf=sweeps.GREY)
    with Renderer(views.scene([body], [views.camera(128, 500.0)])) as renderer:
        here = renderer.render(state, max_error=0.02)
        there = renderer.render(sweeps.turned(state, q / np.linalg.norm(q), shift_m * rng.standard_normal(3)),
                                max_error=0.02)
    np.testing.assert_allclose(sweeps.flux(there), sweeps.flux(here), rtol=3e-4)
    difference = np.abs(there.irradiance_W_m2 - here.irradiance_W_m2)
    level = here.irradiance_W_m2[here.irradiance_W_m2 > 0].mean()
    assert np.sqrt(np.mean(difference[here.irradiance_W_m2 > 0] ** 2)) < 5e-3 * level
    np.testing.assert_allclose(views.centroid_px(there.irradiance_W_m2), views.centroid_px(here.irradiance_W_m2),
                               atol=2e-3)


def _beside_the_neck(phase_deg, **kwargs):
    """Half a radius from the middle of a contact binary, both lobes in a field of 90 deg."""
    shape = views.binary(2, 5)
    place = np.array([0.0, -70.0, 20.0])
    base = views.state(phase_deg=phase_deg, direction=place)
    spacecraft = Pose(r_inertial_m=place, q_from_inertial=frames.look_at(place, np.array([20.0, 0.0, -5.0])))
    scene = views.scene([Body(name="body", shape=shape, brdf=sweeps.GREY)], [views.camera(96, 48.0)], **kwargs)
    return scene, State(r_sun_inertial_m=base.r_sun_inertial_m, spacecraft=spacecraft, bodies=base.bodies)


@pytest.mark.parametrize("phase_deg", slow_but([10.0, 40.0, 70.0, 100.0], 0, 2))
def test_a_camera_inside_the_bounding_sphere(phase_deg):
    _agrees_with_rays(*_beside_the_neck(phase_deg, sun_disc=False))


def test_the_plan_tells_what_was_drawn_where_rays_took_over():
    """At 100 deg the first pass tells that no map is fine enough: neither maps nor hard edges are in the image."""
    scene, state = _beside_the_neck(100.0)
    scene = replace(scene, bodies=[replace(body, smooth_normals=True) for body in scene.bodies])
    with Renderer(scene) as renderer:
        plan = renderer.render(state, max_error=0.02).plan
        fixed = renderer.render(state, samples=2).plan
    assert fixed.bodies[0].shadow_map_px and "the Sun's disc" in fixed.left_out[0]
    assert plan.windows[0].engine == "rays" and plan.bodies[0].shadow_map_px is None and plan.left_out == ()


def test_the_image_tells_whether_a_coarse_map_has_edges_to_blur():
    """Close up, a map of 4096 texels is too coarse for 1 % if edges of shadows are all that there is; they are not."""
    place = np.array([60.0, -280.0, 80.0])
    base = views.state(phase_deg=60.0, direction=place)
    scene = views.scene([Body(name="body", shape=views.binary(1),
                              brdf=sweeps.GREY)], [views.camera(128, 3500.0)], sun_disc=False)
    state = State(r_sun_inertial_m=base.r_sun_inertial_m, bodies=base.bodies,
                  spacecraft=Pose(r_inertial_m=place, q_from_inertial=frames.look_at(place, np.zeros(3))))
    assert _agrees_with_rays(scene, state, max_error=0.01, engine="raster").windows[0].engine == "raster"


@pytest.mark.parametrize("q, sun", [
    ((1.0, 0.0, 0.0, 0.0), (0.5, 0.1, -0.86)), ((1.0, 0.0, 0.0, 0.0), (0.36, 0.12, -0.92)),
    ((0.0, 0.0, 1.0, 0.0), (0.5, 0.1, 0.2)),
], ids=["ahead", "ahead, shaded", "behind"])
def test_a_camera_between_two_bodies(q, sun):
    """One ahead and one behind, and the one behind may shade the one ahead."""
    bodies = [Body(name=name, shape=views.binary(seed, 5),
                   brdf=sweeps.GREY) for name, seed in (("ahead", 2), ("behind", 3))]
    state = State(r_sun_inertial_m=1.5e11 * np.array(sun),
                  spacecraft=Pose(r_inertial_m=np.array([40.0, 0.0, 0.0]), q_from_inertial=np.array(q)),
                  bodies={"ahead": Pose(r_inertial_m=np.array([0.0, 0.0, 260.0])),
                          "behind": Pose(r_inertial_m=np.array([90.0, 0.0, -150.0]))})
    _agrees_with_rays(views.scene(bodies, [views.camera(96, 80.0)]), state)


def _agrees_with_rays(scene, state, max_error=0.02, engine=None):
    with RayTracer(scene) as tracer, Renderer(scene) as renderer:
        exact = tracer.render(state, samples=16).irradiance_W_m2.astype(np.float64)
        image = renderer.render(state, max_error=max_error, engine=engine)
    lit = exact > 0.0
    assert lit.any()
    rms = np.sqrt(np.mean((image.irradiance_W_m2 - exact)[lit] ** 2)) / exact[lit].mean()
    assert rms < image.plan.predicted_error < max_error
    np.testing.assert_allclose(image.irradiance_W_m2.sum(dtype=np.float64), exact.sum(), rtol=0.1 * max_error)
    return image.plan
