"""Warnings of what nothing refuses: each condition has its own, and ordinary scenes have none.

Truth is the geometry that each state is made of: where the body stands against the boresight, the Sun and its
neighbour; and the camera's own chain of numbers, electrons = t A R E.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import comae as coma
import numpy as np
import pytest
import serving
import trimesh
import views
from glrender import (
    Body,
    ConfigError,
    Pose,
    Renderer,
    Scene,
    Shape,
    Stars,
    draw_still,
    frames,
    generate,
    open_renderer,
    take_frame,
)
from glrender.base.constants import AU_M
from glrender.brdf import Lambert
from glrender.capture.frame_advice import LEAST_DN
from glrender.engines.advice import Advice, scene_advice
from glrender_camera import AutoExposure, BrownConrady, CameraModel, Detector, MosaicModel, Optics
from scipy.spatial.transform import Rotation

GREY = Lambert(normal_albedo=0.2)
# The Sun has about the 1000 W/m2 of `views` in this band.
OPTICS = Optics(aperture_diameter_m=0.001, psf_sigma_px=0.5, band_nm=(350.0, 1100.0))
DETECTOR = Detector(quantum_efficiency=0.5, full_well_electrons=30000.0, gain_DN_per_electron=0.1, bit_depth=12,
                    read_noise_electrons=10.0)
MODEL = CameraModel(optics=OPTICS, detector=DETECTOR, exposure_s=1e-4)
R_CAMERA = 2000.0 * np.array([0.3, -0.8, 0.4]) / np.linalg.norm([0.3, -0.8, 0.4])


def codes(warnings):
    return [advice.code for advice in warnings]


def the_one(warnings, code):
    assert codes(warnings) == [code], warnings
    return warnings[0]


@pytest.fixture(scope="module")
def one():
    """A sphere of 100 m, a camera of 7.3 degrees half across with a model, and one without."""
    scene = views.scene([views.sphere(GREY, 4)], [views.camera(model=MODEL), views.camera(name="bare")])
    with Renderer(scene) as renderer:
        yield renderer


@pytest.fixture(scope="module")
def two():
    scene = views.scene([views.sphere(GREY, 3, 100.0, "primary"), views.sphere(GREY, 3, 10.0, "moon")],
                        [views.camera(model=MODEL)])
    with Renderer(scene) as renderer:
        yield renderer


def turned(state, q):
    return replace(state, spacecraft=replace(state.spacecraft, q_from_inertial=q))


# Nothing to see


def test_a_body_behind_the_camera(one):
    state = views.state(target=2.0 * R_CAMERA)
    for warnings in (one.render(state, "navcam").warnings, draw_still(one, state, "bare").warnings):
        told = the_one(warnings, "behind_camera")
        assert "body is behind the camera (180 deg off the boresight)" in told.message
        assert told.path == "state.spacecraft.q_from_inertial" and "+Z" in told.message
    assert "behind_camera" in codes(take_frame(one, state, "navcam", exposure_s=0.01).warnings)


@pytest.mark.parametrize("off_deg, code", [(20.0, "out_of_view"), (80.0, "out_of_view"), (100.0, "behind_camera")])
def test_a_body_beside_the_image_is_told_with_its_angle(one, off_deg, code):
    q = frames.look_at(R_CAMERA, np.zeros(3))
    turn = frames.dcm([np.cos(np.radians(off_deg) / 2), 0.0, np.sin(np.radians(off_deg) / 2), 0.0])
    told = the_one(one.render(turned(views.state(), frames.quaternion(turn @ frames.dcm(q))), "bare").warnings, code)
    assert float(re.search(r"\(([\d.]+) deg off", told.message)[1]) == pytest.approx(off_deg, abs=0.5)
    if off_deg < 90.0:
        # The corner of 256 pixels at 1000 pixels of focal length.
        reach = float(re.search(r"reaches ([\d.]+) deg", told.message)[1])
        assert reach == pytest.approx(np.degrees(np.arctan(128.0 * np.sqrt(2.0) / 1000.0)), abs=0.1)


@pytest.mark.parametrize("off_deg, is_seen", [(60.0, True), (72.0, True), (80.0, False), (100.0, False)])
def test_ground_beside_the_camera(one, off_deg, is_seen):
    """110 m from the middle of a sphere of 100 m its limb is 65.4 degrees off, and the image reaches 7.3, 10.3 at its
    corners: beyond 75.7 degrees there is no ground in it, though part of the body is before the camera and part behind.
    """
    q = frames.look_at(R_CAMERA, np.zeros(3))
    turn = Rotation.from_rotvec(np.radians(off_deg) * np.array([-1.0, 1.0, 0.0]) / np.sqrt(2.0)).as_matrix()
    state = turned(views.state(60.0, range_m=110.0), frames.quaternion(turn @ frames.dcm(q)))
    image = one.render(state, "bare")
    assert image.irradiance_W_m2.any() == is_seen
    if is_seen:
        assert image.warnings == ()
    else:
        the_one(image.warnings, "out_of_view" if off_deg < 90.0 else "behind_camera")


@pytest.mark.parametrize("mistake, told", [
    (lambda q: q * [1, -1, -1, -1], "its conjugate"),
    (lambda q: np.roll(q, -1), "read as [x, y, z, w] it"),
    (lambda q: np.roll(q * [1, -1, -1, -1], -1), "read as [x, y, z, w], its conjugate")])
def test_the_usual_mistakes_with_a_quaternion_are_named(one, mistake, told):
    right = views.state()
    assert one.render(right, "bare").warnings == ()
    (warning,) = one.render(turned(right, mistake(right.spacecraft.q_from_inertial)), "bare").warnings
    assert warning.code in ("out_of_view", "behind_camera") and f"; {told}" in warning.message
    assert warning.message.endswith("has it in view")


def test_of_several_bodies_the_nearest_to_the_boresight_is_told(two):
    state = views.state(bodies=("primary", "moon"), target=2.0 * R_CAMERA)
    beside = replace(state, bodies={**state.bodies, "moon": Pose(r_inertial_m=[500.0, 0.0, 0.0])})
    told = the_one(draw_still(two, beside).warnings, "behind_camera")
    assert told.message.startswith("none of the 2 bodies is in view")


def test_one_of_two_bodies_in_view_is_enough(two):
    state = views.state(bodies=("primary", "moon"))
    away = replace(state, bodies={**state.bodies, "moon": Pose(r_inertial_m=3.0 * R_CAMERA)})
    assert draw_still(two, away).warnings == () and two.render(away).warnings == ()


@pytest.mark.parametrize("phase_deg, is_told", [
    (150.0, False), (174.0, False), (178.0, True), (180.0, True)])
def test_only_the_night_side_is_in_view(one, phase_deg, is_told):
    warnings = draw_still(one, views.state(phase_deg), "bare").warnings
    if not is_told:
        assert warnings == ()
    else:
        told = the_one(warnings, "night_side")
        assert f"only the night side of body is in view (phase {phase_deg:.3g} deg)" in told.message
        assert told.path == "state.r_sun_inertial_m"


def test_a_close_look_at_the_night_side_is_told_below_that_phase(one):
    """From 105 m over the night side, 75 degrees beyond the terminator, the horizon is 18 degrees away: all is dark."""
    state = views.state(165.0, range_m=105.0)
    assert the_one(draw_still(one, state, "bare").warnings, "night_side").message.count("phase 165 deg")


def test_a_body_in_anothers_shadow(two):
    state = views.state(30.0, bodies=("primary", "moon"))
    to_sun = state.r_sun_inertial_m / np.linalg.norm(state.r_sun_inertial_m)
    r_moon = -400.0 * to_sun
    close = r_moon + 300.0 * R_CAMERA / 2000.0
    eclipsed = replace(state, bodies={**state.bodies, "moon": Pose(r_inertial_m=r_moon)}, spacecraft=Pose(
        r_inertial_m=close, q_from_inertial=frames.look_at(close, r_moon)))
    told = the_one(draw_still(two, eclipsed).warnings, "dark")
    assert "another body's" in told.message
    aside = replace(eclipsed, bodies={**eclipsed.bodies, "primary": Pose(r_inertial_m=[0.0, 0.0, 5e3])})
    assert draw_still(two, aside).warnings == ()


def test_a_body_that_reflects_nothing():
    scene = views.scene([views.sphere(Lambert(normal_albedo=0.0), 3)], [views.camera()])
    with Renderer(scene) as renderer:
        assert the_one(renderer.render(views.state(20.0)).warnings, "dark").path == "state.bodies.body"


def test_nothing_in_the_region_that_was_asked_for(one):
    state = views.state()
    told = the_one(draw_still(one, state, "bare", roi=(0, 0, 20, 20)).warnings, "out_of_region")
    box = np.array(json.loads(re.search(r"within (\[.*\]) px", told.message)[1]))
    half = 1000.0 * 100.0 / np.sqrt(2000.0**2 - 100.0**2)
    np.testing.assert_allclose(box, 127.5 + half * np.array([-1, -1, 1, 1]), atol=0.5)
    assert draw_still(one, state, "bare", roi=(100, 100, 160, 160)).warnings == ()


def test_a_lens_that_distorts_sees_farther_than_its_pinhole():
    """Barrel distortion brings a body into the corner that the pinhole would have beside the image."""
    camera = views.camera(focal_length_px=170.0, distortion=BrownConrady(k1=-0.1))
    scene = views.scene([views.sphere(GREY, 3)], [camera])
    state, edge = views.state(), 1.17  # where the pinhole's corner is at 1.06, and the lens's at 1.26
    q = frames.look_at(R_CAMERA, np.zeros(3))
    turn = Rotation.from_rotvec(np.arctan(edge) * np.array([-1.0, 1.0, 0.0]) / np.sqrt(2.0)).as_matrix()
    with Renderer(scene) as renderer:
        seen = draw_still(renderer, turned(state, frames.quaternion(turn @ frames.dcm(q))))
        assert seen.irradiance_W_m2.any() and seen.warnings == ()
        dark = draw_still(renderer, views.state(target=2.0 * R_CAMERA))
        assert codes(dark.warnings) == ["behind_camera"]


@pytest.mark.parametrize("backend", ["raytrace"])
def test_other_backends_tell_as_well(one, backend):
    with open_renderer(one.scene, backend) as renderer:
        assert codes(renderer.render(views.state(target=2.0 * R_CAMERA), "bare").warnings) == ["behind_camera"]
        assert renderer.render(views.state(), "bare", max_error=0.1).warnings == ()


def test_a_coma_against_the_sun_is_light_enough():
    """Dust scatters forward: a comet's night side is looked at on purpose."""
    aside_m = np.array([1.5e4, 4.5e4, -1.5e4])
    state = replace(coma.state(aside_m, frames.look_at(aside_m, np.zeros(3))),
                    r_sun_inertial_m=-AU_M * aside_m / np.linalg.norm(aside_m))
    scene = coma.scene(coma.three_jets())
    for each, is_lit in ((scene, True), (replace(scene, emission=()), False)):
        with Renderer(each) as renderer:
            image = renderer.render(state)
            assert image.irradiance_W_m2.any() == is_lit and codes(image.warnings) == ["night_side"] * (not is_lit)


# Detector frames


def signal_DN(irradiance_W_m2, exposure_s):
    """Of a pixel: aperture area times electrons per joule, by the gain."""
    return irradiance_W_m2 * exposure_s * np.pi / 4 * 0.001**2 * MODEL.electrons_per_joule * 0.1


def test_a_frame_that_is_all_saturated(one):
    state = views.state(20.0, range_m=400.0)
    captured = take_frame(one, state, "navcam", exposure_s=10.0)
    assert captured.frame.saturated.all()
    told = the_one(captured.warnings, "saturated")
    assert told.message.startswith("all 65536 pixels are saturated at an exposure_s of 10")
    fits_s = float(re.search(r"fit below ([\d.e+-]+) s", told.message)[1])
    assert signal_DN(captured.irradiance_W_m2.max(), fits_s) == pytest.approx(3000.0, rel=0.05), "30000 electrons"
    again = take_frame(one, state, "navcam", exposure_s=0.8 * fits_s)
    assert again.warnings == () and again.frame.saturated.mean() < 0.01


def test_a_body_that_is_saturated_in_a_small_part_of_the_frame(one):
    captured = take_frame(one, views.state(20.0), "navcam", exposure_s=1.0)
    told = the_one(captured.warnings, "saturated")
    n_lit = np.count_nonzero(captured.irradiance_W_m2)
    assert n_lit < 0.2 * 65536 and f"{n_lit} lit pixels are saturated" in told.message


def test_a_point_source_may_saturate_its_pixels(one):
    captured = take_frame(one, views.state(20.0, range_m=4e4), "navcam", exposure_s=1.0)
    assert captured.frame.saturated.any() and captured.warnings == ()


def test_bodies_before_stars_may_be_overexposed(one):
    stars = Stars(magnitude_limit=7.0, year=2031.5)
    with Renderer(replace(one.scene, stars=stars)) as renderer:
        captured = take_frame(renderer, views.state(20.0), "navcam", exposure_s=1.0)
        assert captured.stages["stars"][0].isdigit() and captured.warnings == ()
        # A star tracker sees no body.
        away = take_frame(renderer, views.state(target=2.0 * R_CAMERA), "navcam", exposure_s=1.0)
        assert away.stages["stars"][0].isdigit() and away.warnings == ()
        night = take_frame(renderer, views.state(180.0), "navcam", exposure_s=0.01)
        assert codes(night.warnings) == ["night_side"]


def limited(one, **rules):
    model = replace(MODEL, exposure_s="auto", auto_exposure=AutoExposure(**rules))
    return replace(one.scene, cameras=[replace(one.scene.cameras[0], model=model)])


def test_automatic_exposure_at_its_limits(one):
    state = views.state(20.0)
    for rules, field, percent in (({"min_s": 1e-5, "max_s": 1e-4}, "max_s", (5, 30)),
                                  ({"min_s": 0.05}, "min_s", (99, 100))):
        with Renderer(limited(one, **rules)) as renderer:
            told = [advice for advice in take_frame(renderer, state).warnings if advice.code == "exposure_limit"][0]
            assert told.path == f"auto_exposure.{field}"
            assert f"stays at its limit of {rules[field]:.3g} s" in told.message
            assert percent[0] <= float(re.search(r"at ([\d.e+]+) % of", told.message)[1]) <= percent[1]
    with Renderer(limited(one)) as renderer:
        captured = take_frame(renderer, state)
        assert captured.warnings == () and 1e-4 < captured.frame.exposure_s < 10.0
        dark = take_frame(renderer, views.state(target=2.0 * R_CAMERA))
        assert codes(dark.warnings) == ["behind_camera", "exposure_limit"]


def test_a_loop_that_sends_its_exposure_back_is_told_at_the_limit_alone(one):
    state = views.state(20.0)
    with Renderer(limited(one, min_s=1e-5, max_s=1e-4)) as renderer:
        assert codes(take_frame(renderer, state, exposure_s=1e-4).warnings) == ["exposure_limit"]
        assert take_frame(renderer, state, exposure_s=5e-5).warnings == ()
    with Renderer(limited(one, max_s=0.05)) as renderer:
        # Far too long, and the loop will shorten it: that is no limit.
        assert codes(take_frame(renderer, state, exposure_s=0.05).warnings) == ["saturated"]


def test_light_of_less_than_half_a_number(one):
    state = views.state(20.0)
    peak = draw_still(one, state, "navcam").irradiance_W_m2.max()
    signal = signal_DN(peak, 1.0)
    told = [take_frame(one, state, "navcam", exposure_s=scale * LEAST_DN / signal).warnings
            for scale in (0.9, 1.1)]
    assert codes(told[0]) == ["underexposed"] and told[1] == ()
    fits_s = float(re.search(r"; ([\d.e+-]+) s would", told[0][0].message)[1])
    assert signal_DN(peak, fits_s) == pytest.approx(0.7 * 3000.0, rel=0.05)


def test_behind_a_mosaic_the_band_with_most_light_decides():
    bands = {"R": ((600.0, 700.0), 0.001), "G": ((500.0, 600.0), 0.002), "B": ((400.0, 500.0), 0.001)}
    optics = {letter: replace(OPTICS, band_nm=band, aperture_diameter_m=wide) for letter, (band, wide) in bands.items()}
    camera = views.camera(model=MosaicModel(optics=optics, detector=DETECTOR, exposure_s="auto"))
    scene = Scene(bodies=[views.sphere(GREY, 4)], cameras=[camera], max_error=0.1)
    with Renderer(scene) as renderer:
        state = views.state(20.0)
        assert take_frame(renderer, state).warnings == ()
        told = the_one(take_frame(renderer, state, exposure_s=10.0).warnings, "saturated")
        fits_s = float(re.search(r"fit below ([\d.e+-]+) s", told.message)[1])
        fits, exceeds = (take_frame(renderer, state, exposure_s=scale * fits_s).frame for scale in (0.8, 1.2))
        # Every other pixel of two rows is green.
        green = np.indices((256, 256)).sum(axis=0) % 2 == 1
        assert not fits.saturated.any() and exceeds.saturated[green].any() and not exceeds.saturated[~green].any()


# Distances of another unit


@pytest.mark.parametrize("sun_au, is_told", [(0.01, True), (0.03, True), (0.05, False), (30.0, False), (1000.0, True)])
def test_the_sun_at_an_unlikely_distance(one, sun_au, is_told):
    warnings = one.render(views.state(sun_distance_au=sun_au), "bare").warnings
    assert codes(warnings) == ["sun_distance"] * is_told
    assert all(f"the Sun is {sun_au:.3g} au from body" in str(told) for told in warnings)


# Ordinary scenes


# Nearer than 200 m at 130 degrees there is nothing but night.
@pytest.mark.parametrize("range_m, phase_deg", [
    (range_m, phase_deg) for range_m in (102.0, 150.0, 1000.0, 1e5, 1e8) for phase_deg in (0.0, 60.0, 130.0)
    if range_m > 200.0 or phase_deg < 90.0])
def test_ordinary_states_have_none(one, range_m, phase_deg):
    state = views.state(phase_deg, range_m=range_m)
    assert one.render(state, "bare").warnings == ()
    assert draw_still(one, state, "navcam").warnings == ()
    # Fainter light needs more than the 10 s that an automatic exposure has.
    assert range_m > 1e6 or take_frame(one, state, "navcam", exposure_s="auto").warnings == ()


def test_a_spacecrafts_own_body_stands_around_its_camera():
    """Panels of 3 m whose origin is in the camera, before a body far away."""
    panels = trimesh.util.concatenate([trimesh.creation.box((1.0, 3.0, 0.1), trimesh.transformations.translation_matrix(
        [side, 0.0, -0.5])) for side in (-2.0, 2.0)])
    craft = Body(name="craft", shape=Shape.from_arrays(panels.vertices, panels.faces), brdf=GREY)
    scene = views.scene([views.sphere(GREY, 4), craft], [views.camera()])
    state = views.state(bodies=("body", "craft"))
    mounted = replace(state, bodies={**state.bodies, "craft": Pose(
        r_inertial_m=state.spacecraft.r_inertial_m, q_from_inertial=state.spacecraft.q_from_inertial)})
    with Renderer(scene) as renderer:
        assert renderer.render(mounted).warnings == ()


def test_blur_of_a_body_that_is_followed_has_none(one):
    """Past a body at 20 km/s and 2 km, and turning after it: 10 rad/s are meant."""
    state = views.state()
    aside = frames.dcm(state.spacecraft.q_from_inertial)[0]
    moving = replace(state, spacecraft=replace(state.spacecraft, v_inertial_m_s=2e4 * aside,
                                               angular_velocity_rad_s=[0.0, 10.0, 0.0]))
    assert take_frame(one, moving, "navcam", exposure_s=3e-4).warnings == ()
    still = replace(moving, spacecraft=replace(moving.spacecraft, v_inertial_m_s=None))
    told = the_one(take_frame(one, still, "navcam", exposure_s=3e-4).warnings, "unit")
    assert told.path == "state.spacecraft.angular_velocity_rad_s"


def test_what_the_plan_warns_of_is_told_with_the_rest(one):
    image = one.render(views.state(), "bare")
    plan = replace(image.plan, warnings=("the budget is not met",))
    told = replace(image, plan=plan).warnings
    assert told == (Advice("plan", "plan.warnings", "the budget is not met"),)


def test_what_shapes_warn_of_is_told_of_the_scene():
    """An icosphere without one facet has three open edges."""
    whole = generate.icosphere(radius_m=100.0, subdivisions=2)
    body = Body(name="holed", shape=Shape.from_arrays(whole.vertices_m, whole.facets[1:]), brdf=GREY)
    scene = views.scene([views.sphere(GREY, 2), body], [views.camera()])
    told = scene_advice(scene)
    assert {advice.code for advice in told} == {"shape"} and {advice.path for advice in told} == {"bodies[1].shape"}
    assert any("holed: 3 open edges" in str(advice) for advice in told)


def test_a_name_cannot_forge_a_line(one):
    with pytest.raises(ConfigError, match="printable"):
        replace(one.scene.bodies[0], name="a\nb")


# The command line


GLRENDER = Path(sys.executable).with_name("glrender")


def test_the_command_line_prints_them(tmp_path):
    (tmp_path / "scene.toml").write_text(serving.SCENE)
    (tmp_path / "state.json").write_text(json.dumps(views.state(target=2.0 * R_CAMERA).to_dict()))
    made = subprocess.run([GLRENDER, "render", "scene.toml", "--state", "state.json", "--camera", "bare", "--out",
                           "a.npy"], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert made.returncode == 0 and made.stderr.count("\n") == 1, made.stderr
    assert made.stderr.startswith("glrender: warning: body is behind the camera (180 deg off the boresight)")
