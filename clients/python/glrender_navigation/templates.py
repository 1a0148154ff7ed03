"""Estimator by correlation with rendered templates."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from .believed import Drawn, Refined, placed
from .camera import Sight, StateLike
from .limb import from_shift
from .measurement import Estimator, Measurement, NotFound

# Below this correlation the template is not what the frame shows.
_LEAST_CORRELATION = 0.6
_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 60, 1e-5)
# Odd, [px]: light of both is smoothed by it for the fine match.
_SMOOTH_PX = 5
# Errors of a drawn template are alike over so many pixels.
_PX_ALIKE = 16.0


class Templates(Estimator):
    """The frame's light against the believed frame's: normalised correlation to a pixel, then an affine
    match to a part of one, whose size gives the range.
    """

    name = "templates"

    def _measured(self, frame: np.ndarray, believed: StateLike, here: Sight,
                  render: Callable[..., Any]) -> Measurement:
        light = np.asarray(frame, np.float32) - np.float32(np.quantile(frame[::4, ::4], 0.05))
        light /= max(float(np.quantile(light, 0.999)), 1e-30)

        def step(drawn: Drawn, number: int) -> tuple[np.ndarray, np.ndarray]:
            template = drawn.pixels / max(float(np.quantile(drawn.pixels, 0.999)), 1e-30)
            corner = self._corner(light, template) if number == 0 else drawn.corner_px
            warp = np.array([[1.0, 0.0, corner[0]], [0.0, 1.0, corner[1]]], np.float32)
            correlation, warp = cv2.findTransformECC(template, light, warp, cv2.MOTION_AFFINE, _CRITERIA, None,
                                                     _SMOOTH_PX)
            if correlation < _LEAST_CORRELATION:
                raise NotFound(f"the frame correlates with the template by {correlation:.2f}, {_LEAST_CORRELATION} is "
                               "needed")
            center_px = self.camera.project(drawn.here.r_body_camera_m)
            scale = np.sqrt(max(float(np.linalg.det(warp[:, :2].astype(float))), 1e-6))
            place_m = placed(self.camera, warp[:, :2] @ (center_px - drawn.corner_px) + warp[:, 2],
                             drawn.here.range_m / scale)
            return place_m, self._covariance(light, template, warp, center_px - drawn.corner_px, drawn)

        place_m, covariance_px2 = Refined(frame, believed, self.camera, self.body, render)(step)
        return from_shift(self, place_m, covariance_px2)

    @staticmethod
    def _corner(light: np.ndarray, template: np.ndarray) -> np.ndarray:
        """Where the template's corner is in the frame, to a pixel."""
        reach = [max(0, side // 2) for side in template.shape]
        wide = cv2.copyMakeBorder(light, reach[0], reach[0], reach[1], reach[1], cv2.BORDER_CONSTANT, value=0.0)
        _, best, _, place = cv2.minMaxLoc(cv2.matchTemplate(wide, template, cv2.TM_CCORR_NORMED))
        if not best > _LEAST_CORRELATION:
            raise NotFound(f"the frame correlates with the template by {best:.2f}, {_LEAST_CORRELATION} is needed")
        return np.array([place[0] - reach[1], place[1] - reach[0]])

    def _covariance(self, light: np.ndarray, template: np.ndarray, warp: np.ndarray, center: np.ndarray,
                    drawn: Drawn) -> np.ndarray:
        """Of shift right, shift down and radius [px2], of what the template leaves in the frame."""
        size = template.shape[::-1]
        seen = cv2.warpAffine(light, warp, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
        gain = float((seen * template).sum() / np.square(template).sum())
        left = seen - gain * template
        smooth = gain * cv2.GaussianBlur(template, (0, 0), 1.0)
        right, down = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=0.125), cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=0.125)
        y, x = np.mgrid[: size[1], : size[0]]
        radius_px = self.camera.focal_length_px * self.body.mean_radius_m / drawn.here.range_m
        rows = np.stack([right, down, (right * (x - center[0]) + down * (y - center[1])) / radius_px]).reshape(3, -1)
        lit = template.ravel() > 0.01
        information = rows[:, lit] @ rows[:, lit].T
        return float(np.mean(np.square(left.ravel()[lit]))) * _PX_ALIKE * np.linalg.inv(information.astype(float))
