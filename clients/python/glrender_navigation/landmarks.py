"""Estimator by features that the frame and the believed frame share, and the pose that they tell of."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from scipy.optimize import least_squares

from .believed import Drawn, Refined
from .camera import Sight, StateLike
from .measurement import Estimator, Measurement, NotFound

_LEAST_MATCHES = 8
_INLIER_PX = 2.0
# Side of the windows that are tracked [px], and how far a feature may be from where tracking it back ends.
_WINDOW_PX = 21
_BACK_PX = 0.5
# Windows overlap: errors of neighbours are alike.
_ALIKE = 2.0


class Landmarks(Estimator):
    """Corners of the believed frame, whose pixels have places on the body, tracked into the frame (Lucas-Kanade).

    RANSAC finds the pose of those that agree; the place is then refined with the attitude that the star tracker tells.
    """

    name = "landmarks"

    def _measured(self, frame: np.ndarray, believed: StateLike, here: Sight,
                  render: Callable[..., Any]) -> Measurement:
        grey = _grey(frame)

        def step(drawn: Drawn, number: int) -> tuple[np.ndarray, np.ndarray]:
            # The whole frame with the drawn region in it: what is tracked may leave the region.
            whole, mask = np.zeros(grey.shape, np.float32), np.zeros(grey.shape, np.uint8)
            (x, y), (height, width) = drawn.corner_px, drawn.pixels.shape
            whole[y : y + height, x : x + width] = drawn.pixels
            whole = _grey(whole)
            ground = np.isfinite(drawn.products["r_body"][..., 0]).astype(np.uint8)
            mask[y : y + height, x : x + width] = cv2.erode(ground, np.ones((3, 3), np.uint8), borderValue=0)
            corners = cv2.goodFeaturesToTrack(whole, 300, 0.003, 4.0, mask=mask)
            n_corners = 0 if corners is None else len(corners)
            if n_corners < _LEAST_MATCHES:
                raise NotFound(f"the believed frame has {n_corners} features, {_LEAST_MATCHES} are needed")
            tracked, is_found, _ = cv2.calcOpticalFlowPyrLK(whole, grey, corners, None, winSize=(_WINDOW_PX,) * 2)
            back, is_back, _ = cv2.calcOpticalFlowPyrLK(grey, whole, tracked, None, winSize=(_WINDOW_PX,) * 2)
            is_found = (is_found & is_back)[:, 0] > 0
            is_found &= np.linalg.norm(back - corners, axis=2)[:, 0] < _BACK_PX
            r_body_m = _places(drawn.products["r_body"], corners[:, 0] - drawn.corner_px)
            is_found &= np.isfinite(r_body_m).all(axis=1)
            if is_found.sum() < _LEAST_MATCHES:
                raise NotFound(f"{is_found.sum()} features are found again, {_LEAST_MATCHES} are needed")
            return self._solved(r_body_m[is_found], tracked[is_found, 0].astype(float), drawn.here)

        place_m, covariance_m2 = Refined(frame, believed, self.camera, self.body, render, products=("r_body",),
                                         most=3)(step)
        return self.placed(place_m, covariance_m2)

    def _solved(self, r_body_m: np.ndarray, seen_px: np.ndarray, here: Sight) -> tuple[np.ndarray, np.ndarray]:
        """The body's place [m] and its covariance, of places (N, 3) on the body and where they are seen (N, 2)."""
        turn = cv2.Rodrigues(here.camera_from_body)[0]
        is_found, _, _, inliers = cv2.solvePnPRansac(
            r_body_m, seen_px, self.camera.matrix, None, turn, here.r_body_camera_m.reshape(3, 1).copy(),
            useExtrinsicGuess=True, iterationsCount=200, reprojectionError=_INLIER_PX, flags=cv2.SOLVEPNP_ITERATIVE)
        if not is_found or inliers is None or len(inliers) < _LEAST_MATCHES:
            raise NotFound(f"{0 if inliers is None else len(inliers)} of {len(seen_px)} matches agree on a pose, "
                           f"{_LEAST_MATCHES} are needed")
        places, seen = r_body_m[inliers[:, 0]] @ here.camera_from_body.T, seen_px[inliers[:, 0]]
        solved = least_squares(lambda r: (self.camera.project(places + r) - seen).ravel(), here.r_body_camera_m,
                               loss="soft_l1", f_scale=0.3, x_scale="jac")
        left = (self.camera.project(places + solved.x) - seen).ravel()
        variance = float((1.4826 * np.median(np.abs(left)))**2) + 0.05**2
        jacobian = _jacobian(self.camera.focal_length_px, places + solved.x)
        return solved.x, _ALIKE * variance * np.linalg.inv(jacobian.T @ jacobian)


def _jacobian(focal_length_px: float, r_m: np.ndarray) -> np.ndarray:
    """Derivatives (2 N, 3) [px/m] of the landmarks' pixels by the body's place (3,) [m]."""
    x, y, z = r_m.T
    zero = np.zeros_like(x)
    return focal_length_px * np.stack([np.column_stack([1.0 / z, zero, -x / z**2]),
                                       np.column_stack([zero, 1.0 / z, -y / z**2])], axis=1).reshape(-1, 3)


def _grey(pixels: np.ndarray) -> np.ndarray:
    """Eight bits, linear: roots and local contrast would move shades where exposures differ."""
    sky = float(np.quantile(pixels[::4, ::4], 0.05))
    top = max(float(np.quantile(pixels, 0.995)) - sky, 1e-30)
    return (255.0 * np.clip((np.asarray(pixels, np.float32) - sky) / top, 0.0, 1.0)).astype(np.uint8)


def _places(r_body_m: np.ndarray, points_px: np.ndarray) -> np.ndarray:
    """Places (N, 3) [m] on the body, between pixel centres; NaN at outlines, also between near and far ground."""
    at = points_px.astype(np.float32)[:, None]
    places = cv2.remap(np.ascontiguousarray(r_body_m, np.float32), at[..., 0], at[..., 1], cv2.INTER_LINEAR,
                       borderMode=cv2.BORDER_CONSTANT, borderValue=(np.nan,) * 3)[:, 0]
    return places.astype(np.float64)
