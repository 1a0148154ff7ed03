"""Gradients by shapes and albedos, against sums over facets cut by each pixel, exact polygons, and differences."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pillar
import pytest
import views
from facet_images import facet_image
from glrender import Body, Renderer, Shape, generate
from glrender.base.errors import ConfigError
from glrender.brdf import Hapke, Lambert
from moved_states import from_its_camera
from scipy.ndimage import gaussian_filter

LAW = Hapke(single_scattering_albedo=0.3, b=0.3, c=0.4, roughness_deg=20.0)
CAMERA = views.camera(24, 2000.0)
STATE = views.state(phase_deg=50.0, range_m=20_000.0)
BALL = generate.icosphere(radius_m=100.0, subdivisions=1)
SHAPE = Shape.from_arrays(BALL.vertices_m * [1.0, 0.8, 0.6], BALL.facets)
SCENE = views.scene([Body(name="body", brdf=LAW, shape=SHAPE)], [CAMERA], sun_disc=False)


@cache
def weights():
    return np.random.default_rng(1).normal(size=(24, 24))


@cache
def convex_gradient():
    with Renderer(SCENE) as renderer:
        return renderer.gradient(STATE, weights())


def difference(moved, step):
    """The central difference of the weighted sum, of shapes whose vertices are `moved` (V, 3) [m] by a step of 1."""
    plus, minus = (facet_image(replace(SHAPE, vertices_m=SHAPE.vertices_m + side * step * moved), from_its_camera(
        STATE, CAMERA), CAMERA, LAW) for side in (1.0, -1.0))
    return float((weights() * (plus - minus)).sum()) / (2.0 * step)


@pytest.mark.parametrize("seed", range(6))
def test_vertices_of_a_convex_body(seed):
    """Random moves of all vertices: lines, normals and middles of facets follow."""
    moved = np.random.default_rng(seed).normal(size=SHAPE.vertices_m.shape)
    expected, found = difference(moved, 0.003), float((convex_gradient()["body"].vertices_m * moved).sum())
    scale = np.linalg.norm(convex_gradient()["body"].vertices_m)
    assert abs(found - expected) < 1e-4 * scale


def test_heights_are_along_the_normals_and_all_shifts_are_the_bodys():
    gradient = convex_gradient()["body"]
    np.testing.assert_allclose(gradient.heights_m, (gradient.vertices_m * SHAPE.vertex_normals).sum(axis=1), rtol=1e-12)
    with Renderer(SCENE) as renderer:
        image = renderer.render(STATE, derivatives=["bodies.body"])
        again = renderer.gradient(STATE, lambda irradiance: weights() * (irradiance >= 0.0))
    np.testing.assert_array_equal(again.irradiance_W_m2, image.irradiance_W_m2)
    np.testing.assert_array_equal(again["body"].vertices_m, gradient.vertices_m)
    x0, y0, x1, y1 = image.jacobian.roi
    along = (weights()[y0:y1, x0:x1] * image.jacobian["bodies.body"]).sum(axis=(1, 2))[:3]
    total = np.linalg.norm(gradient.vertices_m.sum(axis=0))
    assert total == pytest.approx(np.linalg.norm(along), rel=1e-5)


def test_albedos_add_up_to_the_image():
    """A factor on the light of all facets is one on the image's."""
    gradient = convex_gradient()
    assert gradient["body"].albedo.sum() == pytest.approx(float((weights() * gradient.irradiance_W_m2).sum()), rel=1e-5)


def moved_truth(side_m=0.0, shift_m=(0.0, 0.0), height_m=0.0, half_m=0.0):
    """The image (rows, columns) of the slab whose pillar has a top that is moved, and whose sides are farther out."""
    return pillar.truth(pillar.STATE, pillar.CAMERA, half_m=pillar.HALF_M + half_m, height_m=pillar.HEIGHT_M + height_m,
                     top_m=np.asarray(shift_m))


MOVES = {"up": {"height_m": 1.0}, "along x": {"shift_m": (1.0, 0.0)}, "along y": {"shift_m": (0.0, 1.0)},
         "sides": {"half_m": 1.0}}


@cache
def cut_gradients():
    with Renderer(views.scene([pillar.BODY], [pillar.CAMERA], sun_disc=False)) as renderer:
        return [renderer.gradient(pillar.STATE, weights, max_error=0.003)["body"].vertices_m
                for weights in pillar.MOMENTS]


@pytest.mark.parametrize("name", MOVES)
def test_shadows_and_what_is_hidden_follow_the_pillar_that_casts_them(name):
    r_m, step = pillar.BODY.shape.vertices_m, 4e-3
    moved = np.zeros_like(r_m)
    if name == "sides":
        moved[:, :2] = np.sign(r_m[:, :2]) * (np.abs(r_m[:, :2]) > 0.9 * pillar.HALF_M)
    else:
        moved[r_m[:, 2] == pillar.HEIGHT_M] = {"up": (0.0, 0.0, 1.0), "along x": (1.0, 0.0, 0.0),
                                            "along y": (0.0, 1.0, 0.0)}[name]
    plus, minus = (moved_truth(**{key: np.multiply(side * step, value) for key, value in MOVES[name].items()})
                   for side in (1.0, -1.0))
    expected = pillar.moments(plus - minus) / (2.0 * step)
    found = np.array([(gradient * moved).sum() for gradient in cut_gradients()])
    scale = np.abs(pillar.moments(np.abs(plus - minus))).max() / (2.0 * step)
    np.testing.assert_allclose(found / scale, expected / scale, atol=0.03)


@pytest.mark.parametrize("weights, words", [
    (np.zeros((3, 3)), "weights: must be of the image's"), (np.full((24, 24), np.nan), r"weights\[0, 0\]: must be"),
    ("all", "weights: must be numbers"), (1j * np.ones((24, 24)), "weights: must be numbers"),
    (lambda irradiance: irradiance[:2], "weights: must be of the image's")])
def test_weights_of_another_shape_are_refused(weights, words):
    with Renderer(SCENE) as renderer:
        with pytest.raises(ConfigError, match=words):
            renderer.gradient(STATE, weights)


def test_nothing_lit_is_zero_and_texture_is_refused():
    body = Body(name="body", shape=generate.icosphere(radius_m=100.0, subdivisions=3), brdf=Lambert(normal_albedo=0.3))
    with Renderer(views.scene([body], [views.camera(24, 200.0)], sun_disc=False)) as renderer:
        gradient = renderer.gradient(views.state(phase_deg=180.0, range_m=2000.0), np.ones((24, 24)))
    assert not gradient["body"].vertices_m.any() and not gradient["body"].albedo.any()
    smooth = replace(body, smooth_normals=True)
    with Renderer(views.scene([smooth], [views.camera(24, 200.0)], sun_disc=False)) as renderer:
        with pytest.raises(ConfigError, match="smooth_normals=False"):
            renderer.gradient(views.state(phase_deg=60.0, range_m=2000.0), np.ones((24, 24)))


@pytest.mark.slow
def test_heights_over_a_rough_body_move_its_shadows():
    """Fields over all of Itokawa and bumps, against differences of frames, which divide its facets anew."""
    path = Path(__file__).parents[2] / "data" / "itokawa" / "itokawa_16q_3072.obj"
    shape, camera, rng = Shape.from_file(path, length_unit="km"), views.camera(128, 1000.0), np.random.default_rng(0)
    state, px_m = views.state(phase_deg=60.0, range_m=20.0 * shape.radius_m), 0.02 * shape.radius_m
    smooth, r = gaussian_filter(rng.normal(size=(128, 128)), 4.0), shape.vertices_m / shape.radius_m
    fields = [np.cos(r @ (4.4 * rng.standard_normal(3)) + rng.uniform(0.0, 2.0 * np.pi)) for _ in range(6)]
    fields += [np.exp(-20.0 * ((r - at) ** 2).sum(axis=1)) for at in r[rng.choice(len(r), 12)]]

    def gradient(moved):
        body = Body(name="body", shape=moved, brdf=Lambert(normal_albedo=0.3))
        with Renderer(views.scene([body], [camera], sun_disc=False)) as renderer:
            return renderer.gradient(state, smooth, max_error=0.02)

    def light(field, side):
        moved_m = shape.vertices_m + side * 0.01 * px_m * field[:, None] * shape.vertex_normals
        return float((smooth * gradient(shape.with_vertices(moved_m)).irradiance_W_m2).sum())

    expected = np.array([light(field, 1.0) - light(field, -1.0) for field in fields]) / (0.02 * px_m)
    found = np.array(fields) @ gradient(shape)["body"].heights_m
    assert np.linalg.norm(found - expected) < 0.03 * np.linalg.norm(expected)
    assert np.corrcoef(found, expected)[0, 1] > 0.999
