"""Images behind lenses that distort. Truth: closed forms along rays that OpenCV gives, 10 x 10 a pixel and more."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
import views
from chain import DETECTOR, opencv
from glrender import Body, Pose, Renderer, Shape, State, draw_still, frames, generate, open_renderer, take_frame
from glrender.base.constants import AU_M
from glrender.brdf import Lambert
from glrender.planner.request import ImageUse
from glrender_camera import BrownConrady, CameraModel, ConfigError, Optics, PinholeCamera, lens_of
from scipy.interpolate import RectBivariateSpline

ALBEDO = 0.4
SUN = np.array([0.5, -0.3, -1.0]) / np.linalg.norm([0.5, -0.3, -1.0])
# Coefficients in OpenCV's order, focal length [px], place off the axis [1], radius of a sphere [px].
LENSES = {"barrel": ([-0.28, 0.07, 0.0, 0.0], 170.0, (0.35, 0.2), 20.0),
          "barrel's corner": ([-0.28, 0.07, 0.0, 0.0], 170.0, (0.72, 0.52), 12.0),
          "weak": ([-0.05, 0.0, 0.0, 0.0], 400.0, (0.12, -0.1), 25.0),
          "rational": ([0.9, 0.25, 8e-4, -6e-4, 0.01, 1.25, 0.6, 0.05], 110.0, (-0.4, 0.3), 20.0),
          "pincushion": ([0.25, 0.0, 1e-3, 2e-3], 200.0, (0.45, -0.3), 20.0)}


def camera_of(name, **fields):
    coefficients, focal_length_px, *_ = LENSES[name]
    return PinholeCamera(**{"name": "c", "width_px": 260, "height_px": 200, "focal_length_px": focal_length_px,
                            "distortion": BrownConrady.from_opencv(coefficients), **fields})


def true_image(name, box, radiance_of, n=14):
    """Irradiance (height, width) [W/m2] of radiance along rays (N, 3) through n x n places in the pixels of a box."""
    (x0, y0, x1, y1), image = box, np.zeros((200, 260))
    node_x, node_y = np.arange(x0 - 2.0, x1 + 3.0, 2.0), np.arange(y0 - 2.0, y1 + 3.0, 2.0)
    target = np.stack(np.meshgrid(node_x, node_y), axis=-1).reshape(-1, 2)
    image_of = lambda xy: opencv(camera_of(name), np.column_stack([xy, np.ones(len(xy))]))  # noqa: E731
    xy, step = (target - (129.5, 99.5)) / LENSES[name][1] * 0.8, 1e-5
    for _ in range(20):
        slope = np.stack([(image_of(xy + aside) - image_of(xy - aside)) / (2 * step) for aside in step * np.eye(2)], -1)
        xy -= np.linalg.solve(slope, (image_of(xy) - target)[..., None])[..., 0]
    np.testing.assert_allclose(image_of(xy), target, atol=1e-6)
    within = (np.arange(n) + 0.5) / n - 0.5
    x, y = ((np.arange(low, high)[:, None] + within).ravel() for low, high in ((x0, x1), (y0, y1)))
    smooth = [RectBivariateSpline(node_y, node_x, xy[:, k].reshape(len(node_y), -1), kx=5, ky=5) for k in range(2)]
    (a, b), (c, d) = ([each(y, x, dy=1), each(y, x, dx=1)] for each in smooth)
    ray = np.stack([*(each(y, x) for each in smooth), np.ones((len(y), len(x)))], axis=-1)
    length = np.linalg.norm(ray, axis=-1)
    light = radiance_of((ray / length[..., None]).reshape(-1, 3)).reshape(a.shape) * np.abs(a * d - b * c) / length**3
    image[y0:y1, x0:x1] = light.reshape(y1 - y0, n, x1 - x0, n).mean(axis=(1, 3))
    return image


def sphere(name, radius_m=100.0, **fields):
    """A scene, its state, the pixels around the sphere, and the radiance along rays (N, 3)."""
    _, f, place, radius_px = LENSES[name]
    camera = camera_of(name, **fields)
    centre = np.array([*place, 1.0]) * f * radius_m / radius_px
    state = State(r_sun_inertial_m=centre + AU_M * SUN, spacecraft=Pose(r_inertial_m=np.zeros(3)),
                  bodies={"body": Pose(r_inertial_m=centre)})

    def radiance(ray):
        along = ray @ centre
        root = radius_m**2 - centre @ centre + along**2
        normal = (ray * (along - np.sqrt(np.maximum(root, 0.0)))[:, None] - centre) / radius_m
        return ALBEDO / np.pi * views.SOLAR_IRRADIANCE_W_M2 * np.maximum(normal @ SUN, 0.0) * (root > 0.0)

    around = opencv(camera, centre + radius_m * np.array(list(product((-1.0, 1.0), repeat=3))))
    (x0, y0), (x1, y1) = np.floor(around.min(axis=0)).astype(int), np.ceil(around.max(axis=0)).astype(int)
    box = max(x0, 0), max(y0, 0), min(x1 + 1, 260), min(y1 + 1, 200)
    # A convex body of the sphere's surface is as large as the sphere in the mean over all directions (Cauchy).
    facets = generate.icosphere(radius_m=radius_m, subdivisions=5)
    fit = np.sqrt(4.0 * np.pi * radius_m**2 / facets.facet_areas_m2.sum())
    shape = Shape.from_arrays(fit * facets.vertices_m, facets.facets)
    body = Body(name="body", shape=shape, brdf=Lambert(normal_albedo=ALBEDO))
    return views.scene([body], [camera], sun_disc=False), state, box, radiance


@pytest.mark.parametrize("name", LENSES)
def test_a_sphere_has_the_error_that_is_asked_for(name):
    """RMS and flux within what is predicted, RMS within 0.02 and 0.005 that are asked for; the centre 0.005 px."""
    scene, state, box, radiance = sphere(name)
    truth = true_image(name, box, radiance)
    with Renderer(scene) as renderer:
        for engine, asked in ((None, 0.02), (None, 0.005), ("coverage", 0.01), ("rays", 0.01), ("raster", 0.02)):
            still = draw_still(renderer, state, max_error=asked, engine=engine)
            image, told = still.irradiance_W_m2.astype(float), still.plan.predicted
            assert views.relative_rms(image, truth) < max(min(asked, 1.2 * told["rms"]), 0.003), (engine, asked)
            assert abs(image.sum() / truth.sum() - 1.0) < max(told["flux"], 2e-4), (engine, asked)
            off_px = np.linalg.norm(views.centroid_px(image) - views.centroid_px(truth))
            assert off_px < (0.005 if asked == 0.005 else 0.03), (engine, asked)


class Moved(Renderer):
    """A backend that draws no lens, as one that a plug-in brings."""

    draws_lenses = False


@pytest.mark.parametrize("name", ["barrel", "weak"])
def test_light_that_is_moved_in_cells_has_the_error_that_is_predicted(name):
    """RMS 0.01 to 0.03 whatever is asked: predicted within 1 and 4 times, with a warning where that is missed."""
    scene, state, box, radiance = sphere(name)
    truth = true_image(name, box, radiance)
    with Moved(scene) as renderer:
        with pytest.raises(ConfigError, match="distorts.*take_frame"):
            renderer.render(state)
        still = draw_still(renderer, state, max_error=0.005)
        error = views.relative_rms(still.irradiance_W_m2, truth)
        assert 1.0 < still.plan.predicted["rms"] / error < 4.0
        assert any("a lens moves the light" in text for text in still.plan.warnings) and "rms" in still.plan.missed
        assert not draw_still(renderer, state, max_error=0.1).plan.warnings


def test_the_warning_of_a_distorting_camera_has_pixels_of_its_frame():
    """The limb's errors, predicted and promised at best, are those of the image of cells: 3 along a pixel's side."""
    camera = views.camera(64, 40.0, distortion=BrownConrady(k1=2.0))
    with Moved(views.scene([views.sphere(Lambert(normal_albedo=ALBEDO), 4)], [camera])) as renderer:
        frame = draw_still(renderer, views.state(range_m=400.0), max_error={"limb_px": 1e-6}).plan
        cells = renderer.render(views.state(range_m=400.0), lens_of(camera).source, max_error={"limb_px": 3e-6},
                                use=ImageUse(error_gain=1.0 / 3.0)).plan
    said, said_of_cells = frame.warnings[0], cells.warnings[0]
    assert lens_of(camera).oversampling == 3 and cells.missed == ("limb_px",) and "limb_px" in frame.missed
    assert said.startswith(f"predicted limb_px {cells.predicted['limb_px'] / 3.0:.2g} exceeds max_error 1e-06; ")
    least, of_cells = (float(text.split("view is ")[1]) for text in (said, said_of_cells))
    assert least == pytest.approx(of_cells / 3.0, rel=0.05)


@pytest.mark.parametrize("name", ["barrel", "rational"])
def test_sides_of_large_facets_are_bent(name):
    """A cube of twelve facets, 80 px wide: RMS 0.005. With straight sides it would be 0.02 or more."""
    camera = camera_of(name)
    half_m, centre = 28.0 / camera.focal_length_px, np.array([0.4, 0.2, 1.0])
    turn = frames.dcm(np.array([0.8, 0.4, 0.2, 0.4]))
    corners = half_m * np.array(list(product((-1.0, 1.0), repeat=3)))
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    shape = Shape.from_arrays(corners, [corner for a, b, c, d in sides for corner in ((a, b, c), (a, c, d))])
    state = State(r_sun_inertial_m=centre + AU_M * SUN, spacecraft=Pose(r_inertial_m=np.zeros(3)),
                  bodies={"body": Pose(r_inertial_m=centre, q_from_inertial=frames.quaternion(turn))})

    def radiance(ray):
        way, begin = ray @ turn.T, -turn @ centre
        near, far = (-np.sign(way) * side - begin for side in (half_m, -half_m))
        near, far = near / way, far / way
        axis, every = near.argmax(axis=1), np.arange(len(ray))
        cosine = -np.sign(way[every, axis]) * (turn @ SUN)[axis] * (near.max(axis=1) < far.min(axis=1))
        return ALBEDO / np.pi * views.SOLAR_IRRADIANCE_W_M2 * np.maximum(cosine, 0.0)

    body = Body(name="body", shape=shape, brdf=Lambert(normal_albedo=ALBEDO))
    with Renderer(views.scene([body], [camera], sun_disc=False)) as renderer:
        image = draw_still(renderer, state, max_error=0.02, engine="coverage").irradiance_W_m2
    rows, columns = np.nonzero(image)
    truth = true_image(name, (columns.min() - 1, rows.min() - 1, columns.max() + 2, rows.max() + 2), radiance, 10)
    assert len(rows) > 1500 and views.relative_rms(image, truth) < 0.005


def test_a_region_of_interest_is_that_part_of_the_image_and_nothing_else():
    scene, state, (x0, y0, x1, y1), _ = sphere("barrel")
    roi = (x0 + 8, y0 + 5, x1 - 4, y1 - 10)
    inside = np.s_[roi[1]:roi[3], roi[0]:roi[2]]
    with Renderer(scene) as renderer:
        whole, part = (draw_still(renderer, state, products=["range", "facet_id"], engine="coverage", max_error=0.005,
                                  roi=box) for box in (None, roi))
    assert part.stages["region"].startswith("drawn alone")
    np.testing.assert_allclose(part.irradiance_W_m2[inside], whole.irradiance_W_m2[inside],
                               atol=2e-3 * whole.irradiance_W_m2.max())
    assert np.count_nonzero(part.irradiance_W_m2) == np.count_nonzero(part.irradiance_W_m2[inside]) > 300
    np.testing.assert_array_equal(part.products["facet_id"][inside], whole.products["facet_id"][inside])


def test_a_body_of_a_fraction_of_a_pixel_has_its_flux_and_its_place():
    """A sphere of 0.5 px in the barrel's corner: its light and centre are those of rays through the lens."""
    name = "barrel's corner"
    scene, state, _, radiance = sphere(name, radius_m=4.0)
    centre = 12.0 / 4.0 * 100.0 / 12.0 * np.array(state.bodies["body"].r_inertial_m)
    state = State(r_sun_inertial_m=centre + AU_M * SUN, spacecraft=Pose(r_inertial_m=np.zeros(3)),
                  bodies={"body": Pose(r_inertial_m=centre)})
    with Renderer(scene) as renderer:
        still = draw_still(renderer, state, max_error=0.005)
    range_m, phase = np.linalg.norm(centre), np.arccos(-SUN @ centre / np.linalg.norm(centre))
    disc = (np.sin(phase) + (np.pi - phase) * np.cos(phase)) * 2.0 / (3.0 * np.pi)
    flux = ALBEDO * views.SOLAR_IRRADIANCE_W_M2 * disc * (4.0 / range_m) ** 2
    np.testing.assert_allclose(still.irradiance_W_m2.sum(dtype=float), flux, rtol=3e-3)
    limb_px = scene.cameras[0].project(centre)
    assert np.linalg.norm(views.centroid_px(still.irradiance_W_m2) - limb_px) < 0.2


def test_a_frame_through_a_lens_is_that_of_its_rays():
    """Electrons of the camera model: those of the irradiance, within 1e-3; no second image is drawn."""
    model = CameraModel(optics=Optics(aperture_diameter_m=0.01, psf_sigma_px=0.7), detector=DETECTOR, exposure_s=1e-3)
    scene, state, box, radiance = sphere("weak", model=model)
    with open_renderer(scene) as renderer:
        frame = take_frame(renderer, state, seed=1)
    truth = true_image("weak", box, radiance) * scene.cameras[0].cos_field_angle
    rate = model.optics.aperture_area_m2 * model.electrons_per_joule * model.exposure_s
    np.testing.assert_allclose(frame.frame.electrons.sum(dtype=float), truth.sum() * rate, rtol=1e-3)
    assert frame.stages["distortion"] == "k1 -0.05; drawn behind the lens"


def test_a_body_around_a_camera_whose_corners_image_nothing_is_drawn():
    """The corners' outer edges have no direction, and the body reaches behind the camera: closed form within 1e-2."""
    camera = PinholeCamera(name="c", width_px=90, height_px=90, focal_length_px=90.0, distortion=BrownConrady(k1=-0.3))
    assert np.isnan(camera.directions(np.array([[-0.5, -0.5]]))).all()
    assert camera.least_cosine == pytest.approx(1.0 / np.hypot(1.0, np.sqrt(1.0 / 0.9)))
    centre = 120.0 * np.array([0.6, 0.6, 0.5]) / np.linalg.norm([0.6, 0.6, 0.5])
    shape = generate.icosphere(radius_m=100.0, subdivisions=5)
    body = Body(name="body", shape=shape, brdf=Lambert(normal_albedo=ALBEDO))
    state = State(r_sun_inertial_m=centre - AU_M * centre / 120.0, spacecraft=Pose(r_inertial_m=np.zeros(3)),
                  bodies={"body": Pose(r_inertial_m=centre)})
    ray = camera.directions(np.stack(np.meshgrid(np.arange(50.0, 85.0), np.arange(50.0, 85.0)), axis=-1))
    along = ray @ centre
    normal = (ray * (along - np.sqrt(along**2 - 120.0**2 + 100.0**2))[..., None] - centre) / 100.0
    truth = ALBEDO / np.pi * views.SOLAR_IRRADIANCE_W_M2 * (normal @ -centre / 120.0) * (
        camera.solid_angle_sr()[50:85, 50:85])
    with Renderer(views.scene([body], [camera], sun_disc=False)) as renderer:
        for engine in ("rays", "raster"):
            still = draw_still(renderer, state, max_error=0.02, engine=engine)
            assert 0.0 < still.plan.predicted["rms"] < 0.02
            assert views.relative_rms(still.irradiance_W_m2[50:85, 50:85], truth) < 0.01
