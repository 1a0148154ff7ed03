"""Rotations and projections against hand-worked anchors."""

from __future__ import annotations

import numpy as np
import pytest
from glrender import ConfigError, PinholeCamera, frames

HALF = np.sqrt(0.5)


@pytest.mark.parametrize("q, expected", [
    ([HALF, 0.0, 0.0, HALF], [0.0, 1.0, 0.0]),   # +90 deg about z takes x to y (photometry.md section 4.3)
    ([HALF, 0.0, HALF, 0.0], [0.0, 0.0, -1.0]),  # about y takes x to -z
    ([-HALF, 0.0, 0.0, -HALF], [0.0, 1.0, 0.0]),  # both signs are one rotation
])
def test_quaternion_is_scalar_first_and_takes_x_to(q, expected):
    np.testing.assert_allclose(frames.dcm(np.array(q)) @ [1.0, 0.0, 0.0], expected, atol=1e-15)


def test_quaternion_and_matrix_are_inverses(rng):
    for _ in range(20):
        q = rng.standard_normal(4)
        q /= np.linalg.norm(q) * np.sign(q[0])
        np.testing.assert_allclose(frames.quaternion(frames.dcm(q)), q, atol=1e-14)


def test_look_at_puts_the_target_on_the_boresight_and_up_on_top():
    r = np.array([3.0, -4.0, 5.0])
    camera_from_inertial = frames.dcm(frames.look_at(r, np.zeros(3)))
    np.testing.assert_allclose(camera_from_inertial @ -r, [0.0, 0.0, np.linalg.norm(r)], atol=1e-13)
    assert (camera_from_inertial @ [0.0, 0.0, 1.0])[1] < 0.0, "inertial +z must point up in the image (-Y)"
    np.testing.assert_allclose(np.linalg.det(camera_from_inertial), 1.0, atol=1e-14)


def test_look_at_the_own_place_is_refused():
    with pytest.raises(ConfigError, match="r_to_m: must be another point than r_from_m"):
        frames.look_at(np.ones(3), np.ones(3))


@pytest.mark.parametrize("bounds", [(-0.5, -0.5, 639.5, 479.5), (100, 50, 132, 300), (-3.2, 5.1, 9.7, 6)])
def test_projection_agrees_with_the_pinhole_camera(bounds, rng):
    """Window coordinates of GL against PinholeCamera.project, 1e-9 px, off-centre principal point."""
    camera = PinholeCamera(name="c", width_px=640, height_px=480, focal_length_px=700.0,
                           principal_point_px=(300.2, 250.7))
    points = np.append(rng.uniform(-1, 1, (100, 2)), rng.uniform(2, 8, (100, 1)), axis=1)
    clip = frames.clip_from_camera(700.0, camera.principal_point_px, bounds, 1.0, 10.0) @ np.append(
        points, np.ones((100, 1)), axis=1).T
    ndc = (clip[:3] / clip[3]).T
    x0, y0, x1, y1 = bounds
    window_xy = 0.5 * (ndc[:, :2] + 1.0) * [x1 - x0, y1 - y0] + [x0, y0]
    np.testing.assert_allclose(window_xy, camera.project(points), atol=1e-9)
    assert (np.abs(ndc[:, 2]) <= 1.0).all(), "points between near and far must be kept"


def test_directions_and_project_are_inverses(rng):
    camera = PinholeCamera(name="c", width_px=640, height_px=480, focal_length_px=700.0)
    pixel = rng.uniform(0, 480, (50, 2))
    np.testing.assert_allclose(camera.project(3.0 * camera.directions(pixel)), pixel, atol=1e-10)
    assert np.isnan(camera.project([0.0, 0.0, -1.0])).all(), "behind the camera there is no pixel"


def test_solid_angles_sum_to_the_frame():
    """Sum over pixels against the closed form of a rectangle's solid angle, 4 asin(...)."""
    camera = PinholeCamera(name="c", width_px=400, height_px=300, focal_length_px=500.0)
    a, b = 200.0 / 500.0, 150.0 / 500.0
    exact = 4.0 * np.arcsin(a * b / np.sqrt((1 + a * a) * (1 + b * b)))
    np.testing.assert_allclose(camera.solid_angle_sr().sum(), exact, rtol=1e-6)


def test_sun_frame_is_a_rotation_towards_the_sun(rng):
    for direction in [*np.eye(3), *-np.eye(3), rng.standard_normal(3)]:
        direction = direction / np.linalg.norm(direction)
        rotation = frames.sun_from_body(direction)
        np.testing.assert_allclose(rotation @ direction, [0.0, 0.0, 1.0], atol=1e-14)
        np.testing.assert_allclose(np.linalg.det(rotation), 1.0, atol=1e-14)
