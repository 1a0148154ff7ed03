"""Direct alignment: poses of the same shape, drawn a pixel apart, are found by light."""

from __future__ import annotations

import numpy as np
import pytest
from glrender_navigation import moved, sight
from glrender_navigation.believed import blurred, draw
from glrender_navigation.direct_alignment import aligned
from glrender_navigation.measurement import NotFound
from scipy.spatial.transform import Rotation

SIDE = 192
# A turn of the body in the camera [rad], and its move [share of the range]: a pixel or two.
TURN, MOVE = np.array([2e-3, -3e-3, 4e-3]), np.array([8e-4, -6e-4, 4e-3])


@pytest.fixture(scope="module")
def nearby(world):
    """Camera, body, the true sight, its irradiance [W/m2] without blur, and what draws the believed frame by a pose."""
    shape, camera = world.shape(6), world.camera(SIDE)
    true = list(world.views(10))[8][0]
    body, here = world.body(shape), sight(true, camera, "body")
    with world.Local(world.scene(shape, SIDE)) as local:
        def drawn_at(camera_from_body, place_m):
            return draw(local.render, moved(true, camera, "body", place_m, camera_from_body), camera, body, ("r_body",))

        yield camera, body, here, local.render(true).pixels, drawn_at


def found_by_three(frame, camera, body, here, drawn_at):
    """The pose of the third of three alignments, and its errors: centre [px], range [1], attitude [rad]."""
    pose = Rotation.from_rotvec(TURN).as_matrix() @ here.camera_from_body, here.r_body_camera_m + MOVE * here.range_m
    start = off(camera, here, pose)
    assert start[0] > 0.5 and start[1] > 3e-3 and start[2] > 5e-3
    for _ in range(3):
        pose = aligned(frame, drawn_at(*pose), camera, body)[:2]
    return pose, off(camera, here, pose)


def off(camera, here, found) -> tuple[float, float, float]:
    """Errors of the centre [px], of the range [1] and of the attitude [rad]."""
    camera_from_body, place_m = found
    turn = Rotation.from_matrix(camera_from_body) * Rotation.from_matrix(here.camera_from_body).inv()
    return (float(np.linalg.norm(camera.project(place_m) - camera.project(here.r_body_camera_m))),
            abs(float(np.linalg.norm(place_m)) / here.range_m - 1.0),
            float(turn.magnitude()))


@pytest.mark.parametrize(("gain", "sky", "sigma_px"), [(1.0, 0.0, 0.6), (3e7, 50.0, 0.6), (1.0, 0.0, 0.75)])
def test_a_pose_nearby_is_found_whatever_exposure_sky_and_blur(nearby, gain, sky, sigma_px):
    """Within 0.06 px, 0.02 % and 0.1 deg from 0.6 px, 0.4 % and 0.3 deg, at any gain and sky.

    A blur that is wider than the believed one moves the limb outwards: 0.06 % are allowed.
    """
    camera, body, here, irradiance, drawn_at = nearby
    frame = gain * blurred(irradiance, sigma_px) + sky
    _, (off_px, off_range, off_rad) = found_by_three(frame, camera, body, here, drawn_at)
    assert off_px < 0.06 and off_range < (2e-4 if sigma_px == 0.6 else 6e-4) and off_rad < 1.8e-3


def test_light_of_something_else_does_not_move_the_ground(nearby):
    """A streak over the brightest ground, half as bright: still within 0.1 px and 0.05 %."""
    camera, body, here, irradiance, drawn_at = nearby
    spoilt = blurred(irradiance, 0.6)
    y, x = np.unravel_index(blurred(irradiance, 4.0).argmax(), irradiance.shape)
    spoilt[y - 8 : y + 8, x - 8 : x + 8] += 0.5 * spoilt.max() * np.eye(16, dtype=np.float32)
    _, (off_px, off_range, _) = found_by_three(spoilt, camera, body, here, drawn_at)
    assert off_px < 0.1 and off_range < 5e-4


def test_a_negative_and_a_body_without_light_are_refused(nearby):
    """Light that falls where the believed frame's rises has no pose; nor has ground that is all another body's."""
    camera, body, here, irradiance, drawn_at = nearby
    drawn = drawn_at(here.camera_from_body, here.r_body_camera_m)
    with pytest.raises(NotFound, match=r"0\.1 is needed"):
        aligned(irradiance.max() - blurred(irradiance, 0.6), drawn, camera, body)
    drawn.is_clear[:] = False
    with pytest.raises(NotFound, match="0 pixels .* 500 are needed"):
        aligned(irradiance, drawn, camera, body)
