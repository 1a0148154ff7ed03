"""Laser ranges: float64 rays from one point against the facets themselves, without OpenGL.

All rays start at the instrument, so a facet can only be met by rays inside its outline as seen from
there. Outlines are boxes on the faces of a cube around the instrument; rays and facets are halved
together until few are left, and those are intersected exactly: edges and corners leave no gap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from glrender_camera.validate import finite, integer, positive, unit_vectors

from ...base.errors import ConfigError
from ...scene.scene import Scene
from ...scene.shape.ray_triangle import distances
from ...view.state import State
from ...view.view import view_bodies

MAX_DIRECTIONS = 10_000
"""In one request."""
# So many pairs of ray and facet are tested at once; more are halved first.
_MAX_PAIRS = 30_000


@dataclass(frozen=True, kw_only=True)
class RangeNoise:
    """A rangefinder's own errors.

    Parameters
    ----------
    sigma_m : float [m], >= 0
        Standard deviation of a normal error.
    resolution_m : float [m], >= 0
        Ranges are rounded to multiples of it; 0 leaves them.
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
    """What each ray of a rangefinder met first.

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


def laser_ranges(scene: Scene, state: State, directions_camera: np.ndarray, camera: str | None = None,
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
        vertices = body.drawn_shape.vertices_m - view.r_camera_body_m
        ray_body = rays @ view.camera_from_body
        distance, facet = first_hits(vertices, body.drawn_shape.facets, ray_body)
        nearer = np.flatnonzero(distance < nearest)
        nearest[nearer], body_id[nearer], facet_id[nearer] = distance[nearer], index, facet[nearer]
        a, b, c = np.moveaxis(vertices[body.drawn_shape.facets[facet[nearer]]], 1, 0)
        normal = np.cross(b - a, c - a)
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


def first_hits(vertices: np.ndarray, facets: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The facet that each ray from the origin meets first.

    Parameters
    ----------
    vertices : (V, 3) float64 [m]
        Relative to the rays' origin.
    facets : (M, 3) int
    rays : (N, 3) float64
        Unit vectors.

    Returns
    -------
    distance : (N,) float64 [m]
        Infinite where nothing is met.
    facet : (N,) int64
        -1 there.
    """
    distance, facet = np.full(len(rays), np.inf), np.full(len(rays), -1)
    axis = np.argmax(np.abs(rays), axis=1)
    face = 2 * axis + (rays[np.arange(len(rays)), axis] < 0.0)
    for side in np.unique(face):
        mine = np.flatnonzero(face == side)
        depth_axis = side // 2
        others = [k for k in range(3) if k != depth_axis]
        depth = vertices[:, depth_axis] * (-1.0 if side % 2 else 1.0)
        ahead = depth > 0.0
        with np.errstate(divide="ignore", invalid="ignore"):
            outline = vertices[:, others] / depth[:, None]
        corners = [outline[facets[:, k]] for k in range(3)]
        low = np.minimum(np.minimum(corners[0], corners[1]), corners[2])
        high = np.maximum(np.maximum(corners[0], corners[1]), corners[2])
        n_ahead = ahead[facets[:, 0]].astype(np.int8) + ahead[facets[:, 1]] + ahead[facets[:, 2]]
        # A facet that reaches behind the instrument has no outline here: it may be anywhere.
        behind = n_ahead < 3
        low[behind], high[behind] = -np.inf, np.inf
        candidates = np.flatnonzero(n_ahead)
        if len(candidates) < len(facets):
            low, high = low[candidates], high[candidates]
        place = rays[mine][:, others] / np.abs(rays[mine, depth_axis])[:, None]
        _halve(vertices, facets, rays, distance, facet, mine, place, candidates, low, high)
    return distance, facet


def _halve(vertices: np.ndarray, facets: np.ndarray, rays: np.ndarray, distance: np.ndarray, facet: np.ndarray,
           mine: np.ndarray, place: np.ndarray, candidates: np.ndarray, low: np.ndarray, high: np.ndarray) -> None:
    """Intersect these rays with the candidates whose boxes they touch, halving both while they are many."""
    # Beyond round-off of the projection: no facet is lost at its box's edge.
    margin = 1e-9
    touched = ((low <= place.max(axis=0) + margin) & (high >= place.min(axis=0) - margin)).all(axis=1)
    candidates, low, high = candidates[touched], low[touched], high[touched]
    if not len(candidates):
        return
    if len(mine) > 1 and len(mine) * len(candidates) > _MAX_PAIRS:
        order = np.argsort(place[:, np.argmax(np.ptp(place, axis=0))])
        for half in np.array_split(order, 2):
            _halve(vertices, facets, rays, distance, facet, mine[half], place[half], candidates, low, high)
        return
    # An axis at a time: over pairs of columns NumPy takes three times as long.
    (x, y), (x0, y0), (x1, y1) = (np.ascontiguousarray(each.T) for each in (place, low - margin, high + margin))
    x, y = x[:, None], y[:, None]
    ray, near = np.nonzero((x0 <= x) & (x <= x1) & (y0 <= y) & (y <= y1))
    ray, near = mine[ray], candidates[near]
    t = distances([vertices.take(corner, axis=0).T for corner in facets[near].T], rays[ray].T)
    # Of each ray the nearest first; of two as near the first of the shape.
    order = np.lexsort((t, ray))
    order = order[np.diff(ray[order], prepend=-1) > 0]
    hit = order[t[order] < distance[ray[order]]]
    distance[ray[hit]], facet[ray[hit]] = t[hit], near[hit]
