"""Messages to systemd (`Type=notify`): the service is ready, alive, stopping. Without systemd nothing is said.

Source: sd_notify(3), sd_watchdog_enabled(3).
"""

from __future__ import annotations

import contextlib
import logging
import os
import socket
import time

log = logging.getLogger(__name__)


class Systemd:
    """Reports the state of the server's loop to the service manager of `$NOTIFY_SOCKET`.

    A loop that stands still says nothing: after `WatchdogSec` systemd starts the server anew.
    """

    def __init__(self):
        address = os.environ.get("NOTIFY_SOCKET", "")
        # An abstract socket's name begins with a zero byte.
        self._address = "\0" + address[1:] if address.startswith("@") else address
        # Twice in the time that systemd waits.
        self._period_s = 0.5e-6 * _watchdog_us()
        self._last_s = 0.0

    def say_ready(self) -> None:
        """The sockets are bound and a renderer is there."""
        self._say("READY=1")

    def say_alive(self) -> None:
        """The loop has turned; sent as often as the watchdog wants it."""
        now = time.monotonic()
        if self._period_s > 0.0 and now - self._last_s >= self._period_s:
            self._last_s = now
            self._say("WATCHDOG=1")

    def say_stopping(self) -> None:
        """The last requests are answered."""
        self._say("STOPPING=1")

    def _say(self, line: str) -> None:
        if self._address:
            with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as peer:
                peer.setblocking(False)
                peer.sendto(line.encode(), self._address)


def _watchdog_us() -> int:
    """The time after which the service manager doubts this process [us]; 0 if it watches none, or another."""
    told, pid = os.environ.get("WATCHDOG_USEC", ""), os.environ.get("WATCHDOG_PID", "")
    if not told.isdecimal() or pid not in ("", str(os.getpid())):
        if told and not told.isdecimal():
            log.warning("WATCHDOG_USEC must be a number of microseconds, got %r: no watchdog is served", told)
        return 0
    return int(told)
