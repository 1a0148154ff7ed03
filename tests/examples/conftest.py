"""The examples' scenes and scenarios have no improbable field."""

from __future__ import annotations

import pytest
from likely import all_likely


@pytest.fixture(autouse=True)
def likely_units():
    with all_likely():
        yield
