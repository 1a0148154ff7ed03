"""Finer shapes of parts of a body. Truth: float64 rays against one fine mesh of a closed form, whose part they are."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import raytracer
import views
from glrender import Body, ConfigError, Pose, Renderer, Shape, State, frames, generate
from glrender.brdf import Lambert
from glrender.scene.scene_file import Files, body
from glrender.scene.shape.bisection import bisected
from glrender.scene.shape.planar import area, between, located
from glrender.scene.shape.regions import Region, with_regions
from scipy.ndimage import binary_erosion
from scipy.spatial.transform import Rotation

GREY = Lambert(normal_albedo=0.2)
UP = np.array([0.3, 0.5, 0.8]) / np.linalg.norm([0.3, 0.5, 0.8])
EAST = np.cross(UP, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(UP, [0.0, 0.0, 1.0]))
HALF_ANGLE = np.radians(25.0)


def bumpy(direction):
    """Places (N, 3) [m] of an ellipsoid with hills and knobs, in directions from its centre."""
    x, y, z = d = (direction / np.linalg.norm(direction, axis=-1, keepdims=True)).T
    radius_m = 1.0 / np.sqrt((x / 250.0) ** 2 + (y / 200.0) ** 2 + (z / 170.0) ** 2)
    return (d * radius_m * (1.0 + 0.03 * np.sin(5 * x + 2 * y) * np.cos(4 * z)
                            + 0.004 * np.sin(40 * x) * np.sin(37 * y + 20 * z))).T


@cache
def fine(subdivisions):
    """Facets of 1.7 degrees at 5, of 0.9 at 6."""
    mesh = generate.icosphere(radius_m=1.0, subdivisions=subdivisions)
    return Shape.from_arrays(bumpy(mesh.vertices_m), mesh.facets)


@cache
def cap(subdivisions=5, half_angle=HALF_ANGLE, turned=1, lean=0.0):
    """What of the fine mesh lies around `UP`, or around a direction that leans to `EAST`."""
    whole = fine(subdivisions)
    middle = whole.vertices_m[whole.facets].mean(axis=1)
    chosen = middle @ (np.cos(lean) * UP + np.sin(lean) * EAST) > np.cos(half_angle) * np.linalg.norm(middle, axis=1)
    return Shape.from_arrays(whole.vertices_m, whole.facets[chosen][:, ::turned])


def parts(shape, n_region):
    """Facets (F,) by number: 0 of the body, 1 of the region, 2 of the strip, as `with_regions` orders them."""
    seam = shape.report.seams[-1]
    kind = np.full(len(shape.facets), 2)
    kind[:len(kind) - seam.n_strip] = 1
    kind[:len(kind) - seam.n_strip - n_region] = 0
    return kind


def aimed(target_m, camera_m, phase_deg):
    phase = np.radians(phase_deg)
    return State(t_s=0.0, r_sun_inertial_m=1.496e11 * (np.cos(phase) * UP + np.sin(phase) * EAST),
                 spacecraft=Pose(r_inertial_m=camera_m, q_from_inertial=frames.look_at(camera_m, target_m)),
                 bodies={"body": Pose(r_inertial_m=np.zeros(3), q_from_inertial=[1.0, 0.0, 0.0, 0.0])})


def test_a_region_replaces_what_lies_beneath():
    """The mesh is closed, has each facet of the region in its place, and one surface along each ray from the middle."""
    region, whole = cap(), with_regions(fine(4), [Region(shape=cap())])
    assert whole.report.is_watertight
    assert (whole.report.n_shells, whole.report.n_flipped, whole.report.n_welded) == (1, 0, 0)
    assert whole.report.warnings == ()
    own = parts(whole, len(region.facets)) == 1
    np.testing.assert_array_equal(whole.vertices_m[whole.facets[own]], region.vertices_m[region.facets])
    # Solid angles of facets that face outward sum to that of a sphere: nothing is covered twice (van Oosterom 1983).
    a, b, c = np.moveaxis(whole.vertices_m[whole.facets] / np.linalg.norm(whole.vertices_m[whole.facets], axis=-1,
                                                                          keepdims=True), 1, 0)
    dot = lambda u, v: np.einsum("ij,ij->i", u, v)  # noqa: E731
    solid_angle = 2.0 * np.arctan2(dot(a, np.cross(b, c)), 1.0 + dot(a, b) + dot(b, c) + dot(c, a))
    assert solid_angle.min() > 0.0
    assert solid_angle.sum() == pytest.approx(4.0 * np.pi, rel=1e-12)


def test_the_gap_is_the_height_of_the_rim_over_the_body():
    """A cap of a plane's grid, 3 m above a plane, and 8 m above it at one vertex of its rim."""
    plane = np.array([[-1e3, -1e3, 0.0], [1e3, -1e3, 0.0], [1e3, 1e3, 0.0], [-1e3, 1e3, 0.0]])
    x, y = np.meshgrid(np.arange(-50.0, 51.0, 10.0), np.arange(-50.0, 51.0, 10.0))
    number = np.arange(x.size).reshape(x.shape)
    quads = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=-1).reshape(-1, 4)
    vertices = np.stack([x.ravel(), y.ravel(), np.full(x.size, 3.0)], axis=1)
    vertices[0, 2] = 8.0
    patch = Shape.from_arrays(vertices, np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]]))
    made = with_regions(Shape.from_arrays(plane, [[0, 1, 2], [0, 2, 3]]), [Region(shape=patch)])
    seam = made.report.seams[0]
    assert seam.gap_max_m == pytest.approx(8.0, rel=0.01)  # the mean normal leans by half a degree
    assert seam.gap_rms_m == pytest.approx(np.sqrt((39 * 9.0 + 64.0) / 40), rel=0.01)
    assert made.report.n_open_edges == 16  # the plane's four, in four each
    assert "up to 8" in made.report.warnings[-1]
    # Around the strip the plane is the plane.
    far = np.abs(made.vertices_m).max(axis=1) > 50.0 + 2.0 * seam.width_m
    assert far.any()
    np.testing.assert_array_equal(made.vertices_m[far, 2], 0.0)


def test_a_site_of_decimetres_on_a_planet_is_one_body():
    """20 facets of 1,700 km and posts of 0.1 m: closed, places to a micrometre, ground around in small steps."""
    planet = generate.icosphere(radius_m=1.7374e6, subdivisions=0)
    x, y = np.meshgrid(np.arange(-20, 21) * 0.1, np.arange(-20, 21) * 0.1)
    number = np.arange(x.size).reshape(x.shape)
    quads = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=-1).reshape(-1, 4)
    height = 0.02 * np.sin(7.0 * x) * np.sin(5.0 * y)
    patch = Shape.from_arrays(np.stack([x, y, height], axis=-1).reshape(-1, 3),
                              np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]]))
    facet = planet.vertices_m[planet.facets[0]]
    normal, middle = planet.facet_normals[0], facet.mean(axis=0)
    across = (facet[1] - facet[0]) / np.linalg.norm(facet[1] - facet[0])
    axes = np.stack([across, np.cross(normal, across), normal], axis=1)
    site = Body(name="moon", shape=planet, brdf=GREY, regions=[Region(
        shape=patch, r_region_body_m=middle, q_body_from_region=frames.quaternion(axes))])
    assert site.shape.report.is_watertight
    assert site.shape.report.seams[0].gap_max_m < 0.021
    assert len(site.shape.facets) < len(patch.facets) + 5000
    own = site.shape.vertices_m[site.shape.facets[parts(site.shape, len(patch.facets)) == 1]]
    there = (own - middle) @ axes
    np.testing.assert_allclose(there, patch.vertices_m[patch.facets], atol=2e-9 * 1e3)


def test_later_regions_lie_over_earlier_ones_and_may_have_their_laws():
    dark, bright = Lambert(normal_albedo=0.05), Lambert(normal_albedo=0.5)
    made = Body(name="body", shape=fine(3), brdf=GREY, regions=[
        Region(shape=cap(4), brdf=dark), Region(shape=cap(5, np.radians(12.0)), brdf=bright)])
    assert made.shape.report.is_watertight
    assert list(made.materials.values()) == [GREY, dark, bright]
    assert len(made.parts) == 3
    assert made.parts[2].shape.report.n_facets == len(cap(5, np.radians(12.0)).facets)
    middle = made.parts[2].shape.vertices_m.mean(axis=0)
    assert middle @ UP > 0.95 * np.linalg.norm(middle)
    assert 0 < made.parts[1].shape.report.n_facets < len(cap(4).facets)
    same = Body(name="body", shape=fine(3), brdf=GREY, regions=[Region(shape=cap(4))])
    assert same.parts == (same,)


def test_holes_of_a_region_are_closed():
    whole = cap()
    middle = np.argmax(whole.vertices_m @ UP)
    holed = Shape.from_arrays(whole.vertices_m, whole.facets[(whole.facets != middle).all(axis=1)])
    made = with_regions(fine(4), [Region(shape=holed)])
    assert made.report.is_watertight
    assert made.report.warnings == ("1 holes in regions[0] closed by flat facets",)


@pytest.mark.parametrize(("region", "message"), [
    (lambda: Region(shape=cap(4, turned=-1)), "regions[0].shape: must face outward as the body does"),
    (lambda: Region(shape=cap(4), r_region_body_m=[0.0, 0.0, 500.0]), "regions[0]: must lie on the body"),
    (lambda: Region(shape=cap(4), r_region_body_m=300.0 * UP), "regions[0]: must be within 0.5 of its extent"),
    (lambda: Region(shape=Shape.from_arrays(1e-3 * cap(4).vertices_m, cap(4).facets)), "is its length unit right"),
    (lambda: Region(shape=Shape.from_arrays(1e3 * cap(4).vertices_m, cap(4).facets)), "at most 0.5 of the body's area"),
    (lambda: Region(shape=fine(3)), "must have at most 0.5 of the body's area"),
    (lambda: Region(shape=generate.icosphere(radius_m=10.0, subdivisions=1)), "must be an open surface with a rim"),
    (lambda: Region(shape=Shape.from_arrays(cap(4).vertices_m, cap(4).facets[[0, -1]])),
     "regions[0].shape: must be in one piece"),
    (lambda: Region(shape=Shape.from_arrays(cap(4).vertices_m, cap(4).facets, sides="both")),
     "regions[0].sides: must be front"),
    (lambda: "cap", "regions[0]: must be a Region")])
def test_a_region_that_is_not_a_part_of_the_body_is_refused(region, message):
    with pytest.raises(ConfigError) as refused:
        Body(name="body", shape=fine(4), brdf=GREY, regions=[region()])
    assert message in str(refused.value)


@pytest.mark.parametrize(("changed", "message"), [
    ({"regions": Region(shape=cap(4))}, "regions: must be a list of Region"),
    ({"regions": (each for each in [Region(shape=cap(4), brdf=GREY)])}, "regions: must be a list of Region"),
    ({"shape": Shape.from_arrays(cap(4).vertices_m, cap(4).facets, sides="both")}, "sides: must be front of a body"),
    ({"albedo_map": np.ones((4, 8))}, "albedo_map: goes with regions if it is of longitudes")])
def test_a_body_that_takes_no_regions_is_refused(changed, message):
    with pytest.raises(ConfigError, match=message):
        Body(**{"name": "body", "shape": fine(4), "brdf": GREY, "regions": [Region(shape=cap(4))]} | changed)


def test_a_rim_that_is_far_off_is_logged(caplog):
    raised = Shape.from_arrays(1.08 * cap(5, np.radians(10.0)).vertices_m, cap(5, np.radians(10.0)).facets)
    (text,) = with_regions(fine(4), [Region(shape=raised)]).report.warnings
    assert "off the shape around" in text and text in caplog.text


@cache
def ball(subdivisions, height=0.008):
    """A sphere of 250 m with hills of 1.4 m RMS, whose turned parts lie on it everywhere."""
    mesh = generate.icosphere(radius_m=1.0, subdivisions=subdivisions)
    x, y, z = mesh.vertices_m.T
    hills = np.sin(9 * x + 2 * y) * np.cos(11 * z) + np.sin(17 * x - 3 * z) * np.sin(13 * y + 5 * z)
    return Shape.from_arrays(250.0 * mesh.vertices_m * (1.0 + height * hills[:, None]), mesh.facets)


@pytest.mark.parametrize("turned_deg, height, is_doubted", [(0, 0.008, False), (15, 0.008, True), (180, 0.008, True),
                                                            (0, 0.0, False)])
def test_ground_of_elsewhere_is_doubted_on_a_round_body_too(turned_deg, height, is_doubted):
    """Its rim is less than 5 % of its extent off. A plain sphere has no relief to compare."""
    whole = ball(5)
    middle = whole.vertices_m[whole.facets].mean(axis=1)
    site = Shape.from_arrays(whole.vertices_m, whole.facets[middle @ UP > np.cos(HALF_ANGLE) * 250.0])
    q = Rotation.from_rotvec(np.radians(turned_deg) * (UP if turned_deg > 90 else EAST)).as_quat(scalar_first=True)
    report = with_regions(ball(4, height), [Region(shape=site, q_body_from_region=q)]).report
    (seam,) = report.seams
    assert seam.gap_max_m < 0.05 * seam.extent_m
    assert [text[:38] for text in report.warnings] == ["the body's vertices beneath regions[0]"] * is_doubted
    if not height:
        assert np.isnan(seam.relief_m)


def test_a_region_that_reaches_over_the_edge_of_open_ground_is_refused():
    ground = cap(4, np.radians(36.0))
    for lean_deg, message in ((13.0, "must lie within the body's surface"), (25.0, "must lie on the body")):
        with pytest.raises(ConfigError, match=message):
            with_regions(ground, [Region(shape=cap(5, np.radians(20.0), lean=np.radians(lean_deg)))])


def test_a_scene_file_has_regions(tmp_path):
    fine(4).to_file(tmp_path / "body.obj")
    cap().to_file(tmp_path / "site.obj")
    table = {"name": "body", "shape": "body.obj", "length_unit": "m", "brdf": {"law": "lambert", "normal_albedo": 0.2},
             "regions": [{"shape": "site.obj", "length_unit": "m"}]}
    made = body(table, "bodies[0]", Files(tmp_path, restricted=True))
    assert len(made.shape.facets) == len(with_regions(fine(4), [Region(shape=cap())]).facets)
    for change, message in (({"shape": "../site.obj"}, "bodies[0].regions[0].shape: must be a bare file name"),
                            ({"unit": "m"}, "bodies[0].regions[0].unit: unknown key"),
                            ({"r_region_body_m": [1.0]}, "bodies[0].regions[0].r_region_body_m"),
                            ({"r_region_body_m": [0.0, 0.0, 900.0]}, "bodies[0].regions[0]: must lie on the body")):
        wrong = {**table, "regions": [{**table["regions"][0], **change}]}
        with pytest.raises(ConfigError) as refused:
            body(wrong, "bodies[0]", Files(tmp_path, restricted=True))
        assert message in str(refused.value)


@pytest.mark.parametrize("engine", ["coverage", "rays", "raster"])
def test_neither_sky_nor_light_comes_through_the_seam(engine):
    """At night, behind the terminator, the seam fills the frame: every pixel sees ground, and none has light."""
    made = Body(name="body", shape=fine(4), brdf=GREY, regions=[Region(shape=cap())])
    rim = bumpy(np.cos(HALF_ANGLE) * UP + np.sin(HALF_ANGLE) * EAST)
    camera = views.camera(96, 150.0)
    with Renderer(views.scene([made], [camera])) as renderer:
        night = renderer.render(aimed(rim, 1.4 * rim, 170.0), engine=engine, products=["irradiance", "facet_id"])
    facet = night.products["facet_id"]
    assert facet.min() >= 0
    assert set(parts(made.shape, len(cap().facets))[np.unique(facet)]) == {0, 1, 2}
    np.testing.assert_array_equal(night.irradiance_W_m2, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize("place", ["whole", "above", "rim"])
def test_frames_are_those_of_one_fine_mesh(place):
    """At 0, 60 and 100 degrees: as predicted of the mesh that is drawn, and nearer the fine one than without a region.

    The region's inner pixels are those of the fine mesh within the prediction, and at 100 degrees, where shadows of
    coarser ground fall on them, nearer to it than the coarse mesh's. Those of the strip are as far from it as the
    coarse mesh's, and a quarter farther at most where light grazes it.
    """
    region, coarse, whole = cap(6), fine(4), fine(6)
    made = Body(name="body", shape=coarse, brdf=GREY, regions=[Region(shape=region)])
    site, edge = bumpy(UP), np.cos(HALF_ANGLE) * UP + np.sin(HALF_ANGLE) * EAST
    target, camera_m, focal_px = {"whole": (np.zeros(3), 3000.0 * UP, 1000.0),
                                  "above": (site, site + 200.0 * UP, 210.0),
                                  "rim": (bumpy(edge), bumpy(edge) + 60.0 * edge, 140.0)}[place]
    camera, kind = views.camera(176, focal_px), parts(made.shape, len(region.facets))
    with Renderer(views.scene([made], [camera], max_error=0.02)) as renderer:
        for phase_deg in (0.0, 60.0, 100.0):
            state = aimed(target, camera_m, phase_deg)
            image = renderer.render(state, products=["irradiance", "facet_id"])
            drawn, finest, without = (raytracer.trace([("body", mesh.vertices_m, mesh.facets, GREY)], camera, state,
                                                      views.SOLAR_IRRADIANCE_W_M2, 5)[0]
                                      for mesh in (made.shape, whole, coarse))
            mean, light = finest[finest > 0.0].mean(), image.irradiance_W_m2
            assert views.relative_rms(light, drawn) <= image.plan.predicted_error + 5e-3  # the truth's own noise
            assert views.relative_rms(light, finest) <= 1.01 * views.relative_rms(without, finest)
            facet = image.products["facet_id"]
            owner = np.where(facet >= 0, kind[facet], -1)
            region_off, strip_off = ([np.sqrt(np.mean((each - finest)[binary_erosion(owner == number)] ** 2)) / mean
                                      for each in (light, without)] for number in (1, 2))
            assert strip_off[0] <= (1.05 if phase_deg < 90.0 else 1.25) * strip_off[1]
            assert region_off[0] <= (image.plan.predicted_error if phase_deg < 90.0 else region_off[1])


# Triangles in a plane


def test_bisection_keeps_places_and_opens_no_crack():
    sphere = generate.icosphere(radius_m=10.0, subdivisions=2)
    small_m = 0.3

    def is_coarse(vertices, facets):
        middle = vertices[facets].mean(axis=1)
        sides = np.linalg.norm(vertices[facets] - vertices[np.roll(facets, 1, axis=1)], axis=-1).max(axis=1)
        return (middle[:, 2] > 9.0) & (sides > small_m)

    vertices, facets, parent = bisected(sphere.vertices_m, sphere.facets.astype(np.int64), is_coarse, 100_000)
    assert not is_coarse(vertices, facets).any()
    made = Shape.from_arrays(vertices, facets)
    assert made.report.is_watertight
    assert made.report.n_flipped == 0
    np.testing.assert_allclose(np.bincount(parent, made.facet_areas_m2), sphere.facet_areas_m2, rtol=1e-12)
    np.testing.assert_allclose(made.facet_normals, sphere.facet_normals[parent], atol=1e-9)


def test_triangles_between_an_outline_and_a_hole_keep_every_corner():
    """Also of corners in a line, which earcut leaves out; no triangle's circle holds a corner that it could see."""
    def square(half, count):
        side = np.linspace(-half, half, count, endpoint=False)
        return np.concatenate([np.stack(each, axis=1) for each in (
            (side, 0 * side - half), (0 * side + half, side), (-side, 0 * side + half), (0 * side - half, -side))])

    points = np.concatenate([square(10.0, 7), square(8.0, 40)])
    made = between(points, np.arange(28), np.arange(28, 188))
    sizes = [area(points[each]) for each in made]
    assert sum(sizes) == pytest.approx(400.0 - 256.0, rel=1e-6)
    assert min(sizes) > -1e-6
    sides = {(a, b) for each in made for a, b in zip(each, np.roll(each, -1), strict=True)}
    assert all((k, (k + 1) % 28) in sides for k in range(28))
    assert all((28 + (k + 1) % 160, 28 + k) in sides for k in range(160))
    # No triangle runs along the strip: its sides are no longer than across it and along two of the outline's.
    assert max(np.linalg.norm(points[each] - points[np.roll(each, 1)], axis=1).max() for each in made) < 4.5


def test_points_are_located_in_the_triangles_at_them(rng):
    corners = rng.uniform(-1.0, 1.0, (300, 3, 2))
    turned = np.array([area(each) for each in corners]) < 0.0
    corners[turned] = corners[turned][:, ::-1]
    corners[0, 1] = corners[0, 0]  # without an area
    points = rng.uniform(-0.8, 0.8, (50, 2))
    with np.errstate(all="raise"):
        point, triangle, weights = located(points, corners)
    np.testing.assert_allclose(np.einsum("ij,ijk->ik", weights, corners[triangle]), points[point], atol=1e-12)
    found = set(zip(point.tolist(), triangle.tolist(), strict=True))
    side = np.roll(corners, -1, axis=1) - corners
    away = points[:, None, None] - corners
    inside = (side[..., 0] * away[..., 1] - side[..., 1] * away[..., 0] > 0.0).all(axis=-1)
    assert found == set(zip(*(each.tolist() for each in np.nonzero(inside)), strict=True))
