"""The renderer: owns the context and the buffers, and carries out what the planner decided."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import numpy as np
from glrender_camera import PinholeCamera
from glrender_camera.validate import integer, within

from . import grouping, plan
from .area_engine import AreaEngine
from .area_grid import SmallBody
from .area_levels import area_levels
from .backends.full_shape import traced_products
from .body_meshes import body_levels, body_meshes, body_traits
from .brdf import Law
from .clock import Clock
from .eclipses import casters, eclipse
from .emission_frame import EmissionFrame
from .engine_costs import engine_costs
from .error_model import NO_PENUMBRA, own_penumbra, rounding_px
from .errors import ConfigError, DeviceError
from .gl.context import Context
from .gl.evaluate import BrdfEvaluator
from .image import Image, checked_products
from .irradiance_pass import IrradiancePass
from .kept_images import KeptImages
from .memory import keep_freed
from .plan_windows import MAX_SAMPLES, apart_limit, plan_windows
from .plugin_trial import blamed_on, check_light, try_twin
from .product_pass import ProductPass
from .ray_engine import RayEngine
from .render_plan import BodyPlan, RenderPlan
from .scene import Scene, checked_max_error
from .shadows import Shadows
from .slow import SlowFrames, checked_allow_slow, misses_budget, with_emission
from .state import State
from .surface_pass import Frame, SurfacePass
from .view import BodyView, chunks_in_window, view_bodies

# How far OpenGL may put places off in products.
_MOST_ROUNDING_PX = 0.02
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
        keep_freed()
        self.scene = scene
        with ExitStack() as stack:
            self._context = stack.enter_context(Context(backend, device_index))
            self._meshes, self._traits, shapes = {}, {}, {}
            for body in scene.bodies:
                levels, ratios = body_levels(body)
                self._meshes[body.name] = [stack.enter_context(mesh)
                                           for mesh in body_meshes(self._context, body, levels)]
                shapes[body.name], by_areas = area_levels(body, levels)
                self._traits[body.name] = body_traits(body, levels, ratios, by_areas)
            self._slow = SlowFrames(scene)
            stack.callback(self._slow.close)
            rays = areas = kept_images = None
            try:
                rays = RayEngine(scene)
                stack.callback(rays.close)
                areas = AreaEngine(scene, rays, shapes)
                stack.callback(areas.close)
                kept_images = KeptImages(scene, rays)
                stack.callback(kept_images.close)
            except DeviceError:
                pass  # embreex is optional
            self._rays, self._areas, self._kept_images = rays, areas, kept_images
            self._costs = engine_costs(self._context, rays is not None)
            self._shadows = Shadows(self._context, scene.hulls, self._meshes)
            stack.callback(self._shadows.close)
            self._surfaces = stack.enter_context(SurfacePass(self._context, scene, self._meshes))
            self._irradiance = stack.enter_context(IrradiancePass(self._context, self._surfaces, rays, areas,
                                                                  kept_images))
            self._products = stack.enter_context(ProductPass(self._context, self._surfaces, self._meshes))
            for law in {id(body.brdf): body.brdf for body in scene.bodies}.values():
                try_twin(law, self.evaluate_brdf)
            self._emission = []
            for emission in scene.emission:
                with blamed_on(type(emission)):
                    self._emission.append(stack.enter_context(emission.open(self._context, scene)))
            self._stack = stack.pop_all()

    def __enter__(self) -> Renderer:
        return self

    def __exit__(self, *exception) -> None:
        self.close()

    def close(self) -> None:
        """Release the context and all that lives in it."""
        self._stack.close()

    @property
    def info(self) -> dict[str, Any]:
        """The OpenGL that was found: backend, gl_renderer, gl_version, limits; and the costs that plans reckon with."""
        return {**self._context.info, "engine_costs_ns": self._costs.text}

    def evaluate_brdf(self, law: Law, to_sun: np.ndarray, to_camera: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """BRDF [1/sr] of (N, 3) unit vectors, (N,) float32, by the very GLSL function that draws."""
        return BrdfEvaluator(self._context)(law, to_sun, to_camera, normal)

    def render(self, state: State, camera: str | PinholeCamera | None = None, *, max_error: float | None = None,
               products: Iterable[str] = ("irradiance",), samples: int | None = None, level: int | None = None,
               after_psf: bool = False, error_gain: float = 1.0, apart_px: float = 0.0,
               allow_slow: bool | str = False,
               on_progress: Callable[[float], None] | None = None, out: np.ndarray | None = None) -> Image:
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
        error_gain : float [1], 1e-9..1
            What is left of an error that is independent from pixel to pixel where others average them, as a lens does
            that has several cells a pixel: the budget holds for that.
        apart_px : float [px], 0..256
            Bodies that are smaller, and alone in their pixels, are told in `Image.small_bodies` instead of the
            image: sub-pixel places that a point spread function can use. At a phase angle g those up to 1 / cos(g / 2)
            as large are, at most 4 times. Of several the smallest, as many as together cover no more than one body of
            this size; none in an emission that dims.
        allow_slow : bool or {"raytrace", "cycles"}
            Whether another backend may draw the frame, in seconds or minutes, where OpenGL's error is above
            the budget and no `samples` or `level` is asked for; or which one.
        on_progress : callable, optional
            Called by the slow backend with the share done, 0..1.
        out : (height, width) float32 array, optional
            Where the irradiance is drawn, instead of new memory; a slow backend brings its own.

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
        clock = Clock()
        pinhole = self.scene.drawn_camera(camera)
        wanted = checked_products(products)
        budget = self.scene.max_error if max_error is None else checked_max_error(max_error)
        if samples is not None:
            samples = integer("samples", samples, 1, MAX_SAMPLES)
        if level is None and samples is not None:
            level = 0
        if level is not None:
            level = integer("level", level, 0, 99)
        apart_px = within("apart_px", apart_px, 0.0, 256.0)
        may_be_slow = checked_allow_slow(allow_slow) and level is None
        gain = within("error_gain", error_gain, 1e-9, 1.0)
        if after_psf and pinhole.model is not None:
            gain *= pinhole.model.psf_noise_gain
        views = view_bodies(state, pinhole, self.scene.hulls)
        if any(getattr(emission, "dims", True) for emission in self.scene.emission):
            # What dims the image does not reach points beside it.
            apart_px = 0.0
        apart_px = apart_limit(views, apart_px)
        planned = self._plan_bodies(views, pinhole, budget / gain, level)
        # What is asked for by its level is drawn by OpenGL.
        costs = self._costs if level is None else replace(self._costs, ray_ns=math.inf)
        choices = plan_windows(views, self._traits, planned, pinhole, budget, gain, costs, samples, apart_px)
        bodies = plan.without_maps(planned, [choice.first for choice in choices])
        clock.lap("plan")
        self._context.make_current()
        self._shadows.begin_frame()
        shadows, bodies = self._shadows.draw(views, bodies, pinhole)
        self._context.gl.finish()
        clock.lap("shadow")
        frame = Frame(camera=pinhole, views=views, bodies=bodies, shadows=shadows)
        irradiance = _blank((pinhole.height_px, pinhole.width_px), out)
        small: list[SmallBody] = []
        windows = [self._irradiance.draw(irradiance, choice, frame, gain, clock, small, apart_px)
                   for choice in choices]
        frame_plan = plan.told_plan(pinhole, budget, views, self._traits, bodies, windows, self.scene.sun_disc)
        slow = None
        if may_be_slow and misses_budget(frame_plan):
            fast = Image(irradiance_W_m2=irradiance, products={}, plan=frame_plan, timings_ms=clock.laps_ms)
            slow = self._slow.instead_of(fast, allow_slow, state, pinhole, error_gain=gain,
                                          on_progress=on_progress)
            irradiance, small = slow.irradiance_W_m2, []
            clock.lap("slow")
        if self._emission:
            frame_plan = self._add_emission(irradiance, state, frame, frame_plan)
            clock.lap("emission")
        arrays = {}
        if wanted:
            # What a pixel's centre sees is told of the full shape: by OpenGL, if its coordinates are fine enough.
            bodies = [replace(body, level=0) for body in planned]
            shadows, _ = self._shadows.draw(views, bodies, pinhole) if "sunlit" in wanted else ({}, None)
            arrays = self._products.draw(wanted, replace(frame, bodies=bodies, shadows=shadows), windows)
            if self._rays is not None and max(rounding_px(view, self._traits[view.name], body.relative_to_camera)
                                              for view, body in zip(views, bodies, strict=True)) > _MOST_ROUNDING_PX:
                traced = traced_products(self._rays, wanted, pinhole, views, grouping.union([w.roi for w in windows]))
                arrays = {name: values.astype(arrays[name].dtype) for name, values in traced.items()}
            clock.lap("products")
        return Image(irradiance_W_m2=irradiance, products=arrays, timings_ms=clock.laps_ms, small_bodies=tuple(small),
                     plan=frame_plan if slow is None else with_emission(slow.plan, frame_plan))

    def _plan_bodies(self, views: list[BodyView], camera: PinholeCamera, budget: float,
                     level: int | None) -> list[BodyPlan]:
        bodies, hulls, has_disc = [], self.scene.hulls, self.scene.sun_disc
        for view in views:
            traits, chunks, hull = self._traits[view.name], self._meshes[view.name][0].chunks, hulls[view.name]
            sun_radius_rad = view.sun_radius_rad if has_disc else 0.0
            cast = casters(view, views, hulls, sun_radius_rad) if view.is_visible else []
            shown = chunks_in_window(chunks, view, camera, camera.bounds_px)
            bodies.append(plan.plan_body(
                view, traits, camera, [name for name, _ in cast], budget, level,
                shown_share=chunks.n_facets(shown) / traits.levels[0].n_facets,
                seen_share=self._shadows.seen_share(view, camera),
                penumbra=own_penumbra(view) if has_disc and not hull.is_convex else NO_PENUMBRA,
                eclipse=eclipse(view, cast, hulls, camera, sun_radius_rad)))
        return bodies

    def forget_shadow_maps(self) -> None:
        """Find all shadows anew when next they are needed; no image changes."""
        self._shadows.close()
        if self._areas is not None:
            self._areas.forget()
            self._kept_images.forget()

    def _add_emission(self, irradiance: np.ndarray, state: State, frame: Frame, frame_plan: RenderPlan) -> RenderPlan:
        """Add what the scene's emission plug-ins draw; where their light falls is the whole image."""
        views, camera = {view.name: view for view in frame.views}, frame.camera

        def draw_surfaces(target, stage, bounds_px, grid):
            self._surfaces.draw(replace(frame, shadows={}), target, stage, bounds_px, grid, tuple(views))

        def shadow_map(name):
            shadow = frame.shadows.get(name)
            # The shadow falls on dust far beside what the image shows of the body.
            if shadow is None or not views[name].is_whole:
                bodies = [replace(body, shadow_map_px=_EMISSION_SHADOW_PX if body.name == name else None)
                          for body in frame.bodies]
                shadow = self._shadows.draw(frame.views, bodies, camera, is_whole=True)[0][name]
            return shadow.shadow_map, shadow.shadow_from_body

        given = EmissionFrame(
            state=state, camera=camera, views=views, max_error=frame_plan.max_error,
            solar_irradiance_1au_W_m2=self.scene.solar_irradiance_of(camera),
            rois=tuple(window.roi for window in frame_plan.windows),
            draw_surfaces=draw_surfaces, shadow_map=shadow_map)
        added = []
        for emission, opened in zip(self.scene.emission, self._emission, strict=True):
            with blamed_on(type(emission)):
                added.append(opened.add(irradiance, given))
            check_light(emission, irradiance, added[-1])
        return replace(frame_plan, emission=tuple(added), roi=(0, 0, camera.width_px, camera.height_px))


def _blank(shape: tuple[int, int], out: np.ndarray | None) -> np.ndarray:
    """A dark image, in `out` if that is given."""
    if out is None:
        return np.zeros(shape, np.float32)
    if out.shape != shape or out.dtype != np.float32:
        raise ConfigError("out", f"must be float32 of shape {shape}", f"{out.dtype} of {out.shape}")
    out.fill(0.0)
    return out
