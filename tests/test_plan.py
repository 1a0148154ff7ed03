"""The planner, without GL: what it decides and why."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
import views
from glrender import grouping, plan, plan_windows
from glrender.costs import EngineCosts
from glrender.eclipses import Eclipse
from glrender.error_model import NOISE_FACETS, BodyTraits, LevelTraits
from glrender.first_samples import Expected, first_samples
from glrender.lattice import cell_error
from glrender.lod_flux import PHASES_RAD, FluxRatio
from glrender.ray_engine import RAYS_AT_ONCE
from glrender.view import BodyView, snapped


def view(name="body", size_px=200.0, phase_deg=60.0, bounds_px=None, depth_m=(900.0, 1100.0), is_visible=True):
    if bounds_px is None and np.isfinite(size_px):
        bounds_px = np.array([100.0, 80.0, 100.0 + size_px, 80.0 + 0.8 * size_px])
    return BodyView(name=name, camera_from_body=np.eye(3), r_camera_body_m=np.array([0.0, 0.0, -1000.0]),
                    sun_direction_body=np.array([0.0, 0.0, -1.0]), sun_distance_au=1.0, range_m=1000.0,
                    phase_rad=np.radians(phase_deg), depth_m=depth_m, bounds_px=bounds_px, is_visible=is_visible,
                    is_whole=bool(np.isfinite(size_px)))


CAMERA = views.camera(1024, 1000.0)


FULL = LevelTraits(n_facets=50_000, crease_rad=0.15)
RATIO = FluxRatio(mean=np.full(len(PHASES_RAD), 1.01), scatter=np.full(len(PHASES_RAD), 2e-3))
COARSE = LevelTraits(n_facets=12_000, crease_rad=0.15, deviation_m=0.1, flux_ratio=RATIO)


def traits(*levels, is_convex=False):
    return BodyTraits(radius_m=100.0, is_convex=is_convex, law="lambert", max_phase_rad=np.pi, levels=levels)


def body(member, *levels, budget=0.02, level=None, is_convex=False, casters=()):
    return plan.plan_body(member, traits(*(levels or (FULL,)), is_convex=is_convex), CAMERA, casters, budget, level)


RASTER = EngineCosts(facet_ns=140.0, sample_ns=13.0, ray_ns=np.inf)


def windows(members, max_error=0.02, gain=1.0, samples=None, costs=RASTER):
    bodies = [body(member, budget=max_error / gain) for member in members]
    known = {member.name: traits(FULL) for member in members}
    choices = plan_windows.plan_windows(members, known, bodies, CAMERA, max_error, gain, costs, samples)
    return tuple(choice.first for choice in choices)


def test_a_tighter_budget_asks_for_more_samples():
    """One sample a pixel is enough for a loose budget; a tight one starts with more, or draws again."""
    costs = []
    for budget in (0.5, 0.1, 0.05, 0.02, 0.01, 0.003):
        window, = windows([view()], budget)
        assert window.predicted_error <= budget or window.budget < window.predicted_error
        costs.append(window.samples)
    assert costs[0] == 1 and costs[-1] > 2


def test_bodies_apart_cover_no_more_than_one():
    """Eight of 20 px would cost eight times what one does: none is apart; of small ones all are."""
    one, eight = [view(size_px=20.0, phase_deg=0.0)], [view(f"{k}", size_px=20.0, phase_deg=0.0) for k in range(8)]
    assert plan_windows.apart_limit(one, 24.0) == plan_windows.apart_limit([], 24.0) == 24.0
    assert plan_windows.apart_limit(eight, 24.0) == 20.0
    assert plan_windows.apart_limit([view(f"{k}", size_px=8.0) for k in range(8)], 24.0) == 24.0
    assert plan_windows.apart_limit([*eight, view("moon", size_px=3.0)], 24.0) == 20.0
    assert plan_windows.apart_limit(eight, 0.0) == 0.0


@pytest.mark.parametrize("phase_deg, size_px", [(0.0, 24.0), (60.0, 27.7), (110.0, 41.8), (150.0, 92.7), (175.0, 96.0)])
def test_crescents_are_apart_while_they_have_no_more_pixels_than_a_disc(phase_deg, size_px):
    """24 px / cos(g / 2), at most 96: closed form; two that touch are as large as both, at the fuller one's phase."""
    sizes = [plan_windows.apart_size_px([view(size_px=size_px + d, phase_deg=phase_deg)]) for d in (-0.1, 0.1)]
    assert sizes[0] < 24.0 < sizes[1]
    both = [view(size_px=10.0, phase_deg=170.0), view(size_px=20.0, phase_deg=phase_deg)]
    np.testing.assert_allclose(plan_windows.apart_size_px(both), plan_windows.apart_size_px(both[1:]))
    assert np.isinf(plan_windows.apart_size_px([view(size_px=np.inf)]))


def test_a_psf_that_smooths_the_error_saves_samples():
    sharp, = windows([view()], 0.01)
    smooth, = windows([view()], 0.01, gain=0.3)
    assert smooth.samples < sharp.samples


def test_a_fixed_count_of_samples_is_never_refined():
    window, = windows([view()], 0.001, samples=2)
    assert window.samples == 2 and window.budget == np.inf


def test_rays_are_cast_where_they_are_cheaper_or_a_shadow_map_is_too_coarse():
    rays = replace(RASTER, ray_ns=1000.0)
    near = view(size_px=800.0)
    assert windows([near], costs=rays)[0].engine == "raster", "400,000 samples"
    assert windows([view(size_px=15.0)], 0.05, costs=rays)[0].engine == "rays", "2 x 50,000 facets for 1,000 samples"
    assert windows([view(size_px=15.0)], 0.05, costs=rays, samples=4)[0].engine == "raster", "as it was asked for"
    inside = view(bounds_px=None, size_px=np.inf)
    coarse, = windows([inside], 0.01)
    assert coarse.predicted_error > 0.01
    exact, = windows([inside], 0.01, costs=rays)
    assert exact.engine == "rays" and exact.modelling_error == 0.0


AREAS = replace(RASTER, ray_ns=400.0, area_ns=160.0)


def area_choice(members, max_error=0.02, samples=None, costs=AREAS, apart_px=0.0, even_facet_m=0.3, **changed):
    bodies = [replace(body(member, budget=max_error), **changed) for member in members]
    known = {member.name: replace(traits(FULL), even_facet_m=even_facet_m) for member in members}
    return plan_windows.plan_windows(members, known, bodies, CAMERA, max_error, 1.0, costs, samples, apart_px)


def test_areas_are_drawn_where_they_are_cheapest_and_rays_stand_by():
    """50,000 facets of 4 px: 15 ms at any budget; 2 x 2 samples are as dear, 8 x 8 are ten times."""
    choice, = area_choice([view(size_px=500.0)])
    assert choice.first.engine == "areas" and choice.by_rays.engine == "rays"
    assert choice.first.grid == tuple(choice.first.roi[k + 2] - choice.first.roi[k] for k in (0, 1))
    assert choice.first.samples == 1 and choice.first.predicted_error <= 0.02
    dear, = area_choice([view(size_px=500.0)], costs=replace(AREAS, area_ns=40_000.0))
    assert dear.first.engine == "raster"
    gpu, = area_choice([view(size_px=500.0)], costs=replace(AREAS, facet_ns=1.0, sample_ns=0.05))
    assert gpu.first.engine == "raster"


def test_areas_are_not_drawn_of_what_they_do_not_hold():
    """Texture, smooth normals, detail, a wide penumbra, a body that reaches behind the camera, what is asked for."""
    near = [view(size_px=500.0)]
    uneven = plan_windows.plan_windows(near, {"body": traits(FULL)}, [body(near[0])], CAMERA, 0.02, 1.0, AREAS, None)
    assert uneven[0].first.engine != "areas"
    assert area_choice(near, even_facet_m=300.0)[0].first.engine != "areas"
    assert area_choice(near, eclipse=Eclipse(error=0.06))[0].first.engine != "areas"
    assert area_choice(near, samples=2)[0].first.engine == "raster"
    assert area_choice(near, costs=replace(AREAS, ray_ns=np.inf))[0].first.engine == "raster"
    assert area_choice([view(bounds_px=None, size_px=np.inf)])[0].first.engine != "areas"


def test_a_small_body_has_cells_of_its_own_by_area():
    """A lattice of 1800 samples across is dearer than 50,000 facets, and errs: rays are what stands by."""
    costs = replace(AREAS, area_ns=50.0)
    choice, = area_choice([view(size_px=3.0, phase_deg=140.0)], 0.002, costs=costs)
    assert choice.first.engine == "areas" and choice.first.samples == 0
    assert choice.by_rays.engine == "rays" and choice.by_rays.samples == 0
    x0, _, x1, _ = choice.first.bounds_px
    cell_px = (x1 - x0) / choice.first.grid[0]
    assert 0.2 * 0.002 < cell_error(cell_px, np.radians(140.0)) <= 1.1 * 0.3 * 0.002
    tight, = area_choice([view(size_px=3.0, phase_deg=140.0)], 0.0013, costs=replace(AREAS, area_ns=1e5))
    assert tight.first.engine == "areas", "dearer, but no lattice meets this budget"
    apart, = area_choice([view(size_px=20.0)], 0.005, costs=replace(AREAS, sample_ns=100.0), apart_px=24.0)
    assert apart.first.engine == "areas" and apart.first.samples == 0


@pytest.mark.parametrize("size_px", [0.001, 0.3, 1.0, 3.9])
@pytest.mark.parametrize("phase_deg", [20.0, 120.0, 160.0])
def test_cells_leave_areas_most_of_the_budget(size_px, phase_deg):
    """Or areas are not planned: they would be drawn for nothing."""
    drawn = []
    for budget in (1e-4, 1e-3, 0.01, 0.1):
        choice, = area_choice([view(size_px=size_px, phase_deg=phase_deg)], budget, costs=replace(AREAS, area_ns=1e-3))
        if choice.first.engine == "areas":
            drawn.append(choice.first.modelling_error / budget)
    assert len(drawn) >= 2 and max(drawn) <= 0.9


def test_few_rays_have_one_thread_and_many_have_all():
    """Eight threads: up to a part's rays what one takes, then no more until all are as fast."""
    costs = replace(RASTER, ray_ns=100.0, lone_ray_ns=800.0)
    part = RAYS_AT_ONCE * 800.0
    assert costs.rays_ns(0) > 0.0
    np.testing.assert_allclose([costs.rays_ns(n) - costs.rays_ns(0) for n in (1000, RAYS_AT_ONCE, 4 * RAYS_AT_ONCE)],
                               [8e5, part, part])
    np.testing.assert_allclose(costs.rays_ns(80 * RAYS_AT_ONCE) - costs.rays_ns(0), 10.0 * part)


def test_outlines_are_left_to_the_second_pass_and_creases_to_the_first():
    """Equal errors of one sample: where few pixels have it all, fewer samples everywhere."""
    outlines, creases = (Expected(limb=limb, creases=creases, facets_per_px=NOISE_FACETS)
                         for limb, creases in ((1e-2, 1e-9), (1e-9, 1e-2)))
    _, few = first_samples(outlines, 200_000.0, 1.1e5, 0.15, 1, 0.01)
    _, everywhere = first_samples(creases, 200_000.0, 1.1e5, 0.15, 1, 0.01)
    assert few < everywhere


def test_a_level_of_detail_is_used_where_its_errors_fit_the_budget():
    far, near = view(size_px=20.0, depth_m=(9e4, 1.1e5)), view(size_px=800.0)
    chosen = body(far, FULL, COARSE, budget=0.1)
    assert chosen.level == 1 and chosen.n_facets == 12_000
    assert chosen.flux_ratio == pytest.approx(1.01) and 0.0 < chosen.modelling_error <= 0.1
    assert body(far, FULL, COARSE, budget=0.005).level == 0, "its image is too coarse"
    smooth = replace(COARSE, crease_rad=1e-3)
    assert body(near, FULL, smooth, budget=0.06).level == 1
    assert body(near, FULL, smooth, budget=0.04).level == 0, "its flux scatters by 2.5 x 0.2 %"
    assert body(far, FULL, COARSE, level=9).level == 1 and body(far, FULL, COARSE, budget=0.1, level=0).level == 0


def test_the_region_holds_every_pixel_that_the_outline_touches():
    """Pixel k reaches from k - 1/2 to k + 1/2."""
    window, = windows([view(bounds_px=np.array([9.6, 19.4, 30.4, 40.6]))])
    assert window.roi == (10, 19, 31, 42)
    window, = windows([view(bounds_px=np.array([-50.0, -3.0, 2000.0, 10.0]))])
    assert window.roi == (0, 0, 1024, 11)


def test_bodies_far_apart_are_drawn_apart_and_touching_ones_together():
    a = view("a", bounds_px=np.array([10.0, 10.0, 50.0, 50.0]))
    b = view("b", bounds_px=np.array([45.0, 45.0, 90.0, 90.0]))
    c = view("c", bounds_px=np.array([500.0, 500.0, 600.0, 600.0]))
    d = view("d", bounds_px=np.array([85.0, 85.0, 95.0, 95.0]))
    groups = {window.bodies for window in windows([a, c, b, d])}
    assert groups == {("a", "b", "d"), ("c",)}


def test_a_body_smaller_than_a_few_pixels_gets_a_grid_of_its_own():
    window, = windows([view(size_px=0.01)])
    # Edges and creases of 0.15 rad at 60 deg: 4.9 N^-1.5 = 0.2 % from 182 on, and the margin; the shadow map tells of
    # the rest.
    assert window.samples == 0 and max(window.grid) == pytest.approx(1.04 * 182, abs=3)
    assert 0.002 < window.predicted_error < 0.005
    rayed, = windows([view(size_px=0.01)], 0.1, costs=replace(RASTER, ray_ns=1000.0))
    assert rayed.engine == "rays" and window.engine == "raster", "4096 rays are cheaper than 100,000 facets"
    assert window.roi == (100, 80, 101, 81)
    # In front of another body, occlusion needs the shared grid.
    small, large = view("small", size_px=2.0), view("large", size_px=200.0)
    window, = windows([small, large])
    assert window.samples >= 1


def test_nothing_in_view_is_nothing_to_draw():
    assert windows([view(is_visible=False)]) == ()
    assert grouping.union([]) == (0, 0, 0, 0)


@pytest.mark.parametrize("phase_deg, is_convex, casters, expected", [
    (60.0, False, (), True), (60.0, True, (), False), (60.0, True, ("moon",), True), (0.0, False, (), False),
    (0.2, False, (), False), (5.0, False, (), True),
])
def test_shadows_only_where_something_can_cast(phase_deg, is_convex, casters, expected):
    planned = body(view(phase_deg=phase_deg), is_convex=is_convex, casters=casters)
    assert (planned.shadow_map_px is not None) == expected


def test_a_low_sun_and_a_tight_budget_ask_for_a_finer_shadow_map():
    size = lambda phase, budget=0.02: body(view(phase_deg=phase), budget=budget).shadow_map_px  # noqa: E731
    assert size(60.0) <= size(120.0) <= size(150.0) <= plan.SHADOW_SIZES_PX[-1]
    assert size(60.0) < size(150.0)
    assert size(60.0, 0.02) < size(60.0, 0.001)


def test_depth_groups_are_disjoint_and_farthest_first():
    a = view("a", depth_m=(100.0, 200.0))
    b = view("b", depth_m=(150.0, 300.0))
    c = view("c", depth_m=(1e9, 1.1e9))
    d = view("d", depth_m=(10.0, 20.0), is_visible=False)
    groups = grouping.depth_groups([a, b, c, d])
    assert [(near, far, {v.name for v in members}) for near, far, members in groups] == [
        (1e9, 1.1e9, {"c"}), (100.0, 300.0, {"a", "b"})]


@pytest.mark.parametrize("size", plan.SHADOW_SIZES_PX)
def test_the_node_of_a_direction_is_within_a_texels_shift(size, rng):
    """0.71 / size rad at the centre of a cube's face: half a texel of 2 R / size is R / size."""
    direction = rng.standard_normal((1000, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    nodes = np.array([snapped(d, size) for d in direction])
    np.testing.assert_allclose(np.linalg.norm(nodes, axis=1), 1.0, rtol=1e-14)
    assert np.linalg.norm(nodes - direction, axis=1).max() <= 0.7072 / size
    again = np.array([snapped(d, size) for d in nodes])
    np.testing.assert_allclose(again, nodes, atol=1e-15, err_msg="a node is its own node")


def test_planning_takes_well_below_a_millisecond():
    members = [view("a"), view("b", bounds_px=np.array([600.0, 600.0, 700.0, 700.0]))]
    began = time.process_time()
    for _ in range(200):
        windows(members)
        grouping.depth_groups(members)
    assert (time.process_time() - began) / 200 < 1e-3



def rays_of(level, size_px, budget, phase_deg=60.0, sample_ns=200.0, ray_ns=50.0):
    """The window of a body that rays draw."""
    member = view(size_px=size_px, phase_deg=phase_deg)
    costs = replace(RASTER, facet_ns=90.0, sample_ns=sample_ns, ray_ns=ray_ns, lone_ray_ns=2.0 * ray_ns)
    drawn = [plan.plan_body(member, traits(level), CAMERA, (), budget, None)]
    (choice,) = plan_windows.plan_windows([member], {"body": traits(level)}, drawn, CAMERA, budget, 1.0, costs, None)
    assert choice.first.engine == "rays"
    return choice.first


def test_many_rough_facets_in_few_pixels_have_more_rays_than_16_x_16():
    """At 40 px each sample is noise, and 16 x 16 of them err by more; a hundred times as many pixels have no more."""
    rough = LevelTraits(n_facets=10_000_000, crease_rad=0.35)
    assert 16 < rays_of(rough, 40.0, 0.01).samples <= 25
    assert rays_of(rough, 40.0, 0.05).samples <= 16 and rays_of(rough, 400.0, 0.01).samples <= 16


def test_rays_go_where_something_faces_the_sun_if_the_image_that_tells_is_cheaper():
    """Of few facets at a low Sun it is; of three million in 20 px it costs more than all rays."""
    few, many = (LevelTraits(n_facets=n, crease_rad=0.35) for n in (200_000, 3_000_000))
    assert rays_of(few, 300.0, 0.01, phase_deg=150.0, sample_ns=13.0, ray_ns=300.0).rays_at_facing
    assert not rays_of(many, 20.0, 0.01).rays_at_facing


def test_a_level_of_detail_costs_more_a_facet_and_a_sample():
    """Areas at 4 ms are dearer than 12,000 facets of a full shape, and cheaper than those of a level."""
    costs = replace(AREAS, facet_ns=90.0, sample_ns=20.0, area_ns=36.0)
    member = view(size_px=100.0)
    engines = []
    for level in (replace(COARSE, deviation_m=0.0), COARSE):
        known = {"body": replace(traits(FULL, level), even_facet_m=0.3)}
        drawn = [plan.plan_body(member, known["body"], CAMERA, (), 0.1, 1)]
        drawn = [replace(drawn[0], level=1 if level is COARSE else 0, shadow_map_px=None)]
        choice, = plan_windows.plan_windows([member], known, drawn, CAMERA, 0.1, 1.0, costs, None)
        engines.append(choice.first.engine)
    assert engines == ["raster", "areas"]


def test_each_of_two_small_bodies_errs_by_its_own_facets():
    """A rough one of few facets beside a smooth one of many: not a rough one of many."""
    rough, smooth, both = (LevelTraits(n_facets=n, crease_rad=rad)
                           for n, rad in ((1_000, 0.35), (3_000_000, 0.01), (3_000_000, 0.35)))
    members = [view(name, size_px=1.5, bounds_px=np.array([x, 80.0, x + 1.5, 81.5]))
               for name, x in (("one", 100.0), ("other", 101.7))]

    def across(*levels):
        known = {member.name: traits(level) for member, level in zip(members, levels, strict=True)}
        drawn = [plan.plan_body(member, known[member.name], CAMERA, (), 0.02, None) for member in members]
        choice, = plan_windows.plan_windows(members, known, drawn, CAMERA, 0.02, 1.0, replace(RASTER, ray_ns=50.0),
                                            None)
        assert not choice.first.samples
        return max(choice.first.grid)

    assert across(smooth, smooth) < across(rough, smooth) < across(rough, rough) < 0.5 * across(both, smooth)


@pytest.mark.parametrize("moon_px", [1e-5, 1e-3, 0.02])
def test_a_moon_without_light_leaves_the_grid_as_it_is(moon_px):
    place = np.array([101.0, 81.0, 101.0 + moon_px, 81.0 + moon_px])
    grids, told = zip(*((window.grid, window.predicted_error) for members in (
        [view(size_px=3.0)], [view(size_px=3.0), view("moon", size_px=moon_px, bounds_px=place)])
        for window in windows(members, 0.005, costs=replace(RASTER, ray_ns=50.0))), strict=True)
    assert np.abs(np.subtract(*grids)).max() <= 1 and told[1] == pytest.approx(told[0], rel=0.01)


def test_crescents_that_no_grid_samples_have_no_more_than_for_their_sums():
    for phase_deg in (178.0, 179.9, 180.0):
        window, = windows([view(size_px=3.0, phase_deg=phase_deg)], 0.1)
        assert max(window.grid) <= 1.05 * 1024 and window.predicted_error > 0.1


@pytest.mark.parametrize("phase_deg, is_enough", [(60.0, True), (150.0, False)])
def test_samples_too_few_for_the_flux_are_told(phase_deg, is_enough):
    """Of a rough crescent 1024 across it are not enough, though its pixels are within the budget."""
    member, known = view(size_px=3.0, phase_deg=phase_deg), traits(LevelTraits(n_facets=1_000_000, crease_rad=0.3))
    drawn = [plan.plan_body(member, known, CAMERA, (), 0.02, None)]
    choice, = plan_windows.plan_windows([member], {"body": known}, drawn, CAMERA, 0.02, 1.0,
                                        replace(RASTER, ray_ns=50.0), None)
    told = plan.told_plan(CAMERA, 0.02, [member], {"body": known}, drawn, [choice.first], False)
    assert choice.first.predicted_error <= 0.02 and (choice.first.flux_error == 0.0) == is_enough
    assert any("for a flux within" in line for line in told.left_out) != is_enough


def test_several_bodies_that_are_few_pixels_have_a_grid_as_one_has():
    """Beyond 4 px, where 16 x 16 samples a pixel are too few for their flux; not beyond 32 px."""
    for size_px, is_own in ((5.0, True), (12.0, True), (40.0, False)):
        members = [view("one", size_px, 60.0), view("other", 0.5 * size_px, 60.0)]
        window, = windows(members, 0.005, costs=replace(RASTER, ray_ns=50.0))
        assert (window.samples == 0) == is_own
