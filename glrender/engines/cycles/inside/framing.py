"""Messages between glrender and Blender's process: a JSON head and arrays, framed; nothing that can be executed.

    "GLRC" | u32 size of the head | the head | the arrays' bytes, one behind the other

in little-endian. The head's `arrays` names each array with its dtype and shape. This file is read by both
sides, by Blender's Python too: it imports nothing of glrender.
"""

from __future__ import annotations

import json
import socket
import struct

import numpy as np

MAGIC = b"GLRC"
_MAX_HEAD_BYTES = 1 << 24
_MAX_ARRAY_BYTES = 1 << 34


class FramingError(Exception):
    """The bytes that arrived are no message."""


def send(link: socket.socket, head: dict, arrays: dict | None = None) -> None:
    """Send one message.

    Parameters
    ----------
    link : socket
        Connected stream.
    head : dict
        JSON's types; `arrays` is taken.
    arrays : dict of str to ndarray
    """
    named = {name: np.ascontiguousarray(array) for name, array in (arrays or {}).items()}
    described = [{"name": name, "dtype": array.dtype.newbyteorder("<").str, "shape": list(array.shape)}
                 for name, array in named.items()]
    text = json.dumps({**head, "arrays": described}, allow_nan=False).encode()
    link.sendall(MAGIC + struct.pack("<I", len(text)) + text)
    for array in named.values():
        link.sendall(array.astype(array.dtype.newbyteorder("<"), copy=False).reshape(-1).view(np.uint8))


def receive(link: socket.socket) -> tuple[dict, dict]:
    """Receive one message: its head and its arrays.

    Raises
    ------
    EOFError
        The other side hung up.
    FramingError
        Bytes that are no message.
    TimeoutError
        The socket's.
    """
    start = _exactly(link, 8)
    (size,) = struct.unpack("<I", start[4:])
    if bytes(start[:4]) != MAGIC or size > _MAX_HEAD_BYTES:
        raise FramingError(f"no message starts with {bytes(start)!r}")
    head = json.loads(bytes(_exactly(link, size)))
    arrays = {}
    for told in head.pop("arrays"):
        dtype, shape = np.dtype(told["dtype"]), tuple(told["shape"])
        n_bytes = dtype.itemsize * int(np.prod(shape, dtype=np.int64))
        if dtype.hasobject or not 0 <= n_bytes <= _MAX_ARRAY_BYTES:
            raise FramingError(f"array {told['name']!r} cannot be of {told['dtype']} and {told['shape']}")
        arrays[told["name"]] = np.frombuffer(_exactly(link, n_bytes), dtype).reshape(shape)
    return head, arrays


def _exactly(link: socket.socket, n_bytes: int) -> bytearray:
    got = bytearray(n_bytes)
    rest = memoryview(got)
    while rest:
        count = link.recv_into(rest)
        if not count:
            raise EOFError("the other side hung up")
        rest = rest[count:]
    return got
