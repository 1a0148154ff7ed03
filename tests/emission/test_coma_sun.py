"""A coma whose activity follows the Sun: what a frame uses and tells depends on no frame before it."""

from __future__ import annotations

from dataclasses import replace

import comae as coma
import numpy as np
import pytest
from cells import slow_but
from glrender import Renderer
from glrender.base.rotations import dcm, look_at
from glrender.emission import layers
from glrender.emission.column import columns
from glrender.emission.sources.jets import Jets

SUN_M = 1.5e11
ONE_JET = Jets(jets=coma.three_jets().jets[:1])
ASIDE_M = np.array([1.5e4, 4.5e4, -1.5e4])


@pytest.fixture(autouse=True)
def middles(monkeypatch):
    """The twin is of pixels' middles."""
    monkeypatch.setattr("glrender.emission.drawing.surface_samples", lambda *_: 1)


def with_sun(direction):
    direction = np.asarray(direction, float)
    return replace(coma.state(ASIDE_M, look_at(ASIDE_M, np.zeros(3))),
                   r_sun_inertial_m=SUN_M * direction / np.linalg.norm(direction))


@pytest.mark.parametrize("first", slow_but([(-1.0, -0.2, 0.3), (0.0, 0.0, 1.0)], 0, are_values=True))
def test_a_frame_is_the_same_whatever_the_sun_lit_first(first):
    """Before, its steps were those that the first frame's Sun needed: a retry at another worker got other bytes."""
    scene, asked = coma.scene(coma.three_jets(), body=coma.lobes()), with_sun((1.0, 0.3, -0.5))
    with Renderer(scene) as renderer:
        alone = renderer.render(asked)
    with Renderer(scene) as renderer:
        renderer.render(with_sun(first))
        after = renderer.render(asked)
    assert after.irradiance_W_m2.tobytes() == alone.irradiance_W_m2.tobytes()
    assert after.plan.predicted_error == alone.plan.predicted_error
    assert after.plan.emission[0].predicted_error == alone.plan.emission[0].predicted_error


@pytest.mark.parametrize("sun", slow_but([(1.0, 0.2, -0.3), (0.1, 1.0, 0.3), (0.3, -0.2, -1.0), (1.0, 1.0, -1.0)],
                                         0, 2, are_values=True))
def test_the_error_told_holds_after_a_frame_with_all_vents_in_the_dark(sun, monkeypatch):
    """A dark first frame had 8 steps taken and 0 told ever after: an error of 3.0, not 0.02, of the mean."""
    with Renderer(coma.scene(ONE_JET, body=coma.lobes())) as renderer:
        renderer.render(with_sun((-1.0, -0.2, 0.3)))
        column, _, (layer,), image = coma.drawn_columns(renderer, with_sun(sun), monkeypatch, products=["range"])
        rays = coma.pixel_rays(renderer.scene.cameras[0]) @ dcm(look_at(ASIDE_M, np.zeros(3)))
    end = np.where(np.isnan(image.products["range"]), np.inf, image.products["range"]).ravel()
    truth, column = columns(layer.field, ASIDE_M, rays[::5], 500, end[::5]), column.ravel()[::5]
    assert truth.max() > 0.0
    error = float(np.sqrt(np.mean((column - truth) ** 2)) / truth.mean())
    assert error < 0.02 and error < 1.5 * image.plan.emission[0].predicted_error + 1e-3


def test_no_frame_measures_what_the_opening_can(monkeypatch):
    """The first frame took 1.2 s longer, and with another Sun's a deadline would fall due."""
    with Renderer(coma.scene(coma.three_jets(), body=coma.lobes())) as renderer:
        monkeypatch.setattr(layers, "measured_errors", None)
        assert renderer.render(with_sun((1.0, 0.3, -0.5))).irradiance_W_m2.max() > 0.0
