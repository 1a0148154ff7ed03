"""Drag, dust, thrusters and wheels against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from glrender import ConfigError
from glrender.scenario import (
    AtRest,
    DustImpacts,
    GasDrag,
    OfFunction,
    Plate,
    RigidBody,
    Thruster,
    Wheels,
    scenario_of_table,
)
from scipy.spatial.transform import Rotation
from scipy.special import ellipk

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
AT_REST = AtRest(r_m=[0.0, 0.0, 2e4], about="comet")
COMA = {"trajectory": AT_REST, "density_kg_m3": 4e-9, "reference_distance_m": 1e4, "outflow_speed_m_s": 800.0}


def axes_of(q):
    return Rotation.from_quat(q, scalar_first=True).inv()


def test_drag_of_a_sphere_and_of_plates():
    """1/2 rho v^2 C_D A along the flow, rho by 1/r^2: 1e-9 at twice the distance; a cube's faces by their cosines."""
    force = 0.5 * 1e-9 * 800.0**2 * 2.0 * 3.0
    drag = GasDrag(**COMA, area_m2=3.0, drag_coefficient=2.0, centre_of_pressure_m=[0.5, 0.0, 0.1])
    np.testing.assert_allclose(drag(0.0, IDENTITY, np.zeros(3)), [0.0, -0.5 * force, 0.0], rtol=1e-14)
    # The flow comes along the frame's -Z + X after a turn by 45 deg about Y.
    turned = Rotation.from_euler("y", 45.0, degrees=True)
    q = turned.inv().as_quat(scalar_first=True)
    faces = [Plate(area_m2=3.0, normal=sign * np.eye(3)[k], centre_m=sign * np.eye(3)[k]) for k in range(3)
             for sign in (-1.0, 1.0)]
    of_plates = GasDrag(**COMA, plates=faces, drag_coefficient=2.0)
    flow = turned.inv().apply([0.0, 0.0, 1.0])
    total = sum(f for _, f in of_plates.forces(0.0, q))
    np.testing.assert_allclose(total, 2.0 * np.sqrt(0.5) * force * flow, rtol=1e-14)
    np.testing.assert_allclose(of_plates(0.0, q, np.zeros(3)), np.zeros(3), atol=1e-20)
    one = GasDrag(**COMA, plates=[Plate(area_m2=3.0, normal=[0, 0, -2.0], centre_m=[0.0, 0.7, 0.0])],
                  drag_coefficient=2.0)
    np.testing.assert_allclose(one(0.0, IDENTITY, np.zeros(3)), [0.7 * force, 0.0, 0.0], rtol=1e-14)
    away = GasDrag(**COMA, plates=[Plate(area_m2=3.0, normal=[0, 0, 1.0], centre_m=[0.0, 0.7, 0.0])])
    assert not away(0.0, IDENTITY, np.zeros(3)).any()


def test_drag_sees_the_velocity_and_functions_of_the_place():
    """A spacecraft that flies with the gas feels nothing; functions of density and velocity are used as they are."""
    with_it = OfFunction(function=lambda t: ([0.0, 0.0, 2e4 + 800.0 * t], [0.0, 0.0, 800.0]), about="comet")
    drag = GasDrag(**COMA | {"trajectory": with_it}, area_m2=3.0, centre_of_pressure_m=[1.0, 0.0, 0.0])
    np.testing.assert_allclose(drag(5.0, IDENTITY, np.zeros(3)), np.zeros(3), atol=1e-25)
    drag = GasDrag(trajectory=AT_REST, density_kg_m3=lambda r: 1e-5 / r[2], area_m2=2.0, drag_coefficient=1.0,
                   outflow_speed_m_s=lambda r: [100.0, 0.0, 0.0], centre_of_pressure_m=[0.0, 1.0, 0.0])
    np.testing.assert_allclose(drag(0.0, IDENTITY, np.zeros(3)), [0.0, 0.0, -0.5 * 5e-10 * 1e4 * 2.0], rtol=1e-14)


def test_drag_swings_a_body_as_a_pendulum():
    """A centre of pressure behind: I theta'' = - F d sin theta, with the period of 60 deg by the elliptic integral."""
    drag = GasDrag(**COMA, area_m2=3.0, drag_coefficient=2.0, centre_of_pressure_m=[0.0, 0.0, 0.5])
    pull, inertia, amplitude = 0.5 * 0.5 * 1e-9 * 800.0**2 * 6.0, 4.0, np.radians(60.0)
    period = 4.0 * np.sqrt(inertia / pull) * ellipk(np.sin(amplitude / 2.0)**2)
    body = RigidBody(inertia_kg_m2=[4.0, 4.0, 3.0], angular_velocity_rad_s=[0.0, 0.0, 0.0], torques=[drag],
                     q_from_inertial=Rotation.from_rotvec([-amplitude, 0.0, 0.0]).as_quat(scalar_first=True))
    q, _ = body.motion(period * np.array([0.0, 0.25, 0.5, 1.0]))
    angle = axes_of(q).as_rotvec()[:, 0]
    np.testing.assert_allclose(angle, amplitude * np.array([1.0, 0.0, -1.0, 1.0]), atol=1e-8)


def dust(seed, **changes):
    return DustImpacts(**{"trajectory": AT_REST, "rate_hz": 0.5, "grain_mass_kg": 1e-6, "outflow_speed_m_s": 50.0,
                          "radius_m": 2.0, "centre_m": [0.3, 0.0, 0.0], "duration_s": 100.0, "seed": seed, **changes})


def test_dust_has_the_mean_and_variance_of_shot_noise():
    """Campbell: n (c x p), and n p^2 (R^2 / 4 + c^2) about the axis of c x p; 4000 seeds, five standard errors."""
    sums = []
    for seed in range(4000):
        hits = dust(seed)
        sums.append(hits.impulses(np.arange(len(hits.times_s)), IDENTITY).sum(axis=0))
    sums, count, momentum = np.array(sums), 50.0, 1e-6 * 50.0
    variance = count * momentum**2 * np.array([2.0**2 / 4.0, 2.0**2 / 4.0 + 0.3**2, 0.0])
    error = np.sqrt(variance / len(sums))
    np.testing.assert_allclose(sums.mean(axis=0), [0.0, -count * 0.3 * momentum, 0.0], atol=5.0 * error.max())
    np.testing.assert_allclose(sums.var(axis=0)[:2], variance[:2], rtol=5.0 * np.sqrt(2.0 / len(sums)))
    np.testing.assert_allclose(sums[:, 2], 0.0, atol=1e-18)


def test_dust_arrives_as_poisson_has_it():
    """Counts of mean and variance 50, gaps of mean 2 s; the same seed gives the same impacts, another others."""
    counts = np.array([len(dust(seed).times_s) for seed in range(2000)])
    np.testing.assert_allclose([counts.mean(), counts.var()], 50.0, rtol=0.17)
    np.testing.assert_allclose(counts.mean(), 50.0, atol=5.0 * np.sqrt(50.0 / 2000))
    gaps = np.diff(dust(3, duration_s=1e5).times_s)
    np.testing.assert_allclose([gaps.mean(), gaps.std()], 2.0, rtol=0.05)
    one, same, other = dust(7), dust(7), dust(8)
    np.testing.assert_array_equal(one.times_s, same.times_s)
    np.testing.assert_array_equal(one.impulse(0, IDENTITY), same.impulse(0, IDENTITY))
    assert len(other.times_s) != len(one.times_s) or (other.times_s != one.times_s).all()


def test_impacts_change_the_angular_momentum_by_their_sum():
    """In inertial axes, of a tumbling body, and back again from the end; the same seed gives the same attitude."""
    inertia, hits = np.array([2.0, 3.0, 4.0]), dust(11, grain_mass_kg=1e-3)
    body = RigidBody(inertia_kg_m2=inertia, angular_velocity_rad_s=[0.01, 0.02, 0.03], impulses=[hits])
    t = np.concatenate([[0.0], hits.times_s, [100.0]])
    q, rates = body.motion(t)
    momentum = axes_of(q).apply(rates * inertia)
    before = np.arange(1, len(hits.times_s) + 1)
    gained = np.array([axes_of(q[k]).apply(hits.impulse(k - 1, q[k])) for k in before])
    # At the time of an impact the state is that before it.
    np.testing.assert_allclose(np.diff(momentum, axis=0)[1:], gained, atol=1e-11)
    assert np.linalg.norm(gained.sum(axis=0)) > 1e-3
    np.testing.assert_array_equal(body.motion(t)[0], q)
    again = RigidBody(inertia_kg_m2=inertia, angular_velocity_rad_s=[0.01, 0.02, 0.03],
                      impulses=[dust(11, grain_mass_kg=1e-3)])
    np.testing.assert_array_equal(again.motion(t)[0], q)


def test_pulses_of_a_thruster_are_not_missed():
    """10 ms of 2 N at 0.5 m in an hour: 0.01 N m s, whatever the steps; the torque is off on both sides."""
    thruster = Thruster(force_N=[0.0, 2.0, 0.0], place_m=[0.5, 0.0, 0.0],
                        pulses_s=[[1800.0, 1800.01], [2000.0, 2001.0]])
    body = RigidBody(inertia_kg_m2=[4.0, 4.0, 4.0], angular_velocity_rad_s=[0.0, 0.0, 0.0], torques=[thruster])
    t = np.array([1799.0, 1800.005, 1900.0, 2000.5, 3600.0])
    q, rates = body.motion(t)
    np.testing.assert_allclose(rates[:, 2], np.array([0.0, 0.005, 0.01, 0.51, 1.01]) / 4.0, atol=1e-12)
    angle = 0.01 * (1900.0 - 1800.005) / 4.0
    np.testing.assert_allclose(axes_of(q[2]).magnitude(), angle, rtol=1e-8)
    # Backwards from the start pulses at negative times are flown through too.
    early = Thruster(force_N=[0.0, 2.0, 0.0], place_m=[0.5, 0.0, 0.0], pulses_s=[[-20.0, -19.0]])
    _, rates = RigidBody(inertia_kg_m2=[4.0, 4.0, 4.0], angular_velocity_rad_s=[0.0, 0.0, 0.0],
                         torques=[early]).motion(np.array([-30.0, -10.0]))
    np.testing.assert_allclose(rates[:, 2], [-0.25, 0.0], atol=1e-12)


def test_wheels_trade_momentum_with_the_body():
    """Wheels spun up and stopped: a turn to rest again; the sum of momenta stays in inertial axes when it tumbles."""
    table = {"times_s": [10.0, 20.0, 40.0, 50.0], "momentum_N_m_s": [[0, 0, 0], [0, 0, 2.0], [0, 0, 2.0], [0, 0, 0]]}
    body = RigidBody(inertia_kg_m2=[4.0, 4.0, 5.0], angular_velocity_rad_s=[0.0, 0.0, 0.0], torques=[Wheels(**table)])
    t = np.array([5.0, 15.0, 30.0, 60.0])
    q, rates = body.motion(t)
    np.testing.assert_allclose(rates[:, 2], [0.0, -0.2, -0.4, 0.0], atol=1e-12)
    # Mean rate 0.2 for 10 s, twice, and 0.4 for 20 s.
    turned = Rotation.from_rotvec([0.0, 0.0, -12.0])
    np.testing.assert_allclose((axes_of(q[3]) * turned.inv()).magnitude(), 0.0, atol=1e-9)
    wheels, inertia = Wheels(**table), np.array([2.0, 3.0, 4.0])
    t = np.linspace(0.0, 60.0, 41)
    q, rates = RigidBody(inertia_kg_m2=inertia, angular_velocity_rad_s=[0.1, -0.2, 0.05], torques=[wheels],
                         rtol=1e-12).motion(t)
    momentum = axes_of(q).apply(rates * inertia + np.array([wheels.momentum(x) for x in t]))
    np.testing.assert_allclose(momentum, np.tile(momentum[0], (len(t), 1)), atol=1e-9)


def scenario(**attitude):
    return {"bodies": [{"name": "comet", "generated": {"kind": "icosphere", "radius_m": 1e3, "subdivisions": 1},
                        "brdf": {"law": "lambert", "normal_albedo": 0.05}}],
            "cameras": [{"name": "c", "width_px": 64, "height_px": 64, "focal_length_px": 64.0}],
            "sun": {"r_m": [3e11, 0.0, 0.0]}, "trajectory": {"kind": "at_rest", "r_m": [0.0, 0.0, 2e4]},
            "time": {"duration_s": 200.0, "frames": 5},
            "attitude": {"mode": "rigid_body", "inertia_kg_m2": [4.0, 4.0, 3.0],
                         "angular_velocity_rad_s": [0.0, 0.0, 0.0], **attitude}}


DRAG = {"density_kg_m3": 4e-9, "reference_distance_m": 1e4, "outflow_speed_m_s": 800.0, "area_m2": 3.0}
DUST = {"rate_hz": 0.5, "grain_mass_kg": 1e-3, "outflow_speed_m_s": 50.0, "radius_m": 2.0, "seed": 4}


def test_torques_of_a_scenario_file():
    """All at once, as in Python; dust lasts as long as the scenario."""
    made = scenario(gas_drag={**DRAG, "centre_of_pressure_m": [0.5, 0.0, 0.0]}, dust_impacts=DUST,
                    thrusters=[{"force_N": [0.0, 2.0, 0.0], "place_m": [0.5, 0.0, 0.0], "pulses_s": [[10.0, 11.0]]}],
                    wheels={"times_s": [0.0, 50.0], "momentum_N_m_s": [[0, 0, 0], [0.1, 0, 0]]})
    states = scenario_of_table(made).states()
    body = RigidBody(inertia_kg_m2=[4.0, 4.0, 3.0], angular_velocity_rad_s=[0.0, 0.0, 0.0], torques=[
        GasDrag(trajectory=AT_REST, **DRAG, centre_of_pressure_m=[0.5, 0.0, 0.0]),
        Thruster(force_N=[0.0, 2.0, 0.0], place_m=[0.5, 0.0, 0.0], pulses_s=[[10.0, 11.0]]),
        Wheels(times_s=[0.0, 50.0], momentum_N_m_s=[[0, 0, 0], [0.1, 0, 0]])],
        impulses=[DustImpacts(trajectory=AT_REST, **DUST, duration_s=200.0)])
    q, rates = body.motion(np.array([state.t_s for state in states]))
    np.testing.assert_allclose([state.spacecraft.q_from_inertial for state in states], q, atol=1e-12)
    np.testing.assert_allclose([state.spacecraft.angular_velocity_rad_s for state in states], rates, atol=1e-12)
    plates = [{"area_m2": 3.0, "normal": [0.0, 0.0, -1.0], "centre_m": [0.5, 0.0, 0.0]}]
    of_plates = scenario(gas_drag={**{key: DRAG[key] for key in DRAG if key != "area_m2"}, "plates": plates})
    assert scenario_of_table(of_plates).states()[-1].spacecraft.angular_velocity_rad_s[1] < -0.01


@pytest.mark.parametrize("field, value, message", [
    ("gas_drag", {**DRAG, "density_kg_m3": -1.0}, "attitude.gas_drag.density_kg_m3: must be > 0"),
    ("gas_drag", {**DRAG, "plates": [{"area_m2": 1.0, "normal": [0, 0, 1], "centre_m": [0, 0, 0]}]},
     "attitude.gas_drag.area_m2: needs exactly one of `area_m2` and `plates`"),
    ("gas_drag", {"density_kg_m3": 1e-9, "outflow_speed_m_s": 1.0, "plates": [{"area_m2": 1.0, "normal": [0, 0, 0],
                                                                              "centre_m": [0, 0, 0]}]},
     "attitude.gas_drag.plates[0].normal: must not be zero"),
    ("gas_drag", {**DRAG, "area": 3.0}, "attitude.gas_drag.area: unknown key"),
    ("dust_impacts", {**DUST, "rate_hz": 1e4}, "attitude.dust_impacts.rate_hz: times duration_s must be at most 90000"),
    ("dust_impacts", {key: DUST[key] for key in DUST if key != "seed"}, "attitude.dust_impacts.seed: missing"),
    ("thrusters", [{"force_N": [1, 0, 0], "place_m": [0, 0, 0], "pulses_s": [[2.0, 1.0]]}],
     "attitude.thrusters[0].pulses_s: must be pairs of on and off, ascending"),
    ("thrusters", {}, "attitude.thrusters: must be a list of tables"),
    ("wheels", {"times_s": [0.0, 1.0], "momentum_N_m_s": [[0, 0, 0]]},
     "attitude.wheels.momentum_N_m_s: must be 2 rows of three numbers"),
    ("wheels", {"times_s": [0.0], "momentum_N_m_s": [[0, 0, 0]]}, "attitude.wheels.times_s: must be two times"),
    ("impulses", [], "attitude.impulses: unknown key"),
])
def test_a_wrong_torque_is_told_by_its_field(field, value, message):
    with pytest.raises(ConfigError) as caught:
        scenario_of_table(scenario(**{field: value}))
    assert message in str(caught.value)


def test_drag_needs_a_trajectory_about_the_body():
    made = scenario()
    made["bodies"][0]["attitude"] = {**made["attitude"], "gas_drag": DRAG}
    with pytest.raises(ConfigError, match=r"bodies\[0\].attitude.gas_drag: needs a trajectory of 'comet' about"):
        scenario_of_table(made)
    made = scenario(gas_drag=DRAG)
    del made["sun"]
    made["trajectory"] = {"kind": "kepler", "r_m": [3e11, 0, 0], "v_m_s": [0, 2e4, 0], "epoch_tdb": "2020-01-01"}
    made["bodies"][0]["orbit"] = {"r_m": [3e11, 1e6, 0], "v_m_s": [0, 2e4, 0], "epoch_tdb": "2020-01-01"}
    made["time"]["start_tdb"] = "2020-01-01"
    with pytest.raises(ConfigError, match="attitude.gas_drag: needs a trajectory of 'spacecraft' about the body that"):
        scenario_of_table(made)
