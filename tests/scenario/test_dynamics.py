"""Rigid-body dynamics against closed forms."""

from __future__ import annotations

import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from glrender import ConfigError
from glrender.scenario import Epoch, GravityGradient, Kepler, RigidBody, Thruster
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scipy.special import ellipj


def axes_of(q):
    """Rotations of components in the frame to components in inertial."""
    return Rotation.from_quat(q, scalar_first=True).inv()


def test_eulers_symmetric_top():
    """Its spin axis goes round the angular momentum at L / I1, and the rate round it at (1 - I3 / I1) w3."""
    i1, i3, w = 2.0, 3.1, np.array([0.03, 0.0, 0.2])
    t = np.linspace(-300.0, 900.0, 61)
    q, rates = RigidBody(inertia_kg_m2=[i1, i1, i3], angular_velocity_rad_s=w).motion(t)
    lam = (i3 / i1 - 1.0) * w[2]
    np.testing.assert_allclose(rates, np.stack([w[0] * np.cos(lam * t), w[0] * np.sin(lam * t), w[2] + 0 * t], axis=1),
                               atol=1e-9)
    momentum = np.array([i1 * w[0], 0.0, i3 * w[2]])
    axis = axes_of(q).apply([0.0, 0.0, 1.0])
    expected = Rotation.from_rotvec(t[:, None] * momentum / i1).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(axis, expected, atol=1e-8)


def test_a_free_asymmetric_top_is_jacobis():
    """Rates by Jacobi's elliptic functions; energy and angular momentum, in inertial axes, are kept to 1e-9."""
    inertia = np.array([1.0, 2.0, 2.6])
    begin = np.array([0.0, 0.05, 0.2])
    t = np.linspace(0.0, 600.0, 121)
    q, rates = RigidBody(inertia_kg_m2=inertia, angular_velocity_rad_s=begin, rtol=1e-12).motion(t)
    momentum = axes_of(q).apply(rates * inertia)
    np.testing.assert_allclose(momentum, np.tile(momentum[0], (len(t), 1)), atol=1e-9)
    np.testing.assert_allclose((inertia * rates**2).sum(axis=1), inertia @ begin**2, rtol=1e-9)
    # Landau and Lifshitz, Mechanics, section 37, of I1 < I2 < I3 and L^2 > 2 E I2; at t = 0 the rate about 1 is 0.
    energy2, l2 = inertia @ begin**2, (inertia * begin) @ (inertia * begin)
    i1, i2, i3 = inertia
    rate = np.sqrt((i3 - i2) * (l2 - energy2 * i1) / (i1 * i2 * i3))
    modulus = (i2 - i1) * (energy2 * i3 - l2) / ((i3 - i2) * (l2 - energy2 * i1))
    quarter = brentq(lambda x: ellipj(x, modulus)[1], 1.0, 3.0)
    sn, cn, dn, _ = ellipj(rate * t - quarter, modulus)
    top = np.sqrt([(energy2 * i3 - l2) / (i1 * (i3 - i1)), (energy2 * i3 - l2) / (i2 * (i3 - i2)),
                   (l2 - energy2 * i1) / (i3 * (i3 - i1))])
    closed = np.abs(np.stack([top[0] * cn, top[1] * sn, top[2] * dn], axis=1))
    np.testing.assert_allclose(np.abs(rates), closed, atol=1e-8)


def test_small_librations_have_their_period():
    """Pitch of a satellite in a circular orbit: 2 pi / (n sqrt(3 (Iy - Ix) / Iz)); Wertz (1978), section 18.3."""
    mu, radius = 666.0, 10e3
    n = np.sqrt(mu / radius**3)
    inertia = np.array([1.0, 3.0, 3.5])
    orbit = Kepler(r_m=[radius, 0.0, 0.0], v_m_s=[0.0, n * radius, 0.0], epoch=Epoch(0), about="b",
                   gravitational_parameter_m3_s2=mu)
    torque = GravityGradient(inertia_kg_m2=inertia, gravitational_parameter_m3_s2=mu, trajectory=orbit, start=Epoch(0))
    pitch = 1e-3
    body = RigidBody(inertia_kg_m2=inertia, angular_velocity_rad_s=[0.0, 0.0, n], torques=[torque],
                     q_from_inertial=Rotation.from_rotvec([0.0, 0.0, -pitch]).as_quat(scalar_first=True))
    period = 2.0 * np.pi / (n * np.sqrt(3.0 * (inertia[1] - inertia[0]) / inertia[2]))
    t = period * np.linspace(0.0, 3.0, 301)
    q, _ = body.motion(t)
    # X of the frame in the axes that turn with the orbit: its angle swings as a cosine.
    x = Rotation.from_rotvec(-n * t[:, None] * [0.0, 0.0, 1.0]).apply(axes_of(q).apply([1.0, 0.0, 0.0]))
    expected = pitch * np.cos(2.0 * np.pi * t / period)
    np.testing.assert_allclose(np.arctan2(x[:, 1], x[:, 0]), expected, atol=1e-5 * pitch)


def test_a_torque_and_a_wheel():
    """A constant torque about an axis gives t^2 / 2; a wheel's momentum makes a slow body nutate at H / I."""
    inertia, torque, t = 4.0, 1e-3, np.linspace(0.0, 50.0, 11)
    q, rates = RigidBody(inertia_kg_m2=[4.0, 4.0, inertia], angular_velocity_rad_s=[0.0, 0.0, 0.0],
                         torques=[lambda t, q, w: np.array([0.0, 0.0, torque])]).motion(t)
    np.testing.assert_allclose(rates[:, 2], torque / inertia * t, atol=1e-12)
    np.testing.assert_allclose(axes_of(q).as_rotvec()[:, 2], 0.5 * torque / inertia * t**2, atol=1e-9)
    _, rates = RigidBody(inertia_kg_m2=[4.0, 4.0, 4.0], angular_velocity_rad_s=[1e-3, 0.0, 0.0],
                         wheel_momentum_N_m_s=[0.0, 0.0, 2.0]).motion(t)
    np.testing.assert_allclose(rates[:, 0], 1e-3 * np.cos(0.5 * t), atol=1e-10)


def test_a_torque_that_is_no_torque_is_refused():
    body = RigidBody(inertia_kg_m2=[1.0, 1.0, 1.0], angular_velocity_rad_s=[0.0, 0.0, 0.0],
                     torques=[lambda t, q, w: [0.0, np.nan, 0.0]])
    with pytest.raises(ConfigError, match="torques: must be finite"):
        body.motion([1.0])


# Times that are asked for one after the other


class Counted:
    """A torque about Z that counts how often it is asked for, and is not known beyond a time [s]."""

    def __init__(self, known_s=np.inf):
        self.calls, self.known_s = 0, known_s

    def __call__(self, t_s, q, omega):
        assert abs(t_s) <= self.known_s
        self.calls += 1
        return np.array([0.0, 0.0, 1e-4 * np.sin(0.01 * t_s)])


class Kicks:
    times_s = np.array([-70.0, -3.0, 5.0, 40.0, 40.5, 150.0])

    def impulse(self, index, q_from_inertial):
        return np.array([0.0, 1e-3 * (index + 1.0), 0.0])


PULSES = Thruster(force_N=[0.0, 1e-3, 0.0], place_m=[1.0, 0.0, 0.0], pulses_s=[[-20.0, -10.0], [39.0, 40.2]])
TUMBLING = RigidBody(inertia_kg_m2=[1.0, 2.0, 2.6], angular_velocity_rad_s=[0.1, 0.05, 0.2])


def test_a_frame_far_from_the_start_is_not_integrated_from_there():
    """As an exposure does after a sequence: its times cost a twentieth of what the whole way does."""
    torque = Counted()
    body = replace(TUMBLING, torques=[torque])
    for sign in (1.0, -1.0):
        before = torque.calls
        body.motion(sign * np.linspace(0.0, 2500.0, 9))
        whole, before = torque.calls - before, torque.calls
        body.motion(sign * (2499.0 + np.linspace(-0.5, 0.5, 21)))
        assert 0 < torque.calls - before < 0.05 * whole


def test_what_is_found_does_not_depend_on_what_was_asked_for_before():
    """To the bit, in any order, from threads and in a process; torques that jump and impulses among the times."""
    body = replace(TUMBLING, torques=[PULSES], impulses=[Kicks()])
    calls = [np.array(times) for times in ([280.0], [3.0, 270.0], [-90.0, 39.5, 41.0], [0.1], [40.0], [40.25],
                                           [150.0, 150.1], [-15.0, 0.0, 5.0], [77.7])]
    alone = [replace(body).motion(times) for times in calls]
    again = pickle.loads(pickle.dumps(body))
    for other in (body, again):
        for index in (*range(len(calls)), *reversed(range(len(calls)))):
            for one, two in zip(other.motion(calls[index]), alone[index], strict=True):
                np.testing.assert_array_equal(one, two)
    shared = replace(body)
    with ThreadPoolExecutor(4) as threads:
        for found, expected in zip(threads.map(shared.motion, calls * 2), alone * 2, strict=True):
            np.testing.assert_array_equal(found[0], expected[0])
    # And as one integration from the start has it.
    q, rates = replace(body).motion(np.concatenate(calls))
    np.testing.assert_allclose(q, np.concatenate([each[0] for each in alone]), atol=1e-8)
    np.testing.assert_allclose(rates, np.concatenate([each[1] for each in alone]), atol=1e-9)


@pytest.mark.parametrize("last", [0.1, 12.3, 1234.5])
def test_a_torque_is_not_asked_for_beyond_the_last_time(last):
    """A trajectory of a table ends with the scenario."""
    body = replace(TUMBLING, torques=[Counted(last)])
    for times in ([0.5 * last], [last], [-last, last], np.linspace(-last, last, 7)):
        body.motion(np.array(times))


def test_impulses_add_to_the_momentum_at_their_times():
    """Without torques its components in inertial axes jump by the impulse alone, and not at its very time."""
    body = replace(TUMBLING, impulses=[Kicks()])
    t = np.array([4.0, 5.0, 5.0 + 1e-9, 39.0, 40.0, 40.0 + 1e-9])
    q, rates = body.motion(t)
    momentum = axes_of(q).apply(rates * [1.0, 2.0, 2.6])
    jump = axes_of(q[[1, 4]]).apply([[0.0, 3e-3, 0.0], [0.0, 4e-3, 0.0]])
    still = np.zeros(3)
    np.testing.assert_allclose(np.diff(momentum, axis=0), [still, jump[0], still, still, jump[1]], atol=1e-8)
