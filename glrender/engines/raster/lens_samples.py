"""Samples behind a lens that distorts: each is interpolated between four denser ones of a rectilinear image."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from glrender_camera import PinholeCamera

Bounds = tuple[float, float, float, float]
# Samples of the rectilinear image along one that is wanted: what four of them blur is far narrower than a pixel.
_FINER = 2.0
# Places along the sides of a grid that bound its directions.
_NODES = 9
# Rows whose places are looked up at once.
_ROWS = 64


def lens_samples(draw: Callable[[PinholeCamera, Bounds, tuple[int, int], np.ndarray | None], np.ndarray],
                 camera: PinholeCamera, bounds_px: Bounds, grid: tuple[int, int], mask: np.ndarray | None,
                 most: tuple[int, int]) -> np.ndarray:
    """Samples of a grid in the image of a camera that distorts.

    Parameters
    ----------
    draw : callable
        Draws samples (rows, columns) [W/m2 per pixel] of a rectilinear camera, within bounds [px], of a grid, and in
        pixels of a mask (rows, columns) uint8, if there is one.
    camera : PinholeCamera
        Distorts.
    bounds_px : (x0, y0, x1, y1) float [px]
    grid : (int, int)
        Samples across and down.
    mask : (rows, columns) uint8, optional
        Pixels, of a whole number of samples each, that are wanted.
    most : (int, int)
        Most samples along a side that may be drawn, and in all.

    Returns
    -------
    (rows, columns) float32 [W/m2 per pixel]
        0 where no direction is imaged.
    """
    (columns, rows), (x0, y0, x1, y1), ideal = grid, bounds_px, camera.rectilinear
    x = x0 + (np.arange(columns) + 0.5) * (x1 - x0) / columns
    y = y0 + (np.arange(rows) + 0.5) * (y1 - y0) / rows
    lens, sides = camera.lens_map, np.linspace(bounds_px[:2], bounds_px[2:], _NODES)
    around = camera.normalised(np.stack(np.meshgrid(*sides.T), axis=-1).reshape(-1, 2))
    around = around[np.isfinite(around).all(axis=1)] * ideal.focal_length_px + np.array(ideal.principal_point_px)
    # Between nodes the image of a side bends by no more than it leaves the box of theirs.
    low, high = around.min(axis=0), around.max(axis=0)
    low, high = low - (high - low) / _NODES, high + (high - low) / _NODES
    if mask is not None or (high - low).max() > 1.0:
        low, high = np.floor(low) - 0.5, np.ceil(high) + 0.5
    per_px = _FINER * lens.stretch * max(columns / (x1 - x0), rows / (y1 - y0))
    wide, tall = (high - low).tolist()
    per_px = min(per_px, most[0] / max(wide, tall), math.sqrt(most[1] / (wide * tall)))
    if mask is not None:
        per_px = max(math.floor(per_px), 1)
    size = max(round(wide * per_px), 2), max(round(tall * per_px), 2)
    per_cell = np.array(size) / (high - low)
    # For each sample: the first of the four that are around it, its way to the next ones, and its share of their light.
    first = np.full((rows, columns), -1, np.int32)
    way, share = np.zeros((2, rows, columns), np.float32), np.zeros((rows, columns), np.float32)
    is_asked = np.ones((rows, columns), bool) if mask is None else np.kron(
        mask, np.ones((rows // mask.shape[0], columns // mask.shape[1]), np.uint8)).astype(bool)
    for begin in range(0, rows, _ROWS):
        row, column = np.nonzero(is_asked[begin:begin + _ROWS])
        row += begin
        xy = camera.normalised(np.stack([x[column], y[row]], axis=1)).T
        seen = np.flatnonzero(np.isfinite(xy[0]))
        row, column, xy = row[seen], column[seen], xy[:, seen]
        at = (ideal.focal_length_px * xy.T + ideal.principal_point_px - low) * per_cell - 0.5
        cell = np.clip(np.floor(at).astype(np.int32), 0, np.array(size) - 2)
        first[row, column], share[row, column] = cell[:, 1] * size[0] + cell[:, 0], 1.0 / lens.area_scales(xy)
        way[:, row, column] = np.clip(at - cell, 0.0, 1.0).T
    wanted = None
    if mask is not None:
        drawn = first[first >= 0]
        wanted = np.zeros((round(tall), round(wide)), np.uint8)
        for down in (0, 1):
            for right in (0, 1):
                wanted[(drawn // size[0] + down) // per_px, (drawn % size[0] + right) // per_px] = 1
    samples = draw(ideal, (*low.tolist(), *high.tolist()), size, wanted).ravel()
    corner = np.maximum(first, 0)
    top, bottom = ((1.0 - way[0]) * samples[corner + down] + way[0] * samples[corner + down + 1]
                   for down in (0, size[0]))
    return share * ((1.0 - way[1]) * top + way[1] * bottom)
