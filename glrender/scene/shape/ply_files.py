"""Reader of PLY files, text and binary of either byte order, with polygons of any and of different sizes.

Source: Turk (1994), The PLY polygon file format.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...base.errors import ShapeError
from .facet_geometry import counted

_TYPES = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
          "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
          "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8"}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_CORNERS = ("vertex_indices", "vertex_index")
# Bytes of the longest header.
_HEAD = 1 << 20


@dataclass(frozen=True)
class _Element:
    """Rows of one kind: its properties' names, with the types of values and, of lists, of counts."""

    name: str
    count: int
    properties: list[tuple[str, str, str | None]]

    @property
    def lists(self) -> list[str]:
        """Names of the properties that are lists."""
        return [name for name, _, count in self.properties if count]

    def too_many(self) -> ShapeError:
        """The error of a file that ends before its rows do."""
        return ShapeError("", f"promises more {self.name} rows than the file can hold", self.count)


def read_ply(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices (V, 3) float64, corners (N,) int64 of all polygons, and how many each has (P,).

    Elements and properties that are no facets, as triangle strips, are passed over.

    Raises
    ------
    ShapeError
    """
    data = path.read_bytes()
    order, elements, at = _header(data)
    rows = _TextRows(data[at:].split()) if order == "" else _BinaryRows(data, at, order)
    vertices, corners, sizes = None, [], []
    for element in elements:
        names = [name for name, _, _ in element.properties]
        if element.count > len(data):
            # A row takes at least a byte: a header that promises more is broken or hostile.
            raise element.too_many()
        if element.name == "vertex":
            missing = [axis for axis in "xyz" if axis not in names]
            if missing:
                raise ShapeError("", "has vertices without", ", ".join(missing))
            scalars, _ = rows.take(element, None)
            vertices = np.stack([scalars[axis] for axis in "xyz"], axis=1).astype(np.float64)
        elif element.name == "face" and (lists := [n for n in element.lists if n in _CORNERS]):
            _, (values, counts) = rows.take(element, lists[0])
            corners.append(values)
            sizes.append(counts)
        else:
            rows.take(element, None)
    if vertices is None or not any(len(some) for some in sizes):
        raise ShapeError("", "has no vertices or no facets", str(path))
    return vertices, np.concatenate(corners).astype(np.int64), np.concatenate(sizes)


def _header(data: bytes) -> tuple[str, list[_Element], int]:
    """Byte order ("" for text), elements, and where the rows begin."""
    end = data.find(b"end_header", 0, _HEAD)
    line_end = data.find(b"\n", end)
    # Old Mac programs end lines with CR alone.
    if end >= 0 and data[end + 10:end + 11] == b"\r" and data[end + 11:end + 12] != b"\n":
        line_end = end + 10
    if not data.startswith(b"ply") or end < 0 or line_end < 0:
        raise ShapeError("", "is not a readable PLY file: it must begin with a header, from `ply` to `end_header`")
    order, elements = None, []
    for line in data[:end].decode("latin-1").splitlines()[1:]:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        try:
            if words[0] == "format":
                order = _ORDERS[words[1]]
            elif words[0] == "element":
                elements.append(_Element(words[1], int(words[2]), []))
            elif words[0] == "property" and words[1] == "list":
                if _TYPES[words[2]][0] == "f":
                    raise KeyError
                elements[-1].properties.append((words[4], _TYPES[words[3]], _TYPES[words[2]]))
            elif words[0] == "property":
                elements[-1].properties.append((words[2], _TYPES[words[1]], None))
            else:
                raise KeyError
        except (KeyError, IndexError, ValueError):
            raise ShapeError("", "is not a readable PLY file: its header has", line.strip()[:100]) from None
    if order is None or any(element.count < 0 for element in elements):
        raise ShapeError("", "is not a readable PLY file: its header must have a format, and counts >= 0")
    return order, elements, line_end + 1


class _BinaryRows:
    """Rows of elements, one element after the other."""

    def __init__(self, data: bytes, at: int, order: str):
        self._data, self._at, self._order = data, at, order

    def take(self, element: _Element, wanted: str | None) -> tuple[dict, tuple[np.ndarray, np.ndarray]]:
        """Scalars by name if the rows have no lists, and the wanted list's values and counts."""
        if not element.lists:
            row = np.dtype([(str(k), self._order + kind) for k, (_, kind, _) in enumerate(element.properties)])
            if self._at + row.itemsize * element.count > len(self._data):
                raise element.too_many()
            table = np.frombuffer(self._data, row, element.count, self._at) if row.itemsize else None
            self._at += row.itemsize * element.count
            return {name: table[str(k)] for k, (name, _, _) in enumerate(element.properties)}, (None, None)
        starts = self._walk(element)
        return self._scalars(element, starts), self._lists(element, starts, wanted)

    def _walk(self, element: _Element) -> np.ndarray:
        """Offsets at which each property of each row begins (rows, properties); lists begin at their counts."""
        sizes = [(np.dtype(kind).itemsize, np.dtype(count).itemsize if count else 0, count and count[0] == "i")
                 for _, kind, count in element.properties]
        order, data, at, starts = "big" if self._order == ">" else "little", self._data, self._at, []
        end = len(data)
        for _ in itertools.repeat(None, element.count):
            for size, of_count, is_signed in sizes:
                starts.append(at)
                if of_count:
                    n = int.from_bytes(data[at:at + of_count], order, signed=bool(is_signed))
                    if n < 0:
                        raise ShapeError("", f"has a list of {element.name} with a count of", n)
                    at += of_count + n * size
                else:
                    at += size
            if at > end:
                raise element.too_many()
        self._at = at
        return np.array(starts, np.int64).reshape(element.count, len(sizes))

    def _gather(self, starts: np.ndarray, kind: str) -> np.ndarray:
        """Values (N,) of a type that begin at some bytes (N,)."""
        size = np.dtype(kind).itemsize
        found = np.frombuffer(self._data, np.uint8)[starts[:, None] + np.arange(size)]
        return found.reshape(-1).view(self._order + kind)

    def _scalars(self, element: _Element, starts: np.ndarray) -> dict:
        return {name: self._gather(starts[:, k], kind)
                for k, (name, kind, count) in enumerate(element.properties) if count is None}

    def _lists(self, element: _Element, starts: np.ndarray, wanted: str | None) -> tuple:
        for k, (name, kind, count) in enumerate(element.properties):
            if name == wanted and count:
                sizes = self._gather(starts[:, k], count).astype(np.int64)
                first = np.repeat(starts[:, k] + np.dtype(count).itemsize, sizes)
                return self._gather(first + counted(sizes) * np.dtype(kind).itemsize, kind).astype(np.int64), sizes
        return None, None


class _TextRows:
    """Rows of elements as words; a row need not be a line."""

    def __init__(self, words: list[bytes]):
        self._words, self._at = words, 0

    def take(self, element: _Element, wanted: str | None) -> tuple[dict, tuple[np.ndarray, np.ndarray]]:
        """Scalars by name if the rows have no lists, and the wanted list's values and counts."""
        words, at, width = self._words, self._at, len(element.properties)
        if not element.lists:
            self._at = at + width * element.count
            if self._at > len(words):
                raise element.too_many()
            return {name: _numbers(words[at + k:self._at:width], element.name)
                    for k, (name, _, _) in enumerate(element.properties)}, (None, None)
        scalars = {name: [] for name, _, count in element.properties if count is None}
        values, sizes = [], []
        try:
            for _ in itertools.repeat(None, element.count):
                for name, _, count in element.properties:
                    if count is None:
                        scalars[name].append(words[at])
                        at += 1
                        continue
                    n = int(words[at])
                    if n < 0 or at + n >= len(words):
                        raise IndexError
                    if name == wanted:
                        values += words[at + 1:at + 1 + n]
                        sizes.append(n)
                    at += 1 + n
        except IndexError:
            raise element.too_many() from None
        except ValueError:
            raise ShapeError("", f"has a list of {element.name} with a count of", repr(words[at])) from None
        self._at = at
        with np.errstate(invalid="ignore"):  # a NaN is refused later, as an index
            indices = _numbers(values, element.name).astype(np.int64)
        return ({name: _numbers(column, element.name) for name, column in scalars.items()},
                (indices, np.array(sizes, np.int64)))


def _numbers(words: list[bytes], name: str) -> np.ndarray:
    try:
        return np.array(words, dtype=object).astype(np.float64)
    except ValueError as error:
        raise ShapeError("", f"has a {name} row with a word that is no number", str(error),
                         "write decimals with a point" if "," in str(error) else "") from None
