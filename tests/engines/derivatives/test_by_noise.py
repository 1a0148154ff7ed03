"""A tolerance by the camera's noise: the pose that explains what a frame errs by is below so many deviations."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
import views
from glrender import Body, Renderer
from glrender.base.errors import ConfigError, SceneError
from glrender.brdf import Lambert
from glrender.capture.capture import take_frame
from glrender.engines.rays.backend import RayTracer
from glrender.scene.tolerance import checked_max_error
from glrender_camera import CameraModel

MODEL = CameraModel.from_dict({"preset": "generic_navigation_camera"})
CAMERA = views.camera(160, 5000.0, model=MODEL)
STATE = views.state(phase_deg=60.0, range_m=10_000.0)


@cache
def scene(camera=CAMERA):
    body = Body(name="body", brdf=Lambert(normal_albedo=0.3), shape=views.binary(7, subdivisions=5))
    return views.scene([body], [camera], sun_disc=False)


@pytest.mark.parametrize("sigmas", [1.0, 0.2])
def test_the_frame_errs_by_less_than_the_noise_lets_be_known(sigmas):
    with Renderer(scene()) as renderer:
        truth = renderer.render(STATE, derivatives=["spacecraft"], max_error=0.0005)
        image = renderer.render(STATE, max_error={"sigmas": sigmas}, derivatives=["sun"])
    known = truth.information(components={"spacecraft": (0, 1, 2)})
    costs = np.abs(list(known.cost_of(image).values())) / list(known.in_pixels.values())
    assert costs.max() < sigmas
    assert 0.0005 < image.plan.max_error < 0.05


def test_more_deviations_and_other_units_and_a_dark_frame():
    with Renderer(scene()) as renderer:
        one, four = (renderer.render(STATE, max_error={"sigmas": each}).plan for each in (0.25, 1.0))
        both = renderer.render(STATE, max_error={"sigmas": 1.0, "rms": 0.5 * four.max_error, "flux": 0.5}).plan
        dark, blurred = (draw(views.state(phase_deg=180.0, range_m=10_000.0), max_error={"sigmas": 1.0})
                         for draw in (renderer.render, partial(take_frame, renderer)))
    assert four.max_error == pytest.approx(4.0 * one.max_error) and both.asked["rms"] == 0.5 * four.max_error
    assert not dark.irradiance_W_m2.any() and dark.plan.max_error == blurred.plan.max_error == 1.0


def test_frames_of_a_scene_that_asks_so():
    """A detector's frame, whose tolerance holds after the point spread function, has the same error before it."""
    with Renderer(replace(scene(), max_error={"sigmas": 0.5})) as renderer:
        image, frame = renderer.render(STATE), take_frame(renderer, STATE)
        gradient = renderer.gradient(STATE, np.ones((160, 160)))
    assert frame.plan.max_error == pytest.approx(image.plan.max_error * MODEL.psf_noise_gain, rel=0.05)
    assert gradient.irradiance_W_m2.any() and frame.plan.predicted_error <= frame.plan.max_error


def test_the_noise_is_of_the_frames_own_exposure():
    """As if it were the camera's: shorter by 300, with more noise, and with fewer errors that count."""
    errors = []
    for own_s, asked_s in ((3e-3, None), (1e-5, 3e-3), (1e-5, None)):
        model = replace(MODEL, exposure_s=own_s)
        with Renderer(replace(scene(replace(CAMERA, model=model)), max_error={"sigmas": 1.0})) as renderer:
            errors.append(take_frame(renderer, STATE, exposure_s=asked_s).plan.max_error)
    assert errors[1] == errors[0] < 0.7 * errors[2], errors


def test_a_deadline_is_the_first_frames_as_well():
    given_s = []

    class Recorded(Renderer):
        def render(self, *state, deadline_s=None, **options):
            given_s.append(deadline_s)
            return super().render(*state, deadline_s=deadline_s, **options)

    with Recorded(scene()) as renderer:
        for deadline_s in (None, 100.0, 1e-6):
            renderer.render(STATE, max_error={"sigmas": 1.0}, deadline_s=deadline_s)
    assert given_s[:3] == [None, None, 100.0] and 0.0 < given_s[3] <= 100.0 and given_s[4:] == [1e-6, 1e-6]


def refused(message, given, backend=Renderer, **options):
    with backend(given) as renderer, pytest.raises(ConfigError, match=message):
        renderer.render(STATE, max_error={"sigmas": 1.0}, **options)


def test_refusals():
    refused(r"max_error.sigmas: .*a model.*got 1.0.*number for max_error", scene(replace(CAMERA, model=None)))
    smooth = replace(scene(), bodies=[replace(scene().bodies[0], smooth_normals=True)])
    refused(r"max_error.sigmas: needs derivatives.*smooth normals.*number for max_error", smooth)
    refused(r"max_error.sigmas: .*backend", scene(), RayTracer)
    with Renderer(scene()) as renderer, pytest.raises(SceneError, match=r"^state.bodies.body: missing"):
        renderer.render(replace(STATE, bodies={}), max_error={"sigmas": 1.0})
    for value in (0.0, np.nan, 1e5):
        with pytest.raises(ConfigError, match=r"max_error.sigmas"):
            checked_max_error({"sigmas": value})
