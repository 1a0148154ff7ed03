"""Metals and paints: Mitsuba's rough conductor, a white furnace, GLSL, the flux of a sphere by each engine."""

from __future__ import annotations

import re

import numpy as np
import pytest
import views
from cells import slow_but
from glrender import ConfigError, Renderer
from glrender.brdf import Microfacet
from glrender.engines.cycles.osl import law_as_osl
from missing import needed_module

UP = np.array([0.0, 0.0, 1.0])


def metal(roughness, base_albedo=1.0):
    return Microfacet(base_albedo=base_albedo, metalness=1.0, roughness=roughness)


def paint(roughness, base_albedo=1.0):
    return Microfacet(base_albedo=base_albedo, metalness=0.0, roughness=roughness)


def directions(rng, count, most_deg=88.0):
    """Unit vectors (N, 3) within an angle from +z."""
    cosine, turn = rng.uniform(np.cos(np.radians(most_deg)), 1.0, count), rng.uniform(0.0, 2.0 * np.pi, count)
    sine = np.sqrt(1.0 - cosine**2)
    return np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=1)


def pairs(rng, count):
    """Directions to Sun and camera, half of them near each other's mirror, where the highlight is."""
    sun, camera = directions(rng, count), directions(rng, count)
    half = count // 2
    camera[:half] = sun[:half] * [-1.0, -1.0, 1.0] + rng.normal(0.0, 0.05, (half, 3))
    camera /= np.linalg.norm(camera, axis=1, keepdims=True)
    camera[:, 2] = np.abs(camera[:, 2])
    return sun, camera


@pytest.mark.parametrize("roughness", [0.2, 0.35, 0.5, 1.0])
def test_a_metal_is_mitsubas_rough_conductor(roughness):
    """47 pairs of directions each, 188 in all: 1e-5, of single precision."""
    mitsuba = needed_module("mitsuba", "make mitsuba")
    mitsuba.set_variant("scalar_rgb")
    made = mitsuba.load_dict({"type": "roughconductor", "material": "none", "distribution": "ggx",
                              "alpha": roughness**2})
    sun, camera = pairs(np.random.default_rng(3), 47)
    hit, expected = mitsuba.SurfaceInteraction3f(), []
    for to_sun, to_camera in zip(sun, camera, strict=True):
        hit.wi = mitsuba.Vector3f(*to_camera.tolist())
        value = made.eval(mitsuba.BSDFContext(), hit, mitsuba.Vector3f(*to_sun.tolist()))
        expected.append(float(value[0]) / to_sun[2])
    np.testing.assert_allclose(metal(roughness).brdf(sun, camera, UP), expected, rtol=1e-5)


def returned(law, incidence_deg, n=200):
    """Share of the light from an angle that a surface returns: half vectors by GGX' density, and cosines."""
    angle, alpha2 = np.radians(incidence_deg), law.roughness**4
    to_sun = np.array([np.sin(angle), 0.0, np.cos(angle)])
    turn = (np.arange(n) + 0.5) * 2.0 * np.pi / n
    # Half of the directions mirror the Sun in half vectors of the lobe, half are even: each weighs by both densities.
    place = ((np.arange(n) + 0.5) / n)[:, None]
    height = np.sqrt((1.0 - place) / (1.0 + place * (alpha2 - 1.0)))
    aside = np.sqrt(1.0 - height**2)
    half = np.stack(np.broadcast_arrays(aside * np.cos(turn), aside * np.sin(turn), height), axis=-1).reshape(-1, 3)
    mirrored = 2.0 * (half @ to_sun)[:, None] * half - to_sun
    even = np.stack(np.broadcast_arrays(np.sqrt(place) * np.cos(turn), np.sqrt(place) * np.sin(turn),
                                        np.sqrt(1.0 - place)), axis=-1).reshape(-1, 3)
    total = 0.0
    for ways in (mirrored, even):
        ways = ways[ways[:, 2] > 1e-9]
        bisector = ways + to_sun
        bisector /= np.linalg.norm(bisector, axis=1, keepdims=True)
        cosine = bisector[:, 2]
        density = alpha2 / np.pi / ((alpha2 - 1.0) * cosine**2 + 1.0) ** 2 * cosine / (4.0 * (bisector @ to_sun))
        density = 0.5 * (density + ways[:, 2] / np.pi)
        total += float((law.brdf(to_sun, ways, UP) * ways[:, 2] / density).sum()) / (2.0 * n * n)
    return total


@pytest.mark.parametrize("roughness", [0.1, 0.2, 0.5, 1.0])
def test_a_white_paint_returns_all_light_and_a_black_one_what_its_coat_does(roughness):
    """0.5 % from square on to 87 deg; of a grey one, what the coat lets through is scaled."""
    for incidence_deg in (0.0, 60.0, 84.0, 87.0):
        white, grey, black = (returned(paint(roughness, base), incidence_deg) for base in (1.0, 0.5, 0.0))
        assert white == pytest.approx(1.0, abs=5e-3)
        assert grey == pytest.approx(black + 0.5 * (1.0 - black), abs=5e-3) and 0.01 < black < 0.8


def test_a_metal_loses_what_scatters_twice():
    """8 % and more at roughness 0.5, 42 % and more at 1, as docs/photometry.md says."""
    most = [max(returned(metal(roughness), deg) for deg in (0.0, 45.0, 60.0, 75.0, 85.0)) for roughness in (0.5, 1.0)]
    np.testing.assert_allclose(most, [0.92, 0.58], atol=0.02)


def test_a_mixture_is_between_and_directions_may_be_swapped():
    sun, camera = pairs(np.random.default_rng(4), 200)
    of = lambda metalness: Microfacet(base_albedo=0.4, metalness=metalness, roughness=0.3)  # noqa: E731
    np.testing.assert_allclose(of(0.25).brdf(sun, camera, UP), 0.25 * of(1.0).brdf(sun, camera, UP)
                               + 0.75 * of(0.0).brdf(sun, camera, UP), rtol=1e-12)
    np.testing.assert_allclose(of(0.25).brdf(sun, camera, UP), of(0.25).brdf(camera, sun, UP), rtol=1e-12)


@pytest.mark.parametrize("roughness", [0.1, 0.35, 1.0])
def test_shader_is_the_twin(roughness, evaluate):
    """1e-4 up to 88 deg, with a texture's factor; finite and never negative from any direction."""
    rng = np.random.default_rng(5)
    law = Microfacet(base_albedo=0.6, metalness=0.3, roughness=roughness)
    sun, camera = (each.astype(np.float32) for each in pairs(rng, 20_000))
    normal = np.broadcast_to(UP.astype(np.float32), sun.shape)
    np.testing.assert_allclose(evaluate(law, sun, camera, normal), law.brdf(sun, camera, normal), rtol=1e-4)
    scaled = Microfacet(base_albedo=0.3, metalness=0.3, roughness=roughness)
    np.testing.assert_allclose(evaluate(law, sun, camera, normal, np.full(len(sun), 0.5), {"HAS_ALBEDO_TEXTURE": 1}),
                               scaled.brdf(sun, camera, normal), rtol=1e-4)
    ways = rng.normal(size=(3, 20_000, 3)).astype(np.float32)
    sun, camera, normal = ways / np.linalg.norm(ways, axis=-1, keepdims=True)
    for values in (evaluate(law, sun, camera, normal), law.brdf(sun, camera, normal), law.brdf(sun, -sun, normal),
                   evaluate(law, normal, normal, normal), law.brdf(normal, normal, normal)):
        assert np.isfinite(values).all() and (values >= 0.0).all()


def test_blender_gets_the_same_text_without_what_its_language_lacks():
    """Open Shading Language has no vectors of two to work on, and no place in a row by a number."""
    text = law_as_osl(paint(0.3), False)
    assert "law_left_at_vec4(k)" in text and not re.search(r"\]\s*\[|law_left\[", text)
    body = text[text.index("float brdf("):]
    assert "vec2" not in body[:body.index("shader law")]


@pytest.mark.parametrize("options", slow_but([
    {"max_error": 0.05}, {"engine": "rays", "max_error": 0.05}, {"max_error": 0.02}, {"max_error": 0.005}], 0))
def test_a_metal_spheres_flux_is_that_of_its_normals(options):
    """0.5 % at 10, 60 and 110 deg, by quadrature over the sphere."""
    law = metal(0.35, 0.9)
    cosine, weight = np.polynomial.legendre.leggauss(400)
    turn = (np.arange(800) + 0.5) * 2.0 * np.pi / 800
    normal = np.stack(np.broadcast_arrays(np.sqrt(1.0 - cosine**2)[:, None] * np.cos(turn),
                                          np.sqrt(1.0 - cosine**2)[:, None] * np.sin(turn), cosine[:, None]), axis=-1)
    scene = views.scene([views.sphere(law, subdivisions=5, radius_m=1.0)], [views.camera(128, 5.5e5)], sun_disc=False)
    with Renderer(scene) as renderer:
        for phase_deg in (10.0, 60.0, 110.0):
            angle = np.radians(phase_deg)
            sun, camera = np.array([np.cos(angle), np.sin(angle), 0.0]), np.array([1.0, 0.0, 0.0])
            light = law.brdf(sun, camera, normal) * np.maximum(normal @ sun, 0.0) * np.maximum(normal @ camera, 0.0)
            truth = float((light * weight[:, None]).sum() * 2.0 * np.pi / 800) * views.SOLAR_IRRADIANCE_W_M2 * 1e-8
            image = renderer.render(views.state(phase_deg=phase_deg, range_m=1e4), **options)
            assert image.irradiance_W_m2.sum(dtype=float) == pytest.approx(truth, rel=5e-3), phase_deg


@pytest.mark.parametrize("roughness, subdivisions, is_left_out", [(0.1, 5, True), (0.2, 4, True), (0.35, 5, False)])
def test_highlights_that_facets_break_are_said_to_be_left_out(roughness, subdivisions, is_left_out):
    """Facets of 0.022 rad by a highlight of 0.012 rad; each has its own, where a smooth ball has one."""
    scene = views.scene([views.sphere(metal(roughness), subdivisions=subdivisions, radius_m=1.0)],
                        [views.camera(32, 1.2e5)], sun_disc=False)
    with Renderer(scene) as renderer:
        left_out = renderer.render(views.state(phase_deg=30.0, range_m=1e4)).plan.left_out
    assert any("highlights of a smooth" in line for line in left_out) == is_left_out, left_out


@pytest.mark.parametrize("field, value", [("base_albedo", 1.1), ("metalness", -0.1), ("roughness", 0.05),
                                          ("roughness", np.nan), ("base_albedo", "grey")])
def test_factors_out_of_range_are_refused_by_name(field, value):
    with pytest.raises(ConfigError) as caught:
        Microfacet(**{"base_albedo": 0.5, "metalness": 0.0, "roughness": 0.5, field: value})
    assert caught.value.path == field
