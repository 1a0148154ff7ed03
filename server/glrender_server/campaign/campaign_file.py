"""From a campaign file (TOML) to its cases: a scenario, and the axes along which it is varied."""

from __future__ import annotations

import copy
import hashlib
import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
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
    """What all flights of a campaign have in common.

    Attributes
    ----------
    scene : Scene
        The true one.
    states : sequence of State
        The true trajectory; `pointing` says whether its attitudes are flown.
    camera, body : str
        What takes the frames, and what is navigated about.
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
        Values by the axes' names; of beliefs as ``belief.bodies.itokawa.facets``.
    believed : mapping
        The table [belief] of the scenario, which the axes change.
    folder : path
        That names of shape files in beliefs are relative to.
    """

    path: Path
    setup: Setup
    axes: Mapping[str, tuple[Any, ...]]
    believed: Mapping[str, Any]
    folder: Path

    @property
    def varied(self) -> list[str]:
        """Names of the axes with several values."""
        return [name for name, values in self.axes.items() if len(values) > 1]

    @cached_property
    def cases(self) -> list[Case]:
        """All cases: beliefs change slowest, seeds fastest."""
        beliefs: dict[str, Belief] = {}
        return [self._case(dict(zip(self.axes, values, strict=True)), beliefs)
                for values in itertools.product(*self.axes.values())]

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

    def _case(self, values: dict[str, Any], beliefs: dict[str, Belief]) -> Case:
        table = believed_table(self.believed, values)
        key = _digest(table, _contents(table, self.folder))
        if key not in beliefs:
            beliefs[key] = read_belief(table, self.setup.scene, self.folder)
        digest = _digest(self._digest, key, {name: value for name, value in values.items() if name in _OWN_AXES})
        return Case(id=digest[:_ID_DIGITS], values=values, belief=beliefs[key], belief_key=key)

    @cached_property
    def _digest(self) -> str:
        setup = self.setup
        return _digest(setup.version, digest_of_scene(setup.scene), digest_of_states(setup.states), setup.camera,
                       setup.body, setup.pointing, setup.handover, setup.acceleration_error)


def load_campaign(path: str | Path) -> Campaign:
    """A campaign of its file; the scenario's name is relative to it.

    Raises
    ------
    ConfigError
        The file is missing or is not TOML, or a field breaks a rule: with the path of the field.
    """
    path = Path(path)
    with error_path(path.name):
        table = known_keys("", read_toml(path), _KEYS, required=("scenario", "axes"))
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
            axes = _axes(table["axes"], scenario.scene, camera)
        if (count := int(np.prod([len(values) for values in axes.values()], dtype=float))) > _MAX_CASES:
            raise ConfigError("axes", f"must give {_MAX_CASES} cases at most", count, "give fewer values")
        believed = read_toml(scenario_path).get("belief", {})
        campaign = Campaign(path=path, setup=setup, axes=axes, believed=believed, folder=scenario_path.parent)
        _try_beliefs(campaign)
    return campaign


def believed_table(base: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """The table [belief] with the values of a case's axes put in."""
    table = copy.deepcopy(dict(base))
    for name, value in values.items():
        first, *steps = name.split(".")
        if first == "belief":
            place = table
            for step in steps[:-1]:
                place = place.setdefault(step, {})
                if not isinstance(place, dict):
                    raise ConfigError(f"axes.{name}", "must be a field of a belief", value,
                                      f"the scenario has {step} = {place!r}")
            place[steps[-1]] = value
    return table


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


def _axes(table: object, scene: Scene, camera: PinholeCamera) -> dict[str, tuple[Any, ...]]:
    known_keys("", table, _AXES)
    if not isinstance(table.get("belief", {}), Mapping):
        raise ConfigError("belief", "must be a table of beliefs", table["belief"], "belief.bodies.NAME.facets = [0.1]")
    given = {**dict(_leaves("belief", table.get("belief", {}))),
             **{name: table[name] for name in _OWN_AXES if name in table}}
    axes = {**{name: None for name in given if name not in _OWN_AXES}, "estimator": ["model"],
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
    return axes


def _table_of_fault(fault: Fault) -> dict[str, Any]:
    return {"kind": fault.kind, **asdict(fault)}


def _leaves(path: str, table: object) -> Iterator[tuple[str, Any]]:
    """Dotted names of the axes in nested tables, with their lists."""
    if not isinstance(table, Mapping):
        yield path, table
        return
    for key, value in table.items():
        yield from _leaves(f"{path}.{key}", value)


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


def _try_beliefs(campaign: Campaign) -> None:
    """Refuse at the start what no worker could believe: each value of each axis of beliefs alone."""
    first = {name: values[0] for name, values in campaign.axes.items()}
    for name, values in campaign.axes.items():
        if name.startswith("belief."):
            for index, value in enumerate(values):
                table = believed_table(campaign.believed, {**first, name: value})
                with error_path(f"axes.{name}[{index}]"):
                    _believed(table, campaign, name)
    if not any(name.startswith("belief.") for name in campaign.axes):
        _believed(dict(campaign.believed), campaign, "")


def _believed(table: dict[str, Any], campaign: Campaign, axis: str) -> None:
    try:
        with error_path("belief"):
            read_belief(table, campaign.setup.scene, campaign.folder).scene(campaign.setup.scene)
    except ConfigError as error:
        # The axis names the field already.
        error.path = error.path.removeprefix(axis).lstrip(".") if axis and error.path.startswith(axis) else error.path
        raise


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
