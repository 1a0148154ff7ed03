"""Shape files: read exactly, checked, repaired with a report; hostile ones refused with a clear error."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from glrender import Shape, ShapeError, generate
from glrender.scene.shape.convex_hull import Hull
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

CUBE_V = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
CUBE_QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
CUBE_F = np.array([t for a, b, c, d in CUBE_QUADS for t in ((a, b, c), (a, c, d))])


def cube_obj(separator="\n"):
    lines = [f"v {x} {y} {z}" for x, y, z in CUBE_V] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in CUBE_F]
    return separator.join(lines) + separator


def plate_model(first_plate):
    plates = [f"{a + 1} {b + 1} {c + 1}" for a, b, c in CUBE_F]
    return "\n".join(["8", *(f"{x} {y} {z}" for x, y, z in CUBE_V), "12", first_plate, *plates[1:]])


def is_cube(shape, scale=1.0):
    assert shape.report.is_watertight and len(shape.facets) == 12 and len(shape.vertices_m) == 8
    np.testing.assert_allclose(shape.report.volume_m3, scale**3, rtol=1e-12)
    corner = shape.vertices_m[shape.facets].mean(axis=1) - shape.vertices_m.mean(axis=0)
    assert (np.einsum("ij,ij->i", corner, shape.facet_normals) > 0.0).all(), "normals point outward"
    return True


def load(tmp_path, text, name="s.obj", unit="m", **kwargs):
    file = tmp_path / name
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return Shape.from_file(file, length_unit=unit, **kwargs)


@pytest.mark.parametrize("name, n_facets, volume_km3, extents_km", [
    ("itokawa/itokawa_64q_49152_uv.obj", 49152, 0.01779, (0.562, 0.305, 0.243)),
    ("itokawa/itokawa_8q_768.obj", 768, None, None),
    ("bennu/bennu_49k.ply", 49152, 0.0616333, (0.5679, 0.5434, 0.4954)),
    ("bennu/g_12570mm_alt_v014.obj", 12288, None, None),
    ("didymos/didymos_49k.obj", 49152, 0.203356, (0.8182, 0.8015, 0.6045)),
    ("didymos/dimorphos_49k.ply", 49152, 0.00175937, (0.1777, 0.169, 0.1145)),
    ("67p/67p-16k.obj", 31998, None, None), ("67p/67p-4k.obj", 7998, None, None),
    ("damit/Eva.obj", None, 1.0, None), ("damit/Danzig.obj", None, 1.0, None),
])
def test_real_shapes_are_the_published_closed_bodies(shared, name, n_facets, volume_km3, extents_km):
    """Facets, volume and extents of tests/data/README.md; every one is watertight and of genus 0."""
    shape = Shape.from_file(shared / name, length_unit="km")
    report = shape.report
    assert report.is_watertight and report.n_shells == 1
    assert report.n_vertices == report.n_facets // 2 + 2, "Euler: genus 0"
    if n_facets:
        assert report.n_facets == n_facets
    if volume_km3:
        np.testing.assert_allclose(report.volume_m3 / 1e9, volume_km3, rtol=1e-3)
    if extents_km:
        np.testing.assert_allclose(np.array(report.extent_m) / 1e3, extents_km, atol=6e-4)
    assert not report.warnings


def test_a_textured_model_is_the_closed_body_that_it_is(shared):
    """Itokawa: 25,350 vertices in the file, 24,578 used; texture coordinates stay with their corners."""
    shape = Shape.from_file(shared / "itokawa" / "itokawa_64q_49152_uv.obj", length_unit="km")
    assert len(shape.vertices_m) == 24578 and shape.report.n_unused + shape.report.n_welded == 25350 - 24578
    assert shape.uv.shape == (49152, 3, 2) and 0.0 <= shape.uv.min() and shape.uv.max() <= 1.0
    lines = (shared / "itokawa" / "itokawa_64q_49152_uv.obj").read_text().splitlines()
    texture = [list(map(float, line.split()[1:3])) for line in lines if line.startswith("vt ")]
    faces = [line.split()[1:] for line in lines if line.startswith("f ")]
    for k in (0, 777, 49151):
        expected = [texture[int(corner.split("/")[1]) - 1] for corner in faces[k]]
        np.testing.assert_allclose(shape.uv[k], expected, atol=1e-6)


@pytest.mark.parametrize("text", [
    cube_obj(), cube_obj("\r\n"), "# a comment\no cube\n" + cube_obj(),
    cube_obj().replace("v 0.0 0.0 0.0", "v 0.0 0.0 0.0 1.0 0.5 0.5"),
    "\n".join(f"v {x} {y} {z}" for x, y, z in CUBE_V) + "\n"
    + "\n".join("f " + " ".join(str(i + 1) for i in quad) for quad in CUBE_QUADS),
    "\n".join(f"v {x} {y} {z}" for x, y, z in CUBE_V) + "\n"
    + "\n".join("f " + " ".join(str(i - 8) for i in f) for f in CUBE_F),
    "\n".join(f"v {x} {y} {z}" for x, y, z in CUBE_V) + "\nvn 0 0 1\n"
    + "\n".join("f " + " ".join(f"{i + 1}//1" for i in f) for f in CUBE_F),
    cube_obj().replace(" ", "\t"), "  " + cube_obj("\n  "), "\ufeff" + cube_obj(),
    cube_obj(" # a corner\n"), "# caf\u00e9 \\\n" + cube_obj(" \n").replace(" 1.0 ", " \\\n1.0 \\\r\n "),
    cube_obj().replace("v 1.0 1.0 1.0", "v 1.0 1.0 1.0 0.5 0.5 0.5").replace("v 0.0 1.0 1.0", "v 0.0 1.0 1.0 1.0"),
    cube_obj().replace("v ", "v   ").replace("f ", "f  "),
], ids=["plain", "crlf", "comments", "colours", "quads", "negative", "v//vn", "tabs", "indents", "byte-order mark",
        "trailing comments", "continued lines", "colours on some", "blanks"])
def test_obj_dialects_give_the_same_cube(tmp_path, text):
    assert is_cube(load(tmp_path, text))


def test_obj_texture_coordinates_follow_repairs(tmp_path):
    lines = [f"v {x} {y} {z}" for x, y, z in CUBE_V] + [f"vt {k / 36} {1 - k / 36}" for k in range(36)]
    faces = [[(i, 3 * k + j) for j, i in enumerate(f)] for k, f in enumerate(CUBE_F)]
    faces[4] = [faces[4][0], faces[4][2], faces[4][1]]  # wound the wrong way
    lines += ["f " + " ".join(f"{v + 1}/{t + 1}" for v, t in face) for face in faces]
    shape = load(tmp_path, "\n".join(lines))
    assert is_cube(shape) and shape.report.n_flipped == 1
    np.testing.assert_allclose(shape.uv[4, :, 0] * 36, [12, 13, 14], atol=1e-5)


def test_a_shape_file_of_its_own_reads_back_bit_for_bit(tmp_path):
    shape = generate.three_lobes(radius_m=123.456, subdivisions=3)
    shape.to_file(tmp_path / "s.obj")
    again = Shape.from_file(tmp_path / "s.obj", length_unit="m")
    np.testing.assert_array_equal(again.vertices_m, shape.vertices_m)
    np.testing.assert_array_equal(again.facets, shape.facets)


def test_plate_models_of_both_layouts(tmp_path):
    v = [f"{x} {y} {z}" for x, y, z in CUBE_V]
    f = [f"{a + 1} {b + 1} {c + 1}" for a, b, c in CUBE_F]
    numbered = [f"{k + 1} {row}" for k, row in enumerate(v)], [f"{k + 1} {row}" for k, row in enumerate(f)]
    assert is_cube(load(tmp_path, "\n".join(["8", *v, "12", *f]), "a.tab"))
    assert is_cube(load(tmp_path, "\n".join(["8", *numbered[0], "12", *numbered[1]]), "b.tab"))
    assert is_cube(load(tmp_path, "\n".join(["8 12", *numbered[0], *numbered[1]]), "c.tab", unit="km"), 1e3)
    assert is_cube(load(tmp_path, "\r\n".join(["8", *numbered[0], "12", *numbered[1], ""]), "d.plt"))


def test_icq_is_a_closed_cube_of_grids(tmp_path):
    """A cube in implicitly connected quadrilaterals, q = 3: 6 faces of 4 x 4 vertices, edges welded."""
    q, rows = 3, []
    grid = np.linspace(-1.0, 1.0, q + 1)
    for axis in range(3):
        for side in (-1.0, 1.0):
            for a in grid:
                for b in grid:
                    point = np.insert([a, b], axis, side)
                    rows.append(" ".join(f"{x:.12f}" for x in point))
    shape = load(tmp_path, "\n".join([str(q), *rows]), "s.icq")
    assert shape.report.is_watertight and len(shape.facets) == 12 * q * q
    np.testing.assert_allclose(shape.report.volume_m3, 8.0, rtol=1e-9)


@pytest.mark.parametrize("kind", ["ply", "stl"])
def test_ply_and_stl_are_read(tmp_path, kind):
    import trimesh

    trimesh.Trimesh(CUBE_V, CUBE_F, process=False).export(tmp_path / f"s.{kind}")
    assert is_cube(Shape.from_file(tmp_path / f"s.{kind}", length_unit="m"))


def test_units_scale_and_must_be_known(tmp_path):
    assert is_cube(load(tmp_path, cube_obj(), unit="km"), 1000.0)
    assert is_cube(load(tmp_path, cube_obj(), unit=2.5), 2.5)
    for unit in ("mm", 0.0, -1.0, float("nan"), None, 1e300, 1e-300, ["m"]):
        with pytest.raises(ValueError, match="length_unit"):
            load(tmp_path, cube_obj(), unit=unit)


@pytest.mark.parametrize("unit, message", [
    (1e-4, "s.obj: must have an extent of at least 0.001 m, got 0.0001; is the length unit right"),
    (1e9, r"s.obj.vertices\[1\]: must be within 1e\+10 m of the origin, got .*; is the length unit right")])
def test_a_body_too_small_or_too_large_is_refused(tmp_path, unit, message):
    text = cube_obj().replace(" 1.0", " 11.0") if unit > 1.0 else cube_obj()
    with pytest.raises(ShapeError, match=message):
        load(tmp_path, text, unit=unit)


def test_a_number_beyond_float64_in_metres_is_not_finite(tmp_path):
    with pytest.raises(ShapeError, match="must be finite"):
        load(tmp_path, cube_obj().replace("v 0.0 0.0 0.0", "v 1e305 0.0 0.0"), unit=1e9)


def test_winding_is_made_one_and_outward_per_shell(rng):
    """Half of the facets of two shells turned at random, one shell inside out: all repaired."""
    facets = np.concatenate([CUBE_F, CUBE_F[:, ::-1] + 8])
    vertices = np.concatenate([CUBE_V, CUBE_V + [5.0, 0.0, 0.0]])
    turned = rng.random(24) < 0.5
    facets[turned] = facets[turned][:, ::-1]
    shape = Shape.from_arrays(vertices, facets)
    assert shape.report.n_shells == 2 and 0 < shape.report.n_flipped < 24
    np.testing.assert_allclose(shape.report.volume_m3, 2.0, rtol=1e-12)
    centre = np.where((shape.vertices_m[shape.facets].mean(axis=1)[:, :1] > 3.0), [5.5, 0.5, 0.5], [0.5, 0.5, 0.5])
    outward = shape.vertices_m[shape.facets].mean(axis=1) - centre
    assert (np.einsum("ij,ij->i", outward, shape.facet_normals) > 0.0).all()


def test_seams_duplicates_and_slivers_are_mended_and_counted():
    """Every facet with corners of its own, one twice, one without area, one vertex that nobody uses."""
    vertices = np.concatenate([CUBE_V[CUBE_F].reshape(-1, 3), [[9.0, 9.0, 9.0]]])
    facets = np.concatenate([np.arange(36).reshape(12, 3), [[0, 1, 2]], [[0, 1, 1]]])
    shape = Shape.from_arrays(vertices, facets)
    assert is_cube(shape)
    report = shape.report
    assert (report.n_welded, report.n_duplicate, report.n_degenerate, report.n_unused) == (28, 1, 1, 1)


def test_holes_fins_and_odd_extents_are_warned_of():
    shape = Shape.from_arrays(CUBE_V, CUBE_F[1:])
    assert shape.report.n_open_edges == 3 and "3 open edges" in shape.report.warnings[0]
    fin = Shape.from_arrays(np.concatenate([CUBE_V, [[2.0, 2.0, 2.0]]]), np.concatenate([CUBE_F, [[0, 1, 8]]]))
    assert fin.report.n_non_manifold_edges == 1
    for scale in (1e-3, 1e9):
        assert "is the length unit right" in Shape.from_arrays(scale * CUBE_V, CUBE_F).report.warnings[0]


def test_vertex_normals_of_a_sphere_are_radial():
    shape = generate.icosphere(radius_m=3.0, subdivisions=4)
    np.testing.assert_allclose(shape.vertex_normals, shape.vertices_m / 3.0, atol=5e-3)


@pytest.mark.parametrize("name, text, message", [
    ("s.obj", "", "is empty"),
    ("s.obj", "v 0 0 0\n", "no vertices or no facets"),
    ("s.obj", cube_obj().replace("f 1 2 4", "f 1 2 40"), r"facets\[0\]: must index vertices 0..7, got \[0, 1, 39\]"),
    ("s.obj", cube_obj().replace("f 1 2 4", "f 0 2 4"), r"facets\[0\]: must index"),
    ("s.obj", cube_obj().replace("f 1 2 4", "f 1 2"), "fewer than 3 corners"),
    ("s.obj", cube_obj().replace("f 1 2 4", "f 1 2 x"), "index that is no integer"),
    ("s.obj", cube_obj().replace("v 0.0 0.0 0.0", "v nan 0.0 0.0"), r"vertices\[0\]: must be finite"),
    ("s.obj", cube_obj().replace("v 0.0 0.0 0.0", "v 1e999 0.0 0.0"), r"vertices\[0\]: must be finite"),
    ("s.obj", cube_obj().replace("v 0.0 0.0 0.0", "v 0,0 0,0 0,0"), "decimals with a point"),
    ("s.obj", cube_obj().replace("v 0.0 0.0 0.0", "v 0.0 0.0"), "with 2 numbers instead of 3"),
    ("s.obj", cube_obj().replace("v 0.0 0.0 0.0", "v 0.0 0.0").replace("v 0.0 0.0 1.0", "v 0.0 0.0 1.0 0.0"),
     "with 2 numbers instead of 3, got '0.0 0.0'"),
    ("s.obj", cube_obj().replace("f 1 2 4", "f 1 2").replace("f 1 4 3", "f 1 2 4 3"), "fewer than 3 corners"),
    ("s.obj", "\n".join(["v 1 1 1"] * 3 + ["f 1 2 3"]), "no extent"),
    ("s.obj", "\n".join(["v 0 0 0", "v 1 1 1", "v 2 2 2", "f 1 2 3"]), "no facet with an area"),
    ("s.obj", b"\0\1\2" * 100, "is binary"),
    ("s.xyz", cube_obj(), "must end in one of .bds, .dsk, .glb, .icq, .obj"),
    ("s.tab", "a b\n", "must begin with the number of vertices"),
    ("s.tab", "8\n0 0 0\n", "is no plate model"),
    ("s.tab", "1000000000000 3\n", "facets|ends before"),
    ("s.tab", "3 999999999999\n0 0 0\n", "more than 20000000 facets"),
    ("s.tab", "# a\n\n# b\n", "has no lines but comments"),
    ("s.icq", "\n \n", "has only empty lines"),
    ("s.icq", "500\n0 0 0\n", "ends before"),
    ("s.icq", "99999999\n0 0 0\n", "more than 20000000 facets"),
    ("s.ply", b"ply\nformat binary_little_endian 1.0\nelement vertex 1000000000000\nproperty float x\n"
              b"property float y\nproperty float z\nelement face 1\n"
              b"property list uchar int vertex_indices\nend_header\n",
     "promises more vertex rows"),
    ("s.ply", b"ply\ngarbage", "is not a readable PLY"),
    ("s.stl", b"\0" * 80 + struct.pack("<I", 4_000_000_000) + b"\0" * 50,
     "134 bytes do not fit a count of facets, got 4000000000; a binary file of as many has 200000000084 bytes"),
    ("s.stl", b"\xff\xfe" * 100, "is neither text nor binary STL: 200 bytes do not fit a count of facets"),
    ("s.stl", b"solid \xff\xfe facet" * 100, "is neither text nor binary STL"),
    ("s.tab", plate_model("1.5 2 3"), "has a plate with an index that is no 32-bit integer, got '1.5 2 3'"),
    ("s.tab", plate_model("nan 2 3"), "has a plate with an index that is no 32-bit integer, got 'nan 2 3'"),
    ("s.tab", plate_model("1e300 2 3"), "no 32-bit integer, got '1e300 2 3'"),
    ("s.tab", "\n".join(["4", *(f"{p} 0.1" for p in ("0 0 0", "1 0 0", "0 1 0", "0 0 1")), "1", "1 2 3"]),
     "has vertex rows of 4 columns, whose first one does not count them, got '0 0 0 0.1'"),
    ("s.tab", "\n".join(["4", *("0,5 0,5 0,5", "1,5 0,5 0,5", "0,5 1,5 0,5", "0,5 0,5 1,5"), "1", "1 2 3"]),
     "has a vertex with 6 numbers instead of 3"),
    ("s.tab", plate_model("1 2 3 7"), "has plate rows of 4 columns, whose first one does not count them|instead of"),
    ("s.obj", cube_obj().replace("v 0.0 0.0 0.0", "v 0.0 0.0 0.0 0.0 0.0"), "has a vertex with 5 numbers, where"),
    ("s.obj", cube_obj() + "cstype bspline\nsurf 0 1 0 1 1 2 3 4\n", "has a statement `cstype` of a surface that"),
    ("s.obj", cube_obj() + "call more.obj\n", "has a statement `call` of a surface that is no polygon, or"),
])
def test_hostile_files_are_refused_by_name_rule_and_value(tmp_path, name, text, message):
    with pytest.raises(ShapeError, match=message) as caught:
        load(tmp_path, text, name)
    assert str(caught.value).startswith(name)


def test_what_qhull_cannot_do_is_a_shape_error():
    """Sides 2e-16 of the distance to the origin apart: float64 has no room between them."""
    with pytest.raises(ShapeError, match="shape: has no convex hull: QH"):
        Hull(CUBE_V * [1.0, 1.0, 1e-6] + 1e10, CUBE_F)


def test_a_lone_facet_beside_a_shell_to_rewind():
    """A shell of one facet has no neighbours to agree with."""
    facets = CUBE_F.copy()
    facets[3] = facets[3][::-1]
    shape = Shape.from_arrays(np.concatenate([CUBE_V, CUBE_V[:3] + 5.0]), np.concatenate([facets, [[8, 9, 10]]]))
    assert shape.report.n_shells == 2 and shape.report.n_flipped >= 1


@pytest.mark.parametrize("changes, message", [
    ({"facets": np.full((2, 3), np.nan)}, "facets: must be integers"),
    ({"facets": CUBE_F + 0.4}, "facets: must be integers"),
    ({"facets": "abc"}, "needs vertices"), ({"vertices_m": "a"}, "needs arrays of numbers"),
    ({"vertices_m": [[0, 0], [1]]}, "needs arrays of numbers"),
    ({"uv": np.zeros((3, 3, 2))}, r"uv: must be \(12, 3, 2\) finite numbers, got \(3, 3, 2\)"),
    ({"uv": np.full((12, 3, 2), np.nan)}, "uv: must be .* finite numbers"), ({"uv": "x"}, "needs arrays of numbers")])
def test_arrays_that_are_no_mesh_are_refused(changes, message):
    with pytest.raises(ShapeError, match=message):
        Shape.from_arrays(**{"vertices_m": CUBE_V, "facets": CUBE_F, **changes})


def test_missing_files_folders_and_limits(tmp_path):
    with pytest.raises(ShapeError, match="none.obj: cannot be read: No such file"):
        Shape.from_file(tmp_path / "none.obj", length_unit="m")
    with pytest.raises(ShapeError, match="is a folder"):
        Shape.from_file(tmp_path, length_unit="m")
    with pytest.raises(ShapeError, match="more than 5 facets, got 12"):
        load(tmp_path, cube_obj(), max_facets=5)


def _valid_files():
    import trimesh

    mesh = trimesh.Trimesh(CUBE_V, CUBE_F, process=False)
    plate = "\n".join(["8", *(f"{x} {y} {z}" for x, y, z in CUBE_V), "12",
                       *(f"{a + 1} {b + 1} {c + 1}" for a, b, c in CUBE_F)])
    return {"obj": cube_obj().encode(), "tab": plate.encode(), "ply": mesh.export(file_type="ply"),
            "stl": mesh.export(file_type="stl"), "glb": mesh.export(file_type="glb"),
            "off": mesh.export(file_type="off").encode()}


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(kind=st.sampled_from(["obj", "tab", "ply", "stl", "glb", "off"]), cut=st.integers(0, 2000),
       flips=st.lists(st.tuples(st.integers(0, 2000), st.integers(0, 255)), max_size=5))
def test_damaged_files_load_or_are_refused_never_crash(tmp_path, kind, cut, flips):
    """Truncation and flipped bytes of small valid files: a closed mesh or a ShapeError, nothing else."""
    data = bytearray(_valid_files()[kind])
    for position, value in flips:
        data[position % len(data)] = value
    data = data[: max(len(data) - cut, 0)]
    file = tmp_path / f"damaged.{kind}"
    file.write_bytes(bytes(data))
    try:
        shape = Shape.from_file(file, length_unit="m")
    except ShapeError:
        return
    assert np.isfinite(shape.vertices_m).all() and len(shape.facets)
