"""The Cycles backend: a scene for Blender's process, samples until the error is known, pixels to irradiance."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from glrender_camera import PinholeCamera
from glrender_camera.validate import integer, positive

from ...base.errors import ConfigError, DeviceError
from ...base.own_process import OwnProcess
from ...brdf import Lambert
from ...planner.adaptive_samples import frame_error
from ...planner.predicted import rms_tolerance
from ...scene.scene import Body, Scene
from ...scene.shape.shape import Shape
from ...scene.tolerance import checked_max_error
from ...view.regions import region, touching
from ...view.state import State
from ...view.view import BodyView, view_bodies
from ..image import Image, checked_products
from ..rays.aimed import AimedRays
from ..rays.emission import Emitted
from ..rays.engine import RayEngine
from ..rays.products import full_shape_plan, traced_products
from .blender_terms import BlenderTerms, warnings_of
from .displaced_mesh import displaced
from .lens import Lens
from .process import BlenderProcess
from .rounds import MAX_SAMPLES, Rounds

MAX_BOUNCES = 64


class Cycles:
    """Draws a scene's states with Blender's Cycles, on the CPU; the interface is `Renderer`'s.

    The Sun is a disc of its angular size, and with bounces facets light each other. Lambert's law is
    exact; of other laws what the Sun lights is exact, what other facets light is not: `osl.py`.

    Parameters
    ----------
    scene : Scene
    bounces : int, 0..64
        Between facets, at most; 0 is direct sunlight alone.
    deadline_s : float [s]
        Blender is killed if it takes longer for one draw.
    n_threads : int
        0 for all cores.

    Raises
    ------
    DeviceError
        There is no Blender, or it does not start; the message says what to install.
    """

    settings: tuple[str, ...] = ("bounces", "deadline_s", "n_threads")
    options: tuple[str, ...] = ("seed", "bounces", "on_progress")

    def __init__(self, scene: Scene, *, bounces: int = 4, deadline_s: float = 600.0, n_threads: int = 0):
        self._own, self.scene = OwnProcess(), scene
        self._bounces = integer("bounces", bounces, 0, MAX_BOUNCES)
        self._deadline_s = positive("deadline_s", deadline_s)
        self._n_threads = integer("n_threads", n_threads, 0, 1024)
        self._hulls = scene.hulls
        self._terms = BlenderTerms(scene)
        self._is_lambert = all(type(law) is Lambert for body in scene.bodies for law in body.laws)
        if scene.lamps and not self._is_lambert:
            raise ConfigError("lamps", "shine on Lambert's law alone in the backend cycles", None,
                              "the backends raytrace and auto draw them with every law")
        for body in scene.bodies:
            if has_two_faces(body):
                raise ConfigError("albedo_map" if body.materials is None else "materials",
                                  "must be the same on both sides of a sheet in the backend cycles",
                                  body.name, "the backends raytrace and auto draw each side's own")
        self._blender: BlenderProcess | None = None
        self._rays: RayEngine | None = None
        self._emitted = Emitted(scene, self._ray_engine)
        self._start()

    def __enter__(self) -> Cycles:
        return self

    def __exit__(self, *exception) -> None:
        self.close()

    def close(self) -> None:
        """End Blender's process; in a forked child it does nothing."""
        if not self._own.is_here:
            return
        if self._blender is not None:
            self._blender.close()
            self._blender = None
        if self._rays is not None:
            self._rays.close()
            self._rays = None

    @property
    def info(self) -> dict[str, Any]:
        """The name and the version of the engine that draws."""
        version = "" if self._blender is None else self._blender.version
        return {"backend": "cycles", "gl_renderer": f"Cycles (Blender {version})", "gl_version": ""}

    def render(self, state: State, camera: str | PinholeCamera | None = None, *, max_error: float | None = None,
               products: Iterable[str] = ("irradiance",), samples: int | None = None, seed: int = 0,
               bounces: int | None = None, on_progress: Callable[[float], None] | None = None) -> Image:
        """Draw one frame until the standard error of its pixels is below the tolerance.

        Parameters
        ----------
        state, camera, products
            As `Renderer.render`; products are those of the pixel's centre, and need embreex.
        max_error : float [1] or mapping, optional
            Root mean square standard error over the mean of the lit pixels, or as `Renderer.render`.
        samples : int, optional
            samples x samples paths a pixel, whatever their error.
        seed : int
            Equal seeds give equal images.
        bounces : int, 0..64, optional
            Instead of the renderer's.
        on_progress : callable, optional
            Called with the share done, 0..1; a guess while rounds are still to come. If it raises, the
            frame is given up.

        Returns
        -------
        Image
            `plan.predicted_error` is the standard error reached, from two independent halves.

        Raises
        ------
        DeviceError
            Blender failed, died or overran the deadline; the next frame starts another.
        """
        self._own.check()
        began = time.perf_counter()
        pinhole = self.scene.drawn_camera(camera)
        wanted = checked_products(products)
        max_error = self.scene.max_error if max_error is None else checked_max_error(max_error)
        samples = None if samples is None else integer("samples", samples, 1, 128)
        seed = integer("seed", seed, 0, 2**20)
        bounces = self._bounces if bounces is None else integer("bounces", bounces, 0, MAX_BOUNCES)
        views = view_bodies(state, pinhole, self._hulls)
        tolerance = rms_tolerance(max_error, views, pinhole)
        roi = region(views, pinhole)
        irradiance = np.zeros((pinhole.height_px, pinhole.width_px), np.float32)
        reached, most, warnings = 0.0, 0, ()
        groups = touching(views, pinhole)
        for index, group in enumerate(groups):
            members = list(group.views)
            main = max(members, key=lambda view: min(view.size_px, 1e9))
            lens = Lens.of(group, pinhole)
            asked = self._terms.view(main, members, views, lens)
            solar = self.scene.solar_irradiance_of(pinhole) / main.sun_distance_au**2
            asked["lamps"] = self._terms.lamps(main, pinhole, solar)
            self._shape_ground(members, pinhole)
            draw = partial(self._pixels, asked, lens, solar, bounces)
            rounds = Rounds(draw, seed, _part_of(on_progress, index, len(groups)))
            error = rounds.fixed(samples**2) if samples is not None else rounds.until(tolerance)
            most = max(most, rounds.n_samples)
            x0, y0, x1, y1 = lens.roi
            irradiance[y0:y1, x0:x1] = rounds.mean
            reached = max(reached, error)
            warnings += tuple(text for text in warnings_of(main, views, lens, asked) if text not in warnings)
        if groups and not irradiance.any():
            reached = max(reached, self._missed(pinhole, views, roi, seed))
        way_out = "leave samples out"
        if samples is None:
            way_out = f"it is out of reach with {MAX_SAMPLES} samples a pixel, of which {most} were drawn"
        arrays = traced_products(self._ray_engine(), wanted, pinhole, views, roi) if wanted else {}
        left_out = ("light between facets",) if bounces == 0 else ()
        frame_plan = full_shape_plan(self.scene, pinhole, views, max_error=max_error, predicted_error=reached, roi=roi,
                                     warnings=warnings, left_out=left_out, way_out=way_out)
        frame_plan = self._emitted.add(irradiance, state, pinhole, views, frame_plan)
        took_ms = 1e3 * (time.perf_counter() - began)
        return Image(irradiance_W_m2=irradiance, products=arrays, plan=replace(frame_plan, milliseconds=took_ms),
                     request=(self.scene, state, pinhole), timings_ms={"trace": took_ms})

    def _missed(self, camera: PinholeCamera, views: list[BodyView], roi: tuple[int, int, int, int], seed: int) -> float:
        """Error of a dark frame: all, where rays of the facets that face Sun and camera find light."""
        try:
            aimed = AimedRays(self._ray_engine(), camera, views, roi)
            found, error = aimed.until(1.0, np.random.default_rng(seed))
        except DeviceError:
            # Without embreex nobody knows.
            return 1.0
        return frame_error(found, found) or aimed.of_darkness(error)

    def _ray_engine(self) -> RayEngine:
        if self._rays is None:
            self._rays = RayEngine(self.scene)
        return self._rays

    def _start(self) -> None:
        self._blender = BlenderProcess()
        self._displaced: set[int] = set()
        described, arrays = self._terms.bodies()
        lamps = [{"half_angle_rad": math.radians(lamp.half_angle_deg)} for lamp in self.scene.lamps]
        self._ask({"op": "load", "bodies": described, "lamps": lamps, "threads": self._n_threads}, arrays)

    def _shape_ground(self, members: list[BodyView], camera: PinholeCamera) -> None:
        """Give Blender the ground that the camera resolves of bodies with detail."""
        for index, body in enumerate(self._terms.drawn):
            view = next((view for view in members if view.name == body.name), None)
            if body.relief is None or view is None:
                continue
            made = displaced(body, view, camera)
            if made is not body or index in self._displaced:
                if self._blender is None:
                    self._start()
                self._ask({"op": "shape", "index": index}, self._terms.arrays(made))
                self._displaced.add(index)

    def _ask(self, head: dict[str, Any], arrays: dict[str, np.ndarray] | None = None,
             on_progress: Callable[[float], None] | None = None) -> dict[str, np.ndarray]:
        try:
            return self._blender.ask(head, arrays, deadline_s=self._deadline_s, on_progress=on_progress)
        except BaseException:
            # A request that was given up, by an error or by the caller, must get no answer later.
            self._blender.close()
            self._blender = None
            raise

    def _pixels(self, asked: dict[str, Any], lens: Lens, solar: float, bounces: int, n_samples: int, seed: int,
                on_progress: Callable[[float], None]) -> np.ndarray:
        """Irradiance (rows, columns) [W/m2 per pixel] of a lens's pixels, for a Sun of `solar` W/m2."""
        radiance = self._draw(asked, n_samples, seed, bounces, on_progress)
        return lens.pixels(radiance * lens.solid_angles_sr()) * solar

    def _draw(self, asked: dict[str, Any], n_samples: int, seed: int, bounces: int,
              on_progress: Callable[[float], None]) -> np.ndarray:
        """Mean radiance (rows, columns) of the region [1/sr], for a Sun of 1 W/m2."""
        if self._blender is None:
            self._start()

        n_parts = 1 if self._is_lambert or bounces == 0 else 3

        def draw(n_bounces: int, is_indirect: bool, part: int) -> np.ndarray:
            head = {"op": "draw", **asked, "samples": n_samples, "seed": seed, "bounces": n_bounces,
                    "is_indirect": is_indirect}
            drawn = self._ask(head, on_progress=lambda share: on_progress((part + share) / n_parts))["pixels"]
            # Not every Blender reports its samples as it goes.
            on_progress((part + 1) / n_parts)
            return drawn

        if n_parts == 1:
            return draw(bounces, False, 0).astype(np.float64)
        # The same paths twice: their difference is what came from other facets.
        between = draw(bounces, True, 0).astype(np.float64) - draw(0, True, 1)
        return draw(0, False, 2) + between


def _part_of(on_progress: Callable[[float], None] | None, index: int, count: int) -> Callable[[float], None]:
    """A callback by which one of several equal parts reports the share of the whole."""
    return lambda share: None if on_progress is None else on_progress((index + share) / count)


def has_two_faces(body: Body) -> bool:
    """Whether a sheet of a body has another look on its other side: Blender would draw either of the two."""
    shape, other = body.shape, body.shape.other_side
    if other is None:
        return False
    sheet = np.flatnonzero(other >= 0)
    if body.materials is not None and (body.looks[sheet] != body.looks[other[sheet]]).any():
        return True
    mapped = np.concatenate([sheet[:0], *(np.intersect1d(sheet, facets)
                                          for part, facets in zip(body.parts, body.part_facets, strict=True)
                                          if part.albedo_map is not None)])
    return bool((_uv_by_vertex(shape, mapped) != _uv_by_vertex(shape, other[mapped])).any())


def _uv_by_vertex(shape: Shape, facet: np.ndarray) -> np.ndarray:
    """Texture coordinates of facets' corners in the order of their vertices' numbers; nothing without."""
    if shape.uv is None:
        return np.zeros(0)
    order = np.argsort(shape.facets[facet], axis=1)
    return np.take_along_axis(shape.uv[facet], order[..., None], axis=1)
