"""Reader of binary glTF. What a header promises is checked before it is made; what would be another shape is refused.

Source: Khronos (2021), glTF 2.0: the nodes are a strict tree, a mesh is drawn once for each node that names it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import cast

import numpy as np
from scipy.spatial.transform import Rotation

from ...base.errors import ShapeError
from .facet_geometry import joined, renumbered
from .file_mesh import FileMesh
from .glb_json import entry_at, listed, whole
from .glb_materials import GlbMaterial, read_materials
from .textures import image_pixels

# Bytes of a component, and numbers of a value; matrices and vectors of four are neither places nor texture coordinates.
_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}
# Extensions that a file may require: integers as places are read, how surfaces and lamps look is not asked for.
_KNOWN = ("KHR_mesh_quantization", "KHR_lights_punctual", "KHR_xmp_json_ld")
_KNOWN_BEGIN = ("KHR_materials_", "KHR_texture_", "EXT_texture_")
# Extensions of a node by which it is drawn elsewhere, or not at all.
_OF_NODES = ("EXT_mesh_gpu_instancing", "KHR_node_visibility")
_STRIP, _FAN, _TRIANGLES = 5, 6, 4
# Nodes from a root down to the deepest: more than any program makes by hand.
_MOST_DEEP = 64


def read_glb(path: Path, max_facets: int) -> FileMesh:
    """The meshes of a file's scene, in one, and their materials.

    Points and lines are left out, as are animations, cameras and lamps.

    Raises
    ------
    ShapeError
        The file promises more than it holds, names other files, or materials and images that are not there, needs an
        extension that would change the shape and is not known here, or has skins or morphed meshes.
    """
    data = path.read_bytes()
    about, blob = _chunks(data)
    accessors = listed(about, "accessors")
    counts = [entry.get("count", 0) for entry in accessors]
    if any(type(count) is not int or count < 0 for count in counts) or sum(counts) > len(data):
        # A value takes at least a byte.
        raise ShapeError("", "promises more values than the file can hold", str(path))
    if any("uri" in entry for entry in listed(about, "buffers")):
        raise ShapeError("", "has a buffer outside its binary chunk", str(path), "export it as one file")
    _refuse_extensions(about)
    meshes, nodes = listed(about, "meshes"), listed(about, "nodes")
    drawn = list(_drawn(about, nodes, str(path)))
    facets = [_n_facets(mesh, counts) for mesh in meshes]
    total = 0
    for node, _ in drawn:
        total += entry_at(facets, node["mesh"], "mesh")
    if total > max_facets:
        raise ShapeError("", f"has more than {max_facets} facets", total, "decimate it, or raise max_facets")
    values = _Values(accessors=accessors, views=listed(about, "bufferViews"), blob=blob)
    materials = read_materials(about, values.view)
    read = {index: _mesh(meshes[index], values, materials) for index in sorted({node["mesh"] for node, _ in drawn})}
    parts = []
    for node, place in drawn:
        _refuse_morphs(node, meshes[node["mesh"]])
        mesh = read[node["mesh"]]
        # A mirrored mesh keeps its outside.
        turn = slice(None, None, -1 if np.linalg.det(place[:3, :3]) < 0.0 else 1)
        parts.append(replace(mesh, vertices=mesh.vertices @ place[:3, :3].T + place[:3, 3],
                             facets=mesh.facets[:, turn], uv=mesh.uv[:, turn]))
    made = _with_materials(_in_one(parts), materials)
    has_colours = any("COLOR_0" in surface["attributes"] for node, _ in drawn for surface in _surfaces(
        meshes[node["mesh"]])) and bool(made.materials)
    return replace(made, warnings=("colours of vertices are left out",)) if has_colours else made


def pixels_of_images(path: Path) -> int:
    """Number of pixels in the headers of a file's images; 0 for one that `read_glb` refuses."""
    try:
        about, blob = _chunks(path.read_bytes())
        values = _Values(accessors=[], views=listed(about, "bufferViews"), blob=blob)
        return sum(image_pixels(values.view(image.get("bufferView"))) for image in listed(about, "images"))
    except (OSError, ValueError, RecursionError):
        return 0


def _in_one(parts: list[FileMesh]) -> FileMesh:
    """Meshes in one."""
    nothing = FileMesh(np.empty((0, 3)), np.empty((0, 3), np.int64), np.empty((0, 3, 2), np.float32),
                       material=np.empty(0, np.int64))
    parts = [nothing, *parts]
    uv, material = (np.concatenate([getattr(part, name) for part in parts]) for name in ("uv", "material"))
    return FileMesh(*joined((part.vertices, part.facets) for part in parts), uv, material=material)


def _with_materials(mesh: FileMesh, materials: list[GlbMaterial]) -> FileMesh:
    """A mesh with its materials, and texture coordinates where all facets have them or an image needs them."""
    *given, default = materials
    is_double, has_image = (np.array([is_it(each) for each in materials])[mesh.material] for is_it in (
        lambda each: each.is_double_sided, lambda each: each.surface.image is not None))
    has_uv = ~np.isnan(mesh.uv).any(axis=(1, 2))
    if len(lost := np.flatnonzero(has_image & ~has_uv)):
        material = materials[mesh.material[lost[0]]]
        raise ShapeError("meshes.primitives.attributes", f"must have TEXCOORD_{material.uv_set}, by which the image of "
                         f"its material {material.surface.name!r} is laid", hint="export it with texture coordinates")
    uv = np.nan_to_num(mesh.uv) if len(mesh.uv) and (has_image.any() or has_uv.all()) else None
    mesh, is_default = replace(mesh, uv=uv, is_double_sided=is_double), mesh.material == len(given)
    if is_default.all():
        return replace(mesh, material=None)
    surfaces = [each.surface for each in given]
    if is_default.any():
        surfaces.append(replace(default.surface, notes=(
            f"{int(is_default.sum())} facets without a material have the format's default: a white metal of roughness "
            f"1, named {default.surface.name!r}",)))
    return replace(mesh, materials=tuple(surfaces))


@dataclass(frozen=True, kw_only=True)
class _Values:
    """The values that accessors lead to."""

    accessors: list[dict]
    views: list[dict]
    blob: bytes
    made: dict[int, np.ndarray] = field(default_factory=dict)

    def of(self, index: object, kind: str) -> np.ndarray:
        """Values (N, width) of an accessor, as they are stored; in the file's bytes, or made once."""
        entry, at = entry_at(self.accessors, index, "accessor"), cast(int, index)
        if entry.get("type") != kind:
            raise ShapeError("accessors.type", f"must be {kind}", entry.get("type"))
        if at in self.made:
            return self.made[at]
        shape, component = (entry.get("count", 0), _WIDTHS[kind]), _component(entry)
        if "bufferView" in entry and "sparse" not in entry:
            return self._rows(entry, component, *shape)
        rows = self._rows(entry, component, *shape).copy() if "bufferView" in entry else np.zeros(shape, component)
        self.made[at] = self._replaced(rows, entry["sparse"]) if "sparse" in entry else rows
        return self.made[at]

    def vectors(self, index: object, which: np.ndarray, kind: str = "VEC3") -> np.ndarray:
        """Some of an accessor's vectors (N, width) float64: floats, integers, or integers that are normalised."""
        rows = self.of(index, kind)[which]
        entry = entry_at(self.accessors, index, "accessor")
        if rows.dtype.kind == "f" or not entry.get("normalized"):
            return rows.astype(np.float64)
        return np.maximum(rows / np.iinfo(rows.dtype).max, -1.0)

    def _replaced(self, rows: np.ndarray, sparse: object) -> np.ndarray:
        """Rows, of which a sparse accessor gives some anew."""
        if not isinstance(sparse, dict) or not all(isinstance(sparse.get(key), dict) for key in ("indices", "values")):
            raise ShapeError("accessors.sparse", "must have indices and values", sparse)
        count, at = sparse.get("count"), sparse["indices"]
        if type(count) is not int or not 0 <= count <= len(rows):
            raise ShapeError("accessors.sparse.count", f"must be up to {len(rows)}", count)
        places = self._rows(at, _component(at), count, 1)[:, 0]
        if places.dtype.kind != "u" or count and places.max() >= len(rows):
            raise ShapeError("accessors.sparse.indices", f"must be whole numbers below {len(rows)}")
        rows[places] = self._rows(sparse["values"], rows.dtype, count, rows.shape[1])
        return rows

    def view(self, index: object) -> bytes:
        """The bytes of a buffer's view."""
        view = entry_at(self.views, index, "bufferView")
        begin, size = whole(view, "byteOffset"), whole(view, "byteLength")
        if view.get("buffer") != 0 or begin + size > len(self.blob):
            raise ShapeError("bufferViews", "must be within the binary chunk", view)
        return self.blob[begin:begin + size]

    def _rows(self, entry: dict, kind: np.dtype, count: int, width: int) -> np.ndarray:
        view = entry_at(self.views, entry.get("bufferView"), "bufferView")
        begin, size, skip = (whole(table, key) for table, key in (
            (view, "byteOffset"), (view, "byteLength"), (entry, "byteOffset")))
        step = whole(view, "byteStride") or kind.itemsize * width
        if view.get("buffer") != 0 or begin + size > len(self.blob) or count and (
                step < kind.itemsize * width or skip + (count - 1) * step + kind.itemsize * width > size):
            raise ShapeError("bufferViews", "must be within the binary chunk, with all values of their accessors", view)
        return np.ndarray((count, width), kind, self.blob if count else b"", begin + skip if count else 0,
                          (step, kind.itemsize))


def _mesh(mesh: dict, values: _Values, materials: list[GlbMaterial]) -> FileMesh:
    """A mesh's primitives in one, with NaN as texture coordinates where there are none."""
    parts = []
    for primitive in _surfaces(mesh):
        attributes = primitive["attributes"]
        place = attributes.get("POSITION")
        n_points = len(values.of(place, "VEC3"))
        corners = np.arange(n_points)
        if "indices" in primitive:
            corners = values.of(primitive["indices"], "SCALAR")[:, 0]
            if corners.dtype.kind != "u" or len(corners) and corners.max() >= n_points:
                raise ShapeError("meshes.primitives.indices", f"must be whole numbers below {n_points}")
        # Vertices that no corner names are left out: a mesh may be drawn many times.
        used, corners = renumbered(corners, n_points)
        facets = _triangles(corners, primitive.get("mode", _TRIANGLES))
        number = len(materials) - 1
        if (given := primitive.get("material")) is not None:
            number = entry_at(range(number), given, "meshes.primitives.material", "export it with all its materials")
        uv, of_image = np.full((*facets.shape, 2), np.nan, np.float32), materials[number]
        if (laid := attributes.get(f"TEXCOORD_{of_image.uv_set}")) is not None:
            if len(values.of(laid, "VEC2")) != n_points:
                raise ShapeError(f"meshes.primitives.attributes.TEXCOORD_{of_image.uv_set}", f"must be {n_points}")
            at = values.vectors(laid, used, "VEC2")
            at = at @ of_image.uv_from[:, :2].T + of_image.uv_from[:, 2]
            # Images begin on top here, and shapes' coordinates below.
            uv = np.stack([at[:, 0], 1.0 - at[:, 1]], axis=1).astype(np.float32)[facets]
        parts.append(FileMesh(values.vectors(place, used), facets, uv, material=np.full(len(facets), number)))
    return _in_one(parts)


def _triangles(corners: np.ndarray, mode: int) -> np.ndarray:
    if mode == _TRIANGLES:
        if len(corners) % 3:
            raise ShapeError("meshes.primitives", "must have three corners a triangle", len(corners))
        return corners.reshape(-1, 3)
    if mode == _FAN:
        return np.stack([corners[1:-1], corners[2:], np.broadcast_to(corners[:1], len(corners[2:]))], axis=1)
    strip = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
    strip[1::2] = strip[1::2, [1, 0, 2]]
    # Strips are joined by triangles without an area.
    return strip[(strip != np.roll(strip, 1, axis=1)).all(axis=1)]


def _drawn(about: dict, nodes: list[dict], path: str) -> Iterator[tuple[dict, np.ndarray]]:
    """The nodes of the scene that have a mesh, and their places (4, 4)."""
    children = [child for node in nodes for child in listed(node, "children", int)]
    if len(set(children)) < len(children):
        raise ShapeError("", "has a node with several parents, where the nodes must be a tree", path)
    scenes = listed(about, "scenes")
    for scene in scenes:
        roots = listed(scene, "nodes", int)
        # From a root that is a child the way down could lead in a circle.
        if len(set(roots)) < len(roots) or set(roots) & set(children):
            raise ShapeError("", "has a scene that begins at a node with a parent, or twice at one", path)
    roots = [k for k in range(len(nodes)) if k not in set(children)]
    if scenes:
        roots = listed(entry_at(scenes, about.get("scene", 0), "scene"), "nodes", int)
    left = [(root, np.eye(4), 1) for root in reversed(roots)]
    while left:
        index, above, depth = left.pop()
        if depth > _MOST_DEEP:
            raise ShapeError("nodes.children", f"must lead at most {_MOST_DEEP} nodes deep", depth,
                             "apply the nodes' transforms before it is exported")
        node = entry_at(nodes, index, "node")
        place = above @ _place(node)
        left += [(child, place, depth + 1) for child in reversed(listed(node, "children", int))]
        for name in _OF_NODES:
            if name in (node.get("extensions") or {}):
                raise ShapeError("nodes.extensions", "must not move or hide nodes", name, "export it without")
        if "mesh" in node:
            yield node, place


def _place(node: dict) -> np.ndarray:
    """A node's transform (4, 4)."""
    if "matrix" in node:
        return _numbers(node, "matrix", np.eye(4).ravel()).reshape(4, 4).T
    place, scale = np.eye(4), _numbers(node, "scale", np.ones(3))
    turn = _numbers(node, "rotation", np.array([0.0, 0.0, 0.0, 1.0]))
    if not np.linalg.norm(turn) > 0.0:
        raise ShapeError("nodes.rotation", "must be a quaternion", turn.tolist())
    place[:3, :3] = Rotation.from_quat(turn).as_matrix() * scale
    place[:3, 3] = _numbers(node, "translation", np.zeros(3))
    return place


def _refuse_extensions(about: dict) -> None:
    for name in map(str, listed(about, "extensionsRequired", None)):
        if name not in _KNOWN and not name.startswith(_KNOWN_BEGIN):
            raise ShapeError("extensionsRequired", "must be known here: the shape could be another without it", name,
                             "export it without this extension")


def _refuse_morphs(node: dict, mesh: dict) -> None:
    if "skin" in node:
        raise ShapeError("nodes.skin", "must not be there: bones would move the mesh", node["skin"],
                         "apply the pose before it is exported")
    weights = node.get("weights", mesh.get("weights", []))
    if any(primitive.get("targets") for primitive in _surfaces(mesh)) and weights != [0] * len(weights):
        raise ShapeError("meshes.weights", "must be 0: morph targets would move the mesh", weights,
                         "apply them before it is exported")


def _chunks(data: bytes) -> tuple[dict, bytes]:
    """The JSON and the binary chunk of a file."""
    size = int.from_bytes(data[12:16], "little")
    if data[:4] != b"glTF" or data[16:20] != b"JSON" or size > len(data) - 20:
        raise ShapeError("", "is no binary glTF: it must begin with glTF and a JSON chunk")
    about = json.loads(data[20:20 + size])
    if not isinstance(about, dict):
        raise ShapeError("", "is no binary glTF: its JSON must be an object")
    asset = about.get("asset")
    version = str(asset.get("version")) if isinstance(asset, dict) else None
    if data[4:8] != b"\x02\0\0\0" or version is None or not version.startswith("2."):
        raise ShapeError("asset.version", "must be of glTF 2", version)
    begin = 28 + size
    is_there = data[begin - 4:begin] == b"BIN\0"
    return about, data[begin:begin + int.from_bytes(data[begin - 8:begin - 4], "little")] if is_there else b""


def _component(entry: dict) -> np.dtype:
    if (kind := entry.get("componentType")) not in _COMPONENTS:
        raise ShapeError("accessors.componentType", f"must be one of {', '.join(map(str, _COMPONENTS))}", kind)
    return np.dtype(_COMPONENTS[kind])


def _numbers(node: dict, key: str, default: np.ndarray) -> np.ndarray:
    value = np.array(node.get(key, default))
    if value.shape != default.shape or value.dtype.kind not in "if" or not np.isfinite(value).all():
        raise ShapeError(f"nodes.{key}", f"must be {len(default)} numbers", node[key])
    return value.astype(np.float64)


def _surfaces(mesh: dict) -> list[dict]:
    """The primitives of a mesh that have an area."""
    primitives = listed(mesh, "primitives")
    if not all(isinstance(primitive.get("attributes"), dict) for primitive in primitives):
        raise ShapeError("", "is no binary glTF: attributes must be an object")
    return [primitive for primitive in primitives if primitive.get("mode", _TRIANGLES) in (_TRIANGLES, _STRIP, _FAN)]


def _n_facets(mesh: dict, counts: list[int]) -> int:
    """Most facets of a mesh: its corners as triangles, strips or fans."""
    total = 0
    for primitive in _surfaces(mesh):
        corners = primitive.get("indices", primitive["attributes"].get("POSITION"))
        if type(corners) is int and 0 <= corners < len(counts):
            total += counts[corners] // 3 if primitive.get("mode", _TRIANGLES) == _TRIANGLES else counts[corners]
    return total
