"""Estimators by centre of brightness, corrected for the phase angle."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .camera import Sight, StateLike
from .measurement import Estimator, Measurement, brightness_center_px, lit_pixels

# Digital numbers above the sky: of eight bits, three times the read noise and more.
_LEAST_DN = 6.0


class Sphere(Estimator):
    """Centre of brightness and number of lit pixels, both as of a Lambert sphere.

    Its centre of brightness is off its centre towards the Sun by 3 pi / 16 sin(g) (1 + cos g) / (sin g + (pi - g)
    cos g) radii, and the lit part of its disc is (1 + cos g) / 2.
    """

    name = "sphere"

    def _measured(self, frame: np.ndarray, believed: StateLike, here: Sight,
                  render: Callable[..., Any]) -> Measurement:
        lit = lit_pixels(frame, _least(frame))
        brightness_px = brightness_center_px(lit)
        sun, f = here.sun_direction_camera, self.camera.focal_length_px
        phase = np.arccos(np.clip(-self.camera.direction(brightness_px) @ sun, -1.0, 1.0))
        radius_px = np.sqrt(np.count_nonzero(lit) / np.pi / max(0.5 * (1.0 + np.cos(phase)), 0.05))
        offset = (3.0 * np.pi / 16.0) * np.sin(phase) * (1.0 + np.cos(phase)) / (
            np.sin(phase) + (np.pi - phase) * np.cos(phase))
        sunward, length = sun[:2], np.linalg.norm(sun[:2])
        center_px = brightness_px - (offset * radius_px / length * sunward if length > 1e-9 else 0.0)
        # The errors of an irregular body stay for many frames, until it has turned: they count for
        # more than their size.
        return Measurement.of_center(self.camera, center_px, 0.3 * radius_px, f * self.body.mean_radius_m / radius_px,
                                     0.3)


class Model(Estimator):
    """Centre of brightness and number of lit pixels against those of the believed frame.

    A frame that is rendered for the estimated state has the same offsets, shape and shadows included. It is drawn as
    digital numbers, through the on-board camera's model.
    """

    name = "model"

    def _measured(self, frame: np.ndarray, believed: StateLike, here: Sight,
                  render: Callable[..., Any]) -> Measurement:
        found = lit_pixels(frame, _LEAST_DN)
        predicted = render(believed, output="dn", exposure_s="auto", seed=0).pixels
        expected = lit_pixels(predicted, _LEAST_DN)
        shift_px = brightness_center_px(found) - brightness_center_px(expected)
        range_m = here.range_m * np.sqrt(np.count_nonzero(expected) / np.count_nonzero(found))
        # A prediction far off is worth less: the body is seen from another side.
        return Measurement.of_center(self.camera, self.camera.project(here.r_body_camera_m) + shift_px,
                                     0.5 + 0.1 * np.linalg.norm(shift_px), range_m, 0.02)


def _least(frame: np.ndarray) -> float | None:
    return _LEAST_DN if frame.dtype.kind in "ui" else None
