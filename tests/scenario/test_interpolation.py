"""Tables that are not smooth: holds, slews, burns, rows of uneven distance, segments about a burn."""

from __future__ import annotations

import time

import numpy as np
import pytest
from glrender import ConfigError
from glrender.scenario import (
    AttitudeTable,
    Disturbed,
    Epoch,
    Geometry,
    Kepler,
    TrajectoryTable,
    scenario_of_table,
    trajectory_of_oem,
)
from glrender.scenario.files.polynomials import through_rows
from scipy.interpolate import KroghInterpolator
from scipy.spatial.transform import Rotation

START = Epoch.from_tdb("2030-01-01T00:00:00")
BASE = {"bodies": [{"name": "rock", "generated": {"kind": "icosphere", "radius_m": 9.0, "subdivisions": 1},
                    "brdf": {"law": "lambert", "normal_albedo": 0.1}}],
        "cameras": [{"name": "c", "width_px": 8, "height_px": 8, "focal_length_px": 4.0}],
        "sun": {"r_m": [0.0, 0.0, -1e11]}, "trajectory": {"kind": "at_rest", "r_m": [0.0, 0.0, -3000.0]}}


def angle_deg(table, t_s, axis):
    """Angles (N,) [deg] of a frame that turns about an axis, and its rates (N,) [deg/s] there."""
    q, rates = table.at(Geometry(start=START, t_s=t_s, r_m={}, v_m_s={}), "spacecraft")
    inertial_from_frame = Rotation.from_quat(q, scalar_first=True).inv()
    return np.degrees(inertial_from_frame.as_rotvec() @ axis), np.degrees(rates @ axis)


def turning(times_s, angles_deg, axis, **more):
    q = Rotation.from_rotvec(np.radians(angles_deg)[:, None] * axis).inv().as_quat(scalar_first=True)
    # Either sign of a quaternion is one attitude.
    signs = np.where(np.arange(len(q)) % 3, 1.0, -1.0)[:, None]
    return AttitudeTable(times_s=times_s, q_from_inertial=q * signs, **more)


@pytest.mark.parametrize("slew_deg, n_rows_of_slew", [(20.0, 1), (140.0, 3), (-3.0, 2)])
@pytest.mark.parametrize("step_s", [0.1, 10.0, 600.0])
def test_holds_stay_holds_beside_a_slew(slew_deg, n_rows_of_slew, step_s):
    """Angles of the rows to 1e-7 deg and no rate in the holds; a spline was off by a tenth of the slew."""
    axis = np.array([0.6, 0.0, 0.8])
    rows = np.concatenate([np.zeros(8), np.linspace(0.0, slew_deg, n_rows_of_slew + 1)[1:], np.full(9, slew_deg)])
    t = step_s * np.arange(len(rows))
    table = turning(t, rows, axis)
    for first, last, angle in ((0, 7, 0.0), (7 + n_rows_of_slew, len(rows) - 1, slew_deg)):
        found, rates = angle_deg(table, np.linspace(t[first], t[last], 203)[1:-1], axis)
        np.testing.assert_allclose(found, angle, atol=1e-7)
        np.testing.assert_allclose(rates, 0.0, atol=1e-6 / step_s)
    # Monotonic from hold to hold.
    slew, _ = angle_deg(table, np.linspace(t[7], t[7 + n_rows_of_slew], 100), axis)
    assert (np.diff(slew) * np.sign(slew_deg) > 0.0).all()
    (note,) = table.notes_at(START, t[[2]] + 0.3 * step_s)
    assert note.startswith("the interpolation by a spline leaves the rows") and "(slerp)" in note


def test_a_smooth_attitude_keeps_its_spline_and_no_note():
    """A slew that starts and ends smoothly, and a libration about its turning points: 1e-3 of the amplitude."""
    axis, t = np.array([0.0, 0.6, -0.8]), np.arange(0.0, 400.1, 10.0)
    asked = np.linspace(150.0, 250.0, 997)
    for angle in (lambda x: 30.0 * np.sin(2.0 * np.pi * x / 203.0), lambda x: 20.0 * np.tanh((x - 200.0) / 40.0)):
        table = turning(t, angle(t), axis)
        assert table.notes_at(START, asked) == []
        np.testing.assert_allclose(angle_deg(table, asked, axis)[0], angle(asked), atol=0.02)


# Places


def burnt(times_s, burn_s, dv_m_s, with_velocity):
    """Straight lines on both sides of a burn at the origin: a table, and places of times."""
    before = np.array([0.3, 0.0, -0.1])
    after = before + dv_m_s

    def place(t_s):
        x = t_s - burn_s
        return np.where(x[:, None] < 0.0, x[:, None] * before, x[:, None] * after)

    v = np.where((times_s < burn_s)[:, None], before, after)
    return TrajectoryTable(times_s=times_s, r_m=place(times_s) + [3e3, 0.0, 0.0], v_m_s=v if with_velocity else None,
                           about="rock"), place


@pytest.mark.parametrize("dv_m_s", [[-0.5, 0.1, 0.0], [3.0, -5.0, 0.0], [0.0, 0.0, 0.4]])
@pytest.mark.parametrize("step_s", [10.0, 300.0, 3600.0])
def test_steps_beside_a_burn_are_straight(dv_m_s, step_s):
    """With velocities, in all steps but the one whose end has the velocity after the burn: rounding."""
    t = step_s * np.arange(13)
    table, place = burnt(t, 6.0 * step_s, np.array(dv_m_s), True)
    asked = np.concatenate([np.linspace(0.0, t[5], 101)[:-1], np.linspace(t[6], t[-1], 101)[1:]])
    r, _ = table.at(START, asked)
    np.testing.assert_allclose(r - [3e3, 0.0, 0.0], place(asked), atol=1e-9 * t[-1])
    (note,) = table.notes_at(START, asked)
    assert note.startswith("the interpolation by polynomials leaves the rows in") and "cubic Hermite" in note


@pytest.mark.parametrize("step_s", [10.0, 300.0])
def test_a_spacecraft_that_waits_moves_on_and_waits_does_not_overshoot(step_s):
    """Rows without velocities: between equal ones the place is theirs, elsewhere within those of the two rows."""
    x = np.concatenate([np.zeros(9), [200.0, 400.0], np.full(9, 400.0)])
    table = TrajectoryTable(times_s=step_s * np.arange(len(x)), r_m=x[:, None] * [1.0, -2.0, 0.0] + 7e3, about="rock")
    asked = np.linspace(0.0, step_s * (len(x) - 1), 1801)
    r, v = table.at(START, asked)
    moved = (r - 7e3) @ [1.0, -2.0, 0.0] / 5.0
    waits = (asked < 8.0 * step_s) | (asked > 10.0 * step_s)
    np.testing.assert_allclose(moved[waits], np.where(asked < 9.0 * step_s, 0.0, 400.0)[waits], atol=1e-9)
    np.testing.assert_allclose(v[waits], 0.0, atol=1e-9)
    assert moved.min() > -1e-9 and moved.max() < 400.0 + 1e-9
    assert "PCHIP" in table.notes_at(START, asked)[0]


LOW = Kepler.from_elements(about="rock", semi_major_axis_m=6.9e6, eccentricity=0.01, inclination_deg=50.0,
                           longitude_ascending_node_deg=10.0, argument_of_periapsis_deg=80.0, mean_anomaly_deg=5.0,
                           epoch=START, gravitational_parameter_m3_s2=3.986e14)


@pytest.mark.parametrize("with_velocity, limit_m", [(True, 20.0), (False, 5e3)])
def test_rows_of_uneven_distance(with_velocity, limit_m):
    """600 s beside 5 s of a low orbit of the Earth, 37 degrees a step: as exact as a table that ends there.

    A polynomial of degree 7 at the end of its rows: the remainder's f(8) / 8! times the product of distances.
    """
    coarse, dense = 600.0 * np.arange(11), 6000.0 + 5.0 * np.arange(1, 41)
    t = np.concatenate([coarse, dense, 6200.0 + 600.0 * np.arange(1, 9)])
    asked = np.linspace(0.0, t[-1], 3001)

    def made(times_s):
        r, v = LOW.at(START, times_s)
        return TrajectoryTable(times_s=times_s, r_m=r, v_m_s=v if with_velocity else None, about="rock", epoch=START)

    table, truth = made(t), LOW.at(START, asked)[0]
    off = np.linalg.norm(table.at(START, asked)[0] - truth, axis=1)
    assert off.max() < limit_m
    before, among = asked < 6000.0, (asked > 6030.0) & (asked < 6170.0)
    np.testing.assert_array_equal(table.at(START, asked[before])[0], made(coarse).at(START, asked[before])[0])
    assert off[among].max() < 1e-3
    (note,) = table.notes_at(START, asked)
    assert "rows on one side alone" in note and table.notes_at(START, asked[among]) == []


@pytest.mark.parametrize("with_velocity", [True, False])
def test_velocities_at_a_row_where_steps_change_are_those_behind_it(with_velocity):
    """A circle, 0.19 rad a step of 600 s, then 5 s: on the row itself as exact as a picosecond later, 1e-8."""
    rate, t = 0.19 / 600.0, np.concatenate([600.0 * np.arange(4), 1800.0 + 5.0 * np.arange(1, 40)])

    def circle(times_s):
        angle = rate * times_s[:, None]
        r = 7e6 * np.hstack([np.cos(angle), np.sin(angle), 0.0 * angle])
        return r, rate * np.cross([0.0, 0.0, 1.0], r)

    r, v = circle(t)
    table = TrajectoryTable(times_s=t, r_m=r, v_m_s=v if with_velocity else None, about="rock")
    asked = t[3:]
    found = table.at(START, asked)
    np.testing.assert_allclose(found[0], r[3:], rtol=1e-12, atol=1e-5)
    np.testing.assert_allclose(found[1], v[3:], atol=1e-8 * 7e6 * rate)


def test_two_rows_of_a_burn_keep_both_sides_apart():
    """Rows a second before and after a burn of 2 m/s, between rows of 60 s: straight on both sides, to rounding."""
    t = np.concatenate([60.0 * np.arange(10), [599.0, 601.0], 600.0 + 60.0 * np.arange(1, 10)])
    before, after = np.array([1.0, 0.0, 0.0]), np.array([0.0, 2.0, 0.5])
    place = lambda x: np.where((x < 600.0)[:, None], (x - 600.0)[:, None] * before, (x - 600.0)[:, None] * after)  # noqa: E731
    table = TrajectoryTable(times_s=t, r_m=place(t), about="rock")
    asked = np.concatenate([np.linspace(0.0, 599.0, 300), np.linspace(601.0, t[-1], 300)])
    np.testing.assert_allclose(table.at(START, asked)[0], place(asked), atol=1e-9)


@pytest.mark.parametrize("count", [2, 3, 4, 8])
@pytest.mark.parametrize("with_slopes", [True, False])
def test_polynomials_are_scipys(rng, count, with_slopes):
    x = np.sort(np.linspace(-1.0, 1.0, count) + rng.uniform(-0.2, 0.2, (5, count)) / count, axis=1)
    y, slopes = rng.normal(size=(2, 5, count, 3))
    of, at = rng.integers(0, 5, 40), rng.uniform(-1.0, 1.0, 40)
    values, rates = through_rows(x, y, slopes if with_slopes else None, of, at)
    for k in range(40):
        if with_slopes:
            made = KroghInterpolator(np.repeat(x[of[k]], 2), np.stack([y[of[k]], slopes[of[k]]], axis=1).reshape(-1, 3))
        else:
            made = KroghInterpolator(x[of[k]], y[of[k]])
        np.testing.assert_allclose([values[k], rates[k]], made.derivatives(at[k], 2), rtol=1e-8, atol=1e-8)


def test_twenty_thousand_rows_are_asked_for_at_once():
    """Of a processor it takes 0.2 s; one polynomial after the other took 20 s."""
    t = 60.0 * np.arange(20_000)
    r, v = LOW.at(START, t)
    table = TrajectoryTable(times_s=t, r_m=r, v_m_s=v, about="rock", epoch=START)
    began = time.process_time()
    found = table.at(START, t[:-1] + 30.0)
    assert time.process_time() - began < 5.0
    np.testing.assert_allclose(found[0], LOW.at(START, t[:-1] + 30.0)[0], atol=1e-2)


@pytest.mark.parametrize("with_velocity", [True, False])
def test_an_orbit_of_sixteen_rows_keeps_its_polynomials(with_velocity):
    t = np.linspace(0.0, 2.0 * 5704.0, 33)
    r, v = LOW.at(START, t)
    table = TrajectoryTable(times_s=t, r_m=r, v_m_s=v if with_velocity else None, about="rock", epoch=START)
    assert table.notes_at(START, np.linspace(0.0, t[-1], 500)) == []


# What check tells


def test_check_tells_of_frames_in_such_steps_alone(tmp_path):
    t = np.arange(0.0, 2001.0, 10.0)
    half = np.radians(np.where(t < 1000.0, 0.0, 5.0))
    (tmp_path / "q.csv").write_text("t_s,q_w,q_x,q_y,q_z\n" + "\n".join(
        f"{a},{float(np.cos(b))!r},0.0,0.0,{float(np.sin(b))!r}" for a, b in zip(t, half, strict=True)) + "\n")
    attitude = {"mode": "csv", "file": "q.csv", "offset_deg": [0.0, 0.0, 1.0]}

    def told(times_s):
        scenario = scenario_of_table({**BASE, "attitude": attitude, "time": {"times_s": times_s}}, folder=tmp_path)
        assert isinstance(scenario.attitudes["spacecraft"], Disturbed)
        return scenario.check()

    (note,) = told([5.0, 995.0, 1005.0, 1995.0])
    assert note.startswith("attitude of 'spacecraft': the interpolation by a spline leaves the rows")
    assert "t_s = 1000 to t_s = 1010" in note
    assert told([5.0, 105.0, 1995.0]) == []


# Segments


def date(t):
    return START.after(t).tdb


def segment(first, last, place, **meta):
    """Rows each 600 s of a place [km] with its velocity [km/s]."""
    rows = "\n".join(f"{date(t)} " + " ".join(f"{x:.9f}" for x in place(t)) for t in range(first, last + 1, 600))
    keys = "\n".join(f"{key} = {value}" for key, value in meta.items())
    return ("META_START\nOBJECT_NAME = CRAFT\nOBJECT_ID = 2030-001A\nCENTER_NAME = ROCK\nREF_FRAME = ICRF\n"
            f"TIME_SYSTEM = TDB\nSTART_TIME = {date(first)}\nSTOP_TIME = {date(last)}\n{keys}\nMETA_STOP\n{rows}\n")


def written(path, *segments):
    path.write_text("CCSDS_OEM_VERS = 2.0\nCREATION_DATE = 2030-01-01T00:00:00\nORIGINATOR = TEST\n\n"
                    + "\n".join(segments))
    return trajectory_of_oem(path, "rock")


def line(speed_km_s):
    return lambda t: (5.0 + speed_km_s * (t - 3600.0), 0.0, 0.0, speed_km_s, 0.0, 0.0)


def test_segments_count_within_their_useable_times(tmp_path):
    """CCSDS 502.0-B-3, table 5-3: rows beyond are for the interpolation; the first goes on as if nothing burnt."""
    path = written(tmp_path / "a.oem",
                   segment(0, 5400, line(5e-4), USEABLE_START_TIME=date(300), USEABLE_STOP_TIME=date(3600)),
                   segment(1800, 9000, line(-2e-4), USEABLE_START_TIME=date(3600), USEABLE_STOP_TIME=date(8000)))
    t = np.array([300.0, 2000.0, 3599.0, 3601.0, 5000.0, 8000.0])
    expected = 5e3 + np.where(t < 3600.0, 0.5, -0.2) * (t - 3600.0)
    np.testing.assert_allclose(path.at(START, t)[0][:, 0], expected, atol=1e-6)
    for beyond in (200.0, 8100.0):
        with pytest.raises(ConfigError, match="must be in a segment of the table: 2030-01-01T00:05:00.000000 TDB to"):
            path.at(START, np.array([beyond]))
    assert path.notes_at(START, t) == []


def test_the_microsecond_of_dates_beyond_segments_is_round_off(tmp_path):
    """As it is beyond a table: both ends, and between segments that follow each other; two are refused."""
    path = written(tmp_path / "a.oem", segment(0, 3600, line(5e-4)), segment(3600, 7200, line(5e-4)))
    t = np.array([-9e-7, 3600.0 - 9e-7, 3600.0 + 9e-7, 7200.0 + 9e-7])
    np.testing.assert_allclose(path.at(START, t)[0][:, 0], 5e3 + 0.5 * (t - 3600.0), atol=1e-6)
    assert path.notes_at(START, t) == []
    for far in (-2e-6, 7200.0 + 2e-6):
        with pytest.raises(ConfigError, match="must be in a segment of the table"):
            path.at(START, np.array([far]))


@pytest.mark.parametrize("key, value, inside, outside", [
    ("USEABLE_START_TIME", "2030-001T00:20:00", 1300.0, 1100.0), ("USEABLE_STOP_TIME", date(4000), 3900.0, 4100.0)])
def test_one_segment_with_one_of_the_two(tmp_path, key, value, inside, outside):
    """The table's end stands for the one that is missing; a day of the year is a date."""
    path = written(tmp_path / "a.oem", segment(0, 5400, line(5e-4), **{key: value}))
    for t in (inside, 0.0 if key == "USEABLE_STOP_TIME" else 5400.0):
        np.testing.assert_allclose(path.at(START, np.array([t]))[0][0, 0], 5e3 + 0.5 * (t - 3600.0), atol=1e-6)
    with pytest.raises(ConfigError, match="time: must be within the table"):
        path.at(START, np.array([outside]))


@pytest.mark.parametrize("start, stop", [(3600, 600), (6000, 7000)])
def test_useable_times_without_rows_are_refused(tmp_path, start, stop):
    with pytest.raises(ConfigError, match=r"a\.oem\.USEABLE_START_TIME: must be before USEABLE_STOP_TIME, with rows"):
        written(tmp_path / "a.oem", segment(0, 5400, line(5e-4), USEABLE_START_TIME=date(start),
                                            USEABLE_STOP_TIME=date(stop)))
