"""CCSDS ephemerides and attitudes: OEM and AEM files in keyword = value notation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from ...base.errors import ConfigError, error_path
from ..epochs import Epoch
from ..paths import Trajectory
from .state_files import text_of
from .tables import AttitudeTable, Segments, TrajectoryTable

# EME2000 is ICRF to 0.02 arcseconds; the files do not tell these apart any better.
_INERTIAL = ("ICRF", "ICRF2", "ICRF3", "EME2000", "J2000", "GCRF")
_M_PER_KM = 1000.0


@dataclass
class _Segment:
    """A block of metadata, and the rows behind it with their line numbers."""

    meta: dict[str, str] = field(default_factory=dict)
    rows: list[tuple[int, list[str]]] = field(default_factory=list)


def trajectory_of_oem(path: str | Path, about: str, object_name: str | None = None) -> Trajectory:
    """The trajectory of an Orbit Ephemeris Message (OEM).

    Parameters
    ----------
    path : path
        A file in KVN; kilometres, as the standard has them.
    about : str
        The name in the scenario of the file's CENTER_NAME.
    object_name : str, optional
        Needed where the file has several objects.

    Returns
    -------
    Trajectory
        Interpolated as `TrajectoryTable` does it, within each segment.

    Raises
    ------
    ConfigError
        With the file and the line: another frame than ICRF, EME2000 or J2000, several centres, another time system
        than TDB, UTC, TT, TAI.

    Source: CCSDS 502.0-B-3, section 5.
    """
    path = Path(path)
    segments = _one_object(path, _segments(path, "CCSDS_OEM_VERS"), object_name)
    parts = []
    for segment in segments:
        with error_path(path.name):
            _needed(segment.meta, "REF_FRAME", _INERTIAL)
            if segment.meta.get("CENTER_NAME") != segments[0].meta.get("CENTER_NAME"):
                raise ConfigError("CENTER_NAME", "must be one in the whole file", segment.meta.get("CENTER_NAME"))
            epochs, numbers = _table(segment, (6, 9))
            parts.append(TrajectoryTable(times_s=_since(epochs), about=about, epoch=epochs[0],
                                         r_m=numbers[:, :3] * _M_PER_KM, v_m_s=numbers[:, 3:6] * _M_PER_KM))
    return parts[0] if len(parts) == 1 else Segments(parts=parts)


def attitude_of_aem(path: str | Path, object_name: str | None = None) -> AttitudeTable:
    """The attitudes of an Attitude Ephemeris Message (AEM) of quaternions, one segment.

    Parameters
    ----------
    path : path
        A file in KVN, of ATTITUDE_TYPE QUATERNION; versions 1 and 2.
    object_name : str, optional
        Needed where the file has several objects.

    Raises
    ------
    ConfigError
        With the file and the line: several segments, another type, no frame or two that are inertial.

    Source: CCSDS 504.0-B-2, section 4; the quaternion turns frames, so glrender's is the conjugate.
    """
    path = Path(path)
    segments = _one_object(path, _segments(path, "CCSDS_AEM_VERS"), object_name)
    if len(segments) > 1:
        raise ConfigError(path.name, "must have one segment", len(segments), "split the file")
    meta = segments[0].meta
    with error_path(path.name):
        _needed(meta, "ATTITUDE_TYPE", ("QUATERNION",))
        a_to_b = _needed(meta, "ATTITUDE_DIR", ("A2B", "B2A")) == "A2B" if "ATTITUDE_DIR" in meta else True
        frames = [meta.get(f"REF_FRAME_{name}", "") in _INERTIAL for name in "AB"]
        if sum(frames) != 1:
            raise ConfigError("REF_FRAME_A", f"or REF_FRAME_B must be one of {', '.join(_INERTIAL)}, the other not",
                              [meta.get(f"REF_FRAME_{name}") for name in "AB"])
        epochs, q = _table(segments[0], (4,))
        if meta.get("QUATERNION_TYPE", "LAST") == "LAST":
            q = np.roll(q, 1, axis=1)
        # The conjugate of the file's takes components in its first frame to those in its second.
        if a_to_b == frames[0]:
            q = q * [1.0, -1.0, -1.0, -1.0]
        return AttitudeTable(times_s=_since(epochs), q_from_inertial=q, epoch=epochs[0],
                             interpolation="linear")


def _segments(path: Path, version_key: str) -> list[_Segment]:
    """The segments of a file: metadata by key, rows as words."""
    text = text_of(path)
    if text.lstrip().startswith("<"):
        raise ConfigError(path.name, "is XML; only keyword = value notation is read", str(path))
    segments, in_meta, in_covariance, is_known = [], False, False, False
    for number, line in enumerate(text.splitlines(), 1):
        line = line.strip()
        if not line or line.startswith("COMMENT") or line in ("DATA_START", "DATA_STOP"):
            continue
        if line.startswith("COVARIANCE_ST"):
            in_covariance = line == "COVARIANCE_START"
        elif line == "META_START":
            segments.append(_Segment())
            in_meta = True
        elif line == "META_STOP":
            in_meta = False
        elif "=" in line:
            key, value = (part.strip() for part in line.split("=", 1))
            is_known |= key == version_key
            if in_meta:
                segments[-1].meta[key] = value
        elif segments and not in_meta and not in_covariance:
            segments[-1].rows.append((number, line.split()))
    if not is_known or not segments:
        raise ConfigError(path.name, f"must have {version_key} and a segment", str(path))
    return segments


def _since(epochs: Sequence[Epoch]) -> np.ndarray:
    """Times (N,) [s] from the first of epochs."""
    return np.array([epoch - epochs[0] for epoch in epochs])


def _one_object(path: Path, segments: list[_Segment], name: str | None) -> list[_Segment]:
    names = list(dict.fromkeys(segment.meta.get("OBJECT_NAME", "") for segment in segments))
    if name is None and len(names) > 1 or name is not None and name not in names:
        raise ConfigError("object_name", f"must be one of those in {path.name}", name, f"it has {', '.join(names)}")
    return [segment for segment in segments if name in (None, segment.meta.get("OBJECT_NAME"))]


def _needed(meta: Mapping[str, str], key: str, allowed: tuple[str, ...]) -> str:
    if meta.get(key) not in allowed:
        raise ConfigError(key, f"must be one of {', '.join(allowed)}", meta.get(key))
    return meta[key]


def _table(segment: _Segment, widths: tuple[int, ...]) -> tuple[list[Epoch], np.ndarray]:
    """Epochs and numbers of the rows of a segment."""
    scale = _needed(segment.meta, "TIME_SYSTEM", ("TDB", "UTC", "TT", "TAI"))
    epochs, numbers = [], []
    for number, (day, *words) in segment.rows:
        name = f"line {number}"
        epochs.append(Epoch.from_scale(_calendar_date(day), scale, name))
        try:
            values = [float(word) for word in words]
        except ValueError:
            raise ConfigError(name, "must be an epoch and numbers", " ".join(words)) from None
        if len(values) not in widths:
            raise ConfigError(name, f"must have {' or '.join(map(str, widths))} numbers behind the epoch", len(values))
        numbers.append(values)
    if len(epochs) < 2:
        raise ConfigError("META_START", "must be followed by at least two rows", len(epochs))
    return epochs, np.array(numbers)


def _calendar_date(text: str) -> str:
    """A date with its day of the year turned into month and day: 2006-001T00:00:00."""
    day, mark, time = text.removesuffix("Z").partition("T")
    if len(day) == 8 and day[4] == "-" and day.replace("-", "").isdigit():
        day = (datetime(int(day[:4]), 1, 1) + timedelta(days=int(day[5:]) - 1)).date().isoformat()
    return f"{day}{mark}{time}"


