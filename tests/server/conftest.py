"""What the tests of this room leave as they found it."""

from __future__ import annotations

import logging

import pytest


@pytest.fixture(autouse=True)
def logging_as_it_was():
    """A program's entry point that runs in this process adds a handler to a stream that ends with its test."""
    root = logging.getLogger()
    level, handlers = root.level, list(root.handlers)
    yield
    root.setLevel(level)
    for handler in set(root.handlers) - set(handlers):
        root.removeHandler(handler)
