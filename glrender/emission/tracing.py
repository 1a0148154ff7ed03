"""A coma in the frame of a backend that traces rays: the float64 line integral along each pixel's ray.

Light is linear, so the coma's is added to that of the surfaces: the same integral that a path tracer would sample in
a volume of single scattering, without its noise. Pixels at the bodies' edges are means over their area.
"""

from __future__ import annotations

import time
from dataclasses import replace

import cv2
import numpy as np

from ..base import rotations as frames
from ..engines.emission_interface import TracedFrame
from ..planner.plan import EmissionPlan
from ..scene.scene import Scene
from .column import columns
from .layers import Layer, Layers
from .light import add_light, is_point, point_correction
from .planning import Sampling, choose
from .settings import ComaSettings
from .telling import told

_RAYS_AT_ONCE = 1 << 14
# Samples along the side of a pixel at an edge, and what makes one: surfaces so far apart in depth, in body radii.
_EDGE_SAMPLES, _EDGE_RADII = 4, 0.2


class ComaTracing:
    """A coma's tables; see `emission_frame.TracedEmission`."""

    def __init__(self, coma: ComaSettings, scene: Scene):
        self._coma = coma
        self._layers = Layers(coma.sources, next(body.shape for body in scene.bodies if body.name == coma.body))

    def add(self, irradiance: np.ndarray, frame: TracedFrame) -> EmissionPlan:
        """Add the coma's light; where its dust hides surfaces, dim these."""
        began = time.perf_counter()
        view, camera = frame.views[self._coma.body], frame.camera
        has_shadow, q = self._coma.has_shadow, self._coma.dust.extinction_efficiency
        body_from_inertial = frames.dcm(frame.state.bodies[view.name].q_from_inertial)
        drawn = [(layer, choose(layer.errors, view.range_m / camera.focal_length_px, self._layers.radius_m,
                                0.5 * max(camera.width_px, camera.height_px), frame.max_error, has_shadow,
                                1.0 / camera.focal_length_px, per_node=(1,), per_far=()))
                 for layer in self._layers.at(view.sun_direction_body)]
        rotations = [layer.field_from_body(body_from_inertial, view.sun_direction_body) for layer, _ in drawn]
        rays = _Rays(frame, self._coma.body, drawn, rotations, is_point(self._layers.radius_m, view, camera))
        column = rays.image(_EDGE_RADII * self._layers.radius_m, has_shadow)
        hidden = rays.image(_EDGE_RADII * self._layers.radius_m, False) if has_shadow and q > 0.0 else column
        box = (0, 0, camera.width_px, camera.height_px)
        if rays.is_point:
            point_correction(column, camera, view, 1e-3 * self._layers.least_m, self._layers.radius_m, box)
        greatest = float(hidden.max())
        solar_irradiance = frame.solar_irradiance_1au_W_m2 / view.sun_distance_au**2
        add_light(irradiance, column, hidden, camera, view, self._coma.dust, box, solar_irradiance)
        return told(self._coma, drawn, greatest, 1e3 * (time.perf_counter() - began))


class _Rays:
    """The columns of a frame's rays, by all fields.

    A nucleus that is a point in its coma ends no ray: `light.point_correction` takes out the light that it hides.
    """

    def __init__(self, frame: TracedFrame, body: str, drawn: list[tuple[Layer, Sampling]],
                 rotations: list[np.ndarray], is_point: bool):
        self.is_point = is_point
        self._frame, self._view = frame, frame.views[body]
        self._bodies = tuple(name for name in frame.views if not (is_point and name == body))
        least = 1e-3 if is_point else 1.0
        self._fields = [(replace(layer.field, least_m=least * layer.field.least_m),
                         max(sampling.steps, sampling.front_steps), rotation)
                        for (layer, sampling), rotation in zip(drawn, rotations, strict=True)]

    def image(self, edge_m: float, has_shadow: bool) -> np.ndarray:
        """Columns (height, width) float32 [1]; at edges of more than `edge_m`, means over pixels."""
        height, width = self._frame.camera.height_px, self._frame.camera.width_px
        y, x = (axis.ravel() for axis in np.mgrid[:height, :width])
        pixel = np.stack([x, y], axis=1).astype(np.float64)
        column, range_m = self._columns(pixel, has_shadow)
        # Nothing at all is as far as a surface far behind.
        deep = np.minimum(range_m, self._view.range_m * 2.0 + 1e3 * edge_m).reshape(height, width)
        kernel = np.ones((3, 3), np.uint8)
        is_edge = np.flatnonzero(cv2.dilate(deep, kernel) - cv2.erode(deep, kernel) > edge_m)
        if len(is_edge):
            offsets = (np.arange(_EDGE_SAMPLES) + 0.5) / _EDGE_SAMPLES - 0.5
            column[is_edge] = np.mean([self._columns(pixel[is_edge] + (dx, dy), has_shadow)[0]
                                       for dy in offsets for dx in offsets], axis=0)
        return column.reshape(height, width).astype(np.float32)

    def _columns(self, pixel: np.ndarray, has_shadow: bool) -> tuple[np.ndarray, np.ndarray]:
        """Columns (N,) [1] of places (N, 2) [px], and ranges (N,) [m] of what they see."""
        parts = [self._part(pixel[k:k + _RAYS_AT_ONCE], has_shadow) for k in range(0, len(pixel), _RAYS_AT_ONCE)]
        return tuple(np.concatenate(each) for each in zip(*parts, strict=True))

    def _part(self, pixel: np.ndarray, has_shadow: bool) -> tuple[np.ndarray, np.ndarray]:
        view, total = self._view, np.zeros(len(pixel))
        range_m = self._frame.ranges(pixel, self._bodies)
        ray_body = self._frame.camera.directions(pixel) @ view.camera_from_body
        for field, steps, rotation in self._fields:
            lit = (lambda r, turn=rotation: self._frame.sunlit(r @ turn, view.name)) if has_shadow else None
            total += columns(field, rotation @ view.r_camera_body_m, ray_body @ rotation.T, steps, range_m, lit)
        return total, range_m
