"""Light that the samples of a small body's own grid pass by: its error, and the body by rays from its facets."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from glrender_camera import PinholeCamera

from ..planner.adaptive_samples import frame_error
from ..planner.plan import PASSED_BY, WindowPlan
from ..planner.small_body_grid import own_cells
from ..view.regions import Group
from ..view.view import BodyView
from .rays.aimed import AimedRays
from .rays.engine import RayEngine
from .small_bodies import add_by_area

# Most points of facets that rays start from: a round choice that takes a tenth of a second.
_MOST_POINTS = 1 << 19


def with_missed(window: WindowPlan, samples: np.ndarray, missed: Callable[[int], np.ndarray]) -> WindowPlan:
    """The plan of a small body's own grid, with the error that exact areas show of its samples (rows, columns).

    `missed` has the light of areas in the samples' cells, less that of so many samples along a cell's side.
    """
    of_all, of_areas = (missed(count).astype(float) for count in (0, 1))
    total, of_flux = float(of_all.sum()), float(of_areas.sum())
    # The samples have met most of the facets: all is in shadow.
    if not total > 0.0 or not samples.any() and 2.0 * of_flux < total:
        return window
    error = frame_error(*(_in_pixels(window.bounds_px, each) for each in (of_all, of_areas)))
    if not error > window.drawn["samples"]:
        return window
    return replace(window, flux_error=math.hypot(window.flux_error, of_flux / total),
                   drawn={**window.drawn, "samples": 0.0, PASSED_BY: error})


def draw_aimed(rays: RayEngine, group: Group, window: WindowPlan, camera: PinholeCamera, views: list[BodyView]
               ) -> tuple[np.ndarray, WindowPlan] | None:
    """A small body's own cells, and its plan, by rays from its facets; None where none can be aimed.

    Parameters
    ----------
    rays : RayEngine
    group : Group
    window : WindowPlan
        By rays, of a grid of its own.
    camera : PinholeCamera
        Without a lens.
    views : list of BodyView
        Of all bodies, of which those of the group alone are visible.
    """
    bounds_px, (columns, rows), per_px = own_cells(group.outline, group.size_px)
    place_px = tuple((middle - edge) * per_px - 0.5
                     for middle, edge in zip(camera.principal_point_px, bounds_px[:2], strict=True))
    camera = replace(camera, width_px=columns, height_px=rows, focal_length_px=per_px * camera.focal_length_px,
                     principal_point_px=place_px)
    aimed = AimedRays(rays, camera, views, (0, 0, columns, rows),
                      lambda image: _in_pixels(bounds_px, per_px**2 * image))
    if not aimed.is_able:
        return None
    mean, error = aimed.until(window.budget.left_after(window.modelling_error), np.random.default_rng(0),
                              most_points=_MOST_POINTS)
    return (mean * per_px**2).astype(np.float32), replace(
        window, bounds_px=bounds_px, grid=(columns, rows), flux_error=0.0, drawn={"rays from facets": error})


def _in_pixels(bounds_px: tuple[float, float, float, float], cells: np.ndarray) -> np.ndarray:
    """Pixels (rows, columns) that share cells of some bounds by area, wherever the image ends."""
    x0, y0 = (math.floor(edge + 0.5) for edge in bounds_px[:2])
    columns, rows = (math.ceil(bounds_px[axis + 2] + 0.5) - low for axis, low in enumerate((x0, y0)))
    image = np.zeros((max(rows, 1), max(columns, 1)), np.float32)
    add_by_area(image, cells, tuple(edge - low for edge, low in zip(bounds_px, (x0, y0) * 2, strict=True)))
    return image.astype(float)
