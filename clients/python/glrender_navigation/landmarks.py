"""Estimator by features that the frame and the believed frame share, and the pose that follows."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from .believed import Drawn, Refined, grown
from .body import BelievedBody
from .camera import Camera, Sight, StateLike
from .checks import number
from .features import ALIKE, jacobian, places_at, variance
from .measurement import N_STRETCHES, Estimator, Measurement, NotFound

_LEAST_MATCHES = 8
_INLIER_PX = 2.0
# Side of the windows that are tracked [px], and how far a feature may be from where tracking it back ends.
_WINDOW_PX = 21
_BACK_PX = 0.5
# Sigmas of the star tracker and of the features by which a pose may be turned from the believed attitude.
_MOST_TURNED = 5.0
# Errors of the believed attitude, where nothing else is said [rad]: a star tracker's 20 arc seconds, and the pole's.
_SIGMA_ATTITUDE_RAD = 2e-4


class Landmarks(Estimator):
    """Corners of the believed frame, whose pixels have places on the body, tracked into the frame (Lucas-Kanade).

    RANSAC finds the pose of those that agree, and a pose that is turned from the believed attitude is refused; the
    place is then refined with the attitude of the star tracker.

    Parameters
    ----------
    camera : Camera
    body : BelievedBody
    sigma_attitude_rad : float [rad], optional
        Standard deviation of the believed attitude of the body in the camera, of each axis.

    Raises
    ------
    ValueError
        With the field: a sigma below zero, or a value that is no number.
    """

    name = "landmarks"

    def __init__(self, camera: Camera, body: BelievedBody, *, sigma_attitude_rad: float = _SIGMA_ATTITUDE_RAD):
        super().__init__(camera, body)
        self._sigma_attitude_rad = number("sigma_attitude_rad", sigma_attitude_rad, "give radians, 0 is exact",
                                          is_zero_allowed=True)

    def _measured(self, frame: np.ndarray, believed: StateLike, here: Sight,
                  render: Callable[..., Any]) -> Measurement:
        height_px, width_px = frame.shape
        # A window that leaves the image is no feature.
        half = _WINDOW_PX // 2
        is_inner = np.zeros(frame.shape, bool)
        is_inner[half:-half, half:-half] = True

        def step(drawn: Drawn, number: int) -> tuple[np.ndarray, np.ndarray]:
            # The whole frame with the drawn region in it: tracked features may leave the region.
            whole, mask = np.zeros(frame.shape, np.float32), np.zeros(frame.shape, np.uint8)
            (x, y), (height, width) = drawn.corner_px, drawn.pixels.shape
            region = np.s_[y : y + height, x : x + width]
            whole[region] = drawn.pixels
            # Both by the light of this body alone.
            grey, whole = (_grey(image, image[region][drawn.is_clear]) for image in (frame, whole))
            ground = np.isfinite(drawn.products["r_body"][..., 0]).astype(np.uint8)
            mask[region] = cv2.erode(ground, np.ones((3, 3), np.uint8), borderValue=0)
            mask[region] *= ~grown(~drawn.is_clear, half)
            mask[~is_inner] = 0
            corners = cv2.goodFeaturesToTrack(whole, 300, 0.003, 4.0, mask=mask)
            n_corners = 0 if corners is None else len(corners)
            if n_corners < _LEAST_MATCHES:
                raise NotFound(f"the believed frame has {n_corners} features, {_LEAST_MATCHES} are needed")
            tracked, is_found, _ = cv2.calcOpticalFlowPyrLK(whole, grey, corners, None, winSize=(_WINDOW_PX,) * 2)
            back, is_back, _ = cv2.calcOpticalFlowPyrLK(grey, whole, tracked, None, winSize=(_WINDOW_PX,) * 2)
            is_found = (is_found & is_back)[:, 0] > 0
            is_found &= np.linalg.norm(back - corners, axis=2)[:, 0] < _BACK_PX
            r_body_m = places_at(drawn.products["r_body"], corners[:, 0] - drawn.corner_px)
            is_found &= np.isfinite(r_body_m).all(axis=1)
            at_px = tracked[:, 0]
            is_found &= ((at_px > half) & (at_px < [width_px - 1.0 - half, height_px - 1.0 - half])).all(axis=1)
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

        def off_px(x: np.ndarray) -> np.ndarray:
            """Residuals [px] of a place [m], or of a turn [rad] and a place."""
            turned = Rotation.from_rotvec(x[:-3]).apply(places) if len(x) > 3 else places
            return (self.camera.project(turned + x[-3:]) - seen).ravel()

        solved = least_squares(off_px, here.r_body_camera_m, loss="soft_l1", f_scale=0.3, x_scale="jac")
        self._check_turn(off_px, solved.x)
        by_turn, by_place = np.split(jacobian(self.camera.focal_length_px, places, solved.x), 2, axis=1)
        inverse = np.linalg.inv(by_place.T @ by_place)
        # An attitude that errs moves the place.
        lever = inverse @ by_place.T @ by_turn
        return solved.x, ALIKE * variance(off_px(solved.x)) * inverse + self._sigma_turn**2 * lever @ lever.T

    @property
    def _sigma_turn(self) -> float:
        """Standard deviation [rad] of the attitude, of each axis: the believed one's, and by the shape's own error."""
        return float(np.hypot(self._sigma_attitude_rad,
                              self.body.shape_error_m / self.body.mean_radius_m / N_STRETCHES**0.5))

    def _check_turn(self, off_px: Callable[[np.ndarray], np.ndarray], r_m: np.ndarray) -> None:
        """Refuse landmarks that fit better where they are turned.

        Raises
        ------
        NotFound
        """
        solved = least_squares(off_px, np.append(np.zeros(3), r_m), loss="soft_l1", f_scale=0.3, x_scale="jac")
        covariance = ALIKE * variance(off_px(solved.x)) * np.linalg.inv(solved.jac.T @ solved.jac)[:3, :3]
        covariance += self._sigma_turn**2 * np.eye(3)
        turn = solved.x[:3]
        if (sigmas := float(np.sqrt(turn @ np.linalg.solve(covariance, turn)))) > _MOST_TURNED:
            raise NotFound(f"the landmarks are turned by {np.degrees(np.linalg.norm(turn)):.2f} deg from the believed "
                           f"attitude, {sigmas:.0f} sigma: {_MOST_TURNED:g} are allowed; check the attitude, or the "
                           "body's shape and rotation")


def _grey(pixels: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Eight bits, linear, of an image whose brightest light is that of some pixels (N,).

    Roots and local contrast would move shades where exposures differ.
    """
    if not light.size:
        raise NotFound("other bodies leave nothing of this one in the believed frame")
    sky = float(np.quantile(pixels[::4, ::4], 0.05))
    top = max(float(np.quantile(light, 0.99)) - sky, 1e-30)
    return (255.0 * np.clip((np.asarray(pixels, np.float32) - sky) / top, 0.0, 1.0)).astype(np.uint8)
