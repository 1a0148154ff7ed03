"""From a scenario file (TOML) to a `Scenario`: a scene file with orbits, trajectory, attitude and time."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from glrender_camera.validate import known_keys, one_of, text

from ...base.errors import ConfigError, error_path
from ...scene.scene import Scene
from ..scenario import SPACECRAFT, SUN, Scenario
from .attitude_fields import read_body_attitude, read_craft_attitude
from .camera_fields import read_cameras
from .fields import Known, a_table
from .time_fields import SAMPLER_KEYS, TimeFields
from .trajectory_fields import (
    read_encounter,
    read_images_of,
    read_motion_of_body,
    read_spice,
    read_sun,
    read_trajectory,
)

_OWN_KEYS = ("scene", "encounter", "trajectory", "attitude", "time", "sun", "spice", "output")
_BODY_KEYS = ("orbit", "trajectory", "spin", "attitude")


def load_scenario(path: str | Path) -> Scenario:
    """A scenario from a TOML file; names of files in it are relative to it.

    Raises
    ------
    ConfigError
        The file is missing or is not TOML, or a field breaks a rule: with the path of the field.
    """
    path = Path(path)
    return scenario_of_table(_toml(path), folder=path.parent, path=path.name)


def scenario_of_table(table: Mapping[str, Any], *, folder: str | Path = ".", path: str = "scenario") -> Scenario:
    """A scenario of plain data, as a scenario file has it (`docs/scenario.md`).

    Parameters
    ----------
    table : mapping
    folder : path
        Where relative names of files lead from.
    path : str
        What messages call the whole.

    Raises
    ------
    ConfigError
        With the path of the field.
    """
    with error_path(path):
        return _scenario(_with_scene(a_table(table), Path(folder)), Path(folder))


def _scenario(table: dict[str, Any], folder: Path) -> Scenario:
    own = {key: table.pop(key) for key in _OWN_KEYS if key in table}
    entries = table.get("bodies")
    if isinstance(entries, list):
        table["bodies"] = [{key: value for key, value in entry.items() if key not in _BODY_KEYS}
                           if isinstance(entry, Mapping) else entry for entry in entries]
    spice = None
    if "spice" in own:
        with error_path("spice"):
            spice = read_spice(own["spice"], folder)
    notes = read_cameras(table, folder, spice)
    known = Known(scene=_scene(table, folder), folder=folder, spice=spice)
    for index, name in enumerate(known.names):
        if name in (SUN, SPACECRAFT):
            raise ConfigError(f"bodies[{index}].name", "must be another name in a scenario", name)
    if ("encounter" in own) == ("trajectory" in own):
        raise ConfigError("encounter", "needs exactly one of [encounter] and [trajectory]")
    with error_path("time"):
        times = TimeFields(own.get("time", {}))
    known.start = times.start if "encounter" in own else times.start or times.first
    if "trajectory" in own:
        with error_path("trajectory"):
            read_images_of(known, own["trajectory"])
    for index, entry in enumerate(entries):
        with error_path(f"bodies[{index}]"):
            read_motion_of_body(known, entry["name"], entry)
    read_sun(known, own)
    encounter = {}
    if "encounter" in own:
        with error_path("encounter"):
            encounter = a_table(own["encounter"])
            craft = read_encounter(known, {key: encounter[key] for key in encounter if key not in SAMPLER_KEYS})
    else:
        with error_path("trajectory"):
            craft = read_trajectory(known, own["trajectory"], SPACECRAFT)
    known.trajectories[SPACECRAFT] = craft
    origin = craft.about if craft.about in known.names else known.names[0]
    sampler = times.sampler(craft, known.start, encounter)
    known.duration_s = float(sampler.t_s()[-1])
    attitudes = {}
    with error_path("attitude"):
        attitudes[SPACECRAFT] = read_craft_attitude(
            known, own.get("attitude", {"mode": "isd" if known.images else "target"}), origin)
    for index, entry in enumerate(entries):
        with error_path(f"bodies[{index}]"):
            if (attitude := read_body_attitude(known, entry["name"], entry, origin)) is not None:
                attitudes[entry["name"]] = attitude
    with error_path("output"):
        output = a_table(own.get("output", {}))
    return Scenario(trajectories=known.trajectories, attitudes=attitudes, origin=origin, start=known.start,
                    sampler=sampler, scene=known.scene, output=output, notes=tuple(notes))


def _scene(table: Mapping[str, Any], folder: Path) -> Scene:
    try:
        return Scene.from_dict(table, shape_dir=folder, path="scene")
    except ConfigError as error:
        # The scene's tables are at the top of the scenario's.
        error.path = error.path.removeprefix("scene.")
        raise


def _toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(str(path), f"cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(str(path), f"is not TOML: {error}") from None


def _with_scene(table: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The table with the scene's of another file in it, where `scene` names one; its bodies by name."""
    if "scene" not in table:
        return table
    base = _toml(folder / text("scene", table["scene"]))
    bodies, more = base.get("bodies", []), table.get("bodies", [])
    if not isinstance(more, list):
        raise ConfigError("bodies", "must be a list of tables", more)
    added = {}
    for index, entry in enumerate(more):
        known_keys(f"bodies[{index}]", entry, ("name", *_BODY_KEYS), required=("name",))
        one_of(f"bodies[{index}].name", entry["name"], [body.get("name") for body in bodies])
        added[entry["name"]] = entry
    return {**base, **{key: value for key, value in table.items() if key != "scene"},
            "bodies": [{**body, **added.get(body.get("name"), {})} for body in bodies]}
