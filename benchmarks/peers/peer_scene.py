"""A scene as a peer takes it: triangles in the camera's frame, one Sun direction, Lambert. Needs numpy only.

The camera stands at the origin, +Z boresight, +X right, +Y down; lengths are in units of the
farthest body's range, so that float32 programs keep their digits.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True, kw_only=True, eq=False)
class PeerScene:
    """The scene that every peer gets.

    Attributes
    ----------
    width_px, height_px : int
    focal_length_px : float
    principal_point_px : (2,) float64
        (0, 0) is the centre of the top-left pixel.
    vertices : (V, 3) float64
        Camera frame, in units of `unit_m`.
    facets : (F, 3) int32
    normal_albedo : (F,) float64 [1]
        Of each facet: BRDF = albedo / pi.
    to_sun : (3,) float64
        Unit vector, camera frame.
    solar_irradiance_W_m2 : float
        At the bodies.
    """

    width_px: int
    height_px: int
    focal_length_px: float
    principal_point_px: np.ndarray
    vertices: np.ndarray
    facets: np.ndarray
    normal_albedo: np.ndarray
    to_sun: np.ndarray
    solar_irradiance_W_m2: float

    def save(self, path: Path) -> None:
        np.savez(path, **self.__dict__)

    @classmethod
    def load(cls, path: Path) -> PeerScene:
        with np.load(path) as stored:
            return cls(**{name: stored[name] if stored[name].ndim else stored[name].item() for name in stored.files})

    @property
    def facet_normals(self) -> np.ndarray:
        """(F, 3) float64, outward, unit length."""
        a, b, c = (self.vertices[self.facets[:, k]] for k in range(3))
        normals = np.cross(b - a, c - a)
        return normals / np.linalg.norm(normals, axis=1, keepdims=True)

    def pixel_rays(self, dx: float = 0.0, dy: float = 0.0,
                   region: tuple[int, int, int, int] | None = None) -> np.ndarray:
        """(H, W, 3) float64 unit vectors through the centres of a region's pixels, moved by (dx, dy) px."""
        x0, y0, x1, y1 = region or (0, 0, self.width_px, self.height_px)
        cx, cy = self.principal_point_px
        rays = np.empty((y1 - y0, x1 - x0, 3))
        rays[..., 0] = np.arange(x0, x1) + (dx - cx)
        rays[..., 1] = (np.arange(y0, y1) + (dy - cy))[:, None]
        rays[..., 2] = self.focal_length_px
        return rays / np.linalg.norm(rays, axis=-1, keepdims=True)

    def solid_angle_sr(self) -> np.ndarray:
        """(H, W) float64 of each pixel."""
        return self.pixel_rays()[..., 2] ** 3 / self.focal_length_px**2

    def region_px(self, margin_px: float = 1.0) -> tuple[int, int, int, int]:
        """x0, y0, x1, y1 of the pixels that the triangles may touch, one past the last."""
        depth = self.vertices[:, 2]
        if depth.min() <= 0.0:
            return (0, 0, self.width_px, self.height_px)
        place = self.vertices[:, :2] / depth[:, None] * self.focal_length_px + self.principal_point_px
        low = np.clip(np.floor(place.min(axis=0) - margin_px), 0, (self.width_px, self.height_px))
        high = np.clip(np.ceil(place.max(axis=0) + margin_px) + 1, 0, (self.width_px, self.height_px))
        return tuple(int(x) for x in (*low, *high))

    @property
    def depth_range(self) -> tuple[float, float]:
        """Nearest (at least a thousandth of the farthest) and farthest depth."""
        farthest = float(self.vertices[:, 2].max())
        return max(float(self.vertices[:, 2].min()), 1e-3 * farthest), farthest
