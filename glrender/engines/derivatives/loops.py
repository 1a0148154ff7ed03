"""Loops that add what moving lines change in an image's cells, and what cells say of lines, compiled when first called.

A frame is a sum of areas of constant radiance between straight lines. Where both ends of a line move, the radiance of
the cells that it crosses changes by the step in radiance across the line times the area that it sweeps, which is linear
between the ends. What changes in the radiance of areas is added by Green's theorem, as in `coverage.accumulate`. A
gradient follows these lines the other way.
"""

from __future__ import annotations

import math

import numpy as np
from glrender_camera.numba_loops import INDICES, TABLE, VECTOR, called, compiled_when_called, read, write
from numba.types import float32, float64, int32, intp, void

# Distance from a border of cells [px] within which a line lies along it: both sides change by half as much.
_ALONG = 1e-9
_SWEPT, _AREAS, _RATES = write(float64, 3), write(float64, 3), read(float64, 3)
_GRADIENT = write(float64, 2)


@compiled_when_called(write(float64, 3)(TABLE, TABLE, TABLE, VECTOR, float64))
def place_rates(r_camera_m, shifts, turns, stretches, focal_length_px):
    """Rates (P, 2, K) [px] of the places of points (3, P) [m] in `camera`.

    The points shift (K, 3) [m] and turn (K, 3) [rad] about the camera, and the focal length grows (K,) [px].
    """
    count = len(stretches)
    found = np.empty((r_camera_m.shape[1], 2, count))
    for i in range(r_camera_m.shape[1]):
        x, y, z = r_camera_m[0, i], r_camera_m[1, i], r_camera_m[2, i]
        across, down, scale = x / z, y / z, focal_length_px / z
        for k in range(count):
            along = shifts[k, 2] + turns[k, 0] * y - turns[k, 1] * x
            found[i, 0, k] = (scale * (shifts[k, 0] + turns[k, 1] * z - turns[k, 2] * y - across * along)
                              + stretches[k] * across)
            found[i, 1, k] = (scale * (shifts[k, 1] + turns[k, 2] * x - turns[k, 0] * z - down * along)
                              + stretches[k] * down)
    return found


@called
def _add_left(areas, y0, dy, begin, end, steps):
    """Add the changes by the part of a line, between shares of its length, that lies to the left of all cells."""
    rows = areas.shape[0]
    low, high = min(y0 + begin * dy, y0 + end * dy), max(y0 + begin * dy, y0 + end * dy)
    for row in range(max(int(low), 0), min(math.ceil(high), rows)):
        height = min(row + 1.0, high) - max(float(row), low)
        height = height if dy > 0.0 else -height
        for j in range(len(steps)):
            areas[row, 0, j] += steps[j] * height


@called
def _within(x0, y0, dx, dy, rows, columns):
    """Shares of a line's length: its part to the left of cells (R, C), then its part in them, each a begin and an end.

    A part that is not there ends where it begins, or before.
    """
    begin, end = 0.0, 1.0
    if dy != 0.0:
        one, other = -y0 / dy, (rows - y0) / dy
        begin, end = max(begin, min(one, other)), min(end, max(one, other))
    elif not 0.0 <= y0 < rows:
        return 0.0, 0.0, 0.0, 0.0
    if dx > 0.0:
        end = min(end, (columns - x0) / dx)
        inside = min(max(-x0 / dx, begin), end)
        return begin, inside, inside, end
    if dx < 0.0:
        begin = max(begin, (columns - x0) / dx)
        inside = max(min(-x0 / dx, end), begin)
        return inside, end, begin, inside
    if x0 < 0.0:
        return begin, end, 0.0, 0.0
    return 0.0, 0.0, begin, end if x0 < columns else begin


@called
def _first_cell(x, y, dx, dy, rows, columns):
    """Column and row of the first cell (R, C) of a line that enters them at a place, and goes on by (dx, dy)."""
    column, row = int(x), int(y)
    # A line that comes from a border of cells goes on in the cell before it.
    if dx < 0.0 and x <= column:
        column -= 1
    if dy < 0.0 and y <= row:
        row -= 1
    return min(max(column, 0), columns - 1), min(max(row, 0), rows - 1)


@called
def _walk(swept, areas, x0, y0, x1, y1, first, last, step, steps):
    """Follow a line from (x0, y0) to (x1, y1) through the cells (R, C) that it crosses.

    Areas swept (R, C, K) change by the step times the areas that are swept per unit of its length, `first` (K,) at its
    begin and `last` (K,) at its end; sums along rows (R, C + 2, M) by other steps (M,).
    """
    rows, columns = swept.shape[0], swept.shape[1]
    dx, dy = x1 - x0, y1 - y0
    if 0.0 <= min(x0, x1) and 0.0 <= min(y0, y1) and max(x0, x1) < columns and max(y0, y1) < rows:
        column, row = int(x0), int(y0)
        if column == int(x1) and row == int(y1):
            # Most lines are in one cell.
            for k in range(len(first)):
                swept[row, column, k] += 0.5 * step * (first[k] + last[k])
            beyond = dy * (0.5 * (x0 + x1) - column)
            for j in range(len(steps)):
                areas[row, column, j] += steps[j] * (dy - beyond)
                areas[row, column + 1, j] += steps[j] * beyond
            return
    left_begin, left_end, begin, end = _within(x0, y0, dx, dy, rows, columns)
    if len(steps) and left_begin < left_end:
        _add_left(areas, y0, dy, left_begin, left_end, steps)
    if not begin < end:
        return
    column, row = _first_cell(x0 + begin * dx, y0 + begin * dy, dx, dy, rows, columns)
    right, below = 1 if dx > 0.0 else 0, 1 if dy > 0.0 else 0
    per_x, per_y = 1.0 / dx if dx != 0.0 else math.inf, 1.0 / dy if dy != 0.0 else math.inf
    while begin < end:
        at_x = (column + right - x0) * per_x if dx != 0.0 else math.inf
        at_y = (row + below - y0) * per_y if dy != 0.0 else math.inf
        until = max(min(at_x, at_y, end), begin)
        share, half = until - begin, 0.5 * (begin + until)
        for k in range(len(first)):
            swept[row, column, k] += step * share * ((1.0 - half) * first[k] + half * last[k])
        if len(steps):
            height = dy * share
            beyond = height * (x0 + half * dx - column)
            for j in range(len(steps)):
                areas[row, column, j] += steps[j] * (height - beyond)
                areas[row, column + 1, j] += steps[j] * beyond
        begin = until
        if at_x <= at_y:
            column += 2 * right - 1
        else:
            row += 2 * below - 1
        if not (0 <= column < columns and 0 <= row < rows):
            return


@called
def _add_line(swept, areas, xy, rates, a, b, left, top, step, steps, first, last):
    """Add what a line between two points changes, by their places (2, P) [px] and rates (P, 2, K) [px]."""
    x0, y0, x1, y1 = xy[0, a] - left, xy[1, a] - top, xy[0, b] - left, xy[1, b] - top
    # A line whose ends are no numbers is nowhere.
    if not abs(x0) + abs(x1) + abs(y0) + abs(y1) < math.inf:
        return
    dx, dy = x1 - x0, y1 - y0
    for k in range(len(first)):
        first[k] = dx * rates[a, 1, k] - dy * rates[a, 0, k]
        last[k] = dx * rates[b, 1, k] - dy * rates[b, 0, k]
    x, y = float(round(x0)), float(round(y0))
    is_down, is_across = max(abs(x0 - x), abs(x1 - x)) < _ALONG, max(abs(y0 - y), abs(y1 - y)) < _ALONG
    if not (is_down or is_across):
        _walk(swept, areas, x0, y0, x1, y1, first, last, step, steps)
        return
    for j in range(len(steps)):
        steps[j] *= 0.5
    for side in (-_ALONG, _ALONG):
        if is_down:
            _walk(swept, areas, x + side, y0, x + side, y1, first, last, 0.5 * step, steps)
        else:
            _walk(swept, areas, x0, y + side, x1, y + side, first, last, 0.5 * step, steps)


@compiled_when_called(void(_SWEPT, _AREAS, TABLE, _RATES, INDICES, read(int32, 2), TABLE, float64, float64))
def add_facets(swept, areas, xy, rates, corners, neighbours, values, left, top):
    """Add what lines around whole facets change: values (1 + M, F) are radiance and its own changes.

    One line for two facets that share it; the facets of no radiance are not drawn.
    """
    first, last, steps = np.empty(swept.shape[2]), np.empty(swept.shape[2]), np.empty(len(values) - 1)
    for facet in range(values.shape[1]):
        here = values[0, facet]
        if here == 0.0:
            continue
        for side in range(3):
            across = neighbours[side, facet]
            there = values[0, across] if across >= 0 else 0.0
            if there == 0.0 or facet < across:
                for j in range(len(steps)):
                    steps[j] = values[1 + j, facet] - (values[1 + j, across] if there != 0.0 else 0.0)
                _add_line(swept, areas, xy, rates, corners[side, facet], corners[(side + 1) % 3, facet], left, top,
                          here - there, steps, first, last)


@compiled_when_called(void(_SWEPT, _AREAS, TABLE, _RATES, read(intp, 2, "A"), TABLE, float64, float64))
def add_polygons(swept, areas, xy, rates, corners, values, left, top):
    """Add what lines around polygons of corners (C, N) change: values (1 + M, N) are radiance and its own changes."""
    first, last, steps = np.empty(swept.shape[2]), np.empty(swept.shape[2]), np.empty(len(values) - 1)
    for i in range(values.shape[1]):
        for k in range(len(corners)):
            for j in range(len(steps)):
                steps[j] = values[1 + j, i]
            _add_line(swept, areas, xy, rates, corners[k, i], corners[(k + 1) % len(corners), i], left, top,
                      values[0, i], steps, first, last)


@compiled_when_called(void(_SWEPT, TABLE, _RATES, TABLE, float64, float64))
def add_cuts(swept, xy, rates, values, left, top):
    """Add what lines change that move with respect to what they bound: begins, then ends, at places (2, 2 N).

    Their steps in radiance are (1, N).
    """
    first, last, steps = np.empty(swept.shape[2]), np.empty(swept.shape[2]), np.empty(0)
    areas = np.empty((swept.shape[0], swept.shape[1] + 2, 0))
    for i in range(values.shape[1]):
        _add_line(swept, areas, xy, rates, i, i + values.shape[1], left, top, values[0, i], steps, first, last)


@compiled_when_called(void(_SWEPT, _AREAS, read(intp, 1), float64, VECTOR, VECTOR, write(float32, 3, "A")))
def finish(swept, areas, which, scale, across, down, found):
    """Add derivatives (K, R, C): areas swept, and the sums along rows (M,) of those `which` (M,) have any.

    Times a scale over (1 + x^2 + y^2)^1.5 by the squares `across` (C,) and `down` (R,).
    """
    sums = np.empty(len(which))
    for row in range(swept.shape[0]):
        sums[:] = 0.0
        for column in range(swept.shape[1]):
            slant = 1.0 + across[column] + down[row]
            factor = scale / (slant * math.sqrt(slant))
            for j in range(len(which)):
                sums[j] += areas[row, column, j]
                swept[row, column, which[j]] += sums[j]
            for k in range(swept.shape[2]):
                found[k, row, column] += swept[row, column, k] * factor


@called
def _read_line(weights, right, x0, y0, x1, y1):
    """What a line from (x0, y0) to (x1, y1) moves and bounds, of weights of cells (R, C): the reverse of `_walk`.

    The weight of what its begin sweeps, and of what its end does, per unit of area; and that of what lies to its right,
    by the sums `right` (R, C + 1) of the weights from each cell to the end of its row.
    """
    rows, columns = weights.shape[0], weights.shape[1]
    dx, dy = x1 - x0, y1 - y0
    if 0.0 <= min(x0, x1) and 0.0 <= min(y0, y1) and max(x0, x1) < columns and max(y0, y1) < rows:
        column, row = int(x0), int(y0)
        if column == int(x1) and row == int(y1):
            half, beyond = 0.5 * weights[row, column], dy * (0.5 * (x0 + x1) - column)
            return half, half, (dy - beyond) * right[row, column] + beyond * right[row, column + 1]
    at_begin, at_end, of_step = 0.0, 0.0, 0.0
    left_begin, left_end, begin, end = _within(x0, y0, dx, dy, rows, columns)
    if left_begin < left_end and dy != 0.0:
        low, high = y0 + left_begin * dy, y0 + left_end * dy
        low, high, sign = min(low, high), max(low, high), 1.0 if dy > 0.0 else -1.0
        for row in range(max(int(low), 0), min(math.ceil(high), rows)):
            of_step += sign * (min(row + 1.0, high) - max(float(row), low)) * right[row, 0]
    if not begin < end:
        return at_begin, at_end, of_step
    column, row = _first_cell(x0 + begin * dx, y0 + begin * dy, dx, dy, rows, columns)
    over, below = 1 if dx > 0.0 else 0, 1 if dy > 0.0 else 0
    per_x, per_y = 1.0 / dx if dx != 0.0 else math.inf, 1.0 / dy if dy != 0.0 else math.inf
    while begin < end:
        at_x = (column + over - x0) * per_x if dx != 0.0 else math.inf
        at_y = (row + below - y0) * per_y if dy != 0.0 else math.inf
        until = max(min(at_x, at_y, end), begin)
        share, half = until - begin, 0.5 * (begin + until)
        at_begin += weights[row, column] * share * (1.0 - half)
        at_end += weights[row, column] * share * half
        height = dy * share
        beyond = height * (x0 + half * dx - column)
        of_step += (height - beyond) * right[row, column] + beyond * right[row, column + 1]
        begin = until
        if at_x <= at_y:
            column += 2 * over - 1
        else:
            row += 2 * below - 1
        if not (0 <= column < columns and 0 <= row < rows):
            break
    return at_begin, at_end, of_step


@called
def _add_gradient(weights, right, xy, a, b, left, top, step, gradient):
    """Add the derivatives (2, P) by the places of a line's ends, and return that by its step."""
    x0, y0, x1, y1 = xy[0, a] - left, xy[1, a] - top, xy[0, b] - left, xy[1, b] - top
    if not abs(x0) + abs(x1) + abs(y0) + abs(y1) < math.inf:
        return 0.0
    x, y = float(round(x0)), float(round(y0))
    is_down, is_across = max(abs(x0 - x), abs(x1 - x)) < _ALONG, max(abs(y0 - y), abs(y1 - y)) < _ALONG
    if is_down or is_across:
        at_begin, at_end, of_step = 0.0, 0.0, 0.0
        for side in (-_ALONG, _ALONG):
            if is_down:
                found = _read_line(weights, right, x + side, y0, x + side, y1)
            else:
                found = _read_line(weights, right, x0, y + side, x1, y + side)
            at_begin, at_end, of_step = at_begin + 0.5 * found[0], at_end + 0.5 * found[1], of_step + 0.5 * found[2]
    else:
        at_begin, at_end, of_step = _read_line(weights, right, x0, y0, x1, y1)
    dx, dy = step * (x1 - x0), step * (y1 - y0)
    gradient[0, a] -= dy * at_begin
    gradient[1, a] += dx * at_begin
    gradient[0, b] -= dy * at_end
    gradient[1, b] += dx * at_end
    return of_step


_READ = (TABLE, TABLE, TABLE)


@compiled_when_called(void(*_READ, INDICES, read(int32, 2), VECTOR, float64, float64, _GRADIENT, write(float64, 1)))
def facets_gradient(weights, right, xy, corners, neighbours, radiance, left, top, of_places, of_radiance):
    """Add derivatives by the places (2, V) and radiance (F,) of whole facets: the reverse of `add_facets`."""
    for facet in range(len(radiance)):
        here = radiance[facet]
        if here == 0.0:
            continue
        for side in range(3):
            across = neighbours[side, facet]
            there = radiance[across] if across >= 0 else 0.0
            if there == 0.0 or facet < across:
                of_step = _add_gradient(weights, right, xy, corners[side, facet], corners[(side + 1) % 3, facet],
                                       left, top, here - there, of_places)
                of_radiance[facet] += of_step
                if there != 0.0:
                    of_radiance[across] -= of_step


@compiled_when_called(void(*_READ, read(intp, 2, "A"), read(intp, 1, "A"), VECTOR, float64, float64, _GRADIENT,
                           write(float64, 1)))
def polygons_gradient(weights, right, xy, corners, facet, radiance, left, top, of_places, of_radiance):
    """Add derivatives by the places (2, P) of polygons' corners (C, N), and by the radiance (F,) of facets (N,)."""
    for i in range(len(facet)):
        for k in range(len(corners)):
            end = corners[(k + 1) % len(corners), i]
            of_radiance[facet[i]] += _add_gradient(weights, right, xy, corners[k, i], end, left, top,
                                                   radiance[facet[i]], of_places)


@compiled_when_called(void(*_READ, VECTOR, float64, float64, _GRADIENT))
def cuts_gradient(weights, right, xy, steps, left, top, of_places):
    """Add derivatives by the places (2, 2 N) of cuts, begins, then ends, with steps in radiance (N,)."""
    for i in range(len(steps)):
        _add_gradient(weights, right, xy, i, i + len(steps), left, top, steps[i], of_places)
