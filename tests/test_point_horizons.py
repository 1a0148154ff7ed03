"""Horizons of vertices in tables: what they tell is what rays say, of what they cannot know they tell nothing."""

from __future__ import annotations

import numpy as np
import pytest
import solids
import views
from glrender import Body, Shape, area_levels, facet_tables, generate, lod
from glrender.area_engine import AreaEngine
from glrender.brdf import Lambert
from glrender.facet_cutter import _NEAR
from glrender.facet_tables import FacetTables
from glrender.point_horizons import PointHorizons
from glrender.ray_engine import RayEngine
from glrender.view import view_bodies

GREY = Lambert(normal_albedo=0.3)


@pytest.fixture(scope="module")
def rough():
    return views.rough_body(GREY)


def large(monkeypatch):
    """From here on every shape has too many vertices for horizons that are never too low."""
    monkeypatch.setattr(facet_tables, "_MOST_HORIZONS", 0)


def looked_at(body, phase_deg):
    """Tables, facing vertices (N,), what is told of them (2, N), and what rays say (2, N)."""
    camera = views.camera(64, 400.0)
    scene = views.scene([body], [camera], sun_disc=False)
    view, = view_bodies(views.state(phase_deg=phase_deg, range_m=2000.0), camera, scene.hulls)
    rays = RayEngine(scene)
    tables = FacetTables(body, np.zeros(len(body.shape.facets), bool), rays.solid("body"), with_middles=True)
    sun, r_camera_m = view.sun_direction_body, view.r_camera_body_m
    facet = np.flatnonzero((sun @ tables.normal > 0.0) & (r_camera_m @ tables.normal > tables.offset_m))
    vertex, first = np.unique(tables.corners[:, facet], return_index=True)
    of = tables.number.take(np.tile(facet, 3)[first])
    r_m, every = tables.vertices_m.take(vertex, axis=1), np.ones(len(vertex), bool)
    said = np.stack([ask(tables.solid, r_m, of, view, [view], every) for ask in (rays.in_view, rays.in_light)])
    return tables, vertex, tables.vertices.look(vertex, sun, r_camera_m, _NEAR), said


@pytest.mark.parametrize("phase_deg", [30.0, 60.0, 100.0, 130.0])
def test_vertices_are_lit_and_seen_where_rays_say_so(rough, phase_deg, monkeypatch):
    """One in a thousand may differ; rays are asked of a third at most."""
    large(monkeypatch)
    tables, vertex, told, said = looked_at(rough, phase_deg)
    known = told >= 0
    assert tables.horizons is None and len(vertex) > 2000
    assert known.mean() > 0.66 and np.mean((told > 0)[known] != said[known]) < 1e-3
    assert {*np.unique(told)} == {-1, 0, 1}


def test_nothing_is_told_of_vertices_whose_facets_face_all_ways():
    """Two pyramids that share their tip and its vertex: the mean of their normals is none of the surface's."""
    one = np.array([[0, 0, 0], [1, 1, 2], [-1, 1, 2], [-1, -1, 2], [1, -1, 2]], float)
    sides = np.array([[0, 2, 1], [0, 3, 2], [0, 4, 3], [0, 1, 4]])
    vertices = np.concatenate([one, one[1:] * [1.0, 1.0, -1.0]])
    facets = np.concatenate([sides, np.where(sides > 0, sides + 4, 0)[:, ::-1]])
    corners = np.ascontiguousarray(facets.T)
    normal = np.cross(vertices[facets[:, 1]] - vertices[facets[:, 0]], vertices[facets[:, 2]] - vertices[facets[:, 0]])
    found = facet_tables._vertex_normals(corners, (normal / np.linalg.norm(normal, axis=1)[:, None]).T, len(vertices))
    assert (found[:, 0] == 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(found[:, 1:], axis=0), 1.0)
    box = Shape.from_arrays(*solids.box((-1, -1, -1), (1, 1, 1)))
    corner = facet_tables._vertex_normals(np.ascontiguousarray(box.facets.T), box.facet_normals.T, 8)
    assert (np.sign(corner.T) == np.sign(box.vertices_m)).all()


def test_rays_are_asked_below_the_plane_that_heights_are_over():
    """Of what is below the plane across a vertex's normal a table without horizon knows nothing."""
    up = np.array([[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]], np.float32)
    flat = PointHorizons(points=up, heights=np.zeros((1, 16), np.uint8))
    walled = PointHorizons(points=up, heights=np.full((1, 16), 100, np.uint8))
    none = PointHorizons(points=0.0 * up, heights=np.zeros((1, 16), np.uint8))
    far_m, low = np.array([1e6, 2e5, 1e5]), np.array([0.6, 0.0, -0.8])
    for table, seen, lit in ((flat, 1, -1), (walled, 0, 0), (none, -1, -1)):
        np.testing.assert_array_equal(table.look(np.array([0]), low, far_m), [[seen], [lit]])
    high = np.array([0.6, 0.0, 0.8])
    assert walled.look(np.array([0]), high, far_m)[1] == 1
    # Near the horizon rays are asked, so near as is said.
    near = np.array([np.sqrt(1.0 - 0.45**2), 0.0, 0.45])
    assert [walled.look(np.array([0]), near, far_m, within)[1, 0] for within in (None, 32.0)] == [1, -1]


def images(body, camera, state, budget):
    """Of the full shape, by tables of vertices and without; how often tables were looked at, and what is told."""
    scene = views.scene([body], [camera], sun_disc=False)
    seen, drawn, n_looks = view_bodies(state, camera, scene.hulls), [], 0
    look = PointHorizons.look

    def counted(*given):
        nonlocal n_looks
        n_looks += 1
        return look(*given)

    for asks_tables in (True, False):
        rays = RayEngine(scene)
        engine = AreaEngine(scene, rays, is_reference=True)
        full = FacetTables(body, np.zeros(len(body.shape.facets), bool), rays.solid("body"), with_middles=True,
                           asks_tables=asks_tables)
        assert (full.vertices is not None) == asks_tables
        engine._facets["body"] = [full]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(PointHorizons, "look", counted)
            image, told = engine.draw(("body",), camera, seen, camera.bounds_px, (camera.width_px, camera.height_px),
                                      budget)
        drawn.append(image)
        engine.close()
        rays.close()
    return drawn, n_looks, told


@pytest.mark.parametrize("budget", [0.05, 0.02])
def test_an_image_is_nearly_the_same_where_every_ray_is_cast(rough, budget, monkeypatch):
    """By tables and without: within a thirtieth of the budget."""
    large(monkeypatch)
    (image, truth), n_looks, _ = images(rough, views.camera(128, 600.0),
                                        views.state(phase_deg=60.0, range_m=1500.0), budget)
    assert n_looks and np.count_nonzero(truth) > 2000 and views.relative_rms(image, truth) < budget / 30.0


def torus(radius_m, tube_m, n_around, n_across):
    """A ring about the z axis."""
    around, across = (np.arange(n) * (2.0 * np.pi / n) for n in (n_around, n_across))
    out = radius_m + tube_m * np.cos(across)
    vertices = np.stack(np.broadcast_arrays(np.cos(around)[:, None] * out, np.sin(around)[:, None] * out,
                                            tube_m * np.sin(across)), axis=-1).reshape(-1, 3)
    i, j = np.divmod(np.arange(n_around * n_across), n_across)
    number = lambda i, j: i % n_around * n_across + j % n_across  # noqa: E731
    one, beside, across, beyond = number(i, j), number(i + 1, j), number(i + 1, j + 1), number(i, j + 1)
    return vertices, np.concatenate([np.stack([one, beside, across], axis=1), np.stack([one, across, beyond], axis=1)])


def joined(*meshes):
    """(vertices, facets) of several in one."""
    begins = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    return (np.concatenate([vertices for vertices, _ in meshes]),
            np.concatenate([facets + begin for (_, facets), begin in zip(meshes, begins[:-1], strict=True)]))


def boulders():
    """Sixty balls, half sunk into a large one."""
    rng, ball = np.random.default_rng(1), generate.icosphere(radius_m=1.0, subdivisions=3)
    large_one = generate.icosphere(radius_m=100.0, subdivisions=6)
    meshes = [(large_one.vertices_m, large_one.facets)]
    for towards in rng.standard_normal((60, 3)):
        middle_m = 101.0 * towards / np.linalg.norm(towards)
        meshes.append((middle_m + rng.uniform(3.0, 9.0) * ball.vertices_m, ball.facets))
    return joined(*meshes)


def ringed():
    """A ball with a ring around it that touches nothing."""
    ball = generate.icosphere(radius_m=100.0, subdivisions=5)
    return joined((ball.vertices_m, ball.facets), torus(160.0, 6.0, 256, 32))


OVERHANGS = {"torus": lambda: torus(100.0, 40.0, 192, 96), "boulders": boulders, "ring": ringed}


@pytest.mark.parametrize("phase_deg", [20.0, 60.0, 90.0])
@pytest.mark.parametrize("name", OVERHANGS)
def test_what_stands_above_something_free_is_not_missed(name, phase_deg, monkeypatch):
    """A ring's far side, balls half sunk, a ring that floats: within a third of the budget of every ray cast.

    Each point's first step of the sine is free in most azimuths: what is above was told to be, RMS up to 0.8.
    """
    large(monkeypatch)
    monkeypatch.setattr(facet_tables, "_MOST_UNKNOWN", 1.0)
    body = Body(name="body", shape=Shape.from_arrays(*OVERHANGS[name]()), brdf=GREY)
    range_m = 20.0 * body.hull.radius_m
    (image, truth), n_looks, told = images(body, views.camera(96, 800.0),
                                           views.state(phase_deg=phase_deg, range_m=range_m), 0.02)
    assert n_looks and told < 0.02 and views.relative_rms(image, truth) < 0.02 / 3.0


@pytest.mark.parametrize("phase_deg", [60.0, 90.0])
def test_a_real_body_with_a_neck_is_as_rays_say(shared, phase_deg, monkeypatch):
    """67P with 128,000 facets, of whose vertices one in five is under an overhang, or near one."""
    large(monkeypatch)
    shape = generate.subdivide_with_relief(Shape.from_file(shared / "67p" / "67p-16k.obj", length_unit="km"), levels=1,
                                           relief=0.02, seed=1)
    body = Body(name="body", shape=shape, brdf=GREY)
    (image, truth), n_looks, _ = images(body, views.camera(128, 1000.0),
                                        views.state(phase_deg=phase_deg, range_m=20.0 * body.hull.radius_m), 0.02)
    assert n_looks and views.relative_rms(image, truth) < 0.02 / 3.0


def test_a_shape_whose_tables_tell_little_has_none(rough, monkeypatch):
    """Where a quarter of the vertices is under something, the others may be too; nor what others are measured by."""
    large(monkeypatch)
    for body, asks_tables, has_tables in (
            (rough, True, True), (rough, False, False),
            (Body(name="body", shape=Shape.from_arrays(*torus(100.0, 40.0, 128, 64)), brdf=GREY), True, False)):
        rays = RayEngine(views.scene([body], [views.camera()]))
        tables = FacetTables(body, np.zeros(len(body.shape.facets), bool), rays.solid("body"), with_middles=True,
                             asks_tables=asks_tables)
        assert (tables.vertices is not None) == has_tables
        rays.close()


def test_levels_of_detail_are_measured_by_rays_alone(rough, monkeypatch, tmp_path):
    """The full shape is their truth: what its tables missed, no level would be told to err by."""
    large(monkeypatch)
    monkeypatch.setattr(area_levels, "_ASPECTS", 2)
    look, of_full = PointHorizons.look, (len(rough.shape.vertices_m), len(rough.shape.facets))
    monkeypatch.setattr(PointHorizons, "look", lambda table, *given: look(table, *given)
                        if len(table.points) not in of_full else pytest.fail("the full shape's table was asked"))
    shapes, levels = area_levels.area_levels(rough, lod.levels_of_detail(rough.shape)[:1], tmp_path)
    assert len(shapes) == 1 and levels
    scene = views.scene([rough], [views.camera()])
    rays = RayEngine(scene)
    assert AreaEngine(scene, rays, {"body": shapes})._facets["body"][0].vertices is not None
    assert AreaEngine(scene, rays, {"body": shapes}, is_reference=True)._facets["body"][0].vertices is None
