"""A shape file's content, as its reader found it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .materials import FileMaterial


@dataclass(frozen=True)
class FileMesh:
    """A shape file's content: triangles, as the file has them.

    Attributes
    ----------
    vertices : (V, 3) float64
        In the file's unit.
    facets : (F, 3) int64
        From 0.
    uv : (F, 3, 2) float32 or None
        Texture coordinates of the corners.
    warnings : tuple of str
        Of what was left out.
    is_double_sided : (F,) bool or None
        Facets that the file gives two sides, if they are of an open shell.
    material : (F,) int or None
        Numbers of the facets' materials.
    materials : tuple of FileMaterial
    """

    vertices: np.ndarray
    facets: np.ndarray
    uv: np.ndarray | None = None
    warnings: tuple[str, ...] = ()
    is_double_sided: np.ndarray | None = None
    material: np.ndarray | None = None
    materials: tuple[FileMaterial, ...] = ()
