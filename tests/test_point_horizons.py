"""Horizons of vertices in tables: what they tell is what rays say, of what they cannot know they tell nothing."""

from __future__ import annotations

import numpy as np
import pytest
import solids
import views
from glrender import Shape, facet_tables
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
    tables = FacetTables(body, np.zeros(len(body.shape.facets), bool), rays.solid("body"), with_vertices=True)
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


@pytest.mark.parametrize("budget", [0.05, 0.02])
def test_an_image_is_nearly_the_same_where_every_ray_is_cast(rough, budget, monkeypatch):
    """By tables and without: within a thirtieth of the budget."""
    n_looks, look = [0], PointHorizons.look

    def counted(*given):
        n_looks[0] += len(given) == 5
        return look(*given)

    monkeypatch.setattr(PointHorizons, "look", counted)
    camera, state = views.camera(128, 600.0), views.state(phase_deg=60.0, range_m=1500.0)
    scene = views.scene([rough], [camera], sun_disc=False)
    seen, images = view_bodies(state, camera, scene.hulls), []
    for has_tables in (True, False):
        large(monkeypatch)
        rays = RayEngine(scene)
        engine = AreaEngine(scene, rays, is_reference=True)
        full = FacetTables(rough, np.zeros(len(rough.shape.facets), bool), rays.solid("body"), with_vertices=True)
        if not has_tables:
            full.vertices = None
        engine._facets["body"] = [full]
        images.append(engine.draw(("body",), camera, seen, camera.bounds_px, (128, 128), budget)[0])
        engine.close()
        rays.close()
    lit = images[1] > 0.0
    difference = np.sqrt(np.mean((images[0] - images[1])[lit] ** 2)) / images[1][lit].mean()
    assert n_looks == [1] and lit.sum() > 2000 and difference < budget / 30.0
