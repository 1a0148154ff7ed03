"""The scenario: trajectories, attitudes and times joined to the states of a sequence, and checked."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..base.constants import SUN_RADIUS_M
from ..base.errors import ConfigError, SceneError, error_path
from ..base.plausible import Advice
from ..base.rotations import dcm
from ..scene.body import Body
from ..scene.scene import Scene
from ..view.course import Course
from ..view.state import Pose, State
from .attitude import Attitude, Fixed, Geometry
from .belief.belief import Belief
from .epochs import Epoch
from .paths import Trajectory
from .plausible import (
    SPACECRAFT,
    SUN,
    Written,
    doubted,
    overlap_doubts,
    refuse_impossible,
    scenario_doubts,
    written_objects,
)

# The scene of a scenario without one. Those from files have one, so that readers of `scenario.scene` need not ask.
_NO_SCENE: Any = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Scenario:
    """Trajectories, attitudes and times.

    Parameters
    ----------
    trajectories : mapping of name to Trajectory
        Trajectories of "spacecraft", of the bodies and of "sun". Each is about another object; one, the root, has none.
    sampler : object with `t_s()`
        As in `glrender.scenario.samplers`.
    attitudes : mapping of name to Attitude
        Attitudes of "spacecraft" and of the bodies; an object without one keeps ICRF's axes.
    origin : str
        Whose place is the origin of the states' frame `inertial`, with ICRF's axes: the body that is flown by, for
        digits.
    start : Epoch, optional
        Epoch of t_s = 0; needed by what moves by the calendar.
    scene : Scene, optional
        Checked against where it is given.
    output : mapping
        The table of that name of a scenario file, as it was read.
    notes : sequence of str
        Warnings from the reading of cameras, which `check` repeats.
    keypoints : mapping
        Places (3,) [m] in a body's frame, by the names of the body and the keypoint: for labels.
    belief : Belief
        How the on-board side has the scene.
    written : sequence of Written
        Where a file has the trajectories and attitudes: what messages call their fields. By default the objects'.

    Raises
    ------
    ConfigError
        A trajectory about nothing, or in a circle; no trajectory of the spacecraft or the Sun; bodies that are not
        those of the scene.
    """

    trajectories: Mapping[str, Trajectory]
    sampler: Any
    attitudes: Mapping[str, Attitude] = field(default_factory=dict)
    origin: str
    start: Epoch | None = None
    scene: Scene = _NO_SCENE
    output: Mapping[str, Any] = field(default_factory=dict)
    notes: Sequence[str] = ()
    keypoints: Mapping[str, Mapping[str, np.ndarray]] = field(default_factory=dict)
    belief: Belief = field(default_factory=Belief)
    written: Sequence[Written] = ()

    def __post_init__(self):
        names = self.names
        for needed in (SUN, SPACECRAFT, self.origin):
            if needed not in names:
                raise ConfigError(f"trajectories.{needed}", "missing", hint=f"there are {', '.join(names)}")
        root = self._chain(self.origin)[-1]
        for name in names:
            if (other := self._chain(name)[-1]) != root:
                raise ConfigError(f"trajectories.{other}", "missing", hint=f"nothing gives its place from {root!r}")
        for name in self.attitudes:
            if name not in names or name == SUN:
                raise ConfigError(f"attitudes.{name}", "must be of the spacecraft or a body", name,
                                  f"there are {', '.join(names)}")
        if self.scene is not None:
            for body in self.scene.bodies:
                if body.name not in self.bodies:
                    raise ConfigError(f"trajectories.{body.name}", "missing: the scene has this body")
            for name in self.bodies:
                if name not in self.scene.hulls:
                    raise ConfigError(f"trajectories.{name}", "must be of a body of the scene", name,
                                      f"the scene has {', '.join(self.scene.hulls)}")

    @property
    def names(self) -> list[str]:
        """All that has a place: those with a trajectory, and what these are about."""
        return list(dict.fromkeys([*self.trajectories, *(path.about for path in self.trajectories.values())]))

    @property
    def bodies(self) -> list[str]:
        """Names of the bodies."""
        return [name for name in self.names if name not in (SUN, SPACECRAFT)]

    @cached_property
    def t_s(self) -> np.ndarray:
        """(N,) float64 times of the frames [s], from the start."""
        return np.asarray(self.sampler.t_s(), float)

    def epochs(self) -> list[Epoch]:
        """The epochs of the frames; none where there is no start."""
        return [] if self.start is None else [self.start.after(t) for t in self.t_s]

    def geometry(self, t_s: np.ndarray) -> Geometry:
        """Where everything is, at times (N,) [s] from the start."""
        t_s = np.asarray(t_s, float)
        steps = {}
        for name, path in self.trajectories.items():
            with error_path(f"trajectories.{name}"):
                steps[name] = np.concatenate(path.at(self.start, t_s), axis=1)
        places = {name: self._from_origin(name, steps, len(t_s)) for name in self.names}
        return Geometry(start=self.start, t_s=t_s, r_m={name: place[:, :3] for name, place in places.items()},
                        v_m_s={name: place[:, 3:] for name, place in places.items()})

    def states(self, t_s: np.ndarray | None = None) -> list[State]:
        """The states at the frames' times, or at others (N,) [s]: positions from the origin, velocities from the Sun.

        Raises
        ------
        ConfigError
            A state that a trajectory or an attitude does not have, with its path.
        """
        return list(self.iter_states(t_s))

    def iter_states(self, t_s: np.ndarray | None = None) -> Iterator[State]:
        """The states of `states`, one after the other; each knows the others as its course."""
        for state in self._plain_states(self.t_s if t_s is None else t_s):
            yield state.with_course(Course(states=self._motion.plain_states, state=state))

    def plain_states(self, t_s: np.ndarray) -> list[State]:
        """The states at times (N,) [s], without a course."""
        return list(self._plain_states(t_s))

    @cached_property
    def _motion(self) -> Scenario:
        """The moving objects, without the scene: they are sent with states to other processes."""
        return replace(self, scene=_NO_SCENE, output={}, notes=(), keypoints={}, belief=Belief())

    def _plain_states(self, t_s: np.ndarray) -> Iterator[State]:
        geometry = self.geometry(t_s)
        turned = self._turned(geometry)
        with doubted(self.doubts):
            for index in range(len(geometry.t_s)):
                yield self._state(index, geometry, turned)

    def _state(self, index: int, geometry: Geometry,
               turned: Mapping[str, tuple[np.ndarray, np.ndarray | None]]) -> State:
        rates = {name: None if rate is None else rate[index] for name, (_, rate) in turned.items()}
        pose = {name: Pose(r_inertial_m=geometry.r_m[name][index], q_from_inertial=turned[name][0][index],
                           v_inertial_m_s=geometry.v_m_s[name][index] - geometry.v_m_s[SUN][index],
                           angular_velocity_rad_s=rates[name])
                for name in (SPACECRAFT, *self.bodies)}
        return State(t_s=float(geometry.t_s[index]), r_sun_inertial_m=geometry.r_m[SUN][index],
                     spacecraft=pose.pop(SPACECRAFT), bodies=pose,
                     date_tdb=None if self.start is None else self.start.after(float(geometry.t_s[index])).tdb)

    @property
    def scene_bodies(self) -> Sequence[Body]:
        """The scene's bodies; none without a scene."""
        return () if self.scene is None else self.scene.bodies

    @cached_property
    def doubts(self) -> tuple[Advice, ...]:
        """Warnings of fields that are improbable, most often for their unit."""
        return tuple(scenario_doubts(self._fields, self.scene_bodies))

    @property
    def _fields(self) -> Sequence[Written]:
        return self.written or written_objects(self.trajectories, self.attitudes)

    def check(self) -> list[str]:
        """Warnings, in sentences, before the first frame is drawn; nothing is drawn.

        Raises
        ------
        SceneError
            A spacecraft or the Sun inside a body, with the first frame where it is; a sequence without frames.
        """
        if not len(self.t_s):
            raise SceneError("time", "gives no frame", hint="ask for one frame at least")
        refuse_impossible(self._fields, self.scene_bodies)
        states = self.states()
        with doubted(self.doubts):
            for index, state in enumerate(states):
                self._refuse_inside(index, state)
        cameras = [] if self.scene is None else self.scene.cameras
        doubts = [*self.doubts, *overlap_doubts(states, self.scene_bodies, self._fields, self.doubts)]
        return [*self.notes, *map(str, doubts), *self._of_sources(),
                *(warning for camera in cameras for warning in self._of_camera(camera, states))]

    def _of_sources(self) -> list[str]:
        """Warnings of trajectories and attitudes that have some (`notes_at`) about the frames' times."""
        warnings = []
        for kind, sources in (("trajectory", self.trajectories), ("attitude", self.attitudes)):
            for name, source in sources.items():
                if hasattr(source, "notes_at"):
                    with error_path(f"{kind}.{name}"):
                        warnings += [f"{kind} of {name!r}: {note}" for note in source.notes_at(self.start, self.t_s)]
        return warnings

    def _refuse_inside(self, index: int, state: State) -> None:
        for name, pose in state.bodies.items():
            where = f"frame {index}, t_s = {state.t_s:g}"
            distance_m = float(np.linalg.norm(state.r_sun_inertial_m - pose.r_inertial_m))
            if not distance_m > SUN_RADIUS_M:
                raise SceneError(f"bodies.{name}", f"is inside the Sun ({where})", distance_m)
            if self.scene is not None:
                offset = dcm(pose.q_from_inertial) @ (state.spacecraft.r_inertial_m - pose.r_inertial_m)
                if not self.scene.hulls[name].is_outside(offset):
                    raise SceneError(SPACECRAFT, f"is inside {name!r} ({where}), at [m] from its origin",
                                     [round(float(x), 3) for x in offset], "give a trajectory that keeps farther away")

    def _of_camera(self, camera: Any, states: list[State]) -> list[str]:
        """Warnings of one camera: frames with the Sun in the field, frames without a body."""
        with_sun, empty = [], []
        for index, state in enumerate(states):
            to_camera = dcm(camera.q_camera_from_spacecraft) @ dcm(state.spacecraft.q_from_inertial)
            from_craft = lambda r, state=state: r - state.spacecraft.r_inertial_m  # noqa: E731
            corner = np.hypot(camera.width_px, camera.height_px) / 2.0 / camera.focal_length_px
            if _off_axis_rad(to_camera @ from_craft(state.r_sun_inertial_m)) < np.arctan(corner):
                with_sun.append(index)
            seen = []
            for name, pose in state.bodies.items():
                r = to_camera @ from_craft(pose.r_inertial_m)
                range_m = float(np.linalg.norm(r))
                radius_m = self.scene.hulls[name].radius_m
                seen.append(_off_axis_rad(r) < np.arctan(corner) + np.arcsin(min(radius_m / max(range_m, 1e-9), 1.0)))
            if not any(seen):
                empty.append(index)
        warnings = []
        if with_sun:
            warnings.append(f"camera {camera.name!r}: the Sun is in the field, behind the target, in "
                            f"{_frames(with_sun)}: bodies show their dark sides; check the side of the trajectory")
        if empty:
            warnings.append(f"camera {camera.name!r}: no body is in the field in {_frames(empty)}"
                            f"{', the whole sequence' if len(empty) == len(states) else ''}: check [attitude]")
        return warnings

    def _turned(self, geometry: Geometry) -> dict[str, tuple[np.ndarray, np.ndarray | None]]:
        turned = {}
        for name in (SPACECRAFT, *self.bodies):
            with error_path(f"attitudes.{name}"):
                turned[name] = self.attitudes.get(name, Fixed()).at(geometry, name)
        return turned

    def _chain(self, name: str) -> list[str]:
        """A name, what it is about, and so on to the root."""
        chain = [name]
        while chain[-1] in self.trajectories:
            about = self.trajectories[chain[-1]].about
            if about in chain:
                raise ConfigError(f"trajectories.{name}.about", "must not lead in a circle",
                                  " > ".join([*chain, about]))
            chain.append(about)
        return chain

    def _from_origin(self, name: str, steps: dict[str, np.ndarray], count: int) -> np.ndarray:
        """Positions and velocities (N, 6) from the origin. Steps that both have in common are left out, for digits."""
        there, here = self._chain(name)[:-1], self._chain(self.origin)[:-1]
        place = np.zeros((count, 6))
        for step in there:
            if step not in here:
                place = place + steps[step]
        for step in here:
            if step not in there:
                place = place - steps[step]
        return place


def _off_axis_rad(r_camera: np.ndarray) -> float:
    return float(np.arctan2(np.hypot(r_camera[0], r_camera[1]), r_camera[2]))


def _frames(indices: list[int]) -> str:
    first, last = indices[0], indices[-1]
    return f"{len(indices)} frame{'s' if len(indices) > 1 else ''} ({first}{f' to {last}' if last > first else ''})"
