"""Predictions keep to their orbits, whatever the step: Kepler's closed form, and trajectories in fine steps."""

from __future__ import annotations

import numpy as np
import pytest
from glrender_navigation import Navigator
from glrender_navigation.motion import carried
from scipy.optimize import brentq
from scipy.stats import chi2

# gravity [m3/s2], distance at the nearest point [m], eccentricity, span [s]
ORBITS = {"Didymos": (35.4, 1.2e3, 0.0, 7200.0), "Eros": (4.46e5, 35e3, 0.3, 36e3), "Phobos": (7.1e5, 20e3, 0.9, 36e3),
          "Vesta": (1.73e10, 475e3, 0.0, 7200.0), "flyby": (4.46e5, 35e3, 1.6, 36e3)}


def kepler(motion, t_s, gm):
    """Place and velocity (6,) after a time by universal variables (Vallado, Algorithm 8) and Brent's root."""
    r, v = motion[:3], motion[3:]
    distance, alpha = np.linalg.norm(r), 2.0 / np.linalg.norm(r) - v @ v / gm

    def stumpff(chi):
        psi = alpha * chi * chi
        root = np.sqrt(abs(psi))
        if psi > 1e-6:
            return (1.0 - np.cos(root)) / psi, (root - np.sin(root)) / root**3
        if psi < -1e-6:
            return (1.0 - np.cosh(root)) / psi, (np.sinh(root) - root) / root**3
        return 0.5 - psi / 24.0, 1.0 / 6.0 - psi / 120.0

    def off(chi):
        c, s = stumpff(chi)
        return (r @ v / gm**0.5 * chi**2 * c + (1.0 - alpha * distance) * chi**3 * s + distance * chi) / gm**0.5 - t_s

    most = 1e-3 * distance**0.5
    while off(most) < 0.0:
        most *= 2.0
    chi = brentq(off, 0.0, most, xtol=1e-15 * most, rtol=8.9e-16)
    c, s = stumpff(chi)
    f, g = 1.0 - chi**2 / distance * c, t_s - chi**3 / gm**0.5 * s
    end = f * r + g * v
    far = np.linalg.norm(end)
    of_r = gm**0.5 / (far * distance) * chi * (alpha * chi**2 * s - 1.0)
    return np.concatenate([end, of_r * r + (1.0 - chi**2 / far * c) * v])


def begun(gm, nearest_m, eccentricity):
    """A motion at its nearest point, of an orbit inclined to all axes."""
    axes = np.linalg.qr(np.array([[1.0, 2.0, 0.5], [-1.0, 1.0, 2.0], [0.3, 1.0, -1.0]]))[0]
    return np.concatenate([nearest_m * axes[0], np.sqrt(gm * (1.0 + eccentricity) / nearest_m) * axes[1]])


@pytest.mark.parametrize("name", ORBITS)
@pytest.mark.parametrize("n_steps", [1, 7, 120])
def test_a_prediction_keeps_to_its_orbit(name, n_steps):
    """Two to ten hours, in one step or in 120: within 1e-8 of the distance and of the velocity."""
    gm, nearest_m, eccentricity, span_s = ORBITS[name]
    begin = begun(gm, nearest_m, eccentricity)
    navigator = Navigator(begin[:3], begin[3:], sigma_r_m=1.0, sigma_v_m_s=1e-3, gm_m3_s2=gm)
    for _ in range(n_steps):
        navigator.predict([0.0] * 3, span_s / n_steps)
    truth = kepler(begin, span_s, gm)
    assert np.linalg.norm(navigator.r_m - truth[:3]) < 1e-8 * nearest_m
    assert np.linalg.norm(navigator.v_m_s - truth[3:]) < 1e-8 * np.linalg.norm(begin[3:])


@pytest.mark.parametrize("name", ORBITS)
def test_the_transition_matrix_is_the_orbits_own(name):
    """Against central differences of Kepler's closed form over the whole span, to 1e-5 of each block's largest."""
    gm, nearest_m, eccentricity, span_s = ORBITS[name]
    begin = begun(gm, nearest_m, eccentricity)
    found = carried(begin, np.zeros(3), span_s, gm).transition
    small = np.repeat([1e-6 * nearest_m, 1e-6 * np.linalg.norm(begin[3:])], 3)
    ends = [[kepler(begin + sign * step, span_s, gm) for sign in (-1.0, 1.0)] for step in np.diag(small)]
    expected = np.diff(ends, axis=1)[:, 0].T / (2.0 * small)
    for rows in (slice(3), slice(3, 6)):
        for columns in (slice(3), slice(3, 6)):
            block = expected[rows, columns]
            np.testing.assert_allclose(found[rows, columns], block, rtol=0.0, atol=1e-5 * np.abs(block).max())


def in_fine_steps(motion, acceleration, step_s, gm, n=2000):
    """Motions (N, 6) after a step, each with its acceleration (N, 3), by leapfrog."""
    r, v, dt = motion[:, :3].copy(), motion[:, 3:].copy(), step_s / n
    for _ in range(n):
        r += 0.5 * dt * v
        v += dt * (acceleration - gm * r / np.linalg.norm(r, axis=1, keepdims=True)**3)
        r += 0.5 * dt * v
    return np.hstack([r, v])


def test_an_acceleration_over_a_step_bends_the_orbit():
    """A tenth of gravity for a sixth of an orbit: place, and its slope by the acceleration, against 2000 leaps."""
    gm, step_s = 7.1e5, 3600.0
    begin, pushed = begun(gm, 20e3, 0.2), gm / 20e3**2 * 0.1 * np.array([0.3, -0.8, 0.5])
    found = carried(begin, pushed, step_s, gm)
    many = pushed + np.vstack([np.zeros((1, 3)), 1e-7 * np.eye(3), -1e-7 * np.eye(3)])
    ends = in_fine_steps(np.tile(begin, (7, 1)), many, step_s, gm)
    np.testing.assert_allclose(found.motion, ends[0], rtol=1e-5)
    np.testing.assert_allclose(found.gain, (ends[1:4] - ends[4:]).T / 2e-7, rtol=0.0, atol=1e-4 * step_s**2)
    # Without gravity half the square of the step, and the step.
    free = carried(begin, pushed, step_s, 0.0)
    np.testing.assert_allclose(free.gain, np.vstack([0.5 * step_s**2 * np.eye(3), step_s * np.eye(3)]), atol=1e-6)
    np.testing.assert_allclose(free.motion[3:], begin[3:] + step_s * pushed, rtol=1e-12)


@pytest.mark.parametrize("name, step_s", [("Eros", 600.0), ("Phobos", 3600.0), ("Vesta", 1800.0), ("flyby", 3600.0)])
def test_errors_stay_those_of_the_covariance_in_long_steps(name, step_s):
    """200 flights without measurements, six steps each: NEES of place and velocity within 99.8 % of chi-square."""
    gm, nearest_m, eccentricity, _ = ORBITS[name]
    rng, n = np.random.default_rng(8), 200
    begin, speed = begun(gm, nearest_m, eccentricity), np.sqrt(gm / nearest_m)
    sigma_r_m, sigma_v_m_s, process = 1e-4 * nearest_m, 1e-4 * speed, 1e-5 * gm / nearest_m**2
    first = begin + rng.standard_normal((n, 6)) * np.repeat([sigma_r_m, sigma_v_m_s], 3)
    navigator = Navigator(begin[:3], begin[3:], sigma_r_m=sigma_r_m, sigma_v_m_s=sigma_v_m_s, gm_m3_s2=gm,
                          process_acceleration_m_s2=process)
    truth = first
    for _ in range(6):
        navigator.predict([0.0] * 3, step_s)
        truth = in_fine_steps(truth, process * rng.standard_normal((n, 3)), step_s, gm)
    error = truth - np.concatenate([navigator.r_m, navigator.v_m_s])
    nees = np.einsum("ij,ij->i", error, np.linalg.solve(navigator.covariance, error.T).T)
    low, high = chi2.ppf([0.001, 0.999], 6 * n) / n
    assert low < nees.mean() < high


@pytest.mark.parametrize("begin, step_s", [
    ([1e3, 0.0, 0.0, 0.0, 0.0, 0.0], 1e5), ([1e3, 0.0, 0.0, -5.0, 0.0, 0.0], 1e3),
    ([1e3, 0.0, 0.0, 0.0, 0.18, 0.0], 1e9)])
def test_a_step_that_no_orbit_leads_through_is_refused(begin, step_s):
    """A fall into the centre, slow or fast, and 28,000 orbits: the estimate stays, and shorter steps go on."""
    navigator = Navigator(begin[:3], begin[3:], sigma_r_m=1.0, sigma_v_m_s=1e-3, gm_m3_s2=35.4)
    with pytest.raises(ValueError, match="^step_s: must not lead through the body's centre, .*, got .*; take"):
        navigator.predict([0.0] * 3, step_s)
    np.testing.assert_array_equal(navigator.r_m, begin[:3])
    np.testing.assert_array_equal(np.diag(navigator.covariance), [1.0] * 3 + [1e-6] * 3)
    navigator.predict([0.0] * 3, 0.0)
    np.testing.assert_array_equal(navigator.r_m, begin[:3])
    navigator.predict([0.0] * 3, 10.0)
    assert not np.array_equal(navigator.v_m_s, begin[3:])
