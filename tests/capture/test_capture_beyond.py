"""Stray light of the Sun and of bodies beyond the frame, against closed forms and a frame that holds them."""

from __future__ import annotations

import numpy as np
import pytest
import views
from glrender import Pose, State, open_renderer, take_frame
from glrender.base.constants import AU_M
from glrender.brdf import Lambert
from glrender_camera import BrownConrady, CameraModel, Detector, Optics, StrayLight

GREY = Lambert(normal_albedo=0.3)


def model(**stray):
    return CameraModel(optics=Optics(aperture_diameter_m=0.01, psf_sigma_px=0.7, stray_light=StrayLight(**stray)),
                       detector=Detector(quantum_efficiency=0.5, full_well_electrons=1e15, gain_DN_per_electron=1e-10,
                                         bit_depth=16), exposure_s=1.0)


WING = dict(wing_fraction=0.02, wing_core_px=20.0, wing_exponent=3.0)


def sun_state(angle_deg, r_body=(0.0, 0.0, -5000.0)):
    angle = np.radians(angle_deg)
    return State(r_sun_inertial_m=AU_M * np.array([np.sin(angle), 0.0, np.cos(angle)]),
                 spacecraft=Pose(r_inertial_m=np.zeros(3)), bodies={"body": Pose(r_inertial_m=np.array(r_body))})


@pytest.mark.parametrize("angle_deg, stray, share", [
    (20.0, WING, None), (20.0, dict(veiling_glare_beyond=1e-4), 1e-4), (20.0, dict(WING, baffle_deg=15.0), 0.0),
    (100.0, dict(veiling_glare_beyond=1e-4), 0.0)])
def test_the_sun_beside_the_frame_throws_light_into_it(angle_deg, stray, share):
    """The wing's profile at the Sun's distance, or the veil's share of its light: 2 %; nothing past the baffle."""
    camera = views.camera(96, 300.0, model=model(**stray))
    with open_renderer(views.scene([views.sphere(GREY, 2)], [camera])) as renderer:
        capture = take_frame(renderer, sun_state(angle_deg))
    light = capture.frame.electrons.sum(dtype=np.float64) / (
        camera.model.optics.aperture_area_m2 * camera.model.electrons_per_joule)
    if share is None:
        x = 300.0 * np.tan(np.radians(angle_deg)) - (np.arange(96) - 47.5)
        y = np.arange(96) - 47.5
        profile = 0.02 / (2.0 * np.pi * 400.0) * (1.0 + (x**2 + y[:, None] ** 2) / 400.0) ** -1.5
        share = profile.sum()
    foreshortened = views.SOLAR_IRRADIANCE_W_M2 * np.cos(np.radians(angle_deg))
    np.testing.assert_allclose(light, share * foreshortened, rtol=0.02, atol=1e-12)
    assert capture.stages["beyond"].startswith("the Sun") == (share > 0.0)


def test_a_body_hides_the_sun_beside_the_frame():
    """All of it, and half of it."""
    camera = views.camera(96, 300.0, model=model(veiling_glare_beyond=1e-4))
    angle, light = np.radians(20.0), []
    towards, right = np.array([np.sin(angle), 0.0, np.cos(angle)]), np.array([np.cos(angle), 0.0, -np.sin(angle)])
    with open_renderer(views.scene([views.sphere(GREY, 4)], [camera])) as renderer:
        for place in (2000.0 * towards, 2000.0 * towards + 100.0 * right, 2000.0 * towards + 300.0 * right):
            light.append(take_frame(renderer, sun_state(20.0, place)).frame.electrons.sum(dtype=np.float64))
    assert light[0] < 1e-3 * light[2]
    np.testing.assert_allclose(light[1] / light[2], 0.5, atol=0.15)


@pytest.mark.parametrize("x_px, tolerance", [(120.0, 0.02), (90.0, 0.02), (52.0, 0.03)])
def test_the_wing_of_a_body_beside_the_frame_is_that_of_a_wider_frame(x_px, tolerance):
    """60 px across, beyond the frame, near it, or cut by its edge: the dark far side against a wider camera's crop."""
    optics = dict(wing_fraction=0.1, wing_core_px=20.0, wing_exponent=2.5)
    focal = 300.0
    narrow = views.camera(96, focal, name="narrow", model=model(**optics))
    wide = views.camera(96 + 2 * 160, focal, name="wide", model=model(**optics))
    range_m = 2000.0
    centre = range_m * np.array([x_px / focal, 0.02, 1.0])
    state = State(r_sun_inertial_m=AU_M * np.array([0.3, 0.2, -1.0]), spacecraft=Pose(r_inertial_m=np.zeros(3)),
                  bodies={"body": Pose(r_inertial_m=centre)})
    with open_renderer(views.scene([views.sphere(GREY, 4, 200.0)], [narrow, wide], max_error=0.02)) as renderer:
        got, true = (take_frame(renderer, state, name) for name in ("narrow", "wide"))
    left = np.s_[:, :20]
    expected = true.frame.electrons[160:-160, 160:-160][left].sum(dtype=np.float64)
    np.testing.assert_allclose(got.frame.electrons[left].sum(dtype=np.float64), expected, rtol=tolerance)
    assert got.stages["beyond"].startswith("body") and true.stages["beyond"].startswith("skipped")


def test_without_stray_light_nothing_comes_from_beyond():
    camera = views.camera(96, 300.0, model=CameraModel(
        optics=Optics(aperture_diameter_m=0.01), detector=model(**WING).detector, exposure_s=1.0))
    with open_renderer(views.scene([views.sphere(GREY, 2)], [camera])) as renderer:
        capture = take_frame(renderer, sun_state(20.0))
    assert capture.stages["beyond"] == "skipped: the optics have no stray light" and not capture.frame.dn.any()


def account(capture):
    """Light [W/m2] that came from the frame's own sky and from beyond it."""
    text = capture.stages["light"]
    return sum(float(part.split()[0]) for part in (text, text.split("sky, ")[1]))


@pytest.mark.parametrize("size_px, x_px", [(12.0, -10.0), (12.0, -8.0), (12.0, -6.0), (0.5, -4.6), (0.5, -3.0),
                                           (0.5, 0.0)])
def test_a_small_body_that_the_edge_cuts_throws_its_wing_in_once(size_px, x_px):
    """Told as points: once in the account, 1e-3; a wider camera's crop, 1 %, and 5e-3 on the far side.

    What the point spread function carries out of the image has its wing as well: without, up to 38 % were missing.
    """
    optics, focal = dict(wing_fraction=0.1, wing_core_px=5.0, wing_exponent=2.5), 10.0 * size_px
    narrow = views.camera(64, focal, name="narrow", model=model(**optics), principal_point_px=(x_px, 30.0))
    wide = views.camera(64 + 2 * 96, focal, name="wide", model=model(**optics),
                        principal_point_px=(x_px + 96.0, 126.0))
    with open_renderer(views.scene([views.sphere(GREY, 4)], [narrow, wide], max_error=0.02)) as renderer:
        got, true = (take_frame(renderer, views.state(range_m=2000.0), name) for name in ("narrow", "wide"))
    assert got.stages["points"].startswith("0 stars, 1 bod")
    for part, tolerance in ((np.s_[:, :], 0.01), (np.s_[:, 24:], 5e-3)):
        np.testing.assert_allclose(got.frame.electrons[part].sum(dtype=np.float64),
                                   true.frame.electrons[96:-96, 96:-96][part].sum(dtype=np.float64), rtol=tolerance)
    np.testing.assert_allclose(account(got), account(true), rtol=1e-3)


@pytest.mark.parametrize("k1, angle_deg, is_beyond", [(-0.2, 27.0, False), (-0.2, 32.0, True), (0.4, 25.0, True),
                                                      (0.4, 19.0, False), (-0.2, 40.0, True)])
def test_a_lens_decides_whether_the_sun_is_in_the_image(k1, angle_deg, is_beyond):
    """Its light comes once: from the frame's own sky or from beyond it; `cv2`'s r (1 + k1 r2) against the edge."""
    camera = views.camera(128, 138.0, model=model(veiling_glare_beyond=1e-4), distortion=BrownConrady(k1=k1))
    r = np.tan(np.radians(angle_deg))
    margin = 5
    assert (138.0 * r * (1.0 + k1 * r * r) > 64.0 + margin) == is_beyond
    with open_renderer(views.scene([views.sphere(GREY, 2)], [camera])) as renderer:
        capture = take_frame(renderer, sun_state(angle_deg))
    assert capture.stages["beyond"].startswith("the Sun") == is_beyond
    np.testing.assert_allclose(account(capture), views.SOLAR_IRRADIANCE_W_M2 * np.cos(np.radians(angle_deg)), rtol=0.01)


def test_the_suns_light_is_whole_while_it_leaves_the_image():
    """Its disc, 93 px wide, cut by the edge: what the image lacks comes from beyond it, 5 %."""
    camera = views.camera(64, 1e4, model=model(veiling_glare_beyond=1e-4), principal_point_px=(32.0, 32.0))
    with open_renderer(views.scene([views.sphere(GREY, 2)], [camera])) as renderer:
        for x_px in (60.0, 68.0, 100.0, 130.0):
            capture = take_frame(renderer, sun_state(np.degrees(np.arctan(x_px / 1e4))))
            np.testing.assert_allclose(account(capture), views.SOLAR_IRRADIANCE_W_M2, rtol=0.05, err_msg=str(x_px))
