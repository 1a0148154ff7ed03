"""What a level of detail does to a body's flux: the ratio to the full shape by phase angle, from rays.

A level keeps the full shape's slopes, but not the shadows that relief smaller than its facets
casts and hides. The renderer multiplies a level's irradiance by the mean ratio over aspects; what
differs from aspect to aspect is the error that the planner expects of it.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .cache import cached_arrays
from .frames import GOLDEN_ANGLE_RAD, evenly_spread
from .lod import Level
from .rays import LIFT, RayMesh
from .scene import Body
from .surface import Surface

PHASES_RAD = np.radians([0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0, 105.0, 120.0, 135.0, 150.0])
_ASPECTS = 16
# Rays across the body's bounding sphere: the scatter of one ratio is then about 0.1 %.
_RAYS_ACROSS = 128


@dataclass(frozen=True, kw_only=True, eq=False)
class FluxRatio:
    """Flux of the full shape over that of a level.

    Attributes
    ----------
    mean : (P,) float64
        At `PHASES_RAD`, over aspects.
    scatter : (P,) float64
        Standard deviation from aspect to aspect.
    """

    mean: np.ndarray
    scatter: np.ndarray

    def at(self, phase_rad: float) -> tuple[float, float]:
        """Mean and scatter at a phase angle; beyond the last one, the last one's."""
        return (float(np.interp(phase_rad, PHASES_RAD, self.mean)),
                float(np.interp(phase_rad, PHASES_RAD, self.scatter)))


def flux_ratios(body: Body, levels: tuple[Level, ...], cache: Path | None = None) -> tuple[FluxRatio, ...]:
    """Ratios of a body's levels; kept in the cache with the levels.

    Raises
    ------
    DeviceError
        embreex is not installed.
    """
    texture = b"" if body.albedo_map is None else body.albedo_map.tobytes()
    digest = hashlib.sha256(body.shape.content_hash.encode() + texture)
    digest.update(f"{body.brdf!r} {body.smooth_normals} {[len(level.facets) for level in levels]} {_ASPECTS} "
                  f"{_RAYS_ACROSS} {PHASES_RAD.tolist()}".encode())
    names = [f"{what}_{index}" for index in range(len(levels)) for what in ("mean", "scatter")]
    arrays = cached_arrays(f"flux1-{digest.hexdigest()[:32]}", names, lambda: _measured(body, levels), cache)
    return tuple(FluxRatio(mean=arrays[f"mean_{index}"], scatter=arrays[f"scatter_{index}"])
                 for index in range(len(levels)))


def _measured(body: Body, levels: tuple[Level, ...]) -> dict[str, np.ndarray]:
    surface = Surface(body)
    every = np.arange(len(body.shape.facets))
    normal, albedo = surface.normals(every), surface.albedo_scale(every)
    meshes = [RayMesh(body.drawn_shape.vertices_m, body.shape.facets)]
    meshes += [RayMesh(level.vertices_m, level.facets) for level in levels]
    rng = np.random.default_rng(0)
    flux = np.zeros((len(meshes), _ASPECTS, len(PHASES_RAD)))
    for aspect in range(_ASPECTS):
        to_camera, aside = aspect_directions(aspect, _ASPECTS)
        grid = _grid(to_camera, meshes[0].radius_m)
        suns = np.cos(PHASES_RAD)[:, None] * to_camera + np.sin(PHASES_RAD)[:, None] * aside
        for which, mesh in enumerate(meshes):
            facet, distance = mesh.hit(grid, np.broadcast_to(-to_camera, grid.shape))
            seen = np.flatnonzero(facet >= 0)
            geometric = mesh.normals[facet[seen]]
            start = grid[seen] - to_camera * distance[seen, None] + geometric * (LIFT * mesh.radius_m)
            source = facet[seen]
            if which:
                texels = levels[which - 1].source_facet
                source = texels[source, rng.integers(0, texels.shape[1], len(source))]
            shading = normal[source]
            shading = np.where((shading @ to_camera > 0.0)[:, None], shading, geometric)
            for k, to_sun in enumerate(suns):
                lit = np.flatnonzero(shading @ to_sun > 0.0)
                lit = lit[~mesh.blocks(start[lit], to_sun)]
                value = surface.brdf(to_sun, to_camera, shading[lit], albedo[source[lit]])
                flux[which, aspect, k] = (value * (shading[lit] @ to_sun)).sum()
    made = {}
    for index in range(len(levels)):
        full, level = flux[0], flux[index + 1]
        made[f"mean_{index}"] = full.sum(axis=0) / level.sum(axis=0)
        ratio = full / np.maximum(level, 1e-3 * level.max(axis=0))
        made[f"scatter_{index}"] = ratio.std(axis=0)
    return made


def aspect_directions(aspect: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """A direction to the camera, one of `count` that are evenly spread, and one at right angles to it."""
    to_camera = evenly_spread(aspect, count)
    first = np.cross(to_camera, np.eye(3)[np.argmin(np.abs(to_camera))])
    first /= np.linalg.norm(first)
    turn = 2.0 * GOLDEN_ANGLE_RAD * aspect
    return to_camera, np.cos(turn) * first + np.sin(turn) * np.cross(to_camera, first)


def _grid(to_camera: np.ndarray, radius_m: float) -> np.ndarray:
    """Origins of parallel rays that cover the bounding sphere, two radii in front of it."""
    first = np.cross(to_camera, np.eye(3)[np.argmin(np.abs(to_camera))])
    first /= np.linalg.norm(first)
    second = np.cross(to_camera, first)
    steps = ((np.arange(_RAYS_ACROSS) + 0.5) / _RAYS_ACROSS * 2.0 - 1.0) * radius_m
    x, y = (axis.reshape(-1, 1) for axis in np.meshgrid(steps, steps))
    return x * first + y * second + 2.0 * radius_m * to_camera
