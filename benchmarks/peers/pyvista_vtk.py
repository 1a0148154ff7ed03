"""PyVista (VTK): a rasteriser of 8 bit with a directional light and VTK's shadow pass."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .peer_scene import PeerScene

SAMPLES = (1,)
IS_RELATIVE = True


def prepare(scene: PeerScene) -> Callable[[int], np.ndarray]:
    """A function that gives the image (H, W) up to a factor."""
    import pyvista

    solid = pyvista.PolyData(scene.vertices.astype(np.float32),
                             np.concatenate([np.full((len(scene.facets), 1), 3), scene.facets], axis=1).ravel())
    plotter = pyvista.Plotter(off_screen=True, window_size=(scene.width_px, scene.height_px), lighting="none")
    plotter.background_color = "black"
    plotter.add_mesh(solid, color="white", ambient=0.0, diffuse=1.0, specular=0.0, smooth_shading=False)
    light = pyvista.Light(light_type="scene light", intensity=1.0)
    light.positional = False
    middle = scene.vertices.mean(axis=0)
    light.focal_point, light.position = middle, middle + scene.to_sun
    plotter.add_light(light)
    camera = plotter.camera
    camera.position, camera.focal_point, camera.up = (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)
    camera.view_angle = float(np.degrees(2.0 * np.arctan(0.5 * scene.height_px / scene.focal_length_px)))
    near, far = scene.depth_range
    camera.clipping_range = (0.9 * near, 1.1 * far)
    plotter.enable_shadows()
    plotter.show(auto_close=False)

    def render(samples: int) -> np.ndarray:
        plotter.render()
        return plotter.screenshot(return_img=True)[..., 0] / 255.0

    return render
