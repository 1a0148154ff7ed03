"""What is modelled of a body, and how bodies are grouped; without GL."""

from __future__ import annotations

import numpy as np
import pytest
import views
from glrender.planner import body_plan as plan
from glrender.planner.error_model import BodyTraits
from glrender.view import regions as grouping
from glrender.view.view import BodyView


def view(name="body", size_px=200.0, phase_deg=60.0, bounds_px=None, depth_m=(900.0, 1100.0), is_visible=True):
    """A body's view, as large as it is asked for; of infinite size it reaches beside the camera."""
    if bounds_px is None and np.isfinite(size_px):
        bounds_px = np.array([100.0, 80.0, 100.0 + size_px, 80.0 + 0.8 * size_px])
    return BodyView(name=name, camera_from_body=np.eye(3), r_camera_body_m=np.array([0.0, 0.0, -1000.0]),
                    sun_direction_body=np.array([0.0, 0.0, -1.0]), sun_distance_au=1.0, range_m=1000.0,
                    phase_rad=np.radians(phase_deg), depth_m=depth_m, bounds_px=bounds_px, is_visible=is_visible,
                    is_whole=bool(np.isfinite(size_px)))


CAMERA = views.camera(1024, 1000.0)


def traits(n_facets=50_000, crease_rad=0.15, facet_m=0.3, **known):
    """Of a body of 100 m with flat facets; `facet_m` infinite for those that are not as bright everywhere."""
    return BodyTraits(**{"radius_m": 100.0, "is_convex": False, "law": "lambert", "max_phase_rad": np.pi,
                         "n_facets": n_facets, "crease_rad": crease_rad, "facet_m": facet_m, **known})


def body(member, known=None, tolerance=0.02, casters=(), **given):
    return plan.plan_body(member, known or traits(), CAMERA, casters, tolerance, **given)


@pytest.mark.parametrize("phase_deg, is_convex, casters, expected", [
    (60.0, False, (), True), (60.0, True, (), False), (60.0, True, ("moon",), True), (0.0, False, (), False),
    (0.2, False, (), False), (5.0, False, (), True),
])
def test_shadows_only_where_something_can_cast(phase_deg, is_convex, casters, expected):
    planned = body(view(phase_deg=phase_deg), traits(is_convex=is_convex), casters=casters)
    assert (planned.shadow_map_px is not None) == expected


def test_a_low_sun_and_a_tight_budget_ask_for_a_finer_shadow_map():
    def size(phase_deg, tolerance=0.02):
        return body(view(phase_deg=phase_deg), tolerance=tolerance).shadow_map_px

    assert size(60.0) <= size(120.0) <= size(150.0) <= plan.SHADOW_SIZES_PX[-1]
    assert size(60.0) < size(150.0)
    assert size(60.0, 0.02) < size(60.0, 0.001)


def test_a_map_of_a_part_has_more_texels_across_the_body_and_no_more_along_a_side():
    whole, part = (body(view(phase_deg=150.0), tolerance=0.001, seen_share=share) for share in (1.0, 0.05))
    assert whole.shadow_map_px <= plan.MAX_SHADOW_SIDE_PX < part.shadow_map_px
    assert 0.05 * part.shadow_map_px <= plan.MAX_SHADOW_SIDE_PX and part.modelling_error < whole.modelling_error


def test_hard_edges_count_where_there_is_a_shadow_map():
    """The error of a penumbra is part of the modelling error; a body that nothing casts on has none."""
    hard, soft = (body(view(), penumbra=(error, 3.0)) for error in (0.05, 0.0))
    assert hard.modelling_error == pytest.approx(np.hypot(soft.modelling_error, 0.05)) and hard.penumbra_px == 3.0
    convex = body(view(), traits(is_convex=True), penumbra=(0.05, 3.0))
    assert convex.shadow_map_px is None and convex.modelling_error == convex.penumbra_error == 0.0


def test_depth_groups_are_disjoint_and_farthest_first():
    a = view("a", depth_m=(100.0, 200.0))
    b = view("b", depth_m=(150.0, 300.0))
    c = view("c", depth_m=(1e9, 1.1e9))
    d = view("d", depth_m=(10.0, 20.0), is_visible=False)
    groups = grouping.depth_groups([a, b, c, d])
    assert [(near, far, {v.name for v in members}) for near, far, members in groups] == [
        (1e9, 1.1e9, {"c"}), (100.0, 300.0, {"a", "b"})]
