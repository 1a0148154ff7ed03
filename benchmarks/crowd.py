"""Throughput and fairness with 8, 64 and 256 clients of one server, each with one request in flight.

    python benchmarks/crowd.py --seconds 10 --clients 8 64 256 [--in-process]

The clients are ZeroMQ sockets in four processes, so that the server has the machine to itself as far as it can; what is
answered `busy` is asked again after the time that the server tells. `loop_ms` is the processor time of the server's
loop, the first thread of its process, for one frame; `sockets_ms` that of its other threads, which are ZeroMQ's.
Prints one JSON line for each number of clients.
"""

from __future__ import annotations

import argparse
import heapq
import json
import random
import subprocess
import sys
import tempfile
import time
from multiprocessing import get_context
from pathlib import Path

import msgpack
import numpy as np
import zmq
from glrender_client import Client
from soak import SCENE, state

N_PROCESSES, WARM_UP_S = 4, 2.0


def fly(endpoint: str, first: int, n_clients: int, seconds: float, results) -> None:
    """Frames of some clients; puts the frames of each, all waits [s], and how often the server was busy."""
    context, poller = zmq.Context(), zmq.Poller()
    sockets, asked, counts, numbers = [], [0.0] * n_clients, [0] * n_clients, [0] * n_clients
    for _ in range(n_clients):
        dealer = context.socket(zmq.DEALER)
        dealer.set(zmq.LINGER, 0)
        dealer.connect(endpoint)
        poller.register(dealer, zmq.POLLIN)
        sockets.append(dealer)
    place = {dealer: index for index, dealer in enumerate(sockets)}

    def ask(index: int) -> None:
        numbers[index] += 1
        sockets[index].send(msgpack.packb({
            "v": 1, "op": "render", "id": numbers[index], "client": f"c{first + index}", "camera": "eye",
            "state": state(numbers[index] % 4, float((first + index) * 1_000_000 + numbers[index]))}))

    began = time.monotonic()
    waits, n_busy, later = [], 0, []
    for index in range(n_clients):
        asked[index] = time.monotonic()
        ask(index)
    while (now := time.monotonic()) < began + WARM_UP_S + seconds:
        while later and later[0][0] <= now:
            ask(heapq.heappop(later)[1])
        for dealer, _ in poller.poll(10 if later else 100):
            index = place[dealer]
            header = msgpack.unpackb(dealer.recv_multipart()[0])
            now = time.monotonic()
            if header["ok"]:
                if now - began > WARM_UP_S:
                    counts[index] += 1
                    waits.append(now - asked[index])
                asked[index] = now
                ask(index)
            else:
                n_busy += header["error"]["code"] == "busy"
                pause_s = header["error"].get("retry_after_s", 0.02) * random.uniform(0.5, 1.5)
                heapq.heappush(later, (now + pause_s, index))
    results.put((counts, waits, n_busy))


def n_rendered(endpoint: str) -> int:
    """Requests to render that the server has taken."""
    with Client(endpoint) as client:
        return client.status()["requests"].get("render", 0)


def threads_ms(pid: int) -> tuple[float, float]:
    """Processor time of a process' first thread, and of its others together [ms]; proc(5), schedstat."""
    used = {int(task.name): int((task / "schedstat").read_text().split()[0]) for task in
            Path(f"/proc/{pid}/task").iterdir()}
    return 1e-6 * used[pid], 1e-6 * (sum(used.values()) - used[pid])


def measured(endpoint: str, pid: int, n_clients: int, seconds: float) -> dict:
    """Measure one row."""
    spawn = get_context("spawn")
    results, n_each = spawn.Queue(), n_clients // N_PROCESSES
    flyers = [spawn.Process(target=fly, args=(endpoint, k * n_each, n_each, seconds, results))
              for k in range(N_PROCESSES)]
    before, n_before = threads_ms(pid), n_rendered(endpoint)
    for flyer in flyers:
        flyer.start()
    found = [results.get() for _ in flyers]
    for flyer in flyers:
        flyer.join()
    n_frames = n_rendered(endpoint) - n_before
    loop_ms, sockets_ms = ((now - then) / n_frames for now, then in zip(threads_ms(pid), before, strict=True))
    counts = np.array(sum((each for each, _, _ in found), []))
    waits = np.sort(1e3 * np.array(sum((each for _, each, _ in found), [])))
    return {"clients": n_clients, "loop_ms": round(loop_ms, 3), "sockets_ms": round(sockets_ms, 3),
            "frames_per_s": round(counts.sum() / seconds, 1),
            "p50_ms": round(float(np.quantile(waits, 0.5)), 1), "p99_ms": round(float(np.quantile(waits, 0.99)), 1),
            "busy": sum(busy for _, _, busy in found), "slowest": int(counts.min()), "fastest": int(counts.max()),
            "jain": round(float(counts.sum()**2 / (len(counts) * (counts.astype(float)**2).sum())), 3)}


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--clients", type=int, nargs="+", default=[8, 64, 256])
    parser.add_argument("--workers", default="1")
    parser.add_argument("--in-process", action="store_true")
    arguments = parser.parse_args(argv)
    options = ["--in-process"] if arguments.in_process else ["--workers", arguments.workers]
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "scene.toml"
        scene.write_text(SCENE)
        process = subprocess.Popen([sys.executable, "-m", "glrender_server", str(scene), "--zmq", "tcp://127.0.0.1:*",
                                    *options], stdout=subprocess.PIPE, text=True)
        try:
            endpoint = process.stdout.readline().split()[3]
            for n_clients in arguments.clients:
                row = measured(endpoint, process.pid, n_clients, arguments.seconds)
                sys.stdout.write(json.dumps({"benchmark": "crowd", "server": " ".join(options), **row}) + "\n")
                sys.stdout.flush()
        finally:
            process.terminate()
            process.wait(30.0)
    return 0


if __name__ == "__main__":
    sys.exit(main())
