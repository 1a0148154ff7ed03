"""Units within a scene's cameras: a mistake is told under its field with the way out, a real instrument is not."""

from __future__ import annotations

import copy

import msgpack
import numpy as np
import pytest
import views
from glrender import Body, ConfigError, Scene, Shape, State, draw_still, open_renderer
from glrender.base.plausible import RULES, improbable
from glrender.brdf import Lambert
from glrender.engines.advice import scene_advice
from glrender_camera import CameraModel
from glrender_server.operations import Operations

MODEL = "cameras[0].model."
GREY = Lambert(normal_albedo=0.2)
TABLE = {
    "bodies": [{"name": "body", "generated": {"kind": "icosphere", "radius_m": 100.0, "subdivisions": 1},
                "brdf": {"law": "lambert", "normal_albedo": 0.2}}],
    "cameras": [{"name": "navcam", "width_px": 32, "height_px": 32, "focal_length_px": 1000.0, "model": {
        "exposure_s": 0.01, "optics": {"aperture_diameter_m": 0.02, "f_number": 4.0, "pixel_pitch_m": 5.5e-6},
        "detector": {"quantum_efficiency": 0.5, "full_well_electrons": 3e4, "gain_DN_per_electron": 0.13,
                     "bit_depth": 12}}}]}
OPTICS, DETECTOR = ("cameras", 0, "model", "optics"), ("cameras", 0, "model", "detector")


def changed(place, **fields):
    """The table with other fields at a place."""
    table = copy.deepcopy(TABLE)
    at = table
    for key in place:
        at = at[key]
    at.update(fields)
    return table


def told(table):
    return [(advice.code, advice.path, str(advice)) for advice in scene_advice(Scene.from_dict(table))]


@pytest.mark.parametrize("place, fields, path, piece", [
    (OPTICS, {"aperture_diameter_m": 15.0}, MODEL + "optics.aperture_diameter_m",
     "is likely between 0.0001 and 2 m (of HiRISE 0.5 m, of the smallest lenses 0.5 mm), got 15; in mm? then write"),
    (OPTICS, {"aperture_diameter_m": 2e-5}, MODEL + "optics.aperture_diameter_m", "got 2e-05; in km? then write 0.02"),
    (OPTICS, {"pixel_pitch_m": 5.5e-9}, MODEL + "optics.pixel_pitch_m", "got 5.5e-09; in km? then write 5.5e-06"),
    (OPTICS, {"band_nm": [450e3, 950e3]}, MODEL + "optics.band_nm", "[450000, 950000]; in pm? then write [450, 950]"),
    (DETECTOR, {"gain_DN_per_electron": 8.0}, MODEL + "detector.gain_DN_per_electron",
     "within a factor of 5 of 2^bit_depth, 4096 DN, and is 2.4e+05 DN, got 8; in e-/DN? then write its inverse, 0.125"),
    (DETECTOR, {"full_well_electrons": 30.0}, MODEL + "detector.full_well_electrons", "in ke-? then write 30000"),
    (DETECTOR, {"bit_depth": 16}, MODEL + "detector.gain_DN_per_electron", "or of a bit_depth of 12?"),
    (DETECTOR, {"full_well_electrons": 4095.0}, MODEL + "detector.gain_DN_per_electron", "of a bit_depth of 9?"),
    ((), {"solar_irradiance_1au_W_m2": 1360.8}, "solar_irradiance_1au_W_m2",
     "within 20 % of the Sun's 715.2 W/m2 from 450 to 950 nm (ASTM E490), the band of camera 'navcam', got 1360.8; of"),
    ((), {"solar_irradiance_1au_W_m2": 0.7152}, "solar_irradiance_1au_W_m2", "leave it out"),
    (("cameras", 0), {"r_camera_spacecraft_m": [350.0, 0.0, 120.0]}, "cameras[0].r_camera_spacecraft_m",
     "is likely at most 100 m (the longest boom in space had 60 m), got [350, 0, 120]; in mm? then write [0.35,"),
    (("bodies", 0, "brdf"), {"law": "oren_nayar", "roughness_deg": 0.4}, "bodies[0].brdf.roughness_deg",
     "is likely at least 1.5 deg (or 0; fits of small bodies have 5 to 40), got 0.4; in rad? then write 22.9183"),
    (("cameras", 0), {"focal_length_px": 0.1}, "cameras[0].focal_length_px", "got 0.1; it is the focal length over"),
])
def test_an_improbable_field_is_told_with_its_way_out(place, fields, path, piece):
    (said,) = told(changed(place, **fields))
    assert said[:2] == ("unit", path) and said[2].startswith(f"{path}: ") and piece in said[2]


@pytest.mark.parametrize("place, fields", [
    (("bodies", 0, "brdf"), {"law": "oren_nayar", "roughness_deg": 0.0}),
    (("bodies", 0, "brdf"), {"law": "oren_nayar", "roughness_deg": 3.0}),
    # A pinhole of 136 x 102 deg, as hazard cameras of rovers see, and a lens of any field.
    (("cameras", 0), {"width_px": 5120, "height_px": 2554, "focal_length_px": 1034.0}),
    (("cameras", 0), {"focal_length_px": 2.0, "distortion": {"k1": 0.1}})])
def test_smooth_laws_wide_cameras_and_lenses_are_no_doubt(place, fields):
    assert told(changed(place, **fields)) == []


def test_a_band_of_micrometres_is_told_whether_or_not_the_irradiance_is_given():
    with pytest.raises(ConfigError) as refused:
        Scene.from_dict(changed(OPTICS, band_nm=[0.45, 0.95]))
    assert str(refused.value) == (f"scene.{MODEL}optics.band_nm: must reach beyond 10 nm for diffraction, got "
                                  "(0.45, 0.95); in um? then write [450.0, 950.0]")
    table = changed(OPTICS, band_nm=[0.45, 0.95])
    for field in ("f_number", "pixel_pitch_m"):
        del table["cameras"][0]["model"]["optics"][field]
    with pytest.raises(ConfigError) as refused:
        Scene.from_dict(table)
    assert str(refused.value).startswith("scene.cameras[0].model.optics.band_nm: must be within 119.5..1e+06 nm")
    assert "in um? then write [450, 950]" in str(refused.value)
    (said,) = told({**table, "solar_irradiance_1au_W_m2": 715.0})
    assert said[1] == MODEL + "optics.band_nm" and "in um? then write [450, 950]" in said[2]


@pytest.mark.parametrize("field, value, piece", [
    ("pixel_pitch_m", 5.5, "must be at most 0.001 m, got 5.5; in um? then write 5.5e-06"),
    ("pixel_pitch_m", 5.5e-3, "must be at most 0.001 m, got 0.0055; in mm? then write 5.5e-06"),
    ("pixel_pitch_m", 5500.0, "must be at most 0.001 m, got 5500.0; in nm? then write 5.5e-06"),
    ("aperture_diameter_m", 15000.0, "must be at most 100 m, got 15000.0; in um? then write 0.015"),
    ("aperture_diameter_m", 150.0, "must be at most 100 m, got 150.0; in mm? then write 0.15")])
def test_an_impossible_length_is_refused_under_its_own_name(field, value, piece):
    with pytest.raises(ConfigError) as refused:
        Scene.from_dict(changed(OPTICS, **{field: value}))
    assert str(refused.value).startswith(f"scene.{MODEL}optics.{field}: {piece}")


def test_the_bands_of_a_mosaic_have_their_own_path():
    table = changed(("cameras", 0, "model"), pattern=["RG", "GR"], optics={
        "R": {"aperture_diameter_m": 0.02, "band_nm": [600.0, 700.0]},
        "G": {"aperture_diameter_m": 20.0, "band_nm": [500.0, 600.0]}})
    (said,) = told(table)
    assert said[1] == MODEL + "optics.G.aperture_diameter_m"
    table["cameras"][0]["model"]["optics"]["R"]["band_nm"] = [0.6, 0.7]
    with pytest.raises(ConfigError, match=r"optics\.R\.band_nm: must be within 119\.5"):
        Scene.from_dict(table)


def test_a_camera_without_a_model_may_have_the_irradiance_of_any_band():
    table = copy.deepcopy(TABLE)
    del table["cameras"][0]["model"]
    for irradiance, is_told in ((594.0, False), (1366.0, False), (0.05, False), (1.4e6, True)):
        assert bool(told({**table, "solar_irradiance_1au_W_m2": irradiance})) == is_told


def test_frames_of_a_python_scene_tell_of_their_own_camera():
    model = CameraModel.from_dict({**TABLE["cameras"][0]["model"], "optics": {"aperture_diameter_m": 15.0}})
    scene = Scene(bodies=[views.sphere(GREY, 2)],
                  cameras=[views.camera(32), views.camera(32, 500.0, name="wide", model=model)])
    with open_renderer(scene) as renderer:
        assert draw_still(renderer, views.state(), "navcam").warnings == ()
        for warnings in (draw_still(renderer, views.state(), "wide").warnings, renderer.render(
                views.state(), "wide").warnings):
            (advice,) = warnings
            assert advice.path == "cameras[1].model.optics.aperture_diameter_m"


# Aperture [m], band [nm], full well [e-], gain [e-/DN], bits, and pitch [um]: rounded, of the size that papers give.
INSTRUMENTS = {
    "New Horizons LORRI": (0.208, (350, 850), 8e4, 22.0, 12, 13.0),
    "New Horizons MVIC": (0.075, (400, 975), 1.3e5, 58.6, 12, 13.0),
    "Rosetta NavCam": (0.070, (550, 850), 1e5, 24.0, 12, 13.0),
    "Rosetta OSIRIS NAC": (0.090, (250, 1000), 1.2e5, 3.1, 14, 13.5),
    "Hayabusa AMICA": (0.015, (380, 1010), 7e4, 17.0, 12, 12.0),
    "Hayabusa2 ONC-T": (0.01508, (390, 975), 8e4, 20.95, 12, 13.0),
    "DART DRACO": (0.208, (400, 1000), 2.2e4, 6.0, 12, 6.5),
    "HiRISE": (0.5, (400, 1000), 7.6e4, 9.0, 14, 12.0),
    "JunoCam": (0.0125, (400, 900), 2.5e4, 12.0, 12, 7.4),
    "Cassini ISS NAC, gain 2": (0.19, (200, 1050), 1.2e5, 29.0, 12, 12.0),
    "LROC NAC": (0.195, (400, 750), 2.0e5, 72.0, 12, 7.0),
    "Dawn FC": (0.0199, (400, 1100), 3e5, 18.0, 14, 14.0),
    "OSIRIS-REx PolyCam": (0.175, (500, 800), 3.0e4, 2.0, 14, 8.5),
    "OSIRIS-REx NavCam": (0.008, (400, 700), 6e3, 1.5, 12, 2.2),
    "Lucy L'LORRI": (0.208, (450, 850), 8e4, 20.0, 12, 13.0),
    "Hera AFC": (0.0249, (450, 900), 1e5, 7.0, 14, 15.0),
    "JUICE JANUS": (0.100, (380, 1080), 2.7e4, 2.0, 14, 7.0),
    "Clementine LWIR": (0.131, (8000, 9500), 3e7, 1.5e5, 8, 50.0),
    "Mars Express HRSC": (0.031, (430, 970), 4.2e5, 1600.0, 8, 7.0),
    "Galileo SSI": (0.1765, (400, 1100), 1e5, 400.0, 8, 15.2),
    "NEAR MSI": (0.0186, (400, 1100), 1.0e5, 26.0, 12, 16.0),
    "Hubble WFC3 UVIS": (2.4, (200, 1000), 7e4, 1.5, 16, 15.0),
    "Rosetta ALICE": (0.040, (120, 205), 1e5, 2.0, 16, 100.0),
    "CubeSat with an IMX273": (0.004, (400, 700), 1.1e4, 2.7, 12, 3.45),
    "scanning lidar's camera": (0.05, (1054, 1074), 1e5, 24.0, 12, 25.0),
}


@pytest.mark.parametrize("name", INSTRUMENTS)
def test_real_instruments_are_likely(name):
    """None is warned of, but for a telescope in orbit of more than 2 m."""
    aperture_m, band_nm, full_well, electrons_per_DN, bits, pitch_um = INSTRUMENTS[name]
    table = changed(DETECTOR, full_well_electrons=full_well, gain_DN_per_electron=1.0 / electrons_per_DN,
                    bit_depth=bits)
    table["cameras"][0]["model"]["optics"] = {"aperture_diameter_m": aperture_m, "band_nm": list(band_nm)}
    assert [path for _, path, _ in told(table)] == [MODEL + "optics.aperture_diameter_m"] * (aperture_m > 2.0)
    # As metres: 13 um are 1.3e-5. As micrometres by mistake they would be refused.
    assert not [advice for advice in improbable("optics", {"pixel_pitch_m": pitch_um * 1e-6}, "optics")]


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: f"{rule.of}: {rule.field}")
def test_each_rule_has_both_sides(rule):
    """At the bound nothing is told, a little beyond it the field is, with value and way out."""
    many = {"band_nm": lambda x: [x, x], "r_m": lambda x: [0.0, x, 0.0], "r_camera_spacecraft_m": lambda x: [x, 0, 0],
            "angular_velocity_rad_s": lambda x: [0.0, 0.0, -x]}.get(rule.field, lambda x: x)
    for bound, beyond in ((rule.low, 0.99), (rule.high, 1.01)):
        if 0.0 < bound < float("inf"):
            inside = (1.0 + 1e-12 if beyond < 1.0 else 1.0 - 1e-12) * bound
            assert improbable(rule.of, {rule.field: many(inside)}, "a") == []
            (advice,) = improbable(rule.of, {rule.field: many(beyond * bound)}, "a")
            assert advice.path == f"a.{rule.field}" and rule.unit in str(advice) and "got" in str(advice)
    assert improbable(rule.of, {}, "a") == []


def ring(inner_m, outer_m, half_m, count=24):
    """A ring about Z of a rectangular section."""
    around = 2.0 * np.pi * np.arange(count) / count
    corners = [(r, z) for r, z in ((inner_m, -half_m), (outer_m, -half_m), (outer_m, half_m), (inner_m, half_m))]
    points = np.array([[r * np.cos(a), r * np.sin(a), z] for a in around for r, z in corners])
    at = lambda k, j: 4 * (k % count) + j % 4  # noqa: E731
    quads = [(at(k, j), at(k, j + 1), at(k + 1, j + 1), at(k + 1, j)) for k in range(count) for j in range(4)]
    return Shape.from_arrays(points, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]))


def drawn_overlaps(bodies, places_m):
    """The warnings of overlap of a frame of bodies at places."""
    state = views.state(range_m=5000.0).to_dict()
    state["bodies"] = {body.name: {"r_inertial_m": place} for body, place in zip(bodies, places_m, strict=True)}
    with open_renderer(views.scene(bodies, [views.camera(64)])) as renderer:
        return [advice for advice in renderer.render(State.from_dict(state)).warnings if advice.code == "overlap"]


@pytest.mark.parametrize("distance_m, is_told", [(1.2, True), (110.0, True), (117.0, True), (121.0, False)])
def test_bodies_within_each_other_are_told(distance_m, is_told):
    """Spheres of 100 m and of 20 m, by the distance of their centres."""
    bodies = [views.sphere(GREY, 3, 100.0, "primary"), views.sphere(GREY, 3, 20.0, "moon")]
    found = drawn_overlaps(bodies, [[0.0, 0.0, 0.0], [0.0, distance_m, 0.0]])
    assert [advice.path for advice in found] == ["state.bodies.moon.r_inertial_m"] * is_told
    assert all("'primary' and 'moon'" in str(advice) and "in km?" in str(advice) for advice in found)


def test_a_body_in_the_hole_of_another_is_apart():
    """A planet within its ring, whose convex hull is round both; and a rock at the neck of a contact binary."""
    planet = views.sphere(GREY, 3, 60.0, "planet")
    about = Body(name="ring", shape=ring(80.0, 100.0, 5.0), brdf=GREY)
    assert about.hull.inner_radius_m > 0.0 and drawn_overlaps([about, planet], 2 * [[0.0, 0.0, 0.0]]) == []
    binary = Body(name="binary", shape=views.binary(1, 4), brdf=GREY)
    neck_m = binary.hull.solid_radius_m
    rock = views.sphere(GREY, 2, 5.0, "rock")
    assert 0.0 < neck_m <= binary.hull.inner_radius_m
    assert drawn_overlaps([binary, rock], [[0.0, 0.0, 0.0], [0.5 * neck_m, 0.0, 0.0]])


def test_the_service_tells_it_where_a_scene_is_loaded_and_with_each_frame():
    """Once in a reply, and in the log once for the scene and not again for its frames."""
    operations = Operations(Scene.from_dict(TABLE))
    try:
        assert operations.described["warnings"] == []
        loaded, code, *_ = operations.answer({"v": 1, "op": "load_scene", "id": 1, "client": "a",
                                              "scene": changed(OPTICS, aperture_diameter_m=15.0)})
        assert not code
        drawn, code, _, warnings = operations.answer({"v": 1, "op": "render", "id": 2, "client": "a",
                                                      "state": views.state().to_dict()})
        assert not code
        for parts in (loaded, drawn):
            (said,) = msgpack.unpackb(parts[0])["warnings"]
            assert (said["code"], said["path"]) == ("unit", MODEL + "optics.aperture_diameter_m")
        assert warnings == [("navcam", ())]
    finally:
        operations.close()
