"""Triangles: draws the bodies of a part of an image into a target, with shadows, in slices of depth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from glrender_camera import PinholeCamera

from ...base import rotations as frames
from ...planner.plan import BodyPlan
from ...scene.scene import Scene
from ...view import regions as grouping
from ...view.view import BodyView
from ..prepared_body import PreparedBody
from .gl.mesh import IRRADIANCE_STAGE, SurfaceVariant
from .gl.targets import PixelMask, Target
from .shadow_maps import NO_SHADOW, Shadow

# Room before the nearest and behind the farthest point, in radii of the body [1]: 32 steps of float32, to which the
# shader rounds coordinates. A facet across the boresight has one depth, and rounding takes it beyond the near plane.
_ROUNDING_ROOM = 2.0**-18


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame:
    """The inputs that all passes of a frame share.

    Attributes
    ----------
    camera : PinholeCamera
    views : sequence of BodyView
        In the scene's order.
    bodies : sequence of BodyPlan
        The same bodies.
    shadows : mapping
        Name to Shadow, of the bodies that have one.
    """

    camera: PinholeCamera
    views: Sequence[BodyView]
    bodies: Sequence[BodyPlan]
    shadows: Mapping[str, Shadow]

    def only(self, names: Sequence[str]) -> list[BodyView]:
        """All bodies, of which those of some names alone are seen: others may still cast shadows."""
        return [replace(view, is_visible=view.is_visible and view.name in names) for view in self.views]


class SurfacePass:
    """Draws surfaces.

    Parameters
    ----------
    mask : PixelMask
    scene : Scene
    bodies : mapping of str to PreparedBody
    """

    def __init__(self, mask: PixelMask, scene: Scene, bodies: Mapping[str, PreparedBody]):
        self._mask, self._scene, self._bodies = mask, scene, bodies

    def draw(self, frame: Frame, target: Target, stage: str, bounds_px: tuple[float, float, float, float],
             grid: tuple[int, int], names: Sequence[str], mask: np.ndarray | None = None) -> None:
        """Draw bodies.

        Parameters
        ----------
        frame : Frame
        target : Target
        stage : str
            The fragment shader.
        bounds_px : (float, float, float, float) [px]
            Part of the image that the target shows: x0, y0, x1, y1.
        grid : (int, int)
            Samples across and down.
        names : sequence of str
            The bodies.
        mask : (rows, columns) uint8, optional
            Pixels that are drawn, of a whole number of samples each.
        """
        plans = {body.name: body for body in frame.bodies}
        camera = frame.camera
        target.begin(*grid, depth=1.0 if mask is None else 0.0)
        if mask is not None:
            self._mask.open(mask, grid[0] // mask.shape[1])
        members = [view for view in frame.views if view.name in names]
        groups = grouping.depth_groups(members)
        for index, (near, far, group) in enumerate(groups):
            room_m = _ROUNDING_ROOM * max(self._scene.hulls[view.name].radius_m for view in group)
            near, far = max(near * (1.0 - 1e-6) - room_m, 0.5 * near), far * (1.0 + 1e-6) + room_m
            clip_from_camera = frames.clip_from_camera(
                camera.focal_length_px, camera.principal_point_px, bounds_px, near, far)
            # Each group has its slice of the depth buffer: nearer groups cover farther ones.
            clip_from_camera = frames.depth_slice(index, len(groups)) @ clip_from_camera
            for view in group:
                self._draw_body(stage, view, plans[view.name], clip_from_camera, camera,
                                frame.shadows.get(view.name, NO_SHADOW))

    def _draw_body(self, stage: str, view: BodyView, body_plan: BodyPlan, clip_from_camera: np.ndarray,
                   camera: PinholeCamera, shadow: Shadow) -> None:
        prepared, r_camera = self._bodies[view.name], view.r_camera_body_m
        offset = np.zeros(3) if body_plan.relative_to_camera else -r_camera
        clip_from_surface = clip_from_camera @ frames.transform(
            view.camera_from_body, view.camera_from_body @ offset)
        solar_irradiance = self._scene.solar_irradiance_of(camera) / view.sun_distance_au**2
        relief = None
        if body_plan.detail_m is not None and stage == IRRADIANCE_STAGE:
            footprint_m = view.depth_m[0] / camera.focal_length_px
            relief = {**prepared.body.relief.uniforms(r_camera + offset, footprint_m),
                      "footprint_per_m": 1.0 / camera.focal_length_px}
        high = r_camera.astype(np.float32)
        variant = SurfaceVariant(
            relative_to_camera=body_plan.relative_to_camera, normal_lookup=body_plan.normal_lookup,
            shadows=shadow.shadow_map is not None, relief=relief is not None)
        values = {
            "clip_from_surface": clip_from_surface, "shadow_from_body": shadow.shadow_from_body,
            "r_camera_body": high, "r_camera_body_low": r_camera - high,
            "sun_direction_body": view.sun_direction_body, "boresight_body": view.camera_from_body[2],
            "irradiance_scale": solar_irradiance / camera.focal_length_px**2,
            "shadow_bias_per_texel": shadow.bias_per_texel,
            "sun_radius_rad": view.sun_radius_rad if self._scene.sun_disc else 0.0,
            "body_id": prepared.index}
        for mesh in prepared.meshes:
            mesh.draw_surface(stage, variant, values, shadow.shadow_map and shadow.shadow_map.texture, relief)
