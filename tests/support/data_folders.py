"""Data of tests: the project's own under tests/data, and real shapes and images of ../shared/data."""

from __future__ import annotations

from pathlib import Path

import glrender
import pytest

ITOKAWA = Path(glrender.__file__).parent / "data" / "itokawa.obj"
"""Itokawa of 12,288 facets, in km, as the wheel has it."""

class DataFolders:
    """A folder that may lie in several places: of two files of one name the first place's counts.

    Parameters
    ----------
    *places : path
        The first is the project's own.
    """

    def __init__(self, *places: Path):
        self._places = places

    def __truediv__(self, name: str | Path) -> Path | DataFolders:
        """The file of that name, or the folder; a test that needs one which is nowhere is skipped loudly."""
        wanted = [place / name for place in self._places]
        there = [path for path in wanted if path.exists()]
        if not there:
            pytest.skip(f"SKIPPED FOR WANT OF DATA: {wanted[-1]} is not there; set GLRENDER_SHARED")
        return there[0] if there[0].is_file() or there[0] == wanted[-1] else DataFolders(*wanted)
