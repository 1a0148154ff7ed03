"""Runs in Blender's process: loads bodies once, draws frame after frame, ends with the socket.

    python serve.py FD          a Python that has bpy
    blender --background --factory-startup --python serve.py -- FD
"""

from __future__ import annotations

import os
import select
import socket
import sys
import threading
import traceback

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))

import framing


def main() -> None:
    link = socket.socket(fileno=int(sys.argv[-1]))
    # Blender prints a line for every sample; what matters goes to standard error.
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    threading.Thread(target=_end_with, args=(link.fileno(),), daemon=True).start()
    drawing = None
    try:
        import bpy
        import drawing

        framing.send(link, {"ready": bpy.app.version_string, "version": list(bpy.app.version)})
    except Exception as error:
        framing.send(link, {"failed": f"{type(error).__name__}: {error}"})
        return
    stage = None
    while True:
        try:
            head, arrays = framing.receive(link)
        except (EOFError, OSError):
            return
        try:
            if head["op"] == "load":
                stage = drawing.Stage(head, arrays)
                framing.send(link, {"done": "load"})
            elif head["op"] == "shape":
                stage.reshape(head["index"], arrays)
                framing.send(link, {"done": "shape"})
            else:
                pixels = stage.draw(head, lambda share: framing.send(link, {"progress": share}))
                framing.send(link, {"done": "draw"}, {"pixels": pixels})
        except (BrokenPipeError, ConnectionResetError):
            return
        except Exception as error:
            # Errors raised on purpose have a full message; others are bugs.
            if not isinstance(error, RuntimeError):
                traceback.print_exc()
            framing.send(link, {"failed": f"{type(error).__name__}: {error}"})


def _end_with(fd: int) -> None:
    """End this process, even amid a frame, when the other side is gone."""
    poller = select.poll()
    poller.register(fd, select.POLLHUP | select.POLLERR | getattr(select, "POLLRDHUP", 0))
    while not poller.poll(1000):
        pass
    os._exit(0)


main()
# Blender would go on to its own main loop, or crash in its clean-up.
os._exit(0)
