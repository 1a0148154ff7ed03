"""How much light: flux of spheres and polyhedra, units, shadows, determinism, backends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import raytracer
import solids
import views
from backends import WORKING, backend_or_skip
from cells import slow_but
from data_folders import ITOKAWA
from glrender import Body, Pose, Renderer, Shape, frames, generate
from glrender.base.constants import AU_M, SUN_RADIUS_M
from glrender.brdf import Hapke, Lambert, LommelSeeliger, LunarLambert
from phase_functions import mcewen, phi_lambert, phi_lommel_seeliger

HAPKE = Hapke(single_scattering_albedo=0.33, b=0.25, c=1.0, shoe_amplitude=1.4, shoe_width=0.05, roughness_deg=28.0)

# law, geometric albedo times phase function; photometry.md section 3
CLOSED_FORMS = {
    "lambert": (Lambert(normal_albedo=0.4), lambda g: 0.4 * (2 / 3) * phi_lambert(g)),
    "lommel_seeliger": (LommelSeeliger(single_scattering_albedo=0.3), lambda g: 0.3 / 8 * phi_lommel_seeliger(g)),
    "lunar_lambert": (LunarLambert(normal_albedo=0.2, weight="mcewen"),
                      lambda g: 0.2 * (mcewen(np.degrees(g)) * phi_lommel_seeliger(g)
                                       + 2 / 3 * (1 - mcewen(np.degrees(g))) * phi_lambert(g))),
}


@pytest.fixture(scope="module", params=[*CLOSED_FORMS, "hapke"])
def sphere_of(request):
    """A renderer of an icosphere of 81,920 facets, its law and the closed form of its flux, if it has one.

    From 1e6 radii: nearer, parallax alone moves a crescent's flux (3 / (pi - g) per radian of phase).
    """
    law, closed_form = CLOSED_FORMS.get(request.param, (HAPKE, None))
    with Renderer(views.scene([views.sphere(law, 6)], [views.camera(384, 1.65e8)])) as renderer:
        yield renderer, law, closed_form


@pytest.mark.parametrize("phase_deg", slow_but([0.0, 10.0, 30.0, 60.0, 90.0, 120.0, 150.0, 160.0, 170.0], 0, 3, 5, 8))
def test_flux_of_a_sphere(sphere_of, phase_deg):
    """F (R / range)^2 p Phi(g) within the mesh's bias of 0.02 % + 0.1 %, and the sum over its facets within 0.1 %.

    Lunar-Lambert's closed form holds while its weight is positive, to 100 degrees; Hapke has none.
    """
    renderer, law, closed_form = sphere_of
    range_m = 1e8
    state = views.state(phase_deg=phase_deg, range_m=range_m, sun_distance_au=2.0)
    flux = renderer.render(state, samples=8).irradiance_W_m2.sum(dtype=np.float64)
    solar = views.SOLAR_IRRADIANCE_W_M2 / 4.0
    shape = renderer.scene.bodies[0].shape
    sun = state.r_sun_inertial_m / np.linalg.norm(state.r_sun_inertial_m)
    to_camera = state.spacecraft.r_inertial_m / range_m
    mu0, mu = np.maximum(shape.facet_normals @ sun, 0.0), np.maximum(shape.facet_normals @ to_camera, 0.0)
    over_facets = (law.brdf(sun, to_camera, shape.facet_normals) * mu0 * mu * shape.facet_areas_m2).sum()
    np.testing.assert_allclose(flux, solar * over_facets / range_m**2, rtol=1e-3)
    if closed_form is not None and (not isinstance(law, LunarLambert) or phase_deg < 100.0):
        expected = solar * (100.0 / range_m) ** 2 * closed_form(np.radians(phase_deg))
        np.testing.assert_allclose(flux, expected, rtol=1.2e-3)


def test_flux_of_a_polyhedron_is_the_sum_over_its_facets():
    """80 facets, convex: the sum of brdf mu0 mu A / range^2, 1e-3 (sampling of the edges)."""
    law = Lambert(normal_albedo=0.5)
    body = views.sphere(law, 1)
    state = views.state(phase_deg=70.0, range_m=1e6)
    with Renderer(views.scene([body], [views.camera(256, 1.1e6)])) as renderer:
        image = renderer.render(state, samples=8)
    corner = body.shape.vertices_m[body.shape.facets]
    area_normal = 0.5 * np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    sun = state.r_sun_inertial_m / np.linalg.norm(state.r_sun_inertial_m)
    to_camera = state.spacecraft.r_inertial_m / 1e6
    area = np.linalg.norm(area_normal, axis=1)
    mu0, mu = area_normal @ sun / area, area_normal @ to_camera / area
    flux = (0.5 / np.pi * np.maximum(mu0, 0) * np.maximum(mu, 0) * area).sum() * views.SOLAR_IRRADIANCE_W_M2 / 1e12
    np.testing.assert_allclose(image.irradiance_W_m2.sum(dtype=np.float64), flux, rtol=1e-3)


def test_flux_does_not_depend_on_range_down_to_a_thousandth_of_a_pixel():
    """Identity of photometry.md section 1.6 at 200 to 0.001 px across, 1 %."""
    law = Lambert(normal_albedo=0.5)
    with Renderer(views.scene([views.sphere(law, 4)], [views.camera(256, 1000.0)])) as renderer:
        for diameter_px in (200.0, 20.0, 5.0, 3.9, 1.0, 0.5, 0.1, 0.001):
            range_m = 200.0 * 1000.0 / diameter_px
            aside = np.array([0.0132, 0.0, 0.0211]) * range_m
            state = views.state(phase_deg=60.0, range_m=range_m, target=aside)
            image = renderer.render(state)
            expected = (views.SOLAR_IRRADIANCE_W_M2 * (100.0 / range_m) ** 2 * 0.5 * 2 / 3
                        * phi_lambert(np.radians(60.0)))
            tolerance = 0.03 if diameter_px > 100 else 0.01  # near by, less of the sphere is in view
            np.testing.assert_allclose(image.irradiance_W_m2.sum(dtype=np.float64), expected, rtol=tolerance)
            if diameter_px < 5.0:
                # A pixel's light counts at its centre: what the closed form's centre falls between.
                offset = np.abs(views.centroid_px(image.irradiance_W_m2) - renderer.scene.cameras[0].project(
                    frames.dcm(state.spacecraft.q_from_inertial) @ -state.spacecraft.r_inertial_m))
                assert (offset < 0.5 + 0.3 * diameter_px).all()


def test_solid_angle_falls_off_as_cos_cubed():
    """A wall that fills a wide field: E / (I/F F/pi) is the pixel's solid angle, cos^3(theta) / f^2.

    2e-4 is 1/256 px at this focal length: NVIDIA's cards interpolate between vertices that are snapped to it.
    """
    law = Lambert(normal_albedo=1.0)
    camera = views.camera(64, 40.0)
    body = views.sphere(law, 4, 1e6)
    with Renderer(views.scene([body], [camera])) as renderer:
        image = renderer.render(views.state(phase_deg=0.0, range_m=1e6 + 2e5), samples=1, products=["incidence"])
    radiance = views.SOLAR_IRRADIANCE_W_M2 / np.pi * np.cos(image.products["incidence"].astype(np.float64))
    np.testing.assert_allclose(image.irradiance_W_m2 / radiance, camera.solid_angle_sr(), rtol=2e-4)


@pytest.mark.parametrize("phase_deg", [10.0, 60.0, 90.0, 120.0])
def test_shadows_take_no_light_from_a_convex_body(phase_deg, monkeypatch):
    """Acne shows as lost flux: shadow map on against off on a sphere, 0.1 % (photometry.md section 4.3)."""
    from glrender.planner import body_plan as plan

    law = Lambert(normal_albedo=0.5)
    state = views.state(phase_deg=phase_deg)
    with Renderer(views.scene([views.sphere(law, 5)], [views.camera()])) as renderer:
        without = renderer.render(state, samples=2)
        assert without.plan.bodies[0].shadow_map_px is None, "a convex body alone needs no shadow map"
        for size in (256, 1024, 4096):
            monkeypatch.setattr(plan, "plan_shadow", lambda *_, size=size: size)
            with_map = renderer.render(state, samples=2)
            monkeypatch.undo()
            np.testing.assert_allclose(with_map.irradiance_W_m2.sum(), without.irradiance_W_m2.sum(),
                                       rtol=1e-3 if phase_deg < 100 else 3e-3)


@pytest.mark.parametrize("phase_deg", [5.0, 60.0, 110.0])
def test_a_real_shape_agrees_with_rays(phase_deg):
    """Itokawa, 12k facets: flux within 0.2 %, RMS within the planner's prediction; 6 x 6 rays a pixel."""
    law = Lambert(normal_albedo=0.3)
    body = Body.from_file(ITOKAWA, name="body", length_unit="km", brdf=law)
    camera = views.camera(200, 900.0)
    state = views.state(phase_deg=phase_deg, range_m=3000.0)
    truth, *_ = raytracer.trace([("body", body.shape.vertices_m, body.shape.facets, law)], camera, state,
                                views.SOLAR_IRRADIANCE_W_M2, 6)
    with Renderer(views.scene([body], [camera])) as renderer:
        image = renderer.render(state, max_error=0.02)
    error = np.sqrt(np.mean((image.irradiance_W_m2 - truth)[truth > 0] ** 2)) / truth[truth > 0].mean()
    assert image.plan.predicted_error <= 0.02
    assert error < 0.03, "the truth's own sampling adds about 0.01"
    np.testing.assert_allclose(image.irradiance_W_m2.sum(dtype=np.float64), truth.sum(), rtol=2e-3)


def test_more_samples_come_closer_to_rays():
    """Each doubling of the samples cuts the error by 2 or more."""
    law = Lambert(normal_albedo=0.3)
    body = Body.from_file(ITOKAWA, name="body", length_unit="km", brdf=law)
    camera, state = views.camera(128, 600.0), views.state(range_m=3000.0)
    truth, *_ = raytracer.trace([("body", body.shape.vertices_m, body.shape.facets, law)], camera, state,
                                views.SOLAR_IRRADIANCE_W_M2, 8)
    with Renderer(views.scene([body], [camera])) as renderer:
        error = [np.sqrt(np.mean((renderer.render(state, samples=n).irradiance_W_m2 - truth) ** 2)) for n in (1, 2, 4)]
    assert error[0] > 2.0 * error[1] and error[1] > 1.5 * error[2], error


@pytest.mark.parametrize("options", [{}, {"samples": 3}], ids=["planned", "by OpenGL"])
def test_the_same_request_gives_the_same_bytes_whatever_came_before(options):
    """A reused shadow map is the one that a fresh renderer draws: history does not show."""
    body = Body(name="body", shape=views.binary(3), brdf=Lambert(normal_albedo=0.2))
    scene = views.scene([body], [views.camera(128, 500.0)])
    state = views.state(phase_deg=70.0)
    nudged = views.state(phase_deg=70.003)
    with Renderer(scene) as renderer:
        first = renderer.render(state, **options)
        renderer.render(nudged, **options)
        renderer.render(views.state(phase_deg=30.0, range_m=900.0), **options)
        again = renderer.render(state, **options)
    with Renderer(scene) as renderer:
        renderer.render(nudged, **options)
        fresh = renderer.render(state, **options)
    assert first.irradiance_W_m2.tobytes() == again.irradiance_W_m2.tobytes() == fresh.irradiance_W_m2.tobytes()


def test_a_shadow_map_serves_its_epoch_alone():
    body = Body(name="body", shape=views.binary(3), brdf=Lambert(normal_albedo=0.2))
    with Renderer(views.scene([body], [views.camera(128, 500.0)])) as renderer:
        reused = [renderer.render(views.state(phase_deg=g), samples=2).plan.bodies[0].shadow_map_reused
                  for g in (70.0, 70.0, 70.001, 70.0)]
    assert reused == [False, True, False, True]


def test_maps_of_one_frame_do_not_take_each_others_place():
    """Two bodies, after eight small maps: the second's large one was drawn over the first's, at 21 % of the flux."""
    bodies = [Body(name=name, shape=views.binary(seed), brdf=Lambert(normal_albedo=0.2))
              for seed, name in enumerate(("first", "second"))]
    q = np.array([1.0, 0.0, 0.0, 0.0])
    moon = {"second": Pose(r_inertial_m=np.array([230.0, 40.0, 60.0]), q_from_inertial=q)}
    states = [views.state(phase_deg=g) for g in (70.0, 60.0, 50.0, 40.0)]
    states = [replace(state, bodies={"first": state.bodies["body"], **moon}) for state in states]
    scene = views.scene(bodies, [views.camera(128, 300.0)])
    with Renderer(scene) as renderer:
        for state in states:
            small = renderer.render(state, samples=1, max_error=0.3)
        after = renderer.render(states[0], samples=1, max_error=0.01)
        sizes = [max(body.shadow_map_px for body in image.plan.bodies) for image in (small, after)]
        assert all(body.shadow_map_px == sizes[1] > sizes[0] for body in after.plan.bodies)
        renderer.forget_shadow_maps()
        fresh = renderer.render(states[0], samples=1, max_error=0.01)
    assert after.irradiance_W_m2.tobytes() == fresh.irradiance_W_m2.tobytes()


def test_egl_and_osmesa_draw_the_same_image():
    """Two ways to one software rasteriser: 0.1 % of the pixels may differ by an edge sample."""
    backend_or_skip("osmesa")
    backend_or_skip("egl")
    body = Body(name="body", shape=views.binary(3), brdf=Lambert(normal_albedo=0.2))
    images = []
    for backend in WORKING:
        with Renderer(views.scene([body], [views.camera(128, 500.0)]), backend=backend) as renderer:
            images.append(renderer.render(views.state()).irradiance_W_m2)
    assert (np.abs(images[0] - images[1]) > 1e-6 * images[0].max()).mean() < 1e-3
    np.testing.assert_allclose(images[0].sum(), images[1].sum(), rtol=1e-5)


def test_two_renderers_of_one_process_do_not_mix():
    """Bindings are global in GL: each draw binds its own (engine.md)."""
    dark, bright = (views.scene([views.sphere(Lambert(normal_albedo=a), 3)], [views.camera()]) for a in (0.1, 0.9))
    state = views.state()
    with Renderer(dark) as first, Renderer(bright) as second:
        a, b, c = first.render(state), second.render(state), first.render(state)
    np.testing.assert_allclose(b.irradiance_W_m2, 9.0 * a.irradiance_W_m2, rtol=1e-6)
    assert a.irradiance_W_m2.tobytes() == c.irradiance_W_m2.tobytes()


def test_closing_one_renderer_leaves_the_other_whole():
    """Object numbers repeat between contexts: a release in the wrong one would delete the other's buffers."""
    body = Body(name="body", shape=generate.three_lobes(radius_m=100.0), brdf=Lambert(normal_albedo=0.2))
    scene, state = views.scene([body], [views.camera(64, 250.0)]), views.state()
    first = Renderer(scene)
    before = first.render(state, products=["range"])
    second = Renderer(scene)
    second.render(state)
    second.close()
    after = first.render(state, products=["range"])
    third = Renderer(scene)
    first.close()
    last = third.render(state, products=["range"])
    third.close()
    for image in (after, last):
        assert image.irradiance_W_m2.tobytes() == before.irradiance_W_m2.tobytes()
        np.testing.assert_array_equal(image.products["range"], before.products["range"])


def test_the_suns_irradiance_is_that_of_the_cameras_band():
    """Default: E490's of the band (400 to 700 nm: 530.105 W/m2, photometry.md section 1.6), else the total."""
    from glrender_camera import CameraModel, Detector, Optics

    model = CameraModel(optics=Optics(aperture_diameter_m=0.01, band_nm=(400.0, 700.0)), exposure_s=1.0,
                        detector=Detector(quantum_efficiency=0.5, full_well_electrons=1e5,
                                          gain_DN_per_electron=0.04, bit_depth=12))
    cameras = [views.camera(64, 250.0, name="bare"), views.camera(64, 250.0, name="visible", model=model)]
    scene = views.scene([views.sphere(Lambert(normal_albedo=0.5), 3)], cameras, solar_irradiance_1au_W_m2=None)
    with Renderer(scene) as renderer:
        bare, visible = (renderer.render(views.state(), name).irradiance_W_m2.sum() for name in ("bare", "visible"))
    np.testing.assert_allclose(visible / bare, 530.105 / 1360.8, rtol=2e-4)


def test_a_law_beyond_its_phase_is_told_in_the_plan():
    """McEwen's cubic is fitted to about 100 degrees; past it the weight is held, and the image is not black."""
    law = LunarLambert(normal_albedo=0.2, weight="mcewen")
    with Renderer(views.scene([views.sphere(law, 3)], [views.camera(64, 250.0)])) as renderer:
        within, beyond = (renderer.render(views.state(phase_deg=g)) for g in (60.0, 150.0))
    assert within.plan.warnings == ()
    assert "lunar_lambert of body at a phase of 150.0 deg: it holds to" in beyond.plan.warnings[0]
    assert beyond.irradiance_W_m2.max() > 0.0


def test_a_budget_that_cannot_be_met_is_told_in_the_plan():
    with Renderer(views.scene([views.sphere(Lambert(normal_albedo=0.2), 3)], [views.camera(64, 250.0)])) as renderer:
        met, missed = (renderer.render(views.state(), max_error=budget).plan for budget in (0.05, 1e-5))
    assert met.predicted_error <= 0.05 and not met.warnings
    assert missed.predicted_error > 1e-5
    assert "exceeds max_error 1e-05" in missed.warnings[0]


def test_smooth_normals_leave_no_black_limb():
    """Interpolated normals on a coarse sphere at full phase: every pixel of the disc is lit."""
    law = LommelSeeliger(single_scattering_albedo=0.3)
    with Renderer(views.scene([views.sphere(law, 2, smooth_normals=True)], [views.camera()])) as renderer:
        image = renderer.render(views.state(phase_deg=0.0), samples=1, products=["body_id"])
    assert (image.irradiance_W_m2[image.products["body_id"] == 0] > 0.0).all()


@pytest.mark.parametrize("is_smooth", [False, True])
@pytest.mark.parametrize("height", [-0.5, 0.0, 0.5])
def test_a_face_is_lit_by_what_of_the_suns_disc_is_above_it(height, is_smooth):
    """A cube's face whose plane cuts the Sun's disc, at a height in its radii: closed form of the segment.

    A smooth face has the segment's share of a point Sun's light, a flat one its cosines.
    """
    body = Body(name="body", shape=Shape.from_arrays(*solids.box((-50.0,) * 3, (50.0,) * 3)),
                brdf=Lambert(normal_albedo=0.3), smooth_normals=is_smooth)
    radius_rad = SUN_RADIUS_M / AU_M
    cosine, total = (abs(height) * radius_rad + 1e-5 if is_smooth else 0.01), []
    for sun_disc, phase_rad in ((True, np.arccos(height * radius_rad)), (False, np.arccos(cosine))):
        state = views.state(phase_deg=np.degrees(phase_rad), direction=(0.0, 0.0, 1.0))
        with Renderer(views.scene([body], [views.camera(96)], sun_disc=sun_disc)) as renderer:
            total.append(renderer.render(state, samples=4, engine="raster").irradiance_W_m2.sum(dtype=float))
    above = np.linspace(-height, 1.0, 100001)
    light = 1.0 if is_smooth else radius_rad * (height + above) / cosine
    expected = np.trapezoid(light * np.sqrt(1.0 - above**2), above) / (0.5 * np.pi)
    np.testing.assert_allclose(total[0] / total[1], expected, rtol=0.015)


def test_an_albedo_texture_scales_the_albedo(shared):
    """Itokawa's map at half strength gives half the light of the full one, and structure of its own."""
    files = shared / "itokawa"
    make = lambda gain: Body.from_file(  # noqa: E731
        files / "itokawa_64q_49152_uv.obj", name="body", length_unit="km", brdf=Lambert(normal_albedo=0.3),
        albedo_texture=files / "itokawa_albedo.jpg", albedo_texture_gain=gain)
    images = []
    for gain in (1.0, 0.5):
        with Renderer(views.scene([make(gain)], [views.camera(200, 900.0)])) as renderer:
            images.append(renderer.render(views.state(phase_deg=20.0, range_m=3000.0)).irradiance_W_m2)
    np.testing.assert_allclose(images[1], 0.5 * images[0], rtol=1e-5, atol=1e-12)
