"""The Cycles backend: a scene for Blender's process, samples until the error is known, pixels to irradiance."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from glrender_camera import PinholeCamera
from glrender_camera.validate import integer, positive

from ... import frames
from ...brdf import Lambert
from ...constants import AU_M, SUN_RADIUS_M
from ...image import Image, checked_products
from ...ray_engine import RayEngine
from ...scene import Body, Scene, checked_max_error
from ...state import State
from ...view import BodyView, view_bodies
from ..full_shape import full_shape_plan, traced_products, visible_region
from .osl import law_as_osl
from .process import BlenderProcess

MAX_BOUNCES = 64
_FIRST_SAMPLES, _MAX_SAMPLES = 8, 1 << 14
# A round has at most this many times the samples of all before it.
_GROWTH = 4
# Blender's y axis of the camera is up and its z axis is backwards.
_BLENDER_AXES = np.diag([1.0, -1.0, -1.0])
# Blender's units across the largest body: rays start off the surface by a share of the coordinates.
_UNITS_PER_RADIUS = 50.0
# Of the Sun's angular radius: a body whose Sun stands further off is told of.
_MAX_SUN_DIFFERENCE = 0.1
_FOCAL_LENGTH_PER_SIZE = 2000.0


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

    def __init__(self, scene: Scene, *, bounces: int = 4, deadline_s: float = 600.0, n_threads: int = 0):
        self.scene = scene
        self._bounces = integer("bounces", bounces, 0, MAX_BOUNCES)
        self._deadline_s = positive("deadline_s", deadline_s)
        self._n_threads = integer("n_threads", n_threads, 0, 1024)
        self._hulls = {body.name: body.hull for body in scene.bodies}
        self._origin_m = {name: 0.5 * (hull.points_m.min(axis=0) + hull.points_m.max(axis=0))
                          for name, hull in self._hulls.items()}
        self._is_lambert = all(isinstance(body.brdf, Lambert) for body in scene.bodies)
        self._blender: BlenderProcess | None = None
        self._rays: RayEngine | None = None
        self._start()

    def __enter__(self) -> Cycles:
        return self

    def __exit__(self, *exception) -> None:
        self.close()

    def close(self) -> None:
        """End Blender's process."""
        if self._blender is not None:
            self._blender.close()
            self._blender = None
        if self._rays is not None:
            self._rays.close()
            self._rays = None

    @property
    def info(self) -> dict[str, Any]:
        """Which engine draws."""
        version = "" if self._blender is None else self._blender.version
        return {"backend": "cycles", "gl_renderer": f"Cycles (Blender {version})", "gl_version": ""}

    def render(self, state: State, camera: str | None = None, *, max_error: float | None = None,
               products: Iterable[str] = ("irradiance",), samples: int | None = None, seed: int = 0,
               bounces: int | None = None, on_progress: Callable[[float], None] | None = None) -> Image:
        """Draw one frame until the standard error of its pixels is below the budget.

        Parameters
        ----------
        state, camera, products
            As `Renderer.render`; products are those of the pixel's centre, and need embreex.
        max_error : float [1], optional
            Root mean square standard error over the mean of the lit pixels.
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
        began = time.perf_counter()
        pinhole = self.scene.camera(camera)
        wanted = checked_products(products)
        budget = self.scene.max_error if max_error is None else checked_max_error(max_error)
        samples = None if samples is None else integer("samples", samples, 1, 128)
        seed = integer("seed", seed, 0, 2**20)
        bounces = self._bounces if bounces is None else integer("bounces", bounces, 0, MAX_BOUNCES)
        views = view_bodies(state, pinhole, self._hulls)
        roi = visible_region(views, pinhole)
        irradiance = np.zeros((pinhole.height_px, pinhole.width_px), np.float32)
        reached, warnings = 0.0, ()
        if roi != (0, 0, 0, 0):
            main = max((view for view in views if view.is_visible), key=lambda view: min(view.size_px, 1e9))
            asked = self._asked(main, views, pinhole, roi)
            scale = self._irradiance_scale(main, pinhole, roi)
            report = on_progress or (lambda share: None)
            rounds = _Rounds(lambda n, s, part: self._draw(asked, n, s, bounces, part) * scale, seed, report)
            reached = rounds.fixed(samples**2) if samples is not None else rounds.until(budget)
            x0, y0, x1, y1 = roi
            irradiance[y0:y1, x0:x1] = rounds.mean
            warnings = _sun_warnings(main, views)
            if samples is None and reached > budget:
                warnings += (f"the budget of {budget:g} is not met: {reached:.2g} with {_MAX_SAMPLES} samples",)
        arrays = {}
        if wanted:
            self._rays = self._rays or RayEngine(self.scene)
            arrays = traced_products(self._rays, wanted, pinhole, views, roi)
        left_out = ("light between facets",) if bounces == 0 else ()
        frame_plan = full_shape_plan(self.scene, pinhole, views, max_error=budget, predicted_error=reached, roi=roi,
                                     warnings=warnings, left_out=left_out)
        return Image(irradiance_W_m2=irradiance, products=arrays, plan=frame_plan,
                     timings_ms={"trace": 1e3 * (time.perf_counter() - began)})

    def _start(self) -> None:
        self._blender = BlenderProcess()
        unit = self._unit_m
        told, arrays = [], {}
        for index, body in enumerate(self.scene.bodies):
            told.append(_described(body))
            for key, array in _arrays(body, self._origin_m[body.name], unit).items():
                arrays[f"{key}/{index}"] = array
        self._ask({"op": "load", "bodies": told, "threads": self._n_threads}, arrays)

    @property
    def _unit_m(self) -> float:
        return max(hull.radius_m for hull in self._hulls.values()) / _UNITS_PER_RADIUS

    def _ask(self, head: dict[str, Any], arrays: dict[str, np.ndarray] | None = None,
             on_progress: Callable[[float], None] | None = None) -> dict[str, np.ndarray]:
        try:
            return self._blender.ask(head, arrays, deadline_s=self._deadline_s, on_progress=on_progress)
        except BaseException:
            # Of a request that was given up, by an error or by the caller, no answer may come later.
            self._blender.close()
            self._blender = None
            raise

    def _draw(self, asked: dict[str, Any], n_samples: int, seed: int, bounces: int,
              on_progress: Callable[[float], None]) -> np.ndarray:
        """Mean radiance (rows, columns) of the region [1/sr], for a Sun of 1 W/m2."""
        if self._blender is None:
            self._start()

        def draw(n_bounces: int, is_indirect: bool, part: int) -> np.ndarray:
            head = {"op": "draw", **asked, "samples": n_samples, "seed": seed, "bounces": n_bounces,
                    "is_indirect": is_indirect}
            n_parts = 1 if self._is_lambert or bounces == 0 else 3
            return self._ask(head, on_progress=lambda share: on_progress((part + share) / n_parts))["pixels"]

        if self._is_lambert or bounces == 0:
            return draw(bounces, False, 0).astype(np.float64)
        # The same paths twice: their difference is what came from other facets.
        between = draw(bounces, True, 0).astype(np.float64) - draw(0, True, 1)
        return draw(0, False, 2) + between

    def _asked(self, main: BodyView, views: list[BodyView], camera: PinholeCamera,
               roi: tuple[int, int, int, int]) -> dict[str, Any]:
        """Poses in the axes of the largest body in view, about its middle: what never moves is built once."""
        unit = self._unit_m
        middle = self._origin_m[main.name]
        main_from_camera = main.camera_from_body.T
        r_camera = main.r_camera_body_m - middle
        bodies = []
        for view in views:
            rotation = main_from_camera @ view.camera_from_body
            offset = main.r_camera_body_m - middle + rotation @ (self._origin_m[view.name] - view.r_camera_body_m)
            bodies.append(np.eye(4) if view is main else frames.transform(rotation, offset / unit))
        visible = [view for view in views if view.is_visible]
        share = _nearer(visible, camera)
        r_camera, middle_camera = share * r_camera, main.camera_from_body @ -r_camera
        focal_length_px, moved_m = share * camera.focal_length_px, (1.0 - share) * middle_camera[2]
        near = min(view.depth_m[0] for view in visible) - moved_m
        far = max(view.depth_m[1] for view in visible) - moved_m
        corner = camera.directions(np.array([[x, y] for x in (-0.5, camera.width_px - 0.5)
                                             for y in (-0.5, camera.height_px - 0.5)]))
        # The body's middle stays in its place of the image.
        cx, cy = np.array(camera.principal_point_px) + (
            0.0 if share == 1.0 else (1.0 - share) * camera.focal_length_px * middle_camera[:2] / middle_camera[2])
        width, height = camera.width_px, camera.height_px
        return {
            "bodies_from": [matrix.tolist() for matrix in bodies],
            "camera_from": frames.transform(main_from_camera @ _BLENDER_AXES, r_camera / unit).tolist(),
            "sun_from": frames.transform(_axes_along(main.sun_direction_body), np.zeros(3)).tolist(),
            "sun_angle_rad": 2.0 * math.asin(SUN_RADIUS_M / (main.sun_distance_au * AU_M)),
            "size_px": [width, height], "region_px": list(roi), "focal_length_px": focal_length_px,
            "shift": [-(cx - 0.5 * (width - 1)) / width, (cy - 0.5 * (height - 1)) / width],
            # Clipping is by range in some versions and by depth in others.
            "clip": [0.9 * near / unit, 1.1 * far / unit / float(corner[:, 2].min())]}

    def _irradiance_scale(self, main: BodyView, camera: PinholeCamera, roi: tuple[int, int, int, int]) -> np.ndarray:
        """Solar irradiance times the pixels' solid angles (rows, columns) [W sr/m2]."""
        x0, y0, x1, y1 = roi
        x, y = np.arange(x0, x1) - camera.principal_point_px[0], np.arange(y0, y1) - camera.principal_point_px[1]
        tangent2 = (x[None, :] ** 2 + y[:, None] ** 2) / camera.focal_length_px**2
        solar = self.scene.solar_irradiance_of(camera) / main.sun_distance_au**2
        return solar / camera.focal_length_px**2 * (1.0 + tangent2) ** -1.5


class _Rounds:
    """Two independent halves of a frame's samples; how they differ is the error of their mean.

    Parameters
    ----------
    draw : callable
        Samples a pixel, seed and progress to the mean of a frame (rows, columns) float64.
    seed : int
    report : callable
        Called with the share done.
    """

    def __init__(self, draw, seed: int, report: Callable[[float], None]):
        self._draw, self._seed, self._tell, self._told = draw, 2048 * seed, report, 0.0
        self._halves: list[Any] = [0.0, 0.0]
        self._n_samples, self._n_rounds = 0, 0

    @property
    def mean(self) -> np.ndarray:
        """Of all samples."""
        return 0.5 * (self._halves[0] + self._halves[1])

    def fixed(self, n_samples: int) -> float:
        """Draw this many samples a pixel; the error, or 0 where one sample tells none."""
        if n_samples == 1:
            self._halves = [self._draw(1, self._seed, self._report)] * 2
            return 0.0
        return self._round(n_samples // 2, n_samples - n_samples // 2, 0.0, 1.0)

    def until(self, budget: float) -> float:
        """Draw until the error is below the budget, or for _MAX_SAMPLES; the error."""
        n, done = _FIRST_SAMPLES, 0.0
        while True:
            # Of all the work, at the pace of n^-1/2, were this round the last.
            error = self._round(n // 2, n // 2, done, 0.5 * (1.0 + done))
            if error <= budget or self._n_samples >= _MAX_SAMPLES:
                self._report(1.0)
                return error
            done = min((budget / error) ** 2, 0.95)
            more = self._n_samples * ((error / budget) ** 2 - 1.0)
            n = int(min(max(more, 8.0), _GROWTH * self._n_samples, _MAX_SAMPLES - self._n_samples)) // 2 * 2
            if n < 2:
                return error

    def _report(self, share: float) -> None:
        """Guesses may fall; what is told does not."""
        self._told = max(self._told, min(share, 1.0))
        self._tell(self._told)

    def _round(self, first: int, second: int, begin: float, end: float) -> float:
        n_before = 0.5 * self._n_samples
        for half, n in enumerate((first, second)):
            low, high = begin + 0.5 * half * (end - begin), begin + 0.5 * (half + 1) * (end - begin)
            drawn = self._draw(n, self._seed + 2 * self._n_rounds + half,
                               lambda share, low=low, high=high: self._report(low + share * (high - low)))
            before = n_before / (n_before + n)
            self._halves[half] = before * self._halves[half] + (1.0 - before) * drawn
        self._n_samples, self._n_rounds = self._n_samples + first + second, self._n_rounds + 1
        lit = self.mean > 0.0
        if not lit.any():
            return 0.0
        return float(0.5 * np.sqrt(np.mean((self._halves[0] - self._halves[1])[lit] ** 2)) / self.mean[lit].mean())


def _nearer(visible: list[BodyView], camera: PinholeCamera) -> float:
    """Share of its range at which the camera stands, with as much less focal length: 1 unless it is far away.

    Blender's float32 puts rays 6e-8 focal lengths beside their pixels; from nearer, perspective puts the outline
    of a body of s px off by (s / 2)^2 / f. Both are the same at f = 2000 s: 0.12 px for 1000 px.
    """
    if any(view.bounds_px is None for view in visible):
        return 1.0
    bounds = np.array([view.bounds_px for view in visible])
    size_px = float((bounds[:, 2:].max(axis=0) - bounds[:, :2].min(axis=0)).max())
    return min(1.0, _FOCAL_LENGTH_PER_SIZE * size_px / camera.focal_length_px)


def _described(body: Body) -> dict[str, Any]:
    is_lambert = isinstance(body.brdf, Lambert)
    law = None if is_lambert else law_as_osl(body.brdf, body.albedo_map is not None)
    return {"name": body.name, "smooth": body.smooth_normals, "law": law,
            "normal_albedo": body.brdf.normal_albedo if is_lambert else 0.0}


def _arrays(body: Body, origin_m: np.ndarray, unit_m: float) -> dict[str, np.ndarray]:
    shape = body.shape
    arrays = {"vertices": ((shape.vertices_m - origin_m) / unit_m).astype(np.float32),
              "facets": shape.facets.astype(np.int32)}
    if body.smooth_normals:
        arrays["normals"] = shape.vertex_normals.astype(np.float32)
    if body.albedo_map is not None:
        # Blender repeats a texture: a row more on top and below, so that none comes round from the other end.
        texture = np.pad(body.albedo_map[::-1], ((1, 1), (0, 0)), mode="edge")
        uv = shape.uv.astype(np.float64)
        uv[..., 1] = (np.clip(uv[..., 1], 0.0, 1.0) * (len(texture) - 2) + 1.0) / len(texture)
        arrays |= {"texture": texture, "uv": uv.astype(np.float32)}
    return arrays


def _axes_along(direction: np.ndarray) -> np.ndarray:
    """Right-handed axes (3, 3), in columns, whose third is a unit vector."""
    other = np.eye(3)[np.argmin(np.abs(direction))]
    first = np.cross(other, direction)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(direction, first), direction], axis=1)


def _sun_warnings(main: BodyView, views: list[BodyView]) -> tuple[str, ...]:
    """Cycles has one Sun for all: a warning where that is not what a body sees."""
    sun_rad = SUN_RADIUS_M / (main.sun_distance_au * AU_M)
    warnings = []
    for view in views:
        there = view.camera_from_body @ view.sun_direction_body - main.camera_from_body @ main.sun_direction_body
        if np.linalg.norm(there) > _MAX_SUN_DIFFERENCE * sun_rad:
            warnings.append(f"{view.name}: lit from where {main.name} sees the Sun, "
                            f"{math.degrees(np.linalg.norm(there)):.2g} deg off")
    return tuple(warnings)
