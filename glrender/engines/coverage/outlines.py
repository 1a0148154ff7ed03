"""Outlines of facets and of their parts in an image's cells: lines that a lens bends are drawn in short pieces."""

from __future__ import annotations

import numpy as np
from glrender_camera.lens_map import LensMap

from ...view.view import BodyView
from . import accumulate
from .facet_tables import FacetTables
from .image_cells import ImageCells
from .sub_triangles import normalised, projected


def add_facets(changes: np.ndarray, cells: ImageCells, facets: FacetTables, view: BodyView, xy_px: np.ndarray,
               radiance: np.ndarray) -> None:
    """Add what facets change in the cells of an image: `accumulate`.

    Parameters
    ----------
    changes : (rows, columns + 2) complex128
    cells : ImageCells
    facets : FacetTables
    view : BodyView
    xy_px : (2, V) float64 [px]
        Places of the facets' vertices.
    radiance : (F,) float64
        0 of a facet that is not drawn. Its part of the changes is real; the cover is imaginary.
    """
    lens = cells.camera.lens_map
    if lens is not None:
        drawn = np.flatnonzero(radiance)
        long = drawn[_are_long(xy_px, facets.corners.take(drawn, axis=1), lens)]
        if len(long):
            xy = normalised(facets.vertices_m, view)
            _add_bent(changes, cells, lens, xy, facets.corners.take(long, axis=1), radiance.take(long) + 1j)
            radiance = radiance.copy()
            radiance[long] = 0.0
    accumulate.in_two_images(changes, np.count_nonzero(radiance), lambda image, *turn: accumulate.add_facets(
        image, xy_px, facets.corners, facets.neighbours, radiance, *turn, cells.origin_px, cells.per_px, 0))


def add_polygons(changes: np.ndarray, cells: ImageCells, view: BodyView, r_body_m: np.ndarray,
                 polygons: list[tuple[np.ndarray, np.ndarray]]) -> None:
    """Add what polygons change in the cells of an image: corners (K, N) among points (3, P) [m], values (N,) complex.

    As `add_facets`.
    """
    xy_px, lens, xy = projected(r_body_m, view, cells.camera), cells.camera.lens_map, None
    for corner, values in polygons:
        if lens is not None:
            is_long = _are_long(xy_px, corner, lens)
            if is_long.any():
                xy = normalised(r_body_m, view) if xy is None else xy
                _add_bent(changes, cells, lens, xy, corner[:, is_long], values[is_long])
                corner, values = corner[:, ~is_long], values[~is_long]
        accumulate.add_polygons(changes, xy_px, corner, values, cells.origin_px, cells.per_px)


def _are_long(xy_px: np.ndarray, corners: np.ndarray, lens: LensMap) -> np.ndarray:
    """Whether polygons (N,) of corners (K, N) have a side that the lens may bend."""
    place = xy_px.take(corners, axis=1)
    return (np.square(np.roll(place, -1, axis=1) - place).sum(axis=0) > lens.straight_px**2).any(axis=0)


def _add_bent(changes: np.ndarray, cells: ImageCells, lens: LensMap, xy: np.ndarray, corners: np.ndarray,
              values: np.ndarray) -> None:
    """Add polygons of corners (K, N) at X / Z, Y / Z (2, P), their sides halved until each piece is straight."""
    begin, end = (xy.take(each, axis=1).reshape(2, -1) for each in (corners, np.roll(corners, -1, axis=0)))
    step = np.tile(values, len(corners))
    places = np.concatenate([lens.places_px(begin), lens.places_px(end)])
    low, high = np.reshape(cells.bounds_px, (2, 2))
    while len(step):
        first, last = places[:2], places[2:]
        length_px = np.sqrt(np.square(last - first).sum(axis=0))
        # A line beyond one side of the cells changes them alike whatever its way, and bends by less than its length.
        beyond = (np.maximum(first, last) + length_px < low[:, None]) | (
            np.minimum(first, last) - length_px > high[:, None])
        is_done = ~(length_px > lens.straight_px) | beyond.any(axis=0)
        accumulate.add_lines(changes, np.ascontiguousarray(places[:, is_done]), step[is_done], cells.origin_px,
                             cells.per_px)
        begin, end, step, places = begin[:, ~is_done], end[:, ~is_done], step[~is_done], places[:, ~is_done]
        middle = 0.5 * (begin + end)
        middle_px = lens.places_px(middle)
        begin, end = np.concatenate([begin, middle], axis=1), np.concatenate([middle, end], axis=1)
        places = np.concatenate([np.concatenate([places[:2], middle_px], axis=1),
                                 np.concatenate([middle_px, places[2:]], axis=1)])
        step = np.tile(step, 2)
