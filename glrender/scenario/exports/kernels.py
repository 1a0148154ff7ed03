"""SPICE's binary kernels of a flight, by spiceypy: SPK of type 13 and CK of type 3."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ...base.errors import ConfigError
from ..spice.kernels import spiceypy_of
from .flight import KM_PER_M, Flight, in_capitals
from .text_kernels import TICKS_PER_S, Codes

_SUN, _BARYCENTRE = 10, 0
# NAIF, Frames Required Reading: frames built into SPICE have positive numbers below those left to users.
_FIRST_USERS_FRAME = 1_400_000
# Degree of SPK's polynomials: each follows from two states alone, so that holds and manoeuvres stay apart.
_DEGREE = 3
# Turn [rad] from row to row up to which a CK is interpolated: beyond it quaternions may stand for another turn.
_MOST_TURN_RAD = 0.5 * np.pi


def codes_of(flight: Flight) -> Codes:
    """The numbers of a flight: a body that SPICE knows by its name has SPICE's.

    Raises
    ------
    ConfigError
        Two bodies of one number, or one of the Sun's or the spacecraft's; a camera with the name of
        another frame; spiceypy missing.
    """
    tool = spiceypy_of("--with")
    known = {}
    for name in flight.radii_m:
        try:
            known[name] = tool.bodn2c(in_capitals(name))
        except tool.utils.exceptions.NotFoundError:
            continue
    codes = Codes(flight=flight, known=known)
    numbers = {name: codes.body(name) for name in flight.radii_m}
    taken = {_SUN, _BARYCENTRE, codes.spacecraft}
    if len({*numbers.values(), *taken}) < len(numbers) + len(taken):
        raise ConfigError("ids", f"must give each body a number of its own, and none the Sun's ({_SUN}), the solar "
                          f"system's ({_BARYCENTRE}) or the spacecraft's ({codes.spacecraft})", numbers,
                          "give others, as --ids ROCK=2101955: SPICE knows some names already")
    camera = in_capitals(flight.camera.name)
    if (0 < tool.namfrm(camera) < _FIRST_USERS_FRAME
            or camera in map(codes.frame_name, (flight.spacecraft, *flight.radii_m))):
        raise ConfigError(f"cameras.{flight.camera.name}.name", "must not be that of another of SPICE's frames", camera,
                          "rename the camera")
    return codes


def spk(flight: Flight) -> bytes:
    """Spacecraft and other bodies about the first one, that about the Sun, and a camera off the spacecraft's origin.

    Source: NAIF, SPK Required Reading: Hermite interpolation of states at unequal steps; km, km/s, J2000.
    """
    flight.needs_two("spk")
    tool, codes, et_s = spiceypy_of("--with"), codes_of(flight), flight.et_s
    centre = codes.body(flight.about)
    sun = flight.rows_of_sun()
    tracks = [(flight.spacecraft, codes.spacecraft, centre, flight.rows(flight.spacecraft)),
              *((name, codes.body(name), centre, flight.rows(name)) for name in flight.others),
              (flight.about, centre, _SUN, (-sun[0], -sun[1]))]
    if flight.camera.r_camera_spacecraft_m.any():
        tracks.append((flight.camera.name, codes.camera, centre, flight.rows_of_camera()))

    def write(path: str) -> None:
        handle = tool.spkopn(path, "GLRENDER", 0)
        for name, code, about, (r, v) in tracks:
            tool.spkw13(handle, code, about, "J2000", et_s[0], et_s[-1], in_capitals(name), _DEGREE, len(et_s),
                        np.hstack([r, v]) * KM_PER_M, et_s)
        tool.spkcls(handle)

    return _written(write)


def ck(flight: Flight) -> bytes:
    """Attitudes of the spacecraft and the bodies from J2000, with rates where all are known.

    Source: NAIF, CK Required Reading: SPICE's quaternion of `b_from_a` is `q_b_from_a`, angular velocities are in the
    base frame's axes; clocks' ticks are those of the flight's own SCLK.
    """
    tool, codes = spiceypy_of("--with"), codes_of(flight)
    ticks = (flight.et_s - codes.clock_start_s) * TICKS_PER_S

    def write(path: str) -> None:
        handle = tool.ckopn(path, "GLRENDER", 0)
        for name in (flight.spacecraft, *flight.radii_m):
            q, rates = flight.turns(name)
            frames = Rotation.from_quat(q, scalar_first=True)
            in_base = np.zeros((len(q), 3)) if rates is None else frames.inv().apply(rates)
            starts = ticks[np.concatenate([[True], ~_joined(frames, rates, ticks / TICKS_PER_S)])]
            tool.ckw03(handle, ticks[0], ticks[-1], codes.frame(name), "J2000", rates is not None, in_capitals(name),
                       len(q), ticks, q, in_base, len(starts), starts)
        tool.ckcls(handle)

    return _written(write)


def _joined(frames: Rotation, rates: np.ndarray | None, times_s: np.ndarray) -> np.ndarray:
    """Whether each row (N - 1,) may be interpolated to from the row before it."""
    turned = (frames[1:] * frames[:-1].inv()).magnitude()
    if rates is not None:
        speeds = np.linalg.norm(rates, axis=1)
        turned = np.maximum(turned, np.maximum(speeds[1:], speeds[:-1]) * np.diff(times_s))
    return np.asarray(turned) < _MOST_TURN_RAD


def _written(write: Callable[[str], Any]) -> bytes:
    """The bytes of a file that a function writes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "kernel"
        write(str(path))
        return path.read_bytes()
