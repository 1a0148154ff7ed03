"""The search for Blender on this machine: a Python that has bpy, or the program itself."""

from __future__ import annotations

import importlib.util
import os
import shutil
import sys
from pathlib import Path

from ...base.disk_cache import cache_folder
from ...base.errors import DeviceError

SERVE = Path(__file__).parent / "inside" / "serve.py"
_HINT = ("`make blender` brings it (PyPI's bpy, in an environment of its own), or `pip install 'glrender[cycles]'` "
         "where this Python is bpy's (3.11 for Blender 4.2 to 5.0), or set GLRENDER_BLENDER to a blender or to a "
         "python that has bpy")


def own_python() -> Path:
    """The Python of Blender's own environment, made by `make blender`."""
    return cache_folder() / "blender" / "bin" / "python"


def blender_command() -> list[str]:
    """The command that runs `inside/serve.py` in Blender; a socket's number is to be added.

    First $GLRENDER_BLENDER, then this Python's bpy, `own_python`, and a `blender` on the path.

    Raises
    ------
    DeviceError
        There is none; the message says what to install.
    """
    asked = os.environ.get("GLRENDER_BLENDER")
    if asked:
        program = shutil.which(asked)
        if program is None:
            raise DeviceError(f"GLRENDER_BLENDER: must be a program, got {asked!r}; {_HINT}")
        return _command(program)
    if importlib.util.find_spec("bpy") is not None:
        return _command(sys.executable)
    if own_python().is_file():
        return _command(str(own_python()))
    program = shutil.which("blender")
    if program is None:
        raise DeviceError(f"the backend cycles needs Blender, which is not here: {_HINT}")
    return _command(program)


def _command(program: str) -> list[str]:
    if "python" in Path(program).name:
        return [program, "-s", str(SERVE)]
    return [program, "--background", "--factory-startup", "--python-exit-code", "1", "--python", str(SERVE), "--"]
