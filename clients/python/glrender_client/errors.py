"""What can go wrong between a client and the service."""

from __future__ import annotations


class GlrenderClientError(Exception):
    """Base of all that this package raises."""


class RequestTimeout(GlrenderClientError, TimeoutError):
    """No reply within the time allowed, on any try."""

    @classmethod
    def after(cls, endpoint: str, op: str, timeout_s: float, n_tries: int, presence: str) -> RequestTimeout:
        """Of an operation that was tried so often, for so long each time [s]; `presence` is of `told_presence`."""
        why = ("; a large shape takes minutes the first time: give load_scene a longer `timeout_s`"
               if op == "load_scene" else "")
        return cls(f"{endpoint} did not answer `{op}` within {timeout_s:g} s, {n_tries} times: {presence}{why}")


class ServerError(GlrenderClientError):
    """The server refused the request.

    Attributes
    ----------
    code : str
        ``config``, ``scene``, ``shape``, ``protocol``, ``device``, ``shader``, ``busy``, ``closing``,
        ``internal``.
    path : str
        The field that is wrong, e.g. ``state.spacecraft.q_from_inertial``.
    message : str
    """

    def __init__(self, code: str, path: str, message: str):
        super().__init__(f"[{code}] {message}")
        self.code, self.path, self.message = code, path, message


class Busy(ServerError):
    """The server's queue is full; the same request later will do."""
