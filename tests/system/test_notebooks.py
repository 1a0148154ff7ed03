"""The notebooks of the documentation: they run as they are stored, and are stored as they ran."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from cells import slow_but
from missing import needed_module

NOTEBOOKS = sorted((Path(__file__).parents[2] / "docs" / "notebooks").glob("*.ipynb"))


@pytest.fixture(scope="module")
def nbformat():
    needed_module("ipywidgets", "pip install -e '.[test]'")
    needed_module("nbclient", "pip install -e '.[test]'")
    return needed_module("nbformat", "pip install -e '.[test]'")


def kinds(cell) -> list[set[str]]:
    """Of each output its MIME types, or the name of its stream."""
    return [set(output.data) if "data" in output else {output.name} for output in cell.get("outputs", [])]


def printed(cell) -> tuple[list[str], list[float]]:
    """What a cell prints: words, and numbers."""
    text = "".join(output.text for output in cell.get("outputs", []) if "text" in output)
    number = r"\d+(?:\.\d+)?(?:e-?\d+)?"
    return re.split(number, text), [float(each) for each in re.findall(number, text)]


@pytest.mark.parametrize("path", slow_but(NOTEBOOKS, 1), ids=lambda path: path.stem)
def test_a_notebook_runs_and_shows_what_is_stored(path, nbformat, tmp_path):
    from nbclient import NotebookClient

    stored = nbformat.read(path, 4)
    run = nbformat.read(path, 4)
    # An error ends the run with its traceback.
    NotebookClient(run, timeout=300, coalesce_streams=True, resources={"metadata": {"path": str(tmp_path)}}).execute()
    for cell, again in zip(stored.cells, run.cells, strict=True):
        assert kinds(cell) == kinds(again), cell.source
        (words, numbers), (words_again, numbers_again) = printed(cell), printed(again)
        assert words == words_again
        np.testing.assert_allclose(numbers_again, numbers, rtol=0.05)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_stored_notebook_is_whole_and_small(path, nbformat):
    stored = nbformat.read(path, 4)
    code = [cell for cell in stored.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    shown = set().union(*(types for cell in code for types in kinds(cell)))
    assert {"image/png", "text/html", "application/vnd.jupyter.widget-view+json"} <= shown and "stderr" not in shown
    assert path.stat().st_size < 300_000


def test_there_are_two():
    assert len(NOTEBOOKS) == 2
