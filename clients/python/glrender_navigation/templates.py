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
# Smoothing of both images, coarse and fine [px], and the step that is small enough [px]; and the most steps of each.
_SMOOTH_PX, _MOST_STEPS = {4.0: 0.1, 1.0: 0.01}, 12
# Light at the frame's border is left out [px]: smoothing has taken other light in there.
_BORDER_PX = 4
# Pixels of the template that are compared: more say no more, and OpenCV's `remap` takes 32,767 rows.
_LEAST_USED, _MOST_USED = 20, 16_000
# Share of the brightest light below which pixels, dark and smooth, do not count.
_LIT = 0.01
# Parts of the template to each side, whose residuals count as independent.
_N_BLOCKS = 8


class Templates(Estimator):
    """The frame's light against the believed frame's: least squares of shift, size and gain.

    Light of other bodies, next to them and at the frame's border is left out.

    Source: Baker and Matthews (2004), Lucas-Kanade 20 years on: the inverse compositional algorithm; the covariance
    of residuals that are alike by Liang and Zeger (1986).
    """

    name = "templates"

    def _measured(self, frame: np.ndarray, believed: StateLike, here: Sight,
                  render: Callable[..., Any]) -> Measurement:
        light = np.asarray(frame, np.float32) - np.float32(np.quantile(frame[::4, ::4], 0.05))
        light /= max(float(np.quantile(light, 0.999)), 1e-30)
        smooth = [_blurred(light, sigma_px) for sigma_px in _SMOOTH_PX]
        is_inner = np.zeros(frame.shape, bool)
        is_inner[_BORDER_PX:-_BORDER_PX, _BORDER_PX:-_BORDER_PX] = True

        def step(drawn: Drawn, number: int) -> tuple[np.ndarray, np.ndarray]:
            template = drawn.pixels / max(float(np.quantile(drawn.pixels, 0.999)), 1e-30)
            (x, y), (height, width) = drawn.corner_px, template.shape
            is_clear = drawn.is_clear & is_inner[y : y + height, x : x + width]
            center_px = self.camera.project(drawn.here.r_body_camera_m)
            at_px, scale = center_px, 1.0
            for seen, (sigma_px, enough_px) in zip(smooth, _SMOOTH_PX.items(), strict=True):
                match = _Match(_blurred(template, sigma_px), is_clear, center_px - drawn.corner_px)
                at_px, scale, covariance = match.fitted(seen, at_px, scale, enough_px)
            radius_px = self.camera.focal_length_px * self.body.mean_radius_m / drawn.here.range_m
            return (placed(self.camera, at_px, drawn.here.range_m / scale),
                    np.diag([1.0, 1.0, radius_px]) @ covariance @ np.diag([1.0, 1.0, radius_px]))

        place_m, covariance_px2 = Refined(frame, believed, self.camera, self.body, render)(step)
        return from_shift(self, place_m, covariance_px2)


class _Match:
    """A template (h, w) to be found in frames, with the pixels (h, w) that count, and its centre (2,) [px]."""

    def __init__(self, template: np.ndarray, is_clear: np.ndarray, center_px: np.ndarray):
        right, down = (cv2.Sobel(template, cv2.CV_32F, *order, scale=0.125) for order in ((1, 0), (0, 1)))
        # Sky that is smooth says nothing of the place.
        is_used = is_clear & (np.maximum(template, np.hypot(right, down)) > _LIT)
        rows, columns = np.nonzero(is_used)
        every = len(rows) // _MOST_USED + 1
        rows, columns = rows[::every], columns[::every]
        self._arm_px = np.stack([columns, rows], axis=1) - center_px
        self._template, right, down = (image[rows, columns].astype(np.float64) for image in (template, right, down))
        radial = right * self._arm_px[:, 0] + down * self._arm_px[:, 1]
        self._rows = np.stack([right, down, radial, self._template])
        self._reach_px = 0.5 * max(template.shape)
        height, width = template.shape
        self._block = (rows * _N_BLOCKS // height) * _N_BLOCKS + columns * _N_BLOCKS // width

    def fitted(self, seen: np.ndarray, at_px: np.ndarray, scale: float,
               enough_px: float) -> tuple[np.ndarray, float, np.ndarray]:
        """Where the template's centre is in a frame [px], its size there, and their covariance (3, 3).

        Raises
        ------
        NotFound
            The frame has other light there, or none.
        """
        high = np.array(seen.shape[::-1]) - 1.0 - _BORDER_PX
        for _ in range(_MOST_STEPS):
            here_px = at_px + scale * self._arm_px
            is_inside = ((here_px >= _BORDER_PX) & (here_px <= high)).all(axis=1)
            if is_inside.sum() < _LEAST_USED:
                raise NotFound(f"{is_inside.sum()} pixels of the template are inside the frame and clear of other "
                               f"bodies, {_LEAST_USED} are needed")
            here = here_px[is_inside].astype(np.float32)[:, None]
            light = cv2.remap(seen, here[..., 0], here[..., 1], cv2.INTER_LINEAR)[:, 0].astype(np.float64)
            rows, template = self._rows[:, is_inside], self._template[is_inside]
            square = float(template @ template)
            gain = float(light @ template) / square
            correlation = gain * np.sqrt(square / max(float(light @ light), 1e-300))
            if not correlation > _LEAST_CORRELATION:
                raise NotFound(f"the frame correlates with the template by {correlation:.2f}, {_LEAST_CORRELATION} is "
                               "needed")
            left, inverse = light - gain * template, np.linalg.inv(rows @ rows.T)
            move = (inverse @ (rows @ left))[:3] / gain
            at_px, scale = at_px - scale * move[:2], scale * (1.0 - move[2])
            if not 0.5 < scale < 2.0:
                raise NotFound("the template's size went astray")
            if np.abs(move[:2]).max() + abs(move[2]) * self._reach_px < enough_px:
                break
        # Residuals are alike over parts of the template, of any size: the sum over each part counts.
        parts = np.stack([np.bincount(self._block[is_inside], row * left, _N_BLOCKS**2) for row in rows])
        covariance = inverse @ (parts @ parts.T) @ inverse / gain**2
        return at_px, scale, covariance[:3, :3]


def _blurred(image: np.ndarray, sigma_px: float) -> np.ndarray:
    return cv2.GaussianBlur(np.asarray(image, np.float32), (0, 0), sigma_px, borderType=cv2.BORDER_REPLICATE)
