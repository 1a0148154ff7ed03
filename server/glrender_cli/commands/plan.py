"""`glrender plan`: explains how a frame is drawn, its predicted errors, and the effects left out."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace

from ..drawing import add_drawing, draw
from ..subject import add_subject


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `glrender plan`."""
    add_subject(parser)
    add_drawing(parser)
    parser.add_argument("--json", action="store_true", help="the whole plan, as replies of the server carry it")


def run(arguments: argparse.Namespace) -> int:
    """Draw the frame, and print its plan."""
    plan = draw(arguments).capture.plan
    # Its warnings are among those of the frame, which were printed.
    text = json.dumps(plan.to_dict()) if arguments.json else str(replace(plan, warnings=()))
    sys.stdout.write(text + "\n")
    return 0
