"""Brightness of a surface's material: the frames' signal over the shading of a law, at vertices or in a map."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import trimesh
from glrender_navigation.checks import whole
from PIL import Image

from .frames import PosedFrame, views_in_light
from .mesh import Mesh, grey

Law = Callable[[np.ndarray, np.ndarray], np.ndarray]

# Below it the shading is of the relief that the surface lacks.
_LEAST_SHADING = 0.1


def lommel_seeliger(cos_incidence: np.ndarray, cos_emission: np.ndarray) -> np.ndarray:
    """Shading of a dark surface, 0.5 where both angles are equal. Source: Hapke (2012)."""
    return cos_incidence / (cos_incidence + cos_emission)


def vertex_brightness(frames: Sequence[PosedFrame], mesh: Mesh, law: Law = lommel_seeliger) -> np.ndarray:
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
    found = _brightness(frames, mesh, mesh.vertices_m, mesh.vertex_normals, law)
    return found / _mean(found)


def textured(frames: Sequence[PosedFrame], mesh: Mesh, n_texels: int = 2,
             law: Law = lommel_seeliger) -> trimesh.Trimesh:
    """The surface with a grey map of its brightness, as `trimesh` exports it to OBJ (with MTL and PNG) or GLB.

    Parameters
    ----------
    frames, mesh, law
        As of `vertex_brightness`; texels have the greys of its vertices.
    n_texels : int, optional
        Steps of the map along the sides of a facet, 1 or more.

    Raises
    ------
    ValueError
        Without embreex, without frames, or with less than a texel.
    """
    # Each facet has a square of texels, and lies in the half next to two sides; a step beyond it is of the facet too.
    n, n_facets = whole("n_texels", n_texels), len(mesh.facets)
    side, n_columns = n + 2, int(np.ceil(np.sqrt(n_facets)))
    y, x = np.nonzero(np.add.outer(np.arange(side), np.arange(side)) <= n + 1)
    weights = np.maximum(np.column_stack([n - x - y, x, y]), 0) / np.maximum(n, x + y)[:, None]
    points_m, normal = (np.einsum("tk,fkc->ftc", weights, each).reshape(-1, 3)
                        for each in (mesh.corners_m, mesh.vertex_normals[mesh.facets]))
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    found = _brightness(frames, mesh, points_m, normal, law).reshape(n_facets, -1)
    corner = side * np.stack(np.divmod(np.arange(n_facets), n_columns), axis=1)[:, None]
    picture = np.full((side * -(-n_facets // n_columns), side * n_columns), np.nan)
    at_y, at_x = np.moveaxis(corner + np.column_stack([y, x]), -1, 0)
    picture[at_y, at_x] = found
    uv = (corner + [[0, 0], [0, n], [n, 0]] + 0.5)[..., ::-1] / picture.shape[::-1] * [1.0, -1.0] + [0.0, 1.0]
    visual = trimesh.visual.TextureVisuals(uv=uv.reshape(-1, 2), image=Image.fromarray(grey(picture / _mean(picture))))
    return trimesh.Trimesh(mesh.corners_m.reshape(-1, 3), np.arange(3 * n_facets).reshape(-1, 3), process=False,
                           visual=visual)


def _brightness(frames: Sequence[PosedFrame], mesh: Mesh, points_m: np.ndarray, normal: np.ndarray,
                law: Law) -> np.ndarray:
    """Signal over exposure and shading (N,) at points (N, 3) of the mesh with normals (N, 3)."""
    total, count = np.zeros((2, len(points_m)))
    for frame, seen, at_px, cos_incidence, cos_emission in views_in_light(frames, mesh, points_m, normal):
        here = np.flatnonzero(seen)
        shading = law(cos_incidence[here], cos_emission[here])
        here, shading = here[shading > _LEAST_SHADING], shading[shading > _LEAST_SHADING]
        total[here] += frame.signal[at_px[here, 1], at_px[here, 0]] / (frame.exposure_s * shading)
        count[here] += 1
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _mean(found: np.ndarray) -> float:
    seen = found[np.isfinite(found)]
    return float(seen.mean()) if seen.size else 1.0
