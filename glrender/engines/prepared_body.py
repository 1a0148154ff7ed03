"""A body of a scene as the engines of a renderer hold it, and the memory that it takes."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass

import numpy as np

from ..planner.error_model import BodyTraits
from ..scene.scene import Body
from .coverage.facet_tables import FacetTables
from .raster.gl.mesh import Mesh
from .rays.mesh import RayMesh


@dataclass(frozen=True, kw_only=True, eq=False)
class PreparedBody:
    """One body, made once for all frames.

    Attributes
    ----------
    index : int
        The body's number in the scene.
    body : Body
    traits : BodyTraits
    meshes : tuple of Mesh
        For OpenGL: of each of the body's parts.
    solid : RayMesh or None
        For rays; None without Embree.
    facets : FacetTables or None
        For coverage, likewise; None too of many facets of which none is evenly bright.
    """

    index: int
    body: Body
    traits: BodyTraits
    meshes: tuple[Mesh, ...]
    solid: RayMesh | None
    facets: FacetTables | None

    @property
    def memory_bytes(self) -> dict[str, int]:
        """Memory [byte] of the shape's arrays, and of those of each engine.

        Embree's trees and tables of surface detail are not counted; of what frames add `RenderPlan.memory_bytes` says.
        """
        shape = self.body.drawn_shape
        shared = {id(shape.vertices_m), id(shape.facets)}
        tables = [] if self.facets is None else [self.facets, self.facets.horizons]
        return {"shape": shape.vertices_m.nbytes + shape.facets.nbytes,
                "raster": sum(mesh.memory_bytes for mesh in self.meshes),
                "rays": _own_bytes(self.solid, shared), "coverage": sum(_own_bytes(each, shared) for each in tables)}


def _own_bytes(thing: object, shared: Container[int]) -> int:
    """Memory [byte] of the arrays that an object has as attributes, without those that it shares."""
    arrays = [] if thing is None else [value for value in vars(thing).values() if isinstance(value, np.ndarray)]
    return sum(array.nbytes for array in arrays if id(array) not in shared)
