"""Files that promise what they do not hold, or would take more time and memory than their bytes explain.

They are refused by name, within 5 s (of a busy machine) and 0.5 GiB.
"""

from __future__ import annotations

import json
import resource
import struct
import time
import zlib
from contextlib import contextmanager

import numpy as np
import pytest
from glrender import ConfigError, Shape, ShapeError
from glrender.emission.grid_files import read_grid
from glrender.emission.tables import _facet_table
from glrender.scene.shape.glb_files import read_glb
from glrender.scene.shape.textures import read_texture
from PIL import Image


@contextmanager
def soon_and_small():
    """Within 5 s, and with no more than 0.5 GiB beyond what the process has."""
    pages = int(open("/proc/self/statm").read().split()[0])
    limits, began = resource.getrlimit(resource.RLIMIT_AS), time.monotonic()
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + 2**29, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limits)
    assert time.monotonic() - began < 5.0


def png(width, height):
    """A PNG's beginning: what it says of its size, and a few of its pixels."""
    chunk = lambda kind, data: struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))  # noqa: E731
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
            + chunk(b"IDAT", zlib.compress(bytes(10_000))) + chunk(b"IEND", b""))


@pytest.mark.parametrize("size", [(30_000, 17_000), (16_385, 1), (1, 16_385), (16_384, 8_193), (2**31 - 1, 2**31 - 1)])
def test_a_texture_too_large_is_refused_before_its_pixels_are_decoded(tmp_path, size):
    (tmp_path / "map.png").write_bytes(png(*size))
    with soon_and_small(), pytest.raises(ShapeError, match="must be a texture of at most 16384 pixels|cannot be read"):
        read_texture(tmp_path / "map.png")


def test_a_texture_as_large_as_allowed_is_read(tmp_path):
    Image.new("1", (16_384, 10), 1).save(tmp_path / "map.png")
    np.testing.assert_array_equal(read_texture(tmp_path / "map.png"), np.ones((10, 16_384), np.float32))


@pytest.mark.parametrize("data", [b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EndComments\nquit\n",
                                  png(40, 40)[:60], png(40, 40).replace(b"IDAT", b"IDAX"), b"II*\0\x08\0\0\0\xff\xff"])
def test_what_is_no_picture_or_a_program_is_refused(tmp_path, data):
    """Pillow starts Ghostscript on EPS, whatever the file is called."""
    (tmp_path / "map.png").write_bytes(data)
    with pytest.raises(ShapeError, match="texture cannot be read"):
        read_texture(tmp_path / "map.png")


def refused(path, match):
    with soon_and_small(), pytest.raises(ShapeError, match=match):
        Shape.from_file(path, length_unit="m")


def test_a_facet_of_very_many_corners_is_refused_by_name(tmp_path):
    """Convex: nothing stood against a fan before."""
    angle = np.linspace(0.0, 2.0 * np.pi, 100_000, endpoint=False)
    rows = [f"v {x:.9f} {y:.9f} 0" for x, y in zip(np.cos(angle), np.sin(angle), strict=True)]
    (tmp_path / "disc.obj").write_text("\n".join([*rows, "f " + " ".join(map(str, range(1, 100_001)))]))
    refused(tmp_path / "disc.obj", "a polygon of 100000 corners, where 10000 are allowed.*triangulate it first")


@pytest.mark.parametrize("kind", ["ply", "stl"])
def test_other_formats_have_the_same_limit(tmp_path, kind):
    n = 20_000
    angle = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    rows = [f"{x:.9f} {y:.9f} 0" for x, y in zip(np.cos(angle), np.sin(angle), strict=True)]
    text = {"ply": f"ply\nformat ascii 1.0\nelement vertex {n}\nproperty float x\nproperty float y\nproperty float z\n"
                   f"element face 1\nproperty list int int vertex_indices\nend_header\n" + "\n".join(rows)
                   + f"\n{n} " + " ".join(map(str, range(n))) + "\n",
            "stl": "solid disc\nfacet normal 0 0 1\nouter loop\n" + "\n".join(f"vertex {row}" for row in rows)
                   + "\nendloop\nendfacet\nendsolid disc\n"}[kind]
    (tmp_path / f"disc.{kind}").write_text(text)
    refused(tmp_path / f"disc.{kind}", f"a polygon of {n} corners, where 10000 are allowed")


def test_a_polygon_as_large_as_allowed_is_cut(tmp_path):
    angle = np.linspace(0.0, 2.0 * np.pi, 10_000, endpoint=False)
    rows = [f"v {x:.9f} {y:.9f} 0" for x, y in zip(np.cos(angle), np.sin(angle), strict=True)]
    (tmp_path / "disc.obj").write_text("\n".join([*rows, "f " + " ".join(map(str, range(1, 10_001)))]))
    shape = Shape.from_file(tmp_path / "disc.obj", length_unit=10.0)
    np.testing.assert_allclose(shape.facet_areas_m2.sum(), 100.0 * np.pi, rtol=1e-6)


def test_an_outline_that_crosses_itself_everywhere_takes_no_cube_of_time(tmp_path, rng):
    """Ears sought one by one took 190 s for 1000 corners; 3000 are cut as well as it goes."""
    rows = [f"v {x:.6f} {y:.6f} 0" for x, y in rng.uniform(0.0, 1.0, (3000, 2))]
    (tmp_path / "tangle.obj").write_text("\n".join([*rows, "f " + " ".join(map(str, range(1, 3001)))]))
    with soon_and_small():
        shape = Shape.from_file(tmp_path / "tangle.obj", length_unit="m")
    assert np.isfinite(shape.facet_areas_m2).all() and shape.report.warnings


@pytest.mark.parametrize("outline", ["comb", "spiral"])
def test_outlines_that_are_long_and_wound_are_cut(tmp_path, outline):
    n = 600
    if outline == "comb":
        x = np.arange(n // 2)
        xy = np.concatenate([np.stack([x, np.where(x % 2, 100.0, 1.0)], 1)[::-1], np.stack([x, 0.0 * x], 1)])
    else:
        t = np.linspace(1.0, 20.0 * np.pi, n // 2)
        turn = np.stack([np.cos(t), np.sin(t)], 1)
        xy = np.concatenate([t[:, None] * turn, (t[:, None] + 2.5)[::-1] * turn[::-1]])
    rows = [f"v {x:.9f} {y:.9f} 0" for x, y in xy]
    (tmp_path / "body.obj").write_text("\n".join([*rows, "f " + " ".join(map(str, range(1, len(xy) + 1)))]))
    shape = Shape.from_file(tmp_path / "body.obj", length_unit="m")
    area = 0.5 * abs(np.sum(xy[:, 0] * np.roll(xy[:, 1], -1) - xy[:, 1] * np.roll(xy[:, 0], -1)))
    np.testing.assert_allclose(shape.facet_areas_m2.sum(), area, rtol=1e-6)


def test_loops_that_never_end_take_no_square_of_time(tmp_path):
    """280 kB of them took 93 s."""
    (tmp_path / "open.stl").write_text("solid x\nfacet normal 0 0 1\n" + "outer loop vertex 0 0 0\n" * 40_000)
    refused(tmp_path / "open.stl", "outer loops and endloops differ in number")


def glb(**about):
    """A binary glTF of a tetrahedron, with parts of its JSON replaced."""
    points = np.array([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]], "<f4").tobytes()
    blob = points + np.array([0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3], "<u2").tobytes()
    header = {"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
              "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
              "accessors": [{"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 4},
                            {"bufferView": 1, "componentType": 5123, "type": "SCALAR", "count": 12}],
              "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": 48},
                              {"buffer": 0, "byteOffset": 48, "byteLength": 24}],
              "buffers": [{"byteLength": len(blob)}]}
    text = json.dumps({**header, **about}).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(blob), b"BIN\0") + blob
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def test_the_binary_gltf_that_is_spoilt_below_is_sound(tmp_path):
    (tmp_path / "body.glb").write_bytes(glb())
    assert len(Shape.from_file(tmp_path / "body.glb", length_unit="m").facets) == 4


VALUES = {"componentType": 5126, "type": "VEC3", "count": 200_000_000}


@pytest.mark.parametrize("about, match", [
    ({"accessors": [VALUES, {**VALUES, "type": "SCALAR"}]}, "more values than the file can hold"),
    ({"accessors": [{**VALUES, "count": -1}]}, "more values than the file"),
    ({"accessors": [{**VALUES, "count": 1e9}]}, "more values than the file"),
    ({"accessors": [{**VALUES, "count": 90}] * 99}, "more values than the file can hold"),
    ({"nodes": [{"children": [k + 1, k + 1]} for k in range(40)] + [{"mesh": 0}]}, "several parents"),
    ({"nodes": [{"children": [1]}, {"children": [0], "mesh": 0}]}, "begins at a node with a parent"),
    ({"scenes": [{"nodes": [0] * 1000}]}, "or twice at one"),
    ({"nodes": [{"children": [[1]]}]}, "must be numbers of nodes"), ({"nodes": 3}, "nodes must be a list"),
    ({"nodes": [3]}, "nodes must be objects"), ({"meshes": [{"primitives": 1}]}, "primitives must be a list"),
    ({"buffers": [{"byteLength": 72, "uri": "../../etc/passwd"}]}, "a buffer outside its binary chunk"),
], ids=range(12))
def test_a_binary_gltf_that_promises_or_branches_without_end_is_refused(tmp_path, about, match):
    (tmp_path / "body.glb").write_bytes(glb(**about))
    refused(tmp_path / "body.glb", match)


def test_instances_of_a_mesh_are_counted_before_they_are_made(tmp_path):
    nodes = [{"mesh": 0}] * 5000
    (tmp_path / "body.glb").write_bytes(glb(nodes=nodes, scenes=[{"nodes": list(range(len(nodes)))}]))
    with soon_and_small(), pytest.raises(ShapeError, match="more than 15000 facets, got 20000"):
        Shape.from_file(tmp_path / "body.glb", length_unit="m", max_facets=15_000)


def test_places_that_no_facet_names_are_not_drawn_with_each_instance(tmp_path):
    """4000 times a mesh of four facets, whose accessor has 100,000 places: 10 GB of them."""
    points = np.zeros((100_000, 3), "<f4")
    points[:4] = [[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]]
    blob = points.tobytes() + np.array([0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3], "<u2").tobytes()
    about = {"asset": {"version": "2.0"}, "nodes": [{"mesh": 0, "translation": [20.0 * k, 0, 0]} for k in range(4000)],
             "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
             "accessors": [{"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 100_000},
                           {"bufferView": 1, "componentType": 5123, "type": "SCALAR", "count": 12}],
             "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": 1_200_000},
                             {"buffer": 0, "byteOffset": 1_200_000, "byteLength": 24}],
             "buffers": [{"byteLength": len(blob)}]}
    text = json.dumps(about).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(blob), b"BIN\0") + blob
    (tmp_path / "body.glb").write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks)
    with soon_and_small():
        mesh = read_glb(tmp_path / "body.glb", 20_000)
    assert (len(mesh.vertices), len(mesh.facets)) == (16_000, 16_000)


@pytest.mark.parametrize("name, data", [
    ("body.glb", b"glTF" + struct.pack("<IIII", 2, 100_020, 100_000, 0x4E4F534A) + b"[" * 100_000),
    ("body.glb", b"glTF"), ("body.glb", b""), ("body.off", b"OFF\n100000000 100000000 0\n"), ("body.off", b"\0" * 100),
    ("body.icq", b"999999999999999999999\n"), ("body.tab", b"99999999999999999999 99999999999999999999\n1 2 3\n"),
    ("body.tab", b"9" * 5000), ("body.icq", b"9" * 5000),
    ("body.ply", b"ply\nformat ascii 1.0\nelement vertex " + b"9" * 5000 + b"\nend_header\n"),
    ("body.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 " + b"9" * 5000 + b"\n"),
    ("body.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999999999999\n"),
    ("body.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/99999999999999999999 2/1 3/1\n"),
    ("body.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1/1 2/1/1 99999999999999999999/1/1\n"),
], ids=range(14))
def test_headers_and_indices_beyond_all_numbers_are_refused(tmp_path, name, data):
    (tmp_path / name).write_bytes(data)
    refused(tmp_path / name, name)


def npy(header):
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header


@pytest.mark.parametrize("data", [
    npy(b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }\n") + bytes(64),
    npy(b"{'descr': '<f8', 'fortran_order': False, 'shape': (-1,), }\n") + bytes(64),
    npy(b"{'descr': '<f8', 'fortran_order': False, 'shape': (" + b"9" * 300 + b",), }\n"),
    npy(b"{'descr': '|O', 'fortran_order': False, 'shape': (1,), }\n") + b"cos\nsystem\n(S'true'\ntR.",
    npy(b"(" * 9000), npy(b"-" * 9000 + b"1"), b"\x93NUMPY", b"", b"PK\x03\x04" + bytes(50)])
def test_a_table_of_numbers_that_lies_is_refused_by_name(tmp_path, data):
    (tmp_path / "table.npy").write_bytes(data)
    with soon_and_small(), pytest.raises(ConfigError, match="^table: (cannot be read|must hold numbers)"):
        _facet_table(tmp_path / "table.npy")


def test_an_archive_is_no_table(tmp_path):
    np.savez(tmp_path / "table.npz", a=np.ones(3))
    (tmp_path / "table.npz").rename(tmp_path / "table.npy")
    with pytest.raises(ConfigError, match="^table: must hold numbers"):
        _facet_table(tmp_path / "table.npy")


def test_tables_are_read_as_before_and_nothing_is_unpacked(tmp_path):
    import gzip
    np.save(tmp_path / "table.npy", np.arange(4.0))
    (tmp_path / "table.txt").write_text("0\n1\n2\n3\n")
    for name in ("table.npy", "table.txt"):
        np.testing.assert_array_equal(_facet_table(tmp_path / name), [0.0, 1.0, 2.0, 3.0])
    (tmp_path / "table.gz").write_bytes(gzip.compress(b"1\n" * 1_000_000))
    with soon_and_small(), pytest.raises(ConfigError, match="^table: cannot be read"):
        _facet_table(tmp_path / "table.gz")


def test_a_grids_box_of_many_numbers_is_refused_by_its_shape(tmp_path):
    np.savez_compressed(tmp_path / "grid.npz", density=np.ones((2, 2, 2)), low_m=np.zeros(10**6), high_m=np.ones(3))
    with soon_and_small(), pytest.raises(ConfigError, match=r"low_m: must have shape \(3,\), got \(1000000,\)"):
        read_grid(tmp_path / "grid.npz")
