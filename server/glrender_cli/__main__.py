"""`glrender`: frames, sequences and checks from the command line."""

from __future__ import annotations

import argparse
import logging
import os
import re
import sys
from collections.abc import Iterable, Sequence
from importlib import import_module
from typing import NoReturn

from glrender import GlrenderError, __version__
from glrender_camera.validate import did_you_mean
from glrender_server.logs import is_ours

# Each command is a module of `commands`, loaded when it is asked for.
COMMANDS = {
    "init": "write a scene file, or a whole scenario, with comments to start from",
    "check": "describe a shape, a scene or a scenario, and warn of oddities",
    "render": "draw one frame of a scene, a scenario or a shape file",
    "plan": "explain how a frame is drawn, its predicted error, and the effects left out",
    "fields": "print the fields of a table of scene and scenario files",
    "sequence": "draw frames of many states as files, on all cores",
    "dataset": "draw labelled frames in shards: WebDataset, HDF5, COCO or BOP",
    "compress": "what each codec does to a frame: rate, errors, shifts of centre and features",
    "bench": "how long frames of a scene take on this machine",
    "doctor": "what this machine has, and how to mend what it lacks",
    "demo": "fly a closed loop around a body through the server",
    "top": "how a running server does, on one screen",
    "view": "show the frames of a running server on a page in the browser",
    "keygen": "make CURVE keys: the server's, and one pair for each client",
    "campaign": "fly a loop with other seeds, beliefs, faults and budgets, and report its errors",
    "reconstruct": "make a surface from the frames of a sequence",
    "deviation": "how far a surface lies from the true one, in numbers and as a picture",
    "credibility": "check frames of this machine against closed forms and rays, as a page and as JSON",
    "completion": "print a script that completes commands in a shell",
}


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message}; `{self.prog} --help` says more\n")


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of the console script: 0, or 1 after an error. Wrong arguments exit with 2."""
    argv = sys.argv[1:] if argv is None else list(argv)
    command = next((word for word in argv if not word.startswith("-")), None)
    handler = logging.StreamHandler()
    handler.addFilter(is_ours)
    # Before a command is imported, whose loops may be compiled then.
    logging.basicConfig(level=logging.WARNING, handlers=[handler], format="glrender: %(message)s")
    parser = parser_of(() if command is None else (command,))
    if command is not None and command not in COMMANDS:
        parser.error(f"unknown command {command!r}; {did_you_mean(command, COMMANDS) or ', '.join(COMMANDS)}")
    arguments, strange = parser.parse_known_args(argv)
    if strange:
        known = re.findall(r"--[a-z][a-z-]*", arguments.parser.format_help())
        meant = did_you_mean(strange[0].partition("=")[0], known)
        arguments.parser.error(f"unknown argument {strange[0]!r}{'; ' * bool(meant)}{meant}")
    if arguments.verbose:
        handler.setFormatter(logging.Formatter("%(levelname)s %(name)s: %(message)s"))
        logging.getLogger().setLevel(logging.INFO)
    try:
        return arguments.run(arguments) or 0
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # who read it has seen enough
        return 1
    except KeyboardInterrupt:
        sys.stderr.write("glrender: interrupted\n")
        return 130
    except (GlrenderError, OSError) as error:
        sys.stderr.write(f"glrender: {error}\n")
        return 1


def parser_of(loaded: Iterable[str]) -> argparse.ArgumentParser:
    """The parser of all commands, of which those of `loaded` have their arguments too."""
    parser = _Parser(prog="glrender", description=__doc__, allow_abbrev=False)
    parser.add_argument("--version", action="version", version=f"glrender {__version__}")
    parser.add_argument("-v", "--verbose", action="store_true", help="log what happens inside")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, purpose in COMMANDS.items():
        own = commands.add_parser(name, help=purpose, description=purpose, allow_abbrev=False)
        if name in loaded:
            module = import_module(f".commands.{name}", __package__)
            module.add_arguments(own)
            own.set_defaults(run=module.run, parser=own, whole_parser=lambda: parser_of(COMMANDS))
    return parser


if __name__ == "__main__":
    sys.exit(main())
