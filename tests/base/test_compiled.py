"""Machine code is kept from start to start; where it cannot be, or cannot be read, a start takes longer and no more."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from glrender_camera import numba_loops

ROOT = Path(__file__).parents[2]
LOOP = """
import logging
logging.basicConfig()
from numba.types import intp
from glrender_camera.numba_loops import compiled

@compiled(intp(intp))
def twice(x):
    return 2 * x

print(twice(21), sum(twice.stats.cache_hits.values()))
"""


def started(folder, **environment):
    """What a process says that compiles a loop, or reads it: its value and how often it was read; and its warnings."""
    (folder / "loop.py").write_text(LOOP)
    run = subprocess.run([sys.executable, folder / "loop.py"], capture_output=True, text=True, timeout=60,
                         env={**os.environ, "PYTHONPATH": str(ROOT / "camera_model"), **environment})
    assert run.returncode == 0, run.stderr
    return run.stdout.split(), run.stderr


def test_it_is_kept(tmp_path):
    made, told = started(tmp_path, NUMBA_CACHE_DIR=str(tmp_path))
    assert made == ["42", "0"] and told.count("\n") == 1 and "compiling" in told and "s left" in told
    assert started(tmp_path, NUMBA_CACHE_DIR=str(tmp_path)) == (["42", "1"], "")


def test_without_a_folder_that_can_be_written_it_is_made_at_every_start(tmp_path):
    (tmp_path / "__pycache__").write_text("a file")
    nowhere = {"HOME": "/proc/none", "XDG_CACHE_HOME": "/proc/none"}
    for _ in range(2):
        value, warning = started(tmp_path, **nowhere)
        assert value == ["42", "0"] and "machine code of twice is not kept" in warning


@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
@pytest.mark.parametrize("size", [0, 100])
def test_half_a_file_is_not_read(tmp_path, suffix, size):
    folder = tmp_path / "kept"
    started(tmp_path, NUMBA_CACHE_DIR=str(folder))
    (file,) = folder.rglob(f"*.{suffix}")
    file.write_bytes(file.read_bytes()[:size])
    value, warning = started(tmp_path, NUMBA_CACHE_DIR=str(folder))
    assert value == ["42", "0"] and "machine code of twice is not kept" in warning


def test_what_few_need_is_made_when_it_is_called(tmp_path, monkeypatch):
    """Once, also where threads call it together."""
    made = []
    monkeypatch.setattr(numba_loops, "compiled", lambda signature: lambda function: made.append(signature) or function)
    twice = numba_loops.compiled_when_called("a signature")(lambda x: 2 * x)
    assert not made
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(twice, range(8))) == [0, 2, 4, 6, 8, 10, 12, 14]
    assert made == ["a signature"]


def test_no_loop_calls_one_of_another_file():
    """Numba would run the old one on after a change of the other file: it looks at each file's own text alone."""
    files = [file for folder in ("glrender", "camera_model") for file in (ROOT / folder).rglob("*.py")
             if "numba_loops import" in file.read_text()]
    names = "|".join(file.stem for file in files)
    assert len(files) > 2
    for file in files:
        assert not re.search(rf"from [.a-z]*\b({names}) import", file.read_text()), file.name
