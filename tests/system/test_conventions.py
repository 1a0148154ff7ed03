"""docs/conventions.md, block by block: other tools' attitudes with the tools themselves, and whatever else it says."""

from __future__ import annotations

import json
import logging
import os
import re
import subprocess
import tomllib
from pathlib import Path

import glrender
import msgpack
import numpy as np
import pytest
import serving
import views
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
    from_spice,
    generate,
    load_scene,
)
from glrender.base.constants import AU_M
from glrender.base.disk_cache import cache_folder
from glrender.brdf import Lambert
from glrender.engines.image import PRODUCTS
from glrender.engines.rays.laser_ranges import checked_directions
from glrender.scene.solar_irradiance import Band
from glrender.view.light_time import apparent_state
from glrender_camera import Detector, MosaicModel, Optics, validate
from glrender_camera.errors import error_path, path_of
from glrender_server.operations import Operations
from missing import missing, needed_module
from scipy.spatial.transform import Rotation

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "conventions.md").read_text(encoding="utf-8")

# Which tests try which block: by the page's headings, and the words that a paragraph, an item or a row begins with.
CHECKS = {
    "Conventions": {"Every number": ["test_every_block_of_the_page_is_tried"]},
    "Units and types": {
        "SI, radians": ["test_documented_scene_files_have_units_in_their_names",
                        "test_what_the_wire_sends_has_its_units", "test_all_that_is_given_becomes_float64",
                        "test_any_origin_of_inertial_gives_the_same_bytes"]},
    "Quaternions and vectors": {
        "`q_b_from_a`": ["test_quaternion_is_scalar_first_and_takes_x_to", "test_the_anchor"],
        "A norm within": ["test_a_norm_within_1e_6_is_renormalised_in_silence",
                          "test_a_norm_within_1e_3_is_renormalised_with_one_warning",
                          "test_a_norm_beyond_1e_3_is_refused", "test_both_signs_of_a_quaternion_are_one_attitude"],
        "`r_x_f_m`": ["test_the_mounting_is_applied"],
        "From other tools": ["test_a_row_of_the_table_gives_the_attitude"],
        "`tests/system/test_conventions.py`": ["test_a_row_of_the_table_gives_the_attitude"],
        **dict.fromkeys(("SciPy", "SPICE", "Basilisk", "MATLAB Aerospace", "MATLAB Robotics", "ROS tf2", "ROS `Pose",
                         "CCSDS"), ["test_a_row_of_the_table_gives_the_attitude"])},
    "Frames": {
        "`inertial`": ["test_any_origin_of_inertial_gives_the_same_bytes",
                       "test_any_axes_of_inertial_give_the_same_image"],
        "`body`": ["test_body_attitude_turns_the_body_not_the_sky", "test_a_marker_is_seen_where_the_matrix_puts_it"],
        "`spacecraft`": ["test_the_mounting_is_applied"],
        "`camera`": ["test_a_marker_lights_the_pixel_whose_centre_it_covers"],
        "`pixel`": ["test_a_marker_lights_the_pixel_whose_centre_it_covers"],
        "Arrays are": ["test_a_marker_lights_the_pixel_whose_centre_it_covers",
                       "test_a_sphere_on_the_boresight_is_centred_on_the_principal_point",
                       "test_the_principal_point_moves_the_sphere"]},
    "Time": {"`t_s` is": ["test_time_and_velocities_change_no_still_image", "test_what_is_left_out_has_pythons_default",
                          "test_light_takes_a_third_of_a_millisecond_for_100_km",
                          "test_a_body_is_seen_where_it_was_when_its_light_left",
                          "test_a_body_is_aberrated_as_a_star_is", "test_stellar_aberration_is_the_closed_form"]},
    "Rates": {"A pose may": ["test_a_pose_turns_as_its_gyroscope_says", "test_a_passing_body_is_blurred_along_its_way",
                             "test_stellar_aberration_is_the_closed_form", "test_the_sun_stands_still"]},
    "Photometry": {
        "A law returns": ["test_radf_of_lambert_is_albedo_times_cosine", "test_lambert_is_its_albedo_over_pi"],
        "The Sun lights": ["test_the_suns_direction_is_that_of_the_bodys_origin",
                           "test_the_suns_distance_is_that_of_each_bodys_origin", "test_a_straight_edges_penumbra",
                           "test_a_point_sun_on_request"],
        "`irradiance_W_m2`": ["test_solid_angle_falls_off_as_cos_cubed", "test_flux_of_a_sphere",
                              "test_flux_does_not_depend_on_range_down_to_a_thousandth_of_a_pixel"],
        "Irradiance is": ["test_the_suns_irradiance_is_that_of_the_cameras_band",
                          "test_the_irradiance_of_a_scene_and_of_a_mosaic",
                          "test_a_mosaic_counts_what_one_camera_in_each_band_counts"]},
    "Determinism": {"The same": ["test_the_same_request_gives_the_same_bytes_whatever_came_before"]},
}


def blocks(page):
    """(heading, text) of every paragraph, item and row of a table; a table's head is none."""
    for section in re.split(r"(?m)^#+ ", page)[1:]:
        heading, _, text = section.partition("\n")
        for part in re.split(r"\n\s*\n", text.strip()):
            if part.startswith("|"):
                yield from ((heading, row.strip("| ")) for row in part.splitlines()[2:])
            else:
                yield from ((heading, item) for item in re.split(r"(?m)^- ", part) if item)


def test_every_block_of_the_page_is_tried():
    """A new sentence needs a test: each block belongs to one entry of CHECKS, whose tests are there."""
    defined = {name for file in (ROOT / "tests").glob("**/test_*.py")
               for name in re.findall(r"^def (test_\w+)", file.read_text(encoding="utf-8"), re.M)}
    met = []
    for heading, text in blocks(PAGE):
        keys = [key for key in CHECKS[heading] if text.startswith(key)]
        assert len(keys) == 1, f"{heading}: {len(keys)} entries of CHECKS for {text[:60]!r}"
        met.append((heading, keys[0]))
        assert set(CHECKS[heading][keys[0]]) <= defined, set(CHECKS[heading][keys[0]]) - defined
    assert sorted(met) == sorted((heading, key) for heading in CHECKS for key in CHECKS[heading])


# Units and types


UNITS = ("m", "px", "s", "ms", "ns", "deg", "rad", "rad_s", "m_s", "nm", "W_m2", "electrons", "DN", "K", "kg_m3", "au")
# Numbers [1], counts and years of the scene files in docs/.
PURE = {"B", "R", "albedo_texture_gain", "aspect", "b", "bit_depth", "c", "central_obscuration", "coverage", "depth",
        "exponent", "extinction_efficiency", "f_number", "geometric_albedo", "grid", "height", "k1", "magnitude_limit",
        "max_error", "max_step", "normal_albedo", "p1", "percentile", "q_camera_from_spacecraft", "quantum_efficiency",
        "seed", "single_scattering_albedo", "target", "transmission", "veiling_glare", "veiling_glare_beyond",
        "wing_exponent", "wing_fraction", "year"}
# Numbers [1], versions, counts and indices of the wire, and a region's pixels.
PURE_ON_THE_WIRE = {"v", "id", "part", "shape", "seed", "q_from_inertial", "roi"}


def numbers_of(table):
    """The names of all numbers, and of lists of numbers, in tables and tables of tables."""
    for name, value in table.items():
        values = value if isinstance(value, list) and value else [value]
        if all(isinstance(each, dict) for each in values):
            for each in values:
                # What takes milliseconds, and in what unit they are, the outer name says.
                yield from (name,) if name.endswith("_ms") else numbers_of(each)
        elif all(isinstance(each, (int, float)) and not isinstance(each, bool) for each in values):
            yield name


def without_unit(names):
    return {name for name in names if not re.search(rf"_({'|'.join(UNITS)}|\w+_per_\w+)$", name)}


def test_documented_scene_files_have_units_in_their_names():
    """Every number of the TOML in docs/ ends in its unit, but for those that have none."""
    tables = [tomllib.loads(text) for page in sorted((ROOT / "docs").glob("*.md"))
              for text in re.findall(r"```toml\n(.*?)```", page.read_text(encoding="utf-8"), re.S)]
    found = [name for table in tables for name in numbers_of(table)]
    assert len(found) > 60 and without_unit(found) <= PURE, without_unit(found) - PURE


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """ask(op, **fields): the header of a reply, its arrays' bytes behind it, from what serves in a server."""
    operations = Operations(Scene.from_dict(tomllib.loads(serving.SCENE)))

    def ask(op, **fields):
        parts, _ = operations.answer({"v": 1, "id": 1, "client": "test", "op": op, **fields})
        return msgpack.unpackb(parts[0]), [bytes(part) for part in parts[1:]]

    yield ask
    operations.close()


def test_what_the_wire_sends_has_its_units(served):
    """Every number of replies ends in its unit, but for those that have none; an array tells it."""
    state = views.state(range_m=1500.0).to_dict()
    header, _ = served("render", state=state, camera="navcam", output="dn", seed=3, exposure_s=0.01, roi=[0, 0, 90, 60],
                       products=[name for name in PRODUCTS if name != "irradiance"])
    assert header["ok"], header
    assert {each["name"]: each["unit"] for each in header["arrays"]} == {
        "image": "DN", "range": "m", "body_id": "1", "facet_id": "1", "incidence": "rad", "emission": "rad",
        "phase": "rad", "r_body": "m", "sunlit": "1"}
    assert served("render", state=state, camera="bare")[0]["arrays"][0]["unit"] == "W/m2"
    # The plan's and the stages' words are docs/protocol.md's.
    found = {*numbers_of({key: header[key] for key in header if key not in ("plan", "stages")}), *numbers_of(state)}
    assert {"t_s", "exposure_s", "timings_ms", "r_inertial_m", "roi", "n_saturated_px"} <= found
    assert without_unit(found) <= PURE_ON_THE_WIRE, without_unit(found) - PURE_ON_THE_WIRE


def test_all_that_is_given_becomes_float64():
    """From float32, integers and lists, in the Python interface."""
    short = np.float32([1.0, 2.0, 3.0])
    pose = Pose(r_inertial_m=short, q_from_inertial=np.float32([1, 0, 0, 0]), v_inertial_m_s=[1, 2, 3],
                angular_velocity_rad_s=short)
    shape = Shape.from_arrays(np.float32(R_MARKER_M), FACETS)
    camera = PinholeCamera(name="c", width_px=4, height_px=4, focal_length_px=10, r_camera_spacecraft_m=short)
    for array in (pose.r_inertial_m, pose.q_from_inertial, pose.v_inertial_m_s, pose.angular_velocity_rad_s,
                  State(r_sun_inertial_m=[AU_M, 0, 0], spacecraft=pose, bodies={}).r_sun_inertial_m, shape.vertices_m,
                  camera.r_camera_spacecraft_m, camera.q_camera_from_spacecraft, from_basilisk_mrp(short)):
        assert array.dtype == np.float64


# Quaternions and vectors


# A marker 100 m along the body's x.
R_MARKER_M = np.array([[100.0, 0, 0], [104, 0, 0], [100, 4, 0], [100, 0, 4]])
FACETS = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
# On a square of 2 by 2, its tip away from what comes along +Z.
PYRAMID = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [0, 0, 1]])
PYRAMID_FACETS = np.array([[0, 2, 1], [0, 3, 2], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
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


# Frames


def three_lobes(state, **options):
    """Image of an asymmetric body, with its products."""
    shape = generate.three_lobes(radius_m=100.0, subdivisions=3)
    body = Body(name="body", shape=shape, brdf=Lambert(normal_albedo=0.3))
    with Renderer(views.scene([body], [views.camera(64, 400.0)])) as renderer:
        return renderer.render(state, products=["range", "facet_id", "r_body"], **options)


def same_bytes(one, other):
    assert one.irradiance_W_m2.any() and one.irradiance_W_m2.tobytes() == other.irradiance_W_m2.tobytes()
    for name, product in one.products.items():
        np.testing.assert_array_equal(product, other.products[name])


def test_any_origin_of_inertial_gives_the_same_bytes():
    """All moved by 1e15 m, in eighths of a metre, whose differences float64 has exactly."""
    state = views.state(phase_deg=50.0)
    grid = lambda r: np.round(np.asarray(r)[:3] * 8.0) / 8.0  # noqa: E731
    moved_by = np.array([2.0**49, -(2.0**48), 2.0**47 + 0.125])
    moved = lambda by: State(r_sun_inertial_m=grid(state.r_sun_inertial_m) + by, spacecraft=Pose(  # noqa: E731
        r_inertial_m=grid(state.spacecraft.r_inertial_m) + by, q_from_inertial=state.spacecraft.q_from_inertial),
        bodies={"body": Pose(r_inertial_m=by)})
    same_bytes(three_lobes(moved(np.zeros(3))), three_lobes(moved(moved_by)))


def test_any_axes_of_inertial_give_the_same_image():
    """All turned: irradiance within 1e-4 of the mean, ranges within 1e-6."""
    state, turn = views.state(phase_deg=50.0), Rotation.from_rotvec([0.3, -1.2, 2.0]).as_matrix()
    turned = lambda pose: Pose(  # noqa: E731
        r_inertial_m=turn @ pose.r_inertial_m,
        q_from_inertial=frames.quaternion(frames.dcm(pose.q_from_inertial) @ turn.T))
    one = three_lobes(state)
    other = three_lobes(State(r_sun_inertial_m=turn @ state.r_sun_inertial_m, spacecraft=turned(state.spacecraft),
                              bodies={name: turned(pose) for name, pose in state.bodies.items()}))
    assert views.relative_rms(other.irradiance_W_m2, one.irradiance_W_m2.astype(float)) < 1e-4
    seen = np.isfinite(one.products["range"]) & np.isfinite(other.products["range"])
    assert seen.sum() > 100
    np.testing.assert_allclose(other.products["range"][seen], one.products["range"][seen], rtol=1e-6)


@pytest.mark.parametrize("x_px, y_px", [(0, 0), (18, 0), (0, 12), (18, 12), (4, 9), (9, 4)])
def test_a_marker_lights_the_pixel_whose_centre_it_covers(x_px, y_px):
    """0.6 px wide, at 19 x 13 px: alone in its pixel, [row, column], or in none when it stands between centres."""
    camera = PinholeCamera(name="c", width_px=19, height_px=13, focal_length_px=100.0)
    body = Body(name="b", shape=Shape.from_arrays(3.0 * PYRAMID, PYRAMID_FACETS), brdf=Lambert(normal_albedo=0.3))

    def hit(dx_px, dy_px):
        # +X to the right of the image, +Y down; the image's middle is pixel (9, 6).
        place = [(x_px + dx_px - 9.0) * 10.0, (y_px + dy_px - 6.0) * 10.0, 1000.0]
        state = State(r_sun_inertial_m=[0, 0, -AU_M], spacecraft=Pose(r_inertial_m=[0, 0, 0]),
                      bodies={"b": Pose(r_inertial_m=place)})
        products = renderer.render(state, products=["body_id", "range"]).products
        assert products["body_id"].shape == (13, 19)
        np.testing.assert_array_equal(np.isfinite(products["range"]), products["body_id"] == 0)
        return np.argwhere(products["body_id"] == 0).tolist()

    with Renderer(Scene(bodies=[body], cameras=[camera])) as renderer:
        for dx_px, dy_px in ((0.0, 0.0), (0.25, -0.25), (-0.25, 0.25)):
            assert hit(dx_px, dy_px) == [[y_px, x_px]]
        assert hit(0.45, 0.0) == hit(0.0, -0.45) == []


# Time


def test_time_and_velocities_change_no_still_image():
    """t_s is carried through, and nothing is moved by light time or aberration: the same bytes."""
    state = views.state(phase_deg=50.0, range_m=1500.0)
    moving = lambda pose, v: Pose(  # noqa: E731
        r_inertial_m=pose.r_inertial_m, q_from_inertial=pose.q_from_inertial, v_inertial_m_s=v,
        angular_velocity_rad_s=[0.0, 0.3, 0.0])
    other = State(t_s=8e8, r_sun_inertial_m=state.r_sun_inertial_m,
                  spacecraft=moving(state.spacecraft, [3e4, -2e7, 1e4]),
                  bodies={"body": moving(state.bodies["body"], [-2e7, 0.0, 1e4])})
    same_bytes(three_lobes(state), three_lobes(other))


def test_light_takes_a_third_of_a_millisecond_for_100_km():
    """By the body's own motion in `apparent_state`: 0.33 m at 1 km/s."""
    state = State(r_sun_inertial_m=[AU_M, 0, 0], spacecraft=Pose(r_inertial_m=[0, 0, 0]),
                  bodies={"b": Pose(r_inertial_m=[0, 0, 1e5], v_inertial_m_s=[1e3, 0, 0])})
    seen = apparent_state(state, aberration=False).bodies["b"].r_inertial_m
    np.testing.assert_allclose(seen[0] / -1e3, 0.33e-3, atol=0.005e-3)


def test_what_is_left_out_has_pythons_default(served):
    """t_s 0 and the axes of `inertial`, in Python, in State.from_dict and in a reply."""
    r_sun, r_craft, r_body = [0.0, 0.0, -AU_M], [0.0, 0.0, -1500.0], [0.0, 0.0, 0.0]
    short = {"r_sun_inertial_m": r_sun, "spacecraft": {"r_inertial_m": r_craft},
             "bodies": {"body": {"r_inertial_m": r_body}}}
    whole = {"t_s": 0.0, "r_sun_inertial_m": r_sun,
             "spacecraft": {"r_inertial_m": r_craft, "q_from_inertial": [1.0, 0.0, 0.0, 0.0]},
             "bodies": {"body": {"r_inertial_m": r_body, "q_from_inertial": [1.0, 0.0, 0.0, 0.0]}}}
    in_python = State(r_sun_inertial_m=r_sun, spacecraft=Pose(r_inertial_m=r_craft),
                      bodies={"body": Pose(r_inertial_m=r_body)})
    assert State.from_dict(short).to_dict() == in_python.to_dict() == whole
    (header, pixels), (_, expected) = (served("render", state=state, camera="bare") for state in (short, whole))
    assert header["t_s"] == 0.0 and pixels == expected and np.frombuffer(pixels[0], np.float32).any()
    header, _ = served("range", state=short, camera="bare", directions_camera=[[0.0, 0.0, 1.0]])
    assert header["ok"] and header["t_s"] == 0.0
    for path in ("r_sun_inertial_m", "spacecraft", "bodies", "spacecraft.r_inertial_m", "bodies.body.r_inertial_m"):
        *way, last = path.split(".")
        bad = json.loads(json.dumps(short))
        table = bad
        for name in way:
            table = table[name]
        del table[last]
        error = served("render", state=bad, camera="bare")[0]["error"]
        assert (error["code"], error["path"]) == ("config", f"state.{path}") and "missing" in error["message"]
    for wrong in (None, "now", float("nan")):
        assert served("render", state={**short, "t_s": wrong}, camera="bare")[0]["error"]["path"] == "state.t_s"


# Rates


def test_the_sun_stands_still():
    state = views.state()
    moving = State(r_sun_inertial_m=state.r_sun_inertial_m, bodies=state.bodies,
                   spacecraft=Pose(r_inertial_m=state.spacecraft.r_inertial_m, v_inertial_m_s=[3e4, 0, 0]))
    after = moving.after(10.0)
    np.testing.assert_array_equal(after.r_sun_inertial_m, moving.r_sun_inertial_m)
    np.testing.assert_array_equal(after.spacecraft.r_inertial_m, moving.spacecraft.r_inertial_m + [3e5, 0.0, 0.0])


# Photometry


def test_lambert_is_its_albedo_over_pi():
    z, aside = np.array([0.0, 0.0, 1.0]), np.array([0.6, 0.0, 0.8])
    np.testing.assert_allclose(Lambert(normal_albedo=0.3).brdf(aside, z, z), 0.3 / np.pi, rtol=1e-15)


def test_the_suns_direction_is_that_of_the_bodys_origin():
    """One direction for all of a body; of a shape 3000 km from its origin that of its middle, 4e-4 rad off; to 1e-5."""
    shape = Shape.from_arrays(1e5 * PYRAMID + [3e6, 0.0, 0.0], PYRAMID_FACETS)
    body = Body(name="b", shape=shape, brdf=Lambert(normal_albedo=0.3))
    camera = PinholeCamera(name="c", width_px=32, height_px=32, focal_length_px=100.0)
    sun = 5e9 * np.array([0.6, 0.0, -0.8])
    state = State(r_sun_inertial_m=sun, spacecraft=Pose(r_inertial_m=[3e6, 0, -1e6]),
                  bodies={"b": Pose(r_inertial_m=[0, 0, 0])})
    with Renderer(Scene(bodies=[body], cameras=[camera])) as renderer:
        incidence = renderer.render(state, products=["incidence"]).products["incidence"]
    seen = incidence[np.isfinite(incidence)]
    middle = 0.5 * (shape.vertices_m.min(axis=0) + shape.vertices_m.max(axis=0)) - sun
    assert len(seen) > 100 and abs(np.arccos(middle[2] / np.linalg.norm(middle)) - np.arccos(0.8)) > 3e-4
    np.testing.assert_allclose(seen, np.arccos(middle[2] / np.linalg.norm(middle)), atol=1e-5)


def test_the_suns_distance_is_that_of_each_bodys_origin():
    """Two spheres of one size in the frame, at 2e9 and 3e9 m from the Sun: F (R / range)^2 of each; 0.5 %."""
    bodies = [views.sphere(Lambert(normal_albedo=0.3), 4, radius_m, name)
              for name, radius_m in (("near", 1e4), ("far", 1.001e7))]
    state = State(r_sun_inertial_m=[0, 0, -2e9], spacecraft=Pose(r_inertial_m=[0, 0, -1e6]), bodies={
        "near": Pose(r_inertial_m=[-3e4, 0, 0]), "far": Pose(r_inertial_m=[3.003e7, 0, 1e9])})
    with Renderer(views.scene(bodies, [views.camera(128)], sun_disc=False)) as renderer:
        image = renderer.render(state, samples=4).irradiance_W_m2.astype(np.float64)
    np.testing.assert_allclose(image[:, :64].sum() / image[:, 64:].sum(), 1.5**2, rtol=5e-3)


def test_the_irradiance_of_a_scene_and_of_a_mosaic():
    """What a scene gives; of a mosaic that of its pattern's first letter, E490's of 600 to 700 nm of R."""
    bands = {"R": (600.0, 700.0), "G": (500.0, 600.0), "B": (400.0, 500.0)}
    detector = Detector(quantum_efficiency=0.5, full_well_electrons=1e5, gain_DN_per_electron=0.04, bit_depth=12)
    body = views.sphere(Lambert(normal_albedo=0.5), 1)
    for pattern, first in ((("RG", "GB"), "R"), (("GR", "BG"), "G"), (("BG", "GR"), "B")):
        optics = {letter: Optics(aperture_diameter_m=0.01, band_nm=band) for letter, band in bands.items()}
        camera = views.camera(32, model=MosaicModel(optics=optics, detector=detector, exposure_s=1e-3, pattern=pattern))
        scene = Scene(bodies=[body], cameras=[camera])
        np.testing.assert_allclose(scene.solar_irradiance_of(camera), Band.box(*bands[first]).irradiance_1au_W_m2)
    given = Scene(bodies=[body], cameras=[views.camera(32)], solar_irradiance_1au_W_m2=594.0)
    assert given.solar_irradiance_of(given.cameras[0]) == 594.0
    with Renderer(given) as one, Renderer(Scene(bodies=[body], cameras=[views.camera(32)])) as other:
        ratio = one.render(views.state()).irradiance_W_m2.sum() / other.render(views.state()).irradiance_W_m2.sum()
    np.testing.assert_allclose(ratio, 594.0 / 1360.8, rtol=1e-6)
