"""Chunks that are left out would have drawn nothing; shadow maps cover what is seen, in finer texels."""

from __future__ import annotations

import numpy as np
import pytest
import sweeps
import views
from glrender import Body, Renderer, frames, generate
from glrender.engines.raster import cluster_bounds as chunk_boxes
from glrender.engines.rays.backend import RayTracer
from glrender.scene.shape.clusters import Chunks

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
    """Draw all chunks; which of them the Sun sees stays, so that a shadow map covers the same."""
    for name in ("in_window", "facing_point"):
        monkeypatch.setattr(Chunks, name, lambda chunks, *_: np.ones(len(chunks), bool))
    monkeypatch.setattr(chunk_boxes, "on_mask", lambda boxes, *_: np.ones(len(boxes), bool))


def facets_drawn(monkeypatch):
    """Facets of each draw from now on."""
    drawn = []
    monkeypatch.setattr(Chunks, "runs", lambda chunks, chosen, runs=Chunks.runs: (
        drawn.append(chunks.n_facets(chosen)), runs(chunks, chosen))[1])
    return drawn


@pytest.mark.parametrize("radii, off", PLACES)
def test_what_is_left_out_would_have_drawn_nothing(monkeypatch, radii, off):
    states = [aimed(radii, off, phase_deg, seed) for seed, phase_deg in enumerate([20.0, 70.0, 120.0])]
    products = ["facet_id", "range"]
    with Renderer(scene()) as renderer:
        culled = [renderer.render(state, samples=2, products=products) for state in states]
        everything(monkeypatch)
        renderer.forget_shadow_maps()
        whole = [renderer.render(state, samples=2, products=products) for state in states]
    assert any((image.irradiance_W_m2 > 0.0).any() for image in whole)
    for ours, full in zip(culled, whole, strict=True):
        # The shadow map covers another box then, and its texels lie elsewhere.
        assert (ours.irradiance_W_m2 != full.irradiance_W_m2).mean() < 5e-3
        for name in products:
            np.testing.assert_array_equal(ours.products[name], full.products[name])


@pytest.mark.parametrize("phase_deg, max_error", [(70.0, 0.02), (120.0, 0.025), (150.0, 0.09)])
def test_a_second_pass_and_a_night_side_draw_only_what_they_show(monkeypatch, phase_deg, max_error):
    """Chunks beside the pixels that are drawn again; dark ones before nothing that is lit."""
    drawn = facets_drawn(monkeypatch)
    state = views.state(phase_deg=phase_deg, direction=(0.1, 0.9, 0.3))
    large = views.scene([Body(name="body", shape=SHAPE, brdf=sweeps.GREY)], [views.camera(256, 1500.0)])
    with Renderer(large) as renderer:
        ours = renderer.render(state, max_error=max_error, engine="raster")
        n_ours = sum(drawn)
        everything(monkeypatch)
        whole = renderer.render(state, max_error=max_error, engine="raster")
    assert ours.plan.windows[0].refined_samples
    assert n_ours < 0.85 * (sum(drawn) - n_ours)
    np.testing.assert_array_equal(ours.irradiance_W_m2, whole.irradiance_W_m2)


def test_boxes_hold_their_chunks():
    """Every vertex in view is in its chunk's box; beside the camera a box has no end."""
    chunks = Chunks(SHAPE.vertices_m, SHAPE.facets)
    corners = SHAPE.vertices_m[SHAPE.facets][chunks.order]
    rng = np.random.default_rng(3)
    for radii in (0.3, 1.2, 2.0, 30.0):
        place = radii * SHAPE.radius_m * rng.standard_normal(3)
        camera_from_body = frames.dcm(frames.look_at(place, rng.standard_normal(3) * 30.0))
        boxes = chunks.boxes_px(camera_from_body, place, 700.0, (90.0, 40.0))
        point = (corners - place) @ camera_from_body.T
        before = point[..., 2] > 1e-9
        pixel = point[..., :2] / np.where(before, point[..., 2], 1.0)[..., None] * 700.0 + (90.0, 40.0)
        each = np.repeat(np.arange(len(chunks)), [count for chunk in np.eye(len(chunks), dtype=bool)
                                                  for _, count in chunks.runs(chunk)])
        box = boxes[each][:, None]
        inside = ((pixel >= box[..., :2] - 1e-6) & (pixel <= box[..., 2:] + 1e-6)).all(axis=-1)
        assert (inside | ~before).all()


@pytest.mark.parametrize("seed", range(10))
def test_boxes_on_a_mask(seed):
    """Against every pixel: none that touches is left out, and few more are kept."""
    rng = np.random.default_rng(seed)
    bounds = (9.5, -0.5, 209.5, 149.5)
    low = rng.uniform(-50.0, 250.0, (400, 2))
    boxes = np.concatenate([low, low + rng.uniform(0.0, 12.0, (400, 2))], axis=1)
    boxes[0] = (-np.inf, -np.inf, np.inf, np.inf)
    mask = (rng.random((150, 200)) < 1e-3).astype(np.uint8)
    y, x = np.nonzero(mask)
    x0, y0, x1, y1 = boxes.T[..., None]
    touches = ((x0 < x + 10.5) & (x1 > x + 9.5) & (y0 < y + 0.5) & (y1 > y - 0.5)).any(axis=1)
    kept = chunk_boxes.on_mask(boxes, mask, bounds)
    np.testing.assert_array_equal(kept, touches)


def test_close_up_few_facets_are_drawn(monkeypatch):
    assert len(Chunks(SHAPE.vertices_m, SHAPE.facets)) > 100
    drawn, counts = facets_drawn(monkeypatch), []
    with Renderer(scene(1000.0)) as renderer:
        for radii in (1.3, 5.0, 30.0):
            renderer.render(aimed(radii, 0.3, 60.0, 1), samples=1)
            counts.append(drawn[-1])
    assert counts[0] < 0.2 * len(SHAPE.facets) and counts[0] < counts[1] < counts[2]


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


def test_close_up_shadows_are_finer():
    """A small part of the body in view: more texels across the body than a map has."""
    state = aimed(1.6, 0.3, 100.0, 8)
    with Renderer(scene(1500.0)) as renderer, RayTracer(scene(1500.0)) as tracer:
        exact = tracer.render(state, samples=9).irradiance_W_m2.astype(float)
        image = renderer.render(state, samples=6, max_error=0.005)
    body = image.plan.bodies[0]
    assert body.shadow_map_px > 4096 and max(body.shadow_map_drawn_px) < 0.6 * body.shadow_map_px
    assert views.relative_rms(image.irradiance_W_m2.astype(float), exact) < 0.02
