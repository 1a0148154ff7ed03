"""Means over an image's cells of what is constant between straight lines: exact, and by the lines alone.

Green's theorem, as in the signed-area rasterisers of outline fonts: a line changes what lies to its right in its
row of cells, so that sums along the rows are the image. The cost is that of the cells that lines cross.

Compiled by Numba when this is imported, once on a machine. Values are complex, of two quantities at once. A line's
step is what has larger x over what has smaller x beside a line that goes towards larger y; below, beside one that
goes towards smaller y. Lines around a value are closed.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from glrender_camera import threads
from numba.types import complex128, float64, int32, intp, void

from ...base.numba_loops import compiled, inlined, read, write

ROUNDING = 1e-12
"""Of an image's largest mean, what rounding leaves in cells that are dark, at most."""
# Cells.
_FARTHEST = 1e12
# What is divided by when there is nothing to divide.
_TINY = 1e-300
# Triangles in a turn of each of the two images that are made at once; so few that waking a thread takes longer.
_BLOCK = 1 << 12
_FEW = 1 << 14
# Small facets whose shares are worked out at once.
_AT_ONCE = 256
_CHANGES, _NUMBERS, _VALUES, _VECTOR = write(complex128, 2), read(intp, 1), read(complex128, 1), read(float64, 1, "A")
_TABLE = read(float64, 2)


def no_changes(shape: tuple[int, int]) -> np.ndarray:
    """Changes from cell to cell of an image of (rows, columns) that is dark: with two columns for what is beyond."""
    return np.zeros((shape[0], shape[1] + 2), complex)


def cell_means(start: np.ndarray, end: np.ndarray, steps: np.ndarray, shape: tuple[int, int]
               ) -> tuple[np.ndarray, np.ndarray]:
    """Means (rows, columns) float64 over the cells of an image: of the real part, and of the imaginary one.

    Parameters
    ----------
    start, end : (2, E) float64
        Ends of lines, x to the right and y down: the cell of row r and column c is c..c + 1, r..r + 1.
    steps : (E,) complex128
        Across the lines.
    shape : (int, int)
    """
    changes = no_changes(shape)
    for (x0, y0), (x1, y1), step in zip(start.T, end.T, steps, strict=True):
        add_line(changes, x0, y0, x1, y1, step)
    found = np.empty((2, *shape))
    means(changes, 0, shape[0], *found)
    for part in found:
        part[part < ROUNDING * part.max(initial=0.0)] = 0.0
    return found[0], found[1]


@compiled(float64(_CHANGES, intp, intp, write(float64, 2), write(float64, 2)))
def means(changes, first, last, values, cover):
    """Write the means of rows first to last of changes (R, C + 2): their real part and their imaginary one.

    Returns the largest real one. Of what is dark, rounding is left: less than `ROUNDING` of the image's largest.
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
                  read(float64, 1), float64, float64))
def settle(values, cover, first, last, least, scale, across, down, most, least_share):
    """Turn means (R, C) of rows first to last into light: 0 of what is less than the least.

    Where the cover is more than `most`, of what is too much a share is taken off, all where there is twice as much as
    there can be, or more; and all is times a scale over (1 + x^2 + y^2)^1.5 by the squares `across` (C,) and `down`
    (R,). Returns what is unsure where areas overlap: a sum of squares, of half of what is too much.
    """
    unsure = 0.0
    for row in range(first, last):
        for column in range(values.shape[1]):
            value, covered = values[row, column], cover[row, column]
            if value < least:
                value = 0.0
            elif covered > most:
                unsure += (0.5 * value * (1.0 - 1.0 / covered)) ** 2
                value *= 1.0 - max(least_share, min(covered - 1.0, 1.0)) * (1.0 - 1.0 / covered)
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
    # What is no number, or too large for a count of cells, is nowhere.
    if not top < bottom or min(x0, x1) >= columns or not abs(x0) + abs(x1) + y1 - y0 < _FARTHEST:
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


@compiled(void(_CHANGES, read(float64, 2), read(intp, 2), read(int32, 2), _NUMBERS, _VALUES, _VECTOR, _VECTOR))
def add_facets(changes, xy, corners, neighbours, facets, shown, origin, per_px):
    """Add what lines around facets (N,) change in cells; one line for two that share it.

    `shown` (F,) are the values of all facets: 0 of those that are not drawn.
    """
    for i in range(len(facets)):
        facet = facets[i]
        for side in range(3):
            across = neighbours[side, facet]
            there = shown[across] if across >= 0 else 0.0j
            if there == 0.0j or facet < across:
                a, b = corners[side, facet], corners[(side + 1) % 3, facet]
                add_line(changes, (xy[0, a] - origin[0]) * per_px[0], (xy[1, a] - origin[1]) * per_px[1],
                         (xy[0, b] - origin[0]) * per_px[0], (xy[1, b] - origin[1]) * per_px[1], shown[facet] - there)


@compiled(void(_CHANGES, read(float64, 2), read(intp, 2), read(int32, 2), read(float64, 1), intp, intp, intp, _VECTOR,
               _VECTOR))
def add_lit(changes, xy, corners, neighbours, radiance, first, block, every, origin, per_px):
    """The same of all facets that have a radiance (F,): in blocks of so many from a first one on, so many apart."""
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
                    add_line(changes, (xy[0, a] - origin[0]) * per_px[0], (xy[1, a] - origin[1]) * per_px[1],
                             (xy[0, b] - origin[0]) * per_px[0], (xy[1, b] - origin[1]) * per_px[1], step)


@inlined
def _part_below(low, middle, high, edge):
    """Of a triangle between its corners' coordinates in order, the part below an edge that is between them, too."""
    is_lower = edge <= middle
    beyond, side = (edge - low, middle - low) if is_lower else (high - edge, high - middle)
    part = beyond * beyond / (side * (high - low) + _TINY)
    return part if is_lower else 1.0 - part


@inlined
def _twice_below(x0, below0, x1, below1, right):
    """Twice the area between a line and an edge below it, as far as another edge to the right; of ends below it."""
    across = x1 - x0
    slope = (below1 - below0) / (across if across != 0.0 else 1.0)
    beyond0, beyond1 = right - x0 if right < x0 else 0.0, right - x1 if right < x1 else 0.0
    below0 += beyond0 * slope
    below1 += beyond1 * slope
    both = (below0 if below0 > 0.0 else 0.0) + (below1 if below1 > 0.0 else 0.0)
    return (across + beyond1 - beyond0) * both * both / (abs(below0) + abs(below1) + _TINY)


@inlined
def _corner(ax, ay, bx, by, cx, cy, right, bottom):
    """Area of a triangle before an edge to the right and one below."""
    return 0.5 * abs(_twice_below(ax, bottom - ay, bx, bottom - by, right)
                     + _twice_below(bx, bottom - by, cx, bottom - cy, right)
                     + _twice_below(cx, bottom - cy, ax, bottom - ay, right))


@inlined
def _in_order(a, b, c):
    low, high = min(a, min(b, c)), max(a, max(b, c))
    return low, a + b + c - low - high, high


@compiled(void(_CHANGES, float64, float64, float64, float64, float64, float64, complex128))
def _add_wide(changes, ax, ay, bx, by, cx, cy, value):
    """Add a triangle column by column, if it has no more than two rows."""
    x0, x1, x2 = _in_order(ax, bx, cx)
    y0, y1, y2 = _in_order(ay, by, cy)
    area = 0.5 * abs((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))
    # What is no number is nowhere.
    is_within = x0 >= 0.0 and x2 < changes.shape[1] - 2 and y0 >= 0.0 and y2 < changes.shape[0] and area >= 0.0
    if not (is_within and y2 <= math.floor(y0) + 2.0):
        add_line(changes, ax, ay, bx, by, value)
        add_line(changes, bx, by, cx, cy, value)
        add_line(changes, cx, cy, ax, ay, value)
        return
    column, row = int(x0), int(y0)
    right, bottom = column + 1.0, min(row + 1.0, y2)
    below = row + 1 if y2 > row + 1.0 else row
    top = area * _part_below(y0, y1, y2, bottom)
    before, before_below, left, corner = 0.0, 0.0, 0.0, 0.0
    while x2 > right + 1.0:
        next_left = area * _part_below(x0, x1, x2, right)
        next_corner = _corner(ax, ay, bx, by, cx, cy, right, bottom)
        this = next_corner - corner
        this_below = next_left - left - this
        changes[row, column] += (this - before) * value
        changes[below, column] += (this_below - before_below) * value
        before, before_below, left, corner = this, this_below, next_left, next_corner
        column, right = column + 1, right + 1.0
    right = min(right, x2)
    next_left = area * _part_below(x0, x1, x2, right)
    next_corner = _corner(ax, ay, bx, by, cx, cy, right, bottom)
    this, last = next_corner - corner, top - next_corner
    changes[row, column] += (this - before) * value
    changes[row, column + 1] += (last - this) * value
    changes[row, column + 2] -= last * value
    this, last = next_left - left - this, area - next_left - last
    changes[below, column] += (this - before_below) * value
    changes[below, column + 1] += (last - this) * value
    changes[below, column + 2] -= last * value


@inlined
def _find_shares(x, y, n, rows, columns, cell, is_small, part):
    """Of triangles (3, n) in cells' coordinates: the first cell, and the areas of all, in its row, column and in it.

    Without a branch, as processors do it for several at once.
    """
    for i in range(n):
        ax, bx, cx, ay, by, cy = x[0, i], x[1, i], x[2, i], y[0, i], y[1, i], y[2, i]
        x0, x1, x2 = _in_order(ax, bx, cx)
        y0, y1, y2 = _in_order(ay, by, cy)
        column, row = math.floor(x0), math.floor(y0)
        # Of one row or column all is in the first.
        right, bottom = min(column + 1.0, x2), min(row + 1.0, y2)
        area = 0.5 * abs((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))
        part[0, i], part[1, i] = area, area * _part_below(y0, y1, y2, bottom)
        part[2, i] = area * _part_below(x0, x1, x2, right)
        part[3, i] = _corner(ax, ay, bx, by, cx, cy, right, bottom)
        is_small[i] = ((x0 >= 0.0) & (x2 < columns) & (y0 >= 0.0) & (y2 < rows) & (x2 <= column + 2.0)
                       & (y2 <= row + 2.0) & (area >= 0.0))
        cell[0, i], cell[1, i] = np.int32(row), np.int32(column)


@inlined
def _add_shares(changes, x, y, value, n, cell, is_small, part):
    """Add such triangles to four cells each; those that have more column by column. Of no value (n,) nothing."""
    for i in range(n):
        shown = complex(value[i], 1.0 if value[i] != 0.0 else 0.0)
        if not is_small[i]:
            _add_wide(changes, x[0, i], y[0, i], x[1, i], y[1, i], x[2, i], y[2, i], shown)
            continue
        row, column = cell[0, i], cell[1, i]
        area, top, left, corner = part[0, i], part[1, i], part[2, i], part[3, i]
        last = top - corner
        changes[row, column] += corner * shown
        changes[row, column + 1] += (last - corner) * shown
        changes[row, column + 2] -= last * shown
        # Of what ends in the last row nothing is below.
        below, next_row = left - corner, min(row + 1, changes.shape[0] - 1)
        last = area - left - last
        changes[next_row, column] += below * shown
        changes[next_row, column + 1] += (last - below) * shown
        changes[next_row, column + 2] -= last * shown


@compiled(void(_CHANGES, read(float64, 2), read(intp, 2), read(float64, 1), intp, intp, intp, _VECTOR, _VECTOR))
def add_small(changes, xy, corners, radiance, first, block, every, origin, per_px):
    """The same as `add_lit`, sooner where most facets have no more than two columns and two rows of cells.

    Of facets that face the camera: those that do not would count where they are small. By what of each is in which of
    the four, many at a time.
    """
    rows, columns = float(changes.shape[0]), float(changes.shape[1] - 2)
    x, y, value = np.empty((3, _AT_ONCE)), np.empty((3, _AT_ONCE)), np.empty(_AT_ONCE)
    cell, is_small, part = np.empty((2, _AT_ONCE), np.int32), np.empty(_AT_ONCE, np.bool_), np.empty((4, _AT_ONCE))
    for begin in range(first, len(radiance), every):
        facet, end = begin, min(begin + block, len(radiance))
        while facet < end:
            n = 0
            while facet < end and n < _AT_ONCE:
                if radiance[facet] != 0.0:
                    for k in range(3):
                        vertex = corners[k, facet]
                        x[k, n] = (xy[0, vertex] - origin[0]) * per_px[0]
                        y[k, n] = (xy[1, vertex] - origin[1]) * per_px[1]
                    value[n] = radiance[facet]
                    n += 1
                facet += 1
            _find_shares(x, y, n, rows, columns, cell, is_small, part)
            _add_shares(changes, x, y, value, n, cell, is_small, part)


@compiled(void(_CHANGES, read(float64, 2), read(intp, 2, "A"), _VALUES, _VECTOR, _VECTOR))
def add_polygons(changes, xy, corners, values, origin, per_px):
    """Add what lines around polygons change in cells: corners (K, N) at places (2, P) [px], values (N,)."""
    n_corners = len(corners)
    for i in range(len(values)):
        for k in range(n_corners):
            a, b = corners[k, i], corners[(k + 1) % n_corners, i]
            add_line(changes, (xy[0, a] - origin[0]) * per_px[0], (xy[1, a] - origin[1]) * per_px[1],
                     (xy[0, b] - origin[0]) * per_px[0], (xy[1, b] - origin[1]) * per_px[1], values[i])


def in_two_images(changes: np.ndarray, n_triangles: int, add: Callable[[np.ndarray, int, int, int], None]) -> None:
    """Add triangles by two threads, few by one: to two images whatever the number of threads, for the same bytes.

    Each turn takes a block of triangles from a first one on, and others so many apart: `add` has the image and the
    three numbers.
    """
    images = [changes, np.zeros_like(changes)]
    threads.run(lambda k: add(images[k], k * _BLOCK, _BLOCK, len(images) * _BLOCK), range(len(images)),
                threads.N_CORES if n_triangles > _FEW else 1)
    changes += images[1]
