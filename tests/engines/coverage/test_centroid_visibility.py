"""Facets lit or dark by their centroids: horizons by closed form, light by rays, radiance by laws, frames by truth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
import solids
import views
from cells import slow_but
from glrender import Body, Renderer, Shape, generate
from glrender.brdf import GlslText, Hapke, Lambert, Law, LommelSeeliger, Minnaert
from glrender.engines.coverage.brdf_tables import BrdfTables
from glrender.engines.coverage.centroid_horizons import CentroidHorizons
from glrender.engines.coverage.centroid_visibility import CentroidVisibility
from glrender.engines.coverage.engine import CoverageEngine
from glrender.engines.coverage.image_cells import ImageCells
from glrender.engines.rays.backend import RayTracer
from glrender.engines.rays.engine import RayEngine
from glrender.engines.rays.mesh import RayMesh
from glrender.planner.error_budget import Budget
from glrender.scene.surface import Surface
from glrender.view.regions import region
from glrender.view.view import view_bodies
from glrender_camera import threads

GREY = Lambert(normal_albedo=0.3)
LAWS = [GREY, LommelSeeliger(single_scattering_albedo=0.3),
        Hapke(single_scattering_albedo=0.1, b=0.3, c=0.5, shoe_amplitude=1.0, shoe_width=0.05,
              roughness_deg=20.0)]
HIGHLIGHT = """
float brdf(vec3 to_sun, vec3 to_camera, vec3 normal, float albedo_scale)
{
    vec3 bisector = normalize(to_sun + to_camera), aside = cross(normal, bisector);
    if (dot(normal, to_sun) <= 0.0 || dot(normal, to_camera) <= 0.0) return 0.0;
    return albedo_scale * (0.02 + exp(-dot(aside, aside) * law_narrowness));
}
"""


@dataclass(frozen=True, kw_only=True)
class Highlight(Law):
    """A grey surface with a bell-shaped highlight about the bisector of Sun and camera."""

    width_rad: float
    glrender_api: ClassVar[int] = 1
    glsl: ClassVar[str] = GlslText("bell_highlight", HIGHLIGHT)
    uniform_fields: ClassVar[dict] = {"law_narrowness": "float"}

    def lit_brdf(self, geometry):
        bisector = geometry.to_sun + geometry.to_camera
        bisector = bisector / np.linalg.norm(bisector, axis=-1, keepdims=True)
        aside = np.cross(geometry.normal, bisector)
        return 0.02 + np.exp(-(aside**2).sum(axis=-1) / self.width_rad**2)

    def uniforms(self):
        return {"law_narrowness": self.width_rad**-2}


def sphere_flux(law, phase_deg):
    """Light of a sphere of radius 1 m at 1 m, as a share of the Sun's: by quadrature over its normals."""
    mu, weight = np.polynomial.legendre.leggauss(600)
    turn = (np.arange(1200) + 0.5) * 2.0 * np.pi / 1200
    normal = np.stack(np.broadcast_arrays(np.sqrt(1.0 - mu**2)[:, None] * np.cos(turn),
                                          np.sqrt(1.0 - mu**2)[:, None] * np.sin(turn), mu[:, None]), axis=-1)
    sun, camera = np.array([np.cos(np.radians(phase_deg)), np.sin(np.radians(phase_deg)), 0.0]), np.array([1.0, 0, 0])
    light = law.brdf(sun, camera, normal) * np.maximum(normal @ sun, 0.0) * np.maximum(normal @ camera, 0.0)
    return float((light * weight[:, None]).sum() * 2.0 * np.pi / 1200)


@pytest.mark.parametrize("law, phase_deg, by_centroids", slow_but([
    (GREY, 60.0, True), (Highlight(width_rad=0.05), 60.0, False),
    (Minnaert(normal_albedo=0.3, exponent=0.6), 60.0, False), (Highlight(width_rad=0.05), 10.0, False),
    (Highlight(width_rad=2.0), 60.0, True)], 0, 1, 2))
def test_a_table_is_taken_only_of_laws_that_it_holds(law, phase_deg, by_centroids):
    """The flux of a sphere to 0.3 %, by quadrature: facets are clipped where a table would miss the highlight."""
    scene = views.scene([views.sphere(law, subdivisions=5, radius_m=1.0)], [views.camera(128, 5.5e5)], sun_disc=False)
    with Renderer(scene) as renderer:
        image = renderer.render(views.state(phase_deg=phase_deg, range_m=1e4), max_error=0.05)
    window, = image.plan.windows
    assert window.engine == "coverage" and window.by_centroids == by_centroids
    flux = float(image.irradiance_W_m2.sum(dtype=float)) / (views.SOLAR_IRRADIANCE_W_M2 * 1e-8)
    assert flux == pytest.approx(sphere_flux(law, phase_deg), rel=3e-3)


def test_an_error_of_a_table_is_that_of_the_light_of_a_sphere():
    """Flux of a highlight by the table over the law's own, midway between nodes: sums over the facets of a sphere."""
    law = Highlight(width_rad=0.1)
    body, camera = views.sphere(law, subdivisions=5), views.camera(64, 10.0)
    surface, tables, hulls = Surface(body), BrdfTables(), views.scene([body], [camera]).hulls
    view, = view_bodies(views.state(phase_deg=35.0, range_m=1e7), camera, hulls)
    _, first, step = tables.of(surface, view, 100.0, 1.0)
    middle = first + step * (np.floor((np.sqrt(2.0 * np.sin(0.5 * view.phase_rad)) - first) / step) + 0.5)
    phase_deg = np.degrees(2.0 * np.arcsin(0.5 * middle**2))
    view, = view_bodies(views.state(phase_deg=phase_deg, range_m=1e7), camera, hulls)
    middle_m = body.shape.vertices_m[body.shape.facets].mean(axis=1).T
    normal, to_camera = body.shape.facet_normals, view.r_camera_body_m / view.range_m
    free = CentroidHorizons(facets=np.concatenate([normal.T, middle_m]).T.astype(np.float32, order="C"),
                            heights=np.zeros((len(normal), 16), np.uint8))
    found, _, _ = free.shade(view.sun_direction_body, view.r_camera_body_m, tables.of(surface, view, 100.0, 1.0))
    weight = body.shape.facet_areas_m2 * np.maximum(normal @ to_camera, 0.0)
    truth = law.brdf(view.sun_direction_body, to_camera, normal) * np.maximum(normal @ view.sun_direction_body, 0.0)
    rms, flux = tables.errors(surface, view, 100.0)
    error = float((weight * (found - truth)).sum() / (weight * truth).sum())
    assert flux == pytest.approx(abs(error), rel=0.1) and 0.1 < flux < rms


def test_a_table_near_a_body_holds_a_surge_by_few_nodes():
    """One radius and a hundredth from the middle, where phase angles on the body differ by 160 deg: 0.05 % of the flux.

    A table with twice as many nodes is no more than a frame needs, and takes as long again.
    """
    law = Hapke(single_scattering_albedo=0.3, b=0.3, c=0.2, shoe_amplitude=1.0, shoe_width=0.05)
    body, camera, tables = views.sphere(law, subdivisions=4), views.camera(64, 10.0), BrdfTables()
    view, = view_bodies(views.state(phase_deg=60.0, range_m=101.0), camera, views.scene([body], [camera]).hulls)
    table, first, step = tables.of(Surface(body), view, 100.0, 1.0)
    assert tables.errors(Surface(body), view, 100.0)[1] < 5e-4
    assert len(table) < 60 and first + step * (len(table) - 1) > 1.4


@pytest.fixture(scope="module")
def rough():
    return views.rough_body(GREY)


def horizons(shape):
    """Centroids (3, F) of a shape's facets, and their horizons."""
    middle_m = shape.vertices_m[shape.facets].mean(axis=1).T
    return middle_m, CentroidHorizons.of(middle_m, np.ascontiguousarray(shape.facet_normals.T),
                                         RayMesh(shape.vertices_m, shape.facets))


def test_horizons_in_a_walled_yard_are_those_of_its_walls():
    """A floor of two facets within walls 40 m high: the sine of the elevation of their tops, all around."""
    walls = [solids.box(low, high) for low, high in (
        ((-60, -60, 0), (-50, 60, 40)), ((50, -60, 0), (60, 60, 40)), ((-50, -60, 0), (50, -50, 40)),
        ((-50, 50, 0), (50, 60, 40)))]
    floor = solids.box((-50, -50, -10), (50, 50, 0))
    shape = Shape.from_arrays(*solids.joined(floor, *walls))
    middle_m, told = horizons(shape)
    flat = np.flatnonzero((shape.facet_normals[:, 2] > 0.99) & (np.abs(middle_m[2]) < 1e-9))
    assert len(flat) == 2
    for facet in flat:
        x, y = middle_m[:2, facet]
        # Around +z the axes are x and y; azimuths are even on a square around.
        for k, height in enumerate(told.heights[facet]):
            place = k / 4.0
            s, t = ((1.0 - place, place) if place <= 1 else (1.0 - place, 2.0 - place) if place <= 2
                    else (place - 3.0, 2.0 - place) if place <= 3 else (place - 3.0, place - 4.0))
            ray = np.array([s, t]) / np.hypot(s, t)
            away = min((50.0 * np.sign(r) - p) / r for r, p in zip(ray, (x, y), strict=True) if r)
            assert height == pytest.approx(255.0 * 40.0 / np.hypot(40.0, away), abs=1.1), (facet, k)


def test_an_open_plain_and_a_convex_body_have_no_horizon():
    _, told = horizons(generate.icosphere(radius_m=100.0, subdivisions=3))
    assert (told.heights == 0).all()


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.glsl)
@pytest.mark.parametrize("phase_deg", [0.0, 3.0, 60.0, 140.0])
@pytest.mark.parametrize("range_m", [800.0, 1e5])
def test_radiance_of_a_free_facet_is_that_of_its_law(law, phase_deg, range_m):
    """Of each facet of a sphere, from where it is seen, by the area that it shows: to 1 %, 0.3 % on average."""
    body = Body(name="body", shape=generate.icosphere(radius_m=100.0, subdivisions=4), brdf=law)
    camera = views.camera(64, 10.0)
    scene = views.scene([body], [camera], sun_disc=False)
    view, = view_bodies(views.state(phase_deg=phase_deg, range_m=range_m), camera, scene.hulls)
    middle_m, told = horizons(body.shape)
    found, asked, _ = told.shade(view.sun_direction_body, view.r_camera_body_m,
                                 BrdfTables().of(Surface(body), view, 100.0, 1.0))
    to_camera = view.r_camera_body_m - middle_m.T
    to_camera /= np.linalg.norm(to_camera, axis=1, keepdims=True)
    normal, sun = body.shape.facet_normals, view.sun_direction_body
    shown = np.einsum("ij,ij->i", normal, to_camera)
    faces = (normal @ sun > 0.0) & (shown > 0.0)
    expected = np.where(faces, law.brdf(sun, to_camera, normal) * (normal @ sun), 0.0) * shown
    assert len(asked) == 0 and (found[~faces] == 0.0).all() and faces.sum() > 50
    error = np.abs(found * shown - expected)
    assert error.max() < 0.01 * expected.max() and error[faces].mean() < 3e-3 * expected[faces].mean()


class Counted:
    """A surface that counts how often its law is asked."""

    def __init__(self, body):
        self._surface, self.n = Surface(body), 0

    def brdf(self, *given):
        self.n += 1
        return self._surface.brdf(*given)


def test_what_is_known_of_a_surface_is_not_worked_out_again(rough):
    camera, tables, surface = views.camera(64, 400.0), BrdfTables(), Counted(rough)
    scene = views.scene([rough], [camera], sun_disc=False)
    found = []
    for phase_deg, is_new in ((60.0, True), (60.1, False), (30.0, True), (60.0, False)):
        view, = view_bodies(views.state(phase_deg=phase_deg, range_m=2000.0), camera, scene.hulls)
        n_before = surface.n
        found.append(tables.of(surface, view, 100.0, 2.0)[0])
        assert surface.n - n_before == (len(found[-1]) if is_new else 0), phase_deg
    assert found[-1].tobytes() == found[0].tobytes() and all(5 <= len(each) <= 10 for each in found)


@pytest.mark.parametrize("phase_deg", [30.0, 100.0])
def test_centroids_are_lit_and_seen_where_rays_say_so(rough, phase_deg):
    """Of rough facets: 2 % of those that face both differ, of few is asked; so it is for those that are asked."""
    camera = views.camera(64, 400.0)
    scene = views.scene([rough], [camera], sun_disc=False)
    view, = view_bodies(views.state(phase_deg=phase_deg, range_m=2000.0), camera, scene.hulls)
    middle_m, told = horizons(rough.shape)
    normal = rough.shape.facet_normals
    found, asked, is_asked = told.shade(view.sun_direction_body, view.r_camera_body_m,
                                        BrdfTables().of(Surface(rough), view, 100.0, 1.0))
    rays, every = RayEngine(scene), np.arange(len(normal))
    faces = (normal @ view.sun_direction_body > 1e-6) & (
        np.einsum("ij,ij->i", normal, view.r_camera_body_m - middle_m.T) > 1e-6)
    sees = rays.in_view(middle_m, every, view, [view], faces)
    free = rays.in_light(middle_m, every, view, [view], sees)
    known = np.ones(len(normal), bool)
    known[asked] = False
    assert np.mean((found > 0.0)[faces & known] != free[faces & known]) < 0.02
    assert 0.0 < len(asked) < 0.14 * faces.sum() and is_asked.any(axis=0).all()
    assert 0.2 < free[asked].mean() < 0.8, "it is worth asking"


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.glsl)
def test_a_frame_by_centroids_is_within_its_predicted_error(law, rough):
    """Against rays: the image, its flux within a tenth of the budget; the same bytes again; the plan says so."""
    scene = views.scene([replace(rough, brdf=law)], [views.camera(160, 1000.0)], sun_disc=False)
    state, budget = views.state(phase_deg=50.0, range_m=2000.0), 0.07
    with Renderer(scene) as renderer, RayTracer(scene) as tracer:
        image, again = (renderer.render(state, max_error=budget) for _ in range(2))
        truth = tracer.render(state, samples=12).irradiance_W_m2.astype(float)
    window, = image.plan.windows
    assert window.engine == "coverage" and window.by_centroids
    assert image.plan.to_dict()["windows"][0]["by_centroids"]
    assert any("lit or dark by its centroid" in line for line in image.plan.left_out)
    assert image.irradiance_W_m2.tobytes() == again.irradiance_W_m2.tobytes()
    light = image.irradiance_W_m2.astype(float)
    assert views.relative_rms(light, truth) <= image.plan.predicted_error <= budget
    assert light.sum() == pytest.approx(truth.sum(), rel=0.1 * budget)


def engine_of(shape):
    """A scene with a shape alone, and its engine."""
    scene = views.scene([Body(name="body", shape=shape, brdf=GREY)], [views.camera(300, 1000.0)], sun_disc=False)
    return scene, CoverageEngine(scene, RayEngine(scene))


def both(made):
    """Means and error of a coverage image."""
    return made.means, made.error


def whole(camera, seen):
    """Arguments of the engine for a body's region, in pixels."""
    x0, y0, x1, y1 = region(seen, camera)
    return ("body",), seen, ImageCells(camera, (x0 - 0.5, y0 - 0.5, x1 - 0.5, y1 - 0.5), (x1 - x0, y1 - y0))


@pytest.mark.parametrize("kind", ["rough", "binary"])
@pytest.mark.parametrize("size_px", slow_but([40, 240], 1))
def test_boundary_facets_tell_the_error_of_a_frame(rough, kind, size_px):
    """Also of one lobe's shadow on the other, and not far too much: beside facets that are clipped."""
    shape = rough.shape if kind == "rough" else views.binary(2)
    scene, engine = engine_of(shape)
    camera, ratios = views.camera(300, size_px * 10.0), []
    for phase_deg, direction in ((30.0, (1, 0, 0)), (60.0, (0, 1, 0.3)), (90.0, (0.2, -1, 0.5)), (110.0, (1, 1, 0.2)),
                                 (75.0, (-1, 0.4, 0.1))):
        state = views.state(phase_deg=phase_deg, range_m=2000.0, direction=direction)
        given = whole(camera, view_bodies(state, camera, scene.hulls))
        image, told = both(engine.draw_by_centroids(*given, Budget(tolerance=1.0)))
        exact, _ = both(engine.draw(*given, Budget(tolerance=0.004)))
        ratios.append(views.relative_rms(image, exact) / np.hypot(told.rms, 0.003))
    assert 0.2 < np.median(ratios) < 0.8 and max(ratios) < 1.0


def test_a_frame_tells_its_error_before_it_is_drawn(rough):
    """The frame is dark where that exceeds the tolerance."""
    scene, engine = engine_of(rough.shape)
    camera, = scene.cameras
    given = whole(camera, view_bodies(views.state(phase_deg=60.0, range_m=2000.0), camera, scene.hulls))
    image, told = both(engine.draw_by_centroids(*given, Budget(tolerance=1.0)))
    again, told_again = both(engine.draw_by_centroids(*given, Budget(tolerance=1.01 * told.judged)))
    assert told_again == told and told.judged == told.rms > 0.0 and again.tobytes() == image.tobytes()
    dark, unknown = both(engine.draw_by_centroids(*given, Budget(tolerance=0.99 * told.judged)))
    assert not dark.any() and np.isinf(unknown).all(), "it is no image, and may not be taken for the best one"
    strict, error = both(engine.draw_by_centroids(*given, Budget(tolerance=1.0, flux=1e-3)))
    assert error.rms == told.rms and error.judged > told.judged, "by a share of the flux that is a hundredth"
    assert strict.tobytes() == image.tobytes() and np.isinf(engine.draw_by_centroids(
        *given, Budget(tolerance=0.99 * error.judged, flux=0.99e-3 * error.judged)).error).all()


@pytest.mark.parametrize("flux_share", [0.1, 1e-4], ids=["pixels", "flux"])
@pytest.mark.parametrize("size_px", [40.0, 240.0])
def test_one_facet_in_fifteen_tells_the_error_of_all(rough, size_px, flux_share):
    """To a factor of two: squared light of boundaries is in few facets, fewer of which have all their neighbours."""
    scene, engine = engine_of(rough.shape)
    camera = views.camera(300, size_px * 10.0)
    for phase_deg in (40.0, 80.0):
        seen = view_bodies(views.state(phase_deg=phase_deg, range_m=2000.0), camera, scene.hulls)
        few, every = (CentroidVisibility(engine.facets("body"), seen[0], whole(camera, seen)[2], engine._rays,
                                         BrdfTables(), one_in).error(flux_share).judged for one_in in (15, 1))
        assert 0.5 < few / every < 1.5


def test_few_rays_tell_that_millions_would_be_in_vain(monkeypatch):
    """A knobbly ball of 328,000 facets, whose centroids each cost a ray: a fifteenth of them where these do not do."""
    ball = generate.icosphere(radius_m=100.0, subdivisions=7)
    knobs = 1.0 + 0.03 * np.sin(0.2 * ball.vertices_m).prod(axis=1, keepdims=True)
    scene, engine = engine_of(Shape.from_arrays(knobs * ball.vertices_m, ball.facets))
    camera, = scene.cameras
    given = whole(camera, view_bodies(views.state(phase_deg=80.0, range_m=2000.0), camera, scene.hulls))
    asked, in_view = [], engine._rays.in_view
    monkeypatch.setattr(engine._rays, "in_view", lambda *told: asked.append(told[-1].sum()) or in_view(*told))
    error = engine.draw_by_centroids(*given, Budget(tolerance=1.0)).error
    n_all = sum(asked) / (1.0 + 1.0 / 15.0)
    assert 0.0 < error.judged < 0.2 and n_all > 50_000
    few = CentroidVisibility(engine.facets("body"), given[1][0], given[2], engine._rays, BrdfTables(), 15).error(0.1)
    asked.clear()
    engine.draw_by_centroids(*given, Budget(tolerance=0.8 * few.judged))
    assert sum(asked) > n_all, "what misses by a hair may be within it"
    asked.clear()
    dark = engine.draw_by_centroids(*given, Budget(tolerance=0.3 * error.judged))
    assert not dark.means.any() and np.isinf(dark.error).all() and sum(asked) < n_all / 12


def test_the_image_does_not_depend_on_the_number_of_threads(rough, monkeypatch):
    scene, engine = engine_of(rough.shape)
    camera, = scene.cameras
    given = whole(camera, view_bodies(views.state(phase_deg=60.0, range_m=2000.0), camera, scene.hulls))
    image, told = both(engine.draw_by_centroids(*given, Budget(tolerance=1.0)))
    monkeypatch.setattr(threads, "N_CORES", 1)
    again, told_again = both(engine.draw_by_centroids(*given, Budget(tolerance=1.0)))
    assert again.tobytes() == image.tobytes() and told_again == told


@pytest.mark.parametrize("phase_deg", slow_but([60.0, 100.0], 0))
def test_a_frame_whose_boundaries_are_too_long_is_clipped_instead(phase_deg):
    """Its own estimate keeps it within the budget, and its plan says how it was drawn."""
    scene, engine = engine_of(views.binary(2))
    camera, = scene.cameras
    state = views.state(phase_deg=phase_deg, range_m=1500.0, direction=(0.2, -1.0, 0.5))
    given = whole(camera, view_bodies(state, camera, scene.hulls))
    exact, _ = both(engine.draw(*given, Budget(tolerance=0.003)))
    with Renderer(scene) as renderer:
        told = 0.1
        for budget_share, by_centroids in ((1.0, True), (0.8, False)):
            budget = budget_share * told
            image = renderer.render(state, max_error=budget)
            window, = image.plan.windows
            assert window.engine == "coverage" and window.by_centroids == by_centroids
            told = image.plan.predicted_error
            x0, y0, x1, y1 = image.roi
            assert views.relative_rms(image.irradiance_W_m2[y0:y1, x0:x1], exact) < told <= budget
