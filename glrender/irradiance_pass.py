"""The irradiance of one window of an image: by triangles, rays or areas, with more samples where it asks."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import cv2
import numpy as np

from . import error_model
from .area_engine import AreaEngine
from .area_grid import SmallBody, add_by_area
from .clock import Clock
from .first_samples import MAX_SAMPLES
from .gl.context import Context
from .gl.mesh import IRRADIANCE_STAGE
from .gl.targets import Target
from .grouping import outline_px
from .kept_images import CONTRAST, NODE_ERROR, KeptImages
from .plan_windows import FACING_SAMPLES, WindowChoice, apart_size_px
from .ray_engine import RayEngine, draws
from .refine import frame_error, pixel_errors, pixel_means, plan_refinement
from .render_plan import LevelPlan, WindowPlan
from .surface_pass import Frame, SurfacePass

# Samples drawn at once: 16 Mi samples of float32 and depth are 128 MiB.
_MAX_WINDOW_SAMPLES = 4096 * 4096
# Of the budget: what is left then for samples would not do.
_ALL_BUT = 0.9
# Of a pixel's light, what it lacks that has a shadow: rounding lacks less.
_SHADED = 1e-3
# Least budget of rays that are kept: of a node's error much would be left out.
_LEAST_KEPT = 4e-3
# Most of them across a body, what their error is to be less than asked for, and the power of its contrast that asks for
# more of them from the first: as errors are between edges' and noise's.
_MOST_KEPT_ACROSS, _FINER, _FIRST = 1024, 1.05, 0.8


class IrradiancePass:
    """Draws windows.

    Parameters
    ----------
    context : Context
    surfaces : SurfacePass
    rays : RayEngine or None
    areas : AreaEngine or None
        With rays.
    kept_images : KeptImages or None
        With rays.
    """

    def __init__(self, context: Context, surfaces: SurfacePass, rays: RayEngine | None, areas: AreaEngine | None,
                 kept_images: KeptImages | None):
        self._context, self._surfaces, self._rays, self._areas = context, surfaces, rays, areas
        self._kept_images = kept_images
        self._target = Target(context, [1])

    def __enter__(self) -> IrradiancePass:
        return self

    def __exit__(self, *exception) -> None:
        self._target.__exit__(*exception)

    def draw(self, irradiance: np.ndarray, choice: WindowChoice, frame: Frame, error_gain: float, clock: Clock,
             small: list[SmallBody], apart_px: float) -> WindowPlan:
        """Add a window to an image; its plan with what its samples told.

        Parameters
        ----------
        irradiance : (height, width) float32 [W/m2]
            Changed in place.
        choice : WindowChoice
        frame : Frame
        error_gain : float [1]
            What the camera's PSF leaves of an error that is independent from pixel to pixel.
        clock : Clock
        small : list of SmallBody
            Gets the body that has a grid of its own.
        apart_px : float [px]
            One of a smaller `apart_size_px` is told there alone, and not added to the image.
        """
        def misses(window: WindowPlan) -> bool:
            return window.predicted_error > error_gain * window.budget

        drawn = self._draw_window(choice.first, frame, error_gain, clock, may_give_up=choice.by_rays is not None)
        made = [] if drawn is None else [drawn]
        if choice.by_rays is not None and (drawn is None or (choice.first.engine == "areas" and misses(drawn[1]))):
            made.append(self._draw_window(choice.by_rays, frame, error_gain, clock))
        if choice.by_areas is not None and misses(made[-1][1]):
            # Crescents have slivers of light that many samples find few of.
            made.append(self._draw_window(choice.by_areas, frame, error_gain, clock))
        # Where none meets the budget, what comes nearest.
        mean, window = min(made, key=lambda each: each[1].predicted_error)
        if window.samples:
            x0, y0, x1, y1 = window.roi
            irradiance[y0:y1, x0:x1] = mean
        else:
            small.append(self._add_small(irradiance, mean, window, frame, apart_px))
        clock.lap("readback")
        return window

    def _draw_window(self, window: WindowPlan, frame: Frame, error_gain: float, clock: Clock,
                     may_give_up: bool = False) -> tuple[np.ndarray, WindowPlan] | None:
        """The window's pixels, or a small body's own cells, and its plan; None, if it may, where rays take over."""
        if window.engine == "areas":
            return self._draw_areas(window, frame, error_gain, clock)
        if self._is_kept(window, frame):
            window = replace(window, modelling_error=math.hypot(window.modelling_error, NODE_ERROR),
                             predicted_error=math.hypot(window.predicted_error, error_gain * NODE_ERROR),
                             rays_at_facing=False)
            if 0 < window.samples <= MAX_SAMPLES:
                # What is between samples tells more; of more of them the planner took some to spare.
                window = _with_samples(window, self._most_kept(window, frame, window.samples * CONTRAST**_FIRST))
        if window.samples:
            return self._draw_sampled(window, frame, error_gain, clock, may_give_up)
        return self._samples(window, frame, clock, window.bounds_px, window.grid), window

    def _add_small(self, irradiance: np.ndarray, samples: np.ndarray, window: WindowPlan, frame: Frame,
                   apart_px: float) -> SmallBody:
        """A body of the samples of its own grid; in the image as well if it is not kept apart."""
        members = [view for view in frame.views if view.name in window.bodies]
        body = SmallBody.from_grid(window.bodies, samples, window.bounds_px, size_px=outline_px(members),
                                   is_apart=apart_size_px(members) < apart_px)
        if not body.is_apart:
            add_by_area(irradiance, samples, window.bounds_px)
        return body

    def _draw_areas(self, window: WindowPlan, frame: Frame, error_gain: float, clock: Clock
                    ) -> tuple[np.ndarray, WindowPlan]:
        """Means of the window's cells and its plan, whose error is infinite where nothing could be drawn.

        Where facets as lit as their middles turn out not to be enough, they are cut at the edges of light.
        """
        left = math.sqrt(max(window.budget**2 - window.modelling_error**2, 0.0))
        means, told = self._areas.draw(window.bodies, frame.camera, frame.views, window.bounds_px, window.grid, left,
                                       dict(zip(window.bodies, window.levels, strict=True)), True, eclipse_error=max(
                                           body.eclipse.error for body in frame.bodies if body.name in window.bodies))
        clock.lap("surface")
        if told > left and any(level.tells_error for level in window.levels):
            cut = replace(window, levels=(LevelPlan(),) * len(window.bodies))
            return self._draw_areas(cut, frame, error_gain, clock)
        predicted = error_gain * math.hypot(told, window.modelling_error)
        return means.astype(np.float32), replace(window, predicted_error=predicted)

    def _draw_sampled(self, window: WindowPlan, frame: Frame, error_gain: float, clock: Clock,
                      may_give_up: bool) -> tuple[np.ndarray, WindowPlan] | None:
        """The window's pixels and its plan; None, if it may, where its shadows' edges alone cost the budget."""
        x0, y0, x1, y1 = window.roi
        mean, error = (np.zeros((y1 - y0, x1 - x0), np.float32) for _ in range(2))
        draw = partial(self._draw_tile, window, frame, clock)
        sunward = self._sunward(window, frame, clock)
        crease_rad, facets_per_px = window.noise
        noise = error_model.noise_gain(crease_rad, facets_per_px / window.samples**2)
        told_gain = CONTRAST if self._is_kept(window, frame) else 1.0
        slivers = error_model.sliver_gain(max(view.phase_rad for view in frame.views if view.name in window.bodies))
        # Beside the bodies' outlines it is dark; beyond the frame, nobody knows.
        sides = (y0 > 0, x0 > 0, y1 < frame.camera.height_px, x1 < frame.camera.width_px)
        for tile in self._tiles(mean.shape, window.samples):
            ends = (tile[0].start == 0, tile[1].start == 0, tile[0].stop == y1 - y0, tile[1].stop == x1 - x0)
            dark = tuple(side and end for side, end in zip(sides, ends, strict=True))
            samples = draw(tile, window.samples, None if sunward is None else sunward[tile])
            mean[tile], error[tile] = pixel_errors(samples, window.samples, told_gain * noise * slivers, dark)
        now, power = frame_error(mean, error), error_model.noise_power(noise)
        # Edges of shadows lie where the map's texels put them, however many samples see them.
        told = now * window.samples**(0.5 * power)
        floor = math.hypot(window.modelling_error, told * math.sqrt(window.shadow_share))
        if may_give_up and floor > _ALL_BUT * window.budget > window.modelling_error:
            # Dear as rays are, the image without shadows tells first how much of its error is at such edges.
            edges = self._edge_share(window, frame, clock, mean, error)
            floor = math.hypot(window.modelling_error, told * math.sqrt(window.texel_share * edges))
        if may_give_up and floor > _ALL_BUT * window.budget:
            return None
        budget = max(math.sqrt(max(window.budget**2 - floor**2, 0.0)), 0.3 * window.budget)
        if window.samples < (finer := self._finer(window, frame, now / budget, power)):
            return self._draw_sampled(_with_samples(window, finer), frame, error_gain, clock, may_give_up)
        refinement = plan_refinement(mean, error, window.samples, budget, power) if math.isfinite(budget) else None
        clock.lap("refine")
        if refinement is None:
            return mean, replace(window, predicted_error=error_gain * math.hypot(now, floor))
        for tile in self._tiles(mean.shape, refinement.samples):
            mask = refinement.mask[tile]
            if mask.any():
                pixels = pixel_means(draw(tile, refinement.samples, mask), refinement.samples)
                np.copyto(mean[tile], pixels, where=mask.astype(bool))
                clock.lap("readback")
        return mean, replace(window, predicted_error=error_gain * math.hypot(refinement.predicted_error, floor),
                             refined_samples=refinement.samples, refined_share=refinement.share)

    def _finer(self, window: WindowPlan, frame: Frame, excess: float, power: float) -> int:
        """Samples along a pixel's side that leave no excess of error where they are kept, which a mask's are not."""
        if excess <= 1.0 or not self._is_kept(window, frame):
            return window.samples
        return self._most_kept(window, frame, window.samples * (_FINER * excess) ** (2.0 / power))

    def _most_kept(self, window: WindowPlan, frame: Frame, wanted: float) -> int:
        """Samples along a pixel's side, as many as are wanted if they may be kept."""
        return min(math.ceil(wanted), max(int(_MOST_KEPT_ACROSS / frame.views[0].size_px), window.samples))

    def _edge_share(self, window: WindowPlan, frame: Frame, clock: Clock, mean: np.ndarray, error: np.ndarray) -> float:
        """Of the squared error of pixels (height, width), the share beside the edges of cast shadows."""
        bare = self._without_shadows(window, frame, clock, window.samples)
        around = np.ones((3, 3), np.uint8)
        edges = [cv2.dilate(part.astype(np.uint8), around) for part in (mean < (1.0 - _SHADED) * bare, mean > 0.0)]
        squared = np.square(error, dtype=np.float64)
        return float(squared[(edges[0] & edges[1]) > 0].sum() / max(squared.sum(), 1e-300))

    def _sunward(self, window: WindowPlan, frame: Frame, clock: Clock) -> np.ndarray | None:
        """Pixels (rows, columns) uint8 that see what faces the Sun, or are near one, if rays are cast only there.

        Of a rough body's crescent at 150 deg this leaves one pixel in twelve, and no light out.
        """
        if not window.rays_at_facing:
            return None
        full = replace(frame, bodies=[replace(body, level=0) for body in frame.bodies])
        count = max(FACING_SAMPLES, window.samples)
        facing = (self._without_shadows(replace(window, engine="raster"), full, clock, count) > 0.0).astype(np.uint8)
        return cv2.dilate(facing, np.ones((5, 5), np.uint8))

    def _without_shadows(self, window: WindowPlan, frame: Frame, clock: Clock, count: int) -> np.ndarray:
        """Means (height, width) float32 of count x count samples a pixel, as if nothing cast a shadow."""
        x0, y0, x1, y1 = window.roi
        mean, bare = np.zeros((y1 - y0, x1 - x0), np.float32), replace(frame, shadows={})
        for tile in self._tiles(mean.shape, count):
            mean[tile] = pixel_means(self._draw_tile(window, bare, clock, tile, count), count)
        return mean

    def _tiles(self, shape: tuple[int, int], samples: int) -> Iterator[tuple[slice, slice]]:
        """Parts of a window that fit a framebuffer, as rows and columns of pixels."""
        limit = self._context.info["max_texture_px"]
        columns = max(min(shape[1], limit // samples), 1)
        rows = max(min(shape[0], limit // samples, _MAX_WINDOW_SAMPLES // (columns * samples**2)), 1)
        for top in range(0, shape[0], rows):
            for left in range(0, shape[1], columns):
                yield (slice(top, min(top + rows, shape[0])), slice(left, min(left + columns, shape[1])))

    def _draw_tile(self, window: WindowPlan, frame: Frame, clock: Clock, tile: tuple[slice, slice], samples: int,
                   mask: np.ndarray | None = None) -> np.ndarray:
        """Samples of a part of a window; zero beside the mask."""
        rows, columns = tile
        left, top = window.roi[0] + columns.start, window.roi[1] + rows.start
        width, height = columns.stop - columns.start, rows.stop - rows.start
        bounds_px = (left - 0.5, top - 0.5, left + width - 0.5, top + height - 0.5)
        return self._samples(window, frame, clock, bounds_px, (width * samples, height * samples), mask)

    def _samples(self, window: WindowPlan, frame: Frame, clock: Clock, bounds_px: tuple[float, float, float, float],
                 grid: tuple[int, int], mask: np.ndarray | None = None) -> np.ndarray:
        """Samples (rows, columns) float32 of a grid, by the window's engine; zero beside the mask."""
        if window.engine == "rays":
            samples = self._cast(window, frame, bounds_px, grid, mask)
            clock.lap("surface")
            return samples
        self._surfaces.draw(frame, self._target, IRRADIANCE_STAGE, bounds_px, grid, window.bodies, mask)
        self._context.gl.finish()
        clock.lap("surface")
        samples = self._target.read()
        clock.lap("readback")
        return samples

    def _is_kept(self, window: WindowPlan, frame: Frame) -> bool:
        """Whether rays are cast at a node, and kept."""
        return window.engine == "rays" and window.budget >= _LEAST_KEPT and self._kept_images.may_serve(frame.views)

    def _cast(self, window: WindowPlan, frame: Frame, bounds_px: tuple[float, float, float, float],
              grid: tuple[int, int], mask: np.ndarray | None) -> np.ndarray:
        if mask is None and self._is_kept(window, frame):
            return self._kept_images.samples(frame.views[0], frame.camera, bounds_px, grid)
        (columns, rows), (x0, y0, x1, y1) = grid, bounds_px
        x = x0 + (np.arange(columns) + 0.5) * (x1 - x0) / columns
        y = y0 + (np.arange(rows) + 0.5) * (y1 - y0) / rows
        # Others may still cast shadows here.
        seen = [replace(view, is_visible=view.is_visible and view.name in window.bodies) for view in frame.views]
        # Each pixel has the Sun's disc to itself; a grid of a body's own has it once.
        across = round(columns / (x1 - x0)) if window.samples else columns
        if mask is None:
            return self._rays.lattice(x, y, frame.camera, seen, across).astype(np.float32)
        samples = np.zeros((rows, columns), np.float32)
        count = columns // mask.shape[1]
        top, left = (count * axis[:, None, None] for axis in np.nonzero(mask))
        within = np.arange(count)
        row, column = (axis.ravel() for axis in np.broadcast_arrays(top + within[:, None], left + within))
        samples[row, column] = self._rays.irradiance(np.stack([x.take(column), y.take(row)]).T, frame.camera, seen,
                                                     draws(row, column, across))
        return samples


def _with_samples(window: WindowPlan, samples: int) -> WindowPlan:
    """With so many along a pixel's side, of which there were some before."""
    columns, rows = (samples * cells // window.samples for cells in window.grid)
    return replace(window, samples=samples, grid=(columns, rows))
