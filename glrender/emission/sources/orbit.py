"""Dust under the Sun's gravity less its radiation pressure: where a grain of ratio beta is a time after it left."""

from __future__ import annotations

import math

import numpy as np

from ...base.errors import ConfigError

SUN_GM_M3_S2 = 1.327_124_400_18e20
"""Heliocentric gravitational constant [m3/s2]; IAU 2009 system."""
_ITERATIONS = 60


def stumpff(z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """c0..c3 of z: 1 - z/2 + ..., 1 - z/6 + ..., 1/2 - z/24 + ..., 1/6 - z/120 + ...; cos, sin or their hyperbolics.

    Source: Danby (1992), Fundamentals of Celestial Mechanics, section 6.9.
    """
    z = np.asarray(z, np.float64)
    root = np.sqrt(np.abs(z))
    near = np.abs(z) < 0.01
    safe = np.where(near, 1.0, z)
    safe_root = np.where(near, 1.0, root)
    c0 = np.where(z >= 0.0, np.cos(root), np.cosh(np.minimum(root, 700.0)))
    c1 = np.where(z >= 0.0, np.sin(safe_root), np.sinh(np.minimum(safe_root, 700.0))) / safe_root
    c2, c3 = (1.0 - c0) / safe, (1.0 - c1) / safe
    # Within 0.01 the differences cancel; five terms are exact to 1e-16.
    series = lambda k: sum((-z) ** n / math.factorial(2 * n + k) for n in range(6))  # noqa: E731
    return tuple(np.where(near, series(k), c) for k, c in enumerate((c0, c1, c2, c3)))


def propagate(r_m: np.ndarray, v_m_s: np.ndarray, gm_m3_s2: np.ndarray,
              time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Kepler's problem for an attracting, absent or repelling centre, forward or back.

    Parameters
    ----------
    r_m, v_m_s : (N, 3) float64
    gm_m3_s2 : (N,) float64 [m3/s2]
        Of either sign: (1 - beta) GM.
    time_s : (N,) float64 [s]

    Returns
    -------
    (N, 3) position [m] and (N, 3) velocity [m/s].

    Source: universal variable s, dt = r ds (Stiefel and Scheifele 1971); G_k = s^k c_k(alpha s^2) with
    alpha = 2 GM / r - v^2: nothing is divided by GM.
    """
    r0 = np.linalg.norm(r_m, axis=1)
    eta = np.einsum("ij,ij->i", r_m, v_m_s)
    alpha = 2.0 * gm_m3_s2 / r0 - np.einsum("ij,ij->i", v_m_s, v_m_s)
    # Time grows with s everywhere (dt/ds = r > 0): Newton within a bracket that doubles until it holds the root.
    low, high = np.zeros(len(r0)), time_s / r0
    for _ in range(_ITERATIONS):
        beyond = np.abs(_time(high, r0, eta, alpha, gm_m3_s2)) >= np.abs(time_s)
        if beyond.all():
            break
        low, high = np.where(beyond, low, high), np.where(beyond, high, 2.0 * high)
    s = 0.5 * (low + high)
    for _ in range(_ITERATIONS):
        missing = time_s - _time(s, r0, eta, alpha, gm_m3_s2)
        is_short = missing * np.sign(time_s) > 0.0
        low, high = np.where(is_short, s, low), np.where(is_short, high, s)
        step = s + missing / _radius(s, r0, eta, alpha, gm_m3_s2)
        inside = (step - low) * (step - high) <= 0.0
        new = np.where(inside, step, 0.5 * (low + high))
        # One more step from 1e-9 squares that: below round-off.
        is_found = np.all(np.abs(new - s) <= 1e-9 * np.abs(new))
        s = new
        if is_found:
            break
    g0, g1, g2, g3 = _g(s, alpha)
    r = r0 * g0 + eta * g1 + gm_m3_s2 * g2
    f, g = 1.0 - gm_m3_s2 / r0 * g2, r0 * g1 + eta * g2
    f_dot, g_dot = -gm_m3_s2 / (r * r0) * g1, 1.0 - gm_m3_s2 / r * g2
    return (f[:, None] * r_m + g[:, None] * v_m_s, f_dot[:, None] * r_m + g_dot[:, None] * v_m_s)


def _g(s: np.ndarray, alpha: np.ndarray) -> tuple[np.ndarray, ...]:
    c = stumpff(alpha * s**2)
    return tuple(s**k * c[k] for k in range(4))


def _time(s, r0, eta, alpha, gm):
    _, g1, g2, g3 = _g(s, alpha)
    return r0 * g1 + eta * g2 + gm * g3


def _radius(s, r0, eta, alpha, gm):
    g0, g1, g2, _ = _g(s, alpha)
    return np.maximum(r0 * g0 + eta * g1 + gm * g2, 1e-9 * r0)


def comet_state(perihelion_m: float, eccentricity: float, true_anomaly_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,) [m] and velocity (3,) [m/s] in the orbit's plane: x to the perihelion, z along the pole."""
    if eccentricity > 1.0 and not 1.0 + eccentricity * math.cos(true_anomaly_rad) > 0.0:
        raise ConfigError("true_anomaly_deg", "is beyond the hyperbola's asymptote", math.degrees(true_anomaly_rad))
    parameter = perihelion_m * (1.0 + eccentricity)
    r = parameter / (1.0 + eccentricity * math.cos(true_anomaly_rad))
    c, s = math.cos(true_anomaly_rad), math.sin(true_anomaly_rad)
    speed = math.sqrt(SUN_GM_M3_S2 / parameter)
    return r * np.array([c, s, 0.0]), speed * np.array([-s, eccentricity + c, 0.0])
