"""Brightness of a surface's material: the frames' signal over the shading of a law, at each vertex."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from .frames import PosedFrame, views_in_light
from .mesh import Mesh

# Below it the shading is of the relief that the surface lacks.
_LEAST_SHADING = 0.1


def lommel_seeliger(cos_incidence: np.ndarray, cos_emission: np.ndarray) -> np.ndarray:
    """Shading of a dark surface, 0.5 where both angles are equal. Source: Hapke (2012)."""
    return cos_incidence / (cos_incidence + cos_emission)


def vertex_brightness(frames: Sequence[PosedFrame], mesh: Mesh,
                      law: Callable[[np.ndarray, np.ndarray], np.ndarray] = lommel_seeliger) -> np.ndarray:
    """Signal over exposure and shading at each vertex, (V,) float64, of mean 1; nan where no frame saw it lit.

    Parameters
    ----------
    frames : sequence of PosedFrame
    mesh : Mesh
    law : function of (N,) cosines of incidence and emission, optional
        Shading, up to a factor; Lommel and Seeliger's by default.

    Raises
    ------
    ValueError
        Without embreex, or without frames.
    """
    total, count = np.zeros((2, len(mesh.vertices_m)))
    for frame, seen, at_px, cos_incidence, cos_emission in views_in_light(frames, mesh, mesh.vertices_m,
                                                                          mesh.vertex_normals):
        here = np.flatnonzero(seen)
        shading = law(cos_incidence[here], cos_emission[here])
        here, shading = here[shading > _LEAST_SHADING], shading[shading > _LEAST_SHADING]
        total[here] += frame.signal[at_px[here, 1], at_px[here, 0]] / (frame.exposure_s * shading)
        count[here] += 1
    with np.errstate(invalid="ignore"):
        found = total / count
    return found / np.nanmean(found) if count.any() else found
