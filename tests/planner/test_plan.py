"""What is modelled of a body, and how bodies are grouped; without GL."""

from __future__ import annotations

import numpy as np
import pytest
from glrender.planner import body_plan as plan
from glrender.planner import error_model
from glrender.view import regions as grouping
from planning import body, traits, view


@pytest.mark.parametrize("phase_deg, is_convex, casters, expected", [
    (60.0, False, (), True), (60.0, True, (), False), (60.0, True, ("moon",), True), (0.0, False, (), False),
    (0.2, False, (), False), (5.0, False, (), True),
])
def test_shadows_only_where_something_can_cast(phase_deg, is_convex, casters, expected):
    planned = body(view(phase_deg=phase_deg), traits(is_convex=is_convex), casters=casters)
    assert (planned.shadow_map_px is not None) == expected


def test_a_map_is_drawn_where_cast_shadows_may_take_more_than_the_flux_s_share():
    """Cast shadows take 6 % of the sunlit surface at 10 deg, in proportion to the phase angle."""
    limit_deg = 0.1 * 0.02 / 0.06 * 10.0
    found = [body(view(phase_deg=times * limit_deg)).shadow_map_px is not None for times in (0.95, 1.05)]
    assert found == [False, True]


def test_a_low_sun_and_a_tight_budget_ask_for_a_finer_shadow_map():
    def size(phase_deg, tolerance=0.02):
        return body(view(phase_deg=phase_deg), tolerance=tolerance).shadow_map_px

    assert size(60.0) <= size(120.0) <= size(150.0) <= plan.SHADOW_SIZES_PX[-1]
    assert size(60.0) < size(150.0)
    assert size(60.0, 0.02) < size(60.0, 0.001)


def test_a_map_of_a_part_has_more_texels_across_the_body_and_no_more_along_a_side():
    whole, part = (body(view(size_px=size_px, phase_deg=150.0, depth_m=(1.0, 200.0)), tolerance=0.001)
                   for size_px in (200.0, np.inf))
    assert whole.shadow_map_px <= plan.MAX_SHADOW_SIDE_PX < part.shadow_map_px


def test_the_sizes_of_shadow_maps():
    """From 256 texels to as many as leave 256 steps of float32 a texel; of a whole body 4096 along a side at most."""
    assert plan.SHADOW_SIZES_PX[0] == 256 and plan.SHADOW_SIZES_PX[-1] == 2**24 // 256
    assert body(view(size_px=800.0), tolerance=1e-6).shadow_map_px == 4096


def test_the_map_is_the_coarsest_whose_edges_and_leaks_are_within_their_shares():
    """One sample a pixel has a squared error of some 0.015 (0.002 to 0.05 of twelve shapes); of that n texels a pixel
    leave n^-3 at the edges of shadows, for 0.4 of the tolerance."""
    sizes = []
    for tolerance in np.geomspace(2e-4, 0.05, 60):
        seen, known = view(size_px=100.0, phase_deg=8.0), traits(crease_rad=0.0)
        size = body(seen, known, tolerance).shadow_map_px

        def fits(texels, tolerance=tolerance, seen=seen, known=known):
            edges = np.sqrt(0.015 * error_model.shadow_share(seen, texels))
            return edges <= 0.4 * tolerance and error_model.leaked_flux(seen, known, texels) <= 0.1 * tolerance

        sizes.append(size)
        assert size == 4096 or fits(size)
        assert size == 256 or not fits(size // 2)
    assert len(set(sizes)) == 5


def test_hard_edges_count_where_there_is_a_shadow_map():
    """The error of a penumbra is part of the modelling error; a body that nothing casts on has none."""
    hard, soft = (body(view(), hard_error=error, own_px=3.0) for error in (0.05, 0.0))
    assert {**soft.modelled, "hard edges": 0.05} == hard.modelled and hard.penumbra.width_px == 3.0
    convex = body(view(), traits(is_convex=True), hard_error=0.05)
    assert convex.shadow_map_px is None and set(convex.modelled) == {"coordinates"}


def test_depth_groups_are_disjoint_and_farthest_first():
    a = view("a", depth_m=(100.0, 200.0))
    b = view("b", depth_m=(150.0, 300.0))
    c = view("c", depth_m=(1e9, 1.1e9))
    d = view("d", depth_m=(10.0, 20.0), is_visible=False)
    groups = grouping.depth_groups([a, b, c, d])
    assert [(near, far, {v.name for v in members}) for near, far, members in groups] == [
        (1e9, 1.1e9, {"c"}), (100.0, 300.0, {"a", "b"})]
