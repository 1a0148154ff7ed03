"""A law's own GLSL function, run on arrays of directions."""

from __future__ import annotations

import moderngl
import numpy as np

from ....base.errors import ConfigError
from ....brdf.law import Law
from ....shaders import UniformBlock, compose
from .context import Context
from .owner import ResourceOwner

_WIDTH = 1024
_INPUTS = ("to_sun", "to_camera", "normal", "albedo_scale")


def checked_vectors(name: str, value: object) -> np.ndarray:
    """(N, 3) float32 of finite numbers."""
    try:
        array = np.asarray(value, np.float32)
    except (TypeError, ValueError, OverflowError):
        raise ConfigError(name, "must be (N, 3) numbers", value) from None
    if array.ndim != 2 or array.shape[1] != 3 or not np.isfinite(array).all():
        raise ConfigError(name, "must be (N, 3) finite numbers", array)
    return array


class BrdfEvaluator:
    """Runs `brdf()` of `shaders/brdf/<law>.glsl` in a fragment shader, in float32.

    Parameters
    ----------
    context : Context
    """

    def __init__(self, context: Context):
        self._context = context

    def __call__(self, law: Law, to_sun: np.ndarray, to_camera: np.ndarray, normal: np.ndarray,
                 albedo_scale: np.ndarray | None = None, defines: dict[str, int] | None = None) -> np.ndarray:
        """BRDF of unit vectors.

        Parameters
        ----------
        law : Law
        to_sun, to_camera, normal : (N, 3) float [1]
            Away from the surface.
        albedo_scale : (N,) float [1], optional
            The texture's factor; default 1.
        defines : dict, optional
            Further preprocessor switches, e.g. ``{"HAS_ALBEDO_TEXTURE": 1}``.

        Returns
        -------
        (N,) float32 [1/sr]

        Raises
        ------
        ConfigError
            No law, or arrays that are not (N, 3) of finite numbers.
        """
        if not isinstance(law, Law):
            raise ConfigError("law", "must be a law of glrender.brdf", law)
        to_sun, to_camera, normal = (checked_vectors(name, array) for name, array in
                                     (("to_sun", to_sun), ("to_camera", to_camera), ("normal", normal)))
        count = len(to_sun)
        for name, array in (("to_camera", to_camera), ("normal", normal)):
            if len(array) != count:
                raise ConfigError(name, f"must have shape ({count}, 3), as to_sun", array.shape)
        if albedo_scale is None:
            albedo_scale = np.ones(count)
        context, gl = self._context, self._context.gl
        context.make_current()
        block = UniformBlock("Law", law.uniform_fields)
        program = context.program(
            compose("fullscreen.vert.glsl"),
            compose("evaluate.frag.glsl", brdf=law.glsl, blocks=[block],
                    defines={**law.defines(), **(defines or {})}))
        height = min(max(-(-count // _WIDTH), 1), context.info["max_texture_px"])
        result = np.empty(count, np.float32)
        with ResourceOwner(context) as owner:
            target = owner.own(gl.texture((_WIDTH, height), 1, dtype="f4"))
            framebuffer = owner.own(gl.framebuffer([target]))
            uniforms = owner.own(gl.buffer(block.pack(law.uniforms())))
            vertex_array = owner.own(gl.vertex_array(program, []))
            textures = [owner.own(gl.texture((_WIDTH, height), n, dtype="f4")) for n in (3, 3, 3, 1)]
            if "Law" in program:
                program["Law"].binding = 0
            gl.disable(moderngl.DEPTH_TEST | moderngl.CULL_FACE | moderngl.BLEND)
            for start in range(0, count, _WIDTH * height):
                stop = min(start + _WIDTH * height, count)
                for unit, (name, array) in enumerate(
                        zip(_INPUTS, (to_sun, to_camera, normal, albedo_scale), strict=True)):
                    components = textures[unit].components
                    texels = np.zeros((_WIDTH * height, components), np.float32)
                    texels[: stop - start] = np.asarray(array[start:stop]).reshape(-1, components)
                    textures[unit].write(texels)
                    textures[unit].use(unit)
                    if name in program:
                        program[name].value = unit
                uniforms.bind_to_uniform_block(0)
                framebuffer.use()
                vertex_array.render(moderngl.TRIANGLES, vertices=3)
                texels = np.frombuffer(framebuffer.read(components=1, dtype="f4"), np.float32)
                result[start:stop] = texels[: stop - start]
        return result
