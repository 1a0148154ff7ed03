"""The irradiance of the bodies of a frame: of each region engines are tried in order until one meets the tolerance."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from glrender_camera import PinholeCamera

from ..base.errors import ConfigError
from ..base.stopwatch import Clock
from ..planner import eclipse_samples, error_model
from ..planner.account import Drawn
from ..planner.adaptive_samples import (
    aligned_errors,
    frame_error,
    pixel_errors,
    pixel_means,
    plan_refinement,
)
from ..planner.engine_choice import MOST_FACETS_PER_PX, MOST_FIRST_SAMPLES
from ..planner.error_budget import ECLIPSE_SHARE
from ..planner.frame_plan import FramePlan
from ..planner.plan import HARD, LEAK, PASSED_BY, UNEVEN, WindowPlan
from ..planner.request import MAX_SAMPLES
from ..planner.small_body_grid import MAX_RAYS_ACROSS
from ..view.regions import Group
from .coverage.coverage_image import CoverageImage
from .coverage.engine import CoverageEngine
from .coverage.image_cells import ImageCells
from .coverage.sampling import SampledAreas
from .coverage.sunlit_areas import SunlitAreas
from .passed_by import draw_aimed, with_missed
from .raster.gl.context import Context
from .raster.gl.mesh import IRRADIANCE_STAGE
from .raster.gl.targets import Target
from .raster.lens_samples import Bounds, lens_samples
from .raster.surface_pass import Frame, SurfacePass
from .rays.engine import RayEngine, draws, places_in
from .settle import SETTLING_SAMPLES, settle
from .shadow_check import ShadowCheck
from .small_bodies import SmallBody, add_by_area

# Samples drawn at once: 16 Mi samples of float32 and depth are 128 MiB.
_MAX_WINDOW_SAMPLES = 16_777_216
# Rays that are cast at first at what faces Sun and camera of a crescent: 0.1 s.
_FIRST_RAYS = 3e5
# Side [px] of the parts of an image that are passed over where nothing faces both.
_FACING_TILE_PX = 32
# Error of a pixel by facets' areas over that by contrast [1] from which its samples pass parts by.
_MUCH_LARGER = 2.0
# Samples along the side of a part that OpenGL draws behind a lens: it draws three times as many, and more.
_LENS_TILE = 1024


class Made(NamedTuple):
    """A group of bodies, drawn in one way."""

    mean: np.ndarray
    """The region's pixels, or a small body's own cells."""
    window: WindowPlan
    """The plan, with the error that was estimated."""
    error: float
    """The error [1] that the tolerance is for; infinite where nothing could be drawn."""
    areas: tuple[tuple[SunlitAreas, ...], ...] = ()
    """Of coverage: `CoverageImage.areas`."""
    areas_error: float = 0.0
    """RMS error [1] of an image of these areas alone."""


class IrradiancePass:
    """Draws the irradiance of frames.

    Parameters
    ----------
    context : Context
    target : Target
        Of one component.
    surfaces : SurfacePass
    rays : RayEngine or None
    coverage : CoverageEngine or None
        With rays.
    """

    def __init__(self, context: Context, target: Target, surfaces: SurfacePass, rays: RayEngine | None,
                 coverage: CoverageEngine | None):
        self._context, self._target, self._surfaces = context, target, surfaces
        self._rays, self._coverage = rays, coverage

    def draw(self, plan: FramePlan, frame: Frame, irradiance: np.ndarray, clock: Clock, deadline: float = math.inf
             ) -> Drawn:
        """Draw the groups of a plan: each in the first way that meets the tolerance, or the one that comes nearest.

        Parameters
        ----------
        plan : FramePlan
        frame : Frame
        irradiance : (height, width) float32 [W/m2]
            Dark; changed in place.
        clock : Clock
        deadline : float [s]
            By `time.monotonic`: nothing is begun after it, once there is an image.

        Raises
        ------
        ConfigError
            The engine that was asked for finds no light on a body.
        """
        windows, small, areas = [], [], []
        for group, options in zip(plan.groups, plan.options, strict=True):
            if plan.request.has_derivatives:
                made = self._draw_coverage(group, options[0], frame, clock, deadline, is_only=True)
                areas.append((made.areas, made.areas_error))
            else:
                made = self._first_that_fits(group, options, frame, clock, deadline)
            mean, window = made.mean, made.window
            windows.append(window)
            if window.target == "region":
                x0, y0, x1, y1 = window.roi
                irradiance[y0:y1, x0:x1] = mean
            else:
                is_apart = window.target == "point"
                small.append(SmallBody.from_grid(window.bodies, mean, window.bounds_px, size_px=group.size_px,
                                                 is_apart=is_apart))
                if not is_apart:
                    add_by_area(irradiance, mean, window.bounds_px)
            clock.lap("readback")
        if hopeless := [name for window in windows if math.isinf(window.predicted_error) for name in window.bodies]:
            asked = "derivatives" if plan.request.has_derivatives else "engine"
            raise ConfigError(asked, f"cannot draw {', '.join(hopeless)}", plan.request.engine,
                              "no corner of a facet has light: it falls between them, or the law's albedo is 0; "
                              f"leave {asked} out")
        return Drawn(irradiance_W_m2=irradiance, small_bodies=tuple(small), windows=tuple(windows),
                     bodies=tuple(frame.bodies), areas=tuple(areas), is_late=time.monotonic() > deadline)

    def _first_that_fits(self, group: Group, options: Sequence[WindowPlan], frame: Frame, clock: Clock,
                         deadline: float) -> Made:
        """A group, drawn in the first way that meets the tolerance, or the one that comes nearest."""
        best = None
        for option in options:
            made = self._draw_option(group, option, frame, clock, deadline, option is options[-1])
            window, error = made.window, made.error
            # Engines may be allowed RMS errors of their own, where other units are asked for.
            if best is None or error * best.window.budget.tolerance < best.error * window.budget.tolerance:
                best = made
            if not math.isfinite(best.error):
                continue
            # Where areas are known and rays have settled them, rays alone are no better.
            is_done = window.engine == "coverage" and not window.by_centroids and math.isfinite(error)
            if error <= window.budget.tolerance or is_done or time.monotonic() > deadline:
                break
        return best

    def _draw_option(self, group: Group, window: WindowPlan, frame: Frame, clock: Clock, deadline: float,
                     is_last: bool) -> Made:
        """A group, drawn in one way."""
        if window.engine == "coverage":
            return self._draw_coverage(group, window, frame, clock, deadline)
        draw = self._draw_grid if window.target != "region" else partial(
            self._draw_sampled, deadline=deadline, is_last=is_last)
        mean, window = draw(group, window, frame, clock)
        made = Made(mean, window, window.predicted_error)
        if (window.engine != "rays" or PASSED_BY not in window.drawn or made.error <= window.budget.tolerance
                or time.monotonic() > deadline):
            return made
        if (aimed := draw_aimed(self._rays, group, window, frame.camera, frame.only(window.bodies))) is None:
            return made
        clock.lap("refine")
        return min(made, Made(*aimed, aimed[1].predicted_error), key=lambda each: each.error)

    def _areas(self, window: WindowPlan, frame: Frame, grid: tuple[int, int]) -> SampledAreas | None:
        """Areas that tell of the light that samples in the cells of a grid miss: `CoverageEngine.sampled_areas`.

        In an eclipse without those who cast it.
        """
        if self._coverage is None:
            return None
        views = [view for view in frame.views if not window.eclipse_px or view.name in window.bodies]
        return self._coverage.sampled_areas(
            window.bodies, views, ImageCells(frame.camera, window.bounds_px, grid),
            is_crowded=window.noise[1] > MOST_FACETS_PER_PX)

    def _draw_grid(self, group: Group, window: WindowPlan, frame: Frame, clock: Clock
                   ) -> tuple[np.ndarray, WindowPlan]:
        """A small body's own samples, and its plan."""
        samples = self._samples(window, frame, clock, window.bounds_px, window.grid)
        if window.eclipse_px > 0.0:
            few = eclipse_samples.bare_samples(group.phase_rad, window.grid)
            bare = sum(self._samples(window, replace(frame, views=[view]), clock, window.bounds_px, few)
                       for view in group.views)
            flux = eclipse_samples.grid_flux_error(samples, bare)
            pixels = eclipse_samples.grid_pixel_error(flux, group.size_px, group.phase_rad)
            window = replace(window, flux_error=flux, drawn={**window.drawn, "eclipse": pixels})
        areas = self._areas(window, frame, window.grid)
        return samples, window if areas is None else with_missed(window, samples, areas.missed)

    def _draw_coverage(self, group: Group, window: WindowPlan, frame: Frame, clock: Clock, deadline: float,
                       is_only: bool = False) -> Made:
        """A group by areas: where they miss the tolerance rays settle the cells that err most."""
        draw = self._coverage.draw_by_centroids if window.by_centroids else partial(
            self._coverage.draw, has_planes=window.has_planes, is_only=is_only)
        budget = window.budget.after(window.modelling_error)
        made = draw(window.bodies, list(frame.views), ImageCells(frame.camera, window.bounds_px, window.grid), budget)
        clock.lap("surface")
        if made.squared_of_areas is None or time.monotonic() > deadline:
            return _made_by_areas(window, made)
        done = self._settled(group, window, frame, made)
        if made.softer is not None and done.error > window.budget.tolerance and time.monotonic() < deadline:
            done = min(done, self._settled(group, window, frame, made.softer()), key=lambda each: each.error)
        clock.lap("refine")
        return done

    def _settled(self, group: Group, window: WindowPlan, frame: Frame, made: CoverageImage
                 ) -> Made:
        """The same of an image of areas, whose cells that err most rays settle if the tolerance is exceeded."""
        done = _made_by_areas(window, made)
        if done.error <= window.budget.tolerance or made.squared_of_areas is None:
            return done
        uneven, window = window.modelled[UNEVEN], replace(window, modelled={**window.modelled, UNEVEN: 0.0})
        tolerance, (crease_rad, facets_per_px) = window.budget.left_after(window.modelling_error), window.noise
        noise = error_model.noise_gain(crease_rad, facets_per_px / SETTLING_SAMPLES**2)
        settled = settle(made.means, made.squared(uneven), partial(made.most_squared, tolerance),
                         partial(self._cast_in_cells, window, frame),
                         noise * error_model.crescent_gain(group.phase_rad), error_model.noise_power(noise))
        return _made_by_areas(replace(window, refined_samples=settled.samples, refined_share=settled.share),
                              made.with_cells(settled.means, settled.squared))._replace(areas_error=done.areas_error)

    def _cast_in_cells(self, window: WindowPlan, frame: Frame, cells: np.ndarray, n: int) -> np.ndarray:
        """Light (K, n, n) of n x n rays in each of some cells (K,) of a window's grid."""
        (columns, rows), (x0, y0, x1, y1) = window.grid, window.bounds_px
        row, column = places_in(cells // columns, cells % columns, n)
        place = np.stack([x0 + (column + 0.5) * (x1 - x0) / (n * columns), y0 + (row + 0.5) * (y1 - y0) / (n * rows)])
        across = n if window.target == "region" else n * columns
        return self._rays.irradiance(place.T, frame.camera, frame.only(window.bodies), draws(row, column, across)
                                     ).reshape(-1, n, n)

    def _draw_sampled(self, group: Group, window: WindowPlan, frame: Frame, clock: Clock, deadline: float,
                      is_last: bool) -> tuple[np.ndarray, WindowPlan]:
        """The region's pixels and its plan: few samples everywhere, then more where their contrast is high.

        No more are drawn where they cannot meet the tolerance and another option follows, which no deadline forbids.
        """
        x0, y0, x1, y1 = window.roi
        mean, error = (np.zeros((y1 - y0, x1 - x0), np.float32) for _ in range(2))
        facing = None
        if window.engine == "rays" and group.phase_rad > error_model.CRESCENT_RAD and not self._rays.scene.lamps:
            facing = self._coverage.may_be_lit(window.bodies, list(frame.views), ImageCells(
                frame.camera, window.bounds_px, (x1 - x0, y1 - y0)))
        if facing is not None:
            n_facing = np.count_nonzero(facing)
            if not n_facing:
                return mean, replace(window, modelled={})
            # Where few pixels have light, more samples find slivers of it; where many have, fewer do.
            most = max(math.isqrt(2 * MOST_FIRST_SAMPLES // n_facing), 2)
            count = max(min(window.samples, most), min(int(math.sqrt(_FIRST_RAYS / n_facing)), MAX_SAMPLES))
            window = replace(window, samples=count, grid=((x1 - x0) * count, (y1 - y0) * count))
        check = None
        if window.engine == "raster":
            window = replace(window, shadow_share=_shadow_share(window, frame))
            if self._rays is not None and ShadowCheck.is_needed(window, frame):
                check = ShadowCheck(self._rays, window, frame)
        draw = partial(self._draw_tile, window, frame, clock)
        is_eclipsed = window.eclipse_px > 0.0
        variance, share = (np.zeros_like(mean), np.ones_like(mean)) if is_eclipsed else (None, 1.0)
        crease_rad, facets_per_px = window.noise
        noise = error_model.noise_gain(crease_rad, facets_per_px / window.samples**2)
        gain = noise * error_model.crescent_gain(group.phase_rad)
        # Beside the bodies' outlines it is dark; beyond the frame, nobody knows.
        sides = (y0 > 0, x0 > 0, y1 < frame.camera.height_px, x1 < frame.camera.width_px)
        is_bent = window.engine == "raster" and frame.camera.lens_map is not None
        widest_px = _LENS_TILE // window.samples if is_bent else math.inf
        for tile in self._tiles(mean.shape, window.samples, widest_px if facing is None else _FACING_TILE_PX):
            if facing is not None and not facing[tile].any():
                continue
            ends = (tile[0].start == 0, tile[1].start == 0, tile[0].stop == y1 - y0, tile[1].stop == x1 - x0)
            dark = tuple(side and end for side, end in zip(sides, ends, strict=True))
            mask = None if facing is None else facing[tile]
            samples = draw(tile, window.samples, mask)
            mean[tile], error[tile] = pixel_errors(samples, window.samples, gain, dark)
            if check is not None:
                check.look(tile, samples)
            if is_eclipsed:
                bare = sum(self._draw_tile(window, replace(frame, views=[view]), clock, tile, window.samples, mask)
                           for view in group.views)
                variance[tile], share[tile] = eclipse_samples.sample_variances(
                    samples, bare, window.samples, window.eclipse_px)
        power = error_model.noise_power(noise)
        if is_eclipsed:
            power = min(power, eclipse_samples.ECLIPSE_POWER)
            error = np.maximum(error, eclipse_samples.pixel_errors(variance, window.samples, window.eclipse_px))
        is_aligned = (aligned := aligned_errors(mean, window.samples)) > error
        error = np.where(is_aligned, aligned, error)
        light, is_crowded = mean, facets_per_px > MOST_FACETS_PER_PX
        areas = None if is_crowded else self._areas(window, frame, (x1 - x0, y1 - y0))
        if areas is not None:
            are_exact = areas.are_exact and not is_eclipsed
            of_areas = share * np.abs(areas.missed(window.samples))
            # Where nothing hides or shades, areas know the error of each pixel, however small.
            is_larger = are_exact | (of_areas > _MUCH_LARGER * error)
            if is_larger.any():
                error, of_all = np.where(is_larger, of_areas, error), share * areas.missed(0)
                # An image is dark for what samples pass by, and for no shadow, where they miss most of the light of
                # areas; it is too bright where they meet thin parts. The larger error holds where none is drawn again.
                if not mean.any():
                    is_of_areas = 2.0 * of_areas.sum() > of_all.sum()
                elif math.isinf(window.budget.tolerance):
                    is_of_areas = frame_error(of_all, error) > frame_error(mean, error)
                else:
                    # Lamps' light is in no area.
                    is_of_areas = mean.sum() > of_all.sum() and not self._rays.scene.lamps
                light = of_all if are_exact or is_of_areas else mean
            else:
                areas = None
        now = frame_error(light, error)
        # Edges of shadows lie where the map's texels put them, however many samples see them.
        edges = now * window.samples**(0.5 * power) * math.sqrt(window.shadow_share)
        if check is not None:
            # Rays have seen what leaks and penumbras as well, which were modelled before.
            edges, modelled = check.error, {**window.modelled, LEAK: 0.0, HARD: 0.0}
            window = replace(window, modelled=modelled, flux_error=math.hypot(window.flux_error, check.flux_error))
        floor = math.hypot(window.modelling_error, edges)
        left = window.budget.left_after(floor)
        most = MAX_RAYS_ACROSS / max(view.size_px for view in group.views) if window.engine == "rays" else 0.0
        refinement = None
        has_aim = is_last or floor <= window.budget.tolerance or math.isfinite(deadline)
        if math.isfinite(left) and has_aim and time.monotonic() < deadline:
            left *= ECLIPSE_SHARE if is_eclipsed or areas is not None else 1.0
            refinement = plan_refinement(light, error, window.samples, left, power, most, is_aligned)
            if is_eclipsed:
                refinement = eclipse_samples.holding_flux(refinement, mean, error, variance, window.samples, left,
                                                          window.budget.flux_asked, most)
        clock.lap("refine")
        if refinement is None:
            told = {"flux_error": eclipse_samples.flux_error(mean, variance, window.samples)} if is_eclipsed else {}
            return mean, replace(window, drawn={"samples": now, "edges of shadow maps": edges}, **told)
        widest_px = _LENS_TILE // refinement.samples if is_bent else math.inf
        for tile in self._tiles(mean.shape, refinement.samples, widest_px):
            mask = refinement.mask[tile]
            if mask.any():
                pixels = pixel_means(draw(tile, refinement.samples, mask), refinement.samples)
                np.copyto(mean[tile], pixels, where=mask.astype(bool))
                clock.lap("readback")
        reached, told = refinement.predicted_error, {}
        if is_eclipsed:
            # More pixels are lit than the first samples showed.
            count = eclipse_samples.counts(refinement, window.samples)
            reached = frame_error(mean, error * (window.samples / count) ** np.where(is_aligned, 1.0, 0.5 * power))
            told = {"flux_error": eclipse_samples.flux_error(mean, variance, count)}
        if areas is not None:
            finer = (window.samples / refinement.samples) ** np.where(is_aligned, 1.0, 0.5 * power)
            after = error * np.where(refinement.mask, finer, 1.0)
            again = np.where(refinement.mask, share * np.abs(areas.missed(refinement.samples)), 0.0)
            after = np.where((again > _MUCH_LARGER * after) | is_larger, np.maximum(after, again), after)
            reached = max(reached, frame_error(light, after))
        return mean, replace(window, drawn={"samples": reached, "edges of shadow maps": edges}, **told,
                             refined_samples=refinement.samples, refined_share=refinement.share)

    def _tiles(self, shape: tuple[int, int], samples: int, most_px: float = math.inf) -> Iterator[tuple[slice, slice]]:
        """Parts of a window that fit a framebuffer, and have no longer side, as rows and columns of pixels."""
        limit = min(self._context.info["max_texture_px"] // samples, most_px)
        columns = max(min(shape[1], limit), 1)
        rows = max(min(shape[0], limit, _MAX_WINDOW_SAMPLES // (columns * samples**2)), 1)
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
        def draw(camera: PinholeCamera, bounds_px: Bounds, grid: tuple[int, int], mask: np.ndarray | None
                 ) -> np.ndarray:
            self._surfaces.draw(replace(frame, camera=camera), self._target, IRRADIANCE_STAGE, bounds_px, grid,
                                window.bodies, mask)
            self._context.gl.finish()
            clock.lap("surface")
            return self._target.read()

        samples = draw(frame.camera, bounds_px, grid, mask) if frame.camera.lens_map is None else lens_samples(
            draw, frame.camera, bounds_px, grid, mask, (self._context.info["max_texture_px"], _MAX_WINDOW_SAMPLES))
        clock.lap("readback")
        return samples

    def _cast(self, window: WindowPlan, frame: Frame, bounds_px: tuple[float, float, float, float],
              grid: tuple[int, int], mask: np.ndarray | None) -> np.ndarray:
        """Samples (rows, columns) float32 of a grid by rays; zero beside the mask."""
        (columns, rows), (x0, y0, x1, y1) = grid, bounds_px
        x = x0 + (np.arange(columns) + 0.5) * (x1 - x0) / columns
        y = y0 + (np.arange(rows) + 0.5) * (y1 - y0) / rows
        seen = frame.only(window.bodies)
        # Each pixel has the Sun's disc to itself; a grid of a body's own has it once.
        across = round(columns / (x1 - x0)) if window.target == "region" else columns
        if mask is None:
            return self._rays.lattice(x, y, frame.camera, seen, across).astype(np.float32)
        samples = np.zeros((rows, columns), np.float32)
        count = columns // mask.shape[1]
        row, column = places_in(*np.nonzero(mask), count)
        samples[row, column] = self._rays.irradiance(np.stack([x.take(column), y.take(row)]).T, frame.camera, seen,
                                                     draws(row, column, across))
        return samples


def _made_by_areas(window: WindowPlan, made: CoverageImage) -> Made:
    """A group by areas, as an image has them."""
    judged, drawn = (replace(window, drawn={"boundaries": float(each)}) for each in (made.error.judged, made.error.rms))
    return Made(made.means.astype(np.float32), drawn, judged.predicted_error, made.areas, drawn.predicted_error)


def _shadow_share(window: WindowPlan, frame: Frame) -> float:
    """The greatest `shadow_share` of the window's bodies, whose maps are drawn: 0 without a map."""
    return max((error_model.shadow_share(view, body.shadow_map_px, bool(body.casters))
                for view, body in zip(frame.views, frame.bodies, strict=True)
                if view.name in window.bodies and body.shadow_map_px is not None), default=0.0)
