"""OEM and AEM files: every keyword is used, passed over by name, or refused; truth by SPICE's and SciPy's rotations.

The two long samples are the examples of CCSDS 502.0-B-2 (figure 5-1) and 504.0-B-1 (figure 4-1); the spinning one is
that of 504.0-B-1 figure 4-3 with its nutation, as NASA GSFC wrote it for ST5.
"""

from __future__ import annotations

import numpy as np
import pytest
from glrender import ConfigError, frames
from glrender.scenario import Epoch, Geometry, attitude_of_aem, scenario_of_table, trajectory_of_oem
from scipy.spatial.transform import Rotation

META = """META_START
OBJECT_NAME = {object}
OBJECT_ID = 2030-001A
CENTER_NAME = {center}
REF_FRAME = ICRF
TIME_SYSTEM = TDB
START_TIME = 2030-01-01T00:00:00
STOP_TIME = 2030-01-01T00:50:00
{more}META_STOP
"""
HEAD = "CCSDS_OEM_VERS = 2.0\nCREATION_DATE = 2030-01-01T00:00:00\nORIGINATOR = TEST\n\n"
START = Epoch.from_tdb("2030-01-01T00:00:00")
EXAMPLE = """CCSDS_AEM_VERS = 1.0
CREATION_DATE = 2002-11-04T17:22:31
ORIGINATOR = NASA/JPL
META_START
COMMENT This file was produced by M.R. Somebody, MSOO NAV/JPL, 2002 OCT 04.
COMMENT It is to be used for attitude reconstruction only. The relative accuracy of these
COMMENT attitudes is 0.1 degrees per axis.
OBJECT_NAME = MARS GLOBAL SURVEYOR
OBJECT_ID = 1996-062A
CENTER_NAME = MARS BARYCENTER
REF_FRAME_A = EME2000
REF_FRAME_B = SC_BODY_1
ATTITUDE_DIR = A2B
TIME_SYSTEM = UTC
START_TIME = 1996-11-28T21:29:07.2555
USEABLE_START_TIME = 1996-11-28T22:08:02.5555
USEABLE_STOP_TIME = 1996-11-30T01:18:02.5555
STOP_TIME = 1996-11-30T01:28:02.5555
ATTITUDE_TYPE = QUATERNION
QUATERNION_TYPE = LAST
INTERPOLATION_METHOD = hermite
INTERPOLATION_DEGREE = 7
META_STOP
DATA_START
1996-11-28T21:29:07.2555 0.56748 0.03146 0.45689 0.68427
1996-11-28T22:08:03.5555 0.42319 -0.45697 0.23784 0.74533
1996-11-28T22:08:04.5555 -0.84532 0.26974 -0.06532 0.45652
1996-11-30T01:28:02.5555 0.74563 -0.45375 0.36875 0.31964
DATA_STOP
META_START
COMMENT This block begins after trajectory correction maneuver TCM-3.
OBJECT_NAME = mars global surveyor
OBJECT_ID = 1996-062A
CENTER_NAME = mars barycenter
REF_FRAME_A = EME2000
REF_FRAME_B = SC_BODY_1
ATTITUDE_DIR = A2B
TIME_SYSTEM = UTC
START_TIME = 1996-12-18T12:05:00.5555
USEABLE_START_TIME = 1996-12-18T12:10:00.5555
USEABLE_STOP_TIME = 1996-12-28T21:23:00.5555
STOP_TIME = 1996-12-28T21:28:00.5555
ATTITUDE_TYPE = QUATERNION
QUATERNION_TYPE = LAST
META_STOP
DATA_START
1996-12-18T12:05:00.5555 -0.64585 0.018542 -0.23854 0.72501
1996-12-18T12:10:05.5555 0.87451 -0.43475 0.13458 -0.16767
1996-12-18T12:10:10.5555 0.03125 -0.65874 0.23458 -0.71418
1996-12-28T21:28:00.5555 -0.25485 0.58745 -0.36845 0.67394
DATA_STOP
"""
AEM = """CCSDS_AEM_VERS = {version}
CREATION_DATE = 2030-01-01T00:00:00
ORIGINATOR = TEST
META_START
OBJECT_NAME = CRAFT
OBJECT_ID = 2030-001A
REF_FRAME_A = {a}
REF_FRAME_B = {b}
{direction}TIME_SYSTEM = TDB
START_TIME = 2030-01-01T00:00:00
STOP_TIME = 2030-01-01T00:10:00
ATTITUDE_TYPE = {kind}
{more}META_STOP
DATA_START
{rows}
DATA_STOP
"""
# ST5, spinning at 15 turns a minute: right ascension, declination, phase, spin, nutation, its period and its phase.
ST5 = [("2030-01-01T00:00:00.071", "268.62512 68.407179 159.5566582 -109.9677896 0.366382445 18.16999799 -156.19211"),
       ("2030-01-01T00:00:00.196", "268.59578 68.395597 148.3145228 -109.9677896 0.366382445 18.16999799 -169.93808"),
       ("2030-01-01T00:00:00.321", "268.56786 68.383555 137.0710680 -109.9677896 0.366382445 18.16999799 -183.68405"),
       ("2030-01-01T00:00:00.446", "268.54141 68.371076 125.8262462 -109.9677896 0.366382445 18.16999799 -197.43003")]


def oem_rows(count=6, wide=()):
    """A straight line of 0.5 m/s, rows every ten minutes; those of `wide` have accelerations."""
    return "".join(f"2030-01-01T00:{10 * k:02d}:00 {5 + 0.3 * k:.6f} 1.0 2.0 5.0E-4 0.0 0.0"
                   + (" 0.0 0.0 0.0\n" if k in wide else "\n") for k in range(count))


def oem(folder, rows=None, *, name="CRAFT", center="ROCK", more="", head=HEAD):
    (folder / "a.oem").write_text(head + META.format(object=name, center=center, more=more)
                                  + (oem_rows() if rows is None else rows))
    return folder / "a.oem"


@pytest.mark.parametrize("wide", [(0,), (5,), (1, 2, 4), range(6)])
def test_rows_with_and_without_accelerations_are_one_line(tmp_path, wide):
    r, v = trajectory_of_oem(oem(tmp_path, oem_rows(wide=wide)), "rock").at(START, np.array([90.0, 1500.0, 2999.0]))
    np.testing.assert_allclose(r, [[5045.0, 1e3, 2e3], [5750.0, 1e3, 2e3], [6499.5, 1e3, 2e3]], atol=1e-6)
    np.testing.assert_allclose(v, [[0.5, 0.0, 0.0]] * 3, atol=1e-9)


@pytest.mark.parametrize("version", ["1", "2", "2.", "3.00", "1.0"])
def test_a_version_is_a_number(tmp_path, version):
    r, _ = trajectory_of_oem(oem(tmp_path, head=HEAD.replace("2.0", version)), "rock").at(START, np.array([90.0]))
    np.testing.assert_allclose(r, [[5045.0, 1e3, 2e3]], atol=1e-6)
    for wrong in ("4", "nan", "two", "2.0.1", "1e0"):
        with pytest.raises(ConfigError, match=f"CCSDS_OEM_VERS: must be one of 1.0, 2.0, 3.0, got '{wrong}'"):
            trajectory_of_oem(oem(tmp_path, head=HEAD.replace("2.0", wrong)), "rock")


@pytest.mark.parametrize("old, new, message", [
    ("2030-01-01T00:20:00", "INTERPOLATION = HERMITE\n2030-01-01T00:20:00", "line 16: must be an epoch and numbers:"),
    ("REF_FRAME = ICRF", "REF_FRAME = ICRF\nREF_FRAMES = ICRF", "line 10: has a keyword that is not known here, got "
     "'REF_FRAMES'; did you mean 'REF_FRAME'?"),
    ("REF_FRAME = ICRF", "REF_FRAME = ICRF\nREF_FRAME = EME2000", "line 10: gives a keyword a second time, got 'REF_F"),
    ("ORIGINATOR = TEST", "ORIGINATORS = TEST", "line 3: has a keyword that is not known here"),
    ("OBJECT_ID = 2030-001A", "OBJECT_ID", "line 7: must be keyword = value, got 'OBJECT_ID'"),
    ("OBJECT_ID = 2030-001A", "OBJECT_ID =", "line 7: must give the keyword a value, got 'OBJECT_ID'"),
    ("META_STOP\n", "", "line 13: must be keyword = value, got '2030-01-01T00:00:00 5"),
    ("META_STOP\n", "META_STOP\nMETA_STOP\n", "line 14: must not come here, got 'META_STOP'"),
    ("CENTER_NAME = ROCK\n", "", "CENTER_NAME: must be there, and one in the whole file"),
    ("TIME_SYSTEM = TDB\n", "", "TIME_SYSTEM: must be one of TDB, UTC, TT, TAI, got None"),
    ("CCSDS_OEM_VERS = 2.0", "CCSDS_OEM_VERS = 4.0", "CCSDS_OEM_VERS: must be one of 1.0, 2.0, 3.0, got '4.0'"),
    ("5.300000 1.0 2.0", "5.300000 1.0 nan", "line 15: must be an epoch and finite numbers"),
    ("5.300000 1.0 2.0", "5.300000 1.0", "line 15: must have 6 or 9 numbers behind the epoch, got 5"),
    ("2030-01-01T00:10:00", "2030-366T00:10:00", "line 15: must be a date"),
    ("2030-01-01T00:10:00", "2030-01-01T00:00:00", "line 15: must be later than the row before"),
])
def test_what_an_oem_says_is_used_or_refused_with_its_line(tmp_path, old, new, message):
    path = oem(tmp_path)
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(ConfigError) as caught:
        trajectory_of_oem(path, "rock")
    assert str(caught.value).startswith("a.oem.") and message in str(caught.value)


def test_what_an_oem_may_say_beside_its_numbers_is_passed_over(tmp_path):
    """Covariances, comments, interpolation and names for people change no number."""
    covariance = ("COVARIANCE_START\nEPOCH = 2030-01-01T00:00:00\nCOV_REF_FRAME = RTN\n1.0\n2.0 3.0\nCOMMENT x = 1\n"
                  "COVARIANCE_STOP\n")
    head = HEAD.replace("2.0", "3.0").replace("ORIGINATOR", "CLASSIFICATION = public\nMESSAGE_ID = 7\nORIGINATOR")
    more = "COMMENT a = b\nREF_FRAME_EPOCH = 2000-01-01T12:00:00\nINTERPOLATION = Lagrange\nINTERPOLATION_DEGREE = 5\n"
    full = trajectory_of_oem(oem(tmp_path, oem_rows() + covariance, head=head, more=more), "rock")
    plain = trajectory_of_oem(oem(tmp_path), "rock")
    np.testing.assert_array_equal(full.r_m, plain.r_m)
    assert full.epoch == plain.epoch


def scenario(folder, trajectory, moon=None):
    body = {"generated": {"kind": "icosphere", "radius_m": 300.0, "subdivisions": 1},
            "brdf": {"law": "lambert", "normal_albedo": 0.1}}
    bodies = [{"name": "didymos", **body}, {"name": "dimorphos", **body, **(moon or {"trajectory": {
        "kind": "at_rest", "r_m": [0.0, 1e3, 0.0]}})}]
    return scenario_of_table(
        {"bodies": bodies, "cameras": [{"name": "c", "width_px": 64, "height_px": 64, "focal_length_px": 64.0}],
         "sun": {"r_m": [1.5e11, 0.0, 0.0]}, "trajectory": trajectory,
         "time": {"start_tdb": "2030-01-01T00:00:00", "times_s": [60.0]}}, folder=folder)


@pytest.mark.parametrize("center, trajectory, about", [
    ("DIDYMOS", {}, "didymos"), ("Dimorphos", {}, "dimorphos"),
    ("65803 DIDYMOS", {"about": "didymos", "center_name": "65803 Didymos"}, "didymos"),
    ("DIMORPHOS", {"about": "dimorphos"}, "dimorphos")])
def test_an_oem_is_about_its_centre(tmp_path, center, trajectory, about):
    oem(tmp_path, center=center)
    made = scenario(tmp_path, {"kind": "oem", "file": "a.oem", **trajectory})
    assert made.trajectories["spacecraft"].about == about
    (state,) = made.states()
    np.testing.assert_allclose(state.spacecraft.r_inertial_m - state.bodies[about].r_inertial_m, [5030.0, 1e3, 2e3],
                               atol=1e-6)


@pytest.mark.parametrize("center, trajectory, message", [
    ("EARTH", {}, "trajectory.a.oem.CENTER_NAME: must be 'didymos' or 'dimorphos' or 'sun', got 'EARTH'; write center"),
    ("DIMORPHOS", {"about": "didymos"}, "a.oem.CENTER_NAME: must be 'didymos', got 'DIMORPHOS'"),
    ("DIDYMOS BARYCENTER", {}, "a.oem.CENTER_NAME: must be"),
    ("EARTH", {"about": "didymos", "center_name": "MARS"}, "a.oem.CENTER_NAME: must be 'MARS', the center_name"),
])
def test_an_oem_about_another_place_is_refused(tmp_path, center, trajectory, message):
    oem(tmp_path, center=center)
    with pytest.raises(ConfigError) as caught:
        scenario(tmp_path, {"kind": "oem", "file": "a.oem", **trajectory})
    assert message in str(caught.value)


def test_an_oem_about_the_sun_is_of_a_body_or_the_spacecraft(tmp_path):
    """A file each, of the body and the spacecraft about the Sun: where they are from each other."""
    oem(tmp_path, name="ROCK", center="Sun").rename(tmp_path / "rock.oem")
    oem(tmp_path, oem_rows().replace("1.0 2.0 5.0", "1.5 2.0 5.0"), center="SUN")
    table = {"bodies": [{"name": "rock", "generated": {"kind": "icosphere", "radius_m": 30.0, "subdivisions": 1},
                         "brdf": {"law": "lambert", "normal_albedo": 0.1},
                         "trajectory": {"kind": "oem", "file": "rock.oem"}}],
             "cameras": [{"name": "c", "width_px": 64, "height_px": 64, "focal_length_px": 64.0}],
             "trajectory": {"kind": "oem", "file": "a.oem"},
             "time": {"start_tdb": "2030-01-01T00:00:00", "times_s": [60.0]}}
    (state,) = scenario_of_table(table, folder=tmp_path).states()
    np.testing.assert_allclose(state.spacecraft.r_inertial_m - state.bodies["rock"].r_inertial_m, [0.0, 500.0, 0.0],
                               atol=1e-6)
    np.testing.assert_allclose(state.r_sun_inertial_m - state.bodies["rock"].r_inertial_m, [-5030.0, -1e3, -2e3],
                               atol=1e-6)


def test_an_oem_is_of_its_object(tmp_path):
    """A moon's file does not move the spacecraft, nor the spacecraft's a moon; unless the name is asked for."""
    oem(tmp_path, name="DIMORPHOS", center="DIDYMOS")
    with pytest.raises(ConfigError, match="a.oem.OBJECT_NAME: must not be another body's, got 'DIMORPHOS'; write obj"):
        scenario(tmp_path, {"kind": "oem", "file": "a.oem"})
    asked = scenario(tmp_path, {"kind": "oem", "file": "a.oem", "object_name": "Dimorphos"})
    np.testing.assert_allclose(asked.states()[0].spacecraft.r_inertial_m, [5030.0, 1e3, 2e3], atol=1e-6)
    craft = {"kind": "at_rest", "r_m": [9e3, 0.0, 0.0]}
    of_moon = scenario(tmp_path, craft, moon={"trajectory": {"kind": "oem", "file": "a.oem"}})
    np.testing.assert_allclose(of_moon.states()[0].bodies["dimorphos"].r_inertial_m, [5030.0, 1e3, 2e3], atol=1e-6)
    oem(tmp_path, name="HERA", center="DIDYMOS")
    with pytest.raises(ConfigError, match=r"bodies\[1\].*object_name: must be .* got 'dimorphos'; it has HERA; "
                       "write object_name = 'HERA' if it is the one that is meant"):
        scenario(tmp_path, craft, moon={"trajectory": {"kind": "oem", "file": "a.oem"}})
    aem(tmp_path, "EULER_ANGLE", [(30.0, 0.0, 0.0)] * 3, more="EULER_ROT_SEQ = 321\n")
    with pytest.raises(ConfigError, match="attitude.*got 'dimorphos'; it has CRAFT; write object_name = 'CRAFT' if"):
        scenario(tmp_path, craft, moon={"attitude": {"mode": "aem", "file": "a.aem"}})
    for key in ("object_name", "center_name"):
        with pytest.raises(ConfigError, match=f"trajectory.*{key}: must be a string that is not empty"):
            scenario(tmp_path, {"kind": "oem", "file": "a.oem", key: 7})


def at(attitude, t_s, start=START):
    q, rates = attitude.at(Geometry(start=start, t_s=np.asarray(t_s, float), r_m={}, v_m_s={}), "spacecraft")
    return frames.dcm(q), rates


def aem(folder, kind, rows, *, version="1.0", a="ICRF", b="SC_BODY_1", direction="A2B", more=""):
    """An AEM of rows of a minute; `rows` are texts or numbers."""
    lines = [row if isinstance(row, str) else f"2030-01-01T00:{k:02d}:00 " + " ".join(f"{x:.15g}" for x in row)
             for k, row in enumerate(rows)]
    (folder / "a.aem").write_text(AEM.format(
        version=version, a=a, b=b, kind=kind, more=more, rows="\n".join(lines),
        direction=f"ATTITUDE_DIR = {direction}\n" if direction else ""))
    return folder / "a.aem"


def test_the_standards_own_first_aem_is_read(tmp_path):
    """Two segments within their USEABLE times; frames of its quaternions by their definition."""
    (tmp_path / "mgs.aem").write_text(EXAMPLE)
    made = attitude_of_aem(tmp_path / "mgs.aem")
    for date, (x, y, z, w) in (("1996-11-28T22:08:03.5555", (0.42319, -0.45697, 0.23784, 0.74533)),
                               ("1996-12-18T12:10:10.5555", (0.03125, -0.65874, 0.23458, -0.71418))):
        matrix, _ = at(made, [0.0], Epoch.from_utc(date))
        # The frame is turned by the quaternion: its X axis, in EME2000, is the first row.
        first = np.array([w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)])
        np.testing.assert_allclose(matrix[0, 0], first / np.linalg.norm(first), atol=2e-5)
    for date in ("1996-11-28T22:08:02", "1996-11-30T01:19:00", "1996-12-18T12:06:00"):
        with pytest.raises(ConfigError, match="time: must be within the table: 1996-11-28T22:09:0.* TDB, 1996-12-18"):
            at(made, [0.0], Epoch.from_utc(date))


# A tumble: a frame from ICRF by Euler angles that are linear in time, and its rate by differences of its matrices.
SEQUENCE, BEGIN_DEG, SLOPE_DEG_S = "ZXZ", np.array([10.0, 25.0, -40.0]), np.array([0.05, -0.02, 1.5])


def tumble(t):
    """Components in the frame from ICRF (3, 3), by the textbook's product of three matrices."""
    matrix = np.eye(3)
    for axis, angle in zip(SEQUENCE, np.radians(BEGIN_DEG + SLOPE_DEG_S * t), strict=True):
        c, s = np.cos(angle), np.sin(angle)
        matrix = {"X": np.array([[1, 0, 0], [0, c, s], [0, -s, c]]), "Z": np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
                  }[axis] @ matrix
    return matrix


def tumble_rate(t, h=1e-4):
    """Of the frame, in it [rad/s]: the antisymmetric part of A (dA/dt)^T."""
    skew = tumble(t) @ ((tumble(t + h) - tumble(t - h)) / (2 * h)).T
    return np.array([skew[2, 1], skew[0, 2], skew[1, 0]])


def tumbling_rows(kind, times, rate_frame):
    """Rows of a type, of the tumble; a quaternion turns the frame, scalar last."""
    rows = []
    for t in times:
        # SciPy's rotation of the transposed matrix takes ICRF's axes to the frame's.
        q = lambda when: Rotation.from_matrix(tumble(when).T).as_quat()  # noqa: E731
        dq = q(t + 1e-4) - q(t - 1e-4)
        dq = (dq if np.abs(dq).max() < 0.1 else q(t + 1e-4) + q(t - 1e-4)) / 2e-4
        angles = BEGIN_DEG + SLOPE_DEG_S * t
        rate = np.degrees(tumble_rate(t) if rate_frame == "B" else tumble(t).T @ tumble_rate(t))
        rows.append({"QUATERNION": [*q(t)], "QUATERNION/DERIVATIVE": [*q(t), *dq], "QUATERNION/RATE": [*q(t), *rate],
                     "QUATERNION/ANGVEL": [*q(t), *rate], "EULER_ANGLE": [*angles],
                     "EULER_ANGLE/DERIVATIVE": [*angles, *SLOPE_DEG_S], "EULER_ANGLE/RATE": [*angles, *rate],
                     "EULER_ANGLE/ANGVEL": [*angles, *rate]}[kind])
    return rows


@pytest.mark.parametrize("rate_frame", ["A", "B"])
@pytest.mark.parametrize("version, kind", [
    ("1.0", "QUATERNION"), ("1.0", "QUATERNION/DERIVATIVE"), ("1.0", "QUATERNION/RATE"), ("1.0", "EULER_ANGLE"),
    ("1.0", "EULER_ANGLE/RATE"), ("2.0", "QUATERNION"), ("2.0", "QUATERNION/ANGVEL"), ("2.0", "quaternion/derivative"),
    ("2.0", "EULER_ANGLE"), ("2.0", "EULER_ANGLE/DERIVATIVE"), ("2.0", "Euler_Angle/AngVel")])
def test_every_type_of_aem_is_the_tumble_it_was_written_of(tmp_path, version, kind, rate_frame):
    """Rows a minute apart, a quarter of a turn: with rates to 0.1 deg between them, without to a tenth of the step."""
    more = "EULER_ROT_SEQ = " + (SEQUENCE if version == "2.0" else "313") + "\n"
    more += "QUATERNION_TYPE = last\n" if version == "1.0" else ""
    more += f"{'RATE_FRAME' if version == '1.0' else 'ANGVEL_FRAME'} = REF_FRAME_{rate_frame}\n"
    times = 60.0 * np.arange(6)
    made = attitude_of_aem(aem(tmp_path, kind, tumbling_rows(kind.upper(), times, rate_frame), version=version,
                               direction="" if version == "2.0" else "a2b", more=more))
    matrices, rates = at(made, times)
    np.testing.assert_allclose(matrices, [tumble(t) for t in times], atol=1e-9)
    t = np.linspace(0.0, 300.0, 51)
    matrices, rates_between = at(made, t)
    off = [np.degrees(np.linalg.norm(Rotation.from_matrix(m @ tumble(when).T).as_rotvec()))
           for m, when in zip(matrices, t, strict=True)]
    if "/" in kind:
        np.testing.assert_allclose(rates, [tumble_rate(when) for when in times], atol=1e-6)
        assert max(off) < 0.2
        # The rates are those of the attitudes that are given.
        ahead, _ = at(made, t[:-1] + 1e-3)
        differences = [Rotation.from_matrix(m @ n.T).as_rotvec() / 1e-3
                       for m, n in zip(matrices[:-1], ahead, strict=True)]
        np.testing.assert_allclose(rates_between[:-1], differences, atol=1e-5)
    else:
        assert max(off) < 9.0


def test_a_last_date_that_was_rounded_down_is_no_end_before_the_last_frame(tmp_path):
    """Dates of files have microseconds: 0.9 us after the last row is its time, 2 us are not."""
    track = trajectory_of_oem(oem(tmp_path), "rock")
    turned = attitude_of_aem(aem(tmp_path, "quaternion", [[0, 0, 0, 1], [0, 0, 0.1, 0.995]],
                                 more="QUATERNION_TYPE = LAST\n"))
    np.testing.assert_array_equal(track.at(START, np.array([3000.0]))[0], track.at(START, np.array([3000.0 + 9e-7]))[0])
    np.testing.assert_array_equal(at(turned, [60.0])[0], at(turned, [60.0 + 9e-7])[0])
    for there in (lambda: track.at(START, np.array([3000.0 + 2e-6])), lambda: at(turned, [60.0 + 2e-6])):
        with pytest.raises(ConfigError, match="must be within the table"):
            there()


def test_whole_turns_between_rows_count(tmp_path):
    """A spin of 4.2 turns a row by its rates; the short way back would be 0.2 turns."""
    rows = [(0.0, 0.0, np.sin(np.pi * 4.2 * k), np.cos(np.pi * 4.2 * k), 0.0, 0.0, 4.2 * 6.0) for k in range(4)]
    made = attitude_of_aem(aem(tmp_path, "QUATERNION/ANGVEL", rows, version="2.0", direction="",
                               more="ANGVEL_FRAME = SC_BODY_1\n"))
    matrices, rates = at(made, [30.0, 77.0])
    for matrix, t in zip(matrices, (30.0, 77.0), strict=True):
        angle = 2.0 * np.pi * 4.2 * t / 60.0
        np.testing.assert_allclose(matrix[0], [np.cos(angle), np.sin(angle), 0.0], atol=1e-9)
    np.testing.assert_allclose(rates, [[0.0, 0.0, 2.0 * np.pi * 4.2 / 60.0]] * 2, atol=1e-12)


def test_spins_are_about_their_axis(tmp_path):
    """Right ascension and declination of +Z, and 4.1 turns a row."""
    rows = [(40.0, 30.0, 20.0 + 360.0 * 4.1 * k, 4.1 * 6.0) for k in range(3)]
    matrices, rates = at(attitude_of_aem(aem(tmp_path, "SPIN", rows)), [0.0, 15.0, 100.0])
    c, s = np.cos(np.radians(40.0)), np.sin(np.radians(40.0))
    pole, node = np.array([np.sqrt(0.75) * c, np.sqrt(0.75) * s, 0.5]), np.array([-s, c, 0.0])
    np.testing.assert_allclose(matrices[:, 2], [pole] * 3, atol=1e-12)
    phase = np.radians(20.0 + 4.1 * 6.0 * np.array([0.0, 15.0, 100.0]))
    # X is turned by the phase from the node of the equator, as a body's prime meridian.
    np.testing.assert_allclose(matrices[:, 0], np.cos(phase)[:, None] * node + np.sin(phase)[:, None]
                               * np.cross(pole, node), atol=1e-9)
    np.testing.assert_allclose(rates, [[0.0, 0.0, np.radians(4.1 * 6.0)]] * 3, atol=1e-12)


@pytest.mark.parametrize("is_momentum", [False, True])
def test_a_nutating_spin_goes_from_row_to_row(tmp_path, is_momentum):
    """ST5's rows: from every other one the rates of spin and nutation lead to those between within 1e-3 deg.

    With the momentum's place of the same motion, found from the axes' cone, the rates are the same.
    """
    rows = [f"{day} {rest}" for day, rest in ST5]
    kind = "SPIN/NUTATION_MOM" if is_momentum else "SPIN/NUTATION"
    if is_momentum:
        numbers = np.array([[float(x) for x in rest.split()] for _, rest in ST5])
        nutation, speed = np.radians(numbers[0, 4]), 360.0 / numbers[0, 5]
        # In the frame of node, across and pole: the pole is off the momentum by the nutation.
        a, d, phase = np.radians([numbers[0, 0], numbers[0, 1], numbers[0, 2] - numbers[0, 6]])
        pole = np.array([np.cos(d) * np.cos(a), np.cos(d) * np.sin(a), np.sin(d)])
        node = np.array([-np.sin(a), np.cos(a), 0.0])
        side = np.cos(phase) * node + np.sin(phase) * np.cross(pole, node)
        momentum = np.cos(nutation) * pole + np.sin(nutation) * side
        place = f"{np.degrees(np.arctan2(momentum[1], momentum[0])):.9f} {np.degrees(np.arcsin(momentum[2])):.9f}"
        rows = [f"{day} {' '.join(rest.split()[:4])} {place} {speed:.9f}" for day, rest in ST5]
    whole = attitude_of_aem(aem(tmp_path, kind, rows))
    coarse = attitude_of_aem(aem(tmp_path, kind, [rows[0], rows[2]]))
    truth, rates = at(whole, [0.196])
    got, of_coarse = at(coarse, [0.196])
    assert np.degrees(Rotation.from_matrix(got[0] @ truth[0].T).magnitude()) < 1e-3
    np.testing.assert_allclose(of_coarse, rates, atol=1e-4)


@pytest.mark.parametrize("a, b, direction", [("ICRF", "SC_BODY_1", "B2A"), ("SC_BODY_1", "ICRF", "A2B"),
                                             ("SC_BODY", "j2000", "b2a"), ("icrf", "SC BODY 1", "A2B"),
                                             ("sc  body_1", "ICRF", "A2B"), ("Sc Body", "EME2000", "B2A")])
def test_either_frame_may_come_first(tmp_path, a, b, direction):
    """Attitude and rate are the spacecraft's: of quaternions and rates that turn to the inertial frame, or from it."""
    to_craft = (direction.upper() == "A2B") == (b.upper().startswith("SC"))
    turn, rows = np.radians(0.7), []
    for k in range(3):
        q = np.array([0.0, 0.0, np.sin(30.0 * turn * k), np.cos(30.0 * turn * k)])
        rows.append([*(q if to_craft else q * [-1, -1, -1, 1]), 0.0, 0.0, 0.7 if to_craft else -0.7])
    made = attitude_of_aem(aem(tmp_path, "QUATERNION/RATE", rows, a=a, b=b, direction=direction,
                               more="QUATERNION_TYPE = LAST\nRATE_FRAME = REF_FRAME_A\n"))
    matrices, rates = at(made, [45.0])
    np.testing.assert_allclose(matrices[0, 0], [np.cos(45.0 * turn), np.sin(45.0 * turn), 0.0], atol=1e-12)
    np.testing.assert_allclose(rates, [[0.0, 0.0, turn]], atol=1e-12)


Q = [(0.0, 0.0, 0.0, 1.0)] * 2


@pytest.mark.parametrize("kind, rows, options, message", [
    ("QUATERNION", Q, {}, "QUATERNION_TYPE: must be one of FIRST, LAST, got None; version 1 must have it: add "
     "QUATERNION_TYPE = LAST where the scalar is"),
    ("QUATERNION", Q, {"direction": ""}, "ATTITUDE_DIR: must be one of A2B, B2A, got None; version 1 must have it: add "
     "ATTITUDE_DIR = A2B where the rows turn from REF_FRAME_A to"),
    ("QUATERNION", Q, {"version": "2.0", "direction": "B2A"}, "ATTITUDE_DIR: must be one of A2B, got 'B2A'; version 2 "
     "has this direction alone: where the rows turn from REF_FRAME_B to REF_FRAME_A, exchange what"),
    ("QUATERNION", Q, {"version": "2.0", "more": "QUATERNION_TYPE = FIRST\n"}, "QUATERNION_TYPE: must be one of LAST, "
     "got 'FIRST'; version 2 has the scalar last"),
    ("QUATERNIONS", Q, {}, "ATTITUDE_TYPE: must be one of QUATERNION, QUATERNION/DERIVATIVE"),
    ("QUATERNION/ANGVEL", [(0, 0, 0, 1.0, 0, 0, 1.0)] * 2, {"version": "2.0"}, "ANGVEL_FRAME: must be the frame of"),
    ("EULER_ANGLE", [(0, 0, 0)] * 2, {}, "EULER_ROT_SEQ: must be three of X, Y, Z or 1, 2, 3, neighbours not the same"),
    ("EULER_ANGLE", [(0, 0, 0)] * 2, {"more": "EULER_ROT_SEQ = 7051995\n"}, "EULER_ROT_SEQ: must be three of X, Y, Z"),
    ("QUATERNION", Q, {"a": "ITRF-93"}, "REF_FRAME_A: or REF_FRAME_B must be one of ICRF"),
    ("QUATERNION", Q, {"b": "STARTRACKER_1"}, "REF_FRAME_B: must be SC_BODY_1 or another SC_BODY, got 'STARTRACKER_1'; "
     "write frame = 'STARTRACKER_1'"),
    ("QUATERNION", Q, {"more": "QUATERNION_TYPE = LAST\nWRONG_KEYWORD = 1\n"}, "line 15: has a keyword that is not"),
    ("QUATERNION", [(0.9, 0, 0, 0)] * 2, {"more": "QUATERNION_TYPE = LAST\n"}, "line 17: must have a quaternion of"),
    ("SPIN", Q, {"more": "USEABLE_STOP_TIME = 2029-01-01T00:00:00\n"}, "USEABLE_START_TIME: must be before"),
    ("SPIN", Q, {"more": "USEABLE_START_TIME = 2030-001T00:01:00\n"}, "USEABLE_START_TIME: must be before USEABLE"),
    ("SPIN/NUTATION", [(0, 0, 0, 1.0, 2.0, 0, 0)] * 2, {}, "line 16: must have a nutation period"),
    ("SPIN", [(0, 0, 0, 100.0), (0, 0, 130.0, 100.0)], {}, "line 17: must be where the rates lead within 90 deg from"),
])
def test_what_an_aem_says_is_used_or_refused_with_its_line(tmp_path, kind, rows, options, message):
    with pytest.raises(ConfigError) as caught:
        attitude_of_aem(aem(tmp_path, kind, rows, **options))
    assert str(caught.value).startswith("a.aem.") and message in str(caught.value)


def test_an_aem_is_of_its_object_and_frame(tmp_path):
    """In a scenario: a body's file does not turn the spacecraft; a tracker's frame is taken where it is asked for."""
    oem(tmp_path, center="DIDYMOS")
    aem(tmp_path, "EULER_ANGLE", [(30.0, 0.0, 0.0)] * 3, b="INSTRUMENT_1", more="EULER_ROT_SEQ = 321\n")
    table = {"bodies": [{"name": "didymos", "generated": {"kind": "icosphere", "radius_m": 300.0, "subdivisions": 1},
                         "brdf": {"law": "lambert", "normal_albedo": 0.1}}],
             "cameras": [{"name": "c", "width_px": 64, "height_px": 64, "focal_length_px": 64.0}],
             "sun": {"r_m": [1.5e11, 0.0, 0.0]}, "trajectory": {"kind": "oem", "file": "a.oem"},
             "attitude": {"mode": "aem", "file": "a.aem", "frame": "instrument 1"},
             "time": {"start_tdb": "2030-01-01T00:00:00", "times_s": [60.0]}}
    (state,) = scenario_of_table(table, folder=tmp_path).states()
    np.testing.assert_allclose(frames.dcm(state.spacecraft.q_from_inertial)[0], [np.sqrt(0.75), 0.5, 0.0], atol=1e-12)
    table["attitude"]["frame"] = "SC_BODY_1"
    with pytest.raises(ConfigError, match="attitude.a.aem.REF_FRAME_B: must be 'SC_BODY_1', the frame that is asked"):
        scenario_of_table(table, folder=tmp_path)
    path = tmp_path / "a.aem"
    path.write_text(path.read_text().replace("CRAFT", "DIDYMOS").replace("INSTRUMENT_1", "DIDYMOS_FIXED"))
    del table["attitude"]["frame"]
    with pytest.raises(ConfigError, match="attitude.a.aem.OBJECT_NAME: must not be another body's, got 'DIDYMOS'"):
        scenario_of_table(table, folder=tmp_path)
    table["bodies"][0]["attitude"] = table.pop("attitude")
    (state,) = scenario_of_table(table, folder=tmp_path).states()
    np.testing.assert_allclose(frames.dcm(state.bodies["didymos"].q_from_inertial)[0], [np.sqrt(0.75), 0.5, 0.0],
                               atol=1e-12)
