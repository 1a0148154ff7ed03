"""The chain from a state to a frame: distortion, margin, the Sun, mosaics, against closed forms and other programs."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import views
from cells import slow_but
from chain import COLOURS, DETECTOR, LENS, MOSAIC, OPTICS, READ, opencv, table
from glrender import Body, ConfigError, Pose, Scene, State, draw_still, frames, open_renderer, take_frame
from glrender.base.constants import AU_M, SUN_RADIUS_M
from glrender.brdf import Lambert
from glrender.engines.rays.laser_ranges import laser_ranges
from glrender.planner.request import ImageUse
from glrender_camera import BrownConrady, CameraModel, Detector, MosaicModel, Optics, PinholeCamera, lens_of

GREY = Lambert(normal_albedo=0.4)
QUIET = CameraModel(optics=Optics(aperture_diameter_m=0.01), detector=DETECTOR, exposure_s=1e-3)


def lambert_sphere(camera, centre_camera_m, radius_m, sun_camera, n=4):
    """Float64 image of a sphere through a distorting lens: rays on n x n cells a pixel of a wide image, each carried by
    OpenCV to where it falls."""
    f = camera.focal_length_px
    x, y = centre_camera_m[:2] / centre_camera_m[2]
    reach = 1.2 * radius_m / np.linalg.norm(centre_camera_m) * (1.0 + x * x + y * y)
    axis = np.arange(-reach * f, reach * f, 1.0 / n) / f
    ray = np.stack([*np.meshgrid(x + axis, y + axis), np.ones((axis.size, axis.size))], axis=-1).reshape(-1, 3)
    cosine = 1.0 / np.linalg.norm(ray, axis=1)
    ray *= cosine[:, None]
    along = ray @ centre_camera_m
    under_root = radius_m**2 - centre_camera_m @ centre_camera_m + along**2
    hit = under_root > 0.0
    ray, cosine = ray[hit], cosine[hit]
    normal = (ray * (along[hit] - np.sqrt(under_root[hit]))[:, None] - centre_camera_m) / radius_m
    light = 0.4 / np.pi * views.SOLAR_IRRADIANCE_W_M2 * np.maximum(normal @ sun_camera, 0.0) * cosine**3 / (n * f) ** 2
    place = np.rint(opencv(camera, ray)).astype(int)
    image = np.zeros((camera.height_px, camera.width_px))
    inside = ((place >= 0) & (place < (camera.width_px, camera.height_px))).all(axis=1)
    np.add.at(image, (place[inside, 1], place[inside, 0]), light[inside])
    return image


def off_axis(camera, range_m=1000.0, radius_m=100.0, sun=(0.5, -0.3, -1.0), place=(0.33, 0.2, 1.0), **kwargs):
    """A sphere off the axis of a camera at the origin; (scene, state, centre and Sun in `camera`)."""
    scene = views.scene([views.sphere(GREY, 6, radius_m)], [camera], max_error=0.02, **kwargs)
    centre = range_m * np.array(place) / np.linalg.norm(place)
    sun = np.array(sun) / np.linalg.norm(sun)
    state = State(r_sun_inertial_m=centre + AU_M * sun, spacecraft=Pose(r_inertial_m=np.zeros(3)),
                  bodies={"body": Pose(r_inertial_m=centre)})
    return scene, state, centre, sun


# Distortion


@pytest.mark.parametrize("backend", ["auto", "raytrace"])
def test_a_distorted_sphere_is_the_one_that_rays_and_opencv_make(backend):
    """Flux 2e-3, centre of light 0.01 px, RMS 3 % of the mean, 28 px off axis of 130: undistorted it is 9 px away."""
    camera = views.camera(200, 220.0, distortion=LENS)
    scene, state, centre, sun = off_axis(camera)
    with open_renderer(scene, backend) as renderer:
        capture = draw_still(renderer, state)
    image, true = capture.irradiance_W_m2, lambert_sphere(camera, centre, 100.0, sun, 16)
    np.testing.assert_allclose(image.sum(dtype=np.float64), true.sum(), rtol=2e-3)
    np.testing.assert_allclose(views.centroid_px(image), views.centroid_px(true), atol=0.01)
    assert np.linalg.norm(views.centroid_px(true) - camera.focal_length_px * centre[:2] / centre[2] - 99.5) > 3.0
    lit = true > 0.0
    assert np.sqrt(np.mean((image - true)[lit] ** 2)) < 0.03 * true[lit].mean()
    assert capture.stages["distortion"] == "k1 -0.25, k2 0.08, p1 0.002, p2 -0.001; drawn behind the lens"
    assert capture.plan.max_error == 0.02 and 0.0 < capture.plan.predicted_error


def test_a_distorted_frame_has_its_own_off_axis_cosine():
    """Electrons over irradiance: the cosine of each lit pixel's own angle, which OpenCV images there; 5 sigma."""
    camera = views.camera(200, 220.0, distortion=LENS, model=QUIET)
    scene, state, _, _ = off_axis(camera, place=(0.4, 0.35, 1.0))
    with open_renderer(scene) as renderer:
        capture = take_frame(renderer, state, seed=1)
    rows, columns = np.nonzero(capture.irradiance_W_m2)
    pixel = np.stack([columns, rows], axis=-1).astype(float)
    direction = camera.directions(pixel)
    np.testing.assert_allclose(opencv(camera, direction), pixel, atol=1e-6)
    cosine = direction[:, 2]
    rate = QUIET.optics.aperture_area_m2 * QUIET.electrons_per_joule * QUIET.exposure_s
    expected = (capture.irradiance_W_m2[rows, columns] * cosine * rate).sum(dtype=np.float64)
    assert 0.8 < cosine.mean() < 0.9 and expected > 1e8
    electrons = capture.frame.electrons.sum(dtype=np.float64)
    np.testing.assert_allclose(electrons, expected, rtol=5.0 / np.sqrt(expected) + 1e-6)


@pytest.mark.parametrize("margin_px", [0, 3])
def test_products_of_a_distorted_frame_are_those_of_each_pixels_own_direction(margin_px):
    """Against float64 rays: range within 1 mm, body everywhere, but for pixels that meet the very limb."""
    optics = Optics(aperture_diameter_m=0.01, psf_sigma_px=0.5 * bool(margin_px))
    camera = views.camera(200, 220.0, distortion=LENS,
                          model=CameraModel(optics=optics, detector=DETECTOR, exposure_s=1e-3))
    scene, state, _, _ = off_axis(camera)
    with open_renderer(scene) as renderer:
        names = ["range", "body_id", "r_body", "incidence"]
        made = take_frame(renderer, state, products=names).products
        wide = draw_still(renderer, state, products=names).products
    assert list(made) == ["range", "body_id", "incidence", "r_body"] and made["r_body"].shape == (200, 200, 3)
    around = cv2.dilate((wide["body_id"] + 1).astype(np.uint8), np.ones((5, 5)))
    rows, columns = np.nonzero(around)
    pixel = np.stack([columns, rows], axis=-1).astype(float)
    direction = camera.directions(pixel)
    np.testing.assert_allclose(opencv(camera, direction), pixel, atol=1e-4)
    true = laser_ranges(scene, state, direction)
    for products in (made, wide):
        assert (products["body_id"][rows, columns] == true.body_id).mean() > 0.999
        seen = (products["body_id"][rows, columns] == 0) & (true.body_id == 0)
        error = np.abs(products["range"][rows, columns] - true.range_m)[seen]
        assert np.median(error) < 1e-6 and (error < 1e-3).mean() > 0.99
        place = products["r_body"][rows, columns][seen] + np.array(state.bodies["body"].r_inertial_m)
        assert np.median(np.linalg.norm(place - direction[seen] * true.range_m[seen, None], axis=1)) < 1e-4
        np.testing.assert_array_equal(np.isnan(products["range"]), products["body_id"] < 0)


def test_a_distorting_camera_projects_as_opencv_does_and_back():
    """1e-9 px both ways; the solid angles are those that pixels have by finite differences, 1e-6."""
    camera = views.camera(120, 150.0, distortion=LENS)
    rng = np.random.default_rng(1)
    ray = np.append(rng.uniform(-0.35, 0.35, (500, 2)), np.ones((500, 1)), axis=1)
    np.testing.assert_allclose(camera.project(ray), opencv(camera, ray), atol=1e-9)
    np.testing.assert_allclose(camera.directions(camera.project(ray)), ray / np.linalg.norm(ray, axis=1)[:, None],
                               atol=1e-12)
    pixel = np.array([20.0, 97.0])
    right, down = ((camera.directions(pixel + step) - camera.directions(pixel - step)) / 2e-3
                   for step in ([1e-3, 0.0], [0.0, 1e-3]))
    np.testing.assert_allclose(camera.solid_angle_sr()[97, 20], np.linalg.norm(np.cross(right, down)), rtol=1e-6)


@pytest.mark.parametrize("roi", [(64, 64, 128, 128), (100, 40, 228, 200)])
def test_a_region_is_drawn_alone_and_within_the_budget_of_its_own(roi):
    """Against the ray tracer in float64, 64 samples a pixel; the shadows of what is beside the region fall into it."""
    shape = views.binary(2, 5)
    scene = views.scene([Body(name="body", shape=shape, brdf=GREY)], [views.camera(256, 2000.0)], max_error=0.05)
    state, (x0, y0, x1, y1) = views.state(), roi
    with open_renderer(scene) as renderer:
        capture = draw_still(renderer, state, roi=roi, products=["facet_id"])
    with open_renderer(scene, "raytrace") as tracer:
        truth = tracer.render(state, samples=8).irradiance_W_m2.astype(float)
    beside = np.ones(truth.shape, bool)
    beside[y0:y1, x0:x1] = False
    assert not capture.irradiance_W_m2[beside].any() and (capture.products["facet_id"][beside] == -1).all()
    drawn = capture.plan.roi
    assert drawn[2] <= x1 - x0 and drawn[3] <= y1 - y0
    truth = truth[y0:y1, x0:x1]
    error = np.sqrt(np.mean((capture.irradiance_W_m2[y0:y1, x0:x1] - truth)[truth > 0] ** 2)) / truth[truth > 0].mean()
    assert error < scene.max_error
    assert error < 2.0 * capture.plan.predicted_error + 0.01


def test_a_lens_without_coefficients_is_no_lens():
    camera = views.camera(64, 220.0, distortion=BrownConrady())
    scene, state, _, _ = off_axis(camera)
    assert camera.distortion is None
    with open_renderer(scene) as renderer:
        capture = draw_still(renderer, state)
        np.testing.assert_array_equal(capture.irradiance_W_m2, renderer.render(state).irradiance_W_m2)
    assert capture.stages == {"distortion": "skipped: the camera has none",
                              "region": "skipped: the whole image is drawn"}


# Margins


def soft(sigma_px=1.5):
    return CameraModel(optics=Optics(aperture_diameter_m=0.01, psf_sigma_px=sigma_px), detector=DETECTOR,
                       exposure_s=1e-3)


@pytest.mark.parametrize("lens", [None, BrownConrady(k1=-0.05)])
def test_a_body_beyond_the_frame_shines_in(lens):
    """Just beyond the right edge: the light in the frame is the cropped light of a camera twice as wide, 2 %."""
    camera = views.camera(64, 400.0, model=soft(), distortion=lens)
    wide = views.camera(128, 400.0, name="wide", principal_point_px=(31.5, 31.5), model=soft(), distortion=lens,
                        height_px=64)
    scene = views.scene([views.sphere(GREY, 5, 10.0)], [camera, wide], max_error=0.02)
    # The sphere's left limb is 1 px beyond the frame's last pixel.
    centre = np.array([(32.0 + 1.0 + 4.0) / 400.0 * 1000.0, 0.0, 1000.0])
    state = State(r_sun_inertial_m=[0.0, 0.0, -AU_M], spacecraft=Pose(r_inertial_m=np.zeros(3)),
                  bodies={"body": Pose(r_inertial_m=centre)})
    with open_renderer(scene) as renderer:
        capture = take_frame(renderer, state, "navcam", seed=1)
        true = take_frame(renderer, state, "wide", seed=1)
    light, expected = (c.frame.electrons[:, :64].sum(dtype=np.float64) for c in (capture, true))
    assert not capture.irradiance_W_m2.any() and expected > 1e6
    np.testing.assert_allclose(light, expected, rtol=0.02)
    assert capture.stages["margin"] == "9 px, as far as light is spread"


def test_a_body_well_inside_has_no_margin_and_the_bytes_of_the_plain_chain():
    camera = views.camera(64, 400.0, model=soft())
    scene = views.scene([views.sphere(GREY, 5, 40.0)], [camera], max_error=0.02)
    state = views.state(range_m=1000.0)
    with open_renderer(scene) as renderer:
        capture = take_frame(renderer, state, seed=5, products=["range"])
        image = renderer.render(state, use=ImageUse(error_gain=camera.model.psf_noise_gain), products=["range"])
    np.testing.assert_array_equal(capture.frame.dn, camera.expose(image.irradiance_W_m2, 5, roi=image.roi).dn)
    np.testing.assert_array_equal(capture.products["range"], image.products["range"])
    assert capture.stages["margin"] == "skipped: nothing reaches beyond the frame"
    assert list(capture.stages)[:5] == ["distortion", "margin", "motion_blur", "sun", "stars"]
    assert all(text.startswith("skipped") for text in list(capture.stages.values())[:5])


def test_a_pinpoint_optics_never_has_a_margin():
    camera = views.camera(64, 400.0, model=QUIET)
    scene = views.scene([views.sphere(GREY, 5, 10.0)], [camera])
    with open_renderer(scene) as renderer:
        capture = take_frame(renderer, views.state(range_m=100.0))
    assert capture.stages["margin"] == "skipped: no light is spread that far" and capture.frame.dn.any()


# The Sun


def sunward(camera, body_px=None, radius_px=10.0):
    """Towards the Sun at 1 au; a sphere on the side of it, so many pixels from the Sun's centre."""
    scene = views.scene([views.sphere(GREY, 6, 100.0)], [camera], max_error=0.05)
    f = camera.focal_length_px
    sun = np.array([3.3 / f, -2.1 / f, 1.0])
    range_m = 100.0 * f / radius_px
    aside = 1e4 if body_px is None else body_px
    centre = range_m * (sun + [aside / f, 0.0, 0.0])
    return scene, State(r_sun_inertial_m=AU_M * sun / np.linalg.norm(sun), spacecraft=Pose(r_inertial_m=np.zeros(3)),
                        bodies={"body": Pose(r_inertial_m=centre)})


@pytest.mark.parametrize("lens", [None, BrownConrady(k1=-0.2)])
def test_the_sun_in_view_has_its_flux_and_saturates(lens):
    """1000 W/m2 at 1 au, 1e-3; every pixel of the disc full, and nothing of the sky."""
    camera = views.camera(128, 4000.0, model=QUIET, distortion=lens)
    scene, state = sunward(camera)
    with open_renderer(scene) as renderer:
        capture = take_frame(renderer, state)
    np.testing.assert_allclose(capture.irradiance_W_m2.sum(dtype=np.float64), views.SOLAR_IRRADIANCE_W_M2, rtol=1e-3)
    radius_px = 4000.0 * SUN_RADIUS_M / AU_M
    np.testing.assert_allclose(capture.frame.saturated.sum(), np.pi * radius_px**2, rtol=0.15)
    assert capture.stages["sun"] == "in view"


@pytest.mark.parametrize("aside_px", slow_but([4.0, 20.0, 26.0], 1))
def test_a_body_hides_its_part_of_the_sun(aside_px):
    """A disc of 10 px before one of 18.6 px: two circles' overlap in closed form, 1 % of the hidden part."""
    camera = views.camera(128, 4000.0, model=QUIET)
    scene, state = sunward(camera, aside_px)
    with open_renderer(scene) as renderer:
        capture = take_frame(renderer, state)
    a, b = 4000.0 * SUN_RADIUS_M / AU_M, 4000.0 * np.tan(np.arcsin(10.0 / 4000.0))
    if aside_px + b <= a:
        overlap = np.pi * b**2
    else:
        u = np.arccos((aside_px**2 + a**2 - b**2) / (2.0 * aside_px * a))
        v = np.arccos((aside_px**2 + b**2 - a**2) / (2.0 * aside_px * b))
        overlap = a**2 * (u - 0.5 * np.sin(2.0 * u)) + b**2 * (v - 0.5 * np.sin(2.0 * v))
    hidden = 1.0 - capture.irradiance_W_m2.sum(dtype=np.float64) / views.SOLAR_IRRADIANCE_W_M2
    np.testing.assert_allclose(hidden, overlap / (np.pi * a**2), rtol=0.01)


@pytest.mark.parametrize("focal_length_px, sun_px", [(100.0, 63.0), (2e5, 0.0), (4000.0, 80.0), (4000.0, -83.0)])
def test_the_sun_never_crashes(focal_length_px, sun_px):
    """A point, larger than the frame, half outside, in the margin: finite, and as much light as fits."""
    camera = views.camera(128, focal_length_px, model=soft())
    scene = views.scene([views.sphere(GREY, 4, 100.0)], [camera])
    sun = AU_M * np.array([sun_px / focal_length_px, 0.0, 1.0])
    state = State(r_sun_inertial_m=sun, spacecraft=Pose(r_inertial_m=np.zeros(3)),
                  bodies={"body": Pose(r_inertial_m=[0.0, 0.0, -1e6])})
    with open_renderer(scene) as renderer:
        capture = take_frame(renderer, state, exposure_s="auto")
        blinding = take_frame(renderer, state, exposure_s=1e6)
    assert np.isfinite(capture.frame.electrons).all() and capture.stages["sun"] == "in view"
    assert blinding.frame.saturated.any()
    assert capture.irradiance_W_m2.sum(dtype=np.float64) <= views.SOLAR_IRRADIANCE_W_M2 * (1.0 + 1e-3)


def test_inside_the_sun_no_frame_is_taken():
    camera = views.camera(32, 100.0, model=QUIET)
    scene = views.scene([views.sphere(GREY, 4, 100.0)], [camera])
    state = State(r_sun_inertial_m=[0.0, 0.0, 8e8], spacecraft=Pose(r_inertial_m=[0.0, 0.0, 2e8]),
                  bodies={"body": Pose(r_inertial_m=np.zeros(3))})
    with open_renderer(scene) as renderer, pytest.raises(ConfigError, match="solar radius"):
        take_frame(renderer, state)


# Mosaics


def test_a_mosaic_counts_what_one_camera_in_each_band_counts():
    """The grey body drawn once and scaled, against three scenes drawn in their own band: 5 sigma of the electrons."""
    camera = views.camera(96, 400.0, model=MOSAIC)
    options = {"solar_irradiance_1au_W_m2": None}
    state = views.state(range_m=1000.0)
    with open_renderer(views.scene([views.sphere(GREY, 5)], [camera], **options)) as renderer:
        capture = take_frame(renderer, state, seed=1)
    sums = {}
    for letter, model in MOSAIC.bands.items():
        own = views.camera(96, 400.0, model=model)
        with open_renderer(views.scene([views.sphere(GREY, 5)], [own], **options)) as renderer:
            expected = take_frame(renderer, state, seed=2).frame.electrons
        mine = np.zeros((96, 96), bool)
        for i, row in enumerate(MOSAIC.pattern):
            for j, x in enumerate(row):
                mine[i::2, j::2] |= x == letter
        sums[letter] = expected[mine].sum(dtype=np.float64)
        got = capture.frame.electrons[mine].sum(dtype=np.float64)
        assert sums[letter] > 1e6
        np.testing.assert_allclose(got, sums[letter], atol=5.0 * np.sqrt(got + sums[letter]))
    assert len({round(value, -3) for value in sums.values()}) == 3
    assert capture.stages["mosaic"] == "RG GB"


# Exposure with a memory


def test_the_last_frame_sets_the_exposure():
    """From ten times too long to its target in three frames, each from the one before; 5 %."""
    detector = Detector(quantum_efficiency=0.5, full_well_electrons=1e5, gain_DN_per_electron=0.04, bit_depth=12)
    model = CameraModel(optics=Optics(aperture_diameter_m=0.01), detector=detector, exposure_s="auto")
    camera = views.camera(96, 400.0, model=model)
    with open_renderer(views.scene([views.sphere(GREY, 5)], [camera])) as renderer:
        told = take_frame(renderer, views.state(range_m=1000.0)).frame.exposure_s
        capture = take_frame(renderer, views.state(range_m=1000.0), exposure_s=10.0 * told)
        for _ in range(3):
            capture = take_frame(renderer, views.state(range_m=1000.0), previous=capture.frame)
    np.testing.assert_allclose(capture.frame.exposure_s, told, rtol=0.05)


def test_a_camera_without_a_model_takes_no_frame():
    scene, state, _, _ = off_axis(views.camera(32, 220.0))
    with open_renderer(scene) as renderer, pytest.raises(ConfigError, match="output: camera 'navcam' has no optics"):
        take_frame(renderer, state)


# Bad input


@pytest.mark.parametrize("scene, message", [
    (table({"distortion": {"k7": 0.1}}), r"scene\.cameras\[0\]\.distortion\.k7: unknown key"),
    (table({"distortion": {"k1": float("nan")}}), r"scene\.cameras\[0\]\.distortion\.k1: must be a finite number"),
    (table({"distortion": 0.1}), r"scene\.cameras\[0\]\.distortion: must be a table"),
    (table({"distortion": {"k1": -0.9}}), r"scene\.cameras\[0\]\.distortion: .* folds over at 0\.608581"),
    (table({"distortion": {"k1": 100.0}}), r"scene\.cameras\[0\]\.distortion: must magnify by at most 8"),
    (table(stars={"magnitude_limit": 6.0}), r"scene\.stars\.year: missing"),
    (table(stars={"magnitude_limit": 6.0, "year": 2030, "colour": 1}), r"scene\.stars\.colour: unknown key"),
    (table(stars={"magnitude_limit": 60.0, "year": 2030}), r"scene\.stars\.magnitude_limit: must be between -2 and 14"),
    (table(stars={"magnitude_limit": 6.0, "year": "now"}), r"scene\.stars\.year: must be a finite number"),
    (table(stars={"magnitude_limit": 6.0, "year": 2030, "aberration": 1}), r"scene\.stars\.aberration: must be true"),
    (table(stars=[]), r"scene\.stars: must be a table"),
    (table({"model": {**COLOURS, "pattern": ["RX"]}}), r"scene\.cameras\[0\]\.model\.optics\.G: unknown key"),
    (table({"model": {**COLOURS, "optics": {"R": OPTICS, "G": OPTICS}}}), r"model\.optics\.B: missing"),
    (table({"model": {**COLOURS, "optics": {"R": {}, "G": OPTICS, "B": OPTICS}}}),
     r"cameras\[0\]\.model\.optics\.R\.aperture_diameter_m: missing"),
    (table({"model": {**COLOURS, "optics": 5}}), r"cameras\[0\]\.model\.optics: must be a table"),
    (table({"model": {**COLOURS, "filters": 3}}), r"cameras\[0\]\.model\.filters: unknown key"),
    (table({"model": COLOURS}, solar_irradiance_1au_W_m2=700.0), r"scene\.solar_irradiance_1au_W_m2: must be left out"),
    (table({"model": {"optics": OPTICS, "detector": {**READ, "rolling_shutter_row_s": 2.0}, "exposure_s": 1.0}}),
     r"detector\.rolling_shutter_row_s: must be between -1 and 1"),
])
def test_bad_scenes_are_refused_by_field(scene, message):
    with pytest.raises(ConfigError, match=message):
        Scene.from_dict(scene)


def test_a_mosaic_of_a_scene_file_is_a_mosaic():
    camera = Scene.from_dict(table({"model": COLOURS, "distortion": {"k1": -0.01}})).cameras[0]
    assert isinstance(camera.model, MosaicModel) and camera.model.pattern == ("RG", "GB")
    assert camera.distortion == BrownConrady(k1=-0.01) and isinstance(camera, PinholeCamera)


def test_a_distorted_edge_needs_more_cells_where_it_is_stretched():
    """Pincushion k1 = 2 at the corner's r = 0.54: magnified 1 + 3 k1 r^2 = 2.7 along the radius, so 3 x 3 cells."""
    camera = views.camera(160, 100.0, distortion=BrownConrady(k1=2.0))
    assert lens_of(camera).oversampling == 3
    assert frames.dcm(camera.q_camera_from_spacecraft).shape == (3, 3)


def test_progress_rises_through_poses():
    """To 1, in steps that a frame's poses share, whether its exposure is given, metered, or its poses are."""
    scene = views.scene([views.sphere(GREY, 4)], [views.camera(48, 200.0, model=soft())])
    state = views.state(phase_deg=70.0, target=(30.0, 0.0, 0.0))
    turning = replace(state.spacecraft, angular_velocity_rad_s=(0.0, 0.1, 0.0))
    turning = replace(state, spacecraft=turning)
    given = tuple(replace(turning.after(dt), t_s=dt) for dt in (-0.05, 0.0, 0.05))
    with open_renderer(scene, "raytrace") as tracer:
        for options, steps in (({"exposure_s": 0.1}, 3), ({"exposure_s": "auto"}, 2),
                               ({"exposure_s": 0.1, "sub_states": given}, 4)):
            told = []
            capture = take_frame(tracer, turning, max_error=0.1, on_progress=told.append, **options)
            assert "poses" in capture.stages["motion_blur"] or options["exposure_s"] == "auto"
            assert told == sorted(set(told)) and told[-1] == 1.0 and 0.0 < told[0] <= 0.5 and len(told) >= steps


@pytest.mark.parametrize("lens", [None, BrownConrady(k1=-0.05)])
def test_a_ray_traced_frame_has_the_margin_and_the_lens_too(lens):
    """Across the frame's edge: rays draw the same wide image; 1 % of the light."""
    camera = views.camera(48, 200.0, model=soft(), distortion=lens)
    scene, state = views.scene([views.sphere(GREY, 5)], [camera]), views.state(phase_deg=70.0, target=(200.0, 0.0, 0.0))
    with open_renderer(scene) as renderer, open_renderer(scene, "raytrace") as tracer:
        fast, slow = (take_frame(each, state, seed=1, max_error=0.02) for each in (renderer, tracer))
    assert not slow.plan.windows and fast.plan.windows
    assert slow.irradiance_W_m2.shape == (48, 48) and slow.plan.predicted_error <= slow.plan.max_error == 0.02
    assert not slow.stages["margin"].startswith("skipped")
    np.testing.assert_allclose(slow.frame.electrons.sum(), fast.frame.electrons.sum(), rtol=0.01)


def test_a_sun_that_a_body_covers_is_not_told_in_view():
    camera = views.camera(128, 4000.0, model=QUIET)
    scene, state = sunward(camera, 0.0, radius_px=40.0)
    with open_renderer(scene) as renderer:
        capture = take_frame(renderer, state)
    assert capture.stages["sun"] == "skipped: hidden by a body, or outside the image"
    assert not capture.frame.saturated.any()
