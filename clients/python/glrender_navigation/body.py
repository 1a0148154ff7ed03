"""On-board knowledge of a body: its name, mean radius and ellipsoid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .checks import array, number, refuse

# Least volume of a closed shape, over its surface to the power of 1.5; a sphere has 0.094.
_LEAST_VOLUME = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class BelievedBody:
    """A body as the on-board software has it.

    Parameters
    ----------
    name : str
        In the believed states.
    mean_radius_m : float [m]
        Radius of the disc that the body covers on average.
    ellipsoid_m : (3, 3) float [m], optional
        Columns are the semi-axes of the ellipsoid that stands for it, in `body`; by default a sphere's.
    ellipsoid_center_m : (3,) float [m], optional
        In `body`.
    shape_error_m : float [m], optional
        Standard deviation of the believed shape's surface, by mapping; by default 0.5 % of the mean radius.
    ellipsoid_error_m : float [m], optional
        RMS distance of the surface from the ellipsoid; by default a twentieth of the mean radius.
    bounding_radius_m : float [m], optional
        Radius of the sphere about the origin that holds the body; by default three mean radii.

    Raises
    ------
    ValueError
        With the field: a radius that is not above zero, an error below it, or a value that is no number.
    """

    name: str
    mean_radius_m: float
    ellipsoid_m: np.ndarray | None = None
    ellipsoid_center_m: np.ndarray = (0.0, 0.0, 0.0)
    shape_error_m: float | None = None
    ellipsoid_error_m: float | None = None
    bounding_radius_m: float | None = None

    def __post_init__(self):
        radius_m = number("mean_radius_m", self.mean_radius_m, "give metres")
        axes = radius_m * np.eye(3) if self.ellipsoid_m is None else array("ellipsoid_m", self.ellipsoid_m, (3, 3),
                                                                           "columns are the semi-axes")
        if not np.linalg.matrix_rank(axes) == 3:
            raise refuse("ellipsoid_m", "must have three semi-axes that span space", axes, "leave out for a sphere")
        object.__setattr__(self, "ellipsoid_m", axes)
        object.__setattr__(self, "ellipsoid_center_m",
                           array("ellipsoid_center_m", self.ellipsoid_center_m, (3,), "give x, y and z"))
        for name, share in (("shape_error_m", 0.005), ("ellipsoid_error_m", 0.05), ("bounding_radius_m", 3.0)):
            value = getattr(self, name)
            object.__setattr__(self, name, share * radius_m if value is None else number(
                name, value, "leave out for the default", is_zero_allowed=name != "bounding_radius_m"))

    @classmethod
    def from_mesh(cls, name: str, vertices_m: np.ndarray, facets: np.ndarray) -> BelievedBody:
        """The body of a closed shape: vertices (V, 3) float [m], facets (F, 3) int.

        The mean radius is of a quarter of the surface (Cauchy), the ellipsoid has the moments of the volume.

        Raises
        ------
        ValueError
            A vertex that is no number, a facet of vertices that are not there, or a shape that encloses no volume.
        """
        vertices_m = array("vertices_m", vertices_m, (None, 3), "give metres, a row for each vertex")
        indices = array("facets", facets, (None, 3), "give three vertex numbers from 0 for each facet")
        facets = indices.astype(int)
        if (bad := (facets != indices) | (facets < 0) | (facets >= len(vertices_m))).any():
            raise refuse("facets", f"must be integers from 0 to {len(vertices_m) - 1}, one for each vertex",
                         indices[bad][0].item(), "files count some vertices from 1: subtract it")
        a, b, c = np.moveaxis(vertices_m[facets], 1, 0)
        area_m2 = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
        # Tetrahedra between the facets and the origin.
        volume = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0
        total, corners = volume.sum(), a + b + c
        if not abs(total) > _LEAST_VOLUME * area_m2**1.5:
            raise refuse("facets", "must enclose a volume", float(total), "give a closed shape that turns outwards")
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
