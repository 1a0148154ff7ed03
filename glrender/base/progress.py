"""Progress of a slow frame: its parts report their shares, and the share of the whole never falls."""

from __future__ import annotations

from collections.abc import Callable


class Progress:
    """Share of a frame that is done, 0..1.

    Parameters
    ----------
    report : callable, optional
        Called with the share whenever it has risen; what it raises gives the frame up.
    """

    def __init__(self, report: Callable[[float], None] | None):
        self._report, self._told = report, 0.0

    def part(self, begin: float, end: float) -> Callable[[float], None]:
        """A callback for a part of the whole, from one share to another; the part calls it with its own share."""
        return lambda share: self._tell(begin + share * (end - begin))

    def finish(self) -> None:
        """Report the whole as done, if a part reported anything."""
        if self._told > 0.0:
            self._tell(1.0)

    def _tell(self, share: float) -> None:
        if self._report is not None and share > self._told:
            self._told = min(share, 1.0)
            self._report(self._told)
