"""What each cause of error may take of the tolerance: the parts of a plan never add up to more. Mostly without GL."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import views
from glrender import Body, Renderer, Scene, generate
from glrender.brdf import Lambert
from glrender.planner import error_budget
from glrender.planner.error_budget import Budget
from glrender.planner.penumbra import Penumbra
from glrender.planner.request import ImageUse, Request
from glrender.planner.small_body_grid import MAX_RAYS_ACROSS
from glrender.view.regions import Group
from planning import CAMERA, seen, traits, view, ways

STATE = views.state(phase_deg=60.0, range_m=1500.0)
BODY = Body(name="body", shape=generate.contact_binary(radius_m=100.0, seed=7, subdivisions=4),
            brdf=Lambert(normal_albedo=0.3))
# Most of the tolerance that modelling may take, so that the least that the drawing aims at fits as well.
ROOM = math.sqrt(1.0 - error_budget.LEAST_LEFT**2)


@pytest.fixture(scope="module")
def renderer():
    with Renderer(Scene(bodies=[BODY], cameras=[views.camera(64, 350.0)])) as made:
        yield made


@pytest.mark.parametrize("modelled, left", [(0.0, 0.05), (0.03, 0.04), (0.04, 0.03), (0.0499, 0.015), (7.0, 0.015)])
def test_what_is_left_is_the_other_leg_and_never_less_than_the_least(modelled, left):
    assert Budget(tolerance=0.05).left_after(modelled) == pytest.approx(left)


def test_a_tenth_of_the_tolerance_is_the_flux_s():
    assert Budget(tolerance=0.02).flux == pytest.approx(0.002)


def test_shares_that_stand_side_by_side_leave_the_drawing_its_least():
    """Facets, cells and penumbras of coverage; texels and leaks of OpenGL's shadow maps, and a small body's samples."""
    of = error_budget
    assert of.PENUMBRA_SHARE <= ROOM and of.CELL_SHARE <= of.PENUMBRA_SHARE
    leaks = 2.0 * of.FLUX_SHARE
    assert math.hypot(of.SHADOW_MAP_SHARE, leaks) <= math.sqrt(1.0 - of.SAMPLES_SHARE**2) + 0.012
    assert max(of.MISSED_SHARE, of.UNDIVIDED_SHARE) < of.OVERLAPS_LEFT < 1.0


def test_the_parts_of_random_windows_are_within_the_tolerance():
    """1000 bodies at random: what is modelled leaves the drawing its least, and a small body's own samples fit as well.

    Slivers of light near a phase of 180 deg and uneven facets, which rays settle, may exceed it in clipped coverage;
    and a small body's grid that is as fine as any.
    """
    rng, n_whole, n_own = np.random.default_rng(54), 0, 0
    for _ in range(1000):
        slope = float(rng.uniform(0.0, 2.0))
        known = traits(n_facets=int(10.0 ** rng.uniform(2.0, 6.5)), crease_rad=rng.uniform(0.01, 0.6),
                       facet_m=rng.choice([np.inf, 10.0 ** rng.uniform(-2.0, 2.0)]), is_convex=bool(rng.random() < 0.2),
                       view_slope=lambda phase_rad, slope=slope: slope)
        member = view(size_px=10.0 ** rng.uniform(-1.0, 2.8), phase_deg=rng.uniform(0.0, 178.0))
        tolerance = 10.0 ** rng.uniform(-3.5, 0.0)
        planned = seen(member, known, penumbra=Penumbra(hard_error=10.0 ** rng.uniform(-4.0, -1.0)))
        gain = rng.uniform(0.2, 1.0)
        for option in ways([planned], gain * tolerance, ImageUse(error_gain=gain))[0]:
            others = [error for cause, error in option.causes.items()
                      if cause not in ("slivers", "uneven facets", *option.drawn)]
            if option.engine != "raster":
                assert math.hypot(*others) <= ROOM * option.budget.tolerance, option
            if option.modelling_error > option.budget.tolerance:
                most = max(option.causes["slivers"], option.causes["uneven facets"])
                assert option.how == "coverage" and most > 0.5 * option.budget.tolerance, option
            elif "samples" in option.drawn and max(option.grid) < MAX_RAYS_ACROSS:
                assert option.predicted_error <= option.budget.tolerance * (1.0 + 1e-9), option
                n_own += 1
            else:
                n_whole += 1
    assert n_whole > 1000 and n_own > 200


@pytest.mark.parametrize("engine", ["coverage", "rays", "raster"])
@pytest.mark.parametrize("max_error", [0.1, 0.02, 0.006])
def test_a_drawn_frame_s_parts_are_its_prediction_and_within_the_tolerance(renderer, engine, max_error):
    plan = renderer.render(STATE, max_error=max_error, engine=engine).plan
    window, = plan.windows
    assert window.drawn and window.modelled
    assert plan.predicted_error == pytest.approx(math.hypot(*window.causes.values()))
    assert plan.predicted_error <= max_error and plan.missed == ()
    assert plan.to_dict()["windows"][0]["predicted_error"] == plan.predicted_error


def test_a_point_spread_function_s_gain_is_applied_once_where_errors_are_reported(renderer):
    """Equal errors before it are equal frames; what is reported is the part of them that it leaves.

    The flux, which it leaves as it is, asks for no more of a body of so many pixels.
    """
    bare, blurred = (renderer.render(STATE, max_error=0.05 * gain, use=ImageUse(error_gain=gain))
                     for gain in (1.0, 0.3))
    assert bare.irradiance_W_m2.tobytes() == blurred.irradiance_W_m2.tobytes()
    one, other = bare.plan.windows[0], blurred.plan.windows[0]
    assert other.budget.tolerance == pytest.approx(0.3 * one.budget.tolerance), "after the point spread function"
    assert other.budget.flux == pytest.approx(0.1 * 0.05 * 0.3), "which leaves the error of the flux as it is"
    assert blurred.plan.predicted_error == pytest.approx(0.3 * bare.plan.predicted_error, rel=1e-4)
    for cause, error in one.causes.items():
        # These are errors of the flux.
        if cause not in ("one direction to the Sun", "slivers"):
            assert other.causes[cause] == pytest.approx(0.3 * error)


@pytest.mark.parametrize("asked", [{"flux": 0.004}, {"centroid_px": 0.05}, {"range": 0.01}, {"rms": 0.02}])
def test_the_flux_that_a_table_allows_is_the_same_after_a_point_spread_function(asked):
    members = Group.of([view(size_px=30.0)], CAMERA)
    for how in ("coverage", "centroids", "rays", "raster"):
        bare, blurred = (Request(camera=CAMERA, max_error=asked, use=ImageUse(error_gain=gain)).budget(members, how)
                         for gain in (1.0, 0.3))
        assert bare.flux == blurred.flux == pytest.approx(0.1 * bare.tolerance)
        assert bare.flux <= asked.get("flux", 1.0) and blurred.tolerance >= bare.tolerance


def test_light_that_leaks_past_shadow_maps_is_held_as_without_a_point_spread_function(renderer):
    """At a low Sun the flux asks for texels: as many for 2 % after a function of any gain, fewer for 10 %."""
    low = views.state(phase_deg=140.0, range_m=1500.0)
    bare, blurred, lax = (renderer.render(low, max_error=max_error, engine="raster",
                                          use=ImageUse(error_gain=gain)).plan.bodies[0]
                          for max_error, gain in ((0.02, 1.0), (0.02, 0.2), (0.1, 1.0)))
    assert bare.shadow_map_px == blurred.shadow_map_px >= 2 * lax.shadow_map_px


@pytest.mark.parametrize("phase_deg, cause", [(165.0, "slivers"), (40.0, "centroids")])
def test_no_point_spread_function_averages_the_flux_that_slivers_and_centroids_lose(phase_deg, cause):
    """As digital numbers a frame is promised the same flux: the loss is reported whole, and predicted as it is."""
    body = Body(name="body", shape=generate.contact_binary(radius_m=100.0, seed=7, subdivisions=5),
                brdf=Lambert(normal_albedo=0.3))
    state = views.state(phase_deg=phase_deg, range_m=1500.0)
    with Renderer(Scene(bodies=[body], cameras=[views.camera(64, 350.0)])) as made:
        bare, blurred = (made.render(state, max_error=0.1, use=ImageUse(error_gain=gain)).plan for gain in (1.0, 0.5))
    one, other = (plan.windows[0].causes[cause] for plan in (bare, blurred))
    assert bare.windows[0].modelled_flux == blurred.windows[0].modelled_flux
    assert one == pytest.approx(other) and blurred.windows[0].how == bare.windows[0].how
    assert blurred.predicted["flux"] == pytest.approx(bare.predicted["flux"], rel=1e-6)


def test_no_point_spread_function_averages_one_direction_to_the_sun(renderer):
    cause = "one direction to the Sun"
    one, other = (renderer.render(STATE, max_error=0.02, use=ImageUse(error_gain=gain)).plan.windows[0].modelled[cause]
                  for gain in (1.0, 0.3))
    assert one == pytest.approx(other) == pytest.approx(BODY.shape.radius_m / views.AU_M, rel=0.1)


@pytest.mark.parametrize("asked, infinite", [({}, "flux_asked"), ({"samples": 4}, "tolerance")])
def test_a_plan_on_the_wire_has_none_in_place_of_infinite_numbers(renderer, asked, infinite):
    """JSON has no infinity. A window by rays with a wide penumbra has an infinite `noise` too."""
    plan = renderer.render(STATE, **asked).plan
    plan = replace(plan, windows=(replace(plan.windows[0], noise=(math.inf, math.nan)),))
    window, = json.loads(json.dumps(plan.to_dict(), allow_nan=False))["windows"]
    assert window["noise"] == [None, None] and window["budget"][infinite] is None
    assert window["predicted_error"] == plan.predicted_error


def test_the_sun_s_direction_on_a_planet_is_no_error_that_a_point_spread_function_hides_or_adds():
    """A body of 6.4e6 m at 1 au: its error of the total light, R / d, and of the centre are those of any gain."""
    shape = generate.contact_binary(radius_m=6.4e6, seed=7, subdivisions=5)
    scene = Scene(bodies=[Body(name="body", shape=shape, brdf=Lambert(normal_albedo=0.3))],
                  cameras=[views.camera(64, 350.0)])
    with Renderer(scene) as made:
        bare, blurred = (made.render(views.state(phase_deg=60.0, range_m=9.6e7), max_error=0.02 * gain, engine="rays",
                                     use=ImageUse(error_gain=gain)).plan.predicted for gain in (1.0, 0.05))
    for unit in ("flux", "centroid_px", "range"):
        assert blurred[unit] == pytest.approx(bare[unit], rel=1e-6), unit


def test_a_printed_plan_says_what_spent_the_tolerance(renderer):
    """The causes from a tenth of the window's error on, the largest first, in per cent."""
    plan = renderer.render(STATE, max_error=0.02, engine="raster").plan
    line, = (line for line in str(plan).splitlines() if "OpenGL" in line)
    spent = dict(each.rsplit(" ", 1) for each in line.split("% (")[1].split(")")[0].split(", "))
    parts = plan.windows[0].causes
    assert list(spent) == sorted((cause for cause, error in parts.items() if error > 0.1 * plan.predicted_error),
                                 key=lambda cause: -parts[cause])
    for cause, percent in spent.items():
        assert float(percent) == pytest.approx(100.0 * parts[cause], rel=0.06)
    assert math.hypot(*map(float, spent.values())) == pytest.approx(100.0 * plan.predicted_error, rel=0.06)
