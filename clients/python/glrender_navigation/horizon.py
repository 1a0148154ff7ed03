"""Estimator by the lit limb against an ellipsoid's horizon."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from .body import BelievedBody
from .camera import Camera, Sight, StateLike, others_px
from .limb import LEAST_POINTS, is_limb_there, limb_points
from .measurement import N_STRETCHES, Estimator, Measurement, NotFound, is_anothers

# A Lambert sphere at full phase loses 0.6 px of its limb to its shades, at other phases less; no render takes them off.
_SHADING_PX = 0.3
# Standard deviation over the believed range [1] by which that helps an ellipsoid's horizon, as half a limb separates
# size and place badly; and the farthest that a horizon may be from the believed range.
_SIGMA_RANGE = 0.2
_FARTHEST = 3.0 * _SIGMA_RANGE
# Horizons through three edges each that are tried, edges that are counted on each, and points of its own outline.
_N_TRIED, _N_COUNTED, _N_OUTLINE = 400, 200, 64
# An edge is of a horizon within the ellipsoid's own error, or within so many pixels, and where the outline's normal is
# the horizon's within 45 degrees.
_NEAR_PX = 1.5
_ALONG = np.cos(np.radians(45.0))
# Share of a horizon's lit limb in the image that must be found.
_LEAST_SHARE = 0.3
# Times the median distance of the limb's points from the fitted horizon, or the ellipsoid's own error, from which a
# point is no limb of this body.
_FAR = 3.0
_MOST_FITS = 5


class LimbEllipse(Estimator):
    """The lit limb against the horizon of the body's ellipsoid; nothing is rendered.

    Edges of other bodies are left out before the fit: the horizon that is nearest to all that a limb shows, and to
    nothing else, is found by trial (RANSAC). How far the shape is from the ellipsoid counts as the limb's error, and
    the believed range with 20 %.

    Source: Christian and Robinson (2016), Noniterative horizon-based optical navigation by Cholesky factorization.
    """

    name = "limb_ellipse"

    def _measured(self, frame: np.ndarray, believed: StateLike, here: Sight,
                  render: Callable[..., Any]) -> Measurement:
        points_px, normals = limb_points(frame, here)
        horizons = _Horizons(self.camera, self.body, here)
        others = others_px(believed, self.camera, self.body.name)
        is_limb, first_m = horizons.agreed(points_px, normals, others)
        rays, x = horizons.rays(points_px), first_m / here.range_m
        # A stretch of the outline is one measurement; shades move all of the limb alike.
        n_alike = 2.0 * np.pi * horizons.radius_px / N_STRETCHES
        sigma_px = np.hypot(horizons.error_px * np.sqrt(n_alike), _SHADING_PX * np.sqrt(is_limb.sum()))
        scale_px = horizons.radius_px * float(_to_horizon(horizons.centers(first_m)))

        def off(x: np.ndarray, rays: np.ndarray) -> np.ndarray:
            """Residuals [sigmas] of a place [ranges]: from each ray to the horizon, and from the believed range."""
            c = horizons.centers(here.range_m * x)
            # By how much a ray passes the unit sphere, of all that touch it at the horizon's distance.
            return np.append(scale_px / sigma_px * (rays @ c - _to_horizon(c)),
                             (np.linalg.norm(x) - 1.0) / _SIGMA_RANGE)

        def slopes(x: np.ndarray, rays: np.ndarray) -> np.ndarray:
            """Derivatives of the residuals with respect to the place."""
            c = horizons.centers(here.range_m * x)
            of_c = scale_px / sigma_px * (rays - c / _to_horizon(c))
            return np.vstack([of_c @ (here.range_m * horizons.sphere_from_camera),
                              x / (np.linalg.norm(x) * _SIGMA_RANGE)])

        for _ in range(_MOST_FITS):
            solved = least_squares(off, x, slopes, loss=_soft_but_last, args=(rays[is_limb],))
            off_all, x, fitted = np.abs(off(solved.x, rays)[:-1]), solved.x, is_limb
            spread = max(float(np.median(off_all[fitted])), max(horizons.error_px, _SHADING_PX) / sigma_px)
            is_limb = fitted & (off_all <= _FAR * spread)
            if np.array_equal(is_limb, fitted):
                break
        place_m = here.range_m * solved.x
        if not place_m[2] > 0.0:
            raise NotFound("the limb's points lie on no horizon before the camera")
        covariance = np.linalg.inv(solved.jac.T @ solved.jac)
        return Measurement.of_place(self.camera, place_m, here.range_m**2 * covariance)


class _Horizons:
    """Horizons of a body's ellipsoid at places (K, 3) [m] in `camera`.

    Lines of sight are taken into coordinates where the ellipsoid is a unit sphere, whose horizon is a circular cone.
    """

    def __init__(self, camera: Camera, body: BelievedBody, here: Sight):
        self._camera, self._here, self._size_px = camera, here, (camera.width_px, camera.height_px)
        self.sphere_from_camera = np.linalg.inv(body.ellipsoid_m) @ here.camera_from_body.T
        self._center_m = here.camera_from_body @ body.ellipsoid_center_m
        self.radius_px = camera.focal_length_px * body.mean_radius_m / here.range_m
        self.error_px = self.radius_px * body.ellipsoid_error_m / body.mean_radius_m

    def rays(self, points_px: np.ndarray) -> np.ndarray:
        """Unit vectors (N, 3) of the sphere's coordinates towards pixels (N, 2)."""
        rays = self._camera.direction(points_px) @ self.sphere_from_camera.T
        return rays / np.linalg.norm(rays, axis=1, keepdims=True)

    def centers(self, places_m: np.ndarray) -> np.ndarray:
        """The sphere's centres (..., 3), for the body's places (..., 3) [m]."""
        return (places_m + self._center_m) @ self.sphere_from_camera.T

    def agreed(self, points_px: np.ndarray, normals: np.ndarray,
               others: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Which edges (N,) lie on the horizon that agrees best with them, and the place (3,) [m] of that.

        Raises
        ------
        NotFound
            None is of the body's size and at its place, or shows enough of its limb.
        """
        rays, n = self.rays(points_px), len(points_px)
        places_m = self._tried(rays, others)
        if not len(places_m):
            raise NotFound("no horizon of the body's size is among the limb's edges")
        expected_px = self._lit_px(places_m)
        every = max(n // _N_COUNTED, 1)
        found = every * self._is_near(places_m, rays[::every], normals[::every]).sum(axis=1)
        size = np.linalg.norm(places_m, axis=1) / self._here.range_m - 1.0
        best = (found / (expected_px + n - found) * np.exp(-0.5 * np.square(size / _SIGMA_RANGE))).argmax()
        is_limb = self._is_near(places_m[best:best + 1], rays, normals)[0]
        if is_limb.sum() < max(LEAST_POINTS, _LEAST_SHARE * expected_px[best]):
            raise NotFound(f"{is_limb.sum()} of {n} edges lie on one horizon of the body's size, of which "
                           f"{expected_px[best]:.0f} px are lit; {LEAST_POINTS} and {_LEAST_SHARE:.0%} are needed")
        return is_limb, places_m[best]

    def _tried(self, rays: np.ndarray, others: dict[str, np.ndarray]) -> np.ndarray:
        """Places (K, 3) [m] of horizons through three rays each, but for those of another size or body."""
        here, three = self._here, rays[np.random.default_rng(len(rays)).integers(0, len(rays), (_N_TRIED, 3))]
        three = three[np.abs(np.linalg.det(three)) > 1e-12]
        # u . w = 1 for each ray u to the horizon of a unit sphere at c, of w = c / sqrt(c . c - 1).
        w = np.linalg.solve(three, np.ones((len(three), 3, 1)))[..., 0]
        square = np.einsum("ij,ij->i", w, w)
        c = w[square > 1.0] / np.sqrt(square[square > 1.0] - 1.0)[:, None]
        places_m = np.vstack([here.r_body_camera_m, c @ np.linalg.inv(self.sphere_from_camera).T - self._center_m])
        is_size = np.abs(np.linalg.norm(places_m, axis=1) / here.range_m - 1.0) < _FARTHEST
        places_m = places_m[is_size & (places_m[:, 2] > 0.0)]
        project = self._camera.project
        return places_m[~is_anothers(project(places_m), project(here.r_body_camera_m), others, self.radius_px)]

    def _is_near(self, places_m: np.ndarray, rays: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Which rays (N, 3) touch the horizons of places (K, 3), with its normals: (K, N)."""
        c = self.centers(places_m)
        far = _to_horizon(c)[:, None]
        off_px = self.radius_px * far * (c @ rays.T - far)
        outward = ((rays[None] - c[:, None] / far[..., None]) @ self.sphere_from_camera)[..., :2]
        along = np.einsum("ijk,jk->ij", outward, normals) / np.maximum(np.linalg.norm(outward, axis=2), 1e-12)
        return (np.abs(off_px) < max(self.error_px, _NEAR_PX)) & (along > _ALONG)

    def _lit_px(self, places_m: np.ndarray) -> np.ndarray:
        """Length (K,) [px] of the lit limb that horizons have in the image."""
        c = self.centers(places_m)
        square = np.einsum("ij,ij->i", c, c)[:, None, None]
        across = np.linalg.svd(c[:, None])[2][:, 1:]
        turn = np.linspace(0.0, 2.0 * np.pi, _N_OUTLINE, endpoint=False)
        ring = np.stack([np.cos(turn), np.sin(turn)], axis=1) @ across
        outline = (1.0 - 1.0 / square) * c[:, None] + np.sqrt(np.maximum(1.0 - 1.0 / square, 0.0)) * ring
        at_px = self._camera.project(outline @ np.linalg.inv(self.sphere_from_camera).T)
        tangent = 0.5 * (np.roll(at_px, -1, axis=1) - np.roll(at_px, 1, axis=1))
        length = np.linalg.norm(tangent, axis=2)
        normals = np.stack([tangent[..., 1], -tangent[..., 0]], axis=-1) / np.maximum(length, 1e-9)[..., None]
        arm = at_px - at_px.mean(axis=1, keepdims=True)
        normals *= np.sign(np.einsum("ijk,ijk->ij", normals, arm))[..., None]
        return (length * is_limb_there(at_px, normals, self._here, self._size_px)).sum(axis=1)


def _to_horizon(places: np.ndarray) -> np.ndarray:
    """Distances (...) from places (..., 3) to the horizon of the unit sphere."""
    return np.sqrt(np.maximum(np.square(places).sum(axis=-1) - 1.0, 1e-6))


def _soft_but_last(squares: np.ndarray) -> np.ndarray:
    """Loss of `least_squares` that is soft_l1 for all rows but the last, the believed range's."""
    t = 1.0 + squares
    loss = np.stack([2.0 * (np.sqrt(t) - 1.0), 1.0 / np.sqrt(t), -0.5 * t**-1.5])
    loss[:, -1] = squares[-1], 1.0, 0.0
    return loss
