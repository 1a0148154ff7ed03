"""The four fields that every request has, and those that every reply repeats."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from glrender import ProtocolError
from glrender_camera.validate import integer, one_of

from . import codec

ENVELOPE = ("v", "op", "id", "client")


def checked_envelope(header: Mapping[str, Any], operations: Iterable[str]) -> str:
    """The client's name, after the four fields that every request has."""
    for key in ENVELOPE:
        if key not in header:
            raise ProtocolError(key, "missing")
        if isinstance(header[key], list | dict):
            raise ProtocolError(key, "must be one value, no list or map")
    if isinstance(header["v"], bool) or header["v"] != codec.VERSION:
        raise ProtocolError("v", f"this server speaks version {codec.VERSION}", header["v"])
    integer("id", header["id"], 0, 2**64 - 1)
    if not isinstance(header["client"], str) or not 0 < len(header["client"]) <= 128:
        raise ProtocolError("client", "must be a name of 1 to 128 characters", header["client"])
    one_of("op", header["op"], operations)
    return header["client"]


def echo(header: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of its request that every reply repeats."""
    # A float with a whole value counts (MATLAB); it is answered as an integer.
    number = header.get("id")
    is_number = isinstance(number, int | float) and 0 <= number < 2**64 and number == int(number)
    op, client = header.get("op"), header.get("client")
    return {"v": codec.VERSION, "op": op if isinstance(op, str) and len(op) <= 128 else "",
            "id": int(number) if is_number else 0,
            "client": client if isinstance(client, str) and len(client) <= 128 else ""}


def refusal(header: Mapping[str, Any], code: str, path: str, message: str, **more: Any) -> list[Any]:
    """The reply with an error; `more` stands in that."""
    return codec.pack({**echo(header), "ok": False, "error": {"code": code, "path": path, "message": message, **more}})
