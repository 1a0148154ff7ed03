"""The rule that chooses engines, as a table; regions, samples and small bodies' own grids. Without GL."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import planning
import pytest
import views
from glrender import Body, ConfigError, Renderer, generate
from glrender.brdf import Lambert
from glrender.emission import Coma
from glrender.emission.sources.haser import Haser
from glrender.engines.small_bodies import CELL_PX
from glrender.planner import engine_choice
from glrender.planner.error_model import FEWEST_CENTROIDS
from glrender.planner.penumbra import Penumbra
from glrender.planner.request import ENGINES, ImageUse
from glrender.view import regions as grouping
from planning import seen as seen_body
from planning import traits, view

GREY = Lambert(normal_albedo=0.3)
# Not as bright all over: a texture, smooth normals or surface detail.
UNEVEN = traits(facet_m=np.inf)


def ways(members, known=None, tolerance=0.02, planned=None, **request):
    """Of each region, the ways to draw it in order."""
    return planning.ways([seen_body(member, known, **(planned or {})) for member in members], tolerance, **request)


def order(*given, **request):
    """The engines of one region's ways in order, none where it is refused; coverage by centroids as "centroids"."""
    try:
        options, = ways(*given, **request)
    except ConfigError as error:
        assert error.path == "engine" and error.rule.startswith("cannot draw"), error
        return []
    return ["centroids" if option.by_centroids else option.engine for option in options]


NEAR = [view(size_px=500.0)]
BESIDE = [view(bounds_px=None, size_px=np.inf)]
# Facets of 300 m at 900 m whose radiance changes with the direction that they are seen from.
LARGE = traits(facet_m=300.0, view_slope=lambda phase_rad: 1.0)
CROWDED = traits(n_facets=3_000_000, facet_m=0.1)


@pytest.mark.parametrize("members, known, request_, expected", [
    (NEAR, traits(n_facets=9_000), {}, ["coverage", "rays"]),
    (NEAR, traits(), {}, ["centroids", "coverage", "rays"]),
    (NEAR, traits(), {"tolerance": 0.005}, ["coverage", "rays"]),
    ([view(size_px=500.0, phase_deg=140.0)], traits(), {}, ["coverage", "rays"]),
    ([view(size_px=20.0)], CROWDED, {}, ["rays", "centroids", "coverage"]),
    ([view(size_px=20.0)], traits(n_facets=99_000), {"tolerance": 0.005}, ["coverage", "rays"]),
    (NEAR, UNEVEN, {}, ["raster", "rays"]),
    (NEAR, LARGE, {}, ["coverage", "rays"]),
    (NEAR, traits(facet_m=300.0), {}, ["centroids", "coverage", "rays"]),
    (BESIDE, traits(), {"tolerance": 0.1}, ["raster", "rays"]),
    (BESIDE, traits(), {"tolerance": 2e-4}, ["rays"]),
    (NEAR, traits(), {"has_gpu": True}, ["raster", "centroids", "coverage", "rays"]),
    (BESIDE, traits(), {"has_gpu": True, "tolerance": 2e-4}, ["rays"]),
    (NEAR, traits(), {"engines": ("raster",)}, ["raster"]),
    (BESIDE, traits(), {"engines": ("raster",), "tolerance": 2e-4}, ["raster"]),
    (NEAR, traits(), {"engine": "coverage"}, ["centroids", "coverage"]),
    (NEAR, traits(), {"engine": "rays"}, ["rays"]),
    (NEAR, traits(), {"engine": "raster"}, ["raster"]),
    (NEAR, UNEVEN, {"engine": "coverage"}, []),
    (NEAR, traits(), {"samples": 2}, ["raster"]),
], ids=["few facets", "many", "tight", "low Sun", "crowded", "crowded by few", "texture", "facets too large",
        "large ones by Lambert", "beside the camera", "no map is fine enough", "GPU", "GPU, no map", "no Embree",
        "no Embree, no map", "coverage asked for", "rays asked for", "OpenGL asked for", "cannot", "samples"])
def test_the_rule(members, known, request_, expected):
    assert order(members, known, **request_) == expected


def test_surface_detail_is_drawn_by_opengl_alone():
    for known in (traits(), UNEVEN):
        assert order(NEAR, known, planned={"detail_layers": 3}) == ["raster"]
        assert order(NEAR, known, planned={"detail_layers": 3}, engine="rays") == []
        assert order(BESIDE, known, 2e-4, planned={"detail_layers": 3}) == ["raster"], "though no map is fine enough"


def test_from_ten_thousand_facets_on_centroids_come_first():
    assert FEWEST_CENTROIDS == 10_000
    for n_facets, is_first in ((9_999, False), (10_000, True)):
        assert (order([view(size_px=300.0)], traits(n_facets=n_facets))[0] == "centroids") == is_first
    assert order([view(size_px=500.0)], traits(n_facets=10_000))[0] == "coverage", "each covers 50 pixels"


def test_centroids_are_not_tried_where_hard_edges_of_other_bodies_cost_too_much():
    assert order(NEAR, planned={"penumbra": Penumbra(hard_error=0.05)}) == ["coverage", "rays"]


def test_coverage_takes_each_pixel_as_a_whole():
    (first, clipped, rays), = ways(NEAR)
    assert first.grid == tuple(first.roi[k + 2] - first.roi[k] for k in (0, 1)) and first.samples == 1
    assert (clipped.roi, clipped.grid) == (first.roi, first.grid) and clipped.modelling_error < first.modelling_error
    assert first.predicted_error <= 0.02 and rays.samples > 1


def test_an_asked_number_of_samples_is_never_refined():
    (window,), = ways(NEAR, tolerance=0.001, samples=3)
    assert window.samples == 3 and window.budget.tolerance == np.inf and window.engine == "raster"


def test_bodies_of_few_pixels_have_samples_enough_for_their_flux():
    """More than the first 2 x 2: 16 x 16 at most by OpenGL, more by rays of many rough facets."""
    rough = traits(n_facets=10_000_000, crease_rad=0.35)

    def samples(size_px, tolerance, engine):
        (window,), = ways([view(size_px=size_px)], rough, tolerance, engine=engine)
        return window.samples

    assert samples(400.0, 0.01, "rays") == samples(400.0, 0.01, "raster") == 2
    assert 2 < samples(20.0, 0.01, "raster") <= 16 < samples(20.0, 0.001, "rays") <= 1024 / 20.0 + 1.0
    assert samples(20.0, 0.05, "rays") < samples(20.0, 0.01, "rays")


@pytest.mark.parametrize("engine", ["rays", "raster"])
def test_crescents_begin_with_more_samples(engine):
    first = [ways([view(size_px=500.0, phase_deg=phase_deg)], engine=engine)[0][0].samples
             for phase_deg in (60.0, 110.0, 150.0)]
    assert first == [2, 2, 4]


def test_large_regions_begin_with_fewer_samples():
    """A million in all, but for crescents of which it is known where they have light."""
    def samples(phase_deg, known=None):
        return ways([view(size_px=900.0, phase_deg=phase_deg)], known, engine="rays")[0][0].samples

    assert [samples(phase_deg) for phase_deg in (60.0, 150.0)] == [1, 4]
    assert [samples(phase_deg, UNEVEN) for phase_deg in (60.0, 150.0)] == [1, 2]


def test_a_small_body_has_a_grid_of_its_own():
    """Of samples by rays, as fine as its tolerance asks for; of cells by coverage, which errs by none."""
    grids = []
    for tolerance in (0.05, 0.005):
        options, = ways([view(size_px=3.0)], traits(n_facets=9_000), tolerance)
        assert [option.engine for option in options] == ["coverage", "rays"]
        assert all(option.target == "own_grid" for option in options) and options[0].roi == (100, 80, 104, 83)
        grids.append([max(option.grid) for option in options])
    (coarse, few), (fine, many) = grids
    assert coarse == fine and many > few
    # In front of another body, occlusion needs the shared grid.
    options, = ways([view("small", size_px=2.0), view("large", size_px=200.0)])
    assert all(option.target == "region" for option in options)


@pytest.mark.parametrize("size_px", [1e-12, 0.001, 0.3, 1.0, 3.9, 20.0])
@pytest.mark.parametrize("place_px", [0.0, 0.5, 99.7])
def test_no_cell_is_in_two_pixels(size_px, place_px):
    """They have the outline within, and are 0.28 px wide at most, of small bodies at most a sixteenth of the size."""
    box = place_px + np.array([0.0, 0.0, size_px, 0.35 * size_px])
    options, = ways([view(size_px=size_px, phase_deg=20.0, bounds_px=box)], use=ImageUse(apart_px=24.0))
    bounds, grid = np.reshape(options[0].bounds_px, (2, 2)), np.array(options[0].grid)
    assert (bounds[0] <= box[:2]).all() and (bounds[1] > box[2:]).all()
    (across_px, down_px), = [(bounds[1] - bounds[0]) / grid]
    assert across_px == down_px <= min(CELL_PX, max(size_px / 16.0, 1e-9))
    # In float64 without rounding, the edges of pixels being at halves.
    assert ((bounds + 0.5) % across_px == 0.0).all() and (1.0 / across_px) % 1.0 == 0.0


def test_a_body_that_is_kept_apart_has_a_grid_of_its_own_up_to_that_size():
    for size_px, is_own in ((20.0, True), (30.0, False)):
        options, = ways([view(size_px=size_px, phase_deg=0.0)], use=ImageUse(apart_px=24.0))
        assert {option.target == "point" for option in options} == {is_own}


def test_crescents_that_no_grid_samples_have_the_most_and_say_so():
    for phase_deg in (178.0, 179.9, 180.0):
        (window,), = ways([view(size_px=3.0, phase_deg=phase_deg)], tolerance=0.1, engine="rays")
        assert max(window.grid) <= 1.05 * 1024 and window.predicted_error > 0.1


def test_each_of_two_small_bodies_errs_by_its_own_facets():
    """A rough one of few facets beside a smooth one of many: not a rough one of many."""
    rough, smooth, both = (traits(n_facets=n, crease_rad=rad)
                           for n, rad in ((1_000, 0.35), (3_000_000, 0.01), (3_000_000, 0.35)))
    members = [view(name, size_px=1.5, bounds_px=np.array([x, 80.0, x + 1.5, 81.5]))
               for name, x in (("one", 100.0), ("other", 101.7))]

    def across(*each):
        (window,), = planning.ways(list(map(seen_body, members, each)), engine="rays")
        return max(window.grid)

    assert across(smooth, smooth) <= across(rough, smooth) <= across(rough, rough) < across(both, smooth)


def test_bodies_apart_cover_no_more_than_one():
    """Eight of 20 px would cost eight times what one does: none is apart; of small ones all are. Parts are one."""
    parts = [view(f"{k}", size_px=20.0, phase_deg=0.0) for k in range(8)]
    eight = [grouping.Group.of([each], planning.CAMERA) for each in parts]
    small = [grouping.Group.of([view(f"{k}", size_px=8.0)], planning.CAMERA) for k in range(8)]
    for groups in (eight[:1], [], small, [grouping.Group.of(parts, planning.CAMERA)]):
        assert engine_choice.apart_limit(groups, 24.0) == 24.0
    assert engine_choice.apart_limit(eight, 24.0) == engine_choice.apart_limit([*eight, small[0]], 24.0) == 20.0
    assert engine_choice.apart_limit(eight, 0.0) == 0.0


@pytest.mark.parametrize("phase_deg, size_px", [(0.0, 24.0), (60.0, 27.7), (110.0, 41.8), (150.0, 92.7), (175.0, 96.0)])
def test_crescents_are_apart_while_they_have_no_more_pixels_than_a_disc(phase_deg, size_px):
    """24 px / cos(g / 2), at most 96: closed form; two that touch are as large as both, at the fuller one's phase."""
    sizes = [engine_choice.apart_size_px(size_px + d, np.radians(phase_deg)) for d in (-0.1, 0.1)]
    assert sizes[0] < 24.0 < sizes[1]
    for d, is_apart in ((-0.1, True), (0.1, False)):
        both = [view("thin", size_px=1.0, phase_deg=170.0), view("full", size_px=size_px + d, phase_deg=phase_deg)]
        options, = ways(both, use=ImageUse(apart_px=24.0), engine="rays")
        assert (options[0].target == "point") == is_apart and options[0].bodies == ("thin", "full")
    assert np.isinf(engine_choice.apart_size_px(np.inf, 0.0))


def test_the_region_holds_every_pixel_that_the_outline_touches():
    """Pixel k reaches from k - 1/2 to k + 1/2."""
    for bounds_px, roi in ((np.array([9.6, 19.4, 30.4, 40.6]), (10, 19, 31, 42)),
                           (np.array([-50.0, -3.0, 2000.0, 10.0]), (0, 0, 1024, 11))):
        options, = ways([view(bounds_px=bounds_px)])
        assert {option.roi for option in options} == {roi}


def test_bodies_far_apart_are_drawn_apart_and_touching_ones_together():
    members = [view(name, bounds_px=np.array([low, low, high, high]))
               for name, low, high in (("a", 10.0, 50.0), ("c", 500.0, 600.0), ("b", 45.0, 90.0), ("d", 85.0, 95.0))]
    assert {options[0].bodies for options in ways(members)} == {("a", "b", "d"), ("c",)}


def test_nothing_in_view_is_nothing_to_draw():
    assert ways([view(is_visible=False)]) == ()
    assert grouping.union([]) == (0, 0, 0, 0)


def test_planning_takes_well_below_a_millisecond():
    members = [view("a"), view("b", bounds_px=np.array([600.0, 600.0, 700.0, 700.0]))]
    began = time.process_time()
    for _ in range(200):
        ways(members)
        grouping.depth_groups(members)
    assert (time.process_time() - began) / 200 < 1e-3


@pytest.fixture(scope="module")
def renderer():
    shape = views.binary(3, 4)
    smooth = generate.icosphere(radius_m=100.0, subdivisions=4)
    scene = views.scene([Body(name="body", shape=shape, brdf=GREY),
                         Body(name="smooth", shape=smooth, brdf=GREY, smooth_normals=True)],
                        [views.camera(64, 500.0)], max_error=0.05)
    with Renderer(scene) as made:
        yield made


def seen(*names):
    """A state in which other bodies are far behind the camera."""
    state = views.state(bodies=("body", "smooth"))
    away = 3.0 * state.spacecraft.r_inertial_m
    return replace(state, bodies={name: pose if name in names else replace(pose, r_inertial_m=away)
                                  for name, pose in state.bodies.items()})


@pytest.mark.parametrize("engine", ENGINES)
def test_the_engine_that_is_asked_for_draws(renderer, engine):
    """And all three agree within twice the budget."""
    image = renderer.render(seen("body"), engine=engine)
    assert [window.engine for window in image.plan.windows] == [engine]
    usual = renderer.render(seen("body"))
    assert views.relative_rms(image.irradiance_W_m2.astype(float), usual.irradiance_W_m2.astype(float)) < 0.1


def test_an_engine_that_cannot_draw_is_refused(renderer):
    with pytest.raises(ConfigError, match="engine: cannot draw smooth, got 'coverage'"):
        renderer.render(seen("smooth"), engine="coverage")
    assert renderer.render(seen("smooth"), engine="rays").irradiance_W_m2.any()
    with pytest.raises(ConfigError, match="engine: must be one of coverage, rays, raster, got 'areas'"):
        renderer.render(seen("body"), engine="areas")
    assert renderer.info["engines"] == ENGINES


def test_samples_are_drawn_by_opengl_and_never_again(renderer):
    window, = renderer.render(seen("body"), samples=3).plan.windows
    assert window.engine == "raster" and window.samples == 3 and not window.refined_samples


@pytest.fixture(scope="module")
def lumpy():
    shape = views.binary(2, 5)
    with Renderer(views.scene([Body(name="body", shape=shape, brdf=GREY)], [views.camera(200, 1500.0)],
                              sun_disc=False)) as made:
        yield made


@pytest.mark.parametrize("engine", ["raster", "rays"])
def test_nothing_is_begun_after_the_deadline(lumpy, engine):
    """The first samples are drawn, and not refined; the plan says that the budget is missed."""
    state = views.state(phase_deg=70.0, range_m=2000.0)
    late, usual = (lumpy.render(state, max_error=0.005, engine=engine, deadline_s=deadline_s)
                   for deadline_s in (1e-6, 1000.0))
    assert not late.plan.windows[0].refined_samples and usual.plan.windows[0].refined_samples
    assert late.plan.predicted_error > 0.005 >= usual.plan.predicted_error
    assert any("predicted error" in line and "exceeds max_error 0.005" in line for line in late.plan.warnings)
    error = views.relative_rms(late.irradiance_W_m2.astype(float), usual.irradiance_W_m2.astype(float))
    assert error < late.plan.predicted_error


def test_a_deadline_that_is_kept_changes_no_byte(lumpy):
    state = views.state(phase_deg=70.0, range_m=2000.0)
    kept, usual = (lumpy.render(state, max_error=0.02, deadline_s=deadline_s) for deadline_s in (1000.0, None))
    assert kept.irradiance_W_m2.tobytes() == usual.irradiance_W_m2.tobytes()


@pytest.mark.parametrize("max_error", [0.05, 0.03, 0.02, 0.01, 0.003])
def test_the_best_frame_until_the_deadline_is_lit(lumpy, max_error):
    """Also where the first way does not do, and draws nothing: a dark frame is no frame."""
    state = views.state(phase_deg=70.0, range_m=2000.0)
    usual = lumpy.render(state, max_error=max_error).irradiance_W_m2.sum(dtype=float)
    late = lumpy.render(state, max_error=max_error, deadline_s=1e-6)
    assert late.irradiance_W_m2.sum(dtype=float) == pytest.approx(usual, rel=0.02), late.plan.windows


@pytest.mark.parametrize("engine", [*ENGINES, None])
def test_a_budget_that_nothing_meets_has_a_lit_frame(lumpy, engine):
    state = views.state(phase_deg=70.0, range_m=2000.0)
    usual = lumpy.render(state, max_error=0.01).irradiance_W_m2.sum(dtype=float)
    image = lumpy.render(state, max_error=2e-4, engine=engine)
    assert image.irradiance_W_m2.sum(dtype=float) == pytest.approx(usual, rel=2e-3)
    assert 2e-4 < image.plan.predicted_error < 0.1 and image.plan.warnings


@pytest.mark.parametrize("field, value, rule", [
    ("use", {"error_gain": 0.5}, "must be an ImageUse"), ("use", None, "must be an ImageUse"),
    ("out", [0.0], "must be a float32 array of shape"), ("out", np.zeros((8, 8), np.float32), "must be float32 of"),
    ("out", np.frombuffer(bytes(160_000), np.float32).reshape(200, 200), "must be float32 of.*writeable")])
def test_a_use_and_a_place_that_are_none_are_refused_by_name(lumpy, field, value, rule):
    """By a renderer whose emission dims the image, too, in which no light comes as points."""
    coma = Coma(body="body", sources=[Haser(weight_m=5.0)])
    with Renderer(replace(lumpy.scene, emission=(coma,))) as dimmed:
        for renderer in (lumpy, dimmed):
            with pytest.raises(ConfigError, match=f"^{field}: {rule}"):
                renderer.render(views.state(), use=ImageUse(out=value) if field == "out" else value)


@pytest.mark.parametrize("deadline_s", [0.0, -1.0, float("nan")])
def test_a_deadline_is_positive(lumpy, deadline_s):
    with pytest.raises(ConfigError, match="deadline_s"):
        lumpy.render(views.state(), deadline_s=deadline_s)
