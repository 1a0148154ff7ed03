"""Estimators by the lit limb: against an ellipsoid's horizon, and against the limb of the believed frame."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from scipy.optimize import least_squares

from .believed import Drawn, Refined, placed
from .camera import Sight, StateLike
from .measurement import N_STRETCHES, Estimator, Measurement, NotFound, lit_pixels

# Smoothing before edges are looked for, and length of the profiles across them.
_SMOOTH_PX = 1.0
_REACH_PX = 4.0
_STEP_PX = 0.25
_LEAST_POINTS = 20
# Below this phase angle terminator and limb are one to 1.5 % of the radius.
_FULL_PHASE_RAD = np.radians(10.0)
# Cosine to the Sun's direction in the image from which an edge is taken for the limb.
_LIMB_COSINE = 0.2
# Width of the stripes towards the Sun in which the foremost point is the limb; least length of an outline over the
# longest one's.
_LANE_PX = 1.0
_LEAST_PIECE = 0.2
# Shades and smoothing move an edge by so much, which no render takes off here.
_SHADING_PX = 0.25
# Times the median distance of the limb's points from the fitted horizon, or the ellipsoid's own error, from which a
# point is no limb of this body.
_FAR = 3.0
_MOST_FITS = 5
# Of the believed range, which an ellipsoid's horizon is helped by: half a limb tells size and place apart badly.
_SIGMA_RANGE = 0.2


class LimbEllipse(Estimator):
    """The lit limb against the horizon of the body's ellipsoid; nothing is rendered.

    How far the shape is from the ellipsoid counts as the limb's error, and the believed range with 20 %.

    Source: Christian and Robinson (2016), Noniterative horizon-based optical navigation by Cholesky factorization.
    """

    name = "limb_ellipse"

    def _measured(self, frame: np.ndarray, believed: StateLike, here: Sight,
                  render: Callable[..., Any]) -> Measurement:
        points_px, _, is_longest = limb_points(frame, here)
        # In these coordinates the ellipsoid is a unit sphere, whose horizon is a circular cone.
        sphere_from_camera = np.linalg.inv(self.body.ellipsoid_m) @ here.camera_from_body.T
        rays = self.camera.direction(points_px) @ sphere_from_camera.T
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        center_m = here.camera_from_body @ self.body.ellipsoid_center_m
        radius_px = self.camera.focal_length_px * self.body.mean_radius_m / here.range_m
        error_px = radius_px * self.body.ellipsoid_error_m / self.body.mean_radius_m
        # A stretch of limb is one measurement.
        sigma_px = np.hypot(error_px, _SHADING_PX) * np.sqrt(len(rays) / N_STRETCHES)
        scale_px = radius_px * _to_horizon(sphere_from_camera @ (here.r_body_camera_m + center_m))

        def off(x: np.ndarray, rays: np.ndarray) -> np.ndarray:
            """Residuals [sigmas] of a place [ranges]: from each ray to the horizon, and from the believed range."""
            c = sphere_from_camera @ (here.range_m * x + center_m)
            # By how much a ray passes the unit sphere, of all that touch it at the horizon's distance.
            off_px = scale_px * (rays @ c - _to_horizon(c))
            return np.append(off_px / sigma_px, (np.linalg.norm(x) - 1.0) / _SIGMA_RANGE)

        def slopes(x: np.ndarray, rays: np.ndarray) -> np.ndarray:
            """Derivatives of the residuals with respect to the place."""
            c = sphere_from_camera @ (here.range_m * x + center_m)
            of_c = scale_px / sigma_px * (rays - c / _to_horizon(c))
            return np.vstack([of_c @ (here.range_m * sphere_from_camera), x / (np.linalg.norm(x) * _SIGMA_RANGE)])

        is_limb, x = is_longest | (is_longest.sum() < _LEAST_POINTS), here.r_body_camera_m / here.range_m
        # The limb of another body, before this one or beside it, is far from this one's, and each fit is less astray.
        for _ in range(_MOST_FITS):
            solved = least_squares(off, x, slopes, loss=_soft_but_last, args=(rays[is_limb],))
            off_all, x, fitted = np.abs(off(solved.x, rays)[:-1]), solved.x, is_limb
            is_limb = off_all <= _FAR * max(float(np.median(off_all[fitted])), error_px / sigma_px)
            if np.array_equal(is_limb, fitted):
                break
        place_m = here.range_m * solved.x
        if not place_m[2] > 0.0:
            raise NotFound("the limb's points lie on no horizon before the camera")
        covariance = np.linalg.inv(solved.jac.T @ solved.jac)
        return Measurement.of_place(self.camera, place_m, here.range_m**2 * covariance)


class LimbShape(Estimator):
    """The lit limb against the limb of the believed frame, along its normals: shift and size."""

    name = "limb_shape"

    def _measured(self, frame: np.ndarray, believed: StateLike, here: Sight,
                  render: Callable[..., Any]) -> Measurement:
        smooth = cv2.GaussianBlur(np.asarray(frame, np.float32), (0, 0), _SMOOTH_PX)

        def step(drawn: Drawn, number: int) -> tuple[np.ndarray, np.ndarray]:
            points_px, normals, _ = limb_points(drawn.pixels, drawn.here)
            at_px = points_px + drawn.corner_px
            center_px = self.camera.project(drawn.here.r_body_camera_m)
            radius_px = self.camera.focal_length_px * self.body.mean_radius_m / drawn.here.range_m
            reach_px = _REACH_PX + (0.1 * radius_px if number == 0 else 0.0)
            off_px, is_edge = _crossings(smooth, at_px, normals, reach_px)
            height, width = frame.shape
            is_edge &= ((at_px > _REACH_PX) & (at_px < np.array([width, height]) - 1.0 - _REACH_PX)).all(axis=1)
            if is_edge.sum() < _LEAST_POINTS:
                raise NotFound(f"{is_edge.sum()} edges of the frame are near the believed limb, {_LEAST_POINTS} are "
                               "needed")
            n, arm = normals[is_edge], (at_px[is_edge] - center_px) / radius_px
            rows = np.column_stack([n, np.einsum("ij,ij->i", n, arm)])
            solved = least_squares(lambda x: rows @ x - off_px[is_edge], np.zeros(3), jac=lambda x: rows,
                                   loss="soft_l1", f_scale=0.5)
            range_m = drawn.here.range_m / (1.0 + solved.x[2] / radius_px)
            place_m = placed(self.camera, center_px + solved.x[:2], range_m)
            return place_m, _covariance(rows, rows @ solved.x - off_px[is_edge])

        place_m, covariance_px2 = Refined(frame, believed, self.camera, self.body, render)(step)
        return from_shift(self, place_m, covariance_px2)


def from_shift(estimator: Estimator, place_m: np.ndarray, covariance_px2: np.ndarray) -> Measurement:
    """A measurement of a place (3,) [m]; the covariance (3, 3) [px2] is of shift right, shift down, radius."""
    camera, range_m = estimator.camera, float(np.linalg.norm(place_m))
    per_px = range_m / camera.focal_length_px
    along = range_m * per_px / estimator.body.mean_radius_m
    turn = np.column_stack([per_px * np.array([1.0, 0.0, -place_m[0] / place_m[2]]),
                            per_px * np.array([0.0, 1.0, -place_m[1] / place_m[2]]), -along * place_m / range_m])
    return estimator.placed(place_m, turn @ covariance_px2 @ turn.T)


def limb_points(pixels: np.ndarray, here: Sight) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places (N, 2) [px] of the lit limb to a part of a pixel, its normals (N, 2), and what is of the longest outline.

    Normals point away from the body. Other outlines, (N,) False, may be of other bodies.

    An edge is the limb where its normal points to the Sun's side and nothing lit is before it; at small phase angles
    all round.

    Raises
    ------
    NotFound
    """
    is_lit = (lit_pixels(pixels) > 0.0).astype(np.uint8)
    # Beside what is lit nothing is looked at.
    left, top, wide, high = cv2.boundingRect(is_lit)
    margin, (height, width) = int(4.0 * _REACH_PX), pixels.shape
    x0, y0 = max(left - margin, 0), max(top - margin, 0)
    part = np.s_[y0:top + high + margin, x0:left + wide + margin]
    smooth = cv2.GaussianBlur(np.asarray(pixels[part], np.float32), (0, 0), _SMOOTH_PX)
    contours, _ = cv2.findContours(is_lit[part], cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    # Shadows may part the body; specks of light beyond the terminator tell nothing.
    least = _LEAST_PIECE * max(map(len, contours))
    outlines = [contour.reshape(-1, 2).astype(np.float64) for contour in contours if len(contour) >= least]
    points, normals = np.concatenate(outlines), np.concatenate([_normals(outline) for outline in outlines])
    lengths = [len(outline) for outline in outlines]
    is_longest = np.repeat(np.arange(len(outlines)) == np.argmax(lengths), lengths)
    corner = np.array([x0, y0], float)
    keep = ((points + corner > _REACH_PX) & (points + corner < np.array([width, height]) - 1.0 - _REACH_PX)).all(axis=1)
    if here.phase_rad > _FULL_PHASE_RAD:
        sun = here.sun_direction_camera[:2] / np.linalg.norm(here.sun_direction_camera[:2])
        keep &= (normals @ sun > _LIMB_COSINE) & _foremost(points, sun)
    points, normals, is_longest = points[keep], normals[keep], is_longest[keep]
    off, is_edge = _crossings(smooth, points, normals, _REACH_PX) if len(points) else (None, np.zeros(0, bool))
    if is_edge.sum() < _LEAST_POINTS:
        raise NotFound(f"the lit limb has {is_edge.sum()} edges inside the image, {_LEAST_POINTS} are needed")
    return points[is_edge] + off[is_edge, None] * normals[is_edge] + corner, normals[is_edge], is_longest[is_edge]


def _to_horizon(place: np.ndarray) -> float:
    """Distance from a place (3,) to the horizon of the unit sphere."""
    return float(np.sqrt(max(place @ place - 1.0, 1e-6)))


def _soft_but_last(squares: np.ndarray) -> np.ndarray:
    """Loss of `least_squares` that is soft_l1 for all rows but the last, the believed range's."""
    t = 1.0 + squares
    loss = np.stack([2.0 * (np.sqrt(t) - 1.0), 1.0 / np.sqrt(t), -0.5 * t**-1.5])
    loss[:, -1] = squares[-1], 1.0, 0.0
    return loss


def _normals(outline: np.ndarray) -> np.ndarray:
    """Unit normals (N, 2) of a closed outline (N, 2), away from its inside.

    They are the outline's own, over some pixels: gradients of light follow shades as well.
    """
    reach = max(1, min(6, len(outline) // 12))
    tangent = np.roll(outline, -reach, axis=0) - np.roll(outline, reach, axis=0)
    normals = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    x, y = outline.T
    # The sign of the outline's area tells which way round it goes.
    return normals * -np.sign(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def _foremost(points: np.ndarray, sun: np.ndarray) -> np.ndarray:
    """Which of the outlines' points (N, 2) [px] the Sun's direction (2,) in the image meets first."""
    lane = np.floor(points @ [-sun[1], sun[0]] / _LANE_PX).astype(int)
    lane -= lane.min()
    ahead = np.full(lane.max() + 1, -np.inf)
    np.maximum.at(ahead, lane, points @ sun)
    # An outline that is steep to the Sun changes by some pixels within a lane.
    return points @ sun > ahead[lane] - 4.0 * _LANE_PX


def _crossings(smooth: np.ndarray, points: np.ndarray, normals: np.ndarray,
               reach_px: float) -> tuple[np.ndarray, np.ndarray]:
    """How far [px] along normals the light falls to half of what it is inside, coming from outside; and where it does.

    Inside is the light three to five smoothing lengths behind the edge.
    """
    t = np.arange(-reach_px, reach_px + 0.5 * _STEP_PX, _STEP_PX)
    at = (points[:, None] + t[:, None] * normals[:, None]).astype(np.float32)
    profile = cv2.remap(smooth, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    sky = np.quantile(smooth[::4, ::4], 0.05)
    profile = profile - sky
    # The steepest fall, then half of the light behind it.
    fall = profile[:, :-1] - profile[:, 1:]
    behind = int(round(2.5 * _SMOOTH_PX / _STEP_PX))
    steepest = fall.argmax(axis=1)
    rows = np.arange(len(points))
    inside = profile[rows, np.maximum(steepest - behind, 0)]
    outside = profile[rows, np.minimum(steepest + behind, len(t) - 1)]
    level = 0.5 * (inside + outside)
    is_below = (profile < level[:, None]) & (np.arange(len(t)) > np.maximum(steepest - behind, 0)[:, None])
    last = is_below.argmax(axis=1)
    before, after = profile[rows, np.maximum(last - 1, 0)], profile[rows, last]
    share = (before - level) / np.maximum(before - after, 1e-12 * max(float(np.abs(profile).max()), 1e-300))
    bright = 0.05 * float(np.quantile(smooth[::2, ::2], 0.99) - sky)
    is_edge = is_below.any(axis=1) & (last > 0) & (inside > bright) & (outside < 0.3 * inside)
    return t[np.maximum(last - 1, 0)] + share * _STEP_PX, is_edge


def _covariance(jacobian: np.ndarray, off_px: np.ndarray) -> np.ndarray:
    """Covariance of a fit whose residuals [px] are alike over stretches of limb."""
    variance = float((1.4826 * np.median(np.abs(off_px)))**2) + 0.02**2
    return variance * len(off_px) / N_STRETCHES * np.linalg.inv(jacobian.T @ jacobian)
