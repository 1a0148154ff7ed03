"""Blender's Cycles as a backend: inter-reflection, and the Sun as a disc. See docs/plugins.md."""

from .backend import Cycles

__all__ = ["Cycles"]
