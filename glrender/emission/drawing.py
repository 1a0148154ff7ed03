"""Draws a coma into a frame: fields around the body, columns by the GPU, light added to the irradiance."""

from __future__ import annotations

import time
from contextlib import ExitStack

import cv2
import numpy as np
from glrender_camera import PinholeCamera

from ..emission_frame import EmissionFrame, EmissionPlan
from ..gl.coma_pass import ENDS, ComaPass, ComaVolume
from ..gl.context import Context
from ..gl.passes import Target
from ..scene import Scene
from ..view import BodyView
from .bake import SphericalBake
from .coma import Coma
from .fields import Field, SphericalField
from .geometry import phase_rad, shader_values, solid_angle_sr

_TILE_PX = 2048
# Pixels between nodes of the map of phase function and solid angle: bilinear between them.
_FACTOR_STEP_PX = 8


class ComaDrawing(ExitStack):
    """A coma's textures in a context; see `emission_frame.EmissionPass`."""

    def __init__(self, coma: Coma, context: Context, scene: Scene):
        super().__init__()
        self._coma, self._context = coma, context
        body = next(body for body in scene.bodies if body.name == coma.body)
        distance = np.linalg.norm(body.shape.vertices_m, axis=1)
        self._bake = SphericalBake(coma.sources, (float(distance.min()), float(distance.max())))
        self._pass = self.enter_context(ComaPass(context, len(scene.bodies)))
        self._surface = self.enter_context(Target(context, [2]))
        self._volumes: list[tuple[Field, ComaVolume]] = []

    def _current(self, view: BodyView) -> list[tuple[Field, ComaVolume, np.ndarray]]:
        if not self._volumes:
            for field in self._bake.fields(view.sun_direction_body):
                volume = self.enter_context(ComaVolume(self._context, field.texels(),
                                                       isinstance(field, SphericalField)))
                self._volumes.append((field, volume))
        return [(field, volume, np.eye(3)) for field, volume in self._volumes]

    def add(self, irradiance: np.ndarray, frame: EmissionFrame) -> EmissionPlan:
        """Add the coma's light; where its dust hides what is behind it, dim that."""
        began = time.perf_counter()
        view = frame.views[self._coma.body]
        fields = self._current(view)
        scale = frame.solar_irradiance_1au_W_m2 / view.sun_distance_au**2
        steps, per_node = 4, 4
        height, width = irradiance.shape
        for top in range(0, height, _TILE_PX):
            for left in range(0, width, _TILE_PX):
                box = (left, top, min(left + _TILE_PX, width), min(top + _TILE_PX, height))
                columns = self._columns(box, frame, fields, steps, per_node)
                tile = irradiance[box[1]:box[3], box[0]:box[2]]
                factor = self._light_per_column(frame.camera, view, box) * np.float32(scale)
                dust = self._coma.dust
                if dust.extinction_efficiency > 0.0:
                    tile *= dust.transmission(columns)
                tile += factor * dust.thin(columns)
        return EmissionPlan(kind="coma", body=self._coma.body, predicted_error=0.0, modelled={},
                            milliseconds=1e3 * (time.perf_counter() - began))

    def _columns(self, box, frame, fields, steps, per_node) -> np.ndarray:
        x0, y0, x1, y1 = box
        width, height = x1 - x0, y1 - y0
        view = frame.views[self._coma.body]
        inside = [(max(a - x0, 0), max(b - y0, 0), min(c - x0, width), min(d - y0, height)) for a, b, c, d in frame.rois]
        inside = [roi for roi in inside if roi[2] > roi[0] and roi[3] > roi[1]]
        if inside:
            frame.draw_surfaces(self._surface, "coma/surface.frag.glsl", (x0 - 0.5, y0 - 0.5, x1 - 0.5, y1 - 0.5),
                                (width, height))
        nodes = tuple(-(-(size - 1) // per_node) + 1 for size in (width, height))
        self._pass.begin(width, height)
        for field, volume, field_from_body in fields:
            values = shader_values(field, frame.camera, view, frame.views, field_from_body, (x0, y0))
            values |= {"shadow_from_field": np.eye(4), "pixels_per_node": per_node, "steps_per_end": steps}
            self._pass.march(volume, values, nodes)
            self._pass.add_columns(volume, values, None, [(0, 0, width, height)])
        return self._pass.read()

    def _light_per_column(self, camera: PinholeCamera, view: BodyView, box) -> np.ndarray:
        """Irradiance of a column of 1 over the Sun's (rows, columns) float32 [1], smooth over the image."""
        x0, y0, x1, y1 = box
        step = _FACTOR_STEP_PX
        across, down = -(-(x1 - x0) // step) + 2, -(-(y1 - y0) // step) + 2
        # cv2 takes nodes for the middles of cells of `step` pixels; one cell more on each side.
        x, y = (first + step * (np.arange(count) - 0.5) - 0.5 for first, count in ((x0, across), (y0, down)))
        pixel = np.stack(np.broadcast_arrays(x, y[:, None]), axis=-1)
        light = self._coma.dust.radiance_per_column(phase_rad(camera, view, pixel)) * solid_angle_sr(camera, pixel)
        fine = cv2.resize(light.astype(np.float32), (across * step, down * step), interpolation=cv2.INTER_LINEAR)
        return fine[step:step + y1 - y0, step:step + x1 - x0]
