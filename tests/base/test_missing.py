"""What is missing fails in CI and is skipped loudly elsewhere."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from missing import missing, needed_module

TOOLS = Path(__file__).parents[2] / "tools"


def test_in_ci_it_is_a_failure(monkeypatch):
    monkeypatch.setenv("CI", "true")
    with pytest.raises(pytest.fail.Exception, match="GNU HURD IS MISSING: make hurd"):
        missing("GNU HURD", "make hurd")
    with pytest.raises(pytest.fail.Exception, match="NO_SUCH_MODULE .* IS MISSING: make it"):
        needed_module("no_such_module", "make it")


def test_elsewhere_it_is_a_skip_that_says_so(monkeypatch):
    monkeypatch.delenv("CI", raising=False)
    with pytest.raises(pytest.skip.Exception, match="GNU HURD IS MISSING: make hurd"):
        missing("GNU HURD", "make hurd")


@pytest.mark.parametrize("ci, status", [("true", 1), ("", 0)])
@pytest.mark.parametrize("what", ["blender", "mitsuba"])
def test_an_installer_that_fails_says_so_and_fails_in_ci(tmp_path, what, ci, status):
    """With a Python that can neither import nor install anything, and no other Python on the path."""
    python, path = tmp_path / "python", tmp_path / "bin"
    python.write_text(f'#!/bin/sh\ncase "$*" in *finder*) echo {tmp_path}/venv/bin/python;; *) exit 1;; esac\n')
    python.chmod(0o755)
    path.mkdir()
    (path / "rm").symlink_to(shutil.which("rm"))
    run = subprocess.run([shutil.which("sh"), TOOLS / f"install_{what}.sh", python], capture_output=True, text=True,
                         timeout=60, env={"PATH": str(path), "CI": ci})
    assert run.returncode == status, run.stderr
    assert "NOT HERE" in run.stderr
