"""pyrender: a rasteriser of 8 bit with a directional light and its shadow map."""

from __future__ import annotations

import os
from collections.abc import Callable

import numpy as np

from .peer_scene import PeerScene

SAMPLES = (1,)
IS_RELATIVE = True


def prepare(scene: PeerScene) -> Callable[[int], np.ndarray]:
    """A function that gives the image (H, W) up to a factor; its gamma of 2.2 is undone."""
    os.environ["PYOPENGL_PLATFORM"] = "egl"
    import pyrender
    import trimesh

    corners = scene.vertices[scene.facets].reshape(-1, 3) * [1.0, -1.0, -1.0]
    facets = np.arange(len(corners)).reshape(-1, 3)
    solid = trimesh.Trimesh(corners, facets, process=False)
    material = pyrender.MetallicRoughnessMaterial(metallicFactor=0.0, roughnessFactor=1.0,
                                                  baseColorFactor=(1.0, 1.0, 1.0, 1.0))
    near, far = scene.depth_range
    cx, cy = scene.principal_point_px
    drawn = pyrender.Scene(bg_color=(0.0, 0.0, 0.0, 1.0), ambient_light=(0.0, 0.0, 0.0))
    drawn.add(pyrender.Mesh.from_trimesh(solid, material=material, smooth=False))
    drawn.add(pyrender.IntrinsicsCamera(scene.focal_length_px, scene.focal_length_px, cx + 0.5, cy + 0.5,
                                        znear=0.9 * near, zfar=1.1 * far), pose=np.eye(4))
    # A light shines along its own -Z.
    back = scene.to_sun * [1.0, -1.0, -1.0]
    side = np.cross(back, [0.3, 0.5, 0.8])
    side /= np.linalg.norm(side)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([side, np.cross(back, side), back], axis=1)
    pose[:3, 3] = scene.vertices.mean(axis=0) * [1.0, -1.0, -1.0]
    drawn.add(pyrender.DirectionalLight(color=np.ones(3), intensity=3.0), pose=pose)
    renderer = pyrender.OffscreenRenderer(scene.width_px, scene.height_px)

    def render(samples: int) -> np.ndarray:
        colour, _ = renderer.render(drawn, flags=pyrender.RenderFlags.SHADOWS_DIRECTIONAL)
        return (colour[..., 0] / 255.0) ** 2.2

    return render
