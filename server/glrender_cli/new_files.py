"""New files to start from: a text, and the files of the wheel that it names."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from glrender import ConfigError

EXAMPLE = "itokawa.obj"
"""Itokawa of 12,288 facets, in km; R. Gaskell, NASA PDS, CC0."""
_DATA = resources.files("glrender") / "data"


def write_new(file: Path, text: str, others: tuple[str, ...] = ()) -> None:
    """Write a text and the files of the wheel that it names, in its folder; no file that is there is replaced.

    Parameters
    ----------
    file : path
    text : str
    others : tuple of str
        Names of files in `glrender/data`. One that is there already must be the same.

    Raises
    ------
    ConfigError
        A file is there.
    """
    there = [name for name in others if (file.parent / name).exists()]
    for name in there:
        if (file.parent / name).read_bytes() != (_DATA / name).read_bytes():
            raise ConfigError(str(file.parent / name), "is there already, and is another file",
                              hint="choose another folder, or remove it")
    try:
        with file.open("x", encoding="utf-8") as opened:
            opened.write(text)
    except FileExistsError:
        raise ConfigError("--out", "is there already", str(file), "choose another name, or remove it") from None
    for name in set(others) - set(there):
        (file.parent / name).write_bytes((_DATA / name).read_bytes())
