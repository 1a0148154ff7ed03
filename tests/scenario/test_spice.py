"""SPICE's kernels: Rosetta about 67P, aberration, cameras, and what is told where there is no coverage."""

from __future__ import annotations

import json
import time
from datetime import UTC, datetime

import numpy as np
import PIL.Image
import pytest
from glrender import ConfigError, Renderer, frames
from glrender.scenario import Epoch, Spice, SpiceAttitude, SpiceTrajectory, camera_of_kernel, scenario_of_table
from missing import needed_module

ROSETTA = ["naif0012.tls", "c67p_label_v01.tpc", "ros67p_label_v01.bsp", "ros67p_label_v01.bc", "ros67p_label_v01.tf",
           "ros67p_label_v01.tsc"]


@pytest.fixture
def tool():
    """spiceypy with an empty pool, before and after."""
    spiceypy = needed_module("spiceypy", "pip install -e '.[test]'")
    spiceypy.kclear()
    yield spiceypy
    spiceypy.kclear()


def rosetta(shared, **changes):
    """A scenario of the kernels' 48 frames; a sphere stands for 67P."""
    poses = json.loads((shared / "67p" / "poses.json").read_text())["images"]
    epochs = [datetime.fromtimestamp(pose["utc_unix"], UTC).isoformat() for pose in poses.values()]
    table = {
        "bodies": [{"name": "67p", "generated": {"kind": "icosphere", "radius_m": 2e3, "subdivisions": 2},
                    "brdf": {"law": "lommel_seeliger", "single_scattering_albedo": 0.05},
                    "attitude": {"mode": "spice", "frame": "67P_FIXED"}}],
        "cameras": [{"name": "navcam", "width_px": 512, "height_px": 512, "focal_length_px": 5863.364}],
        "spice": {"kernels": [str(shared / "kernels" / name) for name in ROSETTA], "observer": "-226",
                  "ids": {"67p": "1000012"}},
        "trajectory": {"kind": "spice"}, "attitude": {"mode": "spice", "frame": "ROS_NAVCAM_LBL"},
        "time": {"epochs_utc": [epoch.removesuffix("+00:00") for epoch in epochs]}}
    return {**table, **changes}, poses


def test_states_are_those_of_the_images_labels(tool, shared):
    """The kernels were made from the labels: position to 5 cm at 120 km, attitude and Sun to 1e-5 deg."""
    table, poses = rosetta(shared)
    states = scenario_of_table(table).states()
    assert len(states) == 48
    for state, pose in zip(states, poses.values(), strict=True):
        label, body = pose["label"], state.bodies["67p"]
        body_from_inertial = frames.dcm(body.q_from_inertial)
        r = body_from_inertial @ (state.spacecraft.r_inertial_m - body.r_inertial_m)
        np.testing.assert_allclose(r, np.array(label["pos_body_km"]) * 1e3, atol=0.05)
        camera_from_body = frames.dcm(state.spacecraft.q_from_inertial) @ body_from_inertial.T
        np.testing.assert_allclose(camera_from_body, label["R_body_to_cam"], atol=2e-7)
        sun = body_from_inertial @ state.r_sun_inertial_m
        np.testing.assert_allclose(sun / np.linalg.norm(sun), label["sun_body"], atol=2e-7)


def test_frames_are_those_of_the_camera(tool, shared):
    """NCC of real NavCam frames with renders of the kernels' states: 0.9 in the median, and as with the labels."""
    table, poses = rosetta(shared)
    table["bodies"][0] |= {"shape": str(shared / "67p" / "67p-16k.obj"), "length_unit": "km"}
    del table["bodies"][0]["generated"]
    scenario = scenario_of_table(table)
    assert scenario.check() == []
    found = []
    with Renderer(scenario.scene) as renderer:
        for index, (name, pose) in list(enumerate(poses.items()))[::6]:
            (state,) = scenario.states(scenario.t_s[[index]])
            real = np.asarray(PIL.Image.open(shared / "67p" / "navcam" / f"{name}.png").convert("L"), float)
            drawn = renderer.render(state).irradiance_W_m2.astype(float)
            found.append((np.corrcoef(drawn.ravel(), real.ravel())[0, 1], pose["ncc512"]["label"]))
    ours, labels = np.array(found).T
    assert np.median(ours) >= 0.9, ours
    np.testing.assert_array_less(labels - 0.01, ours)


@pytest.mark.parametrize("aberration", ["NONE", "LT", "LT+S", "CN+S"])
def test_aberration_is_spkezrs(tool, shared, tmp_path, aberration):
    """Of 67P from Rosetta; the body turns back by the light time, and the Sun is where the body saw it."""
    # Light time needs places from the barycentre of the solar system, which these kernels lack: 67P moves straight.
    begin, end, v_km_s = 460523306.0, 460872506.0, np.array([-7.0, 11.0, 6.0])
    places = [[*(np.array([2e8, -4e8, -2e8]) + v_km_s * t), *v_km_s] for t in (0.0, end - begin)]
    handle = tool.spkopn(str(tmp_path / "67p.bsp"), "test", 0)
    tool.spkw08(handle, 1000012, 0, "J2000", begin, end, "67P", 1, 2, places, begin, end - begin)
    moon = [[5e3, 1e3, -2e3, 0.0, 1e-3, 0.0], [5e3, 1e3 + 1e-3 * (end - begin), -2e3, 0.0, 1e-3, 0.0]]
    tool.spkw08(handle, 1000013, 1000012, "J2000", begin, end, "MOON", 1, 2, moon, begin, end - begin)
    tool.spkcls(handle)
    table, _ = rosetta(shared)
    table["bodies"].append({"name": "1000013", "generated": {"kind": "icosphere", "radius_m": 9.0, "subdivisions": 1},
                            "brdf": {"law": "lambert", "normal_albedo": 0.1}, "trajectory": {"kind": "spice"}})
    table["spice"]["kernels"].append(str(tmp_path / "67p.bsp"))
    table["spice"]["aberration"] = aberration
    table["time"] = {"start_tdb": "2014-08-07T12:00:00", "duration_s": 3600.0, "frames": 3}
    scenario = scenario_of_table(table)
    for epoch, state in zip(scenario.epochs(), scenario.states(), strict=True):
        seen, ago = tool.spkezr("1000012", epoch.et_s, "J2000", aberration, "-226")
        np.testing.assert_allclose(-state.spacecraft.r_inertial_m, seen[:3] * 1e3, atol=1e-6)
        moon, _ = tool.spkpos("1000013", epoch.et_s, "J2000", aberration, "-226")
        offset = state.bodies["1000013"].r_inertial_m - state.spacecraft.r_inertial_m
        np.testing.assert_allclose(offset, np.asarray(moon) * 1e3, atol=1e-6)
        ago = 0.0 if aberration == "NONE" else ago
        sun, _ = tool.spkpos("SUN", epoch.et_s - ago, "J2000", aberration, "1000012")
        np.testing.assert_allclose(state.r_sun_inertial_m, np.asarray(sun) * 1e3, atol=1e-3)
        turned = tool.pxform("J2000", "67P_FIXED", epoch.et_s - ago)
        np.testing.assert_allclose(frames.dcm(state.bodies["67p"].q_from_inertial), turned, atol=1e-14)


def test_rates_of_a_body_are_its_spin(tool, shared):
    """696.53874200 deg a day about +Z, by its PCK; the CK of the camera has no rates, and none are made up."""
    table, _ = rosetta(shared)
    state = scenario_of_table(table).states()[3]
    expected = [0.0, 0.0, np.radians(696.53874200) / 86400.0]
    np.testing.assert_allclose(state.bodies["67p"].angular_velocity_rad_s, expected, rtol=1e-9, atol=1e-14)
    assert state.spacecraft.angular_velocity_rad_s is None


def test_a_missing_epoch_is_told_with_the_coverage(tool, shared):
    table, _ = rosetta(shared)
    table["time"] = {"epochs_tdb": ["2015-01-01T00:00:00"]}
    with pytest.raises(ConfigError) as caught:
        scenario_of_table(table).states()
    message = str(caught.value)
    assert message.startswith("trajectories.")
    assert "is not in the kernels at 2015-01-01T00:00:00 TDB" in message and "SPKINSUFFDATA" in message
    assert "ros67p_label_v01.bsp has -226 from 2014-08-05T20:08:26 TDB to 2014-08-09T21:08:25 TDB" in message


def _nowhere(table):
    table["spice"]["kernels"].append("nowhere.bsp")


def _no_id(table):
    table["spice"]["ids"] = {}


def _no_frame(table):
    table["attitude"]["frame"] = "NOWHERE"


def _no_aberration(table):
    table["spice"]["aberration"] = "XLT"


@pytest.mark.parametrize("spoil, message", [
    (_nowhere, "spice.kernels[6]: is not there"),
    (_no_id, "must lead to a name or number that SPICE knows, got '67p'; give spice.ids of '67p'"),
    (_no_frame, "attitudes.spacecraft.frame: is not in the kernels at 2014-08-05"),
    (_no_aberration, "spice.aberration: must be one of 'NONE', 'LT', 'LT+S', 'CN+S', got 'XLT'"),
])
def test_what_kernels_lack_is_told(tool, shared, spoil, message):
    table, _ = rosetta(shared)
    spoil(table)
    with pytest.raises(ConfigError) as caught:
        scenario_of_table(table).states()
    assert message in str(caught.value)


def test_a_kernel_that_is_none_is_told(tool, tmp_path):
    (tmp_path / "bad.tpc").write_text("KPL/PCK\n\\begindata\nX = ( 1.0, 'open )\n")
    with pytest.raises(ConfigError, match=r"kernels\[0\]: is refused by SPICE: SPICE\("):
        Spice(kernels=[tmp_path / "bad.tpc"], observer="-226")


@pytest.mark.parametrize("kernel, instrument, focal_length_px", [
    ("amica31.ti", "-130102", 0.1208 / 12e-6), ("dawn_fc_v10.ti", "-203120", 150.07 / 13.9995e-3)])
def test_cameras_are_those_of_real_instrument_kernels(tool, shared, kernel, instrument, focal_length_px):
    """AMICA's is in metres, the Framing Camera's in mm and um: the field of view tells which."""
    camera = camera_of_kernel(real_kernel(tool, shared, kernel), instrument=instrument, name="c").camera
    # The Framing Camera's pixels are not square: 1e-6 of the mean of both sides.
    np.testing.assert_allclose(camera.focal_length_px, focal_length_px, rtol=1e-12 if kernel == "amica31.ti" else 1e-5)
    assert (camera.width_px, camera.height_px) == (1024, 1024)
    np.testing.assert_allclose(camera.q_camera_from_spacecraft, [1.0, 0.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(camera.principal_point_px, [511.5, 511.5], atol=1e-9)
    spice = Spice(kernels=[shared / "kernels" / kernel], observer="-1")
    turned = camera_of_kernel(spice, instrument=instrument, name="c", image_right=[0.0, 1.0, 0.0]).camera
    right = frames.dcm(turned.q_camera_from_spacecraft) @ [0.0, 1.0, 0.0]
    np.testing.assert_allclose(right, [1.0, 0.0, 0.0], atol=1e-12)


def real_kernel(tool, shared, kernel):
    if kernel.startswith("dawn"):
        tool.lmpool(["FRAME_DAWN_FC2 = -203120", "FRAME_-203120_NAME = 'DAWN_FC2'", "FRAME_-203120_CLASS = 3",
                     "FRAME_-203120_CLASS_ID = -203120", "FRAME_-203120_CENTER = -203"])
    return Spice(kernels=[shared / "kernels" / kernel], observer="-1")


def test_the_lens_of_a_kernel_is_inverted(tool, shared, rng):
    """dawn_fc_v10.ti's own equations, E1 8.4e-6 / mm^2: within the residual told, 0.2 px of pixels that are not square.

    The lens moves the corners by 0.8 px; to leave it out is asked for.
    """
    spice = real_kernel(tool, shared, "dawn_fc_v10.ti")
    made = camera_of_kernel(spice, instrument="-203120", name="c")
    p = np.concatenate([rng.uniform(-0.0475, 0.0475, (5000, 2)), np.ones((5000, 1))], axis=1)
    xy = 150.07 * p[:, :2]
    expected = (xy + 8.4e-6 * xy * np.sum(xy * xy, axis=1, keepdims=True)) / [14.004e-3, 13.995e-3] + 511.5
    off = np.hypot(*(made.camera.project(p) - expected).T).max()
    assert off <= 1.01 * made.residual_px < 0.26 and 0.05 < off, (off, made.residual_px)
    assert "its distortion follows the instrument's to" in made.notes()[0]
    plain = camera_of_kernel(spice, instrument="-203120", name="c", lens={"model": "none"})
    assert plain.camera.distortion is None
    assert 0.5 < np.hypot(*(plain.camera.project(p) - expected).T).max() < 1.5
    with pytest.raises(ConfigError, match="focal_length_px: is given, and the kernel's RAD_DIST_COEFF counts in mm"):
        camera_of_kernel(spice, instrument="-203120", name="c", focal_length_px=1e4)
    by_hand = camera_of_kernel(spice, instrument="-203120", name="c", focal_length_px=1e4, lens={"model": "none"})
    np.testing.assert_allclose(by_hand.camera.focal_length_px, 1e4, rtol=1e-12)


PLAIN = """KPL/IK
\\begindata
INS-77001_FOV_FRAME = 'J2000'
INS-77001_FOV_SHAPE = 'RECTANGLE'
INS-77001_BORESIGHT = ( 0.0, 0.0, 1.0 )
INS-77001_FOV_CLASS_SPEC = 'ANGLES'
INS-77001_FOV_REF_VECTOR = ( 1.0, 0.0, 0.0 )
INS-77001_FOV_REF_ANGLE = ( 5.0 )
INS-77001_FOV_CROSS_ANGLE = ( 5.0 )
INS-77001_FOV_ANGLE_UNITS = 'DEGREES'
INS-77001_FOCAL_LENGTH = ( 100.0 )
INS-77001_PIXEL_SIZE = ( 17.0 )
INS-77001_PIXEL_SAMPLES = ( 1024 )
INS-77001_PIXEL_LINES = ( 1024 )
"""


def of_plain(tool, tmp_path, more, **options):
    tool.kclear()
    (tmp_path / "plain.ti").write_text(PLAIN + more + "\\begintext\n")
    spice = Spice(kernels=[tmp_path / "plain.ti"], observer="-77")
    return camera_of_kernel(spice, instrument="-77001", name="c", **options).camera


@pytest.mark.parametrize("more, expected", [
    ("", [511.5, 511.5]), ("INS-77001_CCD_CENTER = ( 533.5, 500.0 )\n", [533.5, 500.0]),
    ("INS-77001_CENTER = ( 533.5, 500.0 )\n", [533.5, 500.0]),
    ("INS-77001_BORESIGHT_SAMPLE = ( 534.5 )\nINS-77001_BORESIGHT_LINE = ( 501.0 )\n", [533.5, 500.0])])
def test_the_boresight_is_imaged_where_the_kernel_has_it(tool, tmp_path, more, expected):
    """CCD_CENTER counts from 0, ISIS's keywords from 1 (ISIS adds 1 to the first to get the second)."""
    camera = of_plain(tool, tmp_path, more)
    np.testing.assert_allclose(camera.project([0.0, 0.0, 1.0]), expected, atol=1e-9)
    by_hand = of_plain(tool, tmp_path, more, principal_point_px=[100.0, 200.0])
    np.testing.assert_allclose(by_hand.principal_point_px, [100.0, 200.0])
    lensed = of_plain(tool, tmp_path, more + "INS-77001_OD_K = ( 0.0, 1E-5, 0.0 )\n")
    # The lens has no effect on its own axis, and the fit's tangential terms are small.
    np.testing.assert_allclose(lensed.project([0.0, 0.0, 1.0]), expected, atol=1e-3)


def test_a_centre_of_another_size_and_a_lens_that_is_not_read_are_refused(tool, tmp_path):
    centre = "INS-77001_CCD_CENTER = ( 533.5, 500.0 )\n"
    with pytest.raises(ConfigError, match="principal_point_px: missing: the kernel's CCD_CENTER is of 1024 x 1024 px"):
        of_plain(tool, tmp_path, centre, height_px=512)
    np.testing.assert_allclose(of_plain(tool, tmp_path, "INS-77001_CENTER = ( 511.5, 511.5 )\n", height_px=512)
                               .principal_point_px, [511.5, 255.5])
    for name in ("OD_T_X", "DISTORTION_COEF", "OD_CENTER", "RADIAL_DISTORTION"):
        with pytest.raises(ConfigError, match=f"lens: is not read from the kernel's keyword, got 'INS-77001_{name}'"):
            of_plain(tool, tmp_path, f"INS-77001_{name} = ( 1.0, 2.0 )\n")
    assert of_plain(tool, tmp_path, "INS-77001_OD_T_X = ( 1.0 )\n", lens={"model": "none"}).distortion is None


def test_a_camera_that_looks_elsewhere_is_mounted_so(tool, shared, tmp_path):
    """A boresight along -Y of the instrument, which is turned in the spacecraft; and in a scenario file."""
    kernel = tmp_path / "odd.ti"
    kernel.write_text("""KPL/IK
\\begindata
FRAME_ODD = -77001
FRAME_-77001_NAME = 'ODD'
FRAME_-77001_CLASS = 4
FRAME_-77001_CLASS_ID = -77001
FRAME_-77001_CENTER = -77
TKFRAME_-77001_RELATIVE = 'J2000'
TKFRAME_-77001_SPEC = 'ANGLES'
TKFRAME_-77001_UNITS = 'DEGREES'
TKFRAME_-77001_ANGLES = ( 90.0, 0.0, 0.0 )
TKFRAME_-77001_AXES = ( 3, 2, 1 )
INS-77001_FOV_FRAME = 'ODD'
INS-77001_FOV_SHAPE = 'RECTANGLE'
INS-77001_BORESIGHT = ( 0.0, -1.0, 0.0 )
INS-77001_FOV_CLASS_SPEC = 'ANGLES'
INS-77001_FOV_REF_VECTOR = ( 1.0, 0.0, 0.0 )
INS-77001_FOV_REF_ANGLE = ( 5.0 )
INS-77001_FOV_CROSS_ANGLE = ( 5.0 )
INS-77001_FOV_ANGLE_UNITS = 'DEGREES'
INS-77001_FOCAL_LENGTH = ( 100.0 )
INS-77001_PIXEL_SIZE = ( 17.0 )
INS-77001_PIXEL_SAMPLES = ( 1024 )
INS-77001_PIXEL_LINES = ( 1024 )
\\begintext
""")
    table, _ = rosetta(shared)
    table["spice"]["kernels"].append(str(kernel))
    table["cameras"] = [{"name": "odd", "instrument": "-77001", "spacecraft_frame": "J2000"}]
    camera = scenario_of_table(table).scene.camera("odd")
    # The boresight in the frame that stands for the spacecraft, by SPICE.
    ahead = tool.pxform("ODD", "J2000", 0.0) @ [0.0, -1.0, 0.0]
    right = tool.pxform("ODD", "J2000", 0.0) @ [1.0, 0.0, 0.0]
    axes = frames.dcm(camera.q_camera_from_spacecraft)
    np.testing.assert_allclose(axes @ ahead, [0.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(axes @ right, [1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(camera.focal_length_px, 1e5 / 17.0)
    table["cameras"][0]["width_px"] = 2048
    with pytest.raises(ConfigError, match="focal_length_px: is 5882.35 px by FOCAL_LENGTH over PIXEL_SIZE"):
        scenario_of_table(table)
    table["cameras"][0]["instrument"] = "-77002"
    with pytest.raises(ConfigError, match="instrument: has no field of view in the kernels"):
        scenario_of_table(table)


def test_sources_serve_alone(tool, shared):
    """A trajectory and an attitude of kernels, without a scenario file; kernels are unloaded."""
    spice = Spice(kernels=[shared / "kernels" / name for name in ROSETTA], observer="-226", ids={"67p": "1000012"})
    start = Epoch.from_tdb("2014-08-07T12:00:00")
    r, v = SpiceTrajectory(spice=spice, target="spacecraft", about="67p").at(start, np.array([0.0, 1.0]))
    # Centimetres of a cubic polynomial between the labels' epochs.
    np.testing.assert_allclose(r[1] - r[0], v[0], atol=0.05)
    assert 50e3 < np.linalg.norm(r[0]) < 130e3 and SpiceAttitude(spice=spice, frame="67P_FIXED").frame == "67P_FIXED"
    spice.close()
    assert tool.ktotal("ALL") == 0


def test_an_encounter_of_a_body_from_spk(tool, shared):
    """67P's place about the Sun out of the kernel, the spacecraft's of the encounter."""
    table, _ = rosetta(shared)
    del table["trajectory"]
    table["bodies"][0]["trajectory"] = {"kind": "spice", "about": "sun"}
    table["attitude"] = {"mode": "target"}
    table["time"] = {"frames": 3}
    table["encounter"] = {"distance_m": 20e3, "relative_velocity_m_s": 1e4, "phase_angle_deg": 60.0,
                          "date_utc": "2014-08-07T12:00:00", "duration_s": 10.0, "direction": [0.2, 0.3, 1.0]}
    state = scenario_of_table(table).states()[1]
    sun, _ = tool.spkpos("SUN", tool.str2et("2014-08-07T12:00:00"), "J2000", "NONE", "1000012")
    np.testing.assert_allclose(state.r_sun_inertial_m, np.asarray(sun) * 1e3, rtol=1e-12)
    r = state.spacecraft.r_inertial_m
    np.testing.assert_allclose(np.linalg.norm(r), 20e3, atol=1e-6)
    np.testing.assert_allclose(r @ sun / np.linalg.norm(r) / np.linalg.norm(sun), 0.5, atol=1e-9)


def test_an_adapters_state_is_fast(tool, shared):
    """SPICE adds less than 0.3 ms of a core a frame, positions and attitudes together; the best of five."""
    table, _ = rosetta(shared)
    scenario = scenario_of_table(table)
    t_s, seconds = np.tile(scenario.t_s, 10), []
    for _ in range(5):
        begin = time.process_time()
        geometry = scenario.geometry(t_s)
        for name, attitude in scenario.attitudes.items():
            attitude.at(geometry, name)
        seconds.append(time.process_time() - begin)
    assert min(seconds) / len(t_s) < 0.3e-3, min(seconds) / len(t_s)
