"""A body in a context: a mesh of each material, and its traits for the planner."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache

import numpy as np

from ...brdf import Law
from ...planner.error_model import BodyTraits
from ...scene.scene import Body
from ...scene.surface import Surface
from .gl.context import Context
from .gl.mesh import Mesh

# Phase angle [rad] beyond which too little of a sphere is lit for a law to be looked at.
_MOST_PHASE_RAD = 2.6


def body_meshes(context: Context, body: Body) -> Iterator[Mesh]:
    """The body's parts on the device; to be closed."""
    first_facet = 0
    for part in body.parts:
        shape = part.drawn_shape
        yield Mesh(context, shape.vertices_m, shape.facets, part.brdf, first_facet=first_facet,
                   vertex_normals=shape.vertex_normals if body.smooth_normals else None,
                   uv=shape.uv, albedo_map=part.albedo_map, is_closed=body.shape.report.is_watertight)
        first_facet += len(shape.facets)


def body_traits(body: Body) -> BodyTraits:
    """The properties of a body that the planner uses."""
    shape = body.drawn_shape
    areas, laws = shape.facet_areas_m2, [part.brdf for part in body.parts]

    @cache
    def steepest(phase_deg: int) -> float:
        return max(view_slope(law, min(phase_deg, int(math.degrees(law.max_phase)))) for law in laws)

    return BodyTraits(
        radius_m=body.hull.radius_m, is_convex=body.hull.is_convex, law=body.law_names,
        max_phase_rad=min(law.max_phase for law in laws), relief=body.relief, n_facets=len(shape.facets),
        crease_rad=shape.crease_rad, longest_side_m=shape.longest_side_m, is_of_one_look=len(laws) == 1,
        view_slope=lambda phase_rad: steepest(int(math.degrees(min(phase_rad, _MOST_PHASE_RAD)))),
        facet_m=math.sqrt(float(areas @ areas) / float(areas.sum())) if Surface(body).is_even else math.inf)


def view_slope(law: Law, phase_deg: int) -> float:
    """Relative change of a surface's radiance per radian of the direction it is seen from [1/rad], RMS by its light.

    Over the sunlit part of a sphere that the camera sees: 0 by Lambert's law, and of a black surface. Normals are even
    over the sphere, or dense around the bisector of Sun and camera, where a highlight may be narrow: the larger counts.
    """
    half_rad = 0.5 * math.radians(phase_deg)
    cosines, weights = np.polynomial.legendre.leggauss(16)
    angles = np.concatenate([[0.0], np.geomspace(1e-3, 0.5 * math.pi, 24)])
    return max(_slope(law, 2.0 * half_rad, 0.0, 0.5 * (cosines + 1.0), weights),
               _slope(law, half_rad, -half_rad, np.cos(0.5 * (angles[1:] + angles[:-1])), -np.diff(np.cos(angles))))


def _slope(law: Law, sun_rad: float, camera_rad: float, cosines: np.ndarray, weights: np.ndarray) -> float:
    """The same by normals at some cosines from an axis, from which Sun and camera stand at angles in one plane."""
    step_rad, around = 1e-3, (np.arange(32) + 0.5) * np.pi / 16.0
    mu, angle = (axis.ravel() for axis in np.meshgrid(cosines, around, indexing="ij"))
    sine = np.sqrt(1.0 - mu * mu)
    normal = np.stack([sine * np.cos(angle), sine * np.sin(angle), mu], axis=1)
    to_sun, to_camera = (np.array([math.sin(at), 0.0, math.cos(at)]) for at in (sun_rad, camera_rad))
    asides = np.array([to_camera[2], 0.0, -to_camera[0]]), np.array([0.0, 1.0, 0.0])
    here, *beside = (law.brdf(to_sun, way / np.linalg.norm(way), normal)
                     for way in (to_camera, *(to_camera + step_rad * aside for aside in asides)))
    light = (np.repeat(weights, len(around)) * np.maximum(normal @ to_camera, 0.0) * here
             * np.maximum(normal @ to_sun, 0.0))
    if not light.sum() > 0.0:
        return 0.0
    changes = sum(np.where((here > 0.0) & (there > 0.0), there / np.maximum(here, 1e-300) - 1.0, 0.0) ** 2
                  for there in beside) / step_rad**2
    return math.sqrt(float((light * changes).sum() / light.sum()))
