"""The bodies of a renderer with what their engines hold of them."""

from __future__ import annotations

import gc
import pickle
import weakref
from dataclasses import replace

import pytest
import views
from glrender import Body, DeviceError, Renderer, generate
from glrender.brdf import Lambert
from missing import needed_module

SHAPE = generate.icosphere(radius_m=100.0, subdivisions=4)
BODY = Body(name="body", shape=SHAPE, brdf=Lambert(normal_albedo=0.3))


def memory(*bodies):
    with Renderer(views.scene(bodies, [views.camera(32, 100.0)])) as renderer:
        return renderer.info["memory_bytes"]


def test_a_body_s_memory_is_that_of_its_arrays():
    """V corners and F facets: float64 and int32 in the shape; float32 and int32 on the device, and some uniforms.

    What float32 leaves of the corners is kept in float64 for views from near.
    """
    needed_module("embreex", "pip install embreex")
    n_vertices, n_facets = len(SHAPE.vertices_m), len(SHAPE.facets)
    found = memory(BODY)["body"]
    assert found["shape"] == 24 * n_vertices + 12 * n_facets
    assert 0 <= found["raster"] - 36 * n_vertices - 12 * n_facets < 20_000
    # A normal, an offset and an error of float64 each.
    assert found["rays"] == 40 * n_facets
    with Renderer(views.scene([BODY], [views.camera(32, 100.0)])) as renderer:
        assert renderer._bodies["body"].solid.normals is SHAPE.facet_normals, "worked out once, and held once"
    # At least numbers, corners, normals and neighbours.
    assert found["coverage"] > (8 + 24 + 24 + 12) * n_facets


def test_memory_is_in_proportion_to_facets_and_is_each_body_s_own():
    coarser = replace(BODY, name="coarser", shape=generate.icosphere(radius_m=100.0, subdivisions=3))
    both = memory(coarser, BODY)
    assert both["body"] == memory(BODY)["body"]
    for part in ("shape", "rays", "coverage"):
        assert both["body"][part] == pytest.approx(4 * both["coarser"][part], rel=0.01), part


def test_what_coverage_holds_of_bodies_that_it_does_not_draw_counts():
    """Of few facets the tables, which show what samples pass by; nothing of 10,000 and more."""
    finer = generate.icosphere(radius_m=100.0, subdivisions=5)
    for shape, least in ((SHAPE, 68 * len(SHAPE.facets)), (finer, 0)):
        found = memory(replace(BODY, shape=shape, smooth_normals=True))["body"]["coverage"]
        assert (found > least) if least else found == 0


def test_an_image_with_derivatives_holds_no_tables_of_a_closed_renderer_and_can_be_sent():
    with Renderer(views.scene([BODY], [views.camera(32, 100.0)])) as renderer:
        image = renderer.render(views.state(), derivatives=["spacecraft"])
        held = weakref.ref(renderer._bodies["body"].solid)
    gc.collect()
    assert held() is None and image.gradient is not None
    with pytest.raises(DeviceError, match="this renderer is closed; open another"):
        image.gradient(image.irradiance_W_m2)
    sent = pickle.loads(pickle.dumps(image))
    assert sent.gradient is None and (sent.irradiance_W_m2 == image.irradiance_W_m2).all()
    assert (sent.jacobian["spacecraft"] == image.jacobian["spacecraft"]).all()
