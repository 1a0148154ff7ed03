"""Generated bodies: closed, the right size, the same for the same seed."""

from __future__ import annotations

import numpy as np
import pytest
from glrender import ConfigError, generate


@pytest.mark.parametrize("subdivisions", range(6))
def test_icosphere_volume_and_area_approach_the_spheres(subdivisions):
    """20 * 4^n facets; flux bias -6.1 / n_facets (photometry.md section 3), so area and volume within 13 / n."""
    shape = generate.icosphere(radius_m=2.0, subdivisions=subdivisions)
    count = 20 * 4**subdivisions
    assert len(shape.facets) == count and shape.report.is_watertight
    np.testing.assert_allclose(np.linalg.norm(shape.vertices_m, axis=1), 2.0, rtol=1e-14)
    assert 0.0 < 1.0 - shape.report.volume_m3 / (4 / 3 * np.pi * 8.0) < 13.0 / count
    assert 0.0 < 1.0 - shape.facet_areas_m2.sum() / (16 * np.pi) < 13.0 / count


@pytest.mark.parametrize("kind", ["three_lobes", "contact_binary", "gaussian_random_sphere"])
def test_bodies_are_closed_centred_and_do_not_cut_themselves(kind):
    arguments = {} if kind == "three_lobes" else {"seed": 4}
    shape = getattr(generate, kind)(radius_m=50.0, subdivisions=4, **arguments)
    assert shape.report.is_watertight and shape.report.n_shells == 1 and shape.report.n_flipped == 0
    a, b, c = (shape.vertices_m[shape.facets[:, k]] for k in range(3))
    sixfold = np.einsum("ij,ij->i", a, np.cross(b, c))
    centroid = ((a + b + c) * sixfold[:, None]).sum(axis=0) / (4 * sixfold.sum())
    np.testing.assert_allclose(centroid, 0.0, atol=1e-9 * 50.0)
    if kind != "gaussian_random_sphere":
        np.testing.assert_allclose(shape.radius_m, 50.0, rtol=1e-12)


def test_a_radius_over_the_sphere_has_every_facet_seen_from_its_pole():
    """Star-shaped about the point of generation: solid angles are all of one sign and sum to 4 pi."""
    shape = generate.contact_binary(radius_m=50.0, seed=4, subdivisions=5)
    from glrender.scene.shape.convex_hull import winding_number

    inside = shape.vertices_m.mean(axis=0)
    np.testing.assert_allclose(winding_number(shape.vertices_m, shape.facets, inside), 1.0, atol=1e-9)
    np.testing.assert_allclose(winding_number(shape.vertices_m, shape.facets, np.array([0, 0, 80.0])), 0.0, atol=1e-9)


@pytest.mark.parametrize("kind", ["contact_binary", "gaussian_random_sphere"])
def test_equal_seeds_give_equal_bodies_and_others_do_not(kind):
    first, again, other = (getattr(generate, kind)(radius_m=1.0, seed=seed, subdivisions=3).vertices_m.tobytes()
                           for seed in (1, 1, 2))
    assert first == again != other


def test_gaussian_random_sphere_has_its_standard_deviation():
    """Radius: mean 1 and sigma 0.15 over many seeds, within the scatter of 40 bodies."""
    radii = np.array([np.linalg.norm(generate.gaussian_random_sphere(
        radius_m=1.0, sigma=0.15, correlation_deg=25.0, seed=seed, subdivisions=3).vertices_m, axis=1)
        for seed in range(40)])
    np.testing.assert_allclose(radii.mean(), 1.0, atol=0.03)
    np.testing.assert_allclose(radii.std(), 0.15, rtol=0.15)


def test_relief_keeps_the_old_vertices_and_quadruples_the_facets():
    base = generate.three_lobes(radius_m=10.0, subdivisions=3)
    rough = generate.subdivide_with_relief(base, levels=2, relief=0.05, seed=3)
    assert len(rough.facets) == 16 * len(base.facets) and rough.report.is_watertight
    np.testing.assert_allclose(rough.report.volume_m3, base.report.volume_m3, rtol=0.02)
    assert rough.facet_areas_m2.sum() > base.facet_areas_m2.sum()


def test_wrong_arguments_are_refused_by_name():
    for arguments, message in (({"radius_m": 0.0}, "radius_m"), ({"radius_m": 1.0, "seed": -1}, "seed"),
                               ({"radius_m": 1.0, "subdivisions": 12}, "subdivisions"),
                               ({"radius_m": 1.0, "n_craters": 1.5}, "n_craters")):
        with pytest.raises(ConfigError, match=message):
            generate.contact_binary(**arguments)
