"""Surface detail: the height function, its GLSL twin, its geometry in Cycles, and that nothing changes without it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import solids
import views
from cells import slow_but
from glrender import Body, Boulders, ConfigError, Craters, Detail, Noise, Pose, Renderer, Scene, State, frames, generate
from glrender.base.constants import AU_M
from glrender.brdf import Hapke, Lambert
from glrender.engines.cycles import Cycles
from glrender.engines.cycles.displaced_mesh import displaced
from glrender.engines.rays.backend import RayTracer
from glrender.scene.detail.height_field import Relief
from glrender.scene.detail.layers import BOULDER, CRATER, layers_of
from glrender.view.view import view_bodies

GREY = Lambert(normal_albedo=0.3)
NOISE = Noise(amplitude_m=0.2, longest_m=10.0, shortest_m=0.2)
CRATERS = Craters(largest_m=8.0, smallest_m=1.0, coverage=0.1)
BOULDERS = Boulders(largest_m=2.0, smallest_m=0.4, coverage=0.05)
DETAIL = Detail(seed=3, noise=NOISE, craters=CRATERS, boulders=BOULDERS)
KINDS = [Detail(seed=5, noise=NOISE), Detail(seed=5, craters=CRATERS), Detail(seed=5, boulders=BOULDERS)]


def relief(detail=DETAIL, facet_m=1e3):
    return Relief(detail, facet_m, 300.0)


def scene(detail, camera, law=GREY, **kwargs):
    return views.scene([views.sphere(law, 2, detail=detail)], [camera], sun_disc=False, **kwargs)


def pixels(image):
    return image.irradiance_W_m2.astype(np.float64)


@pytest.mark.parametrize("detail", KINDS, ids=["noise", "craters", "boulders"])
def test_the_gradient_is_that_of_the_height(detail, rng):
    """Against central differences of 1e-5 m: what they leave out is below 1e-4 of any slope."""
    ground, r = relief(detail), rng.uniform(-300.0, 300.0, (20000, 3))
    _, gradient = ground(r, 1e-3)
    steps = 1e-5 * np.eye(3)
    numeric = np.stack([(ground(r + step, 1e-3)[0] - ground(r - step, 1e-3)[0]) / 2e-5 for step in steps], axis=1)
    # Where a profile's curvature jumps, differences across it are off by the step.
    np.testing.assert_allclose(numeric, gradient, atol=5e-4)
    assert np.abs(gradient).max() > 0.1


def test_the_height_is_bounded_and_its_slope_is_the_one_that_is_told(rng):
    """|h| below the sum of the layers' rises; the slope's RMS over a plane within 10 % of `slope_rms`."""
    ground, r = relief(), rng.uniform(-300.0, 300.0, (200_000, 3))
    height, gradient = ground(r, 1e-3)
    assert np.abs(height).max() < ground.bound_m
    assert np.abs(height).max() > 0.2 * ground.bound_m
    along = gradient[:, :2]
    np.testing.assert_allclose(np.sqrt((along**2).sum(axis=1).mean()), ground.slope_rms(1e-3), rtol=0.1)


@pytest.mark.parametrize("kind, detail, below", [
    # A crater's ground is below the plain up to where 1.2 s(t) = 1, s the smooth step: t = 0.7409 of its rim's square.
    (CRATER, Detail(seed=8, craters=Craters(largest_m=4.0, smallest_m=4.0, coverage=0.12)), 0.7409**1.5),
    (BOULDER, Detail(seed=8, boulders=Boulders(largest_m=4.0, smallest_m=4.0, coverage=0.2)), 1.0)],
    ids=["craters", "boulders"])
def test_coverage_is_the_share_of_a_plane_that_features_cover(kind, detail, below):
    """What a plane cuts of spheres is their share of the volume: within 2 % on half a square kilometre."""
    side, covered = np.linspace(-350.0, 350.0, 1400), 0.0
    plane = [*(axis.ravel() for axis in np.meshgrid(side, side)), np.full(side.size**2, 17.3)]
    for layer in layers_of(detail):
        assert layer.kind == kind
        height, _ = layer(plane)
        covered += np.mean(height > 0.0 if kind == BOULDER else height < 0.0) / below
    np.testing.assert_allclose(covered, (detail.craters or detail.boulders).coverage, rtol=0.02)


def test_equal_seeds_give_equal_ground_and_others_another():
    """The function is the seed's: the same to the last bit, and uncorrelated with the next one's."""
    r = np.random.default_rng(4).uniform(-300.0, 300.0, (5000, 3))
    first, again, other = (relief(replace(DETAIL, seed=seed))(r, 1e-3)[0] for seed in (7, 7, 8))
    assert first.tobytes() == again.tobytes()
    assert abs(np.corrcoef(first, other)[0, 1]) < 0.1
    # Written down once: another machine, or another version, that draws other ground fails here.
    told = relief()(np.array([[1.0, 2.0, 3.0], [-40.0, 55.5, 0.25]]), 1e-3)
    np.testing.assert_allclose(told[0], [-0.11951285766013141, 0.03407916392810151], rtol=1e-12)


def test_no_scale_below_two_footprints_is_drawn():
    """The spectrum of a line across the ground: beyond the pixel's own frequency there is nothing to alias."""
    footprint = 0.5
    x = np.arange(2**15) * 0.05
    line = np.stack([x, 0.37 * x, 0.11 * x + 5.0], axis=1) / np.linalg.norm([1.0, 0.37, 0.11])
    power = np.abs(np.fft.rfft(relief(KINDS[0])(line, footprint)[0] * np.hanning(len(x)))) ** 2
    frequency = np.fft.rfftfreq(len(x), 0.05)
    assert power[frequency > 1.0 / footprint].sum() < 1e-3 * power.sum()
    assert not relief().active(6.0)
    assert len(relief().active(1.0)) < len(relief().active(1e-3)) == len(relief().layers)


@pytest.mark.parametrize("range_m, focal_px, is_close", [(2000.0, 20000.0, False), (130.0, 1000.0, False),
                                                         (101.0, 900.0, True)])
@pytest.mark.parametrize("law", [GREY, Hapke(single_scattering_albedo=0.4, b=0.35, c=1.0, roughness_deg=20.0)],
                         ids=["lambert", "hapke"])
def test_the_shader_is_its_float64_twin(range_m, focal_px, is_close, law):
    """OpenGL's pixels are those of rays with `Relief.normals` to float32, from afar and from near: 1e-3 RMS."""
    camera = views.camera(128, focal_px)
    ground = scene(DETAIL, camera, law)
    state = views.state(phase_deg=50.0, range_m=range_m)
    with Renderer(ground) as renderer, RayTracer(ground) as tracer, Renderer(scene(None, camera, law)) as bare:
        image, truth, flat = (engine.render(state, samples=1) for engine in (renderer, tracer, bare))
    assert image.plan.bodies[0].relative_to_camera == is_close
    assert image.plan.bodies[0].detail_m is not None
    mean = pixels(truth).mean()
    assert np.sqrt(np.mean((pixels(image) - pixels(truth)) ** 2)) < 1e-3 * mean
    assert np.sqrt(np.mean((pixels(flat) - pixels(truth)) ** 2)) > 0.1 * mean


def test_no_seam_between_facets():
    """A square slab of two triangles: across their common edge pixels differ as elsewhere."""
    range_m = 2000.0
    body = Body(name="body", shape=solids.slab(half_m=100.0), brdf=GREY, detail=DETAIL)
    base = views.state(range_m=range_m, direction=(0.0, 0.0, 1.0))
    state = State(r_sun_inertial_m=AU_M * np.array([0.6, 0.3, 0.74]), spacecraft=base.spacecraft, bodies=base.bodies)
    camera = views.camera(256, 256 / 40.0 * range_m)
    with Renderer(views.scene([body], [camera], sun_disc=False)) as renderer:
        image = renderer.render(state, samples=2, products=["facet_id"])
    facet, light = image.products["facet_id"], pixels(image)
    assert len(np.unique(facet)) == 2
    across = facet[:, 1:] != facet[:, :-1]
    step = np.abs(np.diff(light, axis=1)) / light.mean()
    assert across.sum() > 100 and step[across].std() > 0.0
    np.testing.assert_allclose(step[across].mean(), step[~across].mean(), rtol=0.25)


def test_flux_is_what_it_was_within_what_slopes_tell():
    """Of a ground of RMS slope s, seen from above with the Sun 30 deg off, the mean falls by at most s^2."""
    camera, state = views.camera(128, 20000.0), views.state(phase_deg=30.0, range_m=2000.0)
    with Renderer(scene(DETAIL, camera)) as renderer, Renderer(scene(None, camera)) as bare:
        image, flat = renderer.render(state, samples=3), bare.render(state, samples=3)
    # The footprint at the nearest point is 0.095 m.
    slope = scene(DETAIL, camera).bodies[0].relief.slope_rms(1900.0 / 20000.0)
    assert 0.1 < slope < 0.5
    ratio = pixels(image).sum() / pixels(flat).sum()
    assert 1.0 - slope**2 < ratio < 1.0


def test_a_body_that_is_not_asked_for_detail_or_too_far_away_is_drawn_as_ever():
    """Not one byte changes; the plan says why there is none."""
    camera, state = views.camera(64, 60.0), views.state(range_m=2000.0)
    with Renderer(scene(DETAIL, camera)) as renderer, Renderer(scene(None, camera)) as bare:
        for samples in (None, 3):
            image, flat = renderer.render(state, samples=samples), bare.render(state, samples=samples)
            assert image.irradiance_W_m2.tobytes() == flat.irradiance_W_m2.tobytes()
    assert "body: surface detail: no pixel resolves it" in image.plan.left_out
    assert image.plan.bodies[0].detail_m is None
    assert not any("detail" in told for told in flat.plan.left_out)


def test_equal_requests_give_equal_bytes_whatever_came_between():
    camera, near, far = views.camera(96, 3000.0), views.state(range_m=300.0), views.state(range_m=900.0, phase_deg=20.0)
    with Renderer(scene(DETAIL, camera)) as renderer:
        first = renderer.render(near)
        renderer.render(far)
        again = renderer.render(near)
    assert first.irradiance_W_m2.tobytes() == again.irradiance_W_m2.tobytes()
    assert any("of surface detail what is" in told for told in first.plan.left_out)


@pytest.mark.parametrize("phase_deg", slow_but([30.0, 70.0], 1))
def test_the_planners_error_is_kept(phase_deg):
    """Against 8 x 8 samples: true RMS error within what the plan says, which is within the budget."""
    camera, state = views.camera(128, 1500.0), views.state(phase_deg=phase_deg, range_m=260.0, sun_in_image=(0.3, 1.0))
    with Renderer(views.scene([views.sphere(GREY, 3, detail=DETAIL)], [camera], sun_disc=False)) as renderer:
        truth = pixels(renderer.render(state, samples=8))
        image = renderer.render(state, max_error=0.02)
    lit = truth > 0.0
    error = np.sqrt(np.mean((pixels(image) - truth)[lit] ** 2)) / truth[lit].mean()
    assert error < image.plan.predicted_error <= 0.02 + 1e-6


@pytest.mark.usefixtures("blender")
@pytest.mark.parametrize("phase_deg, correlation, flux", slow_but([(30.0, 0.99, 0.005), (60.0, 0.98, 0.01)], 1))
def test_cycles_draws_the_ground_that_opengl_shades(phase_deg, correlation, flux):
    """Displaced facets of a pixel's size: Cycles equals rays at them; OpenGL, which lacks their shadows, correlates."""
    camera, state = views.camera(128, 5000.0), views.state(phase_deg=phase_deg)
    ground = scene(DETAIL, camera)
    body = displaced(ground.bodies[0], view_bodies(state, camera, ground.hulls)[0], camera)
    assert len(body.shape.facets) > 128**2
    with (Cycles(ground, bounces=0) as cycles, Renderer(ground) as renderer,
          RayTracer(views.scene([body], [camera], sun_disc=False)) as tracer):
        drawn, image, truth = (pixels(engine.render(state, samples=4)) for engine in (cycles, renderer, tracer))
    lit = truth > 0.0
    assert np.corrcoef(drawn[lit], truth[lit])[0, 1] > 0.995
    np.testing.assert_allclose(drawn.sum(), truth.sum(), rtol=2e-3)
    assert np.corrcoef(drawn[lit], image[lit])[0, 1] > correlation
    np.testing.assert_allclose(image.sum(), drawn.sum(), rtol=flux)


def test_displaced_facets_hang_together():
    """Every edge of the split sphere has two facets, and no corner is moved by more than the bound."""
    camera, state = views.camera(64, 2500.0), views.state()
    body = scene(DETAIL, camera).bodies[0]
    made = displaced(body, view_bodies(state, camera, {"body": body.hull})[0], camera)
    ends = np.stack([made.shape.facets, np.roll(made.shape.facets, -1, axis=1)], axis=2)
    assert (np.unique(np.sort(ends.reshape(-1, 2), axis=1), axis=0, return_counts=True)[1] == 2).all()
    assert len(made.shape.facets) > 10 * len(body.shape.facets) and made.detail is None
    heights = np.linalg.norm(made.shape.vertices_m, axis=1)
    assert heights.max() < 100.0 + body.relief.bound_m
    # What is not in the frame stays as it is.
    aside = body.shape.vertices_m @ np.asarray(state.spacecraft.r_inertial_m) / 2000.0 < 80.0
    there = {tuple(vertex) for vertex in made.shape.vertices_m}
    assert sum(tuple(vertex) in there for vertex in body.shape.vertices_m[aside]) > 0.8 * aside.sum()


def _table(**detail):
    body = {"name": "body", "generated": {"kind": "icosphere", "radius_m": 100.0}, "detail": detail,
            "brdf": {"law": "lambert", "normal_albedo": 0.3}}
    camera = {"name": "navcam", "width_px": 64, "height_px": 64, "focal_length_px": 100.0}
    return {"bodies": [body], "cameras": [camera]}


def test_a_scene_file_asks_for_it():
    made = Scene.from_dict(_table(seed=3, noise={"amplitude_m": 0.2, "longest_m": 10.0, "shortest_m": 0.2},
                                  craters={"largest_m": 8.0, "smallest_m": 1.0, "coverage": 0.1},
                                  boulders={"largest_m": 2.0, "smallest_m": 0.4, "coverage": 0.05}))
    assert made.bodies[0].detail == DETAIL
    assert made.bodies[0].relief is not None


@pytest.mark.parametrize("detail, path", [
    ({}, "detail"), ({"sand": {}}, "detail.sand"), ({"seed": -1, "noise": vars(NOISE)}, "detail.seed"),
    ({"noise": {"amplitude_m": 1.0}}, "detail.noise.longest_m"),
    ({"noise": {"amplitude_m": 9.0, "longest_m": 1.0, "shortest_m": 1.0}}, "detail.noise.amplitude_m"),
    ({"noise": {"amplitude_m": 0.1, "longest_m": 1.0, "shortest_m": 2.0}}, "detail.noise.shortest_m"),
    ({"craters": {"largest_m": 1.0, "smallest_m": 1.0, "coverage": 0.5}}, "detail.craters.coverage"),
    ({"boulders": {"largest_m": float("nan"), "smallest_m": 1.0, "coverage": 0.1}}, "detail.boulders.largest_m"),
    ({"craters": {"largest_m": 1e4, "smallest_m": 1.0, "coverage": 0.25}}, "detail"),
    ({"boulders": {"largest_m": 1e-5, "smallest_m": 1e-5, "coverage": 0.1}}, "detail")])
def test_a_bad_table_is_told_by_its_field(detail, path):
    with pytest.raises(ConfigError) as caught:
        Scene.from_dict(_table(**detail))
    assert caught.value.path.startswith(f"scene.bodies[0].{path}")


def test_the_ground_turns_with_its_body():
    """The ground is the body's: turned with the camera and the Sun, the picture is the same to float32."""
    camera = views.camera(64, 2500.0)
    base, q = views.state(), np.array([0.8, 0.36, -0.48, 0.0])
    turn = frames.dcm(q).T
    # Hamilton's product takes the camera along.
    w, x, y, z = base.spacecraft.q_from_inertial
    a, b, c, d = q
    turned_q = [w * a - x * b - y * c - z * d, w * b + x * a + y * d - z * c,
                w * c - x * d + y * a + z * b, w * d + x * c - y * b + z * a]
    turned = State(r_sun_inertial_m=turn @ base.r_sun_inertial_m,
                   spacecraft=Pose(r_inertial_m=turn @ base.spacecraft.r_inertial_m, q_from_inertial=turned_q),
                   bodies={"body": Pose(r_inertial_m=np.zeros(3), q_from_inertial=q)})
    with Renderer(scene(DETAIL, camera)) as renderer:
        image, moved = (pixels(renderer.render(state, samples=1)) for state in (base, turned))
    np.testing.assert_allclose(moved, image, atol=0.02 * image.mean())


def test_each_of_several_bodies_has_its_own_ground():
    """One before the other, shadows drawn: rays' image within the planner's error, the flux within 0.2 %."""
    camera, base = views.camera(96, 1300.0), views.state(phase_deg=50.0, range_m=2000.0)
    towards = np.asarray(base.spacecraft.r_inertial_m) / 2000.0
    other = Body(name="other", shape=generate.icosphere(radius_m=20.0, subdivisions=2), brdf=GREY,
                 detail=Detail(seed=9, noise=NOISE))
    made = views.scene([views.sphere(GREY, 3, detail=DETAIL), other], [camera], sun_disc=False)
    state = State(r_sun_inertial_m=base.r_sun_inertial_m, spacecraft=base.spacecraft,
                  bodies={**base.bodies, "other": Pose(r_inertial_m=130.0 * towards + np.array([20.0, 10.0, 0.0]))})
    with Renderer(made) as renderer, RayTracer(made) as tracer:
        image, truth = renderer.render(state, max_error=0.05), pixels(tracer.render(state, samples=4))
    assert [body.detail_m is not None for body in image.plan.bodies] == [True, True]
    lit = truth > 0.0
    error = np.sqrt(np.mean((pixels(image) - truth)[lit] ** 2)) / truth[lit].mean()
    assert error < image.plan.predicted_error
    np.testing.assert_allclose(pixels(image).sum(), truth.sum(), rtol=2e-3)
