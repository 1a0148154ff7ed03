"""A worker process: its own context and scene; headers come and go through a pipe, frames through shared memory."""

from __future__ import annotations

import pickle
import resource
import signal
import socket
from collections import OrderedDict
from collections.abc import Sequence
from functools import partial
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path

from glrender import DeviceError, GlrenderError

from . import codec, logs
from .operations import Operations, scene_asked
from .slots import offsets, room
from .stream import Channel

_MAX_ATTACHED = 16


def work(peer: socket.socket, backend: str, shape_dir: Path | None, memory_bytes: int | None, log_level: int,
         log_format: str) -> None:
    """Serve jobs until the channel closes.

    Said: ``("awake",)``, answered by the pickled scene and by the `load_scene` request that replaced it since, or
    None; ``("ready", described)`` or ``("failed", text)``; then for each ``("job", message, slot)``: ``("begun",)``,
    ``("progress", share)`` now and then from a slow frame,
    ``("need", n_bytes)`` where the slot is too small (answered by a slot's name, empty if there is none), and
    ``("done", header, sizes, code, timings_ms, warnings, described)``, the parts in the slot at their `offsets`.
    """
    # The server drains on a signal to the group; then the channel closes.
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, signal.SIG_IGN)
    logs.set_up(log_level, log_format)
    if memory_bytes is not None:
        _, most = resource.getrlimit(resource.RLIMIT_DATA)
        resource.setrlimit(resource.RLIMIT_DATA, (memory_bytes, most))
    channel = Channel(peer, is_blocking=True)
    try:
        channel.send("awake")
        scene_pickle, scene_message = channel.receive()
    except (EOFError, OSError):
        return  # the server is gone
    try:
        scene = (pickle.loads(scene_pickle) if scene_message is None
                 else scene_asked(codec.unpack_request([scene_message]), shape_dir))
        del scene_pickle
        operations = Operations(scene, backend, shape_dir)
        operations.on_progress = lambda share: channel.send("progress", share)
    except (GlrenderError, MemoryError) as error:
        channel.send("failed", str(error))
        return
    slots: OrderedDict[str, SharedMemory] = OrderedDict()
    try:
        channel.send("ready", operations.described)
        while True:
            _, message, name = channel.receive()
            channel.send("begun")
            header = codec.unpack_request([message])
            (head, *parts), code = operations.answer(header, partial(_room, channel, slots, name))
            sizes = [len(part) for part in parts]
            del parts
            described = operations.described if header["op"] == "load_scene" and not code else None
            channel.send("done", bytes(head), sizes, code, {} if code else operations.last_timings_ms,
                         operations.last_warnings, described)
    except (EOFError, OSError):
        pass  # the server is gone
    finally:
        operations.close()
        for slot in slots.values():
            slot.close()


def _room(channel: Channel, slots: OrderedDict[str, SharedMemory], name: str,
          sizes: Sequence[int]) -> list[memoryview]:
    n_bytes = offsets(sizes)[-1]
    if not name or n_bytes > _attached(slots, name).size:
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
