"""`glrender check SCENARIO` tells what is wrong before the first frame: the field, the value and the way out."""

from __future__ import annotations

import logging

import pytest
from glrender import generate
from glrender_cli.__main__ import main
from missing import needed_module

SCENE = """
[[bodies]]
name = "67p"
generated = {kind = "icosphere", radius_m = 2000.0, subdivisions = 2}
brdf = {law = "lambert", normal_albedo = 0.05}
BODY
[[cameras]]
name = "navcam"
width_px = 64
height_px = 64
focal_length_px = 64.0
"""
AT_REST = SCENE.replace("BODY", "") + """
[sun]
r_m = [1.5e11, 0.0, 0.0]
[trajectory]
kind = "at_rest"
r_m = [9000.0, 0.0, 0.0]
[time]
times_s = [0.0, 1.0]
"""
KERNELS = ["naif0012.tls", "c67p_label_v01.tpc", "ros67p_label_v01.bsp", "ros67p_label_v01.bc", "ros67p_label_v01.tf",
           "ros67p_label_v01.tsc"]
OF_SPICE = SCENE.replace("BODY", 'attitude = {mode = "spice", frame = "67P_FIXED"}') + """
[spice]
kernels = [KERNELS]
observer = "-226"
ids = {67p = "1000012"}
[trajectory]
kind = "spice"
[attitude]
mode = "spice"
frame = "ROS_NAVCAM_LBL"
[time]
epochs_tdb = ["2014-08-07T12:00:00"]
"""
COVERAGE = "coverage: ros67p_label_v01.bsp has -226 from 2014-08-05T20:08:26 TDB to 2014-08-09T21:08:25 TDB"
ODD_FRAMES = """KPL/FK
\\begindata
FRAME_LEFT = 1500001
FRAME_1500001_NAME = 'LEFT'
FRAME_1500001_CLASS = 4
FRAME_1500001_CLASS_ID = 1500001
FRAME_1500001_CENTER = -226
TKFRAME_1500001_SPEC = 'MATRIX'
TKFRAME_1500001_RELATIVE = 'J2000'
TKFRAME_1500001_MATRIX = ( 1 0 0 0 1 0 0 0 -1 )
FRAME_SKEW = 1500002
FRAME_1500002_NAME = 'SKEW'
FRAME_1500002_CLASS = 4
FRAME_1500002_CLASS_ID = 1500002
FRAME_1500002_CENTER = -226
TKFRAME_1500002_SPEC = 'MATRIX'
TKFRAME_1500002_RELATIVE = 'J2000'
TKFRAME_1500002_MATRIX = ( 1 0.3 0 0 1 0 0 0 1 )
FRAME_ON_SKEW = 1500003
FRAME_1500003_NAME = 'ON_SKEW'
FRAME_1500003_CLASS = 4
FRAME_1500003_CLASS_ID = 1500003
FRAME_1500003_CENTER = -226
TKFRAME_1500003_SPEC = 'ANGLES'
TKFRAME_1500003_RELATIVE = 'SKEW'
TKFRAME_1500003_ANGLES = ( 1.0, 2.0, 3.0 )
TKFRAME_1500003_AXES = ( 1, 2, 3 )
TKFRAME_1500003_UNITS = 'DEGREES'
\\begintext
"""


def fixed(q):
    return f'[attitude]\nmode = "fixed"\nq_from_inertial = {q}\n[time]'


@pytest.mark.parametrize("old, new, told", [
    # Times without a scale, or of another one.
    ("[time]\ntimes_s", "[time]\nstart = '2022-01-01'\ntimes_s",
     "s.toml.time.start: has no time scale, got '2022-01-01'; write start_tdb or start_utc or start_et_s"),
    ("[time]\ntimes_s", "[time]\nstart_et = 3.0\ntimes_s",
     "s.toml.time.start_et: unknown key; did you mean 'start_et_s'? known keys are duration_s, epochs_et_s, "
     "epochs_tdb, epochs_utc, frames, rate_hz, sampler, slow_motion, start_et_s, start_tdb, start_utc, times_s"),
    ("times_s = [0.0, 1.0]", "epochs = ['2022-01-01']", "s.toml.time.epochs: has no time scale, got ['2022-01-01']; "
     "write epochs_tdb or epochs_utc or epochs_et_s"),
    ("times_s = [0.0, 1.0]", "epochs_tdb = ['2022-01-01T00:00:00Z']", "s.toml.time.epochs_tdb[0]: must be TDB, without "
     "a Z, got '2022-01-01T00:00:00Z'; a time in UTC is given as *_utc"),
    # Empty sequences.
    ("times_s = [0.0, 1.0]", "times_s = []", "s.toml.time.times_s: must be a list of times within 1e+11 s that is not "
     "empty, got []"),
    ("times_s = [0.0, 1.0]", "epochs_utc = []", "s.toml.time.epochs_utc: must be a list that is not empty: a sequence "
     "has one frame at least, got []"),
    ("times_s = [0.0, 1.0]", "duration_s = 3.0\nframes = 0", "s.toml.time.frames: must be an integer between 1 and "
     "10000000, got 0"),
    ("times_s = [0.0, 1.0]", "", "s.toml.time: gives no times; give duration_s with frames or rate_hz, times_s, or "
     "epochs_tdb"),
    # Quaternions far off unity; those of tables too.
    ("[time]", fixed([0.7, 0.0, -0.7, 0.0]), "s.toml.attitude.q_from_inertial: norm must be 1 within 0.001, is "
     "0.989949494, got [0.7, 0.0, -0.7, 0.0]; normalise [w, x, y, z] before sending"),
    ("[time]", '[attitude]\nmode = "csv"\nfile = "q.csv"\n[time]', "s.toml.attitude.q_from_inertial[1]: norm must be 1 "
     "within 0.001, is 1.01, got [1.01, 0.0, 0.0, 0.0]; normalise [w, x, y, z] first"),
    # Places that cannot be.
    ("[9000.0, 0.0, 0.0]", "[-1046.0, 1692.0, 0.0]", "spacecraft: is inside '67p' (frame 0, t_s = 0), at [m] from its "
     "origin, got [-1046.0, 1692.0, 0.0]; give a trajectory that keeps farther away"),
    ("[9000.0, 0.0, 0.0]", "[9.0, 0.0, 0.0]", "s.toml.trajectory.r_m: must be more than 1964.49 m from the centre of "
     "'67p', which is solid to there, got [9.0, 0.0, 0.0]; in km? then write [9000.0, 0.0, 0.0]"),
    ("r_m = [1.5e11, 0.0, 0.0]", "r_m = [1.5e8, 0.0, 0.0]", "s.toml.sun.r_m: must be more than the Sun's radius, "
     "6.957e+08 m, got [150000000.0, 0.0, 0.0]; in km? then write [1.5e+11, 0, 0]; it is a position in metres, from "
     "the same origin as the bodies', not a direction"),
])
def test_what_is_wrong_is_told(tmp_path, capsys, old, new, told):
    (tmp_path / "q.csv").write_text("t_s,q_w,q_x,q_y,q_z\n0,1,0,0,0\n1,1.01,0,0,0\n")
    assert old in AT_REST
    (tmp_path / "s.toml").write_text(AT_REST.replace(old, new))
    assert main(["check", str(tmp_path / "s.toml")]) == 1
    assert capsys.readouterr().err == f"glrender: {told}\n"


@pytest.mark.parametrize("old, new, told", [
    ("[9000.0, 0.0, 0.0]", "[-9000.0, 10.0, 0.0]", "camera 'navcam': the Sun is in the field, behind the target, in "
     "2 frames (0 to 1): bodies show their dark sides; check the side of the trajectory"),
    ("[time]", fixed([0.0, 0.0, 1.0, 0.0]), "camera 'navcam': no body is in the field in 2 frames (0 to 1), the whole "
     "sequence: check [attitude]"),
])
def test_what_is_odd_is_warned_of(tmp_path, capsys, old, new, told):
    (tmp_path / "s.toml").write_text(AT_REST.replace(old, new))
    assert main(["check", str(tmp_path / "s.toml")]) == 0
    told_all = capsys.readouterr()
    assert told_all.err.startswith(f"glrender: warning: {told}\n") and "2 states over 1 s" in told_all.out


def test_a_rounded_quaternion_is_renormalised_with_a_warning(tmp_path, capsys, caplog):
    """Four digits, 6e-5 off unity. A field is warned of once a process, so its name is this test's own."""
    file = tmp_path / f"{tmp_path.parent.name}.toml"
    file.write_text(AT_REST.replace("[time]", fixed([0.7071, 0.0, -0.7072, 0.0])))
    with caplog.at_level(logging.WARNING):
        assert main(["check", str(file)]) == 0
    (told,) = [record.getMessage() for record in caplog.records if "q_from_inertial" in record.getMessage()]
    assert told == (f"{file.name}.attitude.q_from_inertial: norm must be 1 within 1e-06, is 1.00006112: renormalised; "
                    "normalise [w, x, y, z] before sending, or write 7 digits")


@pytest.mark.parametrize("old, new, told", [
    ("ros67p_label_v01.bsp", "nowhere.bsp", ["spice.kernels[2]: is not there, got '", "nowhere.bsp'; put it there; in "
                                             "a scenario file names are relative to that"]),
    ("2014-08-07T12:00:00", "2015-08-07T12:00:00", ["is not in the kernels at 2015-08-07T12:00:00 TDB", COVERAGE]),
    ('"ros67p_label_v01.bsp", ', "", ["trajectories.sun: is not in the kernels", "SPICE(NOLOADEDFILES)",
                                      "coverage: ros67p_label_v01.bc has -226970 from 2014-08-05"]),
    (', "ros67p_label_v01.tsc"', "", ["attitudes.spacecraft.frame: is not in the kernels",
                                      "ros67p_label_v01.bc has -226970, and needs the clock's kernel (SCLK)"]),
    ("ROS_NAVCAM_LBL", "ROS_NAVCAM", ["attitudes.spacecraft.frame: is not in the kernels", "SPICE(UNKNOWNFRAME)",
                                      "load the frame kernel (FK) that defines it; loaded are naif0012.tls, "]),
    ("67P_FIXED", "IAU_67P", ["attitudes.67p.frame: is not in the kernels", "load the frame kernel (FK)"]),
    ('"-226"', '"ROSETA"', ["observer: must lead to a name or number that SPICE knows, got 'ROSETA'; give another "
                            "spice.observer, or load the kernel that defines it"]),
    ('67p = "1000012"', "", ["ids: must lead to a name or number that SPICE knows, got '67p'; give spice.ids of "]),
    ("ROS_NAVCAM_LBL", "LEFT", ["attitudes.spacecraft.frame.TKFRAME_1500001_MATRIX: must be a rotation, but mirrors",
                                "turn one axis of a left-handed frame round"]),
    ("ROS_NAVCAM_LBL", "SKEW", ["attitudes.spacecraft.frame.TKFRAME_1500002_MATRIX: rows must be orthonormal within "
                                "0.001, are off by 0.3", "give the rotation alone, without scale or shear"]),
    ("ROS_NAVCAM_LBL", "ON_SKEW", ["TKFRAME_1500002_MATRIX: rows must be orthonormal"]),
])
def test_what_kernels_lack_is_told_with_the_way_out(tmp_path, capsys, shared, old, new, told):
    spiceypy = needed_module("spiceypy", "pip install -e '.[test]'")
    spiceypy.kclear()
    (tmp_path / "odd.tf").write_text(ODD_FRAMES)
    for kernel in KERNELS:
        (tmp_path / kernel).symlink_to(shared / "kernels" / kernel)
    text = OF_SPICE.replace("KERNELS", ", ".join(f'"{name}"' for name in [*KERNELS, "odd.tf"]))
    assert old in text
    (tmp_path / "s.toml").write_text(text.replace(old, new))
    try:
        assert main(["check", str(tmp_path / "s.toml")]) == 1
    finally:
        spiceypy.kclear()
    error = capsys.readouterr().err
    assert error.startswith("glrender: ") and error.count("\n") == 1
    for part in told:
        assert part in error, error


def test_what_is_right_is_told_with_its_output(tmp_path, capsys, shared):
    spiceypy = needed_module("spiceypy", "pip install -e '.[test]'")
    spiceypy.kclear()
    names = ", ".join(f'"{shared / "kernels" / name}"' for name in KERNELS)
    (tmp_path / "s.toml").write_text(OF_SPICE.replace("KERNELS", names))
    try:
        assert main(["check", str(tmp_path / "s.toml")]) == 0
    finally:
        spiceypy.kclear()
    told = capsys.readouterr()
    assert told.err == ""
    assert "sequence: 1 states over 0 s from 2014-08-07T12:00:00.000000 TDB\noutput: fits of W/m2, camera " in told.out


def test_the_shapes_of_a_scenario_are_told_too(tmp_path, capsys):
    """A sphere without its last facet."""
    generate.icosphere(radius_m=2000.0, subdivisions=2).to_file(tmp_path / "whole.obj")
    (tmp_path / "holed.obj").write_text("\n".join((tmp_path / "whole.obj").read_text().splitlines()[:-1]) + "\n")
    generated = 'generated = {kind = "icosphere", radius_m = 2000.0, subdivisions = 2}'
    (tmp_path / "rest.toml").write_text(AT_REST.replace(generated, 'shape = "holed.obj"\nlength_unit = "m"'))
    assert main(["check", str(tmp_path / "rest.toml")]) == 0
    assert capsys.readouterr().err.count("glrender: warning: 67p: 3 open edges of holes") == 1
