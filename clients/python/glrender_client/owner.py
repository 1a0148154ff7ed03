"""A client belongs to one process and one thread: no two can use a socket of ZeroMQ, and replies would be mixed."""

from __future__ import annotations

import os
import threading

from .errors import GlrenderClientError


class Owner:
    """The process that made a client, and the thread that uses it first, or after that one's end.

    A member of what must not be pickled.
    """

    def __init__(self):
        self._pid, self._thread, self._lock = os.getpid(), None, threading.Lock()

    @property
    def is_here(self) -> bool:
        """Whether this is the process that made the client."""
        return os.getpid() == self._pid

    def check_process(self) -> None:
        """Let the process that made the client pass, and no other.

        Raises
        ------
        GlrenderClientError
        """
        if not self.is_here:
            raise GlrenderClientError(
                f"this client belongs to process {self._pid}, and this is {os.getpid()}, forked from it; make one "
                "client in each process (a DataLoader's worker: in `worker_init_fn`, or when it is first asked for an "
                "item)")

    def check(self) -> None:
        """Let one thread of the process that made the client pass.

        Raises
        ------
        GlrenderClientError
        """
        self.check_process()
        here = threading.current_thread()
        with self._lock:
            if self._thread is None or not self._thread.is_alive():
                self._thread = here
        if self._thread is not here:
            raise GlrenderClientError(
                f"this client is used by thread {self._thread.name!r}, and this is {here.name!r}; make one client in "
                "each thread, or use AsyncClient or `render_many`, which have several requests in flight")

    def __reduce__(self):
        raise TypeError("a client cannot be sent to another process; send the endpoint, and make one client in each "
                        "process")
