"""The server's side of its page: a child process that watches, so that the page takes no time of the server's loop."""

from __future__ import annotations

import contextlib
import json
import logging
import secrets
import subprocess
import sys
import threading
import time
from pathlib import Path

from glrender import ConfigError
from glrender_view.port import check_installed, listening

log = logging.getLogger(__name__)

_END_S = 3.0
# A process that dies is replaced after so long; pauses double up to a minute, and are short again after a longer life.
_FIRST_PAUSE_S, _LONG_S = 1.0, 60.0


class ViewProcess:
    """A process that shows a server's frames on a page.

    Parameters
    ----------
    port : int
        Of 127.0.0.1; 0 takes a free one.

    Attributes
    ----------
    address : str
        Of the page, with the token that admits its reader.

    Raises
    ------
    ConfigError
        A library that it needs is not installed.
    OSError
        The port cannot be bound.
    """

    def __init__(self, port: int):
        check_installed("--view")
        self._socket, self._token = listening("--view", port), secrets.token_urlsafe()
        self.address = f"http://127.0.0.1:{self._socket.getsockname()[1]}/?token={self._token}"
        self._process: subprocess.Popen[bytes] | None = None
        self._lock, self._closing = threading.Lock(), threading.Event()

    def start(self, endpoint: str, password: str, key_folder: Path | None) -> None:
        """Start the process, which ends with this one; one that dies is replaced, after a while that doubles.

        Parameters
        ----------
        endpoint : str
            The server's own.
        password : str
            With which it may watch.
        key_folder : path, optional
            Of a server with CURVE: the view is its client `view`.

        Raises
        ------
        ConfigError
            The folder has no key for it.
        """
        keys = None
        if key_folder is not None:
            keys = [str(key_folder / "view.key_secret"), str(key_folder / "server.key")]
            if not Path(keys[0]).is_file():
                raise ConfigError("--view", "needs a key of its own",
                                  hint=f"glrender keygen {key_folder} --client view")
        # Secrets go through the pipe: arguments and environments can be read by others.
        secret = {"endpoint": endpoint.replace("//0.0.0.0:", "//127.0.0.1:"), "password": password, "keys": keys,
                  "token": self._token, "socket": self._socket.fileno()}
        line = json.dumps(secret).encode() + b"\n"
        self._begin(line)
        threading.Thread(target=self._keep_up, args=(line,), daemon=True, name="glrender-view").start()

    def _begin(self, line: bytes) -> None:
        with self._lock:
            if self._closing.is_set():
                return
            self._process = subprocess.Popen([sys.executable, "-m", "glrender_server.view"], stdin=subprocess.PIPE,
                                             pass_fds=[self._socket.fileno()])
            with contextlib.suppress(BrokenPipeError):  # it is dead already
                self._process.stdin.write(line)
                self._process.stdin.flush()

    def _keep_up(self, line: bytes) -> None:
        pause_s = _FIRST_PAUSE_S
        while not self._closing.is_set():
            began, code = time.monotonic(), self._process.wait()
            if self._closing.is_set():
                return
            if time.monotonic() - began > _LONG_S:
                pause_s = _FIRST_PAUSE_S
            log.warning("the page's process has ended (%d); frames are served on, and another shows them in %g s",
                        code, pause_s)
            self._closing.wait(pause_s)
            pause_s = min(2.0 * pause_s, _LONG_S)
            self._begin(line)

    def close(self) -> None:
        """End the process."""
        with self._lock:
            self._closing.set()
        self._socket.close()
        if self._process is None:
            return
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
