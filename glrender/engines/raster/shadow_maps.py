"""Shadow maps of a scene: which bodies cast on which, what a map covers, and when an old one still serves."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from glrender_camera import PinholeCamera

from ...base import rotations as frames
from ...planner.body_plan import MAX_SHADOW_SIDE_PX
from ...planner.plan import BodyPlan
from ...scene.scene import Scene
from ...scene.shape.facet_geometry import area_vectors
from ...view.occluders import casters
from ...view.view import BodyView
from ..prepared_body import PreparedBody
from .gl.context import Context
from .gl.targets import ShadowMap, rounded_room

_MAPS_KEPT = 8
# Texels around the part that must be covered: a lookup at its edge still meets the map.
_MARGIN_TEXELS = 2
# The largest bias of surface.glsl is 20.2 texels.
_DEPTH_MARGIN_TEXELS = 21.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Shadow:
    """The shadow map of a body, and the transforms by which its surface looks it up.

    Attributes
    ----------
    shadow_map : ShadowMap or None
    shadow_from_body : (4, 4) float64
        Texture coordinates and depth, 0 to 1.
    bias_per_texel : float [1]
        Depth of a texel's side.
    """

    shadow_map: ShadowMap | None
    shadow_from_body: np.ndarray
    bias_per_texel: float


NO_SHADOW = Shadow(shadow_map=None, shadow_from_body=np.eye(4), bias_per_texel=0.0)


class Shadows:
    """Draws and keeps shadow maps.

    Parameters
    ----------
    context : Context
    scene : Scene
    bodies : mapping of str to PreparedBody
    """

    def __init__(self, context: Context, scene: Scene, bodies: Mapping[str, PreparedBody]):
        self._context, self._hulls, self._bodies = context, scene.hulls, bodies
        self._maps: OrderedDict[tuple, ShadowMap] = OrderedDict()
        # Maps that the frame needs.
        self._needed: set[tuple] = set()

    def close(self) -> None:
        """Draw every shadow map anew when next it is needed; no image changes."""
        for shadow_map in self._maps.values():
            shadow_map.close()
        self._maps.clear()

    def begin_frame(self) -> None:
        """From here on no map of the frame before is needed any more."""
        self._needed.clear()

    def _seen(self, view: BodyView, sun_from_body: np.ndarray, camera: PinholeCamera) -> np.ndarray:
        """Places (3, N) [m] in frame `sun` of the corners of facets that face Sun and camera and may be in the image.

        A single one where there are none: no shadow is looked up then.
        """
        shape = self._bodies[view.name].body.drawn_shape
        camera = camera.rectilinear
        clip = frames.clip_from_camera(camera.focal_length_px, camera.principal_point_px, camera.bounds_px,
                                       *view.depth_m) @ frames.transform(view.camera_from_body,
                                                                         -view.camera_from_body @ view.r_camera_body_m)
        x, y, _, w = clip[:, :3] @ shape.vertices_m.T + clip[:, 3:]
        beside = np.stack([x > w, x < -w, y > w, y < -w], axis=1)
        facets = shape.facets[~beside[shape.facets].all(axis=1).any(axis=1)]
        normal, corner_m = area_vectors(shape.vertices_m, facets), shape.vertices_m[facets]
        shown = ((normal @ view.sun_direction_body > 0.0)
                 & (np.einsum("fx,fx->f", normal, view.r_camera_body_m - corner_m[:, 0]) > 0.0))
        return sun_from_body @ (corner_m[shown].reshape(-1, 3).T if shown.any() else shape.vertices_m[:1].T)

    def draw(self, views: Sequence[BodyView], bodies: Sequence[BodyPlan],
             camera: PinholeCamera, names: Container[str] | None = None, *, is_whole: bool = False
             ) -> tuple[dict[str, Shadow], list[BodyPlan]]:
        """Shadows of the bodies that need a map, or of those `names` alone; and the plans with what was done.

        A map covers what the image shows of its body, or the whole where `is_whole`. Other cameras of the same epoch
        share it; it stays until the next frame begins.
        """
        shadows, done = {}, []
        for view, body_plan in zip(views, bodies, strict=True):
            texels = body_plan.shadow_map_px
            if texels is None or (names is not None and view.name not in names):
                done.append(body_plan)
                continue
            sun_from_body = frames.sun_from_body(view.sun_direction_body)
            points_m = sun_from_body @ self._hulls[view.name].points_m
            low_m, high_m = points_m.min(axis=1), points_m.max(axis=1)
            texel_m = (high_m - low_m)[:2] / texels
            if not (view.is_whole or is_whole):
                seen_m = self._seen(view, sun_from_body, camera)[:2]
                low_m[:2], high_m[:2] = seen_m.min(axis=1), seen_m.max(axis=1)
                # The planner knows only about how much is seen.
                coarser = max(float((np.ptp(seen_m, axis=1) / texel_m).max()) / MAX_SHADOW_SIDE_PX, 1.0)
                texel_m, body_plan = texel_m * coarser, replace(body_plan, shadow_map_px=max(int(texels / coarser), 1))
            size_px = tuple(int(side) for side in np.ceil((high_m - low_m)[:2] / texel_m) + 2 * _MARGIN_TEXELS)
            centre, half = 0.5 * (low_m + high_m), 0.5 * (high_m - low_m)
            half[:2] = 0.5 * np.array(size_px) * texel_m
            # However large the bias, a surface stays behind what casts from the near plane.
            half[2] += _DEPTH_MARGIN_TEXELS * texel_m.max()
            offset = frames.transform(np.eye(3), -centre) @ frames.transform(sun_from_body, np.zeros(3))
            clip = frames.clip_from_sun(half[0], half[1], -half[2], half[2]) @ offset
            cast = [(view.name, np.eye(4)), *((caster.name, frames.transform(caster.rotation, caster.shift_m))
                                              for caster in casters(view, views, self._hulls))]
            key = (view.name, size_px, clip.tobytes(),
                   *((name, matrix.tobytes()) for name, matrix in cast))
            is_kept = key in self._maps
            self._needed.add(key)
            if is_kept:
                self._maps.move_to_end(key)
            else:
                shadow_map = self._map_to_fill(size_px)
                shadow_map.draw([(mesh, clip @ matrix) for name, matrix in cast
                                 for mesh in self._bodies[name].meshes], size_px)
                self._maps[key] = shadow_map
            shadow_map = self._maps[key]
            shadows[view.name] = Shadow(
                shadow_map=shadow_map, shadow_from_body=shadow_map.texture_from_clip(size_px) @ clip,
                bias_per_texel=texel_m.max() / (2.0 * half[2]))
            done.append(replace(body_plan, shadow_map_reused=is_kept, shadow_map_drawn_px=size_px))
        return shadows, done

    def _map_to_fill(self, size_px: tuple[int, int]) -> ShadowMap:
        """The map with room that nobody needed for longest, or a new one; never one that this frame needs."""
        idle = [key for key in self._maps if key not in self._needed]
        if len(self._maps) < _MAPS_KEPT or not idle:
            return ShadowMap(self._context, size_px)
        for key in idle:
            # Not one with more room: its texels' coordinates round otherwise, and bytes would depend on earlier frames.
            if self._maps[key].room_px == rounded_room(size_px):
                return self._maps.pop(key)
        self._maps.pop(idle[0]).close()
        return ShadowMap(self._context, size_px)
