"""The renderer: owns the context and the buffers, and carries out what the planner decided."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from glrender_camera import PinholeCamera
from glrender_camera.validate import integer

from . import error_model, frames, grouping, plan
from .brdf import Law
from .emission_frame import EmissionFrame
from .engine_costs import engine_costs
from .error_model import NO_PENUMBRA, BodyTraits, LevelTraits
from .errors import ConfigError, DeviceError
from .gl.context import Context
from .gl.evaluate import BrdfEvaluator
from .gl.passes import Mesh, PixelMask, SurfaceVariant, Target
from .image import Image, checked_products
from .lod import Level, levels_of_detail
from .lod_flux import FluxRatio, flux_ratios
from .plan import BodyPlan, RenderPlan, WindowPlan
from .ray_engine import RayEngine
from .refine import frame_error, pixel_errors, pixel_means, plan_refinement
from .scene import Body, Scene, checked_max_error
from .shadows import NO_SHADOW, Shadow, Shadows
from .slow import SlowFrames, checked_allow_slow, misses_budget, with_emission
from .state import State
from .surface import Surface
from .view import BodyView, chunks_in_window, view_bodies

# Samples drawn at once: 16 Mi samples of float32 and depth are 128 MiB.
_MAX_WINDOW_SAMPLES = 4096 * 4096
# Of the budget: what is left then for samples would not do.
_ALL_BUT = 0.9
# Side of a shadow map that only a coma asks for.
_EMISSION_SHADOW_PX = 512


class Renderer:
    """Draws a scene's states. One thread makes it, uses it and closes it.

    Parameters
    ----------
    scene : Scene
    backend : {"auto", "egl", "osmesa"}
    device_index : int, optional
        Which EGL device.

    Raises
    ------
    DeviceError
        No OpenGL; the message says what to install.
    """

    def __init__(self, scene: Scene, backend: str = "auto", device_index: int | None = None):
        if not isinstance(scene, Scene):
            raise ConfigError("scene", "must be a Scene", scene)
        self.scene = scene
        self._hulls = scene.hulls
        with ExitStack() as stack:
            self._context = stack.enter_context(Context(backend, device_index))
            self._meshes, self._traits = {}, {}
            for body in scene.bodies:
                levels, ratios = _levels(body)
                self._meshes[body.name] = [stack.enter_context(mesh)
                                           for mesh in _meshes(self._context, body, levels)]
                self._traits[body.name] = _traits(body, levels, ratios)
            self._slow = SlowFrames(scene)
            stack.callback(self._slow.close)
            self._rays = None
            try:
                self._rays = RayEngine(scene)
                stack.callback(self._rays.close)
            except DeviceError:
                pass  # embreex is optional
            self._costs = engine_costs(self._context, self._rays is not None)
            self._surface = stack.enter_context(Target(self._context, [1]))
            self._mask = stack.enter_context(PixelMask(self._context))
            self._products = stack.enter_context(Target(self._context, [4, 4, 4]))
            self._shadows = Shadows(self._context, self._hulls, self._meshes)
            stack.callback(self._shadows.close)
            self._emission = [stack.enter_context(emission.open(self._context, scene)) for emission in scene.emission]
            self._stack = stack.pop_all()
        self._bodies = {body.name: (index, body) for index, body in enumerate(scene.bodies)}

    def __enter__(self) -> Renderer:
        return self

    def __exit__(self, *exception) -> None:
        self.close()

    def close(self) -> None:
        """Release the context and all that lives in it."""
        self._stack.close()

    @property
    def info(self) -> dict[str, Any]:
        """The OpenGL that was found: backend, gl_renderer, gl_version, limits."""
        return dict(self._context.info)

    def evaluate_brdf(self, law: Law, to_sun: np.ndarray, to_camera: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """BRDF [1/sr] of (N, 3) unit vectors, (N,) float32, by the very GLSL function that draws."""
        return BrdfEvaluator(self._context)(law, to_sun, to_camera, normal)

    def render(self, state: State, camera: str | PinholeCamera | None = None, *, max_error: float | None = None,
               products: Iterable[str] = ("irradiance",), samples: int | None = None, level: int | None = None,
               after_psf: bool = False, allow_slow: bool | str = False,
               on_progress: Callable[[float], None] | None = None) -> Image:
        """Draw one frame.

        Parameters
        ----------
        state : State
        camera : str or PinholeCamera, optional
            Name; the scene's only camera by default. Or a camera that draws for one of the scene's, whose name it has.
        max_error : float [1], optional
            Budget instead of the scene's.
        products : iterable of str
            Out of `PRODUCTS`; ``irradiance`` is always drawn.
        samples : int, optional
            Samples along every pixel's side instead of the planner's choice; the full shape with them,
            unless `level` says otherwise.
        level : int, optional
            Level of detail of every body instead of the planner's choice: 0 is the full shape; one
            beyond a body's coarsest is its coarsest.
        after_psf : bool
            Whether the budget holds for the image after the camera's PSF.
        allow_slow : bool or {"raytrace", "cycles"}
            Whether another backend may draw the frame, in seconds or minutes, where OpenGL's error is above
            the budget and no `samples` or `level` is asked for; or which one.
        on_progress : callable, optional
            Called by the slow backend with the share done, 0..1.

        Returns
        -------
        Image

        Raises
        ------
        SceneError
            The state cannot be rendered: unknown body or camera, a camera inside a body.
        ConfigError
            An argument breaks a rule.
        """
        clock = _Clock()
        pinhole = self.scene.drawn_camera(camera)
        wanted = checked_products(products)
        budget = self.scene.max_error if max_error is None else checked_max_error(max_error)
        if samples is not None:
            samples = integer("samples", samples, 1, plan.MAX_SAMPLES)
        if level is None and samples is not None:
            level = 0
        if level is not None:
            level = integer("level", level, 0, 99)
        may_be_slow = checked_allow_slow(allow_slow) and level is None
        gain = pinhole.model.psf_noise_gain if after_psf and pinhole.model is not None else 1.0
        views = view_bodies(state, pinhole, self._hulls)
        frame_plan = self._plan(views, pinhole, budget, samples, level, gain)
        clock.lap("plan")
        self._context.make_current()
        shadows, bodies = self._shadows.draw(views, frame_plan.bodies, pinhole)
        frame_plan = replace(frame_plan, bodies=tuple(bodies))
        self._context.gl.finish()
        clock.lap("shadow")
        irradiance = np.zeros((pinhole.height_px, pinhole.width_px), np.float32)
        windows = tuple(self._draw_irradiance(irradiance, window, views, frame_plan, pinhole, shadows, gain,
                                              clock)
                        for window in frame_plan.windows)
        frame_plan = plan.with_windows(frame_plan, windows)
        slow = None
        if may_be_slow and misses_budget(frame_plan):
            fast = Image(irradiance_W_m2=irradiance, products={}, plan=frame_plan, timings_ms=clock.laps_ms)
            slow = self._slow.instead_of(fast, allow_slow, state, pinhole, error_gain=gain,
                                          on_progress=on_progress)
            irradiance = slow.irradiance_W_m2
            clock.lap("slow")
        if self._emission:
            frame_plan = self._add_emission(irradiance, state, views, frame_plan, pinhole, shadows)
            clock.lap("emission")
        arrays = {}
        if wanted:
            arrays = self._draw_products(wanted, views, frame_plan, pinhole)
            clock.lap("products")
        return Image(irradiance_W_m2=irradiance, products=arrays, timings_ms=clock.laps_ms,
                     plan=frame_plan if slow is None else with_emission(slow.plan, frame_plan))

    def _plan(self, views: list[BodyView], camera: PinholeCamera, budget: float, samples: int | None,
              level: int | None, gain: float) -> RenderPlan:
        bodies = []
        for view in views:
            traits, chunks = self._traits[view.name], self._meshes[view.name][0].chunks
            casters = self._shadows.casters(view, views)
            shown = chunks_in_window(chunks, view, camera, camera.bounds_px)
            bodies.append(plan.plan_body(
                view, traits, camera, len(casters) > 1, budget / gain, level,
                shown_share=chunks.n_facets(shown) / traits.levels[0].n_facets,
                seen_share=self._shadows.seen_share(view, camera),
                penumbra=self._shadows.penumbra(view, casters, camera) if self.scene.sun_disc else NO_PENUMBRA))
        # What is asked for by its level is drawn by OpenGL.
        costs = self._costs if level is None else replace(self._costs, ray_ns=math.inf)
        windows = plan.plan_windows(views, self._traits, bodies, camera, budget, gain, costs, samples)
        bodies = plan.without_passes(bodies, windows, self._traits)
        by_rays = {name for window in windows if window.engine == "rays" for name in window.bodies}
        left_out, warnings = [], []
        for view, body in zip(views, bodies, strict=True):
            traits = self._traits[view.name]
            if not view.is_visible:
                left_out.append(f"{view.name}: out of view")
                continue
            if view.phase_rad > traits.max_phase_rad:
                phase_deg, limit_deg = np.degrees([view.phase_rad, traits.max_phase_rad])
                warnings.append(f"{traits.law} of {view.name} at a phase of {phase_deg:.1f} deg: "
                                f"it holds to {limit_deg:.1f} deg")
            if body.shadow_map_px is not None and self.scene.sun_disc:
                left_out.append(f"{view.name}: the Sun's disc: shadows have hard edges")
            if body.shadow_map_px is None and view.name not in by_rays:
                left_out.append(f"shadows on {view.name}: nothing can cast on what is seen")
            if body.level:
                left_out.append(f"{view.name}: {body.n_facets} of {traits.levels[0].n_facets} facets")
        return RenderPlan(camera=camera.name, max_error=budget, roi=grouping.union([w.roi for w in windows]),
                          windows=windows, bodies=tuple(bodies), left_out=tuple(left_out), warnings=tuple(warnings),
                          predicted_error=max((w.predicted_error for w in windows), default=0.0))

    def forget_shadow_maps(self) -> None:
        """Draw every shadow map anew when next it is needed; no image changes."""
        self._shadows.close()

    def _draw_irradiance(self, irradiance: np.ndarray, window: WindowPlan, views: list[BodyView],
                         frame_plan: RenderPlan, camera: PinholeCamera, shadows: dict[str, Shadow], gain: float,
                         clock: _Clock) -> WindowPlan:
        """Add a window to the image; what its samples told goes into the plan that is returned."""
        if not window.samples:
            if window.engine == "rays":
                samples = self._cast(window.bounds_px, window.grid, window.bodies, views, camera)
            else:
                self._draw_window(self._surface, "surface.frag.glsl", window.bounds_px, window.grid, window.bodies,
                                  views, frame_plan, camera, shadows)
                samples = self._surface.read()
            clock.lap("surface")
            _add_samples(irradiance, samples, window.bounds_px)
            clock.lap("readback")
            return window
        x0, y0, x1, y1 = window.roi
        mean, error = (np.zeros((y1 - y0, x1 - x0), np.float32) for _ in range(2))
        draw = partial(self._draw_tile, window, views, frame_plan, camera, shadows, clock)
        crease_rad, facets_per_px = window.noise
        noise = error_model.noise_gain(crease_rad, facets_per_px / window.samples**2)
        # Beside the bodies' outlines it is dark; beyond the frame, nobody knows.
        sides = (y0 > 0, x0 > 0, y1 < camera.height_px, x1 < camera.width_px)
        for tile in self._tiles(mean.shape, window.samples):
            ends = (tile[0].start == 0, tile[1].start == 0, tile[0].stop == y1 - y0, tile[1].stop == x1 - x0)
            dark = tuple(side and end for side, end in zip(sides, ends, strict=True))
            mean[tile], error[tile] = pixel_errors(draw(tile, window.samples), window.samples, noise, dark)
        now, power = frame_error(mean, error), error_model.noise_power(noise)
        # Edges of shadows lie where the map's texels put them, however many samples see them.
        floor = math.hypot(window.modelling_error, now * math.sqrt(window.shadow_share * window.samples**power))
        if window.may_be_rays and window.engine == "raster" and floor > _ALL_BUT * window.budget:
            # The image tells that its shadows' edges cost the budget, which no samples cure.
            by_rays = replace(window, engine="rays", modelling_error=0.0, shadow_share=0.0)
            return self._draw_irradiance(irradiance, by_rays, views, frame_plan, camera, shadows, gain, clock)
        budget = max(math.sqrt(max(window.budget**2 - floor**2, 0.0)), 0.3 * window.budget)
        refinement = plan_refinement(mean, error, window.samples, budget, power) if math.isfinite(budget) else None
        clock.lap("refine")
        if refinement is not None:
            mean = mean.copy()
            for tile in self._tiles(mean.shape, refinement.samples):
                mask = refinement.mask[tile]
                if mask.any():
                    pixels = pixel_means(draw(tile, refinement.samples, mask), refinement.samples)
                    np.copyto(mean[tile], pixels, where=mask.astype(bool))
                    clock.lap("readback")
        irradiance[y0:y1, x0:x1] = mean
        if refinement is None:
            return replace(window, predicted_error=gain * math.hypot(now, floor))
        return replace(window, predicted_error=gain * math.hypot(refinement.predicted_error, floor),
                       refined_samples=refinement.samples, refined_share=refinement.share)

    def _tiles(self, shape: tuple[int, int], samples: int) -> Iterator[tuple[slice, slice]]:
        """Parts of a window that fit a framebuffer, as rows and columns of pixels."""
        limit = self._context.info["max_texture_px"]
        columns = max(min(shape[1], limit // samples), 1)
        rows = max(min(shape[0], limit // samples, _MAX_WINDOW_SAMPLES // (columns * samples**2)), 1)
        for top in range(0, shape[0], rows):
            for left in range(0, shape[1], columns):
                yield (slice(top, min(top + rows, shape[0])), slice(left, min(left + columns, shape[1])))

    def _draw_tile(self, window: WindowPlan, views: list[BodyView], frame_plan: RenderPlan, camera: PinholeCamera,
                   shadows: dict[str, Shadow], clock: _Clock, tile: tuple[slice, slice], samples: int,
                   mask: np.ndarray | None = None) -> np.ndarray:
        """Samples of a part of a window; zero beside the mask."""
        rows, columns = tile
        left, top = window.roi[0] + columns.start, window.roi[1] + rows.start
        width, height = columns.stop - columns.start, rows.stop - rows.start
        bounds = (left - 0.5, top - 0.5, left + width - 0.5, top + height - 0.5)
        grid = (width * samples, height * samples)
        if window.engine == "rays":
            pixels = self._cast(bounds, grid, window.bodies, views, camera, mask)
            clock.lap("surface")
            return pixels
        self._draw_window(self._surface, "surface.frag.glsl", bounds, grid, window.bodies, views, frame_plan, camera,
                          shadows, mask)
        self._context.gl.finish()
        clock.lap("surface")
        pixels = self._surface.read()
        clock.lap("readback")
        return pixels

    def _cast(self, bounds_px: tuple[float, float, float, float], grid: tuple[int, int], names: tuple[str, ...],
              views: list[BodyView], camera: PinholeCamera, mask: np.ndarray | None = None) -> np.ndarray:
        """Samples (rows, columns) float32 of a grid, by rays; zero beside the mask."""
        (columns, rows), (x0, y0, x1, y1) = grid, bounds_px
        x = x0 + (np.arange(columns) + 0.5) * (x1 - x0) / columns
        y = y0 + (np.arange(rows) + 0.5) * (y1 - y0) / rows
        pixel = np.stack(np.broadcast_arrays(x, y[:, None]), axis=-1)
        samples = np.zeros((rows, columns), np.float32)
        count = 1 if mask is None else columns // mask.shape[1]
        where = np.ones(samples.shape, bool) if mask is None else np.kron(mask, np.ones((count, count), bool)) > 0
        # Others may still cast shadows here.
        seen = [replace(view, is_visible=view.is_visible and view.name in names) for view in views]
        across = max(round(columns / (x1 - x0)), 1)
        draw = (np.arange(rows) % across)[:, None] * across + np.arange(columns) % across
        samples[where] = self._rays.irradiance(pixel[where], camera, seen, draw[where])
        return samples

    def _draw_window(self, target: Target, stage: str, bounds_px: tuple[float, float, float, float],
                     grid: tuple[int, int], names: tuple[str, ...], views: list[BodyView], frame_plan: RenderPlan,
                     camera: PinholeCamera, shadows: dict[str, Shadow], mask: np.ndarray | None = None) -> None:
        plans = {body.name: body for body in frame_plan.bodies}
        target.begin(*grid, depth=1.0 if mask is None else 0.0)
        if mask is not None:
            self._mask.open(mask, grid[0] // mask.shape[1])
        groups = grouping.depth_groups([v for v in views if v.name in names])
        for index, (near, far, members) in enumerate(groups):
            clip_from_camera = frames.clip_from_camera(
                camera.focal_length_px, camera.principal_point_px, bounds_px, near * (1.0 - 1e-6), far * (1.0 + 1e-6))
            # Each group has its slice of the depth buffer: what is nearer covers what is farther.
            clip_from_camera = frames.depth_slice(index, len(groups)) @ clip_from_camera
            for view in members:
                chunks = self._meshes[view.name][plans[view.name].level].chunks
                chosen = (chunks_in_window(chunks, view, camera, bounds_px)
                          & chunks.facing_point(view.r_camera_body_m))
                self._draw_body(stage, view, plans[view.name], clip_from_camera, camera,
                                shadows.get(view.name, NO_SHADOW), chosen)

    def _draw_body(self, stage: str, view: BodyView, body_plan: BodyPlan, clip_from_camera: np.ndarray,
                   camera: PinholeCamera, shadow: Shadow, chosen: np.ndarray) -> None:
        r_camera = view.r_camera_body_m
        offset = np.zeros(3) if body_plan.relative_to_camera else -r_camera
        clip_from_surface = clip_from_camera @ frames.transform(
            view.camera_from_body, view.camera_from_body @ offset)
        solar_irradiance = self.scene.solar_irradiance_of(camera) / view.sun_distance_au**2 * body_plan.flux_ratio
        high = r_camera.astype(np.float32)
        self._meshes[view.name][body_plan.level].draw_surface(
            stage,
            SurfaceVariant(relative_to_camera=body_plan.relative_to_camera, normal_lookup=body_plan.normal_lookup,
                           shadows=shadow.shadow_map is not None),
            {"clip_from_surface": clip_from_surface, "shadow_from_body": shadow.shadow_from_body,
             "r_camera_body": high, "r_camera_body_low": r_camera - high,
             "sun_direction_body": view.sun_direction_body, "boresight_body": view.camera_from_body[2],
             "irradiance_scale": solar_irradiance / camera.focal_length_px**2,
             "shadow_bias_per_texel": shadow.bias_per_texel,
             "body_id": self._bodies[view.name][0]},
            shadow.shadow_map, chosen)

    def _add_emission(self, irradiance: np.ndarray, state: State, views: list[BodyView], frame_plan: RenderPlan,
                      camera: PinholeCamera, shadows: dict[str, Shadow]) -> RenderPlan:
        """Add what the scene's emission plug-ins draw; where their light falls is the whole image."""
        names = tuple(view.name for view in views)

        def draw_surfaces(target, stage, bounds_px, grid):
            self._draw_window(target, stage, bounds_px, grid, names, views, frame_plan, camera, {})

        def shadow_map(name):
            view = next(view for view in views if view.name == name)
            shadow = shadows.get(name)
            # The shadow falls on dust far beside what the image shows of the body.
            if shadow is None or not view.is_whole:
                bodies = [replace(body, shadow_map_px=_EMISSION_SHADOW_PX if body.name == name else None)
                          for body in frame_plan.bodies]
                shadow = self._shadows.draw(views, bodies, camera, is_whole=True)[0][name]
            return shadow.shadow_map, shadow.shadow_from_body

        frame = EmissionFrame(
            state=state, camera=camera, views={view.name: view for view in views}, max_error=frame_plan.max_error,
            solar_irradiance_1au_W_m2=self.scene.solar_irradiance_of(camera),
            rois=tuple(window.roi for window in frame_plan.windows),
            draw_surfaces=draw_surfaces, shadow_map=shadow_map)
        added = tuple(emission.add(irradiance, frame) for emission in self._emission)
        return replace(frame_plan, emission=added, roi=(0, 0, camera.width_px, camera.height_px))

    def _draw_products(self, wanted: tuple[str, ...], views: list[BodyView], frame_plan: RenderPlan,
                       camera: PinholeCamera) -> dict[str, np.ndarray]:
        # What a pixel's centre sees is told of the full shape.
        frame_plan = replace(frame_plan, bodies=tuple(replace(body, level=0) for body in frame_plan.bodies))
        shadows, _ = self._shadows.draw(views, frame_plan.bodies, camera) if "sunlit" in wanted else ({}, None)
        shape = (camera.height_px, camera.width_px)
        layers = [np.zeros((*shape, 4), np.float32) for _ in range(3)]
        for window in frame_plan.windows:
            x0, y0, x1, y1 = window.roi
            self._draw_window(self._products, "products.frag.glsl", (x0 - 0.5, y0 - 0.5, x1 - 0.5, y1 - 0.5),
                              (x1 - x0, y1 - y0), window.bodies, views, frame_plan, camera, shadows)
            for attachment, layer in enumerate(layers):
                layer[y0:y1, x0:x1] = self._products.read(attachment)
        angles, place, identity = layers
        body_id = identity[..., 0].astype(np.int32) - 1
        beside = body_id < 0
        facet_id = np.where(beside, -1, identity[..., 1] + 4096.0 * identity[..., 2]).astype(np.int32)
        for name, (index, _) in self._bodies.items():
            here = body_id == index
            facet_id[here] = self._meshes[name][0].facet_ids(facet_id[here])
        origin_range_m = np.array([0.0 if body.relative_to_camera else view.range_m
                                   for view, body in zip(views, frame_plan.bodies, strict=True)] + [np.nan])
        angles[beside] = np.nan
        sunlit = place[..., 3].copy()
        place[beside] = np.nan
        made = {
            "range": lambda: origin_range_m[body_id] + angles[..., 0],
            "body_id": lambda: body_id,
            "facet_id": lambda: facet_id,
            "incidence": lambda: angles[..., 1].copy(),
            "emission": lambda: angles[..., 2].copy(),
            "phase": lambda: angles[..., 3].copy(),
            "r_body": lambda: place[..., :3].copy(),
            "sunlit": lambda: sunlit,
        }
        return {name: made[name]() for name in wanted}


def _levels(body: Body) -> tuple[tuple[Level, ...], tuple[FluxRatio, ...]]:
    """Levels of detail and what they do to the flux; none without rays to measure it."""
    levels = levels_of_detail(body.shape)
    try:
        return levels, flux_ratios(body, levels)
    except DeviceError:
        return (), ()


def _meshes(context: Context, body: Body, levels: tuple[Level, ...]) -> Iterator[Mesh]:
    """The full shape and its levels of detail, finest first."""
    shape = body.shape
    yield Mesh(context, shape.vertices_m, shape.facets, body.brdf,
               vertex_normals=shape.vertex_normals if body.smooth_normals else None,
               uv=shape.uv, albedo_map=body.albedo_map)
    surface, every = Surface(body), np.arange(len(shape.facets))
    detail = np.concatenate([surface.normals(every), surface.albedo_scale(every)[:, None]], axis=1) if levels else None
    for level in levels:
        yield Mesh(context, level.vertices_m, level.facets, body.brdf,
                   detail=detail.astype(np.float16)[level.source_facet])


def _traits(body: Body, levels: tuple[Level, ...], ratios: tuple[FluxRatio, ...]) -> BodyTraits:
    shape = body.shape
    full = LevelTraits(n_facets=len(shape.facets), crease_rad=shape.crease_rad)
    return BodyTraits(
        radius_m=body.hull.radius_m, is_convex=body.hull.is_convex, law=body.brdf.glsl,
        max_phase_rad=body.brdf.max_phase,
        levels=(full, *(LevelTraits(n_facets=len(level.facets), crease_rad=shape.crease_rad,
                                    deviation_m=level.deviation_m, flux_ratio=ratio)
                        for level, ratio in zip(levels, ratios, strict=True))))


def _add_samples(irradiance: np.ndarray, samples: np.ndarray, bounds_px: tuple[float, float, float, float]) -> None:
    """Add a grid of samples to the pixels that their cells overlap, by area."""
    x0, y0, x1, y1 = bounds_px
    left, across = _overlaps(x0, x1, samples.shape[1], irradiance.shape[1])
    top, down = _overlaps(y0, y1, samples.shape[0], irradiance.shape[0])
    light = down @ samples.astype(np.float64) @ across.T
    irradiance[top:top + len(down), left:left + len(across)] += light.astype(np.float32)


def _overlaps(low: float, high: float, n_cells: int, n_px: int) -> tuple[int, np.ndarray]:
    """First pixel, and lengths [px] (pixels, cells) that pixels of an axis share with even cells from low to high."""
    first, last = max(math.floor(low + 0.5), 0), min(math.floor(high + 0.5), n_px - 1)
    edge = low + np.arange(n_cells + 1) * (high - low) / n_cells
    pixel = np.arange(first, last + 1)[:, None]
    return first, np.maximum(np.minimum(edge[1:], pixel + 0.5) - np.maximum(edge[:-1], pixel - 0.5), 0.0)


class _Clock:
    """Laps in milliseconds, added up by name."""

    def __init__(self):
        self.laps_ms: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.laps_ms[name] = self.laps_ms.get(name, 0.0) + 1e3 * (now - self._last)
        self._last = now
