"""Price of watching: a closed loop's frames and the server's processor time, with pages open and without.

A loop asks for 512 x 512 digital numbers with nothing between two frames. Windows with pages stand each between two
without, in an order drawn by chance anew in each round, so that what else the machine does falls on all. `frozen` is a
page that reads nothing more; `hostile` one that asks everything without end and reads nothing. Pages are read by a
process of the lowest priority: a browser's own drawing is not ours. Prints one JSON line. Over the same without a page,
medians of the rounds with their standard errors: `rate`, the loop's frames per second; `quick_frame`, the time of a
frame that other work left alone (the 20 % quantile); `processor_time`, that of the server and its worker for one frame.
`server_share` is the part of one core that the server's own process, its loop and its sockets, takes more than without.
`one_answer_us` is its processor time for one answer to `watch` and `status`, of which a view asks 15 and one a second.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import math
import os
import random
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from glrender_client import Client
from websockets.asyncio.client import ClientConnection, connect

SCENE = """
max_error = 0.1
[[bodies]]
name = "body"
generated = { kind = "three_lobes", radius_m = 100.0, subdivisions = 5 }
brdf = { law = "lambert", normal_albedo = 0.2 }
[[cameras]]
name = "navcam"
width_px = 512
height_px = 512
focal_length_px = 4000.0
[cameras.model]
exposure_s = 1e-5
optics = { aperture_diameter_m = 0.01, psf_sigma_px = 0.5 }
detector = { quantum_efficiency = 0.5, full_well_electrons = 30000.0, gain_DN_per_electron = 0.1, bit_depth = 12 }
"""
STATE = {"t_s": 0.0, "r_sun_inertial_m": [1e11, 0.0, -1.1e11],
         "spacecraft": {"r_inertial_m": [0.0, 0.0, -2000.0], "q_from_inertial": [1.0, 0.0, 0.0, 0.0]},
         "bodies": {"body": {"r_inertial_m": [0.0, 0.0, 0.0], "q_from_inertial": [1.0, 0.0, 0.0, 0.0]}}}
CASES = {"one page": (1, "reading"), "ten pages": (10, "reading"), "ten pages, one frozen": (10, "frozen"),
         "hostile": (1, "hostile")}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=60, help="each has a window of every case (60)")
    parser.add_argument("--seconds", type=float, default=1.0, help="of a window (1)")
    parser.add_argument("--pages", metavar="ADDRESS", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.pages:
        os.setpriority(os.PRIO_PROCESS, 0, 19)
        asyncio.run(Reader(arguments.pages).run())
        return
    record = {"benchmark": "view", "rounds": arguments.rounds, "load_average": os.getloadavg()[0]}
    chance = random.Random(1)
    with tempfile.TemporaryDirectory() as folder, server(Path(folder)) as (endpoint, address, process), \
            reader(address) as tell, Client(endpoint, timeout_s=60.0) as client:
        window(client, process, 2.0)
        record["one_answer_us"] = one_answer_us(endpoint, process)
        found: dict[str, list[tuple[Window, Window, Window]]] = {name: [] for name in CASES}
        shown = dict.fromkeys(CASES, 0)
        before = window(client, process, arguments.seconds)
        for _ in range(arguments.rounds):
            for name in chance.sample(list(CASES), len(CASES)):
                tell("open", *CASES[name])
                watched = window(client, process, arguments.seconds)
                shown[name] += int(tell("close"))
                after = window(client, process, arguments.seconds)
                found[name].append((before, watched, after))
                before = after
    for name, windows in found.items():
        # The geometric mean: of chance alone the ratio's median is 1.
        ratios = {field: spread([getattr(b, field) / math.sqrt(getattr(a, field) * getattr(c, field))
                                 for a, b, c in windows]) for field in ("rate", "quick_frame", "processor_time")}
        record[name] = {**ratios, "server_share": spread([
            b.server_share - 0.5 * (a.server_share + c.server_share) for a, b, c in windows]),
            "shown_per_second": round(shown[name] / (arguments.rounds * arguments.seconds), 1)}
    record["loop_per_second"] = round(statistics.median(a.rate for windows in found.values() for a, _, _ in windows), 1)
    sys.stdout.write(json.dumps(record) + "\n")


def one_answer_us(endpoint: str, process: subprocess.Popen) -> dict[str, float]:
    """Processor time of the server's process for an answer, the median of some runs."""
    with Client(endpoint, shared_memory=True) as client:
        newest, found = client.watch().number, {}
        for name, ask in (("watch, with a frame", client.watch), ("watch, none newer", lambda: client.watch(newest)),
                          ("status", client.status)):
            runs = []
            for _ in range(7):
                before = processor_s(process.pid)
                for _ in range(200):
                    ask()
                runs.append((processor_s(process.pid) - before) / 200 * 1e6)
            found[name] = round(statistics.median(runs), 1)
    return found


class Window(NamedTuple):
    """Figures of one window: frames per second, a quick frame's time [s], processor times [s a frame, of one core]."""

    rate: float
    quick_frame: float
    processor_time: float
    server_share: float


def spread(values: list[float]) -> dict[str, float]:
    """Median, and the standard error of it for independent pairs."""
    error = 1.253 * statistics.stdev(values) / len(values) ** 0.5 if len(values) > 1 else float("nan")
    return {"median": round(statistics.median(values), 4), "error": round(error, 4)}


@contextlib.contextmanager
def server(folder: Path):
    (folder / "scene.toml").write_text(SCENE)
    with open(folder / "log", "wb") as log:
        process = subprocess.Popen([sys.executable, "-m", "glrender_server", str(folder / "scene.toml"), "--zmq",
                                    "tcp://127.0.0.1:*", "--view", "0", "--watch"], stdout=subprocess.PIPE, stderr=log,
                                   text=True)
        line, view = process.stdout.readline(), process.stdout.readline()
        try:
            yield line.split()[3], view.split()[2], process
        finally:
            process.terminate()
            process.wait()
            process.stdout.close()


def window(client: Client, process: subprocess.Popen, seconds: float) -> Window:
    """Run the loop for a while."""
    began, times = time.monotonic(), []
    server_s, workers_s = processor_s(process.pid), sum(map(processor_s, workers(process.pid)))
    while (elapsed := time.monotonic() - began) < seconds:
        client.render(STATE, "navcam", output="dn", seed=len(times))
        times.append(time.monotonic() - began - elapsed)
    server_s = processor_s(process.pid) - server_s
    workers_s = sum(map(processor_s, workers(process.pid))) - workers_s
    return Window(len(times) / elapsed, sorted(times)[len(times) // 5], (server_s + workers_s) / len(times),
                  server_s / elapsed)


def workers(number: int) -> list[int]:
    """Processes of the server's, but for its view."""
    children = Path(f"/proc/{number}/task/{number}/children").read_text().split()
    return [int(child) for child in children if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes()]


def processor_s(number: int) -> float:
    """The processor time of all threads of a process [s], to the nanosecond."""
    return sum(int(task.joinpath("schedstat").read_text().split()[0]) for task in Path(
        f"/proc/{number}/task").iterdir()) * 1e-9


@contextlib.contextmanager
def reader(address: str):
    """Yields a function that tells a process which pages to open or close, and returns what it answers."""
    process = subprocess.Popen([sys.executable, __file__, "--pages", address], text=True,
                               stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def tell(*said: object) -> str:
        process.stdin.write(" ".join(map(str, said)) + "\n")
        process.stdin.flush()
        return process.stdout.readline()

    try:
        yield tell
    finally:
        process.kill()
        process.wait()
        process.stdin.close()
        process.stdout.close()


class Reader:
    """Pages without a browser, opened and closed as standard input says."""

    def __init__(self, address: str):
        self._address = address.replace("http", "ws").replace("/?", "/stream?")
        self._count = 0

    async def run(self) -> None:
        """Follow what standard input says."""
        loop, stack, tasks = asyncio.get_running_loop(), contextlib.AsyncExitStack(), []
        while said := (await loop.run_in_executor(None, sys.stdin.readline)).split():
            if said[0] == "open":
                n_pages, kind = int(said[1]), said[2]
                for k in range(n_pages):
                    peer = await stack.enter_async_context(connect(
                        self._address, max_size=None, proxy=None, open_timeout=60, close_timeout=0.1))
                    tasks.append(asyncio.create_task(self._flood(peer) if kind == "hostile" else self._read(
                        peer, kind == "frozen" and k == 0)))
            else:
                for task in tasks:
                    task.cancel()
                await asyncio.gather(*tasks, return_exceptions=True)
                await stack.aclose()
                tasks = []
            sys.stdout.write(f"{self._count}\n")
            sys.stdout.flush()
            self._count = 0

    async def _read(self, peer: ClientConnection, is_frozen: bool) -> None:
        after = 0
        while True:
            await peer.send(json.dumps({"ask": "frame", "after": after, "stream": None}))
            data = await peer.recv()
            self._count += 1
            after = json.loads(data[4:4 + int.from_bytes(data[:4], "little")])["number"]
            if is_frozen:
                await asyncio.sleep(1e6)

    async def _flood(self, peer: ClientConnection) -> None:
        fields = {"after": 0, "stream": None, "number": 0, "x": 256, "y": 256, "camera": "navcam", "body": "body",
                  "azimuth_deg": 0, "elevation_deg": 0, "range_m": 2000}
        while True:
            for kind in ("frame", "status", "pixel", "free"):
                await peer.send(json.dumps({"ask": kind, **fields}))
            await asyncio.sleep(0)  # standard input has its turn


if __name__ == "__main__":
    main()
