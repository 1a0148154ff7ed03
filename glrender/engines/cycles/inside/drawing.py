"""Runs in Blender's process: the scene as Blender's data, and its image as float32 pixels."""

from __future__ import annotations

import glob
import os
import sys
import tempfile
import warnings

import bpy
import numpy as np
from mathutils import Matrix

# Blender as a module leaves its own libraries out; the compiler of OSL asks for one.
sys.path += glob.glob(os.path.join(bpy.utils.resource_path("LOCAL"), "python", "lib", "python3*", "site-packages"))
warnings.simplefilter("ignore", DeprecationWarning)


_MEMORY = "/dev/shm"  # noqa: S108 (a folder of mode 0700 with a random name is made in it)
# Samples beyond which Cycles' tables grow no more.
_MOST_TABLED = 8192
# Backs that a ray from the camera passes; Blender's own limit.
_MOST_BACKS = 1024
_GEOMETRY = ("vertices", "facets", "uv", "normals", "one_sided")


class Stage:
    """Bodies, a Sun, lamps and a camera.

    Parameters
    ----------
    head : dict
        `bodies`: name, law (None, with normal_albedo, for Lambert's; else the text of an OSL shader),
        has_texture, smooth. `lamps`: half_angle_rad of each.
    arrays : dict
        By ``name/index``: vertices (N, 3) float32, facets (M, 3) int32, uv (M, 3, 2), normals (N, 3),
        texture (H, W), bottom row first; one_sided (M,) float32, 1 of a facet whose back hides nothing, if any may be
        seen from there.
    """

    def __init__(self, head: dict, arrays: dict):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self._scene = bpy.context.scene
        self._folder = tempfile.TemporaryDirectory(prefix="glrender", dir=_MEMORY if _has_room() else None)
        self._path = os.path.join(self._folder.name, "frame.exr")
        # Before the bodies: Blender compiles OSL for the engine that is set.
        self._set_up(any(told["law"] for told in head["bodies"]), head["threads"])
        self._script_nodes = []
        self._told = head["bodies"]
        self._bodies = [self._body(told, {key: arrays.get(f"{key}/{index}") for key in (*_GEOMETRY, "texture")})
                        for index, told in enumerate(self._told)]
        self._light = bpy.data.lights.new("sun", "SUN")
        self._light.energy = 1.0
        self._lens = bpy.data.cameras.new("camera")
        self._lens.sensor_fit = "HORIZONTAL"
        self._sun, self._camera = (self._object(name, data) for name, data in
                                   (("sun", self._light), ("camera", self._lens)))
        self._scene.camera = self._camera
        self._lamps = [self._lamp(each) for each in head["lamps"]]
        self._fill_tables()

    def _fill_tables(self) -> None:
        """Make Cycles' tables of samples as large as they get: it keeps them, and smaller ones give other bytes."""
        axes = np.eye(4).tolist()
        self.draw({"bodies_from": [axes] * len(self._bodies), "camera_from": axes, "sun_from": axes,
                   "sun_angle_rad": 0.01, "size": [4, 4], "region": [0, 0, 4, 4], "focal_length": 1.0,
                   "shift": [0.0, 0.0], "clip": [1.0, 2.0], "samples": _MOST_TABLED, "seed": 0, "bounces": 0,
                   "is_indirect": False},
                  lambda share: None)

    def reshape(self, index: int, arrays: dict) -> None:
        """Give a body other vertices, facets, uv and normals."""
        thing = self._bodies[index]
        before = thing.data
        thing.data = self._mesh(self._told[index], {key: arrays.get(key) for key in _GEOMETRY})
        thing.data.materials.append(before.materials[0])
        bpy.data.meshes.remove(before)

    def draw(self, head: dict, progress) -> np.ndarray:
        """Mean radiance (rows, columns) float32 of the region's pixels, top row first, for a Sun of 1 W/m2.

        Parameters
        ----------
        head : dict
            `bodies_from` (4 x 4 matrices), `camera_from`, `sun_from`, `sun_angle_rad` (across), `size`,
            `region`, `focal_length`, `shift`, `clip`, `samples`, `seed`, `bounces`, `is_indirect`; `lamps`: `from`,
            and the `watts` of one that shines so all round.
        progress : callable
            Called with the share done, 0..1.
        """
        for body, matrix in zip(self._bodies, head["bodies_from"], strict=True):
            _place(body, matrix)
        for lamp, here in zip(self._lamps, head.get("lamps", ()), strict=False):
            _place(lamp, here["from"])
            lamp.data.energy = here["watts"]
        _place(self._camera, head["camera_from"])
        _place(self._sun, head["sun_from"])
        if self._light.angle != np.float32(head["sun_angle_rad"]):
            self._light.angle = head["sun_angle_rad"]
        for node in self._script_nodes:
            if node.inputs["is_indirect"].default_value != int(head["is_indirect"]):
                node.inputs["is_indirect"].default_value = int(head["is_indirect"])
            node.inputs["to_sun"].default_value = [row[2] for row in head["sun_from"][:3]]
        (width, height), (x0, y0, x1, y1) = head["size"], head["region"]
        lens, render, cycles = self._lens, self._scene.render, self._scene.cycles
        # Blender takes lengths of 1 mm and more.
        ratio = head["focal_length"] / width
        lens.lens = max(36.0 * ratio, 1.0)
        lens.sensor_width = lens.lens / ratio
        lens.shift_x, lens.shift_y = head["shift"]
        lens.clip_start, lens.clip_end = head["clip"]
        render.resolution_x, render.resolution_y = width, height
        # A hundredth of a pixel inwards: Blender rounds in float32.
        render.border_min_x, render.border_max_x = (x0 + 0.01) / width, (x1 + 0.01) / width
        render.border_min_y, render.border_max_y = 1.0 - (y1 - 0.01) / height, 1.0 - (y0 - 0.01) / height
        cycles.samples, cycles.seed = head["samples"], head["seed"]
        cycles.max_bounces = cycles.diffuse_bounces = head["bounces"]
        listen = _listener(progress)
        bpy.app.handlers.render_stats.append(listen)
        try:
            bpy.ops.render.render(write_still=True)
        finally:
            bpy.app.handlers.render_stats.remove(listen)
        pixels = self._read()
        if pixels.shape != (y1 - y0, x1 - x0):
            raise RuntimeError(f"Blender drew {pixels.shape[::-1]} pixels of a region of {(x1 - x0, y1 - y0)}")
        return pixels

    def _read(self) -> np.ndarray:
        read = bpy.data.images.load(self._path)
        try:
            values = np.empty(4 * read.size[0] * read.size[1], np.float32)
            read.pixels.foreach_get(values)
            return np.ascontiguousarray(values.reshape(read.size[1], read.size[0], 4)[::-1, :, 0])
        finally:
            bpy.data.images.remove(read)
            os.remove(self._path)

    def _lamp(self, lamp: dict) -> bpy.types.Object:
        is_cone = lamp["half_angle_rad"] < 3.0
        light = bpy.data.lights.new("lamp", "SPOT" if is_cone else "POINT")
        light.shadow_soft_size = 0.0
        if is_cone:
            light.spot_size, light.spot_blend = 2.0 * lamp["half_angle_rad"], 0.0
        return self._object("lamp", light)

    def _object(self, name: str, data) -> bpy.types.Object:
        made = bpy.data.objects.new(name, data)
        self._scene.collection.objects.link(made)
        return made

    def _mesh(self, told: dict, arrays: dict) -> bpy.types.Mesh:
        mesh = bpy.data.meshes.new(told["name"])
        vertices, facets = arrays["vertices"], arrays["facets"]
        mesh.vertices.add(len(vertices))
        mesh.vertices.foreach_set("co", vertices.ravel())
        mesh.loops.add(facets.size)
        mesh.loops.foreach_set("vertex_index", facets.ravel())
        mesh.polygons.add(len(facets))
        mesh.polygons.foreach_set("loop_start", np.arange(0, facets.size, 3, dtype=np.int32))
        if bpy.app.version < (4, 1):
            mesh.polygons.foreach_set("loop_total", np.full(len(facets), 3, np.int32))
        mesh.polygons.foreach_set("use_smooth", np.full(len(facets), told["smooth"]))
        if arrays["uv"] is not None:
            mesh.uv_layers.new(name="uv").data.foreach_set("uv", arrays["uv"].astype(np.float32).ravel())
        if arrays["one_sided"] is not None:
            mesh.attributes.new("one_sided", "FLOAT", "FACE").data.foreach_set("value", arrays["one_sided"])
        mesh.update(calc_edges=True)
        if told["smooth"]:
            if bpy.app.version < (4, 1):
                mesh.use_auto_smooth = True
            mesh.normals_split_custom_set_from_vertices(arrays["normals"].tolist())
        return mesh

    def _body(self, told: dict, arrays: dict) -> bpy.types.Object:
        mesh = self._mesh(told, arrays)
        mesh.materials.append(self._material(told, arrays["texture"], arrays["one_sided"] is not None))
        made = self._object(told["name"], mesh)
        # Cycles moves shadows and normals of interpolated surfaces by default.
        made.cycles.shadow_terminator_offset = made.cycles.shadow_terminator_geometry_offset = 0.0
        return made

    def _material(self, told: dict, texture: np.ndarray | None, has_backs: bool) -> bpy.types.Material:
        material = bpy.data.materials.new(told["name"])
        material.use_nodes = True
        nodes, links = material.node_tree.nodes, material.node_tree.links
        nodes.clear()
        output, scale = nodes.new("ShaderNodeOutputMaterial"), None
        if texture is not None:
            image = bpy.data.images.new(told["name"], texture.shape[1], texture.shape[0], float_buffer=True)
            image.colorspace_settings.name = "Non-Color"
            image.pixels.foreach_set(np.repeat(texture.astype(np.float32).ravel(), 4))
            image.update()
            image.pack()
            node = nodes.new("ShaderNodeTexImage")
            node.image, node.interpolation, node.extension = image, "Linear", "REPEAT"
            scale = node.outputs["Color"]
        if told["law"] is None:
            shader = nodes.new("ShaderNodeBsdfDiffuse")
            if scale is None:
                shader.inputs["Color"].default_value = (*[told["normal_albedo"]] * 3, 1.0)
            else:
                product = nodes.new("ShaderNodeMath")
                product.operation, product.use_clamp = "MULTIPLY", True
                product.inputs[1].default_value = told["normal_albedo"]
                links.new(scale, product.inputs[0])
                links.new(product.outputs[0], shader.inputs["Color"])
        else:
            shader = nodes.new("ShaderNodeScript")
            self._script_nodes.append(shader)
            text = bpy.data.texts.new(told["name"] + ".osl")
            text.write(told["law"])
            shader.mode, shader.script = "INTERNAL", text
            if not bpy.app.build_options.cycles_osl:
                raise RuntimeError(f"this Blender {bpy.app.version_string} was built without OSL, which the law of "
                                   f"{told['name']!r} needs; PyPI's bpy has it")
            if "to_sun" not in shader.inputs:
                raise RuntimeError(f"the law of {told['name']!r} does not compile as OSL")
            if scale is not None:
                links.new(scale, shader.inputs["albedo_scale"])
        surface = _without_backs(nodes, links, shader.outputs[0]) if has_backs else shader.outputs[0]
        links.new(surface, output.inputs["Surface"])
        return material

    def _set_up(self, has_scripts: bool, threads: int) -> None:
        """Switch off denoiser, clamp, light threshold and tone curve: each would change the radiance."""
        scene, render, cycles = self._scene, self._scene.render, self._scene.cycles
        render.engine = "CYCLES"
        cycles.device, cycles.shading_system = "CPU", has_scripts
        cycles.use_adaptive_sampling = cycles.use_denoising = False
        cycles.pixel_filter_type, cycles.filter_width = "BOX", 1.0
        cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
        cycles.light_sampling_threshold = 0.0
        cycles.film_exposure = 1.0
        cycles.transparent_max_bounces = _MOST_BACKS
        if hasattr(cycles, "use_light_tree"):
            cycles.use_light_tree = False
        if hasattr(cycles, "use_auto_tile"):
            cycles.use_auto_tile = False
        render.use_persistent_data, render.resolution_percentage = True, 100
        render.use_border, render.use_crop_to_border = True, True
        render.use_compositing = render.use_sequencer = False
        if threads:
            render.threads_mode, render.threads = "FIXED", threads
        render.filepath = self._path
        render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"
        render.image_settings.exr_codec = "NONE"
        scene.view_settings.view_transform = "Raw"


def _without_backs(nodes, links, front):
    """A surface whose one-sided facets have a back that the camera looks through, and that is black to other rays."""
    black, clear = nodes.new("ShaderNodeBsdfDiffuse"), nodes.new("ShaderNodeBsdfTransparent")
    black.inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)
    sided, share = nodes.new("ShaderNodeAttribute"), nodes.new("ShaderNodeMath")
    sided.attribute_name, share.operation = "one_sided", "MULTIPLY"
    links.new(sided.outputs["Fac"], share.inputs[0])
    links.new(nodes.new("ShaderNodeNewGeometry").outputs["Backfacing"], share.inputs[1])
    back, mixed = nodes.new("ShaderNodeMixShader"), nodes.new("ShaderNodeMixShader")
    for mix, factor, one, other in (
            (back, nodes.new("ShaderNodeLightPath").outputs["Is Camera Ray"], black.outputs[0], clear.outputs[0]),
            (mixed, share.outputs[0], front, back.outputs[0])):
        for socket, given in zip(mix.inputs, (factor, one, other), strict=True):
            links.new(given, socket)
    return mixed.outputs[0]


def _place(thing, matrix: list) -> None:
    """Move only the objects whose pose has changed: Blender builds again what was touched."""
    wanted = Matrix(matrix)
    if thing.matrix_world != wanted:
        thing.matrix_world = wanted


def _listener(progress):
    """Blender's statistics as the share of the samples done."""
    def listen(text, *_):
        words = str(text).rpartition("Sample ")[2].split("/")
        if len(words) == 2 and words[0].isdigit() and words[1].split()[0].isdigit():
            progress(int(words[0]) / int(words[1].split()[0]))
    return listen


def _has_room() -> bool:
    try:
        told = os.statvfs(_MEMORY)
    except OSError:
        return False
    return told.f_bavail * told.f_frsize > 1 << 30
