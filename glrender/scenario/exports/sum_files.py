"""SUM files of a flight: camera, pose and light of each frame, as stereophotoclinometry (SPC) reads them."""

from __future__ import annotations

import numpy as np

from ...base.errors import ConfigError
from ...base.rotations import dcm
from .flight import KM_PER_M, Flight
from .text_kernels import PIXEL_MM

_MONTHS = ("JAN", "FEB", "MAR", "APR", "MAY", "JUN", "JUL", "AUG", "SEP", "OCT", "NOV", "DEC")


def sums(flight: Flight) -> list[str]:
    """One SUM file a state, about the first body, without landmarks; sigmas are 0, as poses are exact.

    Raises
    ------
    ConfigError
        A camera that distorts: a K-MATRIX is linear.

    Source: Gaskell et al. (2008), Meteoritics & Planetary Science 43, 1049; SPC's wiki, page SUMFILES. SCOBJ is from
    the camera to the body [km], CX, CY, CZ the camera's axes and SZ the direction of the Sun, in the body's frame;
    CTR counts pixel centres from 1, and the K-MATRIX [px/mm] takes millimetres to pixels, here lines downwards.
    """
    camera = flight.camera
    if camera.distortion is not None:
        raise ConfigError(f"cameras.{camera.name}.distortion", "must be absent for sum, whose K-MATRIX is linear",
                          camera.distortion.text, "leave sum or the distortion out")
    detector = None if camera.model is None else camera.model.detector
    most = 65535 if detector is None else 2**detector.bit_depth - 1
    x, y = camera.principal_point_px
    pixels_mm = 1.0 / PIXEL_MM
    of_camera = [f"{camera.width_px:6d}{camera.height_px:6d}{0:6d}{most:6d}{'':39}NPX, NLN, THRSH",
                 _row((camera.focal_length_px * PIXEL_MM, x + 1.0, y + 1.0), "MMFL, CTR")]
    behind = ["".join(f"{each:10.5f}" for each in (pixels_mm, 0.0, 0.0, 0.0, pixels_mm, 0.0)) + "   K-MATRIX",
              _row((0.0,) * 4, "DISTORTION"), _row((0.0,) * 3, "SIGMA_VSO"), _row((0.0,) * 3, "SIGMA_PTG"),
              "LANDMARKS", "LIMB FITS", "END FILE"]
    places, suns = flight.rows_of_camera()[0], flight.rows_of_sun()[0]
    turns = flight.turns(flight.spacecraft)[0], flight.turns(flight.about)[0]
    found = []
    for index, (epoch, r_m, sun_m, q_craft, q_body) in enumerate(zip(flight.epochs, places, suns, *turns, strict=True)):
        body = dcm(q_body)
        axes = dcm(camera.q_camera_from_spacecraft) @ dcm(q_craft) @ body.T
        rows = {"SCOBJ": -body @ r_m * KM_PER_M, **dict(zip(("CX", "CY", "CZ"), axes, strict=True)),
                "SZ": body @ sun_m / np.linalg.norm(sun_m)}
        utc = epoch.utc
        date = f"{utc[:4]} {_MONTHS[int(utc[5:7]) - 1]} {utc[8:10]} {utc[11:]}"
        found.append("\n".join([f"frame_{index:05d}", date, *of_camera,
                                *(_row(row, label) for label, row in rows.items()), *behind]) + "\n")
    return found


def _row(numbers: tuple[float, ...] | np.ndarray, label: str) -> str:
    """A line of numbers with 12 digits behind the point and Fortran's D for an exponent, and its label."""
    return "".join(f"{each:22.12E}".replace("E", "D") for each in numbers) + f"   {label}"
