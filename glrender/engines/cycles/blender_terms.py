"""A scene and its view in Blender's terms, which `inside/drawing.py` is sent: units, axes, lens and Sun."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from glrender_camera import PinholeCamera

from ...base import rotations as frames
from ...brdf import Lambert
from ...scene.scene import Body, Scene
from ...view.view import BodyView, lamp_in
from .lens import Lens
from .osl import law_as_osl

# Blender's y axis of the camera is up and its z axis is backwards.
_BLENDER_AXES = np.diag([1.0, -1.0, -1.0])
# Blender's units across the largest body: rays start off the surface by a share of the coordinates.
_UNITS_PER_RADIUS = 50.0
# Difference of the Sun's direction over its angular radius [1] from which a body is warned of.
_MAX_SUN_DIFFERENCE = 0.1
# Error of Blender's float32 in a ray's place over the focal length [1]; error [px] from which there is a warning.
_FLOAT32, _MAX_BESIDE_PX = 1e-7, 0.2


class BlenderTerms:
    """A scene for Blender: bodies about their middles, in units of the largest body.

    Parameters
    ----------
    scene : Scene

    Attributes
    ----------
    drawn : list of Body
        Bodies of one material each: the parts of the scene's, in its order.
    """

    def __init__(self, scene: Scene):
        self._scene, self.drawn = scene, [part for body in scene.bodies for part in body.parts]
        hulls = scene.hulls
        self._origin_m = {name: 0.5 * (hull.points_m.min(axis=1) + hull.points_m.max(axis=1))
                          for name, hull in hulls.items()}
        self._unit_m = max(hull.radius_m for hull in hulls.values()) / _UNITS_PER_RADIUS

    def bodies(self) -> tuple[list[dict[str, Any]], dict[str, np.ndarray]]:
        """The head's `bodies` and the arrays of `drawing.Stage`."""
        described, arrays = [], {}
        for index, body in enumerate(self.drawn):
            described.append(_described(body))
            for key, array in self.arrays(body).items():
                arrays[f"{key}/{index}"] = array
        return described, arrays

    def arrays(self, body: Body) -> dict[str, np.ndarray]:
        """The geometry of a body, for `drawing.Stage`."""
        return _arrays(body, self._origin_m[body.name], self._unit_m)

    def lamps(self, main: BodyView, camera: PinholeCamera, solar_W_m2: float) -> list[dict[str, Any]]:
        """Lamps as `drawing.Stage.draw` takes them, in the axes of one body, for a Sun of 1 W/m2 there."""
        made = []
        for lamp in self._scene.lamps:
            place_m, axis = lamp_in(main, lamp, camera)
            place = (place_m - self._origin_m[main.name]) / self._unit_m
            watts = 4.0 * math.pi * lamp.intensity_W_sr / (solar_W_m2 * self._unit_m**2)
            made.append({"from": frames.transform(_axes_along(-axis), place).tolist(), "watts": watts})
        return made

    def view(self, main: BodyView, members: list[BodyView], views: list[BodyView], lens: Lens) -> dict[str, Any]:
        """The view as `drawing.Stage.draw` takes it: poses in the axes of one body, about its middle, so that it is
        built once.

        Parameters
        ----------
        main : BodyView
        members : list of BodyView
            Bodies that the lens sees.
        views : list of BodyView
            All bodies: any may cast its shadow.
        lens : Lens
        """
        unit = self._unit_m
        middle = self._origin_m[main.name]
        main_from_camera = main.camera_from_body.T
        r_camera = main.r_camera_body_m - middle
        bodies = []
        for view, body in zip(views, self._scene.bodies, strict=True):
            rotation = main_from_camera @ view.camera_from_body
            offset = main.r_camera_body_m - middle + rotation @ (self._origin_m[view.name] - view.r_camera_body_m)
            matrix = np.eye(4) if view is main else frames.transform(rotation, offset / unit)
            bodies += [matrix] * len(body.parts)
        middle_camera = main.camera_from_body @ -r_camera
        near, far = min(view.depth_m[0] for view in members), max(view.depth_m[1] for view in members)
        share = _share_of_range(lens, near, far, middle_camera[2])
        r_camera, moved_m = share * r_camera, (1.0 - share) * middle_camera[2]
        near, far = near - moved_m, far - moved_m
        centre = lens.centre
        if share < 1.0:
            # The body's middle stays in its place of the image.
            centre = centre + (1.0 - share) * lens.focal_length * middle_camera[:2] / middle_camera[2]
        (width, height), (cx, cy) = lens.size, (float(c) for c in centre)
        return {
            "bodies_from": [matrix.tolist() for matrix in bodies],
            "camera_from": frames.transform(main_from_camera @ _BLENDER_AXES, r_camera / unit).tolist(),
            "sun_from": frames.transform(_axes_along(main.sun_direction_body), np.zeros(3)).tolist(),
            "sun_angle_rad": 2.0 * math.asin(main.sun_radius_rad),
            "size": [width, height], "region": list(lens.region), "focal_length": share * lens.focal_length,
            "shift": [-(cx - 0.5 * (width - 1)) / width, (cy - 0.5 * (height - 1)) / width],
            # Clipping is by range in some versions and by depth in others.
            "clip": [0.9 * near / unit, 1.1 * far / unit / lens.min_cosine]}


def _share_of_range(lens: Lens, near_m: float, far_m: float, depth_m: float) -> float:
    """Share of its range at which the camera stands, with as much less focal length: 1 unless it is far away.

    Blender's float32 puts rays 1e-7 focal lengths off their cells; from nearer, perspective puts the outline
    of a body s cells across and d deep off by s / 2 d / range. The share makes both the same, which for a
    sphere of 1000 cells is 0.16 cells; and the camera stays well before all that it sees.
    """
    if not np.isfinite(lens.extent):
        return 1.0
    depth = 0.5 * (far_m - near_m) / depth_m
    return min(1.0, max((0.5 * lens.extent * depth / (_FLOAT32 * lens.focal_length)) ** 0.5, 10.0 * depth))


def _described(body: Body) -> dict[str, Any]:
    is_lambert = type(body.brdf) is Lambert
    law = None if is_lambert else law_as_osl(body.brdf, body.albedo_map is not None)
    return {"name": body.name, "smooth": body.smooth_normals, "law": law,
            "normal_albedo": body.brdf.normal_albedo if is_lambert else 0.0}


def _arrays(body: Body, origin_m: np.ndarray, unit_m: float) -> dict[str, np.ndarray]:
    shape = body.drawn_shape
    # Blender draws both sides of a facet: of two in one place one is enough.
    kept = np.arange(len(shape.facets))
    if shape.other_side is not None:
        kept = kept[(shape.other_side < 0) | (kept < shape.other_side)]
    arrays = {"vertices": ((shape.vertices_m - origin_m) / unit_m).astype(np.float32),
              "facets": shape.facets[kept].astype(np.int32)}
    if not shape.report.is_watertight or shape.inside:
        other = shape.other_side
        arrays["one_sided"] = np.float32(np.ones(len(kept)) if other is None else other[kept] < 0)
    if body.smooth_normals:
        arrays["normals"] = shape.vertex_normals.astype(np.float32)
    if body.albedo_map is not None:
        # Blender repeats a texture: a row more on top and below, so that none comes round from the other end.
        texture = np.pad(body.albedo_map[::-1], ((1, 1), (0, 0)), mode="edge")
        uv = shape.uv[kept].astype(np.float64)
        uv[..., 1] = (np.clip(uv[..., 1], 0.0, 1.0) * (len(texture) - 2) + 1.0) / len(texture)
        arrays |= {"texture": texture, "uv": uv.astype(np.float32)}
    return arrays


def _axes_along(direction: np.ndarray) -> np.ndarray:
    """Right-handed axes (3, 3), in columns, whose third is a unit vector."""
    other = np.eye(3)[np.argmin(np.abs(direction))]
    first = np.cross(other, direction)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(direction, first), direction], axis=1)


def warnings_of(main: BodyView, views: list[BodyView], lens: Lens, asked: dict[str, Any]) -> tuple[str, ...]:
    """Warnings of errors that Blender's draw has: one Sun for all bodies, Blender's float32 at long focal lengths."""
    warnings = []
    beside_px = _FLOAT32 * asked["focal_length"] / lens.cells_per_px
    if beside_px > _MAX_BESIDE_PX:
        warnings.append(f"{main.name}: rays stand up to {beside_px:.2g} px off their pixels, for Blender's float32")
    sun_rad = main.sun_radius_rad
    for view in views:
        there = view.camera_from_body @ view.sun_direction_body - main.camera_from_body @ main.sun_direction_body
        if np.linalg.norm(there) > _MAX_SUN_DIFFERENCE * sun_rad:
            warnings.append(f"{view.name}: lit from where {main.name} sees the Sun, "
                            f"{math.degrees(np.linalg.norm(there)):.2g} deg off")
    return tuple(warnings)
