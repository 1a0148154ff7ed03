"""Plans and products that the backends which trace the full shapes share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from glrender_camera import PinholeCamera

from ...planner.plan import BodyPlan, RenderPlan
from ...planner.predicted import frame_errors, rms_tolerance
from ...scene.scene import Scene
from ...scene.tolerance import by_unit
from ...view.regions import Group
from ...view.view import BodyView
from .engine import BESIDE, RayEngine


def full_shape_plan(scene: Scene, camera: PinholeCamera, views: list[BodyView], *,
                    max_error: float | Mapping[str, float], predicted_error: float, roi: tuple[int, int, int, int],
                    way_out: str, left_out: tuple[str, ...] = (), warnings: tuple[str, ...] = ()) -> RenderPlan:
    """The plan of a frame that leaves no facet out and needs no shadow map.

    Each miss of the tolerance is a warning, which ends with the way out.
    """
    groups = [Group.of([view], camera) for view in views if view.is_visible]
    made = RenderPlan(
        promised=frame_errors([(group, "rays", 0.0, 0.0) for group in groups]), way_out=way_out,
        camera=camera.name, max_error=rms_tolerance(max_error, views, camera), roi=roi, windows=(),
        predicted_error=predicted_error, asked=by_unit(max_error), left_out=left_out, warnings=warnings,
        navigation=frame_errors([(group, "rays", predicted_error, 0.0) for group in groups]),
        bodies=tuple(BodyPlan(
            name=view.name, is_visible=view.is_visible, n_facets=len(body.shape.facets), law=body.law_names,
            shadow_map_px=None, shadow_map_reused=False, relative_to_camera=True, normal_lookup=True,
            size_px=view.size_px) for view, body in zip(views, scene.bodies, strict=True)))
    return replace(made, warnings=(*warnings, *made.misses().values()))


def traced_products(engine: RayEngine, wanted: tuple[str, ...], camera: PinholeCamera, views: list[BodyView],
                    roi: tuple[int, int, int, int]) -> dict[str, np.ndarray]:
    """Products (height, width[, 3]) of the pixels' centres, in float64, as `RayEngine` finds them."""
    if not wanted:
        return {}
    x0, y0, x1, y1 = roi
    y, x = (axis.ravel() for axis in np.mgrid[y0:y1, x0:x1])
    seen = engine.products(np.stack([x, y], axis=1).astype(np.float64), camera, views)
    arrays = {}
    for name in wanted:
        values = seen[name]
        arrays[name] = np.full((camera.height_px, camera.width_px, *values.shape[1:]), BESIDE[name], values.dtype)
        arrays[name][y, x] = values
    return arrays
