"""What a level of detail's facets stand for: the full shape's normals within each, and their mean radiance.

A facet that stands for rough ground is not as bright as a flat one: of what it covers in the image, what is turned to
the camera counts for more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from .brdf.geometry import dot
from .frames import sun_from_body
from .lod import Level
from .shape import Shape
from .surface import Surface
from .view import BodyView

# Steps of a table of radiance by the components of a normal, towards the camera and across; and the same in int16.
_STEPS, _INT16 = 32, 32767
# Least cosine of the angle between a facet and what it stands for.
_LEAST_COSINE = 0.2


@dataclass(frozen=True, kw_only=True, eq=False)
class LevelShape:
    """A level of detail as a shape of its own.

    Attributes
    ----------
    shape : Shape
    begin : (F + 1,) int64
        Where the normals of each facet begin.
    normal : (N, 3) int16
        Of the full shape, in 1 / 32767.
    weight : (N,) float32
        Area of each, over the facet's.
    """

    shape: Shape
    begin: np.ndarray
    normal: np.ndarray
    weight: np.ndarray

    @classmethod
    def of(cls, full: Shape, level: Level) -> LevelShape:
        """Of a level of detail of a shape."""
        shape = Shape.from_arrays(level.vertices_m, level.facets)
        # What was mended has other numbers.
        middle = cKDTree(level.vertices_m[level.facets].mean(axis=1))
        _, number = middle.query(shape.vertices_m[shape.facets].mean(axis=1), workers=-1)
        source = np.sort(level.source_facet[number], axis=1)
        is_first = np.ones(source.shape, bool)
        is_first[:, 1:] = source[:, 1:] != source[:, :-1]
        facet, _ = np.nonzero(is_first)
        normal = full.facet_normals[source[is_first]]
        count = np.diff(np.append(np.flatnonzero(is_first), source.size))
        cosine = np.einsum("ij,ij->i", normal, shape.facet_normals[facet])
        return cls(shape=shape, begin=np.searchsorted(facet, np.arange(len(source) + 1)),
                   normal=np.rint(normal * _INT16).astype(np.int16),
                   weight=(count / source.shape[1] / np.maximum(cosine, _LEAST_COSINE)).astype(np.float32))


class FacetRelief:
    """What relief adds to the radiance of flat facets, from one place and by one Sun.

    Parameters
    ----------
    level : LevelShape
    surface : Surface
    to_sun, to_camera : (3,) float64
        From the body: what relief adds changes little over it.
    """

    def __init__(self, level: LevelShape, surface: Surface, to_sun: np.ndarray, to_camera: np.ndarray):
        from . import facet_loops

        self._loops, self._level = facet_loops, level
        across = to_sun - (to_sun @ to_camera) * to_camera
        length = np.linalg.norm(across)
        # With the Sun behind the camera any will do.
        across = across / length if length > 1e-6 else sun_from_body(to_camera)[0]
        self._axes = np.stack([to_camera, across])
        x, y = np.meshgrid(np.arange(_STEPS + 1) / _STEPS, np.arange(-_STEPS, _STEPS + 1) / _STEPS, indexing="ij")
        # Beyond the rim, what is on it.
        outside = np.sqrt(np.maximum(x * x + y * y, 1.0))
        x, y = x / outside, y / outside
        z = np.sqrt(np.maximum(1.0 - x * x - y * y, 0.0))
        normal = (x[..., None] * to_camera + y[..., None] * across
                  + z[..., None] * np.cross(to_camera, across)).reshape(-1, 3)
        brdf = surface.brdf(to_sun, to_camera[None], normal, np.ones(len(normal)))
        self._table = (brdf * np.maximum(dot(normal, to_sun), 0.0)).reshape(x.shape)

    @classmethod
    def of(cls, level: LevelShape, surface: Surface, view: BodyView) -> FacetRelief:
        """As a camera sees it."""
        return cls(level, surface, view.sun_direction_body,
                   view.r_camera_body_m / np.linalg.norm(view.r_camera_body_m))

    def added(self, facet: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """To the radiance of the level's facets (N,), of normals (3, N), in that of a BRDF times a cosine."""
        return self._loops.added_by_relief(self._level.begin, self._level.normal, self._level.weight, facet, normal,
                                           _INT16, self._axes, self._table)
