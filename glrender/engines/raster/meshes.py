"""A body in a context: its mesh, and what the planner knows of it."""

from __future__ import annotations

import math

import numpy as np

from ...brdf import Law
from ...planner.error_model import SLOPE_PHASES_RAD, BodyTraits
from ...scene.scene import Body
from ...scene.shape.shape import longest_sides_m
from ...scene.surface import Surface
from .gl.context import Context
from .gl.mesh import Mesh


def body_mesh(context: Context, body: Body) -> Mesh:
    """The body's shape on the device; to be closed."""
    shape = body.drawn_shape
    return Mesh(context, shape.vertices_m, shape.facets, body.brdf,
                vertex_normals=shape.vertex_normals if body.smooth_normals else None,
                uv=shape.uv, albedo_map=body.albedo_map, is_closed=shape.report.is_watertight)


def body_traits(body: Body) -> BodyTraits:
    """The properties of a body that the planner uses."""
    shape = body.drawn_shape
    areas = shape.facet_areas_m2
    return BodyTraits(
        radius_m=body.hull.radius_m, is_convex=body.hull.is_convex, law=body.brdf.glsl,
        max_phase_rad=body.brdf.max_phase, relief=body.relief, n_facets=len(shape.facets),
        crease_rad=shape.crease_rad, view_slopes=view_slopes(body.brdf),
        longest_side_m=float(longest_sides_m(shape.vertices_m, shape.facets).max()),
        facet_m=math.sqrt(float(areas @ areas) / float(areas.sum())) if Surface(body).is_even else math.inf)


def view_slopes(law: Law) -> tuple[float, ...]:
    """Relative change of a surface's radiance per radian of the direction it is seen from [1/rad], RMS by its light.

    At each of `SLOPE_PHASES_RAD`, over the sunlit part of a sphere that the camera sees: 0 by Lambert's law, and of a
    black surface; beyond the law's largest phase as at the one before.
    """
    step_rad = 1e-3
    cosines, weights = np.polynomial.legendre.leggauss(16)
    around = (np.arange(32) + 0.5) * np.pi / 16.0
    mu, angle = (axis.ravel() for axis in np.meshgrid(0.5 * (cosines + 1.0), around, indexing="ij"))
    sine = np.sqrt(1.0 - mu * mu)
    normal = np.stack([sine * np.cos(angle), sine * np.sin(angle), mu], axis=1)
    weight = np.repeat(weights, len(around)) * mu
    found = []
    for phase_rad in SLOPE_PHASES_RAD:
        if phase_rad > law.max_phase and found:
            found.append(found[-1])
            continue
        to_sun = np.array([math.sin(phase_rad), 0.0, math.cos(phase_rad)])
        here, *beside = (law.brdf(to_sun, np.array(way) / np.linalg.norm(way), normal)
                         for way in ((0.0, 0.0, 1.0), (step_rad, 0.0, 1.0), (0.0, step_rad, 1.0)))
        light = weight * here * np.maximum(normal @ to_sun, 0.0)
        if not light.sum() > 0.0:
            found.append(0.0)
            continue
        changes = sum(np.where((here > 0.0) & (there > 0.0), there / np.maximum(here, 1e-300) - 1.0, 0.0) ** 2
                      for there in beside) / step_rad**2
        found.append(math.sqrt(float((light * changes).sum() / light.sum())))
    return tuple(found)
