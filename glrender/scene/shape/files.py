"""Readers of shape files: each returns vertices, facets and, for OBJ, texture coordinates of the corners."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...base.errors import ShapeError
from ..plugins.registry import shape_readers
from .file_mesh import FileMesh
from .glb_files import read_glb
from .materials import FileMaterial
from .mtl_files import NO_MATERIAL, name_of_material, read_mtl
from .off_files import read_off
from .ply_files import read_ply
from .polygons import MAX_CORNERS, triangulated
from .stl_files import read_stl

MAX_FACETS = 20_000_000
# Statements of OBJ that make surfaces without facets, or take them from elsewhere.
_OTHER_SURFACES = ("surf", "curv", "curv2", "cstype", "call", "csh")
# Numbers of a vertex in OBJ: a place, with a weight, with a colour, with both.
_VERTEX_WIDTHS = (3, 4, 6, 7)
# Comments, but in names of materials.
_COMMENT = re.compile(r"^[ \t]*(?:usemtl|mtllib)\b[^\r\n]*|#[^\r\n]*", re.MULTILINE)
_FORTRAN = str.maketrans("dD", "eE")
# Bytes of a file that no facet count within the limit explains.
_MAX_BYTES = 4 * 1024**3


def own_unit(path: Path) -> str | None:
    """The unit of length that a file has by its format's definition; most have none."""
    reader = shape_readers().get(path.suffix.lower()[1:])
    return None if reader is None else reader.length_unit


def read_shape_file(path: Path, max_facets: int, surface: int | None = None) -> FileMesh:
    """Read a shape file, its polygons cut into triangles; of a file with several surfaces the one that is chosen.

    Raises
    ------
    ShapeError
        The file is missing, of no known kind, or does not hold a mesh.
    """
    try:
        is_folder, size = path.is_dir(), path.stat().st_size
    except OSError as error:
        raise ShapeError("", f"cannot be read: {error.strerror}", str(path),
                         "names in a scene file are relative to its folder" * (not path.is_absolute())) from None
    except ValueError as error:  # a NUL in the name
        raise ShapeError("", f"cannot be read: {error}", str(path)) from None
    if is_folder:
        raise ShapeError("", "is a folder, not a shape file", str(path))
    if size == 0:
        raise ShapeError("", "is empty", str(path))
    if size > _MAX_BYTES:
        raise ShapeError("", "is larger than 4 GiB", str(path), "decimate it first")
    ending, others = path.suffix.lower(), shape_readers()
    options = {} if surface is None else {"surface": surface}
    if ending not in _READERS and ending[1:] not in others:
        raise ShapeError("", f"must end in one of {', '.join(sorted([*_READERS, *(f'.{name}' for name in others)]))}",
                         str(path), _WAYS_OUT.get(ending, "export it as one of these"))
    try:
        if ending in _READERS:
            if options:
                raise ShapeError("surface", "is a choice among a DSK's surfaces, and this file has none", surface,
                                 "leave it out")
            return _READERS[ending](path, max_facets)
        return others[ending[1:]].read(path, max_facets, **options)
    except ShapeError:
        raise
    except (OSError, MemoryError, OverflowError) as error:
        raise ShapeError("", f"cannot be read: {error}", str(path)) from None
    except Exception as error:  # third-party parsers raise anything on hostile bytes
        raise ShapeError("", f"is not a readable {path.suffix[1:].upper()} file: {type(error).__name__}: {error}",
                         str(path)) from None


def _lines(path: Path) -> list[str]:
    return _text(path).splitlines()


def _text(path: Path) -> str:
    data = path.read_bytes()
    if b"\0" in data[:65536]:
        raise ShapeError("", "is binary, not text", str(path))
    return data.decode("utf-8-sig", errors="replace")


def _numbers(path: Path, rows: list[str], width: int, what: str) -> np.ndarray:
    """(n, width) float64 of text rows; a wrong row is named."""
    # Fortran's exponents: 1.0D-02.
    words = " ".join(rows).translate(_FORTRAN).split()
    try:
        # Rows too long and too short may add up to the right number.
        if len(words) == width * len(rows) and all(len(row.split()) == width for row in rows):
            return np.array(words, dtype=object).astype(np.float64).reshape(-1, width)
    except ValueError:
        pass
    for row in rows:
        parts = row.split()
        try:
            [float(part.translate(_FORTRAN)) for part in parts]
        except ValueError:
            hint = "write decimals with a point" if "," in row else ""
            raise ShapeError("", f"has a {what} that is no number", row.strip(), hint) from None
        if len(parts) != width:
            raise ShapeError("", f"has a {what} with {len(parts)} numbers instead of {width}", row.strip())
    raise ShapeError("", f"has unreadable {what} rows", str(path))


def facet_limit(count: int, max_facets: int) -> None:
    """Refuse a file that has more facets than allowed."""
    if count > max_facets:
        raise ShapeError("", f"has more than {max_facets} facets", count, "decimate it, or raise max_facets")


def _obj(path: Path, max_facets: int) -> FileMesh:
    vertex_rows, texture_rows, faces, libraries, uses = [], [], [], [], []
    text = _text(path)
    if "#" in text:
        text = _COMMENT.sub(lambda found: "" if found[0][0] == "#" else found[0], text)
    if "\\" in text:  # a statement goes on in the next line
        text = re.sub(r"\\[ \t]*\r?\n", " ", text)
    for line in text.splitlines():
        words = line.split(None, 1)
        if len(words) < 2 and words != ["usemtl"]:
            continue
        key, rest = (*words, "")[:2]
        if key == "v":
            vertex_rows.append(rest)
        elif key == "vt":
            texture_rows.append(" ".join(rest.split()[:2]))
        elif key == "f":
            faces.append((rest, len(vertex_rows), len(texture_rows)))
        elif key == "usemtl":
            uses.append((len(faces), name_of_material(rest) or NO_MATERIAL))
        elif key == "mtllib":
            libraries.append(name_of_material(rest))
        elif key in _OTHER_SURFACES:
            raise ShapeError("", f"has a statement `{key}` of a surface that is no polygon, or of another file",
                             line.strip(), "export it as polygons, in one file")
    if not vertex_rows or not faces:
        raise ShapeError("", "has no vertices or no facets", str(path))
    facet_limit(len(faces), max_facets)
    material, materials = _obj_materials(path.parent, libraries, uses, len(faces))
    if len(" ".join(vertex_rows).split()) > 3 * len(vertex_rows):  # weights or colours follow
        if wrong := next((row for row in vertex_rows if len(row.split()) not in _VERTEX_WIDTHS), None):
            raise ShapeError("", f"has a vertex with {len(wrong.split())} numbers, where a place has 3, 4 with a "
                             "weight, 6 or 7 with a colour", wrong.strip())
        vertex_rows = [" ".join(row.split()[:3]) for row in vertex_rows]
    vertices = _numbers(path, vertex_rows, 3, "vertex")
    texture = _numbers(path, texture_rows, 2, "texture coordinate") if texture_rows else None
    plain = all(face[1] == len(vertex_rows) for face in (faces[0], faces[-1]))
    text = " ".join(face[0] for face in faces)
    slashes = text.count("/")
    tokens = text.split()
    if plain and "-" not in text and len(tokens) == 3 * len(faces) and all(len(face[0].split()) == 3 for face in faces):
        # The common case, all at once: triangles, positive indices.
        if slashes == 0:
            return FileMesh(vertices, _integers(path, tokens).reshape(-1, 3) - 1, material=material,
                            materials=materials)
        if slashes == len(tokens) and texture is not None and all(token.count("/") == 1 for token in tokens):
            pairs = _integers(path, text.replace("/", " ").split()).reshape(-1, 3, 2) - 1
            return FileMesh(vertices, pairs[..., 0], _corner_uv(texture, pairs[..., 1]), material=material,
                            materials=materials)
    corners, uv_corners, sizes, n_textured = [], [], [], 0
    for face, n_vertices, n_texture in faces:
        polygon = [token.split("/") for token in face.split()]
        if len(polygon) < 3:
            raise ShapeError("", "has a facet with fewer than 3 corners", f"f {face}")
        if len(polygon) > MAX_CORNERS:
            raise ShapeError("", f"has a polygon of {len(polygon)} corners, where {MAX_CORNERS} are allowed", str(path),
                             "triangulate it first")
        try:
            corners += [_from_one(int(corner[0]), n_vertices) for corner in polygon]
            if all(len(corner) > 1 and corner[1] for corner in polygon):
                uv_corners += [_from_one(int(corner[1]), n_texture) for corner in polygon]
                n_textured += 1
        except ValueError:
            raise ShapeError("", "has a facet with an index that is no integer", f"f {face}") from None
        sizes.append(len(polygon))
    uv, warnings = None, ()
    if texture is not None and n_textured == len(faces):
        uv = _corner_uv(texture, np.array(uv_corners))
    elif texture is not None and n_textured:
        warnings = (f"texture coordinates are left out, {len(faces) - n_textured} of {len(faces)} facets have none: no "
                    f"albedo map can be used until every corner of every facet names its own (v/vt)",)
    mesh = _of_polygons(vertices, np.array(corners, np.int64), np.array(sizes), max_facets, uv, material)
    return replace(mesh, warnings=warnings, materials=materials)


def _obj_materials(folder: Path, libraries: list[str], uses: list[tuple[int, str]], n_faces: int
                   ) -> tuple[np.ndarray | None, tuple[FileMaterial, ...]]:
    """Numbers (n_faces,) of the faces' materials, each used from a face on, and the materials."""
    if not uses:
        return None, ()
    begins, names = np.array([0, *(begin for begin, _ in uses), n_faces]), [NO_MATERIAL, *(name for _, name in uses)]
    counts = np.diff(begins)
    number = {name: k for k, name in enumerate(dict.fromkeys(
        name for name, count in zip(names, counts, strict=True) if count))}
    material = np.repeat([number.get(name, 0) for name in names], counts)
    return material, read_mtl(folder, libraries, list(number))


def _from_one(index: int, count: int) -> int:
    """OBJ counts from 1, and backwards from the last with negative numbers."""
    return index - 1 if index > 0 else count + index if index < 0 else -1


def _integers(path: Path, tokens: list[str]) -> np.ndarray:
    try:
        return np.array(tokens, dtype=object).astype(np.int64)
    except ValueError as error:
        raise ShapeError("", "has a facet with an index that is no integer", str(error)) from None


def _corner_uv(texture: np.ndarray, index: np.ndarray) -> np.ndarray:
    if index.min() < 0 or index.max() >= len(texture):
        raise ShapeError("", f"has a texture index outside 1..{len(texture)}", int(index.max()) + 1)
    return texture[index].astype(np.float32)


def _ply(path: Path, max_facets: int) -> FileMesh:
    vertices, corners, sizes = read_ply(path)
    return _of_polygons(vertices, corners, sizes, max_facets)


def _stl(path: Path, max_facets: int) -> FileMesh:
    points, sizes, warnings = read_stl(path)
    if not len(sizes):
        raise ShapeError("", "has no facets", str(path))
    return replace(_of_polygons(points, np.arange(len(points)), sizes, max_facets), warnings=warnings)


def _of_polygons(vertices: np.ndarray, corners: np.ndarray, sizes: np.ndarray, max_facets: int,
                 uv: np.ndarray | None = None, material: np.ndarray | None = None) -> FileMesh:
    """Triangles of polygons of some corners each (P,): of all in turn the vertices (N,) and texture coordinates (N, 2).

    And the polygons' materials (P,).
    """
    few = np.flatnonzero(sizes < 3)
    if len(few):
        raise ShapeError(f"facets[{few[0]}]", "has fewer than 3 corners", int(sizes[few[0]]))
    facet_limit(int(sizes.sum()) - 2 * len(sizes), max_facets)
    try:
        triangles = triangulated(vertices, corners, sizes)
    except ValueError as error:
        raise ShapeError("", f"has {error}") from None
    if material is not None:
        material = np.repeat(material, sizes)[triangles[:, 0]]
    return FileMesh(vertices, corners[triangles], None if uv is None else uv[triangles], material=material)


def _plate_model(path: Path, max_facets: int) -> FileMesh:
    """PDS plate model: a count line, vertices, a count line, plates from 1; index columns optional.

    Or rows of `v` and `f`, with counts before them or none.
    """
    rows = [row for line in _lines(path) if (row := line.replace(",", " ").strip()) and not row.startswith("#")]
    if not rows:
        raise ShapeError("", "has no lines but comments", str(path))
    if any(row.split()[0] in ("v", "f", "V", "F") for row in rows[:3]):
        by_letter: dict[str, list[str]] = {"v": [], "f": []}
        for row in rows:
            letter, *numbers = row.split(maxsplit=1)
            if letter.lower() in by_letter:
                by_letter[letter.lower()].extend(numbers)
            elif not "".join(row.split()).isdigit():
                raise ShapeError("", "must have rows of v, of f and of counts alone", row)
        rows = [f"{len(by_letter['v'])} {len(by_letter['f'])}", *by_letter["v"], *by_letter["f"]]
    head = rows[0].split()
    try:
        counts = [int(word) for word in head]
        if len(counts) == 2:
            n_vertices, n_plates, start = *counts, 1
            plates_at = start + n_vertices
        elif len(counts) == 1:
            n_vertices, start = counts[0], 1
            n_plates, plates_at = int(rows[start + n_vertices].split()[0]), start + n_vertices + 1
        else:
            raise ValueError
    except (ValueError, IndexError):
        raise ShapeError("", "is no plate model: it must begin with the number of vertices, or have rows of v and f",
                         rows[0].strip()) from None
    facet_limit(n_plates, max_facets)
    vertex_rows, plate_rows = rows[start:start + n_vertices], rows[plates_at:plates_at + n_plates]
    if len(vertex_rows) != n_vertices or len(plate_rows) != n_plates or not n_vertices or not n_plates:
        raise ShapeError("", f"promises {n_vertices} vertices and {n_plates} plates and ends before",
                         len(rows))
    vertices, plates = _numbered(path, vertex_rows, "vertex"), _numbered(path, plate_rows, "plate")
    wrong = np.flatnonzero(((plates != np.round(plates)) | (np.abs(plates) > 2**31)).any(axis=1))
    if len(wrong):
        raise ShapeError("", "has a plate with an index that is no 32-bit integer", plate_rows[wrong[0]].strip())
    return FileMesh(vertices, plates.astype(np.int64) - 1)


def _numbered(path: Path, rows: list[str], what: str) -> np.ndarray:
    """(n, 3) float64 of rows with or without their numbers in front; other columns would shift these."""
    width = len(rows[0].split())
    table = _numbers(path, rows, width if width in (3, 4) else 3, what)
    if width == 4 and not (np.diff(table[:, 0]) == 1.0).all():
        raise ShapeError("", f"has {what} rows of 4 columns, whose first one does not count them", rows[0].strip(),
                         "leave other columns out")
    return table[:, -3:]


def _icq(path: Path, max_facets: int) -> FileMesh:
    """Implicitly connected quadrilaterals (Gaskell): q, then six faces of (q + 1) x (q + 1) vertices."""
    rows = [line for line in _lines(path) if line.strip()]
    if not rows:
        raise ShapeError("", "has only empty lines", str(path))
    try:
        q = int(rows[0].split()[0])
    except ValueError:
        raise ShapeError("", "is no ICQ file: it must begin with q", rows[0].strip()) from None
    facet_limit(12 * q * q, max_facets)
    side = q + 1
    if q < 1 or len(rows) < 1 + 6 * side * side:
        raise ShapeError("", f"promises 6 ({q} + 1)^2 vertices and ends before", len(rows) - 1)
    vertices = _numbers(path, rows[1:1 + 6 * side * side], 3, "vertex")
    a = (np.arange(6)[:, None, None] * side * side + np.arange(q)[:, None] * side + np.arange(q)).ravel()
    quad = np.stack([a, a + 1, a + side + 1, a + side], axis=1)
    # The shorter diagonal follows the surface better.
    across = np.linalg.norm(vertices[quad[:, 0]] - vertices[quad[:, 2]], axis=1)
    other = np.linalg.norm(vertices[quad[:, 1]] - vertices[quad[:, 3]], axis=1)
    first = np.where((across <= other)[:, None], quad[:, [0, 1, 2]], quad[:, [0, 1, 3]])
    second = np.where((across <= other)[:, None], quad[:, [0, 2, 3]], quad[:, [1, 2, 3]])
    return FileMesh(vertices, np.concatenate([first, second]))


def _glb(path: Path, max_facets: int) -> FileMesh:
    mesh = read_glb(path, max_facets)
    facet_limit(len(mesh.facets), max_facets)
    return mesh


def _off(path: Path, max_facets: int) -> FileMesh:
    vertices, corners, sizes = read_off(path)
    if not len(sizes):
        raise ShapeError("", "has no facets", str(path))
    return _of_polygons(vertices, corners, sizes, max_facets)


_MAP = "it is a map of heights and no shape: make a mesh of it first"
_WAYS_OUT = {".gltf": "export it as .glb, which has all in one file", ".tif": _MAP, ".tiff": _MAP, ".img": _MAP}
_READERS: dict[str, Callable[[Path, int], FileMesh]] = {
    ".obj": _obj, ".ply": _ply, ".stl": _stl, ".tab": _plate_model, ".plt": _plate_model,
    ".icq": _icq, ".glb": _glb, ".off": _off,
}
