"""Shared memory when it ends: descriptors, memory, the server itself, or a client that cannot read it."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import msgpack
import numpy as np
import pytest
import serving
import zmq
from glrender import load_scene
from glrender_client import Client, shared
from glrender_client.shared import SharedFrames
from glrender_server import slots
from glrender_server.dispatcher import Dispatcher
from glrender_server.front import Request
from glrender_server.job import LocalEngine
from glrender_server.operations import Operations
from glrender_server.slots import SlotStore
from glrender_server.workers import WorkerPool
from lending import ENOUGH, SCENE, STATE, lent

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="shared memory for clients is Linux's")
REQUEST = {"v": 1, "op": "render", "id": 1, "client": "raw", "state": STATE, "camera": "bare", "shared": True}


@pytest.fixture
def store():
    store = SlotStore()
    yield store
    store.close()


@pytest.fixture
def scene(tmp_path):
    (tmp_path / "scene.toml").write_text(SCENE)
    return load_scene(tmp_path / "scene.toml")


@pytest.fixture
def local(scene):
    engine = LocalEngine(Operations(scene))
    yield engine, Dispatcher(engine)
    engine.close()


def no_memory(*_):
    raise OSError(errno.ENOSPC, "No space left on device")


def asked(dispatcher, engine=None, **fields):
    """The parts of the reply to a request, straight through a dispatcher."""
    replies = []
    dispatcher.submit(Request("me", [msgpack.packb({**REQUEST, **fields})], replies.append))
    while not replies:
        dispatcher.work()
        if engine is not None:
            engine.turn({})
    return [msgpack.unpackb(replies[0][0]), *replies[0][1:]]


@pytest.mark.slow
@pytest.mark.parametrize("options", [("--in-process",), ("--workers", "2")], ids=["in process", "workers"])
def test_a_client_that_keeps_every_frame_gets_them_all(tmp_path, options):
    """More than may be left in place: each slot takes three descriptors of the 1024 that a process commonly has."""
    n_frames = slots.MAX_SHARED_SLOTS + 12
    with serving.server(tmp_path, "--zmq", f"ipc://{tmp_path}/z", *options, scene=SCENE) as (endpoint, process), \
            Client(endpoint) as client:
        held = [client.render(STATE, "bare", output="irradiance", max_error=0.1 + 1e-4 * k) for k in range(n_frames)]
        n_shared = sum("shared" in reply.header for reply in held)
        n_open = len(os.listdir(f"/proc/{process.pid}/fd"))
    assert n_frames - 14 <= n_shared <= slots.MAX_SHARED_SLOTS and n_open < 512
    for reply in held:
        np.testing.assert_array_equal(reply.pixels, held[0].pixels)


def test_beyond_half_of_the_systems_memory_frames_are_sent(store, monkeypatch):
    monkeypatch.setattr(store, "_room_bytes", 3 * ENOUGH)
    held = [lent(store, bytes(ENOUGH)) for _ in range(3)]  # 128 KiB each
    assert [place is not None for _, place in held] == [True, False, False]
    del held
    store.trim()
    assert lent(store, bytes(ENOUGH))[1] is None, "two are kept, 256 KiB"
    monkeypatch.setattr(store, "_room_bytes", 4 * ENOUGH)
    assert lent(store, bytes(ENOUGH))[1] is not None


def test_without_memory_a_frame_goes_over_the_socket(local, monkeypatch):
    """Memory that is promised and not there would kill the server when it writes (SIGBUS)."""
    _, dispatcher = local
    monkeypatch.setattr(os, "posix_fallocate", no_memory)
    before = set(os.listdir("/dev/shm"))
    header, image = asked(dispatcher)
    assert header["ok"] and "shared" not in header and len(image) == 4 * 160**2
    assert not [name for name in set(os.listdir("/dev/shm")) - before if f"-{dispatcher._engine._slots._name}-" in name]
    monkeypatch.undo()
    (again,) = asked(dispatcher, id=2)
    assert bytes(SharedFrames().parts(again["shared"])[0]) == bytes(image)


def test_without_memory_a_worker_says_so_and_lives_on(scene, monkeypatch):
    engine = WorkerPool(scene, n_workers=1, deadline_s=20.0)
    dispatcher = Dispatcher(engine)
    try:
        monkeypatch.setattr(os, "posix_fallocate", no_memory)
        (refused,) = asked(dispatcher, engine)
        assert refused["error"]["code"] == "device" and "shared memory" in refused["error"]["message"]
        monkeypatch.undo()
        assert asked(dispatcher, engine, id=2)[0]["ok"] and engine.restarts == 0
    finally:
        dispatcher.close()
        engine.close()


def test_a_server_that_ends_sends_its_pixels(local):
    _, dispatcher = local
    assert "shared" in asked(dispatcher)[0]
    dispatcher.is_ending = True
    header, image = asked(dispatcher, id=2)
    assert "shared" not in header and len(image) == 4 * 160**2


@pytest.mark.parametrize("options", [("--in-process",), ("--deadline", "50")], ids=["in process", "workers"])
def test_sigterm_sends_the_pixels_of_what_is_under_way(tmp_path, options):
    with serving.server(tmp_path, *options, scene=SCENE) as (endpoint, process), zmq.Context() as context, \
            context.socket(zmq.DEALER) as socket:
        socket.connect(endpoint)
        for number in range(20):
            socket.send(msgpack.packb({**REQUEST, "client": f"c{number}", "samples": 16}))
        assert socket.poll(20_000)
        process.send_signal(signal.SIGTERM)
        replies = []
        while len(replies) < 20 and socket.poll(20_000):
            replies.append(socket.recv_multipart())
        assert process.wait(20.0) == 0
    headers = [msgpack.unpackb(parts[0]) for parts in replies]
    assert len(headers) == 20 and all(header["ok"] for header in headers)
    assert "shared" not in headers[-1] and len(replies[-1][1]) == 4 * 160**2


def test_what_a_killed_server_left_the_next_removes(store):
    """SIGKILL for the whole group, as systemd does: nobody is left to tidy up. What lives stays."""
    script = ("import time; from glrender_server.slots import SlotStore; store = SlotStore(); store.take(1 << 16)\n"
              "print(store._name, flush=True); time.sleep(60)")
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, start_new_session=True) as process:
        name = process.stdout.readline().decode().strip()
        os.killpg(process.pid, signal.SIGKILL)
    left = lambda name: [path.name for path in Path("/dev/shm").glob(f"{name}*")]  # noqa: E731
    store.take(1)
    SlotStore().close()
    assert not left(name) and len(left(store._name)) == 2
    store.close()
    assert not left(store._name)


def test_memory_that_cannot_be_read_is_not_asked_for_again_and_again(tmp_path, monkeypatch):
    """As with another user's server, or one in a container: two frames are drawn twice, not every one."""
    with serving.server(tmp_path, scene=SCENE) as (endpoint, _), Client(endpoint, shared_memory=True) as client:
        monkeypatch.setattr(shared, "_FOLDER", tmp_path)
        for _ in range(5):
            assert "shared" not in client.render(STATE, "bare").header
        assert client.status()["requests"]["render"] == 7


def test_a_recording_does_not_share(tmp_path):
    with pytest.raises(ValueError, match="a recording holds the pixels"):
        Client("ipc:///nowhere", record=tmp_path / "frames.glr", shared_memory=True)
    assert not list(tmp_path.iterdir())
