"""`glrender-vizard [MAP.toml]`: draw the camera images of Basilisk simulations, in Vizard's place, until SIGTERM."""

from __future__ import annotations

import argparse
import gc
import logging
import os
import signal
import sys
from collections.abc import Hashable
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path

from glrender import ConfigError, GlrenderError, __version__
from glrender_camera.validate import integer, positive
from glrender_server import limits, logs
from glrender_server.__main__ import DEADLINE_S, MAX_WORKERS, checked_endpoint, worker_memory_bytes
from glrender_server.metrics import MetricsServer
from glrender_server.server import Server
from glrender_server.workers import WorkerPool
from glrender_server.zmq_front import ZmqFront

from .bodies import BodyMap
from .dispatcher import VizardDispatcher
from .engines import Engines, memory_shares
from .frames import make_scene
from .limits import MAX_MESSAGE_BYTES
from .pictures import Pictures
from .recorded import FrameFiles, replay, tap

ENDPOINT = "tcp://127.0.0.1:5556"
# Name and delimiter of the connection, and the four parts of an update.
_MAX_PARTS = 6
# A message that is a little too large is answered; beyond this the connection is closed.
_MAX_PART_BYTES = MAX_MESSAGE_BYTES * 3 // 2
_IGNORED = ("-batchmode", "-saveMetrics", "-saveMsgFile", "--args")


def main(argv: list[str] | None = None) -> int:
    """Entry point of the console script."""
    arguments = _parser().parse_args(argv)
    logs.set_up(logging.DEBUG if arguments.verbose else logging.INFO, arguments.log_format)
    try:
        body_map = BodyMap() if arguments.map is None else BodyMap.load(arguments.map)
        if arguments.replay is not None or arguments.tap is not None:
            with closing(FrameFiles(arguments.out, body_map, arguments.backend)) as made:
                n_written = (_tap(arguments.tap, made) if arguments.replay is None
                             else replay(arguments.replay, made))
            logs.say(f"glrender-vizard wrote {n_written} images to {arguments.out}")
            return 0
        _serve(arguments, body_map)
    except (GlrenderError, OSError) as error:
        sys.stderr.write(f"glrender-vizard: {error}\n")
        return 1
    logs.say("glrender-vizard stopped")
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="glrender-vizard", description=__doc__)
    parser.add_argument("--version", action="version", version=f"glrender-vizard {__version__}")
    parser.add_argument("map", nargs="?", type=Path, default=os.environ.get("GLRENDER_VIZARD_MAP"),
                        help="map from Basilisk's names to shapes, laws and cameras (TOML); default "
                             "$GLRENDER_VIZARD_MAP, else every body is a grey sphere")
    # Basilisk's examples start Vizard with one of the last two; both modes are served at once.
    parser.add_argument("--zmq", "-noDisplay", "-directComm", default=ENDPOINT, metavar="ENDPOINT",
                        help=f"where to listen ({ENDPOINT}), as the simulations' reqComAddress and reqPortNumber say")
    parser.add_argument("--tap", metavar="ENDPOINT", help="draw what a simulation broadcasts, e.g. "
                                                          "tcp://127.0.0.1:5570, to files; it does not wait for them")
    parser.add_argument("--replay", "-loadFile", type=Path, metavar="FILE",
                        help="draw a recording (_UnityViz.bin) to files")
    parser.add_argument("--out", type=Path, default=Path("frames"), help="folder of --replay and --tap (frames)")
    parser.add_argument("--workers", type=int, default=1, metavar="N", help="processes that draw, for each scene (1)")
    parser.add_argument("--deadline", type=float, default=DEADLINE_S, metavar="S",
                        help=f"give up a frame that takes longer ({DEADLINE_S:g} s)")
    parser.add_argument("--worker-memory", type=float, metavar="GIB",
                        help="data that a process may have: fewer scenes are open where all together had more than "
                             "four fifths of the machine's memory; default: an even share of that")
    parser.add_argument("--backend", default="auto", help="auto, egl, osmesa, or a plug-in such as raytrace")
    parser.add_argument("--allow-remote", action="store_true",
                        help="listen beyond this machine, unencrypted, for anyone who can reach the port")
    parser.add_argument("--metrics", type=int, metavar="PORT",
                        help="serve Prometheus metrics on http://127.0.0.1:PORT/metrics; 0 takes a free one")
    parser.add_argument("--log-format", choices=logs.FORMATS, default="text")
    parser.add_argument("-v", "--verbose", action="store_true")
    parser.add_argument(*_IGNORED, action="store_true", dest="ignored", help="Vizard's, without an effect here")
    return parser


def _serve(arguments: argparse.Namespace, body_map: BodyMap) -> None:
    endpoint = checked_endpoint(arguments.zmq, arguments.allow_remote)
    n_workers = integer("--workers", arguments.workers, 1, MAX_WORKERS)
    given_bytes = None if arguments.worker_memory is None else worker_memory_bytes(arguments.worker_memory, n_workers)
    max_scenes, memory_bytes = memory_shares(worker_memory_bytes(None, 1), n_workers, given_bytes)
    options = {"n_workers": n_workers,
               "deadline_s": positive("--deadline", arguments.deadline), "log_format": arguments.log_format,
               "memory_bytes": memory_bytes,
               "operations": Pictures}

    def make(key: Hashable) -> WorkerPool:
        return WorkerPool(make_scene(key, body_map), arguments.backend, **options)

    with ExitStack() as stack:
        of_zmq, _ = limits.max_connections()
        front = stack.enter_context(closing(ZmqFront(endpoint, None, of_zmq, _MAX_PARTS, _MAX_PART_BYTES)))
        engines = stack.enter_context(closing(Engines(make, max_scenes)))
        dispatcher = VizardDispatcher(engines, body_map)
        said = ""
        if arguments.metrics is not None:
            metrics = stack.enter_context(closing(MetricsServer(
                integer("--metrics", arguments.metrics, 0, 65535), dispatcher.metrics)))
            said = f" (metrics on {metrics.endpoint})"
        # Modules that are loaded are no garbage; looking through them takes a millisecond a frame.
        gc.freeze()
        # Scripts wait for this line; logs go to standard error.
        Server(dispatcher, engines, [front]).serve(
            partial(logs.say, f"glrender-vizard ready on {front.endpoint}{said}"))


def _tap(endpoint: str, made: FrameFiles) -> int:
    if not endpoint.startswith(("tcp://", "ipc://")):
        raise ConfigError("--tap", "must be tcp://HOST:PORT or ipc:///PATH", endpoint)
    stopped: list[int] = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda number, _: stopped.append(number))
    logs.say(f"glrender-vizard listens to {endpoint}")
    return tap(endpoint, made, lambda: bool(stopped))


if __name__ == "__main__":
    sys.exit(main())
