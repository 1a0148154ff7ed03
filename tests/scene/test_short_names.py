"""A scene at a Python prompt is a line, not its arrays."""

from __future__ import annotations

import views
from glrender import Body, generate
from glrender.brdf import Lambert


def test_scenes_bodies_and_shapes_are_named_in_a_line():
    shape = generate.icosphere(radius_m=100.0, subdivisions=2)
    body = Body(name="rock", shape=shape, brdf=Lambert(normal_albedo=0.1))
    text = repr(views.scene([body], [views.camera(200, 1500.0)]))
    for part in ("rock", "320 facets, 200 x 200 x 200 m", "Lambert", "200 x 200 px", "max_error"):
        assert part in text
    assert repr(shape) in repr(body) and repr(body) in text and len(text) < 200 and "array" not in text
