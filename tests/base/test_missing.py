"""What a test lacks is skipped loudly and fails in .ci/run; nothing asks a machine whether it is CI; slow tenths."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
TOOLS = REPOSITORY / "tools"
LACKING = """
import pytest
from missing import missing, needed_module


def test_a_tool():
    missing("GNU HURD", "make hurd")


def test_a_module():
    needed_module("no_such_module", "make it")


@pytest.fixture
def absent():
    missing("A FIXTURE", "make one")


def test_a_fixture(absent):
    pass


def test_what_this_system_has_not():
    pytest.skip("this is not Linux")


@pytest.mark.slow
@pytest.mark.parametrize("number", range(100))
def test_slow(number):
    pass
"""


def pytest_prints(tmp_path, *options: str) -> str:
    """What pytest prints of LACKING under tests/conftest.py."""
    shutil.copy(REPOSITORY / "tests/conftest.py", tmp_path)
    (tmp_path / "test_lacking.py").write_text(LACKING)
    (tmp_path / "pytest.ini").write_text(f"[pytest]\nmarkers = slow: long\npythonpath = {TOOLS}/../tests/support\n")
    run = subprocess.run([sys.executable, "-m", "pytest", "-ra", "-v", "-p", "no:cacheprovider", *options,
                          str(tmp_path)], capture_output=True, text=True, timeout=120, cwd=tmp_path,
                         env={**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"})
    return run.stdout + run.stderr


def test_what_is_missing_is_skipped_and_the_reason_says_what_to_type(tmp_path):
    said = pytest_prints(tmp_path, "-m", "not slow")
    assert "4 skipped" in said and "failed" not in said and "4 TESTS WERE SKIPPED" in said, said
    for reason in ("GNU HURD IS MISSING: make hurd", r"NO_SUCH_MODULE \(.*\) IS MISSING: make it", "A FIXTURE IS"):
        assert re.search(reason, said), said


def test_it_fails_where_nothing_may_be_missing(tmp_path):
    """And what a system cannot have is still skipped."""
    said = pytest_prints(tmp_path, "-m", "not slow", "--nothing-missing")
    assert re.search("2 failed, 1 skipped, .*1 error", said) and "GNU HURD IS MISSING: make hurd" in said, said


def test_ten_tenths_of_the_slow_tests_are_all_of_them_once(tmp_path):
    said = [pytest_prints(tmp_path, "--collect-only", "-q", f"--slow-tenth={tenth}") for tenth in range(10)]
    parts = [set(re.findall(r"test_slow\[\d+\]", each)) for each in said]
    assert sum(map(len, parts)) == len(set.union(*parts)) == 100
    assert all(parts) and all("test_a_tool" in each for each in said)


@pytest.mark.parametrize("what", ["blender", "mitsuba"])
def test_an_installer_that_fails_says_so_and_lets_the_tests_run(tmp_path, what):
    """With a Python that can neither import nor install anything, and no other Python on the path."""
    python, path = tmp_path / "python", tmp_path / "bin"
    python.write_text(f'#!/bin/sh\ncase "$*" in *finder*) echo {tmp_path}/venv/bin/python;; *) exit 1;; esac\n')
    python.chmod(0o755)
    path.mkdir()
    (path / "rm").symlink_to(shutil.which("rm"))
    run = subprocess.run([shutil.which("sh"), TOOLS / f"install_{what}.sh", python], capture_output=True, text=True,
                         timeout=60, env={"PATH": str(path)})
    assert run.returncode == 0, run.stderr
    assert "NOT HERE" in run.stderr


def test_nothing_asks_whether_it_is_ci():
    """The doors of users and of CI are one: Makefile, tools and tests do not read the variable CI."""
    asking = re.compile(r"\$[({]?CI\b|(environ\S*|env)[\[(][\"']CI[\"']|ifn?def\s+CI\b|printenv\s+CI\b"
                        r"|[\"']CI[\"']\s+(not )?in")
    files = [REPOSITORY / "Makefile", REPOSITORY / ".ci/run", *(REPOSITORY / "tools").rglob("*.*"),
             *(REPOSITORY / "tests").rglob("*.py")]
    assert len(files) > 200
    assert not [str(file) for file in files
                if file.suffix != ".pyc" and asking.search(file.read_text(encoding="utf-8"))]
    name = "C" + "I"
    for line in (f'[ "${{{name}:-}}" = true ]', f"${name}", f'environ.get("{name}")', f"environ['{name}']",
                 f"ifeq ($({name}),true)", f"ifdef {name}", f'"{name}" in os.environ', f"printenv {name}",
                 f'monkeypatch.setenv("{name}", "1")'):
        assert asking.search(line)


def test_nothing_is_asked_for_while_tests_are_collected():
    """A skip or a failure at a module's top would end the collection: fixtures and tests ask."""
    asks = re.compile(r"^(\w+ = )?(missing|needed_module|pytest\.skip|pytest\.importorskip)\(", re.MULTILINE)
    files = sorted((REPOSITORY / "tests").rglob("test_*.py"))
    assert len(files) > 150 and not [str(file) for file in files if asks.search(file.read_text(encoding="utf-8"))]
    assert asks.search('import x\nneeded_module("x", "")') and asks.search('x = pytest.importorskip("x")')
