"""A server that a command starts for itself, in a process of its own."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from glrender import GlrenderError

_STARTUP_S = 120.0


class OwnServer:
    """A server in its own process, stopped whatever happens.

    Parameters
    ----------
    arguments : sequence
        Of `glrender-server`, but for where it listens.

    Attributes
    ----------
    page : str
        Address of the page with its frames, once `endpoint` has it; empty without.
    """

    def __init__(self, arguments: Sequence[str | Path | int]):
        self._command = [sys.executable, "-m", "glrender_server", "--zmq", "tcp://127.0.0.1:*", *map(str, arguments)]
        self._endpoint, self.page = "", ""

    def __enter__(self) -> OwnServer:
        self._process = subprocess.Popen(self._command, stdout=subprocess.PIPE)
        return self

    def endpoint(self) -> str:
        """Where it listens; waits until it does.

        Raises
        ------
        GlrenderError
            It did not start.
        """
        deadline, printed = time.monotonic() + _STARTUP_S, b""
        while not self._endpoint and time.monotonic() < deadline:
            if select.select([self._process.stdout], [], [], 0.2)[0]:
                if not (chunk := os.read(self._process.stdout.fileno(), 4096)):
                    break
                printed += chunk
                words = printed.decode(errors="replace").split()
                if b"ready" in printed and printed.endswith(b"\n"):
                    self._endpoint = next(word.rstrip(",;") for word in words if word.startswith("tcp://"))
                    self.page = next((word for word in words if word.startswith("http://")), "")
        if not self._endpoint:
            raise GlrenderError(f"the server did not start (exit code {self._process.poll()}): "
                                f"try `{' '.join(self._command)}`")
        return self._endpoint

    def __exit__(self, *exception: object) -> None:
        self._process.terminate()
        try:
            self._process.wait(timeout=10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()
