"""Cameras out of SPICE's instrument kernels."""

from __future__ import annotations

from typing import Any

import numpy as np
from glrender_camera import PinholeCamera
from glrender_camera.validate import integer
from scipy.spatial.transform import Rotation

from ...base.attitude import from_spice
from ...base.errors import ConfigError
from ..checks import unit
from .kernels import Spice, told_by

# By how much focal length over pixel size may differ from what the field of view says.
_FIELD_RTOL = 0.05


def camera_of_kernel(spice: Spice, *, instrument: str, name: str, spacecraft_frame: str | None = None,
                     width_px: int | None = None, height_px: int | None = None, focal_length_px: float | None = None,
                     image_right: np.ndarray = (1.0, 0.0, 0.0), **more: Any) -> PinholeCamera:
    """The camera of an instrument kernel, without its distortion.

    Parameters
    ----------
    spice : Spice
    instrument : str
        SPICE's name or number.
    name : str
        Of the camera.
    spacecraft_frame : str, optional
        The frame of the scenario's spacecraft; by default the instrument's own, with no mounting.
    width_px, height_px : int [px], optional
        In place of the kernel's PIXEL_SAMPLES and PIXEL_LINES.
    focal_length_px : float [px], optional
        In place of the kernel's FOCAL_LENGTH over PIXEL_SIZE (or PIXEL_PITCH). Kernels write these in mm and um,
        or both in one unit: it is taken as the field of view (`getfov`) has it, within 5 %.
    image_right : (3,) float
        Direction in the instrument's frame that points right in the image; no kernel tells it. The boresight is
        the kernel's, and the third axis, down, follows: no frame is mirrored.
    **more
        Of `PinholeCamera`: principal_point_px, model, distortion.

    Raises
    ------
    ConfigError
        A keyword that the kernels lack, with its name; a focal length that does not fit the field of view.
    """
    code = spice.code(instrument, "instrument")
    try:
        _, frame, boresight, _, corners = spice.tool.getfov(code, 50)
    except spice.error as error:
        raise ConfigError("instrument", f"has no field of view in the kernels: {told_by(error)}",
                          instrument) from None
    width = integer("width_px", width_px or _number(spice, code, "PIXEL_SAMPLES"), 1, 16384)
    height = integer("height_px", height_px or _number(spice, code, "PIXEL_LINES"), 1, 16384)
    axes = _camera_axes(boresight, image_right)
    if focal_length_px is None:
        focal_length_px = _focal_length_px(spice, code, np.asarray(corners) @ axes.T, width)
    mounting = axes
    if spacecraft_frame is not None:
        mounting = axes @ spice.asked(None, "spacecraft_frame", spice.tool.pxform, spacecraft_frame, frame, 0.0)
    return PinholeCamera(name=name, width_px=width, height_px=height, focal_length_px=focal_length_px,
                         q_camera_from_spacecraft=from_spice(mounting), **more)


def _number(spice: Spice, code: int, key: str) -> float:
    try:
        return float(spice.tool.gdpool(f"INS{code}_{key}", 0, 1)[0])
    except spice.error:
        raise ConfigError("instrument", f"has no INS{code}_{key} in the kernels", code, "give it by hand") from None


def _focal_length_px(spice: Spice, code: int, corners_camera: np.ndarray, width_px: int) -> float:
    size_key = "PIXEL_SIZE" if spice.tool.expool(f"INS{code}_PIXEL_SIZE") else "PIXEL_PITCH"
    ratio = _number(spice, code, "FOCAL_LENGTH") / _number(spice, code, size_key)
    by_field = width_px / float(np.ptp(corners_camera[:, 0] / corners_camera[:, 2]))
    if len(corners_camera) > 2:
        for scale in (1000.0, 1.0):
            if abs(ratio * scale / by_field - 1.0) < _FIELD_RTOL:
                return ratio * scale
    raise ConfigError("focal_length_px", f"is {ratio * 1000.0:.6g} px by FOCAL_LENGTH over {size_key}, in mm and "
                      f"um, but {by_field:.6g} px by the field of view", hint="give focal_length_px")


def _camera_axes(boresight: np.ndarray, image_right: np.ndarray) -> np.ndarray:
    """Camera axes right, down, boresight (3, 3) as rows in the instrument's frame."""
    z, right = unit("boresight", boresight), unit("image_right", image_right)
    right = right - (right @ z) * z
    if not np.linalg.norm(right) > 1e-6:
        raise ConfigError("image_right", "must not be along the boresight", list(image_right))
    x = right / np.linalg.norm(right)
    return Rotation.from_matrix(np.stack([x, np.cross(z, x), z])).as_matrix()
