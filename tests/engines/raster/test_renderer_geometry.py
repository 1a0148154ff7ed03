"""Where things land: centres, orientation, handedness, depth, regions. Truth: closed forms and rays."""

from __future__ import annotations

import numpy as np
import pytest
import raytracer
import views
from glrender import Body, Pose, Renderer, State, frames, generate
from glrender.base.constants import AU_M
from glrender.brdf import Lambert

WHITE = Lambert(normal_albedo=1.0)


@pytest.fixture(scope="module")
def sphere_renderer():
    with Renderer(views.scene([views.sphere(WHITE)], [views.camera()])) as renderer:
        yield renderer


def test_a_sphere_on_the_boresight_is_centred_on_the_principal_point(sphere_renderer):
    """Full phase: the centroid is the image's centre, ((w - 1)/2, (h - 1)/2), within 0.005 px."""
    image = sphere_renderer.render(views.state(phase_deg=0.0), samples=4)
    np.testing.assert_allclose(views.centroid_px(image.irradiance_W_m2), [127.5, 127.5], atol=0.005)


def test_the_principal_point_moves_the_sphere():
    camera = views.camera(principal_point_px=(100.25, 140.75))
    with Renderer(views.scene([views.sphere(WHITE)], [camera])) as renderer:
        image = renderer.render(views.state(phase_deg=0.0), samples=4)
    np.testing.assert_allclose(views.centroid_px(image.irradiance_W_m2), [100.25, 140.75], atol=0.02)


def test_the_mounting_is_applied():
    """A camera half a metre off and turned by 0.02 rad about the spacecraft's x: centroid by float64 geometry."""
    turn = np.array([np.cos(0.01), np.sin(0.01), 0.0, 0.0])
    camera = views.camera(q_camera_from_spacecraft=turn, r_camera_spacecraft_m=(20.0, -10.0, 5.0))
    state = views.state(phase_deg=0.0)
    spacecraft_from_inertial = frames.dcm(state.spacecraft.q_from_inertial)
    r_camera = state.spacecraft.r_inertial_m + spacecraft_from_inertial.T @ camera.r_camera_spacecraft_m
    state = State(r_sun_inertial_m=1e8 * r_camera, spacecraft=state.spacecraft, bodies=state.bodies)
    with Renderer(views.scene([views.sphere(WHITE)], [camera])) as renderer:
        image = renderer.render(state, samples=4)
    centre = frames.dcm(turn) @ (spacecraft_from_inertial @ -state.spacecraft.r_inertial_m
                                 - camera.r_camera_spacecraft_m)
    np.testing.assert_allclose(views.centroid_px(image.irradiance_W_m2), camera.project(centre), atol=0.02)


@pytest.mark.parametrize("sun_in_image", [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0), (0.6, -0.8)])
@pytest.mark.parametrize("phase_deg", [30.0, 60.0, 90.0, 120.0])
def test_centre_of_brightness_is_displaced_towards_the_sun(sphere_renderer, sun_in_image, phase_deg):
    """Lambert closed form (photometry.md section 3), 0.4 % of the radius: mesh bias and perspective.

    Four directions of the Sun decide all eight orientations (PRo3D issue 801).
    """
    distant = views.state(phase_deg=phase_deg, range_m=2000.0, sun_in_image=sun_in_image)
    image = sphere_renderer.render(distant, samples=4)
    radius_px = 1000.0 * 100.0 / 2000.0
    offset = (views.centroid_px(image.irradiance_W_m2) - 127.5) / radius_px
    g = np.radians(phase_deg)
    expected = (3 * np.pi / 16) * np.sin(g) * (1 + np.cos(g)) / (np.sin(g) + (np.pi - g) * np.cos(g))
    # At a range of 20 radii the camera sees 1/20 rad less of the sphere: 1 % of the offset.
    np.testing.assert_allclose(offset, expected * np.array(sun_in_image) / np.hypot(*sun_in_image), atol=0.012)


def test_an_asymmetric_body_is_not_mirrored():
    """Three unequal lobes against float64 rays: no mirror image or turn correlates as well."""
    shape = generate.three_lobes(radius_m=100.0)
    body = Body(name="body", shape=shape, brdf=WHITE)
    camera, state = views.camera(96, 400.0), views.state(phase_deg=40.0, sun_in_image=(0.5, 1.0))
    with Renderer(views.scene([body], [camera])) as renderer:
        image = renderer.render(state, samples=2).irradiance_W_m2
    truth, *_ = raytracer.trace([("body", shape.vertices_m, shape.facets, WHITE)], camera, state,
                                views.SOLAR_IRRADIANCE_W_M2, 2)
    correlation = lambda a, b: float(np.corrcoef(a.ravel(), b.ravel())[0, 1])  # noqa: E731
    assert correlation(image, truth) > 0.995
    for turns in range(4):
        for flip in (False, True):
            if turns or flip:
                other = np.rot90(image[::-1] if flip else image, turns)
                assert correlation(other, truth) < 0.95, f"turned {turns} times, flipped {flip}"


@pytest.mark.parametrize("phase_deg", [20.0, 75.0])
def test_body_attitude_turns_the_body_not_the_sky(phase_deg):
    """q_from_inertial takes inertial components to body components: against rays of an attitude of 3-1-3."""
    shape = generate.three_lobes(radius_m=100.0)
    q = np.array([0.5, -0.1, 0.7, 0.3])
    q /= np.linalg.norm(q)
    camera, state = views.camera(96, 400.0), views.state(phase_deg=phase_deg, q_body=q)
    with Renderer(views.scene([Body(name="body", shape=shape, brdf=WHITE)], [camera])) as renderer:
        image = renderer.render(state, samples=4).irradiance_W_m2
    truth, *_ = raytracer.trace([("body", shape.vertices_m, shape.facets, WHITE)], camera, state,
                                views.SOLAR_IRRADIANCE_W_M2, 4)
    assert np.sqrt(np.mean((image - truth) ** 2)) < 0.03 * truth[truth > 0].mean()


def snapped_m(range_m, emission_rad, camera):
    """What a card that interpolates between vertices snapped to 1/256 px (NVIDIA's) may err along the ray."""
    return range_m / camera.focal_length_px / 256.0 * np.tan(emission_rad)


def test_products_agree_with_rays(rng):
    """Facet, range, angles and body coordinates at pixel centres of a small shape, float64 rays as truth."""
    shape = generate.three_lobes(radius_m=100.0)
    camera, state = views.camera(128, 600.0), views.state(phase_deg=60.0)
    with Renderer(views.scene([Body(name="body", shape=shape, brdf=WHITE)], [camera])) as renderer:
        products = renderer.render(state, products=["range", "body_id", "facet_id", "incidence", "emission", "phase",
                                                    "r_body", "sunlit"]).products
    _, facet, range_m = raytracer.trace([("body", shape.vertices_m, shape.facets, WHITE)], camera, state, 1.0, 1)
    seen = facet >= 0
    same = seen & (products["facet_id"] == facet)
    # 8 sub-pixel bits move edges by 1/256 px: a few pixels in a thousand see the neighbour facet.
    assert same.sum() > 0.985 * seen.sum()
    assert (products["body_id"][same] == 0).all()
    assert (products["body_id"][products["facet_id"] < 0] == -1).all()
    normal = np.cross(*(shape.vertices_m[shape.facets[facet[same], k]] - shape.vertices_m[shape.facets[facet[same], 0]]
                        for k in (1, 2)))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    y, x = np.nonzero(same)
    inertial_from_camera = frames.dcm(state.spacecraft.q_from_inertial).T
    ray = camera.directions(np.stack([x, y], axis=1)) @ inertial_from_camera.T
    sun = state.r_sun_inertial_m / np.linalg.norm(state.r_sun_inertial_m)
    between = lambda a, b: np.arccos(np.clip(np.sum(a * b, axis=-1), -1, 1))  # noqa: E731
    emission = between(normal, -ray)
    assert (np.abs(products["range"][same] - range_m[same]) < 1e-6 * range_m[same] + snapped_m(range_m[same], emission,
                                                                                           camera)).all()
    np.testing.assert_allclose(products["incidence"][same], between(normal, sun), atol=2e-4)
    np.testing.assert_allclose(products["emission"][same], emission, atol=2e-4)
    np.testing.assert_allclose(products["phase"][same], between(-ray, sun), atol=1e-5)
    place = state.spacecraft.r_inertial_m + ray * range_m[same][:, None]
    assert (np.linalg.norm(products["r_body"][same] - place, axis=1)
            < 0.02 + snapped_m(range_m[same], emission, camera)).all()
    assert np.isnan(products["range"][~seen & (products["facet_id"] < 0)]).all()
    assert set(np.unique(products["sunlit"])) <= {0.0, 1.0}


def test_the_nearer_body_hides_the_farther_and_both_have_their_place():
    """Two spheres in line, at ranges that share no depth range, and close together."""
    for gap_m in (250.0, 5e4):
        near, far = views.sphere(WHITE, 3, 30.0, "near"), views.sphere(Lambert(normal_albedo=0.5), 3, 100.0, "far")
        state = views.state(phase_deg=0.0, range_m=3000.0, bodies=("near", "far"))
        away = -state.spacecraft.r_inertial_m / 3000.0
        poses = {"near": state.bodies["near"], "far": Pose(r_inertial_m=gap_m * away)}
        state = State(r_sun_inertial_m=state.r_sun_inertial_m, spacecraft=state.spacecraft, bodies=poses)
        for order in ([near, far], [far, near]):
            with Renderer(views.scene(order, [views.camera(256, 2000.0)])) as renderer:
                products = renderer.render(state, products=["body_id", "range"]).products
            names = [body.name for body in order]
            assert products["body_id"][127, 127] == names.index("near")
            np.testing.assert_allclose(products["range"][127, 127], 3000.0 - 30.0, atol=0.5)
            if gap_m < 1e4:
                assert products["body_id"][127, 127 + 40] == names.index("far")


def test_a_body_casts_its_shadow_on_another():
    """A moon between the Sun and a planet: the planet's irradiance inside the disc of shadow is zero."""
    moon, planet = views.sphere(WHITE, 4, 20.0, "moon"), views.sphere(WHITE, 5, 100.0, "planet")
    base = views.state(phase_deg=30.0, range_m=2000.0, bodies=("moon", "planet"))
    sun = base.r_sun_inertial_m / np.linalg.norm(base.r_sun_inertial_m)
    poses = {"planet": base.bodies["planet"], "moon": Pose(r_inertial_m=400.0 * sun)}
    state = State(r_sun_inertial_m=base.r_sun_inertial_m, spacecraft=base.spacecraft, bodies=poses)
    camera = views.camera(256, 1500.0)
    with Renderer(views.scene([moon, planet], [camera])) as renderer:
        image = renderer.render(state, samples=4, products=["sunlit", "body_id"])
    bodies = [(b.name, b.shape.vertices_m, b.shape.facets, WHITE) for b in (moon, planet)]
    truth, *_ = raytracer.trace(bodies, camera, state, views.SOLAR_IRRADIANCE_W_M2, 4)
    np.testing.assert_allclose(image.irradiance_W_m2.sum(), truth.sum(), rtol=1e-3)
    assert np.sqrt(np.mean((image.irradiance_W_m2 - truth) ** 2)) < 0.03 * truth[truth > 0].mean()
    # The shadow is a disc of the moon's radius on the planet: pi 20^2 m2 seen at its foreshortening.
    shadowed = (image.products["sunlit"] == 0) & (image.products["body_id"] == 1)
    assert shadowed[~np.isnan(truth)].sum() > 500


@pytest.mark.parametrize("altitude_radii", [1e-3, 1e-2, 1.0, 1e3, 1e6, 1e9])
def test_depth_holds_from_a_thousandth_to_a_billion_radii(altitude_radii):
    """Facets seen at pixel centres against float64 rays; the field of view keeps the same facets in view."""
    shape = generate.three_lobes(radius_m=100.0)
    direction = np.array([0.3, -0.8, 0.4]) / np.linalg.norm([0.3, -0.8, 0.4])
    # The surface point below the camera, by the ray tracer itself.
    start = views.state(range_m=1e3)
    _, _, range_m = raytracer.trace([("body", shape.vertices_m, shape.facets, WHITE)], views.camera(3, 1e5), start,
                                    1.0, 1)
    ground_m = 1e3 - range_m[1, 1]
    camera_range = ground_m + 100.0 * altitude_radii
    altitude_m = camera_range - ground_m
    extent_m = min(250.0, 2.0 * altitude_m)
    camera = views.camera(100, 100.0 * altitude_m / extent_m)
    state = views.state(phase_deg=30.0, range_m=camera_range, direction=direction)
    with Renderer(views.scene([Body(name="body", shape=shape, brdf=WHITE)], [camera])) as renderer:
        image = renderer.render(state, products=["facet_id", "range", "emission"])
    if altitude_radii <= 1e3:
        _, facet, truth_range = raytracer.trace([("body", shape.vertices_m, shape.facets, WHITE)], camera, state, 1.0,
                                                1)
        seen = facet >= 0
        assert (image.products["facet_id"][seen] == facet[seen]).mean() > 0.97
        same = seen & (image.products["facet_id"] == facet)
        wrong = np.abs(image.products["range"][same] - truth_range[same])
        snapped = snapped_m(truth_range[same], image.products["emission"][same], camera)
        assert (wrong < 2e-5 * truth_range[same] + snapped).all()
    else:
        # Beyond float32 rays the picture must be the one from 1000 radii, pixel for pixel but for edges.
        near_range = ground_m + 1e5
        near = views.state(phase_deg=30.0, range_m=near_range, direction=direction)
        with Renderer(views.scene([Body(name="body", shape=shape, brdf=WHITE)],
                                  [views.camera(100, 100.0 * 1e5 / extent_m)])) as renderer:
            expected = renderer.render(near, products=["facet_id"]).products["facet_id"]
        assert (image.products["facet_id"] == expected).mean() > 0.99
    assert image.irradiance_W_m2.max() > 0.0


@pytest.mark.parametrize("engine", ["raster", None])
def test_no_frame_looks_through_the_facet_that_it_looks_down_on(engine, rng):
    """Exactly nadir 0.5 to 10 m above facets of 600 m: each pixel is that of a Lambert plane at that range, to 1e-3."""
    camera = views.camera(12, focal_length_px=25.0)
    scene = views.scene([views.sphere(Lambert(normal_albedo=0.3), 1, radius_m=1000.0)], [camera])
    shape = scene.bodies[0].shape
    with Renderer(scene) as renderer:
        for height_m in (0.5, 0.5, 1.0, 1.0, 2.0, 2.0, 5.0, 10.0):
            facet = rng.integers(len(shape.facets))
            normal, place = shape.facet_normals[facet], shape.vertices_m[shape.facets[facet]].mean(axis=0)
            r_camera = place + height_m * normal
            to_sun = normal + 0.4 * np.cross(normal, rng.normal(size=3))
            state = State(r_sun_inertial_m=1e8 * r_camera + AU_M * to_sun / np.linalg.norm(to_sun),
                          spacecraft=Pose(r_inertial_m=r_camera, q_from_inertial=frames.look_at(r_camera, place)),
                          bodies={"body": Pose(r_inertial_m=np.zeros(3))})
            r_sun = state.r_sun_inertial_m - place
            image = renderer.render(state, engine=engine, products=["range"])
            solar = views.SOLAR_IRRADIANCE_W_M2 * (AU_M / np.linalg.norm(r_sun)) ** 2
            radiance = 0.3 / np.pi * solar * (normal @ r_sun) / np.linalg.norm(r_sun)
            np.testing.assert_allclose(image.irradiance_W_m2, radiance * camera.solid_angle_sr(), rtol=1e-3)
            np.testing.assert_allclose(image.products["range"], height_m / camera.cos_field_angle, rtol=1e-3)


def test_region_of_interest_changes_no_pixel():
    """The region drawn holds all that is lit: a body far away at each corner makes it the whole frame."""
    state = views.state(phase_deg=50.0, target=(40.0, 30.0, -60.0))
    with Renderer(views.scene([views.sphere(WHITE, 4)], [views.camera()])) as renderer:
        small = renderer.render(state, samples=2)
    assert small.roi != (0, 0, 256, 256)
    wide = views.camera(512, principal_point_px=(255.5, 255.5))
    with Renderer(views.scene([views.sphere(WHITE, 4)], [wide])) as renderer:
        whole = renderer.render(state, samples=2).irradiance_W_m2
    inside = np.zeros_like(whole)
    inside[128:384, 128:384] = small.irradiance_W_m2
    difference = np.abs(whole - inside)
    # Another projection window rounds differently in float32: normals by 1e-4, and edges may take a
    # neighbour's sample.
    assert (difference > 1e-3 * whole.max()).mean() < 2e-3
    np.testing.assert_allclose(inside.sum(), whole.sum(), rtol=1e-4)


def test_a_body_half_out_of_the_frame_is_cut_at_its_edge(sphere_renderer):
    state = views.state(phase_deg=0.0, target=(0.0, 0.0, 250.0))
    image = sphere_renderer.render(state, samples=1)
    x0, y0, x1, y1 = image.roi
    assert y1 == 256 and y0 > 0
    assert image.irradiance_W_m2[255].any()


def test_a_body_behind_the_camera_leaves_the_frame_dark(sphere_renderer):
    away = views.state(phase_deg=20.0)
    away = views.state(phase_deg=20.0, target=tuple(2.0 * away.spacecraft.r_inertial_m))
    image = sphere_renderer.render(away)
    assert image.roi == (0, 0, 0, 0)
    assert not image.irradiance_W_m2.any()
    assert "body: out of view" in image.plan.left_out
