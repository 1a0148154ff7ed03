"""Hostile clients that `soak.py --hostile` starts beside the honest ones: each does one thing until it ends."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import struct
import time

import msgpack
import zmq


def _dealer(endpoint: str) -> zmq.Socket:
    dealer = zmq.Context.instance().socket(zmq.DEALER)
    dealer.set(zmq.LINGER, 0)
    dealer.connect(endpoint)
    return dealer


def flood(endpoint: str) -> None:
    """Send junk of one byte, some thousand a second, and read nothing."""
    dealer = _dealer(endpoint)
    while True:
        for _ in range(20):
            with contextlib.suppress(zmq.Again):
                dealer.send(b"x", zmq.NOBLOCK)
        time.sleep(0.01)


def fill_headers(endpoint: str) -> None:
    """Send headers of a million empty maps."""
    dealer = _dealer(endpoint)
    header = b"\x81\xa1a" + b"\xdd" + (10**6).to_bytes(4, "big") + b"\x80" * 10**6
    while True:
        dealer.send(header)
        dealer.poll(1000)
        time.sleep(0.5)


def hoard(endpoint: str) -> None:
    """Ask for frames and read none."""
    dealer = _dealer(endpoint)
    dealer.set(zmq.RCVHWM, 1)
    from soak import state  # this file is run by it

    for number in range(10**9):
        dealer.send(msgpack.packb({"v": 1, "op": "render", "id": number, "client": "hoard", "camera": "eye",
                                   "state": state(0, float(number))}))
        time.sleep(0.1)


def _spoken_to(endpoint: str) -> socket.socket:
    """A connection that has shaken hands as a DEALER; ZMTP 3.0 (RFC 23) by hand, as a library ends its messages."""
    host, _, port = endpoint.removeprefix("tcp://").rpartition(":")
    raw = socket.create_connection((host, int(port)), 5.0)
    raw.sendall(b"\xff" + bytes(8) + b"\x7f\x03\x00" + b"NULL".ljust(20, b"\0") + bytes(32))
    ready = b"\x05READY\x0bSocket-Type" + struct.pack(">I", 6) + b"DEALER"
    raw.sendall(bytes([4, len(ready)]) + ready)
    # A message that comes with the handshake is lost by libzmq: wait for its own, of 64 bytes and READY.
    with raw.makefile("rb") as theirs:
        theirs.read(64)
        theirs.read(theirs.read(2)[1])
    return raw


def come_and_go(endpoint: str) -> None:
    """Ask for a frame and go, twenty times a second (a client that crashes): a third of them amid their message."""
    from soak import state  # this file is run by it

    for number in range(10**9):
        message = msgpack.packb({"v": 1, "op": "render", "id": 1, "client": f"gone{number}", "camera": "eye",
                                 "state": state(0, float(number))})
        frame = b"\x02" + struct.pack(">Q", len(message)) + message
        with contextlib.suppress(OSError), _spoken_to(endpoint) as raw:
            raw.sendall(frame[:len(frame) // 2] if number % 3 == 0 else frame)
            raw.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", number % 2, 0))
        time.sleep(0.05)


def never_end(endpoint: str) -> None:
    """Begin a message of many parts and do not end it, again and again."""
    while True:
        with contextlib.suppress(OSError), _spoken_to(endpoint) as raw:
            while True:
                raw.sendall(b"\x03" + struct.pack(">Q", 2**20) + bytes(2**20))
        time.sleep(2.0)


def connect(endpoint: str) -> None:
    """Hold connections open that say nothing."""
    host, _, port = endpoint.removeprefix("tcp://").rpartition(":")
    held: list[socket.socket] = []
    while True:
        with contextlib.suppress(OSError):
            held.append(socket.create_connection((host, int(port))))
        if len(held) > 300:
            held.pop(0).close()
        time.sleep(0.05)


def stop(number: int) -> None:
    """Stop a worker as a debugger or a driver does; the server ends it at its deadline."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(number, signal.SIGSTOP)


ALL = (flood, fill_headers, hoard, never_end, connect)
