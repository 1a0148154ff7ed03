"""`glrender view`: a page in the browser that shows the frames of a running server."""

from __future__ import annotations

import argparse
import secrets
import signal
import sys
import threading
from pathlib import Path

from glrender import ConfigError
from glrender_camera.validate import integer
from glrender_client import Client, GlrenderClientError
from glrender_view.port import check_installed, listening


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `glrender view`."""
    parser.add_argument("endpoint", nargs="?", default="tcp://127.0.0.1:5555",
                        help="of the server's --zmq (tcp://127.0.0.1:5555), which was started with --watch")
    parser.add_argument("--port", type=int, default=0, help="of the page on 127.0.0.1; 0 takes a free one (0)")
    parser.add_argument("--key", type=Path, help="for a server with CURVE: this client's NAME.key_secret")
    parser.add_argument("--server-key", type=Path, help="and the server's server.key")


def run(arguments: argparse.Namespace) -> int:
    """Show the page until Ctrl-C."""
    check_installed("view")
    from glrender_view.serving import serve

    keys = None if arguments.key is None and arguments.server_key is None else (arguments.key, arguments.server_key)
    try:
        # Wrong addresses and keys are refused now.
        with Client(arguments.endpoint, timeout_s=2.0, retries=0, key=arguments.key,
                    server_key=arguments.server_key) as client:
            client.watch()
    except (GlrenderClientError, ValueError) as error:
        raise ConfigError("view", str(error)) from None
    found = listening("--port", integer("--port", arguments.port, 0, 65535))
    token, ended = secrets.token_urlsafe(), threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    sys.stdout.write(f"glrender view of {arguments.endpoint} on http://127.0.0.1:{found.getsockname()[1]}/"
                     f"?token={token}\n")
    sys.stdout.flush()
    serve(found, token, arguments.endpoint, keys, "", ended)
    return 0
