"""Build the camera as a co-simulation unit: build_fmu.py --fmi 3 --bodies NAME [NAME ...] [--out DIR]."""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))


def build(version: int, bodies: list[str], out: Path) -> Path:
    """The file of a unit whose inputs are the Sun, the spacecraft and some bodies.

    Parameters
    ----------
    version : 2 or 3
    bodies : list of str
        Names of all bodies of the server's scene.
    out : path
        Folder, made if it is missing.
    """
    import glrender_client
    from glrender_fmi.camera_unit import BODIES_FILE

    builder = importlib.import_module("pythonfmu3.builder" if version == 3 else "pythonfmu.builder").FmuBuilder
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        listed = Path(folder) / BODIES_FILE
        listed.write_text(json.dumps(bodies), encoding="utf-8")
        parts = [listed, HERE / "glrender_fmi", Path(glrender_client.__file__).parent]
        return builder.build_FMU(HERE / f"glrender_camera_fmi{version}.py", dest=out, project_files=parts)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fmi", type=int, choices=(2, 3), default=3)
    parser.add_argument("--bodies", nargs="+", required=True, metavar="NAME")
    parser.add_argument("--out", type=Path, default=Path("."))
    arguments = parser.parse_args()
    sys.stdout.write(f"{build(arguments.fmi, arguments.bodies, arguments.out)}\n")
