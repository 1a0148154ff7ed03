"""Means over cells by the lines around areas, against polygons that are clipped by each cell."""

from __future__ import annotations

import numpy as np
import pytest
from glrender import generate
from glrender.engines.coverage import facet_loops
from glrender.engines.coverage.accumulate import ROUNDING, add_facets, add_line, means, no_changes, settle


def clipped_area(polygon, row: int, column: int) -> float:
    """Area of a convex polygon (N, 2) in a cell, by Sutherland and Hodgman (1974)."""
    points = [tuple(point) for point in polygon]
    for axis, bound, sign in ((0, column, 1.0), (0, column + 1, -1.0), (1, row, 1.0), (1, row + 1, -1.0)):
        kept = []
        for start, end in zip(points, points[1:] + points[:1], strict=True):
            inside = [sign * (point[axis] - bound) for point in (start, end)]
            if inside[0] >= 0.0:
                kept.append(start)
            if inside[0] * inside[1] < 0.0:
                t = inside[0] / (inside[0] - inside[1])
                kept.append(tuple(a + t * (b - a) for a, b in zip(start, end, strict=True)))
        points = kept
        if not points:
            return 0.0
    x, y = np.array(points).T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def lines_around(polygon, value):
    """Lines of a polygon (N, 2), counter-clockwise as one sees it with y down."""
    points = np.asarray(polygon, float)
    x, y = points.T
    if x @ np.roll(y, -1) - y @ np.roll(x, -1) > 0.0:
        points = points[::-1]
    return points.T, np.roll(points, -1, axis=0).T, np.full(len(points), value, complex)


def cell_means(start, end, steps, shape):
    """Means over cells of what lines from (2, E) to (2, E) with steps (E,) enclose: real and imaginary parts."""
    changes, found = no_changes(shape), np.empty((2, *shape))
    for (x0, y0), (x1, y1), step in zip(start.T, end.T, steps, strict=True):
        add_line(changes, x0, y0, x1, y1, step)
    means(changes, 0, shape[0], *found)
    return [np.where(part < ROUNDING * part.max(initial=0.0), 0.0, part) for part in found]


@pytest.mark.parametrize("size", [0.3, 2.0, 9.0])
def test_triangles_anywhere_cover_what_clipping_says(size):
    rng = np.random.default_rng(1)
    for _ in range(60):
        shape = tuple(int(n) for n in rng.integers(1, 8, 2))
        triangle = rng.uniform(-2.0, 9.0, 2) + size * rng.uniform(-1.0, 1.0, (3, 2))
        truth = [[3.0 * clipped_area(triangle, row, column) for column in range(shape[1])] for row in range(shape[0])]
        np.testing.assert_allclose(cell_means(*lines_around(triangle, 3.0), shape)[0], truth, atol=1e-11)


@pytest.mark.parametrize("polygon", [
    [(1, 1), (4, 1), (4, 3), (1, 3)], [(1.5, 1.0), (1.5, 3.0), (3.25, 3.0), (3.25, 1.0)],
    [(-3, -3), (9, -3), (9, 9), (-3, 9)], [(-5, 1), (-1, 1), (-1, 3)], [(7, 1), (9, 1), (9, 4)],
    [(2, -4), (3, -4), (3, -1)], [(0, 0), (6, 0), (0, 5)], [(2, 2), (2, 2), (3, 3)]],
    ids=["on the lines", "upright", "around it all", "left", "right", "above", "corner to corner", "no area"])
def test_lines_along_cells_and_beside_the_image(polygon):
    truth = [[clipped_area(polygon, row, column) for column in range(6)] for row in range(5)]
    np.testing.assert_allclose(cell_means(*lines_around(polygon, 1.0), (5, 6))[0], truth, atol=1e-13)


def test_what_is_dark_is_zero_and_many_lines_are_as_few():
    """More lines than are taken at a time, of areas that share them: no rounding is left beside them."""
    n = 60
    place = np.linspace(10.0, 50.0, n + 1) + 1e-3 * np.sin(np.arange(n + 1.0))
    squares = [[(place[i], place[j]), (place[i + 1], place[j]), (place[i + 1], place[j + 1]), (place[i], place[j + 1])]
               for i in range(n) for j in range(n)]
    start, end, step = (np.concatenate(each, axis=-1) for each in
                        zip(*(lines_around(square, 0.7) for square in squares), strict=True))
    made = cell_means(start, end, step * (1.0 + 2.0j), (60, 64))
    np.testing.assert_array_equal(made[1], 2.0 * made[0])
    made = made[0]
    np.testing.assert_allclose(made[12:48, 12:48], 0.7, rtol=1e-12)
    lit = np.zeros((60, 64), bool)
    lit[9:51, 9:51] = True
    assert not made[~lit].any() and made.min() == 0.0


def test_no_lines_are_a_dark_image():
    assert not np.any(cell_means(np.zeros((2, 0)), np.zeros((2, 0)), np.zeros(0, complex), (3, 4)))


@pytest.mark.parametrize(("right", "largest", "twice", "half"), [(7, 8.0, 4.0, 2.0), (3.25, 4.25, 3.4, 0.425)])
def test_cells_are_added_up_over_their_cover_and_by_their_solid_angles(right, largest, twice, half):
    """Of two squares of which one is over a part of the other: cover shares it, half of what is too much is unsure.

    Of two whole cells a row; or of a quarter of one.
    """
    rows, columns = 6, 8
    changes = no_changes((rows, columns))
    for square, value in (([(1, 1), (5, 1), (5, 5), (1, 5)], 3.0), ([(3, 1), (right, 1), (right, 3), (3, 3)], 5.0)):
        for (x0, y0), (x1, y1), _ in zip(*(each.T for each in lines_around(square, 1.0)), strict=True):
            add_line(changes, x0, y0, x1, y1, value + 1.0j)
    across, down = 0.1 * np.arange(columns), 0.2 * np.arange(rows)
    image, cover = np.full((2, rows, columns), np.nan)
    assert max(means(changes, first, last, image, cover) for first, last in ((0, 2), (2, rows))) == pytest.approx(
        largest)
    unsure = [settle(image, cover, first, last, 1e-12, 2.0, across, down)
              for first, last in ((0, 2), (2, rows))]
    n_twice = 2 if right == 7 else 1
    expected = np.zeros((rows, columns))
    expected[1:5, 1:5], expected[1:3, 5:7] = 3.0, 5.0 if right == 7 else 0.0
    expected[1:3, 3:3 + n_twice] = twice
    np.testing.assert_allclose(image, 2.0 * expected / (1.0 + across + down[:, None]) ** 1.5, rtol=1e-12)
    # In each of two rows 8 over twice the cover is 4 too much, and 4.25 over 1.25 times the cover 0.85.
    np.testing.assert_allclose(unsure, [n_twice * half**2, n_twice * half**2], rtol=1e-12)


def test_blocks_of_facets_change_cells_as_all_at_once_do(rng):
    """Every block once, the sides that neighbours share once: the cover of facets that have a radiance, and light."""
    shape = generate.icosphere(radius_m=100.0, subdivisions=5)
    corners = np.ascontiguousarray(shape.facets.T, np.intp)
    n_facets, across = corners.shape[1], facet_loops.neighbours(corners, len(shape.vertices_m))
    radiance = np.where(rng.random(n_facets) < 0.5, rng.random(n_facets), 0.0)
    xy = np.ascontiguousarray(shape.vertices_m.T[:2] * 0.25 + 32.0)
    where = np.zeros(2), np.ones(2)
    expected, found = no_changes((64, 64)), no_changes((64, 64))
    for facet in np.flatnonzero(radiance):
        places = xy[:, corners[:, facet]].T
        for start, end in zip(places, np.roll(places, -1, axis=0), strict=True):
            add_line(expected, *start, *end, radiance[facet] + 1j)
    for k in range(3):
        add_facets(found, xy, corners, across, radiance, k * 1000, 1000, 3000, *where, 0)
    np.testing.assert_allclose(found, expected, atol=1e-9)
