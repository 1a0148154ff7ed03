"""The common ground of all exports: epochs, and places and attitudes about the first body, as arrays."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from glrender_camera import PinholeCamera
from glrender_camera.validate import integer, text
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from ...base.errors import ConfigError
from ...view.state import Pose, State
from ..epochs import Epoch

KM_PER_M = 1e-3
# SPICE's names of frames have 26 characters at most, which leaves as many for bodies with "_FIXED" behind them.
_MOST_LETTERS = 20
_MOST_ID = 2**31 - 1


@dataclass(frozen=True, kw_only=True, eq=False)
class Flight:
    """The states of a sequence with the names and numbers that other tools know them by.

    Parameters
    ----------
    states : sequence of State
        With dates, each later than the one before.
    camera : PinholeCamera
    radii_m : mapping of str to float [m]
        Radii of the bodies by their names, in the order of the scene; the first is the centre of all files.
    spacecraft : str
        Name of the spacecraft in the files.
    ids : mapping of str to int
        NAIF's numbers of bodies and, negative, of `spacecraft`; the others get numbers of their own.

    Raises
    ------
    ConfigError
        States without dates or out of order, names that are too long or alike in capitals, numbers of nobody.
    """

    states: Sequence[State]
    camera: PinholeCamera
    radii_m: Mapping[str, float]
    spacecraft: str = "spacecraft"
    ids: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self):
        text("spacecraft", self.spacecraft)
        for index, state in enumerate(self.states):
            if lacking := [name for name in self.radii_m if name not in state.bodies]:
                raise ConfigError(f"states[{index}].bodies", "must have every body of the scene", lacking)
            if state.date_tdb is None:
                raise ConfigError(f"states[{index}].date_tdb", "missing: other tools' files have dates",
                                  hint="give the scenario a time.start_tdb, or each state a date_tdb")
            if index and not self.epochs[index] > self.epochs[index - 1]:
                raise ConfigError(f"states[{index}].date_tdb", "must be later than that of the state before",
                                  state.date_tdb, "put the states in order, with one state a date")
        names = ["sun", self.spacecraft, self.camera.name, *self.radii_m]
        if len({in_capitals(name) for name in names}) < len(names):
            raise ConfigError("spacecraft", "and the names of camera, bodies and the Sun must differ in more than case "
                              "and punctuation", names, "rename one")
        for name in self.ids:
            if name not in (known := (self.spacecraft, *self.radii_m)):
                raise ConfigError("ids", f"must be of {', '.join(known)}", name)
            of_bodies = name != self.spacecraft
            integer(f"ids.{name}", self.ids[name], 1 if of_bodies else -2_000_000, _MOST_ID if of_bodies else -1)

    @cached_property
    def epochs(self) -> list[Epoch]:
        """The states' epochs, to the microsecond of their dates."""
        return [Epoch.from_tdb(str(state.date_tdb)) for state in self.states]

    @property
    def et_s(self) -> np.ndarray:
        """The same (N,) [s] as SPICE's ET."""
        return np.array([epoch.et_s for epoch in self.epochs])

    @property
    def about(self) -> str:
        """Name of the body that all places are about."""
        return next(iter(self.radii_m))

    @property
    def others(self) -> tuple[str, ...]:
        """Names of the other bodies."""
        return tuple(self.radii_m)[1:]

    def rows(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Positions (N, 3) [m] and velocities (N, 3) [m/s] of the spacecraft or a body about the centre, ICRF axes."""
        (r, v), (r_centre, v_centre) = self._given(name), self._given(self.about)
        return r - r_centre, v - v_centre

    def rows_of_sun(self) -> tuple[np.ndarray, np.ndarray]:
        """The same of the Sun, which stands still in `inertial`."""
        r = np.array([state.r_sun_inertial_m for state in self.states]) - self._given(self.about)[0]
        centre = [state.bodies[self.about] for state in self.states]
        if any(pose.v_inertial_m_s is None for pose in centre):
            return r, self._derivative(r)
        return r, -self._given(self.about)[1]

    def rows_of_camera(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities of the camera's projection centre."""
        (r, v), q, rates = self.rows(self.spacecraft), *self.turns(self.spacecraft)
        inertial_from_frame = Rotation.from_quat(q, scalar_first=True).inv()
        arm_m = np.array(self.camera.r_camera_spacecraft_m)
        moved = inertial_from_frame.apply(arm_m)
        if rates is None:
            return r + moved, v + self._derivative(moved)
        return r + moved, v + inertial_from_frame.apply(np.cross(rates, arm_m))

    def turns(self, name: str) -> tuple[np.ndarray, np.ndarray | None]:
        """`q_frame_from_inertial` (N, 4), and rates (N, 3) [rad/s] in the frame, or None where not all are known."""
        poses = self._poses(name)
        rates = [pose.angular_velocity_rad_s for pose in poses]
        return (np.array([pose.q_from_inertial for pose in poses]),
                None if any(rate is None for rate in rates) else np.array(rates))

    def needs_two(self, kind: str) -> None:
        """Refuse a file that holds spans of time where there is one state alone."""
        if len(self.states) < 2:
            raise ConfigError("states", f"must be two or more for {kind}", len(self.states), f"leave {kind} out")

    def _poses(self, name: str) -> list[Pose]:
        return [state.spacecraft if name == self.spacecraft else state.bodies[name] for state in self.states]

    def _given(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities in `inertial`; where not all poses have velocities, those of a spline."""
        poses = self._poses(name)
        r, v = np.array([pose.r_inertial_m for pose in poses]), [pose.v_inertial_m_s for pose in poses]
        return r, self._derivative(r) if any(each is None for each in v) else np.array(v)

    def _derivative(self, r: np.ndarray) -> np.ndarray:
        if len(r) < 2:
            return np.zeros_like(r)
        times = np.array([epoch - self.epochs[0] for epoch in self.epochs])
        return CubicSpline(times, r)(times, 1)


def in_capitals(name: str) -> str:
    """A name as kernels have it: A to Z without accents, digits, underscores, at most 20; digits alone are a number."""
    letters = "".join(each for each in unicodedata.normalize("NFKD", name) if not unicodedata.combining(each))
    made = re.sub(r"[^A-Z0-9]+", "_", letters.upper()).strip("_")
    if len(made) > _MOST_LETTERS or not re.search("[A-Z]", made):
        raise ConfigError("name", f"must have a letter, and at most {_MOST_LETTERS} letters and digits in other tools' "
                          "files", name, "rename it")
    return made
