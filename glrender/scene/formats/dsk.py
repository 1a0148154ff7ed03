"""SPICE's digital shape kernels (DSK) of type 2: triangular plates, in kilometres by definition. Needs spiceypy.
Source: NAIF, DSK Required Reading, N0067.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import ShapeError
from ..shape.files import FileMesh, facet_limit

# DAS files with DSK segments begin with it; a file that was copied as text does not.
_ID_WORD = b"DAS/DSK "
# Type of plates; bytes of a record; place of the first free record's number in SPICE's dashfs; rows read in a turn.
_PLATES, _RECORD_BYTES, _FREE, _ROWS = 2, 1024, 4, 1 << 17


class Dsk:
    """The reader of `.bds` and `.dsk`."""

    glrender_api = 1
    length_unit = "km"

    @staticmethod
    def read(path: Path, max_facets: int, surface: int | None = None) -> FileMesh:
        """The plates of a file's segments; of one surface, by SPICE's number of it, where the file has several."""
        with path.open("rb") as file:
            found = file.read(len(_ID_WORD))
        if found != _ID_WORD:
            raise ShapeError("", "is no DSK: it must begin with 'DAS/DSK'", found.decode("ascii", "replace"),
                             "a DSK is binary; text for transfer (.xdsk) becomes one by SPICE's tobin")
        try:
            import spiceypy as spice
        except ImportError:
            raise ShapeError("", "a DSK needs spiceypy, which is not installed",
                             hint="pip install \"glrender[spice]\"") from None
        with _opened(spice, path) as handle:
            n_records = spice.dashfs(handle)[_FREE] - 1
            if path.stat().st_size < n_records * _RECORD_BYTES:
                raise ShapeError("", "is cut off: its DSK needs more bytes", path.stat().st_size,
                                 f"copy it again, as binary, all {n_records * _RECORD_BYTES} bytes")
            segments = _segments(spice, handle)
            listed = " and ".join(map(str, surfaces := sorted({segment.surfce for _, segment in segments})))
            if surface is None and len(surfaces) > 1:
                raise ShapeError("surface", f"missing: the file has {listed}", hint=f"choose: surface = {surfaces[0]}")
            if surface is not None and surface not in surfaces:
                raise ShapeError("surface", f"must be one of {listed}, as the file has it", surface)
            chosen = [(place, segment) for place, segment in segments if surface in (None, segment.surfce)]
            if wrong := [segment.dtype for _, segment in chosen if segment.dtype != _PLATES]:
                raise ShapeError("", f"has a segment of type {wrong[0]}, and only type 2 (plates) is read", str(path),
                                 "SPICE's mkdsk makes plates of a shape")
            counts = [spice.dskz02(handle, place) for place, _ in chosen]
            facet_limit(sum(n_plates for _, n_plates in counts), max_facets)
            vertices, facets, n_before = [], [], 0
            for (place, _), (n_vertices, n_plates) in zip(chosen, counts, strict=True):
                vertices.append(_rows(spice.dskv02, handle, place, n_vertices))
                facets.append(_rows(spice.dskp02, handle, place, n_plates).astype(np.int64) + (n_before - 1))
                n_before += n_vertices
        return FileMesh(np.concatenate(vertices), np.concatenate(facets))


@contextlib.contextmanager
def _opened(spice: Any, path: Path) -> Iterator[int]:
    """The handle of a file that is opened on its own: SPICE's pool of kernels stays as it is."""
    handle = None
    try:
        handle = spice.dasopr(str(path))
        yield handle
    except spice.utils.exceptions.SpiceyError as error:
        spice.reset()
        raise ShapeError("", f"is no readable DSK: {str(getattr(error, 'short', '') or error).strip()}",
                         str(path), "it may be cut off; copy it again, as binary") from None
    finally:
        if handle is not None:
            spice.dascls(handle)


def _segments(spice: Any, handle: int) -> list[tuple[Any, Any]]:
    """Descriptors of a file's segments: where each is, and what it is."""
    found = []
    with contextlib.suppress(spice.utils.exceptions.NotFoundError):
        place = spice.dlabfs(handle)
        while True:
            found.append((place, spice.dskgd(handle, place)))
            place = spice.dlafns(handle, place)
    if found:
        return found
    raise ShapeError("", "is a DSK without segments", None)


def _rows(read: Any, handle: int, place: Any, count: int) -> np.ndarray:
    return np.concatenate([np.asarray(read(handle, place, first + 1, min(_ROWS, count - first)))
                           for first in range(0, count, _ROWS)])
