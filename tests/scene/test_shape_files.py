"""Shape files as other programs write them: polygons, PLY, STL. Truths: areas and volumes in closed form."""

from __future__ import annotations

import struct

import numpy as np
import pytest
import trimesh
from glrender import Shape, ShapeError, generate
from glrender.scene.shape.polygons import triangulated
from scipy.spatial.transform import Rotation

CUBE_V = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
TRIANGLES = [t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))]
MIXED = [*QUADS[:5], (1, 5, 7), (1, 7, 3)]

L = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
SQUARE, HOLE = [(0, 0), (4, 0), (4, 4), (0, 4)], [(1, 1), (1, 3), (3, 3), (3, 1)]
STAR = [((1.0, 0.2)[k % 2] * np.cos(0.1 + k * np.pi / 11), (1.0, 0.2)[k % 2] * np.sin(0.1 + k * np.pi / 11))
        for k in range(22)]
COMB = [(0, 0), (20, 0), *[place for k in range(9, -1, -1) for place in ((2 * k + 1.5, 3), (2 * k + 0.5, 0.5))]]
SPIRAL = [(t * np.cos(t), t * np.sin(t)) for t in np.linspace(1.0, 20.0, 150)]
SPIRAL = (SPIRAL + [((t + 1.5) * np.cos(t), (t + 1.5) * np.sin(t)) for t in np.linspace(20.0, 1.0, 150)])[::-1]
OUTLINES = {"L": L, "star": STAR, "comb": COMB, "spiral": SPIRAL, "square with points on its sides":
            [(0, 0), (1, 0), (2, 0), (4, 0), (4, 4), (2, 4), (0, 4), (0, 1)],
            "L with points on its sides": [(0, 0), (1, 0), (2, 0), (2, 1), (1.5, 1), (1, 1), (1, 1.5), (1, 2), (0, 2)],
            "triangle with points on its sides": [(0, 0), (1, 0), (2, 0), (3, 0), (1.5, 1.5), (0, 3), (0, 1.5)],
            "hole by a bridge": [*SQUARE, SQUARE[0], *HOLE, HOLE[0]],
            "needle": [(0, 0), (1000, 1e-3), (2000, 0), (1000, 2e-3)], "arrow": [(0, 0), (2, 1), (0, 2), (0.1, 1)],
            "corner twice": [(0, 0), (2, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)],
            "a spike": [(0, 0), (2, 0), (4, 0), (2, 0), (2, 2), (0, 2)]}


def load(folder, data, name="s.obj", unit="m"):
    path = folder / name
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return Shape.from_file(path, length_unit=unit)


def is_cube(shape):
    assert shape.report.is_watertight and len(shape.facets) == 12 and shape.report.n_flipped == 0
    np.testing.assert_allclose((shape.report.volume_m3, shape.facet_areas_m2.sum()), (1.0, 6.0), rtol=1e-6)
    return True


def signed_area(outline):
    """Shoelace formula."""
    x, y = np.array(outline, float).T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


@pytest.mark.parametrize("name", OUTLINES)
@pytest.mark.parametrize("places", [np.float64, np.float32])
def test_a_polygon_is_covered_once_from_whichever_corner(name, places):
    """Sum of the triangles' areas and sum of their absolutes are the polygon's area: nothing twice, nothing beside it.

    In a plane that lies askew, rounded to float32 too; each corner is still a corner of some triangle.
    """
    outline = OUTLINES[name]
    turn = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()
    for start in range(0, len(outline), max(len(outline) // 11, 1)):
        ring = outline[start:] + outline[:start]
        points = (np.array([(x, y, 0.0) for x, y in ring]) @ turn.T + [5.0, 3.0, -2.0]).astype(places)
        points = points.astype(float)
        corner = points[triangulated(points, np.arange(len(ring)), np.array([len(ring)]))]
        area = 0.5 * np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]) @ turn[:, 2]
        extent = np.ptp(points, axis=0).max()
        tolerance = (1e-12 if places is np.float64 else 1e-6) * extent**2
        np.testing.assert_allclose(area.sum(), signed_area(outline), atol=tolerance)
        np.testing.assert_allclose(np.abs(area).sum(), signed_area(outline), atol=tolerance)
        if name not in ("a spike", "corner twice"):
            used = {tuple(place) for place in corner.reshape(-1, 3)}
            assert used == {tuple(place) for place in points}


def test_points_on_a_side_leave_no_open_edge(tmp_path):
    """A square prism whose top has points on its sides, which its walls share."""
    ring = OUTLINES["square with points on its sides"]
    n = len(ring)
    lines = [f"v {x} {y} {z}" for z in (0, 1) for x, y in ring]
    lines += ["f " + " ".join(str(k) for k in range(n, 0, -1)), "f " + " ".join(str(n + k + 1) for k in range(n))]
    lines += [f"f {k + 1} {(k + 1) % n + 1} {(k + 1) % n + n + 1} {k + n + 1}" for k in range(n)]
    shape = load(tmp_path, "\n".join(lines))
    assert shape.report.is_watertight and not shape.report.warnings
    np.testing.assert_allclose(shape.report.volume_m3, 16.0, rtol=1e-12)


def test_a_bent_quadrilateral_keeps_both_its_triangles():
    """Corners out of plane by a quarter: the fold along either diagonal covers the unit square once from above."""
    points = np.array([(0, 0, 0), (1, 0, 0.25), (1, 1, 0), (0, 1, 0.25)], float)
    corner = points[triangulated(points, np.arange(4), np.array([4]))]
    area = 0.5 * np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])[:, 2]
    np.testing.assert_allclose(area, 0.5, rtol=1e-12)


def test_texture_coordinates_follow_the_corners_of_concave_polygons(tmp_path):
    """Of an L-shaped prism: u, v are x, y, whatever triangles it is cut into."""
    lines = [f"v {x} {y} {z}" for z in (0, 1) for x, y in L] + [f"vt {x / 4} {y / 4}" for x, y in L]
    lines.append("f " + " ".join(f"{k}/{k}" for k in range(6, 0, -1)))
    lines.append("f " + " ".join(f"{k + 6}/{k}" for k in range(1, 7)))
    lines += [f"f {a}/{a} {b}/{b} {b + 6}/{b} {a + 6}/{a}" for a in range(1, 7) for b in [a % 6 + 1]]
    shape = load(tmp_path, "\n".join(lines))
    np.testing.assert_allclose(4.0 * shape.uv, shape.vertices_m[shape.facets][..., :2], atol=1e-6)


def test_texture_coordinates_on_some_facets_are_left_out_aloud(tmp_path, caplog):
    lines = [f"v {x} {y} {z}" for x, y, z in CUBE_V] + ["vt 0 0", "vt 1 0", "vt 1 1"]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in TRIANGLES[:5]]
    lines += [f"f {a + 1}/1 {b + 1}/2 {c + 1}/3" for a, b, c in TRIANGLES[5:]]
    shape = load(tmp_path, "\n".join(lines))
    assert shape.uv is None
    assert "texture coordinates are left out, 5 of 12 facets have none" in shape.report.warnings[0]
    assert "5 of 12 facets" in caplog.text



_CODES = {"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d",
          "int32": "i", "float64": "d", "uint8": "B"}


def ply(form, elements, newline="\n", comment="comment made by a test"):
    """A PLY file: elements of (name, properties, rows), properties of (name, type) or (name, count type, type)."""
    order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[form]
    lines, body = ["ply", f"format {form} 1.0", comment], b""
    for name, properties, rows in elements:
        lines.append(f"element {name} {len(rows)}")
        lines += [f"property list {kinds[0]} {kinds[1]} {each}" if len(kinds) == 2 else f"property {kinds[0]} {each}"
                  for each, *kinds in properties]
        for row in rows:
            if not order:
                words = [f"{len(value)} " + " ".join(map(str, value)) if len(kinds) == 2 else str(value)
                         for (_, *kinds), value in zip(properties, row, strict=True)]
                body += (" ".join(words) + newline).encode()
                continue
            for (_, *kinds), value in zip(properties, row, strict=True):
                if len(kinds) == 2:
                    body += struct.pack(f"{order}{_CODES[kinds[0]]}{len(value)}{_CODES[kinds[1]]}", len(value), *value)
                else:
                    body += struct.pack(order + _CODES[kinds[0]], value)
    return newline.join([*lines, "end_header", ""]).encode() + body


FORMS = ("ascii", "binary_little_endian", "binary_big_endian")
XYZ = [(axis, "float") for axis in "xyz"]


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("count, index", [("uchar", "int"), ("ushort", "uint"), ("int", "uchar"), ("uint8", "int32")])
@pytest.mark.parametrize("faces", [TRIANGLES, QUADS, MIXED], ids=["triangles", "quadrilaterals", "both"])
def test_ply_of_any_byte_order_and_polygons(tmp_path, form, count, index, faces):
    data = ply(form, [("vertex", XYZ, CUBE_V), ("face", [("vertex_indices", count, index)], [(f,) for f in faces])])
    assert is_cube(load(tmp_path, data, "s.ply"))


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_ply_with_all_that_programs_add(tmp_path, form, newline):
    """Other properties before, between and behind, other elements, lists of vertices, doubles, comments."""
    places = [(axis, "double") for axis in "xyz"]
    vertex = [("quality", "double"), *places, ("red", "uchar"), ("tags", "uchar", "short")]
    face = [("flags", "uchar"), ("texcoord", "uchar", "float"), ("vertex_index", "uchar", "int"), ("area", "float")]
    data = ply(form, [
        ("camera", [("f", "float"), ("poses", "int", "double")], [(1.5, (1.0, 2.0)), (2.5, ())]),
        ("vertex", vertex, [(0.5, *place, 7, tuple(range(k % 3))) for k, place in enumerate(CUBE_V)]),
        ("edge", [("a", "int"), ("b", "int")], [(0, 1)]),
        ("face", face, [(1, (0.25,) * (2 * len(f)), f, 2.5) for f in MIXED]),
        ("empty", [("nothing", "int")], [])], newline)
    assert is_cube(load(tmp_path, data, "s.ply"))


CORNERS = [("vertex_indices", "uchar", "int")]


def faces(*rows):
    return ("face", CORNERS, [(row,) for row in rows])


@pytest.mark.parametrize("data, message", [
    (ply("binary_little_endian", [("vertex", XYZ, CUBE_V), faces(*MIXED)])[:-5], "more face rows"),
    (ply("ascii", [("vertex", XYZ, CUBE_V), faces(*MIXED)])[:-5], "more face rows"),
    (ply("ascii", [("vertex", XYZ[:2], [p[:2] for p in CUBE_V]), faces(*MIXED)]), "vertices without, got 'z'"),
    (ply("ascii", [("vertex", XYZ, CUBE_V), faces((0, 1, 99))]), r"facets\[0\]: must index vertices 0..7"),
    (ply("ascii", [("vertex", XYZ, CUBE_V), faces((0, 1))]), r"facets\[0\]: has fewer than 3 corners, got 2"),
    (ply("binary_big_endian", [("vertex", XYZ, CUBE_V), ("face", [("vertex_indices", "char", "int")], [((0, 1, 2),)])]
         ).replace(b"\x03\0\0\0\0", b"\xfd\0\0\0\0"), "list of face with a count of, got -3"),
    (b"ply\nformat ascii 1.0\nelement vertex 3\nproperty complex x\nend_header\n", "got 'property complex x'"),
    (b"ply\nformat text 1.0\nend_header\n", "got 'format text 1.0'"),
    (ply("ascii", [("vertex", XYZ, CUBE_V)]), "has no vertices or no facets"),
    (ply("ascii", [("vertex", XYZ, CUBE_V), faces(TRIANGLES[0])]).replace(b"0 0 0", b"0,5 0 0"),
     "write decimals with a point")])
def test_a_broken_ply_is_refused_by_its_fault(tmp_path, data, message):
    with pytest.raises(ShapeError, match=message):
        load(tmp_path, data, "s.ply")


def stl_text(facets=TRIANGLES, form="%e", newline="\n"):
    rows = ["solid cube"]
    for f in facets:
        rows += ["facet normal 0 0 0", " outer loop", *["  vertex " + " ".join([form] * 3) % CUBE_V[k] for k in f],
                 " endloop", "endfacet"]
    return newline.join([*rows, "endsolid cube", ""])


def stl_binary(facets=TRIANGLES, head=b"binary"):
    return head.ljust(80) + struct.pack("<I", len(facets)) + b"".join(
        struct.pack("<12fH", 0, 0, 0, *[c for k in f for c in CUBE_V[k]], 7) for f in facets)


@pytest.mark.parametrize("data", [
    stl_text(), stl_text(newline="\r\n"), stl_text(newline="\r"), stl_text(newline=" "), stl_text(form="%d"),
    stl_text().upper(), stl_text().replace("endsolid cube", ""), stl_text().replace("endsolid", "end solid"),
    stl_text().replace("endloop", "end loop").replace("endfacet", "end facet"),
    stl_text().replace("solid cube", "solid facet model, vertex 1 2 3 and outer loop of vertex count 8"),
    stl_text().replace("solid cube", "solid"), "\n  " + stl_text(), "\ufeff" + stl_text(),
    stl_text().replace("solid cube", "solid K\xf6rper").encode("latin-1"),
    stl_text(TRIANGLES[:6]) + stl_text(TRIANGLES[6:]), stl_text(QUADS), stl_text().replace("  vertex", "\tVertex\t"),
    stl_binary(), stl_binary(head=b"solid cube"), stl_binary(head=b"solid outer loop"),
    stl_binary(head=b"solid outer loop") + bytes(64), stl_binary() + b"attributes"],
    ids=["plain", "CRLF", "CR", "one line", "integers", "upper case", "no endsolid", "end solid", "end loop",
         "STL's words in the name", "no name", "indented", "byte-order mark", "Latin-1", "two solids", "quadrilaterals",
         "tabs", "binary", "binary that begins with solid", "binary with a loop in its head",
         "binary with zeros behind", "binary with bytes behind"])
def test_stl_as_it_is_found_is_the_cube(tmp_path, data):
    shape = load(tmp_path, data, "s.stl")
    assert is_cube(shape)
    told = " ".join(shape.report.warnings)
    assert ("bytes behind" in told) == (isinstance(data, bytes) and len(data) > 684 and data[80:84] == b"\x0c\0\0\0")


@pytest.mark.parametrize("data, message", [
    (stl_text()[:-60], "ends, or begins anew, within a facet"),
    (stl_text().replace("vertex 0", "vertex 0,5 0", 1), "must be three or more of `vertex x y z`"),
    (stl_text(form="%d").replace("vertex 0 0 0", "vertex 0,5 0 0", 1), "write decimals with a point"),
    (stl_text().replace("  vertex", "  vortex", 1), r"facets\[0\]: must be three or more"),
    (stl_binary()[:-7], "677 bytes do not fit a count of facets, got 12"),
    ("solid nothing\nendsolid nothing\n", "is neither text nor binary STL")])
def test_a_broken_stl_is_refused_by_its_fault(tmp_path, data, message):
    with pytest.raises(ShapeError, match=message):
        load(tmp_path, data, "s.stl")


@pytest.mark.parametrize("kind", ["glb", "off"])
def test_other_formats_are_read_as_trimesh_writes_them(tmp_path, kind):
    """The cube that trimesh writes: 12 facets, area 6, volume 1."""
    trimesh.creation.box((1.0, 1.0, 1.0)).export(tmp_path / f"cube.{kind}")
    report = Shape.from_file(tmp_path / f"cube.{kind}", length_unit="m").report
    assert report.n_facets == 12 and report.is_watertight
    np.testing.assert_allclose(report.volume_m3, 1.0, rtol=1e-6)


ROUND = generate.icosphere(radius_m=100.0, subdivisions=1)


@pytest.mark.parametrize("exponent", ["D", "d", "E"])
@pytest.mark.parametrize("is_numbered", [False, True])
def test_plate_models_may_have_fortran_s_exponents(tmp_path, exponent, is_numbered):
    """`1.0D-02`, in the first rows, in the last or in all."""
    rows = [" ".join(f"{x:.9E}".replace("E", exponent) for x in vertex) for vertex in ROUND.vertices_m]
    if exponent == "d":
        rows[0] = rows[0].replace("d", "e")
    plates = [" ".join(map(str, plate)) for plate in ROUND.facets + 1]
    if is_numbered:
        rows, plates = ([f"{k + 1} {row}" for k, row in enumerate(each)] for each in (rows, plates))
    (tmp_path / "a.tab").write_text("\n".join([f"{len(rows)} {len(plates)}", *rows, *plates]) + "\n")
    found = Shape.from_file(tmp_path / "a.tab", length_unit="m")
    np.testing.assert_array_equal(found.facets, ROUND.facets)
    np.testing.assert_allclose(found.vertices_m, ROUND.vertices_m, atol=1e-6)


@pytest.mark.parametrize("head", ["", "42\n", "42 80\n"])
@pytest.mark.parametrize("ending, row", [("tab", "{} {} {} {}"), ("plt", "{},{},{},{}"), ("tab", "{}\t{}\t{}\t{}")])
def test_plate_models_may_have_rows_of_v_and_f(tmp_path, ending, row, head):
    """After comments, with Fortran's exponents, commas, tabs, capitals or counts before them."""
    letter = "V" if head else "v"
    rows = [row.format(letter, *(f"{x:.9E}".replace("E", "D") for x in vertex)) for vertex in ROUND.vertices_m]
    rows += [row.format("f", *plate) for plate in ROUND.facets + 1]
    (tmp_path / f"a.{ending}").write_text("\n".join(["# plates", head + rows[0], *rows[1:]]) + "\n")
    found = Shape.from_file(tmp_path / f"a.{ending}", length_unit="m")
    np.testing.assert_array_equal(found.facets, ROUND.facets)
    np.testing.assert_allclose(found.vertices_m, ROUND.vertices_m, atol=1e-6)


@pytest.mark.parametrize("rows, message", [
    (["v 0 0 1.0D+0x", "v 1 0 0", "v 0 1 0", "f 1 2 3"], "a vertex that is no number, got '0 0 1.0D.0x'"),
    (["v 0 0 0", "v 1 0 0", "v 0 1 0", "f 1 2 3 1 2"], "a plate with 5 numbers instead of 3"),
    (["v 0 0 0", "v 1 0 0", "v 0 1 0", "g top", "f 1 2 3"], "rows of v, of f and of counts alone, got 'g top'"),
    (["v 0 0 0", "v 1 0 0"], "promises 2 vertices and 0 plates")])
def test_plate_models_of_wrong_rows_are_refused_with_the_row(tmp_path, rows, message):
    (tmp_path / "a.tab").write_text("\n".join(rows))
    with pytest.raises(ShapeError, match=message):
        Shape.from_file(tmp_path / "a.tab", length_unit="m")
