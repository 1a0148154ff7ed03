"""ISDs of a flight: the camera and the pose of each frame, as JSON for CSM's frame sensor model."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ...base.errors import ConfigError
from ...base.rotations import dcm
from .flight import KM_PER_M, Flight
from .text_kernels import PIXEL_MM, Codes

_J2000 = 1


def isds(flight: Flight) -> list[str]:
    """One ISD a state, about the first body.

    Raises
    ------
    ConfigError
        A camera that distorts: no model of usgscsm's takes ideal places to images as OpenCV's does.

    Source: ALE, formatter.py; usgscsm, UsgsAstroFrameSensorModel.cpp: pixels count from the corner of the first one,
    and SPICE's quaternions and angular velocities are in J2000.
    """
    camera, codes = flight.camera, Codes(flight=flight, known={})
    if camera.distortion is not None:
        raise ConfigError(f"cameras.{camera.name}.distortion", "must be absent for isd, whose lenses go the other way",
                          camera.distortion.text, "leave isd or the distortion out")
    centre = [place + 0.5 for place in camera.principal_point_px]
    radius_km = flight.radii_m[flight.about] * KM_PER_M
    common = {
        "name_model": "USGS_ASTRO_FRAME_SENSOR_MODEL", "name_platform": flight.spacecraft, "name_sensor": camera.name,
        "image_samples": camera.width_px, "image_lines": camera.height_px,
        "detector_sample_summing": 1, "detector_line_summing": 1, "starting_detector_sample": 0,
        "starting_detector_line": 0, "detector_center": {"sample": centre[0], "line": centre[1]},
        "focal_length_model": {"focal_length": camera.focal_length_px * PIXEL_MM},
        "focal2pixel_samples": [0.0, 1.0 / PIXEL_MM, 0.0], "focal2pixel_lines": [0.0, 0.0, 1.0 / PIXEL_MM],
        "optical_distortion": {"radial": {"coefficients": [0.0, 0.0, 0.0]}},
        "reference_height": {"minheight": -1000, "maxheight": 1000, "unit": "m"},
        "radii": {"semimajor": radius_km, "semiminor": radius_km, "unit": "km"}}
    constant = {"constant_frames": [codes.camera, codes.frame(flight.spacecraft)],
                "constant_rotation": dcm(camera.q_camera_from_spacecraft).ravel().tolist()}
    places = {"instrument_position": flight.rows_of_camera(), "sun_position": flight.rows_of_sun()}
    turns = {"instrument_pointing": (flight.spacecraft, constant), "body_rotation": (flight.about, {})}
    found = []
    for index, et_s in enumerate(flight.et_s):
        tables: dict[str, Any] = {key: _moved(et_s, r[index], v[index]) for key, (r, v) in places.items()}
        tables |= {key: _turned(flight, codes, et_s, index, name) | more for key, (name, more) in turns.items()}
        found.append(json.dumps({**common, "center_ephemeris_time": et_s, **tables}, indent=1) + "\n")
    return found


def _moved(et_s: float, r_m: np.ndarray, v_m_s: np.ndarray) -> dict[str, Any]:
    return {**_times("spk", et_s), "positions": [(r_m * KM_PER_M).tolist()],
            "velocities": [(v_m_s * KM_PER_M).tolist()], "unit": "km"}


def _turned(flight: Flight, codes: Codes, et_s: float, index: int, name: str) -> dict[str, Any]:
    q, rates = flight.turns(name)
    table = {**_times("ck", et_s), "time_dependent_frames": [codes.frame(name), _J2000],
             "quaternions": [q[index].tolist()]}
    if rates is not None:
        in_base = Rotation.from_quat(q[index], scalar_first=True).inv().apply(rates[index])
        table["angular_velocities"] = [in_base.tolist()]
    return table


def _times(kind: str, et_s: float) -> dict[str, Any]:
    return {"reference_frame": _J2000, "ephemeris_times": [et_s], f"{kind}_table_start_time": et_s,
            f"{kind}_table_end_time": et_s, f"{kind}_table_original_size": 1}
