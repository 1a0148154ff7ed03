"""What rays see of a large shape that is small in the image: cast at a node of Sun and camera, for all frames near it.

Rays cost what the shape's facets miss in the processor's cache, however few pixels it covers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from glrender_camera import PinholeCamera

from .kept_nodes import KeptAtNodes, camera_at_node, phase_gain
from .level_tables import FEWEST_KEPT
from .ray_engine import RayEngine
from .scene import Scene
from .surface import Surface
from .view import BodyView

NODE_ERROR = 2e-3
"""RMS error [1] of the image that is farthest from its node."""
CONTRAST = 1.4
"""Contrast of samples over that of those which are interpolated between them, as noise has it."""
# Steps of the grid of directions in 1 rad, and of ranges in a factor e; of samples a pixel in a factor 2.
_DIRECTIONS, _RANGES, _DENSITIES = 4096, 512, 8
# Largest size [px], at which a step of the grid moves the outline by 0.008 px; least range in the body's radii; least
# phase angle [rad], below which surfaces surge; and least cosine off the boresight, as an image is even.
_MOST_PX, _NEAREST, _LEAST_RAD, _LEAST_COS = 64.0, 8.0, 0.02, 0.95
# Beside the outline, in sizes: what rounding takes.
_MARGIN = 0.01


class KeptImages:
    """Samples of one body's window by rays.

    Parameters
    ----------
    scene : Scene
    rays : RayEngine
        Of the same scene.
    """

    def __init__(self, scene: Scene, rays: RayEngine):
        self._scene, self._rays = scene, rays
        self._kept = KeptAtNodes(_DIRECTIONS, _RANGES)
        self._surfaces = {body.name: Surface(body) for body in scene.bodies}

    def close(self) -> None:
        """Forget, and look for nothing any more."""
        self._kept.close()

    def forget(self) -> None:
        """Cast anew in the next frame; no image changes."""
        self._kept.forget()

    def may_serve(self, views: list[BodyView]) -> bool:
        """Whether a scene's only body is a large shape that is small in the image, all of it."""
        view = views[0]
        radius_m = self._rays.solid(view.name).radius_m
        return (len(views) == 1 and view.is_whole and view.size_px <= _MOST_PX
                and len(self._surfaces[view.name].body.shape.facets) >= FEWEST_KEPT
                and view.range_m >= _NEAREST * radius_m and view.cos_off_axis > _LEAST_COS
                and view.phase_rad - radius_m / view.range_m >= _LEAST_RAD)

    def samples(self, view: BodyView, camera: PinholeCamera, bounds_px: tuple[float, float, float, float],
                grid: tuple[int, int]) -> np.ndarray:
        """Samples (rows, columns) float32 [W/m2 per pixel] of a grid, each between the four that are nearest.

        Parameters
        ----------
        view : BodyView
            Of which `may_serve` is true.
        camera : PinholeCamera
        bounds_px : (float, float, float, float) [px]
            Of the grid: x0, y0, x1, y1.
        grid : (int, int)
            Columns and rows.
        """
        x0, y0, x1, y1 = bounds_px
        columns, rows = grid
        wanted = columns / (x1 - x0)
        density = 2.0 ** (math.ceil(math.log2(wanted) * _DENSITIES - 1e-9) / _DENSITIES)
        of = view.name, camera.focal_length_px, density

        def make(node: BodyView) -> _Kept:
            return self._cast(node, camera_at_node(camera.focal_length_px), density)

        node, kept = self._kept.at(view, self._rays.solid(view.name).radius_m, of, make)
        surface = self._surfaces[view.name]
        gain = (phase_gain(surface, view, node) * (node.sun_distance_au / view.sun_distance_au) ** 2
                * self._scene.solar_irradiance_of(camera) / kept.solar_irradiance_W_m2)
        # From a cell of the grid to its place in the image, and from there to one of the node's.
        pixel = np.array([[(x1 - x0) / columns, 0.0, x0 + 0.5 * (x1 - x0) / columns],
                          [0.0, (y1 - y0) / rows, y0 + 0.5 * (y1 - y0) / rows], [0.0, 0.0, 1.0]])
        to_node = kept.cell_from_pixel @ _through_plane(view, node, camera) @ pixel
        found = cv2.warpPerspective(kept.image, to_node, (columns, rows), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
        # A pixel's solid angle falls off as cos^3 of its angle from the boresight: across a small body as a product.
        across, down = (start + scale * np.arange(count) - middle for (scale, start), count, middle in zip(
            (pixel[0, [0, 2]], pixel[1, 1:]), grid, camera.principal_point_px, strict=True))
        middle_x, middle_y = (0.5 * (each[0] + each[-1]) for each in (across, down))
        found *= (gain * _solid_angle(across, middle_y, camera)).astype(np.float32)
        found *= (_solid_angle(middle_x, down, camera) / _solid_angle(middle_x, middle_y, camera)
                  ).astype(np.float32)[:, None]
        return found

    def _cast(self, node: BodyView, camera: PinholeCamera, density: float) -> _Kept:
        hull_m = self._scene.hulls[node.name].points_m
        points = node.camera_from_body @ (hull_m - node.r_camera_body_m[:, None])
        xy = points[:2] / points[2] * camera.focal_length_px
        low, high = xy.min(axis=1), xy.max(axis=1)
        margin = _MARGIN * (high - low).max()
        first = np.floor((low - margin) * density)
        columns, rows = (np.ceil((high + margin) * density) - first).astype(int)
        x, y = ((start + np.arange(count) + 0.5) / density for start, count in zip(first, (columns, rows), strict=True))
        # Each pixel, about, has the Sun's disc to itself.
        light = self._rays.lattice(x, y, camera, [node], round(density))
        image = (light / _solid_angle(x, y[:, None], camera)).astype(np.float32)
        to_cell = np.array([[density, 0.0, -first[0] - 0.5], [0.0, density, -first[1] - 0.5], [0.0, 0.0, 1.0]])
        return _Kept(image=image, cell_from_pixel=to_cell,
                     solar_irradiance_W_m2=self._scene.solar_irradiance_of(camera))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Kept:
    """Samples (rows, columns) of pixels as large as on the boresight, and what takes a place [px] to them (3, 3)."""

    image: np.ndarray
    cell_from_pixel: np.ndarray
    solar_irradiance_W_m2: float

    @property
    def n_bytes(self) -> int:
        return self.image.nbytes


def _through_plane(view: BodyView, node: BodyView, camera: PinholeCamera) -> np.ndarray:
    """Homography (3, 3) from a camera's image to a node's, of the plane through the body's origin that faces the node.

    Source: Hartley and Zisserman (2004), Multiple View Geometry, 13.1.
    """
    normal = node.r_camera_body_m / node.range_m
    # Along a ray d from the camera at r that plane is met at r - d (n r) / (n d).
    ray_to_plane = (np.outer(view.r_camera_body_m - node.r_camera_body_m, normal)
                    - float(normal @ view.r_camera_body_m) * np.eye(3))
    x, y = camera.principal_point_px
    ray_from_pixel = np.array([[1.0, 0.0, -x], [0.0, 1.0, -y], [0.0, 0.0, camera.focal_length_px]])
    node_from_ray = np.diag([camera.focal_length_px, camera.focal_length_px, 1.0])
    return node_from_ray @ node.camera_from_body @ ray_to_plane @ view.camera_from_body.T @ ray_from_pixel


def _solid_angle(x_px: np.ndarray | float, y_px: np.ndarray | float, camera: PinholeCamera) -> np.ndarray | float:
    """Of pixels so far from the principal point, over that of the one there."""
    return (1.0 + (x_px**2 + y_px**2) / camera.focal_length_px**2) ** -1.5
