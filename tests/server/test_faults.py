"""Faults of the machine: no memory, no descriptors, no disk. The request is told, and the server serves on."""

from __future__ import annotations

import errno
import multiprocessing
import os
import re
import resource
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import msgpack
import numpy as np
import pytest
import serving
import views
import zmq
from glrender.base import disk_cache
from glrender_client import Client, ServerError
from glrender_server import server, tcp_front
from glrender_server.server import Server
from glrender_server.stream import Channel
from glrender_server.systemd import Systemd
from glrender_server.worker import work
from glrender_server.zmq_front import ZmqFront

STATE = views.state().to_dict()
REPOSITORY = Path(__file__).parents[2]
HUGE = serving.SCENE + """
[[cameras]]
name = "huge"
width_px = 6000
height_px = 6000
focal_length_px = 40000.0
"""


def test_a_frame_that_needs_more_memory_than_a_worker_may_have_is_told(tmp_path):
    with serving.server(tmp_path, "--worker-memory", "0.9", scene=HUGE) as (endpoint, _), \
            Client(endpoint, timeout_s=60.0) as client:
        expected = client.render(STATE, "bare").pixels
        with pytest.raises(ServerError) as caught:
            client.render(STATE, "huge", products=["range", "r_body"])
        assert caught.value.code == "device" and "--worker-memory" in caught.value.message
        np.testing.assert_array_equal(client.render({**STATE, "t_s": 1.0}, "bare").pixels, expected)
        assert client.status()["workers"]["restarts"] == 0


def test_without_descriptors_the_listener_rests(monkeypatch):
    """It would wake the loop without end, and fill the log."""
    front, poller = tcp_front.TcpFront("127.0.0.1:0"), zmq.Poller()
    front.start(poller)
    host, _, port = front.endpoint.rpartition(":")
    listener, tries = front._listener, []

    class Exhausted:
        fileno = listener.fileno

        def accept(self):
            tries.append(time.monotonic())
            raise OSError(errno.EMFILE, "Too many open files")

    try:
        with serving.Framed((host, int(port))) as framed:
            framed.send(msgpack.packb({"v": 1, "op": "hello", "id": 1, "client": "c"}))
            monkeypatch.setattr(front, "_listener", Exhausted())
            deadline = time.monotonic() + 1.5
            while time.monotonic() < deadline:
                assert not front.take_in(dict(poller.poll(20)))
            assert 1 <= len(tries) <= 2, "once a second"
            monkeypatch.setattr(front, "_listener", listener)
            deadline, requests = time.monotonic() + 5.0, []
            while time.monotonic() < deadline and not requests:
                requests = front.take_in(dict(poller.poll(20)))
            assert len(requests) == 1, "then it is served"
    finally:
        front.close()


def test_with_few_descriptors_there_are_fewer_connections():
    """ZeroMQ would take connections until none is left for workers and frames."""
    code = ("import resource; resource.setrlimit(resource.RLIMIT_NOFILE, (128, 256)); "
            "from glrender_server import limits; print(*limits.max_connections(), "
            "resource.getrlimit(resource.RLIMIT_NOFILE)[0])")
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert told.stdout.split() == ["102", "51", "256"]


def test_a_cache_is_bounded_and_the_longest_unused_goes(tmp_path, monkeypatch):
    monkeypatch.setattr(disk_cache, "MAX_CACHE_BYTES", 50_000)
    monkeypatch.setenv("GLRENDER_CACHE", str(tmp_path))
    made = []

    def table(name):
        made.append(name)
        return np.zeros(16_000, np.uint8)

    def use(name):
        disk_cache.cached_bytes(name, (16_000,), lambda: table(name))
        time.sleep(0.02)

    for name in ("a", "b", "c", "a", "d"):
        use(name)
    assert made == ["a", "b", "c", "d"] and sorted(path.stem for path in tmp_path.iterdir()) == ["a", "c", "d"]


def test_a_full_disk_costs_the_table_alone(tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(np, "save", full)
    monkeypatch.setenv("GLRENDER_CACHE", str(tmp_path))
    assert disk_cache.cached_bytes("a", (3,), lambda: np.ones(3, np.uint8)).sum() == 3 and not list(tmp_path.iterdir())


def test_no_wait_goes_by_the_clock_on_the_wall():
    """It jumps."""
    for folder in ("server/glrender_server", "clients/python/glrender_client"):
        for path in (REPOSITORY / folder).glob("*.py"):
            assert not re.search(r"\btime\.time\(|datetime\.now|utcnow", path.read_text()), path


def test_systemd_is_told_that_the_loop_turns(tmp_path, monkeypatch):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(60.0)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.setenv("WATCHDOG_USEC", "400000")
        with serving.server(tmp_path) as (_, process):
            assert [manager.recv(100) for _ in range(3)] == [b"READY=1", b"WATCHDOG=1", b"WATCHDOG=1"]
            process.terminate()
            said = manager.recv(100)
            while said == b"WATCHDOG=1":
                said = manager.recv(100)
            assert said == b"STOPPING=1"


@pytest.mark.parametrize("told", ["", "x", "-1", "1e6"])
def test_a_watchdog_that_makes_no_sense_is_none(told, monkeypatch):
    monkeypatch.setenv("WATCHDOG_USEC", told)
    assert Systemd()._period_s == 0.0


@pytest.mark.parametrize("pid, period_s", [("1", 0.0), ("own", 1.0), ("", 1.0)])
def test_the_watchdog_of_another_process_is_not_answered(pid, period_s, monkeypatch):
    """sd_watchdog_enabled(3): WATCHDOG_PID names the process that is meant."""
    monkeypatch.setenv("WATCHDOG_USEC", "2000000")
    monkeypatch.setenv("WATCHDOG_PID", str(os.getpid()) if pid == "own" else pid)
    assert Systemd()._period_s == period_s


class Stub:
    """Engine, dispatcher and front of a loop that serves nobody; each part may fail, for a number of turns."""

    endpoint, is_idle, has_more, can_work, is_ending = "", True, False, False, False

    def __init__(self, **fails):
        self.fails, self.seen = fails, []

    def __getattr__(self, name):
        def part(*_, **__):
            self.seen.append(name)
            if self.fails.get(name, 0) > 0:
                self.fails[name] -= 1
                raise OSError(errno.EMFILE, "Too many open files")
            return ()
        return part


@pytest.mark.parametrize("part", ["turn", "take_in", "work", "stop_listening"])
def test_a_part_of_the_loops_turn_that_fails_ends_neither_the_loop_nor_the_other_parts(part, caplog):
    stub = Stub(**{part: 3})
    loop = Server(stub, stub, [stub])

    def stop_later():
        time.sleep(0.6)
        loop.stop()

    threading.Thread(target=stop_later, daemon=True).start()
    loop.serve()
    assert stub.fails[part] == (0 if part != "stop_listening" else 2) and "Too many open files" in caplog.text
    assert {"turn", "take_in", "work", "stop_listening"} <= set(stub.seen)
    assert stub.seen[-1] == "close", "of the fronts, before anything that takes its time"
    assert "turn" in stub.seen[stub.seen.index("stop_listening"):]


def test_who_takes_nothing_keeps_a_server_from_its_end_for_one_bound_alone(monkeypatch):
    monkeypatch.setattr(server, "_DRAIN_S", 1.0)
    stub, front, poller = Stub(), ZmqFront("tcp://127.0.0.1:*"), zmq.Poller()
    front.start(poller)
    loop = Server(stub, stub, [front])
    with zmq.Context() as context, context.socket(zmq.DEALER) as dealer:
        dealer.set(zmq.LINGER, 0)
        dealer.set(zmq.RCVHWM, 1)
        dealer.connect(front.endpoint)
        dealer.send(b"question")
        requests = []
        serving.until(lambda: requests.extend(front.take_in(dict(poller.poll(20)))) or requests)
        for _ in range(80):
            requests[0].answer([bytes(1 << 20)])
        assert not front.is_idle
        began = time.monotonic()
        loop.serve(loop.stop)
        assert 1.0 < time.monotonic() - began < 2.5


def test_a_connection_that_fails_loses_no_request_of_another(monkeypatch):
    front, poller = tcp_front.TcpFront("127.0.0.1:0"), zmq.Poller()
    front.start(poller)
    host, _, port = front.endpoint.rpartition(":")
    try:
        with serving.Framed((host, int(port))) as first, serving.Framed((host, int(port))) as second:
            serving.until(lambda: front.take_in(dict(poller.poll(20))) or len(front._connections) == 2)
            _, failing = front._connections.values()

            def fails(*_):
                raise OSError(errno.ENOMEM, "Cannot allocate memory")

            monkeypatch.setattr(failing, "turn", fails)
            first.send(msgpack.packb({"v": 1, "op": "hello", "id": 1, "client": "c"}))
            second.send(b"x")
            requests = []
            serving.until(lambda: requests.extend(front.take_in(dict(poller.poll(20)))) or requests)
            assert len(requests) == 1 and len(front._connections) == 1
    finally:
        front.close()


def test_a_loop_that_fails_in_each_turn_ends():
    """A service manager starts the server anew."""
    stub = Stub(turn=10**6)
    stub.has_more = True  # turns do not wait
    with pytest.raises(OSError, match="Too many open files"):
        Server(stub, stub, [stub]).serve()
    assert 100 <= stub.seen.count("turn") <= 102


def test_sighup_reloads_and_ends_nothing():
    reloaded, stub = [], Stub()
    loop = Server(stub, stub, [stub], lambda: (reloaded.append(time.monotonic()), loop.stop()))
    loop.serve(lambda: os.kill(os.getpid(), signal.SIGHUP))
    assert len(reloaded) == 1


def test_a_dead_worker_is_found_without_a_free_descriptor():
    """A module that its first `join` imports would want one: the loop ended by it."""
    code = "import sys, glrender_server.workers; assert 'multiprocessing.connection' in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_without_systemd_nothing_is_said(monkeypatch):
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    systemd = Systemd()
    systemd.say_ready()
    systemd.say_alive()


def test_a_workers_memory_is_limited_by_the_system():
    ours, theirs = socket.socketpair()
    spawn = multiprocessing.get_context("spawn")
    process = spawn.Process(target=work, args=(theirs, "auto", None, 2 * 2**30, 30, "text"), daemon=True)
    process.start()
    theirs.close()
    channel = Channel(ours, is_blocking=True)
    try:
        assert channel.receive() == ("awake",)
        assert resource.prlimit(process.pid, resource.RLIMIT_DATA)[0] == 2 * 2**30
    finally:
        channel.close()
        process.join(20.0)
    assert process.exitcode == 0, "it ends with the server"
