"""`glrender credibility`: checks of this machine's frames against closed forms and rays, as a page and as JSON."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from glrender import ConfigError

from ..credibility.checks import checks
from ..credibility.report import write_pack


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `glrender credibility`."""
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="for credibility.html and .json")
    parser.add_argument("--backend", default="auto")


def run(arguments: argparse.Namespace) -> int:
    """Print and write the checks; 1 if one does not hold."""
    if arguments.out.exists() and not arguments.out.is_dir():
        raise ConfigError("--out", "must be a folder", str(arguments.out))
    found = []
    for check in checks(arguments.backend):
        found.append(check)
        sys.stdout.write(f"{'holds' if check.holds else 'FAILS'} {check.name}: {check.requirement} {check.number:.3g}, "
                         f"at most {check.most:.3g}\n")
    for path in write_pack(arguments.out, found):
        sys.stdout.write(f"{path}\n")
    return int(not all(check.holds for check in found))
