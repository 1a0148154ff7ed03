"""Readers of formats that trimesh reads: binary glTF and OFF. What a header promises is checked before it is made.

Source: Khronos (2021), glTF 2.0: the nodes are a strict tree, a mesh is drawn once for each node that names it.
"""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import trimesh

from ...base.errors import ShapeError


def read_off(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) float64 and triangles (F, 3) int64."""
    return _loaded(path.read_bytes(), "off")


def read_glb(path: Path, max_facets: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) float64 and triangles (F, 3) int64 of all meshes of a file's scene, in one.

    Raises
    ------
    ShapeError
        It promises more than it holds, or names other files.
    """
    data = path.read_bytes()
    about = _header(data)
    counts = [entry.get("count", 0) for entry in _entries(about, "accessors")]
    if any(type(count) is not int or count < 0 for count in counts) or sum(counts) > len(data):
        # A value takes at least a byte.
        raise ShapeError("", "promises more values than the file can hold", str(path))
    if any("uri" in entry for entry in _entries(about, "buffers")):
        raise ShapeError("", "has a buffer outside its binary chunk", str(path), "export it as one file")
    facets = [_n_facets(mesh, counts) for mesh in _entries(about, "meshes")]
    nodes, total = _entries(about, "nodes"), 0
    children = [child for node in nodes for child in _indices(node, "children")]
    if len(set(children)) < len(children):
        raise ShapeError("", "has a node with several parents, where the nodes must be a tree", str(path))
    for node in nodes:
        mesh = node.get("mesh")
        if type(mesh) is int and 0 <= mesh < len(facets):
            total += facets[mesh]
    if total > max_facets:
        raise ShapeError("", f"has more than {max_facets} facets", total, "decimate it, or raise max_facets")
    for scene in _entries(about, "scenes"):
        roots = _indices(scene, "nodes")
        # From a root that is a child the way down could lead in a circle.
        if len(set(roots)) < len(roots) or set(roots) & set(children):
            raise ShapeError("", "has a scene that begins at a node with a parent, or twice at one", str(path))
    return _loaded(data, "glb", skip_materials=True)


def _loaded(data: bytes, kind: str, **options: bool) -> tuple[np.ndarray, np.ndarray]:
    """The mesh that trimesh reads from memory: it must find no other file by this one's name."""
    mesh = trimesh.load_mesh(io.BytesIO(data), file_type=kind, process=False, **options)
    return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)


def _header(data: bytes) -> dict:
    size = int.from_bytes(data[12:16], "little")
    if data[:4] != b"glTF" or data[16:20] != b"JSON" or size > len(data) - 20:
        raise ShapeError("", "is no binary glTF: it must begin with glTF and a JSON chunk")
    about = json.loads(data[20:20 + size])
    if not isinstance(about, dict):
        raise ShapeError("", "is no binary glTF: its JSON must be an object")
    return about


def _entries(about: dict, key: str) -> list[dict]:
    """A list of objects, empty if it is not there."""
    entries = _list(about, key)
    if not all(isinstance(entry, dict) for entry in entries):
        raise ShapeError("", f"is no binary glTF: {key} must be objects")
    return entries


def _list(about: dict, key: str) -> list:
    entries = about.get(key, [])
    if not isinstance(entries, list):
        raise ShapeError("", f"is no binary glTF: {key} must be a list")
    return entries


def _indices(about: dict, key: str) -> list[int]:
    entries = _list(about, key)
    if not all(type(entry) is int for entry in entries):
        raise ShapeError("", f"is no binary glTF: {key} must be numbers of nodes")
    return entries


def _n_facets(mesh: dict, counts: list[int]) -> int:
    """Most facets of a mesh: its corners as triangles, strips or fans."""
    total = 0
    for primitive in _entries(mesh, "primitives"):
        attributes = primitive.get("attributes")
        corners = primitive.get("indices", attributes.get("POSITION") if isinstance(attributes, dict) else None)
        if type(corners) is int and 0 <= corners < len(counts):
            total += counts[corners] if primitive.get("mode", 4) in (5, 6) else counts[corners] // 3
    return total
