"""Derivatives of frames with shadows, and with what hides, against exact polygons of a slab with a pillar."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import views
from glrender import Body, Pose, Renderer, Shape, State, frames
from glrender.base.constants import AU_M
from glrender.brdf import Lambert
from moved_states import from_its_camera, moved
from scipy.spatial import ConvexHull

HALF_M, SIDE_M, HEIGHT_M, RANGE_M, ALBEDO = 100.0, 40.0, 60.0, 4000.0, 0.3
CAMERA = views.camera(80, 1100.0)
COUNTS = {"spacecraft": 6, "bodies.body": 6, "sun": 2, "focal_length": 1}
# Steps [m, rad, px] of a thousandth of what moves the outline by a pixel, about.
STEPS = {"spacecraft": (4e-3, 4e-3, 0.1, 1e-6, 1e-6, 3e-5), "bodies.body": (4e-3, 4e-3, 0.1, 3e-5), "sun": (3e-5,),
         "focal_length": (0.03,)}


def state(sun_deg=40.0, emission_deg=35.0):
    """Camera and Sun on either side of the pillar, across its corners: what it hides and shades overlap in its base."""
    to_sun, to_camera = (np.array([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)])
                         for angle, azimuth in np.radians([(sun_deg, 20.0), (emission_deg, 205.0)]))
    r_camera_m = RANGE_M * to_camera
    return State(r_sun_inertial_m=AU_M * to_sun,
                 spacecraft=Pose(r_inertial_m=r_camera_m, q_from_inertial=frames.look_at(r_camera_m, np.zeros(3))),
                 bodies={"body": Pose(r_inertial_m=np.zeros(3), q_from_inertial=(1.0, 0.0, 0.0, 0.0))})


STATE = state()


def square(half_m, height_m):
    corners = half_m * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return np.column_stack([corners, np.full(4, height_m)])


def hull(points_m):
    return points_m[ConvexHull(points_m[:, :2]).vertices]


def covered(places):
    """The share (rows, columns) of each pixel that a polygon (N, 2) [px] covers, without a sign: by its sides alone."""
    image = np.zeros((CAMERA.height_px, CAMERA.width_px + 1))
    for (x0, y0), (x1, y1) in zip(places, np.roll(places, -1, axis=0), strict=True):
        # The side's parts in each row, and in each column of it.
        cuts = [0.0, 1.0]
        for begin, end in ((x0, x1), (y0, y1)):
            borders = np.arange(np.ceil(min(begin, end) - 0.5), np.floor(max(begin, end) + 0.5)) + 0.5
            cuts += ((borders - begin) / (end - begin)).tolist() if begin != end else []
        for one, other in zip(sorted(cuts), sorted(cuts)[1:], strict=False):
            x, y = (begin + 0.5 * (one + other) * (end - begin) for begin, end in ((x0, x1), (y0, y1)))
            row, column, height = int(np.floor(y + 0.5)), int(np.floor(x + 0.5)), (other - one) * (y1 - y0)
            image[row, column] += height * (column + 0.5 - x)
            image[row, column + 1] += height * (x - column + 0.5)
    return np.abs(np.cumsum(image, axis=1)[:, :-1])


def truth(state, camera):
    """Irradiance (rows, columns) float64 [W/m2] by polygons: the slab's top, less shadow and what the pillar hides."""
    state = from_its_camera(state, camera)
    to_sun = state.r_sun_inertial_m / np.linalg.norm(state.r_sun_inertial_m)
    r_camera_m, camera_axes = state.spacecraft.r_inertial_m, frames.dcm(state.spacecraft.q_from_inertial)
    base, top = square(0.5 * SIDE_M, 0.0), square(0.5 * SIDE_M, HEIGHT_M)
    shadow = hull(np.concatenate([base, top - HEIGHT_M * to_sun / to_sun[2]]))
    behind = r_camera_m + (top - r_camera_m) * (r_camera_m[2] / (r_camera_m[2] - HEIGHT_M))
    areas = [(1.0, square(HALF_M, 0.0)), (-1.0, shadow), (-1.0, hull(np.concatenate([base, behind]))), (1.0, base),
             (1.0, top)]
    image = sum(sign * covered(camera.project((polygon - r_camera_m) @ camera_axes.T)) for sign, polygon in areas)
    x, y = np.meshgrid(*2 * [(np.arange(80) - 39.5) / camera.focal_length_px])
    solid_angle = camera.focal_length_px**-2 * (1.0 + x**2 + y**2) ** -1.5
    return image * solid_angle * views.SOLAR_IRRADIANCE_W_M2 * ALBEDO / np.pi * to_sun[2]


def slab():
    """Of one shell: rings of four corners, from the slab's bottom up to the pillar's top."""
    rings = [square(HALF_M, -20.0), square(HALF_M, 0.0), square(0.5 * SIDE_M, 0.0), square(0.5 * SIDE_M, HEIGHT_M)]
    facets = [[0, 2, 1], [0, 3, 2], [12, 13, 14], [12, 14, 15]]
    for low in (0, 4, 8):
        for here, there in ((0, 1), (1, 2), (2, 3), (3, 0)):
            facets += [[low + here, low + there, low + 4 + there], [low + here, low + 4 + there, low + 4 + here]]
    return Shape.from_arrays(np.concatenate(rings), np.array(facets))


BODY = Body(name="body", shape=slab(), brdf=Lambert(normal_albedo=ALBEDO))


@cache
def drawn(sun_disc=False, distance_au=1.0):
    seen = replace(STATE, r_sun_inertial_m=distance_au * STATE.r_sun_inertial_m)
    with Renderer(views.scene([BODY], [CAMERA], sun_disc=sun_disc)) as renderer:
        return renderer.render(seen, derivatives=COUNTS, max_error=0.003)


def whole(image, name):
    (x0, y0, x1, y1), values = image.jacobian.roi, image.jacobian[name]
    found = np.zeros((len(values), *image.irradiance_W_m2.shape))
    found[:, y0:y1, x0:x1] = values
    return found


def moments(image):
    """Sums (6,) of an image, of it times the places, and times their squares: what places edges, to a pixel."""
    x, y = np.meshgrid(*2 * [(np.arange(80) - 39.5) / 25.0])
    return np.array([(image * weight).sum() for weight in (1.0, x, y, x * x, x * y, y * y)])


def differences(name, k):
    step = STEPS[name][min(k, len(STEPS[name]) - 1)]
    plus, minus = (truth(*moved(STATE, CAMERA, name, k, side * step)) for side in (1.0, -1.0))
    return (plus - minus) / (2.0 * step)


def test_the_image_is_that_of_the_polygons():
    assert views.relative_rms(drawn().irradiance_W_m2.astype(float), truth(STATE, CAMERA)) < 0.003


@pytest.mark.parametrize("name, k", [(name, k) for name, count in COUNTS.items() for k in range(count)])
def test_cuts_move_as_the_polygons_do(name, k):
    """Edges that shade and hide, to where few bisections put them; those that slide over few facets are coarser."""
    expected, found = differences(name, k), whole(drawn(), name)[k]
    scale = np.abs(moments(np.abs(expected))).max()
    slides = name == "sun" or (name, k // 3) == ("bodies.body", 1)
    np.testing.assert_allclose(moments(found) / scale, moments(expected) / scale, atol=0.03 if slides else 1e-3)
    assert np.linalg.norm(found - expected) < (0.25 if slides else 0.015) * np.linalg.norm(expected)


@pytest.mark.parametrize("name, k", [("spacecraft", 0), ("bodies.body", 3), ("bodies.body", 4), ("sun", 0), ("sun", 1)])
def test_the_discs_derivatives_are_the_mean_of_its_points(name, k):
    """A tenth of an astronomical unit from the Sun penumbras are 8 px wide, and their middles move as hard edges do."""
    image, expected = drawn(sun_disc=True, distance_au=0.1), 100.0 * differences(name, k)
    scale = np.abs(moments(np.abs(expected))).max()
    np.testing.assert_allclose(moments(whole(image, name)[k]) / scale, moments(expected) / scale, atol=0.05)
    hard = np.linalg.norm(whole(drawn(), "sun")) * 100.0
    assert np.linalg.norm(whole(image, "sun")) < 0.8 * hard


def test_the_plan_keeps_coverage_and_predicts_the_error_of_derivatives():
    """Where it would draw by rays otherwise: a rough binary at a tight tolerance."""
    body = Body(name="body", shape=views.binary(3, 5), brdf=Lambert(normal_albedo=0.3))
    with Renderer(views.scene([body], [views.camera(128, 1000.0)], sun_disc=False, max_error=0.001)) as renderer:
        image = renderer.render(views.state(phase_deg=90.0, range_m=2000.0), derivatives=["spacecraft", "sun"])
    assert {window.engine for window in image.plan.windows} == {"coverage"}
    assert "derivatives were asked for" in str(image.plan) and "predicted error of derivatives" in str(image.plan)
    assert 0.002 < image.plan.jacobian_error["spacecraft"] < 0.1 < image.plan.jacobian_error["sun"]
    with Renderer(views.scene([body], [views.camera(64, 500.0)], sun_disc=False)) as renderer:
        late = renderer.render(views.state(phase_deg=175.0, range_m=2000.0), derivatives=["spacecraft"])
    assert late.plan.jacobian_error["spacecraft"] > 0.5
    assert image.plan.to_dict()["jacobian_error"] == image.plan.jacobian_error
