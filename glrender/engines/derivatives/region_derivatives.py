"""The derivatives of a frame, drawn from the very areas of its image, and their expected errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from glrender_camera import PinholeCamera

from ...planner.account import Drawn
from ...view.regions import union
from ...view.view import BodyView
from ..coverage.image_cells import ImageCells
from ..coverage.sub_triangles import projected
from ..coverage.sunlit_areas import SunlitAreas
from ..raster.surface_pass import Frame
from ..rays.engine import RayEngine
from . import loops
from .jacobian import Jacobian
from .moving_lines import Cuts, in_camera, place_rates, sun_rates_body
from .parameters import Rates, count_of, each_of, sun_axes
from .radiance_rates import radiance_rates

# Most numbers of a part of an image that is drawn at once: 64 MiB.
_AT_ONCE = 1 << 23
# Error of derivatives over their RMS [1] without a cut, where they err as the image does otherwise; and the factors and
# powers of the image's error [1] where cuts stay or go with what hides, and where they slide: Itokawa and a contact
# binary at 60 and 100 deg, tolerances of 0.002 to 0.05, against 18 bisections at 0.0007.
_UNCUT, _CUT, _SLIDING = 1e-4, (2.5, 0.8), (6.0, 0.4)


def derivatives_of(names: Sequence[str], drawn: Drawn, frame: Frame, rays: RayEngine
                   ) -> tuple[Jacobian, dict[str, float]]:
    """The derivatives of a drawn frame by parameters, and the error [1] to expect of each over its RMS."""
    x0, y0, x1, y1 = roi = union([window.roi for window in drawn.windows])
    each = each_of(names)
    found, errors = np.zeros((len(each), y1 - y0, x1 - x0), np.float32), dict.fromkeys(names, 0.0)
    for window, (by_points, areas_error) in zip(drawn.windows, drawn.areas, strict=True):
        left, top, right, bottom = window.roi
        part = np.s_[top - y0:bottom - y0, left - x0:right - x0]
        cells, of_window = ImageCells(frame.camera, window.bounds_px, window.grid), found[:, *part]
        if "focal_length" in names:
            light_W_m2 = drawn.irradiance_W_m2[top:bottom, left:right]
            of_window[each.index("focal_length")] = _by_solid_angle(light_W_m2, cells)
        add_derivatives(of_window, names, by_points, list(frame.views), cells, rays)
        is_cut = any(not areas.seen.cutter.is_free for of_point in by_points for areas in of_point)
        errors = {name: max(error, _expected_error(name, areas_error, is_cut)) for name, error in errors.items()}
    first = np.cumsum([0, *(count_of(name) for name in names)])
    view, ranges_m = frame.views[0], {f"bodies.{view.name}": view.range_m for view in frame.views}
    ranges_m["spacecraft"] = min(view.range_m for view in frame.views if view.is_visible or len(frame.views) == 1)
    return Jacobian(roi=roi, ranges_m=ranges_m, arrays={name: found[begin:end] for name, begin, end in zip(
        names, first[:-1], first[1:], strict=True)}, sun_axes=sun_axes(
        view.camera_from_body @ view.sun_direction_body)), errors


def _expected_error(name: str, areas_error: float, is_cut: bool) -> float:
    """The error [1] to expect over the RMS of derivatives, of an image's error [1], with light cut off or whole."""
    if not is_cut:
        return _UNCUT + areas_error
    factor, power = _SLIDING if name == "sun" or name.startswith("bodies.") else _CUT
    return factor * areas_error**power


def _by_solid_angle(irradiance_W_m2: np.ndarray, cells: ImageCells) -> np.ndarray:
    """Derivatives (rows, columns) [W/m2/px] by the focal length, of the solid angle that a pixel has."""
    across, down = cells.tangents_squared
    squared = across + down[:, None]
    return irradiance_W_m2 * ((3.0 * squared / (1.0 + squared) - 2.0) / cells.camera.focal_length_px)


def add_derivatives(found: np.ndarray, names: Sequence[str], by_points: Sequence[Sequence[SunlitAreas]],
                    views: list[BodyView], cells: ImageCells, rays: RayEngine) -> None:
    """Add the derivatives (K, rows, columns) float32 of one region's pixels by parameters.

    Parameters
    ----------
    found : (K, rows, columns) float32 [W/m2]
    names : sequence of str
    by_points : sequence of sequence of SunlitAreas
        By each point of the Sun's disc whose mean the image is: the areas of each body.
    views : list of BodyView
        Of all bodies.
    cells : ImageCells
        The region's pixels.
    rays : RayEngine
    """
    scale = rays.scene.solar_irradiance_of(cells.camera) / cells.camera.focal_length_px**2
    each = each_of(names)
    for areas in (one for found_by_point in by_points for one in found_by_point):
        rates = Rates.of(names, areas.seen.view, cells.camera)
        _add(found, _Lines(areas, each, rates, views, cells.camera, rays), cells, scale / len(by_points))


class _Lines:
    """The lines of one body's areas, and how they and the radiance between them change."""

    def __init__(self, areas: SunlitAreas, each: Sequence[str], rates: Rates, views: list[BodyView],
                 camera: PinholeCamera, rays: RayEngine):
        seen, self.areas, focal_length_px = areas.seen, areas, camera.focal_length_px
        facets, view = seen.facets, seen.view
        drawn = areas.facets()
        radiance = seen.radiance.of(drawn)
        changes = radiance_rates(facets, view, drawn, radiance, each, rates)
        self.changed = np.flatnonzero(changes.any(axis=1))
        self.values = np.zeros((1 + len(self.changed), facets.n_facets))
        self.values[0, drawn] = radiance
        self.values[1:, drawn] = changes[self.changed]
        self.whole = np.zeros_like(self.values)
        self.whole[:, areas.whole] = self.values[:, areas.whole]
        self.vertex_rates = place_rates(in_camera(facets.vertices_m, view), rates, focal_length_px)
        points_m = seen.cutter.points.r_m
        self.points_xy = projected(points_m, view, camera)
        self.point_rates = place_rates(in_camera(points_m, view), rates, focal_length_px)
        cuts = Cuts.of(areas, rays, views, bool(sun_rates_body(rates, view).any()))
        self.cut_xy, self.cut_rates = projected(cuts.r_m, view, camera), cuts.own_rates(areas, rates, focal_length_px)
        self.cut_values = self.values[:1, cuts.facet[:len(cuts.facet) // 2]]


def _add(found: np.ndarray, lines: _Lines, cells: ImageCells, scale: float) -> None:
    count, rows, columns = found.shape
    seen, (left, top), (across, down) = lines.areas.seen, cells.origin_px, cells.tangents_squared
    polygons = [(corner, np.ascontiguousarray(lines.values[:, facet])) for corner, facet in lines.areas.polygons]
    n_rows = max(_AT_ONCE // max(columns * (count + len(lines.changed)), 1), 1)
    for first in range(0, rows, n_rows):
        part = slice(first, min(first + n_rows, rows))
        swept = np.zeros((part.stop - first, columns, count))
        sums = np.zeros((part.stop - first, columns + 2, len(lines.changed)))
        loops.add_facets(swept, sums, seen.xy_px, lines.vertex_rates, seen.facets.corners, seen.facets.neighbours,
                         lines.whole, left, top + first)
        for corner, values in polygons:
            loops.add_polygons(swept, sums, lines.points_xy, lines.point_rates, corner, values, left, top + first)
        loops.add_cuts(swept, lines.cut_xy, lines.cut_rates, lines.cut_values, left, top + first)
        loops.finish(swept, sums, lines.changed, scale, across, np.ascontiguousarray(down[part]), found[:, part])
