"""A law's GLSL twin as an OSL shader: the very text that OpenGL draws with, so that a plug-in's law works here too.

Cycles' closures know no arbitrary BRDF, but the Sun is small: its light is that of a diffuse closure whose
weight is pi times the law's BRDF, for the Sun's direction and the camera's. Cycles itself then casts the shadow rays.
Light from other facets comes from everywhere: it meets a diffuse closure whose weight is the law's
hemispherical-directional reflectance at the angle of emission, exact for light that is the same from all sides.
"""

from __future__ import annotations

import math
import re
import warnings
from typing import Any

import numpy as np

from ...brdf import Law
from ...brdf.integrals import hemispherical_albedo
from ...shaders import compose

_NODES = 33
# Words of OSL that a GLSL text may use as names.
_RESERVED = re.compile(r"\b(normal|point|color|vector|matrix|output|surface|closure|shader|emit|string|light|public)\b")
_GLOBAL_CONSTANT = re.compile(r"^const float (\w+) = (.+?);", re.MULTILINE)
_FUNCTION = re.compile(r"^(?:float|int|bool|vec3|vec4) \w+\([^)]*\)\s*\{", re.MULTILINE)
_PREAMBLE = """\
struct vec4 { float x; float y; float z; float w; };
struct vec2 { float x; float y; };
#define vec3 vector
#define bool int
#define const
"""
_MAIN = """\
// In Cycles I points to the camera.
shader law(
    vector to_sun = vector(0.0, 0.0, 1.0),
    float albedo_scale = 1.0,
    int is_indirect = 0,
    output closure color result = 0)
{
    float weight = 0.0;
    if (is_indirect)
        weight = albedo_scale * reflectance(dot(N, I));
    else
        weight = M_PI * brdf(to_sun, I, N, albedo_scale);
    result = weight * diffuse(N);
}
"""


def law_as_osl(law: Law, has_texture: bool) -> str:
    """The text of a law's OSL shader, with inputs `to_sun`, `albedo_scale` and `is_indirect`.

    Parameters
    ----------
    law : Law
    has_texture : bool
        Whether `albedo_scale` may differ from 1.

    Raises
    ------
    ShaderError
        The law has no GLSL twin.
    """
    text = compose("brdf", brdf=law.glsl, defines={**law.defines(), "HAS_ALBEDO_TEXTURE": int(has_texture)}).text
    lines = [line for line in text.splitlines() if not line.startswith(("#version", "#line"))]
    text = _RESERVED.sub(r"\1_", re.sub(r"//[^\n]*", "", "\n".join(lines)))
    text = _GLOBAL_CONSTANT.sub(r"#define \1 (\2)", text)
    values = law.uniforms()
    tables, locals_ = [], {}
    for name, kind in law.uniform_fields.items():
        if "[" in kind:
            tables.append(_table(name, values[name]))
            text = re.sub(rf"\b{name}\[", f"{name}_at[", text)
        else:
            locals_[name] = f"{kind} {name} = {_literal(values[name])};"
    text = _call_tables(text)
    return "\n".join([_PREAMBLE, *tables, _with_locals(text, locals_), _reflectance(law), _MAIN])


def _with_locals(text: str, values: dict[str, str]) -> str:
    """OSL has no global constants: each function declares those that it reads."""
    pieces, start = [], 0
    for match in _FUNCTION.finditer(text):
        end = _closing(text, match.end())
        used = [line for name, line in values.items() if re.search(rf"\b{name}\b", text[match.end():end])]
        pieces += [text[start:match.end()], "\n    " + " ".join(used)]
        start = match.end()
    return "".join([*pieces, text[start:]])


def _closing(text: str, start: int, brackets: str = "{}") -> int:
    """The index at which the bracket that was opened before `start` closes."""
    depth = 1
    for index in range(start, len(text)):
        depth += (text[index] == brackets[0]) - (text[index] == brackets[1])
        if not depth:
            return index
    return len(text)


def _call_tables(text: str) -> str:
    """``law_x_at[i].y`` as ``law_x_at(i, 1)``, and ``vec4 v = law_x_at[i]`` component by component."""
    while (match := re.search(r"\b(law_\w+_at)\[", text)) is not None:
        end = _closing(text, match.end(), "[]")
        name, index, rest = match[1], text[match.end():end], text[end + 1:]
        if (component := re.match(r"\.([xyzw])\b", rest)) is not None:
            text = f"{text[:match.start()]}{name}_({index}, {'xyzw'.index(component[1])}){rest[2:]}"
        else:
            text = f"{text[:match.start()]}{name}_vec4({index}){rest}"
    return text


def _table(name: str, rows: Any) -> str:
    rows = np.asarray(rows, np.float32)
    numbers = ", ".join(_number(x) for x in rows.ravel())
    return (f"float {name}_at_(int i, int k)\n{{\n    float table[{rows.size}] = {{ {numbers} }};\n"
            f"    return table[4 * i + k];\n}}\n"
            f"vec4 {name}_at_vec4(int i)\n{{\n    vec4 row;\n"
            + "".join(f"    row.{c} = {name}_at_(i, {k});\n" for k, c in enumerate("xyzw")) + "    return row;\n}\n")


def _literal(value: Any) -> str:
    numbers = [_number(x) for x in np.asarray(value, np.float32).ravel()]
    return numbers[0] if len(numbers) == 1 else "{ " + ", ".join(numbers) + " }"


def _number(value: float) -> str:
    return repr(float(np.float32(value)))


def _reflectance(law: Law) -> str:
    """The law's hemispherical-directional reflectance against the cosine of emission, by straight lines."""
    cosines = np.linspace(0.0, 1.0, _NODES)
    cosines[0] = 1e-3
    with warnings.catch_warnings():
        # Beyond its phases a law is held; the value here is an average.
        warnings.simplefilter("ignore")
        values = [hemispherical_albedo(law, math.acos(c), 48) for c in cosines]
    numbers = ", ".join(_number(x) for x in values)
    return (f"float reflectance(float cosine)\n{{\n    float table[{_NODES}] = {{ {numbers} }};\n"
            f"    float place = clamp(cosine, 0.0, 1.0) * {_NODES - 1}.0;\n"
            f"    int k = min(int(place), {_NODES - 2});\n"
            "    return mix(table[k], table[k + 1], place - k);\n}\n")
