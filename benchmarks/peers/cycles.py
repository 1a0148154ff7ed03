"""Blender's Cycles (bpy) on the CPU: direct light of a Sun without size, box filter; the image comes as a file."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from .peer_scene import PeerScene

SAMPLES = (1, 2, 4)


def prepare(scene: PeerScene) -> Callable[[int], np.ndarray]:
    """A function of samples along a pixel's side that gives the irradiance [W/m2 per pixel], (H, W)."""
    os.environ["OPENCV_IO_ENABLE_OPENEXR"] = "1"
    import bpy
    from mathutils import Matrix, Vector

    bpy.ops.wm.read_factory_settings(use_empty=True)
    blender = bpy.context.scene
    turned = scene.vertices * [1.0, -1.0, -1.0]
    # Rays start off the surface by a share of the coordinates: the origin belongs into the bodies.
    low, high = turned.min(axis=0), turned.max(axis=0)
    centre, unit = 0.5 * (low + high), 0.01 * float((high - low).max())
    mesh = bpy.data.meshes.new("bodies")
    mesh.from_pydata(((turned - centre) / unit).tolist(), [], scene.facets.tolist())
    body = bpy.data.objects.new("bodies", mesh)
    blender.collection.objects.link(body)
    for index, albedo in enumerate(np.unique(scene.normal_albedo)):
        material = bpy.data.materials.new(f"grey{index}")
        material.use_nodes = True
        nodes = material.node_tree.nodes
        nodes.clear()
        diffuse, output = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeOutputMaterial")
        diffuse.inputs["Color"].default_value = (albedo, albedo, albedo, 1.0)
        material.node_tree.links.new(diffuse.outputs[0], output.inputs[0])
        mesh.materials.append(material)
    mesh.polygons.foreach_set("material_index", np.unique(scene.normal_albedo, return_inverse=True)[1].astype(np.int32))
    lamp = bpy.data.lights.new("sun", "SUN")
    lamp.energy, lamp.angle = 1.0, 0.0
    sun = bpy.data.objects.new("sun", lamp)
    sun.rotation_mode = "QUATERNION"
    sun.rotation_quaternion = Vector(scene.to_sun * [1.0, -1.0, -1.0]).to_track_quat("Z", "Y")
    blender.collection.objects.link(sun)
    lens = bpy.data.cameras.new("camera")
    lens.sensor_fit, lens.sensor_width = "HORIZONTAL", 36.0
    lens.lens = 36.0 * scene.focal_length_px / scene.width_px
    cx, cy = scene.principal_point_px
    lens.shift_x = -(cx - 0.5 * (scene.width_px - 1)) / scene.width_px
    lens.shift_y = (cy - 0.5 * (scene.height_px - 1)) / scene.width_px
    near, far = scene.depth_range
    lens.clip_start, lens.clip_end = 0.5 * near / unit, 2.0 * far / unit
    camera = bpy.data.objects.new("camera", lens)
    camera.matrix_world = Matrix.Translation(Vector(-centre / unit))
    blender.collection.objects.link(camera)
    blender.camera = camera
    _settings(blender, scene)
    x0, y0, x1, y1 = scene.region_px()
    solid_angle = scene.solid_angle_sr()
    path = Path(tempfile.mkdtemp()) / "frame.exr"
    blender.render.filepath = str(path)

    def render(samples: int) -> np.ndarray:
        blender.cycles.samples = samples**2
        bpy.ops.render.render(write_still=True)
        read = bpy.data.images.load(str(path))
        pixels = np.empty(4 * read.size[0] * read.size[1], np.float32)
        read.pixels.foreach_get(pixels)
        shape = (read.size[1], read.size[0])
        bpy.data.images.remove(read)
        whole = pixels.reshape(*shape, 4)[::-1, :, 0].astype(np.float64)
        inside = np.zeros(solid_angle.shape)
        inside[y0:y1, x0:x1] = whole[y0:y1, x0:x1]
        return inside * solid_angle * scene.solar_irradiance_W_m2

    return render


def _settings(blender, scene: PeerScene) -> None:
    """Direct light only, no denoiser, no tone curve, only the bodies' region."""
    cycles, render = blender.cycles, blender.render
    render.engine = "CYCLES"
    cycles.device, cycles.use_adaptive_sampling, cycles.use_denoising = "CPU", False, False
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 1.0
    cycles.max_bounces = 0
    render.use_persistent_data = True
    render.resolution_x, render.resolution_y, render.resolution_percentage = scene.width_px, scene.height_px, 100
    x0, y0, x1, y1 = scene.region_px()
    render.use_border, render.use_crop_to_border = True, False
    render.border_min_x, render.border_max_x = x0 / scene.width_px, x1 / scene.width_px
    render.border_min_y, render.border_max_y = 1.0 - y1 / scene.height_px, 1.0 - y0 / scene.height_px
    render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"
    render.image_settings.exr_codec = "NONE"
    blender.view_settings.view_transform = "Raw"
    world = blender.world
    if world is not None:
        world.use_nodes = False
        world.color = (0.0, 0.0, 0.0)
