"""Derivatives of frames of convex bodies, against sums over facets that are cut by each pixel, and a closed form."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import views
from facet_images import facet_image
from glrender import Body, Pose, Renderer, Shape, State, generate
from glrender.base.constants import AU_M
from glrender.brdf import Hapke, Lambert
from moved_states import from_its_camera, moved
from scipy.spatial.transform import Rotation

COUNTS = {"spacecraft": 6, "bodies.body": 6, "sun": 2, "focal_length": 1}
LAW = Hapke(single_scattering_albedo=0.3, b=0.3, c=0.4, roughness_deg=20.0)
# Steps [m, rad, px] that move the outline by a pixel, about.
_PX = {"spacecraft": (10.0, 10.0, 2000.0, 5e-4, 5e-4, 0.1), "bodies.body": (10.0, 10.0, 2000.0, 0.1), "sun": (0.1,),
       "focal_length": (200.0,)}
# On a mount that is turned about all axes and 3 m off the spacecraft's origin.
CAMERA = views.camera(24, 2000.0, q_camera_from_spacecraft=Rotation.from_euler("xyz", [0.002, -0.003, 0.7]).as_quat(
    scalar_first=True), r_camera_spacecraft_m=[3.0, -2.0, 1.0])
BODY = Body(name="body", brdf=LAW, shape=Shape.from_arrays(
    generate.icosphere(radius_m=100.0, subdivisions=1).vertices_m * [1.0, 0.8, 0.6],
    generate.icosphere(radius_m=100.0, subdivisions=1).facets))
STATE = replace(views.state(phase_deg=50.0, range_m=20_000.0), bodies={"body": Pose(
    r_inertial_m=[10.0, -5.0, 7.0], q_from_inertial=Rotation.from_euler("xyz", [0.3, 1.1, -0.4]).as_quat(
        scalar_first=True))})


def truth(state, camera, law=LAW):
    return facet_image(BODY.shape, from_its_camera(state, camera), camera, law)


@cache
def drawn(*names):
    with Renderer(views.scene([BODY], [CAMERA], sun_disc=False)) as renderer:
        return renderer.render(STATE, derivatives=names)


def whole(image, name):
    """The derivatives of all pixels."""
    (x0, y0, x1, y1), values = image.jacobian.roi, image.jacobian[name]
    found = np.zeros((len(values), *image.irradiance_W_m2.shape))
    found[:, y0:y1, x0:x1] = values
    return found


@pytest.mark.parametrize("name, k", [(name, k) for name, count in COUNTS.items() for k in range(count)])
def test_derivatives_are_those_of_sums_over_facets(name, k):
    """By central differences of a millipixel; kinks at the borders of pixels are left in."""
    image = drawn(*COUNTS)
    step = 1e-3 * _PX[name][min(k, len(_PX[name]) - 1)]
    plus, minus = (truth(*moved(STATE, CAMERA, name, k, side * step)) for side in (1.0, -1.0))
    expected = (plus - minus) / (2.0 * step)
    assert image.jacobian[name].dtype == np.float32 and image.jacobian[name].shape[0] == COUNTS[name]
    error = np.linalg.norm(whole(image, name)[k] - expected) / np.linalg.norm(expected)
    assert error < 3e-4
    # The plan counts facets of one radiance each as an error, as of the image.
    assert image.plan.predicted_error < image.plan.jacobian_error[name] < 2.0 * image.plan.predicted_error


@pytest.mark.parametrize("name", ["single_scattering_albedo", "b", "c", "roughness_deg", "filling_factor"])
def test_derivatives_by_numbers_of_a_law(name):
    """The last is at the end of its range: a difference to one side, of a law that bends."""
    number, step = getattr(LAW, name), 1e-4
    laws = [replace(LAW, **{name: number + side * step}) for side in (1.0, -1.0) if number + side * step >= 0.0]
    image = drawn(*(f"law.{each}" for each in ("single_scattering_albedo", "b", "c", "roughness_deg",
                                               "filling_factor")))
    if len(laws) == 1:
        # The porosity's root of its volume has no derivative at 0: the step from there is what counts.
        assert np.isfinite(image.jacobian[f"law.{name}"]).all()
        return
    expected = (truth(STATE, CAMERA, laws[0]) - truth(STATE, CAMERA, laws[1])) / (2.0 * step)
    assert np.linalg.norm(whole(image, f"law.{name}")[0] - expected) < 1e-4 * np.linalg.norm(expected)


def test_bodies_move_against_the_spacecraft():
    image = drawn(*COUNTS)
    np.testing.assert_allclose(image.jacobian["bodies.body"][:3], -image.jacobian["spacecraft"][:3], rtol=1e-4,
                               atol=1e-6 * np.abs(image.jacobian["spacecraft"][:3]).max())


def plate(half_px=4.0, place_px=(0.5, 0.25)):
    """A square plate of Lambert's law that faces camera and Sun: the frame with derivatives, and its radiance."""
    albedo, range_m, focal_length_px = 0.4, 100.0, 500.0
    camera, half_m = views.camera(16, focal_length_px), half_px * range_m / focal_length_px
    corners = half_m * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    shape = Shape.from_arrays(corners, np.array([[0, 2, 1], [0, 3, 2]]))
    x, y = np.array(place_px) * range_m / focal_length_px
    state = State(r_sun_inertial_m=[0.0, 0.0, -AU_M], spacecraft=Pose(r_inertial_m=[-x, -y, -range_m]),
                  bodies={"body": Pose(r_inertial_m=np.zeros(3))})
    body = Body(name="body", shape=shape, brdf=Lambert(normal_albedo=albedo))
    with Renderer(views.scene([body], [camera], sun_disc=False)) as renderer:
        image = renderer.render(state, derivatives=["spacecraft"])
    x, y = np.meshgrid(*2 * [np.arange(16) - 7.5])
    solid_angle = focal_length_px**-2 * (1.0 + (x**2 + y**2) / focal_length_px**2) ** -1.5
    return image, views.SOLAR_IRRADIANCE_W_M2 * albedo / np.pi * solid_angle, focal_length_px / range_m


def covered(low, high, place):
    """Lengths of pixels (16,) between two edges [px] about the middle of 16."""
    edges = np.arange(17) - 8.0
    return np.diff(np.clip(edges, low + place, high + place))


def test_a_plates_edges_sweep_the_pixels_that_they_cross():
    """Its image is a square that shifts, grows and turns: the closed form of each pixel."""
    image, radiance, px_per_m = plate(place_px=(0.3, 0.2))
    found, down = whole(image, "spacecraft"), covered(-4.0, 4.0, 0.2)
    expected = np.zeros((16, 16))
    # Its left edge is in column 4, at -3.7 px from the middle, its right one in column 12: the plate moves left.
    expected[:, 4], expected[:, 12] = down, -down
    np.testing.assert_allclose(found[0], radiance * expected * px_per_m, atol=1e-6 * np.abs(found[0]).max())
    grows = np.zeros((16, 16))
    grows[:, 4] += 3.7 * down
    grows[:, 12] += 4.3 * down
    across = covered(-4.0, 4.0, 0.3)
    grows[4] += 3.8 * across
    grows[12] += 4.2 * across
    np.testing.assert_allclose(found[2], radiance * grows / 100.0, atol=1e-6 * np.abs(found[2]).max())


def test_an_edge_on_the_border_of_pixels_changes_both_by_half():
    """As central differences have it."""
    image, radiance, px_per_m = plate(place_px=(0.0, 0.2))
    found, down = whole(image, "spacecraft")[0], covered(-4.0, 4.0, 0.2)
    expected = np.zeros((16, 16))
    expected[:, 3], expected[:, 4] = 0.5 * down, 0.5 * down
    expected[:, 11], expected[:, 12] = -0.5 * down, -0.5 * down
    np.testing.assert_allclose(found, radiance * expected * px_per_m, atol=1e-5 * np.abs(found).max())


def test_a_part_of_a_body_in_the_image_has_the_whole_ones_derivatives():
    """Lines that begin or end beyond the image, on each side."""
    camera = replace(CAMERA, width_px=64, height_px=64, principal_point_px=(31.5, 31.5))

    def both(image):
        return np.concatenate([whole(image, "spacecraft"), whole(image, "sun")])

    with Renderer(views.scene([BODY], [camera], sun_disc=False)) as renderer:
        every = both(renderer.render(STATE, camera, derivatives=["spacecraft", "sun"]))
        for left, top in ((20, 20), (36, 20), (20, 36), (36, 36), (30, 30)):
            x, y = camera.principal_point_px
            part = replace(camera, width_px=12, height_px=11, principal_point_px=(x - left, y - top))
            found = both(renderer.render(STATE, part, derivatives=["spacecraft", "sun"]))
            expected = every[:, top:top + 11, left:left + 12]
            largest = np.abs(every).max(axis=(1, 2))[:, None, None]
            np.testing.assert_allclose(found / largest, expected / largest, atol=1e-5)


def test_a_frame_is_the_same_with_derivatives_and_they_the_same_again():
    with Renderer(views.scene([BODY], [CAMERA], sun_disc=False)) as renderer:
        alone, again = renderer.render(STATE), renderer.render(STATE, derivatives=COUNTS)
    for name in COUNTS:
        np.testing.assert_array_equal(again.jacobian[name], drawn(*COUNTS).jacobian[name])
    assert alone.jacobian is None and "jacobian_error" not in alone.plan.to_dict()
    np.testing.assert_array_equal(alone.irradiance_W_m2, drawn(*COUNTS).irradiance_W_m2)


def test_nothing_lit_has_no_derivatives():
    with Renderer(views.scene([BODY], [CAMERA], sun_disc=False)) as renderer:
        dark = renderer.render(replace(STATE, r_sun_inertial_m=-AU_M * STATE.spacecraft.r_inertial_m / 20_000.0),
                               derivatives=["spacecraft", "bodies.body", "sun", "law.b"])
        assert {name: values.shape[0] for name, values in dark.jacobian.items()} == {
            "spacecraft": 6, "bodies.body": 6, "sun": 2, "law.b": 1}
        assert not any(values.any() for values in dark.jacobian.values())
        behind = replace(STATE, spacecraft=replace(STATE.spacecraft, q_from_inertial=Pose(
            r_inertial_m=np.zeros(3), q_from_inertial=np.roll(STATE.spacecraft.q_from_inertial, 2)).q_from_inertial))
        away = renderer.render(behind, derivatives=["spacecraft"])
    assert away.jacobian["spacecraft"].shape == (6, 0, 0) and away.jacobian.roi == (0, 0, 0, 0)
