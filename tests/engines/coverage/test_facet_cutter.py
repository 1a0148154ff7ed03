"""Parts of facets: those that touch share their points, and cuts are where light ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import solids
import views
from glrender import Body, Shape
from glrender.base.constants import AU_M
from glrender.brdf import Lambert
from glrender.engines.coverage import facet_loops
from glrender.engines.coverage.boundary_clip import FacetCutter
from glrender.engines.coverage.facet_tables import FacetTables
from glrender.engines.coverage.sub_triangles import FacetParts, Points
from glrender.engines.rays.engine import RayEngine
from glrender.view.view import view_bodies
from scipy.spatial.transform import Rotation


def cutter(*boxes, phase_deg=0.0, turn_deg=0.0):
    """Of boxes in one shape, seen and lit from above, or from either side: the cutter, and the top of the first.

    Camera and Sun are half of the phase angle off the vertical: towards -x and +x. The first box may be turned about
    the vertical.
    """
    vertices_m, facets = solids.joined(*(solids.box(*ends) for ends in boxes))
    vertices_m[:8] = Rotation.from_euler("z", turn_deg, degrees=True).apply(vertices_m[:8])
    shape = Shape.from_arrays(vertices_m, facets)
    body = Body(name="body", shape=shape, brdf=Lambert(normal_albedo=0.3))
    scene = views.scene([body], [views.camera(64, 1e5)], sun_disc=False)
    half = np.radians(0.5 * phase_deg)
    state = views.state(direction=(-np.sin(half), 0.0, np.cos(half)), range_m=1e5)
    state = replace(state, r_sun_inertial_m=AU_M * np.array([np.sin(half), 0.0, np.cos(half)]))
    (view,) = seen = view_bodies(state, scene.cameras[0], scene.hulls)
    rays = RayEngine(scene)
    tables = FacetTables(body, rays.solid("body"))
    facing = facet_loops.facing(
        tables.normal, tables.offset_m, 0, tables.n_facets, view.sun_direction_body, 0.0, view.r_camera_body_m,
        np.zeros((2, tables.vertices_m.shape[1])), tables.corners, np.array([-1.0, -1.0, 1.0, 1.0]))[0]
    top = facing[tables.corner_m(facing)[:, 2].max(axis=0) == boxes[0][1][2]]
    return FacetCutter(tables, view, seen, rays, top), top


def whole(cut, facets):
    return FacetParts(cut.corner, facets, np.ones(len(facets)))


def lit_m2(cut, polygons):
    """The area of polygons of a cut."""
    r_m = cut.points.r_m.T
    return sum(float(np.abs(np.cross(r_m[b] - r_m[a], r_m[c] - r_m[a])).sum()) / 2.0
               for corner, _ in polygons for a, b, c in
               [(corner[0], corner[k], corner[k + 1]) for k in range(1, len(corner) - 1)])


@pytest.mark.parametrize("n_pairs", [0, 1, 7, 5000])
def test_distinct_pairs_are_those_of_numpy(n_pairs):
    rng = np.random.default_rng(1)
    ones, others = rng.integers(0, 60, (2, n_pairs))
    pairs, first, number = facet_loops.distinct_pairs(ones, others)
    expected = {tuple(sorted(pair)) for pair in zip(ones.tolist(), others.tolist(), strict=True)}
    assert sorted(tuple(sorted(pair)) for pair in pairs.T.tolist()) == sorted(expected)
    np.testing.assert_array_equal(pairs, [ones[first], others[first]])
    np.testing.assert_array_equal(np.sort(pairs[:, number], axis=0), np.sort([ones, others], axis=0))
    for k in range(len(first)):
        assert first[k] == np.flatnonzero(number == k)[0]


def test_points_keep_what_was_before_as_they_grow():
    rng = np.random.default_rng(2)
    points, expected = Points(np.zeros((3, 0)), np.zeros(0, bool), np.zeros(0, bool)), np.zeros((5, 0))
    for n in (1, 0, 3, 50, 2, 400):
        r_m, is_seen, is_lit = rng.random((3, n)), rng.random(n) < 0.5, rng.random(n) < 0.5
        np.testing.assert_array_equal(points.add(r_m, is_seen, is_lit), expected.shape[1] + np.arange(n))
        expected = np.concatenate([expected, [*r_m, is_seen, is_lit]], axis=1)
        np.testing.assert_array_equal([*points.r_m, points.is_seen, points.is_lit], expected)


def test_parts_that_touch_share_their_points():
    """Two facets of a square have four corners; divided in four, nine points; again, twenty-five."""
    cut, top = cutter(((-100, -100, -20), (100, 100, 0)))
    parts = whole(cut, top)
    for n in (4, 9, 25):
        assert len(cut.points.is_seen) == n == len(np.unique(parts.corner))
        parts = cut.quarters(parts)
    np.testing.assert_allclose(parts.area_px.sum(), 2.0)


def test_what_hides_the_middle_of_a_side_is_seen_though_all_corners_are_free():
    """A box above the middle of a slab: the corners of its two facets are seen, the middle of their diagonal is not."""
    cut, top = cutter(((-100, -100, -20), (100, 100, 0)), ((-5, -5, 10), (5, 5, 20)))
    assert cut.points.is_seen.all() and not cut.are_mixed(whole(cut, top)).any()
    parts = cut.quarters(whole(cut, top))
    middle = np.flatnonzero((np.abs(cut.points.r_m[:2]) < 1e-9).all(axis=0))
    assert len(middle) == 1 and not cut.points.is_seen[middle[0]] and not cut.points.is_lit[middle[0]]
    assert cut.are_mixed(parts).any()


@pytest.mark.parametrize("n_bisections", [1, 2, 3, 8])
def test_a_cut_ends_where_the_shadow_does(n_bisections):
    """The lit rest of a square below a box that covers one half: within what so many bisections leave, and 2 %.

    What is cut off is that much larger than its edge tells, as natural edges of light bend.
    """
    cut, top = cutter(((-100, -100, -20), (100, 100, 0)), ((0, -200, 10), (200, 200, 20)))
    lit, triangles = cut.sorted(cut.quarters(cut.quarters(whole(cut, top))))
    assert len(triangles.facet)
    polygons = [(lit.corner, lit.facet), *cut.cut_off(triangles, n_bisections)]
    ends = np.concatenate([cut.points.r_m[0, corner].ravel() for corner, _ in polygons])
    most = 0.5 ** (n_bisections + 1) + 0.02
    assert -100.0 <= ends.min() and ends.max() <= 50.0 * most
    assert abs(lit_m2(cut, polygons) - 200.0 * 100.0) <= 200.0 * 50.0 * most


def test_what_hides_a_side_does_not_hide_what_is_beside_it():
    """Bars of 8 m over two sides of a triangle of 200 m hide two of its corners and all of a side, and little else."""
    bars = ((-90, -104, 10), (104, -96, 20)), ((96, -90, 30), (104, 200, 40))
    cut, top = cutter(((-100, -100, -20), (100, 100, 0)), *bars)
    triangles = whole(cut, top)
    chosen = np.flatnonzero(cut.points.r_m.take(triangles.corner, axis=1)[0].sum(axis=0) > 0.0)
    assert len(chosen) == 1
    polygons = cut.cut_off(triangles.at(chosen), 3)
    exact = 200.0**2 / 2.0 - 2.0 * 4.0 * 200.0
    assert 0.6 * exact < lit_m2(cut, polygons) < 1.1 * exact


@pytest.mark.parametrize("wide_m", [20.0, 60.0, 90.0])
def test_what_an_edge_that_bends_cuts_off_is_larger_than_its_chord(wide_m):
    """A box over a square in the corner of a triangle: its chord, between the triangle's sides, has half of it."""
    cut, top = cutter(((-100, -100, -20), (100, 100, 0)), ((100 - wide_m, -200, 10), (200, -100 + wide_m, 20)))
    triangles = whole(cut, top)
    mixed = triangles.at(np.flatnonzero(cut.are_mixed(triangles)))
    corners_m = cut.points.r_m.take(mixed.corner, axis=1)[:2]
    at_right_angle = (corners_m == np.array([100.0, -100.0])[:, None, None]).all(axis=0).any(axis=0)
    (chosen,) = np.flatnonzero(at_right_angle & (cut.are_lit(mixed).sum(axis=0) == 2))
    polygons = cut.cut_off(mixed.at(np.array([chosen])), 10)
    assert 0.75 * wide_m**2 < 200.0**2 / 2.0 - lit_m2(cut, polygons) < 1.05 * wide_m**2


@pytest.mark.parametrize("end_m", [20.0, 50.0])
def test_what_a_straight_edge_cuts_off_is_a_little_larger(end_m):
    """A box covers all beyond a line that is parallel to a side of both facets, of which one and two corners are lit.

    What is lit of the one is 1.01 times as large, what is dark of the other 1.02 times, as natural edges leave them.
    """
    cut, top = cutter(((-100, -100, -20), (100, 100, 0)), ((end_m, -200, 10), (200, 200, 20)))
    triangles = whole(cut, top)
    n_lit = cut.are_lit(triangles).sum(axis=0)
    for corners, lit_share in ((1, 1.01 * (0.5 * (1.0 + end_m / 100.0)) ** 2),
                               (2, 1.0 - 1.02 * (0.5 * (1.0 - end_m / 100.0)) ** 2)):
        (chosen,) = np.flatnonzero(n_lit == corners)
        polygons = cut.cut_off(triangles.at(np.array([chosen])), 14)
        assert sum(len(facet) for _, facet in polygons) == 1
        assert lit_m2(cut, polygons) == pytest.approx(lit_share * 200.0**2 / 2.0, rel=1e-3)


@pytest.mark.parametrize("turn_deg", [-25.0, -10.0, 15.0, 30.0])
def test_a_cut_is_as_oblique_as_the_edge(turn_deg):
    """Facets that are turned below a box that covers all beyond a line: cuts end on their sides where that is."""
    cut, top = cutter(((-100, -100, -20), (100, 100, 0)), ((20.0, -400, 10), (400, 400, 20)), turn_deg=turn_deg)
    triangles, n_vertices = whole(cut, top), len(cut.points.is_lit)
    polygons = cut.cut_off(triangles.at(np.flatnonzero(cut.are_mixed(triangles))), 14)
    ends_m = np.concatenate([cut.points.r_m[0, corner[corner >= n_vertices]] for corner, _ in polygons])
    assert len(ends_m) == 4 and n_vertices == 4
    np.testing.assert_allclose(ends_m, 20.0, atol=5.0)
    assert np.ptp(cut.points.r_m[1, n_vertices:]) > 150.0


def test_what_faces_both_is_found_in_parts_with_what_is_shown_of_it():
    """Of random triangles, against NumPy: the share of their boxes in a window, none beside it, parts in order."""
    rng = np.random.default_rng(4)
    n_facets = 400
    normal, offset_m = rng.standard_normal((3, n_facets)), rng.standard_normal(n_facets)
    r_camera_m = np.array([3.0, 1.0, 2.0])
    to_sun, xy = np.array([0.6, 0.0, 0.8]), rng.uniform(-10.0, 30.0, (2, 300))
    corners, bounds = rng.integers(0, 300, (3, n_facets)), np.array([0.0, -5.0, 20.0, 12.0])
    parts = [facet_loops.facing(normal, offset_m, first, last, to_sun, 0.1, r_camera_m, xy, corners, bounds)
             for first, last in ((0, 150), (150, 150), (150, n_facets))]
    *parts, set_px = zip(*parts, strict=True)
    found, cosine, shown = (np.concatenate(each) for each in parts)
    low, high = (join(xy[:, corners], axis=1) for join in (np.min, np.max))
    inside = np.minimum(high, bounds[2:, None]) - np.maximum(low, bounds[:2, None])
    share = np.prod(np.maximum(inside, 0.0) / (high - low), axis=0)
    faces = (to_sun @ normal > 0.0) & (r_camera_m @ normal > offset_m) & (share > 0.0)
    np.testing.assert_array_equal(found, np.flatnonzero(faces))
    np.testing.assert_allclose(cosine, (to_sun @ normal)[faces], rtol=1e-12)
    np.testing.assert_allclose(shown, share[faces], rtol=1e-12)
    assert 20 < (shown < 1.0).sum() < len(found)
    cosines = to_sun @ normal
    is_set = (cosines > -0.1) & (cosines <= 0.0) & (r_camera_m @ normal > offset_m)
    (ax, ay), (bx, by), (cx, cy) = xy[:, corners].transpose(1, 0, 2)
    area = 0.5 * np.abs((bx - ax) * (cy - ay) - (cx - ax) * (by - ay))
    np.testing.assert_allclose(sum(set_px), (share * area)[is_set].sum(), rtol=1e-12)
