"""The passes of a coma: integrals on coarse grids of rays, then each pixel's column up to what it sees."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np

from ....shaders import UniformBlock, compose
from .context import Context
from .owner import ResourceOwner
from .targets import ShadowMap, Target

_BINDING = 0
_UNITS = {"weights": 0, "total": 1, "front": 2, "surface": 3, "shadow_map": 4}


@dataclass(frozen=True, kw_only=True)
class Grid:
    """Nodes of a tile: the first one's place [px], their distance [px], and how many there are across and down."""

    first_px: tuple[float, float]
    per_node: int
    shape: tuple[int, int]

    @classmethod
    def on(cls, box: tuple[int, int, int, int], per_node: int) -> Grid:
        """Nodes on the first pixel of a box x0, y0, x1, y1 and on, as far as its last pixel is between some."""
        x0, y0, x1, y1 = box
        return cls(first_px=(x0, y0), per_node=per_node,
                   shape=tuple(-(-(side - 1) // per_node) + 2 for side in (x1 - x0, y1 - y0)))

    @classmethod
    def around(cls, width: int, height: int, per_node: int) -> Grid:
        """Nodes at the centres of cells of `per_node` pixels, one more cell on each side."""
        first = -0.5 * (per_node + 1)
        return cls(first_px=(first, first), per_node=per_node,
                   shape=(-(-width // per_node) + 2, -(-height // per_node) + 2))


def coma_block(n_bodies: int) -> UniformBlock:
    """The uniform block of the passes; pixels count from the middle of the tile's first one."""
    return UniformBlock("Coma", {
        "field_from_camera": "mat4", "shadow_from_field": "mat4",
        "body_px": "vec4", "near_px": "vec2", "focus_px": "vec2", "focus_slope": "vec2", "principal_point_px": "vec2",
        "first_node_px": "vec2", "first_front_px": "vec2",
        "r_focus_camera": "vec3", "low_m": "vec3", "high_m": "vec3",
        "focus_depth_m": "float", "focal_length_px": "float", "least_m": "float", "nodes_reach_rad": "float",
        "inner_m": "float", "shells_per_octave": "float", "pixels_per_node": "float", "pixels_per_front_node": "float",
        "is_ahead": "int", "steps": "int",
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
        self._block, self._n_bodies = coma_block(n_bodies), n_bodies
        context.make_current()
        self._uniforms = self.own(context.gl.buffer(reserve=self._block.dtype.itemsize))
        self._fields, self._near = 0, (0, 0, 0, 0)
        self._columns, self._totals, self._fronts = (FloatTarget(context, [n]) for n in (1, 1, 4))
        for target in (self._columns, self._totals, self._fronts):
            self.callback(target.close)
        self._programs: dict[tuple, moderngl.Program] = {}

    def begin(self, near: tuple[int, int, int, int]) -> None:
        """Clear the columns of a box x0, y0, x1, y1 of a tile; those of several fields then add up."""
        self._near, self._fields = near, 0
        self._columns.begin(near[2] - near[0], near[3] - near[1])

    def totals(self, volume: ComaVolume, values: Mapping[str, Any], grid: Grid,
               shadow_map: ShadowMap | None = None) -> np.ndarray:
        """Integrals (down, across) float32 [m] of K over theta along the rays of a grid, through whatever they meet."""
        self._draw_nodes(self._totals, _textures(volume, shadow_map), values, grid, {
            **_defines(volume, shadow_map), **_WHOLE_RAYS})
        return self._totals.read()

    def _draw_nodes(self, target: FloatTarget, textures: Mapping[str, Any], values: Mapping[str, Any], grid: Grid,
                    defines: Mapping[str, int]) -> moderngl.Texture:
        target.begin(*grid.shape)
        given = {**values, "first_node_px": grid.first_px, "pixels_per_node": grid.per_node}
        self._draw(textures, given, "coma/nodes.frag.glsl", defines, target.framebuffer, (0, 0, *grid.shape))
        return target.texture()

    def add(self, volume: ComaVolume, values: Mapping[str, Any], steps: tuple[int, int], per_node: tuple[int, int],
            body: tuple[int, int, int, int] | None, surface: FloatTarget, surface_samples: int,
            shadow_map: ShadowMap | None = None) -> None:
        """Add a field's columns to those of the box that was begun.

        Parameters
        ----------
        volume : ComaVolume
        values : mapping
            Of `coma_block`, but for steps, grids and boxes.
        steps, per_node : (int, int)
            Steps that the half circle has, and pixels from node to node: off the bodies, and before them.
        body : (int, int, int, int) [px] or None
            The box x0, y0, x1, y1 of the tile, within the one that was begun, where `surface`, drawn there with
            `coma/surface.frag.glsl` and `surface_samples` along a pixel's side, ends rays.
        shadow_map : ShadowMap, optional
            Takes `shadow_from_field`.
        """
        x0, y0, x1, y1 = self._near
        left, top, right, bottom = (x0, y0, x0, y0) if body is None else body
        textures, defines = _textures(volume, shadow_map), _defines(volume, shadow_map)
        nodes = Grid.on(self._near, per_node[0])
        values = {**values, "steps": steps[0], "near_px": (x0, y0), "body_px": (left, top, right, bottom)}
        textures["total"] = self._draw_nodes(self._totals, textures, values, nodes,
                                             {**defines, **_WHOLE_RAYS})
        textures["total"].filter = (moderngl.LINEAR, moderngl.LINEAR)
        values |= {"first_node_px": nodes.first_px, "pixels_per_node": nodes.per_node}
        for box in ((x0, y0, x1, top), (x0, bottom, x1, y1), (x0, top, left, bottom), (right, top, x1, bottom)):
            self._draw_near(textures, values, {**defines, "HAS_SURFACE": 0, "HAS_FRONT": 0}, box)
        if body is not None:
            textures["surface"] = surface.texture()
            values["steps"] = steps[1]
            ends = {**defines, "ENDS_AT_SURFACE": 1, "HAS_SURFACE": 1, "SURFACE_SAMPLES": surface_samples,
                    "SEVERAL_BODIES": int(self._n_bodies > 1)}
            # With a node for each pixel, the pixel's own ray is as cheap.
            has_front = int(per_node[1] > 1)
            if has_front:
                fronts = Grid.on(body, per_node[1])
                textures["front"] = self._draw_nodes(self._fronts, textures, values, fronts, ends)
                values |= {"first_front_px": fronts.first_px, "pixels_per_front_node": fronts.per_node}
            self._draw_near(textures, values, {**ends, "HAS_FRONT": has_front}, body)
        self._fields += 1

    def _draw_near(self, textures: Mapping[str, Any], values: Mapping[str, Any], defines: Mapping[str, int],
                   box: tuple[int, int, int, int]) -> None:
        x0, y0 = self._near[:2]
        self._draw(textures, values, "coma/column.frag.glsl", defines, self._columns.framebuffer,
                   (box[0] - x0, box[1] - y0, box[2] - x0, box[3] - y0))

    def read(self) -> np.ndarray:
        """(rows, columns) float32 [1] of the box that was begun."""
        return self._columns.read()

    def _draw(self, textures: Mapping[str, Any], values: Mapping[str, Any], stage: str,
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
        self._uniforms.write(self._block.pack({**_NO_GRIDS, **values}))
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


_NO_GRIDS = {"first_node_px": (0, 0), "pixels_per_node": 1, "first_front_px": (0, 0), "pixels_per_front_node": 1,
             "near_px": (0, 0), "body_px": (0, 0, 0, 0)}

_WHOLE_RAYS = {"HAS_SURFACE": 0, "ENDS_AT_SURFACE": 0}


def _textures(volume: ComaVolume, shadow_map: ShadowMap | None) -> dict[str, Any]:
    return {"weights": volume.texture, "shadow_map": None if shadow_map is None else shadow_map.texture}


def _defines(volume: ComaVolume, shadow_map: ShadowMap | None) -> dict[str, int]:
    return {"SPHERICAL": int(volume.is_spherical), "HAS_SHADOW": int(shadow_map is not None)}
