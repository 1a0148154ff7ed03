"""Materials of Wavefront's OBJ: laws of the names that `usemtl` has, from the libraries next to it.

Source: Wavefront, MTL material format 4.2.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ...brdf import Lambert
from .materials import FileMaterial, grey_of

# Bytes of a library, far more than any has: it is read whole.
_MAX_BYTES = 16 * 1024**2
# Statements, in lower case, that change nothing under one Sun and in grey, and values by which others change nothing.
_PASSED = ("kd", "ka", "map_ka", "ni", "illum", "sharpness")
_NOTHING = {**dict.fromkeys(("ks", "tr", "ke", "pm", "ps", "pc", "aniso"), 0.0), "d": 1.0, "tf": 1.0}
_COMMENT = re.compile(r"(?:^|\s)#(?:\s|$)")
# Diffuse colour of a material that names none [1]: that of the format's own viewers.
_USUAL = "0.8"
NO_MATERIAL = "without usemtl"
"""Name of the material of facets before the first `usemtl`, where others have one."""


def read_mtl(folder: Path, libraries: list[str], names: list[str]) -> tuple[FileMaterial, ...]:
    """Materials of some names, out of libraries in a folder; nothing outside it is opened.

    A material that no library has, or not rightly, is one without a law, which says why.
    """
    tables, faults = {}, []
    for library in (name for line in libraries for name in _names(folder, line)):
        try:
            tables = {**_tables(_text(folder, library)), **tables}
        except (OSError, ValueError) as error:
            faults.append(f"mtllib {library} {error.strerror if isinstance(error, OSError) else error}")
    made = []
    for name in names:
        if (table := tables.get(name)) is None:
            why = "; ".join(faults) or (f"no `newmtl` of this name in {', '.join(libraries)}" if libraries
                                        else "the OBJ has no mtllib")
            made.append(FileMaterial(name=name, fault=why))
            continue
        left_out = [word for key, (word, text) in table.items() if key not in _PASSED and not _is_nothing(key, text)]
        notes = [f"{', '.join(left_out)} left out; Kd alone is drawn, by Lambert's law"] if left_out else []
        notes += [] if "kd" in table else [f"without Kd it is drawn with {_USUAL}"]
        try:
            law = Lambert(normal_albedo=min(grey_of(_colour(table.get("kd", ("Kd", _USUAL))[1])), 1.0))
        except ValueError as error:
            made.append(FileMaterial(name=name, fault=str(error)))
        else:
            made.append(FileMaterial(name=name, law=law, notes=tuple(f"material {name}: {note}" for note in notes)))
    return tuple(made)


def _names(folder: Path, line: str) -> list[str]:
    """Names of libraries in a statement: of several, or of one with blanks."""
    return [line] if Path(line).name == line and (folder / line).is_file() else line.split()


def _text(folder: Path, library: str) -> str:
    library = library.removeprefix("./")
    path = folder / library
    if Path(library).name != library or library in (".", "..") or "\0" in library:
        raise ValueError("must be a bare name: a file in the OBJ's folder")
    # A link must not lead out.
    if path.exists() and path.resolve().parent != folder.resolve():
        raise ValueError("must be a file in the OBJ's folder")
    if not path.is_file():
        raise ValueError("is no file in the OBJ's folder")
    if path.stat().st_size > _MAX_BYTES:
        raise ValueError(f"must have at most {_MAX_BYTES} bytes")
    return path.read_bytes().decode("utf-8-sig", errors="replace")


def _tables(text: str) -> dict[str, dict[str, tuple[str, str]]]:
    """Statements, as they are written, by their lower case by the materials' names; the first of a name counts."""
    made: dict[str, dict[str, tuple[str, str]]] = {}
    table: dict[str, tuple[str, str]] = {}
    for line in text.splitlines():
        key, _, rest = line.replace("\t", " ").strip().partition(" ")
        if key.lower() == "newmtl":
            table = {}
            made.setdefault(name_of_material(rest), table)
        elif not key.startswith("#") and (rest := rest.partition("#")[0].strip()):
            table.setdefault(key.lower(), (key, rest))
    return made


def name_of_material(text: str) -> str:
    """The name in a statement, which may have blanks and `#` in it: a comment has a blank before and behind its `#`."""
    return _COMMENT.split(text, maxsplit=1)[0].strip()


def _colour(text: str) -> np.ndarray:
    """Linear red, green and blue (3,) of `Kd`: three numbers, or one for all."""
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) not in (1, 3) or not all(0.0 <= value <= 1.0 for value in values):
        raise ValueError(f"Kd must be three numbers, 0..1, got {text!r}")
    return np.broadcast_to(values, 3)


def _is_nothing(key: str, text: str) -> bool:
    try:
        return {float(word) for word in text.split()} == {_NOTHING.get(key)}
    except ValueError:
        return False
