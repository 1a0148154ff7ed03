"""A renderer belongs to the process that made it: what it has opened does not live in another."""

from __future__ import annotations

import os

from .errors import DeviceError


class OwnProcess:
    """Remembers which process made a renderer, and refuses any other; a member of what must not be pickled."""

    def __init__(self):
        self._pid = os.getpid()

    @property
    def is_here(self) -> bool:
        """Whether this process made the renderer."""
        return os.getpid() == self._pid

    def check(self) -> None:
        """Refuse a process that did not make the renderer.

        Raises
        ------
        DeviceError
        """
        if not self.is_here:
            raise DeviceError(f"this renderer belongs to process {self._pid}, and this is {os.getpid()}, forked from "
                              "it; make one renderer in each process (a DataLoader's worker: in `worker_init_fn`, or "
                              "when it is first asked for an item)")

    def __reduce__(self):
        raise TypeError("a renderer cannot be sent to another process; send the scene, which can, and make one "
                        "renderer in each process")
