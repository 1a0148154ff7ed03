"""Points that stand for a large shape's surface: light by closed form and by rays, frames within what plans tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import views
from glrender import Renderer, Shape, facet_tables, generate
from glrender.area_engine import AreaEngine
from glrender.backends.raytrace import RayTracer
from glrender.brdf import Hapke, Lambert
from glrender.costs import EngineCosts
from glrender.facet_tables import FacetTables, point_counts
from glrender.ray_engine import RayEngine
from glrender.render_plan import LevelPlan
from glrender.surface_points import SurfacePoints
from glrender.view import view_bodies
from glrender_camera import threads

GREY = Lambert(normal_albedo=0.3)
HAPKE = Hapke(single_scattering_albedo=0.1, b=0.3, c=0.5, shoe_amplitude=1.0, shoe_width=0.05, roughness_deg=20.0)
COUNTS = (4096, 8192, 16_384, 32_768)
MOST = COUNTS[-1]


@pytest.fixture(autouse=True)
def few(monkeypatch):
    """Points of small shapes: large ones take a minute each."""
    monkeypatch.setattr(facet_tables, "_POINTS", COUNTS)
    monkeypatch.setattr(facet_tables, "_FACETS_PER_POINT", 2)


def points_of(body):
    """A body's points, and its scene in a frame of 64 pixels."""
    scene = views.scene([body], [views.camera(64, 300.0)], sun_disc=False)
    facets = FacetTables(body, np.zeros(len(body.shape.facets), bool), RayEngine(scene).solid("body"))
    return SurfacePoints(facets), scene


def drawn(points, scene, state, n_points, origin_px=(-0.5, -0.5), per_px=1.0, grid=(64, 64)):
    camera, = scene.cameras
    view, = view_bodies(state, camera, scene.hulls)
    return scene.solar_irradiance_of(camera) * points.image(
        n_points, view, camera, 1.0, np.array(origin_px), np.full(2, per_px), grid)


@pytest.fixture(scope="module")
def rough():
    return views.rough_body(GREY)


def test_points_are_of_shapes_that_are_far_larger(monkeypatch):
    monkeypatch.undo()
    counts = [len(point_counts(n_facets)) for n_facets in (390_000, 400_000, 800_000, 1_600_000, 10**8)]
    assert counts == [0, 1, 2, 3, 3]


@pytest.mark.parametrize("phase_deg", [0.0, 60.0, 110.0])
def test_a_sphere_has_the_light_of_its_closed_form(phase_deg):
    """Lambert's phase function, from afar: 2/3 r^2 A / d^2 ((pi - g) cos g + sin g) / pi times the solar irradiance."""
    points, scene = points_of(views.sphere(GREY, subdivisions=6))
    image = drawn(points, scene, views.state(phase_deg=phase_deg, range_m=1e6), MOST)
    phase = np.radians(phase_deg)
    expected = (2.0 / 3.0 * (100.0 / 1e6) ** 2 * 0.3 * ((np.pi - phase) * np.cos(phase) + np.sin(phase)) / np.pi
                * views.SOLAR_IRRADIANCE_W_M2)
    assert image.sum() == pytest.approx(expected, rel=4e-3)


@pytest.mark.parametrize("law", [GREY, HAPKE], ids=lambda law: law.glsl)
@pytest.mark.parametrize("phase_deg", [20.0, 60.0, 100.0])
def test_a_rough_body_is_as_rays_see_it(rough, law, phase_deg):
    """At 6 px; and of fewer points the errors grow as those of samples do."""
    body = replace(rough, brdf=law)
    points, scene = points_of(body)
    errors, fluxes = {count: [] for count in COUNTS}, []
    for direction in ((1, 0, 0), (0, 1, 0.3), (-0.2, -0.4, 1), (0.3, -1, -0.6)):
        state = views.state(phase_deg=phase_deg, range_m=1e4, direction=direction)
        with RayTracer(scene) as tracer:
            truth = tracer.render(state, samples=32).irradiance_W_m2.astype(float)
        for count in COUNTS:
            errors[count].append(views.relative_rms(drawn(points, scene, state, count), truth))
        fluxes.append(drawn(points, scene, state, MOST).sum() / truth.sum())
    rms = [np.sqrt(np.mean(np.square(errors[count]))) for count in COUNTS]
    assert rms[-1] < (0.06 if phase_deg > 90.0 else 0.03) and 2.0 < rms[0] / rms[-1] < 6.0
    assert np.mean(fluxes) == pytest.approx(1.0, abs=0.01) and np.std(fluxes) < 0.01


def test_points_are_even_by_area(rough):
    """Facets of one half are a sixteenth as large: it has as many points all the same."""
    shape = generate.icosphere(radius_m=100.0, subdivisions=5)
    fine = generate.icosphere(radius_m=100.0, subdivisions=7)
    halves = [each.facets[each.vertices_m[each.facets].mean(axis=1)[:, 2] > 0.0] for each in (shape, fine)]
    vertices_m = np.concatenate([shape.vertices_m, fine.vertices_m * [1.0, 1.0, -1.0]])
    both = Shape.from_arrays(vertices_m, np.concatenate([halves[0], halves[1][:, ::-1] + len(shape.vertices_m)]))
    points, _ = points_of(replace(rough, shape=both))
    for count in COUNTS:
        up = points._points[:count, 5] > 0.0
        assert up.mean() == pytest.approx(0.5, abs=2.0 / np.sqrt(count)), count


def test_cells_and_threads_do_not_matter(rough, monkeypatch):
    points, scene = points_of(rough)
    state = views.state(phase_deg=60.0, range_m=2000.0)
    image = drawn(points, scene, state, MOST)
    fine = drawn(points, scene, state, MOST, per_px=4.0, grid=(256, 256))
    assert fine.reshape(64, 4, 64, 4).mean(axis=(1, 3)) == pytest.approx(image, rel=1e-9, abs=1e-15)
    part = drawn(points, scene, state, MOST, origin_px=(19.5, 29.5), grid=(20, 10))
    assert part == pytest.approx(image[30:40, 20:40], rel=1e-12)
    monkeypatch.setattr(threads, "N_CORES", 1)
    assert drawn(points, scene, state, MOST).tobytes() == image.tobytes()


def test_a_frame_by_points_is_within_what_its_plan_tells(rough, monkeypatch):
    """Against rays; the plan says what it left out."""
    scene = views.scene([rough], [views.camera(64, 80.0)], sun_disc=False)
    state = views.state(phase_deg=40.0, range_m=2000.0)
    with Renderer(scene) as renderer, RayTracer(scene) as tracer:
        # Everything else is dear.
        monkeypatch.setattr(renderer, "_costs", EngineCosts(facet_ns=1e4, sample_ns=1e4, ray_ns=1e4, area_ns=128.0))
        monkeypatch.setattr(EngineCosts, "points_ns", lambda *_: 1e3)
        image, again = (renderer.render(state, max_error=0.1) for _ in range(2))
        truth = tracer.render(state, samples=32).irradiance_W_m2.astype(float)
    window, = image.plan.windows
    n_points = window.levels[0].n_points
    assert window.engine == "areas" and n_points in COUNTS and not window.levels[0].tells_error
    assert f"body: all of the surface but {n_points} points" in image.plan.left_out
    assert image.plan.to_dict()["windows"][0]["levels"][0]["n_points"] == n_points
    assert image.irradiance_W_m2.tobytes() == again.irradiance_W_m2.tobytes()
    light = image.irradiance_W_m2.astype(float)
    assert views.relative_rms(light, truth) <= image.plan.predicted_error <= 0.1
    assert light.sum() == pytest.approx(truth.sum(), rel=0.01)


def test_areas_draw_points(rough):
    """With the ratio of the flux, at another distance from the Sun."""
    scene = views.scene([rough], [views.camera(64, 300.0)], sun_disc=False)
    areas = AreaEngine(scene, RayEngine(scene))
    points, _ = points_of(rough)
    areas._points["body"] = points
    near, far = (views.state(range_m=2000.0, sun_distance_au=au) for au in (1.0, 2.0))
    image, told = areas.draw(("body",), scene.cameras[0], view_bodies(far, scene.cameras[0], scene.hulls),
                             (-0.5, -0.5, 63.5, 63.5), (64, 64), 0.1,
                             {"body": LevelPlan(by_middles=True, n_points=COUNTS[0], flux_ratio=1.5)})
    assert told == 0.0 and image == pytest.approx(1.5 / 4.0 * drawn(points, scene, near, COUNTS[0]), rel=1e-5)
