"""Frames that a client on the server's machine reads in place: right, its own while it holds them, and given back."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from functools import partial
from multiprocessing.shared_memory import SharedMemory

import msgpack
import numpy as np
import pytest
import serving
from glrender import load_scene
from glrender_client import Client, shared
from glrender_client.shared import NotShared, SharedFrames
from glrender_server import slots
from glrender_server.codec import pack, with_field
from glrender_server.operations import Operations
from glrender_server.slots import SlotStore, room
from lending import ENOUGH, SCENE, STATE, lent

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="shared memory for clients is Linux's")


@pytest.fixture(scope="module", params=[("--in-process",), ("--workers", "2")], ids=["in process", "workers"])
def endpoint(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("shared")
    with serving.server(folder, "--zmq", f"ipc://{folder}/z", *request.param, scene=SCENE) as (endpoint, _):
        yield endpoint


@pytest.fixture
def store():
    store = SlotStore()
    yield store
    store.close()


def test_frames_read_in_place_are_those_of_the_socket(endpoint):
    options = {"products": ["range", "r_body", "body_id"], "order": "F"}
    with Client(endpoint) as here, Client(endpoint, shared_memory=False) as there:
        ours, theirs = (client.render(STATE, "navcam", **options) for client in (here, there))
        assert "shared" in ours.header and "shared" not in theirs.header
        assert list(ours.arrays) == list(theirs.arrays)
        for name, array in theirs.arrays.items():
            np.testing.assert_array_equal(ours.arrays[name], array, strict=True)
        assert not ours.pixels.flags.writeable and ours.pixels.flags.aligned
        frames = [{"camera": "navcam", "output": "dn", "seed": 3}, {"camera": "bare"}]
        for mine, its in zip(here.render_frames(STATE, frames), there.render_frames(STATE, frames), strict=True):
            np.testing.assert_array_equal(mine.pixels, its.pixels, strict=True)


def test_a_frame_that_is_held_is_never_written_over(endpoint):
    with Client(endpoint) as client, Client(endpoint, shared_memory=False) as other:
        held = [client.render(STATE, "navcam", output="dn", seed=seed) for seed in range(12)]
        assert len({reply.header["shared"]["name"] for reply in held}) == 12, "each has its own memory"
        for seed, reply in enumerate(held):
            np.testing.assert_array_equal(reply.pixels, other.render(STATE, "navcam", output="dn", seed=seed).pixels)


def test_memory_that_is_not_held_is_used_again(endpoint):
    with Client(endpoint) as client:
        names = {client.render(STATE, "bare", max_error=0.1 + 1e-3 * k).header["shared"]["name"] for k in range(40)}
    assert len(names) <= 14, "40 frames, of which two are held at a time; the last test's twelve slots are free"


def test_frames_come_over_the_socket_where_memory_cannot_be_read(endpoint, monkeypatch, tmp_path):
    with Client(endpoint) as client:
        here = client.render(STATE, "bare").pixels
        monkeypatch.setattr(shared, "_FOLDER", tmp_path)
        reply = client.render(STATE, "bare")
        assert "shared" not in reply.header
        np.testing.assert_array_equal(reply.pixels, here)


def test_a_recording_has_its_pixels_in_it(endpoint, tmp_path):
    with Client(endpoint, record=tmp_path / "frames.glr") as client:
        assert "shared" not in client.render(STATE, "bare").header


def test_what_is_not_true_or_false_is_refused(endpoint):
    with Client(endpoint) as client, pytest.raises(Exception, match="shared: must be true or false, got 1"):
        client._ask("render", {"state": STATE, "camera": "bare", "shared": 1})


def test_a_client_that_comes_too_late_sees_it(store):
    views, place = lent(store, b"first" * ENOUGH)
    del views
    views, again = lent(store, b"other" * ENOUGH)
    assert (again["name"], again["number"]) == (place["name"], place["number"] + 1)
    with pytest.raises(NotShared, match="holds another frame"):
        SharedFrames().parts(place)
    assert bytes(SharedFrames().parts(again)[0]) == b"other" * ENOUGH


def test_memory_comes_back_with_the_last_array_and_from_the_dead(store):
    """A process that holds a frame and is killed: the system takes its lock away."""
    views, place = lent(store, bytes(ENOUGH))
    script = ("import sys, json, time; from glrender_client.shared import SharedFrames\n"
              "held = SharedFrames().parts(json.loads(sys.argv[1])); print('held', flush=True); time.sleep(60)")
    with subprocess.Popen([sys.executable, "-c", script, json.dumps(place)], stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"held\n"
        del views
        assert store.take(ENOUGH).name != place["name"], "it is read"
        process.kill()
    deadline, taken = time.monotonic() + 5.0, ""
    while taken != place["name"] and time.monotonic() < deadline:
        slot = store.take(ENOUGH)
        taken = slot.name
        store.give_back(slot)
    assert taken == place["name"]


def test_beyond_the_limit_frames_are_sent(store, monkeypatch):
    views, place = lent(store, bytes(ENOUGH))
    assert place is not None and bytes(views[0]) == bytes(ENOUGH)
    assert lent(store, bytes(ENOUGH - 1))[1] is None, "small"
    monkeypatch.setattr(slots, "MAX_SHARED_BYTES", store.n_bytes - 1)
    assert lent(store, bytes(ENOUGH))[1] is None


def test_what_is_read_is_not_trimmed(store):
    held = [SharedFrames().parts(lent(store, bytes(ENOUGH))[1]) for _ in range(12)]
    before = store.n_bytes
    store.trim()
    assert store.n_bytes == before
    held.clear()
    store.trim()
    assert store.n_bytes < before


@pytest.mark.parametrize("n_fields", [1, 14, 15, 16, 300])
def test_a_header_takes_one_more_field(n_fields):
    header = {f"field_{k}": k for k in range(n_fields)}
    packed = with_field(pack(header)[0], "shared", {"name": "x"})
    assert msgpack.unpackb(packed) == {**header, "arrays": [], "shared": {"name": "x"}}


def test_memory_that_was_lent_for_an_answer_can_be_closed_after_it(tmp_path):
    """A worker that ends closes its slots: an image drawn in one must not keep it."""
    (tmp_path / "scene.toml").write_text(SCENE)
    operations = Operations(load_scene(tmp_path / "scene.toml"))
    slot = SharedMemory(create=True, size=1 << 20)
    try:
        (_, *parts), code, *_ = operations.answer(
            {"v": 1, "op": "render", "id": 1, "client": "a", "state": STATE, "camera": "bare"}, partial(room, slot))
        assert not code and np.frombuffer(parts[0], np.float32).max() > 0.0
        del parts
        slot.close()
    finally:
        operations.close()
        slot.unlink()
