"""`glrender fields`: the fields of a table of scene and scenario files, with type, unit, range and default."""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

from glrender import ConfigError
from glrender_camera.validate import did_you_mean

# A wheel has the page; an editable install reads the repository's.
_PAGES = (Path(__file__).parents[1] / "scene_files.md",
          Path(__file__).parents[3] / "docs" / "reference" / "scene_files.md")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `glrender fields`."""
    parser.add_argument("table", nargs="?", metavar="TABLE",
                        help="cameras.model.detector, trajectory.csv, bodies.brdf.hapke, with a field behind it or "
                             "without; default: the names of all tables")


def run(arguments: argparse.Namespace) -> int:
    """Print tables or a field, or the names of all tables."""
    tables = _tables()
    if arguments.table is None:
        sys.stdout.writelines(f"{name}\n" for name in tables)
        return 0
    found = found_in(tables, arguments.table)
    if not found:
        raise ConfigError("TABLE", "is no table or field of a scene or scenario file", arguments.table,
                          did_you_mean(arguments.table, tables) or "`glrender fields` lists all")
    for name, rows in found.items():
        sys.stdout.write(f"{name}\n")
        sys.stdout.writelines(f"  {field}: {', '.join(filter(None, (kind, _told(default))))}\n"
                              f"{f'      {text}' + chr(10) if text else ''}" for field, kind, default, text in rows)
    return 0


Rows = list[tuple[str, ...]]
"""Field, type, default and meaning."""


def found_in(tables: dict[str, Rows], asked: str) -> dict[str, Rows]:
    """The tables of a name, as `bodies.spin`, also with their choice, as `bodies.brdf.hapke`; or those with a field.

    A path may be as messages and files write it, `cameras[0].model` or `[[cameras]]`; a field alone is looked for in
    all tables where the file itself has none.
    """
    asked = re.sub(r"\[\d*\]|[\[\]\s]", "", asked)
    found = {name: rows for name, rows in tables.items() if asked in _names(name)}
    if found:
        return found
    table, _, field = asked.rpartition(".")
    own = {name: [row for row in rows if row[0] == field] for name, rows in tables.items()}
    own = {name: rows for name, rows in own.items() if rows}
    if not table and "the file" not in own:
        return own
    return {name: rows for name, rows in own.items() if (table or "the file") in _names(name)}


def _names(name: str) -> set[str]:
    """What a table may be asked for by: its whole name, its path, and its path with its choice."""
    path, _, choice = name.partition(", ")
    quoted = re.search(r'"(\w+)"', choice)
    return {name, path, f"{path}.{quoted[1]}" if quoted else path}


def _tables() -> dict[str, Rows]:
    page = next(path for path in _PAGES if path.is_file()).read_text(encoding="utf-8")
    found: dict[str, Rows] = {}
    for part in re.split(r"^### ", page, flags=re.M)[1:]:
        name, _, text = part.partition("\n")
        rows = [line for line in text.splitlines() if line.startswith("| `")]
        found[name] = [tuple(map(_plain, re.split(r"(?<!\\)\|", row)[1:5])) for row in rows]
    return found


def _plain(cell: str) -> str:
    """A cell of Markdown without links and escapes; of code alone without its quotes."""
    cell = re.sub(r"\[([^\]]+)\]\([^)]*\)", r"\1", cell.strip()).replace("&lt;", "<")
    return re.sub(r"^`([^`]*)`$", r"\1", re.sub(r"\\([*|])", r"\1", cell))


def _told(default: str) -> str:
    return default if default in ("", "required") else f"default {default}"
