"""`glrender-server SCENE.toml`: serve a scene until SIGTERM."""

from __future__ import annotations

import argparse
import ipaddress
import logging
import sys
from pathlib import Path
from urllib.parse import urlsplit

from glrender import ConfigError, GlrenderError, load_scene

from .dispatcher import Dispatcher
from .zmq_front import ZmqServer


def main(argv: list[str] | None = None) -> int:
    """Entry point of the console script."""
    parser = argparse.ArgumentParser(prog="glrender-server", description=__doc__)
    parser.add_argument("scene", type=Path, help="scene file (TOML)")
    parser.add_argument("--zmq", default="tcp://127.0.0.1:5555", metavar="ENDPOINT",
                        help="where to listen (tcp://127.0.0.1:5555); port * takes a free one; ipc:///path too")
    parser.add_argument("--backend", default="auto", help="auto, egl, osmesa, or a plug-in such as raytrace")
    parser.add_argument("--shape-dir", type=Path, help="folder whose shape files `load_scene` may name")
    parser.add_argument("--allow-remote", action="store_true",
                        help="listen beyond this machine: unencrypted, for anyone who can reach the port")
    parser.add_argument("-v", "--verbose", action="store_true")
    arguments = parser.parse_args(argv)
    logging.basicConfig(level=logging.DEBUG if arguments.verbose else logging.INFO,
                        format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    try:
        endpoint = checked_endpoint(arguments.zmq, arguments.allow_remote)
        if arguments.shape_dir is not None and not arguments.shape_dir.is_dir():
            raise ConfigError("--shape-dir", "must be a folder", str(arguments.shape_dir))
        dispatcher = Dispatcher(load_scene(arguments.scene), arguments.backend, arguments.shape_dir)
        try:
            server = ZmqServer(dispatcher, endpoint)
            # Scripts wait for this line; logs go to standard error.
            server.serve(lambda bound: _say(f"glrender-server ready on {bound} "
                                            f"({dispatcher.info['gl_renderer']} by {dispatcher.info['backend']})"))
        finally:
            dispatcher.close()
    except (GlrenderError, OSError) as error:
        sys.stderr.write(f"glrender-server: {error}\n")
        return 1
    _say("glrender-server stopped")
    return 0


def checked_endpoint(endpoint: str, allow_remote: bool) -> str:
    """The endpoint, if it stays on this machine or may leave it.

    Raises
    ------
    ConfigError
    """
    parts = urlsplit(endpoint)
    if parts.scheme == "ipc" and (parts.netloc or parts.path):
        return endpoint
    host, _, port = parts.netloc.rpartition(":")
    if parts.scheme != "tcp" or not host or not port:
        raise ConfigError("--zmq", "must be tcp://HOST:PORT or ipc:///PATH", endpoint)
    if host == "localhost":
        # It may resolve to IPv6, where no client looks.
        return f"tcp://127.0.0.1:{port}"
    try:
        is_local = ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        is_local = False
    if not is_local and not allow_remote:
        raise ConfigError("--zmq", "leads beyond this machine", endpoint,
                          "use 127.0.0.1 and an ssh tunnel, or say --allow-remote on a network you trust")
    return endpoint


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
