"""`glrender top`: how a running server does, on one screen."""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import time
from collections.abc import Iterator, Mapping
from datetime import timedelta
from pathlib import Path
from typing import Any

from glrender_camera.validate import within
from glrender_client import Client, GlrenderClientError, RequestTimeout, ServerError
from glrender_server.logs import printable

_HOME_AND_CLEAR = "\x1b[H\x1b[J"
_SECONDS = (0.001, 86400.0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `glrender top`."""
    parser.add_argument("endpoint", nargs="?", default="tcp://127.0.0.1:5555",
                        help="of the server's --zmq (tcp://127.0.0.1:5555)")
    parser.add_argument("--once", action="store_true", help="print one screen and leave: 0, or 1 if there is no answer")
    parser.add_argument("--interval", type=float, default=2.0, metavar="S", help="between two screens (2)")
    parser.add_argument("--timeout", type=float, default=2.0, metavar="S", help="for an answer (2)")
    parser.add_argument("--key", type=Path, help="for a server with CURVE: this client's NAME.key_secret")
    parser.add_argument("--server-key", type=Path, help="and the server's server.key")


def run(arguments: argparse.Namespace) -> int:
    """Show the server's status until Ctrl-C, or once."""
    interval_s = within("--interval", arguments.interval, *_SECONDS)
    timeout_s = within("--timeout", arguments.timeout, *_SECONDS)
    before: tuple[float, Mapping[str, Any]] | None = None
    try:
        with Client(arguments.endpoint, timeout_s=timeout_s, retries=0, key=arguments.key,
                    server_key=arguments.server_key) as client:
            while True:
                try:
                    now, status = time.monotonic(), client.status()
                    rate = None if before is None else _n_requests(status, before[1]) / (now - before[0])
                    lines = list(screen(arguments.endpoint, status, rate))
                    before = now, status
                except (RequestTimeout, ServerError) as error:  # gone, or about to
                    if arguments.once:
                        raise
                    lines, before = [printable(str(error))], None
                _show(lines)
                if arguments.once:
                    return 0
                time.sleep(interval_s)
    except KeyboardInterrupt:
        return 0
    except BrokenPipeError:
        # Whoever read has seen enough; Python would flush once more at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (GlrenderClientError, ValueError) as error:
        sys.stderr.write(f"glrender top: {error}\n")
        return 1


def screen(endpoint: str, status: Mapping[str, Any], rate: float | None = None) -> Iterator[str]:
    """The lines that show a server's `status`; no text from the server moves the terminal's cursor.

    Parameters
    ----------
    endpoint : str
    status : mapping
        The reply to `status`.
    rate : float [1/s], optional
        Requests since the last screen.
    """
    return map(printable, _lines(endpoint, status, rate))


def _lines(endpoint: str, status: Mapping[str, Any], rate: float | None) -> Iterator[str]:
    counted = lambda counts: ", ".join(  # noqa: E731
        f"{count} {name}" for name, count in sorted(counts.items(), key=lambda pair: -pair[1])) or "none"
    yield f"{endpoint}  up {timedelta(seconds=int(status['uptime_s']))}  {status['gl_renderer']} by {status['backend']}"
    yield f"requests   {counted(status['requests'])}" + ("" if rate is None else f"  ({rate:.1f} /s)")
    yield f"errors     {counted(status['errors'])}"
    yield f"waiting    {status['waiting']}"
    yield f"clients    {status['clients']}"
    if "workers" in status:
        workers = status["workers"]
        yield f"workers    {workers['ready']} of {workers['of']} ready, {workers['restarts']} restarts"
    timings = status["last_timings_ms"]
    yield "last [ms]  " + (", ".join(f"{stage} {value:.2f}" for stage, value in timings.items()) or "nothing rendered")
    yield "cameras    " + ", ".join(f"{c['name']} {c['width_px']} x {c['height_px']}" for c in status["cameras"])
    yield "bodies     " + ", ".join(f"{b['name']} {b['n_facets']} facets" for b in status["bodies"])


def _show(lines: list[str]) -> None:
    """Write a screen; on a terminal in the place of the last, and no more lines than fit."""
    begin = ""
    if sys.stdout.isatty():
        size = shutil.get_terminal_size()
        begin, lines = _HOME_AND_CLEAR, [line[:size.columns] for line in lines[:max(1, size.lines - 1)]]
    sys.stdout.write(begin + "\n".join(lines) + "\n")
    sys.stdout.flush()


def _n_requests(status: Mapping[str, Any], before: Mapping[str, Any]) -> int:
    """Requests between two replies, without the `status` of this command itself; a restarted server counts anew."""
    count = lambda reply: sum(reply["requests"].values())  # noqa: E731
    return max(0, count(status) - count(before) - 1)
