"""Products at the centre of each pixel: range, body and facet, angles, place, sunlight."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...planner.plan import WindowPlan
from ...scene.scene import Scene
from .gl.targets import Target
from .surface_pass import Frame, SurfacePass


class ProductPass:
    """Draws the products of `image.PRODUCTS`.

    Parameters
    ----------
    target : Target
        Of three times four components.
    surfaces : SurfacePass
    scene : Scene
    """

    def __init__(self, target: Target, surfaces: SurfacePass, scene: Scene):
        self._target, self._surfaces = target, surfaces
        # Facets are drawn part by part.
        self._facets = {index: np.concatenate(body.part_facets) for index, body in enumerate(scene.bodies)
                        if len(body.parts) > 1}

    def draw(self, wanted: Sequence[str], frame: Frame, windows: Sequence[WindowPlan]) -> dict[str, np.ndarray]:
        """Products by name, (height, width) each."""
        shape = (frame.camera.height_px, frame.camera.width_px)
        layers = [np.zeros((*shape, 4), np.float32) for _ in range(3)]
        for window in windows:
            x0, y0, x1, y1 = window.roi
            self._surfaces.draw(frame, self._target, "products.frag.glsl", (x0 - 0.5, y0 - 0.5, x1 - 0.5, y1 - 0.5),
                                (x1 - x0, y1 - y0), window.bodies)
            for attachment, layer in enumerate(layers):
                layer[y0:y1, x0:x1] = self._target.read(attachment)
        angles, place, identity = layers
        body_id = identity[..., 0].astype(np.int32) - 1
        beside = body_id < 0
        facet_id = np.where(beside, -1, identity[..., 1] + 4096.0 * identity[..., 2]).astype(np.int32)
        for index, number in self._facets.items():
            here = body_id == index
            facet_id[here] = number[facet_id[here]]
        origin_range_m = np.array([0.0 if body.relative_to_camera else view.range_m
                                   for view, body in zip(frame.views, frame.bodies, strict=True)] + [np.nan])
        centre_m = np.array([*(view.centre_m for view in frame.views), np.full(3, np.nan)])
        angles[beside] = np.nan
        sunlit = place[..., 3].copy()
        place[beside] = np.nan
        made = {
            "range": lambda: origin_range_m[body_id] + angles[..., 0],
            "body_id": lambda: body_id,
            "facet_id": lambda: facet_id,
            "incidence": lambda: angles[..., 1].copy(),
            "emission": lambda: angles[..., 2].copy(),
            "phase": lambda: angles[..., 3].copy(),
            "r_body": lambda: (place[..., :3] + centre_m[body_id]).astype(np.float32),
            "sunlit": lambda: sunlit,
        }
        return {name: made[name]() for name in wanted}
