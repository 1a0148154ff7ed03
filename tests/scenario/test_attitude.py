"""Attitudes: pointing, spin, offsets, jitter; each rate is that of the attitude itself."""

from __future__ import annotations

import numpy as np
import orbits
import pytest
from glrender import ConfigError, PinholeCamera, SceneError, frames
from glrender.scenario import (
    AttitudeTable,
    Disturbed,
    Encounter,
    Epoch,
    Fixed,
    Geometry,
    Jitter,
    Pointing,
    RigidBody,
    Scenario,
    Spin,
    Times,
)
from glrender.scenario.attitude import UP_RULES
from missing import needed_module
from orbits import DATE
from scipy.spatial.transform import Rotation

MOUNTING = Rotation.from_euler("xyz", [20.0, -70.0, 130.0], degrees=True).as_quat(scalar_first=True)
POLE = {"pole_right_ascension_deg": 0.0, "pole_declination_deg": 90.0}
T_S = np.linspace(0.0, 600.0, 13)


def flyby():
    return Encounter(body="didymos", body_trajectory=orbits.didymos(), distance_m=2e5, relative_velocity_m_s=1e4,
                     date=DATE, duration_s=600.0, phase_angle_deg=50.0)


def geometry(t_s=T_S):
    craft = flyby()
    scenario = Scenario(trajectories={"didymos": orbits.didymos(), "spacecraft": craft}, origin="didymos",
                        start=craft.start, sampler=Times(times_s=T_S))
    return scenario.geometry(t_s)


def turned_rates(attitude, t_s, owner="spacecraft", h=1e-3):
    """Angular velocities by central differences of the attitudes, in the frame."""
    before, after = (Rotation.from_quat(attitude.at(geometry(t_s + step), owner)[0], scalar_first=True)
                     for step in (-h, h))
    return -(after * before.inv()).as_rotvec() / (2.0 * h)


SOURCES = {
    **{f"pointing, up {up}": Pointing(target="didymos", up=up, q_camera_from_spacecraft=MOUNTING) for up in UP_RULES},
    "pointing, rolled": Pointing(target="didymos", up=[1.0, -1.0, 0.3], roll_deg=33.0),
    "spin": Spin(q_from_inertial=MOUNTING, angular_velocity_rad_s=[0.01, -0.02, 0.03]),
    "fixed": Fixed(q_from_inertial=MOUNTING),
    "table": AttitudeTable(times_s=np.linspace(-10.0, 610.0, 200),
                           q_from_inertial=Rotation.from_euler("zyx", np.stack([
                               np.linspace(0.0, 9.0, 200), np.sin(np.linspace(0.0, 7.0, 200)), np.zeros(200)],
                               axis=1)).as_quat(scalar_first=True)),
    "rigid body": RigidBody(inertia_kg_m2=[1.0, 2.0, 2.5], angular_velocity_rad_s=[0.01, 0.02, -0.01]),
    "offset and jitter": Disturbed(
        attitude=Pointing(target="didymos"), offset_rad=[1e-3, 2e-3, 0.1], q_camera_from_spacecraft=MOUNTING,
        jitter=Jitter(frequency_hz=[0.01, 3.0], density_rad2_hz=[1e-12, 1e-12], seed=3, lines=50)),
}


@pytest.mark.parametrize("attitude", SOURCES.values(), ids=SOURCES)
def test_rates_are_those_of_the_attitude(attitude):
    """Central differences over 2 ms: 1e-8 rad/s of rounding and of third derivatives."""
    t = np.linspace(5.0, 595.0, 9)
    q, rates = attitude.at(geometry(t), "spacecraft")
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(rates, turned_rates(attitude, t), atol=3e-8)


@pytest.mark.parametrize("up", [*UP_RULES, [0.2, 0.3, -0.5]], ids=str)
def test_the_target_is_in_the_middle_and_up_is_up(up):
    """In pixels of a camera that is mounted askew; up is towards -Y."""
    camera = PinholeCamera(name="c", width_px=640, height_px=480, focal_length_px=900.0,
                           q_camera_from_spacecraft=MOUNTING)
    where = geometry()
    q, _ = Pointing(target="didymos", up=up, q_camera_from_spacecraft=MOUNTING).at(where, "spacecraft")
    r, v = where.between("spacecraft", "didymos")
    directions = {"north": np.tile([0.0, 0.0, 1.0], (len(q), 1)), "sun": where.between("spacecraft", "sun")[0],
                  "orbit_normal": np.cross(r, v)}.get(up if isinstance(up, str) else "", np.tile(up, (len(q), 1)))
    for index in range(len(q)):
        to_camera = frames.dcm(camera.q_camera_from_spacecraft) @ frames.dcm(q[index])
        seen = to_camera @ r[index]
        np.testing.assert_allclose(seen[:2] / seen[2], 0.0, atol=1e-13)
        upwards = to_camera @ np.asarray(directions[index], float)
        assert upwards[1] < 0.0
        np.testing.assert_allclose(upwards[0] / np.linalg.norm(upwards), 0.0, atol=1e-13)


def test_pointing_north_is_look_at():
    where = geometry()
    q, _ = Pointing(target="didymos").at(where, "spacecraft")
    for index in range(len(q)):
        expected = frames.look_at(where.r_m["spacecraft"][index], where.r_m["didymos"][index])
        np.testing.assert_allclose(abs(q[index] @ expected), 1.0, atol=1e-14)


def test_roll_and_offsets_turn_the_view_as_they_say():
    """A camera that rolls +X towards +Y sees the top at its left; +Y moves the view right, so the target left."""
    where = geometry()
    r, _ = where.between("spacecraft", "didymos")
    rolled, _ = Pointing(target="didymos", roll_deg=90.0).at(where, "spacecraft")
    assert (frames.dcm(rolled[0]) @ [0.0, 0.0, 1.0])[0] < 0.0
    for axis, sign, place in ((1, -1.0, 0), (0, 1.0, 1)):
        q, _ = Disturbed(attitude=Pointing(target="didymos"), offset_rad=0.01 * np.eye(3)[axis]).at(where, "spacecraft")
        seen = frames.dcm(q[3]) @ r[3]
        np.testing.assert_allclose(seen[place] / seen[2], sign * np.tan(0.01), rtol=1e-9)


def test_up_along_the_boresight_is_refused():
    where = geometry()
    boresight = where.between("spacecraft", "didymos")[0][6]
    with pytest.raises(SceneError, match="up: is along the boresight at t_s = 300"):
        Pointing(target="didymos", up=boresight).at(where, "spacecraft")
    with pytest.raises(SceneError, match="target: must be in the scenario, got 'moon'; there are didymos"):
        Pointing(target="moon").at(where, "spacecraft")


@pytest.mark.parametrize("body, code", [("c67p_label_v01.tpc", 1000012), ("itokawa_gaskell_n3.tpc", 2025143),
                                        ("pck00010.tpc", 2000004)])
def test_a_bodys_spin_is_spices(shared, body, code):
    """IAU pole, prime meridian and rate of real kernels, by SPICE's tisbod: 1e-8 in every element, 20 years on."""
    spice = needed_module("spiceypy", "pip install -e '.[test]'")
    spice.furnsh(str(shared / "kernels" / body))
    pole = [spice.bodvcd(code, item, 3)[1] for item in ("POLE_RA", "POLE_DEC", "PM")]
    if any(part[2] for part in pole):
        pytest.fail("this test takes a body whose spin is constant")
    made = Spin.about_pole(pole_right_ascension_deg=pole[0][0], pole_declination_deg=pole[1][0],
                           prime_meridian_deg=pole[2][0], rate_deg_day=pole[2][1], epoch=Epoch(0))
    for date in ("2000-01-01T12:00:00", "2014-08-08T12:00:00", "2021-03-03T03:03:03"):
        start = Epoch.from_tdb(date)
        q, rates = made.at(Geometry(start=start, t_s=np.array([0.0, 7.0]), r_m={}, v_m_s={}), "body")
        for index, t in enumerate((0.0, 7.0)):
            matrix = spice.tisbod("J2000", code, start.et_s + t)
            np.testing.assert_allclose(frames.dcm(q[index]), matrix[:3, :3], atol=1e-8)
            rotation, rate = spice.xf2rav(matrix)
            np.testing.assert_allclose(rates[index], rotation @ rate, rtol=1e-8, atol=1e-15)
    spice.kclear()


def test_a_spin_has_its_period():
    """Half a turn in half a period, and the other way for a negative one."""
    spin = Spin.about_pole(pole_right_ascension_deg=70.0, pole_declination_deg=64.0, rotation_period_s=-100.0)
    q, _ = spin.at(geometry(np.array([0.0, 25.0, 100.0])), "didymos")
    np.testing.assert_allclose(abs(q[0] @ q[2]), 1.0, atol=1e-14)
    # A fixed direction in the equator moves against the body's turn, here towards +Y.
    x = frames.dcm(q[0]).T @ [1.0, 0.0, 0.0]
    np.testing.assert_allclose(frames.dcm(q[1]) @ x, [0.0, 1.0, 0.0], atol=1e-14)


def test_jitter_has_the_spectrum_asked_for():
    """Its variance is the integral of the density, and a seed gives one sequence."""
    jitter = Jitter(frequency_hz=[1.0, 5.0, 9.0], density_rad2_hz=[[0.0, 1e-10, 0.0], [4e-10, 1e-10, 0.0], [0.0, 1e-10,
                    0.0]], seed=8, lines=400)
    angles, _ = jitter.angles(np.arange(20_000) * 0.0137)
    np.testing.assert_allclose(angles.var(axis=0), [16e-10, 8e-10, 0.0], rtol=0.05)
    again = Jitter(frequency_hz=[1.0, 9.0], density_rad2_hz=[1e-10, 1e-10], seed=8)
    np.testing.assert_array_equal(again.angles(T_S)[0], Jitter(frequency_hz=[1.0, 9.0], density_rad2_hz=[1e-10, 1e-10],
                                                               seed=8).angles(T_S)[0])


def test_a_table_of_tumbling_is_good_to_the_fourth_power():
    """Samples of a free rigid body: 5 s apart 16 times as far off as 2.5 s apart."""
    body = RigidBody(inertia_kg_m2=[1.0, 2.0, 2.5], angular_velocity_rad_s=[0.05, 0.08, 0.1])
    t = np.linspace(101.0, 299.0, 97)
    truth, off = body.motion(t)[0], []
    for step in (5.0, 2.5):
        nodes = np.arange(0.0, 400.1, step)
        # Either sign of a quaternion is one attitude.
        q = body.motion(nodes)[0] * np.where(np.arange(len(nodes)) % 3, 1.0, -1.0)[:, None]
        got, _ = AttitudeTable(times_s=nodes, q_from_inertial=q).at(geometry(t), "didymos")
        off.append(np.max(1.0 - np.abs(np.einsum("ij,ij->i", got, truth))))
    assert off[1] < 1e-8 and off[0] / off[1] > 100.0


@pytest.mark.parametrize("make, message", [
    (lambda: Spin.about_pole(**POLE), "rotation_period_s: needs exactly one of"),
    (lambda: Spin.about_pole(**POLE, rotation_period_s=0.0), "rotation_period_s: must be longer than 0.01 s"),
    (lambda: Pointing(target="b", up="west"), "up: must be one of 'north', 'sun', 'orbit_normal', got 'west'"),
    (lambda: Fixed(q_from_inertial=[1.0, 1.0, 0.0, 0.0]), "norm must be 1 within 0.001"),
    (lambda: Jitter(frequency_hz=[1.0], density_rad2_hz=[1.0], seed=1), "frequency_hz: must be at least two"),
    (lambda: AttitudeTable(times_s=[0.0, 1.0], q_from_inertial=[[1, 0, 0, 0], [2, 0, 0, 0]]), "inertial[1]: norm"),
    (lambda: RigidBody(inertia_kg_m2=[1.0, 1.0, 3.0], angular_velocity_rad_s=[0, 0, 1]), "none above the sum"),
])
def test_a_wrong_attitude_is_refused(make, message):
    with pytest.raises(ConfigError) as caught:
        make()
    assert message in str(caught.value)
