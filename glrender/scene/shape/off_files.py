"""Reader of OFF, the object file format of Geomview, with polygons of any number of corners.

Source: Geomview's manual, OFF: [ST][C][N][4][n]OFF, counts, vertices, faces that may end in a colour.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ...base.errors import ShapeError

# How many numbers of a colour may be behind a face's corners.
_COLOUR = (0, 1, 3, 4)


def read_off(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The polygons of a file; normals, colours and texture coordinates are left out.

    Returns
    -------
    vertices : (V, 3) float64
    corners : (N,) int64
        Of all polygons, one polygon after the other, from 0.
    sizes : (P,) int64
        Corners of each.

    Raises
    ------
    ShapeError
        With the row: a header of another kind, vertices of more than three coordinates, rows that are no numbers or
        too few.
    """
    data = path.read_bytes()
    if b"\0" in data or b"BINARY" in data[:32]:
        raise ShapeError("", "is binary, not text", str(path), "export it as text")
    rows = [row.split() for row in (line.partition("#")[0] for line in data.decode("utf-8-sig").splitlines())]
    rows = [row for row in rows if row]
    kind = re.fullmatch("(ST)?(C)?(N)?(4)?(n)?OFF", rows[0][0]) if rows else None
    if kind is None:
        raise ShapeError("", "is no OFF file: it must begin with OFF", rows[0][0] if rows else None)
    if kind[4] or kind[5]:
        raise ShapeError("", "must have vertices of three coordinates", rows[0][0], "export it as OFF")
    # Counts may stand behind the word.
    counts, begin = (rows[0][1:], 1) if len(rows[0]) > 1 else (rows[1] if len(rows) > 1 else [], 2)
    if len(counts) not in (2, 3) or not all(word.isdecimal() for word in counts):
        raise ShapeError("", "must have counts of vertices, faces and edges", " ".join(counts))
    n_vertices, n_faces = int(counts[0][:18]), int(counts[1][:18])
    if len(rows) - begin != n_vertices + n_faces:
        raise ShapeError("", f"promises {n_vertices} vertices and {n_faces} faces, a row each", len(rows) - begin)
    return _vertices(rows[begin:begin + n_vertices], rows[0][0]), *_polygons(rows[begin + n_vertices:])


def _vertices(rows: list[list[str]], kind: str) -> np.ndarray:
    """Vertices (V, 3); only files that say so have more numbers behind."""
    for row in rows:
        if len(row) < 3 or len(row) > 3 and kind == "OFF":
            raise ShapeError("", f"has a vertex with {len(row)} numbers instead of 3", " ".join(row))
    try:
        return np.array([row[:3] for row in rows], dtype=object).astype(np.float64).reshape(-1, 3)
    except ValueError as error:
        raise ShapeError("", "has a vertex that is no number", str(error)) from None


def _polygons(rows: list[list[str]]) -> tuple[np.ndarray, np.ndarray]:
    corners: list[str] = []
    sizes = []
    for row in rows:
        size = int(row[0]) if row[0].isdecimal() and len(row[0]) < 9 else -1
        if size < 0 or len(row) - 1 - size not in _COLOUR:
            raise ShapeError("", "has a face that is not a count, corners and a colour at most", " ".join(row))
        corners += row[1:1 + size]
        sizes.append(size)
    try:
        return np.array(corners, dtype=object).astype(np.int64), np.array(sizes, np.int64)
    except (ValueError, OverflowError) as error:
        raise ShapeError("", "has a face with an index that is no integer", str(error)) from None
