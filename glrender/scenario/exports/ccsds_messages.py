"""CCSDS messages of a flight: OEM (places and velocities) and AEM (attitudes), in keyword = value notation."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from .flight import KM_PER_M, Flight, in_capitals


def oem(flight: Flight) -> str:
    """An Orbit Ephemeris Message of spacecraft, other bodies and Sun about the first body, in TDB and ICRF.

    Equal flights give equal texts: the date of creation is that of the first state.

    Source: CCSDS 502.0-B-3, section 5: rows of epoch, X, Y, Z [km], X_DOT, Y_DOT, Z_DOT [km/s].
    """
    flight.needs_two("oem")
    rows = {name: flight.rows(name) for name in (flight.spacecraft, *flight.others)} | {"sun": flight.rows_of_sun()}
    lines = _header("OEM", "2.0", flight)
    for name, (r, v) in rows.items():
        lines += _segment(flight, {
            **_object(flight, name),
            "CENTER_NAME": in_capitals(flight.about), "REF_FRAME": "ICRF"}, {}, np.hstack([r, v]) * KM_PER_M)
    return "\n".join(lines) + "\n"


def aem(flight: Flight) -> str:
    """An Attitude Ephemeris Message of the spacecraft and the bodies, from ICRF to their frames, in TDB.

    Source: CCSDS 504.0-B-1, section 4: of a frame that is turned, the quaternion is the conjugate of `q_b_from_a`
    (docs/conventions.md), scalar last.
    """
    flight.needs_two("aem")
    lines = _header("AEM", "1.0", flight)
    for name in (flight.spacecraft, *flight.radii_m):
        own = "SC_BODY_1" if name == flight.spacecraft else f"{in_capitals(name)}_FIXED"
        w, x, y, z = flight.turns(name)[0].T
        lines += _segment(flight, {
            **_object(flight, name), "REF_FRAME_A": "ICRF",
            "REF_FRAME_B": own, "ATTITUDE_DIR": "A2B"}, {"ATTITUDE_TYPE": "QUATERNION", "QUATERNION_TYPE": "LAST"},
            np.stack([-x, -y, -z, w], axis=1), ("DATA_START", "DATA_STOP"))
    return "\n".join(lines) + "\n"


def _header(kind: str, version: str, flight: Flight) -> list[str]:
    # The standards allow comments in the header only right behind the version.
    return [f"CCSDS_{kind}_VERS = {version}",
            "COMMENT CREATION_DATE is the first epoch, so that equal flights give equal files.",
            "COMMENT States are those that the frames were drawn of: no light time, no aberration.",
            f"CREATION_DATE = {flight.epochs[0].tdb}", "ORIGINATOR = GLRENDER", ""]


def _object(flight: Flight, name: str) -> dict[str, str]:
    return {"OBJECT_NAME": in_capitals(name), "OBJECT_ID": str(flight.ids.get(name, in_capitals(name)))}


def _segment(flight: Flight, before: dict[str, str], behind: dict[str, str], rows: np.ndarray,
             edges: Iterable[str] = ()) -> list[str]:
    dates = [epoch.tdb for epoch in flight.epochs]
    meta = {**before, "TIME_SYSTEM": "TDB", "START_TIME": dates[0], "STOP_TIME": dates[-1], **behind}
    data = [f"{date} {' '.join(f'{number:.17g}' for number in row)}" for date, row in zip(dates, rows, strict=True)]
    start, *stop = edges or ("",)
    return ["META_START", *(f"{key} = {value}" for key, value in meta.items()), "META_STOP", start, *data, *stop, ""]
