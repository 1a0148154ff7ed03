"""Plug-ins for the tests of this room."""

from __future__ import annotations

import importlib

import pytest
from glrender.scene.plugins import registry as plugins


@pytest.fixture
def add(tmp_path, monkeypatch):
    """A function that puts a distribution on the path: name, group, entry points, the module's text."""
    def add(name, group, entries, text):
        folder = tmp_path / name
        told = folder / f"{name}-1.5.dist-info"
        told.mkdir(parents=True)
        (told / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.5\n")
        points = "".join(f"{key} = {value}\n" for key, value in entries.items())
        (told / "entry_points.txt").write_text(f"[{group}]\n{points}")
        (folder / f"{name}_module.py").write_text(text)
        monkeypatch.syspath_prepend(folder)
        forget()

    def forget():
        importlib.invalidate_caches()
        for found in (plugins.laws, plugins.backends, plugins.emissions):
            found.cache_clear()

    yield add
    monkeypatch.undo()
    forget()
