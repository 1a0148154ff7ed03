"""Estimator by features that the frame and the believed frame share, and then by their light: place and attitude."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from .believed import Drawn, draw
from .body import BelievedBody
from .camera import Camera, Sight, StateLike, moved
from .direct_alignment import aligned
from .features import places_at
from .measurement import Estimator, Measurement, NotFound

# Share of the brightest pixels that are white to the features.
_WHITE = 0.001
# A believed frame without relief has few features: of low contrast, along edges of shadows, and small ones.
_N_FEATURES, _N_LAYERS, _CONTRAST, _EDGE, _SIGMA_PX = 6000, 5, 0.005, 30.0, 1.0
# Ratio of the best match's distance to the second best's (Lowe 2004 has 0.8; RANSAC takes off the rest).
_RATIO = 0.85
# Matches agree with a pose within so many pixels in the first believed frame, which is the farthest off.
_INLIER_PX = 5.0
_N_TRIALS, _CONFIDENCE = 3000, 0.9999
# Wrong poses gathered up to 54 of 243 matches.
_LEAST_AGREEING, _LEAST_SHARE = 30, 0.25
# Light and features may disagree by so many pixels; the believed frame is drawn anew until its ground stays in place.
_APART_PX, _ENOUGH_PX = 5.0, 0.05
_MOST_PASSES = 8
# Steps that are left after the last one, of which each is 0.7 of the one before at most: their sum over the last.
_LEFT = 2.0
# How far a pose moves the ground is averaged over one of so many pixels.
_EVERY = 37


class PoseByFeatures(Estimator):
    """Features (SIFT) that frame and believed frame share, whose places on the body are known, and then all the light.

    RANSAC finds the pose of the features that agree (P3P), place and attitude. The believed frame is drawn anew from
    it, and its ground laid on the frame's light (`direct_alignment`), until it stays in place. The believed attitude
    may be a few degrees off. Frames are refused where fewer than 30, or than a quarter of the matches, agree: a smooth
    body, a coarse belief, or one that is too far off.

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
        drawn = self._draw(render, believed)
        pose, move_px = self._by_features(frame, drawn), np.inf
        for number in range(_MOST_PASSES):
            drawn = self._draw(render, moved(believed, self.camera, self.body.name, pose[1], pose[0]))
            *pose, covariance = aligned(frame, drawn, self.camera, self.body)
            move_px = _moved_px(drawn, self.camera, *pose)
            if move_px < _ENOUGH_PX:
                step = np.append(Rotation.from_matrix(pose[0] @ drawn.here.camera_from_body.T).as_rotvec(),
                                 pose[1] - drawn.here.r_body_camera_m)
                covariance += _LEFT**2 * np.outer(step, step)
                found = Measurement.of_place(self.camera, pose[1], covariance[3:, 3:])
                return replace(found, pose_covariance=covariance, q_camera_from_body=Rotation.from_matrix(
                    pose[0]).as_quat(scalar_first=True))
            if number == 0 and not move_px < _APART_PX:
                raise NotFound(f"the ground's light is {move_px:.1f} px from where its features are, {_APART_PX:g} are "
                               "allowed")
        raise NotFound(f"the ground still moves by {move_px:.2f} px after {_MOST_PASSES} passes, {_ENOUGH_PX:g} is "
                       "allowed")

    def _draw(self, render: Callable[..., Any], state: StateLike) -> Drawn:
        return draw(render, state, self.camera, self.body, ("r_body",))

    def _by_features(self, frame: np.ndarray, drawn: Drawn) -> tuple[np.ndarray, np.ndarray]:
        """Rotation (3, 3) and place (3,) [m] of the body in `camera` by the matches that agree."""
        places_m, seen_px = self._matches(frame, drawn)
        if len(places_m) < _LEAST_AGREEING:
            raise NotFound(f"frame and believed frame have {len(places_m)} matches, {_LEAST_AGREEING} are needed")
        _, turn, place_m, inliers = cv2.solvePnPRansac(
            places_m, seen_px, self.camera.matrix, None, iterationsCount=_N_TRIALS, reprojectionError=_INLIER_PX,
            confidence=_CONFIDENCE, flags=cv2.SOLVEPNP_AP3P)
        n = 0 if inliers is None else len(inliers)
        if n < max(_LEAST_AGREEING, _LEAST_SHARE * len(places_m)):
            raise NotFound(f"{n} of {len(places_m)} matches agree on a pose, {_LEAST_AGREEING} and {_LEAST_SHARE:.0%} "
                           "are needed; the believed shape or place may be too far off")
        turn, place_m = cv2.solvePnPRefineLM(places_m[inliers[:, 0]], seen_px[inliers[:, 0]], self.camera.matrix, None,
                                             turn, place_m)
        return cv2.Rodrigues(turn)[0], place_m[:, 0]

    def _matches(self, frame: np.ndarray, drawn: Drawn) -> tuple[np.ndarray, np.ndarray]:
        """Places (N, 3) [m] on the body of features of the believed frame, and their pixels (N, 2) in the frame.

        Each is the other's best match.
        """
        ground = (np.isfinite(drawn.products["r_body"][..., 0]) & drawn.is_clear).astype(np.uint8)
        expected = self._sift.detectAndCompute(_root(drawn.pixels, drawn.pixels[drawn.is_clear]), ground)
        (x, y), (height, width) = drawn.corner_px, drawn.pixels.shape
        light = frame[y : y + height, x : x + width][drawn.is_clear]
        seen = self._sift.detectAndCompute(_root(frame, light), None)
        if min(len(seen[0]), len(expected[0])) < _LEAST_AGREEING:
            raise NotFound(f"frame and believed frame have {len(seen[0])} and {len(expected[0])} features, "
                           f"{_LEAST_AGREEING} are needed")
        matcher = cv2.BFMatcher()
        back = [match.trainIdx for match in matcher.match(seen[1], expected[1])]
        pairs = [best for best, second in matcher.knnMatch(expected[1], seen[1], 2)
                 if best.distance < _RATIO * second.distance and back[best.trainIdx] == best.queryIdx]
        drawn_px = np.array([expected[0][pair.queryIdx].pt for pair in pairs]).reshape(-1, 2)
        seen_px = np.array([seen[0][pair.trainIdx].pt for pair in pairs]).reshape(-1, 2)
        places_m = places_at(drawn.products["r_body"], drawn_px)
        is_ground = np.isfinite(places_m).all(axis=1)
        return places_m[is_ground], seen_px[is_ground]


def _moved_px(drawn: Drawn, camera: Camera, camera_from_body: np.ndarray, place_m: np.ndarray) -> float:
    """How far [px] the ground of a believed frame moves to where a pose has it, root mean square."""
    places_m = drawn.products["r_body"][drawn.is_clear][::_EVERY]
    places_m = places_m[np.isfinite(places_m[:, 0])]
    moves_px = camera.project(places_m @ camera_from_body.T + place_m) - camera.project(
        places_m @ drawn.here.camera_from_body.T + drawn.here.r_body_camera_m)
    return float(np.sqrt(np.mean(np.sum(moves_px**2, axis=1))))


def _root(pixels: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Eight bits of the root of an image's signal, as noisy in shade as in light; white by some of its pixels (N,)."""
    if not light.size:
        raise NotFound("other bodies leave nothing of this one in the believed frame")
    sky = float(np.quantile(pixels[::4, ::4], 0.05))
    top = max(float(np.quantile(light, 1.0 - _WHITE)) - sky, 1e-30)
    return (255.0 * np.sqrt(np.clip((np.asarray(pixels, np.float32) - sky) / top, 0.0, 1.0))).astype(np.uint8)
