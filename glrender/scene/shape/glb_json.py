"""Checks of a binary glTF's JSON: what a file says is a list, an object or a number is one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ...base.errors import ShapeError

_KINDS = {dict: "objects", int: "numbers of nodes"}


def listed(table: dict, key: str, kind: type | None = dict) -> list[Any]:
    """A list, empty if it is not there: of objects, of numbers, or of anything where no kind is given."""
    found = table.get(key, [])
    if not isinstance(found, list):
        raise ShapeError("", f"is no binary glTF: {key} must be a list")
    if kind is not None and not all(type(each) is kind for each in found):
        raise ShapeError("", f"is no binary glTF: {key} must be {_KINDS[kind]}")
    return found


def entry_at(entries: Sequence[Any], index: object, what: str, hint: str = "") -> Any:
    """The entry of a number that the file gives."""
    if type(index) is not int or not 0 <= index < len(entries):
        raise ShapeError(what, f"must be a number below {len(entries)}", index, hint)
    return entries[index]


def whole(table: dict, key: str) -> int:
    """A whole number, 0 if it is not there."""
    value = table.get(key, 0)
    if type(value) is not int or value < 0:
        raise ShapeError(key, "must be a whole number", value)
    return value


def table_in(table: dict, key: str) -> dict[str, Any]:
    """An object, empty if it is not there."""
    value = table.get(key, {})
    if not isinstance(value, dict):
        raise ShapeError(key, "must be an object", value)
    return value


def extension(table: dict, name: str) -> dict[str, Any]:
    """What an extension says of an object."""
    return table_in(table_in(table, "extensions"), name)
