"""A small world for all tests of this room: the one of examples/navigation."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

_WORLD = Path(__file__).parents[2] / "examples" / "navigation" / "world.py"
SIZE_PX = 160


@pytest.fixture(scope="session")
def world():
    """The module of the example."""
    spec = importlib.util.spec_from_file_location("navigation_world", _WORLD)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def flown(world):
    """Frames of a flight with their true and believed states, and the renderers of both sides."""
    shape = world.shape(subdivisions=5)
    scene = world.scene(shape, SIZE_PX)
    with world.Local(scene) as truth, world.Local(scene, max_error=0.1) as board:
        views = [(true, believed, truth.render(true, output="dn", exposure_s="auto", seed=seed).pixels)
                 for seed, (true, believed) in enumerate(world.views(6))]
        yield SimpleNamespace(camera=world.camera(SIZE_PX), body=world.body(shape), views=views, truth=truth,
                              board=board)
