"""BOP: folders of scenes with images, depths and masks, and poses of the models in millimetres.

Axes of a camera are OpenCV's, which are ours; (0, 0) is the centre of the top-left pixel. Depth is along the boresight.

The world is the frame `inertial`. `scene_header.json` has each frame's header, without the labels, by its number.

Source: bop_toolkit, docs/bop_datasets_format.md.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from glrender_camera import PinholeCamera

from ...base.rotations import dcm
from ...engines.rays.exact_loops import FACING
from ...engines.rays.exact_rays import exact_mesh
from ...scene.body import Body
from ...scene.scene import Scene
from ...view.state import State
from ...view.view import BodyView, view_bodies
from ..formats import FrameFile
from ..options import FrameOptions
from .images import png

_MM = 1000.0
_FULL = 65535
# Pixels on a side of a grid by which the parts of an outline beyond the image are counted.
_GRID = 192


class BopWriter:
    """Writes a shard as one scene."""

    def __init__(self, scene: Scene, options: FrameOptions, number: int):
        self._scene, self._camera = scene, scene.camera(options.camera)
        self._files: dict[str, bytes] = {}
        self._of_images: dict[str, dict[str, Any]] = {"scene_camera": {}, "scene_gt": {}, "scene_gt_info": {},
                                                      "scene_header": {}}

    def add(self, index: int, state: State, frame: FrameFile, record: Mapping[str, Any]) -> None:
        """Add a frame."""
        body_id, camera = frame.products["body_id"], self._camera
        depth_mm = _MM * np.nan_to_num(frame.products["range"] * _cosines(camera))
        step_mm = max(float(depth_mm.max()), 1e-9) / _FULL
        self._files[f"gray/{index:06d}.png"] = png(frame.pixels)
        self._files[f"depth/{index:06d}.png"] = png(np.rint(depth_mm / step_mm).astype(np.uint16))
        poses, infos = [], []
        views = view_bodies(state, camera, self._scene.hulls)
        for number, (body, view) in enumerate(zip(self._scene.bodies, views, strict=True)):
            label, is_seen = record["labels"]["bodies"][body.name], body_id == number
            outline = Outline(body, view, views, camera, is_seen)
            self._files[f"mask/{index:06d}_{number:06d}.png"] = png(outline.mask)
            self._files[f"mask_visib/{index:06d}_{number:06d}.png"] = png(is_seen)
            turn = dcm(np.array(label["q_camera_from_body"]))
            poses.append({"obj_id": number + 1, "cam_R_m2c": turn.ravel().tolist(),
                          "cam_t_m2c": [_MM * x for x in label["r_camera_m"]]})
            infos.append({"bbox_obj": outline.box, "bbox_visib": _box(label["box_px"]), "px_count_all": outline.n_px,
                          "px_count_valid": int((outline.mask & (depth_mm > 0.0)).sum()),
                          "px_count_visib": label["n_px"],
                          "visib_fract": min(label["n_px"] / outline.n_px, 1.0) if outline.n_px else 0.0})
        header = {name: value for name, value in record.items() if name != "labels"}
        for name, entry in (("scene_camera", {**intrinsics(camera), **_from_world(state, camera),
                                              "depth_scale": step_mm}),
                            ("scene_gt", poses), ("scene_gt_info", infos), ("scene_header", header)):
            self._of_images[name][str(index)] = entry

    def files(self) -> dict[str, bytes]:
        """The shard."""
        return {**self._files, **{f"{name}.json": json.dumps(table).encode()
                                  for name, table in self._of_images.items()}}


class Outline:
    """The whole outline of a body: also where another hides it, and beyond the image, to its own size on each side.

    Attributes
    ----------
    mask : (height, width) bool
        Of the image.
    box : list of int
        x, y, width, height; -1 each where the body is outside.
    n_px : int
        Counted on a grid of 192 x 192 where it goes beyond the image: to 0.2 % of a disc's.
    """

    def __init__(self, body: Body, view: BodyView, views: list[BodyView], camera: PinholeCamera, is_seen: np.ndarray):
        self._mesh, self._view, self._camera = exact_mesh(body.drawn_shape), view, camera
        width, height = camera.width_px, camera.height_px
        self.mask = is_seen
        if view.is_visible and any(_may_hide(view, other) for other in views if other is not view):
            self.mask = self._met(np.arange(width), np.arange(height))
        if view.is_whole or not view.is_visible:
            y, x = np.nonzero(self.mask)
            self.n_px = int(x.size)
            self.box = _box([x.min(), y.min(), x.max() + 1, y.max() + 1] if x.size else None)
            return
        bounds = np.array([-width, -height, 2 * width - 1, 2 * height - 1], float)
        if view.bounds_px is not None:
            bounds = np.concatenate([np.maximum(view.bounds_px[:2], bounds[:2]),
                                     np.minimum(view.bounds_px[2:], bounds[2:])])
        (x, dx), (y, dy) = (_grid(*bounds[k::2]) for k in (0, 1))
        met = self._met(x, y)
        self.n_px = max(int(round(met.sum() * dx * dy)), int(self.mask.sum()))
        rows, columns = np.flatnonzero(met.any(axis=1)), np.flatnonzero(met.any(axis=0))
        self.box = _box([int(np.rint(x[columns[0]])), int(np.rint(y[rows[0]])), int(np.rint(x[columns[-1]])) + 1,
                         int(np.rint(y[rows[-1]])) + 1] if rows.size else None)

    def _met(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Whether rays meet the body at columns (W,) and rows (H,) [px]: (H, W) bool."""
        rays = self._camera.directions(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2).astype(float))
        facet, _ = self._mesh.hit(self._view.r_camera_body_m, rays @ self._view.camera_from_body, FACING)
        return (facet >= 0).reshape(len(y), len(x))


def models(scene: Scene, camera: PinholeCamera) -> dict[str, bytes]:
    """Files of all scenes: camera.json, and the models with their extents, in millimetres."""
    files = {"camera.json": json.dumps({
        "cx": camera.principal_point_px[0], "cy": camera.principal_point_px[1], "fx": camera.focal_length_px,
        "fy": camera.focal_length_px, "width": camera.width_px, "height": camera.height_px,
        "depth_scale": 1.0}).encode()}
    models_info = {}
    for number, body in enumerate(scene.bodies, start=1):
        vertices, facets = _MM * body.shape.vertices_m, body.shape.facets
        low, size = vertices.min(axis=0), np.ptp(vertices, axis=0)
        models_info[str(number)] = {"diameter": _MM * _diameter_m(body.hull.points_m.T),
                                    **{f"min_{axis}": float(value) for axis, value in zip("xyz", low, strict=True)},
                                    **{f"size_{axis}": float(value) for axis, value in zip("xyz", size, strict=True)}}
        header = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}",
                  *(f"property double {axis}" for axis in "xyz"), f"element face {len(facets)}",
                  "property list uchar int vertex_indices", "end_header"]
        lines = [*header, *(f"{x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices.tolist()),
                 *(f"3 {a} {b} {c}" for a, b, c in facets.tolist())]
        files[f"models/obj_{number:06d}.ply"] = ("\n".join(lines) + "\n").encode()
    return {**files, "models/models_info.json": json.dumps(models_info).encode()}


def intrinsics(camera: PinholeCamera) -> dict[str, Any]:
    """The camera's matrix, row by row."""
    f, (cx, cy) = camera.focal_length_px, camera.principal_point_px
    return {"cam_K": [f, 0.0, cx, 0.0, f, cy, 0.0, 0.0, 1.0]}


def _from_world(state: State, camera: PinholeCamera) -> dict[str, Any]:
    """The camera's rotation, row by row, and translation [mm] from the frame `inertial`."""
    craft = dcm(state.spacecraft.q_from_inertial)
    turn = dcm(camera.q_camera_from_spacecraft) @ craft
    r_camera = state.spacecraft.r_inertial_m + craft.T @ camera.r_camera_spacecraft_m
    return {"cam_R_w2c": turn.ravel().tolist(), "cam_t_w2c": (-_MM * turn @ r_camera).tolist()}


def _cosines(camera: PinholeCamera) -> np.ndarray:
    """Depth over range (height, width) at the pixels' centres."""
    return 1.0 / np.sqrt(1.0 + (camera.seen**2).sum(axis=-1))


def _box(box_px: Any) -> list[int]:
    if box_px is None:
        return [-1, -1, -1, -1]
    x0, y0, x1, y1 = (int(edge) for edge in box_px)
    return [x0, y0, x1 - x0, y1 - y0]


def _grid(low: float, high: float) -> tuple[np.ndarray, float]:
    """Whole pixels from low to high, or at most `_GRID` places in the middles of wider ones; and their width."""
    first, last = np.ceil(low), np.floor(high)
    if last - first + 1 <= _GRID:
        return np.arange(first, last + 1), 1.0
    step = (high - low) / _GRID
    return low + step * (np.arange(_GRID) + 0.5), step


def _may_hide(view: BodyView, other: BodyView) -> bool:
    """Whether a body may be before another in the image."""
    if not other.is_visible or view.bounds_px is None or other.bounds_px is None:
        return other.is_visible
    a, b = view.bounds_px, other.bounds_px
    return bool(other.depth_m[0] < view.depth_m[1] and (a[:2] <= b[2:]).all() and (b[:2] <= a[2:]).all())


def _diameter_m(points_m: np.ndarray) -> float:
    return max(float(np.linalg.norm(points_m - point, axis=1).max()) for point in points_m)
