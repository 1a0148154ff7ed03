"""The two passes of a coma: columns on a coarse grid of pixels, then each pixel's up to what its centre sees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import moderngl
import numpy as np

from ..shaders import UniformBlock, compose
from .context import Context
from .owner import ResourceOwner
from .passes import ShadowMap, Target

ENDS = 8
"""Sums that a ray of the coarse grid keeps."""
_BINDING = 0
_UNITS = {"weights": 0, "first_ends": 0, "last_ends": 1, "surface": 2, "shadow_map": 3}


def coma_block(n_bodies: int) -> UniformBlock:
    """What both passes read; pixels count from the middle of the tile's first one."""
    return UniformBlock("Coma", {
        "field_from_camera": "mat4", "shadow_from_field": "mat4",
        "focus_px": "vec2", "focus_slope": "vec2", "principal_point_px": "vec2",
        "r_focus_camera": "vec3", "low_m": "vec3", "high_m": "vec3",
        "focus_depth_m": "float", "focal_length_px": "float", "least_m": "float", "inner_m": "float",
        "shells_per_octave": "float", "pixels_per_node": "float", "is_ahead": "int", "steps_per_end": "int",
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
        self._columns = self.own(_Owner(context, [1]))
        self._ends = None
        self.callback(self._forget_ends)

    def _forget_ends(self) -> None:
        if self._ends is not None:
            self._ends.close()
        self._ends = None

    def begin(self, width: int, height: int) -> None:
        """Clear the columns of a tile; those of several fields then add up."""
        self._columns.target.begin(width, height)

    def march(self, volume: ComaVolume, values: Mapping[str, Any], nodes: tuple[int, int],
              shadow_map: ShadowMap | None = None) -> None:
        """Sum a field's columns at nodes (across, down) of the coarse grid."""
        if self._ends is None or self._ends.size != nodes:
            self._forget_ends()
            self._ends = _Ends(self._context, nodes)
        self._ends.framebuffer.use()
        defines = {"SPHERICAL": int(volume.is_spherical), "HAS_SHADOW": int(shadow_map is not None)}
        program = self._program("coma/march.frag.glsl", defines, values)
        volume.texture.use(_UNITS["weights"])
        if shadow_map is not None:
            shadow_map.texture.use(_UNITS["shadow_map"])
        self._draw(program)

    def add_columns(self, volume: ComaVolume, values: Mapping[str, Any], surface: Target | None,
                    rois: Sequence[tuple[int, int, int, int]]) -> None:
        """Add each pixel's column to the tile's, in boxes x0, y0, x1, y1 of it that share no pixel.

        `surface`, drawn with `coma/surface.frag.glsl`, ends them at what is seen.
        """
        gl = self._context.gl
        framebuffer = self._columns.target._framebuffer
        framebuffer.use()
        defines = {"SPHERICAL": int(volume.is_spherical), "HAS_SURFACE": int(surface is not None)}
        program = self._program("coma/column.frag.glsl", defines, values)
        self._ends.first.use(_UNITS["first_ends"])
        self._ends.last.use(_UNITS["last_ends"])
        if surface is not None:
            surface._framebuffer.color_attachments[0].use(_UNITS["surface"])
        framebuffer.viewport = self._columns.target._window
        for x0, y0, x1, y1 in rois:
            framebuffer.scissor = (x0, y0, x1 - x0, y1 - y0)
            self._draw(program, moderngl.BLEND)
        framebuffer.scissor = None
        gl.disable(moderngl.BLEND)

    def read(self) -> np.ndarray:
        """(height, width) float32 [1] columns of the tile."""
        self._columns.target._framebuffer.use()
        return self._columns.target.read()

    def _program(self, stage: str, defines: Mapping[str, int], values: Mapping[str, Any]) -> moderngl.Program:
        program = self._context.program(compose("fullscreen.vert.glsl"),
                                        compose(stage, blocks=[self._block], defines=defines))
        program["Coma"].binding = _BINDING
        for name, unit in _UNITS.items():
            if name in program:
                program[name].value = unit
        self._uniforms.write(self._block.pack(values))
        self._uniforms.bind_to_uniform_block(_BINDING)
        return program

    def _draw(self, program: moderngl.Program, flags: int = moderngl.NOTHING) -> None:
        gl = self._context.gl
        gl.enable_only(flags)
        gl.blend_func = moderngl.ONE, moderngl.ONE
        with ResourceOwner(self._context) as owner:
            owner.own(gl.vertex_array(program, [])).render(moderngl.TRIANGLES, vertices=3)


class _Owner:
    """A Target that is released as a resource is."""

    def __init__(self, context: Context, components: Sequence[int]):
        self.target = Target(context, components)

    def release(self) -> None:
        self.target.close()


class _Ends(ResourceOwner):
    """What the coarse grid keeps of its rays."""

    def __init__(self, context: Context, size: tuple[int, int]):
        super().__init__(context)
        self.size = size
        self.first, self.last = (self.own(context.gl.texture(size, 4, dtype="f4")) for _ in range(2))
        for texture in (self.first, self.last):
            texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
            texture.repeat_x = texture.repeat_y = False
        self.framebuffer = self.own(context.gl.framebuffer([self.first, self.last]))
