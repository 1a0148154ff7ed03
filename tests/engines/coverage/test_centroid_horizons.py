"""Horizon maps at the centroids of facets: rays are asked wherever azimuths do not tell what stands around."""

from __future__ import annotations

import numpy as np
import pytest
import solids
import views
from cells import slow_but
from glrender import Body, Shape, generate
from glrender.brdf import Lambert
from glrender.engines.coverage.accumulate import ROUNDING, means, no_changes
from glrender.engines.coverage.brdf_tables import BrdfTables
from glrender.engines.coverage.centroid_horizons import CentroidHorizons
from glrender.engines.coverage.centroid_visibility import CentroidVisibility
from glrender.engines.coverage.facet_tables import FacetTables
from glrender.engines.coverage.horizon_loops import UNKNOWN
from glrender.engines.coverage.image_cells import ImageCells
from glrender.engines.rays.engine import RayEngine
from glrender.view.view import view_bodies

GREY = Lambert(normal_albedo=0.3)


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


def ball(radius_m, middle_m, subdivisions):
    made = generate.icosphere(radius_m=radius_m, subdivisions=subdivisions)
    return np.asarray(middle_m) + made.vertices_m, made.facets


def peaks():
    """Forty of 15 m on a ball of 100 m: a smooth surface without an overhang."""
    made, rng = generate.icosphere(radius_m=1.0, subdivisions=6), np.random.default_rng(2)
    radius_m = np.full(len(made.vertices_m), 100.0)
    for towards in rng.standard_normal((40, 3)):
        away_m = 100.0 * np.linalg.norm(made.vertices_m - towards / np.linalg.norm(towards), axis=1)
        radius_m += 15.0 * np.exp(-0.5 * (away_m / 2.0) ** 2)
    return made.vertices_m * radius_m[:, None], made.facets


# Each shape's largest difference, at 20, 60 and 100 degrees, from an image with every ray cast.
SHAPES = {"torus": (lambda: torus(100.0, 40.0, 192, 96), (1e-3, 1e-3, 1e-3)),
          "ring": (lambda: solids.joined(ball(100.0, (0, 0, 0), 5), torus(160.0, 6.0, 256, 32)), (1e-3, 1e-3, 1e-3)),
          "moon": (lambda: solids.joined(ball(100.0, (0, 0, 0), 6), ball(5.0, (30, -115, 90), 4)),
                   (0.015, 0.015, 0.015)),
          "peaks": (peaks, (0.01, 0.01, 0.04))}


def images(body, phase_deg):
    """By centroids (rows, columns), as tables tell and as rays do; the share of centroids that no table tells of."""
    camera = views.camera(128, 1000.0)
    scene = views.scene([body], [camera], sun_disc=False)
    view, = view_bodies(views.state(phase_deg=phase_deg, range_m=20.0 * body.hull.radius_m), camera, scene.hulls)
    rays, drawn = RayEngine(scene), []
    tables = FacetTables(body, rays.solid("body"))
    heights = tables.horizons.heights
    for known in (heights, np.full_like(heights, UNKNOWN)):
        tables.horizons = CentroidHorizons(facets=tables.horizons.facets, heights=known)
        changes, (image, cover) = no_changes((128, 128)), np.empty((2, 128, 128))
        cells = ImageCells(camera, camera.bounds_px, (128, 128))
        CentroidVisibility(tables, view, cells, rays, BrdfTables()).add_to(changes, cells)
        image[image < ROUNDING * means(changes, 0, 128, image, cover)] = 0.0
        drawn.append(image)
    rays.close()
    assert (drawn[1] > 0.0).sum() > 500
    return *drawn, (heights == UNKNOWN).all(axis=1).mean()


@pytest.mark.parametrize("phase_deg", slow_but([20.0, 60.0, 100.0], 1))
@pytest.mark.parametrize("name", SHAPES)
def test_what_azimuths_do_not_tell_rays_are_asked_for(name, phase_deg):
    """What stands above something free, and between two azimuths: a torus was 0.4 wrong, peaks at 100 degrees 0.09."""
    make, most = SHAPES[name]
    image, truth, _ = images(Body(name="body", shape=Shape.from_arrays(*make()), brdf=GREY), phase_deg)
    assert views.relative_rms(image, truth) < most[(20.0, 60.0, 100.0).index(phase_deg)]


@pytest.mark.parametrize("phase_deg", slow_but([60.0, 90.0], 0))
def test_a_real_body_with_a_neck_is_as_rays_say(shared, phase_deg):
    """67P with 128,000 facets, of which a quarter is under its head, or near what is."""
    shape = Shape.from_file(shared / "67p" / "67p-16k.obj", length_unit="km")
    body = Body(name="body", shape=generate.subdivide_with_relief(shape, levels=1, relief=0.02, seed=1), brdf=GREY)
    image, truth, unknown = images(body, phase_deg)
    assert views.relative_rms(image, truth) < 0.02 and 0.1 < unknown < 0.35


def test_tables_tell_of_nearly_all_of_a_rough_body():
    """It has slopes of 20 degrees, and nothing that overhangs."""
    rough = views.rough_body(GREY)
    image, truth, unknown = images(rough, 60.0)
    assert views.relative_rms(image, truth) < 0.01 and unknown < 1e-3


def test_no_tables_are_made_of_a_shape_whose_vertices_move():
    """They would take thirty frames' time; rays show what they do."""
    shape = generate.icosphere(radius_m=100.0, subdivisions=5)
    moved = Body(name="body", shape=shape.with_vertices(shape.vertices_m * [1.0, 0.8, 0.7]), brdf=GREY)
    image, truth, unknown = images(moved, 60.0)
    np.testing.assert_array_equal(image, truth)
    assert unknown == 1.0


def test_heights_are_the_same_wherever_a_search_begins():
    """Of a box on a plate: what rays say at each step, blocked up to a height and free above."""
    shape = solids.several(((-100, -100, -10), (100, 100, 0)), ((20, -30, -5), (60, 30, 35)))
    body = Body(name="body", shape=shape, brdf=GREY)
    rays = RayEngine(views.scene([body], [views.camera()]))
    solid = rays.solid("body")
    x = np.linspace(-90.0, 10.0, 9)
    r_m = np.stack([x, np.full(9, 7.0), np.zeros(9)])
    normal = np.tile([[0.0], [0.0], [1.0]], 9)
    azimuth = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    found = np.empty((9, 16), np.uint8)
    axes = np.tile(np.array([1.0, 0, 0, 0, 1.0, 0])[:, None], 9)
    solid.heights(r_m, normal, axes, np.array([np.cos(azimuth), np.sin(azimuth)]), UNKNOWN, found)
    known = np.flatnonzero((found != UNKNOWN).all(axis=1))
    assert len(known) >= 4
    for i in known:
        for height, angle in zip(found[i].astype(int), azimuth, strict=True):
            for step, is_blocked in ((height, True), (height + 1, False)):
                if 0 < step < 255:
                    sine = step / 255.0
                    flat = np.sqrt(1.0 - sine**2)
                    towards = np.array([flat * np.cos(angle), flat * np.sin(angle), sine])
                    assert solid.blocks(r_m[:, i][None] + [0.0, 0.0, 1e-4], towards)[0] == is_blocked
    rays.close()
