"""Reader of STL files, text and binary, as programs write them."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ...base.errors import ShapeError

# Bytes of a binary file before its facets, and of each facet: normal, corners, a word for anything.
_HEAD, _FACET = 84, 50
_ROW = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("word", "<u2")])
# Bytes in which a text file's first facet is looked for.
_LOOKED_AT = 1 << 20
_MARK = re.compile(r"\b(?:outer\s+(?P<begin>loop)|end\s*loop)\b", re.IGNORECASE)
# A solid's name may hold any word of STL's own: it ends where a facet begins.
_NAME = re.compile(r"\b(?:end\s*)?solid\b.*?(?=\bfacet\s+normal\b|\Z)", re.IGNORECASE | re.DOTALL)


def read_stl(path: Path) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Corners (N, 3) float64, facet by facet, corners of each facet (F,) int, and warnings.

    Raises
    ------
    ShapeError
    """
    data = path.read_bytes()
    count = int.from_bytes(data[80:_HEAD], "little")
    size = _HEAD + _FACET * count
    is_binary = len(data) >= _HEAD and len(data) == size
    if not is_binary and re.search(rb"(?i)\bouter\s+loop\s+vertex\b", data[:_LOOKED_AT]):
        return _text(data.decode("latin-1"))
    if not is_binary and not (count and len(data) > size):
        raise ShapeError("", f"is neither text nor binary STL: {len(data)} bytes do not fit a count of facets", count,
                         f"a binary file of as many has {size} bytes")
    corners = np.frombuffer(data, _ROW, count, _HEAD)["corners"].reshape(-1, 3).astype(np.float64)
    behind = len(data) - size
    warnings = (f"{behind} bytes behind the last of {count} facets were left out: if facets are missing, the file's "
                f"count is wrong",) if behind else ()
    return corners, np.full(count, 3), warnings


def _text(text: str) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    text = _NAME.sub(" ", text)
    # Mark by mark: a pattern of both would look for each loop's end through the whole rest of a file that lacks them.
    loops, begun, start = [], 0, None
    for mark in _MARK.finditer(text):
        if mark["begin"]:
            begun, start = begun + 1, mark.end() if start is None else start
        elif start is not None:
            loops.append(text[start:mark.start()].split())
            start = None
    if begun != len(loops):
        raise ShapeError("", "ends, or begins anew, within a facet: outer loops and endloops differ in number",
                         (begun, len(loops)))
    for number, loop in enumerate(loops):
        if len(loop) < 12 or len(loop) % 4 or any(word.lower() != "vertex" for word in loop[::4]):
            raise ShapeError(f"facets[{number}]", "must be three or more of `vertex x y z`", " ".join(loop)[:100])
    words = [word for loop in loops for word in loop]
    try:
        numbers = np.array([words[k::4] for k in (1, 2, 3)], dtype=object).astype(np.float64).T
    except ValueError as error:
        raise ShapeError("", "has a vertex that is no number", str(error),
                         "write decimals with a point" if "," in str(error) else "") from None
    return numbers, np.array([len(loop) // 4 for loop in loops], int), ()
