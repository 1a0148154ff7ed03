"""Processes that others began, as Linux lists them."""

from __future__ import annotations

from pathlib import Path


def children(pid: int, word: bytes) -> list[int]:
    """Numbers of the processes that a process began and whose command has a word in it."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
                command = (entry / "cmdline").read_bytes()
            except OSError:
                continue
            if int(fields[1]) == pid and word in command:
                found.append(int(entry.name))
    return found
