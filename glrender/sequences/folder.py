"""Folders of frames: whose they are, and files that are whole or not there."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..base.errors import ConfigError

MANIFEST = "manifest.json"


def made(folder: Path, field: str = "--out", named: Path | None = None) -> None:
    """Make a folder; errors name the field, and another folder if this is in one that was asked for.

    Raises
    ------
    ConfigError
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError):
        raise ConfigError(field, "must be a folder, or not be there yet", str(named or folder),
                          "name another") from None
    except OSError as error:
        raise ConfigError(field, f"must be a folder that can be written to ({error.strerror})", str(named or folder),
                          "name another") from None


def claim_folder(folder: Path, ours: Mapping[str, Any]) -> None:
    """Write the manifest of a folder, made if it is missing, or find the same entries in the one that is there.

    Raises
    ------
    ConfigError
        The folder has the manifest of others.
    """
    made(folder, "out")
    file = folder / MANIFEST
    try:
        theirs = json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        write_whole(file, json.dumps(ours, indent=1).encode())
        return
    except ValueError:
        theirs = {}
    # As JSON has them: tuples are lists there.
    if differing := _differing(json.loads(json.dumps(ours)), theirs):
        raise ConfigError("out", f"holds the frames of another sequence: {', '.join(differing)} differ",
                          str(folder), "choose another folder, or remove this one")


def manifest_of(folder: Path) -> dict[str, Any]:
    """The manifest of a folder that has one."""
    return json.loads((folder / MANIFEST).read_text(encoding="utf-8"))


def _differing(ours: Mapping[str, Any], theirs: Any) -> list[str]:
    """Names of our entries that theirs differ from, with those of the tables in them."""
    found, theirs = [], theirs if isinstance(theirs, dict) else {}
    for name, value in ours.items():
        other = theirs.get(name, ...)
        if isinstance(value, dict) and isinstance(other, dict):
            found += [f"{name}.{key}" for key in {**value, **other} if value.get(key, ...) != other.get(key, ...)]
        elif value != other:
            found.append(name)
    return found


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A path to write a file to, which takes its place when the block ends.

    A process that is killed meanwhile leaves no such file; one that fails, as where the disk is full, leaves none.

    Raises
    ------
    OSError
        With the file's name, which libraries leave out.
    """
    apart = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        yield apart
        os.replace(apart, path)
    except BaseException as error:
        apart.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise OSError(error.errno, error.strerror or str(error), str(path)) from error
        raise


def write_whole(path: Path, content: bytes) -> None:
    """Write a file; a process that is killed meanwhile, or a disk that is full, leaves no such file."""
    with whole(path) as apart:
        apart.write_bytes(content)
