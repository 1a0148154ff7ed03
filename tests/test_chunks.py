"""Chunks that are left out would have drawn nothing; shadow maps cover what is seen, in finer texels."""

from __future__ import annotations

import numpy as np
import pytest
import sweeps
import views
from glrender import Body, Renderer, generate
from glrender.backends.raytrace import RayTracer
from glrender.chunks import Chunks
from glrender.shadow_box import shadow_box

SHAPE = generate.contact_binary(radius_m=100.0, seed=4, subdivisions=6)
PLACES = [(1.02, 0.5), (1.1, 0.5), (1.5, 0.9), (3.0, 0.2), (20.0, 0.0)]


def scene(focal_length_px=300.0):
    return views.scene([Body(name="body", shape=SHAPE, brdf=sweeps.GREY)], [views.camera(96, focal_length_px)])


def aimed(radii, off, phase_deg, seed):
    """A camera so many radii away that looks past the body's middle."""
    rng = np.random.default_rng(seed)
    target = off * SHAPE.radius_m * rng.uniform(-1.0, 1.0, 3)
    return views.state(phase_deg=phase_deg, range_m=radii * SHAPE.radius_m, target=target,
                       direction=rng.standard_normal(3))


def everything(monkeypatch):
    for name in ("in_window", "facing_point", "facing_direction"):
        monkeypatch.setattr(Chunks, name, lambda chunks, _: np.ones(len(chunks), bool))


@pytest.mark.parametrize("radii, off", PLACES)
@pytest.mark.parametrize("level", [0, 1])
def test_what_is_left_out_would_have_drawn_nothing(monkeypatch, radii, off, level):
    states = [aimed(radii, off, phase_deg, seed) for seed, phase_deg in enumerate([20.0, 70.0, 120.0])]
    products = ["facet_id", "range"]
    with Renderer(scene()) as renderer:
        # The shadow map's box is held, so that its texels are the same.
        monkeypatch.setattr("glrender.shadows.shadow_box",
                            lambda low, high, seen, texels: shadow_box(low, high, None, min(texels, 4096)))
        culled = [renderer.render(state, samples=2, level=level, products=products) for state in states]
        assert len(renderer._meshes["body"][0].chunks) > 100
        everything(monkeypatch)
        renderer.forget_shadow_maps()
        whole = [renderer.render(state, samples=2, level=level, products=products) for state in states]
    assert any((image.irradiance_W_m2 > 0.0).any() for image in whole)
    for ours, full in zip(culled, whole, strict=True):
        np.testing.assert_array_equal(ours.irradiance_W_m2, full.irradiance_W_m2)
        for name in products:
            np.testing.assert_array_equal(ours.products[name], full.products[name])


def test_close_up_few_facets_are_drawn():
    with Renderer(scene(1000.0)) as renderer:
        shares = [renderer.render(aimed(radii, 0.3, 60.0, 1), samples=1).plan.bodies[0].shown_share
                  for radii in (1.3, 5.0, 30.0)]
    assert shares[0] < 0.2 and shares[0] < shares[1] < 1.0 and shares[2] == 1.0


def test_facets_keep_their_numbers():
    """The mesh's order is its own affair."""
    state = aimed(3.0, 0.2, 60.0, 5)
    with Renderer(scene()) as renderer, RayTracer(scene()) as tracer:
        drawn = renderer.render(state, products=["facet_id"], samples=1).products["facet_id"]
        exact = tracer.render(state, products=["facet_id"], samples=1).products["facet_id"]
    assert len(np.unique(exact)) > 100
    assert np.mean(drawn == exact) > 0.99


def test_cones_hold_their_normals():
    """From directions all round, no chunk that is left out has a facet that faces there."""
    chunks = Chunks(SHAPE.vertices_m, SHAPE.facets)
    normals = SHAPE.facet_normals[chunks.order]
    middles = SHAPE.vertices_m[SHAPE.facets].mean(axis=1)[chunks.order]
    rng, n_left_out = np.random.default_rng(0), 0
    for direction in rng.standard_normal((50, 3)):
        direction /= np.linalg.norm(direction)
        for kept, towards in ((chunks.facing_direction(direction), direction[None]),
                              (chunks.facing_point(150.0 * direction), 150.0 * direction - middles)):
            faces = np.einsum("fx,fx->f", normals, np.broadcast_to(towards, normals.shape)) > 0.0
            n_left_out += np.count_nonzero(~kept)
            drawn = np.zeros(len(faces), bool)
            for first, count in chunks.runs(kept):
                drawn[first:first + count] = True
            assert chunks.n_facets(kept) == np.count_nonzero(drawn)
            assert not (faces & ~drawn).any()
    assert n_left_out > 1000


@pytest.mark.parametrize("seed", range(20))
def test_a_shadow_box_holds_what_is_seen(seed):
    rng = np.random.default_rng(seed)
    low, high = -rng.uniform(50.0, 100.0, 3), rng.uniform(50.0, 100.0, 3)
    centre, half = rng.uniform(low, high), rng.uniform(0.0, 1.0) ** 3 * (high - low)
    seen = np.maximum(centre - half, low), np.minimum(centre + half, high)
    box = shadow_box(low, high, seen, 4096)
    margin = 1.9 * box.texel_m
    assert (box.low_m[:2] <= seen[0][:2] - margin).all() and (box.high_m[:2] >= seen[1][:2] + margin).all()
    np.testing.assert_allclose((box.high_m - box.low_m)[:2], np.array(box.size_px) * box.texel_m)
    np.testing.assert_allclose(box.texel_m, (high - low)[:2] / 4096)
    # No more than a step, at most a quarter of the larger side, on each side of it.
    sides = (seen[1] - seen[0])[:2] / box.texel_m
    assert (np.array(box.size_px) <= sides + 2.0 * max(0.25 * sides.max(), 16.0) + 6.0).all()


def test_close_up_shadows_are_finer(monkeypatch):
    """A small part of the body in view: more texels across the body than a map has, and it is kept for a drift."""
    state, drifted = (aimed(radii, 0.3, 100.0, 8) for radii in (1.6, 1.6005))
    with Renderer(scene(1500.0)) as renderer, RayTracer(scene(1500.0)) as tracer:
        exact = tracer.render(state, samples=9).irradiance_W_m2.astype(float)
        image = renderer.render(state, samples=6, max_error=0.005)
        again = renderer.render(drifted, samples=6, max_error=0.005)
        monkeypatch.setattr("glrender.plan.SHADOW_SIZES_PX", (4096,))
        renderer.forget_shadow_maps()
        coarse = renderer.render(state, samples=6, max_error=0.005)
    body = image.plan.bodies[0]
    assert body.shadow_map_px > 4096 and max(body.shadow_map_drawn_px) < 0.6 * body.shadow_map_px
    assert again.plan.bodies[0].shadow_map_reused
    lit = exact > 0.0
    fine, old = (np.sqrt(np.mean((drawn.irradiance_W_m2 - exact)[lit] ** 2)) for drawn in (image, coarse))
    assert fine < 0.75 * old
