"""Rigid-body dynamics against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from glrender import ConfigError
from glrender.scenario import Epoch, GravityGradient, Kepler, RigidBody
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
