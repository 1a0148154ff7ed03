"""What other bodies' shadows leave of a body's light, beside closed forms and rays."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import views
from glrender import Pose, frames, generate
from glrender.backends.raytrace import RayTracer
from glrender.brdf import Lambert
from glrender.constants import AU_M, SUN_RADIUS_M
from glrender.eclipses import light_left
from glrender.error_model import eclipse_penumbra
from glrender.scene import Body
from glrender.view import between, view_bodies
from missing import needed_module

LAW, SUN_RAD = Lambert(normal_albedo=0.3), SUN_RADIUS_M / AU_M


def eclipse(places_m, radii_m=(), phase_deg=0.0, sun_radius_rad=0.0, shape=None):
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
    casters = [(scene.hulls[view.name], frames.transform(*between(view, seen[0]))) for view in seen[1:]]
    return light_left(seen[0], scene.hulls["body"], casters, sun_radius_rad), scene, state


@pytest.mark.parametrize("caster", [0.3, 0.5, 0.9])
def test_a_moon_before_the_sun_at_full_phase_leaves_the_closed_form(caster):
    """A sphere's light beyond a radius r of its disc, by Lambert's law: (1 - r^2)^1.5."""
    left, *_ = eclipse([(400.0, 0.0, 0.0)], [100.0 * caster])
    assert left == pytest.approx((1.0 - caster**2) ** 1.5, abs=0.02)


def test_only_what_is_before_the_sun_takes_light():
    """A larger moon sunward leaves none, one behind the body or beside it all; two as much as they cover together."""
    assert eclipse([(400.0, 0.0, 0.0)], [120.0])[0] == 0.0
    assert eclipse([(-150.0, 0.0, 0.0)], [120.0])[0] == eclipse([(150.0, 300.0, 0.0)], [120.0])[0] == 1.0
    one, other, both = (eclipse(places, [40.0] * len(places))[0] for places in (
        [(400.0, 50.0, 0.0)], [(300.0, -50.0, 0.0)], [(400.0, 50.0, 0.0), (300.0, -50.0, 0.0)]))
    assert 1.0 - both == pytest.approx((1.0 - one) + (1.0 - other))
    assert eclipse([(400.0, 50.0, 0.0), (300.0, 50.0, 0.0)], [40.0, 40.0])[0] == one


def test_beyond_the_umbra_light_is_left():
    """At 20,000 m the Sun is as wide as 93 m: an annular eclipse of all of the body."""
    narrow, = {eclipse([(20_000.0, 0.0, 0.0)], [60.0], sun_radius_rad=SUN_RAD)[0]}
    assert 0.2 < narrow <= 1.0 - (60.0 / 93.0) ** 2 + 0.3
    assert eclipse([(20_000.0, 0.0, 0.0)], [220.0], sun_radius_rad=SUN_RAD)[0] == 0.0


def test_what_is_left_is_as_rays_find_it():
    """Forty eclipses of a sphere and of a lumpy body, 0 to 150 deg: hulls leave rather too little."""
    needed_module("embreex", "pip install 'glrender[raytrace]'")
    rng, errors = np.random.default_rng(5), []
    shapes = [None, generate.contact_binary(radius_m=100.0, seed=3, subdivisions=4)]
    for case in range(40):
        places = [(rng.uniform(150.0, 1000.0), *rng.uniform(-110.0, 110.0, 2))]
        radius_m, phase_deg = rng.uniform(30.0, 110.0), rng.uniform(0.0, 150.0)
        left, scene, state = eclipse(places, [radius_m], phase_deg, shape=shapes[case % 2])
        flux, seen = [], None
        for bodies in (scene.bodies, scene.bodies[:1]):
            names = [body.name for body in bodies]
            posed = replace(state, bodies={name: state.bodies[name] for name in names})
            with RayTracer(views.scene(bodies, scene.cameras, sun_disc=False)) as tracer:
                image = tracer.render(posed, max_error=0.02, products=["body_id"])
            # Where the moon hides it nothing is told.
            seen = image.products["body_id"] == 0 if seen is None else seen
            flux.append(float(image.irradiance_W_m2[seen].sum(dtype=float)))
        errors.append(left - flux[0] / flux[1])
    assert np.mean(np.abs(errors) < 0.1) >= 0.85 and max(errors) < 0.25, np.round(errors, 3)


def test_the_penumbra_on_a_body_without_size_is_finite():
    """One out of view whose box rounds to nothing is planned all the same."""
    for size_px in (0.0, 1e-200, 1e-12):
        found = eclipse_penumbra(SimpleNamespace(size_px=size_px, sun_radius_rad=4.65e-3), 60.0, 1e4, 1e9)
        assert 0.0 <= found.error <= 1.0 and 0.0 <= found.eclipse_noise <= 1.0
