"""The framing of messages on a byte stream: `GLR1 | u16 n_parts | u16 flags | u32 size ... | parts`, little-endian."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from typing import Any

from glrender import ProtocolError

from .limits import MAX_HEADER_BYTES

MAGIC = b"GLR1"
MAX_PARTS = 16
_PREFIX = struct.Struct("<4sHH")


def framed(parts: Sequence[Any]) -> list[memoryview]:
    """The buffers to write, in order, of one message; the parts are not copied.

    Parameters
    ----------
    parts : sequence of bytes-like
        At most 16, each below 4 GiB.
    """
    views = [memoryview(part).cast("B") for part in parts]
    prefix = _PREFIX.pack(MAGIC, len(views), 0) + struct.pack(f"<{len(views)}I", *(len(view) for view in views))
    return [memoryview(prefix), *(view for view in views if len(view))]


class Decoder:
    """Collects the bytes of a stream and yields whole messages.

    After a `ProtocolError` the stream is lost: where the next message starts is not known.

    Parameters
    ----------
    max_bytes : int
        Largest sum of a message's parts.
    """

    def __init__(self, max_bytes: int = MAX_HEADER_BYTES):
        self._max_bytes, self._held = max_bytes, bytearray()

    @property
    def is_between_messages(self) -> bool:
        """Whether nothing of a next message has come yet."""
        return not self._held

    @property
    def has_message(self) -> bool:
        """Whether a whole message is here, or bytes that are no message."""
        try:
            size = self._message_size()
        except ProtocolError:
            return True
        return size is not None and len(self._held) >= size

    def feed(self, data: bytes) -> None:
        """Add bytes that came."""
        self._held += data

    def messages(self) -> Iterator[list[bytes]]:
        """Take the messages that are complete, one by one.

        Raises
        ------
        ProtocolError
            A message is not framed as above, or larger than allowed: known before its parts are here.
        """
        while self._held and (size := self._message_size()) is not None and len(self._held) >= size:
            sizes = self._part_sizes()
            start, parts = _PREFIX.size + 4 * len(sizes), []
            # One copy of each: a scene has hundreds of megabytes.
            with memoryview(self._held) as held:
                for length in sizes:
                    parts.append(bytes(held[start:start + length]))
                    start += length
            del self._held[:start]
            yield parts

    def _message_size(self) -> int | None:
        """Bytes of the message being collected, or None while its prefix is not complete."""
        held = self._held
        if held[:4] != MAGIC[:len(held)]:
            raise ProtocolError("", "a message on TCP must begin with GLR1", bytes(held[:4]))
        if len(held) < _PREFIX.size:
            return None
        _, n_parts, flags = _PREFIX.unpack_from(held)
        if not 1 <= n_parts <= MAX_PARTS:
            raise ProtocolError("", f"a message must have 1 to {MAX_PARTS} parts", n_parts)
        if flags:
            raise ProtocolError("", "the flags of a message must be 0", flags)
        if len(held) < _PREFIX.size + 4 * n_parts:
            return None
        total = sum(self._part_sizes())
        if total > self._max_bytes:
            raise ProtocolError("", f"a message must not exceed {self._max_bytes} bytes", total)
        return _PREFIX.size + 4 * n_parts + total

    def _part_sizes(self) -> tuple[int, ...]:
        _, n_parts, _ = _PREFIX.unpack_from(self._held)
        return struct.unpack_from(f"<{n_parts}I", self._held, _PREFIX.size)
