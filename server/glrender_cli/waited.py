"""How long a user of a command has waited."""

from __future__ import annotations

import os
import time
from pathlib import Path

_STARTED = time.monotonic()


def waited_s() -> float:
    """Seconds since this process began: by Linux' own count, elsewhere since this module was imported."""
    try:
        ticks = int(Path("/proc/self/stat").read_text().rpartition(")")[2].split()[19])
        return time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")
    except (OSError, AttributeError, ValueError, IndexError):
        return time.monotonic() - _STARTED
