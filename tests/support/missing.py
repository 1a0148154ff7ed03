"""Needs of a test that this machine lacks: in CI a failure, elsewhere a loud skip. A skip must not hide a gap."""

from __future__ import annotations

import importlib
import os
from typing import NoReturn

import pytest


def missing(what: str, remedy: str) -> NoReturn:
    """Fail if the environment says CI=true, skip otherwise; `remedy` is what to type."""
    reason = f"{what} IS MISSING: {remedy}"
    if os.environ.get("CI") == "true":
        pytest.fail(reason, pytrace=False)
    pytest.skip(reason)


def needed_module(name: str, remedy: str):
    """An optional package, imported. For fixtures: at a module's top a failure would end the collection."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        missing(f"{name.upper()} ({error})", remedy)
