"""Open3D's RaycastingScene: Embree with all cores, the same shading as the Embree peer."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .embree import grid_caster
from .peer_scene import PeerScene

SAMPLES = (1, 2, 4, 8)


def prepare(scene: PeerScene) -> Callable[[int], np.ndarray]:
    """A function of samples along a pixel's side that gives the irradiance [W/m2 per pixel], (H, W)."""
    import open3d as o3d

    accelerated = o3d.t.geometry.RaycastingScene()
    accelerated.add_triangles(o3d.core.Tensor(scene.vertices.astype(np.float32)),
                              o3d.core.Tensor(scene.facets.astype(np.uint32)))

    def first_hit(origins: np.ndarray, rays: np.ndarray) -> np.ndarray:
        answer = accelerated.cast_rays(o3d.core.Tensor(np.concatenate([origins, rays], axis=1)))
        facet = answer["primitive_ids"].numpy().astype(np.int64)
        return np.where(facet == 0xFFFFFFFF, -1, facet)

    return grid_caster(scene, first_hit)
