"""`glrender completion`: the script by which a shell completes commands and options."""

from __future__ import annotations

import argparse
import sys

import shtab


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `glrender completion`."""
    parser.add_argument("shell", choices=("bash", "zsh", "tcsh"),
                        help="bash: glrender completion bash > ~/.local/share/bash-completion/completions/glrender")


def run(arguments: argparse.Namespace) -> int:
    """Print the script."""
    sys.stdout.write(shtab.complete(arguments.whole_parser(), arguments.shell) + "\n")
    return 0
