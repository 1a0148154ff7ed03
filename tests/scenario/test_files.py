"""Tables, CSV files, and CCSDS messages."""

from __future__ import annotations

import importlib
import sys
from datetime import UTC, datetime

import numpy as np
import orbits
import pytest
from glrender import ConfigError, frames
from glrender.scenario import (
    AttitudeTable,
    Epoch,
    Geometry,
    TrajectoryTable,
    attitude_of_aem,
    attitude_of_csv,
    attitude_of_parquet,
    scenario_of_table,
    trajectory_of_csv,
    trajectory_of_oem,
    trajectory_of_parquet,
)
from missing import needed_module
from orbits import DATE
from scipy.spatial.transform import Rotation

OEM = """CCSDS_OEM_VERS = 2.0
CREATION_DATE = 2022-10-01T00:00:00
ORIGINATOR = TEST
META_START
OBJECT_NAME = CRAFT
OBJECT_ID = 2022-001A
CENTER_NAME = DIDYMOS
REF_FRAME = EME2000
TIME_SYSTEM = {scale}
START_TIME = 2022-10-11T00:00:00
STOP_TIME = 2022-10-11T01:00:00
META_STOP
COMMENT  rows every five minutes
{rows}
COVARIANCE_START
EPOCH = 2022-10-11T00:00:00
1.0
COVARIANCE_STOP
"""
AEM = """CCSDS_AEM_VERS = 1.0
CREATION_DATE = 2022-10-01T00:00:00
ORIGINATOR = TEST
META_START
OBJECT_NAME = CRAFT
OBJECT_ID = 2022-001A
REF_FRAME_A = {a}
REF_FRAME_B = {b}
ATTITUDE_DIR = {direction}
TIME_SYSTEM = TDB
START_TIME = 2022-10-11T00:00:00
STOP_TIME = 2022-10-11T00:10:00
ATTITUDE_TYPE = QUATERNION
QUATERNION_TYPE = {order}
META_STOP
DATA_START
{rows}
DATA_STOP
"""
CRAFT = Rotation.from_euler("xyz", [[10.0, 20.0, 30.0], [11.0, 22.0, 33.0]], degrees=True)
"""Of the spacecraft's axes in inertial: takes components in the spacecraft's frame to inertial ones."""


def orbit_rows(epoch=DATE, step_s=300.0, count=13):
    """Times [s], positions [m] and velocities [m/s] of a Kepler orbit about a small body."""
    times = step_s * np.arange(count)
    return times, *orbits.small_orbit().at(epoch, times)


def oem(folder, scale="TDB", **more):
    times, r, v = orbit_rows(**more)
    rows = "\n".join(f"{DATE.after(t).tdb} " + " ".join(f"{x:.12f}" for x in np.concatenate([a, b]) / 1e3)
                     for t, a, b in zip(times, r, v, strict=True))
    (folder / "craft.oem").write_text(OEM.format(scale=scale, rows=rows))
    return folder / "craft.oem"


@pytest.mark.parametrize("with_velocity", [True, False])
def test_a_table_is_good_to_the_eighth_power(with_velocity):
    """Rows twice as dense, 2^8 times as exact, but for rounding; velocities a power less."""
    t, off = np.linspace(700.0, 2900.0, 57), []
    for step in (600.0, 300.0):
        times, r, v = orbit_rows(step_s=step, count=int(3600 / step) + 1)
        table = TrajectoryTable(times_s=times, r_m=r, v_m_s=v if with_velocity else None, about="b", epoch=DATE)
        got, truth = table.at(DATE, t), orbits.small_orbit().at(DATE, t)
        off.append([np.abs(a - b).max() for a, b in zip(got, truth, strict=True)])
    assert off[0][0] / off[1][0] > (100.0 if with_velocity else 30.0) and off[1][0] < 1e-3 and off[1][1] < 1e-5


def test_an_oem_is_the_orbit_it_was_written_of(tmp_path):
    """To 1 mm between its rows, five minutes apart; its epochs count, not the scenario's start."""
    path = trajectory_of_oem(oem(tmp_path), "didymos")
    t = np.linspace(0.0, 3500.0, 71)
    r, v = path.at(DATE.after(50.0), t)
    truth = orbits.small_orbit().at(DATE.after(50.0), t)
    np.testing.assert_allclose(r, truth[0], atol=1e-3)
    np.testing.assert_allclose(v, truth[1], atol=1e-5)
    assert path.about == "didymos"


def test_time_systems_of_an_oem(tmp_path):
    """The same dates in UTC are 69.184 s later: 37 leap seconds and 32.184 s."""
    tdb, utc = (trajectory_of_oem(oem(tmp_path, scale=scale), "didymos").epoch for scale in ("TDB", "UTC"))
    np.testing.assert_allclose(utc - tdb, 69.184, atol=2e-3)


def test_segments_follow_each_other(tmp_path):
    text = oem(tmp_path).read_text()
    late = text.replace("2022-10-11", "2022-10-12")
    (tmp_path / "two.oem").write_text(text + late[late.index("META_START"):])
    path = trajectory_of_oem(tmp_path / "two.oem", "didymos")
    r, _ = path.at(DATE, np.array([100.0, 86500.0]))
    np.testing.assert_allclose(r[0], r[1], atol=1e-9)
    with pytest.raises(ConfigError, match="time: must be in a segment of the table: 2022-10-11T00:00:00.000000 TDB to"):
        path.at(DATE, np.array([40000.0]))


def test_days_of_the_year_are_read(tmp_path):
    (tmp_path / "doy.oem").write_text(oem(tmp_path).read_text().replace("2022-10-11T", "2022-284T"))
    assert trajectory_of_oem(tmp_path / "doy.oem", "didymos").epoch == DATE


@pytest.mark.parametrize("old, new, message", [
    ("EME2000", "ITRF2000", "craft.oem.REF_FRAME: must be one of ICRF"),
    ("TIME_SYSTEM = TDB", "TIME_SYSTEM = GPS", "craft.oem.TIME_SYSTEM: must be one of TDB, UTC, TT, TAI, got 'GPS'"),
    ("CCSDS_OEM_VERS = 2.0", "CCSDS_OPM_VERS = 2.0", "craft.oem: must have CCSDS_OEM_VERS"),
    ("2022-10-11T00:05:00.000000 ", "2022-10-11T00:05:00.000000 x ", "craft.oem.line 15: must be an epoch and numbers"),
    ("2022-10-11T00:05:00.000000 ", "2022-10-11T00:05:00.000000 1 ", "craft.oem.line 15: must have 6 or 9 numbers"),
    ("2022-10-11T00:05:00.000000 ", "2022-10-10T00:05:00.000000 ", "craft.oem.line 15: must be later than the row"),
])
def test_a_wrong_oem_is_told_by_its_line(tmp_path, old, new, message):
    path = oem(tmp_path)
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(ConfigError) as caught:
        trajectory_of_oem(path, "didymos")
    assert message in str(caught.value)


def test_xml_and_other_objects_are_told(tmp_path):
    path = oem(tmp_path)
    with pytest.raises(ConfigError, match="object_name: must be one of those in craft.oem, got 'MOON'; it has CRAFT"):
        trajectory_of_oem(path, "didymos", "MOON")
    path.write_text("<?xml version='1.0'?>")
    with pytest.raises(ConfigError, match="is XML; only keyword = value notation is read"):
        trajectory_of_oem(path, "didymos")
    with pytest.raises(ConfigError, match="none.oem: cannot be read"):
        trajectory_of_oem(tmp_path / "none.oem", "didymos")


@pytest.mark.parametrize("order", ["LAST", "FIRST"])
@pytest.mark.parametrize("a, b, direction", [("ICRF", "SC_BODY_1", "A2B"), ("SC_BODY_1", "ICRF", "B2A"),
                                             ("SC_BODY_1", "ICRF", "A2B"), ("ICRF", "SC_BODY_1", "B2A")])
def test_an_aem_is_the_attitude_it_was_written_of(tmp_path, a, b, direction, order):
    """CCSDS: the quaternion turns frames, from the first to the second; scalar last or first."""
    to_craft = (direction == "A2B") == (a == "ICRF")
    # A frame is turned from inertial by the rotation that has the spacecraft's axes.
    turns = CRAFT if to_craft else CRAFT.inv()
    rows = "\n".join(f"2022-10-11T00:{10 * k:02d}:00 " + " ".join(f"{x:.15f}" for x in q)
                     for k, q in enumerate(turns.as_quat(scalar_first=order == "FIRST")))
    (tmp_path / "craft.aem").write_text(AEM.format(a=a, b=b, direction=direction, order=order, rows=rows))
    made = attitude_of_aem(tmp_path / "craft.aem")
    q, rates = made.at(Geometry(start=DATE, t_s=np.array([0.0, 300.0, 600.0]), r_m={}, v_m_s={}), "spacecraft")
    for index in (0, 1):
        np.testing.assert_allclose(frames.dcm(q[2 * index]).T, CRAFT[index].as_matrix(), atol=1e-12)
    whole = (CRAFT[0].inv() * CRAFT[1]).as_rotvec()
    halfway = CRAFT[0] * Rotation.from_rotvec(0.5 * whole)
    np.testing.assert_allclose(frames.dcm(q[1]).T, halfway.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(rates, np.tile(whole / 600.0, (3, 1)), atol=1e-15)


def test_an_aem_of_two_inertial_frames_is_refused(tmp_path):
    (tmp_path / "x.aem").write_text(AEM.format(a="ICRF", b="EME2000", direction="A2B", order="LAST", rows=""))
    with pytest.raises(ConfigError, match="REF_FRAME_A: or REF_FRAME_B must be one of ICRF"):
        attitude_of_aem(tmp_path / "x.aem")


def save_parquet(path, columns):
    arrow = needed_module("pyarrow", "pip install -e '.[test]'")
    importlib.import_module("pyarrow.parquet").write_table(arrow.table(columns), path)


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_state_files_in_a_scenario_file(tmp_path, kind):
    """One file of both, by epochs: positions, velocities and attitudes as in its rows."""
    times, r, v = orbit_rows()
    q = Rotation.from_rotvec(1e-3 * times[:, None] * [0.0, 0.6, 0.8]).as_quat(scalar_first=True)
    rows = [f"{DATE.after(t).tdb}," + ",".join(map(repr, np.concatenate([*parts]).tolist()))
            for t, *parts in zip(times, r, v, q, strict=True)]
    head = "epoch_tdb,r_x_m,r_y_m,r_z_m,v_x_m_s,v_y_m_s,v_z_m_s,q_w,q_x,q_y,q_z"
    (tmp_path / "states.csv").write_text("\n".join([head, *rows]))
    if kind == "parquet":
        columns = dict(zip(head.split(","), zip(*(row.split(",") for row in rows), strict=True), strict=True))
        save_parquet(tmp_path / "states.parquet", {
            name: list(cells) if name == "epoch_tdb" else [float(cell) for cell in cells]
            for name, cells in columns.items()})
    table = {"bodies": [{"name": "b", "generated": {"kind": "icosphere", "radius_m": 100.0, "subdivisions": 1},
                         "brdf": {"law": "lambert", "normal_albedo": 0.1}}],
             "cameras": [{"name": "c", "width_px": 64, "height_px": 64, "focal_length_px": 64.0}],
             "sun": {"r_m": [1.5e11, 0.0, 0.0]}, "trajectory": {"kind": kind, "file": f"states.{kind}"},
             "attitude": {"mode": kind, "file": f"states.{kind}"},
             "time": {"start_tdb": "2022-10-11T00:00:00", "times_s": times.tolist()}}
    states = scenario_of_table(table, folder=tmp_path).states()
    np.testing.assert_allclose([state.spacecraft.r_inertial_m for state in states], r, atol=1e-6)
    np.testing.assert_allclose([state.spacecraft.v_inertial_m_s for state in states], v, atol=1e-9)
    got = np.array([state.spacecraft.q_from_inertial for state in states])
    np.testing.assert_allclose(np.abs(np.einsum("ij,ij->i", got, q)), 1.0, atol=1e-12)
    np.testing.assert_allclose([state.spacecraft.angular_velocity_rad_s for state in states],
                               np.tile([0.0, -6e-4, -8e-4], (len(times), 1)), atol=1e-12)
    table["time"] = {"start_tdb": "2022-10-11T00:00:00", "times_s": [3601.0]}
    with pytest.raises(ConfigError, match="trajectories.spacecraft.time: must be within the table: 2022-10-11T"):
        scenario_of_table(table, folder=tmp_path).states()


@pytest.mark.parametrize("text, message", [
    ("t_s,r_x_m,r_y_m,r_z_m\n0,1,2,3\n", "t.csv: must have column names and at least two rows"),
    ("r_x_m,r_y_m,r_z_m\n1,2,3\n1,2,3\n", "t.csv: must have exactly one column of times"),
    ("t_s,r_x_m,r_y_m\n0,1,2\n1,2,3\n", "t.csv.r_z_m: missing"),
    ("t_s,r_x_m,r_y_m,r_z_m,mass\n0,1,2,3,4\n1,2,3,4,5\n", "t.csv.mass: unknown column"),
    ("t_s,r_x_m,r_y_m,r_z_m\n0,1,2,3\n1,2,three,4\n", "t.csv:3.r_y_m: must be a number, got 'three'"),
    ("t_s,r_x_m,r_y_m,r_z_m\n0,1,2,3\n0,2,3,4\n", "times_s[1]: must be later than the one before, got 0.0"),
    ("t_s,r_x_m,r_y_m,r_z_m\n0,1,2,3\n\n1,2,3,4,5\n", "t.csv:4: must have 4 cells, one a column, got 5; decimals"),
    ("t_s,r_x_m,r_y_m,r_z_m\n0,1,5,2,3\n1,2,5,3,4\n", "t.csv:2: must have 4 cells, one a column, got 5; decimals"),
    ("t_s,r_x_m,r_y_m,r_z_m\n0,1,2,3\n1,2,3\n", "t.csv:3: must have 4 cells, one a column, got 3"),
    ("t_s,r_x_m,r_y_m,r_z_m,r_x_m\n0,1,2,3,4\n1,2,3,4,5\n", "t.csv:1: must name each column once, got 'r_x_m'"),
    ("t_s,r_x_m,r_y_m,r_z_m,\n0,1,2,3,4\n1,2,3,4,5\n", "t.csv:1: must name each column once, got ''"),
    ("t_s,r_x_m,r_y_m,r_z_m,v_x_m_s\n0,1,2,3,4\n1,2,3,4,5\n", "t.csv.v_y_m_s: missing"),
    ("\nt_s,r_x_m,r_y_m,r_z_m\n0,1,2,3\n,,,\n1,2,three,4\n", "t.csv:5.r_y_m: must be a number, got 'three'"),
    ("epoch_utc,r_x_m,r_y_m,r_z_m\n2022-01-01,1,2,3\nsoon,2,3,4\n", "epoch_utc: must be a date"),
])
def test_a_wrong_csv_is_told_by_line_and_column(tmp_path, text, message):
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(ConfigError) as caught:
        trajectory_of_csv(tmp_path / "t.csv", "b")
    assert message in str(caught.value)


def test_a_csv_of_attitudes_counts_from_the_start(tmp_path):
    (tmp_path / "q.csv").write_text("t_s,q_w,q_x,q_y,q_z\n0,1,0,0,0\n10,0.70710678,0,0,0.70710678\n20,0,0,0,-1\n")
    made = attitude_of_csv(tmp_path / "q.csv")
    assert isinstance(made, AttitudeTable) and made.epoch is None
    q, rates = made.at(Geometry(start=Epoch(7), t_s=np.array([5.0, 15.0]), r_m={}, v_m_s={}), "b")
    np.testing.assert_allclose(rates, np.tile([0.0, 0.0, -np.pi / 20.0], (2, 1)), atol=1e-8)
    np.testing.assert_allclose(q[0], [np.cos(np.pi / 8), 0.0, 0.0, np.sin(np.pi / 8)], atol=1e-8)


def test_timestamps_of_a_parquet_file_keep_their_nanoseconds(tmp_path):
    """Rows 3 ns apart in their fractions, as epoch_tdb without a zone or as epoch_utc with it, and texts."""
    places = {"r_x_m": [0.0, 1.0, 2.0], "r_y_m": [0, 0, 0], "r_z_m": [5.0, 5.0, 5.0]}
    stamps = np.array(["2022-10-11T00:00:00.000000001", "2022-10-11T00:00:01.000000004",
                       "2022-10-11T00:00:02.000000007"], "datetime64[ns]")
    save_parquet(tmp_path / "t.parquet", {"epoch_tdb": stamps, **places})
    made = trajectory_of_parquet(tmp_path / "t.parquet", "b")
    np.testing.assert_allclose(made.times_s, [0.0, 1.000000003, 2.000000006], atol=1e-15)
    assert made.epoch == Epoch.from_tdb("2022-10-11T00:00:00.000000001")
    save_parquet(tmp_path / "t.parquet",
                 {"epoch_utc": [datetime(2022, 10, 11, 0, 0, k, tzinfo=UTC) for k in range(3)], **places})
    made = trajectory_of_parquet(tmp_path / "t.parquet", "b")
    assert made.epoch == Epoch.from_utc("2022-10-11T00:00:00")
    save_parquet(tmp_path / "q.parquet", {"t_s": [0, 1], "q_w": [1.0, 1.0], "q_x": [0.0, 0.0], "q_y": [0.0, 0.0],
                                          "q_z": [0.0, 0.0]})
    assert attitude_of_parquet(tmp_path / "q.parquet").epoch is None


@pytest.mark.parametrize("columns, message", [
    ({"t_s": [0.0, 1.0], "r_x_m": [1.0, None], "r_y_m": [1.0, 2.0], "r_z_m": [0.0, 0.0]},
     "t.parquet:1.r_x_m: must be a number, got None"),
    ({"t_s": [0.0, 1.0], "r_x_m": [1.0, 2.0], "r_y_m": [1.0, 2.0]}, "t.parquet.r_z_m: missing"),
    ({"epoch_tdb": [datetime(2022, 1, 1, tzinfo=UTC)] * 2}, "t.parquet.epoch_tdb: must be timestamps without a zone"),
    ({"t_s": [0.0, 1.0], "__index_level_0__": [0, 1]}, "t.parquet.__index_level_0__: unknown column"),
    ({"t_s": [0.0, 1.0], "r_x_m": [1.0, 2.0], "r_y_m": [1.0, 2.0], "r_z_m": [1.0, 2.0], "v_x_m_s": [0.0, 0.0]},
     "t.parquet.v_y_m_s: missing"),
    ({"t_s": []}, "t.parquet: must have column names and at least two rows"),
])
def test_a_wrong_parquet_is_told_by_row_and_column(tmp_path, columns, message):
    save_parquet(tmp_path / "t.parquet", columns)
    with pytest.raises(ConfigError) as caught:
        trajectory_of_parquet(tmp_path / "t.parquet", "b")
    assert message in str(caught.value)


def test_what_is_no_parquet_is_told(tmp_path, monkeypatch):
    needed_module("pyarrow", "pip install -e '.[test]'")
    (tmp_path / "t.parquet").write_text("t_s,r_x_m")
    with pytest.raises(ConfigError, match="t.parquet: is no Parquet file"):
        trajectory_of_parquet(tmp_path / "t.parquet", "b")
    with pytest.raises(ConfigError, match="no.parquet: cannot be read"):
        trajectory_of_parquet(tmp_path / "no.parquet", "b")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ConfigError, match=r"t.parquet: needs pyarrow: .*; pip install 'glrender\[parquet\]'"):
        trajectory_of_parquet(tmp_path / "t.parquet", "b")
