"""`glrender-server SCENE.toml`: serve a scene until SIGTERM."""

from __future__ import annotations

import argparse
import gc
import ipaddress
import logging
import os
import secrets
import sys
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from urllib.parse import urlsplit

from glrender import ConfigError, GlrenderError, __version__
from glrender_camera.validate import integer, positive

from . import limits, logs
from .dispatcher import Dispatcher
from .front import Front
from .job import LocalEngine
from .metrics import MetricsServer
from .scene_source import SceneFile
from .server import Server
from .tap import Tap
from .tcp_front import TcpFront
from .view_process import ViewProcess
from .workers import SLOW_DEADLINE_S, WorkerPool
from .zmq_front import ZmqFront

log = logging.getLogger(__name__)

MAX_WORKERS = 64
DEADLINE_S = 60.0
_SHARE_OF_MEMORY = 0.8


def main(argv: list[str] | None = None) -> int:
    """Entry point of the console script."""
    parser = argparse.ArgumentParser(prog="glrender-server", description=__doc__)
    parser.add_argument("--version", action="version", version=f"glrender-server {__version__}")
    parser.add_argument("scene", type=Path, help="scene file (TOML), or with --belief a scenario file")
    parser.add_argument("--belief", action="store_true",
                        help="serve the scene that the [belief] of a scenario file makes of its own, to the on-board "
                             "side; the true one is served by another server")
    parser.add_argument("--zmq", default="tcp://127.0.0.1:5555", metavar="ENDPOINT",
                        help="where to listen (tcp://127.0.0.1:5555); port * takes a free one; ipc:///path too")
    parser.add_argument("--tcp", metavar="HOST:PORT",
                        help="listen for framed TCP too (MATLAB, Simulink, C), e.g. 127.0.0.1:5556; never encrypted")
    parser.add_argument("--backend", default="auto", help="auto, egl, osmesa, or a plug-in such as raytrace")
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="processes that render (1)")
    parser.add_argument("--in-process", action="store_true",
                        help="render in the server's own process: some 2 ms sooner, but nobody is answered meanwhile, "
                             "no deadline is kept, and what ends the renderer ends the server")
    parser.add_argument("--deadline", type=float, metavar="S", help="kill a worker that takes longer over one request "
                                                                    f"({DEADLINE_S:g} s)")
    parser.add_argument("--slow-deadline", type=float, default=SLOW_DEADLINE_S, metavar="S",
                        help=f"the same for a request with a backend, or that loads a scene ({SLOW_DEADLINE_S:g} s)")
    parser.add_argument("--worker-memory", type=float, metavar="GIB",
                        help="data that a worker may have; default: four fifths of the machine's memory, shared evenly")
    parser.add_argument("--no-load-scene", action="store_true", help="serve this one scene: nobody may replace it")
    parser.add_argument("--operator", action="append", metavar="NAME",
                        help="with --curve: only the client of this key may replace the scene; may be given again")
    parser.add_argument("--shape-dir", type=Path, help="folder whose shape files `load_scene` may name")
    parser.add_argument("--curve", type=Path, metavar="FOLDER",
                        help="encrypt ZeroMQ, and admit the clients of this folder alone (glrender keygen makes it)")
    parser.add_argument("--allow-remote", action="store_true",
                        help="listen beyond this machine unencrypted, for anyone who can reach the port")
    parser.add_argument("--metrics", type=int, metavar="PORT",
                        help="serve Prometheus metrics on http://127.0.0.1:PORT/metrics; 0 takes a free one")
    parser.add_argument("--view", type=int, metavar="PORT",
                        help="show the frames on a page at http://127.0.0.1:PORT, whose full address is printed; 0 "
                             "takes a free port")
    parser.add_argument("--watch", action="store_true",
                        help="let every client watch the frames of all (glrender view ADDRESS)")
    parser.add_argument("--log-format", choices=logs.FORMATS, default="text")
    parser.add_argument("-v", "--verbose", action="store_true", help="log every request")
    arguments = parser.parse_args(argv)
    logs.set_up(logging.DEBUG if arguments.verbose else logging.INFO, arguments.log_format)
    try:
        endpoint = checked_endpoint(arguments.zmq, arguments.allow_remote or arguments.curve is not None)
        address = None if arguments.tcp is None else checked_address(arguments.tcp, arguments.allow_remote)
        if arguments.shape_dir is not None and not arguments.shape_dir.is_dir():
            raise ConfigError("--shape-dir", "must be a folder", str(arguments.shape_dir))
        operators = _operators(arguments)
        of_zmq, of_tcp = limits.max_connections()
        with ExitStack() as stack:
            # First what fails at once: a port that another program has.
            fronts: list[Front] = [stack.enter_context(closing(ZmqFront(endpoint, arguments.curve, of_zmq)))]
            if address is not None:
                fronts.append(stack.enter_context(closing(TcpFront(address, of_tcp))))
                if arguments.curve is not None:
                    log.warning("--tcp with --curve: whoever reaches %s, as every user of this machine does, asks "
                                "without a key", address)
            # Whoever watches must know the password, or nobody may.
            password = "" if arguments.watch else secrets.token_urlsafe()
            view, page = None, ""
            if arguments.view is not None:
                view = stack.enter_context(closing(ViewProcess(integer("--view", arguments.view, 0, 65535))))
            engine = stack.enter_context(closing(_engine(arguments)))
            tap = Tap(password) if arguments.watch or view is not None else None
            dispatcher = stack.enter_context(closing(Dispatcher(engine, fronts, operators, tap)))
            where = " and ".join(front.endpoint for front in fronts)
            said = [f"{engine.described['gl_renderer']} by {engine.described['backend']}"]
            if arguments.curve is not None:
                said.append("CURVE")
            if arguments.metrics is not None:
                metrics = stack.enter_context(closing(MetricsServer(
                    integer("--metrics", arguments.metrics, 0, 65535), dispatcher.metrics)))
                said.append(f"metrics on {metrics.endpoint}")
            if view is not None:
                view.start(fronts[0].endpoint, password, arguments.curve)
                page = f"\nview on {view.address}"
            # Modules that are loaded are no garbage; looking through them takes some tenths of a millisecond a frame.
            gc.freeze()
            # Scripts wait for this line, and for a page's address that comes with it; logs go to standard error.
            Server(dispatcher, engine, fronts, fronts[0].reload_keys).serve(
                lambda: logs.say(f"glrender-server ready on {where} ({'; '.join(said)}){page}"))
    except (GlrenderError, OSError) as error:
        sys.stderr.write(f"glrender-server: {error}\n")
        return 1
    logs.say("glrender-server stopped")
    return 0


def _engine(arguments: argparse.Namespace) -> LocalEngine | WorkerPool:
    n_workers = integer("--workers", arguments.workers, 1, MAX_WORKERS)
    file = SceneFile(arguments.scene, arguments.belief)
    # A pipe, as of `<(...)` in a shell, is open in this process alone.
    scene = file.load() if arguments.in_process or arguments.scene.is_fifo() else file
    if arguments.in_process:
        if n_workers > 1 or arguments.deadline is not None:
            raise ConfigError("--in-process", "goes with no --workers and no --deadline",
                              hint="only a process can be killed")
        from .operations import Operations

        return LocalEngine(Operations(scene, arguments.backend, arguments.shape_dir))
    deadline_s = DEADLINE_S if arguments.deadline is None else positive("--deadline", arguments.deadline)
    memory_bytes = worker_memory_bytes(arguments.worker_memory, n_workers)
    return WorkerPool(scene, arguments.backend, arguments.shape_dir, n_workers=n_workers, deadline_s=deadline_s,
                      slow_deadline_s=positive("--slow-deadline", arguments.slow_deadline), memory_bytes=memory_bytes,
                      log_format=arguments.log_format)


def worker_memory_bytes(given_gib: float | None, n_workers: int) -> int:
    """Data that each of so many workers may have: as given [GiB], or an even share of most of the memory.

    Raises
    ------
    ConfigError
    """
    if given_gib is None:
        return int(_SHARE_OF_MEMORY * _memory_bytes() / n_workers)
    return int(2**30 * positive("--worker-memory", given_gib))


def _memory_bytes(groups: Path = Path("/proc/self/cgroup"), root: Path = Path("/sys/fs/cgroup")) -> int:
    """Memory of the machine, or of the control group that this process is in, or of one above it."""
    found = [os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")]
    with suppress(OSError):
        # Version 2 writes `0::/path`; within a container nothing may be at that path.
        own = next((line[3:] for line in groups.read_text().splitlines() if line.startswith("0::/")), "/")
        for folder in (root / own.lstrip("/"), *(root / own.lstrip("/")).parents):
            with suppress(OSError, ValueError):  # none, or "max"
                found.append(int((folder / "memory.max").read_text()))
            if folder == root:
                break
    return min(found)


def _operators(arguments: argparse.Namespace) -> frozenset[str] | None:
    """Names of the keys that may replace the scene; None for everyone."""
    if arguments.no_load_scene:
        return frozenset()
    if arguments.operator and arguments.curve is None:
        raise ConfigError("--operator", "names a key of --curve FOLDER", arguments.operator,
                          "without keys use --no-load-scene")
    return frozenset(arguments.operator) if arguments.operator else None


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
                          "use 127.0.0.1 and an ssh tunnel"
                          + (", --curve with keys" if option == "--zmq" else "")
                          + ", or say --allow-remote on a network you trust")
    return text


if __name__ == "__main__":
    sys.exit(main())
