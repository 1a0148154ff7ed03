"""Many clients for a long time, with clients and workers killed on the way: is anything lost, crossed, leaked, unfair?

    python benchmarks/soak.py --frames 50000 --kill-client-every 100 --kill-worker-every 500
    python benchmarks/soak.py --seconds 600                                  # nobody is killed: fairness
    python benchmarks/soak.py --seconds 900 --kill-worker-seconds 5 --hostile
    python benchmarks/soak.py --seconds 900 --kill-worker-seconds 5 --come-and-go
    python benchmarks/soak.py --seconds 900 --kill-worker-seconds 5 --all

Every client asks for frames of its own times and checks that each reply has its time and the very pixels of its
state. Prints one JSON line; exit code 1 if a request was lost, a reply crossed or wrong, there was no worker for more
than 10 s, memory grew by 2 MiB or descriptors by 2 % (not with --hostile), or (when no client is killed) the slowest
client got less than 80 % of the fastest's frames. With --all (`beside.py`): two scenes are served in turn, and each
reply must have the pixels of the scene that it names; also where anything beside was not answered, or answered wrongly,
where the loop took a third more processor time in the second half, for a frame and in all, or SIGTERM amid it all is
not obeyed within 5 s. Both are measured with all clients flying, as the median of some
moments: a client that was killed is a descriptor for a while. The server keeps the last reply of 64 clients: memory is
flat only after as many have come, so give it 220 deaths of clients, 300 with --ipc (each reply three descriptors), or
none.
"""

from __future__ import annotations

import argparse
import faulthandler
import hashlib
import json
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
from contextlib import ExitStack, suppress
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path
from statistics import median

import beside
import hostile
from glrender_client import Client, GlrenderClientError, RequestTimeout, ServerError

SCENE = """
max_error = 0.1
[[bodies]]
name = "body"
generated = { kind = "icosphere", radius_m = 100.0, subdivisions = 4 }
brdf = { law = "lambert", normal_albedo = 0.2 }
[[cameras]]
name = "eye"
width_px = 96
height_px = 96
focal_length_px = 300.0
"""
N_PHASES, WARM_UP, WARM_UP_S = 4, 0.3, 60.0
# Without a worker that is ready, at most.
MAX_OUTAGE_S = 10.0
# Connections that come and go, at one moment, of twenty a second.
MAX_PEERS_AT_ONCE = 20
# The loop's processor time for a frame may grow so much from the first half of what is measured to the second: other
# work on the machine takes caches away.
MAX_LOOP_GROWTH = 1.33
MAX_EXIT_S = 5.0
# What 2 % were of a server that drew in its own process; requests that wait while workers start take as much.
MAX_GROWTH_MIB = 2.0
# Longer than a client waits for a frame, shorter than the test does for the run.
_STALLED_S = 90.0


def state(phase: int, t_s: float) -> dict:
    return {"t_s": t_s, "r_sun_inertial_m": [1e11 * phase, 2e10, -1e11],
            "spacecraft": {"r_inertial_m": [0.0, 0.0, -2000.0], "q_from_inertial": [1.0, 0.0, 0.0, 0.0]},
            "bodies": {"body": {"r_inertial_m": [0.0, 0.0, 0.0], "q_from_inertial": [1.0, 0.0, 0.0, 0.0]}}}


def scenes() -> list[dict]:
    """Tables of two scenes with the same names: only their light differs."""
    table = tomllib.loads(SCENE)
    body = {**table["bodies"][0], "brdf": {"law": "lambert", "normal_albedo": 0.1}}
    return [table, {**table, "bodies": [body]}]


def digest(reply) -> bytes:
    return hashlib.sha256(reply.pixels.tobytes()).digest()


def fly(endpoint: str, index: int, truth: dict[str, list[bytes]], counts, faults) -> None:
    """A client process: frames without end; what goes wrong is counted under its kind."""
    with Client(endpoint, timeout_s=60.0, retries=0) as client:
        k = 0
        while True:
            k += 1
            t_s = float(os.getpid() * 1_000_000 + k)
            try:
                reply = client.render(state(k % N_PHASES, t_s), "eye")
            except RequestTimeout:
                faults["lost"][index] += 1
                continue
            except ServerError as error:
                faults["poison" if error.code == "poison" else "other"][index] += 1
                continue
            except GlrenderClientError:
                faults["other"][index] += 1
                continue
            if reply.header["t_s"] != t_s:
                faults["crossed"][index] += 1
            elif reply.header["scene"] not in truth or digest(reply) != truth[reply.header["scene"]][k % N_PHASES]:
                faults["wrong"][index] += 1
            counts[index] += 1


def usage(process: subprocess.Popen, n_moments: int = 15) -> dict[str, float]:
    """Resident memory [MiB] and descriptors of the server's own process, median of some moments."""
    pages, descriptors = [], []
    for _ in range(n_moments):
        time.sleep(0.05)
        pages.append(int(Path(f"/proc/{process.pid}/statm").read_text().split()[1]))
        descriptors.append(len(os.listdir(f"/proc/{process.pid}/fd")))
    return {"rss_MiB": round(median(pages) * os.sysconf("SC_PAGE_SIZE") / 2**20, 1), "fds": median(descriptors)}


def loop_ms(process: subprocess.Popen) -> float:
    """Processor time of the server's loop, its process' first thread [ms]; proc(5), schedstat."""
    return 1e-6 * int(Path(f"/proc/{process.pid}/task/{process.pid}/schedstat").read_text().split()[0])


def workers_of(process: subprocess.Popen) -> list[int]:
    """Process numbers of the server's workers; from /proc, as a small Debian has no ps."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        # Others may end meanwhile.
        with suppress(OSError):
            # Behind the name, which may hold anything in brackets: the state, and the parent.
            parent = (folder / "stat").read_text().rpartition(")")[2].split()[1]
            if int(parent) == process.pid and b"spawn_main" in (folder / "cmdline").read_bytes():
                found.append(int(folder.name))
    return found


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, help="until so many frames have come")
    parser.add_argument("--seconds", type=float, help="or for so long")
    parser.add_argument("--clients", type=int, default=8)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--kill-client-every", type=int, default=0, metavar="FRAMES")
    parser.add_argument("--kill-worker-every", type=int, default=0, metavar="FRAMES")
    parser.add_argument("--kill-worker-seconds", type=float, default=0.0, metavar="S",
                        help="any of them, also one that starts")
    parser.add_argument("--hostile", action="store_true", help="beside who floods, hoards, connects and never "
                                                               "ends; one kill in five only stops the worker")
    parser.add_argument("--come-and-go", action="store_true", help="beside clients that ask and go, 20 a second, a "
                                                                   "third of them amid their message")
    parser.add_argument("--all", action="store_true", help="with those who come and go, scenes that are loaded, junk, "
                                                           "the page, metrics, and the adapter for Vizard")
    parser.add_argument("--deadline", type=float, default=30.0)
    parser.add_argument("--ipc", action="store_true", help="larger frames, which clients read in shared memory")
    arguments = parser.parse_args(argv)
    if (arguments.frames is None) == (arguments.seconds is None):
        parser.error("say either --frames or --seconds")
    arguments.come_and_go |= arguments.all
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        adapter = None
        if arguments.all:
            adapter = stack.enter_context(beside.vizard_peer.adapter(Path(folder)))
        scene = Path(folder) / "scene.toml"
        scene.write_text(SCENE.replace("96", "160") if arguments.ipc else SCENE)
        where = f"ipc://{folder}/z" if arguments.ipc else "tcp://127.0.0.1:*"
        more = ["--view", "0", "--metrics", "0", "--tcp", "127.0.0.1:0"] if arguments.all else []
        with open(Path(folder) / "log", "wb") as log:
            process = subprocess.Popen([sys.executable, "-m", "glrender_server", str(scene), "--zmq", where,
                                        "--workers", str(arguments.workers), "--deadline", str(arguments.deadline),
                                        *more],
                                       stdout=subprocess.PIPE, stderr=log, text=True)
        # Where it hangs before its first frames or after its last, its stacks tell where.
        faulthandler.dump_traceback_later(2.0 * _STALLED_S, exit=True)
        try:
            ready = process.stdout.readline()
            # The page's address follows on a line of its own.
            ready += process.stdout.readline() if arguments.all else ""
            record = soak(process, ready, adapter, arguments)
        except TimeoutError:
            sys.stderr.write((Path(folder) / "log").read_text()[-4000:])
            raise
        finally:
            faulthandler.cancel_dump_traceback_later()
            process.terminate()
            process.wait(timeout=60.0)
    sys.stdout.write(json.dumps(record) + "\n")
    return int(not record["passed"])


class Outages:
    """Watches how long the server has no worker that is ready, and how long it takes to say so."""

    def __init__(self, endpoint: str):
        self.longest_s = self.longest_status_s = 0.0
        self.n_ready = 0
        self._endpoint, self._is_over = endpoint, threading.Event()
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()

    def _watch(self) -> None:
        since = None
        with Client(self._endpoint, timeout_s=60.0) as client:
            while not self._is_over.wait(0.1):
                asked = time.monotonic()
                n_ready = self.n_ready = client.status()["workers"]["ready"]
                now = time.monotonic()
                self.longest_status_s = max(self.longest_status_s, now - asked)
                since = None if n_ready else since or asked
                self.longest_s = max(self.longest_s, now - since if since else 0.0)

    def close(self) -> None:
        """Watch no longer."""
        self._is_over.set()
        self._thread.join()


def is_due(n_frames: int, n_killed: int, every: int) -> bool:
    """Whether one more is to be killed: one for every so many frames, none where that is zero."""
    return every > 0 and n_frames >= (n_killed + 1) * every


def all_beside(ready: str, adapter: tuple[str, subprocess.Popen], served: dict[str, dict]) -> dict:
    """The function and the arguments, by name, of each thing that goes on beside the clients."""
    endpoint, address = ready.split()[3], ready.split()[5]
    metrics, page = (re.search(rf"{what} on ([^\s;)]+)", ready)[1] for what in ("metrics", "view"))
    return {"scenes": (beside.load_scenes, endpoint, served), "junk": (beside.send_junk, endpoint, address),
            "metrics": (beside.scrape, metrics), "page": (beside.look_at_page, page),
            "vizard": (beside.simulate, adapter[0])}


def soak(process: subprocess.Popen, ready: str, adapter: tuple[str, subprocess.Popen] | None,
         arguments: argparse.Namespace) -> dict:
    endpoint = ready.split()[3]
    spawn, rng = get_context("spawn"), random.Random(1)
    # Without locks, each client its own place: one killed within would hold a lock for ever.
    counts = spawn.RawArray("q", arguments.clients)
    faults = {kind: spawn.RawArray("q", arguments.clients) for kind in ("lost", "crossed", "wrong", "poison", "other")}
    with Client(endpoint, timeout_s=60.0) as client:
        truth, served = {}, {}
        for scene in scenes()[::-1] if arguments.all else [None]:
            name = client.hello()["scene"] if scene is None else client.load_scene(scene)["scene"]
            truth[name] = [digest(client.render(state(k, 0.0), "eye")) for k in range(N_PHASES)]
            served[name] = scene

    def start(index: int):
        flyer = spawn.Process(target=fly, args=(endpoint, index, truth, counts, faults), daemon=True)
        flyer.start()
        return flyer

    flyers = [start(index) for index in range(arguments.clients)]
    strangers = (*hostile.ALL * arguments.hostile, *(hostile.come_and_go,) * arguments.come_and_go)
    others = [spawn.Process(target=each, args=(endpoint,), daemon=True) for each in strangers]
    going_on = all_beside(ready, adapter, served) if arguments.all else {}
    done_beside = {name: spawn.RawArray("q", 2) for name in going_on}
    others += [spawn.Process(target=each, args=(done_beside[name], *more), daemon=True)
               for name, (each, *more) in going_on.items()]
    for other in others:
        other.start()
    outages = Outages(endpoint)
    deadline = time.monotonic() + 60.0
    while not (all(counts) and all(done[0] for done in done_beside.values())):
        if time.monotonic() > deadline:
            raise TimeoutError("a client got no frame within 60 s, or a part beside no answer")
        time.sleep(0.05)
    faulthandler.cancel_dump_traceback_later()
    first, began, before, moments = list(counts), time.monotonic(), None, []
    samples, sampled = [], 0.0
    killed = {"clients": 0, "workers": 0}
    most, moved, last_kill = 0, began, began
    while True:
        time.sleep(0.02)
        done, elapsed = sum(counts) - sum(first), time.monotonic() - began
        if done > most:
            most, moved = done, time.monotonic()
        elif time.monotonic() - moved > _STALLED_S:
            raise TimeoutError(f"no frame for {_STALLED_S:g} s after {done}; faults: "
                               f"{ {kind: list(values) for kind, values in faults.items()} }")
        share = done / arguments.frames if arguments.frames else elapsed / arguments.seconds
        # From the second minute on everything has been kept that is ever kept.
        if before is None and (share >= WARM_UP or elapsed > WARM_UP_S):
            before = usage(process)
            samples.append(before)
            adapter_before = usage(adapter[1]) if arguments.all else {}
            moments.append((share, elapsed, loop_ms(process), done))
        if before is not None and arguments.all and elapsed - sampled > 0.02 * arguments.seconds:
            sampled = elapsed
            samples.append(usage(process, n_moments=1))
        if len(moments) == 1 and share >= 0.5 * (moments[0][0] + 1.0):
            moments.append((share, elapsed, loop_ms(process), done))
        # Deaths come one a round, and a fast server gives hundreds of frames in one: it ends when none is due.
        counted = min(done, arguments.frames or done)
        is_client_due = is_due(counted, killed["clients"], arguments.kill_client_every)
        is_worker_due = is_due(counted, killed["workers"], arguments.kill_worker_every)
        if share >= 1.0 and not (is_client_due or is_worker_due):
            break
        if is_client_due:
            index = rng.randrange(arguments.clients)
            flyers[index].kill()
            flyers[index].join()
            flyers[index] = start(index)
            killed["clients"] += 1
        # A machine that takes longer to start a worker than they live would have none for ever.
        if (arguments.kill_worker_seconds and time.monotonic() - last_kill > arguments.kill_worker_seconds
                and outages.n_ready):
            last_kill, is_worker_due = time.monotonic(), True
        if is_worker_due:
            for number in rng.sample(found, 1) if (found := workers_of(process)) else []:
                killed["workers"] += 1
                if arguments.hostile and killed["workers"] % 5 == 0:
                    hostile.stop(number)
                else:
                    os.kill(number, signal.SIGKILL)
    faulthandler.dump_traceback_later(2.0 * _STALLED_S, exit=True)
    moments.append((1.0, time.monotonic() - began, loop_ms(process), sum(counts) - sum(first)))
    last, after = list(counts), usage(process)
    samples.append(after)
    adapter_after = usage(adapter[1]) if arguments.all else {}
    outages.close()
    with Client(endpoint, timeout_s=60.0) as client:
        status = client.status()
    found = {kind: sum(values) for kind, values in faults.items()}
    answered = {name: {"done": done[0], "wrong": done[1]} for name, done in done_beside.items()}
    # Amid it all.
    began_to_end = time.monotonic()
    process.terminate()
    process.wait(timeout=60.0)
    exit_s = time.monotonic() - began_to_end
    for flyer in (*flyers, *others):
        flyer.kill()
        flyer.join()
    used = [[b - a for a, b in zip(then, now, strict=True)] for then, now in pairwise(moments)]
    # Frames fall short where workers start; what else goes on does not.
    loop = {"ms_a_frame": [round(ms / max(n, 1), 3) for _, _, ms, n in used],
            "share_of_a_core": [round(1e-3 * ms / max(seconds, 1e-9), 4) for _, seconds, ms, _ in used]}
    each = [b - a for a, b in zip(first, last, strict=True)]
    fairness = min(each) / max(each)
    if arguments.all:  # a scene that is loaded lets replies go that were kept: the most of each half tells
        half = len(samples) // 2
        before, after = ({what: max(each[what] for each in part) for what in before}
                         for part in (samples[:half], samples[half:]))
    # Some of those who come and go are always there.
    is_flat = (after["rss_MiB"] <= before["rss_MiB"] + MAX_GROWTH_MIB
               and after["fds"] <= 1.02 * before["fds"] + MAX_PEERS_AT_ONCE * arguments.come_and_go)
    is_served = outages.longest_s <= MAX_OUTAGE_S
    is_fair = bool(arguments.kill_client_every) or fairness >= 0.8
    is_sound = not (found["lost"] or found["crossed"] or found["wrong"] or found["other"])
    is_answered = all(of["done"] and not of["wrong"] for of in answered.values())
    is_steady = not arguments.all or any(second <= MAX_LOOP_GROWTH * first for first, second in loop.values())
    has_ended = not arguments.all or exit_s <= MAX_EXIT_S
    return {"benchmark": "soak", "frames": sum(each), "seconds": round(elapsed, 1), "frames_each": each,
            "fairness": round(fairness, 3), "killed": killed, "faults": found, "before": before, "after": after,
            "server_errors": status["errors"], "restarts": status["workers"]["restarts"],
            "longest_outage_s": round(outages.longest_s, 2), "longest_status_s": round(outages.longest_status_s, 3),
            "is_sound": is_sound, "is_flat": is_flat,
            "beside": answered, "adapter": [adapter_before, adapter_after],
            "loop": loop, "exit_s": round(exit_s, 2),
            "is_answered": is_answered, "is_steady": is_steady, "passed": is_sound and is_answered and is_steady
            and has_ended and is_served and (is_flat or arguments.hostile) and is_fair}


if __name__ == "__main__":
    sys.exit(main())
