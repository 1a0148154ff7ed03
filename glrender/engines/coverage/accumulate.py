"""Exact means, over an image's cells, of a value that is constant between straight lines, from the lines alone.

Green's theorem, as in the signed-area rasterisers of outline fonts: a line changes what lies to its right in its
row of cells, so that sums along the rows are the image. The cost is that of the cells that lines cross.

Compiled by Numba when this is imported, once on a machine. Values are complex, of two quantities at once. A line's
step is the value at larger x less that at smaller x if the line goes towards larger y, and the reverse if it goes
towards smaller y. Lines around a value are closed.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from glrender_camera import threads
from glrender_camera.numba_loops import INDICES, VECTOR, compiled, read, write
from numba.types import complex128, float64, int32, intp, void

ROUNDING = 1e-12
"""Light that rounding leaves in dark cells, at most, as a share of an image's largest mean."""
# Triangles in a turn of each of the two images that are made at once.
_BLOCK = 4096
_CHANGES = write(complex128, 2)


def no_changes(shape: tuple[int, int]) -> np.ndarray:
    """Changes from cell to cell of an image of (rows, columns) that is dark: with two columns beyond its edge."""
    return np.zeros((shape[0], shape[1] + 2), complex)


@compiled(float64(_CHANGES, intp, intp, write(float64, 2), write(float64, 2)))
def means(changes, first, last, values, cover):
    """Write the means of rows first to last of changes (R, C + 2): their real part and their imaginary one.

    Returns the largest real one. Dark cells keep the rounding: less than `ROUNDING` of the image's largest.
    """
    largest = 0.0
    for row in range(first, last):
        here = 0.0j
        for column in range(values.shape[1]):
            here += changes[row, column]
            values[row, column], cover[row, column] = here.real, here.imag
            largest = max(largest, here.real)
    return largest


@compiled(float64(write(float64, 2), write(float64, 2), intp, intp, float64, float64, read(float64, 1),
                  read(float64, 1)))
def settle(values, cover, first, last, least, scale, across, down):
    """Turn means (R, C) of rows first to last into light: 0 where it is less than the least.

    What the cover exceeds 1 by is taken off. The result is times a scale over (1 + x^2 + y^2)^1.5 by the squares
    `across` (C,) and `down` (R,). Returns the error where areas overlap: the sum of the squares of half of each excess.
    """
    unsure = 0.0
    for row in range(first, last):
        for column in range(values.shape[1]):
            value, covered = values[row, column], cover[row, column]
            if value < least:
                value = 0.0
            elif covered > 1.0:
                unsure += (0.5 * value * (1.0 - 1.0 / covered)) ** 2
                value /= covered
            slant = 1.0 + across[column] + down[row]
            values[row, column] = value * scale / (slant * math.sqrt(slant))
    return unsure


@compiled(void(_CHANGES, intp, intp, float64, complex128))
def _add_in_cell(changes, row, column, middle, change):
    """Add a change to the right of a middle within a cell, and to all cells beyond."""
    beyond = change * (middle - column)
    changes[row, column] += change - beyond
    changes[row, column + 1] += beyond


@compiled(void(_CHANGES, float64, float64, float64, float64, complex128))
def add_line(changes, x0, y0, x1, y1, step):
    """Add the changes that a line from (x0, y0) to (x1, y1) makes."""
    rows, columns = changes.shape[0], changes.shape[1] - 2
    if y1 < y0:
        x0, y0, x1, y1, step = x1, y1, x0, y0, -step
    top, bottom = max(y0, 0.0), min(y1, float(rows))
    # A line whose ends are no numbers, or so far off that they round by parts of a cell, is nowhere.
    if not top < bottom or min(x0, x1) >= columns or not ROUNDING * (abs(x0) + abs(x1) + y1 - y0) < 1.0:
        return
    slope = (x1 - x0) / (y1 - y0)
    x_top = x0 + (top - y0) * slope
    for row in range(int(top), math.ceil(bottom)):
        low = min(row + 1.0, bottom)
        x_low = x0 + (low - y0) * slope
        left, right, height = min(x_top, x_low), max(x_top, x_low), low - top
        top, x_top = low, x_low
        if left >= columns:
            continue
        # All that is left of the image is in its first column.
        if right <= 0.0:
            changes[row, 0] += step * height
            continue
        first, last = math.floor(max(left, 0.0)), math.ceil(min(right, float(columns)))
        if last - first <= 1 and left >= 0.0 and right <= columns:
            _add_in_cell(changes, row, first, 0.5 * (left + right), step * height)
            continue
        per_column = step * (height / (right - left))
        if left < 0.0:
            changes[row, 0] -= per_column * left
        for column in range(first, last):
            begins, ends = max(left, float(column)), min(right, column + 1.0)
            _add_in_cell(changes, row, column, 0.5 * (begins + ends), per_column * (ends - begins))


@compiled(void(_CHANGES, float64, float64, float64, float64, complex128, intp))
def _take_samples_of_line(changes, x0, y0, x1, y1, step, n):
    """Take off what a line from (x0, y0) to (x1, y1) changes in cells of n x n samples each."""
    rows, columns = n * changes.shape[0], n * (changes.shape[1] - 2)
    if y1 < y0:
        x0, y0, x1, y1, step = x1, y1, x0, y0, -step
    if not ROUNDING * (abs(x0) + abs(x1) + abs(y0) + abs(y1)) < 1.0:
        return
    slope, each = (x1 - x0) / max(y1 - y0, 1e-300), step / (n * n)
    for row in range(max(math.ceil(n * y0 - 0.5), 0), min(math.ceil(n * y1 - 0.5), rows)):
        # The first sample beyond the line.
        column = max(math.ceil(n * (x0 + ((row + 0.5) / n - y0) * slope) - 0.5), 0)
        if column < columns:
            changes[row // n, column // n] -= each * (n - column % n)
            changes[row // n, column // n + 1] -= each * (column % n)


@compiled(void(_CHANGES, read(float64, 2), INDICES, read(int32, 2), read(float64, 1), intp, intp, intp, VECTOR,
               VECTOR, intp))
def add_facets(changes, xy, corners, neighbours, radiance, first, block, every, origin, per_px, n):
    """Add what lines around facets that have a radiance (F,) change in cells; one line for two facets that share it.

    The facets are taken in blocks: `block` facets from the `first` on, and from each that is `every` further. With n
    above 0 what n x n samples in each cell meet of them is taken off instead.
    """
    for begin in range(first, len(radiance), every):
        for facet in range(begin, min(begin + block, len(radiance))):
            here = radiance[facet]
            if here == 0.0:
                continue
            for side in range(3):
                across = neighbours[side, facet]
                there = radiance[across] if across >= 0 else 0.0
                if there == 0.0 or facet < across:
                    a, b = corners[side, facet], corners[(side + 1) % 3, facet]
                    step = complex(here - there, 1.0 if there == 0.0 else 0.0)
                    x0, y0 = (xy[0, a] - origin[0]) * per_px[0], (xy[1, a] - origin[1]) * per_px[1]
                    x1, y1 = (xy[0, b] - origin[0]) * per_px[0], (xy[1, b] - origin[1]) * per_px[1]
                    if n == 0:
                        add_line(changes, x0, y0, x1, y1, step)
                    else:
                        _take_samples_of_line(changes, x0, y0, x1, y1, step, n)


@compiled(void(_CHANGES, read(float64, 2), read(intp, 2, "A"), read(complex128, 1), VECTOR, VECTOR))
def add_polygons(changes, xy, corners, values, origin, per_px):
    """Add what lines around polygons change in cells: corners (K, N) at places (2, P) [px], values (N,)."""
    n_corners = len(corners)
    for i in range(len(values)):
        for k in range(n_corners):
            a, b = corners[k, i], corners[(k + 1) % n_corners, i]
            add_line(changes, (xy[0, a] - origin[0]) * per_px[0], (xy[1, a] - origin[1]) * per_px[1],
                     (xy[0, b] - origin[0]) * per_px[0], (xy[1, b] - origin[1]) * per_px[1], values[i])


@compiled(void(_CHANGES, read(float64, 2), read(complex128, 1), VECTOR, VECTOR))
def add_lines(changes, ends, steps, origin, per_px):
    """Add what lines between two places each (4, N) [px], x0, y0, x1, y1, change in cells, by their steps (N,)."""
    for i in range(len(steps)):
        add_line(changes, (ends[0, i] - origin[0]) * per_px[0], (ends[1, i] - origin[1]) * per_px[1],
                 (ends[2, i] - origin[0]) * per_px[0], (ends[3, i] - origin[1]) * per_px[1], steps[i])


def in_two_images(changes: np.ndarray, n_triangles: int, add: Callable[[np.ndarray, int, int, int], None]) -> None:
    """Add triangles by two threads, few by one: to two images whatever the number of threads, for the same bytes.

    Each turn takes a block of triangles from a first one on, and others so many apart: `add` has the image and the
    three numbers.
    """
    images = [changes, np.zeros_like(changes)]
    # To wake a thread for two turns of each image takes longer.
    threads.run(lambda k: add(images[k], k * _BLOCK, _BLOCK, len(images) * _BLOCK), range(len(images)),
                threads.N_CORES if n_triangles > 4 * _BLOCK else 1)
    changes += images[1]
