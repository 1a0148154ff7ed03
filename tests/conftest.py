"""Fixtures that many tests share. A test says so when it is skipped for want of data."""

from __future__ import annotations

import logging
import os
import signal
from collections import Counter
from pathlib import Path
from zlib import crc32

import numpy as np
import pytest
from data_folders import DataFolders
from missing import missing

_REPOSITORY = Path(__file__).parent.parent
# Files that take about a minute, of few tests that are not marked slow.
_LONG_FILES = {"test_backend", "test_basilisk", "test_command_line", "test_example_pages", "test_octave_tutorial",
               "test_server", "test_site", "test_types", "test_view", "test_workers"}

# In the background, as under nohup, neither tests nor what they start would hear Ctrl-C.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def shared() -> DataFolders:
    """Real shapes, images and kernels: of tests/data, then of the folder `data` of ../shared (or $GLRENDER_SHARED)."""
    other = Path(os.environ.get("GLRENDER_SHARED") or _REPOSITORY.parent / "shared") / "data"
    return DataFolders(_REPOSITORY / "tests" / "data", other)


@pytest.fixture(scope="session")
def blender() -> str:
    """The version of a Blender that starts; without one the tests of the backend cycles cannot run."""
    from glrender import DeviceError
    from glrender.engines.cycles.process import BlenderProcess

    try:
        process = BlenderProcess()
    except DeviceError as error:
        missing(f"BLENDER ({error})", "make blender")
    process.close()
    return process.version


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20261121)


@pytest.fixture(autouse=True)
def logging_as_it_was():
    """A program's entry point that runs in this process adds a handler to a stream that ends with its test."""
    root = logging.getLogger()
    level, handlers = root.level, list(root.handlers)
    yield
    root.setLevel(level)
    for handler in set(root.handlers) - set(handlers):
        root.removeHandler(handler)


def pytest_addoption(parser):
    parser.addoption("--nothing-missing", action="store_true", help="tests that lack a tool fail")
    parser.addoption("--slow-tenth", type=int, choices=range(10), help="of the slow tests, run this tenth alone")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config, items):
    """Leave out nine tenths of the slow tests, by their names: ten tenths are all, whatever else is chosen.

    Of several processes, which take file by file, each begins with a long one: else all wait for the last.
    """
    tenth = config.getoption("--slow-tenth")
    if tenth is not None:
        others = {item for item in items
                  if item.get_closest_marker("slow") and crc32(item.nodeid.encode()) % 10 != tenth}
        config.hook.pytest_deselected(items=list(others))
        items[:] = [item for item in items if item not in others]
    if hasattr(config, "workerinput"):
        seconds = Counter({path: 60.0 for path in {item.path for item in items} if path.stem in _LONG_FILES})
        for item in items:
            seconds[item.path] += 6.0 if item.get_closest_marker("slow") else 0.1
        items.sort(key=lambda item: -seconds[item.path])


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item):
    """Under --nothing-missing, a test that `missing` skipped fails with the same reason."""
    report = yield
    if report.skipped and item.config.getoption("--nothing-missing") and " IS MISSING: " in str(report.longrepr):
        report.outcome, report.longrepr = "failed", report.longrepr[2]
    return report


def pytest_terminal_summary(terminalreporter):
    """Say loudly what was skipped: a skipped test hides a gap."""
    skipped = terminalreporter.stats.get("skipped", [])
    if skipped:
        terminalreporter.write_sep("!", f"{len(skipped)} TESTS WERE SKIPPED, see the reasons above", yellow=True)
