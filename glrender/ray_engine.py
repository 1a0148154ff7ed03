"""Light along rays: what each place of an image sees of a scene, in float64.

The ray tracer backend and the renderer's windows of rays are drawn by it; it shares no line with
the OpenGL passes.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from glrender_camera import PinholeCamera

from .constants import AU_M, SUN_RADIUS_M
from .frames import sun_from_body
from .rays import RayMesh
from .scene import Body, Scene
from .surface import Surface
from .view import BodyView

# What a batch needs stays in a core's cache: 2.8 times as fast as 2^19.
_RAYS_AT_ONCE = 1 << 15
# A shadow ray starts this far off the surface, in radii of the bounding sphere: ten float32 steps.
_LIFT = 6e-7
_R2, _HASH = np.array([0.7548776662466927, 0.5698402909980532]), np.array([[12.9898, 39.3461], [78.233, 11.1353]])

BESIDE: dict[str, Any] = {"range": np.nan, "body_id": -1, "facet_id": -1, "incidence": np.nan, "emission": np.nan,
                          "phase": np.nan, "r_body": np.full(3, np.nan), "sunlit": 0.0}
"""Products of a place that sees no body."""
_DTYPES = {name: np.int32 if name.endswith("_id") else np.float64 for name in BESIDE}


class RayEngine:
    """A scene's acceleration structures.

    Parameters
    ----------
    scene : Scene

    Raises
    ------
    DeviceError
        embreex is not installed.
    """

    def __init__(self, scene: Scene):
        self.scene = scene
        self._solids = {body.name: _Solid(body) for body in scene.bodies}

    def close(self) -> None:
        """Release the acceleration structures."""
        self._solids.clear()

    def irradiance(self, pixel: np.ndarray, camera: PinholeCamera, views: list[BodyView],
                   draw: np.ndarray | int = 0) -> np.ndarray:
        """Irradiance (N,) float64 [W/m2 per pixel] of places in the image (N, 2) [px].

        If the scene's Sun has a disc, each place is lit by one point of it, the `draw`-th (N,) of its pixel: the mean
        of a pixel's draws 0, 1, 2, ... has penumbras.
        """
        if not self.scene.sun_disc:
            draws = [None] * len(_parts(pixel))
        else:
            draws = _parts(np.broadcast_to(draw, len(pixel)))
        return np.concatenate([np.zeros(0)] + [self._trace(part, camera, views, draw)[0]
                                               for part, draw in zip(_parts(pixel), draws, strict=True)])

    def ranges(self, pixel: np.ndarray, camera: PinholeCamera, views: Iterable[BodyView]) -> np.ndarray:
        """Distances (N,) float64 [m] of the first surface at places in the image (N, 2) [px], or infinity."""
        return self._first(camera.directions(pixel), views)[2]

    def sunlit(self, r_body_m: np.ndarray, view: BodyView, views: list[BodyView]) -> np.ndarray:
        """Whether points (N, 3) [m] in a body's frame have a free line (N,) bool to the Sun's middle."""
        return self._sees_sun(r_body_m, view.sun_direction_body, view, views)

    def products(self, pixel: np.ndarray, camera: PinholeCamera, views: list[BodyView]) -> dict[str, np.ndarray]:
        """What places in the image (N, 2) [px] see, by the names of `BESIDE`."""
        made = {name: np.full((len(pixel), *np.shape(value)), value, _DTYPES[name]) for name, value in BESIDE.items()}
        done = 0
        for part in _parts(pixel):
            _, body, facet, distance, sunlit = self._trace(part, camera, views)
            ray_camera = camera.directions(part)
            for index, view in enumerate(views):
                here = np.flatnonzero(body == index)
                ray = ray_camera[here] @ view.camera_from_body
                normal = self._solids[view.name].normals[facet[here]]
                values = {"range": distance[here], "body_id": index, "facet_id": facet[here],
                          "incidence": _angle(normal, view.sun_direction_body), "emission": _angle(normal, -ray),
                          "phase": _angle(-ray, view.sun_direction_body),
                          "r_body": view.r_camera_body_m + ray * distance[here, None], "sunlit": sunlit[here]}
                for name, value in values.items():
                    made[name][done + here] = value
            done += len(part)
        return made

    def _trace(self, pixel: np.ndarray, camera: PinholeCamera, views: list[BodyView],
               draw: np.ndarray | None = None) -> tuple[np.ndarray, ...]:
        """Irradiance, body or -1, facet, distance [m], and whether in sunlight, of places (N, 2) [px]."""
        ray_camera = camera.directions(pixel)
        body, facet, nearest = self._first(ray_camera, views)
        value, sunlit = np.zeros(len(pixel)), np.zeros(len(pixel))
        for index, view in enumerate(views):
            solid = self._solids[view.name]
            here = np.flatnonzero(body == index)
            here = here[solid.normals[facet[here]] @ view.sun_direction_body > 0.0]
            ray = ray_camera[here] @ view.camera_from_body
            r_body = view.r_camera_body_m + ray * nearest[here, None]
            towards = view.sun_direction_body
            if draw is not None:
                radius = SUN_RADIUS_M / (view.sun_distance_au * AU_M)
                towards = towards + radius * _disc(pixel[here], draw[here], towards)
            above = r_body + solid.normals[facet[here]] * (_LIFT * solid.radius_m)
            is_lit = self._sees_sun(above, towards, view, views)
            lit, ray, r_body = here[is_lit], ray[is_lit], r_body[is_lit]
            sunlit[lit] = 1.0
            surface, shaded = solid.surface, facet[lit]
            weights = surface.weights(shaded, r_body) if solid.needs_weights else None
            normal = surface.normals(shaded, weights, -ray)
            if (relief := surface.body.relief) is not None:
                normal = relief.normals(normal, r_body, nearest[lit] / camera.focal_length_px, -ray)
            brdf = surface.brdf(view.sun_direction_body, -ray, normal, surface.albedo_scale(shaded, weights))
            value[lit] = brdf * np.maximum(normal @ view.sun_direction_body, 0.0) / view.sun_distance_au**2
        # A pixel's solid angle falls off as cos^3 of its angle from the boresight.
        value *= self.scene.solar_irradiance_of(camera) * ray_camera[:, 2] ** 3 / camera.focal_length_px**2
        return value, body, facet, nearest, sunlit

    def _first(self, ray_camera: np.ndarray, views: Iterable[BodyView]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Body or -1, facet and distance [m] that rays (N, 3) from the camera meet first."""
        nearest = np.full(len(ray_camera), np.inf)
        body, facet = np.full(len(ray_camera), -1), np.full(len(ray_camera), -1)
        for index, view in enumerate(views):
            if view.is_visible:
                which, distance = self._solids[view.name].hit(view.r_camera_body_m, ray_camera @ view.camera_from_body)
                nearer = distance < nearest
                nearest[nearer], body[nearer], facet[nearer] = distance[nearer], index, which[nearer]
        return body, facet, nearest

    def _sees_sun(self, start: np.ndarray, towards: np.ndarray, view: BodyView, views: list[BodyView]) -> np.ndarray:
        """Whether points (N, 3) [m] of a body have a free line towards the Sun (3,), or a place on it each (N, 3)."""
        is_free = np.ones(len(start), bool)
        for other in views:
            rotation = other.camera_from_body.T @ view.camera_from_body
            offset = other.r_camera_body_m - rotation @ view.r_camera_body_m
            rest = np.flatnonzero(is_free)
            direction = towards if towards.ndim == 1 else towards[rest]
            is_free[rest] = ~self._solids[other.name].blocks(start[rest] @ rotation.T + offset, direction @ rotation.T)
        return is_free


class _Solid(RayMesh):
    """A body that rays may meet."""

    def __init__(self, body: Body):
        super().__init__(body.shape.vertices_m, body.shape.facets)
        self.surface = Surface(body)
        self.needs_weights = body.smooth_normals or body.albedo_map is not None


def _parts(pixel: np.ndarray) -> list[np.ndarray]:
    return [pixel[start:start + _RAYS_AT_ONCE] for start in range(0, len(pixel), _RAYS_AT_ONCE)]


def _disc(pixel: np.ndarray, draw: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Points (N, 3) of a disc of radius 1 across an axis (3,): Roberts' R2 sequence, shifted from pixel to pixel."""
    shift = np.sin(np.rint(pixel) @ _HASH) * 43758.5453
    u, v = ((shift + draw[:, None] * _R2) % 1.0).T
    radius, angle = np.sqrt(u), 2.0 * np.pi * v
    x, y, _ = sun_from_body(axis)
    return np.outer(radius * np.cos(angle), x) + np.outer(radius * np.sin(angle), y)


def _angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return 2.0 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))
