"""Estimators by centre of brightness, corrected for the phase angle."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from .believed import NEXT_PX, grown, is_anothers_ground
from .camera import Sight, StateLike, others_px
from .measurement import Estimator, Measurement, NotFound, brightness_center_px, lit_pixels

# Lit pixels at an image's edge that may be stars, and their share of all that are lit.
_MOST_CUT_PX, _MOST_CUT = 4, 0.05
# Share of the lit disc that other bodies must leave.
_LEAST_LEFT = 0.7
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
        lit = _apart(_whole(lit_pixels(frame, _least(frame)), "the frame"), self.camera.project(here.r_body_camera_m),
                     others_px(believed, self.camera, self.body.name))
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
        others = others_px(believed, self.camera, self.body.name)
        products = ("range", "r_body") if others else ()
        predicted = render(believed, output="dn", exposure_s="auto", seed=0, products=list(products))
        expected = lit_pixels(predicted.pixels, _LEAST_DN)
        if others:
            near = grown(is_anothers_ground(predicted.arrays, np.zeros(2, int), self.camera, here, self.body), NEXT_PX)
            found[near] = expected[near] = 0.0
            radius_px = self.camera.focal_length_px * self.body.mean_radius_m / here.range_m
            lit_px = 0.5 * np.pi * radius_px**2 * (1.0 + np.cos(here.phase_rad))
            if (left := np.count_nonzero(expected) / lit_px) < _LEAST_LEFT:
                raise NotFound(f"other bodies leave {left:.0%} of the lit disc, {_LEAST_LEFT:.0%} are needed")
        found, expected = _whole(found, "the frame"), _whole(expected, "the believed frame")
        shift_px = brightness_center_px(found) - brightness_center_px(expected)
        range_m = here.range_m * np.sqrt(np.count_nonzero(expected) / np.count_nonzero(found))
        # A prediction far off is worth less: the body is seen from another side.
        return Measurement.of_center(self.camera, self.camera.project(here.r_body_camera_m) + shift_px,
                                     0.5 + 0.1 * np.linalg.norm(shift_px), range_m, 0.02)


def _whole(lit: np.ndarray, what: str) -> np.ndarray:
    """The lit pixels (H, W) of an image, if they are some and none is cut by its edge.

    Raises
    ------
    NotFound
    """
    if not lit.any():
        raise NotFound(f"other bodies leave nothing of this one in {what}")
    n_cut = sum(np.count_nonzero(edge) for edge in (lit[0], lit[-1], lit[:, 0], lit[:, -1]))
    if n_cut > min(_MOST_CUT_PX, _MOST_CUT * np.count_nonzero(lit)):
        raise NotFound(f"the body is cut by the edge of {what}, where {n_cut} pixels are lit: its centre of brightness "
                       "needs the whole body")
    return lit


def _apart(lit: np.ndarray, believed_px: np.ndarray, others: dict[str, np.ndarray]) -> np.ndarray:
    """The lit pixels (H, W) without those of other bodies, by their believed places (2,) [px].

    Raises
    ------
    NotFound
        Another body is before this one, behind it or next to it.
    """
    height, width = lit.shape
    inside = {name: px for name, px in others.items() if ((px >= 0.0) & (px < [width, height])).all()}
    if not inside:
        return lit
    _, piece = cv2.connectedComponents((lit > 0.0).astype(np.uint8))
    rows, columns = np.nonzero(lit)
    off = {name: np.hypot(columns - px[0], rows - px[1]) for name, px in {"": believed_px, **inside}.items()}
    nearest = {name: int(piece[rows[each.argmin()], columns[each.argmin()]]) for name, each in off.items()}
    for name in inside:
        if nearest[name] == nearest[""]:
            raise NotFound(f"{name!r} is believed where this body is seen, before it, behind it or next to it: their "
                           "light cannot be separated")
        lit[piece == nearest[name]] = 0.0
    return lit


def _least(frame: np.ndarray) -> float | None:
    return _LEAST_DN if frame.dtype.kind in "ui" else None
