"""The page of conventions, and shapes that show whether a frame keeps to it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "conventions.md").read_text(encoding="utf-8")
# A marker 100 m along the body's x.
R_MARKER_M = np.array([[100.0, 0, 0], [104, 0, 0], [100, 4, 0], [100, 0, 4]])
FACETS = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
# On a square of 2 by 2, its tip away from what comes along +Z.
PYRAMID = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [0, 0, 1]])
PYRAMID_FACETS = np.array([[0, 2, 1], [0, 3, 2], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])


def blocks(page):
    """(heading, text) of every paragraph, item and row of a table; a table's head is none."""
    for section in re.split(r"(?m)^#+ ", page)[1:]:
        heading, _, text = section.partition("\n")
        for part in re.split(r"\n\s*\n", text.strip()):
            if part.startswith("|"):
                yield from ((heading, row.strip("| ")) for row in part.splitlines()[2:])
            else:
                yield from ((heading, item) for item in re.split(r"(?m)^- ", part) if item)
