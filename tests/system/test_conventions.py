"""docs/conventions.md, block by block; attitudes of other tools are in test_attitudes.py."""

from __future__ import annotations

import json
import re
import tomllib

import numpy as np
import pytest
import views
from conventions import FACETS, PAGE, PYRAMID, PYRAMID_FACETS, R_MARKER_M, ROOT, blocks
from glrender import Body, PinholeCamera, Pose, Renderer, Scene, Shape, State, frames, from_basilisk_mrp, generate
from glrender.base.constants import AU_M
from glrender.base.names import PRODUCTS
from glrender.brdf import Lambert
from glrender.scene.solar_irradiance import Band
from glrender.view.light_time import apparent_state
from glrender_camera import Detector, MosaicModel, Optics
from scipy.spatial.transform import Rotation

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
        "`tests/system/test_attitudes.py`": ["test_a_row_of_the_table_gives_the_attitude"],
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
        "Each body has": ["test_the_suns_direction_is_that_of_the_bodys_origin",
                           "test_the_suns_distance_is_that_of_each_bodys_origin", "test_a_straight_edges_penumbra",
                           "test_a_point_sun_on_request"],
        "`irradiance_W_m2`": ["test_solid_angle_falls_off_as_cos_cubed", "test_flux_of_a_sphere",
                              "test_flux_does_not_depend_on_range_down_to_a_thousandth_of_a_pixel"],
        "Irradiance is": ["test_the_suns_irradiance_is_that_of_the_cameras_band",
                          "test_the_irradiance_of_a_scene_and_of_a_mosaic",
                          "test_a_mosaic_counts_what_one_camera_in_each_band_counts"]},
    "Determinism": {"The same": ["test_the_same_request_gives_the_same_bytes_whatever_came_before"]},
}


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


UNITS = ("m", "px", "s", "ms", "ns", "deg", "rad", "rad_s", "m_s", "nm", "W_m2", "electrons", "DN", "K", "kg_m3", "au",
         "hz", "rad2_hz", "W_sr")
# Numbers [1], counts and years of the scene files in docs/.
PURE = {"B", "R", "acceleration_error", "albedo_factor", "albedo_texture_gain", "aspect", "b", "bit_depth", "c",
        "central_obscuration", "coverage", "depth", "exponent", "extinction_efficiency", "f_number", "facets",
        "focal_length_factor", "frames", "geometric_albedo", "grid", "handover", "height", "id", "k1",
        "log_uniform", "magnitude_limit", "max_error", "max_step", "normal_albedo", "p1", "percentile",
        "probability", "q_camera_from_spacecraft", "quantum_efficiency", "seed", "single_scattering_albedo",
        "solid_angle", "sun_direction_inertial", "target", "transmission", "veiling_glare",
        "veiling_glare_beyond", "white_radf", "wing_exponent", "wing_fraction", "year"}
# Numbers [1], versions, counts and indices of the wire, and a region's pixels.
PURE_ON_THE_WIRE = {"v", "id", "part", "shape", "seed", "q_from_inertial", "roi"}


def numbers_of(table):
    """The names of all numbers, and of lists of numbers, in tables and tables of tables."""
    for name, value in table.items():
        values = value if isinstance(value, list) and value else [value]
        if all(isinstance(each, dict) for each in values):
            for each in values:
                # The outer name says what takes milliseconds, and in what unit they are; keypoints have any names.
                yield from (name,) if name.endswith("_ms") else numbers_of(each) if name != "keypoints" else ()
        elif all(isinstance(each, (int, float)) and not isinstance(each, bool) for each in values):
            yield name


def without_unit(names):
    return {name for name in names if not re.search(rf"_({'|'.join(UNITS)}|\w+_per_\w+)$", name)}


def test_documented_scene_files_have_units_in_their_names():
    """Every number of the TOML in docs/ and in the cookbook ends in its unit, but for those that have none."""
    tables = [tomllib.loads(text) for page in sorted((ROOT / "docs").glob("*.md"))
              for text in re.findall(r"```toml\n(.*?)```", page.read_text(encoding="utf-8"), re.S)]
    tables += [tomllib.loads(path.read_text()) for path in (ROOT / "server/glrender_cli/cookbook").glob("*.toml")]
    found = [name for table in tables for name in numbers_of(table)]
    assert len(found) > 60 and without_unit(found) <= PURE, without_unit(found) - PURE


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
