"""Two-body motion: from orbital elements or a state to positions at any time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from glrender_camera.validate import finite, one_of, position, within
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from ..base.constants import GM_SUN_M3_S2, OBLIQUITY_J2000_RAD, SUN_RADIUS_M
from ..base.errors import ConfigError
from ..base.plausible import way_out
from .checks import angle_deg, gm, length, velocity
from .epochs import Epoch, needed

EQUATORIAL_FROM_ECLIPTIC = Rotation.from_euler("x", OBLIQUITY_J2000_RAD).as_matrix()
"""(3, 3): components in the ecliptic of J2000 to components in ICRF."""
# Laguerre's iteration needs 5 for most orbits, 12 for the worst that were tried.
_ITERATIONS = 60
# Before it is checked: that of the Sun.
_SUNS: Any = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Kepler:
    """A two-body orbit about the Sun or a body, of its state at an epoch.

    Parameters
    ----------
    r_m : (3,) float [m]
        Position relative to the centre of `about`, ICRF axes, not zero.
    v_m_s : (3,) float [m/s]
    epoch : Epoch
    about : str, optional
        "sun", or the name of a body.
    gravitational_parameter_m3_s2 : float [m3/s2], > 0, optional
        Parameter of the central mass; the Sun's by default.
    """

    r_m: np.ndarray
    v_m_s: np.ndarray
    epoch: Epoch
    about: str = "sun"
    gravitational_parameter_m3_s2: float = _SUNS

    def __post_init__(self):
        object.__setattr__(self, "r_m", position("r_m", self.r_m))
        object.__setattr__(self, "v_m_s", velocity("v_m_s", self.v_m_s))
        if not np.linalg.norm(self.r_m) > 1e-3:
            raise ConfigError("r_m", "must be at least a millimetre away", self.r_m.tolist())
        _beyond_sun("r_m", self.about, self.r_m, float(np.linalg.norm(self.r_m)))
        object.__setattr__(self, "gravitational_parameter_m3_s2",
                           _checked_gm(self.about, self.gravitational_parameter_m3_s2))

    @classmethod
    def from_elements(cls, *, semi_major_axis_m: float, eccentricity: float, inclination_deg: float,
                      longitude_ascending_node_deg: float, argument_of_periapsis_deg: float,
                      mean_anomaly_deg: float, epoch: Epoch, frame: str = "ecliptic", about: str = "sun",
                      gravitational_parameter_m3_s2: float | None = None) -> Kepler:
        """An orbit of its osculating elements.

        Parameters
        ----------
        semi_major_axis_m : float [m]
            Negative for a hyperbola.
        eccentricity : float [1], >= 0, not 1
        inclination_deg, longitude_ascending_node_deg, argument_of_periapsis_deg, mean_anomaly_deg : float [deg]
            The mean anomaly at `epoch`.
        epoch : Epoch
        frame : "ecliptic" or "equatorial"
            Ecliptic of J2000, or ICRF equator.
        about, gravitational_parameter_m3_s2
            As for `Kepler`.

        Raises
        ------
        ConfigError
            An ellipse with a negative axis, a hyperbola with a positive one, a parabola; an orbit within the Sun.

        Source: Vallado (2013), algorithm 10, COE2RV.
        """
        e = within("eccentricity", eccentricity, 0.0, 1e6)
        if not abs(e - 1.0) > 1e-9:
            raise ConfigError("eccentricity", "must not be 1", e, "a parabola is given by periapsis_distance_m and the "
                              "time of periapsis")
        a = finite("semi_major_axis_m", semi_major_axis_m)
        length("semi_major_axis_m", abs(a))
        if not a * (1.0 - e) > 0.0:
            raise ConfigError("semi_major_axis_m", f"must be {'> 0' if e < 1.0 else '< 0 for a hyperbola'}", a)
        # A hyperbola's axis may be shorter than its periapsis.
        _beyond_sun("semi_major_axis_m", about, a, a if e < 1.0 else a * (1.0 - e))
        mu = _checked_gm(about, gravitational_parameter_m3_s2)
        cos_nu, sin_nu = _true_anomaly(np.radians(angle_deg("mean_anomaly_deg", mean_anomaly_deg)), e)
        p = a * (1.0 - e * e)
        orbit = np.array([[cos_nu, sin_nu, 0.0], [-sin_nu, e + cos_nu, 0.0]])
        orbit *= [[p / (1.0 + e * cos_nu)], [np.sqrt(mu / p)]]
        r, v = orbit @ _perifocal_axes(inclination_deg, longitude_ascending_node_deg, argument_of_periapsis_deg,
                                       frame).T
        return cls(r_m=r, v_m_s=v, epoch=epoch, about=about, gravitational_parameter_m3_s2=mu)

    @classmethod
    def from_periapsis(cls, *, periapsis_distance_m: float, eccentricity: float, inclination_deg: float,
                       longitude_ascending_node_deg: float, argument_of_periapsis_deg: float, periapsis: Epoch,
                       frame: str = "ecliptic", about: str = "sun",
                       gravitational_parameter_m3_s2: float | None = None) -> Kepler:
        """An orbit by its periapsis and the time there, as comets have them: an ellipse, a parabola or a hyperbola.

        Parameters
        ----------
        periapsis_distance_m : float [m], > 0
        eccentricity : float [1], >= 0
            1 for a parabola.
        inclination_deg, longitude_ascending_node_deg, argument_of_periapsis_deg : float [deg]
        periapsis : Epoch
            When it is there; the orbit's epoch.
        frame : "ecliptic" or "equatorial"
            Ecliptic of J2000, or ICRF equator.
        about, gravitational_parameter_m3_s2
            As for `Kepler`.

        Raises
        ------
        ConfigError

        Source: Vallado (2013), section 2.2.
        """
        q = length("periapsis_distance_m", periapsis_distance_m)
        _beyond_sun("periapsis_distance_m", about, q, q)
        mu = _checked_gm(about, gravitational_parameter_m3_s2)
        speed = np.sqrt(mu * (1.0 + within("eccentricity", eccentricity, 0.0, 1e6)) / q)
        axes = _perifocal_axes(inclination_deg, longitude_ascending_node_deg, argument_of_periapsis_deg, frame)
        return cls(r_m=q * axes[:, 0], v_m_s=speed * axes[:, 1], epoch=periapsis, about=about,
                   gravitational_parameter_m3_s2=mu)

    def at(self, start: Epoch, t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions (N, 3) [m] and velocities (N, 3) [m/s] relative to `about`, at times (N,) [s] from a start."""
        return propagated(self.r_m, self.v_m_s, np.asarray(t_s, float) + (needed(start) - self.epoch),
                          self.gravitational_parameter_m3_s2)


def propagated(r_m: np.ndarray, v_m_s: np.ndarray, dt_s: np.ndarray, mu_m3_s2: float) -> tuple[np.ndarray, np.ndarray]:
    """Two-body motion of a state, by universal variables: ellipses, parabolas and hyperbolas alike.

    Parameters
    ----------
    r_m, v_m_s : (3,) float64 [m], [m/s]
    dt_s : (N,) float64 [s]
    mu_m3_s2 : float [m3/s2]

    Returns
    -------
    r_m, v_m_s : (N, 3) float64

    Source: Vallado (2013), algorithm 8; iteration of Conway (1986).
    """
    dt = np.asarray(dt_s, float)
    r0, sigma, root = float(np.linalg.norm(r_m)), float(r_m @ v_m_s) / np.sqrt(mu_m3_s2), np.sqrt(mu_m3_s2)
    alpha = 2.0 / r0 - float(v_m_s @ v_m_s) / mu_m3_s2
    if alpha > 0.0:
        # Whole turns change nothing, and cost digits.
        period = 2.0 * np.pi / (root * alpha**1.5)
        dt = dt - period * np.round(dt / period)
    chi = root * dt / r0 if alpha <= 0.0 else root * dt * alpha
    if alpha < 0.0:
        # Far out on a hyperbola the linear guess overshoots exponentially.
        most = np.arcsinh(1.0 + root * np.abs(dt) * (-alpha)**1.5) / np.sqrt(-alpha) * 2.0
        chi = np.clip(chi, -most, most)
    for _ in range(_ITERATIONS):
        c, s = _stumpff(alpha * chi * chi)
        f = sigma * chi**2 * c + (1.0 - alpha * r0) * chi**3 * s + r0 * chi - root * dt
        slope = chi**2 * c + sigma * chi * (1.0 - alpha * chi**2 * s) + r0 * (1.0 - alpha * chi**2 * c)
        curve = sigma * (1.0 - alpha * chi**2 * c) + (1.0 - alpha * r0) * chi * (1.0 - alpha * chi**2 * s)
        step = 5.0 * f / (slope + np.copysign(np.sqrt(np.abs(16.0 * slope**2 - 20.0 * f * curve)), slope))
        chi = chi - step
        if not (np.abs(step) > 1e-15 * (np.abs(chi) + np.sqrt(r0))).any():
            break
    c, s = _stumpff(alpha * chi * chi)
    f, g = 1.0 - chi**2 / r0 * c, dt - chi**3 / root * s
    r = f[:, None] * r_m + g[:, None] * v_m_s
    range_m = np.linalg.norm(r, axis=1)
    f_dot, g_dot = root / (range_m * r0) * chi * (alpha * chi**2 * s - 1.0), 1.0 - chi**2 / range_m * c
    return r, f_dot[:, None] * r_m + g_dot[:, None] * v_m_s


def _stumpff(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Stumpff's C and S: (1 - cos sqrt z) / z and (sqrt z - sin sqrt z) / sqrt(z)^3."""
    small = np.where(np.abs(z) < 1.0, z, 0.0)
    c_series, s_series = np.zeros_like(small), np.zeros_like(small)
    # The eleventh term is below 1e-22 where |z| < 1; Horner, from the last one.
    for k in range(10, -1, -1):
        c_series = (1.0 - c_series * small / ((2 * k + 3) * (2 * k + 4)))
        s_series = (1.0 - s_series * small / ((2 * k + 4) * (2 * k + 5)))
    w = np.sqrt(np.maximum(np.abs(z), 1.0))
    # cosh of more overflows; no orbit gets there.
    h = np.minimum(w, 700.0)
    c = np.where(z > 0.0, 2.0 * np.sin(0.5 * w)**2, 2.0 * np.sinh(0.5 * h)**2) / w**2
    s = np.where(z > 0.0, w - np.sin(w), np.sinh(h) - h) / w**3
    is_small = np.abs(z) < 1.0
    return np.where(is_small, c_series / 2.0, c), np.where(is_small, s_series / 6.0, s)


def _perifocal_axes(inclination_deg: float, longitude_ascending_node_deg: float, argument_of_periapsis_deg: float,
                    frame: str) -> np.ndarray:
    """(3, 3), as columns in ICRF: to the periapsis, along the motion there, the orbit's normal."""
    angles = [np.radians(angle_deg(name, value)) for name, value in (
        ("argument_of_periapsis_deg", argument_of_periapsis_deg), ("inclination_deg", inclination_deg),
        ("longitude_ascending_node_deg", longitude_ascending_node_deg))]
    axes = Rotation.from_euler("zxz", angles).as_matrix()
    if one_of("frame", frame, ("ecliptic", "equatorial")) == "ecliptic":
        return EQUATORIAL_FROM_ECLIPTIC @ axes
    return axes


def _true_anomaly(mean_anomaly: float, e: float) -> tuple[float, float]:
    """Cosine and sine of the true anomaly, of Kepler's equation."""
    if e < 1.0:
        m = np.remainder(mean_anomaly + np.pi, 2.0 * np.pi) - np.pi
        x = brentq(lambda x: x - e * np.sin(x) - m, m - 1.1 * e - 1e-9, m + 1.1 * e + 1e-9, xtol=1e-15)
        scale = 1.0 - e * np.cos(x)
        return (np.cos(x) - e) / scale, np.sqrt(1.0 - e * e) * np.sin(x) / scale
    end = np.arcsinh(abs(mean_anomaly) / (e - 1.0)) + 1e-9
    x = brentq(lambda x: e * np.sinh(x) - x - mean_anomaly, -end, end, xtol=1e-15)
    scale = e * np.cosh(x) - 1.0
    return (e - np.cosh(x)) / scale, np.sqrt(e * e - 1.0) * np.sinh(x) / scale


def _beyond_sun(name: str, about: str, value: Any, size_m: float) -> None:
    """Refuse a place or an axis within the Sun: it is in another unit."""
    if about == "sun" and not size_m > SUN_RADIUS_M:
        raise ConfigError(name, f"must be more than the Sun's radius, {SUN_RADIUS_M:g} m",
                          np.asarray(value).tolist(), way_out("orbit about the Sun", name, value))


def _checked_gm(about: str, value: float | None) -> float:
    if value is None:
        if about != "sun":
            raise ConfigError("gravitational_parameter_m3_s2", "missing", hint=f"of {about!r}: only the Sun's is known")
        return GM_SUN_M3_S2
    return gm("gravitational_parameter_m3_s2", value)
