"""Attitudes of docs/conventions.md: quaternions, norms, and those of other tools with the tools themselves."""

from __future__ import annotations

import json
import logging
import os
import re
import subprocess
from types import SimpleNamespace

import glrender
import numpy as np
import pytest
import serving
import views
from conventions import FACETS, PAGE, R_MARKER_M, blocks
from glrender import (
    Body,
    ConfigError,
    PinholeCamera,
    Pose,
    Renderer,
    Scene,
    Shape,
    State,
    frames,
    from_basilisk_mrp,
    from_matlab_dcm,
    from_matlab_quat,
    from_ros,
    from_scipy,
    from_spice,
    load_scene,
)
from glrender.base.disk_cache import cache_folder
from glrender.brdf import Lambert
from glrender.engines.rays.laser_ranges import checked_directions
from glrender_camera import validate
from glrender_camera.errors import error_path, path_of
from missing import missing, needed_module
from scipy.spatial.transform import Rotation

# Quaternions and vectors


MATRICES = np.concatenate([Rotation.random(20, random_state=38).as_matrix(), [np.eye(3)]])
NEAR_180_DEG = Rotation.from_rotvec(np.concatenate([
    (np.pi - off) * np.array(axis)[None] / np.linalg.norm(axis)
    for off in (0.0, 1e-15, 1e-9, 1e-5, -1e-9, -1e-5)
    for axis in ([1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1], [1, -2, 3], [-1, 1e-9, 0])])).as_matrix()


def test_the_anchor():
    """(cos 45, 0, 0, sin 45) takes x to y, and so do Hamilton's product v_b = q v_a q* and SciPy."""
    q, v = np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]), np.array([1.0, 0.0, 0.0])
    w, u = q[0], q[1:]
    for seen in (frames.dcm(q) @ v, v + 2.0 * np.cross(u, np.cross(u, v) + w * v),
                 Rotation.from_quat(q, scalar_first=True).apply(v)):
        np.testing.assert_allclose(seen, [0.0, 1.0, 0.0], atol=1e-15)


def test_both_signs_of_a_quaternion_are_one_attitude():
    q = views.state().spacecraft.q_from_inertial
    np.testing.assert_array_equal(frames.dcm(q), frames.dcm(-q))


@pytest.fixture
def warnings(caplog, monkeypatch):
    """What the log warns of, as if no field had been warned of before."""
    monkeypatch.setattr(validate, "_warned", set())
    caplog.set_level(logging.WARNING)
    return lambda: [record.getMessage() for record in caplog.records]


def with_norm(norm):
    return (norm * np.array([0.6, 0.0, -0.8, 0.0])).tolist()


def scene_text(norm):
    return serving.SCENE.replace('name = "bare"', f'name = "bare"\nq_camera_from_spacecraft = {with_norm(norm)}')


def loaded(folder, norm):
    (folder / "scene.toml").write_text(scene_text(norm))
    return load_scene(folder / "scene.toml").cameras[1].q_camera_from_spacecraft


def wire_state(norm):
    state = views.state().to_dict()
    state["bodies"]["body"]["q_from_inertial"] = with_norm(norm)
    return state


@pytest.mark.parametrize("off", [0.0, 9e-7, -9e-7])
def test_a_norm_within_1e_6_is_renormalised_in_silence(off, served, tmp_path, warnings):
    """By Python, by TOML and by the wire; to round-off."""
    exact = with_norm(1.0)
    np.testing.assert_allclose(Pose(r_inertial_m=[0, 0, 0], q_from_inertial=with_norm(1 + off)).q_from_inertial, exact,
                               atol=3e-16)
    np.testing.assert_allclose(loaded(tmp_path, 1.0 + off), exact, atol=3e-16)
    header, pixels = served("render", state=wire_state(1.0 + off), camera="bare")
    assert header["ok"] and pixels == served("render", state=wire_state(1.0), camera="bare")[1]
    np.testing.assert_allclose(np.linalg.norm(checked_directions([[0.0, 0.6, 0.8 + off]])), 1.0, atol=3e-16)
    assert warnings() == []


@pytest.mark.parametrize("off", [1.1e-6, 4e-5, 9.9e-4, -9.9e-4])
def test_a_norm_within_1e_3_is_renormalised_with_one_warning(off, served, tmp_path, warnings):
    """What people type has four digits. The warning has the field's path; once a process, however often it comes."""
    exact = with_norm(1.0)
    for _ in range(2):
        pose = Pose(r_inertial_m=[0, 0, 0], q_from_inertial=with_norm(1.0 + off))
        np.testing.assert_allclose(pose.q_from_inertial, exact, atol=3e-16)
        np.testing.assert_allclose(loaded(tmp_path, 1.0 + off), exact, atol=3e-16)
        header, pixels = served("render", state=wire_state(1.0 + off), camera="bare")
        assert header["ok"] and pixels == served("render", state=wire_state(1.0), camera="bare")[1]
        np.testing.assert_allclose(np.linalg.norm(checked_directions([[0.0, 0.0, 1.0], [0.0, 1.0 + off, 0.0]]), axis=1),
                                   1.0, atol=3e-16)
    told = warnings()
    assert len(told) == 4
    for message, path in zip(told, ("q_from_inertial", "scene.toml.cameras[1].q_camera_from_spacecraft",
                                    "state.bodies.body.q_from_inertial", "directions_camera[1]"), strict=True):
        assert message.startswith(f"{path}: norm must be 1 within 1e-06, is {1.0 + off:.9g}: renormalised; normalise")


@pytest.mark.parametrize("off", [1.01e-3, -1.01e-3, 0.04, -1.0])
def test_a_norm_beyond_1e_3_is_refused(off, served, tmp_path, warnings):
    """Everywhere by field, rule, value and the way out."""
    said = re.escape(f"norm must be 1 within 0.001, is {1.0 + off:.9g}, got [") + ".*; normalise .* before sending"
    with pytest.raises(ConfigError, match="^q_from_inertial: " + said):
        Pose(r_inertial_m=[0, 0, 0], q_from_inertial=with_norm(1.0 + off))
    with pytest.raises(ConfigError, match=r"^scene\.toml\.cameras\[1\]\.q_camera_from_spacecraft: " + said):
        loaded(tmp_path, 1.0 + off)
    error = served("render", state=wire_state(1.0 + off), camera="bare")[0]["error"]
    assert (error["code"], error["path"]) == ("config", "state.bodies.body.q_from_inertial")
    assert re.search(said, error["message"])
    with pytest.raises(ConfigError, match=r"^directions_camera\[0\]: " + said.replace("normalise .*", "normalise")):
        checked_directions([[0.0, 1.0 + off, 0.0]])
    assert warnings() == []


def test_a_warning_has_the_path_that_an_error_has(warnings):
    with error_path("scene"), error_path("cameras[1]"):
        validate.unit_quaternion("q_camera_from_spacecraft", with_norm(1.0001))
    assert warnings()[0].startswith("scene.cameras[1].q_camera_from_spacecraft: norm")
    assert path_of("q_from_inertial") == "q_from_inertial"


def test_warnings_end_with_a_thousand_fields(warnings):
    """Names of bodies come from the wire: no client fills the log, or memory."""
    for index in range(1100):
        Pose.from_dict({"r_inertial_m": [0, 0, 0], "q_from_inertial": with_norm(1.0001)}, f"state.bodies.b{index}")
    assert len(warnings()) == 1000


# From other tools


BASILISK = """
import json, sys
import numpy as np
from Basilisk.utilities import RigidBodyKinematics as rbk
answer = []
for dcm, sigma in json.load(sys.stdin):
    sigma = rbk.C2MRP(np.array(dcm)) if sigma is None else np.array(sigma)
    answer.append({"sigma": sigma.tolist(), "ep": rbk.MRP2EP(sigma).tolist(), "dcm": rbk.MRP2C(sigma).tolist()})
json.dump(answer, sys.stdout)
"""


def basilisk(*asked):
    """What Basilisk makes of (dcm, None) or (None, sigma): of each sigma, ep and dcm; `make basilisk` brings it."""
    python = os.environ.get("GLRENDER_BASILISK") or cache_folder() / "basilisk" / "bin" / "python"
    try:
        run = subprocess.run([python, "-c", BASILISK], input=json.dumps(asked), capture_output=True, text=True,
                             timeout=120, env={k: v for k, v in os.environ.items() if k != "PYTHONPATH"})
    except FileNotFoundError as error:
        missing(f"BASILISK ({error})", "make basilisk")
    assert run.returncode == 0, run.stderr
    return [{key: np.array(value) for key, value in each.items()} for each in json.loads(run.stdout)]


def spice():
    return needed_module("spiceypy", "pip install -e '.[test]'")


def of_scipy():
    """`apply` takes v_a to C v_a; the default is scalar last."""
    turns = [Rotation.from_matrix(dcm) for dcm in MATRICES]
    for turn, dcm in zip(turns, MATRICES, strict=True):
        np.testing.assert_allclose(turn.apply([1.0, 2.0, 3.0]), dcm @ [1.0, 2.0, 3.0], atol=1e-14)
        np.testing.assert_array_equal(np.roll(turn.as_quat(), 1), turn.as_quat(scalar_first=True))
    return [(dcm, turn.as_quat()) for turn, dcm in zip(turns, MATRICES, strict=True)]


def of_spice():
    """Random matrices, and the ecliptic's: its pole is (0, -sin, cos) of 84381.448 arcseconds in J2000 (IAU 1976)."""
    ecliptic, obliquity = spice().pxform("J2000", "ECLIPJ2000", 0.0), np.radians(84381.448 / 3600.0)
    np.testing.assert_allclose(ecliptic @ [0.0, -np.sin(obliquity), np.cos(obliquity)], [0.0, 0.0, 1.0], atol=1e-12)
    return [(dcm, spice().m2q(dcm)) for dcm in (*MATRICES, ecliptic)]


def of_basilisk():
    return [(dcm, each["ep"]) for dcm, each in zip(MATRICES, basilisk(*((dcm.tolist(), None) for dcm in MATRICES)),
                                                   strict=True)]


def of_matlab_aerospace():
    """MathWorks' printed examples: of dcm2quat both matrices, of quat2dcm both quaternions, of angle2quat the first."""
    yaw, pitch = 0.7854, 0.1
    about_z = [[np.cos(yaw), np.sin(yaw), 0.0], [-np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]]
    about_y = [[np.cos(pitch), 0.0, -np.sin(pitch)], [0.0, 1.0, 0.0], [np.sin(pitch), 0.0, np.cos(pitch)]]
    return [([[0, 1, 0], [1, 0, 0], [0, 0, -1]], [0, 0.7071, 0.7071, 0]),
            ([[0.4330, 0.2500, -0.8660], [0.1768, 0.9186, 0.3536], [0.8839, -0.3062, 0.3536]],
             [0.8224, 0.2006, 0.5320, 0.0223]),
            ([[0, 0, -1], [0, 1, 0], [1, 0, 0]], np.array([1, 0, 1, 0]) / np.sqrt(2.0)),
            ([[0.8519, 0.3704, -0.3704], [0.0741, 0.6148, 0.7852], [0.5185, -0.6963, 0.4963]],
             np.array([1.0, 0.5, 0.3, 0.1]) / np.sqrt(1.35)),
            (np.array(about_y) @ about_z, [0.9227, -0.0191, 0.0462, 0.3822])]


def of_matlab_robotics():
    """MathWorks' printed examples of rotm2quat and quat2rotm."""
    return [([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], [0.7071, 0, 0.7071, 0]),
            ([[1, 0, 0], [0, 0, -1], [0, 1, 0]], [0.7071, 0.7071, 0, 0])]


def of_ros_pose():
    """REP 103: yaw grows counter-clockwise from a's x. At 90 deg b's x is a's y: a rover that looks north."""
    return [([[0, 1, 0], [-1, 0, 0], [0, 0, 1]], [0.0, 0.0, 0.7071, 0.7071])]


def of_ros_lookup():
    """tf2's lookup_transform(target b, source a) is the pose of a in b: its columns are a's axes in b's components."""
    return [([[0, -1, 0], [1, 0, 0], [0, 0, 1]], [0.0, 0.0, 0.7071, 0.7071])]


def of_ccsds():
    """Orekit 13.1 reads A2B as Hipparchus' Rotation(QC, Q1, Q2, Q3): matrices of (0.8, 0.1, 0.2, 0.3) and 90 deg."""
    return [([[0.6666666666666663, 0.6666666666666665, -0.3333333333333333],
              [-0.5641025641025639, 0.7435897435897434, 0.3589743589743589],
              [0.4871794871794871, -0.0512820512820513, 0.8717948717948714]], np.array([1, 2, 3, 8]) / np.sqrt(78.0)),
            ([[0, 1, 0], [-1, 0, 0], [0, 0, 1]], np.array([0, 0, 1, 1]) / np.sqrt(2.0))]


TOOLS = {"SciPy": of_scipy, "SPICE": of_spice, "Basilisk": of_basilisk, "MATLAB Aerospace": of_matlab_aerospace,
         "MATLAB Robotics": of_matlab_robotics, "ROS tf2": of_ros_lookup, "ROS `Pose": of_ros_pose, "CCSDS": of_ccsds}
ROWS = [text for heading, text in blocks(PAGE) if heading == "Quaternions and vectors" and " | " in text]


def by_the_page(rule, q):
    """What a reader of the table's second column does with a tool's quaternion."""
    q = np.roll(q, 1) if "scalar last" in rule else np.asarray(q)
    assert ("conjugate" in rule) + ("as it is" in rule) + ("scalar last" in rule and "conjugate" not in rule) == 1, rule
    return q * [1, -1, -1, -1] if "conjugate" in rule else q


@pytest.mark.parametrize("row", ROWS, ids=[row[:12] for row in ROWS])
def test_a_row_of_the_table_gives_the_attitude(row):
    """Of a tool's own quaternion the row's rule makes the matrix C that the tool had it from; 1e-4 where digits are
    printed."""
    tool, rule = row.split(" | ")
    pairs, = (TOOLS[name] for name in TOOLS if tool.startswith(name))
    for dcm, q in pairs():
        np.testing.assert_allclose(frames.dcm(by_the_page(rule, q)), dcm, atol=1.5e-4)
    assert all(callable(getattr(glrender, name)) for name in re.findall(r"`glrender\.(\w+)", rule))


def test_spices_matrices_and_quaternions_are_taken():
    """1e-14, with leading axes; SPICE's own q2m is the way back."""
    matrices = np.concatenate([MATRICES, NEAR_180_DEG])
    quaternions = np.array([spice().m2q(dcm) for dcm in matrices])
    for found in (from_spice(matrices), from_spice(quaternions)):
        for q, dcm in zip(found, matrices, strict=True):
            assert q[0] >= 0.0
            np.testing.assert_allclose(spice().q2m(q), dcm, atol=1e-14)
            np.testing.assert_allclose(frames.dcm(q), dcm, atol=1e-14)


def test_basilisks_mrps_are_taken():
    """Its own MRP2C of both sets, the long way round and near 180 deg too, 1e-13."""
    rng = np.random.default_rng(5)
    axes = rng.standard_normal((40, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    lengths = np.concatenate([[0.0, 1e-9, 1.0, 1.0 - 1e-12, 1.0 + 1e-12, 1e3], rng.uniform(0.0, 3.0, 34)])
    answers = basilisk(*((None, sigma.tolist()) for sigma in lengths[:, None] * axes),
                       *((dcm.tolist(), None) for dcm in NEAR_180_DEG))
    sigma = np.array([each["sigma"] for each in answers])
    for q, each in zip(from_basilisk_mrp(sigma), answers, strict=True):
        assert q[0] >= 0.0
        np.testing.assert_allclose(frames.dcm(q), each["dcm"], atol=1e-13)
    np.testing.assert_allclose(np.array([each["dcm"] for each in answers[40:]]), NEAR_180_DEG, atol=1e-7)


def test_modified_rodrigues_parameters_have_their_closed_form():
    """tan(angle / 4) times the axis of the frame's turn, of both sets, to lengths whose squares overflow; 1e-14."""
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    for angle in np.radians([0.0, 1.0, 90.0, 179.999999, 180.0, 180.000001, 270.0, 359.0]):
        dcm = Rotation.from_rotvec(-angle * axis).as_matrix()
        sigma = np.tan(angle / 4.0) * axis
        np.testing.assert_allclose(frames.dcm(from_basilisk_mrp(sigma)), dcm, atol=1e-14)
        if angle:
            np.testing.assert_allclose(frames.dcm(from_basilisk_mrp(-sigma / (sigma @ sigma))), dcm, atol=1e-14)
    np.testing.assert_array_equal(from_basilisk_mrp([1e200, -1e200, 0.0]), [1.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(from_basilisk_mrp([0.0, 0.0, 1.0]), [0.0, 0.0, 0.0, -1.0])


def test_matlabs_matrices_and_quaternions_are_taken():
    """Those that MathWorks prints (1e-4), and any: dcm2quat is b0 = sqrt(1 + trace) / 2, b1 = (C23 - C32) / (4 b0)."""
    for dcm, q in of_matlab_aerospace():
        np.testing.assert_allclose(frames.dcm(from_matlab_dcm(dcm)), dcm, atol=1.5e-4)
        np.testing.assert_allclose(frames.dcm(from_matlab_quat(q)), dcm, atol=1.5e-4)
    b0 = 0.5 * np.sqrt(1.0 + np.trace(MATRICES, axis1=1, axis2=2))
    crossed = MATRICES - np.swapaxes(MATRICES, 1, 2)
    passive = np.stack([b0, *(crossed[:, i, j] / 4.0 / b0 for i, j in ((1, 2), (2, 0), (0, 1)))], axis=1)
    np.testing.assert_allclose(from_matlab_quat(passive), from_matlab_dcm(MATRICES), atol=1e-12)


def test_matrices_near_180_deg_are_taken():
    """1e-14: no component is divided by a w that is round-off."""
    for q, dcm in zip(from_matlab_dcm(NEAR_180_DEG), NEAR_180_DEG, strict=True):
        np.testing.assert_allclose(frames.dcm(q), dcm, atol=1e-14)
    assert len({tuple(np.round(q, 6) + 0.0) for q in from_matlab_dcm(NEAR_180_DEG[:3])}) == 3


def test_leading_axes_are_kept():
    many = Rotation.random(24, random_state=1)
    matrices = many.as_matrix().reshape(2, 3, 4, 3, 3)
    for found in (from_matlab_dcm(matrices), from_spice(matrices),
                  from_spice(many.as_quat(scalar_first=True).reshape(2, 3, 4, 4)),
                  from_matlab_quat(many.inv().as_quat(scalar_first=True).reshape(2, 3, 4, 4)),
                  from_basilisk_mrp(many.inv().as_mrp().reshape(2, 3, 4, 3))):
        assert found.shape == (2, 3, 4, 4)
        np.testing.assert_allclose(frames.dcm(found.reshape(24, 4)), many.as_matrix(), atol=1e-13)
    assert from_matlab_dcm(np.zeros((0, 3, 3))).shape == from_basilisk_mrp(np.zeros((0, 3))).shape == (0, 4)
    for one in (from_matlab_dcm(np.eye(3)), from_spice([1, 0, 0, 0]), from_basilisk_mrp([0, 0, 0])):
        np.testing.assert_array_equal(one, [1.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("convert, value, message", [
    (from_matlab_dcm, np.diag([1.0, 1.0, -1.0]), "dcm_b_from_a: must be a rotation, but mirrors.*left-handed"),
    (from_matlab_dcm, 1.002 * np.eye(3), "dcm_b_from_a: rows must be orthonormal within 0.001, are off by .*scale"),
    (from_matlab_dcm, [np.eye(3), np.ones((3, 3))], r"dcm_b_from_a\[1\]: rows must be orthonormal"),
    (from_matlab_dcm, np.zeros((3, 3)), "rows must be orthonormal"),
    (from_matlab_dcm, np.zeros((3, 3, 7)), r"must have shape \(..., 3, 3\), got \(3, 3, 7\); .*np.moveaxis"),
    (from_matlab_dcm, [1.0, 0.0, 0.0, 0.0], r"must have shape \(..., 3, 3\)"),
    (from_matlab_dcm, np.full((3, 3), np.nan), "must be finite"),
    (from_matlab_quat, [0.9, 0.0, 0.0, 0.0], "quat: norm must be 1 within 0.001, is 0.9"),
    (from_matlab_quat, [0.0, 0.0, 0.0, 0.0], "quat: norm must be 1"),
    (from_matlab_quat, [1.0, 0.0, 0.0], r"quat: must have shape \(..., 4\)"),
    (from_basilisk_mrp, [0.0, np.inf, 0.0], "sigma_BN: must be finite"),
    (from_basilisk_mrp, [1.0, 0.0, 0.0, 0.0], r"sigma_BN: must have shape \(..., 3\)"),
    (from_basilisk_mrp, ["0", "0", "0"], "sigma_BN: must be numbers"),
    (from_spice, np.eye(6), r"rotation: must have shape \(..., 3, 3\) or \(..., 4\), got \(6, 6\)"),
    (from_spice, -np.eye(3), "rotation: must be a rotation, but mirrors"),
    (from_spice, [[1.0, 0.0, 0.0, 0.0], [1.0, 1.0, 0.0, 0.0]], r"rotation\[1\]: norm must be 1"),
    (from_spice, [[1.0], [1.0, 2.0]], "rotation: must be numbers"), (from_spice, None, "rotation: must be numbers")])
def test_what_is_no_rotation_is_refused_in_words(convert, value, message, warnings):
    with pytest.raises(ConfigError, match=message):
        convert(value)
    assert warnings() == []


def test_a_matrix_of_four_digits_is_taken_with_a_warning(warnings):
    from_matlab_dcm(np.round(MATRICES[0], 4))
    from_spice(np.round(MATRICES[0], 9))
    told, = warnings()
    assert told.startswith("dcm_b_from_a: rows must be orthonormal within 1e-06, are off by")


@pytest.fixture(scope="module")
def marker_renderer():
    camera = PinholeCamera(name="c", width_px=300, height_px=300, focal_length_px=600.0)
    body = Body(name="b", shape=Shape.from_arrays(R_MARKER_M, FACETS), brdf=Lambert(normal_albedo=0.3))
    with Renderer(Scene(bodies=[body], cameras=[camera])) as renderer:
        yield renderer


@pytest.mark.parametrize("convert, number", [
    (from_matlab_dcm, lambda dcm: dcm), (from_spice, lambda dcm: dcm),
    (from_matlab_quat, lambda dcm: Rotation.from_matrix(dcm.T).as_quat(scalar_first=True)),
    (from_basilisk_mrp, lambda dcm: Rotation.from_matrix(dcm.T).as_mrp())])
def test_a_marker_is_seen_where_the_matrix_puts_it(marker_renderer, convert, number):
    """Within a pixel; the conjugate is 150 px off. Of the body's attitude, then of the spacecraft's."""
    dcm = Rotation.from_rotvec([-0.09, 0.17, -0.87]).as_matrix()
    sun = [0.0, 0.0, -1.5e11]
    state = State(r_sun_inertial_m=sun, spacecraft=Pose(r_inertial_m=[0, 0, -600]),
                  bodies={"b": Pose(r_inertial_m=[0, 0, 0], q_from_inertial=convert(number(dcm)))})
    seen = dcm.T @ R_MARKER_M.mean(axis=0) + [0.0, 0.0, 600.0]
    np.testing.assert_allclose(place_px(marker_renderer, state), 149.5 + 600.0 * seen[:2] / seen[2], atol=1.0)
    r_craft = R_MARKER_M.mean(axis=0) - 600.0 * dcm.T @ [0.1, -0.15, 1.0]
    state = State(r_sun_inertial_m=sun, bodies={"b": Pose(r_inertial_m=[0, 0, 0])},
                  spacecraft=Pose(r_inertial_m=r_craft, q_from_inertial=convert(number(dcm))))
    np.testing.assert_allclose(place_px(marker_renderer, state), 149.5 + 600.0 * np.array([0.1, -0.15]), atol=1.0)


def place_px(renderer, state):
    y, x = np.nonzero(renderer.render(state, products=["body_id"]).products["body_id"] >= 0)
    return np.array([x.mean(), y.mean()])


def test_scipys_and_ross_are_what_the_page_says():
    """Rotations one by one and in a stack; a pose of a rover that looks north, as a message and as numbers."""
    for dcm in MATRICES:
        np.testing.assert_allclose(frames.dcm(from_scipy(Rotation.from_matrix(dcm))), dcm, atol=1e-14)
    assert from_scipy(Rotation.from_matrix(MATRICES)).shape == (len(MATRICES), 4)
    ((matrix, orientation),) = of_ros_pose()
    message = SimpleNamespace(**dict(zip("xyzw", orientation, strict=True)))
    for given in (message, orientation, np.tile(orientation, (2, 1))):
        np.testing.assert_allclose(frames.dcm(from_ros(given)).reshape(-1, 3, 3)[-1], matrix, atol=1e-4)
    ((matrix, orientation),) = of_ros_lookup()
    np.testing.assert_allclose(frames.dcm(from_ros(orientation)).T, matrix, atol=1e-4)
    for wrong, message in ((lambda: from_scipy([0.0, 0.0, 0.0, 1.0]), "rotation: must be a scipy Rotation"),
                           (lambda: from_ros([0.0, 0.0, 1.0, 1.0]), "orientation: norm must be 1 within 0.001"),
                           (lambda: from_ros([0.0, 0.0, 1.0]), "orientation: must have shape")):
        with pytest.raises(ConfigError, match=message):
            wrong()
