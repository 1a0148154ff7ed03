"""A scene and a view of it in Blender's terms: units, axes, lens and Sun. What `inside/drawing.py` is sent."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from glrender_camera import PinholeCamera

from ... import frames
from ...brdf import Lambert
from ...constants import AU_M, SUN_RADIUS_M
from ...scene import Body, Scene
from ...view import BodyView
from .osl import law_as_osl

# Blender's y axis of the camera is up and its z axis is backwards.
_BLENDER_AXES = np.diag([1.0, -1.0, -1.0])
# Blender's units across the largest body: rays start off the surface by a share of the coordinates.
_UNITS_PER_RADIUS = 50.0
# Of the Sun's angular radius: a body whose Sun stands further off is told of.
_MAX_SUN_DIFFERENCE = 0.1
_FOCAL_LENGTH_PER_SIZE = 2000.0


class BlenderTerms:
    """A scene for Blender: bodies about their middles, in units of the largest body.

    Parameters
    ----------
    scene : Scene
    """

    def __init__(self, scene: Scene):
        self._scene = scene
        hulls = {body.name: body.hull for body in scene.bodies}
        self._origin_m = {name: 0.5 * (hull.points_m.min(axis=0) + hull.points_m.max(axis=0))
                          for name, hull in hulls.items()}
        self._unit_m = max(hull.radius_m for hull in hulls.values()) / _UNITS_PER_RADIUS

    def bodies(self) -> tuple[list[dict[str, Any]], dict[str, np.ndarray]]:
        """The head's `bodies` and the arrays of `drawing.Stage`."""
        told, arrays = [], {}
        for index, body in enumerate(self._scene.bodies):
            told.append(_described(body))
            for key, array in _arrays(body, self._origin_m[body.name], self._unit_m).items():
                arrays[f"{key}/{index}"] = array
        return told, arrays

    def view(self, main: BodyView, views: list[BodyView], camera: PinholeCamera,
             roi: tuple[int, int, int, int]) -> dict[str, Any]:
        """What `drawing.Stage.draw` asks of a view: poses in the axes of the largest body in view, about its
        middle, so that what never moves is built once."""
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
    is_lambert = type(body.brdf) is Lambert
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


def sun_warnings(main: BodyView, views: list[BodyView]) -> tuple[str, ...]:
    """Cycles has one Sun for all: a warning where that is not what a body sees."""
    sun_rad = SUN_RADIUS_M / (main.sun_distance_au * AU_M)
    warnings = []
    for view in views:
        there = view.camera_from_body @ view.sun_direction_body - main.camera_from_body @ main.sun_direction_body
        if np.linalg.norm(there) > _MAX_SUN_DIFFERENCE * sun_rad:
            warnings.append(f"{view.name}: lit from where {main.name} sees the Sun, "
                            f"{math.degrees(np.linalg.norm(there)):.2g} deg off")
    return tuple(warnings)
