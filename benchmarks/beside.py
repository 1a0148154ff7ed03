"""Strangers and operators of `soak.py --all` beside its clients; each is a process that does one thing until its end.

Each counts in `done[0]` what went well and in `done[1]` what did not.
"""

from __future__ import annotations

import json
import os
import random
import socket
import sys
import time
import urllib.request
from contextlib import suppress
from pathlib import Path

import zmq
from glrender_client import Client, GlrenderClientError, ServerError

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
import vizard_peer

# Longest that a part of the service may take to answer beside all the others, on a busy machine.
PATIENCE_S = 60.0
# Each scene is served for so long.
SCENE_S = 4.0
# What a worker that was killed amid a load answers, or a server that ends.
_ALLOWED_OF_LOADS = {"poison", "busy", "closing"}
_N_PLACES = 5


def load_scenes(done, endpoint: str, scenes: dict[str, dict]) -> None:
    """Serve the scenes in turn, by their digests: the reply says which it is."""
    with Client(endpoint, timeout_s=PATIENCE_S, retries=0) as client:
        while True:
            for digest, scene in scenes.items():
                try:
                    is_right = client.load_scene(scene)["scene"] == digest
                except ServerError as error:
                    is_right = error.code in _ALLOWED_OF_LOADS
                except GlrenderClientError:
                    is_right = False
                done[0 if is_right else 1] += 1
                time.sleep(SCENE_S)


def send_junk(done, endpoint: str, address: str) -> None:
    """Send random bytes over ZeroMQ, which are answered, and over TCP, where the connection ends."""
    rng, place = random.Random(os.getpid()), address.rsplit(":", 1)
    dealer = zmq.Context.instance().socket(zmq.DEALER)
    dealer.connect(endpoint)
    while True:
        dealer.send(rng.randbytes(rng.randrange(1, 1000)))
        done[0 if dealer.poll(int(1e3 * PATIENCE_S)) and dealer.recv_multipart() else 1] += 1
        with suppress(OSError), socket.create_connection((place[0], int(place[1])), PATIENCE_S) as raw:
            raw.sendall(b"GLR1"[:rng.randrange(5)] + rng.randbytes(rng.randrange(1, 1000)))
        time.sleep(0.05)


def scrape(done, url: str) -> None:
    """Read the metrics, as a Prometheus does."""
    while True:
        try:
            with urllib.request.urlopen(url, timeout=PATIENCE_S) as reply:  # noqa: S310, the server's own address
                done[0 if b"glrender_requests_total" in reply.read() else 1] += 1
        except OSError:
            done[1] += 1
        time.sleep(1.0)


def look_at_page(done, url: str) -> None:
    """Ask for frames as the page of --view does; it is opened anew every so often."""
    from websockets.sync.client import connect

    stream = url.replace("http", "ws", 1).replace("/?", "/stream?")
    while True:
        after = 0
        try:
            with connect(stream, max_size=None, proxy=None, open_timeout=PATIENCE_S) as peer:
                for _ in range(200):
                    peer.send(json.dumps({"ask": "frame", "after": after, "stream": None}))
                    data = peer.recv(timeout=PATIENCE_S)
                    after = json.loads(data[4:4 + int.from_bytes(data[:4], "little")])["number"]
                    done[0] += 1
        except Exception:  # whatever it is, the page was not shown
            done[1] += 1
            time.sleep(1.0)


def simulate(done, endpoint: str) -> None:
    """Ask the adapter for images of a few places of a body: each place has its own picture, always the same."""
    truth: dict[int, bytes] = {}
    with vizard_peer.Peer(endpoint, PATIENCE_S) as peer:
        for number in range(10**9):
            place = number % _N_PLACES
            is_right = peer.update(vizard_peer.scene((4.0 * place, 0.0), t_ns=10**9 * number)) == [b"OK"]
            picture = peer.image_bytes()
            is_right = is_right and bool(picture) and picture == truth.setdefault(place, picture)
            done[0 if is_right and len(set(truth.values())) == len(truth) else 1] += 1
            time.sleep(0.2)
