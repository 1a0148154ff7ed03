"""A body in a context: its mesh, and what the planner knows of it."""

from __future__ import annotations

import math

from .error_model import BodyTraits
from .gl.context import Context
from .gl.mesh import Mesh
from .scene import Body
from .surface import Surface


def body_mesh(context: Context, body: Body) -> Mesh:
    """The body's shape on the device; to be closed."""
    shape = body.shape
    return Mesh(context, shape.vertices_m, shape.facets, body.brdf,
                vertex_normals=shape.vertex_normals if body.smooth_normals else None,
                uv=shape.uv, albedo_map=body.albedo_map)


def body_traits(body: Body) -> BodyTraits:
    """What the planner knows of a body."""
    areas = body.shape.facet_areas_m2
    return BodyTraits(
        radius_m=body.hull.radius_m, is_convex=body.hull.is_convex, law=body.brdf.glsl,
        max_phase_rad=body.brdf.max_phase, relief=body.relief, n_facets=len(body.shape.facets),
        crease_rad=body.shape.crease_rad,
        facet_m=math.sqrt(float(areas @ areas) / float(areas.sum())) if Surface(body).is_even else math.inf)
