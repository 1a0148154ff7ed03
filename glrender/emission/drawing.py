"""Draws a coma into a frame: columns of its fields by the GPU, their light added to the irradiance."""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np

from .. import frames
from ..emission_frame import EmissionFrame, EmissionPlan
from ..gl.coma_pass import ComaPass, ComaVolume, FloatTarget
from ..gl.context import Context
from ..scene import Scene
from ..view import BodyView
from .coma import Coma
from .geometry import shader_values
from .layers import Layer, Layers
from .light import add_light, is_point, point_correction
from .measuring import REACH_RAD
from .planning import Sampling, choose, edge_error
from .telling import told

_TILE_PX = 2048
# A body that is smaller is cheap to draw with 4 x 4 samples.
_SMALL_PX = 256.0


@dataclass(frozen=True, eq=False)
class _Drawn:
    """A layer as a frame draws it."""

    layer: Layer
    volume: ComaVolume
    field_from_body: np.ndarray
    sampling: Sampling


class ComaDrawing(ExitStack):
    """A coma's tables and textures in a context; see `emission_frame.EmissionPass`."""

    def __init__(self, coma: Coma, context: Context, scene: Scene):
        super().__init__()
        self._coma, self._context = coma, context
        body = next(body for body in scene.bodies if body.name == coma.body)
        self._layers = Layers(coma.sources, body.shape)
        self._pass = self.enter_context(ComaPass(context, len(scene.bodies)))
        self._surface = self.enter_context(FloatTarget(context, [2]))
        self._volumes: dict[int, tuple[Layer, ComaVolume]] = {}

    def add(self, irradiance: np.ndarray, frame: EmissionFrame) -> EmissionPlan:
        """Add the coma's light; where its dust hides what is behind it, dim that."""
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
        at_edges = edge_error(footprint_m, self._layers.radius_m, _surface_samples(view)) if has_edges else 0.0
        return told(self._coma, [(each.layer, each.sampling) for each in drawn], greatest,
                    1e3 * (time.perf_counter() - began), at_edges)

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
            (left, top, right, bottom), samples = body, _surface_samples(view)
            frame.draw_surfaces(self._surface, "coma/surface.frag.glsl",
                                (x0 + left - 0.5, y0 + top - 0.5, x0 + right - 0.5, y0 + bottom - 0.5),
                                (samples * (right - left), samples * (bottom - top)))
        column = self._sum(box, frame, drawn, body, has_shadow, as_point)
        needs_all = has_shadow and self._coma.dust.extinction_efficiency > 0.0
        hidden = self._sum(box, frame, drawn, body, False, as_point) if needs_all else column
        if as_point:
            point_correction(column, frame.camera, view, 1e-3 * self._layers.least_m, self._layers.radius_m, box)
        return column, hidden

    def _sum(self, box: tuple[int, int, int, int], frame: EmissionFrame, drawn: list[_Drawn],
             body: tuple[int, int, int, int] | None, has_shadow: bool, as_point: bool) -> np.ndarray:
        x0, y0, x1, y1 = box
        width, height = x1 - x0, y1 - y0
        view = frame.views[self._coma.body]
        shadow_map, shadow_from_body = frame.shadow_map(view.name) if has_shadow else (None, np.eye(4))
        self._pass.begin(width, height)
        for each in drawn:
            values = shader_values(each.layer.field, frame.camera, view, frame.views, each.field_from_body, (x0, y0))
            values |= {
                "shadow_from_field": shadow_from_body @ frames.transform(each.field_from_body.T, np.zeros(3)),
                "pixels_per_node": each.sampling.pixels_per_node, "steps": each.sampling.steps,
                "pixels_per_front_node": each.sampling.front_pixels_per_node, "nodes_reach_rad": REACH_RAD,
                "surface_samples": _surface_samples(view),
                # Rays through a nucleus that ends none of them: there `a` must be rho.
                "least_m": (1e-3 if as_point else 1.0) * self._layers.least_m,
                "body_px": (0, 0, 0, 0) if body is None else body}
            self._pass.add(each.volume, values, (width, height), body, self._surface, shadow_map)
        return self._pass.read()


def _surface_samples(view: BodyView) -> int:
    """Along a pixel's side: the smaller the body, the more of the image are the pixels at its edge."""
    return 4 if view.size_px < _SMALL_PX else 2 if view.size_px < _TILE_PX else 1


def _cut(boxes: list[tuple[int, int, int, int]], width: int, height: int) -> tuple[int, int, int, int] | None:
    """The box around boxes, within a tile; None when they are beside it."""
    boxes = [(max(a, 0), max(b, 0), min(c, width), min(d, height)) for a, b, c, d in boxes]
    boxes = [box for box in boxes if box[2] > box[0] and box[3] > box[1]]
    if not boxes:
        return None
    left, top, right, bottom = zip(*boxes, strict=True)
    return (min(left), min(top), max(right), max(bottom))
