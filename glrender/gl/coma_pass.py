"""The two passes of a coma: integrals on a coarse grid of pixels, then each pixel's column up to what it sees."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import moderngl
import numpy as np

from ..shaders import UniformBlock, compose
from .context import Context
from .owner import ResourceOwner
from .targets import ShadowMap, Target

_BINDING = 0
_UNITS = {"weights": 0, "total": 1, "front": 2, "surface": 3, "shadow_map": 4}


def coma_block(n_bodies: int) -> UniformBlock:
    """What both passes read; pixels count from the middle of the tile's first one."""
    return UniformBlock("Coma", {
        "field_from_camera": "mat4", "shadow_from_field": "mat4",
        "body_px": "vec4", "focus_px": "vec2", "focus_slope": "vec2", "principal_point_px": "vec2",
        "r_focus_camera": "vec3", "low_m": "vec3", "high_m": "vec3",
        "focus_depth_m": "float", "focal_length_px": "float", "least_m": "float", "inner_m": "float",
        "shells_per_octave": "float", "pixels_per_node": "float", "pixels_per_front_node": "float",
        "nodes_reach_rad": "float", "is_ahead": "int", "surface_samples": "int",
        "steps": "int",
        "r_body_m": f"vec4[{n_bodies}]"})


class ComaVolume(ResourceOwner):
    """Weights of one field as a texture.

    Parameters
    ----------
    context : Context
    texels : (d, h, w) float32
    is_spherical : bool
    """

    def __init__(self, context: Context, texels: np.ndarray, is_spherical: bool):
        super().__init__(context)
        context.make_current()
        self.is_spherical = is_spherical
        self.texture = self.own(context.gl.texture3d(texels.shape[::-1], 1, np.ascontiguousarray(texels, np.float32),
                                                     dtype="f4"))
        # float32 is also the fastest to interpolate on llvmpipe: 6.5 ns, half floats 8.6, bytes 10.
        self.texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
        self.texture.repeat_x = self.texture.repeat_y = self.texture.repeat_z = False

    def write(self, texels: np.ndarray) -> None:
        """Other weights of the same size."""
        self._context.make_current()
        self.texture.write(np.ascontiguousarray(texels, np.float32))


class ComaPass(ResourceOwner):
    """Framebuffers and programs.

    Parameters
    ----------
    context : Context
    n_bodies : int
        Of the scene.
    """

    def __init__(self, context: Context, n_bodies: int):
        super().__init__(context)
        self._block = coma_block(n_bodies)
        context.make_current()
        self._uniforms = self.own(context.gl.buffer(reserve=self._block.dtype.itemsize))
        self._fields = 0
        self._columns = FloatTarget(context, [1])
        self.callback(self._columns.close)
        self._programs: dict[tuple, moderngl.Program] = {}
        self._nodes: _Nodes | None = None
        self.callback(self._forget_nodes)

    def _forget_nodes(self) -> None:
        if self._nodes is not None:
            self._nodes.close()
        self._nodes = None

    def begin(self, width: int, height: int) -> None:
        """Clear the columns of a tile; those of several fields then add up."""
        self._columns.begin(width, height)
        self._fields = 0

    def add(self, volume: ComaVolume, values: Mapping[str, Any], size: tuple[int, int],
            body: tuple[int, int, int, int] | None, surface: FloatTarget, shadow_map: ShadowMap | None = None) -> None:
        """Add a field's columns to those of the tile.

        Parameters
        ----------
        volume : ComaVolume
        values : mapping
            Of `coma_block`.
        size : (int, int) [px]
            Of the tile.
        body : (int, int, int, int) [px] or None
            The box x0, y0, x1, y1 of the tile, `body_px`, where `surface`, drawn there with
            `coma/surface.frag.glsl` and `surface_samples` along a pixel's side, ends rays.
        shadow_map : ShadowMap, optional
            Takes `shadow_from_field`.
        """
        per_node, per_front = values["pixels_per_node"], values["pixels_per_front_node"]
        nodes, fronts = (tuple(-(-(side - 1) // per) + 1 for side in size) for per in (per_node, per_front))
        if self._nodes is None or self._nodes.sizes != (nodes, fronts):
            self._forget_nodes()
            self._nodes = _Nodes(self._context, nodes, fronts)
        defines = {"SPHERICAL": int(volume.is_spherical), "HAS_SHADOW": int(shadow_map is not None)}
        textures = {"weights": volume.texture, "total": self._nodes.total, "front": self._nodes.front,
                    "surface": surface.texture() if body is not None else None,
                    "shadow_map": None if shadow_map is None else shadow_map.texture}
        draw = partial(self._draw, textures, values)
        ends = {**defines, "ENDS_AT_SURFACE": 1}
        draw("coma/nodes.frag.glsl", {**defines, "TO_SURFACE": 0, "ENDS_AT_SURFACE": 0}, self._nodes.all_rays,
             (0, 0, *nodes))
        columns = self._columns.framebuffer
        if body is None:
            draw("coma/column.frag.glsl", {**defines, "HAS_SURFACE": 0, "HAS_FRONT": 0}, columns, (0, 0, *size))
            self._fields += 1
            return
        x0, y0, x1, y1 = body
        # With a node for each pixel, the pixel's own ray is as cheap.
        has_front = int(per_front > 1)
        if has_front:
            around = (x0 // per_front, y0 // per_front, min(x1 // per_front + 2, fronts[0]),
                      min(y1 // per_front + 2, fronts[1]))
            draw("coma/nodes.frag.glsl", {**ends, "TO_SURFACE": 1}, self._nodes.to_surface, around)
        width, height = size
        for box in ((0, 0, width, y0), (0, y1, width, height), (0, y0, x0, y1), (x1, y0, width, y1)):
            draw("coma/column.frag.glsl", {**defines, "HAS_SURFACE": 0, "HAS_FRONT": 0}, columns, box)
        draw("coma/column.frag.glsl", {**ends, "HAS_SURFACE": 1, "HAS_FRONT": has_front}, columns, body)
        self._fields += 1

    def read(self) -> np.ndarray:
        """(height, width) float32 [1] columns of the tile."""
        return self._columns.read()

    def _draw(self, textures: Mapping[str, moderngl.Texture | None], values: Mapping[str, Any], stage: str,
              defines: Mapping[str, int], framebuffer: moderngl.Framebuffer, box: tuple[int, int, int, int]) -> None:
        """Draw a box x0, y0, x1, y1 of a framebuffer; onto columns it adds."""
        x0, y0, x1, y1 = box
        if x1 <= x0 or y1 <= y0:
            return
        gl = self._context.gl
        program = self._program(stage, tuple(sorted(defines.items())))
        for name, unit in _UNITS.items():
            if name in program:
                program[name].value = unit
                textures[name].use(unit)
        self._uniforms.write(self._block.pack(values))
        self._uniforms.bind_to_uniform_block(_BINDING)
        framebuffer.use()
        framebuffer.viewport = (0, 0, *framebuffer.size)
        framebuffer.scissor = (x0, y0, x1 - x0, y1 - y0)
        # The first field overwrites: blending costs a third of what a pixel does.
        adds = framebuffer is self._columns.framebuffer and self._fields > 0
        gl.enable_only(moderngl.BLEND if adds else moderngl.NOTHING)
        gl.blend_func = moderngl.ONE, moderngl.ONE
        with ResourceOwner(self._context) as owner:
            owner.own(gl.vertex_array(program, [])).render(moderngl.TRIANGLES, vertices=3)
        framebuffer.scissor = None
        gl.disable(moderngl.BLEND)


    def _program(self, stage: str, defines: tuple[tuple[str, int], ...]) -> moderngl.Program:
        if (stage, defines) not in self._programs:
            program = self._context.program(compose("fullscreen.vert.glsl"),
                                            compose(stage, blocks=[self._block], defines=dict(defines)))
            program["Coma"].binding = _BINDING
            self._programs[stage, defines] = program
        return self._programs[stage, defines]


class FloatTarget(Target):
    """A Target that other passes read."""

    @property
    def framebuffer(self) -> moderngl.Framebuffer:
        return self._framebuffer

    def texture(self, attachment: int = 0) -> moderngl.Texture:
        return self._framebuffer.color_attachments[attachment]


class _Nodes(ResourceOwner):
    """What the coarse grid keeps of its rays: all of each, and each up to the surface."""

    def __init__(self, context: Context, nodes: tuple[int, int], fronts: tuple[int, int]):
        super().__init__(context)
        self.sizes = (nodes, fronts)
        self.total = self.own(context.gl.texture(nodes, 1, dtype="f4"))
        self.front = self.own(context.gl.texture(fronts, 4, dtype="f4"))
        self.total.filter = (moderngl.LINEAR, moderngl.LINEAR)
        self.front.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self.total.repeat_x = self.total.repeat_y = False
        self.all_rays, self.to_surface = (self.own(context.gl.framebuffer([texture]))
                                          for texture in (self.total, self.front))
