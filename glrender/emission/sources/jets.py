"""Jets: cones of dust from places on the surface."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from glrender_camera.validate import positive, vector, within

from ...base.errors import ConfigError
from ...engines.rays.exact_rays import exact_mesh
from ...scene.shape.shape import Shape
from .activity import Activity
from .source import EVERYWHERE


@dataclass(frozen=True, kw_only=True, eq=False)
class Jet:
    """A cone from a vent.

    Parameters
    ----------
    vent_m : (3,) float64 [m]
        On the surface, body-fixed.
    normal : (3,) float64 [1]
        Normal of the surface there: it decides the local time.
    axis : (3,) float64 [1]
    weight_m : float [m], > 0
        Mean over all directions of K, fully active.
    half_width_deg : float [deg], 0.5..80
        Angle off the axis at which the density is half of the axis'.
    collimation : float [1], 1..8
        exp(-ln 2 (angle / half width)^(2 collimation)): 1 is a Gaussian, more has a sharper edge.
    vent_radius_m : float [m], > 0
        The cone has this radius at the surface, so that its density there is finite.
    """

    vent_m: np.ndarray
    normal: np.ndarray
    axis: np.ndarray
    weight_m: float
    half_width_deg: float
    vent_radius_m: float
    collimation: float = 1.0

    def __post_init__(self):
        for name in ("vent_m", "normal", "axis"):
            object.__setattr__(self, name, vector(name, getattr(self, name)))
        for name in ("normal", "axis"):
            length = float(np.linalg.norm(getattr(self, name)))
            if not length > 0.0:
                raise ConfigError(name, "must not be zero", getattr(self, name).tolist())
            object.__setattr__(self, name, getattr(self, name) / length)
        positive("weight_m", self.weight_m)
        positive("vent_radius_m", self.vent_radius_m)
        within("half_width_deg", self.half_width_deg, 0.5, 80.0)
        within("collimation", self.collimation, 1.0, 8.0)

    def profile(self, angle_rad: np.ndarray) -> np.ndarray:
        """Density [1] off the axis, over the axis'."""
        return np.exp(-math.log(2.0) * (angle_rad / math.radians(self.half_width_deg)) ** (2.0 * self.collimation))

    def weight(self, r_m: np.ndarray) -> np.ndarray:
        """K (N,) [m] at points (N, 3) [m]."""
        depth = self.vent_radius_m / math.tan(math.radians(self.half_width_deg))
        offset = r_m - (self.vent_m - depth * self.axis)
        distance = np.maximum(np.linalg.norm(offset, axis=-1), 0.5 * depth)
        along = offset @ self.axis
        angle = np.arccos(np.clip(along / distance, -1.0, 1.0))
        squared = np.sum(r_m**2, axis=-1)
        # Behind the vent there is none: it fades in over half of the way from the cone's tip.
        fade = np.clip(2.0 * along / depth - 1.0, 0.0, 1.0)
        return self._axis_weight() * self.profile(angle) * squared / distance**2 * fade

    def _axis_weight(self) -> float:
        # Beyond eight half widths a Gaussian has 5e-20 of its axis; behind the vent is none.
        nodes, weights = np.polynomial.legendre.leggauss(64)
        half = 0.5 * min(0.5 * math.pi, 8.0 * math.radians(self.half_width_deg))
        angle = half * (nodes + 1.0)
        return self.weight_m * 2.0 / float(np.sum(half * weights * self.profile(angle) * np.sin(angle)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Jets:
    """Several jets.

    Parameters
    ----------
    jets : sequence of Jet
    activity : Activity
    """

    jets: Sequence[Jet]
    activity_law: Activity = field(default_factory=Activity)
    reach_m: float = EVERYWHERE

    most_directions = 192

    @property
    def feature_rad(self) -> float:
        """Half width of the narrowest, less for a sharper edge."""
        return min(math.radians(jet.half_width_deg) / jet.collimation for jet in self.jets)

    def components(self, r_m: np.ndarray) -> np.ndarray:
        """K (C, N) [m] of each jet at points (N, 3) [m]."""
        inside = np.linalg.norm(r_m, axis=-1) <= self.reach_m
        return np.stack([np.where(inside, jet.weight(r_m), 0.0) for jet in self.jets])

    def activity(self, sun_direction_body: np.ndarray) -> np.ndarray:
        """(C,) [1]."""
        return self.activity_law(np.stack([jet.normal for jet in self.jets]), sun_direction_body)


def surface_point(shape: Shape, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The outermost point (3,) [m] of a surface in a direction from the origin, and its facet's normal (3,).

    Raises
    ------
    ConfigError
        Nothing is there.
    """
    # From outside, so that the first place is the outermost.
    start_m = 2.0 * float(np.linalg.norm(shape.vertices_m, axis=1).max())
    (facet,), (distance_m,) = exact_mesh(shape).hit(start_m * direction, -direction[None])
    if not distance_m < start_m:
        raise ConfigError("longitude_deg", "no surface in this direction from the body's origin", direction.tolist())
    return (start_m - distance_m) * direction, shape.facet_normals[facet]
