"""Loops over facets, compiled by Numba when this is imported, once on a machine. Vectors are in columns."""

from __future__ import annotations

import math

import numpy as np
from glrender_camera.numba_loops import INDICES, NUMBERS, POINTS, TABLE, VECTOR, compiled, read, write
from numba.types import Tuple, float32, float64, int32, intp, void


@compiled(Tuple((write(intp, 1), write(float64, 1), write(float64, 1), float64))(
    TABLE, read(float64, 1), intp, intp, VECTOR, float64, VECTOR, TABLE, INDICES, VECTOR))
def facing(normal, offset_m, first, last, to_sun, sun_radius, r_camera_m, xy, corners, bounds):
    """Facets (N,) out of first to last that face Sun and camera and are shown.

    With the cosines (N,) of the Sun's incidence, and the shown share of boxes (N,), by the places of their vertices
    (2, V) and the edges x0, y0, x1, y1 of the image; and the area of those that face the camera and that the Sun's
    middle has set for by no more than its radius [rad].
    """
    found, cosines, shown, n = np.empty(last - first, np.intp), np.empty(last - first), np.empty(last - first), 0
    set_area = 0.0
    for facet in range(first, last):
        x, y, z = normal[0, facet], normal[1, facet], normal[2, facet]
        cosine = x * to_sun[0] + y * to_sun[1] + z * to_sun[2]
        if cosine > -sun_radius and x * r_camera_m[0] + y * r_camera_m[1] + z * r_camera_m[2] > offset_m[facet]:
            share, a, b, c = 1.0, corners[0, facet], corners[1, facet], corners[2, facet]
            for axis in range(2):
                low, high = min(xy[axis, a], xy[axis, b], xy[axis, c]), max(xy[axis, a], xy[axis, b], xy[axis, c])
                if low < bounds[axis] or high > bounds[axis + 2]:
                    share *= max(min(high, bounds[axis + 2]) - max(low, bounds[axis]), 0.0) / max(high - low, 1e-300)
            if share > 0.0 and cosine > 0.0:
                found[n], cosines[n], shown[n] = facet, cosine, share
                n += 1
            elif share > 0.0:
                set_area += 0.5 * share * abs((xy[0, b] - xy[0, a]) * (xy[1, c] - xy[1, a])
                                              - (xy[0, c] - xy[0, a]) * (xy[1, b] - xy[1, a]))
    return found[:n].copy(), cosines[:n].copy(), shown[:n].copy(), set_area


@compiled(write(float64, 1)(read(float32, 2), read(float64, 1), read(int32, 2), INDICES, TABLE, VECTOR, intp, VECTOR,
                            VECTOR))
def lit_edges(facets, radiance, neighbours, corners, xy, bounds, every, to_sun, r_camera_m):
    """Light that may be wrong in one of every `every` facets, each all lit or all dark by its radiance (F,).

    Sums (4,): areas and light of lit facets that begin within the edges x0, y0, x1, y1 of the image; and of those
    next to a dark one that faces Sun and camera, squared radiance times the area, and times its square. Of facets whose
    radiance is NaN nothing is known. Facets (F, 6) float32 have normals and centroids [m].
    """
    found = np.zeros(4)
    for facet in range(0, len(radiance), every):
        here = radiance[facet]
        if not here > 0.0:
            continue
        a, b, c = corners[0, facet], corners[1, facet], corners[2, facet]
        if not (bounds[0] <= xy[0, a] <= bounds[2] and bounds[1] <= xy[1, a] <= bounds[3]):
            continue
        area = 0.5 * abs((xy[0, b] - xy[0, a]) * (xy[1, c] - xy[1, a]) - (xy[0, c] - xy[0, a]) * (xy[1, b] - xy[1, a]))
        found[0] += area
        found[1] += area * here
        n_known, is_boundary = 3, False
        for side in range(3):
            across = neighbours[side, facet]
            if across < 0 or radiance[across] > 0.0:
                continue
            if math.isnan(radiance[across]):
                n_known -= 1
                continue
            x, y, z = float(facets[across, 0]), float(facets[across, 1]), float(facets[across, 2])
            if (x * to_sun[0] + y * to_sun[1] + z * to_sun[2] > 0.0
                    and x * (r_camera_m[0] - facets[across, 3]) + y * (r_camera_m[1] - facets[across, 4])
                    + z * (r_camera_m[2] - facets[across, 5]) > 0.0):
                is_boundary = True
        if is_boundary:
            # Where one side is dark it is as likely to be one of those that are not known.
            found[2] += 3 / n_known * area * here**2
            found[3] += 3 / n_known * (area * here) ** 2
    return found


@compiled(Tuple((write(intp, 1), write(intp, 1), write(intp, 2)))(INDICES, NUMBERS, intp))
def vertices_of(corners, facets, n_vertices):
    """Vertices (M,) of facets (N,), one facet (M,) of each, and the numbers (3, N) of the facets' corners."""
    number = np.full(n_vertices, -1, np.intp)
    vertices, of = np.empty(n_vertices, np.intp), np.empty(n_vertices, np.intp)
    places = np.empty((3, len(facets)), np.intp)
    n = 0
    for i in range(len(facets)):
        for corner in range(3):
            vertex = corners[corner, facets[i]]
            if number[vertex] < 0:
                number[vertex], vertices[n], of[n] = n, vertex, facets[i]
                n += 1
            places[corner, i] = number[vertex]
    return vertices[:n].copy(), of[:n].copy(), places


@compiled(Tuple((write(intp, 2), write(intp, 1), write(intp, 1)))(NUMBERS, NUMBERS))
def distinct_pairs(ones, others):
    """Distinct pairs among pairs of numbers (N,), in either order.

    They (2, K), the first (K,) of the N that each is, and which each of the N is.
    """
    n_places = 16
    while n_places < 2 * len(ones):
        n_places *= 2
    places = np.full(n_places, -1, np.intp)
    pairs, first = np.empty((2, len(ones)), np.intp), np.empty(len(ones), np.intp)
    number = np.empty(len(ones), np.intp)
    n = 0
    for i in range(len(ones)):
        low, high = min(ones[i], others[i]), max(ones[i], others[i])
        mixed = low * 0x9E3779B1 + high * 0x85EBCA77
        place = (mixed ^ (mixed >> 15)) & (n_places - 1)
        while True:
            k = places[place]
            if k < 0:
                k = places[place] = n
                pairs[0, k], pairs[1, k], first[k] = ones[i], others[i], i
                n += 1
                break
            if min(pairs[0, k], pairs[1, k]) == low and max(pairs[0, k], pairs[1, k]) == high:
                break
            place = (place + 1) & (n_places - 1)
        number[i] = k
    return pairs[:, :n].copy(), first[:n].copy(), number


@compiled(void(POINTS, intp, intp, POINTS, VECTOR, float64, VECTOR, write(float64, 2)))
def project(r_body_m, first, last, camera_from_body, r_camera_m, focal_length_px, principal_point_px, places):
    """Write places (2, N) [px] of points first to last of some (3, N) [m]; infinitely far off behind the camera."""
    turn = camera_from_body
    for i in range(first, last):
        a, b, c = r_body_m[0, i] - r_camera_m[0], r_body_m[1, i] - r_camera_m[1], r_body_m[2, i] - r_camera_m[2]
        depth = turn[2, 0] * a + turn[2, 1] * b + turn[2, 2] * c
        if not depth > 0.0:
            places[0, i] = places[1, i] = math.inf
            continue
        across = focal_length_px / depth
        for axis in range(2):
            places[axis, i] = principal_point_px[axis] + across * (
                turn[axis, 0] * a + turn[axis, 1] * b + turn[axis, 2] * c)


@compiled(write(float64, 1)(TABLE, INDICES, NUMBERS))
def areas(xy, corners, facets):
    """Areas (N,) in the image of facets (N,) whose vertices are at places (2, V)."""
    found = np.empty(len(facets))
    for i in range(len(facets)):
        a, b, c = corners[0, facets[i]], corners[1, facets[i]], corners[2, facets[i]]
        found[i] = 0.5 * abs((xy[0, b] - xy[0, a]) * (xy[1, c] - xy[1, a])
                             - (xy[0, c] - xy[0, a]) * (xy[1, b] - xy[1, a]))
    return found


@compiled(write(float64, 2)(TABLE, INDICES, NUMBERS, VECTOR))
def to_camera(vertices_m, corners, facets, r_camera_m):
    """Unit vectors (3, N) from the centroids of facets (N,)."""
    found = np.empty((3, len(facets)))
    for i in range(len(facets)):
        a, b, c = corners[0, facets[i]], corners[1, facets[i]], corners[2, facets[i]]
        squared = 0.0
        for axis in range(3):
            found[axis, i] = r_camera_m[axis] - (vertices_m[axis, a] + vertices_m[axis, b] + vertices_m[axis, c]) / 3.0
            squared += found[axis, i] ** 2
        for axis in range(3):
            found[axis, i] /= math.sqrt(squared)
    return found


@compiled(write(float64, 2)(TABLE, INDICES))
def centroids(vertices_m, corners):
    """Centroids (3, F) [m] of facets of corners (3, F) among vertices (3, V)."""
    found = np.empty((3, corners.shape[1]))
    for facet in range(corners.shape[1]):
        a, b, c = corners[0, facet], corners[1, facet], corners[2, facet]
        for axis in range(3):
            found[axis, facet] = (vertices_m[axis, a] + vertices_m[axis, b] + vertices_m[axis, c]) / 3.0
    return found


@compiled(write(int32, 2)(INDICES, intp))
def neighbours(corners, n_vertices):
    """Facets (3, F) across the edges of facets, from each of their corners (3, F) among some vertices to the next.

    -1 where an edge has not exactly two facets that run along it in opposite directions.
    """
    n_sides, n_there = 3 * corners.shape[1], np.zeros(n_vertices, np.int32)
    for side in range(n_sides):
        n_there[corners[side % 3, side // 3]] += 1
    # The sides that have the same end with fewer facets, which a fan's middle has not: one, and which follows each.
    one, following, at = np.full(n_vertices, -1, np.int32), np.empty(n_sides, np.int32), np.empty(n_sides, np.int32)
    for side in range(n_sides):
        low, high = corners[side % 3, side // 3], corners[(side + 1) % 3, side // 3]
        if high < low:
            low, high = high, low
        at[side] = low if n_there[low] <= n_there[high] else high
        following[side], one[at[side]] = one[at[side]], side
    found = np.full((3, corners.shape[1]), -1, np.int32)
    for side in range(n_sides):
        begin, end = corners[side % 3, side // 3], corners[(side + 1) % 3, side // 3]
        other, n_along, across = one[at[side]], 0, -1
        while other >= 0:
            first, last = corners[other % 3, other // 3], corners[(other + 1) % 3, other // 3]
            if first == end and last == begin:
                n_along, across = n_along + 1, other // 3
            elif first == begin and last == end:
                n_along += 1
            other = following[other]
        if n_along == 2:
            found[side % 3, side // 3] = across
    return found
