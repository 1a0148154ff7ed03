"""A shape's uncertainty in what a frame lets be known: an inflated sphere in closed form, fits to deformed shapes."""

from __future__ import annotations

import pickle
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import views
from glrender import Body, Renderer, generate
from glrender.base.errors import ConfigError, DeviceError
from glrender.brdf import Lambert
from glrender_camera import CameraModel, Detector, Optics

CAMERA = views.camera(40, 250.0, model=CameraModel(
    optics=Optics(aperture_diameter_m=0.02, psf_sigma_px=0.8, transmission=7e-6), exposure_s=0.004, detector=Detector(
        quantum_efficiency=0.6, full_well_electrons=5e4, gain_DN_per_electron=0.08, bit_depth=12, offset_DN=60.0,
        read_noise_electrons=20.0)))
STATE = views.state(phase_deg=60.0, range_m=2000.0)
PLACE = {"spacecraft": (0, 1, 2)}
SPHERE = generate.icosphere(radius_m=100.0, subdivisions=2)


def scene(shape=SPHERE):
    return views.scene([Body(name="body", brdf=Lambert(normal_albedo=0.3), shape=shape)], [CAMERA], sun_disc=False)


@cache
def found(shape_sigma):
    with Renderer(scene()) as renderer:
        return renderer.render(STATE, derivatives=["spacecraft"], max_error=0.01).information(
            components=PLACE, shape_sigma=shape_sigma)


def test_a_sphere_of_unknown_radius_hides_its_range():
    """Heights that all go together inflate it: the range errs by the same share, and nothing else does."""
    alone, known = found(None), found((0.5, 1e6))
    along, noise = known.in_pixels, alone.in_pixels
    np.testing.assert_allclose(along["spacecraft[2]"], np.hypot(0.5, noise["spacecraft[2]"]), rtol=3e-3)
    np.testing.assert_allclose(along["spacecraft[0]"], noise["spacecraft[0]"], rtol=0.05)
    np.testing.assert_allclose(known.matrix @ known.covariance, np.eye(3), atol=1e-6)
    np.testing.assert_array_equal(found((0.0, 30.0)).covariance, alone.covariance)


def test_what_is_alike_within_facets_alone_is_each_vertex_on_its_own():
    """With a correlation length far below the facets' sides variances of the vertices add up."""
    with Renderer(scene()) as renderer:
        image = renderer.render(STATE, derivatives=["spacecraft"], max_error=0.01)
        known = image.information(components=PLACE, shape_sigma=(0.5, 0.01))
        by_heights = [image.gradient(each)["body"].heights_m for each in found(None).fit.pixel_weights()]
    expected = 0.25 * np.array(by_heights) @ np.transpose(by_heights)
    added = known.covariance - found(None).covariance
    np.testing.assert_allclose(added, expected, atol=1e-4 * expected.max())


@pytest.mark.slow
def test_fits_to_shapes_deformed_at_random_scatter_so():
    """400 contact binaries with shadows, whose heights go together over a fifth of the radius."""
    height_m, length_m, n_shapes = 0.3, 20.0, 400
    shape = generate.contact_binary(radius_m=100.0, seed=7, subdivisions=3)
    with Renderer(scene(shape)) as renderer:
        image = renderer.render(STATE, derivatives=["spacecraft"], max_error=0.005)
        known, alone = (image.information(components=PLACE, shape_sigma=each) for each in ((height_m, length_m), None))
    squared = np.square(shape.vertices_m[:, None] - shape.vertices_m).sum(axis=-1)
    values, axes = np.linalg.eigh(height_m**2 * np.exp(-0.5 * squared / length_m**2))
    generator, errors = np.random.default_rng(0), []
    for _ in range(n_shapes):
        heights_m = axes @ (np.sqrt(np.maximum(values, 0.0)) * generator.standard_normal(len(values)))
        deformed = shape.with_vertices(shape.vertices_m + heights_m[:, None] * shape.vertex_normals)
        with Renderer(scene(deformed)) as renderer:
            other = renderer.render(STATE, derivatives=["focal_length"], max_error=0.005)
        errors.append(list(known.cost_of(other).values()))
    scattered, factors = np.array(errors).T @ np.array(errors) / n_shapes, known.in_pixels_per_unit
    expected = (known.covariance - alone.covariance) * factors * factors[:, None]
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(scattered / scale / scale[:, None], expected / scale / scale[:, None], atol=0.15)


@pytest.mark.parametrize("shape_sigma, message", [
    (3.0, "shape_sigma: must be two lengths"), ((1.0,), "must be two lengths"), ("12", "must be two lengths"),
    ((-1.0, 3.0), r"shape_sigma\[0\]: must be >= 0"), ((1.0, 0.0), r"shape_sigma\[1\]: must be > 0"),
    ((np.nan, 1.0), r"shape_sigma\[0\]"), (("a", 1.0), r"shape_sigma\[0\]")])
def test_bad_lengths(shape_sigma, message):
    with pytest.raises(ConfigError, match=message):
        found(shape_sigma)


def test_a_closed_renderer_is_said():
    with Renderer(scene()) as renderer:
        image = renderer.render(STATE, derivatives=["spacecraft"])
    with pytest.raises(DeviceError, match="closed"):
        image.information(shape_sigma=(1.0, 10.0))
    sent = pickle.loads(pickle.dumps(image))
    assert sent.gradient is None and sent.information(components=PLACE).sigmas == found(None).sigmas
    with pytest.raises(ConfigError, match="shape_sigma"):
        replace(image, gradient=None).information(shape_sigma=(1.0, 10.0))
