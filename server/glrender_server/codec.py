"""Headers of messages, in msgpack, as `docs/protocol.md` writes them down."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import msgpack
import numpy as np
from glrender import ProtocolError

from .limits import MAX_DEPTH, MAX_FIELDS, MAX_HEADER_BYTES, MAX_VALUES

VERSION = 1
MINOR_VERSION = 4
"""Counts additions to the protocol: fields that a client may do without."""
_FIRST = ("v", "op", "id", "client", "ok")


# First bytes of MessagePack's maps, texts, and lists and maps (its specification, formats).
_MAPS = frozenset((*range(0x80, 0x90), 0xDE, 0xDF))
_TEXTS = frozenset((*range(0xA0, 0xC0), 0xD9, 0xDA, 0xDB))
_CONTAINERS = _MAPS | frozenset((*range(0x90, 0xA0), 0xDC, 0xDD))
_READ_BYTES = 4096


def pack(header: Mapping[str, Any]) -> list[bytes]:
    """The one part of a message of plain data, which has no arrays unless the header describes some."""
    # Fields needed to read the parts come first, so that a slow interpreter may leave the rest unread.
    first = {name: header[name] for name in _FIRST if name in header}
    return [msgpack.packb({**first, "arrays": [], **header}, default=_plain)]


def with_field(packed: bytes, name: str, value: Any) -> bytes:
    """A packed map with one more pair, its first, and the others untouched."""
    first = packed[0]
    count, start = (first & 15, 1) if first < 0x90 else (int.from_bytes(packed[1:3], "big"), 3)
    pair = msgpack.packb(name) + msgpack.packb(value)
    return b"".join([b"\xde", (count + 1).to_bytes(2, "big"), pair, packed[start:]])


def unpack_envelope(parts: Sequence[bytes]) -> dict[str, Any]:
    """The top of a request's header: its plain values, and an empty list in the place of each list or map.

    The contents of lists and maps are passed over, unread: decoding them is the reader's cost.

    Raises
    ------
    ProtocolError
        No map in msgpack, too long, more than `MAX_FIELDS` fields, or a field given twice.
    """
    message = _header_of(parts)
    if not _is_in(_MAPS, message, 0):
        raise ProtocolError("", "the header must be a map with text keys")
    unpacker = msgpack.Unpacker(read_size=_READ_BYTES, max_buffer_size=MAX_HEADER_BYTES, max_ext_len=0)
    fields: dict[str, Any] = {}
    try:
        unpacker.feed(message)
        n_fields = unpacker.read_map_header()
        if n_fields > MAX_FIELDS:
            raise ProtocolError("", f"a header must have at most {MAX_FIELDS} fields", n_fields)
        for _ in range(n_fields):
            if not _is_in(_TEXTS, message, unpacker.tell()):
                raise ProtocolError("", "the header must be a map with text keys")
            name = unpacker.unpack()
            if name in fields:
                raise ProtocolError("", "a key must not be given twice in one map")
            if _is_in(_CONTAINERS, message, unpacker.tell()):
                unpacker.skip()
                fields[name] = []
            else:
                fields[name] = unpacker.unpack()
    except ProtocolError:
        raise
    except Exception as error:  # msgpack raises a dozen kinds on hostile bytes
        raise ProtocolError("", f"the header is not msgpack: {type(error).__name__}") from None
    if unpacker.tell() != len(message):
        raise ProtocolError("", "the header is not msgpack: bytes are left behind it")
    return fields


def _is_in(kinds: frozenset[int], message: bytes, place: int) -> bool:
    return place < len(message) and message[place] in kinds


def _header_of(parts: Sequence[bytes]) -> bytes:
    if len(parts) != 1:
        raise ProtocolError("", "a request must have one part, the header", len(parts))
    if len(parts[0]) > MAX_HEADER_BYTES:
        raise ProtocolError("", f"a header must not exceed {MAX_HEADER_BYTES} bytes", len(parts[0]))
    return parts[0]


def unpack_request(parts: Sequence[bytes]) -> dict[str, Any]:
    """The header of a request; requests carry no pixels.

    Raises
    ------
    ProtocolError
        No map in msgpack, too long, too many values, too deep, or a key given twice.
    """
    message, n_values = _header_of(parts), 0

    def counted(entries: list[Any]) -> list[Any]:
        nonlocal n_values
        n_values += len(entries)
        if n_values > MAX_VALUES:
            raise ProtocolError("", f"a header must have at most {MAX_VALUES} values")
        return entries

    def table(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        made = dict(counted(pairs))
        if len(made) != len(pairs):
            raise ProtocolError("", "a key must not be given twice in one map")
        return made

    try:
        header = msgpack.unpackb(message, max_ext_len=0, max_array_len=MAX_VALUES, max_map_len=MAX_VALUES,
                                 list_hook=counted, object_pairs_hook=table)
    except ProtocolError:
        raise
    except Exception as error:  # msgpack raises a dozen kinds on hostile bytes
        raise ProtocolError("", f"the header is not msgpack: {type(error).__name__}") from None
    if not isinstance(header, dict) or not all(isinstance(key, str) for key in header):
        raise ProtocolError("", "the header must be a map with text keys")
    _check_depth(header)
    return header


def _check_depth(header: dict[str, Any]) -> None:
    level: list[Any] = [header]
    for _ in range(MAX_DEPTH):
        level = [entry for container in level for entry in (
            container.values() if type(container) is dict else container) if type(entry) in (dict, list)]
        if not level:
            return
    raise ProtocolError("", f"lists and maps must not be deeper than {MAX_DEPTH} in each other")


def _plain(value: object) -> object:
    """NumPy scalars and arrays as plain data."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no place in a header")
