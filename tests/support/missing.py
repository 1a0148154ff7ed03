"""Needs of a test that this machine lacks: a loud skip, which tests/conftest.py makes a failure in .ci/run."""

from __future__ import annotations

import importlib
from typing import NoReturn

import pytest


def missing(what: str, remedy: str) -> NoReturn:
    """Skip the test loudly; `remedy` is what to type."""
    pytest.skip(f"{what} IS MISSING: {remedy}")


def needed_module(name: str, remedy: str):
    """An optional package, imported. For fixtures: at a module's top a failure would end the collection."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        missing(f"{name.upper()} ({error})", remedy)
