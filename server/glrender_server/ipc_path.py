"""Unix sockets of `ipc://` endpoints: a path that another server uses, or that is no socket, is never taken."""

from __future__ import annotations

import contextlib
import fcntl
import os
import socket
import stat
from pathlib import Path


def claimed(endpoint: str) -> Claim | None:
    """The path of an `ipc://` endpoint, ours until `Claim.release`; None for another transport.

    Raises
    ------
    OSError
        A server listens there, or something that is no socket.
    """
    # Names that begin with @ are not in the file system.
    path = endpoint.removeprefix("ipc://")
    return None if path == endpoint or path.startswith("@") else Claim(Path(path))


class Claim:
    """A socket's path, and the lock on a file next to it by which a server owns it.

    Parameters
    ----------
    path : path

    Raises
    ------
    OSError
    """

    def __init__(self, path: Path):
        self._path = path
        self._lock_path = path.with_name(path.name + ".lock")
        try:
            status = path.lstat()
        except FileNotFoundError:
            status = None
        if status is not None and not stat.S_ISSOCK(status.st_mode):
            raise OSError(f"cannot listen on ipc://{path}: there is a file that is no socket; choose another path")
        self._lock = os.open(self._lock_path, os.O_CREAT | os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            is_free = status is None or not _answers(path)
        except BlockingIOError:
            is_free = False
        if not is_free:
            os.close(self._lock)
            raise OSError(f"cannot listen on ipc://{path}: a server listens there; stop it or choose another path")

    def restrict(self) -> None:
        """Let only our own user connect, once the socket is bound."""
        os.chmod(self._path, 0o600)

    def release(self) -> None:
        """Another server may have it."""
        with contextlib.suppress(OSError):
            self._lock_path.unlink()
        os.close(self._lock)


def _answers(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX) as peer:
        peer.setblocking(False)
        try:
            peer.connect(str(path))
        except BlockingIOError:
            return True  # its queue is full
        except OSError:
            return False
    return True
