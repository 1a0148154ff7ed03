"""`glrender keygen`: CURVE keys of a server and of its clients."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from glrender_server import keys


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `glrender keygen`."""
    parser.add_argument("folder", type=Path)
    parser.add_argument("--client", action="append", default=[], metavar="NAME", help="may be given several times")


def run(arguments: argparse.Namespace) -> int:
    """Make the keys that are missing, and print their paths."""
    for path in keys.generate(arguments.folder, arguments.client):
        sys.stdout.write(f"{path}\n")
    return 0
