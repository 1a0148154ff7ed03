"""The plan of a frame from facts of its view that are derived once. Without GL."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import views
from glrender import Body, ConfigError, Pose, generate
from glrender.brdf import Lambert
from glrender.planner.account import Drawn, account
from glrender.planner.error_budget import Budget
from glrender.planner.frame_plan import plan_frame
from glrender.planner.penumbra import Penumbra
from glrender.planner.request import WHOLE_IMAGE, ImageUse, Request
from glrender.planner.seen import Seen, seen_bodies
from glrender.view.regions import Group, region, touching
from glrender.view.view import SUN_RADIUS_M
from planning import CAMERA, seen, traits, view, ways

GREY = Lambert(normal_albedo=0.3)


class Relief:
    """Surface detail of two scales, of which a pixel of less than a metre resolves both."""

    def active(self, footprint_m):
        return [index for index, scale_m in enumerate(self.scales_m()) if scale_m > footprint_m]

    def scales_m(self):
        return np.array([5.0, 1.0])

    def slope_rms(self, footprint_m):
        return 0.1 * len(self.active(footprint_m))


def test_a_group_has_one_place_in_the_image():
    """Boxes from 10 to 30 and from 20 to 50 px, the frame's first 1024 px: closed forms."""
    one, other = view("one", bounds_px=np.array([10.0, -20.0, 30.0, 40.0]), phase_deg=20.0), view(
        "other", bounds_px=np.array([20.0, 20.0, 50.0, 60.0]), phase_deg=70.0)
    group = Group.of([one, other], CAMERA)
    assert group.names == ("one", "other") and group.outline == (10.0, -20.0, 50.0, 60.0)
    assert group.roi == region([one, other], CAMERA) == (10, 0, 51, 61) and group.size_px == 80.0
    assert group.phase_rad == pytest.approx(math.radians(70.0))
    assert group.side_px == pytest.approx(math.sqrt(40.0 * 61.0))


def test_a_group_with_a_body_beside_the_camera_may_fill_the_image():
    group = Group.of([view("one"), view("near", size_px=np.inf)], CAMERA)
    assert group.outline is None and group.size_px == math.inf
    assert group.roi == (0, 0, 1024, 1024) and group.side_px == 1024.0


def test_bodies_that_touch_by_a_third_are_one_group_in_the_scene_s_order():
    boxes = {"c": (0.0, 20.0), "a": (60.0, 80.0), "far": (500.0, 510.0), "b": (19.0, 61.0)}
    members = [view(name, bounds_px=np.array([low, low, high, high])) for name, (low, high) in boxes.items()]
    assert sorted(group.names for group in touching(members, CAMERA)) == [("c", "a", "b"), ("far",)]


def test_the_facts_of_a_body_are_those_of_the_scene():
    """A moon 1 km sunward of a body: it casts a shadow whose penumbra is as wide as the Sun's angle times that."""
    bodies = [Body(name=name, shape=generate.icosphere(radius_m=radius_m, subdivisions=2), brdf=GREY)
              for name, radius_m in (("body", 100.0), ("moon", 30.0))]
    scene = views.scene(bodies, [views.camera(200, 1500.0)])
    state = views.state(phase_deg=60.0, bodies=("body", "moon"))
    to_sun = state.r_sun_inertial_m / np.linalg.norm(state.r_sun_inertial_m)
    state = replace(state, bodies={**state.bodies, "moon": Pose(r_inertial_m=1000.0 * to_sun)})
    known = [traits() for _ in bodies]
    body, moon = seen_bodies(state, scene.cameras[0], scene, known)
    assert (body.view.name, body.casters, moon.casters) == ("body", ("moon",), ())
    width_m = 2.0 * SUN_RADIUS_M / np.linalg.norm(state.r_sun_inertial_m) * 1000.0
    assert body.penumbra.eclipse_px * body.view.footprint_m == pytest.approx(width_m, rel=1e-3)
    assert moon.penumbra.eclipse_px == 0.0
    hard, _ = seen_bodies(state, scene.cameras[0], replace(scene, sun_disc=False), known)
    assert hard.casters == ("moon",) and hard.penumbra == Penumbra()


@pytest.mark.parametrize("depth_m, layers, finest_m", [(300.0, 2, 1.0), (900.0, 2, 1.8), (2000.0, 1, 5.0),
                                                       (9000.0, 0, None)])
def test_surface_detail_is_drawn_down_to_two_pixels(depth_m, layers, finest_m):
    """A focal length of 1000 px: a pixel sees a thousandth of the depth."""
    member, known = view(depth_m=(depth_m, depth_m + 200.0)), traits(relief=Relief())
    found = Seen.of(member, known, CAMERA)
    assert (found.detail_layers, found.detail_m) == (layers, finest_m)
    assert found.traits.detail_slope == pytest.approx(0.1 * layers) and found.traits.crease_rad == known.crease_rad
    assert Seen.of(replace(member, is_visible=False), known, CAMERA).detail_m is None


def test_a_frame_s_plan_has_each_body_and_the_groups_in_view():
    members = [seen(view("a")), seen(view("hidden", is_visible=False)), seen(view("b"))]
    plan = plan_frame(members, Request(camera=CAMERA, max_error=0.02))
    assert [body.name for body in plan.bodies] == ["a", "hidden", "b"] and plan.seen == tuple(members)
    assert [group.names for group in plan.groups] == [("a", "b")] == [ways[0].bodies for ways in plan.options]
    assert plan.bodies[0].shadow_map_px and plan.bodies[1].shadow_map_px is None


def test_bodies_that_are_drawn_together_have_one_budget():
    """Tolerances by unit follow from the box of both: their shadow maps are as fine as the window's own budget asks."""
    near = view("near", size_px=40.0, phase_deg=60.0)
    wide = view("wide", size_px=200.0, phase_deg=60.0, bounds_px=np.array([120.0, 80.0, 320.0, 280.0]))
    request = Request(camera=CAMERA, max_error={"centroid_px": 0.05}, engine="raster")
    together, alone = (plan_frame([seen(member) for member in members], request) for members in ([near, wide], [near]))
    group, = together.groups
    assert together.options[0][0].budget == request.budget(group, "raster") != alone.options[0][0].budget
    # The centre of a larger image moves more by an equal error.
    assert together.bodies[0].shadow_map_px > alone.bodies[0].shadow_map_px


@pytest.mark.parametrize("engine, known, text", [
    ("coverage", traits(facet_m=math.inf), "engine: cannot draw body, got 'coverage'; exact coverage draws bodies"),
    ("rays", traits(), "engine: cannot draw body, got 'rays'; rays draw no surface detail"),
])
def test_an_engine_that_cannot_draw_a_body_is_refused_with_the_way_out(engine, known, text):
    with pytest.raises(ConfigError, match=text):
        ways([seen(view(), known, detail_layers=2)], engine=engine)


@pytest.mark.parametrize("asked, is_late, way_out", [
    ({}, False, 'the backend "raytrace" draws it'), ({"engine": "rays"}, False, "leave engine out"),
    ({"engine": "rays"}, True, "give more time than deadline_s")])
def test_a_miss_is_warned_of_with_the_way_out(asked, is_late, way_out):
    """A frame whose drawing errs by 0.5 where 0.02 was asked for; by half of that after a point spread function."""
    use = ImageUse(error_gain=0.5)
    plan = plan_frame([seen(view())], Request(camera=CAMERA, max_error=0.02, use=use, **asked))
    window = replace(plan.options[0][0], modelled={}, modelled_flux={}, drawn={"samples": 0.5})
    made = account(plan, Drawn(irradiance_W_m2=np.zeros((1, 1), np.float32), small_bodies=(), windows=(window,),
                               bodies=plan.bodies, is_late=is_late))
    assert made.predicted_error == made.windows[0].predicted_error == pytest.approx(0.25)
    assert made.missed == ("rms",) and made.warnings == (f"predicted error 0.25 exceeds max_error 0.02; {way_out}",)


def test_a_tolerance_that_no_frame_is_promised_says_so_and_the_other_has_its_way_out():
    """The centre to 1e-9 px, and a total that the drawing misses."""
    plan = plan_frame([seen(view())], Request(camera=CAMERA, max_error={"centroid_px": 1e-9, "flux": 1e-3}))
    window = replace(plan.options[0][0], modelled={}, modelled_flux={}, drawn={"samples": 0.5})
    made = account(plan, Drawn(irradiance_W_m2=np.zeros((1, 1), np.float32), small_bodies=(), windows=(window,),
                               bodies=plan.bodies, is_late=False))
    ends = {text.split()[1]: text.split("; ")[1] for text in made.warnings}
    assert ends == {"flux": 'the backend "raytrace" draws it',
                    "centroid_px": "the least predicted of any frame of this view is 0.0003"}


def test_the_use_of_an_image_is_checked():
    for field, value, limits in (("error_gain", 0.0, "1e-09 and 1"), ("error_gain", 1.1, "1e-09 and 1"),
                                 ("apart_px", -1.0, "0 and 256"), ("apart_px", 257.0, "0 and 256")):
        with pytest.raises(ConfigError, match=f"{field}: must be between {limits}"):
            ImageUse(**{field: value})
    assert WHOLE_IMAGE == ImageUse(error_gain=1, apart_px=0)
    for value in ({"error_gain": 0.5}, None, 0.5):
        with pytest.raises(ConfigError, match="use: must be an ImageUse of glrender.planner.request, got"):
            Request(camera=CAMERA, max_error=0.02, use=value)


def test_a_budget_is_before_the_point_spread_function_but_for_the_flux():
    """0.02 behind a function that leaves a quarter."""
    request = Request(camera=CAMERA, max_error=0.02, use=ImageUse(error_gain=0.25))
    assert request.budget(Group.of([view()], CAMERA), "rays") == Budget(tolerance=0.08, flux=0.002)
