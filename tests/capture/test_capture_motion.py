"""What moves during an exposure, drawn by the renderer: blur, rolling shutter, star trails, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import views
from glrender import ConfigError, Pose, State, frames, open_renderer, take_frame
from glrender.brdf import Lambert
from glrender.capture.motion_blur import MAX_POSES
from glrender.scene.stars import Stars
from glrender_camera import BrownConrady, CameraModel, Detector, Optics, StrayLight

GREY = Lambert(normal_albedo=0.4)
ROW_S = 2e-3


def model(**detector):
    fields = dict(quantum_efficiency=0.5, full_well_electrons=1e9, gain_DN_per_electron=1e-5, bit_depth=16)
    return CameraModel(optics=Optics(aperture_diameter_m=0.01), detector=Detector(**(fields | detector)),
                       exposure_s=0.1)


def passing(speed_px_s=0.0, turn_px_s=0.0, **camera):
    """A sphere 20 px wide on the boresight of a camera at the origin, passing to the right; or the camera turning."""
    camera = views.camera(64, 4e4, **{"model": model(), **camera})
    scene = views.scene([views.sphere(GREY, 5, 25.0)], [camera], max_error=0.02)
    state = State(
        r_sun_inertial_m=[0.0, 0.0, -1.5e11],
        # Turning about its own +Y, the camera sees what is ahead move to its left.
        spacecraft=Pose(r_inertial_m=np.zeros(3), angular_velocity_rad_s=[0.0, -turn_px_s / 4e4, 0.0]),
        bodies={"body": Pose(r_inertial_m=[0.0, 0.0, 1e5], v_inertial_m_s=[speed_px_s * 2.5, 0.0, 0.0])})
    return scene, state


def moments(image):
    """Centre of light (x, y) and its variances along them [px, px2]."""
    image = image.astype(np.float64)
    y, x = np.indices(image.shape)
    centre = views.centroid_px(image)
    return centre, np.array([((x - centre[0]) ** 2 * image).sum(), ((y - centre[1]) ** 2 * image).sum()]) / image.sum()


@pytest.mark.parametrize("lens", [None, BrownConrady(k1=-1e-4)])
@pytest.mark.parametrize("how", ["speed_px_s", "turn_px_s"])
def test_a_passing_body_is_blurred_along_its_way(how, lens):
    """6 px in 0.1 s: variance + 6^2 / 12 along, 0.05 px2, none across; same centre, 0.02 px, and flux, 1e-3."""
    scene, state = passing(**{how: 60.0}, distortion=lens)
    with open_renderer(scene) as renderer:
        moved = take_frame(renderer, state)
        still = take_frame(renderer, passing(distortion=lens)[1])
    (a, va), (b, vb) = moments(moved.irradiance_W_m2), moments(still.irradiance_W_m2)
    np.testing.assert_allclose(a, b, atol=0.02)
    np.testing.assert_allclose(va - vb, [36.0 / 12.0, 0.0], atol=0.05)
    np.testing.assert_allclose(moved.irradiance_W_m2.sum(), still.irradiance_W_m2.sum(), rtol=1e-3)
    assert moved.stages["motion_blur"].endswith("poses, 6 px in 0.1 s")
    assert still.stages["motion_blur"].startswith("skipped")


@pytest.mark.parametrize("row_s", [ROW_S, -ROW_S])
def test_a_rolling_shutter_leans_a_passing_body(row_s):
    """20 px/s, seen 2 ms later from row to row: each row 0.04 px farther, 4 %; the frame's middle row where it is."""
    scene, state = passing(20.0, model=model(rolling_shutter_row_s=row_s))
    with open_renderer(scene) as renderer:
        image = take_frame(renderer, state, exposure_s=1e-3).irradiance_W_m2.astype(np.float64)
    rows = np.arange(26, 38)
    centre = (image[rows] * np.arange(64)).sum(axis=1) / image[rows].sum(axis=1)
    slope, middle = np.polyfit(rows - 31.5, centre, 1)
    np.testing.assert_allclose(slope, 20.0 * row_s, rtol=0.04)
    np.testing.assert_allclose(middle, 31.5, atol=0.02)


def test_what_hardly_moves_is_drawn_once():
    """0.04 px: the bytes of a state that stands still, and the reply says why."""
    scene, state = passing(0.4)
    with open_renderer(scene) as renderer:
        capture, still = take_frame(renderer, state), take_frame(renderer, passing()[1])
    np.testing.assert_array_equal(capture.frame.dn, still.frame.dn)
    assert capture.stages["motion_blur"] == "skipped: 0.04 px of motion"


def test_the_number_of_poses_is_bounded_and_told():
    scene, state = passing(600.0)
    with open_renderer(scene) as renderer:
        capture = take_frame(renderer, state)
    assert capture.stages["motion_blur"].startswith(f"{MAX_POSES} poses, 60 px in 0.1 s, at most {MAX_POSES} are drawn")
    np.testing.assert_allclose(moments(capture.irradiance_W_m2)[1][0], 60.0**2 / 12.0, rtol=0.15)


def test_a_close_flyby_is_bounded_from_its_distance():
    """The surface 100 m below at 50 m/s fills the frame and reaches behind the camera: 0.5 rad/s, 400 px, 0.1 s."""
    camera = views.camera(64, 400.0, model=model())
    scene = views.scene([views.sphere(GREY, 5, 1000.0)], [camera])
    state = State(r_sun_inertial_m=[0.0, 0.0, -1.5e11],
                  spacecraft=Pose(r_inertial_m=[0.0, 0.0, -1100.0], v_inertial_m_s=[50.0, 0.0, 0.0],
                                  q_from_inertial=frames.look_at([0.0, 0.0, -1100.0], [900.0, 0.0, -440.0])),
                  bodies={"body": Pose(r_inertial_m=np.zeros(3))})
    with open_renderer(scene) as renderer:
        capture = take_frame(renderer, state, exposure_s=0.02)
    assert "poses" in capture.stages["motion_blur"] and capture.frame.dn.any()


def test_an_automatic_exposure_meters_what_stands_still():
    scene, state = passing(60.0)
    with open_renderer(scene) as renderer:
        moved = take_frame(renderer, state, exposure_s="auto").frame
        still = take_frame(renderer, passing()[1], exposure_s="auto").frame
    assert moved.exposure_s == still.exposure_s


def test_stars_leave_trails_with_their_flux():
    """A camera that turns by 8 px: Sirius's light as before, 1 %, its variance along by 64 / 12 px2 more, 5 %."""
    camera = views.camera(128, 600.0, model=CameraModel(
        optics=Optics(aperture_diameter_m=0.3, psf_sigma_px=0.7), detector=model().detector, exposure_s=0.5))
    # Sirius alone is as bright.
    scene = views.scene([views.sphere(GREY, 3, 1.0)], [camera], stars=Stars(magnitude_limit=-1.0, year=2020.0))
    right_ascension, declination = np.deg2rad([101.287, -16.716])
    toward = np.array([np.cos(declination) * np.cos(right_ascension), np.cos(declination) * np.sin(right_ascension),
                       np.sin(declination)])
    q = frames.look_at(np.zeros(3), toward)
    sums = []
    for rate in (0.0, 8.0 / 0.5 / 600.0):
        state = State(r_sun_inertial_m=[-1.5e11, -1.5e11, 0.0],
                      spacecraft=Pose(r_inertial_m=np.zeros(3), q_from_inertial=q,
                                      angular_velocity_rad_s=[0.0, rate, 0.0]),
                      bodies={"body": Pose(r_inertial_m=-1e4 * toward)})
        with open_renderer(scene) as renderer:
            sums.append(take_frame(renderer, state))
    still, moved = (capture.frame.electrons.astype(np.float64) for capture in sums)
    assert still.sum() > 1e6 and "poses" in sums[1].stages["motion_blur"]
    np.testing.assert_allclose(moved.sum(), still.sum(), rtol=0.01)
    (centre, width), (moved_centre, moved_width) = moments(still), moments(moved)
    np.testing.assert_allclose(moved_centre, centre, atol=0.02)
    np.testing.assert_allclose(moved_width - width, [64.0 / 12.0, 0.0], atol=0.05 * 64.0 / 12.0)


# The state's rates


def test_a_pose_turns_as_its_gyroscope_says():
    """90 deg/s about the frame's own z for 1 s: a direction fixed in inertial turns the other way; 1e-15."""
    pose = Pose(r_inertial_m=[1.0, 2.0, 3.0], v_inertial_m_s=[1.0, 0.0, -1.0],
                angular_velocity_rad_s=[0.0, 0.0, np.pi / 2.0])
    after = pose.after(1.0)
    np.testing.assert_allclose(frames.dcm(after.q_from_inertial) @ [1.0, 0.0, 0.0], [0.0, -1.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(after.r_inertial_m, [2.0, 2.0, 2.0])
    back = after.after(-1.0)
    np.testing.assert_allclose(back.q_from_inertial, pose.q_from_inertial, atol=1e-15)


def test_a_small_turn_is_the_cross_product():
    """C(t + dt) = C - [w x] C dt, 1e-9 of 1e-5 s steps."""
    rng = np.random.default_rng(3)
    q = rng.standard_normal(4)
    pose = Pose(r_inertial_m=np.zeros(3), q_from_inertial=q / np.linalg.norm(q),
                angular_velocity_rad_s=rng.standard_normal(3))
    before, after = (frames.dcm(pose.after(dt).q_from_inertial) for dt in (-1e-5, 1e-5))
    here = frames.dcm(pose.q_from_inertial)
    np.testing.assert_allclose((after - before) / 2e-5, -np.cross(pose.angular_velocity_rad_s, here.T).T, atol=1e-9)


def test_rates_travel_with_the_state():
    _, state = passing(3.0, 2.0)
    again = State.from_dict(state.to_dict())
    assert again.is_moving and again.to_dict() == state.to_dict()
    assert "v_inertial_m_s" not in views.state().to_dict()["spacecraft"] and not views.state().is_moving


@pytest.mark.parametrize("field, value, message", [
    ("v_inertial_m_s", [3e8, 0.0, 0.0], "below the speed of light"),
    ("v_inertial_m_s", [np.nan, 0.0, 0.0], "must be finite"), ("v_inertial_m_s", 3.0, "must be 3 numbers"),
    ("angular_velocity_rad_s", [1e4, 0.0, 0.0], "must be within 1000"),
    ("angular_velocity_rad_s", [0.0, np.inf, 0.0], "must be finite"), ("spin", [0.0, 0.0, 1.0], "unknown key")])
def test_bad_rates_are_refused_by_field(field, value, message):
    table = views.state().to_dict()
    table["bodies"]["body"][field] = value
    with pytest.raises(ConfigError, match=rf"state\.bodies\.body\.{field}: .*{message}"):
        State.from_dict(table)


def turning_states(camera, exposure_s, n, t_s=0.0):
    """A body that passes at one and the same speed, as poses without rates."""
    base = views.state(range_m=1000.0)
    right = frames.dcm(base.spacecraft.q_from_inertial)[0]
    speed = 8.0 / camera.focal_length_px * 1000.0 / exposure_s
    return [State(t_s=t_s + dt, r_sun_inertial_m=base.r_sun_inertial_m, spacecraft=base.spacecraft,
                  bodies={"body": Pose(r_inertial_m=speed * dt * right)})
            for dt in np.linspace(-0.5 * exposure_s, 0.5 * exposure_s, n)], speed * right


def test_poses_of_a_simulation_blur_as_its_rates_do():
    """Seventeen poses half a pixel apart, given or made of the velocity: the same light, 2 % of the brightest."""
    camera = views.camera(96, 600.0, model=model())
    states, velocity = turning_states(camera, 0.1, 17, t_s=50.0)
    middle = states[8]
    moving = State(t_s=50.0, r_sun_inertial_m=middle.r_sun_inertial_m, spacecraft=middle.spacecraft,
                   bodies={"body": Pose(r_inertial_m=np.zeros(3), v_inertial_m_s=velocity)})
    scene = views.scene([views.sphere(GREY, 4, 30.0)], [camera], max_error=0.02)
    with open_renderer(scene) as renderer:
        given = take_frame(renderer, middle, exposure_s=0.1, sub_states=states)
        made = take_frame(renderer, moving, exposure_s=0.1)
        still = take_frame(renderer, middle, exposure_s=0.1)
    assert given.stages["motion_blur"] == "17 poses as given, over 0.1 s"
    light = [capture.irradiance_W_m2 for capture in (given, made, still)]
    np.testing.assert_allclose(light[0], light[1], atol=0.02 * light[1].max())
    assert np.abs(light[2] - light[1]).max() > 0.1 * light[1].max()


@pytest.mark.parametrize("chosen, rule", [
    (slice(0, 9), "t_s must span -0.05 to 0.05 s"), (slice(0, 1), "must be 2 to 257 states"),
    (slice(None, None, -1), "t_s must rise")])
def test_poses_that_do_not_cover_the_exposure_are_refused(chosen, rule):
    camera = views.camera(32, 200.0, model=model())
    states, _ = turning_states(camera, 0.1, 17)
    with open_renderer(views.scene([views.sphere(GREY, 2, 30.0)], [camera])) as renderer:
        with pytest.raises(ConfigError, match=f"sub_states: {rule}"):
            take_frame(renderer, states[8], exposure_s=0.1, sub_states=states[chosen])
        with pytest.raises(ConfigError, match="sub_states: must be a list of State"):
            take_frame(renderer, states[8], exposure_s=0.1, sub_states=[1])


@pytest.mark.parametrize("size_px, x_px", [(6.0, -10.0), (6.0, 0.0), (40.0, -30.0)])
def test_a_body_that_enters_or_leaves_while_the_shutter_is_open(size_px, x_px):
    """40 px of motion across the frame's edge: the light of a wider camera's crop, 2 %; its wing on the far side, 3 %.

    What was outside in the middle of the exposure was not drawn at all; its wing was counted twice, or not.
    """
    stray = StrayLight(wing_fraction=0.1, wing_core_px=5.0, wing_exponent=2.5)
    model = CameraModel(optics=Optics(aperture_diameter_m=1.0, psf_sigma_px=0.7, stray_light=stray), exposure_s=1.0,
                        detector=Detector(quantum_efficiency=1.0, full_well_electrons=1e15, gain_DN_per_electron=1e-10,
                                          bit_depth=16))
    focal = 10.0 * size_px
    cameras = [views.camera(64 + 2 * room, focal, name=name, model=model, principal_point_px=(x_px + room, 30.0 + room))
               for name, room in (("narrow", 0), ("wide", 96))]
    base = views.state(range_m=2000.0)
    right = frames.dcm(base.spacecraft.q_from_inertial)[0]
    state = State(r_sun_inertial_m=base.r_sun_inertial_m, spacecraft=base.spacecraft, bodies={
        "body": Pose(r_inertial_m=np.zeros(3), v_inertial_m_s=40.0 * 2000.0 / focal * right)})
    with open_renderer(views.scene([views.sphere(GREY, 4)], cameras, max_error=0.02)) as renderer:
        got, wide = (take_frame(renderer, state, name) for name in ("narrow", "wide"))
    true = wide.frame.electrons[96:-96, 96:-96]
    for part, tolerance in ((np.s_[:, :], 0.02), (np.s_[:, 32:], 0.03)):
        np.testing.assert_allclose(got.frame.electrons[part].sum(dtype=np.float64), true[part].sum(dtype=np.float64),
                                   rtol=tolerance)
    assert got.stages["beyond"].startswith("body") and got.stages["beyond"].endswith("mean of 9 poses")


def test_a_body_that_crosses_the_frame_between_two_instants_is_drawn():
    """Out of view at both ends and in the middle of the exposure: its light for its time in the frame, 10 %."""
    cameras = [views.camera(64, 6000.0, name=name, model=model(), principal_point_px=(x_px, 30.0))
               for name, x_px in (("beside", -60.0), ("middle", 32.0))]
    base = views.state(range_m=2e5)
    right = frames.dcm(base.spacecraft.q_from_inertial)[0]
    state = State(r_sun_inertial_m=base.r_sun_inertial_m, spacecraft=base.spacecraft, bodies={
        "body": Pose(r_inertial_m=np.zeros(3), v_inertial_m_s=400.0 * 2e5 / 6000.0 * right)})
    with open_renderer(views.scene([views.sphere(GREY, 4)], cameras, max_error=0.02)) as renderer:
        still = take_frame(renderer, base, "middle").irradiance_W_m2.sum(dtype=np.float64)
        capture = take_frame(renderer, state, "beside", exposure_s=1.0)
    assert capture.stages["motion_blur"].startswith("65 poses, 4")
    np.testing.assert_allclose(capture.irradiance_W_m2.sum(dtype=np.float64), still * 64.0 / 400.0, rtol=0.1)
