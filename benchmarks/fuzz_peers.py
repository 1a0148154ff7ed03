"""Who talks to the server that `fuzz.py` begins: a client that means ill, and two good ones."""

from __future__ import annotations

import copy
import socket
import struct
import time
from typing import TYPE_CHECKING

import msgpack
import numpy as np
import zmq
from fuzz_messages import LOAD, STATE, Mutator, frame
from glrender_client import Client, ServerError

if TYPE_CHECKING:
    from fuzz import Tally

DEADLINE_S = 5.0
GOOD_EVERY = 1000
MAX_HELD_OPEN = 60
# Frames that a good client has under way, and requests of one that reads nothing.
N_PLACES, N_UNREAD = 4, 40


class Pair:
    """Two clients with a scene each, of the same names: a frame is that of its client's scene and of its request."""

    def __init__(self, endpoint: str, tally: Tally):
        dark = copy.deepcopy(LOAD["scene"])
        dark["bodies"][0]["brdf"]["normal_albedo"] = 0.1
        self._scenes, self._tally, self._truth, self._owners = (LOAD["scene"], dark), tally, {}, {}
        self._clients = [Client(endpoint, timeout_s=DEADLINE_S, retries=0) for _ in self._scenes]

    def __enter__(self) -> Pair:
        return self

    def __exit__(self, *exception) -> None:
        for client in self._clients:
            client.close()

    def fly(self, count: int) -> None:
        """Let each load its scene and ask for frames; the other, whose scene has gone, must be told so."""
        try:
            self._fly(count)
        except ServerError as error:
            if error.code != "scene":
                raise
            # A bad message was a good one with a scene, and its connection had gone before the scene was there.
            self._tally.answers["another scene came"] += 1

    def _fly(self, count: int) -> None:
        for own, scene in enumerate(self._scenes):
            client, other = self._clients[own], self._clients[1 - own]
            began = time.monotonic()
            loaded = client.load_scene(scene)["scene"]
            # Several under way at once, each of another moment and place.
            requests = [{"state": self._state(k, float(count + k)), "camera": "navcam"} for k in range(N_PLACES)]
            for k, reply in enumerate(client.render_many(requests, in_flight=N_PLACES)):
                told = reply.header["scene"], reply.header["t_s"]
                owner = self._owners.setdefault(reply.header["client"], own)
                if told != (loaded, float(count + k)) or owner != own:
                    self._tally.fault(f"a reply of another: {told}")
                if not np.array_equal(reply.pixels, self._truth.setdefault((own, k), reply.pixels)):
                    self._tally.fault("a good request gave other pixels")
            self._tally.waited(time.monotonic() - began)
            if count >= GOOD_EVERY:  # until it has loaded one, it takes what is served
                try:
                    other.render(STATE, "navcam")
                    self._tally.fault("a client got a frame of the other's scene")
                except ServerError as error:
                    if error.code != "scene":
                        self._tally.fault(f"of another scene: {error}")
        if len({pixels.tobytes() for pixels in self._truth.values()}) != len(self._truth):
            self._tally.fault("frames that must differ do not")

    @staticmethod
    def _state(k: int, t_s: float) -> dict:
        craft = {**STATE["spacecraft"], "r_inertial_m": [0.0, 10.0 * k, -2000.0]}
        return {**STATE, "t_s": t_s, "spacecraft": craft}


class Peer:
    """A client that means ill, on both transports."""

    def __init__(self, endpoint: str, address: tuple[str, int], mutator: Mutator, tally: Tally):
        self._endpoint, self._address, self._mutator, self._tally = endpoint, address, mutator, tally
        self._context = zmq.Context()
        self._zmq = self._context.socket(zmq.DEALER)
        self._zmq.set(zmq.LINGER, 0)
        self._zmq.connect(endpoint)
        self._tcp: socket.socket | None = None
        self._held: list[socket.socket | zmq.Socket] = []

    def __enter__(self) -> Peer:
        return self

    def __exit__(self, *exception) -> None:
        for peer in [*self._held, *([self._tcp] if self._tcp else [])]:
            peer.close()
        self._context.destroy(0)

    def by_zmq(self, burst: list[list[bytes]]) -> None:
        """Send messages over ZeroMQ, which gives one reply to each."""
        for parts in burst:
            self._zmq.send_multipart(parts)
        for parts in burst:
            if not self._zmq.poll(int(1e3 * DEADLINE_S)):
                self._tally.fault(f"no reply to one of {parts!r} and its like")
                return
            reply = self._zmq.recv_multipart()
            # What begins with an empty part is a REQ socket's, and so is its reply.
            self._tally.take(reply[1] if reply[0] == b"" else reply[0])

    def by_tcp(self, burst: list[list[bytes]]) -> None:
        """Send frames over TCP: each sound one gets a reply; a spoilt or cut stream may end with its connection."""
        rng = self._mutator.rng
        stream, kind = b"".join(map(frame, burst)), rng.random()
        if self._tcp is None:
            self._tcp = self._connect()
        if kind < 0.6:
            self._tcp.sendall(stream)
            for _ in burst:
                self._tally.take(self._receive())
            return
        try:
            self._tcp.sendall(self._mutator.spoilt(stream[:12], 1) + stream[12:] if kind < 0.8
                              else stream[:rng.randrange(len(stream))])
        except OSError:
            pass  # hung up on, as it should be
        if rng.random() < 0.5:
            self._tcp.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self._tcp.close()
        self._tcp = None
        self._tally.answers["connection closed"] += len(burst)

    def hold_one_open(self) -> None:
        """Half a message and silence; or a request whose reply is not read."""
        rng = self._mutator.rng
        whole = frame([msgpack.packb({"v": 1, "op": "render", "id": 1, "client": f"slow{rng.random()}", "state": STATE,
                                      "camera": "navcam", "products": ["r_body", "range"]})])
        slow = self._connect(receive_buffer=2048)
        slow.sendall(whole * 4 if rng.random() < 0.5 else whole[:rng.randrange(1, len(whole))])
        self._hold(slow)

    def leave_unread(self) -> None:
        """Ask over ZeroMQ for what is answered at once, and for frames, and read none of it."""
        peer = self._context.socket(zmq.DEALER)
        for option, value in ((zmq.LINGER, 0), (zmq.RCVHWM, 1), (zmq.RCVBUF, 4096)):
            peer.set(option, value)
        peer.connect(self._endpoint)
        name = f"unread{self._mutator.rng.random()}"
        for number in range(N_UNREAD):
            op = self._mutator.rng.choice([{"op": "hello"}, {"op": "status"},
                                           {"op": "render", "state": STATE, "camera": "navcam"}])
            peer.send(msgpack.packb({"v": 1, "id": number, "client": name, **op}))
        self._hold(peer)

    def go_amid_answer(self) -> None:
        """Ask over TCP for frames, read a part of the answer and close, or reset, the connection."""
        rng = self._mutator.rng
        going = self._connect(receive_buffer=2048)
        name = f"going{rng.random()}"
        going.sendall(b"".join(frame([msgpack.packb({
            "v": 1, "op": "render", "id": k, "client": name, "state": STATE, "camera": "navcam",
            "products": ["r_body", "range"]})]) for k in range(4)))
        going.recv(rng.randrange(1, 1000))
        if rng.random() < 0.5:
            going.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        going.close()

    def _hold(self, peer: socket.socket | zmq.Socket) -> None:
        self._held.append(peer)
        while len(self._held) > MAX_HELD_OPEN:
            self._held.pop(0).close()

    def _connect(self, receive_buffer: int = 0) -> socket.socket:
        peer = socket.socket()
        if receive_buffer:
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        peer.settimeout(DEADLINE_S)
        peer.connect(self._address)
        return peer

    def _receive(self) -> bytes:
        """The header of the next reply."""
        exactly = lambda size: self._tcp.recv(size, socket.MSG_WAITALL) if size else b""  # noqa: E731
        _, n_parts, _ = struct.unpack("<4sHH", exactly(8))
        header, *rest = [exactly(size) for size in struct.unpack(f"<{n_parts}I", exactly(4 * n_parts))]
        return header
