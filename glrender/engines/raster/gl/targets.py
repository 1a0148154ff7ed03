"""Targets of drawing: shadow maps, images, and masks of pixels that are drawn."""

from __future__ import annotations

from collections.abc import Sequence

import moderngl
import numpy as np

from ....shaders import compose
from .context import Context
from .mesh import Mesh
from .owner import ResourceOwner

DEPTH_BYTES = 4
"""Memory [byte] of a texel of a shadow map."""


class ShadowMap(ResourceOwner):
    """Depths seen from the Sun.

    Parameters
    ----------
    context : Context
    room_px : (int, int) [px]
        Texels that it has, at least, along x and y.
    """

    def __init__(self, context: Context, room_px: tuple[int, int]):
        super().__init__(context)
        self.room_px = rounded_room(room_px)
        context.make_current()
        self.texture = self.own(context.gl.depth_texture(self.room_px))
        self.texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self.texture.compare_func = "<="
        self.texture.repeat_x = self.texture.repeat_y = False
        self._framebuffer = self.own(context.gl.framebuffer(depth_attachment=self.texture))

    def texture_from_clip(self, size_px: tuple[int, int]) -> np.ndarray:
        """(4, 4) float64 of a map of so many texels of the room."""
        matrix = np.diag([0.5, 0.5, 0.5, 1.0])
        matrix[:3, 3] = 0.5
        return np.diag([*(used / room for used, room in zip(size_px, self.room_px, strict=True)), 1.0, 1.0]) @ matrix

    def draw(self, casters: Sequence[tuple[Mesh, np.ndarray]], size_px: tuple[int, int]) -> None:
        """Fill so many texels with the depths of `casters`, each with its `sun_clip_from_body` (4, 4) float64."""
        gl = self._context.gl
        self._context.make_current()
        self._framebuffer.use()
        self._framebuffer.viewport = (0, 0, *size_px)
        # The whole room: outside the box there is light, for a coma that asks.
        self._framebuffer.clear(depth=1.0)
        gl.front_face = "ccw"
        for mesh, sun_clip_from_body in casters:
            gl.enable_only(moderngl.DEPTH_TEST | (moderngl.CULL_FACE if mesh.is_closed else moderngl.NOTHING))
            mesh.draw_shadow(sun_clip_from_body)


def rounded_room(size_px: tuple[int, int]) -> tuple[int, int]:
    """Texels of a map for so many: as a body turns its box changes, and the next one may need no other map."""
    return tuple(-(-side // 256) * 256 for side in size_px)


class PixelMask(ResourceOwner):
    """Opens pixels of a target whose depths were cleared to the nearest: the other pixels reject samples.

    A rejected sample costs a depth test, where a shader that discards it costs its start.
    """

    def __init__(self, context: Context):
        super().__init__(context)
        self._points, self._array, self._room = None, None, 0

    def open(self, mask: np.ndarray, samples: int) -> None:
        """Set the depths of pixels (height, width) that are not 0 to the farthest, in the bound framebuffer."""
        context, gl = self._context, self._context.gl
        place = np.argwhere(mask)[:, ::-1].astype(np.float32) + 0.5
        if len(place) > self._room:
            self.close()
            self._room = -(-len(place) // 65536) * 65536
            self._points = self.own(gl.buffer(reserve=8 * self._room))
            program = context.program(compose("mask.vert.glsl"), compose("mask.frag.glsl"))
            self._array = self.own(gl.vertex_array(program, [(self._points, "2f", "pixel")]))
        program = self._array.program
        program["window_px"].value = mask.shape[::-1]
        program["samples"].value = float(samples)
        self._points.write(place.tobytes())
        gl.enable_only(moderngl.DEPTH_TEST | moderngl.PROGRAM_POINT_SIZE)
        gl.depth_func = "1"
        self._array.render(moderngl.POINTS, vertices=len(place))
        gl.depth_func = "<"
        gl.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)


class Target(ResourceOwner):
    """Float framebuffer that grows to the largest window asked for.

    Parameters
    ----------
    context : Context
    components : sequence of int
        Components of each colour attachment.
    """

    def __init__(self, context: Context, components: Sequence[int]):
        super().__init__(context)
        self._components = tuple(components)
        self._size = (0, 0)
        self._framebuffer = None

    def begin(self, width: int, height: int, depth: float = 1.0) -> None:
        """Bind with a window of `width` x `height`, cleared to zero and a depth: by default the farthest."""
        gl = self._context.gl
        self._context.make_current()
        if width > self._size[0] or height > self._size[1]:
            self.close()
            # Rounded up, so that a body that drifts or grows does not reallocate each frame.
            self._size = tuple(max(old, -(-new // 128) * 128)
                               for old, new in zip(self._size, (width, height), strict=True))
            colors = [self.own(gl.texture(self._size, n, dtype="f4")) for n in self._components]
            depths = self.own(gl.depth_renderbuffer(self._size))
            self._framebuffer = self.own(gl.framebuffer(colors, depths))
        self._window = (0, 0, width, height)
        self._framebuffer.use()
        self._framebuffer.viewport = self._window
        self._framebuffer.clear(0.0, 0.0, 0.0, 0.0, depth=depth, viewport=self._window)
        gl.enable_only(moderngl.DEPTH_TEST | moderngl.CULL_FACE)
        gl.front_face = "cw"  # the image is drawn top row first: see frames.clip_from_camera

    def read(self, attachment: int = 0) -> np.ndarray:
        """(height, width) or (height, width, components) float32 of an attachment."""
        components = self._components[attachment]
        width, height = self._window[2:]
        pixels = np.empty((height, width, components), np.float32)
        self._framebuffer.read_into(pixels, viewport=self._window, components=components, attachment=attachment,
                                    dtype="f4", alignment=4)
        return pixels[..., 0] if components == 1 else pixels
