"""The lit limb of a frame, and the estimator that compares it with the limb of the believed frame."""

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
LEAST_POINTS = 20
"""Edges that a limb needs."""
# Below this phase angle terminator and limb are one to 1.5 % of the radius.
_FULL_PHASE_RAD = np.radians(10.0)
# Cosine to the Sun's direction in the image from which an edge is taken for the limb.
_LIMB_COSINE = 0.2
# Width of the stripes towards the Sun in which the foremost point is the limb; least length of an outline over the
# longest one's.
_LANE_PX = 1.0
_LEAST_PIECE = 0.2


class LimbShape(Estimator):
    """The lit limb against the limb of the believed frame, along its normals: shift and size."""

    name = "limb_shape"

    def _measured(self, frame: np.ndarray, believed: StateLike, here: Sight,
                  render: Callable[..., Any]) -> Measurement:
        smooth = cv2.GaussianBlur(np.asarray(frame, np.float32), (0, 0), _SMOOTH_PX)

        def step(drawn: Drawn, number: int) -> tuple[np.ndarray, np.ndarray]:
            points_px, normals = limb_points(drawn.pixels, drawn.here)
            x, y = np.rint(points_px).astype(int).T
            points_px, normals = points_px[drawn.is_clear[y, x]], normals[drawn.is_clear[y, x]]
            at_px = points_px + drawn.corner_px
            center_px = self.camera.project(drawn.here.r_body_camera_m)
            radius_px = self.camera.focal_length_px * self.body.mean_radius_m / drawn.here.range_m
            reach_px = _REACH_PX + (0.1 * radius_px if number == 0 else 0.0)
            off_px, is_edge = _crossings(smooth, at_px, normals, reach_px)
            height, width = frame.shape
            is_edge &= ((at_px > _REACH_PX) & (at_px < np.array([width, height]) - 1.0 - _REACH_PX)).all(axis=1)
            if is_edge.sum() < LEAST_POINTS:
                raise NotFound(f"{is_edge.sum()} edges of the frame are near the believed limb, {LEAST_POINTS} are "
                               "needed")
            n, arm = normals[is_edge], (at_px[is_edge] - center_px) / radius_px
            rows = np.column_stack([n, np.einsum("ij,ij->i", n, arm)])
            solved = least_squares(lambda x: rows @ x - off_px[is_edge], np.zeros(3), jac=lambda x: rows,
                                   loss="soft_l1", f_scale=0.5)
            range_m = drawn.here.range_m / (1.0 + solved.x[2] / radius_px)
            place_m = placed(self.camera, center_px + solved.x[:2], range_m)
            return place_m, _covariance(rows, rows @ solved.x - off_px[is_edge], radius_px)

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


def limb_points(pixels: np.ndarray, here: Sight) -> tuple[np.ndarray, np.ndarray]:
    """Places (N, 2) [px] of the lit limb to a part of a pixel, and its normals (N, 2) away from the body.

    An edge is the limb where its normal points to the Sun's side and nothing lit is before it, at small phase angles
    all round, if the image shows both its sides. Edges of other bodies are among them.

    Raises
    ------
    NotFound
    """
    is_lit = (lit_pixels(pixels) > 0.0).astype(np.uint8)
    # Only the box around the lit pixels is searched.
    left, top, wide, high = cv2.boundingRect(is_lit)
    margin, (height, width) = int(4.0 * _REACH_PX), pixels.shape
    x0, y0 = max(left - margin, 0), max(top - margin, 0)
    part = np.s_[y0:top + high + margin, x0:left + wide + margin]
    smooth = cv2.GaussianBlur(np.asarray(pixels[part], np.float32), (0, 0), _SMOOTH_PX)
    contours, _ = cv2.findContours(is_lit[part], cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    # Shadows may part the body; specks of light beyond the terminator are no limb.
    least = _LEAST_PIECE * max(map(len, contours))
    outlines = [contour.reshape(-1, 2).astype(np.float64) for contour in contours if len(contour) >= least]
    points, normals = np.concatenate(outlines), np.concatenate([_normals(outline) for outline in outlines])
    corner = np.array([x0, y0], float)
    keep = is_limb_there(points + corner, normals, here, (width, height))
    if here.phase_rad > _FULL_PHASE_RAD:
        keep &= _foremost(points, here.sunward_px)
    points, normals = points[keep], normals[keep]
    off, is_edge = _crossings(smooth, points, normals, _REACH_PX) if len(points) else (None, np.zeros(0, bool))
    if is_edge.sum() < LEAST_POINTS:
        raise NotFound(f"the lit limb has {is_edge.sum()} edges inside the image, {LEAST_POINTS} are needed")
    return points[is_edge] + off[is_edge, None] * normals[is_edge] + corner, normals[is_edge]


def is_limb_there(points_px: np.ndarray, normals: np.ndarray, here: Sight, size_px: tuple[int, int]) -> np.ndarray:
    """Whether an edge (..., 2) [px] of a normal (..., 2) may be the lit limb, and the frame shows both its sides."""
    is_inside = ((points_px > _REACH_PX) & (points_px < np.array(size_px) - 1.0 - _REACH_PX)).all(axis=-1)
    return is_inside & ((here.phase_rad <= _FULL_PHASE_RAD) | (normals @ here.sunward_px > _LIMB_COSINE))


def _normals(outline: np.ndarray) -> np.ndarray:
    """Unit normals (N, 2) of a closed outline (N, 2), away from its inside.

    They are the outline's own, over some pixels: gradients of light follow shades as well.
    """
    reach = max(1, min(6, len(outline) // 12))
    tangent = np.roll(outline, -reach, axis=0) - np.roll(outline, reach, axis=0)
    normals = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    x, y = outline.T
    # The sign of the outline's area gives the sense of rotation.
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


def _covariance(jacobian: np.ndarray, off_px: np.ndarray, radius_px: float) -> np.ndarray:
    """Covariance of a fit whose residuals [px] are alike over stretches of the outline."""
    variance = float((1.4826 * np.median(np.abs(off_px)))**2) + 0.02**2
    n_alike = 2.0 * np.pi * radius_px / N_STRETCHES
    return variance * n_alike * np.linalg.inv(jacobian.T @ jacobian)
