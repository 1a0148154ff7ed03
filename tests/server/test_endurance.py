"""Short runs of what `benchmarks/soak.py` and `benchmarks/fuzz.py` do for long: nothing is lost, crossed or ended."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import msgpack
import numpy as np
import pytest
import serving
import views
import zmq
from cells import slow_but
from glrender_client import Client
from serving import Framed

REPOSITORY = Path(__file__).parents[2]
STATE = views.state().to_dict()


@pytest.mark.slow
@pytest.mark.parametrize("where", [[], ["--ipc"]], ids=["tcp", "shared memory"])
def test_killed_clients_and_workers_lose_no_request(where):
    soak = str(REPOSITORY / "benchmarks" / "soak.py")
    run = subprocess.run([sys.executable, soak, *where, "--frames", "500", "--clients", "4",
                          "--kill-client-every", "50", "--kill-worker-every", "150"],
                         capture_output=True, text=True, timeout=300)
    assert run.stdout, run.stderr
    record = json.loads(run.stdout)
    assert record["is_sound"] and record["frames"] >= 500, run.stdout
    assert record["killed"] == {"clients": 10, "workers": 3} and record["restarts"] >= 1, run.stdout


def soaked(*arguments):
    """The record of a run of the soak beside all that a stranger, an operator and a monitor do, ended amid it."""
    run = subprocess.run([sys.executable, str(REPOSITORY / "benchmarks" / "soak.py"), "--all", *arguments],
                         capture_output=True, text=True, timeout=400)
    assert run.stdout, run.stderr
    record = json.loads(run.stdout)
    assert record["is_sound"] and record["is_answered"] and record["restarts"] >= 1, run.stdout
    assert set(record["beside"]) == {"scenes", "junk", "metrics", "page", "vizard"}
    # 5 s where nothing else runs, which `passed` of the soak itself asks for; tests share two cores.
    assert record["exit_s"] <= 15.0, run.stdout
    return record


def test_clients_that_ask_and_go_leave_no_descriptor(tmp_path):
    """The last replies of 64 clients are kept; whoever came before them took descriptors for good."""
    with serving.server(tmp_path, "--workers", "1") as (endpoint, process), zmq.Context() as context:
        def n_open_after(clients):
            for number in clients:
                with context.socket(zmq.DEALER) as dealer:
                    dealer.set(zmq.LINGER, 0)
                    dealer.connect(endpoint)
                    dealer.send(msgpack.packb({"v": 1, "op": "render", "id": 1, "client": f"gone{number}",
                                               "camera": "bare", "state": {**STATE, "t_s": float(number)}}))
                    # Every other is gone before its reply comes.
                    dealer.poll(20_000 if number % 2 else 5)
            with Client(endpoint, timeout_s=30.0) as client:
                client.render(STATE, "bare")
            time.sleep(0.3)
            return len(os.listdir(f"/proc/{process.pid}/fd"))

        most = n_open_after(range(160)) + 20
        assert n_open_after(range(160, 320)) <= most


def test_a_soak_of_seconds_loses_and_crosses_nothing_and_ends_when_it_is_asked_to():
    """SIGTERM was not obeyed beside clients that ask and go."""
    soaked("--seconds", "4", "--clients", "2", "--kill-worker-seconds", "2")


@pytest.mark.slow
def test_a_soak_of_a_minute_is_flat():
    """Memory, descriptors and the loop's time. A leak of each peer's descriptor would be 600 from half to half."""
    record = soaked("--seconds", "60", "--clients", "4", "--kill-worker-seconds", "5")
    before, after = record["before"], record["after"]
    assert record["restarts"] >= 2 and record["is_steady"], json.dumps(record)
    # Peers stay as long as they wait for a frame: longer where other tests share two cores.
    assert after["rss_MiB"] <= before["rss_MiB"] + 2.0 and after["fds"] <= before["fds"] + 100, json.dumps(record)


def fuzzed(*arguments):
    """The record of a run of the fuzzer."""
    run = subprocess.run([sys.executable, "-W", "ignore", str(REPOSITORY / "benchmarks" / "fuzz.py"), *arguments],
                         capture_output=True, text=True, timeout=300)
    record = json.loads(run.stdout)
    assert run.returncode == 0 and record["passed"] and not record["faults"], run.stdout + run.stderr
    # It is no fuzzer that hits only one wall.
    # Whether one is told `busy` is the weather's: test_many_waiting_requests_are_answered_each_once_or_told_busy.
    assert {"ok", "protocol", "config", "scene"} <= record["answers"].keys(), run.stdout
    return record


@pytest.mark.parametrize("messages", slow_but(["20000", "6000"], 1))
def test_bad_messages_are_answered_each_once_and_never_stumbled_over(messages):
    record = fuzzed("--messages", messages)
    assert record["answers"]["lost framing"] > 30


@pytest.mark.slow
@pytest.mark.parametrize("workers", ["1", "2"])
def test_bad_messages_on_both_transports_neither_end_nor_hold_up_the_server(workers):
    """Every so often a good request is answered within its deadline, while others hold connections half open."""
    record = fuzzed("--messages", "6000", "--sockets", "--workers", workers, "--seed", workers)
    assert record["answers"]["connection closed"] > 100 and record["longest_good_s"] < 5.0


def test_a_flood_of_connections_that_say_nothing_lets_a_good_one_in(tmp_path):
    with serving.server(tmp_path, "--tcp", "127.0.0.1:0") as (endpoint, process):
        address = serving.tcp_address(process)
        flood = [socket.create_connection(address) for _ in range(100)]
        with Framed(address) as framed, Client(endpoint) as client:
            header, pixels = framed.ask(msgpack.packb({
                "v": 1, "op": "render", "id": 1, "client": "f", "state": STATE, "camera": "bare"}))
            assert msgpack.unpackb(header)["ok"]
            np.testing.assert_array_equal(np.frombuffer(pixels, np.float32).reshape(32, 32),
                                          client.render(STATE, "bare").pixels)
        for peer in flood:
            peer.close()
