"""Bad messages without end: does the server die, hang, stumble, or keep a good request waiting?

    python benchmarks/fuzz.py --messages 250000 --seed 1               # codec, framing and dispatcher in this process
    python benchmarks/fuzz.py --messages 20000 --sockets               # a server behind ZeroMQ and TCP
    python benchmarks/fuzz.py --messages 20000 --sockets --workers 2

Random bytes; golden requests with bytes changed, cut or added, a value wrong, very deep or very long, or a key twice;
TCP frames changed, cut short, in odd pieces; connections that stay half open, are reset, go amid an answer, or ask and
do not read. Each message must be answered once (or its connection closed), never `internal`; every thousandth is a good
request, which must give the very pixels within its deadline: through sockets those of two clients with scenes of their
own, neither of whom may get the other's. Prints one JSON line; exit code 1 if anything was amiss.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import msgpack
from fuzz_messages import LOAD, SCENE, STATE, Mutator, frame
from fuzz_peers import DEADLINE_S, GOOD_EVERY, Pair, Peer
from glrender import generate, load_scene
from glrender_client.shared import SharedFrames
from glrender_server import slots
from glrender_server.dispatcher import Dispatcher
from glrender_server.framing import Decoder
from glrender_server.front import Request
from glrender_server.job import LocalEngine
from glrender_server.operations import Operations

# "forbidden" is `watch`, of a server that was not started with it.
ALLOWED = {"protocol", "config", "scene", "shape", "busy", "forbidden"}

class Tally:
    """Counts of the answers, and the faults found."""

    def __init__(self):
        self.answers, self.faults, self.longest_s = Counter(), [], 0.0

    def take(self, header_bytes: bytes) -> None:
        """Count one reply."""
        header = msgpack.unpackb(header_bytes)
        code = "ok" if header["ok"] else header["error"]["code"]
        self.answers[code] += 1
        self.answers["in shared memory"] += "shared" in header
        if code != "ok" and code not in ALLOWED:
            self.fault(f"{code}: {header['error']['message']}")

    def fault(self, text: str) -> None:
        """Record a fault."""
        if len(self.faults) < 20:
            self.faults.append(text[:300])

    def waited(self, seconds: float) -> None:
        """Record the time [s] that a good request took."""
        self.longest_s = max(self.longest_s, seconds)
        if seconds > DEADLINE_S:
            self.fault(f"a good request took {seconds:.1f} s")


def in_process(folder: Path, n_messages: int, seed: int) -> Tally:
    """Send messages through decoder, codec and dispatcher without sockets, as ROUTER and TCP fronts would."""
    mutator, tally = Mutator(seed), Tally()
    rng = mutator.rng
    slots.MIN_SHARED_BYTES = 1  # else none of these small frames would be left in shared memory
    engine = LocalEngine(Operations(load_scene(folder / "scene.toml"), shape_dir=folder))
    dispatcher, decoder, truth, count = Dispatcher(engine), Decoder(), None, 0

    def ask(messages: list[list[bytes]]) -> list[bytes]:
        answers = [[] for _ in messages]
        for parts, answer in zip(messages, answers, strict=True):
            dispatcher.submit(Request(rng.randrange(8), parts, answer.append))
        while dispatcher.can_work:
            dispatcher.work()
        for parts, answer in zip(messages, answers, strict=True):
            if len(answer) != 1:
                tally.fault(f"{len(answer)} replies to {parts!r}")
            for reply in answer:
                tally.take(reply[0])
        return [answer[0] for answer in answers if answer]

    while count < n_messages:
        burst = mutator.burst()
        began, count = time.monotonic(), count + len(burst)
        if rng.random() < 0.5:
            ask(burst)
        else:
            stream = b"".join(map(frame, burst))
            if rng.random() < 0.5:
                stream = mutator.spoilt(stream, 1)
            if rng.random() < 0.2:
                stream = stream[:rng.randrange(len(stream))]
            while stream:
                size = rng.choice([1, 7, 100, 5000])
                decoder.feed(stream[:size])
                stream = stream[size:]
                try:
                    ask(list(decoder.messages()))
                except Exception as error:
                    if type(error).__name__ != "ProtocolError":
                        tally.fault(f"decoder: {error!r}")
                    stream, decoder = b"", Decoder()
                    tally.answers["lost framing"] += 1
            if rng.random() < 0.1:
                decoder = Decoder()  # the client is gone within a message
        if time.monotonic() - began > DEADLINE_S:
            tally.fault(f"{len(burst)} messages took {time.monotonic() - began:.1f} s")
        if count // GOOD_EVERY != (count - len(burst)) // GOOD_EVERY or truth is None:
            began = time.monotonic()
            pixels = [bytes(part) for reply in ask(good_requests(count)) for part in in_full(reply)]
            tally.waited(time.monotonic() - began)
            truth = truth or pixels
            if pixels != truth or len(pixels) != 2 or pixels[0] != pixels[1]:
                tally.fault("a good request gave other pixels")
    dispatcher.close()
    engine.close()
    return tally


def in_full(reply: list) -> list:
    """The pixels of a reply, wherever they are."""
    place = msgpack.unpackb(reply[0]).get("shared")
    return reply[1:] if place is None else SharedFrames().parts(place)


def good_requests(count: int) -> list[list[bytes]]:
    """The scene restored, and a frame of it, over the socket and in shared memory."""
    envelope = {"v": 1, "client": "good", "id": count}
    render = {**envelope, "op": "render", "state": STATE, "camera": "navcam"}
    return [[msgpack.packb(header)] for header in ({**LOAD, **envelope}, render, {**render, "shared": True})]


def through_sockets(folder: Path, n_messages: int, seed: int, workers: int) -> Tally:
    """Send messages to a server of its own, over ZeroMQ and TCP in turn."""
    mutator, tally = Mutator(seed), Tally()
    rng = mutator.rng
    with open(folder / "log", "w+") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "glrender_server", str(folder / "scene.toml"), "--zmq", "tcp://127.0.0.1:*", "--tcp",
             "127.0.0.1:0", "--workers", str(workers), "--watch", "--shape-dir", str(folder)],
            stdout=subprocess.PIPE, stderr=log, text=True)
        try:
            words = process.stdout.readline().split()
            host, _, port = words[5].rpartition(":")
            with Peer(words[3], (host, int(port)), mutator, tally) as peer, Pair(words[3], tally) as pair:
                count = 0
                while count < n_messages:
                    burst = mutator.burst()
                    before, count = count, count + len(burst)
                    peer.by_zmq(burst) if rng.random() < 0.5 else peer.by_tcp(burst)
                    if count // 100 != before // 100:
                        rng.choice([peer.hold_one_open, peer.leave_unread, peer.go_amid_answer])()
                    if count // GOOD_EVERY != before // GOOD_EVERY or before == 0:
                        pair.fly(count)
            if process.poll() is not None:
                tally.fault(f"the server ended with {process.returncode}")
        finally:
            process.terminate()
            if process.wait(timeout=60.0):
                tally.fault(f"on SIGTERM the server ended with {process.returncode}")
        log.seek(0)
        if "Traceback" in (text := log.read()):
            tally.fault(text[text.index("Traceback"):])
    return tally


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--messages", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--sockets", action="store_true", help="to a server in its own process")
    parser.add_argument("--workers", type=int, default=1)
    arguments = parser.parse_args(argv)
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        generate.icosphere(radius_m=100.0, subdivisions=2).to_file(folder / "body.obj")
        (folder / "scene.toml").write_text(SCENE)
        if arguments.sockets:
            tally = through_sockets(folder, arguments.messages, arguments.seed, arguments.workers)
        else:
            tally = in_process(folder, arguments.messages, arguments.seed)
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    sys.stdout.write(json.dumps({
        "benchmark": "fuzz", "messages": arguments.messages, "seed": arguments.seed, "sockets": arguments.sockets,
        "workers": arguments.workers, "seconds": round(time.monotonic() - began, 1), "answers": dict(tally.answers),
        "longest_good_s": round(tally.longest_s, 3), "faults": tally.faults,
        "rss_MiB": round(pages * os.sysconf("SC_PAGE_SIZE") / 2**20, 1), "passed": not tally.faults}) + "\n")
    return int(bool(tally.faults))


if __name__ == "__main__":
    sys.exit(main())
