"""Mitsuba 3: a path tracer with direct light only."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .peer_scene import PeerScene

SAMPLES = (1, 2, 4, 8, 16)


def prepare(scene: PeerScene, variant: str = "llvm_ad_mono") -> Callable[[int], np.ndarray]:
    """A function of samples along a pixel's side that gives the irradiance [W/m2 per pixel], (H, W).

    Stratified samples; only the region of the bodies is rendered.
    """
    import mitsuba as mi

    mi.set_variant(variant)
    grey = lambda value: {"type": "rgb", "value": [float(value)] * 3}  # noqa: E731
    # A shadow ray starts 9e-5 (1 + largest coordinate) off the surface: the origin belongs into the bodies,
    # and they must be large against 1, or shadows leak (2 % of the flux at a phase of 120 deg).
    low, high = scene.vertices.min(axis=0), scene.vertices.max(axis=0)
    centre, unit = 0.5 * (low + high), 1e-3 * float((high - low).max())
    vertices = np.ascontiguousarray((scene.vertices - centre) / unit, np.float32)
    near, far = (depth / unit for depth in scene.depth_range)
    x0, y0, x1, y1 = scene.region_px()
    cx, cy = scene.principal_point_px
    to_world = np.diag([-1.0, -1.0, 1.0, 1.0])
    to_world[:3, 3] = -centre / unit
    # Mitsuba's camera has +X left and +Y up.
    film = {"type": "hdrfilm", "width": scene.width_px, "height": scene.height_px, "rfilter": {"type": "box"},
            "pixel_format": "luminance", "component_format": "float32",
            "crop_offset_x": x0, "crop_offset_y": y0, "crop_width": x1 - x0, "crop_height": y1 - y0}
    parts = {"type": "scene", "integrator": {"type": "direct", "hide_emitters": True}}
    for index, albedo in enumerate(np.unique(scene.normal_albedo)):
        facets = scene.facets[scene.normal_albedo == albedo]
        used, facets = np.unique(facets, return_inverse=True)
        material = mi.Properties()
        material["bsdf"] = mi.load_dict({"type": "diffuse", "reflectance": grey(albedo)})
        material["face_normals"] = True
        mesh = mi.Mesh(f"body{index}", len(used), facets.size // 3, props=material)
        arrays = mi.traverse(mesh)
        arrays["vertex_positions"] = vertices[used].ravel()
        arrays["faces"] = np.ascontiguousarray(facets, np.uint32).ravel()
        arrays.update()
        parts[f"body{index}"] = mesh
    parts["sun"] = {"type": "directional", "direction": (-scene.to_sun).tolist(),
                    "irradiance": grey(scene.solar_irradiance_W_m2)}
    parts["sensor"] = {
        "type": "perspective", "fov_axis": "x",
        "fov": float(np.degrees(2.0 * np.arctan(0.5 * scene.width_px / scene.focal_length_px))),
        "principal_point_offset_x": (cx - 0.5 * (scene.width_px - 1)) / scene.width_px,
        "principal_point_offset_y": (cy - 0.5 * (scene.height_px - 1)) / scene.height_px,
        "near_clip": 0.5 * near, "far_clip": 2.0 * far,
        "to_world": mi.ScalarTransform4f(to_world), "film": film,
        "sampler": {"type": "stratified", "sample_count": 1}}
    loaded = mi.load_dict(parts)
    solid_angle = scene.solid_angle_sr()

    def render(samples: int) -> np.ndarray:
        image = mi.render(loaded, spp=samples**2, seed=0)
        whole = np.zeros(solid_angle.shape)
        whole[y0:y1, x0:x1] = np.array(image, np.float64).reshape(y1 - y0, x1 - x0)
        return whole * solid_angle

    return render
