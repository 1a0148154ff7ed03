"""On-board knowledge of a body: its name, mean radius and ellipsoid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True, eq=False)
class BelievedBody:
    """A body as the on-board software has it.

    Parameters
    ----------
    name : str
        In the believed states.
    mean_radius_m : float [m]
        Of the disc that the body covers on average.
    ellipsoid_m : (3, 3) float [m], optional
        Columns are the semi-axes of the ellipsoid that stands for it, in `body`; by default a sphere's.
    ellipsoid_center_m : (3,) float [m], optional
        In `body`.
    shape_error_m : float [m], optional
        Standard deviation of the believed shape's surface, as mapping tells it; by default 0.5 % of the mean radius.
    ellipsoid_error_m : float [m], optional
        RMS distance of the surface from the ellipsoid; by default a twentieth of the mean radius.
    bounding_radius_m : float [m], optional
        Of the sphere about the origin that holds the body; by default three mean radii.
    """

    name: str
    mean_radius_m: float
    ellipsoid_m: np.ndarray | None = None
    ellipsoid_center_m: np.ndarray = (0.0, 0.0, 0.0)
    shape_error_m: float | None = None
    ellipsoid_error_m: float | None = None
    bounding_radius_m: float | None = None

    def __post_init__(self):
        if not self.mean_radius_m > 0.0:
            raise ValueError(f"mean_radius_m: must be > 0, got {self.mean_radius_m!r}")
        axes = self.mean_radius_m * np.eye(3) if self.ellipsoid_m is None else np.asarray(self.ellipsoid_m, float)
        object.__setattr__(self, "ellipsoid_m", axes)
        object.__setattr__(self, "ellipsoid_center_m", np.asarray(self.ellipsoid_center_m, float))
        for name, share in (("shape_error_m", 0.005), ("ellipsoid_error_m", 0.05), ("bounding_radius_m", 3.0)):
            if getattr(self, name) is None:
                object.__setattr__(self, name, share * self.mean_radius_m)

    @classmethod
    def from_mesh(cls, name: str, vertices_m: np.ndarray, facets: np.ndarray) -> BelievedBody:
        """The body of a closed shape: vertices (V, 3) float [m], facets (F, 3) int.

        The mean radius is of a quarter of the surface (Cauchy), the ellipsoid has the moments of the volume.
        """
        a, b, c = np.moveaxis(np.asarray(vertices_m, float)[facets], 1, 0)
        area_m2 = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
        # Tetrahedra between the facets and the origin.
        volume = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0
        total, corners = volume.sum(), a + b + c
        center = volume @ corners / 4.0 / total
        second = sum(np.einsum("i,ij,ik->jk", volume, x, x) for x in (a, b, c, corners)) / 20.0 / total
        squares, axes = np.linalg.eigh(5.0 * (second - np.outer(center, center)))
        ellipsoid_m = axes * np.sqrt(squares)
        arm_m = vertices_m - center
        height_m = np.linalg.norm(arm_m, axis=1) * (1.0 - 1.0 / np.linalg.norm(arm_m @ np.linalg.inv(ellipsoid_m).T,
                                                                               axis=1))
        return cls(name=name, mean_radius_m=float(np.sqrt(area_m2 / (4.0 * np.pi))), ellipsoid_m=ellipsoid_m,
                   ellipsoid_center_m=center, ellipsoid_error_m=float(np.sqrt(np.mean(height_m**2))),
                   bounding_radius_m=float(np.linalg.norm(vertices_m, axis=1).max()))
