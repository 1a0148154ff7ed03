"""Attitudes of a scenario file: [attitude] of the spacecraft, and a body's `spin` or `attitude`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from glrender_camera.validate import known_keys, one_of, vector

from ...base.errors import ConfigError, error_path
from ..attitude import Attitude, Fixed, Pointing, Spin
from ..disturbances import Disturbed, Jitter
from ..dynamics import GravityGradient, RigidBody
from ..instruments.images import AttitudesAtImages
from ..scenario import SPACECRAFT, SUN
from ..spice.sources import SpiceAttitude
from ..torques import DustImpacts, GasDrag, Plate, Thruster, Wheels
from .aem import attitude_of_aem
from .fields import Known, a_table, made, parameters_of, taken_epoch
from .state_files import attitude_of_csv, attitude_of_parquet


def read_craft_attitude(known: Known, value: object, target: str) -> Attitude:
    """The attitude of [attitude]; `target` is looked at where the table names none."""
    table = a_table(value)
    offset_deg, jitter = table.pop("offset_deg", None), table.pop("jitter", None)
    mounting = known.scene.camera(table.pop("camera", known.scene.cameras[0].name)).q_camera_from_spacecraft
    mode = one_of("mode", table.pop("mode", None), ("target", "nadir", *_MODES))
    if mode in ("target", "nadir"):
        rule = {"up": "orbit_normal"} if mode == "nadir" else {}
        attitude = made(Pointing, {"target": target, **rule, **table}, q_camera_from_spacecraft=mounting)
        one_of("target", attitude.target, [SUN, *known.names])
    else:
        attitude = _MODES[mode](known, table, SPACECRAFT)
    if offset_deg is None and jitter is None:
        return attitude
    offset = np.radians(vector("offset_deg", (0.0, 0.0, 0.0) if offset_deg is None else offset_deg))
    with error_path("jitter"):
        shaken = None if jitter is None else made(Jitter, jitter)
    return Disturbed(attitude=attitude, offset_rad=offset, jitter=shaken, q_camera_from_spacecraft=mounting)


def read_body_attitude(known: Known, name: str, entry: Mapping[str, Any], origin: str) -> Attitude | None:
    """The attitude of a body, of its `spin` or `attitude`, or of the ISDs of the origin; None where it has none."""
    if "spin" in entry and "attitude" in entry:
        raise ConfigError("spin", "is given as well as attitude", hint="give one")
    if "spin" in entry:
        with error_path("spin"):
            table, epoch = taken_epoch(entry["spin"], "epoch")
            return made(Spin.about_pole, table, epoch=epoch)
    if "attitude" not in entry:
        return AttitudesAtImages(images=known.images, is_body=True) if known.images and name == origin else None
    with error_path("attitude"):
        table = a_table(entry["attitude"])
        return _MODES[one_of("mode", table.pop("mode", None), _MODES)](known, table, name)


def _fixed(known: Known, table: dict[str, Any], owner: str) -> Fixed:
    return made(Fixed, table)


def _spin(known: Known, table: dict[str, Any], owner: str) -> Spin:
    table, epoch = taken_epoch(table, "epoch")
    return made(Spin, table, epoch=epoch)


def _csv(known: Known, table: dict[str, Any], owner: str) -> Attitude:
    known_keys("", table, ("file", "interpolation"), required=("file",))
    return attitude_of_csv(known.file(table), table.get("interpolation", "spline"))


def _parquet(known: Known, table: dict[str, Any], owner: str) -> Attitude:
    known_keys("", table, ("file", "interpolation"), required=("file",))
    return attitude_of_parquet(known.file(table), table.get("interpolation", "spline"))


def _aem(known: Known, table: dict[str, Any], owner: str) -> Attitude:
    known_keys("", table, ("file", "object_name", "frame"), required=("file",))
    # A body's file is about it; the spacecraft's is about no body.
    name = None if owner == SPACECRAFT else owner
    return attitude_of_aem(known.file(table), table.get("object_name", name), frame=table.get("frame"),
                           bodies=(*known.names, SUN))


def _spice(known: Known, table: dict[str, Any], owner: str) -> Attitude:
    return made(SpiceAttitude, table, spice=known.kernels())


def _isd(known: Known, table: dict[str, Any], owner: str) -> AttitudesAtImages:
    if not known.images:
        raise ConfigError("mode", "needs [trajectory] of ISDs", "isd", 'give trajectory.kind = "isd" and its files')
    known_keys("", table, ())
    return AttitudesAtImages(images=known.images, is_body=owner != SPACECRAFT)


def _rigid_body(known: Known, table: dict[str, Any], owner: str) -> RigidBody:
    given = {name: table.pop(name) for name in _TORQUES if name in table}
    known_keys("", table, [*_TORQUES, *(name for name in parameters_of(RigidBody) if name not in _NOT_IN_FILES)])
    if (moved := [name for name in given if name not in ("thrusters", "wheels")]) and owner not in known.trajectories:
        raise ConfigError(moved[0], f"needs a trajectory of {owner!r} about another body",
                          hint="give the body one, with `about`")
    for name in ("gas_drag", "dust_impacts"):
        if name in given and known.trajectories[owner].about == SUN:
            raise ConfigError(name, f"needs a trajectory of {owner!r} about the body that it flows from, not the Sun")
    torques, impulses = [], []
    if "gravity_gradient_m3_s2" in given:
        torques.append(GravityGradient(
            inertia_kg_m2=table.get("inertia_kg_m2"), trajectory=known.trajectories[owner], start=known.start,
            gravitational_parameter_m3_s2=given["gravity_gradient_m3_s2"]))
    if "gas_drag" in given:
        with error_path("gas_drag"):
            drag = a_table(given["gas_drag"])
            drag["plates"] = [_made_of(f"plates[{index}]", Plate, entry)
                              for index, entry in enumerate(_listed("plates", drag.get("plates", [])))]
            torques.append(made(GasDrag, drag, trajectory=known.trajectories[owner], start=known.start))
    if "dust_impacts" in given:
        with error_path("dust_impacts"):
            dust = {"duration_s": known.duration_s, **a_table(given["dust_impacts"])}
            impulses.append(made(DustImpacts, dust, trajectory=known.trajectories[owner], start=known.start))
    torques += [_made_of(f"thrusters[{index}]", Thruster, entry)
                for index, entry in enumerate(_listed("thrusters", given.get("thrusters", [])))]
    if "wheels" in given:
        torques.append(_made_of("wheels", Wheels, given["wheels"]))
    return made(RigidBody, table, torques=tuple(torques), impulses=tuple(impulses))


def _listed(name: str, value: object) -> list:
    if not isinstance(value, list):
        raise ConfigError(name, "must be a list of tables", value)
    return value


def _made_of(path: str, make: Callable, entry: object) -> Any:
    with error_path(path):
        return made(make, entry)


_TORQUES = ("gravity_gradient_m3_s2", "gas_drag", "dust_impacts", "thrusters", "wheels")
_NOT_IN_FILES = ("torques", "impulses")
_MODES: dict[str, Callable[[Known, dict[str, Any], str], Attitude]] = {
    "fixed": _fixed, "spin": _spin, "csv": _csv, "parquet": _parquet, "aem": _aem, "spice": _spice, "isd": _isd,
    "rigid_body": _rigid_body}
