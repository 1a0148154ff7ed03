"""Blender's process: started once, asked frame by frame, ended with us or when it takes too long."""

from __future__ import annotations

import os
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from ...base.errors import DeviceError
from .finder import blender_command
from .inside import framing

START_S = 120.0
"""Blender that has not said its version by then has failed."""


class BlenderProcess:
    """A Blender of our own that answers requests.

    It speaks through a socket pair of its own, so that whatever Blender prints disturbs nothing; it
    ends when its end of the pair is hung up, be it that this process was killed.

    Raises
    ------
    DeviceError
        No Blender, or one that does not start.
    """

    def __init__(self):
        self._link, theirs = socket.socketpair()
        # It leaves a folder behind where it is killed, as it is in the end.
        self._said, self._folder = tempfile.TemporaryFile(), tempfile.TemporaryDirectory(prefix="glrender-blender-")
        try:
            self._process = subprocess.Popen(  # noqa: S603 (this machine's Blender, with no word from the wire)
                [*blender_command(), str(theirs.fileno())], stdin=subprocess.DEVNULL, stdout=self._said,
                stderr=self._said, pass_fds=[theirs.fileno()], start_new_session=True,
                env=os.environ | {"TMPDIR": self._folder.name})
        except OSError as error:
            self._release()
            raise DeviceError(f"Blender does not start: {error}") from None
        except BaseException:
            self._release()
            raise
        finally:
            theirs.close()
        ready, _ = self._hear(time.monotonic() + START_S, lambda share: None)
        self.version: str = ready["ready"]

    @property
    def pid(self) -> int:
        """Identifier of the process."""
        return self._process.pid

    def ask(self, head: dict[str, Any], arrays: dict[str, np.ndarray] | None = None, *, deadline_s: float,
            on_progress: Callable[[float], None] | None = None) -> dict[str, np.ndarray]:
        """Send a request and wait for the answer.

        Parameters
        ----------
        deadline_s : float [s]
            Blender is killed if it takes longer.
        on_progress : callable, optional
            Called with the share done, 0..1.

        Raises
        ------
        DeviceError
            Blender failed, died or took too long; the process is then closed.
        """
        try:
            self._link.settimeout(deadline_s)
            framing.send(self._link, head, arrays)
        except OSError as error:
            raise self._failure(f"does not take the request ({error})") from None
        return self._hear(time.monotonic() + deadline_s, on_progress or (lambda share: None))[1]

    def close(self) -> None:
        """End the process."""
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        self._release()

    def _release(self) -> None:
        self._link.close()
        self._said.close()
        self._folder.cleanup()

    def _hear(self, deadline: float, on_progress: Callable[[float], None]) -> tuple[dict, dict]:
        while True:
            try:
                self._link.settimeout(max(deadline - time.monotonic(), 1e-3))
                head, arrays = framing.receive(self._link)
            except TimeoutError:
                raise self._failure("took longer than its deadline and was killed") from None
            except (EOFError, OSError):
                raise self._failure("died") from None
            except (framing.FramingError, ValueError, KeyError) as error:
                raise self._failure(f"sent bytes that are no message ({error})") from None
            if "progress" in head:
                on_progress(float(head["progress"]))
            elif "failed" in head:
                raise self._failure(f"failed: {head['failed']}")
            else:
                return head, arrays

    def _failure(self, what: str) -> DeviceError:
        """The error to raise; the process is ended, and its last lines are in the error."""
        self._said.seek(max(self._said.seek(0, 2) - 4000, 0))
        lines = [line.strip() for line in self._said.read().decode(errors="replace").splitlines() if line.strip()]
        self.close()
        return DeviceError(f"Blender {what}" + (f"; it said: {' | '.join(lines[-3:])[-400:]}" if lines else ""))
