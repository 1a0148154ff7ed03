"""Laser ranges: float64 rays against the facets themselves, without OpenGL or Embree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from glrender_camera.validate import finite, integer, positive, unit_vectors

from ...base.errors import ConfigError
from ...base.names import MAX_DIRECTIONS
from ...scene.scene import Scene
from ...view.state import State
from ...view.view import view_bodies
from .exact_loops import FACING
from .exact_rays import exact_mesh

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


@dataclass(frozen=True, kw_only=True)
class RangeNoise:
    """A rangefinder's own errors.

    Parameters
    ----------
    sigma_m : float [m], >= 0
        Standard deviation of a normal error.
    resolution_m : float [m], >= 0
        Ranges are rounded to its multiples; 0 leaves them.
    max_range_m : float [m], > 0, optional
        Nothing returns from farther away.
    seed : int
    """

    sigma_m: float = 0.0
    resolution_m: float = 0.0
    max_range_m: float | None = None
    seed: int = 0

    def __post_init__(self):
        for name in ("sigma_m", "resolution_m"):
            if not finite(name, getattr(self, name)) >= 0.0:
                raise ConfigError(name, "must be >= 0", getattr(self, name))
        if self.max_range_m is not None:
            positive("max_range_m", self.max_range_m)
        # A whole number may come as a float (MATLAB).
        object.__setattr__(self, "seed", integer("seed", self.seed, 0, 2**64 - 1))


@dataclass(frozen=True, kw_only=True, eq=False)
class Ranges:
    """First hits of a rangefinder's rays.

    Attributes
    ----------
    range_m : (N,) float64 [m]
        NaN where nothing returns.
    body_id, facet_id : (N,) int32
        Index into the scene's bodies, and into the body's facets; -1 where nothing returns.
    beam_incidence : (N,) float64 [rad]
        Between the facet's normal and the way back; NaN where nothing returns.
    """

    range_m: np.ndarray
    body_id: np.ndarray
    facet_id: np.ndarray
    beam_incidence: np.ndarray


def laser_ranges(scene: Scene, state: State, directions_camera: ArrayLike, camera: str | None = None,
                 noise: RangeNoise | None = None) -> Ranges:
    """Ranges along directions from a camera's place.

    Parameters
    ----------
    scene : Scene
    state : State
    directions_camera : (N, 3) or (3,) float
        Unit vectors in `camera`; N at most 10 000.
    camera : str, optional
        Name; the scene's only camera by default.
    noise : RangeNoise, optional
        Exact ranges without it.

    Raises
    ------
    SceneError
        The state cannot be rendered: unknown body or camera, a camera inside a body.
    ConfigError
        Directions that are no unit vectors, or too many.
    """
    pinhole = scene.camera(camera)
    rays = checked_directions(directions_camera)
    nearest, body_id = np.full(len(rays), np.inf), np.full(len(rays), -1, np.int32)
    facet_id, incidence = np.full(len(rays), -1, np.int32), np.full(len(rays), np.nan)
    views = view_bodies(state, pinhole, scene.hulls)
    for index, (body, view) in enumerate(zip(scene.bodies, views, strict=True)):
        ray_body = rays @ view.camera_from_body
        facet, distance = exact_mesh(body.drawn_shape).hit(view.r_camera_body_m, ray_body, FACING)
        nearer = np.flatnonzero(distance < nearest)
        nearest[nearer], body_id[nearer], facet_id[nearer] = distance[nearer], index, facet[nearer]
        normal = body.drawn_shape.facet_normals[facet[nearer]]
        # The angle between two vectors that is exact near 0 as well.
        back = -ray_body[nearer]
        incidence[nearer] = np.arctan2(np.linalg.norm(np.cross(normal, back), axis=1),
                                       np.einsum("ij,ij->i", normal, back))
    if noise is not None:
        rng = np.random.default_rng(noise.seed)
        lost = ~(nearest <= (np.inf if noise.max_range_m is None else noise.max_range_m))
        nearest = nearest + noise.sigma_m * rng.standard_normal(len(nearest))
        if noise.resolution_m > 0.0:
            nearest = noise.resolution_m * np.rint(nearest / noise.resolution_m)
        nearest[lost], body_id[lost], facet_id[lost], incidence[lost] = np.inf, -1, -1, np.nan
    return Ranges(range_m=np.where(np.isfinite(nearest), nearest, np.nan), body_id=body_id, facet_id=facet_id,
                  beam_incidence=incidence)


def checked_directions(value: object) -> np.ndarray:
    """(N, 3) float64 unit vectors, renormalised as `unit_vectors` does it.

    Raises
    ------
    ConfigError
    """
    path = "directions_camera"
    try:
        rays = np.array(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        raise ConfigError(path, "must be a list of unit vectors of 3 numbers") from None
    if rays.shape == (3,):
        rays = rays[None]
    if rays.ndim != 2 or rays.shape[1] != 3 or not len(rays):
        raise ConfigError(path, "must be a list of unit vectors of 3 numbers, got shape", list(rays.shape))
    if len(rays) > MAX_DIRECTIONS:
        raise ConfigError(path, f"must be at most {MAX_DIRECTIONS}", len(rays), "ask several times")
    return unit_vectors(path, rays, "normalise before sending")
