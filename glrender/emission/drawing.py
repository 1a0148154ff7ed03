"""Draws a coma into a frame: columns of its fields by the GPU, their light added to the irradiance."""

from __future__ import annotations

import math
import time
from contextlib import ExitStack
from dataclasses import dataclass, replace

import numpy as np

from ..base import rotations as frames
from ..engines.emission_interface import EmissionFrame
from ..engines.raster.gl.coma_pass import ComaPass, ComaVolume, FloatTarget, Grid
from ..engines.raster.gl.context import Context
from ..planner.plan import EmissionPlan
from ..scene.scene import Scene
from ..view.view import BodyView
from .geometry import is_ahead, passing_m, shader_values
from .layers import Layer, Layers
from .light import add_light, cell_middles, is_point, point_correction, spread
from .measuring import REACH_RAD
from .planning import NEAR_NODES, NEAR_RADII, Sampling, choose, edge_error, surface_samples
from .settings import ComaSettings
from .telling import told

_TILE_PX = 2048


@dataclass(frozen=True, eq=False)
class _Drawn:
    """A layer as a frame draws it."""

    layer: Layer
    volume: ComaVolume
    field_from_body: np.ndarray
    sampling: Sampling


class ComaDrawing(ExitStack):
    """A coma's tables and textures in a context; see `emission_frame.EmissionPass`."""

    def __init__(self, coma: ComaSettings, context: Context, scene: Scene):
        super().__init__()
        self._coma, self._context = coma, context
        body = next(body for body in scene.bodies if body.name == coma.body)
        self._layers = Layers(coma.sources, body.shape)
        self._pass = self.enter_context(ComaPass(context, len(scene.bodies)))
        self._surface = self.enter_context(FloatTarget(context, [2]))
        self._volumes: dict[int, tuple[Layer, ComaVolume]] = {}

    def add(self, irradiance: np.ndarray, frame: EmissionFrame) -> EmissionPlan:
        """Add the coma's light; where its dust hides surfaces, dim these."""
        began = time.perf_counter()
        view, dust = frame.views[self._coma.body], self._coma.dust
        drawn = self._plan(frame, view)
        solar_irradiance = frame.solar_irradiance_1au_W_m2 / view.sun_distance_au**2
        height, width = irradiance.shape
        greatest = 0.0
        for top in range(0, height, _TILE_PX):
            for left in range(0, width, _TILE_PX):
                box = (left, top, min(left + _TILE_PX, width), min(top + _TILE_PX, height))
                column, hidden = self._columns(box, frame, drawn)
                greatest = max(greatest, float(hidden.max()))
                add_light(irradiance[top:box[3], left:box[2]], column, hidden, frame.camera, view, dust, box,
                          solar_irradiance)
        has_edges = view.is_visible and not is_point(self._layers.radius_m, view, frame.camera)
        footprint_m = view.range_m / frame.camera.focal_length_px
        at_edges = edge_error(footprint_m, self._layers.radius_m, self._samples(frame)) if has_edges else 0.0
        return told(self._coma, [(each.layer, each.sampling) for each in drawn], greatest,
                    1e3 * (time.perf_counter() - began), at_edges,
                    other_shadows=self._coma.has_shadow and len(frame.views) > 1)

    def _plan(self, frame: EmissionFrame, view: BodyView) -> list[_Drawn]:
        body_from_inertial = frames.dcm(frame.state.bodies[view.name].q_from_inertial)
        footprint_m = view.range_m / frame.camera.focal_length_px
        made = []
        for index, layer in enumerate(self._layers.at(view.sun_direction_body)):
            known = self._volumes.get(index)
            if known is None:
                volume = self.enter_context(ComaVolume(self._context, layer.field.texels(), layer.is_spherical))
            else:
                volume = known[1]
                if known[0] is not layer:
                    volume.write(layer.field.texels())
            self._volumes[index] = (layer, volume)
            sampling = choose(layer.errors, footprint_m, self._layers.radius_m,
                              0.5 * max(frame.camera.width_px, frame.camera.height_px), frame.max_error,
                              self._coma.has_shadow, 1.0 / frame.camera.focal_length_px)
            if not is_ahead(-view.camera_from_body @ view.r_camera_body_m):
                # Nodes that ended at surfaces keep integrals, which are not smooth there.
                sampling = replace(sampling, front_pixels_per_node=1)
            made.append(_Drawn(layer, volume, layer.field_from_body(body_from_inertial, view.sun_direction_body),
                               sampling))
        return made

    def _columns(self, box: tuple[int, int, int, int], frame: EmissionFrame,
                 drawn: list[_Drawn]) -> tuple[np.ndarray, np.ndarray]:
        """Columns (rows, columns) [1] of sunlit dust and of all dust in a tile."""
        x0, y0, x1, y1 = box
        width, height = x1 - x0, y1 - y0
        view, has_shadow = frame.views[self._coma.body], self._coma.has_shadow
        as_point = is_point(self._layers.radius_m, view, frame.camera)
        body = _cut([(a - x0, b - y0, c - x0, d - y0) for a, b, c, d in frame.rois], width, height)
        if as_point and len(frame.views) == 1:
            body = None
        if body is not None:
            (left, top, right, bottom), samples = body, self._samples(frame)
            frame.draw_surfaces(self._surface, "coma/surface.frag.glsl",
                                (x0 + left - 0.5, y0 + top - 0.5, x0 + right - 0.5, y0 + bottom - 0.5),
                                (samples * (right - left), samples * (bottom - top)))
        near = self._near(box, frame, drawn, body)
        column = self._sum(box, frame, drawn, body, near, has_shadow, as_point)
        needs_all = has_shadow and self._coma.dust.extinction_efficiency > 0.0
        hidden = self._sum(box, frame, drawn, body, near, False, as_point) if needs_all else column
        if as_point:
            point_correction(column, frame.camera, view, 1e-3 * self._layers.least_m, self._layers.radius_m, box)
        return column, hidden

    def _samples(self, frame: EmissionFrame) -> int:
        view = frame.views[self._coma.body]
        return surface_samples(view.size_px, view.range_m / frame.camera.focal_length_px, self._layers.radius_m,
                               frame.max_error)

    def _near(self, box: tuple[int, int, int, int], frame: EmissionFrame, drawn: list[_Drawn],
              body: tuple[int, int, int, int] | None) -> tuple[int, int, int, int]:
        """The box of a tile beyond which columns are linear between nodes: the tile where a field has none far."""
        whole = (0, 0, box[2] - box[0], box[3] - box[1])
        view, camera = frame.views[self._coma.body], frame.camera
        focus = -view.camera_from_body @ view.r_camera_body_m
        if not drawn or not is_ahead(focus) or not all(each.sampling.far_pixels_per_node for each in drawn):
            return whole
        half = max(NEAR_RADII * self._layers.radius_m * camera.focal_length_px / view.range_m,
                   *(NEAR_NODES * each.sampling.far_pixels_per_node for each in drawn))
        x, y = focus[:2] / focus[2] * camera.focal_length_px + np.array(camera.principal_point_px) - box[:2]
        around = (math.floor(x - half), math.floor(y - half), math.ceil(x + half), math.ceil(y + half))
        return _cut([around] + ([] if body is None else [body]), *whole[2:]) or (0, 0, 0, 0)

    def _sum(self, box: tuple[int, int, int, int], frame: EmissionFrame, drawn: list[_Drawn],
             body: tuple[int, int, int, int] | None, near: tuple[int, int, int, int], has_shadow: bool,
             as_point: bool) -> np.ndarray:
        size = (box[2] - box[0], box[3] - box[1])
        view = frame.views[self._coma.body]
        shadow_map, shadow_from_body = frame.shadow_map(view.name) if has_shadow else (None, np.eye(4))
        least_m = (1e-3 if as_point else 1.0) * self._layers.least_m
        parts, has_near = [], near[2] > near[0]
        if has_near:
            self._pass.begin(near)
        for each in drawn:
            values = shader_values(each.layer.field, frame.camera, view, frame.views, each.field_from_body, box[:2])
            values |= {
                "shadow_from_field": shadow_from_body @ frames.transform(each.field_from_body.T, np.zeros(3)),
                # Rays through a nucleus that ends no ray: there `a` must be rho.
                "least_m": least_m,
                "nodes_reach_rad": REACH_RAD}
            sampling = each.sampling
            if near != (0, 0, *size):
                step, far = sampling.far_pixels_per_node, {**values, "steps": sampling.steps}
                total = self._pass.totals(each.volume, far, Grid.around(*size, step), shadow_map)
                passing = passing_m(frame.camera, view, cell_middles(size, step) + box[:2])
                parts.append(spread(np.maximum(total, 0.0) / np.maximum(passing, least_m), size, step))
            if has_near:
                self._pass.add(each.volume, values, (sampling.steps, sampling.front_steps),
                               (sampling.pixels_per_node, sampling.front_pixels_per_node), body, self._surface,
                               self._samples(frame), shadow_map)
        column = sum(parts[1:], parts[0]) if parts else np.zeros(size[::-1], np.float32)
        if has_near:
            column[near[1]:near[3], near[0]:near[2]] = self._pass.read()
        return column


def _cut(boxes: list[tuple[int, int, int, int]], width: int, height: int) -> tuple[int, int, int, int] | None:
    """The box around boxes, within a tile; None when they are outside the tile."""
    boxes = [(max(a, 0), max(b, 0), min(c, width), min(d, height)) for a, b, c, d in boxes]
    boxes = [box for box in boxes if box[2] > box[0] and box[3] > box[1]]
    if not boxes:
        return None
    left, top, right, bottom = zip(*boxes, strict=True)
    return (min(left), min(top), max(right), max(bottom))
