"""From a scenario file (TOML) to a `Scenario`: a scene file with orbits, trajectory, attitude and time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from glrender_camera.validate import known_keys, one_of, text

from ...base.constants import AU_M
from ...base.errors import ConfigError, error_path
from ...scene.scene import SCENE_KEYS, Scene
from ...scene.scene_file import read_toml
from ..belief.belief import Belief
from ..paths import Trajectory
from ..plausible import refuse_impossible, written_tables
from ..random_states import RandomStates
from ..samplers import Times
from ..scenario import SPACECRAFT, SUN, Scenario
from ..spice.kernels import Spice
from .attitude_fields import read_body_attitude, read_craft_attitude
from .belief_fields import read_belief
from .camera_fields import read_cameras
from .fields import Known, a_table, with_scales
from .keypoint_fields import read_keypoints
from .random_fields import place_of_craft, read_random
from .time_fields import SAMPLER_KEYS, TimeFields
from .trajectory_fields import (
    read_encounter,
    read_images_of,
    read_motion_of_body,
    read_spice,
    read_sun,
    read_trajectory,
)

_OWN_KEYS = ("scene", "encounter", "trajectory", "random", "attitude", "time", "sun", "spice", "output", "belief")
_BODY_KEYS = ("orbit", "trajectory", "spin", "attitude", "keypoints")


def load_scenario(path: str | Path) -> Scenario | RandomStates:
    """A scenario from a TOML file, or the random states of its [random]; names of files in it are relative to it.

    Raises
    ------
    ConfigError
        The file is missing or is not TOML, or a field breaks a rule: with the path of the field.
    """
    path = Path(path)
    return scenario_of_table(read_toml(path), folder=path.parent, path=path.name)


def load_setting(path: str | Path) -> tuple[Scene, dict[str, dict[str, np.ndarray]], dict[str, Any]]:
    """The scene of a scenario file or a scene file, its keypoints and its [output]; no more of the file is looked at.

    Raises
    ------
    ConfigError
        With the path of the field.
    """
    path = Path(path)
    table = read_toml(path)
    with error_path(path.name):
        table = _with_scene(table, path.parent)
        own, entries = _taken(table)
        read_cameras(table, path.parent, _spice(own, path.parent))
        with error_path("output"):
            output = a_table(own.get("output", {}))
        return _scene(table, path.parent), _keypoints(entries, path.parent), output


def load_believed_scene(path: str | Path) -> Scene:
    """The scene that the [belief] of a scenario file makes of its scene; its trajectory and times are not looked at.

    Raises
    ------
    ConfigError
        With the path of the field.
    """
    path = Path(path)
    table = read_toml(path)
    with error_path(path.name):
        table = _with_scene(table, path.parent)
        own, _ = _taken(table)
        if "belief" not in own:
            raise ConfigError("belief", "missing",
                              hint="describe the on-board scene in [belief], or serve the scene itself")
        read_cameras(table, path.parent, _spice(own, path.parent))
        scene = _scene(table, path.parent)
        belief = _belief(own, scene, path.parent)
        with error_path("belief"):
            return belief.scene(scene)


def scenario_of_table(table: Mapping[str, Any], *, folder: str | Path = ".",
                      path: str = "scenario") -> Scenario | RandomStates:
    """A scenario of plain data, as a scenario file has it (`docs/scenario.md`); random states of its `random`.

    Parameters
    ----------
    table : mapping
    folder : path
        Where relative names of files lead from.
    path : str
        Name of the whole in messages.

    Raises
    ------
    ConfigError
        With the path of the field.
    """
    with error_path(path):
        return _scenario(_with_scene(a_table(table), Path(folder)), Path(folder))


def _scenario(table: dict[str, Any], folder: Path) -> Scenario | RandomStates:
    own, entries = _taken(table)
    spice = _spice(own, folder)
    notes = read_cameras(table, folder, spice)
    known = Known(scene=_scene(table, folder), folder=folder, spice=spice)
    for index, name in enumerate(known.names):
        if name in (SUN, SPACECRAFT):
            raise ConfigError(f"bodies[{index}].name", "must be another name in a scenario", name)
    if len(sources := [key for key in ("encounter", "trajectory", "random") if key in own]) != 1:
        raise ConfigError("encounter", "needs exactly one of [encounter], [trajectory] and [random]", sources)
    with error_path("time"):
        times = TimeFields(own.get("time", {}))
    known.start = times.start if "encounter" in own else times.start or times.first
    if "trajectory" in own:
        with error_path("trajectory"):
            read_images_of(known, own["trajectory"])
    for index, entry in enumerate(entries):
        with error_path(f"bodies[{index}]"):
            read_motion_of_body(known, entry["name"], entry)
    has_sun = "random" not in own or "sun" in own or spice is not None or any(
        path.about == SUN for path in known.trajectories.values())
    read_sun(known, own if has_sun else {**own, "sun": {"r_m": [AU_M, 0.0, 0.0], "about": known.names[0]}})
    encounter: dict[str, Any] = {}
    craft: Trajectory
    if "encounter" in own:
        with error_path("encounter"):
            encounter = a_table(own["encounter"])
            craft = read_encounter(known, {key: encounter[key] for key in encounter if key not in SAMPLER_KEYS})
    elif "random" in own:
        with error_path("random"):
            craft = place_of_craft(known, own["random"])
    else:
        with error_path("trajectory"):
            craft = read_trajectory(known, own["trajectory"], SPACECRAFT)
    known.trajectories[SPACECRAFT] = craft
    origin = craft.about if craft.about in known.names else known.names[0]
    attitudes = {}
    if "random" not in own:
        sampler = times.sampler(craft, known.start, encounter)
        known.duration_s = float(sampler.t_s()[-1])
        with error_path("attitude"):
            attitudes[SPACECRAFT] = read_craft_attitude(
                known, own.get("attitude", {"mode": "isd" if known.images else "target"}), origin)
    for index, entry in enumerate(entries):
        with error_path(f"bodies[{index}]"):
            if (attitude := read_body_attitude(known, entry["name"], entry, origin)) is not None:
                attitudes[entry["name"]] = attitude
    with error_path("output"):
        output = a_table(own.get("output", {}))
    keypoints = _keypoints(entries, folder)
    written = written_tables(own, entries)
    refuse_impossible(written, known.scene.bodies)
    make = partial(Scenario, trajectories=known.trajectories, origin=origin, start=known.start, scene=known.scene,
                   output=output, keypoints=keypoints, notes=tuple(notes), belief=_belief(own, known.scene, folder),
                   written=written)
    if "random" in own:
        for key in ("attitude", "time"):
            if set(a_table(own.get(key, {}))) - set(with_scales("start")):
                raise ConfigError(key, "is given as well as [random]", hint="leave it out: [random] points the camera")
        setting = make(attitudes=attitudes, sampler=Times(times_s=[0.0]))
        with error_path("random"):
            return read_random(setting, own["random"], has_sun)
    return make(attitudes=attitudes, sampler=sampler)


def _taken(table: dict[str, Any]) -> tuple[dict[str, Any], Any]:
    """The tables of a scenario file that no scene has, and the whole entries of its bodies; the table loses them."""
    known_keys("", table, (*SCENE_KEYS, *_OWN_KEYS), required=("bodies", "cameras"))
    own = {key: table.pop(key) for key in _OWN_KEYS if key in table}
    entries = table.get("bodies")
    if isinstance(entries, list):
        table["bodies"] = [{key: value for key, value in entry.items() if key not in _BODY_KEYS}
                           if isinstance(entry, Mapping) else entry for entry in entries]
    return own, entries


def _spice(own: Mapping[str, Any], folder: Path) -> Spice | None:
    with error_path("spice"):
        return read_spice(own["spice"], folder) if "spice" in own else None


def _belief(own: Mapping[str, Any], scene: Scene, folder: Path) -> Belief:
    with error_path("belief"):
        return read_belief(own.get("belief", {}), scene, folder)


def _keypoints(entries: Sequence[Mapping[str, Any]], folder: Path) -> dict[str, dict[str, np.ndarray]]:
    found = {}
    for index, entry in enumerate(entries):
        if "keypoints" in entry:
            with error_path(f"bodies[{index}].keypoints"):
                found[entry["name"]] = read_keypoints(entry["keypoints"], folder)
    return found


def _scene(table: Mapping[str, Any], folder: Path) -> Scene:
    try:
        return Scene.from_dict(table, shape_dir=folder, path="scene")
    except ConfigError as error:
        # The scene's tables are at the top of the scenario's.
        error.path = error.path.removeprefix("scene.")
        raise


def _with_scene(table: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The table with the scene's of another file in it, where `scene` names one; its bodies by name."""
    if "scene" not in table:
        return table
    base = read_toml(folder / text("scene", table["scene"]))
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
