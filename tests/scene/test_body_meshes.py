"""What the planner knows of a body: by its law, against finite differences of images of a sphere."""

from __future__ import annotations

import math

import numpy as np
import pytest
from glrender import Body, generate
from glrender.brdf import Lambert, LommelSeeliger, Microfacet
from glrender.engines.raster.meshes import body_traits, view_slope


def test_a_lambert_surface_is_as_bright_from_everywhere():
    assert view_slope(Lambert(normal_albedo=0.3), 60) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("phase_deg", [1, 3, 10, 30, 60, 90, 120, 148])
def test_the_slope_of_lommel_seeliger_is_a_finite_difference(phase_deg):
    """Its radiance goes as 1 / (mu0 + mu): its relative change with a tilt of the view is known, all over a sphere."""
    phase_rad, step_rad = math.radians(phase_deg), 1e-5
    rng = np.random.default_rng(phase_deg)
    normal = rng.standard_normal((400_000, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    to_sun = np.array([math.sin(phase_rad), 0.0, math.cos(phase_rad)])
    mu0, mu = normal @ to_sun, normal[:, 2]
    lit = (mu0 > 0.0) & (mu > 1e-3)
    mu0, mu, normal = mu0[lit], mu[lit], normal[lit]
    squared = 0.0
    for axis in range(2):
        tilted = (normal[:, axis] * step_rad + normal[:, 2]) / math.hypot(1.0, step_rad)
        squared += np.where(tilted > 0.0, ((mu0 + mu) / (mu0 + tilted) - 1.0) / step_rad, 0.0) ** 2
    light = mu * mu0 / (mu0 + mu)
    assert view_slope(LommelSeeliger(single_scattering_albedo=0.3), phase_deg) == pytest.approx(
        math.sqrt((light * squared).sum() / light.sum()), rel=0.05)


@pytest.mark.parametrize("roughness, phase_deg", [(0.1, 60), (0.1, 5), (0.2, 100)])
def test_the_slope_of_a_narrow_highlight_is_that_of_its_lobe(roughness, phase_deg):
    """By a fine grid of normals about the bisector, as wide as 30 lobes: 5 % less to 15 % more."""
    law = Microfacet(base_albedo=0.9, metalness=1.0, roughness=roughness)
    half_rad, step_rad = 0.5 * math.radians(phase_deg), 1e-5
    aside = np.sinh(np.linspace(-6.0, 6.0, 301)) / math.sinh(6.0) * math.sin(min(30.0 * roughness**2, 0.5))
    y, z = (axis.ravel() for axis in np.meshgrid(aside, aside))
    weight = np.outer(np.gradient(aside), np.gradient(aside)).ravel() / np.sqrt(1.0 - y * y - z * z)
    normal = np.stack([np.sqrt(1.0 - y * y - z * z), y, z], axis=1)
    sun, camera = (np.array([math.cos(half_rad), side * math.sin(half_rad), 0.0]) for side in (1.0, -1.0))
    here = law.brdf(sun, camera, normal)
    light, squared = weight * here * np.maximum(normal @ sun, 0.0) * np.maximum(normal @ camera, 0.0), 0.0
    for way in (np.array([math.sin(half_rad), math.cos(half_rad), 0.0]), np.array([0.0, 0.0, 1.0])):
        squared += ((law.brdf(sun, camera + step_rad * way, normal) / np.maximum(here, 1e-300) - 1.0) / step_rad) ** 2
    truth = math.sqrt((light * squared)[here > 0.0].sum() / light.sum())
    assert 0.95 * truth < view_slope(law, phase_deg) < 1.15 * truth and truth > 10.0


def test_facets_that_are_not_as_bright_all_over_have_no_size():
    """Those of an icosphere of 100 m: 4 pi r^2 over their number, within the facets' own spread."""
    shape = generate.icosphere(radius_m=100.0, subdivisions=3)
    law = Lambert(normal_albedo=0.3)
    flat, smooth = (body_traits(Body(name="body", shape=shape, brdf=law, smooth_normals=is_smooth))
                    for is_smooth in (False, True))
    assert flat.facet_m == pytest.approx(math.sqrt(4.0 * math.pi * 1e4 / len(shape.facets)), rel=0.03)
    assert smooth.facet_m == math.inf and flat.n_facets == len(shape.facets) == 1280
