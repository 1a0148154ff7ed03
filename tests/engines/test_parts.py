"""Bodies of several materials: OpenGL draws parts, all else one body. Truth: float64 rays at each facet, plates."""

from __future__ import annotations

import numpy as np
import pytest
import views
from few_facets import light as traced
from glb_parts import SHEET_UV, glb, material, png, sheet
from glrender import Body, ConfigError, Pose, Renderer, SceneError, State, frames, open_renderer
from glrender.base.constants import AU_M
from glrender.brdf import Lambert
from glrender.engines.cycles import Cycles
from glrender.engines.cycles.backend import has_two_faces
from glrender.engines.rays.aimed import AimedRays
from glrender.engines.rays.engine import RayEngine
from glrender.view.view import view_bodies
from glrender_camera import BrownConrady
from solids import box

GREY = Lambert(normal_albedo=0.3)
WAYS = {"coverage": {"max_error": 0.02}, "rays": {"max_error": 0.02, "engine": "rays"}, "OpenGL": {"samples": 4}}


def craft(folder):
    """A bus of paint with a lid of gold, a dish of bare metal, and a panel: cells before, paint behind."""
    bus, facets = box((-0.5, -0.5, -0.7), (0.5, 0.5, 0.7))
    is_lid = (bus[facets][..., 2] > 0.69).all(axis=1)
    cone = np.array([[0, 0, 0.75], *([0.4 * np.cos(t), 0.4 * np.sin(t), 1.0] for t in np.arange(8) * np.pi / 4)])
    dish = np.array([[0, k + 1, (k + 1) % 8 + 1] for k in range(8)])
    node = {"translation": [1.5, 0.0, 0.0], "scale": [2.0, 1.2, 1.0],
            "rotation": [0.0, float(np.sin(0.2)), 0.0, float(np.cos(0.2))]}
    given = [material("paint", 0.8), material("gold", 0.9, metal=1.0, rough=0.5),
             {**material("metal", 0.6, metal=1.0, rough=0.7), "doubleSided": True}, material("cells", 0.05, rough=0.6)]
    return Body.from_file(glb(folder / "sat.glb", [
        (bus, facets[~is_lid], 0, None, None), (bus, facets[is_lid], 1, None, None), (cone, dish, 2, None, None),
        sheet(3, node), sheet(0, node, turned=True)], given), name="sat", length_unit="m")


def looking(r_camera, r_sun=(2.0, -1.0, 3.0)):
    """A camera that sees the middle of the craft, and the Sun in a direction."""
    r_camera = np.array(r_camera, float)
    return State(r_sun_inertial_m=AU_M * np.array(r_sun) / np.linalg.norm(r_sun), bodies={"sat": Pose(
        r_inertial_m=np.zeros(3))}, spacecraft=Pose(r_inertial_m=r_camera, q_from_inertial=frames.look_at(
            r_camera, np.array([0.7, 0.0, 0.1]))))


@pytest.fixture(scope="module")
def body(tmp_path_factory):
    return craft(tmp_path_factory.mktemp("craft"))


@pytest.fixture(scope="module")
def renderer(body):
    with Renderer(views.scene([body], [views.camera(72, 394.0)], sun_disc=False)) as made:
        yield made


@pytest.mark.parametrize("r_camera", [(8.0, -14.0, 12.0), pytest.param((8.0, -8.0, -16.0), marks=pytest.mark.slow)],
                         ids=["above", "below"])
def test_a_craft_of_four_materials_is_as_rays_see_it(renderer, body, r_camera):
    """Shadows of parts on parts, both sides of a panel and of the dish: within the predicted error and the truth's own.

    The truth's 6 x 6 rays a pixel differ from its 16 x 16 by 1.6 %.
    """
    state = looking(r_camera, (2.0, -1.0, np.sign(r_camera[2]) * 3.0))
    truth = traced([(part.shape.vertices_m[part.shape.facets], part.brdf) for part in body.parts],
                   renderer.scene.cameras[0], state, views.SOLAR_IRRADIANCE_W_M2)
    for way, options in WAYS.items():
        image = renderer.render(state, **options)
        light = image.irradiance_W_m2.astype(float)
        assert views.relative_rms(light, truth) < np.hypot(image.plan.predicted_error, 0.016), way
        assert abs(light.sum() / truth.sum() - 1.0) < (0.01 if way == "OpenGL" else 0.004), way
    engine, camera = RayEngine(renderer.scene), renderer.scene.cameras[0]
    seen = view_bodies(state, camera, engine.scene.hulls)
    light, error = AimedRays(engine, camera, seen, (0, 0, 72, 72)).until(0.01, np.random.default_rng(0))
    assert views.relative_rms(light.reshape(72, 72).astype(float), truth) < np.hypot(error, 0.016)


def test_callers_see_one_body(renderer, body):
    """Plan, products, warnings and memory; with the numbers of the whole shape's facets, as of one law."""
    wanted = ("range", "body_id", "facet_id", "sunlit", "incidence", "r_body")
    state = looking((8.0, -14.0, 12.0))
    alone = Body(name="sat", shape=body.shape, brdf=GREY)
    with open_renderer(views.scene([alone], [views.camera(72, 394.0)], sun_disc=False), "raytrace") as one:
        want = one.render(state, products=wanted, samples=1)
    with open_renderer(renderer.scene, "raytrace") as rays:
        made = [rays.render(state, products=wanted, samples=1),
                renderer.render(state, products=wanted)]
    for image in made:
        assert [each.name for each in image.plan.bodies] == ["sat"]
        assert image.plan.bodies[0].n_facets == len(body.shape.facets)
        assert image.request[0] is not None and image.request[1] is state
        differs = image.products["facet_id"] != want.products["facet_id"]
        assert set(np.unique(image.products["body_id"])) == {-1, 0} and differs.mean() < 0.005
        for name in ("range", "incidence", "r_body"):
            np.testing.assert_allclose(image.products[name][~differs], want.products[name][~differs], atol=2e-5)
    assert list(renderer.info["memory_bytes"]) == ["sat"]
    with Renderer(views.scene([alone], [views.camera(72, 394.0)])) as one:
        want, made_bytes = (each.info["memory_bytes"]["sat"] for each in (one, renderer))
    assert all(want[kind] == made_bytes[kind] for kind in ("shape", "rays", "coverage")), "the whole's"
    assert set(renderer.render(state, products=["facet_id"]).products) == {"facet_id"}
    assert made[1].plan.bodies[0].law == "microfacet" and not made[1].plan.bodies[0].casters


def test_a_craft_of_several_laws_is_drawn_as_one_of_one_law(body):
    """Lambert albedos that differ by 1e-7 of themselves: equal areas, as many rays, one shadow map, and equal light."""
    laws = {name: Lambert(normal_albedo=0.3 + 3e-8 * k) for k, name in enumerate(body.materials)}
    several, state = Body(name="sat", shape=body.shape, materials=laws), looking((8.0, -14.0, 12.0))
    assert len(several.parts) == 4
    images = []
    for each in (several, Body(name="sat", shape=body.shape, brdf=GREY)):
        with Renderer(views.scene([each], [views.camera(72, 394.0)])) as made:
            images.append([made.render(state, **way) for way in (
                {"max_error": 0.02}, {"engine": "rays"}, {"engine": "raster"}, {"samples": 4}, {"max_error": 0.004})])
    for image, other in zip(*images, strict=True):
        one, two = image.plan.windows[0], other.plan.windows[0]
        assert (one.engine, one.refined_samples, one.refined_share) == (
            two.engine, two.refined_samples, two.refined_share)
        assert image.plan.bodies[0].shadow_map_drawn_px == other.plan.bodies[0].shadow_map_drawn_px
        assert image.plan.predicted_error == pytest.approx(other.plan.predicted_error)
        np.testing.assert_allclose(image.irradiance_W_m2, other.irradiance_W_m2, rtol=1e-5,
                                   atol=1e-5 * other.irradiance_W_m2.max())
    assert one.refined_share > 0.0


@pytest.mark.parametrize("has_lens", [False, True])
def test_a_part_behind_the_camera_is_not_in_the_image(tmp_path, has_lens):
    """From between a panel and a box, on the line through both: float64 rays at the panel's facets, and its shade."""
    box_behind, facets = box((-0.5, -0.5, 19.0), (0.5, 0.5, 20.0))
    pieces = [sheet(0, {"scale": [3.0, 3.0, 1.0]}), sheet(1, {"translation": [0.9, 0.0, 0.5]}),
              (box_behind, facets, 2, None, None)]
    body = Body.from_file(glb(tmp_path / "a.glb", pieces, [material("a", 0.5), material("b", 0.9), material("c", 0.3)]),
                          name="sat", length_unit="m")
    r_camera, lens = np.array([0.0, 0.0, 14.0]), {"distortion": BrownConrady(k1=1e-9)} if has_lens else {}
    camera = views.camera(48, 200.0, **lens)
    state = State(r_sun_inertial_m=AU_M * np.array([0.6, 0.0, 0.8]), bodies={"sat": Pose(r_inertial_m=np.zeros(3))},
                  spacecraft=Pose(r_inertial_m=r_camera, q_from_inertial=frames.look_at(r_camera, np.zeros(3))))
    truth = traced([(part.shape.vertices_m[part.shape.facets], part.brdf) for part in body.parts],
                   views.camera(48, 200.0), state, views.SOLAR_IRRADIANCE_W_M2)
    with Renderer(views.scene([body], [camera], sun_disc=False)) as made:
        image = made.render(state, engine="rays", max_error=0.02)
    light = image.irradiance_W_m2.astype(float)
    assert views.relative_rms(light, truth) < np.hypot(image.plan.predicted_error, 0.016)
    assert abs(light.sum() / truth.sum() - 1.0) < 0.004


@pytest.mark.parametrize("scale, fault", [(0.0, "the camera must be outside body 'sat'"),
                                          (1e11, "body 'sat' must be 1e-09 px across")])
def test_errors_name_the_body(renderer, scale, fault):
    """In a body's middle, and where it is too small."""
    state = looking((8.0, -14.0, 12.0))
    place = Pose(r_inertial_m=scale * state.spacecraft.r_inertial_m, q_from_inertial=state.spacecraft.q_from_inertial)
    with pytest.raises(SceneError, match=fault):
        renderer.render(State(r_sun_inertial_m=state.r_sun_inertial_m, bodies=state.bodies, spacecraft=place))
    with pytest.raises(SceneError, match="state.bodies.sat: missing"):
        renderer.render(State(r_sun_inertial_m=state.r_sun_inertial_m, bodies={}, spacecraft=state.spacecraft))


def test_the_light_of_a_distant_craft_is_that_of_its_parts(renderer, body):
    """From 3 px to far below one: the flux goes with the inverse square of the range, and one body has it."""
    direction, fluxes = np.array([8.0, -14.0, 12.0]), []
    for scale in (30.0, 3000.0):
        image = renderer.render(looking(direction * scale))
        fluxes.append(image.irradiance_W_m2.astype(float).sum() * scale**2)
        assert {name for small in image.small_bodies for name in small.names} <= {"sat"}
    near = renderer.render(looking(direction), max_error=0.01).irradiance_W_m2.astype(float).sum()
    np.testing.assert_allclose(fluxes[0], fluxes[1], rtol=0.01)
    # From 20 m the craft is not far: each of its places is seen from elsewhere.
    np.testing.assert_allclose(fluxes[1], near, rtol=0.15)


@pytest.mark.parametrize("way", WAYS)
def test_plates_of_three_materials_have_the_light_of_their_laws(tmp_path, way):
    """GGX, separable Smith and Schlick, written anew: a metal, and black paints, of which the coat alone reflects."""
    given = [("gold", 0.9, 1.0, 0.5), ("coat", 0.0, 0.0, 0.6), ("steel", 0.5, 1.0, 1.0)]
    sheets = [sheet(k, {"translation": [2.0 * (k - 1), 0.0, 0.0]}) for k in range(3)]
    body = Body.from_file(glb(tmp_path / "a.glb", sheets, [material(*row) for row in given]), name="sat",
                          length_unit="m")
    camera, r_camera = views.camera(160, 2.5e5), np.array([0.0, 0.0, 1.0e4])
    with Renderer(views.scene([body], [camera], sun_disc=False)) as renderer:
        for incidence in np.radians([0.0, 30.0, 60.0]):
            to_sun = np.array([np.sin(incidence), 0.0, np.cos(incidence)])
            light = renderer.render(State(
                r_sun_inertial_m=AU_M * to_sun, bodies={"sat": Pose(r_inertial_m=np.zeros(3))}, spacecraft=Pose(
                    r_inertial_m=r_camera, q_from_inertial=frames.look_at(r_camera, np.zeros(3), np.array([0, 1.0, 0])))
            ), **WAYS[way]).irradiance_W_m2
            for k, (name, base, metal, rough) in enumerate(given):
                column = int(79.5 + 50.0 * (k - 1))
                half = to_sun + [0.0, 0.0, 1.0]
                half /= np.linalg.norm(half)
                alpha2, f0 = rough**4, base if metal else 0.04
                distribution = alpha2 / (np.pi * (half[2] ** 2 * (alpha2 - 1.0) + 1.0) ** 2)
                smith = [1.0 / (mu + np.sqrt(alpha2 + (1.0 - alpha2) * mu * mu)) for mu in (to_sun[2], 1.0)]
                brdf = distribution * smith[0] * smith[1] * (f0 + (1.0 - f0) * (1.0 - half[2]) ** 5)
                want = brdf * to_sun[2] * views.SOLAR_IRRADIANCE_W_M2 / 2.5e5**2
                np.testing.assert_allclose(light[78:82, column - 3:column + 4].mean(), want, rtol=0.01,
                                           err_msg=f"{name} at {np.degrees(incidence):.0f} deg")


@pytest.mark.parametrize("way", WAYS)
def test_an_image_scales_its_materials_albedo(tmp_path, way):
    """Halves of a sheet, seen square on: dark and bright as their linear values, and the other material without."""
    halves = np.repeat([[64, 255]], 4, axis=0).astype(np.uint8).repeat(4, axis=1)
    given = [material("map", baseColorTexture={"index": 0}), material("plain", 0.5)]
    body = Body.from_file(glb(tmp_path / "a.glb", [sheet(0, {"translation": [-1.0, 0.0, 0.0]}, SHEET_UV),
                                                   sheet(1, {"translation": [1.0, 0.0, 0.0]})], given, [png(halves)]),
                          name="sat", length_unit="m",
                          materials={"map": Lambert(normal_albedo=0.8), "plain": Lambert(normal_albedo=0.5)})
    camera = views.camera(96, 3.0e5)
    state = State(r_sun_inertial_m=[0.0, 0.0, AU_M], bodies={"sat": Pose(r_inertial_m=np.zeros(3))},
                  spacecraft=Pose(r_inertial_m=[0.0, 0.0, 1.0e4], q_from_inertial=frames.look_at(
                      np.array([0.0, 0.0, 1e4]), np.zeros(3), np.array([0.0, 1.0, 0.0]))))
    with Renderer(views.scene([body], [camera], sun_disc=False)) as renderer:
        light = renderer.render(state, **WAYS[way]).irradiance_W_m2
    unit = views.SOLAR_IRRADIANCE_W_M2 / np.pi / 3.0e5**2
    # 30 px a metre; +X is to the right.
    columns = [int(47.5 + 30.0 * x) for x in (-1.25, -0.75, 1.0)]
    got = [light[46:50, column - 1:column + 2].mean() / unit for column in columns]
    dark = ((64 / 255.0 + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(got, [0.8 * dark, 0.8, 0.5], rtol=0.005)


def test_gradients_are_refused_by_the_bodys_name(renderer):
    with pytest.raises(ConfigError, match="several materials.*'sat'"):
        renderer.gradient(looking((8.0, -14.0, 12.0)), np.ones((72, 72)))


def test_cycles_refuses_a_panel_of_two_materials(renderer, body):
    """It drew 2.6 times the light, or 0.6: one of two sheets in the same place, whichever side was seen."""
    assert has_two_faces(body) and not has_two_faces(Body(name="sat", shape=body.shape, brdf=GREY))
    with pytest.raises(ConfigError, match="^materials: must be the same on both sides of a sheet.*, got 'sat'; "):
        Cycles(renderer.scene)
