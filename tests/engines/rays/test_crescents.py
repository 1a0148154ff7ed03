"""The ray tracer at large phase angles: light in slivers is found, and an error that is missed is said."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import solids
import views
from cells import slow_but
from facet_images import facet_image
from glrender import Body, Pose, Renderer, State, generate
from glrender.base.constants import AU_M
from glrender.brdf import Hapke, Lambert, LommelSeeliger
from glrender.engines.cycles.backend import Cycles
from glrender.engines.rays.aimed import AimedRays
from glrender.engines.rays.backend import RayTracer, _until
from glrender.engines.rays.engine import RayEngine
from glrender.view.view import view_bodies

GREY = Lambert(normal_albedo=0.4)
HAPKE = Hapke(single_scattering_albedo=0.42, b=0.35, c=1.0, shoe_amplitude=0.87, shoe_width=0.05, roughness_deg=26.0)


def crescent(law, size_px, phase_deg, subdivisions=4, range_m=1e5):
    """A sphere of facets, the Sun a point: scene, state, and the sum over its facets."""
    body = views.sphere(law, subdivisions)
    camera = views.camera(int(1.2 * size_px) + 8, size_px * range_m / 200.0)
    # From aside, so that no facets lie along the image's axes.
    state = views.state(phase_deg=phase_deg, range_m=range_m, direction=(0.3, -0.8, 0.4))
    return (views.scene([body], [camera], sun_disc=False), state, facet_image(body.shape, state, camera, law))


@pytest.mark.parametrize("law, size_px, phase_deg", slow_but([
    (GREY, 3.0, 165.0), (GREY, 30.0, 176.0), (GREY, 100.0, 170.0), (GREY, 300.0, 174.0), (HAPKE, 30.0, 170.0),
    (LommelSeeliger(single_scattering_albedo=0.3), 60.0, 179.0)], 0, 1, 5))
@pytest.mark.parametrize("max_error", [0.02, 0.005])
def test_a_spheres_crescent_meets_its_tolerance(law, size_px, phase_deg, max_error):
    """Against the sum over its facets: a sphere at 176 deg lost 92 % of its light to rays through pixels."""
    scene, state, truth = crescent(law, size_px, phase_deg)
    with RayTracer(scene) as tracer:
        image = tracer.render(state, max_error=max_error)
    assert image.plan.predicted_error <= max_error and not image.plan.warnings
    assert views.relative_rms(image.irradiance_W_m2.astype(float), truth) < 1.1 * image.plan.predicted_error
    np.testing.assert_allclose(image.irradiance_W_m2.sum(dtype=float), truth.sum(), rtol=0.1 * max_error)


@pytest.mark.parametrize("samples", [1, 2, 4, 12])
@pytest.mark.parametrize("phase_deg", [160.0, 172.0, 178.0])
def test_the_error_of_given_samples_is_that_beside_the_facets(samples, phase_deg):
    """Between 0.9 and 2.2 times the true one, also where every sample passes the light by; too much of it warns."""
    scene, state, truth = crescent(GREY, 40.0, phase_deg)
    with RayTracer(scene) as tracer:
        image = tracer.render(state, samples=samples, max_error=0.02)
    error = views.relative_rms(image.irradiance_W_m2.astype(float), truth)
    assert 0.9 * error < image.plan.predicted_error < max(2.2 * error, 0.02)
    assert any("exceeds max_error 0.02" in text for text in image.plan.warnings) == (image.plan.predicted_error > 0.02)


def test_a_dark_grid_of_samples_says_that_all_light_is_missing():
    scene, state, truth = crescent(GREY, 3.0, 176.0)
    with RayTracer(scene) as tracer:
        image = tracer.render(state, samples=4, max_error=0.5)
    assert truth.any() and not image.irradiance_W_m2.any()
    assert image.plan.predicted_error >= 1.0 and image.plan.missed == ("rms",) and image.plan.warnings


def test_a_contact_binary_at_177_deg_is_not_dark():
    """Of a shape with dips the hull's crescent is more than there is; all of it is found, whatever the rays' seed."""
    body = Body(name="body", shape=generate.contact_binary(radius_m=300.0, seed=1),
                brdf=LommelSeeliger(single_scattering_albedo=0.3))
    state = views.state(phase_deg=177.0, range_m=4500.0, direction=(0.3, -0.8, 0.4))
    state = replace(state, r_sun_inertial_m=1.4e11 * state.r_sun_inertial_m / np.linalg.norm(state.r_sun_inertial_m))
    scene = views.scene([body], [views.camera(256, 1250.0)])
    with RayTracer(scene) as tracer:
        images = [tracer.render(state, seed=seed) for seed in range(3)]
    light = [image.irradiance_W_m2.sum(dtype=float) for image in images]
    assert min(light) > 0.0 and np.ptp(light) < 0.004 * min(light)
    for one, other in zip(images, images[1:], strict=False):
        assert one.plan.predicted_error <= 0.02 and not one.plan.missed
        apart = views.relative_rms(one.irradiance_W_m2.astype(float), other.irradiance_W_m2.astype(float))
        assert apart < 1.2 * np.hypot(one.plan.predicted_error, other.plan.predicted_error)


@pytest.mark.parametrize("phase_deg", [150.0, 165.0])
def test_a_pillar_shades_and_hides_as_much_by_aimed_rays(phase_deg):
    """Facets a hundred times as large as a pixel, the light that the pillar's two strips take within 1 % of theirs."""
    half, pillar, range_m, angle = 100.0, (5.0, 3.0), 1e6, 0.5 * np.radians(phase_deg)
    camera = views.camera(96, 96 / 290.0 * range_m)
    state = views.state(range_m=range_m, direction=(-np.sin(angle), 0.0, np.cos(angle)))
    state = replace(state, r_sun_inertial_m=AU_M * np.array([np.sin(angle), 0.0, np.cos(angle)]))
    flux = []
    for stands in (pillar, None):
        scene = views.scene([Body(name="body", shape=solids.slab(half, pillar_m=stands), brdf=GREY)], [camera],
                            sun_disc=False)
        engine = RayEngine(scene)
        aimed = AimedRays(engine, camera, view_bodies(state, camera, scene.hulls), (0, 0, 96, 96))
        mean, error = aimed.until(0.02, np.random.default_rng(1))
        engine.close()
        assert error <= 0.02
        flux.append(mean.sum())
    expected = [solids.slab_flux(angle, angle, half, stands, range_m, views.SOLAR_IRRADIANCE_W_M2, 0.4)
                for stands in (pillar, (0.0, 0.0))]
    np.testing.assert_allclose(flux, expected, rtol=1e-3)
    np.testing.assert_allclose(flux[1] - flux[0], expected[1] - expected[0], rtol=0.01)


def test_what_another_body_hides_from_the_sun_is_dark_without_a_warning():
    """A moon behind a planet: it faces Sun and camera, and no ray of it meets the Sun."""
    bodies = [views.sphere(GREY, 4, 10.0, "moon"), views.sphere(GREY, 4, 100.0, "planet")]
    base = views.state(phase_deg=60.0, bodies=("moon", "planet"))
    behind = -300.0 * base.r_sun_inertial_m / np.linalg.norm(base.r_sun_inertial_m)
    state = State(r_sun_inertial_m=base.r_sun_inertial_m,
                  spacecraft=replace(base.spacecraft, r_inertial_m=base.spacecraft.r_inertial_m + behind),
                  bodies={**base.bodies, "moon": Pose(r_inertial_m=behind)})
    with RayTracer(views.scene(bodies, [views.camera(20, 1000.0)])) as tracer:
        image = tracer.render(state)
    assert [body.is_visible for body in image.plan.bodies] == [True, False] and not image.irradiance_W_m2.any()
    assert 0.0 < image.plan.predicted_error < 1e-5 and not image.plan.warnings


def umbra(radii_m, subdivisions=4, range_m=2000.0, **camera):
    """A body in the umbra of another, and a third that the Sun lights, of radii [m] as given: scene and state."""
    names = ("shaded", "shading", "lit")[:len(radii_m)]
    bodies = [views.sphere(GREY, subdivisions, radius_m, name) for radius_m, name in zip(radii_m, names, strict=True)]
    base = views.state(phase_deg=60.0, range_m=range_m, bodies=names)
    to_sun = base.r_sun_inertial_m / np.linalg.norm(base.r_sun_inertial_m)
    aside = np.cross(to_sun, base.spacecraft.r_inertial_m / range_m)
    places = (np.zeros(3), 800.0 * to_sun, 138.0 * aside / np.linalg.norm(aside))
    state = replace(base, bodies={name: Pose(r_inertial_m=place) for name, place in zip(names, places, strict=False)})
    return views.scene(bodies, [views.camera(**camera)]), state


@pytest.mark.parametrize("seed", [0, 2])
def test_a_small_lit_body_is_found_near_a_large_dark_one(seed):
    """A sphere of 0.03 px radius: its light by the closed form of a Lambert sphere, of which facets lose 2 %."""
    scene, state = umbra((100.0, 125.0, 0.06), size_px=160)
    camera, engine = scene.cameras[0], RayEngine(scene)
    mean, _ = AimedRays(engine, camera, view_bodies(state, camera, scene.hulls), (0, 0, 160, 160)).until(
        0.005, np.random.default_rng(seed))
    engine.close()
    phase = (np.sin(np.pi / 3.0) + 2.0 * np.pi / 3.0 * np.cos(np.pi / 3.0)) / np.pi
    light = views.SOLAR_IRRADIANCE_W_M2 * 0.4 * 2.0 / 3.0 * phase * 0.06**2 / (2000.0**2 + 138.0**2)
    np.testing.assert_allclose(mean.sum(), light, rtol=0.05)
    with RayTracer(scene) as tracer:
        image = tracer.render(state, max_error=0.005, seed=seed)
    assert image.irradiance_W_m2.any() and image.plan.missed == ("rms",) and image.plan.warnings


@pytest.mark.parametrize("by_pixels, by_facets, stays", [
    ((1.0, 0.3), (0.0, 1e-6), 0), ((0.0, 1e-7), (1.0, 0.3), 1), ((1.0, 0.3), (1.0, 0.1), 1),
    ((1.0, 0.1), (1.0, 0.3), 0), ((0.0, 1e-9), (0.0, 1e-6), 1)])
def test_of_a_dark_and_a_lit_image_the_lit_one_stays(by_pixels, by_facets, stays):
    """Light and error of each kind of rays; of two lit ones that of less error, of two dark ones the facets'."""
    images = [(np.full((2, 2), light), error) for light, error in (by_pixels, by_facets)]
    rays = SimpleNamespace(until=lambda *_: images[0])
    aimed = SimpleNamespace(until=lambda *_: images[1], is_able=True, of_darkness=lambda error: error)
    progress = SimpleNamespace(part=lambda *_: None, finish=lambda: None)
    assert _until(rays, aimed, False, 0.005, None, progress) == images[stays]


@pytest.mark.parametrize("options", [{}, {"samples": 2}])
@pytest.mark.parametrize("n_shading, expected", [(1, 1.0), (0, 0.0)])
def test_a_dark_frame_of_near_facets_has_no_bound_but_all_light(options, n_shading, expected):
    """No rays are aimed at facets from 60 to 150 m: they may be lit where no ray fell; seen from behind, none may."""
    scene, state = umbra((100.0, 125.0), subdivisions=0, range_m=160.0, size_px=32, focal_length_px=20.0)
    if not n_shading:
        state = replace(state, r_sun_inertial_m=-AU_M * state.spacecraft.r_inertial_m / 160.0, bodies={
            **state.bodies, "shading": Pose(r_inertial_m=900.0 * state.spacecraft.r_inertial_m / 160.0)})
    with RayTracer(scene) as tracer:
        plan, irradiance = (image := tracer.render(state, max_error=0.5, **options)).plan, image.irradiance_W_m2
    assert not irradiance.any() and plan.predicted_error == expected
    assert plan.missed == ("rms",) * n_shading and bool(plan.warnings) == bool(n_shading)


@pytest.mark.usefixtures("blender")
def test_a_dark_frame_of_cycles_has_no_bound_either():
    """Its error is that of the rays of facets, which are too near here."""
    scene, state = umbra((100.0, 125.0), subdivisions=0, range_m=160.0, size_px=32, focal_length_px=20.0)
    with Cycles(scene, bounces=0) as cycles:
        image = cycles.render(state, samples=1, max_error=0.5)
    assert not image.irradiance_W_m2.any() and image.plan.predicted_error == 1.0 and image.plan.warnings


def test_every_unit_that_is_missed_warns_and_the_frame_tells_its_time():
    scene, state, _ = crescent(GREY, 60.0, 100.0)
    with RayTracer(scene) as tracer:
        image = tracer.render(state, samples=2, max_error={"rms": 1e-3, "flux": 0.5, "limb_px": 1e-3})
    assert image.plan.missed == ("rms", "limb_px")
    assert [text.split(" exceeds")[0].split()[1] for text in image.plan.warnings] == ["error", "limb_px"]
    ways_out = [text.split("; ")[1] for text in image.plan.warnings]
    assert ways_out == ["leave samples out", "the least predicted of any frame of this view is 0.012"]
    assert image.plan.milliseconds == image.timings_ms["trace"] > 0.0


def test_the_ray_tracer_meets_a_tolerance_that_opengl_misses():
    """A crescent, compared with the sum over its facets."""
    scene, state, truth = crescent(GREY, 30.0, 174.0)
    with Renderer(scene) as renderer, RayTracer(scene) as tracer:
        fast, slow = renderer.render(state, max_error=0.005, engine="raster"), tracer.render(state, max_error=0.005)
    errors = [views.relative_rms(image.irradiance_W_m2.astype(float), truth) for image in (fast, slow)]
    assert slow.plan.predicted_error <= 0.005 and errors[1] < 1.1 * slow.plan.predicted_error < errors[0]
    assert any(text.endswith("exceeds max_error 0.005; leave engine out") for text in fast.plan.warnings)
