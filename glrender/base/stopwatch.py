"""A stopwatch for the steps of a frame."""

from __future__ import annotations

import time


class Clock:
    """Laps in milliseconds, added up by name."""

    def __init__(self):
        self.laps_ms: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        """End a lap."""
        now = time.perf_counter()
        self.laps_ms[name] = self.laps_ms.get(name, 0.0) + 1e3 * (now - self._last)
        self._last = now
