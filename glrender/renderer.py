"""The renderer: owns the context and the buffers, and carries out what the planner decided."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from glrender_camera import PinholeCamera
from glrender_camera.validate import integer

from . import frames, plan
from .brdf import Law
from .errors import ConfigError
from .gl.context import Context
from .gl.evaluate import BrdfEvaluator
from .gl.passes import Mesh, ShadowMap, SurfaceVariant, Target
from .image import Image, checked_products
from .plan import BodyPlan, RenderPlan, WindowPlan
from .scene import Scene, checked_max_error
from .state import State
from .view import BodyView, view_bodies

# Samples drawn at once: 16 Mi samples of float32 and depth are 128 MiB.
_MAX_WINDOW_SAMPLES = 4096 * 4096
_SHADOW_MAPS_KEPT = 8


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
        self._hulls = {body.name: body.hull for body in scene.bodies}
        with ExitStack() as stack:
            self._context = stack.enter_context(Context(backend, device_index))
            self._meshes = {}
            for body in scene.bodies:
                shape = body.shape
                self._meshes[body.name] = stack.enter_context(Mesh(
                    self._context, shape.vertices_m, shape.facets, body.brdf,
                    vertex_normals=shape.vertex_normals if body.smooth_normals else None,
                    uv=shape.uv, albedo_map=body.albedo_map))
            self._surface = stack.enter_context(Target(self._context, [1]))
            self._products = stack.enter_context(Target(self._context, [4, 4, 4]))
            self._shadow_maps: OrderedDict[tuple, ShadowMap] = OrderedDict()
            stack.callback(self.forget_shadow_maps)
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

    def render(self, state: State, camera: str | None = None, *, max_error: float | None = None,
               products: Iterable[str] = ("irradiance",), samples: int | None = None,
               after_psf: bool = False) -> Image:
        """Draw one frame.

        Parameters
        ----------
        state : State
        camera : str, optional
            Name; the scene's only camera by default.
        max_error : float [1], optional
            Budget instead of the scene's.
        products : iterable of str
            Out of `PRODUCTS`; ``irradiance`` is always drawn.
        samples : int, optional
            Samples along a pixel's side instead of the planner's choice.
        after_psf : bool
            Whether the budget holds for the image after the camera's PSF.

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
        pinhole = self.scene.camera(camera)
        wanted = checked_products(products)
        budget = self.scene.max_error if max_error is None else checked_max_error(max_error)
        if samples is not None:
            samples = integer("samples", samples, 1, plan.MAX_SAMPLES)
        gain = pinhole.model.optics.psf_noise_gain if after_psf and pinhole.model is not None else 1.0
        views = view_bodies(state, pinhole, self._hulls)
        frame_plan = self._plan(views, pinhole, budget, samples, gain)
        clock.lap("plan")
        self._context.make_current()
        shadows, frame_plan = self._draw_shadows(views, frame_plan)
        self._context.gl.finish()
        clock.lap("shadow")
        irradiance = np.zeros((pinhole.height_px, pinhole.width_px), np.float32)
        for window in frame_plan.windows:
            self._draw_irradiance(irradiance, window, views, frame_plan, pinhole, shadows, clock)
        arrays = self._draw_products(wanted, views, frame_plan, pinhole, shadows) if wanted else {}
        if wanted:
            clock.lap("products")
        return Image(irradiance_W_m2=irradiance, products=arrays, plan=frame_plan, timings_ms=clock.laps_ms)

    def _plan(self, views: list[BodyView], camera: PinholeCamera, budget: float, samples: int | None,
              gain: float) -> RenderPlan:
        bodies, left_out, warnings = [], [], []
        for view in views:
            mesh, hull = self._meshes[view.name], self._hulls[view.name]
            shadow_px = None
            if view.is_visible:
                shadow_px = plan.plan_shadow(view, hull.is_convex, len(self._casters(view, views)) > 1, budget)
                if view.phase_rad > mesh.law.max_phase:
                    phase_deg, limit_deg = np.degrees([view.phase_rad, mesh.law.max_phase])
                    warnings.append(f"{mesh.law.glsl} of {view.name} at a phase of {phase_deg:.1f} deg: "
                                    f"it holds to {limit_deg:.1f} deg")
                if shadow_px is None:
                    left_out.append(f"shadows on {view.name}: nothing can cast on what is seen")
            else:
                left_out.append(f"{view.name}: out of view")
            footprint_m = view.depth_m[0] / camera.focal_length_px
            bodies.append(BodyPlan(
                name=view.name, is_visible=view.is_visible, n_facets=mesh.n_facets, law=mesh.law.glsl,
                shadow_map_px=shadow_px, shadow_map_reused=False,
                relative_to_camera=plan.is_close(view, hull.radius_m, footprint_m),
                normal_lookup=footprint_m < 2e-4 * hull.radius_m, size_px=view.size_px))
        windows = plan.plan_windows(views, {name: mesh.n_facets for name, mesh in self._meshes.items()}, camera,
                                    budget, gain, samples)
        predicted = max((w.predicted_error for w in windows), default=0.0)
        if samples is None and predicted > budget:
            warnings.append(f"the budget of {budget:g} is not met: {predicted:.2g} with {plan.MAX_SAMPLES} x "
                            f"{plan.MAX_SAMPLES} samples; the raytrace backend can")
        return RenderPlan(camera=camera.name, max_error=budget, roi=plan.union([w.roi for w in windows]),
                          windows=windows, bodies=tuple(bodies), left_out=tuple(left_out),
                          warnings=tuple(warnings),
                          predicted_error=predicted)

    def _casters(self, receiver: BodyView, views: list[BodyView]) -> list[tuple[str, np.ndarray]]:
        """Bodies whose shadow may fall on the receiver: (name, receiver_from_caster as (4, 4))."""
        casters = [(receiver.name, np.eye(4))]
        radius = self._hulls[receiver.name].radius_m
        for other in views:
            if other.name == receiver.name:
                continue
            rotation = receiver.camera_from_body.T @ other.camera_from_body
            offset = receiver.r_camera_body_m - rotation @ other.r_camera_body_m
            sunward = float(offset @ receiver.sun_direction_body)
            aside = float(np.linalg.norm(offset - sunward * receiver.sun_direction_body))
            reach = radius + self._hulls[other.name].radius_m
            if aside < reach and sunward > -reach:
                casters.append((other.name, frames.transform(rotation, offset)))
        return casters

    def _draw_shadows(self, views: list[BodyView],
                      frame_plan: RenderPlan) -> tuple[dict[str, tuple[ShadowMap, np.ndarray, float]], RenderPlan]:
        """Shadow maps of the receivers: name to (map, shadow_from_body, bias per texel)."""
        shadows, bodies = {}, []
        for view, body_plan in zip(views, frame_plan.bodies, strict=True):
            size = body_plan.shadow_map_px
            if size is None:
                bodies.append(body_plan)
                continue
            sun_from_body = frames.sun_from_body(plan.snapped_sun(view.sun_direction_body, size))
            casters = self._casters(view, views)
            points = self._hulls[view.name].points_m @ sun_from_body.T
            low, high = points.min(axis=0), points.max(axis=0)
            centre = 0.5 * (low + high)
            # Two texels of margin: a lookup beside the last facet still meets the map.
            half = 0.5 * (high - low) * (1.0 + 4.0 / size)
            offset = frames.transform(np.eye(3), -centre) @ frames.transform(sun_from_body, np.zeros(3))
            clip = frames.clip_from_sun(half[0], half[1], -half[2], half[2]) @ offset
            key = (view.name, size, sun_from_body.tobytes(), *((name, m.tobytes()) for name, m in casters))
            is_kept = key in self._shadow_maps
            if is_kept:
                self._shadow_maps.move_to_end(key)
            else:
                shadow_map = self._shadow_map_to_fill(size)
                shadow_map.draw([(self._meshes[name], clip @ matrix) for name, matrix in casters])
                self._shadow_maps[key] = shadow_map
            texture_from_clip = frames.transform(0.5 * np.eye(3), np.full(3, 0.5))
            texel_m = 2.0 * max(half[0], half[1]) / size
            shadows[view.name] = (self._shadow_maps[key], texture_from_clip @ clip, texel_m / (2.0 * half[2]))
            bodies.append(replace(body_plan, shadow_map_reused=is_kept))
        return shadows, replace(frame_plan, bodies=tuple(bodies))

    def _shadow_map_to_fill(self, size: int) -> ShadowMap:
        """A map of this size that nobody needs any more, or a new one."""
        if len(self._shadow_maps) < max(_SHADOW_MAPS_KEPT, 2 * len(self._meshes)):
            return ShadowMap(self._context, size)
        for key, shadow_map in self._shadow_maps.items():
            if shadow_map.size_px == size:
                return self._shadow_maps.pop(key)
        _, oldest = self._shadow_maps.popitem(last=False)
        oldest.close()
        return ShadowMap(self._context, size)

    def forget_shadow_maps(self) -> None:
        """Draw every shadow map anew when next it is needed; no image changes."""
        for shadow_map in self._shadow_maps.values():
            shadow_map.close()
        self._shadow_maps.clear()

    def _draw_irradiance(self, irradiance: np.ndarray, window: WindowPlan, views: list[BodyView],
                         frame_plan: RenderPlan, camera: PinholeCamera, shadows: dict, clock: _Clock) -> None:
        if not window.samples:
            self._draw_window(self._surface, "surface.frag.glsl", window.bounds_px, window.grid, window.bodies, views,
                              frame_plan, camera, shadows)
            clock.lap("surface")
            _add_samples(irradiance, self._surface.read(), window.bounds_px)
            clock.lap("readback")
            return
        x0, y0, x1, y1 = window.roi
        samples, limit = window.samples, self._context.info["max_texture_px"]
        columns = max(min(x1 - x0, limit // samples), 1)
        rows = max(min(y1 - y0, limit // samples, _MAX_WINDOW_SAMPLES // (columns * samples**2)), 1)
        for top in range(y0, y1, rows):
            for left in range(x0, x1, columns):
                right, bottom = min(left + columns, x1), min(top + rows, y1)
                width, height = right - left, bottom - top
                self._draw_window(self._surface, "surface.frag.glsl",
                                  (left - 0.5, top - 0.5, right - 0.5, bottom - 0.5),
                                  (width * samples, height * samples), window.bodies, views, frame_plan, camera,
                                  shadows)
                self._context.gl.finish()
                clock.lap("surface")
                pixels = self._surface.read()
                if samples > 1:
                    pixels = cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA)
                irradiance[top:bottom, left:right] = pixels
                clock.lap("readback")

    def _draw_window(self, target: Target, stage: str, bounds_px: tuple[float, float, float, float],
                     grid: tuple[int, int], names: tuple[str, ...], views: list[BodyView], frame_plan: RenderPlan,
                     camera: PinholeCamera, shadows: dict) -> None:
        plans = {body.name: body for body in frame_plan.bodies}
        target.begin(*grid)
        for index, (near, far, members) in enumerate(plan.depth_groups([v for v in views if v.name in names])):
            if index:
                target.clear_depth()
            clip_from_camera = frames.clip_from_camera(
                camera.focal_length_px, camera.principal_point_px, bounds_px, near * (1.0 - 1e-6), far * (1.0 + 1e-6))
            for view in members:
                self._draw_body(stage, view, plans[view.name], clip_from_camera, camera, shadows.get(view.name))

    def _draw_body(self, stage: str, view: BodyView, body_plan: BodyPlan, clip_from_camera: np.ndarray,
                   camera: PinholeCamera, shadow: tuple[ShadowMap, np.ndarray, float] | None) -> None:
        shadow_map, shadow_from_body, bias = shadow or (None, np.eye(4), 0.0)
        r_camera = view.r_camera_body_m
        offset = np.zeros(3) if body_plan.relative_to_camera else -r_camera
        clip_from_surface = clip_from_camera @ frames.transform(
            view.camera_from_body, view.camera_from_body @ offset)
        solar_irradiance = self.scene.solar_irradiance_of(camera) / view.sun_distance_au**2
        high = r_camera.astype(np.float32)
        self._meshes[view.name].draw_surface(
            stage,
            SurfaceVariant(relative_to_camera=body_plan.relative_to_camera, normal_lookup=body_plan.normal_lookup,
                           shadows=shadow_map is not None),
            {"clip_from_surface": clip_from_surface, "shadow_from_body": shadow_from_body,
             "r_camera_body": high, "r_camera_body_low": r_camera - high,
             "sun_direction_body": view.sun_direction_body, "boresight_body": view.camera_from_body[2],
             "irradiance_scale": solar_irradiance / camera.focal_length_px**2, "shadow_bias_per_texel": bias,
             "body_id": self._bodies[view.name][0]},
            shadow_map)

    def _draw_products(self, wanted: tuple[str, ...], views: list[BodyView], frame_plan: RenderPlan,
                       camera: PinholeCamera, shadows: dict) -> dict[str, np.ndarray]:
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
        origin_range_m = np.array([0.0 if body.relative_to_camera else view.range_m
                                   for view, body in zip(views, frame_plan.bodies, strict=True)] + [np.nan])
        angles[beside] = np.nan
        sunlit = place[..., 3].copy()
        place[beside] = np.nan
        made = {
            "range": lambda: origin_range_m[body_id] + angles[..., 0],
            "body_id": lambda: body_id,
            "facet_id": lambda: np.where(beside, -1, identity[..., 1] + 4096.0 * identity[..., 2]).astype(np.int32),
            "incidence": lambda: angles[..., 1].copy(),
            "emission": lambda: angles[..., 2].copy(),
            "phase": lambda: angles[..., 3].copy(),
            "r_body": lambda: place[..., :3].copy(),
            "sunlit": lambda: sunlit,
        }
        return {name: made[name]() for name in wanted}


def _add_samples(irradiance: np.ndarray, samples: np.ndarray, bounds_px: tuple[float, float, float, float]) -> None:
    """Add a grid of samples to the pixels in which they fall; each stands for its share of a pixel."""
    height, width = samples.shape
    x0, y0, x1, y1 = bounds_px
    column = np.floor(x0 + (np.arange(width) + 0.5) * (x1 - x0) / width + 0.5).astype(int)
    row = np.floor(y0 + (np.arange(height) + 0.5) * (y1 - y0) / height + 0.5).astype(int)
    rows_in, columns_in = ((index >= 0) & (index < size)
                           for index, size in zip((row, column), irradiance.shape, strict=True))
    share = (x1 - x0) * (y1 - y0) / (width * height)
    inside = samples[np.ix_(rows_in, columns_in)].astype(np.float64) * share
    np.add.at(irradiance, np.ix_(row[rows_in], column[columns_in]), inside.astype(np.float32))


class _Clock:
    """Laps in milliseconds, added up by name."""

    def __init__(self):
        self.laps_ms: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.laps_ms[name] = self.laps_ms.get(name, 0.0) + 1e3 * (now - self._last)
        self._last = now
