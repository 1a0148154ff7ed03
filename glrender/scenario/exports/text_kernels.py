"""SPICE's text kernels of a flight: frames and names (FK), the camera (IK) and the clock of its attitudes (SCLK)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ...base.errors import ConfigError
from ...base.rotations import dcm
from .flight import Flight, in_capitals

PIXEL_MM = 0.01
"""Side of a pixel [mm] in files that want one: a camera has its focal length in pixels, which the ratio gives."""
TICKS_PER_S = 1_000_000
_SPACECRAFT = -999
# Numbers of bodies that SPICE knows no name of, from here on; of frames and instruments, within a thousand of the
# spacecraft's own.
_FIRST_BODY = 999_000_001
_CAMERA, _FIRST_BODY_FRAME = 1, 101


@dataclass(frozen=True, kw_only=True, eq=False)
class Codes:
    """NAIF's numbers and names of a flight.

    Parameters
    ----------
    flight : Flight
    known : mapping of str to int
        SPICE's own numbers of the bodies that it knows by name.
    """

    flight: Flight
    known: Mapping[str, int]

    @property
    def spacecraft(self) -> int:
        """Number of the spacecraft, and of its clock."""
        return self.flight.ids.get(self.flight.spacecraft, _SPACECRAFT)

    @property
    def camera(self) -> int:
        """Number of the camera, of its frame and of its place."""
        return self.spacecraft * 1000 - _CAMERA

    def body(self, name: str) -> int:
        """Number of a body."""
        made_up = _FIRST_BODY + list(self.flight.radii_m).index(name)
        return self.flight.ids.get(name, self.known.get(name, made_up))

    def frame(self, name: str) -> int:
        """Number of a frame that turns: of the spacecraft's or a body's."""
        if name == self.flight.spacecraft:
            return self.spacecraft * 1000
        return self.spacecraft * 1000 - _FIRST_BODY_FRAME - list(self.flight.radii_m).index(name)

    def frame_name(self, name: str) -> str:
        """Name of the same frame; SPICE has an EARTH_FIXED of its own, which no kernel replaces."""
        is_fixed = name != self.flight.spacecraft and in_capitals(name) != "EARTH"
        return f"{in_capitals(name)}_{'FIXED' if is_fixed else 'BODY'}"

    @property
    def clock_start_s(self) -> int:
        """Second of ET at which the clock begins: whole, so that ticks are exact."""
        return math.floor(self.flight.et_s[0]) - 1


def fk(codes: Codes) -> str:
    """Names and frames: of spacecraft and bodies (of class 3, by the CK), and of the camera, fixed in the spacecraft.

    Source: NAIF, Frames Required Reading: a TK frame's MATRIX takes components in the frame to those of RELATIVE and
    is written by columns, which are the rows of `camera_from_spacecraft`.
    """
    flight = codes.flight
    entries: dict[str, Any] = {}
    names = {flight.spacecraft: codes.spacecraft, flight.camera.name: codes.camera,
             **{name: codes.body(name) for name in flight.radii_m}}
    for name, code in names.items():
        entries[f"NAIF_BODY_NAME +{len(entries)}"] = in_capitals(name)
        entries[f"NAIF_BODY_CODE +{len(entries)}"] = code
    for name in (flight.spacecraft, *flight.radii_m):
        code = codes.frame(name)
        entries |= _frame(codes.frame_name(name), code, 3, names[name])
        entries |= {f"CK_{code}_SCLK": codes.spacecraft, f"CK_{code}_SPK": names[name]}
        if name != flight.spacecraft:
            entries[f"OBJECT_{names[name]}_FRAME"] = codes.frame_name(name)
    matrix = dcm(flight.camera.q_camera_from_spacecraft)
    entries |= _frame(in_capitals(flight.camera.name), codes.camera, 4, codes.spacecraft)
    entries |= {f"TKFRAME_{codes.camera}_SPEC": "MATRIX",
                f"TKFRAME_{codes.camera}_RELATIVE": codes.frame_name(flight.spacecraft),
                f"TKFRAME_{codes.camera}_MATRIX": matrix.ravel()}
    return _kernel("FK", "Frames: camera +Z is the boresight, +X right and +Y down in the image.", entries)


def ik(codes: Codes) -> str:
    """The camera: field of view, focal length [mm], pixels [um], its principal point from 0, OpenCV's distortion."""
    camera, stem = codes.flight.camera, f"INS{codes.camera}"
    x, y = camera.width_px - 0.5, camera.height_px - 0.5
    corners = camera.directions(np.array([[-0.5, -0.5], [x, -0.5], [x, y], [-0.5, y]]))
    entries: dict[str, Any] = {
        f"{stem}_FOV_FRAME": in_capitals(camera.name), f"{stem}_FOV_SHAPE": "POLYGON",
        f"{stem}_BORESIGHT": np.array([0.0, 0.0, 1.0]), f"{stem}_FOV_CLASS_SPEC": "CORNERS",
        f"{stem}_FOV_BOUNDARY": corners.ravel(), f"{stem}_FOCAL_LENGTH": camera.focal_length_px * PIXEL_MM,
        f"{stem}_PIXEL_SIZE": np.full(2, 1e3 * PIXEL_MM), f"{stem}_PIXEL_SAMPLES": camera.width_px,
        f"{stem}_PIXEL_LINES": camera.height_px, f"{stem}_CCD_CENTER": np.array(camera.principal_point_px)}
    if camera.distortion is not None:
        entries[f"{stem}_OPENCV_DISTORTION"] = np.array(list(asdict(camera.distortion).values()))
    return _kernel("IK", f"FOCAL_LENGTH [mm] and PIXEL_SIZE [um]: the ratio alone counts, pixels are {PIXEL_MM} mm. "
                   "CCD_CENTER counts from the first pixel's centre, 0.", entries)


def sclk(codes: Codes) -> str:
    """A clock of microseconds that runs as TDB does."""
    stem = str(-codes.spacecraft)
    return _kernel("SCLK", "A clock of microseconds of TDB, for the CK alone.", {
        "SCLK_KERNEL_ID": "@2000-01-01", f"SCLK_DATA_TYPE_{stem}": 1, f"SCLK01_TIME_SYSTEM_{stem}": 1,
        f"SCLK01_N_FIELDS_{stem}": 2, f"SCLK01_MODULI_{stem}": np.array([1e10, TICKS_PER_S]),
        f"SCLK01_OFFSETS_{stem}": np.zeros(2), f"SCLK01_OUTPUT_DELIM_{stem}": 1, f"SCLK_PARTITION_START_{stem}": 0.0,
        f"SCLK_PARTITION_END_{stem}": 9e15,
        f"SCLK01_COEFFICIENTS_{stem}": np.array([0.0, codes.clock_start_s, 1.0])})


def _frame(name: str, code: int, frame_class: int, centre: int) -> dict[str, Any]:
    return {f"FRAME_{name}": code, f"FRAME_{code}_NAME": name, f"FRAME_{code}_CLASS": frame_class,
            f"FRAME_{code}_CLASS_ID": code, f"FRAME_{code}_CENTER": centre}


def _kernel(kind: str, note: str, entries: Mapping[str, Any]) -> str:
    lines = [f"KPL/{kind}", "", f"   {note}", "   Written by glrender.", "", "\\begindata", ""]
    for key, value in entries.items():
        name, added, _ = key.partition(" +")
        if len(name) > 32:
            raise ConfigError("name", "makes a keyword of more than SPICE's 32 characters", name, "rename it")
        lines.append(f"{name} {'+=' if added else '='} ( {_words(name, value)} )")
    return "\n".join([*lines, "", "\\begintext", ""])


def _words(name: str, value: Any) -> str:
    if name == "SCLK_KERNEL_ID":
        return value
    if isinstance(value, str):
        return f"'{value}'"
    return "\n   ".join(f"{number:.17g}" for number in np.atleast_1d(value))
