"""A fly-by of a body: the closest approach where and when it is asked for, on the asked side of the Sun."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from glrender_camera.validate import one_of, within
from scipy.integrate import OdeSolution, solve_ivp

from ..base.constants import GM_SUN_M3_S2
from ..base.errors import ConfigError
from .checks import MAX_GM_M3_S2, duration, length, speed, unit
from .epochs import Epoch, needed
from .kepler import EQUATORIAL_FROM_ECLIPTIC
from .paths import Trajectory

SIDES = ("sunlit", "terminator", "dark")
# Sine of the angle between velocity and Sun below which the sides of a pass cannot be separated.
_LEAST_SINE = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class Encounter:
    """The trajectory of a spacecraft that passes a body; both fall freely about the Sun.

    Parameters
    ----------
    body : str
        Name of the body.
    body_trajectory : Trajectory
        Trajectory of the body about the Sun: `Kepler`, or from SPK.
    distance_m : float [m], > 0
        Between the spacecraft and the body's origin at `date`, the least of the pass.
    relative_velocity_m_s : float [m/s], > 0
        At `date`.
    date : Epoch
        Date of the closest approach, in the middle of the duration.
    duration_s : float [s], > 0
    side : "sunlit", "terminator" or "dark", optional
        The phase angle at `date` is the least that the direction of flight allows, 90 deg, or the greatest.
    phase_angle_deg : float [deg], optional
        In place of `side`; Sun, body, spacecraft at `date`.
    direction : (3,) float, optional
        Of the velocity relative to the body, ICRF axes, any length; by default against the body's own velocity.
    over : "north" or "south"
        Side of the ecliptic that chooses one of the two passes with the same phase angle.
    gravitational_parameter_m3_s2 : float [m3/s2], >= 0
        Parameter of the body; it bends a pass by 2 mu / (d v^2) rad, which matters below some 10 m/s. 0 leaves it out.

    Raises
    ------
    ConfigError
        A phase angle that this direction of flight does not reach, with those that it does; flight along the
        Sun's direction with another side than the terminator; a speed so low that the body pulls the spacecraft closer.

    Source: sispo-paper, Table 1. There the offset is along the body's radius; here it is perpendicular to the
    relative velocity, without which the closest approach is elsewhere.
    """

    body: str
    body_trajectory: Trajectory
    distance_m: float
    relative_velocity_m_s: float
    date: Epoch
    duration_s: float
    side: str | None = None
    phase_angle_deg: float | None = None
    direction: np.ndarray | None = None
    over: str = "north"
    gravitational_parameter_m3_s2: float = 0.0

    def __post_init__(self):
        for name, check in (("distance_m", length), ("relative_velocity_m_s", speed), ("duration_s", duration)):
            object.__setattr__(self, name, check(name, getattr(self, name)))
        if (self.side is None) == (self.phase_angle_deg is None):
            raise ConfigError("side", "needs exactly one of `side` and `phase_angle_deg`", self.side)
        if self.side is None:
            within("phase_angle_deg", self.phase_angle_deg, 0.0, 180.0)
        else:
            one_of("side", self.side, SIDES)
        one_of("over", self.over, ("north", "south"))
        within("gravitational_parameter_m3_s2", self.gravitational_parameter_m3_s2, 0.0, MAX_GM_M3_S2)
        if self.direction is not None:
            object.__setattr__(self, "direction", unit("direction", self.direction))
        # Computed here for its errors, and kept.
        r, v = self.closest_approach
        if not v @ v + r @ self._acceleration(0.0, r) > 0.0:
            raise ConfigError("relative_velocity_m_s", "is so low that the body pulls the spacecraft closer than "
                              "distance_m", self.relative_velocity_m_s,
                              f"give more than {np.sqrt(self.gravitational_parameter_m3_s2 / self.distance_m):.6g}")

    @property
    def about(self) -> str:
        """The body's name: positions are relative to it."""
        return self.body

    @property
    def start(self) -> Epoch:
        """Half the duration before the closest approach."""
        return self.date.after(-0.5 * self.duration_s)

    @cached_property
    def closest_approach(self) -> tuple[np.ndarray, np.ndarray]:
        """Position (3,) [m] and velocity (3,) [m/s] relative to the body at `date`, ICRF axes."""
        (r_body,), (v_body,) = self.body_trajectory.at(self.date, np.zeros(1))
        ahead = -v_body if self.direction is None else self.direction
        ahead, to_sun = ahead / np.linalg.norm(ahead), -r_body / np.linalg.norm(r_body)
        return self.distance_m * self._offset(ahead, to_sun), self.relative_velocity_m_s * ahead

    def _offset(self, ahead: np.ndarray, to_sun: np.ndarray) -> np.ndarray:
        """Unit vector from the body, perpendicular to the velocity, at the asked phase angle."""
        across = to_sun - (to_sun @ ahead) * ahead
        sine = float(np.linalg.norm(across))
        least = np.degrees(np.arccos(min(sine, 1.0)))
        if sine < _LEAST_SINE:
            if self.side != "terminator" and self.phase_angle_deg != 90.0:
                raise ConfigError("side" if self.side else "phase_angle_deg", 'must be "terminator", or 90: the flight '
                                  "is along the Sun's direction", self.side or self.phase_angle_deg,
                                  "give another `direction`")
            across, sine = np.cross(ahead, np.eye(3)[np.argmin(np.abs(ahead))]), 1.0
            return across / np.linalg.norm(across)
        if self.side is None and self.phase_angle_deg is not None:
            if not least - 1e-9 <= self.phase_angle_deg <= 180.0 - least + 1e-9:
                raise ConfigError("phase_angle_deg", f"must be between {least:.4f} and {180.0 - least:.4f} for this "
                                  "direction of flight", self.phase_angle_deg, "give another `direction`")
            cosine = np.clip(np.cos(np.radians(self.phase_angle_deg)) / sine, -1.0, 1.0)
        else:
            cosine = {"sunlit": 1.0, "terminator": 0.0, "dark": -1.0}[str(self.side)]
        sunward, normal = across / sine, np.cross(ahead, across) / sine
        if (normal @ EQUATORIAL_FROM_ECLIPTIC[:, 2] < 0.0) == (self.over == "north"):
            normal = -normal
        return cosine * sunward + np.sqrt(1.0 - cosine * cosine) * normal

    def at(self, start: Epoch, t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions (N, 3) [m] and velocities (N, 3) [m/s] relative to the body, at times (N,) [s] from a start.

        The relative motion is integrated, with the Sun's tide: the difference of two orbits would be good to 2e-5 m
        of rounding alone.
        """
        dt = np.asarray(t_s, float) + (needed(start) - self.date)
        out = np.tile(np.concatenate(self.closest_approach), (dt.size, 1))
        for sign in (-1.0, 1.0):
            here = dt * sign > 0.0
            if here.any():
                out[here] = self._flown(sign, float(np.abs(dt[here]).max()))(np.abs(dt[here])).T
        return out[:, :3], out[:, 3:]

    def _flown(self, sign: float, until_s: float) -> OdeSolution:
        """The relative motion after the closest approach (sign 1) or before it (-1), over half the duration or more."""
        if sign not in self._flights or self._flights[sign].t_max < until_s:
            # A little more than half: rounding must not make later requests integrate anew, to other bits.
            until_s = max(until_s, 0.5 * self.duration_s * (1.0 + 1e-9))
            scale = np.repeat([self.distance_m, self.relative_velocity_m_s], 3)
            self._flights[sign] = solve_ivp(
                lambda t, y: self._rates(t * sign, y) * sign, (0.0, until_s), np.concatenate(self.closest_approach),
                method="DOP853", dense_output=True, rtol=1e-13, atol=1e-12 * scale).sol
        return self._flights[sign]

    @cached_property
    def _flights(self) -> dict[float, OdeSolution]:
        return {}

    def _rates(self, dt_s: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate([y[3:], self._acceleration(dt_s, y[:3])])

    def _acceleration(self, dt_s: float, r: np.ndarray) -> np.ndarray:
        """The acceleration of the spacecraft relative to the body [m/s2]: the Sun's tide, and the body's own pull."""
        r_body = self.body_trajectory.at(self.date, np.array([dt_s]))[0][0]
        r_craft = r_body + r
        tide = GM_SUN_M3_S2 * (r_body / np.linalg.norm(r_body)**3 - r_craft / np.linalg.norm(r_craft)**3)
        return tide - self.gravitational_parameter_m3_s2 * r / np.linalg.norm(r)**3
