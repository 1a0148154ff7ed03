"""Put a shader's text together out of files, uniform blocks and defines."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources

from ..base.constants import GLSL_CONSTANTS
from ..base.errors import ShaderError
from .uniform_block import ConstantBlock, UniformBlock

_INCLUDE = re.compile(r'^\s*#include\s+"([^"]+)"\s*$')
# `#line` numbers are file * LINES_PER_FILE + line: a driver's message names one integer.
LINES_PER_FILE = 10_000


@dataclass(frozen=True)
class Source:
    """A composed shader stage: the text for the driver and the files that it came from."""

    text: str
    files: tuple[str, ...]

    def explain(self, driver_message: str) -> str:
        """A driver's message with its line numbers turned back into file:line."""

        def decode(match: re.Match) -> str:
            index, line = divmod(int(match[0]), LINES_PER_FILE)
            return f"{self.files[index - 1]}:{line}" if 1 <= index <= len(self.files) else match[0]

        return re.sub(r"\b\d{5,7}\b", decode, driver_message)


@cache
def _read(name: str) -> str:
    file = resources.files(__package__).joinpath(*name.split("/"))
    if not file.is_file():
        raise ShaderError(f"no shader file {name!r} in glrender/shaders")
    return file.read_text(encoding="utf-8")


def compose(stage: str, *, brdf: str | None = None, blocks: Iterable[UniformBlock | ConstantBlock] = (),
            defines: Mapping[str, int | str] | None = None) -> Source:
    """The text of one shader stage.

    Parameters
    ----------
    stage : str
        A file in `glrender/shaders`, e.g. ``surface.frag.glsl``.
    brdf : str, optional
        Law whose `brdf/<law>.glsl`, or own text, stands for ``#include "brdf"``.
    blocks : iterable of UniformBlock or ConstantBlock
        Declared ahead of the files.
    defines : mapping, optional
        Structure only; a value is a uniform.

    Raises
    ------
    ShaderError
        Unknown file, an include cycle, or ``#include "brdf"`` without a law.
    """
    files: list[str] = []
    lines = ["#version 330 core"]
    lines += [f"#define {name} {value}" for name, value in sorted((defines or {}).items())]
    lines += [block.glsl for block in blocks]
    done: set[str] = set()

    def add(name: str, chain: tuple[str, ...]) -> None:
        text = None
        if name == "brdf":
            if brdf is None:
                raise ShaderError(f"{chain[-1]} includes a law, but none was named")
            # A law from outside brings its text with its name: `brdf.law.GlslText`.
            text = getattr(brdf, "text", None)
            name = f"brdf/{brdf}.glsl"
        if name in chain:
            raise ShaderError("include cycle: " + " -> ".join((*chain, name)))
        if name in done:
            return
        done.add(name)
        files.append(name)
        index = len(files)
        lines.append(f"#line {index * LINES_PER_FILE + 1}")
        for number, line in enumerate((text or _read(name)).splitlines(), start=1):
            include = _INCLUDE.match(line)
            if include:
                add(include[1], (*chain, name))
                lines.append(f"#line {index * LINES_PER_FILE + number + 1}")
            else:
                lines.append(line)

    add(stage, ())
    return Source("\n".join(lines) + "\n", tuple(files))


def constants_glsl() -> str:
    """The text of `constants.glsl`, from `glrender.base.constants`."""
    lines = ["// Written by `python -m glrender.shaders` from glrender/base/constants.py; a test compares them."]
    lines += [f"const float {name} = {value!r};" for name, value in GLSL_CONSTANTS.items()]
    return "\n".join(lines) + "\n"
