"""Levels of detail by areas: as wrong as was measured, as bright as what they stand for, chosen where they do."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import views
from glrender import Body, Pose, Renderer, generate, lod
from glrender.area_engine import AreaEngine
from glrender.area_grid import CELL_PX
from glrender.area_levels import area_levels
from glrender.backends.raytrace import RayTracer
from glrender.brdf import Lambert, LommelSeeliger
from glrender.costs import EngineCosts
from glrender.error_model import BodyTraits, LevelTraits
from glrender.facet_relief import FacetRelief, LevelShape
from glrender.grouping import region
from glrender.level_tables import PHASES_RAD, SIZES_PX, AreaLevel
from glrender.plan import plan_body
from glrender.plan_areas import choose_areas
from glrender.ray_engine import RayEngine
from glrender.render_plan import LevelPlan
from glrender.surface import Surface
from glrender.view import view_bodies

GREY = Lambert(normal_albedo=0.3)
# A ray is dear.
COSTS = EngineCosts(facet_ns=100.0, sample_ns=20.0, ray_ns=1e5, lone_ray_ns=1e5, area_ns=128.0)
CHEAP_RAYS = replace(COSTS, ray_ns=200.0, lone_ray_ns=400.0)


@pytest.fixture(scope="module")
def rough():
    """A rough body, its levels, and what they cost."""
    body = views.rough_body(GREY)
    return body, *area_levels(body, lod.levels_of_detail(body.shape))


def test_a_level_is_as_wrong_as_was_measured(rough):
    """From twelve other sides, at other sizes and phases, beside the full shape: nine in ten within, and not by far."""
    body, shapes, levels = rough
    rng, ratios, fluxes, centres = np.random.default_rng(2), [], [], []
    for _ in range(12):
        size_px, phase_deg = 10.0 ** rng.uniform(0.9, 2.5), rng.uniform(5.0, 140.0)
        camera = views.camera(512, 10.0 * size_px)
        scene = views.scene([body], [camera], sun_disc=False)
        state = views.state(phase_deg=phase_deg, direction=rng.standard_normal(3),
                            range_m=20.0 * body.hull.radius_m, sun_in_image=rng.standard_normal(2))
        seen, rays = view_bodies(state, camera, scene.hulls), RayEngine(scene)
        areas = AreaEngine(scene, rays, {"body": shapes})
        x0, y0, x1, y1 = region(seen, camera)

        def draw(level, budget, areas=areas, camera=camera, seen=seen, box=(x0, y0, x1, y1)):
            x0, y0, x1, y1 = box
            return areas.draw(("body",), camera, seen, (x0 - 0.5, y0 - 0.5, x1 - 0.5, y1 - 0.5), (x1 - x0, y1 - y0),
                              budget, {"body": level})[0]

        truth = draw(LevelPlan(), 0.005)
        for level in levels:
            mean, scatter = level.flux_at(seen[0].phase_rad, size_px)
            image = draw(replace(level.kind, flux_ratio=mean), 0.01)
            # With what the truth itself errs by.
            ratios.append(views.relative_rms(image, truth) / np.hypot(level.error_at(seen[0].phase_rad, size_px), 1e-3))
            fluxes.append(abs(image.sum() / truth.sum() - 1.0) / (scatter + 5e-4))
            places = [np.array([image.sum(axis=axis) @ np.arange(image.shape[1 - axis]) for axis in range(2)])
                      / image.sum() for image in (image, truth)]
            centres.append(np.linalg.norm(places[0] - places[1]) / size_px
                           / (level.centre_at(seen[0].phase_rad) + 1e-4))
    assert np.mean(np.array(ratios) <= 1.0) >= 0.9 and max(ratios) < 1.5, "of all that is told"
    assert np.median(ratios) > 0.4, "it is not told far too much"
    assert np.mean(np.array(fluxes) <= 2.0) >= 0.9 and np.mean(np.array(centres) <= 1.0) >= 0.9


def test_middles_have_another_flux_where_they_are_small(rough):
    """Where facets overlap is seen, and taken off, in small cells only: mean of ten other sides at 12 px and at 400."""
    body, shapes, levels = rough
    level = next(level for level in levels if level.kind.by_middles and not level.kind.number)
    rng, errors = np.random.default_rng(4), {12.0: [], 400.0: []}
    for _ in range(10):
        to_camera, aside = rng.standard_normal((2, 3))
        for size_px, found in errors.items():
            camera = views.camera(512, 10.0 * size_px)
            scene = views.scene([body], [camera], sun_disc=False)
            seen = view_bodies(views.state(phase_deg=90.0, direction=to_camera, range_m=20.0 * body.hull.radius_m,
                                           sun_in_image=aside), camera, scene.hulls)
            areas = AreaEngine(scene, RayEngine(scene), {"body": shapes})
            light, truth = (areas.draw(("body",), camera, seen, camera.bounds_px, (512, 512), 0.005,
                                       {"body": kind})[0].sum() for kind in (level.kind, LevelPlan()))
            found.append(light / truth)
    ratios = {size_px: level.flux_at(np.radians(90.0), size_px)[0] for size_px in errors}
    assert ratios[400.0] - ratios[12.0] > 1e-3
    for size_px, found in errors.items():
        assert abs(np.mean(found) * ratios[size_px] - 1.0) < 4e-4


@pytest.mark.parametrize(("size_px", "n_cells"), [(3.0, 3.0 / CELL_PX), (50.0, 50.0)])
def test_the_flux_is_told_by_the_cells_that_a_body_is_wide(rough, monkeypatch, size_px, n_cells):
    """Below 4 px they are its own, of 0.28 px: middles overlap there as those of a larger body."""
    asked, flux_at = [], AreaLevel.flux_at
    monkeypatch.setattr(AreaLevel, "flux_at", lambda level, phase_rad, cells: (
        asked.append(cells), flux_at(level, phase_rad, cells))[1])
    body, _, _ = rough
    state = views.state(phase_deg=60.0, range_m=20.0 * body.hull.radius_m)
    with Renderer(views.scene([body], [views.camera(64, 10.0 * size_px)], sun_disc=False)) as renderer:
        monkeypatch.setattr(renderer, "_costs", COSTS)
        renderer.render(state, max_error=0.05)
    assert asked and asked == pytest.approx([n_cells] * len(asked), rel=1e-3)


def test_relief_makes_levels_as_bright_as_what_they_stand_for(rough):
    """From side to side the flux differs from the full shape's by half of a flat level's, and so does the image."""
    _, _, levels = rough
    by_areas = [level for level in levels if not level.kind.by_middles]
    flat, relief = ([level for level in by_areas if level.kind.has_relief == has_relief]
                    for has_relief in (False, True))
    assert [level.kind.number for level in flat] == [level.kind.number for level in relief] == [1, 2]
    phase_rad = np.radians(60.0)
    for one, other in zip(flat, relief, strict=True):
        assert other.flux_at(phase_rad, 100.0)[1] < 0.6 * one.flux_at(phase_rad, 100.0)[1]
        assert abs(other.flux_at(phase_rad, 100.0)[0] - 1.0) < 0.5 * abs(one.flux_at(phase_rad, 100.0)[0] - 1.0) + 2e-3
        assert other.error_at(phase_rad, 16.0) < 0.9 * one.error_at(phase_rad, 16.0)
        assert other.error_at(0.0, 16.0) < 0.4 * one.error_at(0.0, 16.0), "where there are no shadows"


@pytest.mark.parametrize("law", [GREY, LommelSeeliger(single_scattering_albedo=0.3)], ids=lambda law: law.glsl)
@pytest.mark.parametrize("phase_deg", [0.0, 40.0, 100.0])
def test_relief_is_the_mean_over_what_the_camera_sees(law, phase_deg):
    """A flat facet that stands for two ridges' sides, by the law itself: within the steps of the table."""
    tilt, phase = np.radians(25.0), np.radians(phase_deg)
    to_camera, to_sun = np.array([np.sin(0.3), 0.1, np.cos(0.3)]), None
    to_camera = to_camera / np.linalg.norm(to_camera)
    across = np.cross(to_camera, [0.2, 1.0, 0.1])
    to_sun = np.cos(phase) * to_camera + np.sin(phase) * across / np.linalg.norm(across)
    sides = np.array([[np.sin(tilt), 0.0, np.cos(tilt)], [-np.sin(tilt), 0.0, np.cos(tilt)]])
    shape = generate.icosphere(radius_m=1.0, subdivisions=1)
    level = LevelShape(shape=shape, begin=np.array([0, 2]), normal=np.rint(sides * 32767).astype(np.int16),
                       weight=np.array([1.0, 3.0], np.float32))
    relief = FacetRelief(level, Surface(Body(name="body", shape=shape, brdf=law)), to_sun, to_camera)
    flat = np.array([[0.0], [0.0], [1.0]])

    def radiance(normal):
        return law.brdf(to_sun, to_camera, normal) * np.maximum(normal @ to_sun, 0.0)

    shown = np.array([1.0, 3.0]) * np.maximum(sides @ to_camera, 0.0)
    expected = shown @ radiance(sides) / shown.sum() - radiance(flat.T)[0]
    assert relief.added(np.zeros(1, np.intp), flat)[0] == pytest.approx(expected, abs=0.004 * law.brdf(
        to_camera, to_camera, to_camera))


@pytest.mark.parametrize("budget", [0.1, 0.05])
def test_a_frame_by_a_level_is_within_what_its_plan_tells(monkeypatch, rough, budget):
    """Against rays: the image, and its flux within a tenth of the budget; the plan tells of the facets left out."""
    body, _, _ = rough
    scene = views.scene([body], [views.camera(64, 400.0)], sun_disc=False)
    state = views.state(phase_deg=40.0, range_m=2000.0)
    with Renderer(scene) as renderer, RayTracer(scene) as tracer:
        monkeypatch.setattr(renderer, "_costs", COSTS)
        image = renderer.render(state, max_error=budget)
        again = renderer.render(state, max_error=budget)
        truth = tracer.render(state, samples=32).irradiance_W_m2.astype(float)
    window, (told,) = image.plan.windows[0], image.plan.bodies
    assert window.engine == "areas" and window.levels[0].number == told.level > 0
    assert told.n_facets < 25_000 and told.flux_ratio == window.levels[0].flux_ratio
    assert any("facets" in line for line in image.plan.left_out)
    assert image.irradiance_W_m2.tobytes() == again.irradiance_W_m2.tobytes()
    assert image.plan.to_dict()["windows"][0]["levels"][0]["number"] == told.level
    light = image.irradiance_W_m2.astype(float)
    assert views.relative_rms(light, truth) <= image.plan.predicted_error <= budget
    assert light.sum() == pytest.approx(truth.sum(), rel=0.1 * budget)


def test_a_body_that_is_not_drawn_by_areas_has_no_levels_of_them(rough):
    body, _, _ = rough
    smooth = replace(body, smooth_normals=True)
    assert area_levels(smooth, lod.levels_of_detail(body.shape)) == ((), ())
    assert area_levels(body, ()) == ((), ())


def table(number, *, error=0.0, scatter=0.0, centre=0.0, n_facets=12_000, n_normals=0, by_middles=False, told=0.0,
          n_points=0):
    phases, sizes = np.ones(len(PHASES_RAD)), np.ones((len(PHASES_RAD), len(SIZES_PX)))
    kind = LevelPlan(number=number, has_relief=n_normals > 0, by_middles=by_middles, n_points=n_points)
    return AreaLevel(kind=kind, n_facets=n_points or n_facets, n_normals=n_normals, crease_rad=0.2,
                     error=error * sizes, flux_ratio=1.01 * sizes, flux_scatter=scatter * sizes,
                     centre=centre * phases, told=told * sizes)


def chosen(levels, budget, *, n_bodies=1, range_m=2000.0, px=100.0, casters=(), frame_px=512, penumbra=0.0,
           costs=COSTS, without=(), apart_m=250.0, moon_m=20.0, reflectance=(0.1, 0.1), is_alone=False, first_rad=None):
    """What is chosen of bodies of 49,000 facets beside each other, of a size in the image; some without levels."""
    shape = generate.icosphere(radius_m=100.0, subdivisions=1)
    names = [f"body{k}" for k in range(n_bodies)]
    camera = views.camera(frame_px, px * range_m / 200.0)
    scene = views.scene([Body(name=name, shape=shape, brdf=GREY) for name in names], [camera], sun_disc=False)
    state = views.state(phase_deg=60.0, range_m=range_m, bodies=names)
    state = replace(state, bodies={name: Pose(r_inertial_m=[apart_m * k, 0.0, 0.0]) for k, name in enumerate(names)})
    seen = view_bodies(state, camera, scene.hulls)
    seen[0] = replace(seen[0], phase_rad=seen[0].phase_rad if first_rad is None else first_rad)
    known = {name: BodyTraits(radius_m=100.0, is_convex=False, law="lambert", max_phase_rad=np.pi,
                              levels=(LevelTraits(n_facets=49_000, crease_rad=0.15),
                                      *(LevelTraits(n_facets=each.n_facets, crease_rad=0.15) for each in levels)),
                              area_levels=() if name in without else tuple(levels), even_facet_m=1.0,
                              reflectance=each) for name, each in zip(names, reflectance, strict=False)}
    if not is_alone:
        known["moon"] = replace(known[names[0]], radius_m=moon_m)
    drawn = [replace(plan_body(view, known[view.name], camera, casters, budget, 0), penumbra_error=penumbra)
             for view in seen]
    return choose_areas(seen, known, drawn, camera, budget, 1.0, costs, n_px=0.6 * px**2, shown_share=1.0)


def test_the_cheapest_level_that_leaves_enough_of_the_budget_is_chosen():
    fine, coarse = table(1, error=0.01), table(2, error=0.03, n_facets=3000)
    assert [chosen([fine, coarse], budget).levels[0].number for budget in (0.1, 0.03, 0.012)] == [2, 1, 0]
    whole, part = chosen([], 0.1), chosen([fine], 0.1)
    assert part.ns < 0.5 * whole.ns and part.error >= 0.01 > whole.error
    assert part.levels[0].flux_ratio == pytest.approx(1.01) and not part.levels[0].has_relief
    assert whole.levels == (LevelPlan(),)


@pytest.mark.parametrize("level, why", [
    (table(1, scatter=0.0051), "its flux scatters by more than a tenth of the budget"),
    (table(1, centre=0.07 / 100.0), "its centre is more than 0.0625 px off"),
    (table(1, error=0.041), "it takes more than 0.8 of the budget"),
    (table(1, n_normals=10_000_000), "its normals cost more than the facets that it saves")])
def test_a_level_that_would_not_do_is_left(level, why):
    assert chosen([level], 0.05).levels == (LevelPlan(),), why
    assert chosen([table(1)], 0.05).levels[0].number == 1


def test_middles_have_hard_edges_of_shadows():
    """Those count, as middles do not tell of them."""
    told = table(0, error=0.03, n_facets=49_000, by_middles=True)
    one = chosen([told], 0.05, costs=CHEAP_RAYS)
    assert one.levels[0].by_middles and one.levels[0].number == 0 and one.ns < 0.5 * chosen([], 0.05).ns
    assert chosen([told], 0.05, penumbra=0.02).levels == (LevelPlan(),)


def test_a_lone_body_is_drawn_by_middles_where_its_frame_will_tell_that_they_do():
    """What one that is not costs twice counts; sides that were not measured do not, as the frame tells of them."""
    def told(told, error=0.04, **known):
        return chosen([table(0, error=error, told=told, n_facets=49_000, by_middles=True)], 0.05, costs=CHEAP_RAYS,
                      **known)

    likely, less, never = (told(error, is_alone=True) for error in (0.03, 0.045, 0.2))
    assert likely.levels[0].by_middles and likely.ns < less.ns and less.levels[0].by_middles
    assert never.levels == (LevelPlan(),)
    assert likely.error < 0.01, "the frame tells the rest"
    assert told(0.03).levels == (LevelPlan(),), "beside others no frame tells: 1.3 times 0.04 is too much"
    assert told(0.03, error=0.051, is_alone=True).levels == (LevelPlan(),), "as wrong as that it was measured"
    assert told(0.03, penumbra=0.048, is_alone=True).levels == (LevelPlan(),), "0.014 is left"


def test_points_stand_for_a_lone_body_alone():
    """They cost what they are, not what the shape is; beside others something would have to be cut."""
    def points(n_points=16_000, is_alone=True, **table_of):
        return chosen([table(0, by_middles=True, n_points=n_points, **table_of)], 0.05, is_alone=is_alone,
                      costs=CHEAP_RAYS)

    one, twice = points(error=0.03), points(32_000, error=0.03)
    assert one.levels[0].n_points == 16_000 and one.ns < 0.7 * twice.ns < 0.7 * chosen([], 0.05, costs=CHEAP_RAYS).ns
    assert one.error == pytest.approx(1.3 * 0.03, rel=0.01), "no frame tells: that of other sides is more"
    assert points(error=0.036).levels == (LevelPlan(),) and points(error=0.03, is_alone=False).levels == (LevelPlan(),)
    assert points(scatter=0.0024).levels[0].n_points and points(scatter=0.0026).levels == (LevelPlan(),)


def test_bodies_that_are_drawn_together_are_by_middles_all_or_none():
    """What they hide of each other counts, by the facets' size: of 0.5 px little, of 11 px more than the budget."""
    told = table(0, error=0.02, n_facets=49_000, by_middles=True)
    apart, close = (chosen([told], 0.05, n_bodies=2, apart_m=apart_m, costs=CHEAP_RAYS) for apart_m in (250.0, 120.0))
    assert all(level.by_middles for level in close.levels) and apart.error < close.error < 0.05 and apart.ns < close.ns
    coarse = table(0, error=0.02, n_facets=100, by_middles=True)
    assert chosen([coarse], 0.05, n_bodies=2, costs=CHEAP_RAYS).levels[0].by_middles
    assert chosen([coarse], 0.05, n_bodies=2, apart_m=120.0, costs=CHEAP_RAYS).levels == (LevelPlan(), LevelPlan())
    assert chosen([told], 0.05, n_bodies=2, without=("body1",), costs=CHEAP_RAYS).levels == (LevelPlan(), LevelPlan())


def test_of_middles_that_cost_about_the_same_the_best_are_taken():
    fine, coarse, cheap = (table(k, error=error, n_facets=n_facets, by_middles=True)
                           for k, error, n_facets in ((0, 0.01, 49_000), (1, 0.03, 40_000), (2, 0.04, 10_000)))
    assert chosen([fine, coarse], 0.1, costs=CHEAP_RAYS).levels[0].number == 0
    assert chosen([fine, coarse, cheap], 0.1, costs=CHEAP_RAYS).levels[0].number == 2


def test_of_large_shapes_it_is_kept_what_is_lit():
    """Just below 100,000 facets each frame is shaded anew, just above half of them."""
    below, above = (chosen([table(0, error=0.01, n_facets=n_facets, by_middles=True)], 0.05, costs=CHEAP_RAYS)
                    for n_facets in (99_000, 101_000))
    assert above.levels[0].by_middles and above.ns < 0.95 * below.ns


def test_middles_of_a_body_that_may_be_dark_are_left():
    """In a large body's shadow there may be nothing left of the light that errors are told over."""
    told = table(0, error=0.01, n_facets=49_000, by_middles=True)
    small, large = (chosen([told], 0.05, casters=("moon",), moon_m=radius_m, costs=CHEAP_RAYS)
                    for radius_m in (20.0, 100.0))
    assert small.levels[0].by_middles and not large.levels[0].by_middles


def test_a_body_exactly_before_the_sun_is_planned_beside_another():
    """Nothing of it is lit, and no part of nothing is asked for."""
    assert math.isfinite(chosen([table(1, error=0.02)], 0.05, n_bodies=2, first_rad=math.pi).error)


def test_bright_bodies_err_by_more_beside_dark_ones():
    level = table(1, error=0.02)
    alike, unlike = (chosen([level], 0.05, n_bodies=2, reflectance=each) for each in ((0.1, 0.1), (0.5, 0.02)))
    assert [each.number for each in alike.levels] == [1, 1] and [each.number for each in unlike.levels] == [1, 1]
    assert unlike.error == pytest.approx(math.sqrt(2.0) * alike.error, rel=0.1)


def test_levels_are_of_bodies_seen_from_afar_and_no_larger_than_was_measured():
    assert chosen([table(1)], 0.05, range_m=790.0).levels[0].number == 0
    assert chosen([table(1)], 0.05, range_m=810.0).levels[0].number == 1
    assert chosen([table(1)], 0.05, px=530.0).levels[0].number == 0
    assert chosen([table(1)], 0.05, px=500.0).levels[0].number == 1


def test_what_is_left_of_a_body_in_a_shadow_or_beside_the_frame_is_not_as_was_measured():
    """40 px of Didymos that a shadow left had an RMS error of 0.21 by a level that was told to have 0.09."""
    assert chosen([table(1)], 0.05, casters=("moon",)).levels[0].number == 0
    assert chosen([table(1)], 0.05, frame_px=90).levels[0].number == 0


def test_each_of_several_bodies_has_its_level():
    assert [level.number for level in chosen([table(1)], 0.05, n_bodies=2).levels] == [1, 1]
