"""ISDs: the camera and the pose of one image, as ALE writes them (JSON) for CSM's frame sensor model."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from glrender_camera.validate import finite, integer, known_keys, one_of, positive, unit_vectors
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation

from ...base.attitude import from_spice
from ...base.errors import ConfigError, error_path
from ..checks import numbers
from ..epochs import Epoch
from ..files.state_files import text_of
from .focal_plane import FocalPlane
from .lens import lens_of

_M_PER_KM = 1000.0
_J2000 = 1
# A field wider than this is of a focal length in metres that counts as millimetres.
_MAX_FIELD_DEG = 120.0
# How far beyond a table's rows an image's epoch may be [s].
_NEAR_S = 1.0
# Pixels a side: of a film that was scanned, more than a camera can be drawn with.
_MAX_PX = 65536
_TABLES = ("instrument_pointing", "body_rotation", "instrument_position", "sun_position")
# Keys that are used, and that may be passed over: names, heights and radii of the target, where the numbers are from.
_USED = (*_TABLES, "name_model", "name_sensor", "center_ephemeris_time", "image_samples", "image_lines",
         "focal2pixel_samples", "focal2pixel_lines", "detector_sample_summing", "detector_line_summing",
         "starting_detector_sample", "starting_detector_line", "detector_center", "focal_length_model",
         "optical_distortion", "projection", "naif_keywords")
_PASSED_OVER = ("isis_camera_version", "name_platform", "reference_height", "radii", "geotransform", "kernels",
                "starting_ephemeris_time", "interpolation_method")
_OF_TABLES = ("ephemeris_times", "reference_frame", "quaternions", "angular_velocities", "time_dependent_frames",
              "constant_frames", "constant_rotation", "positions", "velocities", "unit",
              *(f"{kind}_table_{end}" for kind in ("ck", "spk") for end in ("start_time", "end_time", "original_size")))


@dataclass(frozen=True, kw_only=True, eq=False)
class Isd:
    """The state and the camera of one image.

    The spacecraft's frame is the sensor's: +Z along the boresight.

    Parameters
    ----------
    name : str
        The sensor's.
    epoch : Epoch
        Middle of the exposure.
    r_spacecraft_m, v_spacecraft_m_s, r_sun_m, v_sun_m_s : (3,) float64 [m], [m/s]
        Relative to the target body's centre, ICRF axes.
    q_sensor_from_inertial, q_body_from_inertial : (4,) float64
    rates_sensor_rad_s, rates_body_rad_s : (3,) float64 [rad/s] or None
        In the sensor's frame and in the body's.
    frames : tuple of int
        NAIF's numbers of the sensor's frame and the body's.
    focal_plane : FocalPlane
    notes : list of str
        Warnings.

    Source: ALE, formatter.py; usgscsm, UsgsAstroFrameSensorModel.cpp: pixels count from the corner of the first one.
    """

    name: str
    epoch: Epoch
    r_spacecraft_m: np.ndarray
    v_spacecraft_m_s: np.ndarray
    r_sun_m: np.ndarray
    v_sun_m_s: np.ndarray
    q_sensor_from_inertial: np.ndarray
    q_body_from_inertial: np.ndarray
    rates_sensor_rad_s: np.ndarray | None
    rates_body_rad_s: np.ndarray | None
    frames: tuple[int, int]
    focal_plane: FocalPlane
    notes: list[str]

    @classmethod
    def from_file(cls, path: str | Path, lens: Mapping[str, Any] | None = None) -> Isd:
        """The image of a file.

        Parameters
        ----------
        path : path
        lens : mapping, optional
            `model` and `coefficients` of `lens_of`, or the model "none", in place of the ISD's.

        Raises
        ------
        ConfigError
            A file that is no ISD of a framing camera, with the path of the field.
        """
        path = Path(path)
        with error_path(path.name):
            text = text_of(path)
            try:
                table = json.loads(text)
            except ValueError as error:
                raise ConfigError("", f"is not JSON: {error}") from None
            return _isd(table, lens)


def _isd(table: Any, lens: Mapping[str, Any] | None) -> Isd:
    model = _field(table, "name_model")
    if model != "USGS_ASTRO_FRAME_SENSOR_MODEL":
        raise ConfigError("name_model", "must be USGS_ASTRO_FRAME_SENSOR_MODEL, a framing camera", model,
                          "line scanners and radars see no whole frame at one time")
    known_keys("", table, (*_USED, *_PASSED_OVER))
    if (projection := _field(table, "projection") if "projection" in table else "") not in ("", None):
        raise ConfigError("projection", "must not be there: a map is no image of a camera", projection)
    name = str(_field(table, "name_sensor"))
    center_s = finite("center_ephemeris_time", _field(table, "center_ephemeris_time"))
    et_s, of_epoch = _epoch_of_tables(table, name, center_s)
    sensor_from_inertial, sensor_rates, sensor = _turned(table, "instrument_pointing", et_s)
    body_from_inertial, body_rates, body = _turned(table, "body_rotation", et_s)
    r, v = _moved(table, "instrument_position", et_s)
    r_sun, v_sun = _moved(table, "sun_position", et_s)
    plane, notes = _focal_plane(table, name, lens)
    notes = [*of_epoch, *notes]
    return Isd(name=name, epoch=Epoch.from_et(center_s), r_spacecraft_m=r, v_spacecraft_m_s=v, r_sun_m=r_sun,
               v_sun_m_s=v_sun, q_sensor_from_inertial=sensor_from_inertial, q_body_from_inertial=body_from_inertial,
               rates_sensor_rad_s=sensor_rates, rates_body_rad_s=body_rates, frames=(sensor, body),
               focal_plane=plane, notes=notes)


def _field(table: object, path: str) -> Any:
    """A value of a table by its dotted path; ConfigError where it is missing."""
    for key in path.split("."):
        if not isinstance(table, Mapping) or key not in table:
            raise ConfigError(path, "missing", hint="must be an ISD of ALE, as `isd_generate` writes it")
        table = table[key]
    return table


def _rows(table: object, path: str, width: int) -> np.ndarray:
    rows = numbers(path, _field(table, path))
    if rows.ndim != 2 or rows.shape[1] != width or not len(rows):
        raise ConfigError(path, f"must be rows of {width} numbers", list(rows.shape))
    return rows


def _epoch_of_tables(table: Mapping[str, Any], name: str, center_s: float) -> tuple[float, list[str]]:
    """When the tables are asked [s, ET]: at the image's epoch, or where all have one row alone, at the time of that."""
    times = [np.ravel(_times(table, key)) for key in _TABLES]
    one = float(times[0][0])
    if any(len(some) > 1 or some[0] != one for some in times) or abs(one - center_s) <= _NEAR_S:
        return center_s, []
    return one, [f"camera {name!r}: the ISD's places and attitudes are of one time, {one - center_s:+.3g} s from "
                 "center_ephemeris_time; they are taken as they are"]


def _times(table: object, name: str) -> np.ndarray:
    """Times (N,) [s, ET] of a table's rows."""
    known_keys(name, _field(table, name), _OF_TABLES)
    if (frame := _field(table, f"{name}.reference_frame")) != _J2000:
        raise ConfigError(f"{name}.reference_frame", "must be 1, J2000", frame)
    times = numbers(f"{name}.ephemeris_times", _field(table, f"{name}.ephemeris_times"))
    if times.ndim != 1 or not len(times) or not (np.diff(times) > 0.0).all():
        raise ConfigError(f"{name}.ephemeris_times", "must be times, ascending", list(times.shape))
    return times


def _are_given(rows: object) -> bool:
    """Whether rates are there: ALE writes null, or rows of null, where it has none."""
    return rows is not None and not (isinstance(rows, list) and all(
        row is None or isinstance(row, list) and all(value is None for value in row) for row in rows))


def _rows_about(table: object, name: str, et_s: float, count: int) -> tuple[np.ndarray, slice]:
    """Times of a table's rows from an epoch [s], and the two rows about it, or the one that is near."""
    times = _times(table, name) - et_s
    if times.shape != (count,):
        raise ConfigError(f"{name}.ephemeris_times", f"must be {count} times, one a row", len(times))
    if times[0] <= 0.0 <= times[-1] and count > 1:
        row = min(int(np.searchsorted(times, 0.0, side="right")) - 1, count - 2)
        return times, slice(row, row + 2)
    row = int(np.argmin(np.abs(times)))
    if not abs(times[row]) <= _NEAR_S:
        raise ConfigError(f"{name}.ephemeris_times", f"must come within {_NEAR_S:g} s of center_ephemeris_time, or go "
                          "from before it to after it", round(float(abs(times[row])), 6))
    return times, slice(row, row + 1)


def _moved(table: Any, name: str, et_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Position [m] and velocity [m/s] at the image's epoch, of a table of positions."""
    scale = {"km": _M_PER_KM, "m": 1.0}[one_of(f"{name}.unit", _field(table, name).get("unit", "km"), ("km", "m"))]
    r = _rows(table, f"{name}.positions", 3) * scale
    times, about = _rows_about(table, name, et_s, len(r))
    v = np.zeros_like(r)
    if table[name].get("velocities") is not None:
        v = _rows(table, f"{name}.velocities", 3) * scale
        if len(v) != len(r):
            raise ConfigError(f"{name}.velocities", f"must be {len(r)} rows, one a position", len(v))
    elif len(times) > 1:
        v = np.gradient(r, times, axis=0)
    if len(times[about]) > 1:
        path = CubicHermiteSpline(times[about], r[about], v[about])
        return path(0.0), path(0.0, 1)
    # So near to a row no motion's curvature shows.
    return r[about][0] - v[about][0] * times[about][0], v[about][0]


def _turned(table: Any, name: str, et_s: float) -> tuple[np.ndarray, np.ndarray | None, int]:
    """`q_frame_from_inertial` and rates in the frame at the image's epoch, and the frame's number."""
    q = unit_vectors(f"{name}.quaternions", _rows(table, f"{name}.quaternions", 4), "normalise [w, x, y, z] first")
    times, about = _rows_about(table, name, et_s, len(q))
    rows, times = Rotation.from_quat(q[about], scalar_first=True), times[about]
    share = -times[0] / (times[1] - times[0]) if len(times) > 1 else 0.0
    # Rotations act on components; from row to row the frame turns at a constant rate.
    turned = Rotation.from_rotvec(share * (rows[-1] * rows[0].inv()).as_rotvec()) * rows[0]
    rates = None
    if _are_given(table[name].get("angular_velocities")):
        # As SPICE's `xf2rav` has them, in J2000's axes. Components turn against the frame.
        velocities = _rows(table, f"{name}.angular_velocities", 3)
        if len(velocities) != len(q):
            raise ConfigError(f"{name}.angular_velocities", f"must be {len(q)} rows, one a quaternion", len(velocities))
        rate = velocities[about][0] * (1.0 - share) + velocities[about][-1] * share
        if len(times) == 1:
            turned = turned * Rotation.from_rotvec(rate * times[0])
        rates = turned.apply(rate)
    frames = list(_field(table, f"{name}.time_dependent_frames"))
    if "constant_rotation" in table[name]:
        matrix = numbers(f"{name}.constant_rotation", table[name]["constant_rotation"])
        if matrix.size != 9:
            raise ConfigError(f"{name}.constant_rotation", "must be 9 numbers, rows first", matrix.shape)
        with error_path(f"{name}.constant_rotation"):
            constant = Rotation.from_quat(from_spice(matrix.reshape(3, 3)), scalar_first=True)
        turned, rates = constant * turned, None if rates is None else constant.apply(rates)
        frames = list(_field(table, f"{name}.constant_frames"))
    return turned.as_quat(canonical=True, scalar_first=True), rates, integer(f"{name}.frames", frames[0], -2**31, 2**31)


def _focal_plane(table: object, name: str, lens: Mapping[str, Any] | None) -> tuple[FocalPlane, list[str]]:
    width = integer("image_samples", _field(table, "image_samples"), 1, _MAX_PX)
    height = integer("image_lines", _field(table, "image_lines"), 1, _MAX_PX)
    affine = np.array([numbers(path, _field(table, path)) for path in ("focal2pixel_samples", "focal2pixel_lines")])
    if affine.shape != (2, 3) or not abs(np.linalg.det(affine[:, 1:])) > 0.0:
        raise ConfigError("focal2pixel_samples", "and focal2pixel_lines must be three numbers each, of two directions",
                          affine.tolist())
    axes = ("sample", "line")
    summing, of_summing = np.ones(2), []
    for k, axis in enumerate(axes):
        if (given := _field(table, f"detector_{axis}_summing")) == 0:
            of_summing.append(f"camera {name!r}: the ISD's detector_{axis}_summing is 0; it is taken as 1")
        else:
            summing[k] = positive(f"detector_{axis}_summing", given)
    start = np.array([finite(f"starting_detector_{axis}", _field(table, f"starting_detector_{axis}"))
                      for axis in axes])
    centre = np.array([finite(f"detector_center.{axis}", _field(table, f"detector_center.{axis}")) for axis in axes])
    focal_length_mm, notes = _focal_length_mm(table, name, affine[:, 1:], max(width * summing[0], height * summing[1]))
    model, coefficients, of_lens = _lens(table, name, lens)
    with error_path("optical_distortion"):
        ideal = None if model == "none" else lens_of(model, coefficients, focal_length_mm)
    # CSM's pixels count from the corner of the first one: its centre is 0.5.
    return FocalPlane(width_px=width, height_px=height, focal_length_mm=focal_length_mm,
                      centre_px=(centre + affine[:, 0] - start) / summing - 0.5,
                      px_from_mm=affine[:, 1:] / summing[:, None], lens=ideal), [*of_summing, *notes, *of_lens]


def _focal_length_mm(table: object, name: str, px_from_mm: np.ndarray, size_px: float) -> tuple[float, list[str]]:
    given = positive("focal_length_model.focal_length", _field(table, "focal_length_model.focal_length"))
    scale = np.sqrt(abs(np.linalg.det(px_from_mm)))
    field_deg = [float(np.degrees(2.0 * np.arctan(0.5 * size_px / (length * scale))))
                 for length in (given, given * 1e3)]
    if field_deg[0] <= _MAX_FIELD_DEG:
        return given, []
    if field_deg[1] > _MAX_FIELD_DEG:
        raise ConfigError("focal_length_model.focal_length", f"gives a field of {field_deg[0]:.0f} deg with "
                          "focal2pixel_samples in px/mm", given, "must be in mm")
    return given * 1e3, [f"camera {name!r}: the ISD's focal length {given:g} is taken in m, not mm: a field of "
                         f"{field_deg[1]:.3g} deg, not {field_deg[0]:.0f} deg"]


def _lens(table: Any, name: str, lens: Mapping[str, Any] | None) -> tuple[str, Any, list[str]]:
    """The name of the distortion model, its coefficients, and notes."""
    if lens is not None:
        known_keys("lens", lens, ("model", "coefficients"), required=("model",))
        return lens["model"], lens.get("coefficients"), []
    models = _field(table, "optical_distortion")
    if not models:
        return "none", None, []
    if not isinstance(models, Mapping) or len(models) != 1:
        raise ConfigError("optical_distortion", "must be a table with one model", models)
    (model, value), = models.items()
    if model == "lunarorbiter" and isinstance(value, Mapping) and "coefficients" not in value:
        terms, notes = _radial_terms(table, name)
        return model, {**value, "coefficients": terms}, notes
    if isinstance(value, Mapping) and "coefficients" in value and model != "lunarorbiter":
        known_keys(f"optical_distortion.{model}", value, ("coefficients",))
        return model, value["coefficients"], []
    return model, value, []


def _radial_terms(table: Any, name: str) -> tuple[Any, list[str]]:
    """The terms of a lens that ALE writes among the keywords of the kernels alone, and notes.

    Keywords of the instrument whose number the sensor's frame has, if there are several.
    """
    found = {key: terms for key, terms in (table.get("naif_keywords") or {}).items() if key.endswith("_OD_K")}
    if not found:
        return [0.0], [f"camera {name!r}: the ISD has no radial terms of its lens, naif_keywords.INS..._OD_K; they are "
                       "taken as 0"]
    pointing = _field(table, "instrument_pointing")
    numbers_of_frames = [*(pointing.get("constant_frames") or []), *(pointing.get("time_dependent_frames") or [])]
    own = [key for number in numbers_of_frames for key in found if key == f"INS{number}_OD_K"]
    taken = own[0] if own else next(iter(found))
    others = ", ".join(key for key in found if key != taken)
    return found[taken], [] if own or not others else [
        f"camera {name!r}: the radial terms of the lens are those of naif_keywords.{taken}, though there are also "
        f"{others}, and none is of the sensor's frame"]
