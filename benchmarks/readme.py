"""Fills the figures of README.md in from the pages of results: `python benchmarks/readme.py`.

RESULTS.md and SERVICE.md have the last run of each benchmark; README.md repeats some of their numbers, rounded.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent
# Columns of the chart's table that README.md has, by their `max_error`.
_TOLERANCES = ("0.1", "0.05", "0.02", "0.01")
# Rows of README.md's table, and the rows of the chart's that they repeat.
_ROWS = {"Itokawa, 49k facets": "middle 500 px, 49k", "786k rough facets": "middle 500 px, 786k",
         "3.1 million rough facets": "middle 500 px, 3.1M"}


def cells(page: str, row: str, below: str = "") -> dict[str, str]:
    """Cells of the first row of that name after a heading, by the names of their columns.

    Raises
    ------
    LookupError
        The page has no such row.
    """
    table: list[list[str]] = []
    for line in page[page.index(below):].splitlines():
        table = [*table, [cell.strip() for cell in line.strip("|").split("|")]] if line.startswith("|") else []
        if table and table[-1][0].strip("`") == row:
            return dict(zip(table[0], table[-1], strict=True))
    raise LookupError(f"no row {row!r} below {below!r}")


def figures(results: str, service: str) -> Iterator[tuple[str, list[str]]]:
    """Sentences of README.md, `#` for each of their figures, and the figures."""
    def milliseconds(row: str, *tolerances: str) -> list[str]:
        return [f"{float(cells(results, row)[tolerance].split(',')[0]):.0f}" for tolerance in tolerances]

    yield "takes # ms at an RMS error of 5 % and # ms at 1 %", milliseconds("middle 500 px, 49k", "0.05", "0.01")
    yield "the Sun's disc # and # ms", milliseconds("Hapke, Sun's disc, 49k", "0.05", "0.01")
    for name, row in _ROWS.items():
        yield f"| {name} | # | # | # | # |", milliseconds(row, *_TOLERANCES)
    megabyte = cells(service, "python tcp")["1024² uint8, 1 MiB"]
    yield "the service some # ms", [f"{float(megabyte.split()[0]):.0f}"]
    rates = [cells(results, row, "## On a GPU")["frames/s"].split(",")[0] for row in ("3,145,728", "49,152")]
    yield "draws # (3.1 million facets) to # frames/s", rates
    heldout = cells(results, "all", "### Random scenes")
    yield "Of # random scenes # % kept", [heldout["number"], heldout["RMS ≤ `max_error`"].removesuffix(" %")]
    week = cells(results, "mission_week.py")["figures"]
    yield "takes # minutes through the server", [f"{int(week.split()[0]) / 60:.1f}"]


def filled(readme: str, results: str, service: str) -> str:
    """README.md with the figures of the results.

    Raises
    ------
    LookupError
        A sentence, or a row of the results, is not there.
    """
    for sentence, values in figures(results, service):
        pattern = re.escape(sentence).replace(r"\ ", r"\s+").replace(r"\#", r"([\d.]+)")
        if (found := re.search(pattern, readme)) is None:
            raise LookupError(f"README.md does not have {sentence!r}")
        for group in range(len(values), 0, -1):
            readme = readme[:found.start(group)] + values[group - 1] + readme[found.end(group):]
    return readme


def pages() -> tuple[str, str, str]:
    """README.md, and the pages of the results."""
    names = ("README.md", "benchmarks/RESULTS.md", "benchmarks/SERVICE.md")
    readme, results, service = ((ROOT / name).read_text(encoding="utf-8") for name in names)
    return readme, results, service


if __name__ == "__main__":
    (ROOT / "README.md").write_text(filled(*pages()), encoding="utf-8")
