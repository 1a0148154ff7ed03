"""The subject of a command: a scene, a scenario or a shape file, and the state to draw."""

from __future__ import annotations

import argparse
import difflib
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from glrender import Body, ConfigError, PinholeCamera, Pose, Scene, Shape, State, frames
from glrender.base.constants import AU_M
from glrender.base.errors import error_path
from glrender.brdf import LommelSeeliger
from glrender.scenario import RandomStates, Scenario
from glrender.scenario.epochs import Epoch
from glrender.scenario.files.scenario_file import scenario_of_table
from glrender.scene.scene_file import read_toml
from glrender.scene.shape.files import own_unit
from glrender.scene.shape.shape import file_scale
from glrender_camera import CameraModel
from glrender_camera.validate import within

# Tables that a scenario file has and a scene file has not.
_OF_SCENARIOS = ("scene", "encounter", "trajectory", "random")
# Share of the frame's smaller side that the first body takes in the state that is made for it.
_FILLED = 0.8
# Share of a shell's area in the sum of its facets' area vectors from which it is open (docs/shapes.md), and the cosine
# to +Z from which north is up in a frame, not +Z.
_OPEN, _STEEP = 0.25, 0.9
# Single-scattering albedo of a shape without a scene: between comets (0.04) and S-type asteroids (0.3).
_ALBEDO = 0.1


@dataclass(frozen=True, kw_only=True)
class Subject:
    """A scene with the states that it is seen at.

    Attributes
    ----------
    path : path
        The file that it was read from.
    scene : Scene
    scenario : Scenario, RandomStates or None
    """

    path: Path
    scene: Scene
    scenario: Scenario | RandomStates | None = None


def add_subject(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that name a subject, its camera and its state."""
    parser.add_argument("subject", type=Path, metavar="FILE",
                        help="scene or scenario (TOML), or a shape: OBJ, PLY, STL, PDS plates, ICQ, GLB, OFF")
    parser.add_argument("--unit", help="of a shape file, which carries none: m, km, or metres per unit")
    parser.add_argument("--camera", metavar="NAME", help="default: the scene's first")
    of_state = parser.add_mutually_exclusive_group()
    of_state.add_argument("--state", type=Path, metavar="FILE", help="state vector (JSON of State.to_dict())")
    of_state.add_argument("--phase-deg", type=float, metavar="DEG",
                          help="phase angle at the first body, which fills the frame (60)")
    of_state.add_argument("--at", metavar="TIME",
                          help="of a scenario: seconds from its start, or TDB as 2022-10-11T00:00:00; the middle frame")


def read_subject(path: Path, unit: str | None) -> Subject:
    """The subject of a file.

    Raises
    ------
    ConfigError, ShapeError
        The file is missing or breaks a rule; a shape file without a unit.
    """
    if not path.is_file():
        raise ConfigError(str(path), "is no file", hint=_like(path))
    if path.suffix.lower() != ".toml":
        if unit is None and own_unit(path) is None:
            raise ConfigError("--unit", "missing: shape files carry no unit", hint="--unit km, or --unit m")
        return Subject(path=path, scene=scene_of_shape(path, unit))
    if unit is not None:
        raise ConfigError("--unit", "is of shape files alone; a scene has a `length_unit` for each body", unit)
    table = read_toml(path)
    if any(key in table for key in _OF_SCENARIOS):
        scenario = scenario_of_table(table, folder=path.parent, path=path.name)
        return Subject(path=path, scene=scenario.scene, scenario=scenario)
    return Subject(path=path, scene=Scene.from_dict(table, shape_dir=path.parent, path=path.name))


def scene_of_shape(path: Path, unit: str | None) -> Scene:
    """A scene of a shape alone: of its file's materials, or of Lommel-Seeliger's law; by a navigation camera of 1 Mpx.

    Raises
    ------
    ConfigError, ShapeError
    """
    try:
        metres = file_scale(path, float(unit) if unit is not None and is_number(unit) else unit)
    except ConfigError as error:
        error.path = "--unit"
        raise
    with error_path(str(path)):
        shape = Shape.from_file(path, length_unit=metres)
    has_laws = bool(shape.materials) and all(each.law is not None for each in shape.materials)
    law = None if has_laws else LommelSeeliger(single_scattering_albedo=_ALBEDO)
    body = Body(name=path.stem, shape=shape, brdf=law)
    camera = PinholeCamera(name="navcam", width_px=1024, height_px=1024, focal_length_px=5000.0,
                           model=CameraModel.from_dict({"preset": "generic_navigation_camera", "exposure_s": "auto"}))
    return Scene(bodies=[body], cameras=[camera])


def state_of(subject: Subject, arguments: argparse.Namespace, camera: PinholeCamera) -> State:
    """The state that the arguments of `add_subject` ask for.

    Raises
    ------
    ConfigError
    """
    if arguments.state is not None:
        return read_state(arguments.state)
    if arguments.at is not None and subject.scenario is None:
        raise ConfigError("--at", "is of scenarios alone; a scene has no time", arguments.at, "give --state FILE")
    if subject.scenario is None or arguments.phase_deg is not None:
        phase_deg = 60.0 if arguments.phase_deg is None else arguments.phase_deg
        return default_state(subject.scene, camera.name, np.radians(within("--phase-deg", phase_deg, 0.0, 180.0)))
    if isinstance(subject.scenario, RandomStates):
        if arguments.at is not None:
            raise ConfigError("--at", "is of a trajectory; random states have no order", arguments.at,
                              "leave it out: the first one is drawn")
        return subject.scenario.states()[0]
    return subject.scenario.states(np.array([_time_s(subject.scenario, arguments.at)]))[0]


def read_state(path: Path) -> State:
    """A state of a JSON file.

    Raises
    ------
    ConfigError
    """
    if not path.is_file():
        raise ConfigError(str(path), "is no file", hint=_like(path))
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ConfigError(str(path), f"is not JSON: {error}") from None
    return State.from_dict(table)


def default_state(scene: Scene, camera_name: str, phase_rad: float) -> State:
    """The scene's first body at the origin, 1 au from the Sun, filling most of a camera's frame.

    Open ground is seen from above. Other bodies stand in a row above it in the frame, where none shades another.
    """
    camera = scene.camera(camera_name)
    body, *others = scene.bodies
    smaller_px = min(camera.width_px, camera.height_px)
    range_m = 2.0 * body.hull.radius_m * camera.focal_length_px / (_FILLED * smaller_px)
    front = _front(body.shape)
    up = np.array([0.0, 0.0, 1.0] if abs(front[2]) < _STEEP else [0.0, 1.0, 0.0])
    aside, r_camera = np.cross(up, front) / np.linalg.norm(np.cross(up, front)), range_m * front
    r_sun = AU_M * (np.sin(phase_rad) * aside + np.cos(phase_rad) * front)
    poses = {body.name: Pose(r_inertial_m=-body.shape.centre_m)}
    offset = body.hull.radius_m
    for other in others:
        offset += 1.5 * other.hull.radius_m
        poses[other.name] = Pose(r_inertial_m=offset * np.cross(front, aside) - other.shape.centre_m)
        offset += 1.5 * other.hull.radius_m
    q_camera = frames.look_at(r_camera, np.zeros(3), up)
    q_spacecraft = frames.quaternion(frames.dcm(camera.q_camera_from_spacecraft).T @ frames.dcm(q_camera))
    r_spacecraft = r_camera - frames.dcm(q_spacecraft).T @ camera.r_camera_spacecraft_m
    return State(r_sun_inertial_m=r_sun, bodies=poses,
                 spacecraft=Pose(r_inertial_m=r_spacecraft, q_from_inertial=q_spacecraft))


def _front(shape: Shape) -> np.ndarray:
    """Unit vector (3,) to the side from which an open shell's facets are seen; -Y of a closed one, seen from all."""
    across_m2 = (shape.facet_areas_m2[:, None] * shape.facet_normals).sum(axis=0)
    share = float(np.linalg.norm(across_m2)) / shape.facet_areas_m2.sum()
    return across_m2 / np.linalg.norm(across_m2) if share > _OPEN else np.array([0.0, -1.0, 0.0])


def _time_s(scenario: Scenario, at: str | None) -> float:
    """Seconds from a scenario's start."""
    if at is None:
        return float(scenario.t_s[len(scenario.t_s) // 2])
    if is_number(at):
        t_s = float(at)
    elif scenario.start is None:
        raise ConfigError("--at", "must be seconds from the start: this scenario has no epoch", at)
    else:
        with error_path("--at"):
            t_s = Epoch.from_tdb(at) - scenario.start
    first, last = float(scenario.t_s.min()), float(scenario.t_s.max())
    if not first <= t_s <= last:
        raise ConfigError("--at", f"must be within the scenario's frames, {first:g} to {last:g} s from its start", at)
    return t_s


def is_number(text: str) -> bool:
    """Whether a text is a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True


def _like(path: Path) -> str:
    """The question whether another file of the folder was meant."""
    if path.is_dir():
        return "it is a folder: name a file in it"
    if not path.parent.is_dir():
        return f"there is no folder {str(path.parent)!r}"
    like = difflib.get_close_matches(path.name, [file.name for file in path.parent.iterdir()], n=1)
    return f"did you mean {str(path.with_name(like[0]))!r}?" if like else ""
