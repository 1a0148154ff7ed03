"""A body in a context, or a part of it: its buffers, and how they are drawn, as a surface or from the Sun.

Bindings are global in GL, so every draw binds all that it reads.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np

from ....brdf.law import Law
from ....scene.shape.facet_geometry import area_vectors
from ....shaders import ConstantBlock, UniformBlock, compose
from .context import Context
from .owner import ResourceOwner

SHADOW_BLOCK = UniformBlock("Shadow", {"sun_clip_from_body": "mat4"})
SURFACE_BLOCK = UniformBlock("Surface", {
    "clip_from_surface": "mat4",
    "shadow_from_body": "mat4",
    "r_camera_body": "vec3",
    "r_camera_body_low": "vec3",
    "sun_direction_body": "vec3",
    "boresight_body": "vec3",
    "irradiance_scale": "float",
    "shadow_bias_per_texel": "float",
    "sun_radius_rad": "float",
    "body_id": "int",
    "first_facet": "int",
})
RELIEF_BLOCK = UniformBlock("Relief", {
    "relief_layers": f"vec4[{5 * 64}]",
    "relief_noise": "int",
    "relief_craters": "int",
    "relief_boulders": "int",
    "high_noise": "int",
    "high_craters": "int",
    "high_boulders": "int",
    "footprint_per_m": "float",
})
IRRADIANCE_STAGE = "surface.frag.glsl"
"""The fragment shader that draws light; others see dark surfaces too."""
_BODY_BINDING, _RELIEF_BINDING = 0, 1
_SHADOW_UNIT, _ALBEDO_UNIT, _NORMAL_UNIT = 0, 1, 2
_TEXELS_PER_ROW = 4096


@dataclass(frozen=True)
class SurfaceVariant:
    """The structure of a surface shader; each is a define."""

    relative_to_camera: bool = False
    normal_lookup: bool = False
    shadows: bool = True
    relief: bool = False

    def defines(self, mesh: Mesh) -> dict[str, int]:
        return {"RELATIVE_TO_CAMERA": int(self.relative_to_camera), "NORMAL_LOOKUP": int(self.normal_lookup),
                "SMOOTH_NORMALS": int(mesh.smooth_normals),
                "HAS_SHADOWS": int(self.shadows), "HAS_RELIEF": int(self.relief),
                "HAS_ALBEDO_TEXTURE": int(mesh.has_albedo)}


class Mesh(ResourceOwner):
    """A body's geometry on the device, uploaded once.

    Parameters
    ----------
    context : Context
    vertices_m : (V, 3) float64 [m]
        Body-fixed.
    facets : (F, 3) int32
        Counter-clockwise from outside.
    law : Law
    vertex_normals : (V, 3) float, optional
        Given for smooth shading.
    uv : (F, 3, 2) float32, optional
        Texture coordinates of each facet's corners, origin at the image's bottom left.
    albedo_map : (H, W) float32, optional
        Factor on the law's albedo, row 0 on top.
    is_closed : bool
        Of an open surface facets that face away from the Sun cast shadows too: nothing else may stand sunward.
    first_facet : int
        Number of the first facet among those of the body's parts, one part after the other.
    """

    def __init__(self, context: Context, vertices_m: np.ndarray, facets: np.ndarray, law: Law, *,
                 vertex_normals: np.ndarray | None = None, uv: np.ndarray | None = None,
                 albedo_map: np.ndarray | None = None, is_closed: bool = True, first_facet: int = 0):
        super().__init__(context)
        self.law, self.first_facet, self.is_closed = law, first_facet, is_closed
        self.smooth_normals = vertex_normals is not None
        self.vertices_m, self.facets = vertices_m, facets
        context.make_current()
        gl = context.gl
        self.has_albedo = albedo_map is not None
        self.albedo_texture = None
        if uv is not None and albedo_map is not None:
            # A seam's vertex has several texture coordinates: one GL vertex for each.
            corners = np.concatenate([facets.reshape(-1, 1).astype(np.float64), uv.reshape(-1, 2)], axis=1)
            unique, inverse = np.unique(corners, axis=0, return_inverse=True)
            source, indices = unique[:, 0].astype(np.int64), inverse.reshape(facets.shape)
            self._uv = self.own(gl.buffer(np.ascontiguousarray(unique[:, 1:], np.float32)))
            height, width = albedo_map.shape
            texels = np.ascontiguousarray(albedo_map[::-1], np.float32)
            self.albedo_texture = self.own(gl.texture((width, height), 1, texels, dtype="f4"))
            # No mipmaps: a law is not linear in its albedo, so that the mean albedo of a pixel has not its mean light.
            self.albedo_texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
            self.albedo_texture.repeat_y = False
        else:
            source, indices, self._uv = None, facets, None
        placed = vertices_m if source is None else vertices_m[source]
        high = placed.astype(np.float32)
        self._position = self.own(gl.buffer(high))
        self._low_values = placed - high
        self._position_low = None
        self._normal = None
        if vertex_normals is not None:
            normals = vertex_normals if source is None else vertex_normals[source]
            self._normal = self.own(gl.buffer(np.ascontiguousarray(normals, np.float32)))
        self._indices = self.own(gl.buffer(np.ascontiguousarray(indices, np.int32)))
        self._normal_texture = None
        self.law_constants = ConstantBlock(law.uniform_fields, law.uniforms())
        self._shadow_uniforms = self.own(gl.buffer(reserve=SHADOW_BLOCK.dtype.itemsize))
        self._surface_uniforms = self.own(gl.buffer(reserve=SURFACE_BLOCK.dtype.itemsize))
        self._relief_uniforms = None
        self._vertex_arrays: dict[Any, moderngl.VertexArray] = {}

    @property
    def memory_bytes(self) -> int:
        """Memory [byte] of its buffers and textures on the device, and of what float32 leaves of its corners."""
        held = vars(self).values()
        return (self._low_values.nbytes + sum(each.size for each in held if isinstance(each, moderngl.Buffer))
                + sum(4 * each.width * each.height * each.components for each in held
                      if isinstance(each, moderngl.Texture)))

    def _vertex_array(self, program: moderngl.Program) -> moderngl.VertexArray:
        if program not in self._vertex_arrays:
            buffers = {"position": (self._position, "3f"), "position_low": (self._position_low, "3f"),
                       "vertex_normal": (self._normal, "3f"), "vertex_uv": (self._uv, "2f")}
            content = [(buffer, layout, name) for name, (buffer, layout) in buffers.items() if name in program]
            self._vertex_arrays[program] = self.own(
                self._context.gl.vertex_array(program, content, index_buffer=self._indices, index_element_size=4))
        return self._vertex_arrays[program]

    def draw_shadow(self, sun_clip_from_body: np.ndarray) -> None:
        """Draw the mesh into the bound shadow map."""
        program = self._context.program(compose("shadow.vert.glsl", blocks=[SHADOW_BLOCK]),
                                        compose("shadow.frag.glsl"))
        program["Shadow"].binding = _BODY_BINDING
        self._shadow_uniforms.write(SHADOW_BLOCK.pack({"sun_clip_from_body": sun_clip_from_body}))
        self._shadow_uniforms.bind_to_uniform_block(_BODY_BINDING)
        self._vertex_array(program).render(moderngl.TRIANGLES)

    def draw_surface(self, stage: str, variant: SurfaceVariant, values: Mapping[str, Any],
                     shadows: moderngl.Texture | None, relief: Mapping[str, Any] | None = None) -> None:
        """Draw the mesh into the bound framebuffer with `surface.frag.glsl` or `products.frag.glsl`."""
        context = self._context
        if variant.relative_to_camera and self._position_low is None:
            self._position_low = self.own(context.gl.buffer(self._low_values.astype(np.float32)))
        program = _surface_program(context, stage, variant, self)
        self._surface_uniforms.write(SURFACE_BLOCK.pack({**values, "first_facet": self.first_facet}))
        self._surface_uniforms.bind_to_uniform_block(_BODY_BINDING)
        if variant.relief:
            if self._relief_uniforms is None:
                self._relief_uniforms = self.own(context.gl.buffer(reserve=RELIEF_BLOCK.dtype.itemsize))
            self._relief_uniforms.write(RELIEF_BLOCK.pack(relief))
            self._relief_uniforms.bind_to_uniform_block(_RELIEF_BINDING)
        if variant.shadows:
            shadows.use(_SHADOW_UNIT)
        if self.albedo_texture is not None:
            self.albedo_texture.use(_ALBEDO_UNIT)
        if variant.normal_lookup:
            self._facet_normals().use(_NORMAL_UNIT)
        self._vertex_array(program).render(moderngl.TRIANGLES)

    def _facet_normals(self) -> moderngl.Texture:
        if self._normal_texture is None:
            normal = area_vectors(self.vertices_m, self.facets)
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
            self._normal_texture = self.own(_lookup(self._context.gl, normal))
        return self._normal_texture


def _lookup(gl: moderngl.Context, rows: np.ndarray) -> moderngl.Texture:
    """A texture as a table: row k of (N, components) at (k % width, k // width)."""
    components = rows.shape[1]
    height = -(-len(rows) // _TEXELS_PER_ROW)
    texels = np.zeros((height * _TEXELS_PER_ROW, components), np.float32)
    texels[: len(rows)] = rows
    texture = gl.texture((_TEXELS_PER_ROW, height), components, texels, dtype="f4", alignment=1)
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    return texture


def _surface_program(context: Context, stage: str, variant: SurfaceVariant, mesh: Mesh) -> moderngl.Program:
    law = mesh.law
    defines = {**law.defines(), **variant.defines(mesh)}
    key = (stage, law.glsl, mesh.law_constants.glsl, tuple(sorted(defines.items())))
    if key not in context.surface_programs:
        program = context.program(
            compose("surface.vert.glsl", blocks=[SURFACE_BLOCK], defines=defines),
            compose(stage, brdf=law.glsl, defines=defines,
                    blocks=[SURFACE_BLOCK, mesh.law_constants, *([RELIEF_BLOCK] if variant.relief else [])]))
        program["Surface"].binding = _BODY_BINDING
        if variant.relief:
            program["Relief"].binding = _RELIEF_BINDING
        for sampler, unit in (("shadow_map", _SHADOW_UNIT), ("albedo_texture", _ALBEDO_UNIT),
                              ("facet_normals", _NORMAL_UNIT)):
            if sampler in program:
                program[sampler].value = unit
        context.surface_programs[key] = program
    return context.surface_programs[key]
