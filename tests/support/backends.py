"""OpenGL backends that work on this machine."""

from __future__ import annotations

import pytest
from glrender.engines.raster.gl.context import probe

WORKING = [entry["backend"] for entry in probe() if "error" not in entry]


def backend_or_skip(backend: str) -> str:
    if backend not in WORKING:
        pytest.skip(f"SKIPPED FOR WANT OF {backend.upper()}: this machine has {WORKING}")
    return backend
