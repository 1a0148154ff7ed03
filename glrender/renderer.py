"""The renderer: owns the context and the buffers, and carries out what the planner decided."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from glrender_camera import CameraModel, PinholeCamera

from .base.errors import ConfigError, DeviceError
from .base.own_process import OwnProcess
from .base.stopwatch import Clock
from .brdf import Law
from .engines.coverage.engine import CoverageEngine
from .engines.derivatives.by_noise import LOOSE, tolerance_of_sigmas
from .engines.derivatives.gradient import Gradient, Weights, checked_weights, gradient_of
from .engines.derivatives.parameters import checked_derivatives
from .engines.derivatives.refusals import check_derivable
from .engines.derivatives.region_derivatives import derivatives_of
from .engines.emissions import Emissions
from .engines.image import Image, checked_products
from .engines.irradiance import IrradiancePass
from .engines.plugin_checks import try_twin
from .engines.prepared_body import PreparedBody
from .engines.raster.gl.context import Context
from .engines.raster.gl.evaluate import BrdfEvaluator
from .engines.raster.gl.targets import DEPTH_BYTES, PixelMask, Target
from .engines.raster.meshes import body_meshes, body_traits
from .engines.raster.product_pass import ProductPass
from .engines.raster.shadow_maps import Shadows
from .engines.raster.surface_pass import Frame, SurfacePass
from .engines.rays.engine import RayEngine
from .engines.rays.products import traced_products
from .planner.account import Drawn, account
from .planner.error_model import rounding_px
from .planner.frame_plan import FramePlan, plan_frame
from .planner.request import ENGINES, WHOLE_IMAGE, ImageUse, Request
from .planner.seen import seen_bodies
from .planner.walls import between_walls
from .scene.plugins.registry import OPENGL_BACKENDS, backends
from .scene.scene import Scene
from .scene.tolerance import LEAST, LEAST_DEADLINE_S, SIGMAS, checked_deadline, checked_max_error
from .view.regions import union
from .view.state import State

# How far OpenGL may put places off in products.
_MOST_ROUNDING_PX = 0.02


class Renderer:
    """Draws a scene's states. One thread makes it, uses it and closes it; a forked child makes its own.

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

    settings: tuple[str, ...] = ()
    options: tuple[str, ...] = ("engine", "deadline_s", "use", "derivatives")

    def __init__(self, scene: Scene, backend: str = "auto", device_index: int | None = None):
        if not isinstance(scene, Scene):
            raise ConfigError("scene", "must be a Scene", scene)
        self._own, self.scene, self._is_closed = OwnProcess(), scene, False
        with ExitStack() as stack:
            self._context = stack.enter_context(Context(backend, device_index))
            meshes = [tuple(map(stack.enter_context, body_meshes(self._context, body))) for body in scene.bodies]
            rays = coverage = None
            try:
                rays = RayEngine(scene)
                stack.callback(rays.close)
                coverage = CoverageEngine(scene, rays)
                stack.callback(coverage.close)
            except DeviceError:
                pass  # embreex has no wheel for every machine: OpenGL draws all there
            self._rays, self._engines = rays, ENGINES if rays is not None else ("raster",)
            if scene.lamps:
                self._engines = _for_lamps(scene, rays)
            self._bodies = {body.name: PreparedBody(
                index=index, body=body, traits=body_traits(body), meshes=meshes[index],
                solid=None if rays is None else rays.solid(body.name),
                facets=None if coverage is None else coverage.facets(body.name))
                for index, body in enumerate(scene.bodies)}
            self._left_out = between_walls(scene)
            self._shadows = Shadows(self._context, scene, self._bodies)
            stack.callback(self._shadows.close)
            mask, irradiance, products = (stack.enter_context(each) for each in (
                PixelMask(self._context), Target(self._context, [1]), Target(self._context, [4, 4, 4])))
            self._surfaces = SurfacePass(mask, scene, self._bodies)
            self._irradiance = IrradiancePass(self._context, irradiance, self._surfaces, rays, coverage)
            self._products = ProductPass(products, self._surfaces, scene)
            for law in {id(law): law for body in scene.bodies for law in body.laws}.values():
                try_twin(law, self.evaluate_brdf)
            self._emissions = Emissions(self._context, scene, self._surfaces, self._shadows)
            stack.callback(self._emissions.close)
            self._stack = stack.pop_all()

    def __enter__(self) -> Renderer:
        return self

    def __exit__(self, *exception) -> None:
        self.close()

    def close(self) -> None:
        """Release the context and all that lives in it; in a forked child it does nothing, as nothing is its own."""
        self._is_closed = True
        if self._own.is_here:
            self._stack.close()
            # Images with derivatives keep their renderer.
            self._bodies.clear()

    def _check_open(self) -> None:
        """Refuse another process, and a renderer that was closed."""
        self._own.check()
        if self._is_closed:
            raise DeviceError("this renderer is closed; open another one (an image's gradients draw its frame anew: "
                              "ask for them before)")

    @property
    def info(self) -> dict[str, Any]:
        """The OpenGL that was found: backend, gl_renderer, gl_version, limits; the engines; the memory of each body."""
        return {**self._context.info, "engines": self._engines,
                "memory_bytes": {name: body.memory_bytes for name, body in self._bodies.items()}}

    @property
    def draws_lenses(self) -> bool:
        """Whether it draws what a camera that distorts sees: with rays, and without the light of a coma."""
        return self._rays is not None and not self._emissions

    def evaluate_brdf(self, law: Law, to_sun: np.ndarray, to_camera: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """BRDF [1/sr] of (N, 3) unit vectors, (N,) float32, by the very GLSL function that draws."""
        return BrdfEvaluator(self._context)(law, to_sun, to_camera, normal)

    def render(self, state: State, camera: str | PinholeCamera | None = None, *,
               max_error: float | Mapping[str, float] | None = None, products: Iterable[str] = ("irradiance",),
               samples: int | None = None, engine: str | None = None, deadline_s: float | None = None,
               use: ImageUse = WHOLE_IMAGE, derivatives: Iterable[str] = ()) -> Image:
        """Draw one frame.

        Parameters
        ----------
        state : State
        camera : str or PinholeCamera, optional
            Name; the scene's only camera by default. Or a camera that draws for one of the scene's, whose name it has.
        max_error : float [1] or mapping, optional
            Error tolerance instead of the scene's: RMS, or of each unit that it names out of ``rms``, ``flux``,
            ``centroid_px``, ``limb_px``, ``range``. All that are named are met with the least work. ``sigmas``: in
            deviations of the place that the camera's noise lets be known, which costs a frame with derivatives.
        products : iterable of str
            Out of `PRODUCTS`; ``irradiance`` is always drawn.
        samples : int, optional
            Samples along every pixel's side instead of the planner's choice, by OpenGL.
        engine : {"coverage", "rays", "raster"}, optional
            The only engine that may draw; the planner's choice by default.
        deadline_s : float [s], > 0, optional
            After which nothing more is begun: the frame is then the best so far, and its plan says so.
        use : ImageUse, optional
            `capture` passes it.
        derivatives : iterable of str
            Parameters by which the image is differentiated: ``spacecraft``, ``bodies.NAME``, ``sun``,
            ``focal_length``, and ``law.NAME`` of a law's number (docs/derivatives.md).

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
        self._check_open()
        clock, wanted, deadline = Clock(), checked_products(products), _deadline(deadline_s)
        names = checked_derivatives(derivatives, self.scene)
        request = self._by_noise(state, self._request(camera, max_error, samples, engine, use, bool(names)), deadline)
        plan, frame, drawn = self._drawn(state, request, names, clock, deadline)
        irradiance = drawn.irradiance_W_m2
        made = account(plan, drawn, self._left_out)
        if self._emissions:
            made = self._emissions.add(irradiance, state, frame, made)
            clock.lap("emission")
        jacobian, gradient = None, None
        if names:
            gradient = partial(self.gradient, state, camera=request.camera, max_error=request.max_error)
            jacobian, errors = derivatives_of(names, drawn, frame, self._rays)
            made = replace(made, jacobian_error=errors)
            clock.lap("derivatives")
        arrays = {}
        if wanted:
            arrays = self._drawn_products(wanted, plan, frame, drawn)
            clock.lap("products")
        made = replace(made, milliseconds=sum(clock.laps_ms.values()), memory_bytes=self._added_bytes(frame))
        return Image(irradiance_W_m2=irradiance, products=arrays, plan=made, jacobian=jacobian, gradient=gradient,
                     small_bodies=drawn.small_bodies, timings_ms=clock.laps_ms,
                     request=(self.scene, state, request.camera))

    def gradient(self, state: State, weights: Weights, camera: str | PinholeCamera | None = None, *,
                 max_error: float | Mapping[str, float] | None = None) -> Gradient:
        """The gradient of the sum of weights times one frame's irradiance, with respect to bodies' shapes and albedos.

        Parameters
        ----------
        state : State
        weights : (height, width) array, or callable
            Of pixels; or a function that makes them of the frame's irradiance [W/m2].
        camera, max_error
            As `render` takes them.

        Returns
        -------
        Gradient
            By the names of bodies; with the frame.

        Raises
        ------
        SceneError
            The state cannot be rendered.
        ConfigError
            An argument breaks a rule, or the frame has what has no derivatives (docs/derivatives.md).
        """
        self._check_open()
        request = self._by_noise(state, self._request(camera, max_error, None, None, WHOLE_IMAGE, True), math.inf)
        if not callable(weights):
            weights = checked_weights(weights, (request.camera.height_px, request.camera.width_px))
        _, frame, drawn = self._drawn(state, request, (), Clock(), math.inf)
        return gradient_of(weights, drawn, frame, self._rays)

    def _drawn(self, state: State, request: Request, names: Sequence[str], clock: Clock, deadline: float
               ) -> tuple[FramePlan, Frame, Drawn]:
        """The light of surfaces, with what it was drawn by; refused where parameters by name have no derivatives."""
        traits = [body.traits for body in self._bodies.values()]
        seen = seen_bodies(state, request.camera, self.scene, traits)
        if request.has_derivatives:
            check_derivable(names, self.scene, request, seen)
        plan, irradiance = plan_frame(seen, request), _blank(request.camera, request.use.out)
        clock.lap("plan")
        frame = self._frame(plan)
        clock.lap("shadow")
        return plan, frame, self._irradiance.draw(plan, frame, irradiance, clock, deadline)

    def _added_bytes(self, frame: Frame) -> dict[str, int]:
        """Memory [byte] that a frame takes beyond what opening took."""
        texels = sum(across * down for across, down in (body.shadow_map_drawn_px for body in frame.bodies))
        return {"near_facets": 0 if self._rays is None else self._rays.near_bytes(frame.views),
                "shadow_maps": DEPTH_BYTES * texels}

    def _request(self, camera: str | PinholeCamera | None, max_error: float | Mapping[str, float] | None,
                 samples: int | None, engine: str | None, use: ImageUse, has_derivatives: bool) -> Request:
        """The frame's demands, checked."""
        request = Request(
            camera=self.scene.drawn_camera(camera, self.draws_lenses), use=use, samples=samples, engine=engine,
            engines=self._engines, has_derivatives=has_derivatives,
            max_error=self.scene.max_error if max_error is None else checked_max_error(max_error),
            has_gpu=not self._context.is_software, has_sun_disc=self.scene.sun_disc)
        return replace(request, use=replace(request.use, apart_px=0.0)) if self._emissions.dims else request

    def _by_noise(self, state: State, request: Request, deadline: float) -> Request:
        """The request with an RMS error in place of deviations by the camera's noise, which a first frame tells."""
        asked = request.max_error
        if not isinstance(asked, Mapping) or SIGMAS not in asked:
            return request
        path, sigmas = f"max_error.{SIGMAS}", asked[SIGMAS]
        if not isinstance(request.camera.model, CameraModel):
            raise ConfigError(path, "must be of a camera with a model of one band, whose noise counts", sigmas,
                              "give the camera a detector, or take a number for max_error")
        try:
            first = self.render(state, request.camera, max_error=LOOSE, derivatives=["spacecraft"],
                                deadline_s=_time_left(deadline))
        except ConfigError as error:
            if error.path != "derivatives":
                raise
            raise ConfigError(path, f"needs derivatives: these {error.rule}", sigmas,
                              f"{error.hint}, or take a number for max_error") from None
        rms = min(max(tolerance_of_sigmas(first, sigmas) * request.use.error_gain, LEAST), asked.get("rms", 1.0))
        rest = {unit: most for unit, most in asked.items() if unit != SIGMAS}
        return replace(request, max_error={**rest, "rms": rms} if rest else rms)

    def _frame(self, plan: FramePlan) -> Frame:
        """The bodies, with the shadow maps that the first ways to draw them need."""
        self._context.make_current()
        self._shadows.begin_frame()
        views, camera = [seen.view for seen in plan.seen], plan.request.camera
        by_raster = {name for options in plan.options if options[0].engine == "raster" for name in options[0].bodies}
        shadows, bodies = self._shadows.draw(views, plan.bodies, camera, by_raster)
        return Frame(camera=camera, views=views, bodies=bodies, shadows=shadows)

    def _drawn_products(self, wanted: Sequence[str], plan: FramePlan, frame: Frame, drawn: Drawn
                        ) -> dict[str, np.ndarray]:
        """Products by OpenGL; by rays where its coordinates are too coarse, or where a lens distorts.

        Where rays draw the image, they say what the Sun lights as well: shadow maps may be too coarse for it.
        """
        views, bodies, camera = list(frame.views), frame.bodies, frame.camera
        roi = union([w.roi for w in drawn.windows])
        is_traced = camera.lens_map is not None or self._rays is not None and max(
            rounding_px(seen.view, seen.traits, body.relative_to_camera)
            for seen, body in zip(plan.seen, bodies, strict=True)) > _MOST_ROUNDING_PX
        if is_traced:
            traced = traced_products(self._rays, wanted, camera, views, roi)
            return {name: values.astype(np.float32) if values.dtype == np.float64 and name != "range" else values
                    for name, values in traced.items()}
        shadows, traced = {}, {}
        if "sunlit" in wanted and any(window.engine == "rays" for window in drawn.windows):
            lit = traced_products(self._rays, ("sunlit",), camera, views, roi)["sunlit"]
            traced = {"sunlit": lit.astype(np.float32)}
        elif "sunlit" in wanted:
            shadows, _ = self._shadows.draw(views, bodies, camera)
        rest = [name for name in wanted if name not in traced]
        return {**self._products.draw(rest, replace(frame, shadows=shadows), drawn.windows), **traced}

    def forget_shadow_maps(self) -> None:
        """Draw all shadow maps anew when next they are needed; no image changes."""
        self._shadows.close()


def open_renderer(scene: Scene, backend: str = "auto", device_index: int | None = None, **options: Any) -> Any:
    """A `Renderer`, or the plug-in of that name with the same interface, e.g. ``raytrace``.

    Parameters
    ----------
    scene : Scene
    backend : str
    device_index : int, optional
        Of OpenGL.
    **options
        The plug-in's own, e.g. ``bounces`` of ``cycles``.

    Raises
    ------
    ConfigError
        No such backend, or no such option of it.
    PluginError
        The plug-in is broken; the message names its package.
    DeviceError
        The backend does not work here; the message says what to install.
    """
    if backend in OPENGL_BACKENDS:
        made, arguments = Renderer, {"backend": backend, "device_index": device_index}
    elif not isinstance(backend, str) or backend not in backends():
        raise ConfigError("backend", f"must be one of {', '.join((*OPENGL_BACKENDS, *backends()))}", backend)
    else:
        made, arguments = backends()[backend], {}
    for name in options:
        if name not in made.settings:
            raise ConfigError(name, f"is no option of backend {backend!r}",
                              hint=f"it has {', '.join(made.settings)}" if made.settings else "it has none")
    return made(scene, **arguments, **options)


def _for_lamps(scene: Scene, rays: RayEngine | None) -> tuple[str, ...]:
    """The engines that draw a scene with lamps: rays alone, which draw no surface detail."""
    for index, body in enumerate(scene.bodies):
        if body.detail is not None:
            raise ConfigError(f"bodies[{index}].detail", "goes without lamps: rays draw them, and no surface detail",
                              hint="leave one out; the backend cycles draws both")
    if rays is None:
        raise DeviceError("lamps are drawn by rays, which need embreex: pip install embreex")
    return ("rays",)


def _deadline(seconds: float | None) -> float:
    """The end [s] by `time.monotonic` of a time from now on."""
    return math.inf if seconds is None else time.monotonic() + checked_deadline(seconds)


def _time_left(deadline: float) -> float | None:
    """The time [s] until a deadline: the least where it has passed, and none where there is no deadline."""
    return max(deadline - time.monotonic(), LEAST_DEADLINE_S) if math.isfinite(deadline) else None


def _blank(camera: PinholeCamera, out: np.ndarray | None) -> np.ndarray:
    """A dark image of a camera, in `out` if that is given."""
    shape = (camera.height_px, camera.width_px)
    if out is None:
        return np.zeros(shape, np.float32)
    if not isinstance(out, np.ndarray):
        raise ConfigError("out", f"must be a float32 array of shape {shape}", out)
    if out.shape != shape or out.dtype != np.float32 or not out.flags.writeable:
        raise ConfigError("out", f"must be float32 of shape {shape}, and writeable", f"{out.dtype} of {out.shape}")
    out.fill(0.0)
    return out
