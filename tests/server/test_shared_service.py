"""Frames in shared memory when all else goes wrong: workers killed or too slow, servers gone, clients that leave."""

from __future__ import annotations

import asyncio
import gc
import itertools
import os
import signal
import sys
import threading
from pathlib import Path

import msgpack
import numpy as np
import pytest
import serving
import zmq
from glrender_cli.__main__ import main as glrender
from glrender_client import AsyncClient, Client, RequestTimeout, ServerError, replay
from glrender_client.recording import Recorder
from lending import SCENE, STATE
from serving import children, until

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="shared memory for clients is Linux's")
LARGE = SCENE + "".join(f"""
[[cameras]]
name = "{name}"
width_px = {size}
height_px = {size}
focal_length_px = {7 * size}.0
""" for name, size in (("wide", 2048), ("big", 4096)))


def at(k):
    """A state of its own: no reply is answered from what is kept."""
    return {**STATE, "t_s": float(k)}


def slots_of(process):
    """Names of the shared memory that a server has mapped."""
    text = Path(f"/proc/{process.pid}/maps").read_text()
    return {word.rpartition("/")[2] for word in text.split() if word.startswith("/dev/shm/glrender-slot-")}


@pytest.fixture
def truth(tmp_path):
    """What each seed's frame is, by a server of its own and over its socket."""
    folder = tmp_path / "truth"
    folder.mkdir()
    with serving.server(folder, scene=SCENE) as (endpoint, _), Client(endpoint) as client:
        yield lambda seed: client.render(at(seed), "navcam", output="dn", seed=seed).pixels


@pytest.mark.slow
def test_frames_that_are_held_outlive_the_workers_that_drew_them(tmp_path, truth):
    with serving.server(tmp_path, "--workers", "2", scene=SCENE) as (endpoint, process), \
            Client(endpoint, shared_memory=True, timeout_s=60.0) as client:
        held = []
        for seed in range(12):
            if seed % 4 == 3:
                for number in children(process):
                    os.kill(number, signal.SIGKILL)
            held.append(client.render(at(seed), "navcam", output="dn", seed=seed))
        assert all("shared" in reply.header for reply in held)
        assert client.status()["workers"]["restarts"] >= 3 and client.status()["errors"] == {}
        for seed, reply in enumerate(held):
            np.testing.assert_array_equal(reply.pixels, truth(seed), err_msg=f"frame {seed}")
        held.clear()
        n_slots = len(slots_of(process))
        for k in range(40):
            client.render(at(100 + k), "bare")
        assert len(slots_of(process)) <= min(n_slots, 11), "8 free, one for each worker, and the last reply's"


@pytest.mark.slow
def test_what_a_worker_was_drawing_when_it_was_killed_is_drawn_whole(tmp_path):
    """32 MiB, killed at any moment of it: in the drawing, in the copy, behind it."""
    with serving.server(tmp_path, "--workers", "1", "--deadline", "50", scene=LARGE) as (endpoint, process), \
            Client(endpoint, shared_memory=True, timeout_s=60.0, retries=0) as client:
        expected = client.render(at(0), "wide", samples=1, products=["body_id"])
        n_whole = 0
        for k in range(1, 4):
            until(lambda: client.status()["workers"]["ready"] == 1)
            killer = threading.Timer(0.05 * k, lambda: [os.kill(n, signal.SIGKILL) for n in children(process)])
            killer.start()
            reply = client.render(at(k), "wide", samples=1, products=["body_id"])
            killer.join()
            for name in ("image", "body_id"):
                np.testing.assert_array_equal(reply.arrays[name], expected.arrays[name])
            n_whole += "shared" in reply.header
        assert n_whole == 3 and client.status()["errors"] == {}
        until(lambda: client.status()["workers"]["restarts"] == 3)
        assert len(slots_of(process)) <= 9


@pytest.mark.slow
def test_a_frame_beyond_its_deadline_leaves_no_memory_behind(tmp_path, truth):
    with serving.server(tmp_path, "--workers", "1", "--deadline", "1", scene=LARGE) as (endpoint, process), \
            Client(endpoint, shared_memory=True, timeout_s=60.0, retries=0) as client:
        held = client.render(at(1), "navcam", output="dn", seed=1)
        for k in range(2):
            with pytest.raises(ServerError, match="overran its deadline of 1 s") as caught:
                client.render(at(10 + k), "big", samples=16)
            assert caught.value.code == "poison"
            reply = client.render(at(2 + k), "navcam", output="dn", seed=2 + k)
            assert "shared" in reply.header
            np.testing.assert_array_equal(reply.pixels, truth(2 + k))
        np.testing.assert_array_equal(held.pixels, truth(1))
        assert client.status()["errors"] == {"poison": 2}
        assert len(slots_of(process)) <= 6, "held, the last two replies', the worker's; four died with one in hand"


def test_a_client_that_gave_up_gets_its_next_frame_and_no_other(tmp_path, truth):
    with serving.server(tmp_path, scene=LARGE) as (endpoint, process), \
            Client(endpoint, shared_memory=True, timeout_s=60.0, retries=0) as client:
        for seed in range(8):
            client._timeout_s = 0.002
            with pytest.raises(RequestTimeout):
                client.render(at(100 + seed), "wide", samples=4)
            client._timeout_s = 60.0
            np.testing.assert_array_equal(client.render(at(seed), "navcam", output="dn", seed=seed).pixels, truth(seed))
        assert len(slots_of(process)) <= 6


def test_memory_is_shared_with_keys_too(tmp_path, truth):
    assert glrender(["keygen", str(tmp_path / "keys"), "--client", "loop"]) == 0
    keys = {"key": tmp_path / "keys" / "loop.key_secret", "server_key": tmp_path / "keys" / "server.key"}
    with serving.server(tmp_path, "--curve", str(tmp_path / "keys"), scene=SCENE) as (endpoint, _), \
            Client(endpoint, shared_memory=True, **keys) as client:
        reply = client.render(at(3), "navcam", output="dn", seed=3)
        assert "shared" in reply.header
        np.testing.assert_array_equal(reply.pixels, truth(3))
        with Client(endpoint, shared_memory=True, timeout_s=0.5, retries=0) as stranger, pytest.raises(RequestTimeout):
            stranger.render(at(3), "navcam")
        mode = os.stat(f"/dev/shm/{reply.header['shared']['name']}").st_mode
        assert mode & 0o077 == 0, "what was encrypted on the way lies open to nobody else"


@pytest.mark.slow
def test_a_frame_that_is_held_outlives_its_server(tmp_path, truth):
    """SIGKILL; the next server takes its files away, and the client goes on with that one."""
    where = f"ipc://{tmp_path}/z"
    with serving.server(tmp_path, "--zmq", where, scene=SCENE) as (_, first), \
            Client(where, timeout_s=20.0, retries=2) as client:
        held = client.render(at(1), "navcam", output="dn", seed=1)
        name = held.header["shared"]["name"]
        first.kill()
        first.wait()
        with serving.server(tmp_path, "--zmq", where, scene=SCENE):
            assert not Path(f"/dev/shm/{name}").exists()
            np.testing.assert_array_equal(held.pixels, truth(1))
            reply = client.render(at(2), "navcam", output="dn", seed=2)
            assert "shared" in reply.header and reply.header["shared"]["name"] != name
            np.testing.assert_array_equal(reply.pixels, truth(2))


@pytest.mark.slow
@pytest.mark.parametrize("options", [("--in-process",), ("--workers", "2")], ids=["in process", "workers"])
def test_requests_that_are_cancelled_disturb_nobody_who_shares(tmp_path, truth, options, caplog):
    """What is cancelled is drawn nevertheless: six times fifty a second fill the server's queue.

    However fast the machine is, as many are cancelled as the test is about.
    """
    with serving.server(tmp_path, "--zmq", f"ipc://{tmp_path}/z", *options, scene=SCENE) as (endpoint, _), \
            Client(endpoint, timeout_s=60.0) as client:
        stop, n_cancelled = threading.Event(), 0

        async def leave():
            nonlocal n_cancelled
            async with AsyncClient(endpoint, timeout_s=60.0) as other:
                # On a fast machine all are soon answered: some are left at once.
                waits_s = itertools.cycle([0.02, 0.005, 0.001])
                while not stop.is_set():
                    tasks = [asyncio.create_task(other.render(at(1000 + k), "navcam", samples=4)) for k in range(6)]
                    await asyncio.sleep(next(waits_s))
                    for task in tasks:
                        n_cancelled += task.cancel()
                    await asyncio.gather(*tasks, return_exceptions=True)

        thread = threading.Thread(target=lambda: asyncio.run(leave()))
        thread.start()
        try:
            held = [client.render(at(seed), "navcam", output="dn", seed=seed) for seed in range(12)]
            until(lambda: n_cancelled > 40)
        finally:
            stop.set()
            thread.join()
        gc.collect()
        assert not caplog.records, "an answer that nobody fetched is no mishap"
        for seed, reply in enumerate(held):
            assert "shared" in reply.header
            np.testing.assert_array_equal(reply.pixels, truth(seed))


def test_a_recording_is_replayed_where_others_share_memory(tmp_path):
    """Over ipc, where clients share by default: the recording holds the pixels, and they come again, byte for byte."""
    options = ("--zmq", f"ipc://{tmp_path}/z", "--workers", "2")
    with serving.server(tmp_path, *options, scene=SCENE) as (endpoint, _), Client(endpoint) as other:
        with Client(endpoint, record=tmp_path / "frames.glr") as client:
            for seed in range(4):
                client.render(at(seed), "navcam", output="dn", seed=seed, products=["range"], roi=[3, 5, 250, 191])
            client.render_frames(at(9), [{"camera": "bare"}, {"camera": "navcam", "output": "dn"}], order="F")
        held = [other.render(at(50 + k), "bare") for k in range(6)]
        assert list(replay(tmp_path / "frames.glr", endpoint)) == [None] * 6
        assert all("shared" in reply.header for reply in held)


def test_a_recording_without_its_pixels_says_so(tmp_path):
    """Made by hand, or by another tool: what was left in shared memory is gone, and cannot be compared."""
    request = {"v": 1, "op": "render", "id": 1, "client": "other", "state": STATE, "camera": "bare", "shared": True}
    with serving.server(tmp_path, scene=SCENE) as (endpoint, _):
        with zmq.Context() as context, context.socket(zmq.DEALER) as socket:
            socket.connect(endpoint)
            socket.send(message := msgpack.packb(request))
            assert socket.poll(20_000)
            reply = socket.recv_multipart()
        assert len(reply) == 1
        recorder = Recorder(tmp_path / "frames.glr")
        recorder.keep(message, reply)
        recorder.close()
        (difference,) = replay(tmp_path / "frames.glr", endpoint)
        assert difference.what == "pixels of image were left in shared memory, and not recorded"
