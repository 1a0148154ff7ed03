"""A coma in a frame: closed forms in W/m2, the shader against its float64 twin, surfaces, shadows, plan, errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cells import slow_but
from comae import (
    AU_M,
    SUN_M,
    TABLE,
    camera,
    coma_table,
    drawn_columns,
    grid,
    lobes,
    pixel_rays,
    scene,
    sphere,
    state,
    three_jets,
)
from glrender import Body, Pose, Renderer, Scene, State, frames
from glrender.base.errors import ConfigError
from glrender.brdf import Lambert
from glrender.emission import Dust, drawing
from glrender.emission.column import columns
from glrender.emission.geometry import phase_rad, solid_angle_sr
from glrender.emission.layers import body_hits
from glrender.emission.phase_function import Isotropic
from glrender.emission.sources.activity import Activity
from glrender.emission.sources.haser import Haser
from glrender.emission.sources.jets import Jet, Jets
from glrender.scene.shape.generate import icosphere
from glrender.view.view import view_bodies
from scipy.integrate import quad


@pytest.fixture(autouse=True)
def middles(monkeypatch):
    """The twin is of pixels' middles; what samples at edges do is held against rays (test_coma_traced.py)."""
    monkeypatch.setattr("glrender.emission.drawing.surface_samples", lambda *_: 1)


def test_an_even_coma_has_the_irradiance_of_its_afrho():
    """L = F phi A(0)frho / (8 pi rho) from far off, times the pixel's own solid angle."""
    source, dust = Haser(weight_m=Dust().weight_m(2.0)), Dust()
    with Renderer(scene(source, dust=dust, max_error=0.002)) as renderer, Renderer(scene()) as bare:
        at, pinhole = state(), renderer.scene.cameras[0]
        light = renderer.render(at, samples=1).irradiance_W_m2 - bare.render(at, samples=1).irradiance_W_m2
    view = view_bodies(at, pinhole, {"nucleus": sphere().hull})[0]
    y, x = np.mgrid[:96, :96]
    pixel = np.stack([x, y], axis=-1).astype(np.float64)
    off = np.arccos(pinhole.directions(pixel)[..., 2])
    rho = 5e4 * np.sin(off)
    solar = 1360.8 / (np.linalg.norm(SUN_M) / AU_M) ** 2
    share = 1.0 - off / np.pi
    exact = (solar * dust.phase_function(phase_rad(pinhole, view, pixel)) * 2.0 / (8.0 * np.pi * rho) * share
             * solid_angle_sr(pinhole, pixel))
    beside = rho > 1100.0
    np.testing.assert_allclose(light[beside], exact[beside], rtol=1e-3)


@pytest.mark.parametrize("source", ["haser", "jets", "grid"])
@pytest.mark.parametrize("budget", slow_but([0.05, 0.01], 1))
def test_the_shader_equals_its_twin_within_the_plan(source, budget, monkeypatch):
    """Against 500 float64 steps of every fifth pixel's ray to the surface that its middle sees."""
    made = {"haser": Haser(weight_m=5.0), "jets": three_jets(), "grid": grid()}[source]
    with Renderer(scene(made, body=lobes(), max_error=budget)) as renderer:
        at, pinhole = state(), renderer.scene.cameras[0]
        column, _, (layer,), image = drawn_columns(renderer, at, monkeypatch, products=["range"])
    assert column.min() >= 0.0
    end = np.where(np.isnan(image.products["range"]), np.inf, image.products["range"]).ravel()
    truth = columns(layer.field, np.array([0.0, 0.0, -5e4]), pixel_rays(pinhole)[::5], 500, end[::5])
    column = column.ravel()[::5]
    error = float(np.sqrt(np.mean((column - truth) ** 2)) / truth.mean())
    told = image.plan.emission[0]
    assert error < budget
    assert error < 1.5 * told.predicted_error + 1e-3
    assert abs(column.sum() / truth.sum() - 1.0) < 0.1 * budget + 1e-3


def test_without_economy_the_shader_is_its_twin_to_float32(monkeypatch):
    """The same number of steps for each whole ray, a node for each pixel, nothing in the way."""
    from glrender.emission.planning import Sampling

    monkeypatch.setattr(drawing, "choose", lambda *_: Sampling(
        steps=64, front_steps=64, pixels_per_node=1, front_pixels_per_node=1, predicted_error=0.0))
    at = state(r_spacecraft=(0.0, 3e3, -5e4))
    with Renderer(scene(grid(), body=lobes())) as renderer:
        column, _, (layer,), image = drawn_columns(renderer, at, monkeypatch, products=["range"])
        rays = pixel_rays(renderer.scene.cameras[0])
    free = np.isnan(image.products["range"]).ravel()
    low, high = _angles(layer.field, np.array([0.0, 3e3, -5e4]), rays)
    count = np.maximum(np.ceil(np.float32(64) * (high - low) / np.pi), 16.0)
    # Rays whose number of steps float32 could round another way are left out.
    sure = free & (np.abs(64 * (high - low) / np.pi - np.round(64 * (high - low) / np.pi)) > 1e-3)
    for steps in np.unique(count[sure]):
        of = np.flatnonzero(sure & (count == steps))
        truth = columns(layer.field, np.array([0.0, 3e3, -5e4]), rays[of], int(steps))
        np.testing.assert_allclose(column.ravel()[of], truth, rtol=3e-4, atol=1e-6 * column.max())


def _angles(field, r_camera, rays):
    from glrender.emission.column import angles, ray_geometry

    along, closest, a = ray_geometry(field, r_camera, rays)
    return angles(field, closest, rays, a, along, np.inf)


def test_bodies_hide_the_coma_behind_them_and_not_that_before_them(monkeypatch):
    """A moon before the nucleus, and one far behind it."""
    far = Body(name="far", shape=icosphere(radius_m=2000.0), brdf=Lambert(normal_albedo=0.05))
    near = Body(name="near", shape=icosphere(radius_m=150.0), brdf=Lambert(normal_albedo=0.05))
    q = [1.0, 0.0, 0.0, 0.0]
    at = state(far=Pose(r_inertial_m=[-2.5e3, 0.0, 2e4], q_from_inertial=q),
               near=Pose(r_inertial_m=[2.5e3, 0.0, -1e4], q_from_inertial=q))
    with Renderer(scene(Haser(weight_m=5.0), bodies=[far, near], max_error=0.01)) as renderer:
        column, _, (layer,), image = drawn_columns(renderer, at, monkeypatch, products=["range", "body_id"])
        rays = pixel_rays(renderer.scene.cameras[0])
    end = np.where(np.isnan(image.products["range"]), np.inf, image.products["range"]).ravel()
    truth = columns(layer.field, np.array([0.0, 0.0, -5e4]), rays, 800, end).reshape(column.shape)
    seen = image.products["body_id"]
    for body in (0, 1, 2):
        assert (seen == body).sum() > 10
        np.testing.assert_allclose(column[seen == body], truth[seen == body], rtol=0.01)


def test_the_camera_inside_the_volume_sees_what_is_ahead(monkeypatch):
    """Away from the nucleus too: the origin is behind the camera, where nothing can be projected."""
    for attitude, r in ((frames.look_at([0.0, 0.0, -4e3], [0.0, 0.0, 0.0]), (0.0, 0.0, -4e3)),
                        (frames.look_at([0.0, 0.0, -4e3], [0.0, 0.0, -9e3]), (0.0, 0.0, -4e3)),
                        (frames.look_at([0.0, 0.0, -4e3], [9e3, 0.0, -4e3]), (0.0, 0.0, -4e3))):
        at = state(r_spacecraft=r, q=attitude)
        with Renderer(scene(grid(), body=lobes(), pinhole=camera(fov_rad=1.0))) as renderer:
            column, _, (layer,), image = drawn_columns(renderer, at, monkeypatch, products=["range"])
            rays = pixel_rays(renderer.scene.cameras[0]) @ frames.dcm(attitude)
        end = np.where(np.isnan(image.products["range"]), np.inf, image.products["range"]).ravel()
        truth = columns(layer.field, np.array(r), rays[::5], 500, end[::5])
        assert np.sqrt(np.mean((column.ravel()[::5] - truth) ** 2)) / truth.mean() < 0.02


def test_the_nucleus_casts_its_shadow_through_the_coma(monkeypatch):
    """Against rays to the Sun from every step; the shadow map and nodes leave edges."""
    with Renderer(scene(Haser(weight_m=5.0), body=lobes(), has_shadow=True)) as renderer:
        column, _, (layer,), image = drawn_columns(renderer, state(), monkeypatch, products=["range"])
        rays = pixel_rays(renderer.scene.cameras[0])
    sun = SUN_M / np.linalg.norm(SUN_M)
    hits = body_hits(lobes().shape)

    def lit(r_m):
        # Behind the body as the Sun sees it, whatever lies between.
        away = r_m - (r_m @ sun)[:, None] * sun
        first = hits(away, np.broadcast_to(-sun, r_m.shape))
        return np.where(-(r_m @ sun) > first + 1e-3, 0.0, 1.0)

    end = np.where(np.isnan(image.products["range"]), np.inf, image.products["range"]).ravel()
    every = np.arange(0, len(rays), 5)
    truth = columns(layer.field, np.array([0.0, 0.0, -5e4]), rays[every], 400, end[every], lit)
    unshadowed = columns(layer.field, np.array([0.0, 0.0, -5e4]), rays[every], 400, end[every])
    assert (truth < 0.9 * unshadowed).mean() > 0.02
    error = column.ravel()[every] - truth
    assert np.sqrt(np.mean(error**2)) / truth.mean() < 0.02
    assert abs(error.sum() / truth.sum()) < 0.003


@pytest.mark.slow
def test_a_jets_shadow_has_no_ripples(monkeypatch):
    """Of a sphere, whose shadow is a cylinder; steps that are lit as their middles are leave 11 % at a place in twenty.

    The error told is against the coma's own light, whatever the nucleus reflects.
    """
    axis = np.array([-1.0, 0.3, 0.1]) / np.linalg.norm([-1.0, 0.3, 0.1])
    jet = Jet(vent_m=800.0 * axis, normal=axis, axis=axis, weight_m=3.0, half_width_deg=8.0, vent_radius_m=150.0)
    jets = Jets(jets=[jet], activity_law=Activity(night=1.0))
    r_camera = np.array([0.2, -0.3, -1.0]) / np.linalg.norm([0.2, -0.3, -1.0]) * 5e4
    q = frames.look_at(r_camera, np.zeros(3))
    asked = replace(state(r_camera, q), r_sun_inertial_m=[1.5e11, 0.0, 0.0])
    with Renderer(scene(jets, has_shadow=True, pinhole=camera(128), max_error=0.01)) as renderer:
        column, bare, (layer,), image = drawn_columns(renderer, asked, monkeypatch, products=["range"])
        rays = pixel_rays(renderer.scene.cameras[0]) @ frames.dcm(q)
    end = np.where(np.isnan(image.products["range"]), np.inf, image.products["range"]).ravel()

    def lit(r_m):
        return ~((r_m[:, 0] < 0.0) & (np.hypot(r_m[:, 1], r_m[:, 2]) < 1000.0))

    truth = columns(layer.field, r_camera, rays, 500, end, lit)
    error, mean = column.ravel() - truth, truth.mean()
    # Pixels at the nucleus' edge have their own error, and so has what is nearly dark.
    passing = np.linalg.norm(np.cross(rays, r_camera), axis=1)
    is_free = np.abs(passing - 1000.0) > 250.0
    in_shadow = (truth < 0.9 * columns(layer.field, r_camera, rays, 300, end)) & (truth > 0.02 * mean) & is_free
    assert in_shadow.sum() > 100
    assert np.quantile(np.abs(error / np.maximum(truth, 1e-30))[in_shadow], 0.95) < 0.02
    told = image.plan.emission[0].predicted_error
    assert np.sqrt(np.mean(np.where(is_free, error, 0.0) ** 2)) / mean < min(told, 0.01)


def test_extinction_dims_the_nucleus_and_never_more_than_all():
    thick = Dust(extinction_efficiency=2.0, phase_function=Isotropic())
    source = Haser(weight_m=300.0)
    with Renderer(scene(source, dust=thick)) as renderer, Renderer(scene()) as bare:
        image, plain = renderer.render(state()), bare.render(state()).irradiance_W_m2
    told = image.plan.emission[0]
    assert told.modelled["extinction"] and not any("extinction" in line for line in told.left_out)
    # The middle of the disc: what comes through exp(-q K (1/R - 1/range)), and the dust before it.
    column = 300.0 * (1.0 / 1000.0 - 1.0 / 5e4)
    solar = 1360.8 / (np.linalg.norm(SUN_M) / AU_M) ** 2
    dust = 0.05 / np.pi * solar * (1.0 - np.exp(-2.0 * column)) / 2.0 * (0.2 / 96) ** 2
    middle = image.irradiance_W_m2[47:49, 47:49].mean()
    np.testing.assert_allclose(middle, plain[47:49, 47:49].mean() * np.exp(-2.0 * column) + dust, rtol=0.02)


def test_a_nucleus_below_a_pixel_has_the_aperture_sum_of_its_coma():
    """Sum over pixels of an even coma is 2 pi^2 K rho / range^2 within a circle; here within a square, 3.5255."""
    pinhole = camera(size=65, fov_rad=0.065)
    at = state(r_spacecraft=(130.0, -70.0, -1e7))
    source, dust = Haser(weight_m=5.0), Dust(phase_function=Isotropic())
    with Renderer(scene(source, dust=dust, pinhole=pinhole)) as renderer, Renderer(scene(pinhole=pinhole)) as bare:
        light = renderer.render(at).irradiance_W_m2.astype(np.float64) - bare.render(at).irradiance_W_m2
    solar = 1360.8 / (np.linalg.norm(SUN_M) / AU_M) ** 2
    # Mean of 1/rho over a square of side w is 3.5255 / w; before the disc the column is K asin(rho / R) / rho.
    lost = quad(lambda rho: 2.0 * np.pi * 5.0 * (np.pi - np.arcsin(rho / 1e3)), 0.0, 1e3)[0]
    for half in (0, 1, 4, 12):
        side = (2 * half + 1) * 1e4
        part = light[32 - half:33 + half, 32 - half:33 + half].sum()
        exact = 0.05 / np.pi * solar * (np.pi * 5.0 * 3.52549 * side - lost) / 1e14
        np.testing.assert_allclose(part, exact, rtol=0.01)


def test_the_far_view_keeps_its_pixels():
    """From 1e9 m, as from 1e6 m with a thousandth of the focal length: nothing cancels."""
    made = []
    for range_m, fov in ((1e6, 2e-2), (1e9, 2e-5)):
        with Renderer(scene(Haser(weight_m=5.0, reach_m=2e4), pinhole=camera(fov_rad=fov))) as renderer, \
                Renderer(scene(pinhole=camera(fov_rad=fov))) as bare:
            at = state(r_spacecraft=(0.0, 0.0, -range_m))
            made.append((renderer.render(at).irradiance_W_m2 - bare.render(at).irradiance_W_m2)
                        / (fov / 96.0) ** 2)
    np.testing.assert_allclose(made[1], made[0], rtol=0.01, atol=1e-3 * made[0].max())


def test_the_plan_tells_what_was_modelled_and_left_out():
    with Renderer(scene(Haser(weight_m=5.0))) as renderer, Renderer(scene()) as bare:
        image, plain = renderer.render(state()), bare.render(state())
    assert plain.plan.emission == () and plain.timings_ms.keys().isdisjoint({"emission"})
    told = image.plan.to_dict()["emission"][0]
    assert told["kind"] == "coma" and told["body"] == "nucleus" and told["milliseconds"] > 0.0
    assert told["modelled"]["fields"][0]["models"] == ["haser"]
    assert any("shadow" in line for line in told["left_out"])
    assert image.plan.roi == (0, 0, 96, 96)


def test_equal_requests_give_equal_bytes_whatever_came_between():
    with Renderer(scene(three_jets(), body=lobes())) as renderer:
        first = renderer.render(state()).irradiance_W_m2.tobytes()
        other = State(t_s=0.0, r_sun_inertial_m=-SUN_M, spacecraft=state().spacecraft, bodies=state().bodies)
        assert renderer.render(other).irradiance_W_m2.tobytes() != first
        assert renderer.render(state()).irradiance_W_m2.tobytes() == first


@pytest.mark.slow
def test_a_scene_file_asks_for_every_model(tmp_path):
    np.save(tmp_path / "strength.npy", np.ones(len(Scene.from_dict(TABLE).bodies[0].shape.facets)))
    sources = [
        {"model": "haser", "afrho_m": 1.0, "scale_length_m": 1e5},
        {"model": "jets", "jets": [{"latitude_deg": 10.0, "longitude_deg": 20.0, "half_width_deg": 15.0,
                                    "afrho_m": 0.5}]},
        {"model": "facets", "afrho_m": 1.0, "table": "strength.npy", "activity": {"exponent": 0.5, "night": 0.1}},
        {"model": "tail", "afrho_m": 1.0, "perihelion_au": 0.9, "eccentricity": 0.5, "true_anomaly_deg": 40.0,
         "pole_inertial": [0.0, 0.0, 1.0], "oldest_s": 1e6, "length_m": 1e8, "particles": 5000, "cells": 32}]
    table = coma_table(sources=sources, has_shadow=True,
                       dust={"geometric_albedo": 0.04, "phase_function": {"kind": "henyey_greenstein", "forward": 0.8},
                             "extinction_efficiency": 2.0})
    with Renderer(Scene.from_dict(table, shape_dir=tmp_path)) as renderer:
        image = renderer.render(state())
    assert {model for field in image.plan.emission[0].modelled["fields"] for model in field["models"]} == {
        "haser", "jets", "facets", "tail"}
    assert np.isfinite(image.irradiance_W_m2).all() and image.irradiance_W_m2.min() > 0.0


@pytest.mark.parametrize("changes, path", [
    ({"kind": "gas"}, "scene.emission[0].kind"),
    ({"body": "moon"}, "scene.emission[0].body"),
    ({"colour": 1}, "scene.emission[0].colour"),
    ({"sources": []}, "scene.emission[0].sources"),
    ({"sources": [{"model": "smoke"}]}, "scene.emission[0].sources[0].model"),
    ({"sources": [{"model": "haser"}]}, "scene.emission[0].sources[0].afrho_m"),
    ({"sources": [{"model": "haser", "afrho_m": -1.0}]}, "scene.emission[0].sources[0].afrho_m"),
    ({"sources": [{"model": "haser", "afrho_m": 1.0, "exponent": 1.0}]}, "scene.emission[0].sources[0].exponent"),
    ({"sources": [{"model": "jets", "jets": [{"latitude_deg": 99.0, "longitude_deg": 0.0, "half_width_deg": 5.0,
                                              "afrho_m": 1.0}]}]}, "scene.emission[0].sources[0].jets[0].latitude_deg"),
    ({"sources": [{"model": "grid", "file": "none.npz", "cross_section_per_m": 1.0}]},
     "scene.emission[0].sources[0].file"),
    ({"sources": [{"model": "facets", "afrho_m": 1.0, "table": "none.npy"}]},
     "scene.emission[0].sources[0].table"),
    ({"dust": {"geometric_albedo": 2.0}}, "scene.emission[0].dust.geometric_albedo"),
    ({"dust": {"phase_function": "blue"}}, "scene.emission[0].dust.phase_function.kind"),
    ({"has_shadow": 1}, "scene.emission[0].has_shadow"),
])
def test_a_bad_table_is_told_by_its_field(changes, path, tmp_path):
    table = coma_table()
    table["emission"][0].update(changes)
    with pytest.raises(ConfigError) as caught:
        Scene.from_dict(table, shape_dir=tmp_path)
    assert str(caught.value).startswith(path), str(caught.value)


def test_over_the_wire_only_bare_names_lead_to_grids(tmp_path):
    table = coma_table(sources=[{"model": "grid", "file": "../secret.npz", "cross_section_per_m": 1.0}])
    with pytest.raises(ConfigError, match="bare file name"):
        Scene.from_dict(table, shape_dir=tmp_path, restricted=True)
