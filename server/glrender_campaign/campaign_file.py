"""From a campaign file (TOML) to its cases: a scenario, and the axes along which it is varied."""

from __future__ import annotations

import copy
import hashlib
import itertools
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from glrender import ConfigError, PinholeCamera, Scene, State
from glrender.base.errors import error_path
from glrender.scenario import Belief, RandomStates, Scenario, load_scenario
from glrender.scenario.files.belief_fields import read_belief
from glrender.scene.scene import checked_max_error
from glrender.scene.scene_file import read_toml
from glrender.sequences.options import FrameOptions, exposures_of
from glrender.sequences.sequence import VERSION, digest_of_scene, digest_of_states
from glrender_camera.faults.fault import Fault
from glrender_camera.faults.frame_faults import checked_faults
from glrender_camera.validate import finite, integer, known_keys, one_of, text

from .onboard import OF_FRAMES

_KEYS = ("scenario", "camera", "body", "pointing", "handover", "acceleration_error", "axes")
_OWN_AXES = ("estimator", "max_error", "onboard_max_error", "faults", "seed")
_AXES = ("belief", *_OWN_AXES)
_MAX_CASES = 100_000
_ID_DIGITS = 16


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """One flight of a campaign.

    Attributes
    ----------
    id : str
        The digest of all that the flight depends on.
    values : mapping
        Of each axis.
    belief : Belief
    belief_key : str
        Equal where beliefs are.
    """

    id: str
    values: Mapping[str, Any]
    belief: Belief
    belief_key: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Setup:
    """The settings that all flights of a campaign share.

    Attributes
    ----------
    scene : Scene
        The true one.
    states : sequence of State
        The true trajectory; `pointing` says whether its attitudes are flown.
    camera, body : str
        The camera that takes the frames, and the body to navigate about.
    pointing : "estimate" or "scenario"
    handover : float [1]
        Standard deviation of the first estimate, relative to the range.
    acceleration_error : float [1]
        Standard deviation of the acceleration that is known on board, relative to itself.
    version : str
        Of glrender.
    """

    scene: Scene
    states: Sequence[State]
    camera: str
    body: str
    pointing: str
    handover: float
    acceleration_error: float
    version: str = VERSION


@dataclass(frozen=True, kw_only=True, eq=False)
class Campaign:
    """A campaign: its cases are all combinations of its axes' values.

    Attributes
    ----------
    path : path
        Of its file.
    setup : Setup
    axes : mapping of str to tuple
        Values by the axes' names; of beliefs as ``belief.bodies.itokawa.facets``, and these first.
    paths : mapping of str to tuple of str
        Keys that lead to the field of a belief, by the axis' name.
    beliefs : sequence of (str, Belief)
        Of all combinations of these axes' values, each with a key that is equal where beliefs are.
    """

    path: Path
    setup: Setup
    axes: Mapping[str, tuple[Any, ...]]
    paths: Mapping[str, tuple[str, ...]]
    beliefs: Sequence[tuple[str, Belief]]

    @property
    def varied(self) -> list[str]:
        """Names of the axes with several values."""
        return [name for name, values in self.axes.items() if len(values) > 1]

    @cached_property
    def cases(self) -> list[Case]:
        """All cases: beliefs change slowest, seeds fastest."""
        own = list(itertools.product(*(self.axes[name] for name in self.axes if name not in self.paths)))
        believed = zip(itertools.product(*(self.axes[name] for name in self.paths)), self.beliefs, strict=True)
        return [self._case(dict(zip(self.axes, (*first, *rest), strict=True)), key, belief)
                for first, (key, belief) in believed for rest in own]

    def case(self, id: str) -> Case:
        """The case of an id.

        Raises
        ------
        ConfigError
            No case has it.
        """
        for case in self.cases:
            if case.id == id:
                return case
        raise ConfigError("--case", f"must be the id of one of {len(self.cases)} cases", id,
                          "ids stand in the report; they change with the campaign, its scenario and glrender")

    def _case(self, values: dict[str, Any], key: str, belief: Belief) -> Case:
        digest = _digest(self._digest, key, {name: value for name, value in values.items() if name in _OWN_AXES})
        return Case(id=digest[:_ID_DIGITS], values=values, belief=belief, belief_key=key)

    @cached_property
    def _digest(self) -> str:
        setup = self.setup
        exposures_s = exposures_of(setup.scene, FrameOptions(camera=setup.camera, output="dn", format="npz"))
        return _digest(setup.version, digest_of_scene(setup.scene), digest_of_states(setup.states, exposures_s),
                       setup.camera, setup.body, setup.pointing, setup.handover, setup.acceleration_error)


def load_campaign(path: str | Path) -> Campaign:
    """A campaign of its file; the scenario's name is relative to it.

    Raises
    ------
    ConfigError
        The file is missing or is not TOML, or a field breaks a rule: with the path of the field.
    """
    path = Path(path)
    table = read_toml(path)
    with error_path(path.name):
        known_keys("", table, _KEYS, required=("scenario", "axes"))
        scenario_path = path.parent / text("scenario", table["scenario"])
        with error_path("scenario"):
            scenario = load_scenario(scenario_path)
            if isinstance(scenario, RandomStates):
                raise ConfigError("random", "has no trajectory to fly along", hint="give [encounter] or [trajectory]")
            scenario.check()
        camera = _camera(scenario.scene, table.get("camera"))
        body = one_of("body", table.get("body", scenario.origin), scenario.bodies)
        states = _states(scenario)
        setup = Setup(scene=scenario.scene, states=states, camera=camera.name, body=body,
                      pointing=one_of("pointing", table.get("pointing", "estimate"), ("estimate", "scenario")),
                      handover=_share("handover", table.get("handover", 0.05)),
                      acceleration_error=_share("acceleration_error", table.get("acceleration_error", 0.02)))
        with error_path("axes"):
            axes, paths = _axes(table["axes"], scenario.scene, camera)
        if (count := int(np.prod([len(values) for values in axes.values()], dtype=float))) > _MAX_CASES:
            raise ConfigError("axes", f"must give {_MAX_CASES} cases at most", count, "give fewer values")
        believed = read_toml(scenario_path).get("belief", {})
        beliefs = _Beliefs(believed, scenario.scene, scenario_path.parent, paths).all(axes)
    return Campaign(path=path, setup=setup, axes=axes, paths=paths, beliefs=beliefs)


def _camera(scene: Scene, name: object) -> PinholeCamera:
    camera = scene.camera(text("camera", name) if name is not None else scene.cameras[0].name)
    if camera.model is None:
        raise ConfigError("camera", f"camera {camera.name!r} has no optics and detector", camera.name,
                          "give it a `model` in the scene, or name another")
    return camera


def _states(scenario: Scenario) -> list[State]:
    states = scenario.states()
    if len(states) < 2 or not (np.diff([state.t_s for state in states]) > 0.0).all():
        raise ConfigError("scenario.time", "must give two frames or more, at rising times", len(states))
    return states


def _share(name: str, value: object) -> float:
    if not 0.0 <= (share := finite(name, value)) < 1.0:
        raise ConfigError(name, "must be a share >= 0 and < 1", value, "0.05 is 5 %")
    return share


def _axes(table: object, scene: Scene, camera: PinholeCamera) -> tuple[
        dict[str, tuple[Any, ...]], dict[str, tuple[str, ...]]]:
    """Values of all axes, and the paths of those of beliefs, by the axes' names."""
    known_keys("", table, _AXES)
    if not isinstance(table.get("belief", {}), Mapping):
        raise ConfigError("belief", "must be a table of beliefs", table["belief"], "belief.bodies.NAME.facets = [0.1]")
    leaves = {_dotted(path): (path, values) for path, values in _leaves(("belief",), table.get("belief", {}))}
    paths = {name: path for name, (path, _) in leaves.items()}
    given = {**{name: values for name, (_, values) in leaves.items()},
             **{name: table[name] for name in _OWN_AXES if name in table}}
    axes = {**dict.fromkeys(paths), "estimator": ["model"],
            "max_error": [scene.max_error], "onboard_max_error": [0.1],
            "faults": [list(map(_table_of_fault, camera.model.faults))], "seed": [1]}
    for name in axes:
        values = given.get(name, axes[name])
        if not isinstance(values, list):
            raise ConfigError(name, "must be a list of values", values, f"[{values!r}] is one")
        if not values:
            raise ConfigError(name, "must have a value at least: without, the campaign has no case", values,
                              "leave the axis out, or give it values")
        checked = tuple(_checked(name, f"{name}[{index}]", value) for index, value in enumerate(values))
        for index, value in enumerate(checked):
            if value in checked[:index]:
                raise ConfigError(f"{name}[{index}]", "is given twice", value, "leave one out")
        axes[name] = checked
    return axes, paths


def _table_of_fault(fault: Fault) -> dict[str, Any]:
    return {"kind": fault.kind, **asdict(fault)}


def _leaves(path: tuple[str, ...], table: object) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Keys that lead to the axes in nested tables, with their lists."""
    if not isinstance(table, Mapping):
        yield path, table
        return
    for key, value in table.items():
        yield from _leaves((*path, key), value)


def _dotted(path: Sequence[str]) -> str:
    """A path as TOML has it."""
    return ".".join(key if re.fullmatch(r"[\w-]+", key, re.ASCII) else json.dumps(key) for key in path)


def _checked(name: str, path: str, value: Any) -> Any:
    if name == "seed":
        return integer(path, value, 0, 2**31 - 1)
    if name == "estimator":
        return one_of(path, value, OF_FRAMES)
    if name in ("max_error", "onboard_max_error"):
        return checked_max_error(value, path)
    if name == "faults":
        checked_faults(path, value)
    return value


class _Beliefs:
    """Reads the beliefs of a campaign, and refuses at the start what no worker could believe.

    Parameters
    ----------
    base : mapping
        The table [belief] of the scenario, which the axes change.
    scene : Scene
        The true one.
    folder : path
        That names of shape files are relative to.
    paths : mapping
        As of `Campaign`.
    """

    def __init__(self, base: Mapping[str, Any], scene: Scene, folder: Path, paths: Mapping[str, tuple[str, ...]]):
        self._base, self._scene, self._folder, self._paths = base, scene, folder, paths
        self._read: dict[str, Belief] = {}
        self._surfaces: set[str] = set()

    def all(self, axes: Mapping[str, Sequence[Any]]) -> list[tuple[str, Belief]]:
        """Keys and beliefs of all combinations; of a mistake in one value the path is that value's.

        Raises
        ------
        ConfigError
        """
        first = {name: axes[name][0] for name in self._paths}
        for name in self._paths:
            for index, value in enumerate(axes[name]):
                try:
                    self._of({**first, name: value})
                except ConfigError as error:
                    field = ".".join(self._paths[name])
                    if error.path.startswith(field):
                        error.path = f"axes.{name}[{index}]{error.path.removeprefix(field)}"
                    elif field.startswith(error.path):
                        error.path = f"axes.{error.path}"
                    else:
                        error.path, error.rule = f"axes.{name}[{index}]", f"{error.path}: {error.rule}"
                    raise
        found = []
        for combination in itertools.product(*(axes[name] for name in self._paths)):
            values = dict(zip(self._paths, combination, strict=True))
            try:
                found.append(self._of(values))
            except ConfigError as error:
                error.path = f"axes.{error.path}" if values else f"scenario.{error.path}"
                if values:
                    combined = " and ".join(f"{name} = {value!r}" for name, value in values.items())
                    error.hint = f"{error.hint}; {combined}".removeprefix("; ") + ": fly them in separate campaigns"
                raise
        return found

    def _of(self, values: Mapping[str, Any]) -> tuple[str, Belief]:
        table = self._table(values)
        if (key := _digest(table, _contents(table, self._folder))) not in self._read:
            with error_path("belief"):
                belief = read_belief(table, self._scene, self._folder)
                self._try(belief, table)
            self._read[key] = belief
        return key, self._read[key]

    def _table(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """The table [belief] with values of the axes put in."""
        table = copy.deepcopy(dict(self._base))
        for name, value in values.items():
            _, *steps, last = self._paths[name]
            place = table
            for step in steps:
                place = place.setdefault(step, {})
                if not isinstance(place, dict):
                    raise ConfigError(".".join(self._paths[name]), "must be a field of a belief", value,
                                      f"the scenario has {step} = {place!r}")
            place[last] = value
        return table

    def _try(self, belief: Belief, table: Mapping[str, Any]) -> None:
        """Make the scene; a surface whose facets were reduced once is not reduced again: it takes seconds."""
        bodies, surfaces = {}, set()
        for name, each in belief.bodies.items():
            surface = json.dumps([name, *map(table["bodies"][name].get, ("shape", "facets"))])
            bodies[name] = replace(each, facets=None) if surface in self._surfaces else each
            surfaces.add(surface)
        replace(belief, bodies=bodies).scene(self._scene)
        self._surfaces |= surfaces


def _contents(table: Any, folder: Path) -> list[str]:
    """Digests of the shape files that a belief names."""
    if not isinstance(table, Mapping):
        return []
    found = [digest for value in table.values() for digest in _contents(value, folder)]
    if isinstance(table.get("shape"), str) and (folder / table["shape"]).is_file():
        found.append(hashlib.sha256((folder / table["shape"]).read_bytes()).hexdigest())
    return found


def _digest(*parts: Any) -> str:
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()
