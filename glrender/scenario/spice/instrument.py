"""Cameras out of SPICE's instrument kernels."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from glrender_camera.validate import integer, known_keys, vector
from scipy.spatial.transform import Rotation

from ...base.attitude import from_spice
from ...base.errors import ConfigError, error_path
from ..checks import unit
from ..instruments.focal_plane import FittedCamera, FocalPlane
from ..instruments.lens import lens_of
from .kernels import Spice, told_by

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

# By how much focal length over pixel size may differ from what the field of view says.
_FIELD_RTOL = 0.05
# No detector has pixels that small.
_LEAST_PIXEL_MM = 1e-3
# Keywords of distortion, and their models.
_KERNEL_LENSES = {"OD_K": "radial", "RAD_DIST_COEFF": "dawnfc"}
# Keywords of the boresight's pixel, and the number of the first pixel that they count from; ISIS counts from 1.
_CENTRES = ((("CCD_CENTER",), 0.0), (("CENTER",), 0.0), (("BORESIGHT_SAMPLE", "BORESIGHT_LINE"), 1.0))
# Keywords of lenses that are not read.
_OTHER_LENSES = re.compile(r"OD_.+|.*DIST(ORTION)?(_.*)?")


def camera_of_kernel(spice: Spice, *, instrument: str, name: str, spacecraft_frame: str | None = None,
                     width_px: int | None = None, height_px: int | None = None, focal_length_px: float | None = None,
                     image_right: ArrayLike = (1.0, 0.0, 0.0), lens: Mapping[str, Any] | None = None,
                     **more: Any) -> FittedCamera:
    """The camera of an instrument kernel, with the lens that the kernel has inverted.

    Parameters
    ----------
    spice : Spice
    instrument : str
        SPICE's name or number.
    name : str
        Name of the camera.
    spacecraft_frame : str, optional
        The frame of the scenario's spacecraft; by default the instrument's own, with no mounting.
    width_px, height_px : int [px], optional
        In place of the kernel's PIXEL_SAMPLES and PIXEL_LINES.
    focal_length_px : float [px], optional
        In place of the kernel's FOCAL_LENGTH over PIXEL_SIZE (or PIXEL_PITCH). Kernels write these in mm and um,
        or both in one unit: it is taken as the field of view (`getfov`) has it, within 5 %.
    image_right : (3,) float
        Direction in the instrument's frame that points right in the image; no kernel has it. The boresight is
        the kernel's, and the third axis, down, follows: no frame is mirrored.
    lens : mapping, optional
        `model` and `coefficients` of `lens_of`, along right and down, or the model "none". By default the kernel's
        OD_K (radial) or RAD_DIST_COEFF (dawnfc), if it has one.
    **more
        Of `PinholeCamera`: model; and principal_point_px in place of the kernel's CCD_CENTER or CENTER, from 0, or
        ISIS's BORESIGHT_SAMPLE and BORESIGHT_LINE, from 1. Without either, the detector's middle.

    Returns
    -------
    FittedCamera
        `camera`, and how well its distortion follows the lens.

    Raises
    ------
    ConfigError
        A keyword that the kernels lack, with its name, or of a lens that is not read; a focal length that does not
        fit the field of view; a lens that the camera's distortion does not follow.
    """
    code = spice.code(instrument, "instrument")
    try:
        _, frame, boresight, _, corners = spice.tool.getfov(code, 50)
    except spice.error as error:
        raise ConfigError("instrument", f"has no field of view in the kernels: {told_by(error)}",
                          instrument) from None
    width = integer("width_px", width_px or _numbers(spice, code, "PIXEL_SAMPLES")[0], 1, 16384)
    height = integer("height_px", height_px or _numbers(spice, code, "PIXEL_LINES")[0], 1, 16384)
    axes = _camera_axes(boresight, image_right)
    focal_length_mm, px_per_mm = 1.0, np.full(2, focal_length_px)
    if focal_length_px is None:
        focal_length_mm, px_per_mm = _focal_plane(spice, code, np.asarray(corners) @ axes.T, width)
    mounting = axes
    if spacecraft_frame is not None:
        for name_of_frame in (frame, spacecraft_frame):
            spice.refuse_shears(name_of_frame)
        mounting = axes @ spice.asked(None, "spacecraft_frame", spice.tool.pxform, spacecraft_frame, frame, 0.0)
    model, coefficients = _lens(spice, code, lens, focal_length_px)
    with error_path("lens"):
        ideal = None if model == "none" else lens_of(model, coefficients, focal_length_mm)
    centre = more.pop("principal_point_px", None)
    centre = vector("principal_point_px", _centre(spice, code, width, height) if centre is None else centre, 2)
    plane = FocalPlane(width_px=width, height_px=height, focal_length_mm=focal_length_mm, centre_px=centre,
                       px_from_mm=np.diag(px_per_mm), lens=ideal)
    fitted = plane.camera(name, **more)
    return replace(fitted, camera=replace(fitted.camera, q_camera_from_spacecraft=from_spice(mounting)))


def _centre(spice: Spice, code: int, width: int, height: int) -> np.ndarray:
    """The pixel (2,) [px] of the boresight without distortion, from 0: the kernel's, else the detector's middle."""
    middle = (np.array([width, height]) - 1.0) / 2.0
    for keys, first in _CENTRES:
        if all(spice.tool.expool(f"INS{code}_{key}") for key in keys):
            centre = np.concatenate([_numbers(spice, code, key) for key in keys]) - first
            if centre.shape != (2,):
                raise ConfigError("principal_point_px", f"must be two numbers, INS{code}_{keys[0]}", centre.tolist())
            whole = [_numbers(spice, code, key)[0] if spice.tool.expool(f"INS{code}_{key}") else size
                     for key, size in (("PIXEL_SAMPLES", width), ("PIXEL_LINES", height))]
            if whole == [width, height]:
                return centre
            if np.abs(centre - (np.array(whole) - 1.0) / 2.0).max() > 0.0:
                raise ConfigError("principal_point_px", f"missing: the kernel's {keys[0]} is of {whole[0]:g} x "
                                  f"{whole[1]:g} px, not of {width} x {height}", hint="give it by hand")
    return middle


def _numbers(spice: Spice, code: int, key: str) -> np.ndarray:
    try:
        return np.atleast_1d(spice.tool.gdpool(f"INS{code}_{key}", 0, 20))
    except spice.error:
        raise ConfigError("instrument", f"has no INS{code}_{key} in the kernels", code, "give it by hand") from None


def _focal_plane(spice: Spice, code: int, corners_camera: np.ndarray, width_px: int) -> tuple[float, np.ndarray]:
    """Focal length [mm], and pixels per mm (2,) to the right and down."""
    size_key = "PIXEL_SIZE" if spice.tool.expool(f"INS{code}_PIXEL_SIZE") else "PIXEL_PITCH"
    length, sizes = _numbers(spice, code, "FOCAL_LENGTH")[0], _numbers(spice, code, size_key)
    ratio = length / sizes[0]
    by_field = width_px / float(np.ptp(corners_camera[:, 0] / corners_camera[:, 2]))
    if len(corners_camera) > 2:
        for scale in (1000.0, 1.0):
            if abs(ratio * scale / by_field - 1.0) < _FIELD_RTOL:
                # In one unit with pixels below a micrometre it is the metre.
                length_mm = length * (1000.0 if scale == 1.0 and sizes[0] < _LEAST_PIXEL_MM else 1.0)
                return float(length_mm), ratio * scale * sizes[0] / sizes[[0, min(1, len(sizes) - 1)]] / length_mm
    raise ConfigError("focal_length_px", f"is {ratio * 1000.0:.6g} px by FOCAL_LENGTH over {size_key}, in mm and "
                      f"um, but {by_field:.6g} px by the field of view", hint="give focal_length_px")


def _lens(spice: Spice, code: int, lens: Mapping[str, Any] | None,
          focal_length_px: float | None) -> tuple[str, np.ndarray | None]:
    """Model and coefficients of the lens, those of the kernel by default."""
    if lens is not None:
        known_keys("lens", lens, ("model", "coefficients"), required=("model",))
        return lens["model"], lens.get("coefficients")
    for key, model in _KERNEL_LENSES.items():
        if spice.tool.expool(f"INS{code}_{key}"):
            if focal_length_px is not None:
                raise ConfigError("focal_length_px", f"is given, and the kernel's {key} counts in mm", focal_length_px,
                                  'give lens.model = "none" too, or neither')
            return model, _numbers(spice, code, key)
    for name in spice.tool.gnpool(f"INS{code}_*", 0, 1000):
        if _OTHER_LENSES.fullmatch(name.removeprefix(f"INS{code}_")):
            raise ConfigError("lens", "is not read from the kernel's keyword", name,
                              'give lens = {model, coefficients}, or lens.model = "none"')
    return "none", None


def _camera_axes(boresight: np.ndarray, image_right: ArrayLike) -> np.ndarray:
    """Camera axes right, down, boresight (3, 3) as rows in the instrument's frame."""
    z, right = unit("boresight", boresight), unit("image_right", image_right)
    right = right - (right @ z) * z
    if not np.linalg.norm(right) > 1e-6:
        raise ConfigError("image_right", "must not be along the boresight", np.asarray(image_right).tolist())
    x = right / np.linalg.norm(right)
    return Rotation.from_matrix(np.stack([x, np.cross(z, x), z])).as_matrix()
