"""Shader text: composition, line numbers, constants, uniform blocks."""

from __future__ import annotations

from importlib import resources

import moderngl
import numpy as np
import pytest
from glrender.base.errors import ShaderError
from glrender.brdf import GlslText, Lambert
from glrender.engines.raster.gl.context import Context
from glrender.engines.raster.gl.evaluate import BrdfEvaluator
from glrender.shaders import ConstantBlock, UniformBlock, compose, constants_glsl
from glrender.shaders.compose import Source


@pytest.fixture(scope="module")
def context():
    with Context() as context:
        yield context


def test_constants_file_is_what_the_generator_writes():
    text = resources.files("glrender.shaders").joinpath("constants.glsl").read_text(encoding="utf-8")
    assert text == constants_glsl(), "run `python -m glrender.shaders`"


def test_every_include_comes_once():
    source = compose("surface.frag.glsl", brdf="lambert", blocks=[], defines={"HAS_SHADOWS": 1})
    assert source.text.count("const float PI") == 1
    assert source.text.startswith("#version 330 core\n#define HAS_SHADOWS 1\n")


def test_unknown_names_and_missing_laws_are_refused():
    with pytest.raises(ShaderError, match="nonsense.glsl"):
        compose("nonsense.glsl")
    with pytest.raises(ShaderError, match="includes a law, but none was named"):
        compose("surface.frag.glsl")
    with pytest.raises(ShaderError, match="brdf/nonsense.glsl"):
        compose("surface.frag.glsl", brdf="nonsense")


def test_include_cycle_is_refused():
    law = GlslText("loop", '#include "brdf"')
    with pytest.raises(ShaderError, match=r"cycle: surface\.frag\.glsl -> brdf/loop\.glsl -> brdf/loop\.glsl"):
        compose("surface.frag.glsl", brdf=law)


def test_a_driver_message_names_file_and_line(context):
    """Of a law's own text, after what it includes."""
    class Broken(Lambert):
        glsl = GlslText("broken", '#include "brdf/angles.glsl"\nfloat brdf(vec3 a, vec3 b, vec3 n, float s)\n'
                                  '{ return nonsense; }')

    up = np.array([[0.0, 0.0, 1.0]])
    with pytest.raises(ShaderError, match=r"brdf/broken\.glsl:3"):
        BrdfEvaluator(context)(Broken(normal_albedo=0.3), up, up, up)


def test_explain_leaves_other_numbers_alone():
    assert Source("", ("a.glsl",)).explain("0:10012(5): error 99999") == "0:a.glsl:12(5): error 99999"


def test_uniform_block_round_trip(context, rng):
    """Random numbers into every field, read back through a shader: std140 offsets, matrix order."""
    block = UniformBlock("Probe", {"a": "float", "m": "mat4", "v": "vec3", "b": "float", "w": "vec4", "u": "vec2",
                                   "n": "int", "t": "vec4[3]", "z": "vec3"})
    values = {"a": rng.random(), "m": rng.random((4, 4)), "v": rng.random(3), "b": rng.random(),
              "w": rng.random(4), "u": rng.random(2), "n": 1234567, "t": rng.random((3, 4)), "z": rng.random(3)}
    expected = np.concatenate([
        [values["a"]], (values["m"] @ [1.0, 2.0, 3.0, 4.0]), values["v"], [values["b"]], values["w"], values["u"],
        [values["n"]], values["t"].ravel(), values["z"]]).astype(np.float32)
    parts = ["a", *(f"(m * vec4(1, 2, 3, 4))[{i}]" for i in range(4)), *(f"v[{i}]" for i in range(3)), "b",
             *(f"w[{i}]" for i in range(4)), "u[0]", "u[1]", "float(n)",
             *(f"t[{k}][{i}]" for k in range(3) for i in range(4)), *(f"z[{i}]" for i in range(3))]
    cases = "".join(f"if (k == {k}) c = {part};\n" for k, part in enumerate(parts))
    fragment = Source(f"#version 330 core\n{block.glsl}out float c;\nvoid main() {{ int k = int(gl_FragCoord.x); c = 0;"
                      f"\n{cases} }}", ())
    program = context.program(compose("fullscreen.vert.glsl"), fragment)
    program["Probe"].binding = 0
    gl = context.gl
    target = gl.framebuffer([gl.texture((len(parts), 1), 1, dtype="f4")])
    buffer = gl.buffer(block.pack(values))
    buffer.bind_to_uniform_block(0)
    target.use()
    gl.vertex_array(program, []).render(moderngl.TRIANGLES, vertices=3)
    np.testing.assert_allclose(np.frombuffer(target.read(components=1, dtype="f4"), np.float32), expected, rtol=1e-6)


def test_constants_are_the_float32_of_their_values(context, rng):
    """Each kind of constant read back through a shader, bit for bit."""
    fields = {"a": "float", "v": "vec3", "t": "vec4[2]"}
    values = {"a": rng.random() * 1e-7, "v": rng.standard_normal(3), "t": rng.random((2, 4)) * 1e9}
    expected = np.concatenate([np.ravel(values[name]) for name in fields]).astype(np.float32)
    parts = ["a", *(f"v[{i}]" for i in range(3)), *(f"t[{k}][{i}]" for k in range(2) for i in range(4))]
    cases = "".join(f"if (k == {k}) c = {part};\n" for k, part in enumerate(parts))
    fragment = Source(f"#version 330 core\n{ConstantBlock(fields, values).glsl}out float c;\n"
                      f"void main() {{ int k = int(gl_FragCoord.x); c = 0;\n{cases} }}", ())
    program = context.program(compose("fullscreen.vert.glsl"), fragment)
    target = context.gl.framebuffer([context.gl.texture((len(parts), 1), 1, dtype="f4")])
    target.use()
    context.gl.vertex_array(program, []).render(moderngl.TRIANGLES, vertices=3)
    np.testing.assert_array_equal(np.frombuffer(target.read(components=1, dtype="f4"), np.float32), expected)
    with pytest.raises(ShaderError, match="constant a: must be finite"):
        ConstantBlock({"a": "float"}, {"a": np.inf})


def test_uniform_block_refuses_what_it_cannot_hold():
    with pytest.raises(ShaderError, match="dmat3"):
        UniformBlock("Probe", {"a": "dmat3"})
    with pytest.raises(ShaderError, match=r"needs \['a', 'b'\], got \['a'\]"):
        UniformBlock("Probe", {"a": "float", "b": "float"}).pack({"a": 1.0})
