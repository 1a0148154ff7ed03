"""Labels against closed forms of a sphere: its disc, its pose, and which points of it are seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import views
from glrender import ConfigError, Pose, Renderer, draw_still, frames
from glrender.brdf import Lambert
from glrender.sequences.labels import PRODUCTS, frame_labels
from glrender_camera import BrownConrady

RADIUS_M, RANGE_M, FOCAL_PX = 100.0, 5000.0, 3000.0


@pytest.fixture(scope="module")
def sphere():
    scene = views.scene([views.sphere(Lambert(normal_albedo=0.4), 5)], [views.camera(160, FOCAL_PX)])
    with Renderer(scene) as renderer:
        yield renderer


def labels_of(renderer, state, **options):
    image, scene = renderer.render(state, products=PRODUCTS), renderer.scene
    return frame_labels(scene, state, scene.cameras[0], image.irradiance_W_m2, image.products, **options)


def test_a_spheres_disc(sphere):
    state = views.state(phase_deg=60.0, range_m=RANGE_M)
    found = labels_of(sphere, state)["bodies"]["body"]
    disc_px = FOCAL_PX * np.tan(np.arcsin(RADIUS_M / RANGE_M))
    x0, y0, x1, y1 = found["box_px"]
    assert abs((x1 - x0) - 2.0 * disc_px) < 2.0 and abs((y1 - y0) - 2.0 * disc_px) < 2.0
    assert found["n_px"] == pytest.approx(np.pi * disc_px**2, rel=0.01)
    np.testing.assert_allclose(found["centre_of_figure_px"], found["origin_px"], atol=0.05)
    assert (found["range_m"], found["phase_deg"]) == (pytest.approx(RANGE_M), pytest.approx(60.0))


def test_the_centre_of_brightness_of_a_lambert_sphere(sphere):
    """At quadrature: the mean of x over half a disc, weighted by x, which is cos(incidence), is 3 pi / 16 radii."""
    state = views.state(phase_deg=90.0, range_m=RANGE_M)
    labels = labels_of(sphere, state)
    found = labels["bodies"]["body"]
    moved = np.subtract(found["centre_of_brightness_px"], found["origin_px"])
    sun = np.array(labels["sun_direction_camera"][:2])
    disc_px = FOCAL_PX * RADIUS_M / RANGE_M
    np.testing.assert_allclose(moved, 3.0 * np.pi / 16.0 * disc_px * sun / np.linalg.norm(sun), atol=0.2)


def test_a_pose_takes_points_of_the_body_to_the_camera(sphere):
    state = views.state(phase_deg=30.0, range_m=RANGE_M)
    found = labels_of(sphere, state, keypoints={"body": {"near": tuple(
        RADIUS_M * state.spacecraft.r_inertial_m / RANGE_M), "far": tuple(
        -RADIUS_M * state.spacecraft.r_inertial_m / RANGE_M)}})["bodies"]["body"]
    near, far = found["keypoints"]["near"], found["keypoints"]["far"]
    assert near["is_in_view"] and near["is_seen"] and far["is_in_view"] and not far["is_seen"]
    point = np.array([30.0, -20.0, 10.0])
    r_camera = found["r_camera_m"] + frames.dcm(np.array(found["q_camera_from_body"])) @ point
    camera, pose = sphere.scene.cameras[0], state.bodies["body"]
    r_inertial = pose.r_inertial_m + frames.dcm(pose.q_from_inertial).T @ point
    expected = frames.dcm(camera.q_camera_from_spacecraft) @ frames.dcm(state.spacecraft.q_from_inertial) @ (
        r_inertial - state.spacecraft.r_inertial_m)
    np.testing.assert_allclose(r_camera, expected, atol=1e-6)


def test_a_body_out_of_view_has_no_box(sphere):
    state = views.state(phase_deg=30.0, range_m=RANGE_M, target=(4000.0, 0.0, 0.0))
    found = labels_of(sphere, state)["bodies"]["body"]
    assert found["n_px"] == 0 and found["box_px"] is None and found["centre_of_brightness_px"] is None


def test_keypoints_of_no_body_are_refused(sphere):
    with pytest.raises(ConfigError, match=r"keypoints\.moon: is no body"):
        labels_of(sphere, views.state(), keypoints={"moon": {}})


@pytest.mark.parametrize("lens", [None, BrownConrady(k1=-0.4, p1=0.01)])
def test_limb_points_are_on_the_analytic_limb_of_a_sphere(lens):
    """Directions to the limb make asin(R / D) with that to the centre; facets of 1 degree are inside by 0.002 px."""
    camera = views.camera(160, FOCAL_PX, distortion=lens, principal_point_px=(95.0, 70.0))
    scene = views.scene([views.sphere(Lambert(normal_albedo=0.4), 6)], [camera])
    state = views.state(phase_deg=80.0, range_m=RANGE_M)
    with Renderer(scene) as renderer:
        still = draw_still(renderer, state, products=PRODUCTS)
    labels = frame_labels(scene, state, camera, still.irradiance_W_m2, still.products, n_limb_points=64)
    found = labels["bodies"]["body"]
    points, centre = np.array(found["limb"]["px"]), np.array(found["r_camera_m"])
    assert len(points) == 64
    off_centre = np.arccos(camera.directions(points) @ centre / np.linalg.norm(centre))
    assert np.abs(off_centre - np.arcsin(RADIUS_M / RANGE_M)).max() * FOCAL_PX < 0.005
    # Those that face the Sun are on its side of the disc.
    sun = np.array(labels["sun_direction_camera"][:2])
    aside = (points - found["origin_px"]) @ sun / np.linalg.norm(sun) / 60.0
    faces = np.array(found["limb"]["faces_sun"])
    assert faces[aside > 0.1].all() and not faces[aside < -0.1].any()


def test_the_images_edge_is_no_limb(sphere):
    camera = views.camera(160, FOCAL_PX)
    state = views.state(phase_deg=60.0, range_m=RANGE_M, target=(90.0, 60.0, 0.0))
    found = labels_of(sphere, state, n_limb_points=1000)["bodies"]["body"]
    points, centre = np.array(found["limb"]["px"]), np.array(found["r_camera_m"])
    off = np.arccos(camera.directions(points) @ centre / np.linalg.norm(centre))
    assert found["box_px"][0] == 0 and 50 < len(points) < 300
    assert np.abs(off - np.arcsin(RADIUS_M / RANGE_M)).max() * FOCAL_PX < 0.05


def test_an_edge_behind_a_nearer_body_is_no_limb():
    scene = views.scene([views.sphere(Lambert(normal_albedo=0.4), 5), views.sphere(
        Lambert(normal_albedo=0.4), 4, radius_m=30.0, name="moon")], [views.camera(160, FOCAL_PX)])
    state = views.state(phase_deg=30.0, range_m=RANGE_M, bodies=("body", "moon"))
    towards = state.spacecraft.r_inertial_m / RANGE_M
    aside = np.cross(towards, [0.0, 0.0, 1.0])
    moved = Pose(r_inertial_m=400.0 * towards + 95.0 * aside / np.linalg.norm(aside))
    state = replace(state, bodies={**state.bodies, "moon": moved})
    with Renderer(scene) as renderer:
        image = renderer.render(state, products=PRODUCTS)
    found = frame_labels(scene, state, scene.cameras[0], image.irradiance_W_m2, image.products, n_limb_points=1000)
    for name, radius in (("body", RADIUS_M), ("moon", 30.0)):
        label = found["bodies"][name]
        centre, points = np.array(label["r_camera_m"]), np.array(label["limb"]["px"])
        off = np.arccos(scene.cameras[0].directions(points) @ centre / np.linalg.norm(centre))
        assert len(points) > 40
        assert np.abs(off - np.arcsin(radius / np.linalg.norm(centre))).max() * FOCAL_PX < 0.05


def test_a_keypoint_beyond_the_horizon_is_hidden(sphere):
    """On a sphere at 50 radii the horizon is acos(R / D), 88.85 degrees, from the point below the camera."""
    state = views.state(phase_deg=30.0, range_m=RANGE_M)
    down = state.spacecraft.r_inertial_m / RANGE_M
    aside = np.cross(down, [0.0, 0.0, 1.0])
    aside /= np.linalg.norm(aside)
    horizon = np.degrees(np.arccos(RADIUS_M / RANGE_M))
    places = {str(angle): RADIUS_M * (np.cos(np.radians(angle)) * down + np.sin(np.radians(angle)) * aside)
              for angle in (horizon - 2.0, horizon + 2.0)}
    found = labels_of(sphere, state, keypoints={"body": places})["bodies"]["body"]["keypoints"]
    assert [point["is_seen"] for point in found.values()] == [True, False]
