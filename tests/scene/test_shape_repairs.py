"""What is repaired in a shape, and what is told of it. Truths: volumes in closed form, meshes before they broke."""

from __future__ import annotations

import itertools
import logging

import numpy as np
import pytest
import serving
import views
from glrender import Body, Pose, Renderer, SceneError, Shape, State, frames, generate
from glrender.base.errors import ShapeError
from glrender.brdf import Lambert
from glrender_client import Client
from programs import run
from scipy.spatial.transform import Rotation
from solids import box, joined

BALL = generate.icosphere(radius_m=1.0, subdivisions=3)
BALL_M3 = BALL.report.volume_m3
N = 41
X, Y = np.meshgrid(np.linspace(-100.0, 100.0, N), np.linspace(-100.0, 100.0, N))
_FIRST = (np.arange(N - 1)[:, None] * N + np.arange(N - 1)).ravel()
SHEET = np.concatenate([np.stack([_FIRST, _FIRST + 1, _FIRST + N + 1], 1),
                        np.stack([_FIRST, _FIRST + N + 1, _FIRST + N], 1)])
GREY = Lambert(normal_albedo=0.2)


def ball(radius=1.0, middle=(0.0, 0.0, 0.0)):
    return radius * BALL.vertices_m + middle, BALL.facets.astype(int)


def cube(size=1.0, low=(0.0, 0.0, 0.0)):
    return box(low, np.asarray(low, float) + size)


def tetrahedron(size=1.0):
    """Between four corners of a cube; a third of it."""
    return (size * np.array([[0, 0, 0], [1, 1, 0], [1, 0, 1], [0, 1, 1]], float),
            np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]))


def terrain(height):
    return np.stack([X.ravel(), Y.ravel(), height.ravel()], axis=1)


def broken(mesh, rng):
    """Turned and moved anyhow, three in ten of its facets turned over."""
    vertices, facets = mesh
    turned = rng.random(len(facets)) < 0.3
    return (vertices @ Rotation.random(rng=rng).as_matrix().T + rng.normal(size=3),
            np.where(turned[:, None], facets[:, ::-1], facets))


@pytest.mark.parametrize("meshes, volume_m3", [
    ([ball(4), ball(3, (0.3, 0, 0))], (64 + 27) * BALL_M3), ([ball(1), ball(1, (5, 0, 0))], 2 * BALL_M3),
    ([ball(1), ball(0.5, (0.9, 0, 0))], 1.125 * BALL_M3), ([cube(), cube(1.0, (1, 1, 0))], 2.0),
    ([cube(), cube(1.0, (1, 1, 1))], 2.0), ([cube(2.0), cube(0.5, (2.0, 0.5, 0.5))], 8.125),
    ([cube(), tetrahedron()], 4 / 3)],
    ids=["within", "apart", "overlapping", "share an edge", "share a corner", "touches a face", "touches a corner"])
def test_closed_shells_face_outward(meshes, volume_m3, rng):
    """The volumes add up, whatever the file's winding and wherever it lies."""
    for _ in range(3):
        report = Shape.from_arrays(*broken(joined(*meshes), rng)).report
        np.testing.assert_allclose(report.volume_m3, volume_m3, rtol=1e-9)
        assert (report.n_shells, report.n_open_edges) == (len(meshes), 0)
        assert any(f"{report.n_flipped} facets turned over" in text for text in report.warnings)


def test_what_is_wound_well_is_left_alone():
    vertices, facets = joined(ball(2), ball(1, (5, 0, 0)))
    shape = Shape.from_arrays(vertices, facets)
    np.testing.assert_array_equal(shape.facets, facets)
    assert shape.report.n_flipped == 0 and shape.report.warnings == ("2 separate shells",)


@pytest.mark.parametrize("name, height", [
    ("hill", 12.0 * np.exp(-(X**2 + Y**2) / 1500.0)), ("crater", -12.0 * np.exp(-(X**2 + Y**2) / 1500.0)),
    ("rim", 9.0 * np.exp(-((np.hypot(X, Y) - 40.0) / 12.0) ** 2)),
    ("deep pit", -300.0 * np.exp(-(X**2 + Y**2) / 900.0)),
    ("valley", 90.0 * np.abs(np.sin(X / 30.0))), ("plain", 0.0 * X), ("slope", 0.7 * X)])
@pytest.mark.parametrize("is_upside_down", [False, True])
def test_open_terrain_stays_as_the_file_has_it(name, height, is_upside_down, rng):
    """Whichever way it faces, and whatever its signed volume; a few facets turned over agree with the rest again."""
    facets = SHEET[:, ::-1] if is_upside_down else SHEET
    shape = Shape.from_arrays(terrain(height), facets)
    np.testing.assert_array_equal(shape.facets, facets)
    turned = rng.random(len(facets)) < 0.2
    mended = Shape.from_arrays(terrain(height), np.where(turned[:, None], facets[:, ::-1], facets))
    np.testing.assert_allclose(mended.facet_normals, shape.facet_normals, atol=1e-12)
    assert mended.report.n_flipped == turned.sum() and shape.report.n_flipped == 0
    assert "160 open edges of a surface that encloses nothing" in shape.report.warnings[0]


def test_an_overhang_of_terrain_is_not_turned_over():
    """A cave: half of a tube below a plain, its wall facing its axis, is open; so is a dome that faces its inside."""
    angle = np.linspace(0.0, np.pi, 13)
    places = np.array([(50.0 * np.cos(a), y, -50.0 * np.sin(a)) for y in (0.0, 30.0) for a in angle])
    facets = np.array([t for k in range(12) for t in ((k, k + 1, k + 14), (k, k + 14, k + 13))])
    for order in (slice(None), slice(None, None, -1)):
        shape = Shape.from_arrays(places, facets[:, order])
        np.testing.assert_array_equal(shape.facets, facets[:, order])


def test_a_moebius_strip_has_no_outside_and_stays():
    turn = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    places = np.array([[(1.0 + w * np.cos(a / 2)) * np.cos(a), (1.0 + w * np.cos(a / 2)) * np.sin(a), w * np.sin(a / 2)]
                       for a in turn for w in (-0.3, 0.3)])
    ends = [(2 * k, 2 * k + 1, *((2 * k + 2, 2 * k + 3) if k < 39 else (1, 0))) for k in range(40)]
    facets = np.array([t for a, b, c, d in ends for t in ((a, b, d), (a, d, c))])
    np.testing.assert_array_equal(Shape.from_arrays(places, facets).facets, facets)


def test_a_holed_shell_has_an_inside():
    """One of 1280 facets missing: told as a hole; a camera in the rock is refused."""
    shape = Shape.from_arrays(ball(4)[0], ball()[1][1:])
    assert "3 open edges of holes in a surface that is closed else" in shape.report.warnings[0] and shape.solid.all()
    hull = Body(name="b", shape=shape, brdf=GREY).hull
    assert [hull.is_outside(np.array([x, 0.3, 0.2])) for x in (2.0, 5.0)] == [False, True]


def test_a_facet_without_an_area_leaves_no_hole():
    """A square prism, one of whose corners is on the top's side: a facet of no area fills the gap, as in many files."""
    vertices, facets = cube()
    vertices = np.concatenate([vertices, [[0.5, 0.0, 1.0]]])
    front = [f for f in facets if (vertices[f][:, 1] == 0.0).all()]
    rest = [f for f in facets if not (vertices[f][:, 1] == 0.0).all()]
    assert len(front) == 2
    made = np.array([*rest, (0, 1, 8), (1, 5, 8), (0, 8, 4), (4, 8, 5)])
    shape = Shape.from_arrays(vertices, made)
    assert (shape.report.n_open_edges, shape.report.n_degenerate) == (0, 1) and shape.solid.all()
    np.testing.assert_allclose(shape.report.volume_m3, 1.0, rtol=1e-12)


def test_both_sides_of_a_panel_stay_and_copies_go():
    vertices, facets = box((0, 0, 0), (1, 1, 1))
    panel, sheet = np.array([[2.0, 0, 0], [4, 0, 0], [4, 1, 0], [2, 1, 0]]), np.array([[8, 9, 10], [8, 10, 11]])
    made = np.concatenate([facets, facets[:3], sheet, sheet[:, ::-1], sheet[:, [1, 2, 0]]])
    shape = Shape.from_arrays(np.concatenate([vertices, panel]), made)
    report = shape.report
    assert (report.n_facets, report.n_duplicate, report.n_two_sided, report.n_open_edges) == (16, 5, 2, 0)
    up = shape.facet_areas_m2[12:] * shape.facet_normals[12:, 2]
    np.testing.assert_allclose(sorted(up), [-1.0, -1.0, 1.0, 1.0], rtol=1e-12)
    at_corners = shape.vertex_normals[shape.facets[12:]][..., 2]
    np.testing.assert_allclose(at_corners, np.repeat(np.sign(up)[:, None], 3, axis=1))
    assert "5 facets left out that are there twice with the same side" in report.warnings
    assert shape.solid.tolist() == [True] * 12 + [False] * 4


def test_a_panel_on_a_box_leaves_the_box_closed():
    """Its root is an edge of the box, where four facets meet."""
    vertices, facets = box((0, 0, 0), (1, 1, 1))
    root = [k for k in range(8) if vertices[k, 0] == 1.0 and vertices[k, 2] == 1.0]
    wing = np.concatenate([vertices, [[3.0, 0, 1], [3.0, 1, 1]]])
    sheet = np.array([[root[0], 8, 9], [root[0], 9, root[1]]])
    for sides in (np.concatenate([sheet, sheet[:, ::-1]]), sheet):
        shape = Shape.from_arrays(wing, np.concatenate([facets[:, ::-1], sides]))
        np.testing.assert_allclose(shape.report.volume_m3, 1.0 + shape_volume(shape, ~shape.solid), rtol=1e-12)
        assert shape.solid.sum() == 12 and shape.report.n_flipped == 12


def shape_volume(shape, chosen):
    """Signed volume of some facets about the mean of the vertices, as the report has it."""
    a, b, c = ((shape.vertices_m - shape.vertices_m.mean(axis=0))[shape.facets[chosen][:, k]] for k in range(3))
    return np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0


def test_two_boxes_that_share_a_wall_stay_two_boxes():
    shape = Shape.from_arrays(*joined(cube(), cube(1.0, (0, 0, 1))))
    assert (shape.report.n_two_sided, shape.report.n_open_edges, shape.report.n_flipped) == (2, 0, 0)
    np.testing.assert_allclose(shape.report.volume_m3, 2.0, rtol=1e-12)


def tiled(vertices, facets, gap, rng, n=6):
    """The same in tiles with vertices of their own, each a little off: a gap is a standard deviation along an axis."""
    tile = np.unique(np.floor(vertices[facets].mean(axis=1) / (np.ptp(vertices, axis=0).max() / n)).astype(int), axis=0,
                     return_inverse=True)[1].ravel()
    parts = []
    for k in range(tile.max() + 1):
        used, index = np.unique(facets[tile == k], return_inverse=True)
        parts.append((vertices[used] + gap * rng.normal(size=(len(used), 3)), index.reshape(-1, 3)))
    return joined(*parts)


@pytest.mark.parametrize("scale", [0.01, 1.0, 1e6])
@pytest.mark.parametrize("gap", [0.0, 1e-8, 1e-7, 1e-6, 3e-6])
def test_seams_are_welded_and_the_tolerance_is_told(scale, gap, rng):
    base = generate.contact_binary(radius_m=1.0, subdivisions=4)
    vertices, facets = tiled(scale * base.vertices_m, base.facets, gap * scale, rng)
    shape = Shape.from_arrays(vertices, facets)
    report = shape.report
    assert (report.n_open_edges, report.n_shells, report.n_flipped, report.n_degenerate) == (0, 1, 0, 0)
    assert (report.n_vertices, report.n_facets) == (len(base.vertices_m), len(base.facets))
    np.testing.assert_allclose(report.volume_m3, scale**3 * base.report.volume_m3, rtol=20 * gap + 1e-12)
    told = [text for text in report.warnings if "open edges welded to others within" in text]
    assert bool(told) == (gap > 0.0) and report.seam_gap_m <= report.seam_tolerance_m <= 1e-4 * scale
    assert report.seam_gap_m > gap * scale or not gap


@pytest.mark.parametrize("offset_m", [1e2, 1e4])
def test_seams_far_from_the_origin_differ_by_float32s_steps(offset_m, rng):
    """A metre's body at a hundred or ten thousand metres: vertices of tiles one step of float32 apart, 0.02 to 1 mm."""
    base = generate.contact_binary(radius_m=1.0, subdivisions=3)
    vertices, facets = tiled(base.vertices_m, base.facets, 0.0, rng)
    step = float(np.spacing(np.float32(offset_m)))
    vertices = (vertices + offset_m).astype(np.float32) + step * rng.integers(0, 2, size=vertices.shape)
    report = Shape.from_arrays(vertices, facets).report
    assert (report.n_open_edges, report.n_shells, report.n_facets) == (0, 1, len(base.facets))
    np.testing.assert_allclose(report.volume_m3, base.report.volume_m3, rtol=10 * step)


@pytest.mark.parametrize("mesh, n_vertices", [
    (box((0, 0, 0), (1, 1, 1e-7)), 8), (joined(box((0, 0, 0), (1, 1, 1)), box((0, 0, 1 + 1e-6), (1, 1, 2))), 16),
    (joined(*[(np.array([[0, 0, z], [1, 0, z], [1, 1, z], [0, 1, z]], float), np.array([[0, 1, 2], [0, 2, 3]]))
              for z in (0.0, 0.01)]), 8)], ids=["plate", "gap between boxes", "two sheets"])
def test_thin_features_are_not_welded(mesh, n_vertices):
    """Of what is closed none, however thin; of sheets a gap of a hundredth of their edges."""
    report = Shape.from_arrays(*mesh).report
    assert (report.n_vertices, report.n_seam, report.n_degenerate) == (n_vertices, 0, 0)


@pytest.mark.parametrize("height, r_m", [
    (80.0 * np.exp(-((X - 50) ** 2 + Y**2) / 400) + 80.0 * np.exp(-((X + 50) ** 2 + Y**2) / 400), (0.0, 0.0, 20.0)),
    (90.0 * np.abs(np.sin(X / 30.0)), (0.0, 0.0, 10.0)), (-300.0 * np.exp(-(X**2 + Y**2) / 900.0), (0.0, 0.0, -250.0)),
    (40.0 * np.abs(X / 100.0), (0.0, 0.0, -1.0))], ids=["two mountains", "valley", "deep pit", "below the sheet"])
def test_a_camera_among_mountains_is_outside(height, r_m):
    """Open terrain has no inside, wherever in its hull the camera is; from below it is seen through."""
    shape = Shape.from_arrays(terrain(height), SHEET)
    body = Body(name="ground", shape=shape, brdf=GREY)
    state = State(r_sun_inertial_m=[0.3e11, 0, 1.5e11], bodies={"ground": Pose(r_inertial_m=[0, 0, 0])},
                  spacecraft=Pose(r_inertial_m=r_m,
                                  q_from_inertial=frames.look_at(np.array(r_m), np.array([5.0, 9.0, -999.0]))))
    scene = views.scene([body], [views.camera(64, 60.0)])
    with Renderer(scene) as renderer:
        image = renderer.render(state).irradiance_W_m2
    assert (image > 0.0).any() == (r_m[2] > height[N // 2, N // 2])


def test_a_camera_in_the_rock_is_refused():
    shape = Shape.from_arrays(*ball(4))
    body = Body(name="body", shape=shape, brdf=GREY)
    scene = views.scene([body], [views.camera(32, 20.0)])
    with Renderer(scene) as renderer:
        state = State(r_sun_inertial_m=[0.3e11, 0, 1.5e11], bodies={"body": Pose(r_inertial_m=[0, 0, 0])},
                      spacecraft=Pose(r_inertial_m=[3.0, 0.0, 0.0]))
        with pytest.raises(SceneError, match="outside body 'body'.*reaches 4 m: is its length unit right"):
            renderer.render(state)


def write(shape, path, scale=1.0):
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in (scale * shape.vertices_m).tolist()]
    path.write_text("\n".join([*lines, *(f"f {a} {b} {c}" for a, b, c in (shape.facets + 1).tolist())]))


@pytest.mark.parametrize("size_m", [170.0, 560.0, 4800.0, 25e3])
def test_metres_taken_for_kilometres_are_told_and_the_other_way_round(tmp_path, caplog, size_m):
    """Of Dimorphos', Itokawa's, 67P's and Phobos' size, in either unit, read as either."""
    base = generate.three_lobes(radius_m=0.5, subdivisions=3)
    size = max(base.report.extent_m)
    for unit, other, per_unit in (("m", "km", 1.0), ("km", "m", 1e-3)):
        write(base, tmp_path / "s.obj", size_m * per_unit / size)
        assert not Shape.from_file(tmp_path / "s.obj", length_unit=unit).report.warnings
        caplog.clear()
        told = Shape.from_file(tmp_path / "s.obj", length_unit=other).report.warnings
        assert len(told) == 1 and "is the length unit right (km or m)" in told[0], told
        logged = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
        assert logged == [f"s.obj: {told[0]}"]


def test_a_spacecraft_of_metres_and_a_boulder_of_arrays_are_no_cause_for_doubt(tmp_path):
    parts = [box((x, y, z), (x + 0.4, y + 0.3, z + 0.2)) for x, y, z in itertools.product(range(4), range(4), range(3))]
    write(Shape.from_arrays(*joined(*parts)), tmp_path / "craft.obj")
    assert Shape.from_file(tmp_path / "craft.obj", length_unit="m").report.warnings == ("48 separate shells",)
    assert not generate.three_lobes(radius_m=2.0).report.warnings


SCENE = serving.SCENE.replace('generated = { kind = "three_lobes", radius_m = 100.0, subdivisions = 4 }',
                              'shape = "holed.obj"\nlength_unit = "m"')


def test_what_was_found_reaches_the_command_line_the_log_and_the_client(tmp_path):
    """A shape with a hole: in the log of `glrender render` and of the server, in `hello` and after `load_scene`."""
    shape = Shape.from_arrays(100.0 * BALL.vertices_m, BALL.facets[1:])
    write(shape, tmp_path / "holed.obj")
    (tmp_path / "scene.toml").write_text(SCENE)
    told = list(shape.report.warnings)
    assert len(told) == 1 and told[0].startswith("3 open edges of holes")
    made = run("render", "scene.toml", "--camera", "bare", "--out", "a.npy", cwd=tmp_path)
    assert made.returncode == 0 and told[0] in made.stderr
    with serving.server(tmp_path, scene=SCENE) as (endpoint, _), Client(endpoint) as client:
        assert client.hello()["bodies"][0]["warnings"] == told
        whole = {"name": "b", "generated": {"kind": "icosphere", "radius_m": 9.0}, "brdf": {"law": "lambert",
                                                                                           "normal_albedo": 0.1}}
        cameras = [{"name": "c", "width_px": 16, "height_px": 16, "focal_length_px": 50.0}]
        assert client.load_scene({"bodies": [whole], "cameras": cameras})["bodies"][0]["warnings"] == []
    assert told[0] in (tmp_path / "server.log").read_text()


def test_vertices_move_without_repair():
    """In the same order, also where a file's repair would weld or turn facets; nothing of the shape before changes."""
    shape = generate.contact_binary(radius_m=100.0, seed=3, subdivisions=3)
    moved = shape.with_vertices(1.5 * shape.vertices_m + [10.0, 0.0, 0.0])
    np.testing.assert_array_equal(moved.vertices_m, 1.5 * shape.vertices_m + [10.0, 0.0, 0.0])
    assert moved.facets is shape.facets and not moved.vertices_m.flags.writeable
    assert moved.report.volume_m3 == pytest.approx(1.5**3 * shape.report.volume_m3, rel=1e-9)
    assert moved.report.extent_m == pytest.approx(tuple(1.5 * each for each in shape.report.extent_m))
    np.testing.assert_allclose(moved.facet_normals, shape.facet_normals, atol=1e-9)


@pytest.mark.parametrize("change, words", [
    (lambda r_m: r_m[:-1], "must have the shape"), (lambda r_m: "all", "must be numbers of shape"),
    (lambda r_m: 1j * r_m, "must be numbers of shape"),
    (lambda r_m: np.where(np.arange(len(r_m))[:, None] == 2, np.nan, r_m), r"vertices\[2\]: must be finite"),
    (lambda r_m: 1e12 * r_m, "must be within"), (lambda r_m: -r_m, "must leave closed shells facing as they do"),
    (lambda r_m: r_m * [1.0, 1.0, 0.0], "must have an area|must leave closed shells")])
def test_vertices_that_make_no_shape_are_refused(change, words):
    shape = generate.icosphere(radius_m=100.0, subdivisions=1)
    with pytest.raises(ShapeError, match=words):
        shape.with_vertices(change(shape.vertices_m))


def test_one_shell_of_several_is_not_turned_inside_out_and_sheets_bend_both_ways():
    ball = generate.icosphere(radius_m=100.0, subdivisions=1)
    count = len(ball.vertices_m)
    two = Shape.from_arrays(np.concatenate([2.0 * ball.vertices_m, 0.5 * ball.vertices_m + [500.0, 0.0, 0.0]]),
                            np.concatenate([ball.facets, ball.facets + count]))
    mirrored = two.vertices_m.copy()
    mirrored[count:] = [1000.0, 0.0, 0.0] - mirrored[count:]
    with pytest.raises(ShapeError, match="must leave closed shells facing as they do"):
        two.with_vertices(mirrored)
    corners = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.2], [-1.0, 1.0, 0.0]])
    sheet = Shape.from_arrays(corners, np.array([[0, 1, 2], [0, 2, 3]]), sides="both")
    assert sheet.with_vertices(sheet.vertices_m * [1.0, 1.0, -1.0]).report.n_two_sided == sheet.report.n_two_sided
