"""The programs that a person types, as installed beside this Python."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

GLRENDER = Path(sys.executable).with_name("glrender")


def run(*arguments, cwd, timeout=120):
    return subprocess.run([GLRENDER, *map(str, arguments)], cwd=cwd, capture_output=True, text=True, timeout=timeout)
