"""Binary glTF and OFF: accessors and nodes of all kinds are the shape that they stand for, or are refused by name."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest
import trimesh
from glrender import Shape
from glrender.base.errors import ShapeError

BOX = np.array([[x, y, z] for x in (0, 100.0) for y in (0, 200.0) for z in (0, 300.0)])
FACETS = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6],
                   [0, 6, 4], [1, 5, 7], [1, 7, 3]], "<u2")


def written(folder, views, accessors, *, meshes=None, nodes=None, strides=None, **more):
    """A file of views of bytes and of accessors to them; by default accessor 0 has the corners, 1 the places."""
    blob, table = b"", []
    for k, view in enumerate(views):
        blob += b"\0" * (-len(blob) % 4)
        table.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(view), **(strides or {}).get(k, {})})
        blob += view
    about = {"asset": {"version": "2.0"}, "buffers": [{"byteLength": len(blob)}], "bufferViews": table,
             "accessors": accessors, "nodes": nodes or [{"mesh": 0}],
             "meshes": meshes or [{"primitives": [{"attributes": {"POSITION": 1}, "indices": 0}]}], **more}
    text = json.dumps(about).encode()
    text += b" " * (-len(text) % 4)
    (folder / "a.glb").write_bytes(struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(blob))
                                   + struct.pack("<I4s", len(text), b"JSON") + text
                                   + struct.pack("<I4s", len(blob), b"BIN\0") + blob)
    return folder / "a.glb"


def corners(values=FACETS, kind=5123, view=0):
    return {"bufferView": view, "componentType": kind, "count": values.size, "type": "SCALAR"}


def places(count=8, kind=5126, view=1, **more):
    return {"componentType": kind, "count": count, "type": "VEC3", **({} if view is None else {"bufferView": view}),
            **more}


def read(path):
    return Shape.from_file(path, length_unit="m")


def box(folder, **more):
    return written(folder, [FACETS.tobytes(), BOX.astype("<f4").tobytes()], [corners(), places()], **more)


@pytest.mark.parametrize("kind, numpy_kind, whole", [(5120, "i1", 127), (5121, "u1", 255), (5122, "<i2", 32767),
                                                     (5123, "<u2", 65535)])
@pytest.mark.parametrize("is_normalized", [True, False])
def test_integers_as_places_are_normalised_where_they_say_so(tmp_path, kind, numpy_kind, whole, is_normalized):
    """c / (2^b - 1) or c / (2^(b-1) - 1), section 3.11; with padding between values, and the node's scale."""
    rows = np.zeros((8, 4), numpy_kind)
    rows[:, :3] = np.rint(BOX / 300.0 * whole)
    shape = read(written(
        tmp_path, [FACETS.tobytes(), rows.tobytes()], [corners(), places(kind=kind, normalized=is_normalized)],
        strides={1: {"byteStride": rows.strides[0]}}, extensionsUsed=["KHR_mesh_quantization"],
        extensionsRequired=["KHR_mesh_quantization", "KHR_materials_unlit", "KHR_texture_transform"],
        nodes=[{"mesh": 0, "scale": [300.0 if is_normalized else 300.0 / whole] * 3}]))
    np.testing.assert_allclose(np.ptp(shape.vertices_m, axis=0), [100.0, 200.0, 300.0], atol=300.0 / whole)


def test_a_negative_normalised_place_is_at_least_minus_one(tmp_path):
    rows = np.where(BOX > 0, 32767, -32768).astype("<i2")
    padded = np.concatenate([rows, np.zeros((8, 1), "<i2")], axis=1).tobytes()
    shape = read(written(tmp_path, [FACETS.tobytes(), padded], [corners(), places(kind=5122, normalized=True)],
                         strides={1: {"byteStride": 8}}))
    np.testing.assert_array_equal(np.unique(shape.vertices_m), [-1.0, 1.0])


@pytest.mark.parametrize("has_base", [True, False])
@pytest.mark.parametrize("kind, numpy_kind", [(5121, "u1"), (5123, "<u2"), (5125, "<u4")])
def test_sparse_values_replace_those_of_their_base(tmp_path, has_base, kind, numpy_kind):
    """Places of half the height, or none, and the upper four given anew."""
    some = np.flatnonzero(BOX[:, 2] > 0) if has_base else np.arange(8)
    sparse = {"count": len(some), "indices": {"bufferView": 2, "componentType": kind}, "values": {"bufferView": 3}}
    shape = read(written(
        tmp_path, [FACETS.tobytes(), (BOX * [1, 1, 0.5]).astype("<f4").tobytes(), some.astype(numpy_kind).tobytes(),
                   BOX[some].astype("<f4").tobytes()],
        [corners(), places(view=1 if has_base else None, sparse=sparse)]))
    np.testing.assert_allclose(shape.report.volume_m3, 6e6, rtol=1e-9)


def test_sparse_corners_count_too(tmp_path):
    """A box whose first facet is turned inside out, and put right by sparse corners."""
    wrong = FACETS.copy()
    wrong[0] = wrong[0][::-1]
    sparse = {"count": 2, "indices": {"bufferView": 2, "componentType": 5121}, "values": {"bufferView": 3}}
    shape = read(written(tmp_path, [wrong.tobytes(), BOX.astype("<f4").tobytes(), bytes([0, 2]),
                                    FACETS[0, [0, 2]].tobytes()], [{**corners(), "sparse": sparse}, places()]))
    assert shape.report.is_watertight and not shape.report.warnings


@pytest.mark.parametrize("mode, order", [(5, [0, 1, 2, 3, 3, 3, 4, 4, 5, 6, 7]), (6, [0, 1, 2, 3, 4])])
def test_strips_and_fans_are_their_triangles(tmp_path, mode, order):
    """Section 3.7.2.1: triangles (i, i + 1 + i % 2, i + 2 - i % 2), and (i + 1, i + 2, 0)."""
    rng = np.random.default_rng(3)
    points = rng.normal(size=(8, 3)).astype("<f4")
    n = len(order)
    index = ([(i, i + 1 + i % 2, i + 2 - i % 2) for i in range(n - 2)] if mode == 5
             else [(i + 1, i + 2, 0) for i in range(n - 2)])
    triangles = np.array(order)[np.array(index)]
    triangles = triangles[[len(set(row)) == 3 for row in triangles.tolist()]]
    shape = read(written(tmp_path, [np.array(order, "<u2").tobytes(), points.tobytes()],
                         [corners(np.array(order)), places()],
                         meshes=[{"primitives": [{"attributes": {"POSITION": 1}, "indices": 0, "mode": mode}]}]))
    area = lambda p: np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])  # noqa: E731
    np.testing.assert_allclose(area(shape.vertices_m[shape.facets]).sum(axis=0), area(points[triangles]).sum(axis=0),
                               atol=1e-5)
    assert len(shape.facets) == len(triangles)


@pytest.mark.parametrize("seed", range(4))
def test_trees_of_nodes_are_as_trimesh_places_them(tmp_path, seed):
    """Turned, moved, stretched, mirrored and drawn several times: volume and corners as another reader has them."""
    rng = np.random.default_rng(seed)
    unit = rng.normal(size=(3, 4))
    nodes = [{"children": [1, 2], "rotation": (unit[0] / np.linalg.norm(unit[0])).tolist(),
              "translation": rng.normal(size=3).tolist()},
             {"mesh": 0, "scale": [1.0, -2.0, 1.5], "translation": [500.0, 0.0, 0.0]},
             {"children": [3], "matrix": [0, 2, 0, 0, -2, 0, 0, 0, 0, 0, 2, 0, -700, 30, 0, 1], "mesh": 0},
             {"mesh": 0, "rotation": (unit[1] / np.linalg.norm(unit[1])).tolist(), "translation": [0, 0, 900.0]}]
    path = box(tmp_path, nodes=nodes, scenes=[{"nodes": [0]}], scene=0)
    ours, theirs = read(path), trimesh.load_mesh(path)
    assert len(ours.facets) == len(theirs.faces) == 36
    np.testing.assert_allclose(ours.vertices_m.min(axis=0), theirs.bounds[0], rtol=1e-6, atol=1e-3)
    np.testing.assert_allclose(ours.vertices_m.max(axis=0), theirs.bounds[1], rtol=1e-6, atol=1e-3)
    np.testing.assert_allclose(ours.report.volume_m3, 6e6 * (3.0 + 8.0 + 8.0), rtol=1e-6)
    np.testing.assert_allclose(theirs.volume, ours.report.volume_m3, rtol=1e-6)


def test_the_scene_that_is_asked_for_is_drawn(tmp_path):
    """Of two scenes the file's own `scene`; nodes of the other are not there."""
    nodes = [{"mesh": 0}, {"mesh": 0, "scale": [2.0, 2.0, 2.0]}]
    for scene, volume in ((0, 6e6), (1, 48e6)):
        path = box(tmp_path, nodes=nodes, scenes=[{"nodes": [0]}, {"nodes": [1]}], scene=scene)
        np.testing.assert_allclose(read(path).report.volume_m3, volume, rtol=1e-6)


SHEETS = np.array([[x, y, z] for z in (0.0, 5.0) for x, y in ((0, 0), (2, 0), (2, 2), (0, 2))], "<f4")
PANES = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], "<u2")


def sheets(folder, first, second, materials):
    """Two sheets one above the other, each with a material by its number, or without one."""
    part = lambda k, material: {"attributes": {"POSITION": 2}, "indices": k,  # noqa: E731
                                **({} if material is None else {"material": material})}
    return written(folder, [PANES[:2].tobytes(), PANES[2:].tobytes(), SHEETS.tobytes()],
                   [corners(PANES[:2]), corners(PANES[2:], view=1), places(view=2)],
                   meshes=[{"primitives": [part(0, first), part(1, second)]}], materials=materials)


@pytest.mark.parametrize("sides, first, second, heights", [
    ("file", 0, 1, [5.0]), ("file", 1, 0, [0.0]), ("file", 1, 1, [0.0, 5.0]), ("file", None, 1, [5.0]),
    ("file", 0, None, []), ("front", 1, 1, []), ("both", 0, None, [0.0, 5.0])])
def test_panels_of_a_double_sided_material_have_both_sides(tmp_path, sides, first, second, heights):
    """By the material's `doubleSided`, unless `sides` says otherwise: which of two sheets faces up and down."""
    path = sheets(tmp_path, first, second, [{"name": "paint"}, {"name": "cells", "doubleSided": True}])
    shape = Shape.from_file(path, length_unit="m", sides=sides)
    assert shape.report.n_two_sided == 2 * len(heights) and shape.report.n_facets == 4 + 2 * len(heights)
    down = shape.vertices_m[shape.facets[shape.facet_normals[:, 2] < 0.0]][..., 2]
    assert sorted(set(down.ravel())) == heights


def test_a_closed_shell_of_a_double_sided_material_is_seen_from_outside(tmp_path):
    primitive = {"attributes": {"POSITION": 1}, "indices": 0, "material": 0}
    shape = read(box(tmp_path, meshes=[{"primitives": [primitive]}], materials=[{"doubleSided": True}]))
    assert shape.report.n_two_sided == 0 and shape.report.n_facets == 12


@pytest.mark.parametrize("material, materials, message", [
    (7, [{}], "meshes.primitives.material: must be a number below 1, got 7; export it with all its materials"),
    (0, None, "material: must be a number below 0, got 0"), (-1, [{}], "got -1"), ("cells", [{}], "got 'cells'"),
    (0, [{"doubleSided": 1}], r"materials\[0\].doubleSided: must be true or false, got 1")])
def test_materials_that_are_not_there_are_refused(tmp_path, material, materials, message):
    with pytest.raises(ShapeError, match=message):
        read(sheets(tmp_path, material, None, materials or []))


def test_nodes_may_be_64_deep(tmp_path):
    chain = lambda n: [*({"children": [k + 1]} for k in range(n - 1)), {"mesh": 0}]  # noqa: E731
    assert read(box(tmp_path, nodes=chain(64))).report.n_facets == 12
    with pytest.raises(ShapeError, match="nodes.children: must lead at most 64 nodes deep"):
        read(box(tmp_path, nodes=chain(65)))


def test_points_and_lines_are_no_surface(tmp_path):
    primitive = {"attributes": {"POSITION": 1}, "indices": 0}
    primitives = [primitive, {**primitive, "mode": 1}, {**primitive, "mode": 0}]
    shape = read(box(tmp_path, meshes=[{"primitives": primitives}]))
    assert len(shape.facets) == 12


MORPH = {"primitives": [{"attributes": {"POSITION": 1}, "indices": 0, "targets": [{"POSITION": 1}]}]}
SPARSE = {"count": 1, "indices": {"bufferView": 0, "componentType": 5123}, "values": {"bufferView": 1}}


@pytest.mark.parametrize("more, message", [
    ({"extensionsRequired": ["KHR_draco_mesh_compression"]}, "Required: must be known here: .*'KHR_draco"),
    ({"extensionsRequired": ["EXT_meshopt_compression"]}, "'EXT_meshopt_compression'; export it without"),
    ({"extensionsRequired": ["ACME_places_twice_as_far"]}, "'ACME_places_twice_as_far'"),
    ({"nodes": [{"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {}}}]}, "nodes.extensions: must not move"),
    ({"nodes": [{"mesh": 0, "extensions": {"KHR_node_visibility": {"visible": False}}}]}, "'KHR_node_visibility'"),
    ({"nodes": [{"mesh": 0, "skin": 0}]}, "nodes.skin: must not be there: bones would move the mesh"),
    ({"meshes": [{**MORPH, "weights": [0.5]}]}, "meshes.weights: must be 0: morph targets"),
    ({"meshes": [{**MORPH, "weights": [0.0]}], "nodes": [{"mesh": 0, "weights": [1.0]}]}, "meshes.weights: must be"),
    ({"asset": {"version": "1.0"}}, "asset.version: must be of glTF 2, got '1.0'"),
    ({"accessors": [corners(), places(kind=5130)]}, "accessors.componentType: must be one of 5120"),
    ({"accessors": [corners(), {**places(), "type": "VEC4"}]}, "accessors.type: must be VEC3, got 'VEC4'"),
    ({"accessors": [corners(), places(count=9)]}, "bufferViews: must be within the binary chunk"),
    ({"accessors": [corners(), places(count=7)]}, "meshes.primitives.indices: must be whole numbers below 7"),
    ({"accessors": [corners(FACETS[:, :2]), places(), places()]}, None),
    ({"accessors": [corners(), places(sparse={**SPARSE, "count": 9})]}, "accessors.sparse.count: must be up to 8"),
    ({"accessors": [corners(), places(sparse={**SPARSE, "values": 3})]}, "accessors.sparse: must have indices"),
    ({"accessors": [corners(), places(sparse={**SPARSE, "indices": {"bufferView": 1, "componentType": 5126}})]},
     "accessors.sparse.indices: must be whole numbers below 8"),
    ({"nodes": [{"mesh": 0, "scale": [1.0, 2.0]}]}, "nodes.scale: must be 3 numbers"),
    ({"nodes": [{"mesh": 0, "rotation": [0, 0, 0, 0]}]}, "nodes.rotation: must be a quaternion"),
    ({"nodes": [{"mesh": 7}]}, "mesh: must be a number below 1, got 7"),
    ({"scenes": [{"nodes": [0]}], "scene": 4}, "scene: must be a number below 1, got 4"),
])
def test_what_would_be_another_shape_is_refused_by_name(tmp_path, more, message):
    """The one without a message is sound: eight facets of 24 corners."""
    path = box(tmp_path)
    path.write_bytes(b"")
    views = [FACETS.tobytes(), BOX.astype("<f4").tobytes()]
    path = written(tmp_path, views, more.get("accessors", [corners(), places()]),
                   **{key: value for key, value in more.items() if key != "accessors"})
    if message is None:
        assert len(read(path).facets) == 8
        return
    with pytest.raises(ShapeError, match=message):
        read(path)


PENTAGON = [(float(np.cos(k * 0.4 * np.pi)), float(np.sin(k * 0.4 * np.pi)), 0.0) for k in range(5)] + [(0.0, 0.0, 1.0)]
SIDES = [(4, 3, 2, 1, 0), *((k, (k + 1) % 5, 5) for k in range(5))]
# A regular pentagon's area of the unit circle, a third of it.
VOLUME = 2.5 * np.sin(0.4 * np.pi) / 3.0


def off(folder, head="OFF\n6 6 0\n", vertex="", face="", faces=SIDES):
    (folder / "a.off").write_text(head + "".join(f"{x} {y} {z}{vertex}\n" for x, y, z in PENTAGON) + "".join(
        f"{len(row)} {' '.join(map(str, row))}{face}\n" for row in faces))
    return folder / "a.off"


@pytest.mark.parametrize("options", [
    {}, {"head": "OFF 6 6 0\n"}, {"head": "# a pyramid\nOFF # text\n\n6 6\n"}, {"face": " 255 0 0"}, {"face": " 3"},
    {"head": "COFF\n6 6 0\n", "vertex": " 0.1 0.2 0.3 1.0", "face": " 0.1 0.2 0.3 1.0"},
    {"head": "NOFF\n6 6 0\n", "vertex": " 0 0 1"}, {"head": "STOFF\n6 6 10\n", "vertex": " 0.5 0.5 # a corner"}])
def test_polygons_of_an_off_file_are_cut_into_triangles(tmp_path, options):
    report = read(off(tmp_path, **options)).report
    assert report.is_watertight and report.n_facets == 8
    np.testing.assert_allclose(report.volume_m3, VOLUME, rtol=1e-12)


@pytest.mark.parametrize("options, message", [
    ({"head": "4OFF\n6 6 0\n"}, "must have vertices of three coordinates, got '4OFF'"),
    ({"head": "nOFF\n6 6 0\n"}, "must have vertices of three coordinates, got 'nOFF'"),
    ({"head": "OFF BINARY\n6 6 0\n"}, "is binary, not text"), ({"head": "OF\n6 6 0\n"}, "must begin with OFF"),
    ({"head": "OFF\n6 7 0\n"}, "promises 6 vertices and 7 faces, a row each, got 12"),
    ({"head": "OFF\n6.0 6 0\n"}, "must have counts of vertices, faces and edges"),
    ({"vertex": " 7"}, "has a vertex with 4 numbers instead of 3"), ({"vertex": "x"}, "has a vertex that is no number"),
    ({"faces": [*SIDES[:5], (4, 0, "x")]}, "has a face with an index that is no integer"),
    ({"faces": [*SIDES[:5], (4, 9, 5)]}, "index"), ({"face": " 1 2"}, "has a face that is not a count, corners and a"),
    ({"faces": [*SIDES[:5], (4, 0)]}, "has fewer than 3 corners"),
])
def test_what_is_wrong_with_an_off_file_is_told(tmp_path, options, message):
    with pytest.raises(ShapeError, match=message):
        read(off(tmp_path, **options))
