"""States and frames of glrender as fields of ROS messages, as plain values; nothing here needs rclpy."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

Stamp = tuple[int, int]
"""Seconds and nanoseconds of a header."""
_ENCODINGS = {"uint8": "mono8", "uint16": "mono16", "float32": "32FC1"}
_PLUMB_BOB = ("k1", "k2", "p1", "p2", "k3")
_RATIONAL = (*_PLUMB_BOB, "k4", "k5", "k6")
# Epochs of which some poses have come and others have not.
_MAX_EPOCHS = 100


class Epochs:
    """Gathers the messages of one stamp, until each of some names has come.

    Parameters
    ----------
    names : iterable of str

    Attributes
    ----------
    n_lost : int
        Epochs that were given up, because a later one was complete or too many were not.
    """

    def __init__(self, names: Iterable[str]):
        self._names, self._epochs, self.n_lost = frozenset(names), {}, 0

    def put(self, name: str, stamp: Stamp, value: Any) -> dict[str, Any] | None:
        """Take a message in; the values by name if it was the last of its epoch."""
        epoch = self._epochs.setdefault(stamp, {})
        epoch[name] = value
        is_complete = epoch.keys() >= self._names
        for old in sorted(self._epochs):
            if old == stamp or (old > stamp if is_complete else len(self._epochs) <= _MAX_EPOCHS):
                break
            del self._epochs[old]
            self.n_lost += 1
        if is_complete:
            del self._epochs[stamp]
        return epoch if is_complete else None


def pose_of(position: Sequence[float], orientation: Sequence[float]) -> dict[str, list[float]]:
    """The pose of a state from those of a ROS pose.

    Parameters
    ----------
    position : (3,) float [m]
        In the inertial frame.
    orientation : (4,) float
        x, y, z, w: it takes the frame's own components to inertial ones, so glrender's is its conjugate.
    """
    x, y, z, w = map(float, orientation)
    return {"r_inertial_m": [float(each) for each in position], "q_from_inertial": [w, -x, -y, -z]}


def state_of(stamp: Stamp, sun_m: Sequence[float], spacecraft: Mapping[str, Any],
             bodies: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """The state of an epoch; poses are of `pose_of`."""
    return {"t_s": stamp[0] + 1e-9 * stamp[1], "r_sun_inertial_m": [float(each) for each in sun_m],
            "spacecraft": dict(spacecraft), "bodies": {name: dict(pose) for name, pose in bodies.items()}}


def header(stamp: Stamp, frame_id: str) -> dict[str, Any]:
    """Fields of std_msgs/Header."""
    return {"stamp": {"sec": stamp[0], "nanosec": stamp[1]}, "frame_id": frame_id}


def image(stamp: Stamp, frame_id: str, pixels: np.ndarray) -> dict[str, Any]:
    """Fields of sensor_msgs/Image: little-endian rows without padding.

    Parameters
    ----------
    stamp, frame_id
        Of the header.
    pixels : (height, width) uint8, uint16 or float32
        Digital numbers (mono8, mono16; 12 bits stay the lower 12) or irradiance [W/m2] (32FC1).

    Raises
    ------
    ValueError
    """
    encoding = _ENCODINGS.get(pixels.dtype.name)
    if encoding is None or pixels.ndim != 2:
        raise ValueError(f"pixels must be (height, width) of {', '.join(_ENCODINGS)}, got {pixels.dtype} of "
                         f"{pixels.ndim} axes: colour mosaics go as their raw frame")
    little = np.ascontiguousarray(pixels, pixels.dtype.newbyteorder("<"))
    height, width = little.shape
    return {"header": header(stamp, frame_id), "height": height, "width": width, "encoding": encoding,
            "is_bigendian": 0, "step": width * little.itemsize, "data": array("B", little.tobytes())}


def camera_info(stamp: Stamp, frame_id: str, camera: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of sensor_msgs/CameraInfo, of a camera as `hello` describes it.

    Pixels are counted alike: (0, 0) is the middle of the first. The projection `p` is the camera's own matrix, as of
    one rectified without scaling. Radial terms in the denominator make the model ``rational_polynomial``.
    """
    focal_px, (centre_x_px, centre_y_px) = camera["focal_length_px"], camera["principal_point_px"]
    lens = camera["distortion"] or {}
    is_rational = any(lens.get(name, 0.0) for name in _RATIONAL[len(_PLUMB_BOB):])
    return {
        "header": header(stamp, frame_id), "height": camera["height_px"], "width": camera["width_px"],
        "distortion_model": "rational_polynomial" if is_rational else "plumb_bob",
        "d": [float(lens.get(name, 0.0)) for name in (_RATIONAL if is_rational else _PLUMB_BOB)],
        "k": [focal_px, 0.0, centre_x_px, 0.0, focal_px, centre_y_px, 0.0, 0.0, 1.0],
        "r": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "p": [focal_px, 0.0, centre_x_px, 0.0, 0.0, focal_px, centre_y_px, 0.0, 0.0, 0.0, 1.0, 0.0],
        "binning_x": 0, "binning_y": 0,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}}


def filled(message: Any, fields: Mapping[str, Any]) -> Any:
    """A message with its fields set, those of messages inside it too."""
    for name, value in fields.items():
        if isinstance(value, Mapping):
            filled(getattr(message, name), value)
        else:
            setattr(message, name, value)
    return message


def topic(name: str) -> str:
    """A body's name as part of a topic: what ROS does not take there is an underscore."""
    made = "".join(each if each.isascii() and each.isalnum() else "_" for each in name)
    return f"_{made}" if made[:1].isdigit() else made
