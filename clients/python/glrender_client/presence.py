"""Whether a server that did not answer is there: a busy one still shakes hands, as ZeroMQ's own thread does that."""

from __future__ import annotations

import time

import zmq
from zmq.utils.monitor import recv_monitor_message

from .connection import connected
from .curve import Keys
from .errors import GlrenderClientError

PROBE_S = 1.0
"""Time within which a handshake on a network is over [s]."""
_REFUSED = (zmq.Event.HANDSHAKE_FAILED_AUTH, zmq.Event.HANDSHAKE_FAILED_PROTOCOL,
            zmq.Event.HANDSHAKE_FAILED_NO_DETAIL, zmq.Event.DISCONNECTED)


def told_presence(endpoint: str, keys: Keys | None) -> str:
    """The finding of a new connection to an endpoint, in words that say what to do."""
    context = zmq.Context()
    try:
        found = _found(context, endpoint, keys)
    except GlrenderClientError as error:
        return str(error)
    finally:
        context.destroy(linger=0)
    if found == zmq.Event.HANDSHAKE_SUCCEEDED:
        return ("a server is there, and busy, with this request or with others before it; give a longer `timeout_s`, "
                "or ask for less, as by a larger `max_error`")
    if found is None:
        return "nothing listens there; is glrender-server running there?"
    return ("something listens there, and does not greet as glrender-server does: a server that is stopped, one with "
            "CURVE, which needs `key` and `server_key`, or another program")


def _found(context: zmq.Context, endpoint: str, keys: Keys | None) -> zmq.Event | None:
    """The last event of a new connection before the time is over, or None for no connection."""
    socket = context.socket(zmq.DEALER)
    monitor, last = socket.get_monitor_socket(zmq.EVENT_ALL), None
    connected(context, endpoint, keys, socket)
    deadline = time.monotonic() + PROBE_S
    while (left := deadline - time.monotonic()) > 0.0 and monitor.poll(int(1e3 * left)):
        event = recv_monitor_message(monitor)["event"]
        if event == zmq.Event.HANDSHAKE_SUCCEEDED or event in _REFUSED:
            return event
        if event == zmq.Event.CONNECTED:
            last = event
    return last
