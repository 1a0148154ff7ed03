"""ISDs of real images: cameras, lenses and poses, against SPICE, the IAU's rotations and usgscsm's equations."""

from __future__ import annotations

import copy
import json
from pathlib import Path

import numpy as np
import pytest
from glrender import ConfigError, frames
from glrender.base.constants import AU_M, GM_SUN_M3_S2
from glrender.scenario import FocalPlane, Isd, scenario_of_table
from glrender.scenario.instruments.lens import lens_of
from missing import needed_module
from scipy.spatial.transform import Rotation

DAWN, AMICA, MAPCAM = ("dawn_fc2_ceres_isd.json", "hayabusa_amica_st2458542208_isd.json",
                       "orex_mapcam_20190303_isd.json")
# PAN filter: ISIS's own model of OCAMS, by OD_K_PAN and OD_CENTER_PAN.
OCAMS = {"model": "ocams", "coefficients": [2.21e-5, 1.71e-4, 5.96e-5, 0.0, 0.0, (450.3 - 511.5) * 8.5e-3,
                                            (486.2 - 511.5) * 8.5e-3]}
# MESSENGER's narrow-angle camera, INS-236820_OD_T_X and _OD_T_Y, whose pixels are not square and whose squares are
# not those of a decentred lens.
MDIS = {"x": [0.0, 1.0018542696238024, 0.0, 0.0, -5.0944404749411114e-4, 0.0, 1.00401047146886e-5, 0.0,
              1.00401047146886e-5, 0.0],
        "y": [0.0, 0.0, 1.0, 9.06001059499675e-4, 0.0, 3.57484262662076e-4, 0.0, 1.00401047146886e-5, 0.0,
              1.00401047146886e-5]}
# Scale, shift, k1, p1 and a little more in x.
CUBIC = {"x": [0.01, 1.002, 0.0, 0.0, 2e-5, 0.0, 1e-5, 0.0, 1.01e-5, 0.0],
         "y": [-0.02, 0.0, 1.002, 1e-5, 0.0, 3e-5, 0.0, 1e-5, 0.0, 1e-5]}
LENS = {DAWN: None, AMICA: None, MAPCAM: OCAMS}


@pytest.fixture
def spice():
    return needed_module("spiceypy", "pip install -e '.[test]'")


def scenario(shared, *names, **changes):
    files = [str(shared / "spice_state" / name) for name in names]
    camera = {"name": "c", "isd": files[0], **({} if LENS[names[0]] is None else {"lens": LENS[names[0]]})}
    return {"bodies": [{"name": "b", "generated": {"kind": "icosphere", "radius_m": 100.0, "subdivisions": 1},
                        "brdf": {"law": "lambert", "normal_albedo": 0.1}}],
            "cameras": [camera], "trajectory": {"kind": "isd", "files": files}, **changes}


def of_table(table, folder):
    (folder / "made.json").write_text(json.dumps(table))
    return Isd.from_file(folder / "made.json")


def raw(shared, name):
    return json.loads((shared / "spice_state" / name).read_text())


@pytest.mark.parametrize("name", [DAWN, AMICA, MAPCAM])
def test_the_body_is_turned_as_the_iau_has_it(shared, name):
    """Pole and prime meridian of the ISD's own PCK keywords, apart from its quaternions: within 1e-9 deg."""
    image, keys = Isd.from_file(shared / "spice_state" / name), raw(shared, name)["naif_keywords"]
    code = keys["BODY_CODE"]
    ra, dec, meridian = (keys[f"BODY{code}_{item}"] for item in ("POLE_RA", "POLE_DEC", "PM"))
    days = image.epoch.et_s / 86400.0
    turned = Rotation.from_euler("ZXZ", [ra[0] + 90.0, 90.0 - dec[0], np.polynomial.polynomial.polyval(days, meridian)],
                                 degrees=True).inv()
    off = Rotation.from_quat(image.q_body_from_inertial, scalar_first=True) * turned.inv()
    assert np.degrees(off.magnitude()) < 1e-8
    rate = np.radians(meridian[1] + 2.0 * meridian[2] * days) / 86400.0
    np.testing.assert_allclose(image.rates_body_rad_s, [0.0, 0.0, rate], atol=2e-9)


@pytest.mark.parametrize("name, semi_major_axis_au", [(DAWN, 2.7675), (AMICA, 1.3241), (MAPCAM, 1.1264)])
def test_the_sun_is_where_the_bodys_orbit_has_it(shared, name, semi_major_axis_au):
    """Vis-viva with JPL's semi-major axes of Ceres, Itokawa and Bennu, within 0.5 %: place, velocity and units."""
    image = Isd.from_file(shared / "spice_state" / name)
    r, v = np.linalg.norm(image.r_sun_m), np.linalg.norm(image.v_sun_m_s)
    axis_au = 1.0 / (2.0 / r - v * v / GM_SUN_M3_S2) / AU_M
    np.testing.assert_allclose(axis_au, semi_major_axis_au, rtol=5e-3)


def csm_pixel(table, spice, focal_length_mm, distort, points_km):
    """Sample and line of points in the body's frame [km], by usgscsm's groundToImage; matrices are SPICE's."""
    sensor = table["instrument_pointing"]
    to_sensor = np.reshape(sensor["constant_rotation"], (3, 3)) @ spice.q2m(sensor["quaternions"][0])
    to_body = spice.q2m(table["body_rotation"]["quaternions"][0])
    r = (points_km @ to_body - table["instrument_position"]["positions"][0]) @ to_sensor.T
    x, y = distort(focal_length_mm * r[:, :2] / r[:, 2:]).T
    (s0, sx, sy), (l0, lx, ly) = table["focal2pixel_samples"], table["focal2pixel_lines"]
    return np.stack([table["detector_center"]["sample"] + s0 + sx * x + sy * y,
                     table["detector_center"]["line"] + l0 + lx * x + ly * y], axis=1)


def dawn_lens(u):
    return u * (1.0 + 9.2e-6 * np.sum(u * u, axis=1, keepdims=True))


def amica_lens(u):
    d = u
    for _ in range(20):
        d = u / (1.0 - 2.8e-5 * np.sum(d * d, axis=1, keepdims=True))
    return d


def ocams_lens(u):
    *k, x0, y0 = OCAMS["coefficients"]
    s = np.hypot(*(u - [x0, y0]).T)[:, None]
    return u + (u - [x0, y0]) * (k[0] + k[1] * s + k[2] * s * s)


@pytest.mark.parametrize("name, focal_length_mm, distort, is_mirrored, within_px", [
    (DAWN, 150.08, dawn_lens, False, 1e-4), (AMICA, 120.8, amica_lens, True, 1e-4),
    (MAPCAM, 125.2, ocams_lens, True, 0.04)])
def test_points_of_the_body_land_where_csm_has_them(shared, spice, rng, name, focal_length_mm, distort, is_mirrored,
                                                    within_px):
    """State and camera of a scenario; CSM counts from the first pixel's corner, and mirrored lines upwards."""
    made = scenario_of_table(scenario(shared, name))
    (state,), camera, table = made.states(), made.scene.camera("c"), raw(shared, name)
    radius_km = table["radii"]["semimajor"]
    points = rng.normal(size=(20000, 3))
    points *= radius_km / np.linalg.norm(points, axis=1, keepdims=True)
    inertial = points * 1e3 @ frames.dcm(state.bodies["b"].q_from_inertial) - state.spacecraft.r_inertial_m
    to_camera = frames.dcm(camera.q_camera_from_spacecraft) @ frames.dcm(state.spacecraft.q_from_inertial)
    pixel = camera.project(inertial @ to_camera.T)
    expected = csm_pixel(table, spice, focal_length_mm, distort, points) - 0.5
    if is_mirrored:
        expected[:, 1] = 1023.0 - expected[:, 1]
    seen = ((expected > -0.5) & (expected < 1023.5)).all(axis=1)
    assert seen.sum() > 3000
    np.testing.assert_allclose(pixel[seen], expected[seen], atol=within_px)


def test_amicas_frames_and_field_are_spices(shared, spice):
    """Mounting on the bus by amica31.ti, and the corners of its field, which is of a focal length of 120.5 mm."""
    spice.kclear()
    spice.furnsh(str(shared / "kernels" / "amica31.ti"))
    image = Isd.from_file(shared / "spice_state" / AMICA)
    bus = Rotation.from_quat(raw(shared, AMICA)["instrument_pointing"]["quaternions"][0], scalar_first=True)
    mounting = Rotation.from_quat(image.q_sensor_from_inertial, scalar_first=True) * bus.inv()
    expected = spice.pxform("HAYABUSA_SC_BUS_PRIME", "HAYABUSA_AMICA", 0.0)
    np.testing.assert_allclose(mounting.as_matrix(), expected, atol=1e-9)
    corners = np.array(spice.getfov(-130102, 4)[4])
    spice.kclear()
    made = image.focal_plane.camera("c")
    sensor_from_camera = frames.dcm(made.camera.q_camera_from_spacecraft).T
    x0, y0, x1, y1 = made.camera.bounds_px
    rays = made.camera.directions(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])) @ sensor_from_camera.T
    of_field, of_camera = (np.sort(np.abs(v[:, :2] / v[:, 2:]).ravel()) for v in (corners, rays))
    np.testing.assert_allclose(of_camera, of_field, rtol=6e-3)


@pytest.mark.parametrize("model, coefficients, within_px", [
    ("radial", [1e-4, 2.8e-5, -1e-8], 1e-4), ("radial", [0.0, 8e-4, 1e-6], 0.1), ("dawnfc", [9.2e-6], 1e-4),
    ("radtan", [0.2, -1.0, 1e-4, -2e-4, 3.0], 1e-4), ("cahvor", [1e-5, 5e-5, 0.0, 0.3, -0.2], 0.01),
    ("ocams", OCAMS["coefficients"], 0.05),
    ("transverse", CUBIC, 0.1),
])
@pytest.mark.parametrize("axes", [[[80.0, 0.0], [0.0, 80.0]], [[0.0, -80.0], [80.0, 0.0]], [[0.0, 80.0], [80.0, 0.0]]])
def test_lenses_are_inverted_within_the_residual_told(rng, model, coefficients, within_px, axes):
    """Pixels all over the detector, to directions by the lens, and back by the camera; rows turned where mirrored."""
    plane = FocalPlane(width_px=1024, height_px=800, focal_length_mm=150.0, centre_px=np.array([510.3, 402.0]),
                       px_from_mm=np.array(axes), lens=lens_of(model, coefficients, 150.0))
    made = plane.camera("c")
    assert made.residual_px < within_px, made.residual_px
    pixels = rng.uniform([-0.5, -0.5], [1023.5, 799.5], (5000, 2))
    rays = np.concatenate([plane.ratios(pixels), np.ones((5000, 1))], axis=1)
    landed = made.camera.project(rays @ frames.dcm(made.camera.q_camera_from_spacecraft).T)
    if made.is_mirrored:
        landed[:, 1] = 799.0 - landed[:, 1]
    off = np.hypot(*(landed - pixels).T).max()
    assert off <= 1.05 * made.residual_px + 1e-9
    # The worst place is a corner, where few random pixels come: no bound that says nothing.
    assert off > 0.25 * made.residual_px - 1e-9
    assert bool(made.notes()) == (made.residual_px > 0.05 or made.is_mirrored or made.shift_px > 20.48)


def test_a_lens_that_moves_places_far_is_warned_of():
    """8e-4 / mm^2 at 8 mm is 5 %: 34 px of 650."""
    plane = FocalPlane(width_px=1024, height_px=800, focal_length_mm=150.0, centre_px=np.array([511.5, 399.5]),
                       px_from_mm=80.0 * np.eye(2), lens=lens_of("radial", [0.0, 8e-4, 0.0], 150.0))
    made = plane.camera("c")
    (told,) = made.notes()
    assert "its lens moves places by up to 3" in told


def test_a_lens_is_that_of_its_equation(rng):
    """Image to ideal and back by the other direction's closed form, to 1e-11 mm."""
    d = rng.uniform(-6.0, 6.0, (100, 2))
    r2 = np.sum(d * d, axis=1, keepdims=True)
    np.testing.assert_allclose(lens_of("radial", [1e-4, 2e-5, 3e-8], 100.0)(d),
                               d * (1.0 - 1e-4 - 2e-5 * r2 - 3e-8 * r2 * r2), rtol=1e-13)
    u = lens_of("dawnfc", [9.2e-6], 150.0)(d)
    np.testing.assert_allclose(dawn_lens(u), d, atol=1e-11)
    u = lens_of("ocams", OCAMS["coefficients"], 125.0)(d)
    np.testing.assert_allclose(ocams_lens(u), d, atol=1e-11)
    cubic = {"x": [0.1, 1, 0, 0, 1e-4, 0, 0, 0, 0, 0], "y": [0, 0, 1, 0, 0, 0, 0, 0, 0, 2e-5]}
    x, y = lens_of("transverse", cubic, 100.0)(d).T
    np.testing.assert_allclose(np.stack([0.1 + x + 1e-4 * x * y, y + 2e-5 * y**3], axis=1), d, atol=1e-11)


def test_lenses_that_no_camera_follows_are_refused(shared):
    """ALE writes the numbers of OCAMS, odd powers about another centre, as r^2 and r^4; and MESSENGER's squares."""
    table = scenario(shared, MAPCAM)
    del table["cameras"][0]["lens"]
    with pytest.raises(ConfigError, match=r"cameras\[0\].lens: must be followed by radial .* got 1.42.*lens.model"):
        scenario_of_table(table)
    plane = FocalPlane(width_px=1024, height_px=1024, focal_length_mm=549.1177, centre_px=np.array([511.5, 511.5]),
                       px_from_mm=np.eye(2) / 0.014, lens=lens_of("transverse", MDIS, 549.1177))
    with pytest.raises(ConfigError, match="got 3.97"):
        plane.camera("mdis")
    table["cameras"][0]["lens"] = {"model": "none"}
    assert scenario_of_table(table).scene.camera("c").distortion is None


def test_binned_and_cropped_images_keep_directions(shared, tmp_path):
    """Two by two pixels in one from line 100 on: the places of directions halve about the detector's corner."""
    whole = Isd.from_file(shared / "spice_state" / DAWN).focal_plane
    table = raw(shared, DAWN) | {"detector_sample_summing": 2, "detector_line_summing": 2, "image_samples": 512,
                                 "image_lines": 300, "starting_detector_line": 100}
    binned = of_table(table, tmp_path)
    for column, row in ((0.0, 0.0), (100.5, 250.0)):
        expected = whole.ratios([2.0 * column + 0.5, 2.0 * row + 0.5 + 100.0])
        np.testing.assert_allclose(binned.focal_plane.ratios([column, row]), expected, atol=1e-14)


def test_several_images_are_states_in_the_order_of_their_epochs(shared, tmp_path):
    table = raw(shared, AMICA)
    paths = [shared / "spice_state" / AMICA]
    for index, later_s in enumerate((20.0, -30.5)):
        other = copy.deepcopy(table)
        other["center_ephemeris_time"] += later_s
        for name in ("instrument_pointing", "body_rotation", "instrument_position", "sun_position"):
            other[name]["ephemeris_times"] = [other["center_ephemeris_time"]]
        other["instrument_position"]["positions"] = [[8.8, 0.01 * later_s, 0.1]]
        paths.append(tmp_path / f"{index}.json")
        paths[-1].write_text(json.dumps(other))
    made = scenario(shared, AMICA)
    made["trajectory"]["files"] = [str(path) for path in paths]
    made = scenario_of_table(made)
    np.testing.assert_allclose([state.t_s for state in made.states()], [0.0, 30.5, 50.5], atol=1e-6)
    np.testing.assert_allclose([state.spacecraft.r_inertial_m[1] for state in made.states()],
                               [-305.0, 241.3099824695155, 200.0])
    assert made.start.tdb == "2005-10-13T19:13:45.377680"
    with pytest.raises(ConfigError, match="time: must be an image's: the nearest is of 2005-10-13T19:13:45.377680 TDB"):
        made.states(np.array([3.0]))


def test_an_image_between_rows_moves_and_turns_on(shared, tmp_path):
    """A tenth of a second after the only row: along its velocities, and about its rates."""
    table = raw(shared, MAPCAM)
    before = of_table(table, tmp_path)
    table["center_ephemeris_time"] += 0.1
    after = of_table(table, tmp_path)
    np.testing.assert_allclose(after.r_spacecraft_m - before.r_spacecraft_m, before.v_spacecraft_m_s * 0.1, atol=1e-9)
    pole = Rotation.from_quat(before.q_body_from_inertial, scalar_first=True)
    turn = Rotation.from_quat(after.q_body_from_inertial, scalar_first=True) * pole.inv()
    np.testing.assert_allclose(turn.as_rotvec(), [0.0, 0.0, -0.1 * before.rates_body_rad_s[2]], rtol=1e-5,
                               atol=1e-15)


def tables_at(table, times, place=lambda t: [8.8, 0.0, 0.1], turn=0.0, **more):
    """The table with rows at times [s] from its epoch: places by a function [km], turns about Z [rad/s]."""
    et = table["center_ephemeris_time"]
    for name in ("instrument_pointing", "body_rotation", "instrument_position", "sun_position"):
        table[name]["ephemeris_times"] = [et + t for t in times]
    for name in ("instrument_pointing", "body_rotation"):
        # SPICE's quaternion turns components: a frame that turns by +a about Z has -a's rotation of components.
        table[name]["quaternions"] = [[np.cos(turn * t / 2), 0.0, 0.0, -np.sin(turn * t / 2)] for t in times]
        table[name]["angular_velocities"] = [[0.0, 0.0, turn] for _ in times]
    table["instrument_position"] |= {
        "positions": [list(place(t)) for t in times],
        "velocities": [((np.array(place(t + 1e-3)) - place(t - 1e-3)) / 2e-3).tolist() for t in times]}
    table["sun_position"] |= {key: [table["sun_position"][key][0]] * len(times) for key in ("positions", "velocities")}
    return table | more


def test_an_image_between_distant_rows_is_between_them(shared, tmp_path):
    """MVIC's tables go from 16.6 s before the epoch to 16.6 s after it: a cubic path to 1 mm, a turn at its rate."""
    def place(t):
        return [8.0 + 0.01 * t + 1e-4 * t * t, 1e-5 * t**3, -0.02 * t]

    table = tables_at(raw(shared, AMICA), [-20.0, -15.0, 18.0, 30.0], place, 1e-3)
    table["instrument_pointing"].pop("constant_rotation")
    made = of_table(table, tmp_path)
    np.testing.assert_allclose(made.r_spacecraft_m, np.array(place(0.0)) * 1e3, atol=1e-3)
    np.testing.assert_allclose(made.v_spacecraft_m_s, [10.0, 0.0, -20.0], atol=1e-3)
    np.testing.assert_allclose(np.abs(made.q_body_from_inertial), [1.0, 0.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(made.rates_body_rad_s, [0.0, 0.0, 1e-3], atol=1e-12)
    assert not [note for note in made.notes if "of one time" in note]
    with pytest.raises(ConfigError, match="must come within 1 s of center_ephemeris_time, or go from b"):
        of_table(tables_at(raw(shared, AMICA), [4.0, 5.0]), tmp_path)


def test_tables_of_one_row_are_the_image_and_a_note_says_when(shared, tmp_path):
    """Viking's rows are 4 s after the epoch, all at the same time: usgscsm takes them as they are."""
    table = tables_at(raw(shared, AMICA), [3.99], lambda t: [8.8, 0.1 * t, 0.1], 1e-3)
    made = of_table(table, tmp_path)
    np.testing.assert_allclose(made.r_spacecraft_m, [8800.0, 399.0, 100.0], atol=1e-6)
    turn = Rotation.from_quat(made.q_body_from_inertial, scalar_first=True)
    np.testing.assert_allclose(np.abs(turn.as_rotvec()), [0.0, 0.0, 3.99e-3], atol=1e-12)
    assert any("are of one time, +3.99 s from center_ephemeris_time" in note for note in made.notes)
    table["sun_position"]["ephemeris_times"][0] += 1.0
    with pytest.raises(ConfigError, match="must come within 1 s"):
        of_table(table, tmp_path)


def test_rates_that_are_null_are_none(shared, tmp_path):
    for rates in (None, [None], [[None, None, None]]):
        table = raw(shared, AMICA)
        table["instrument_pointing"]["angular_velocities"] = rates
        assert of_table(table, tmp_path).rates_sensor_rad_s is None


def test_places_in_metres_and_sides_of_films_are_read(shared, tmp_path):
    table = raw(shared, AMICA)
    km = of_table(table, tmp_path)
    for key in ("positions", "velocities"):
        table["instrument_position"][key] = (np.array(table["instrument_position"][key]) * 1e3).tolist()
    table["instrument_position"]["unit"] = "m"
    table |= {"image_samples": 25798, "image_lines": 25356, "detector_sample_summing": 0, "projection": "",
              "geotransform": [0.0, 1.0, 0.0, 0.0, 0.0, 1.0], "kernels": {}, "optical_distortion": {}}
    table["focal_length_model"]["focal_length"] = 500.0
    made = of_table(table, tmp_path)
    np.testing.assert_allclose(made.r_spacecraft_m, km.r_spacecraft_m, rtol=1e-14)
    assert any("the ISD's detector_sample_summing is 0; it is taken as 1" in note for note in made.notes)
    with pytest.raises(ConfigError, match="width_px: must be"):
        made.focal_plane.camera("film")


def test_lenses_of_galileo_and_lunar_orbiter_are_isiss(rng):
    """ISIS's RadialDistortionMap and LoHighDistortionMap, written anew; ALE's one number is K1."""
    d = rng.uniform(-6.0, 6.0, (100, 2))
    r2 = np.sum(d * d, axis=1, keepdims=True)
    np.testing.assert_allclose(lens_of("radial", [-2.4976983626e-05], 1500.0)(d), d * (1.0 - 2.4976983626e-05 * r2),
                               rtol=1e-13)
    terms = {"perspective_x": -3e-4, "perspective_y": 8e-5, "center_point_x": -1.11, "center_point_y": 0.3}
    for k in ([0.00027963, -2.869e-5, 0.0], [0.0]):
        got = lens_of("lunarorbiter", {**terms, "coefficients": k}, 609.28)(d)
        for (x, y), ideal in zip(d, got, strict=True):
            factor = 1.0 - 3e-4 * x + 8e-5 * y
            px, py = x * factor, y * factor
            s2 = (px + 1.11)**2 + (py - 0.3)**2
            ratio = k[0] + (k[1] * s2 if len(k) > 1 else 0.0)
            np.testing.assert_allclose(ideal, [px - ratio * (px + 1.11), py - ratio * (py - 0.3)], rtol=1e-12)
    np.testing.assert_allclose(lens_of("lunarorbiter", terms, 609.28)(d), got, rtol=1e-13)


def test_lunar_orbiters_radial_terms_are_those_of_its_keywords(shared, tmp_path):
    """ALE's ISD has them in naif_keywords alone."""
    table = raw(shared, AMICA)
    lens = {"perspective_x": -3e-6, "perspective_y": 8e-7, "center_point_x": -1.11, "center_point_y": 0.3}
    table["optical_distortion"], table["naif_keywords"] = {"lunarorbiter": lens}, {"INS-1_OD_K": [0.01, 0.0, 0.0]}
    focal_length_mm = of_table(table, tmp_path).focal_plane.focal_length_mm
    plane = of_table(table, tmp_path).focal_plane
    got = plane.lens(np.array([3.0, -2.0]))
    whole = {**lens, "coefficients": [0.01, 0.0, 0.0]}
    expected = lens_of("lunarorbiter", whole, focal_length_mm)(np.array([3.0, -2.0]))
    np.testing.assert_allclose(got, expected, rtol=1e-14)
    assert np.abs(got - [3.0, -2.0]).max() > 0.02
    assert not any("radial terms" in note for note in of_table(table, tmp_path).notes)
    # The sensor's own instrument counts at any place; without one the first, with a note.
    own = f"INS{table['instrument_pointing']['time_dependent_frames'][0]}_OD_K"
    for keywords, note in (({"INS-1_OD_K": [0.5], own: [0.01, 0.0, 0.0]}, None),
                           ({own: [0.01, 0.0, 0.0], "INS-1_OD_K": [0.5]}, None),
                           ({"INS-1_OD_K": [0.01, 0.0, 0.0], "INS-2_OD_K": [0.5]},
                            "INS-1_OD_K, though there are also INS-2")):
        made = of_table({**table, "naif_keywords": keywords}, tmp_path)
        np.testing.assert_allclose(made.focal_plane.lens(np.array([3.0, -2.0])), expected, rtol=1e-14)
        notes = [each for each in made.notes if "radial terms" in each]
        assert len(notes) == (note is not None) and (note is None or note in notes[0])
    for keywords in ({}, None, {"BODY499_RADII": [1.0, 1.0, 1.0]}):
        made = of_table({**table, "naif_keywords": keywords}, tmp_path)
        assert any("has no radial terms of its lens" in each and "taken as 0" in each for each in made.notes)
        expected_without = lens_of("lunarorbiter", lens, focal_length_mm)(np.array([3.0, -2.0]))
        np.testing.assert_allclose(made.focal_plane.lens(np.array([3.0, -2.0])), expected_without, rtol=1e-14)


@pytest.mark.parametrize("path, value, message", [
    ("name_model", "USGS_ASTRO_LINE_SCANNER_SENSOR_MODEL", "name_model: must be USGS_ASTRO_FRAME_SENSOR_MODEL"),
    ("sun_position", None, "sun_position: missing; must be an ISD of ALE"),
    ("focal2pixel_lines", [0.0, 71.4, 0.0], "focal2pixel_samples: and focal2pixel_lines must be three numbers"),
    ("body_rotation.reference_frame", 17, "body_rotation.reference_frame: must be 1, J2000, got 17"),
    ("body_rotation.quaternions", [[0.9, 0.1, 0.1, 0.1]], "body_rotation.quaternions[0]: norm must be 1 within 0.001"),
    ("instrument_pointing.constant_rotation", [1, 0, 0, 0, 1, 0, 0, 0, -1],
     "instrument_pointing.constant_rotation.rotation: must be a rotation, but mirrors"),
    ("instrument_position.ephemeris_times", [488002000.0], "must come within 1 s of center_ephemeris_time"),
    ("instrument_position.positions", [[1.0, 2.0]], "instrument_position.positions: must be rows of 3 numbers"),
    ("optical_distortion", {"kaguyalism": {}}, "optical_distortion.model: must be one of 'radial', 'transverse'"),
    ("optical_distortion", {"radial": {"coefficients": [1.0, 0.0]}}, "optical_distortion.coefficients: must be 3 num"),
    ("optical_distortion", {"radial": {"coefficients": [0.0] * 3, "tangential": [0.1]}},
     "optical_distortion.radial.tangential: unknown key"),
    ("optical_distortion", {"lunarorbiter": {"perspective_x": 0.0}}, "optical_distortion.perspective_y: missing"),
    ("projection", "+proj=sinu", "projection: must not be there: a map is no image of a camera"),
    ("focal_length", 150.0, "focal_length: unknown key"), ("sun_position.unit", "au", "sun_position.unit: must be one"),
    ("sun_position.time_bias", 1.0, "sun_position.time_bias: unknown key"),
    ("focal_length_model.focal_length", None, "focal_length_model.focal_length: missing"),
    ("optical_distortion", {"radial": {"coefficients": [0.0, 0.1, 0.1]}}, "cameras[0].lens: turns the image round"),
    ("optical_distortion", {"dawnfc": {"coefficients": [-1e-2]}}, "cameras[0].lens: images no direction to some"),
    ("focal_length_model.focal_length", -3.0, "focal_length_model.focal_length: must be > 0"),
    ("focal_length_model.focal_length", 1e-6, "gives a field of 180 deg"),
])
def test_a_wrong_isd_is_told_by_its_field(shared, tmp_path, path, value, message):
    table = raw(shared, DAWN)
    *keys, last = path.split(".")
    place = table
    for key in keys:
        place = place[key]
    if value is None:
        del place[last]
    else:
        place[last] = value
    (tmp_path / "bad.json").write_text(json.dumps(table))
    made = scenario(shared, DAWN)
    made["cameras"][0]["isd"] = str(tmp_path / "bad.json")
    made["trajectory"]["files"] = [str(tmp_path / "bad.json")]
    with pytest.raises(ConfigError) as caught:
        scenario_of_table(made)
    assert message in str(caught.value)


def test_what_does_not_go_with_isds_is_told(shared, tmp_path):
    (tmp_path / "none.json").write_text("{")
    for changes, message in (
            ({"time": {"frames": 3}}, "time: is given as well as ISDs, which have the times"),
            ({"time": {"start_tdb": "2005-10-13"}}, "trajectory.files: have the epochs, so [time] must not"),
            ({"trajectory": {"kind": "isd", "files": []}}, "trajectory.files: must be a list of ISD files"),
            ({"trajectory": {"kind": "isd", "files": [str(tmp_path / "none.json")]}}, "none.json: is not JSON"),
            ({"trajectory": {"kind": "isd", "files": [str(tmp_path / "no.json")]}}, "no.json: cannot be read"),
            ({"trajectory": {"kind": "isd", "files": [str(shared / "spice_state" / name) for name in (AMICA, DAWN)]}},
             f"trajectory.{DAWN}: must be of the frames of {AMICA}"),
            ({"trajectory": {"kind": "isd", "files": [str(shared / "spice_state" / AMICA)] * 2}},
             "must not be of the epoch of"),
            ({"trajectory": {"kind": "at_rest", "r_m": [9e3, 0, 0]}, "sun": {"r_m": [1e11, 0, 0]},
              "time": {"times_s": [0.0]}, "attitude": {"mode": "isd"}}, "attitude.mode: needs [trajectory] of ISDs")):
        with pytest.raises(ConfigError) as caught:
            scenario_of_table(scenario(shared, AMICA, **changes))
        assert message in str(caught.value)


def test_the_pages_coefficients_of_ocams_are_those_that_are_followed():
    page = (Path(__file__).parents[2] / "docs" / "scenario.md").read_text(encoding="utf-8")
    assert "[2.21e-5, 1.71e-4, 5.96e-5, 0.0, 0.0, -0.5202, -0.21505]" in " ".join(page.split())
    np.testing.assert_allclose(OCAMS["coefficients"], [2.21e-5, 1.71e-4, 5.96e-5, 0.0, 0.0, -0.5202, -0.21505])
