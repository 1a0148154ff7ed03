"""A worker process: its own context and scene; headers come and go through a pipe, frames through shared memory."""

from __future__ import annotations

import contextlib
import gc
import pickle
import resource
import signal
import socket
from collections import OrderedDict
from collections.abc import Sequence
from functools import partial
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from typing import TYPE_CHECKING

from glrender import DeviceError, GlrenderError

from . import logs
from .scene_digest import scene_digest
from .scene_source import SceneFile
from .slots import mark_begun, offsets, room
from .stream import Channel

if TYPE_CHECKING:
    from glrender import Scene

    from .operations import Operations

_MAX_ATTACHED = 16


def work(peer: socket.socket, backend: str, shape_dir: Path | None, memory_bytes: int | None, log_level: int,
         log_format: str, made_of: type[Operations] | None = None) -> None:
    """Serve jobs until the channel closes.

    Said: ``("awake",)``, answered by ``("scene", pickle, digest)``, which may come again: ``("ready", described)`` or
    ``("failed", text)``. Before that, of a `SceneFile`, which has no digest, ``("opened", pickle, digest, n_facets)``
    for the other workers, or ``("unreadable", error)``. Then for each ``("job", message, slot)``, its slot marked as
    begun: ``("progress", share)`` now and then from a slow frame, ``("need", n_bytes)`` where the slot is too small
    (answered by a slot's name, empty if there is none), and ``("done", header, sizes, code, timings_ms, warnings,
    loaded)``, the parts in the slot at their `offsets`; `loaded` is None, or of a new scene its pickle, its digest, and
    its description. ``("forget",)`` lets go of all slots.
    """
    # The server drains on a signal to the group; then the channel closes.
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    logs.set_up(log_level, log_format)
    if memory_bytes is not None:
        _, most = resource.getrlimit(resource.RLIMIT_DATA)
        resource.setrlimit(resource.RLIMIT_DATA, (memory_bytes, most))
    if made_of is None:
        # Here, since the server's process, which has no renderer, starts a second sooner without it.
        from .operations import Operations as made_of
    channel = Channel(peer, is_blocking=True)
    try:
        channel.send("awake")
        _, scene_pickle, digest = channel.receive()
    except (EOFError, OSError):
        return  # the server is gone
    try:
        scene = pickle.loads(scene_pickle)
        if isinstance(scene, SceneFile):
            scene, digest = _opened(scene, channel)
            if scene is None:
                return
        loaded: list[tuple[bytes, str]] = []
        # A scene is kept as it is read, so that others need not read its files again, which may have gone or changed.
        operations = made_of(scene, backend, shape_dir, digest,
                             on_scene=lambda scene, digest: loaded.append((pickle.dumps(scene), digest)),
                             on_progress=lambda share: channel.send("progress", share))
    except (GlrenderError, MemoryError) as error:
        channel.send("failed", str(error))
        return
    del scene, scene_pickle
    # Modules that are loaded by now are no garbage; looking through them takes some tenths of a millisecond a frame.
    gc.freeze()
    slots: OrderedDict[str, SharedMemory] = OrderedDict()
    try:
        channel.send("ready", operations.described)
        while True:
            kind, *rest = channel.receive()
            if kind == "scene":
                if not _has_replaced(operations, channel, *rest):
                    return
                continue
            if kind == "forget":
                _forget(slots)
                continue
            message, name = rest
            if name:
                with contextlib.suppress(OSError):  # somebody has tidied up: a reply that needs it fails
                    mark_begun(_attached(slots, name))
            loaded.clear()
            (head, *parts), code, timings_ms, warnings = operations.answer_message(
                message, partial(_room, channel, slots, name))
            sizes = [len(part) for part in parts]
            del parts
            made = (*loaded[0], operations.described) if loaded and not code else None
            channel.send("done", bytes(head), sizes, code, timings_ms, warnings, made)
            loaded.clear()
    except (EOFError, OSError):
        pass  # the server is gone
    finally:
        operations.close()
        _forget(slots)


def _opened(file: SceneFile, channel: Channel) -> tuple[Scene | None, str]:
    """The scene of a file and its digest, which the server gets too; none where the server knows why, or is gone."""
    scene, digest = None, ""
    try:
        scene = file.load()
        digest = scene_digest(scene)
        said = "opened", pickle.dumps(scene), digest, sum(len(body.shape.facets) for body in scene.bodies)
    except GlrenderError as error:
        said = "unreadable", error
    except MemoryError:
        said = "unreadable", DeviceError("the scene needs more memory than a worker has; start the server with more "
                                         "--worker-memory")
        scene = None
    try:
        channel.send(*said)
    except OSError:
        scene = None
    return scene, digest


def _forget(slots: OrderedDict[str, SharedMemory]) -> None:
    """Let go of all shared memory: that of slots that the server has released is free then."""
    while slots:
        slots.popitem()[1].close()


def _has_replaced(operations: Operations, channel: Channel, scene_pickle: bytes, digest: str) -> bool:
    try:
        operations.replace(pickle.loads(scene_pickle), digest)
    except (GlrenderError, MemoryError) as error:
        channel.send("failed", str(error))
        return False
    channel.send("ready", operations.described)
    return True


def _room(channel: Channel, slots: OrderedDict[str, SharedMemory], name: str,
          sizes: Sequence[int]) -> list[memoryview]:
    n_bytes = offsets(sizes)[-1]
    if not name or n_bytes > _attached(slots, name).size:
        _forget(slots)
        channel.send("need", n_bytes)
        (name,) = channel.receive()
        if not name:
            raise DeviceError(f"the system has no shared memory for the {n_bytes} bytes of this reply")
    return room(_attached(slots, name), sizes)


def _attached(slots: OrderedDict[str, SharedMemory], name: str) -> SharedMemory:
    if name not in slots:
        while len(slots) >= _MAX_ATTACHED:
            slots.popitem(last=False)[1].close()
        slots[name] = SharedMemory(name)
    slots.move_to_end(name)
    return slots[name]
