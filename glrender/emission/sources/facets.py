"""Dust from the whole surface, each facet with its own strength: from noise, or from a table."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from glrender_camera.validate import integer, positive, within

from ...base.errors import ConfigError
from ...scene.shape.shape import Shape
from ..fields import octahedral_from_direction
from .activity import Activity
from .source import EVERYWHERE

# Facets are summed up in patches by direction from the origin: that many along the map's side.
_PATCHES = 20
# Facets in one cell of that many along the body's half side are one.
_CLUSTERS = 14
_CHUNK = 512


@dataclass(frozen=True, kw_only=True, eq=False)
class Facets:
    """Each facet sends dust along its normal: its K is S A cos(angle)^spread r^2 / d^2.

    Parameters
    ----------
    shape : Shape
    strength : (F,) float [1], >= 0
        S of each facet, of any scale; kept over the greatest.
    weight_m : float [m], > 0
        Mean of K over all directions, far off, when all is fully active.
    spread : float [1], 1..20
        1 is a cosine; more is narrower.
    activity_law : Activity
    """

    shape: Shape
    strength: np.ndarray
    weight_m: float
    spread: float = 1.0
    activity_law: Activity = field(default_factory=Activity)

    reach_m = EVERYWHERE
    # Sums over all facets are dear: what a patch sends is never narrower than this resolves.
    most_directions = 32

    def __post_init__(self):
        positive("weight_m", self.weight_m)
        within("spread", self.spread, 1.0, 20.0)
        strength = np.asarray(self.strength, np.float64)
        count = len(self.shape.facets)
        if strength.shape != (count,):
            raise ConfigError("strength", f"must have one number for each of the {count} facets", strength.shape)
        if not (np.isfinite(strength).all() and strength.min() >= 0.0 and strength.max() > 0.0):
            raise ConfigError("strength", "must be finite and >= 0, and > 0 somewhere")
        strength = strength / strength.max()
        object.__setattr__(self, "strength", strength)
        put = lambda name, value: object.__setattr__(self, name, value)  # noqa: E731 (frozen dataclass)
        area, centre, normal, power = _clusters(self.shape, strength)
        cell = np.minimum((octahedral_from_direction(centre) * _PATCHES).astype(int), _PATCHES - 1)
        _, patch = np.unique(cell @ (1, _PATCHES), return_inverse=True)
        order = np.argsort(patch, kind="stable")
        put("_starts", np.searchsorted(patch[order], np.arange(patch.max() + 1)))
        put("_area", area[order])
        put("_centre", centre[order])
        put("_normal", normal[order])
        # All directions of a facet's cos^spread: 2 pi / (spread + 1) of the 4 pi.
        put("_scale", (power * 2.0 * (self.spread + 1.0) * self.weight_m / power.sum())[order])
        total = np.add.reduceat(power[order][:, None] * self._normal, self._starts)
        put("_patch_normal", total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300))

    @property
    def feature_rad(self) -> float:
        """Dust of one facet spreads over this angle, whatever lies next to it."""
        return 0.5 / np.sqrt(self.spread)

    def components(self, r_m: np.ndarray) -> np.ndarray:
        """K (C, N) [m] of each patch at points (N, 3) [m]."""
        made = np.empty((len(self._starts), len(r_m)), np.float32)
        along_own = np.einsum("ij,ij->i", self._normal, self._centre)
        centre_squared = np.sum(self._centre**2, axis=1)
        for start in range(0, len(r_m), _CHUNK):
            r = r_m[start:start + _CHUNK]
            squared = np.sum(r**2, axis=1)
            # |r - centre|^2 is at least a facet's area: a facet has a size.
            apart = np.maximum(squared - 2.0 * self._centre @ r.T + centre_squared[:, None], self._area[:, None])
            cosine = np.maximum(self._normal @ r.T - along_own[:, None], 0.0) / np.sqrt(apart)
            value = self._scale[:, None] * cosine**self.spread * squared / apart
            made[:, start:start + _CHUNK] = np.add.reduceat(value, self._starts)
        return made

    def activity(self, sun_direction_body: np.ndarray) -> np.ndarray:
        """(C,) [1], by the mean normal of each patch."""
        return self.activity_law(self._patch_normal, sun_direction_body)


def _clusters(shape: Shape, strength: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Areas (C,) [m2], centres (C, 3) [m], normals (C, 3) and powers (C,) of facets close together, as one each."""
    area, centre = shape.facet_areas_m2, shape.vertices_m[shape.facets].mean(axis=1)
    power = strength * area
    cells = np.floor(centre / np.abs(shape.vertices_m).max() * _CLUSTERS).astype(np.int64) + _CLUSTERS + 1
    _, index = np.unique(cells @ np.array([1, 4096, 4096**2]), return_inverse=True)
    added = lambda values: np.bincount(index, weights=values)  # noqa: E731
    total = np.maximum(added(power), 1e-300)
    # Weighted by power: the area of a facet without strength must not shape the cluster.
    mean = lambda vectors: np.stack([added(power * vectors[:, k]) for k in range(3)], axis=1) / total[:, None]  # noqa: E731
    facing = mean(shape.facet_normals)
    length = np.linalg.norm(facing, axis=1, keepdims=True)
    kept = (added(power) > 0.0) & (length[:, 0] > 1e-9)
    return (added(area)[kept], mean(centre)[kept], (facing / np.maximum(length, 1e-9))[kept], added(power)[kept])


def noise_strength(shape: Shape, seed: int, roughness: float = 3.0, contrast: float = 2.0) -> np.ndarray:
    """Strengths (F,) [1] with patches of activity: exp(contrast x smooth noise of unit variance).

    Parameters
    ----------
    shape : Shape
    seed : int
    roughness : float [1], 0.5..32
        Patches along a radius, about.
    contrast : float [1], 0..5
    """
    within("roughness", roughness, 0.5, 32.0)
    within("contrast", contrast, 0.0, 5.0)
    rng = np.random.default_rng(integer("seed", seed, 0, 2**32 - 1))
    centre = shape.vertices_m[shape.facets].mean(axis=1)
    centre = centre / np.linalg.norm(centre, axis=1).max()
    # A sum of waves in random directions is smooth and the same on any mesh of the body.
    waves = rng.normal(size=(64, 3)) * roughness
    noise = np.cos(centre @ waves.T + rng.uniform(0.0, 2.0 * np.pi, 64)).sum(axis=1) / np.sqrt(32.0)
    return np.exp(contrast * noise)
