"""CCSDS attitudes: AEM files in keyword = value notation, of all the standard's types."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from glrender_camera.validate import text
from scipy.spatial.transform import Rotation

from ...base.errors import ConfigError, error_path
from ..attitude import Attitude
from .attitude_rows import AttitudeSegments, AttitudesWithRates
from .kvn import INERTIAL, Segment, in_capitals, of_one_object, one_value, same, segments_of, since
from .tables import AttitudeTable

# Metadata that is used, and that may be passed over: names for people, whose orbit it is, the ends of the rows, and
# how the rows are best interpolated.
_USED = ("OBJECT_NAME", "REF_FRAME_A", "REF_FRAME_B", "ATTITUDE_DIR", "TIME_SYSTEM", "USEABLE_START_TIME",
         "USEABLE_STOP_TIME", "ATTITUDE_TYPE", "QUATERNION_TYPE", "EULER_ROT_SEQ", "RATE_FRAME", "ANGVEL_FRAME")
_PASSED_OVER = ("OBJECT_ID", "CENTER_NAME", "START_TIME", "STOP_TIME", "INTERPOLATION_METHOD", "INTERPOLATION_DEGREE")
# Numbers of a row. Version 1 calls angular velocities rates.
_WIDTHS = {"QUATERNION": 4, "QUATERNION/DERIVATIVE": 8, "QUATERNION/RATE": 7, "QUATERNION/ANGVEL": 7,
           "EULER_ANGLE": 3, "EULER_ANGLE/DERIVATIVE": 6, "EULER_ANGLE/RATE": 6, "EULER_ANGLE/ANGVEL": 6,
           "SPIN": 4, "SPIN/NUTATION": 7, "SPIN/NUTATION_MOM": 7}


def attitude_of_aem(path: str | Path, object_name: str | None = None, *, frame: str | None = None,
                    bodies: Sequence[str] = ()) -> Attitude:
    """The attitudes of an Attitude Ephemeris Message (AEM).

    Parameters
    ----------
    path : path
        A file in KVN, of any ATTITUDE_TYPE; versions 1 and 2.
    object_name : str, optional
        Needed where the file has several objects.
    frame : str, optional
        The file's name of the frame whose attitude is wanted, where it is none of SC_BODY_1, IAU_X, X_FIXED of the
        object X: a star tracker's frame is not the spacecraft's.
    bodies : sequence of str
        Names that the object may not have where no `object_name` is given.

    Returns
    -------
    Attitude
        Between rows with rates as these have it, else at a constant rate; within USEABLE times.

    Raises
    ------
    ConfigError
        With the file and the line: a keyword or a type that is not known, no frame or two that are inertial, rates
        that do not lead from row to row.

    Source: CCSDS 504.0-B-2, section 4, and B-1; the quaternion turns frames, so glrender's is the conjugate. Euler
    angles are in the order of the sequence, spin axes are +Z, as Orekit 12 reads them.
    """
    path = Path(path)
    version, segments = segments_of(path, "AEM", ("1.0", "2.0"), (*_USED, *_PASSED_OVER))
    segments = of_one_object(path, segments, object_name, bodies)
    with error_path(path.name):
        for key in ("REF_FRAME_A", "REF_FRAME_B"):
            one_value(segments, key)
        parts = [_part(segment, version, frame) for segment in segments]
    return AttitudeSegments(parts=[part for part, _ in parts], useable=[span for _, span in parts])


def _part(segment: Segment, version: str, frame: str | None) -> tuple[Attitude, tuple]:
    """The attitudes of a segment, and between which epochs they may be used."""
    kind = segment.value("ATTITUDE_TYPE", tuple(_WIDTHS))
    is_from_inertial = _is_from_inertial(segment, version, frame)
    epochs, numbers = segment.table((_WIDTHS[kind],))
    to_from, rates = _turns(segment, version, kind, np.array(numbers))
    if not is_from_inertial:
        # The other frame's rate, and its other sign.
        to_from, rates = to_from.inv(), None if rates is None else -to_from.inv().apply(rates)
    q, times = to_from.as_quat(scalar_first=True), since(epochs)
    span = segment.useable(epochs)
    if rates is None:
        return AttitudeTable(times_s=times, q_from_inertial=q, epoch=epochs[0], interpolation="linear"), span
    return AttitudesWithRates(times_s=times, q_from_inertial=q, rates_rad_s=rates, epoch=epochs[0],
                              lines=[line for line, _ in segment.rows], is_spin=kind == "SPIN"), span


def _is_from_inertial(segment: Segment, version: str, frame: str | None) -> bool:
    """Whether the rows turn from an inertial frame to the object's, or the other way."""
    both = [segment.meta.get(f"REF_FRAME_{name}", "") for name in "AB"]
    inertial = [in_capitals(name) in INERTIAL for name in both]
    if sum(inertial) != 1:
        raise ConfigError("REF_FRAME_A", f"or REF_FRAME_B must be one of {', '.join(INERTIAL)}, the other not", both)
    own, name = both[inertial.index(False)], segment.meta.get("OBJECT_NAME", "")
    if frame is not None and not same(own, text("frame", frame)):
        raise ConfigError(f"REF_FRAME_{'AB'[inertial.index(False)]}", f"must be {frame!r}, the frame that is asked for",
                          own)
    if frame is None and not re.match(r"SC_BODY(_\w+)?$", in_capitals(own)) and not any(
            same(own, usual) for usual in (f"IAU_{name}", f"{name}_FIXED")):
        raise ConfigError(f"REF_FRAME_{'AB'[inertial.index(False)]}", "must be SC_BODY_1 or another SC_BODY", own,
                          f"write frame = {own!r} if its attitude is the one that is meant")
    if version == "2.0":
        segment.value("ATTITUDE_DIR", ("A2B",), "A2B", "version 2 has this direction alone: where the rows turn from "
                      "REF_FRAME_B to REF_FRAME_A, exchange what these two say, and leave ATTITUDE_DIR out")
        return inertial[0]
    direction = segment.value("ATTITUDE_DIR", ("A2B", "B2A"), hint="version 1 must have it: add ATTITUDE_DIR = A2B "
                              "where the rows turn from REF_FRAME_A to REF_FRAME_B, else B2A")
    return inertial[0] == (direction == "A2B")


def _turns(segment: Segment, version: str, kind: str, rows: np.ndarray) -> tuple[Rotation, np.ndarray | None]:
    """Rotations that take components in a row's first frame to its second, and the rate of the second [rad/s].

    The rate is of the second frame relative to the first, in the second; None where the type has none.
    """
    attitude, _, more = kind.partition("/")
    if attitude == "QUATERNION":
        is_first = _is_scalar_first(segment, version)
        q = _unit(segment, rows[:, :4])
        from_to = Rotation.from_quat(q, scalar_first=is_first)
        if more == "DERIVATIVE":
            return from_to.inv(), _rates_of_quaternions(q, rows[:, 4:], is_first)
        rest = rows[:, 4:]
    elif attitude == "EULER_ANGLE":
        axes = _sequence(segment)
        from_to, rest = Rotation.from_euler(axes, rows[:, :3], degrees=True), rows[:, 3:]
        if more == "DERIVATIVE":
            return from_to.inv(), _rates_of_euler(axes, rows[:, :3], np.radians(rest))
    else:
        return _spinning(segment, more, rows)
    return from_to.inv(), _in_second(segment, version, from_to.inv(), np.radians(rest)) if more else None


def _is_scalar_first(segment: Segment, version: str) -> bool:
    if version == "2.0":
        segment.value("QUATERNION_TYPE", ("LAST",), "LAST", "version 2 has the scalar last: put it there, or write "
                      "CCSDS_AEM_VERS = 1.0 if the file is of that version")
        return False
    return segment.value("QUATERNION_TYPE", ("FIRST", "LAST"), hint="version 1 must have it: add QUATERNION_TYPE = "
                         "LAST where the scalar is the last number of four, else FIRST") == "FIRST"


def _unit(segment: Segment, q: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(q, axis=1)
    if (wrong := np.abs(length - 1.0) > 1e-3).any():
        row = int(np.argmax(wrong))
        raise ConfigError(f"line {segment.rows[row][0]}", "must have a quaternion of norm 1 within 0.001",
                          round(float(length[row]), 6))
    return q / length[:, None]


def _sequence(segment: Segment) -> str:
    """The axes of Euler's angles, as SciPy has them: ZXZ of 313."""
    text = segment.meta.get("EULER_ROT_SEQ", "").upper().translate(str.maketrans("123", "XYZ"))
    if not re.fullmatch("[XYZ]{3}", text) or text[0] == text[1] or text[1] == text[2]:
        raise ConfigError("EULER_ROT_SEQ", "must be three of X, Y, Z or 1, 2, 3, neighbours not the same",
                          segment.meta.get("EULER_ROT_SEQ"))
    return text


def _in_second(segment: Segment, version: str, second_from_first: Rotation, rates: np.ndarray) -> np.ndarray:
    """Rates in the second frame, of those in the frame that the metadata names."""
    key = "ANGVEL_FRAME" if version == "2.0" else "RATE_FRAME"
    named = [name for name in "AB" if same(segment.meta.get(key, ""), f"REF_FRAME_{name}")
             or same(segment.meta.get(key, ""), segment.meta[f"REF_FRAME_{name}"])]
    if len(named) != 1:
        raise ConfigError(key, "must be the frame of the rates, REF_FRAME_A or REF_FRAME_B", segment.meta.get(key))
    is_a2b = segment.meta.get("ATTITUDE_DIR", "A2B").upper() == "A2B"
    return rates if (named == ["B"]) == is_a2b else second_from_first.apply(rates)


def _rates_of_quaternions(q: np.ndarray, q_dot: np.ndarray, is_first: bool) -> np.ndarray:
    """Rates 2 q* q' (N, 3) [rad/s] of quaternions and their derivatives (N, 4) [1/s], scalar first or last."""
    if is_first:
        q, q_dot = np.roll(q, -1, axis=1), np.roll(q_dot, -1, axis=1)
    return 2.0 * (q[:, 3:] * q_dot[:, :3] - q_dot[:, 3:] * q[:, :3] - np.cross(q[:, :3], q_dot[:, :3]))


def _rates_of_euler(axes: str, angles_deg: np.ndarray, derivatives: np.ndarray) -> np.ndarray:
    """Rates (N, 3) in the last frame of Euler angles (N, 3) [deg] and their derivatives: each axis turned on."""
    rates = np.zeros_like(derivatives)
    for k, axis in enumerate(axes):
        rates = Rotation.from_euler(axis, angles_deg[:, k:k + 1], degrees=True).inv().apply(rates)
        rates[:, "XYZ".index(axis)] += derivatives[:, k]
    return rates


def _spinning(segment: Segment, more: str, rows: np.ndarray) -> tuple[Rotation, np.ndarray]:
    """Rotations and rates of a spin axis, +Z, by right ascension, declination and phase, and how it nutates."""
    alpha, delta, phase, spin = rows[:, :4].T
    turned = Rotation.from_euler("ZXZ", np.stack([90.0 + alpha, 90.0 - delta, phase], axis=1), degrees=True).inv()
    rates = np.radians(spin)[:, None] * [0.0, 0.0, 1.0]
    if more == "NUTATION":
        nutation, period_s, angle = rows[:, 4:].T
        if (wrong := (period_s == 0.0) & (nutation != 0.0)).any():
            raise ConfigError(f"line {segment.rows[int(np.argmax(wrong))][0]}",
                              "must have a nutation period, as it has a nutation angle", 0.0)
        sine, nutation_phase = np.sin(np.radians(nutation)), np.radians(angle)
        momentum = np.stack([sine * np.cos(nutation_phase), -sine * np.sin(nutation_phase),
                             np.cos(np.radians(nutation))], axis=1)
        speed = np.divide(2.0 * np.pi, period_s, out=np.zeros_like(period_s), where=period_s != 0.0)
        rates = rates + speed[:, None] * momentum
    elif more == "NUTATION_MOM":
        alpha, delta, speed = np.radians(rows[:, 4:].T)
        momentum = np.stack([np.cos(delta) * np.cos(alpha), np.cos(delta) * np.sin(alpha), np.sin(delta)], axis=1)
        rates = rates + speed[:, None] * turned.apply(momentum)
    return turned, rates
