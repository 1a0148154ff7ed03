"""A reader of protobuf's wire format: the fields that a schema names, all others skipped, every size bounded.

Source: protobuf.dev, "Encoding" (varints, length-prefixed records, packed repeated fields).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any, NamedTuple

from glrender import ProtocolError

from .limits import MAX_FIELDS

_VARINT, _FIXED64, _RECORD, _FIXED32 = 0, 1, 2, 5
_MAX_VARINT_BYTES, _CHARACTER_BYTES = 10, 4
_LISTS = ("ints", "doubles")


class Many(NamedTuple):
    """A list of messages, or of texts, and its largest length."""

    kind: Any
    most: int


class Text(NamedTuple):
    """A text, and the most characters that it may have."""

    most: int


Schema = Mapping[int, tuple[str, Any]]
"""Field number -> its name, and its kind: "int", "double", "ints", "doubles", a `Text`, a schema for a message, `Many`
of a schema or a text. Depth is the schema's: nothing else is looked into."""


def read(data: bytes, schema: Schema) -> dict[str, Any]:
    """The fields of one message.

    Parameters
    ----------
    data : bytes
    schema : Schema

    Returns
    -------
    dict of str to value
        Fields that were sent, and lists, empty if nothing was sent for them. The last value of a field counts.

    Raises
    ------
    ProtocolError
        Truncated, a wrong type, text that is not UTF-8 or too long, a list that is too long, or more than `MAX_FIELDS`
        fields in all.
    """
    return _Reader(memoryview(data)).message(0, len(data), schema)


def varint(data: Any, at: int, end: int) -> tuple[int, int]:
    """An unsigned number of at most 64 bits, and the place behind it.

    Raises
    ------
    ProtocolError
    """
    number = 0
    for place in range(at, min(end, at + _MAX_VARINT_BYTES)):
        byte = data[place]
        number |= (byte & 0x7F) << 7 * (place - at)
        if byte < 0x80:
            return number & 0xFFFF_FFFF_FFFF_FFFF, place + 1
    raise ProtocolError("", f"byte {at}: a number of at most {_MAX_VARINT_BYTES} bytes is cut off or too long")


class _Reader:
    """One message's bytes, and how many fields have been read."""

    def __init__(self, data: memoryview):
        self._data, self._n_fields = data, 0

    def message(self, at: int, end: int, schema: Schema) -> dict[str, Any]:
        found = {name: [] for name, kind in schema.values() if isinstance(kind, Many) or kind in _LISTS}
        while at < end:
            self._count(1)
            tag, at = varint(self._data, at, end)
            wire, start = tag & 7, at
            if wire == _VARINT:
                value, at = varint(self._data, at, end)
            elif wire == _RECORD:
                length, start = varint(self._data, at, end)
                at = start + length
            elif wire in (_FIXED64, _FIXED32):
                at += 8 if wire == _FIXED64 else 4
            else:
                raise ProtocolError("", f"byte {at}: no message of Basilisk's has wire type {wire}", tag)
            if at > end:
                raise ProtocolError("", f"byte {start}: a field ends {at - end} bytes behind its message")
            name, kind = schema.get(tag >> 3, ("", None))
            if kind is not None:
                self._put(found, name, kind, wire, value if wire == _VARINT else 0, start, at)
        return found

    def _put(self, found: dict[str, Any], name: str, kind: Any, wire: int, value: int, start: int, end: int) -> None:
        is_list = isinstance(kind, Many)
        if is_list:
            if len(found[name]) >= kind.most:
                raise ProtocolError(name, f"must be at most {kind.most}", kind.most + 1)
            kind = kind.kind
        if kind in ("int", "ints") and wire == _VARINT:
            self._set(found, name, kind == "ints", value - (value >> 63 << 64))
        elif kind in ("double", "doubles") and wire == _FIXED64:
            self._set(found, name, kind == "doubles", struct.unpack_from("<d", self._data, start)[0])
        elif isinstance(kind, Text) and wire == _RECORD:
            self._set(found, name, is_list, self._text(name, start, end, kind.most))
        elif isinstance(kind, Mapping) and wire == _RECORD:
            self._set(found, name, is_list, self.message(start, end, kind))
        elif kind == "doubles" and wire == _RECORD and (end - start) % 8 == 0:
            self._count((end - start) // 8)
            found[name].extend(struct.unpack_from(f"<{(end - start) // 8}d", self._data, start))
        elif kind == "ints" and wire == _RECORD:
            while start < end:
                self._count(1)
                value, start = varint(self._data, start, end)
                found[name].append(value - (value >> 63 << 64))
        else:
            what = kind if isinstance(kind, str) else "text" if isinstance(kind, Text) else "a message"
            raise ProtocolError(name, f"must be {what}, has wire type", wire)

    def _text(self, name: str, start: int, end: int, most: int) -> str:
        # A character has four bytes at most: a longer field need not be decoded to be refused.
        if end - start > _CHARACTER_BYTES * most:
            raise ProtocolError(name, f"must have at most {most} characters", f"{end - start} bytes")
        try:
            text = str(self._data[start:end], "utf-8")
        except UnicodeDecodeError:
            raise ProtocolError(name, "must be UTF-8", bytes(self._data[start:end][:32])) from None
        if len(text) > most:
            raise ProtocolError(name, f"must have at most {most} characters", len(text))
        return text

    def _count(self, n: int) -> None:
        self._n_fields += n
        if self._n_fields > MAX_FIELDS:
            raise ProtocolError("", f"a message must have at most {MAX_FIELDS} fields")

    @staticmethod
    def _set(found: dict[str, Any], name: str, is_list: bool, value: Any) -> None:
        if is_list:
            found[name].append(value)
        else:
            found[name] = value
