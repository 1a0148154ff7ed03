"""Errors between a client and the service."""

from __future__ import annotations

import random
import time

# A pause grows by half with each `busy` in a row, up to 5 s.
_GROWTH, _MAX_PAUSE_S = 1.5, 5.0


class GlrenderClientError(Exception):
    """Base of all that this package raises."""


class RequestTimeout(GlrenderClientError, TimeoutError):
    """The server gave no reply within the time allowed, on any try."""

    @classmethod
    def after(cls, endpoint: str, op: str, timeout_s: float, n_tries: int, presence: str) -> RequestTimeout:
        """The error of an operation after `n_tries` of `timeout_s` each [s]; `presence` is of `told_presence`."""
        why = ("; a large shape takes minutes the first time: give load_scene a longer `timeout_s`"
               if op == "load_scene" else "")
        return cls(f"{endpoint} did not answer `{op}` within {timeout_s:g} s, {n_tries} times: {presence}{why}")


class ServerError(GlrenderClientError):
    """The server refused the request.

    Attributes
    ----------
    code : str
        ``config``, ``scene``, ``shape``, ``protocol``, ``device``, ``shader``, ``busy``, ``forbidden``,
        ``poison``, ``closing``, ``internal``.
    path : str
        The field that is wrong, e.g. ``state.spacecraft.q_from_inertial``.
    message : str
    """

    def __init__(self, code: str, path: str, message: str):
        super().__init__(f"[{code}] {message}")
        self.code, self.path, self.message = code, path, message


class Busy(ServerError):
    """The server has too much to do, for all of the time that the request was given.

    Attributes
    ----------
    retry_after_s : float [s]
        When the server wants to be asked again.
    """

    def __init__(self, code: str, path: str, message: str, retry_after_s: float = 0.05):
        super().__init__(code, path, message)
        self.retry_after_s = retry_after_s

    def pause_s(self, n_before: int) -> float:
        """Pause [s] after this error and `n_before` others in a row: longer each time, with a random part."""
        chance = random.uniform(0.5, 1.5)  # noqa: S311 - so that clients do not come back all at once
        return chance * min(self.retry_after_s * _GROWTH**min(n_before, 20), _MAX_PAUSE_S)


class Patience:
    """Goes on with one try of a request while the server is busy, until its time is over.

    Parameters
    ----------
    timeout_s : float [s]
    """

    def __init__(self, timeout_s: float):
        self._deadline, self._n_before = time.monotonic() + timeout_s, 0
        self._busy: Busy | None = None

    @property
    def left_s(self) -> float:
        """Time that is left [s]."""
        return self._deadline - time.monotonic()

    def pause_s(self, busy: Busy) -> float:
        """How long to wait before the next question [s].

        Raises
        ------
        Busy
            The time is over by then.
        """
        pause_s = busy.pause_s(self._n_before)
        if pause_s > self.left_s:
            raise busy
        self._n_before, self._busy = self._n_before + 1, busy
        return pause_s

    def check(self) -> None:
        """Nothing has come in the time that was left.

        Raises
        ------
        Busy
            The server had been busy all the while.
        """
        if self._busy is not None:
            raise self._busy
