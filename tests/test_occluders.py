"""What other bodies' shadows leave of a body's light, beside closed forms and rays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import views
from glrender import Pose, frames, generate
from glrender.backends.raytrace import RayTracer
from glrender.brdf import Lambert
from glrender.constants import AU_M, SUN_RADIUS_M
from glrender.eclipses import casters, eclipse
from glrender.hull import Hull
from glrender.scene import Body
from glrender.view import view_bodies
from missing import needed_module
from scipy.spatial.transform import Rotation

LAW, SUN_RAD = Lambert(normal_albedo=0.3), SUN_RADIUS_M / AU_M


def eclipsed(places_m, radii_m=(), phase_deg=0.0, sun_radius_rad=0.0, shape=None, n_px=64, au=1.0, focal_px=400.0):
    """Of a sphere of 100 m, or a shape, what spheres at such places [m] leave: along the Sun, and aside."""
    shape = shape or generate.icosphere(radius_m=100.0, subdivisions=5)
    bodies = [Body(name="body", shape=shape, brdf=LAW)] + [
        views.sphere(LAW, 4, radius_m, f"moon{k}") for k, radius_m in enumerate(radii_m)]
    scene = views.scene(bodies, [views.camera(n_px, focal_px)], sun_disc=sun_radius_rad > 0.0)
    state = views.state(phase_deg, bodies=[body.name for body in bodies], sun_distance_au=au)
    aside_x, aside_y, sunward = frames.sun_from_body(state.r_sun_inertial_m / np.linalg.norm(state.r_sun_inertial_m))
    state = replace(state, bodies={**state.bodies, **{
        f"moon{k}": Pose(r_inertial_m=along * sunward + x * aside_x + y * aside_y)
        for k, (along, x, y) in enumerate(places_m)}})
    seen = view_bodies(state, scene.cameras[0], scene.hulls)
    cast = casters(seen[0], seen, scene.hulls, sun_radius_rad)
    return eclipse(seen[0], cast, scene.hulls, scene.cameras[0], sun_radius_rad), scene, state


def left(*asked, **options):
    return eclipsed(*asked, **options)[0].left


@pytest.mark.parametrize("caster", [0.05, 0.3, 0.5, 0.9])
def test_a_moon_before_the_sun_at_full_phase_leaves_the_closed_form(caster):
    """A sphere's light beyond a radius r of its disc, by Lambert's law: (1 - r^2)^1.5."""
    found = left([(400.0, 0.0, 0.0)], [100.0 * caster])
    assert 1.0 - found == pytest.approx(1.0 - (1.0 - caster**2) ** 1.5, rel=0.03)


def test_only_what_is_before_the_sun_takes_light():
    """A larger moon sunward leaves none, one behind the body or beside it all; two as much as they cover together."""
    assert left([(400.0, 0.0, 0.0)], [120.0]) == pytest.approx(0.0, abs=0.01)
    assert left([(-150.0, 0.0, 0.0)], [120.0]) == left([(150.0, 300.0, 0.0)], [120.0]) == 1.0
    one, other, both = (left(places, [40.0] * len(places)) for places in (
        [(400.0, 50.0, 0.0)], [(300.0, -50.0, 0.0)], [(400.0, 50.0, 0.0), (300.0, -50.0, 0.0)]))
    assert 1.0 - both == pytest.approx((1.0 - one) + (1.0 - other))
    line = [(400.0 + 250.0 * k, 0.0, 0.0) for k in range(3)]
    assert left(line, [90.0] * 3) == pytest.approx(left(line[:1], [90.0]), abs=0.03)
    assert left(line, [30.0, 90.0, 60.0]) == pytest.approx(left(line[1:2], [90.0]), abs=0.03)


def test_a_penumbra_reaches_farther_than_the_umbra():
    """At 20,000 m the Sun is as wide as 93 m: a moon 200 m aside takes light, and one before it leaves some."""
    assert left([(20_000.0, 200.0, 0.0)], [60.0]) == 1.0
    assert 0.8 < left([(20_000.0, 200.0, 0.0)], [60.0], sun_radius_rad=SUN_RAD) < 1.0
    assert left([(20_000.0, 0.0, 0.0)], [300.0], sun_radius_rad=SUN_RAD) == pytest.approx(0.0, abs=0.01)


def overlap(apart, a, b):
    """Area that two discs of radii a and b share."""
    if apart <= abs(a - b):
        return np.pi * min(a, b) ** 2
    if apart >= a + b:
        return 0.0
    at_a, at_b = (np.arccos((apart**2 + p**2 - q**2) / (2.0 * apart * p)) for p, q in ((a, b), (b, a)))
    return a**2 * (at_a - 0.5 * np.sin(2.0 * at_a)) + b**2 * (at_b - 0.5 * np.sin(2.0 * at_b))


@pytest.mark.parametrize("radius_m", [1.0, 10.0, 60.0])
@pytest.mark.parametrize("gap_m", [2e4, 1e5, 1e6])
def test_a_body_narrower_than_the_sun_takes_what_it_covers(radius_m, gap_m):
    """All over a disc as wide as the Sun's there, from which the light is that of a sphere at full phase."""
    half_m, aside_m = SUN_RAD * (gap_m - 50.0), np.linspace(0.0, 100.0, 400)
    light = aside_m * np.sqrt(1.0 - (aside_m / 100.0) ** 2)
    lost = light @ [overlap(x, radius_m, half_m) for x in aside_m] / light.sum() / (np.pi * half_m**2)
    told, *_ = eclipsed([(gap_m, 0.0, 0.0)], [radius_m], sun_radius_rad=SUN_RAD)
    assert 1.0 - told.left == pytest.approx(lost, rel=0.15)
    assert told.noise <= 2.5 * radius_m / half_m
    assert told.width_px <= 2.0 * radius_m / (1900.0 / 400.0) * 1.01


@pytest.mark.parametrize("gap_m", [100.0, 400.0, 4000.0])
def test_noise_of_a_penumbra_is_the_closed_form(gap_m):
    """At full phase, around a radius of 0.5: 1/6 of the ramp's area of samples that are lit or not, as bright as rise.

    Over a sphere's light, 2/3 pi R^2, less what is in the shadow, with one sample on (2 R)^2.
    """
    told, *_ = eclipsed([(gap_m, 0.0, 0.0)], [50.0], sun_radius_rad=SUN_RAD)
    rise = np.sqrt(0.75)
    width_m = 2.0 * SUN_RAD * (gap_m - 100.0 * rise)
    variance = 2.0 * np.pi * 50.0 * width_m / 6.0 * rise**2
    assert told.noise == pytest.approx(200.0 * np.sqrt(variance) / (2.0 / 3.0 * np.pi * 1e4 * 0.75**1.5), rel=0.05)
    assert told.width_px >= width_m / (1900.0 / 400.0)


def test_a_point_sun_has_no_penumbra():
    told, *_ = eclipsed([(4000.0, 0.0, 0.0)], [50.0])
    assert told.noise == told.error == told.width_px == 0.0


def test_hard_edges_within_a_body_smaller_than_a_pixel_cost_what_its_disc_has_of_them():
    """However small it is; less than of one of many pixels. Where the moon is, edges move no flux."""
    found = [eclipsed([(6000.0, 58.0, 0.0)], [80.0], sun_radius_rad=SUN_RAD, focal_px=size_px * 9.5)[0].error
             for size_px in (0.1, 0.5, 1.0, 5.0, 50.0)]
    assert found[0] == pytest.approx(found[1]) == pytest.approx(found[2])
    assert found[2] < 0.7 * found[3] < 0.49 * found[4]


def test_a_penumbra_within_another_s_umbra_costs_nothing():
    near, both = (eclipsed(places_m, radii_m, sun_radius_rad=SUN_RAD)[0] for places_m, radii_m in (
        ([(400.0, 0.0, 0.0)], [80.0]), ([(400.0, 0.0, 0.0), (6000.0, 0.0, 0.0)], [80.0, 30.0])))
    far, *_ = eclipsed([(6000.0, 0.0, 0.0)], [30.0], sun_radius_rad=SUN_RAD)
    assert both.error == pytest.approx(near.error, rel=0.05) and far.error > 2.0 * near.error


@pytest.mark.parametrize("widths_m", [(60.0, 60.0, 300.0), (100.0, 100.0, 10.0)])
def test_a_tilted_body_casts_where_it_is_sunward_of_another(widths_m):
    """Of a long or flat ellipsoid the sunward end; of a small sphere the middle is sunward of its own in both."""
    sphere = generate.icosphere(radius_m=1.0, subdivisions=4)
    turned = Rotation.from_euler("y", 45.0 if widths_m[2] > 100.0 else -45.0, degrees=True)
    tilted_m = turned.apply(sphere.vertices_m * widths_m)
    hulls = {"small": Hull(10.0 * sphere.vertices_m, sphere.facets), "tilted": Hull(tilted_m, sphere.facets)}
    state, camera = views.state(60.0, bodies=["small", "tilted"]), views.camera(64, 400.0)
    end_m = 0.5 * max(widths_m)
    for height_m, expected in ((0.4 * end_m, 0.0), (1.6 * end_m, 1.0)):
        posed = replace(state, r_sun_inertial_m=[0.0, 0.0, AU_M], bodies={
            "small": Pose(r_inertial_m=[end_m, 0.0, height_m]), "tilted": Pose(r_inertial_m=np.zeros(3))})
        small, tilted = view_bodies(posed, camera, hulls)
        told = eclipse(small, casters(small, [small, tilted], hulls), hulls, camera, 0.0)
        assert told.left == pytest.approx(expected, abs=0.01)


def test_a_planet_far_from_its_moon_overflows_nowhere():
    with np.errstate(all="raise"):
        told, *_ = eclipsed([(4e9, 0.0, 0.0)], [7e6], sun_radius_rad=SUN_RAD)
    assert 0.0 < told.left < 1.0


def flux(scene, state, names, seen=None, max_error=0.01):
    """Light [W/m2] of the pixels that show the body itself, where no moon hides it, and which those are."""
    bodies = [body for body in scene.bodies if body.name in names]
    with RayTracer(views.scene(bodies, scene.cameras, sun_disc=False)) as tracer:
        image = tracer.render(replace(state, bodies={name: state.bodies[name] for name in names}), max_error=max_error,
                              products=["body_id"])
    seen = image.products["body_id"] == 0 if seen is None else seen
    return float(image.irradiance_W_m2[seen].sum(dtype=float)), seen


@pytest.mark.parametrize("n_moons", [1, 3])
def test_what_is_left_is_as_rays_find_it(n_moons):
    """Of moons over a sphere and over a lumpy body, 0 to 150 deg."""
    needed_module("embreex", "pip install 'glrender[raytrace]'")
    rng, errors = np.random.default_rng(5), []
    shapes = [None, generate.contact_binary(radius_m=100.0, seed=3, subdivisions=4)]
    for case in range(30):
        places = [(rng.uniform(150.0, 1000.0), *rng.uniform(-110.0, 110.0, 2)) for _ in range(n_moons)]
        radii_m, phase_deg = rng.uniform(30.0, 110.0, n_moons) / n_moons**0.5, rng.uniform(0.0, 150.0)
        told, scene, state = eclipsed(places, radii_m, phase_deg, shape=shapes[case % 2])
        found, seen = flux(scene, state, list(scene.hulls), max_error=0.02)
        errors.append(told.left - found / flux(scene, state, ["body"], seen, max_error=0.02)[0])
    assert np.mean(np.abs(errors) < 0.1) >= 0.85 and max(errors) < 0.4, np.round(errors, 3)


@pytest.mark.parametrize("sun_distance_au", [1.0, 0.2])
def test_hard_edges_are_told_ten_times_the_flux_that_they_move(sun_distance_au):
    """Beside rays with and without the Sun's disc, where a moon grazes a sphere or leaves little of it."""
    needed_module("embreex", "pip install 'glrender[raytrace]'")
    rng, over, fluxes = np.random.default_rng(3), [], []
    for _ in range(16):
        angle, aside = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.0, 170.0)
        places = [(rng.uniform(800.0, 4000.0), aside * np.cos(angle), aside * np.sin(angle))]
        radii_m, phase_deg = [rng.uniform(40.0, 95.0)], rng.uniform(0.0, 100.0)
        found = []
        for sun_radius_rad in (SUN_RAD / sun_distance_au, 0.0):
            told, scene, state = eclipsed(places, radii_m, phase_deg, sun_radius_rad, n_px=64, au=sun_distance_au)
            with RayTracer(scene) as tracer:
                image = tracer.render(state, samples=8, products=["body_id"])
            found.append((told.error, float(image.irradiance_W_m2[image.products["body_id"] != 1].sum(dtype=float))))
        (error, soft), (_, hard) = found
        if soft > 0.01 * max(fluxes := [*fluxes, soft]):
            over.append(error / min(abs(10.0 * (hard / soft - 1.0)), 1.0))
    assert len(over) >= 10 and np.mean(np.array(over) >= 1.0) >= 0.9, np.round(over, 2)


def test_an_eclipse_beside_the_image_costs_nothing():
    """Of a body of which the image shows a part, it counts where that is."""
    errors = []
    for beside_m in (0.0, 60.0):
        told, scene, state = eclipsed([(300.0, 0.0, 0.0)], [3.0], 40.0, SUN_RAD)
        sun = state.r_sun_inertial_m / np.linalg.norm(state.r_sun_inertial_m)
        aside = np.cross(sun, state.spacecraft.r_inertial_m / 2000.0)
        camera = views.camera(200, 200 / 10.0 * 1900.0)
        state = replace(state, spacecraft=replace(state.spacecraft, q_from_inertial=frames.look_at(
            state.spacecraft.r_inertial_m, 100.0 * sun + beside_m * aside)))
        seen = view_bodies(state, camera, scene.hulls)
        assert not seen[0].is_whole
        cast = casters(seen[0], seen, scene.hulls, SUN_RAD)
        errors.append(eclipse(seen[0], cast, scene.hulls, camera, SUN_RAD).error)
    assert errors[0] > 0.05 and errors[1] == 0.0


@pytest.mark.parametrize("size_px", [3.0, 20.0])
@pytest.mark.parametrize("aside_m, least, most", [(60.0, 0.01, 0.1), (-110.0, 0.9, 1.0)])
def test_what_is_left_of_a_body_that_is_half_beside_the_image(size_px, aside_m, least, most):
    """Half of it is in a large moon's shadow: that which the image shows, or the other."""
    needed_module("embreex", "pip install 'glrender[raytrace]'")
    _, scene, state = eclipsed([(800.0, 0.0, 0.0)], [100.0], 30.0)
    sun, to_camera = (place / np.linalg.norm(place) for place in (state.r_sun_inertial_m,
                                                                  state.spacecraft.r_inertial_m))
    across = np.cross(sun, to_camera) / np.linalg.norm(np.cross(sun, to_camera))
    # Its middle is on the edge of an image that is 20 bodies wide.
    camera = views.camera(round(20.0 * size_px), size_px / 200.0 * 1900.0)
    state = replace(state, spacecraft=replace(state.spacecraft, q_from_inertial=frames.look_at(
        state.spacecraft.r_inertial_m, 2105.0 * across)), bodies={
        **state.bodies, "moon0": Pose(r_inertial_m=800.0 * sun + aside_m * across)})
    scene = replace(scene, cameras=[camera])
    body, moon = view_bodies(state, camera, scene.hulls)
    assert not body.is_whole
    told = eclipse(body, casters(body, [body, moon], scene.hulls), scene.hulls, camera, 0.0).left
    eclipsed_flux, seen = flux(scene, state, ["body", "moon0"])
    found = eclipsed_flux / flux(scene, state, ["body"], seen)[0]
    assert least <= found <= most
    assert told == pytest.approx(found, abs=0.1)
