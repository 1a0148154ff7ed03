"""Processes that draw: one that dies ends the work with an error, whenever it dies."""

from __future__ import annotations

import os
import subprocess
import sys

from glrender.sequences.processes import own_processes

# Whoever reads a `Dies` from a pickle dies, as a process does that memory is too short for.
DIES = """
import os
from glrender.sequences.processes import own_processes

class Dies:
    def __reduce__(self):
        return os._exit, (1,)

if __name__ == "__main__":
    with own_processes(2, print, (Dies(), bytes(2**22)), os.getpid) as pool:
        list(pool.done(iter([(0, os.getpid, ())])))
"""


def test_a_process_that_dies_at_its_start_is_reported(tmp_path):
    """It leaves more unread than a pipe holds (64 KiB): its parent, which writes it, must not wait for ever."""
    (tmp_path / "dies.py").write_text(DIES)
    told = subprocess.run([sys.executable, tmp_path / "dies.py"], capture_output=True, text=True, timeout=120)
    assert told.returncode == 1 and "a process that draws was killed: was memory short?" in told.stderr


def test_processes_begin_with_their_arguments_and_leave_no_file(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with own_processes(2, os.chdir, (str(tmp_path),), os.getpid) as pool:
        assert [place for _, place in pool.done(iter([(k, os.getcwd, ()) for k in range(2)]))] == [str(tmp_path)] * 2
        assert list(tmp_path.iterdir())
    assert not list(tmp_path.iterdir())
