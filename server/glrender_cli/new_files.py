"""New files to start from: scenes, and whole scenarios with the files that they name."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from glrender import ConfigError

EXAMPLE = "itokawa.obj"
"""Itokawa of 12,288 facets, in km; R. Gaskell, NASA PDS, CC0."""
SCENARIOS = {
    "csv": ("states.csv",),
    "spice": ("naif0012.tls", "itokawa_gaskell_n3.tpc", "amica31.ti", "hayabusa.tsc", "hayabusa.bsp", "hayabusa.bc"),
    "oem": ("hayabusa.oem", "hayabusa.aem"),
    "isd": ("st_2458542208.json",),
    "encounter": (), "hover": (), "dataset": ()}
"""Kinds of scenarios, and the files that each names besides the shape."""
_PLACES = (resources.files("glrender") / "data", resources.files("glrender_cli") / "cookbook")


def scenario_text(kind: str, file: Path) -> str:
    """The text of a scenario of a kind out of `SCENARIOS`, for a file of that name."""
    return _content(f"{kind}.toml").decode().replace("{file}", file.name)


def write_new(file: Path, text: str, others: tuple[str, ...] = ()) -> None:
    """Write a text and the files that it names, in its folder; no file that is there is replaced.

    Parameters
    ----------
    file : path
    text : str
    others : tuple of str
        Names of files of the package. One that is there already must be the same.

    Raises
    ------
    ConfigError
        A file is there.
    """
    there = [name for name in others if (file.parent / name).exists()]
    for name in there:
        if (file.parent / name).read_bytes() != _content(name):
            raise ConfigError(str(file.parent / name), "is there already, and is another file",
                              hint="choose another folder, or remove it")
    try:
        with file.open("x", encoding="utf-8") as opened:
            opened.write(text)
    except FileExistsError:
        raise ConfigError("--out", "is there already", str(file), "choose another name, or remove it") from None
    for name in set(others) - set(there):
        (file.parent / name).write_bytes(_content(name))


def _content(name: str) -> bytes:
    return next(place / name for place in _PLACES if (place / name).is_file()).read_bytes()
