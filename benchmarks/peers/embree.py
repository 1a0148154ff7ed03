"""Embree ray casting through embreex: one primary ray a sample, one shadow ray where the facet faces the Sun."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np

from .peer_scene import PeerScene

SAMPLES = (1, 2, 4, 8)


def prepare(scene: PeerScene) -> Callable[[int], np.ndarray]:
    """A function of samples along a pixel's side that gives the irradiance [W/m2 per pixel], (H, W)."""
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    corners = np.ascontiguousarray(scene.vertices[scene.facets], np.float32)
    accelerated = rtcore_scene.EmbreeScene()
    TriangleMesh(accelerated, corners)
    return grid_caster(scene, lambda origins, rays: accelerated.run(origins, rays))


def grid_caster(scene: PeerScene, first_hit: Callable[[np.ndarray, np.ndarray], np.ndarray]
                ) -> Callable[[int], np.ndarray]:
    """Lambert on a regular grid of samples with any function (origins, rays) -> facet or -1, float32."""
    normals, to_sun = scene.facet_normals, scene.to_sun
    mu0 = normals @ to_sun
    radiance = np.where(mu0 > 0.0, scene.normal_albedo / np.pi * mu0, 0.0) * scene.solar_irradiance_W_m2
    plane = np.einsum("ij,ij->i", scene.vertices[scene.facets[:, 0]], normals)
    x0, y0, x1, y1 = scene.region_px()
    solid_angle = scene.solid_angle_sr()[y0:y1, x0:x1].ravel()
    extent = float((scene.vertices.max(axis=0) - scene.vertices.min(axis=0)).max())
    sun32 = np.asarray(to_sun, np.float32)

    def render(samples: int) -> np.ndarray:
        offsets = (np.arange(samples) + 0.5) / samples - 0.5
        total = np.zeros(len(solid_angle))
        for dy, dx in itertools.product(offsets, offsets):
            ray = scene.pixel_rays(dx, dy, (x0, y0, x1, y1)).reshape(-1, 3)
            facet = first_hit(np.zeros(ray.shape, np.float32), ray.astype(np.float32))
            sunny = np.flatnonzero((facet >= 0) & (radiance[facet] > 0.0))
            seen = facet[sunny]
            # The point again in float64 from the facet's plane, a millionth of the body off the surface.
            distance = plane[seen] / np.einsum("ij,ij->i", ray[sunny], normals[seen])
            start = ray[sunny] * distance[:, None] + normals[seen] * (1e-6 * extent)
            is_free = first_hit(start.astype(np.float32), np.tile(sun32, (len(start), 1))) < 0
            total[sunny[is_free]] += radiance[seen[is_free]]
        image = np.zeros((scene.height_px, scene.width_px))
        image[y0:y1, x0:x1] = (total / samples**2 * solid_angle).reshape(y1 - y0, x1 - x0)
        return image

    return render
