"""A body in a context: the full shape and its levels of detail, and what the planner knows of them."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from .error_model import BodyTraits, LevelTraits
from .errors import DeviceError
from .gl.context import Context
from .gl.mesh import Mesh
from .level_tables import AreaLevel
from .lod import Level, levels_of_detail
from .lod_flux import FluxRatio, flux_ratios
from .rays import longest_sides_m
from .scene import Body
from .surface import Surface


def body_levels(body: Body) -> tuple[tuple[Level, ...], tuple[FluxRatio, ...]]:
    """Levels of detail and what they do to the flux; none without rays to measure it."""
    levels = levels_of_detail(body.drawn_shape)
    try:
        return levels, flux_ratios(body, levels)
    except DeviceError:
        return (), ()


def body_meshes(context: Context, body: Body, levels: tuple[Level, ...]) -> Iterator[Mesh]:
    """The full shape and its levels of detail, finest first; each to be closed."""
    shape = body.drawn_shape
    yield Mesh(context, shape.vertices_m, shape.facets, body.brdf,
               vertex_normals=shape.vertex_normals if body.smooth_normals else None,
               uv=shape.uv, albedo_map=body.albedo_map)
    surface, every = Surface(body), np.arange(len(shape.facets))
    detail = np.concatenate([surface.normals(every), surface.albedo_scale(every)[:, None]], axis=1) if levels else None
    for level in levels:
        yield Mesh(context, level.vertices_m, level.facets, body.brdf,
                   detail=detail.astype(np.float16)[level.source_facet], beyond_m=level.beyond_m)


def body_traits(body: Body, levels: tuple[Level, ...], ratios: tuple[FluxRatio, ...],
                by_areas: tuple[AreaLevel, ...] = ()) -> BodyTraits:
    """What the planner knows of a body."""
    shape, surface = body.drawn_shape, Surface(body)
    areas = shape.facet_areas_m2
    up, aside_rad = np.array([[0.0, 0.0, 1.0]]), math.radians(30.0)
    to_sun = np.array([math.sin(aside_rad), 0.0, math.cos(aside_rad)])
    full = LevelTraits(n_facets=len(shape.facets), crease_rad=shape.crease_rad)
    return BodyTraits(
        radius_m=body.hull.radius_m, is_convex=body.hull.is_convex, law=body.brdf.glsl,
        max_phase_rad=body.brdf.max_phase, relief=body.relief, area_levels=by_areas,
        longest_side_m=float(longest_sides_m(shape.vertices_m, shape.facets).max()),
        even_facet_m=math.sqrt(float(areas @ areas) / float(areas.sum())) if surface.is_even else math.inf,
        reflectance=float(surface.brdf(to_sun, up, up, np.ones(1))[0]),
        levels=(full, *(LevelTraits(n_facets=len(level.facets), crease_rad=shape.crease_rad,
                                    deviation_m=level.deviation_m, flux_ratio=ratio)
                        for level, ratio in zip(levels, ratios, strict=True))))
