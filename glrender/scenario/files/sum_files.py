"""SUM files of stereophotoclinometry (SPC): the camera, the pose and the light of one image."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from glrender_camera import PinholeCamera

from ...base.attitude import from_spice
from ...base.constants import AU_M
from ...base.errors import ConfigError, error_path
from ...view.state import Pose, State
from ..epochs import Epoch
from .state_files import date_of, text_of

_M_PER_KM = 1000.0
# Lines of numbers after name and date, each with its label behind them and how many numbers it holds.
_LINES = {"NPX": 4, "MMFL": 3, "SCOBJ": 3, "CX": 3, "CY": 3, "CZ": 3, "SZ": 3, "K-MATRIX": 6, "DISTORTION": 4}
_MAX_OFFSET_PX = 0.5


@dataclass(frozen=True, kw_only=True)
class SumImage:
    """An image's camera and state, as its SUM file has them.

    Parameters
    ----------
    name : str
        Name of the image.
    epoch : Epoch
        Epoch of mid-exposure.
    camera : PinholeCamera
    state : State
        One body at the origin, in whose frame `inertial` is; the Sun at the distance that was given.
    """

    name: str
    epoch: Epoch
    camera: PinholeCamera
    state: State


def image_of_sum(path: str | Path, *, body: str, camera: str = "camera", sun_distance_m: float = AU_M) -> SumImage:
    """An image's camera and state of a SUM file.

    Parameters
    ----------
    path : path
    body : str
        Name of the body in the state; its shape is in the frame of SCOBJ.
    camera : str
        Name of the camera.
    sun_distance_m : float [m]
        The file has the Sun's direction alone.

    Raises
    ------
    ConfigError
        With the file and the line: numbers that are missing or wrong, axes that mirror, a K-MATRIX with skew or with
        pixels that are not square by more than half a pixel at a corner, a DISTORTION of the old NEAR kind.

    Source: Gaskell et al. (2008), Meteoritics & Planetary Science 43, 1049; labels as SPC writes them. Axes CX, CY,
    CZ are right-handed, so a negative K22 counts lines from the lowest one upwards, as FITS does. CTR counts pixel
    centres from 1: it is 512.5 in the SUM files of Dawn's 1024 x 1024 px camera.
    """
    path = Path(path)
    lines = text_of(path).splitlines()
    if len(lines) < 2 + len(_LINES):
        raise ConfigError(path.name, f"must have {2 + len(_LINES)} lines at least", len(lines),
                          "give a SUM file of SPC")
    rows = {label: _row(path.name, number, lines[number - 1], label, count)
            for number, (label, count) in enumerate(_LINES.items(), start=3)}
    width, height = int(rows["NPX"][0]), int(rows["NPX"][1])
    focal_x, skew_x, _, skew_y, focal_y, _ = rows["MMFL"][0] * rows["K-MATRIX"]
    if rows["DISTORTION"].any():
        raise ConfigError(f"{path.name}.DISTORTION", "must be 0: NEAR's model is not known here",
                          rows["DISTORTION"].tolist(), "correct the image, and set it to 0")
    focal_px = 0.5 * (abs(focal_x) + abs(focal_y))
    if not focal_px > 0.0:
        raise ConfigError(f"{path.name}.K-MATRIX", "must give a focal length", rows["K-MATRIX"].tolist())
    corner = 0.5 * np.array([width, height]) / focal_px
    residual = np.abs([[abs(focal_x) - focal_px, skew_x], [skew_y, abs(focal_y) - focal_px]]) @ corner
    if not residual.max() <= _MAX_OFFSET_PX:
        raise ConfigError(f"{path.name}.K-MATRIX", f"must be of square pixels without skew within {_MAX_OFFSET_PX} px "
                          "at a corner", rows["K-MATRIX"].tolist(), "resample the image")
    # Both axes turn with the sign of K11: the image stays unmirrored, its lines may be counted upwards.
    axes = np.stack([np.sign(focal_x) * rows["CX"], np.sign(focal_x) * rows["CY"], rows["CZ"]])
    centre_px = rows["MMFL"][1:] - 1.0
    if focal_x * focal_y < 0.0:
        centre_px[1] = height - 1.0 - centre_px[1]
    q = from_spice(_checked_axes(path.name, axes))
    state = State(r_sun_inertial_m=sun_distance_m * rows["SZ"] / np.linalg.norm(rows["SZ"]),
                  spacecraft=Pose(r_inertial_m=-_M_PER_KM * rows["SCOBJ"], q_from_inertial=q),
                  bodies={body: Pose(r_inertial_m=np.zeros(3))})
    with error_path(path.name):
        made = PinholeCamera(name=camera, width_px=width, height_px=height, focal_length_px=focal_px,
                             principal_point_px=tuple(centre_px))
    return SumImage(name=lines[0].strip(), epoch=_epoch(path.name, lines[1]), camera=made, state=state)


def _row(file: str, number: int, line: str, label: str, count: int) -> np.ndarray:
    """The numbers of a line; Fortran's D for E is taken."""
    words = line.split()
    if label not in " ".join(words[count:]):
        raise ConfigError(f"{file}:{number}", f"must have {count} numbers and then {label}", line.strip())
    try:
        numbers = np.array([float(word.upper().replace("D", "E")) for word in words[:count]])
    except ValueError:
        numbers = np.array([np.nan])
    if not np.isfinite(numbers).all():
        raise ConfigError(f"{file}:{number}.{label}", "must be finite numbers", words[:count])
    return numbers


def _checked_axes(file: str, axes: np.ndarray) -> np.ndarray:
    if not np.abs(axes @ axes.T - np.eye(3)).max() < 1e-6:
        raise ConfigError(f"{file}.CX", "and CY, CZ must be orthonormal within 1e-6", axes.tolist())
    if not np.linalg.det(axes) > 0.0:
        raise ConfigError(f"{file}.CX", "CY and CZ must be right-handed", axes.tolist(), "mirror the image first")
    return axes


def _epoch(file: str, line: str) -> Epoch:
    try:
        moment = date_of(line)
    except ValueError:
        raise ConfigError(f"{file}:2", "must be a date in UTC as 2019 MAR 14 19:01:23.961", line.strip()) from None
    return Epoch.from_utc(moment, f"{file}:2")
