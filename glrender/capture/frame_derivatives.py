"""Derivatives of a camera's image and of its digital numbers, by those of the irradiance that a renderer drew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from glrender_camera import CameraModel, ConfigError, Frame, PinholeCamera
from glrender_camera.expected import changed_electrons

from ..engines.derivatives.jacobian import Jacobian


def check_still(camera: PinholeCamera, is_moving: bool) -> None:
    """Refuse derivatives of digital numbers that no one image and one band make.

    Raises
    ------
    ConfigError
    """
    if is_moving:
        raise ConfigError("derivatives", "are of a frame that stands still: this state moves during the exposure",
                          hint="leave rates, courses and sub_states out")
    if not isinstance(camera.model, CameraModel):
        raise ConfigError("derivatives", "are of a camera of one band, and this one has a mosaic",
                          hint="give a camera of its own for each letter")


def without_margin(jacobian: Jacobian, margin_px: int, camera: PinholeCamera) -> Jacobian:
    """The derivatives of the frame alone, of an image with a margin."""
    x0, y0, x1, y1 = roi = jacobian.moved(-margin_px, -margin_px).roi
    sizes = 2 * (camera.width_px, camera.height_px)
    left, top, right, bottom = (min(max(edge, 0), size) for edge, size in zip(roi, sizes, strict=True))
    part = np.s_[:, top - y0:max(bottom, top) - y0, left - x0:max(right, left) - x0]
    return replace(jacobian, roi=(left, top, max(right, left), max(bottom, top)),
                   arrays={name: np.ascontiguousarray(values[part]) for name, values in jacobian.items()})


def of_digital_numbers(jacobian: Jacobian, camera: PinholeCamera, margin_px: int, frame: Frame) -> Jacobian:
    """Derivatives [DN] of a frame's mean digital numbers by those of the image (with its margin) that it was made of.

    Full pixels have none. Stars, the Sun's own disc, light from beyond the frame, faults, the pixels' own pattern and a
    bent characteristic are left out.
    """
    model, seen = camera.model, camera.with_margin(margin_px)
    gain, is_full = np.float32(model.detector.gain_DN_per_electron), frame.saturated
    arrays = {}
    for name in jacobian:
        whole = jacobian.whole(jacobian.each(name), (seen.height_px, seen.width_px))
        arrays[name] = gain * changed_electrons(model, whole, frame.exposure_s, margin_px=margin_px,
                                                relative_illumination=seen.cos_field_angle)
        arrays[name][:, is_full] = 0.0
    return replace(jacobian, roi=(0, 0, camera.width_px, camera.height_px), arrays=arrays)
