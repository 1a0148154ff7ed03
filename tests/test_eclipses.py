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
from glrender.scene import Body
from glrender.view import view_bodies
from missing import needed_module

LAW, SUN_RAD = Lambert(normal_albedo=0.3), SUN_RADIUS_M / AU_M


def eclipsed(places_m, radii_m=(), phase_deg=0.0, sun_radius_rad=0.0, shape=None):
    """Of a sphere of 100 m, or a shape, what spheres at such places [m] leave: along the Sun, and aside."""
    shape = shape or generate.icosphere(radius_m=100.0, subdivisions=5)
    bodies = [Body(name="body", shape=shape, brdf=LAW)] + [
        views.sphere(LAW, 4, radius_m, f"moon{k}") for k, radius_m in enumerate(radii_m)]
    scene = views.scene(bodies, [views.camera(64, 400.0)], sun_disc=sun_radius_rad > 0.0)
    state = views.state(phase_deg, bodies=[body.name for body in bodies])
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
    """A larger moon sunward leaves none, one behind the body or beside it all; two as much as they cover each."""
    assert left([(400.0, 0.0, 0.0)], [120.0]) == pytest.approx(0.0, abs=0.01)
    assert left([(-150.0, 0.0, 0.0)], [120.0]) == left([(150.0, 300.0, 0.0)], [120.0]) == 1.0
    one, other, both = (left(places, [40.0] * len(places)) for places in (
        [(400.0, 50.0, 0.0)], [(300.0, -50.0, 0.0)], [(400.0, 50.0, 0.0), (300.0, -50.0, 0.0)]))
    assert 1.0 - both == pytest.approx((1.0 - one) + (1.0 - other))
    assert left([(400.0, 0.0, 0.0)] * 3, [90.0] * 3) == 0.0


def test_a_penumbra_reaches_farther_than_the_umbra():
    """At 20,000 m the Sun is as wide as 93 m: a moon 200 m aside takes light, and one before it leaves some."""
    assert left([(20_000.0, 200.0, 0.0)], [60.0]) == 1.0
    assert 0.8 < left([(20_000.0, 200.0, 0.0)], [60.0], sun_radius_rad=SUN_RAD) < 1.0
    assert 0.2 < left([(20_000.0, 0.0, 0.0)], [60.0], sun_radius_rad=SUN_RAD) <= 1.0 - (60.0 / 93.0) ** 2
    assert left([(20_000.0, 0.0, 0.0)], [300.0], sun_radius_rad=SUN_RAD) == pytest.approx(0.0, abs=0.01)


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


def test_what_is_left_is_as_rays_find_it():
    """Forty eclipses of a sphere and of a lumpy body, 0 to 150 deg: hulls leave rather too little."""
    needed_module("embreex", "pip install 'glrender[raytrace]'")
    rng, errors = np.random.default_rng(5), []
    shapes = [None, generate.contact_binary(radius_m=100.0, seed=3, subdivisions=4)]
    for case in range(40):
        places = [(rng.uniform(150.0, 1000.0), *rng.uniform(-110.0, 110.0, 2))]
        radius_m, phase_deg = rng.uniform(30.0, 110.0), rng.uniform(0.0, 150.0)
        told, scene, state = eclipsed(places, [radius_m], phase_deg, shape=shapes[case % 2])
        flux, seen = [], None
        for bodies in (scene.bodies, scene.bodies[:1]):
            names = [body.name for body in bodies]
            posed = replace(state, bodies={name: state.bodies[name] for name in names})
            with RayTracer(views.scene(bodies, scene.cameras, sun_disc=False)) as tracer:
                image = tracer.render(posed, max_error=0.02, products=["body_id"])
            # Where the moon hides it nothing is told.
            seen = image.products["body_id"] == 0 if seen is None else seen
            flux.append(float(image.irradiance_W_m2[seen].sum(dtype=float)))
        errors.append(told.left - flux[0] / flux[1])
    assert np.mean(np.abs(errors) < 0.1) >= 0.85 and max(errors) < 0.25, np.round(errors, 3)
