"""The socket of a client."""

from __future__ import annotations

import zmq

from .curve import Keys, set_curve
from .errors import GlrenderClientError

MAX_POLL_MS = 2**31 - 1
"""Longest time that ZeroMQ can wait."""


def positive_s(timeout_s: float) -> float:
    """A timeout [s] that is one.

    Raises
    ------
    ValueError
        It is not above 0.
    """
    if not timeout_s > 0.0:
        raise ValueError(f"timeout_s must be > 0, got {timeout_s!r}")
    return timeout_s


def connected(context: zmq.Context, endpoint: str, keys: Keys | None, socket: zmq.Socket | None = None) -> zmq.Socket:
    """A socket that talks to a server, or waits until there is one.

    Raises
    ------
    GlrenderClientError
        No such address. The socket is closed: one that never connects would hold up whoever sends, and the exit.
    """
    socket = socket or context.socket(zmq.DEALER)
    try:
        socket.set(zmq.LINGER, 0)
        set_curve(socket, keys)
        socket.connect(endpoint)
    except zmq.ZMQError as error:
        socket.close()
        raise GlrenderClientError(f"endpoint must be tcp://HOST:PORT or ipc://PATH, got {endpoint!r}: "
                                  f"{error.strerror}") from None
    return socket
