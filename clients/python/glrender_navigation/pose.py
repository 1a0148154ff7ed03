"""Estimator by features that the frame and the believed frame share, of place and attitude."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from .believed import Drawn, draw
from .body import BelievedBody
from .camera import Camera, Sight, StateLike, moved
from .features import ALIKE, jacobian, places_at, variance
from .measurement import N_STRETCHES, Estimator, Measurement, NotFound

# Share of the brightest pixels that are white to the features.
_WHITE = 0.001
# A believed frame without relief has few features: of low contrast, along edges of shadows, and small ones.
_N_FEATURES, _N_LAYERS, _CONTRAST, _EDGE, _SIGMA_PX = 6000, 5, 0.005, 30.0, 1.0
# Ratio of the best match's distance to the second best's (Lowe 2004 has 0.8; RANSAC takes off the rest).
_RATIO = 0.85
# Matches agree with a pose within so many pixels, in the first believed frame, which is the farthest off, and then.
_FIRST_PX, _INLIER_PX = 5.0, 2.5
_N_TRIALS, _CONFIDENCE = 3000, 0.9999
# Wrong poses gathered up to 54 of 243 matches.
_LEAST_AGREEING, _LEAST_SHARE = 30, 0.25
# Residuals of right matches [px].
_RESIDUAL_PX = 0.3
# The believed frame is drawn anew until its features stay where they are.
_ENOUGH_PX = 0.25
_MOST_PASSES = 8


class PoseByFeatures(Estimator):
    """Features (SIFT) of the frame, matched with those of the believed frame, whose pixels have places on the body.

    RANSAC finds the pose of those that agree (P3P), place and attitude, and the believed frame is drawn anew from it
    until it settles. The believed attitude may be a few degrees off. Frames are refused where fewer than 30, or than a
    quarter of the matches, agree: a smooth body, a coarse belief, or one that is too far off.

    Parameters
    ----------
    camera : Camera
    body : BelievedBody
    """

    name = "pose"

    def __init__(self, camera: Camera, body: BelievedBody):
        super().__init__(camera, body)
        self._sift = cv2.SIFT_create(_N_FEATURES, _N_LAYERS, _CONTRAST, _EDGE, _SIGMA_PX)

    def _measured(self, frame: np.ndarray, believed: StateLike, here: Sight,
                  render: Callable[..., Any]) -> Measurement:
        state, seen, move_px = believed, None, np.inf
        for number in range(_MOST_PASSES):
            drawn = draw(render, state, self.camera, self.body, ("r_body",))
            if seen is None:
                (x, y), (height, width) = drawn.corner_px, drawn.pixels.shape
                light = frame[y : y + height, x : x + width][drawn.is_clear]
                seen = self._sift.detectAndCompute(_root(frame, light), None)
            matches = self._matches(drawn, seen)
            camera_from_body, place_m, covariance = self._solved(matches, _INLIER_PX if number else _FIRST_PX)
            moves_px = self.camera.project(matches[0] @ camera_from_body.T + place_m) - self.camera.project(
                matches[0] @ drawn.here.camera_from_body.T + drawn.here.r_body_camera_m)
            move_px = float(np.median(np.linalg.norm(moves_px, axis=1)))
            if move_px < _ENOUGH_PX:
                found = Measurement.of_place(self.camera, place_m, covariance[3:, 3:])
                return replace(found, pose_covariance=covariance, q_camera_from_body=Rotation.from_matrix(
                    camera_from_body).as_quat(scalar_first=True))
            state = moved(state, self.camera, self.body.name, place_m, camera_from_body)
        raise NotFound(f"the features still move by {move_px:.2f} px after {_MOST_PASSES} passes, {_ENOUGH_PX} is "
                       "allowed")

    def _matches(self, drawn: Drawn, seen: tuple) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Places (N, 3) [m] on the body of features of the believed frame, their pixels (N, 2) in the frame, and sizes.

        Each is the other's best match.
        """
        ground = (np.isfinite(drawn.products["r_body"][..., 0]) & drawn.is_clear).astype(np.uint8)
        expected = self._sift.detectAndCompute(_root(drawn.pixels, drawn.pixels[drawn.is_clear]), ground)
        if min(len(seen[0]), len(expected[0])) < _LEAST_AGREEING:
            raise NotFound(f"frame and believed frame have {len(seen[0])} and {len(expected[0])} features, "
                           f"{_LEAST_AGREEING} are needed")
        matcher = cv2.BFMatcher()
        back = [match.trainIdx for match in matcher.match(seen[1], expected[1])]
        pairs = [best for best, second in matcher.knnMatch(expected[1], seen[1], 2)
                 if best.distance < _RATIO * second.distance and back[best.trainIdx] == best.queryIdx]
        drawn_px = np.array([expected[0][pair.queryIdx].pt for pair in pairs]).reshape(-1, 2)
        seen_px = np.array([seen[0][pair.trainIdx].pt for pair in pairs]).reshape(-1, 2)
        sizes_px = np.array([expected[0][pair.queryIdx].size for pair in pairs])
        places_m = places_at(drawn.products["r_body"], drawn_px)
        is_ground = np.isfinite(places_m).all(axis=1)
        return places_m[is_ground], seen_px[is_ground], sizes_px[is_ground]

    def _solved(self, matches: tuple[np.ndarray, np.ndarray, np.ndarray],
                within_px: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rotation (3, 3) and place (3,) [m] of the body in `camera` by the matches that agree; covariance (6, 6)."""
        places_m, seen_px, sizes_px = matches
        focal_length_px = self.camera.focal_length_px
        if len(places_m) < _LEAST_AGREEING:
            raise NotFound(f"frame and believed frame have {len(places_m)} matches, {_LEAST_AGREEING} are needed")
        _, turn, place_m, inliers = cv2.solvePnPRansac(
            places_m, seen_px, self.camera.matrix, None, iterationsCount=_N_TRIALS, reprojectionError=within_px,
            confidence=_CONFIDENCE, flags=cv2.SOLVEPNP_AP3P)
        n = 0 if inliers is None else len(inliers)
        if n < max(_LEAST_AGREEING, _LEAST_SHARE * len(places_m)):
            raise NotFound(f"{n} of {len(places_m)} matches agree on a pose, {_LEAST_AGREEING} and {_LEAST_SHARE:.0%} "
                           "are needed; the believed shape or place may be too far off")
        first = cv2.Rodrigues(turn)[0]
        arms_m, seen_px = places_m[inliers[:, 0]] @ first.T, seen_px[inliers[:, 0]]
        # A feature's place errs as its size.
        weights = 1.0 / sizes_px[inliers]
        weights /= np.sqrt(np.mean(weights**2))

        def off_px(x: np.ndarray) -> np.ndarray:
            """Weighted residuals [px] of a turn [rad] and a place [m]."""
            turned_m = Rotation.from_rotvec(x[:3]).apply(arms_m) + x[3:]
            return (weights * (self.camera.project(turned_m) - seen_px)).ravel()

        solved = least_squares(off_px, np.append(np.zeros(3), place_m), loss="cauchy", f_scale=_RESIDUAL_PX,
                               x_scale="jac")
        turn, place_m = Rotation.from_rotvec(solved.x[:3]), solved.x[3:]
        derivatives = np.repeat(weights, 2, axis=0) * jacobian(focal_length_px, turn.apply(arms_m), place_m)
        # The believed shape errs alike over stretches of the surface.
        shape_px = focal_length_px * self.body.shape_error_m / place_m[2]
        square_px2 = ALIKE * variance(solved.fun) + shape_px**2 * n / N_STRETCHES
        covariance = square_px2 * np.linalg.inv(derivatives.T @ derivatives)
        if not np.isfinite(covariance).all() or not place_m[2] > 0.0:
            raise NotFound("the solution went astray")
        return turn.as_matrix() @ first, place_m, covariance


def _root(pixels: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Eight bits of the root of an image's signal, as noisy in shade as in light; white by some of its pixels (N,)."""
    if not light.size:
        raise NotFound("other bodies leave nothing of this one in the believed frame")
    sky = float(np.quantile(pixels[::4, ::4], 0.05))
    top = max(float(np.quantile(light, 1.0 - _WHITE)) - sky, 1e-30)
    return (255.0 * np.sqrt(np.clip((np.asarray(pixels, np.float32) - sky) / top, 0.0, 1.0))).astype(np.uint8)
