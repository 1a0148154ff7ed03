"""Close up, shadow maps cover what is seen, in finer texels; facets keep their numbers."""

from __future__ import annotations

import numpy as np
import sweeps
import views
from glrender import Body, Renderer
from glrender.engines.rays.backend import RayTracer


def scene(focal_length_px=300.0):
    body = Body(name="body", shape=views.binary(4), brdf=sweeps.GREY)
    return views.scene([body], [views.camera(96, focal_length_px)])


def aimed(radii, off, phase_deg, seed):
    """A camera so many radii away that looks past the body's middle."""
    rng = np.random.default_rng(seed)
    radius_m = views.binary(4).radius_m
    target = off * radius_m * rng.uniform(-1.0, 1.0, 3)
    return views.state(phase_deg=phase_deg, range_m=radii * radius_m, target=target,
                       direction=rng.standard_normal(3))


def test_facets_keep_their_numbers():
    state = aimed(3.0, 0.2, 60.0, 5)
    with Renderer(scene()) as renderer, RayTracer(scene()) as tracer:
        drawn = renderer.render(state, products=["facet_id"], samples=1).products["facet_id"]
        exact = tracer.render(state, products=["facet_id"], samples=1).products["facet_id"]
    assert len(np.unique(exact)) > 100
    assert np.mean(drawn == exact) > 0.99


def test_close_up_shadows_are_finer():
    """A small part of the body in view: more texels across the body than a map has."""
    state = aimed(1.6, 0.3, 100.0, 8)
    with Renderer(scene(1500.0)) as renderer, RayTracer(scene(1500.0)) as tracer:
        exact = tracer.render(state, samples=9).irradiance_W_m2.astype(float)
        image = renderer.render(state, samples=6, max_error=0.005)
    body = image.plan.bodies[0]
    assert body.shadow_map_px > 4096 and max(body.shadow_map_drawn_px) < 0.6 * body.shadow_map_px
    assert views.relative_rms(image.irradiance_W_m2.astype(float), exact) < 0.02
