"""Files of other tools: kernels read by SPICE itself, CCSDS's messages and ISDs by lines of this test."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from glrender import ConfigError, PinholeCamera, Pose, State
from glrender.base.constants import AU_M
from glrender.scenario.exports.exports import EXPORTS, exports_of, refuse_others
from glrender.scenario.exports.flight import Flight, in_capitals
from glrender_camera import BrownConrady
from missing import needed_module
from scipy.spatial.transform import Rotation

# Velocity [m/s] of the pair of bodies about the Sun, to which all velocities are relative.
V_SUN = np.array([1.2e4, -2.7e4, 3.1e3])
CAMERA = PinholeCamera(name="Nav cam", width_px=200, height_px=100, focal_length_px=900.0,
                       principal_point_px=(80.0, 60.0),
                       q_camera_from_spacecraft=Rotation.from_rotvec([0.3, -0.5, 0.2]).as_quat(scalar_first=True),
                       r_camera_spacecraft_m=[1.0, -2.0, 0.5])
LEAP_SECONDS = Path(__file__).parents[1] / "data" / "kernels" / "naif0012.tls"
IDS = {"Orbiter": -64, "rock": 2101955}


def made(index, has_rates=True):
    """A state in irregular steps: each frame turns at a rate of its own."""
    t_s = 10.0 * index + 0.25 * index**2 + 1e-6 * index
    rates = {"probe": [1e-3, -2e-3, 5e-4], "rock": [0.0, 2e-4, 3e-4], "moon": [-1e-4, 0.0, 2e-4]}

    def pose(name, r0, v, start):
        frame = Rotation.from_rotvec(-np.array(rates[name]) * t_s) * Rotation.from_rotvec(start)
        extra = {"angular_velocity_rad_s": rates[name]} if has_rates else {}
        return Pose(r_inertial_m=np.array(r0) + np.array(v) * t_s, v_inertial_m_s=V_SUN + v,
                    q_from_inertial=frame.as_quat(scalar_first=True), **extra)

    date = np.datetime64("2029-02-13T12:00:00.123456") + np.timedelta64(round(t_s * 1e6), "us")
    return State(t_s=t_s, date_tdb=str(date), r_sun_inertial_m=np.array([AU_M, 2e10, -3e9]) - V_SUN * t_s,
                 spacecraft=pose("probe", [100.0, 2000.0, -5000.0], [0.1, -0.3, 2.0], [0.4, 1.0, -2.0]),
                 bodies={"rock": pose("rock", [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.2, 0.1]),
                         "moon": pose("moon", [900.0, -300.0, 50.0], [0.0, 0.2, 0.1], [0.0, 2.0, 0.0])})


def flight(n=5, **changes):
    states = [made(index, changes.pop("has_rates", True)) for index in range(n)]
    return Flight(**{"states": states, "camera": CAMERA, "radii_m": {"rock": 200.0, "moon": 60.0},
                     "spacecraft": "Orbiter", "ids": IDS} | changes)


def quaternion_matrix(w, x, y, z):
    """Components in b of a vector of a, v_b = q v_a q*, written out."""
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])


@pytest.fixture(scope="module")
def spice(tmp_path_factory):
    """SPICE with the kernels of a flight, in a pool that is empty before and behind."""
    tool, folder = needed_module("spiceypy", "pip install -e '.[test]'"), tmp_path_factory.mktemp("kernels")
    files = exports_of(flight(), ("spk", "ck"))
    tool.kclear()
    tool.furnsh(str(LEAP_SECONDS))
    for name, content in files.items():
        (folder / name).write_bytes(content)
        tool.furnsh(str(folder / name))
    yield tool
    tool.kclear()


def et_of(state):
    """SPICE's ET of a date in TDB: seconds past J2000 noon."""
    return (datetime.fromisoformat(state.date_tdb) - datetime(2000, 1, 1, 12)).total_seconds()


def test_spice_has_the_places_and_attitudes_of_the_states(spice):
    """At each date, by names: places to 1e-9 of the distance, attitudes and rates to 1e-9; a date to a microsecond."""
    for state in flight().states:
        et = et_of(state)
        assert abs(spice.str2et(f"{state.date_tdb.replace('T', ' ')} TDB") - et) < 1e-6
        craft, rock, moon = state.spacecraft, state.bodies["rock"], state.bodies["moon"]
        for target, pose, observer, other in (("ORBITER", craft, "ROCK", rock), ("MOON_OF", moon, "ROCK", rock)):
            code = {"ORBITER": "-64", "ROCK": "2101955", "MOON_OF": str(spice.bodn2c("MOON"))}
            found, _ = spice.spkezr(code[target], et, "J2000", "NONE", code[observer])
            true = np.hstack([pose.r_inertial_m - other.r_inertial_m, pose.v_inertial_m_s - other.v_inertial_m_s])
            np.testing.assert_allclose(1e3 * found, true, rtol=1e-9, atol=1e-9 * 5e3)
        sun, _ = spice.spkezr("SUN", et, "J2000", "NONE", "ROCK")
        true = np.hstack([state.r_sun_inertial_m - rock.r_inertial_m, -rock.v_inertial_m_s])
        np.testing.assert_allclose(1e3 * sun, true, rtol=1e-9)
        for frame, pose in (("ORBITER_BODY", craft), ("ROCK_FIXED", rock), ("MOON_FIXED", moon)):
            turned, rate = spice.xf2rav(spice.sxform("J2000", frame, et))
            np.testing.assert_allclose(turned, quaternion_matrix(*pose.q_from_inertial), atol=1e-9)
            np.testing.assert_allclose(turned @ rate, pose.angular_velocity_rad_s, atol=1e-9)


def test_spice_sees_a_point_in_the_pixel_where_the_camera_has_it(spice):
    """Down the chain body, spacecraft's place, mounting, arm, and the kernel's focal length, pixels and centre."""
    state, point = flight().states[2], np.array([120.0, -60.0, 80.0])
    et, code = et_of(state), spice.bods2c("NAV_CAM")
    place, _ = spice.spkpos("NAV_CAM", et, "J2000", "NONE", "ROCK")
    seen = spice.pxform("J2000", "NAV_CAM", et) @ (spice.pxform("ROCK_FIXED", "J2000", et) @ (1e-3 * point) - place)
    scale = spice.gdpool(f"INS{code}_FOCAL_LENGTH", 0, 1) / (1e-3 * spice.gdpool(f"INS{code}_PIXEL_SIZE", 0, 2))
    by_spice = spice.gdpool(f"INS{code}_CCD_CENTER", 0, 2) + scale * seen[:2] / seen[2]
    to_rock, to_craft, to_camera = (quaternion_matrix(*q) for q in (
        state.bodies["rock"].q_from_inertial, state.spacecraft.q_from_inertial, CAMERA.q_camera_from_spacecraft))
    r = to_craft @ (to_rock.T @ point - state.spacecraft.r_inertial_m) - CAMERA.r_camera_spacecraft_m
    x, y, z = to_camera @ r
    np.testing.assert_allclose(by_spice, [80.0 + 900.0 * x / z, 60.0 + 900.0 * y / z], atol=1e-6)
    shape, frame, boresight, _, corners = spice.getfov(code, 10)
    assert (shape, frame, boresight.tolist()) == ("POLYGON", "NAV_CAM", [0.0, 0.0, 1.0])
    edges = [80.0, 60.0] + 900.0 * corners[:, :2] / corners[:, 2:]
    np.testing.assert_allclose(edges, [[-0.5, -0.5], [199.5, -0.5], [199.5, 99.5], [-0.5, 99.5]], atol=1e-9)


def test_keywords_of_long_numbers_have_spices_32_characters():
    for name, text in exports_of(flight(ids={"Orbiter": -2_000_000}), ["ck"]).items():
        if name != "frames.bc":
            assert max(len(line.split()[0]) for line in text.decode().splitlines() if "= (" in line) <= 32


def test_the_clock_counts_microseconds_of_tdb(spice):
    et = et_of(flight().states[0])
    ticks = spice.sce2c(-64, et)
    assert spice.sct2e(-64, ticks + 1.0) - et == pytest.approx(1e-6, abs=3e-7)
    assert spice.sct2e(-64, ticks) == et


def test_the_earth_has_a_frame_that_spice_does_not_take_for_its_own(spice, tmp_path):
    """SPICE has names of frames built in, which kernels do not replace: EARTH_FIXED is one of them."""
    states = [replace(made(i), bodies={"Earth": made(i).bodies["rock"]}) for i in range(2)]
    kernels = exports_of(flight(states=states, radii_m={"Earth": 6.4e6}, ids={"Orbiter": -65}), ["ck"])
    for name, content in kernels.items():
        (tmp_path / name).write_bytes(content)
        spice.furnsh(str(tmp_path / name))
    turned = spice.pxform("J2000", spice.cnmfrm("EARTH")[1], et_of(states[1]))
    for name in kernels:
        spice.unload(str(tmp_path / name))
    np.testing.assert_allclose(turned, quaternion_matrix(*states[1].bodies["Earth"].q_from_inertial), atol=1e-9)


def test_a_fast_spin_is_not_taken_for_a_slow_one(tmp_path):
    """Rows that a body turns more than a quarter of a turn between are single: SPICE refuses times between them."""
    tool = needed_module("spiceypy", "pip install -e '.[test]'")
    states = [made(index) for index in range(3)]
    for state in states:
        object.__setattr__(state.bodies["rock"], "angular_velocity_rad_s", np.array([0.0, 0.0, 0.7]))
    (tmp_path / "a.bc").write_bytes(exports_of(flight(states=states), ["ck"])["frames.bc"])
    starts = {}
    for frame in (-64000, -64101):
        window = tool.ckcov(str(tmp_path / "a.bc"), frame, False, "INTERVAL", 0.0, "SCLK", tool.cell_double(100))
        starts[frame] = tool.wncard(window)
    assert starts == {-64000: 1, -64101: 3}


def messages(text):
    """The standard's lines: keywords of each segment, and rows of a date and numbers."""
    segments, block = [], "header"
    for line in filter(None, map(str.strip, text.splitlines())):
        if line in ("META_START", "META_STOP", "DATA_START", "DATA_STOP"):
            block = {"META_START": "meta", "META_STOP": "data"}.get(line, block)
            segments += [({}, [])] if line == "META_START" else []
        elif block == "meta":
            key, value = line.split(" = ")
            segments[-1][0][key] = value
        elif block == "data" and not line.startswith("COMMENT"):
            segments[-1][1].append(line.split())
    return segments


def test_an_oem_has_kilometres_about_the_first_body_in_tdb():
    text = exports_of(flight(), ["oem"])["frames.oem"].decode()
    header = text.partition("\n\nMETA_START\n")[0].splitlines()
    # 502.0-B-3, table 5-2: comments of the header stand only right behind the version.
    assert [line.split()[0] for line in header] == [
        "CCSDS_OEM_VERS", "COMMENT", "COMMENT", "CREATION_DATE", "ORIGINATOR"]
    assert header[3] == "CREATION_DATE = 2029-02-13T12:00:00.123456"
    (craft, rows), (moon, moon_rows), (sun, sun_rows) = messages(text)
    assert (craft["OBJECT_NAME"], moon["OBJECT_NAME"], sun["OBJECT_NAME"]) == ("ORBITER", "MOON", "SUN")
    assert (craft["OBJECT_ID"], moon["OBJECT_ID"], sun["OBJECT_ID"]) == ("-64", "MOON", "SUN")
    assert {(each["CENTER_NAME"], each["REF_FRAME"], each["TIME_SYSTEM"]) for each in (craft, moon, sun)} == {
        ("ROCK", "ICRF", "TDB")}
    for state, *lines in zip(flight().states, rows, moon_rows, sun_rows, strict=True):
        rock, craft, moon = state.bodies["rock"], state.spacecraft, state.bodies["moon"]
        for (date, *words), r, v in zip(lines, (craft.r_inertial_m, moon.r_inertial_m, state.r_sun_inertial_m),
                                        (craft.v_inertial_m_s, moon.v_inertial_m_s, 0.0), strict=True):
            assert date == state.date_tdb
            true = np.hstack([r - rock.r_inertial_m, v - rock.v_inertial_m_s])
            np.testing.assert_allclose(1e3 * np.array(words, float), true, rtol=1e-14)


def test_an_aem_turns_frames_from_icrf():
    """By the standard's matrix of Q1, Q2, Q3, QC: components in A to components in B."""
    segments = messages(exports_of(flight(), ["aem"])["frames.aem"].decode())
    assert [each["REF_FRAME_B"] for each, _ in segments] == ["SC_BODY_1", "ROCK_FIXED", "MOON_FIXED"]
    for (meta, rows), name in zip(segments, ("", "rock", "moon"), strict=True):
        assert (meta["REF_FRAME_A"], meta["ATTITUDE_DIR"], meta["QUATERNION_TYPE"]) == ("ICRF", "A2B", "LAST")
        for (date, *words), state in zip(rows, flight().states, strict=True):
            pose, (*v, s) = state.bodies.get(name, state.spacecraft), np.array(words, float)
            cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
            turned = (s * s - np.dot(v, v)) * np.eye(3) + 2.0 * np.outer(v, v) - 2.0 * s * cross
            np.testing.assert_allclose(turned, quaternion_matrix(*pose.q_from_inertial), atol=1e-9)
            assert date == state.date_tdb


def test_an_isd_puts_points_where_the_camera_has_them():
    """By usgscsm's groundToImage: its pixels begin at the corner of the first one."""
    files = exports_of(flight(), ["isd"])
    state, table = flight().states[3], json.loads(files["frame_00003.isd.json"])
    assert len(files) == 5 and table["center_ephemeris_time"] == pytest.approx(et_of(state), abs=2e-7)
    point = np.array([120.0, -60.0, 80.0])
    sensor = table["instrument_pointing"]
    to_camera = np.reshape(sensor["constant_rotation"], (3, 3)) @ quaternion_matrix(*sensor["quaternions"][0])
    to_rock = quaternion_matrix(*table["body_rotation"]["quaternions"][0])
    seen = to_camera @ (to_rock.T @ (1e-3 * point) - table["instrument_position"]["positions"][0])
    x, y = table["focal_length_model"]["focal_length"] * seen[:2] / seen[2]
    (s0, sx, _), (l0, _, ly) = table["focal2pixel_samples"], table["focal2pixel_lines"]
    found = [table["detector_center"]["sample"] + s0 + sx * x, table["detector_center"]["line"] + l0 + ly * y]
    to_rock, to_craft, to_camera = (quaternion_matrix(*q) for q in (
        state.bodies["rock"].q_from_inertial, state.spacecraft.q_from_inertial, CAMERA.q_camera_from_spacecraft))
    r = to_camera @ (to_craft @ (to_rock.T @ point - state.spacecraft.r_inertial_m) - CAMERA.r_camera_spacecraft_m)
    np.testing.assert_allclose(found, [80.5 + 900.0 * r[0] / r[2], 60.5 + 900.0 * r[1] / r[2]], atol=1e-6)
    sun_km = np.array(table["sun_position"]["positions"][0])
    np.testing.assert_allclose(1e3 * sun_km, state.r_sun_inertial_m, rtol=1e-12)
    rates = to_rock.T @ state.bodies["rock"].angular_velocity_rad_s
    np.testing.assert_allclose(table["body_rotation"]["angular_velocities"], [rates], atol=1e-12)


def test_a_sum_file_puts_points_where_the_camera_has_them(spice):
    """By SPC's formula, x = MMFL (VLM + SCOBJ).CX / (VLM + SCOBJ).CZ and K (x, y) + CTR, whose pixels begin at 1."""
    files = exports_of(flight(), ["sum"])
    assert list(files) == [f"frame_{index:05d}.SUM" for index in range(5)]
    for index, state in enumerate(flight().states):
        name, date, *lines = files[f"frame_{index:05d}.SUM"].decode().splitlines()
        assert name == f"frame_{index:05d}" and lines[-3:] == ["LANDMARKS", "LIMB FITS", "END FILE"]
        assert abs(spice.str2et(f"{date} UTC") - et_of(state)) < 1.1e-6
        rows = {}
        for line in lines[:-3]:
            words = line.split()
            n_numbers = next(k for k, word in enumerate(words) if word[0].isalpha())
            rows[" ".join(words[n_numbers:])] = np.array([float(word.replace("D", "E")) for word in words[:n_numbers]])
        assert list(rows) == ["NPX, NLN, THRSH", "MMFL, CTR", "SCOBJ", "CX", "CY", "CZ", "SZ", "K-MATRIX", "DISTORTION",
                              "SIGMA_VSO", "SIGMA_PTG"]
        assert rows["NPX, NLN, THRSH"].tolist() == [200.0, 100.0, 0.0, 65535.0]
        to_rock, to_craft, to_camera = (quaternion_matrix(*q) for q in (
            state.bodies["rock"].q_from_inertial, state.spacecraft.q_from_inertial, CAMERA.q_camera_from_spacecraft))
        np.testing.assert_allclose([rows["CX"], rows["CY"], rows["CZ"]], to_camera @ to_craft @ to_rock.T, atol=1e-9)
        rock = state.bodies["rock"].r_inertial_m
        place = state.spacecraft.r_inertial_m + to_craft.T @ CAMERA.r_camera_spacecraft_m - rock
        np.testing.assert_allclose(-1e3 * rows["SCOBJ"], to_rock @ place, rtol=1e-9)
        sun = to_rock @ (state.r_sun_inertial_m - rock)
        np.testing.assert_allclose(rows["SZ"], sun / np.linalg.norm(sun), atol=1e-9)
        point = np.array([120.0, -60.0, 80.0])
        x, y, z = (np.dot(1e-3 * point + rows["SCOBJ"], rows[axis]) for axis in ("CX", "CY", "CZ"))
        (focal, *centre), k = rows["MMFL, CTR"], rows["K-MATRIX"].reshape(2, 3)
        found = k[:, :2] @ [focal * x / z, focal * y / z] + centre
        r = to_camera @ (to_craft @ (to_rock.T @ point - (place - to_craft.T @ CAMERA.r_camera_spacecraft_m))
                         - CAMERA.r_camera_spacecraft_m)
        np.testing.assert_allclose(found, [81.0 + 900.0 * r[0] / r[2], 61.0 + 900.0 * r[1] / r[2]], atol=1e-6)


def test_equal_flights_give_equal_bytes():
    assert exports_of(flight(), EXPORTS) == exports_of(flight(), EXPORTS)


def test_rates_and_velocities_that_are_not_known_are_left_out_or_differences():
    states = [State.from_dict({**made(index, False).to_dict()}) for index in range(4)]
    for state in states:
        for pose in (state.spacecraft, *state.bodies.values()):
            object.__setattr__(pose, "v_inertial_m_s", None)
    files = exports_of(flight(states=states), ["oem", "isd"])
    assert "angular_velocities" not in json.loads(files["frame_00001.isd.json"])["body_rotation"]
    rows = messages(files["frames.oem"].decode())[0][1]
    np.testing.assert_allclose(np.array([row[4:] for row in rows], float), [[1e-4, -3e-4, 2e-3]] * 4, rtol=1e-6)


def without_date(state):
    return State.from_dict({key: value for key, value in state.to_dict().items() if key != "date_tdb"})


@pytest.mark.parametrize("changes, names, words", [
    ({}, ["oem", "lmk"], "--with: must be one of 'oem', 'aem', 'spk', 'ck', 'isd', 'sum', got 'lmk'"),
    ({"states": [without_date(made(0))]}, ["oem"], "states[0].date_tdb: missing"),
    ({"states": [made(1), made(1)]}, ["ck"], "states[1].date_tdb: must be later"),
    ({"states": [made(1)]}, ["spk"], "states: must be two or more for spk"),
    ({"ids": {"rok": 5}}, ["oem"], "ids: must be of Orbiter, rock, moon, got 'rok'"),
    ({"ids": {"Orbiter": 5}}, ["oem"], "ids.Orbiter: must be "),
    ({"spacecraft": "Nav-Cam"}, ["oem"], "must differ in more than case"),
    ({"spacecraft": "Sun"}, ["oem"], "and the Sun must differ in more than case"),
    ({"spacecraft": "67"}, ["oem"], "name: must have a letter"),
    ({"radii_m": {"rock": 1.0, "other": 1.0}}, ["oem"], "states[0].bodies: must have every body of the scene"),
    ({"ids": {"rock": 301}}, ["spk"], "ids: must give each body a number of its own"),
    ({"ids": {"moon": 10}}, ["ck"], "and none the Sun's"),
    ({"states": [replace(made(i), bodies={"ssb": made(i).bodies["rock"]}) for i in (0, 1)], "radii_m": {"ssb": 1.0},
      "ids": {}}, ["spk"], "the solar system's (0)"),
    ({"states": [replace(made(i), bodies={"dart": made(i).bodies["rock"]}) for i in (0, 1)], "radii_m": {"dart": 1.0},
      "ids": {"Orbiter": -135}}, ["ck"], "the spacecraft's (-135)"),
    ({"spacecraft": "a name of more than twenty letters"}, ["oem"], "at most 20 letters"),
    ({"camera": replace(CAMERA, name="galactic")}, ["spk"], "cameras.galactic.name: must not be that of another of"),
    ({"camera": replace(CAMERA, name="Rock fixed")}, ["ck"], "cameras.Rock fixed.name: must not be that of another of"),
    ({"camera": replace(CAMERA, distortion=BrownConrady(k1=0.01))}, ["isd"],
     "cameras.Nav cam.distortion: must be absent for isd"),
    ({"camera": replace(CAMERA, distortion=BrownConrady(k1=0.01))}, ["sum"],
     "cameras.Nav cam.distortion: must be absent for sum")])
def test_what_a_file_cannot_hold_is_refused(changes, names, words):
    with pytest.raises(ConfigError) as caught:
        exports_of(flight(**changes), names)
    assert words in str(caught.value)


def test_names_may_begin_with_digits_and_have_accents():
    assert [in_capitals(name) for name in ("67P/C-G", "Čapek", "Río Frío")] == ["67P_C_G", "CAPEK", "RIO_FRIO"]


def test_other_contents_are_not_written_over(tmp_path):
    (tmp_path / "frames.oem").write_bytes(b"mine")
    refuse_others(tmp_path, {"frames.aem": b"", "frames.oem": b"mine"})
    with pytest.raises(ConfigError, match="must not write over a file with other contents"):
        refuse_others(tmp_path, {"frames.oem": b"ours"})
