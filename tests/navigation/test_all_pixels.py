"""`all_pixels` against truth, and against the bound that the noise of the frame's own camera sets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from glrender import PinholeCamera, Renderer
from glrender_navigation import ESTIMATORS, Camera, moved, sight
from glrender_navigation.all_pixels import AllPixels
from scipy.spatial.transform import Rotation

SIZE_PX, N_VIEWS, TOLERANCE = 160, 6, 0.005


@pytest.fixture(scope="module")
def near(world):
    """A world of a point Sun: its scene, its camera, a body whose shape is known, and its renderer."""
    shape = world.shape(subdivisions=5)
    scene = replace(world.scene(shape, SIZE_PX, max_error=TOLERANCE), sun_disc=False)
    with world.Local(scene) as side, Renderer(scene) as renderer:
        yield scene, world.camera(SIZE_PX), replace(world.body(shape), shape_error_m=0.0), side, renderer


def errors(found, true, camera):
    """Of the place (3,) [m], right, down and along; and its covariance."""
    assert found is not None
    here = sight(true, camera, "body")
    return found.r_camera_m - here.r_body_camera_m, found.covariance_m2


def bounds(image):
    """Least deviations (3,) [m] of any estimate, by the renderer's own information."""
    return np.array(list(image.information(components={"spacecraft": (0, 1, 2)}, exposure_s="auto").sigmas.values()))


def test_it_reaches_the_bound_of_the_noise_and_knows_it(world, near):
    scene, camera, body, side, renderer = near
    estimator, rows, nees, asked = ESTIMATORS["all_pixels"](camera, body), [], [], []

    def render(*state, **options):
        asked.append("compare" in options)
        return side.render(*state, **options)

    for seed, (true, believed) in list(enumerate(world.views(N_VIEWS)))[::2]:
        image = renderer.render(true, derivatives=["spacecraft"])
        frame = scene.cameras[0].expose(image.irradiance_W_m2, seed).dn
        error, covariance = errors(estimator.measure(frame, believed, render), true, camera)
        rows.append(error / bounds(image))
        nees.append(error @ np.linalg.solve(covariance, error))
    # The time is that of comparisons.
    assert sum(asked) <= 2 * len(rows) and len(asked) <= 5 * len(rows), asked
    assert np.sqrt(np.mean(np.square(rows))) < 1.5, rows
    assert 0.7 < np.mean(nees) < 6.0, nees


@pytest.mark.parametrize("seed", [0, pytest.param(3, marks=pytest.mark.slow), 5])
def test_it_comes_from_20_px_and_4_percent(world, near, seed):
    _, camera, body, side, _ = near
    true, _ = list(world.views(N_VIEWS))[seed]
    here = sight(true, camera, "body")
    pixel, sign = camera.project(here.r_body_camera_m) + [12.0, -16.0], (-1.0) ** seed
    far = moved(true, camera, "body", (1.0 + 0.04 * sign) * here.range_m * camera.direction(pixel))
    frame = side.render(true, output="dn", exposure_s="auto", seed=seed, derivatives=["sun"]).pixels
    error, covariance = errors(AllPixels(camera, body).measure(frame, far, side.render), true, camera)
    assert error @ np.linalg.solve(covariance, error) < 16.0


def test_attitude_and_place_of_a_camera_on_an_arm(world, near):
    """Its attitude is believed a degree off, and its frame is one of numbers that are no integers."""
    scene, camera, body, *_ = near
    q = Rotation.from_rotvec([0.2, -0.3, 0.5]).as_quat(scalar_first=True)
    arm_m = (150.0, -80.0, 60.0)
    pinhole = replace(scene.cameras[0], q_camera_from_spacecraft=q, r_camera_spacecraft_m=arm_m)
    assert isinstance(pinhole, PinholeCamera)
    camera = replace(camera, q_camera_from_spacecraft=tuple(q), r_camera_spacecraft_m=arm_m)
    assert isinstance(camera, Camera)
    true, _ = list(world.views(N_VIEWS))[4]
    level = sight(true, replace(camera, q_camera_from_spacecraft=(1.0, 0.0, 0.0, 0.0)), "body")
    true = moved(true, camera, "body", [20.0, -10.0, level.range_m], level.camera_from_body)
    here = sight(true, camera, "body")
    turn = Rotation.from_rotvec(np.radians([0.4, -0.3, 0.8])).as_matrix()
    believed = moved(true, camera, "body", here.r_body_camera_m + [15.0, 9.0, -40.0], turn @ here.camera_from_body)
    with world.Local(replace(scene, cameras=[pinhole])) as side:
        frame = side.render(true, output="dn", exposure_s="auto", seed=4, derivatives=["sun"]).pixels.astype(float)
        found = AllPixels(camera, body, is_attitude_known=False).measure(frame, believed, side.render)
    error, _ = errors(found, true, camera)
    turned = Rotation.from_quat(found.q_camera_from_body, scalar_first=True).as_matrix() @ here.camera_from_body.T
    error = np.append(Rotation.from_matrix(turned).as_rotvec(), error)
    sigmas = np.sqrt(np.diag(found.pose_covariance))
    assert (np.abs(error) < 4.0 * sigmas).all() and (sigmas[:3] < 1e-3).all(), (error, sigmas)
    assert error @ np.linalg.solve(found.pose_covariance, error) < 25.0


def test_masked_pixels_do_not_count(world, near):
    """Columns of the body, and others, that the sensor lost."""
    _, camera, body, side, _ = near
    true, believed = next(iter(world.views(N_VIEWS)))
    frame = side.render(true, output="dn", exposure_s="auto", seed=2, derivatives=["sun"]).pixels
    frame = np.ma.array(frame, mask=np.zeros(frame.shape, bool))
    frame.mask[:, 20:60], frame.mask[:, 78:82] = True, True
    frame.data[:, 78:82] = 0
    estimator = AllPixels(camera, body)
    found = estimator.measure(frame, believed, side.render)
    assert found is not None, estimator.reason
    error, covariance = errors(found, true, camera)
    assert error @ np.linalg.solve(covariance, error) < 16.0 and found.doubt == ""


def test_a_wrong_match_says_so_and_a_right_one_does_not(world, near):
    """The body is believed to be turned by 20 degrees, which no place explains."""
    _, camera, body, side, _ = near
    true, believed = next(iter(world.views(N_VIEWS)))
    frame = side.render(true, output="dn", exposure_s="auto", derivatives=["sun"]).pixels
    estimator, wrong = AllPixels(camera, replace(body, shape_error_m=None)), believed.to_dict()
    turn = Rotation.from_rotvec(np.radians([20.0, 0.0, 0.0]))
    pose = wrong["bodies"]["body"]
    pose["q_from_inertial"] = (turn * Rotation.from_quat(pose["q_from_inertial"], scalar_first=True)).as_quat(
        scalar_first=True)
    right, found = (estimator.measure(frame, each, side.render) for each in (believed, wrong))
    assert right.doubt == "" and "attitude" in found.doubt, (right.doubt, found.doubt, estimator.reason)
    error_m, covariance_m2 = errors(found, true, camera)
    shape_m2 = right.covariance_m2
    assert error_m @ np.linalg.solve(shape_m2, error_m) > 100.0 > error_m @ np.linalg.solve(covariance_m2, error_m)


@pytest.mark.slow
def test_a_coarser_shape_is_worth_as_much_as_templates_make_of_it(world):
    """The frames and beliefs of examples/navigation, of a sixteenth of the facets: the covariance has the shape's."""
    true_shape, coarse = world.shape(), world.shape(subdivisions=4)
    camera, body, rows = world.camera(256), world.body(coarse), {"all_pixels": [], "templates": []}
    with world.Local(world.scene(true_shape, 256)) as side, world.Local(world.scene(coarse, 256)) as board:
        for seed, (true, believed) in enumerate(world.views(12)):
            frame = side.render(true, output="dn", exposure_s="auto", seed=seed).pixels
            for name, found in rows.items():
                error, covariance = errors(ESTIMATORS[name](camera, body).measure(frame, believed, board.render), true,
                                           camera)
                found.append((*error[:2], error @ np.linalg.solve(covariance, error)))
    across_m = {name: np.sqrt(np.mean(np.square(np.array(found)[:, :2]))) for name, found in rows.items()}
    assert across_m["all_pixels"] < across_m["templates"]
    assert np.mean(np.array(rows["all_pixels"])[:, 2]) < 6.0


def test_a_body_that_may_hide_it_is_the_reason_of_none(world, near):
    scene, camera, body, side, _ = near
    true, _ = next(iter(world.views(N_VIEWS)))
    frame = side.render(true, output="dn", exposure_s="auto").pixels
    moon = replace(scene.bodies[0], name="moon")
    place = true.spacecraft.r_inertial_m * 0.5
    both = {**true.to_dict(), "bodies": {**true.to_dict()["bodies"], "moon": {
        "r_inertial_m": place + [0.0, 0.0, 280.0], "q_from_inertial": [1.0, 0.0, 0.0, 0.0]}}}
    estimator = AllPixels(camera, body)
    with world.Local(replace(scene, bodies=[scene.bodies[0], moon])) as board:
        assert estimator.measure(frame, both, board.render) is None
    assert "derivatives" in estimator.reason or "correlates" in estimator.reason, estimator.reason


@pytest.mark.slow
def test_two_hundred_fits_scatter_as_the_bound_has_it(world, near):
    """Of six views; each frame has a sensor of its own, as the pixels' pattern is part of the noise."""
    scene, camera, body, side, renderer = near
    estimator, rows, nees, pinhole = AllPixels(camera, body), [], [], scene.cameras[0]
    for true, _ in world.views(N_VIEWS):
        image = renderer.render(true, derivatives=["spacecraft"])
        sigmas = bounds(image)
        for seed in range(34):
            detector = replace(pinhole.model.detector, sensor_seed=seed)
            one = replace(pinhole, model=replace(pinhole.model, detector=detector))
            frame = one.expose(image.irradiance_W_m2, seed).dn
            error, covariance = errors(estimator.measure(frame, true, side.render), true, camera)
            rows.append(error / sigmas)
            nees.append(error @ np.linalg.solve(covariance, error))
    scatter = np.std(rows, axis=0)
    assert (np.abs(scatter - 1.0) < 0.1).all(), scatter
    assert abs(np.mean(nees) / 3.0 - 1.0) < 0.05, np.mean(nees)
