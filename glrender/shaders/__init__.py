"""GLSL sources, and how a program's text is put together: pure text, no GL."""

from .compose import Source, compose, constants_glsl
from .uniform_block import ConstantBlock, UniformBlock

__all__ = ["ConstantBlock", "Source", "UniformBlock", "compose", "constants_glsl"]
