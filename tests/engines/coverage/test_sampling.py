"""The error of samples by exact areas: of bars narrower than a sample, even, textured and smooth, by closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import solids
import views
from facet_images import facet_image
from glrender import Body, Pose, Renderer, frames, open_renderer
from glrender.base.constants import AU_M, SUN_RADIUS_M
from glrender.brdf import Lambert
from glrender.engines.coverage.facet_tables import FacetTables
from glrender.engines.coverage.image_cells import ImageCells
from glrender.engines.coverage.sampling import SampledAreas
from glrender.engines.rays.engine import RayEngine
from glrender.scene.lamp import Lamp
from glrender.view.view import view_bodies

RANGE_M, LENGTH_PX, SIDE_PX = 1e6, 30.3, 48
LIGHT = views.SOLAR_IRRADIANCE_W_M2 * 0.3 / np.pi * np.cos(0.5) / RANGE_M**2


EVEN = np.ones((8, 16))
CHECKED = 0.3 + 1.4 * (np.indices((32, 64)).sum(axis=0) % 2)


def bar(wide_px, middle_px, *more, texture=None, is_smooth=False):
    """Bars along the image's rows, a metre to a pixel, with their scene and state and their areas (rows, columns)."""
    camera = views.camera(SIDE_PX, RANGE_M)
    at = views.state(direction=(0.0, 0.0, 1.0), range_m=RANGE_M)
    from_body = view_bodies(at, camera, views.scene([views.sphere(Lambert(normal_albedo=0.3), 0)], [camera]).hulls)[0]
    turn, vertices, facets, area = from_body.camera_from_body, [], [], 0.0
    pixel = np.arange(SIDE_PX) - 0.5 * (SIDE_PX - 1)
    for size, middle in ((wide_px, middle_px), *more):
        ends = [np.array([-0.5, 0.5]) * each + place for each, place in ((LENGTH_PX, 0.2), (size, middle))]
        low, high = (np.array([ends[0][k], ends[1][k], 0.0]) for k in range(2))
        made = solids.box((low[0], low[1], 0.0), (high[0], high[1], 1.0))
        facets.append(made[1] + 8 * len(vertices))
        vertices.append(made[0])
        across, down = (np.maximum(np.minimum(end[1], pixel + 0.5) - np.maximum(end[0], pixel - 0.5), 0.0)
                        for end in ends)
        area = area + down[:, None] * across
    # The boxes are laid out in the camera's axes, their near sides at z = 0.
    shape = type(solids.slab()).from_arrays(np.concatenate(vertices) @ turn, np.concatenate(facets))
    body = Body(name="body", shape=shape, brdf=Lambert(normal_albedo=0.3), smooth_normals=is_smooth)
    if texture is not None:
        body = replace(body, albedo_map=texture, albedo_projection={"kind": "equirectangular", "left_edge_deg": -180.0})
    scene = views.scene([body], [camera], sun_disc=False)
    state = replace(at, r_sun_inertial_m=AU_M * np.array([0.0, np.sin(0.5), np.cos(0.5)]))
    return scene, state, area


@pytest.mark.parametrize("count", [1, 2, 5])
def test_samples_differ_from_areas_by_what_they_miss(count):
    """Of a bar of 0.37 px: its areas, less those of the samples that are in it."""
    scene, state, area = bar(0.37, 0.1)
    body, = scene.bodies
    seen = view_bodies(state, scene.cameras[0], scene.hulls)
    cells = ImageCells(scene.cameras[0], scene.cameras[0].bounds_px, (SIDE_PX, SIDE_PX))
    rays = RayEngine(scene)
    tables = FacetTables(body, rays.solid("body"))
    found = SampledAreas([(tables, seen[0])], seen, cells, scene.solar_irradiance_1au_W_m2, rays).missed(count)
    place = (np.arange(SIDE_PX * count) + 0.5) / count - 0.5 * SIDE_PX
    is_in = (np.abs(place - 0.1) < 0.185)[:, None] & (np.abs(place - 0.2) < 0.5 * LENGTH_PX)
    sampled = is_in.reshape(SIDE_PX, count, SIDE_PX, count).mean(axis=(1, 3))
    np.testing.assert_allclose(found / LIGHT, area - sampled, atol=1e-3)


@pytest.mark.parametrize("texture", [None, EVEN])
@pytest.mark.parametrize("engine", ["rays", "raster"])
@pytest.mark.parametrize("wide_px", [0.3, 0.1])
def test_a_bar_narrower_than_samples_is_found_or_its_error_predicted(engine, wide_px, texture):
    """It is between the rows of 2 x 2 samples; the prediction is over the mean of the drawn light, which errs too."""
    scene, state, area = bar(wide_px, 0.52, texture=texture)
    with Renderer(scene) as renderer:
        image = renderer.render(state, engine=engine, max_error=0.02)
    error = views.relative_rms(image.irradiance_W_m2.astype(float), LIGHT * area)
    assert error <= 1.4 * image.plan.predicted_error


@pytest.mark.parametrize("texture", [None, EVEN])
@pytest.mark.parametrize("engine", ["rays", "raster"])
@pytest.mark.parametrize("wide_px", [0.17, 0.11, 0.02])
def test_a_bar_narrower_than_samples_next_to_a_wide_one(engine, wide_px, texture):
    """All contrast is at the wide one: the pixels of the other show none, and have a small part of the light."""
    scene, state, area = bar(15.3, -8.0, (wide_px, 8.5), texture=texture)
    with Renderer(scene) as renderer:
        image = renderer.render(state, engine=engine, max_error=0.02)
    error = views.relative_rms(image.irradiance_W_m2.astype(float), LIGHT * area)
    assert error <= 1.2 * image.plan.predicted_error


@pytest.mark.parametrize("wide_px, middle_px, more", [(0.1, 0.52, ()), (1e-3, 0.501, ()), (15.3, -8.0, ((0.02, 8.5),))])
@pytest.mark.parametrize("hidden", [0.5, 2.0])
def test_in_an_eclipse_a_bar_has_its_error_by_the_light_that_is_left(wide_px, middle_px, more, hidden):
    """A far sphere hides the middle of the Sun, a quarter of its disc, or twice as much as all of it."""
    scene, state, area = bar(wide_px, middle_px, *more)
    to_sun, far_m = state.r_sun_inertial_m / AU_M, 1e6
    other = views.sphere(Lambert(normal_albedo=0.3), 4, hidden * far_m * SUN_RADIUS_M / AU_M, "other")
    state = replace(state, bodies={**state.bodies, "other": Pose(r_inertial_m=far_m * to_sun)})
    with Renderer(replace(scene, bodies=[*scene.bodies, other], sun_disc=True)) as renderer:
        image = renderer.render(state, engine="rays", max_error=0.02)
    truth = max(1.0 - hidden**2, 0.0) * LIGHT * area
    if hidden > 1.0:
        assert not image.irradiance_W_m2.any() and not truth.any()
        # Where no sample meets the bar nobody knows of a shadow.
        assert image.plan.predicted_error < 1e-4 or wide_px < 0.1
    else:
        assert views.relative_rms(image.irradiance_W_m2.astype(float), truth) <= 1.2 * image.plan.predicted_error


@pytest.mark.parametrize("panel_px", [None, 2.0])
@pytest.mark.parametrize("count, middle_px", [(1, 0.5), (2, 0.25), (3, 0.5)])
def test_samples_that_meet_a_thin_bar_make_it_too_bright_by_what_is_predicted(count, middle_px, panel_px):
    """All of a row's samples meet a tenth of a pixel, alone, where the error is known, or with a panel near it."""
    scene, state, area = bar(0.1, middle_px, *([] if panel_px is None else [(panel_px, -8.0)]))
    with Renderer(scene) as renderer:
        image = renderer.render(state, samples=count)
    drawn, truth = image.irradiance_W_m2, LIGHT * area
    error = np.sqrt(((drawn - truth) ** 2).sum() / np.count_nonzero(truth)) / truth[truth > 0.0].mean()
    assert error <= 1.01 * image.plan.predicted_error
    if panel_px is None:
        assert image.plan.predicted_error < 1.5 * error


@pytest.mark.parametrize("kind", [{"texture": CHECKED}, {"is_smooth": True}])
def test_a_dark_image_of_a_textured_or_smooth_bar_has_an_error(kind):
    """By the engine that the plan chooses: the texture is dark at the middles of facets, or smooth normals aslant."""
    scene, state, _ = bar(1e-3, 0.501, **kind)
    with Renderer(scene) as renderer:
        image = renderer.render(state, max_error=0.02)
    assert image.plan.predicted_error > 0.5
    assert any("exceeds max_error" in str(each) for each in image.warnings)


@pytest.mark.parametrize("engine", ["rays", "raster"])
def test_a_bar_that_all_samples_pass_by_is_no_dark_image_without_an_error(engine):
    """A thousandth of a pixel lies between all rows of samples: the whole light is the error."""
    scene, state, area = bar(1e-3, 0.501)
    with Renderer(scene) as renderer:
        image = renderer.render(state, engine=engine, max_error=0.02)
    error = views.relative_rms(image.irradiance_W_m2.astype(float), LIGHT * area)
    assert error > 0.5 and image.plan.predicted_error > 0.5
    assert any("exceeds max_error" in str(each) for each in image.warnings)
    assert [each.path for each in image.warnings if each.code == "dark"] == ["max_error"]


def smooth_image(shape, state, camera, law, n_points=100_000):
    """Irradiance (rows, columns) [W/m2] of a convex body with smooth normals: a sum over points of its facets."""
    at = np.outer([0.7548776662466927, 0.5698402909980532], np.arange(n_points)) % 1.0
    u, v = np.where(at.sum(axis=0) > 1.0, 1.0 - at, at)
    weights = np.stack([1.0 - u - v, u, v])
    r_camera, sun = state.spacecraft.r_inertial_m, state.r_sun_inertial_m / np.linalg.norm(state.r_sun_inertial_m)
    solar = views.SOLAR_IRRADIANCE_W_M2 / (np.linalg.norm(state.r_sun_inertial_m) / AU_M) ** 2
    image = np.zeros((camera.height_px, camera.width_px))
    for facet, flat, area_m2 in zip(shape.facets, shape.facet_normals, shape.facet_areas_m2, strict=True):
        point = weights.T @ shape.vertices_m[facet]
        normal = weights.T @ shape.vertex_normals[facet]
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        to_camera = r_camera - point
        range_m = np.linalg.norm(to_camera, axis=1)
        to_camera /= range_m[:, None]
        # A normal that turns away from the camera is turned back, to a thousandth.
        normal += np.maximum(1e-3 - (normal * to_camera).sum(axis=1), 0.0)[:, None] * to_camera
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        if flat @ sun > 0.0:
            light = solar * law.brdf(sun, to_camera, normal) * np.maximum(normal @ sun, 0.0) * np.maximum(
                to_camera @ flat, 0.0) * area_m2 / len(point) / range_m**2
            column, row = np.rint(camera.project(
                (point - r_camera) @ frames.dcm(state.spacecraft.q_from_inertial).T)).astype(int).T
            np.add.at(image, (row, column), light)
    return image


@pytest.mark.parametrize("max_error", [0.05, 0.005])
@pytest.mark.parametrize("phase_deg", [30.0, 140.0])
def test_a_smooth_needle_of_few_pixels_keeps_its_light(phase_deg, max_error):
    """The middles of its facets are dark at 140 deg, where its corners are not."""
    camera, law = views.camera(8, 400.0), Lambert(normal_albedo=0.3)
    needle = solids.several(((-100.0, -0.3, -0.3), (100.0, 0.3, 0.3)))
    state = views.state(phase_deg=phase_deg, range_m=20e3)
    truth = smooth_image(needle, state, camera, law)
    with Renderer(views.scene([Body(name="body", shape=needle, brdf=law, smooth_normals=True)], [camera])) as renderer:
        image = renderer.render(state, max_error=max_error)
    predicted = image.plan.predicted_error
    assert views.relative_rms(image.irradiance_W_m2, truth) <= predicted + 1e-3 and predicted <= max_error


@pytest.mark.parametrize("max_error", [0.05, 0.005])
@pytest.mark.parametrize("phase_deg", [30.0, 130.0, 140.0])
def test_a_textured_needle_of_few_pixels_keeps_its_light_or_says_what_it_lost(phase_deg, max_error):
    """On a grid of its own, whose samples are farther apart than it is wide, by sums over its facets."""
    camera, law = views.camera(8, 400.0), Lambert(normal_albedo=0.3)
    needle = solids.several(((-100.0, -0.3, -0.3), (100.0, 0.3, 0.3)))
    body = Body(name="body", shape=needle, brdf=law, albedo_map=np.ones((4, 8)),
                albedo_projection={"kind": "equirectangular", "left_edge_deg": -180.0})
    for range_m in (20e3, 60e3):
        state = views.state(phase_deg=phase_deg, range_m=range_m)
        truth = facet_image(needle, state, camera, law)
        with Renderer(views.scene([body], [camera])) as renderer:
            image = renderer.render(state, max_error=max_error)
        predicted = image.plan.predicted_error
        assert views.relative_rms(image.irradiance_W_m2, truth) <= 1.02 * predicted and predicted <= max_error
        assert image.irradiance_W_m2.sum() == pytest.approx(truth.sum(), rel=max_error)


@pytest.mark.parametrize("phase_deg", [60.0, 180.0])
def test_samples_of_a_lamps_light_have_an_error(phase_deg):
    """A convex body alone, by day and night, beneath a lamp: against rays, 24 by 24 a pixel."""
    lamp = Lamp(name="lamp", intensity_W_sr=1e5, half_angle_deg=3.0)
    scene = views.scene([views.sphere(Lambert(normal_albedo=0.3), 1, radius_m=1.0)], [views.camera(64, 300.0)],
                        sun_disc=False, lamps=[lamp])
    state = views.state(phase_deg, range_m=12.0)
    with Renderer(scene) as renderer, open_renderer(scene, "raytrace") as rays:
        image, truth = renderer.render(state, max_error=0.005), rays.render(state, samples=24)
    error = views.relative_rms(image.irradiance_W_m2.astype(float), truth.irradiance_W_m2.astype(float))
    assert error < image.plan.predicted_error < 0.006
