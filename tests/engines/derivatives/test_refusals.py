"""What has no derivatives is refused by name, with what to change."""

from __future__ import annotations

from dataclasses import replace

import comae
import numpy as np
import pytest
import solids
import views
from glrender import Body, Detail, Lamp, Pose, Renderer
from glrender.base.errors import ConfigError
from glrender.brdf import Lambert, LunarLambert
from glrender.engines.derivatives.refusals import check_derivable
from glrender.planner.request import Request
from glrender.scene.detail.config import Noise
from glrender_camera.distortion import BrownConrady

LAW = Lambert(normal_albedo=0.3)
STATE = views.state()


def refused(message, bodies=None, state=STATE, camera=None, derivatives=("spacecraft",), scene=(), **options):
    bodies = bodies or [views.sphere(LAW, subdivisions=2)]
    with Renderer(views.scene(bodies, [camera or views.camera(64, 500.0)], sun_disc=False, **dict(scene))) as renderer:
        with pytest.raises(ConfigError, match=message):
            renderer.render(state, derivatives=derivatives, **options)


@pytest.mark.parametrize("derivatives, message", [
    (["spacecrafts"], r"derivatives\[0\]: must be the name of a parameter, .*did you mean 'spacecraft'"),
    (["sun", "bodies.bodi"], r"derivatives\[1\].*did you mean 'bodies.body'"),
    (["law.normal_albdo"], "did you mean 'law.normal_albedo'"), (["law.roughness_deg"], "law.normal_albedo"),
    ("pose", "there are spacecraft, sun, focal_length, bodies.body, law.normal_albedo"), ([3], r"derivatives\[0\]"),
    (["sun", "sun"], r"derivatives\[1\]: must be named once"), (7, "must be names of parameters")])
def test_names(derivatives, message):
    refused(message, derivatives=derivatives)


def test_numbers_of_a_law_alone_have_derivatives():
    refused("must be the name", [views.sphere(LunarLambert(normal_albedo=0.2, weight="mcewen"), 2)],
            derivatives=["law.weight"])


@pytest.mark.parametrize("options, message", [
    ({"engine": "rays"}, "engine: must be coverage, or left out"), ({"engine": "raster"}, "engine: must be coverage"),
    ({"samples": 2}, "samples: must be left out")])
def test_engines(options, message):
    refused(message, **options)


@pytest.mark.parametrize("change, message", [
    ({"smooth_normals": True}, "smooth normals .body 'body'.*smooth_normals=False"),
    ({"albedo_map": np.full((4, 8), 0.5), "albedo_projection": {"kind": "equirectangular", "left_edge_deg": -180.0}},
     "a texture .body 'body'.*leave albedo_map out"),
    ({"detail": Detail(noise=Noise(amplitude_m=1.0, longest_m=40.0, shortest_m=10.0))},
     "surface detail .*leave detail out"),
    ({"shape": solids.several(((-50, -20, -20), (20, 20, 20)), ((0, -10, -10), (60, 10, 10)))},
     "shells that overlap .*one shell")])
def test_surfaces(change, message):
    refused(message, [replace(views.sphere(LAW, subdivisions=2), **change)])


def test_comae():
    with pytest.raises(ConfigError, match="has a coma.*leave emission out"):
        check_derivable(["sun"], comae.scene(comae.three_jets()), Request(camera=comae.camera(), max_error=0.1), [])


def test_lamps():
    lamp = Lamp(name="torch", intensity_W_sr=10.0)
    refused("are of sunlight, and this scene has lamps.*leave lamps out", scene={"lamps": [lamp]})


def test_cameras():
    lens = views.camera(64, 500.0, distortion=BrownConrady(k1=-0.1))
    refused("a camera that distorts .*leave distortion out", camera=lens)
    near = views.state(range_m=102.0, target=(0.0, 30.0, 300.0))
    refused("reaches behind the camera .*farther away", state=near)


def pair(place_m):
    bodies = [views.sphere(LAW, subdivisions=2), views.sphere(LAW, subdivisions=2, radius_m=30.0, name="moon")]
    state = views.state(bodies=("body", "moon"))
    return bodies, replace(state, bodies={**state.bodies, "moon": Pose(r_inertial_m=place_m)})


def test_two_bodies_whose_light_crosses():
    bodies, state = pair(500.0 * STATE.r_sun_inertial_m / np.linalg.norm(STATE.r_sun_inertial_m))
    refused("where moon may shade body.*leave one", bodies, state, views.camera(512, 500.0))
    bodies, state = pair(-500.0 * STATE.spacecraft.r_inertial_m / 2000.0)
    refused("where body and moon may hide each other", bodies, state)


def test_bodies_that_stand_apart_have_derivatives_of_their_own():
    """Those of one do not change the pixels of the other; a body out of view has none."""
    to_sun = STATE.r_sun_inertial_m / np.linalg.norm(STATE.r_sun_inertial_m)
    aside = np.cross(to_sun, STATE.spacecraft.r_inertial_m)
    bodies, state = pair(300.0 * aside / np.linalg.norm(aside))
    with Renderer(views.scene(bodies, [views.camera(256, 500.0)], sun_disc=False)) as renderer:
        image = renderer.render(state, derivatives=["bodies.body", "bodies.moon", "spacecraft"])
    body, moon, spacecraft = (image.jacobian[name] for name in ("bodies.body", "bodies.moon", "spacecraft"))
    assert body.any() and moon.any() and not (body.any(axis=0) & moon.any(axis=0)).any()
    np.testing.assert_allclose(body[:3] + moon[:3], -spacecraft[:3], atol=1e-5 * np.abs(spacecraft[:3]).max())
    bodies, state = pair(300_000.0 * aside / np.linalg.norm(aside))
    refused(r"derivatives\[1\]: must be of a body that is in view, .*bodies.moon.*leave it out", bodies, state,
            derivatives=["sun", "bodies.moon"])


def test_shells_that_stand_apart_have_derivatives():
    shape = solids.several(((-50, -20, -20), (-10, 20, 20)), ((10, -20, -20), (60, 20, 20)))
    body = Body(name="body", shape=shape, brdf=LAW)
    with Renderer(views.scene([body], [views.camera(64, 500.0)], sun_disc=False)) as renderer:
        assert renderer.render(STATE, derivatives=["sun"]).jacobian["sun"].any()
