"""`glrender-server SCENE.toml`: serve a scene until SIGTERM."""

from __future__ import annotations

import argparse
import ipaddress
import logging
import sys
from contextlib import ExitStack, closing
from pathlib import Path
from urllib.parse import urlsplit

from glrender import ConfigError, GlrenderError, load_scene

from .dispatcher import Dispatcher
from .front import Front
from .server import Server
from .tcp_front import TcpFront
from .zmq_front import ZmqFront


def main(argv: list[str] | None = None) -> int:
    """Entry point of the console script."""
    parser = argparse.ArgumentParser(prog="glrender-server", description=__doc__)
    parser.add_argument("scene", type=Path, help="scene file (TOML)")
    parser.add_argument("--zmq", default="tcp://127.0.0.1:5555", metavar="ENDPOINT",
                        help="where to listen (tcp://127.0.0.1:5555); port * takes a free one; ipc:///path too")
    parser.add_argument("--tcp", metavar="HOST:PORT",
                        help="listen for framed TCP too (MATLAB, Simulink, C), e.g. 127.0.0.1:5556; never encrypted")
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
        address = None if arguments.tcp is None else checked_address(arguments.tcp, arguments.allow_remote)
        if arguments.shape_dir is not None and not arguments.shape_dir.is_dir():
            raise ConfigError("--shape-dir", "must be a folder", str(arguments.shape_dir))
        with ExitStack() as stack:
            dispatcher = Dispatcher(load_scene(arguments.scene), arguments.backend, arguments.shape_dir)
            stack.callback(dispatcher.close)
            fronts: list[Front] = [stack.enter_context(closing(ZmqFront(endpoint)))]
            if address is not None:
                fronts.append(stack.enter_context(closing(TcpFront(address))))
            where = " and ".join(front.endpoint for front in fronts)
            # Scripts wait for this line; logs go to standard error.
            Server(dispatcher, fronts).serve(lambda: _say(
                f"glrender-server ready on {where} ({dispatcher.info['gl_renderer']} by {dispatcher.info['backend']})"))
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
    if parts.scheme != "tcp":
        raise ConfigError("--zmq", "must be tcp://HOST:PORT or ipc:///PATH", endpoint)
    return f"tcp://{_checked_host_and_port('--zmq', parts.netloc, 'tcp://HOST:PORT', allow_remote)}"


def checked_address(address: str, allow_remote: bool) -> str:
    """``HOST:PORT`` of framed TCP, under the same rule.

    Raises
    ------
    ConfigError
    """
    checked = _checked_host_and_port("--tcp", address, "HOST:PORT", allow_remote)
    port = checked.rpartition(":")[2]
    if not (port.isdecimal() and int(port) < 65536):
        raise ConfigError("--tcp", "must be HOST:PORT, the port between 0 and 65535", address)
    return checked


def _checked_host_and_port(option: str, text: str, form: str, allow_remote: bool) -> str:
    host, _, port = text.rpartition(":")
    if not host or not port:
        raise ConfigError(option, f"must be {form}" + (" or ipc:///PATH" if option == "--zmq" else ""), text)
    if host == "localhost":
        # It may resolve to IPv6, where no client looks.
        return f"127.0.0.1:{port}"
    try:
        is_local = ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        is_local = False
    if not is_local and not allow_remote:
        raise ConfigError(option, "leads beyond this machine", text,
                          "use 127.0.0.1 and an ssh tunnel, or say --allow-remote on a network you trust")
    return text


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
