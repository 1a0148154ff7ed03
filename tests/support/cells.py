"""Sweeps of which a few cells run by default, and all of them by `make test-all`."""

from __future__ import annotations

from collections.abc import Iterable

import pytest


def slow_but(cells: Iterable, *fast: int, are_values: bool = False) -> list:
    """Cells for `pytest.mark.parametrize`: those at the places `fast` as they are, the others marked slow.

    A tuple holds the values of several arguments; with `are_values` each cell is the value of one.
    """
    return [cell if place in fast else pytest.param(*(cell if isinstance(cell, tuple) and not are_values else (cell,)),
                                                    marks=pytest.mark.slow)
            for place, cell in enumerate(cells)]
