"""A uniform block declared once: its GLSL text and its std140 NumPy dtype."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..base.errors import ShaderError

# GLSL type -> (NumPy base, shape, std140 alignment in bytes). Matrices are packed as
# columns here, and here alone: callers pass ordinary row-major NumPy matrices.
_TYPES = {
    "float": ("<f4", (), 4), "int": ("<i4", (), 4),
    "vec2": ("<f4", (2,), 8), "vec3": ("<f4", (3,), 16), "vec4": ("<f4", (4,), 16),
    "mat4": ("<f4", (4, 4), 16),
}


class UniformBlock:
    """A std140 uniform block.

    Parameters
    ----------
    name : str
        Of the block in GLSL; members are global there, so their names must differ between blocks.
    fields : mapping of str to str
        Member name to type: float, int, vec2, vec3, vec4, mat4, or `vec4[n]`.
    """

    def __init__(self, name: str, fields: Mapping[str, str]):
        self.name, self.fields = name, dict(fields)
        names, formats, offsets, offset = [], [], [], 0
        self._matrices = set()
        for member, kind in self.fields.items():
            match = re.fullmatch(r"(\w+)(?:\[(\d+)\])?", kind)
            if not match or match[1] not in _TYPES or (match[2] and match[1] != "vec4"):
                raise ShaderError(f"uniform block {name}.{member}: type {kind!r} is not supported")
            base, shape, alignment = _TYPES[match[1]]
            if match[2]:
                shape = (int(match[2]), *shape)
            if match[1] == "mat4":
                self._matrices.add(member)
            offset = -(-offset // alignment) * alignment
            names.append(member)
            formats.append((base, shape))
            offsets.append(offset)
            offset += np.dtype((base, shape)).itemsize
        size = max(-(-offset // 16) * 16, 16)
        self.dtype = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})
        members = "".join(f"    {self._declare(member, kind)};\n" for member, kind in self.fields.items())
        self.glsl = f"layout(std140) uniform {name} {{\n{members}}};\n" if self.fields else ""

    @staticmethod
    def _declare(member: str, kind: str) -> str:
        base, bracket, size = kind.partition("[")
        return f"{base} {member}{bracket}{size}"

    def pack(self, values: Mapping[str, Any]) -> bytes:
        """The block's bytes; every member must be given, and nothing else."""
        if values.keys() != self.fields.keys():
            raise ShaderError(f"uniform block {self.name}: needs {sorted(self.fields)}, got {sorted(values)}")
        record = np.zeros((), self.dtype)
        for member, value in values.items():
            record[member] = np.asarray(value).T if member in self._matrices else value
        return record.tobytes()


class ConstantBlock:
    """The members of a uniform block as constants, for values that never change while a program lives.

    A software rasteriser reads a uniform from memory at every pixel and folds a constant away: a frame with Hapke's law
    takes 1.05 in place of 1.17 times Lambert's. Two bodies with other values of one law compile two programs for it.

    Parameters
    ----------
    fields : mapping of str to str
        As of `UniformBlock`; float, vec2, vec3, vec4 or `vec4[n]`.
    values : mapping
        One for every field.
    """

    def __init__(self, fields: Mapping[str, str], values: Mapping[str, Any]):
        self.glsl = "".join(_constant(member, kind, values[member]) for member, kind in fields.items())


def _constant(member: str, kind: str, value: Any) -> str:
    array = np.asarray(value, np.float32)
    if not np.isfinite(array).all():
        raise ShaderError(f"constant {member}: must be finite, got {value!r}")
    base, bracket, size = kind.partition("[")
    # repr of the float64 that a float32 is: the same float32 when GLSL reads it.
    numbers = lambda row: ", ".join(repr(float(x)) for x in np.ravel(row))  # noqa: E731
    if bracket:
        text = f"{kind}({', '.join(f'{base}({numbers(row)})' for row in array)})"
        return f"const {base} {member}[{size} = {text};\n"
    return f"const {kind} {member} = {kind}({numbers(array)});\n"
