"""CCSDS ephemerides: OEM files in keyword = value notation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...base.errors import error_path
from ..paths import Trajectory
from .kvn import INERTIAL, centre_of, of_one_object, one_value, segments_of, since
from .tables import Segments, TrajectoryTable

_M_PER_KM = 1000.0
# Metadata that is used, and that may be passed over: names for people, the ends of the rows, and how the rows are
# best interpolated, which `TrajectoryTable` knows itself.
_USED = ("OBJECT_NAME", "CENTER_NAME", "REF_FRAME", "TIME_SYSTEM", "USEABLE_START_TIME", "USEABLE_STOP_TIME")
_PASSED_OVER = ("OBJECT_ID", "REF_FRAME_EPOCH", "START_TIME", "STOP_TIME", "INTERPOLATION", "INTERPOLATION_DEGREE")


def trajectory_of_oem(path: str | Path, about: str | Sequence[str], object_name: str | None = None, *,
                      center_name: str | None = None, bodies: Sequence[str] = ()) -> Trajectory:
    """The trajectory of an Orbit Ephemeris Message (OEM).

    Parameters
    ----------
    path : path
        A file in KVN; kilometres, as the standard has them. Accelerations and covariances are passed over.
    about : str, or sequence of str
        The name in the scenario of the file's CENTER_NAME; of several the one that is called so.
    object_name : str, optional
        Needed where the file has several objects.
    center_name : str, optional
        The file's name for `about`, where it has another one there; case and punctuation make no difference.
    bodies : sequence of str
        Names that the object may not have where no `object_name` is given: a spacecraft's file, not a moon's.

    Returns
    -------
    Trajectory
        Interpolated as `TrajectoryTable` does it, within each segment, from its USEABLE_START_TIME to its
        USEABLE_STOP_TIME: rows beyond are there for the interpolation alone.

    Raises
    ------
    ConfigError
        With the file and the line: another centre than `about`, another frame than ICRF, EME2000 or J2000, another
        time system than TDB, UTC, TT, TAI, a keyword that is not known or is among the rows.

    Source: CCSDS 502.0-B-3, section 5.
    """
    path = Path(path)
    _, segments = segments_of(path, "OEM", ("1.0", "2.0", "3.0"), (*_USED, *_PASSED_OVER))
    segments = of_one_object(path, segments, object_name, bodies)
    parts = []
    with error_path(path.name):
        centre = centre_of("CENTER_NAME", [one_value(segments, "CENTER_NAME")], about, center_name)
        for segment in segments:
            segment.value("REF_FRAME", INERTIAL)
            epochs, numbers = segment.table((6, 9))
            states = np.array([row[:6] for row in numbers]) * _M_PER_KM
            first, last = segment.useable(epochs)
            parts.append(TrajectoryTable(times_s=since(epochs), about=centre, epoch=epochs[0], r_m=states[:, :3],
                                         v_m_s=states[:, 3:], span_s=(first - epochs[0], last - epochs[0])))
    return parts[0] if len(parts) == 1 else Segments(parts=parts)
