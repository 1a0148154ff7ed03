"""Several worker processes: the same pixels, nothing lost when one dies, hangs or reloads; nothing left behind."""

from __future__ import annotations

import gc
import os
import pickle
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import popen_spawn_posix as spawn_popen
from pathlib import Path
from unittest import mock

import msgpack
import numpy as np
import pytest
import serving
import views
from glrender import ConfigError, DeviceError, load_scene
from glrender_client import Client, ServerError
from glrender_server import slots, workers
from glrender_server.scene_digest import scene_digest
from glrender_server.scene_source import SceneFile
from serving import Framed, children, until

STATE = views.state().to_dict()


def ready_workers(client):
    return client.status()["workers"]["ready"]


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pool")
    with serving.server(folder, "--workers", "2", "--tcp", "127.0.0.1:0") as (endpoint, process):
        yield endpoint, process


@pytest.mark.slow
def test_workers_give_the_pixels_of_a_single_server(live, tmp_path):
    with serving.server(tmp_path) as (alone, _), Client(alone) as one, Client(live[0]) as many:
        for order in ("C", "F"):
            products = ["range", "body_id", "r_body"]
            expected = one.render(STATE, "navcam", products=products, order=order)
            for _ in range(3):
                reply = many.render(STATE, "navcam", products=products, order=order)
                assert reply.arrays.keys() == expected.arrays.keys()
                for name, array in expected.arrays.items():
                    np.testing.assert_array_equal(reply.arrays[name], array)
        dn = [client.render(STATE, "navcam", output="dn", seed=5).pixels for client in (one, many)]
        np.testing.assert_array_equal(*dn)


def test_frames_that_a_client_holds_are_not_written_over(live):
    """Every frame is another; all are kept and compared after the last has come."""
    with Client(live[0]) as client:
        frames = [client.render(STATE, "navcam", output="dn", seed=k).pixels for k in range(40)]
        copies = [client.render(STATE, "navcam", output="dn", seed=k).pixels.copy() for k in range(40)]
    for frame, copy in zip(frames, copies, strict=True):
        np.testing.assert_array_equal(frame, copy)
    assert len({frame.tobytes() for frame in frames}) == 40


def test_a_slow_reader_sees_its_own_frames_though_others_are_drawn_meanwhile(live):
    address = serving.tcp_address(live[1])
    request = lambda name, seed: msgpack.packb({  # noqa: E731
        "v": 1, "op": "render", "id": seed, "client": name, "state": STATE, "camera": "navcam", "output": "dn",
        "seed": seed, "products": ["range", "r_body"]})
    with Framed(address, receive_buffer=4096) as slow, Framed(address) as quick:
        for seed in range(8):
            slow.send(request("slow", seed))
        time.sleep(0.5)
        theirs = {seed: quick.ask(request("quick", seed))[1:] for seed in range(40)}
        seen = {}
        for _ in range(8):
            header, *parts = slow.receive()
            seen[msgpack.unpackb(header)["id"]] = parts
        assert seen == {seed: theirs[seed] for seed in range(8)}


def test_errors_cross_the_process_border(live):
    with Client(live[0]) as client:
        with pytest.raises(ServerError, match="unknown camera") as caught:
            client.render(STATE, "wac")
        assert (caught.value.code, caught.value.path) == ("scene", "camera")


def test_two_workers_render_at_once_and_status_does_not_wait(live):
    with Client(live[0], timeout_s=60.0) as client, Client(live[0]) as watcher:
        until(lambda: ready_workers(watcher) == 2)
        thread = threading.Thread(target=client.render, args=(STATE, "navcam"),
                                  kwargs={"samples": 16, "products": ["range", "r_body", "sunlit"]})
        thread.start()
        began = time.monotonic()
        assert watcher.status()["ok"]
        assert time.monotonic() - began < 0.5
        thread.join()


def test_a_killed_worker_is_replaced_and_its_request_answered(tmp_path):
    with serving.server(tmp_path, "--workers", "2") as (endpoint, process), Client(endpoint, timeout_s=60.0) as client:
        expected = client.render(STATE, "navcam").pixels
        for count in range(3):
            until(lambda count=count: client.status()["workers"] == {"ready": 2, "of": 2, "restarts": count})
            os.kill(children(process)[0], signal.SIGKILL)
            for _ in range(4):
                reply = client.render({**STATE, "t_s": time.monotonic()}, "navcam")
                np.testing.assert_array_equal(reply.pixels, expected)
        until(lambda: client.status()["workers"]["restarts"] == 3)
        assert "errors" in client.status() and client.status()["errors"] == {}


def test_a_request_that_kills_its_workers_is_poison_and_the_next_is_served(tmp_path):
    """Each time it is under way every worker is killed: tried twice, then told; nobody else suffers."""
    with serving.server(tmp_path, "--workers", "1", "--deadline", "50") as (endpoint, process), \
            Client(endpoint, timeout_s=60.0, retries=0) as client, Client(endpoint) as watcher:
        stop = threading.Event()

        def killer():
            # Only workers that are up and busy: a worker killed at its start has not begun the request.
            while not stop.is_set():
                status = watcher.status()["workers"]
                if status["ready"]:
                    time.sleep(0.02)
                    for number in children(process):
                        os.kill(number, signal.SIGKILL)
                    time.sleep(0.1)

        thread = threading.Thread(target=killer)
        thread.start()
        try:
            with pytest.raises(ServerError, match="the worker died on this request, 2 times") as caught:
                client.render(STATE, "navcam", samples=16, max_error=1e-4, products=["range", "r_body", "sunlit"])
            assert caught.value.code == "poison"
        finally:
            stop.set()
            thread.join()
        assert client.render(STATE, "bare").pixels.any()


SLOW = """
max_error = 0.1
[[bodies]]
name = "body"
generated = { kind = "icosphere", radius_m = 100.0, subdivisions = 3 }
brdf = { law = "lambert", normal_albedo = 0.2 }
[[cameras]]
name = "big"
width_px = 4096
height_px = 4096
focal_length_px = 30000.0
[[cameras]]
name = "bare"
width_px = 32
height_px = 32
focal_length_px = 100.0
"""


def test_a_request_that_takes_too_long_is_ended_and_told(tmp_path):
    with serving.server(tmp_path, "--workers", "1", "--deadline", "1", scene=SLOW) as (endpoint, _), \
            Client(endpoint, timeout_s=60.0, retries=0) as client:
        began = time.monotonic()
        with pytest.raises(ServerError, match="overran its deadline of 1 s on this request, once") as caught:
            client.render(STATE, "big", samples=16)
        assert caught.value.code == "poison" and time.monotonic() - began < 20.0
        assert client.status()["workers"]["restarts"] == 1, "it would take as long again"
        assert client.render(STATE, "bare").pixels.any()


@pytest.mark.slow
def test_a_new_scene_reaches_every_worker_and_those_that_come_later(tmp_path):
    scene = {"bodies": [{"name": "ball", "generated": {"kind": "icosphere", "radius_m": 50.0, "subdivisions": 3},
                         "brdf": {"law": "lambert", "normal_albedo": 0.5}}],
             "cameras": [{"name": "eye", "width_px": 20, "height_px": 10, "focal_length_px": 50.0}]}
    state = {**STATE, "bodies": {"ball": STATE["bodies"]["body"]}}
    with serving.server(tmp_path, "--workers", "2") as (endpoint, process):
        clients = [Client(endpoint, timeout_s=60.0) for _ in range(4)]
        until(lambda: ready_workers(clients[0]) == 2)
        clients[0].render(STATE, "navcam")
        assert clients[1].load_scene(scene)["bodies"][0]["name"] == "ball"
        assert clients[2].hello()["cameras"][0]["name"] == "eye"

        def fly(_):
            with Client(endpoint, timeout_s=60.0) as client:
                return [client.render({**state, "t_s": float(k)}).pixels.shape for k in range(20)]

        with ThreadPoolExecutor(4) as threads:
            assert list(threads.map(fly, range(4))) == 4 * [20 * [(10, 20)]]
        for number in children(process):
            os.kill(number, signal.SIGKILL)
        assert clients[3].render(state).pixels.shape == (10, 20)
        for client in clients:
            client.close()


def test_nothing_is_left_in_shared_memory_and_no_process_behind(tmp_path):
    with serving.server(tmp_path, "--workers", "2") as (endpoint, process):
        with Client(endpoint) as client:
            for k in range(10):
                client.render(STATE, "navcam", output="dn", seed=k)
        numbers = children(process)
        files = [Path(os.readlink(path)) for path in Path(f"/proc/{process.pid}/fd").iterdir()]
        files = {path for path in files if path.parent == Path("/dev/shm") and path.name.startswith("glrender-slot-")}
        assert len(numbers) == 2 and len(files) > 1 and all(path.exists() for path in files)
        process.send_signal(signal.SIGTERM)
        assert process.wait(20.0) == 0
    assert not any(path.exists() for path in files)
    assert not any(Path(f"/proc/{number}").exists() for number in numbers)
    assert "leaked" not in (tmp_path / "server.log").read_text()


def test_workers_end_when_the_server_is_killed(tmp_path):
    with serving.server(tmp_path, "--workers", "2") as (_, process):
        numbers = children(process)
        process.kill()
        process.wait()
        until(lambda: not any(Path(f"/proc/{number}").exists() for number in numbers), 10.0)


def test_a_pool_that_cannot_start_says_why(tmp_path, monkeypatch):
    (tmp_path / "scene.toml").write_text(serving.SCENE)
    # The spawned process cannot make a context of a backend that is none.
    with pytest.raises(DeviceError, match="a worker did not start: backend: must be one of"):
        workers.WorkerPool(load_scene(tmp_path / "scene.toml"), "vulkan", n_workers=2, deadline_s=5.0)


def test_one_worker_alone_reads_the_file_of_the_scene(tmp_path):
    """The others, and those that come when it has gone, have what was read."""
    source = tmp_path / "scene.toml"
    source.write_text(serving.SCENE)
    made = workers.WorkerPool(SceneFile(source), n_workers=2, deadline_s=20.0)
    try:
        source.unlink()
        until(lambda: made.turn({}) or made.described["workers"]["ready"] == 2)
        for worker in made._workers:
            worker.process.kill()
        until(lambda: made.turn({}) or (made.restarts == 2 and made.described["workers"]["ready"] == 2))
        source.write_text(serving.SCENE)
        assert made.described["scene"] == scene_digest(load_scene(source)) and not made.outage
    finally:
        made.close()


def test_a_file_that_no_scene_comes_from_is_named_with_its_field(tmp_path):
    source = tmp_path / "scene.toml"
    source.write_text(serving.SCENE.replace("radius_m", "radius_km"))
    with pytest.raises(ConfigError, match="radius_km: unknown key"):
        workers.WorkerPool(SceneFile(source), n_workers=2, deadline_s=20.0)
    with pytest.raises(ConfigError, match="none.toml"):
        workers.WorkerPool(SceneFile(tmp_path / "none.toml"), n_workers=1, deadline_s=20.0)


class Deadly:
    """The name of a file whose reader dies, as for want of memory."""

    def __reduce__(self):
        return os._exit, (3,)


def test_a_file_that_its_readers_die_of_is_given_up_after_three():
    began = time.monotonic()
    with pytest.raises(DeviceError, match="read the scene's file died"):
        workers.WorkerPool(SceneFile(Deadly()), n_workers=4, deadline_s=20.0)
    assert time.monotonic() - began < 60.0


def test_a_scene_larger_than_a_workers_memory_names_the_option(tmp_path):
    source = tmp_path / "scene.toml"
    source.write_text(serving.SCENE.replace("subdivisions = 4", "subdivisions = 9"))
    with pytest.raises(DeviceError, match="--worker-memory"):
        workers.WorkerPool(SceneFile(source), n_workers=1, deadline_s=20.0, memory_bytes=600 << 20)


@pytest.fixture
def pool(tmp_path):
    """One worker with a scene that no pipe holds."""
    (tmp_path / "scene.toml").write_text(serving.SCENE.replace("subdivisions = 4", "subdivisions = 5"))
    scene = load_scene(tmp_path / "scene.toml")
    assert len(pickle.dumps(scene)) > 2**17
    made = workers.WorkerPool(scene, n_workers=1, deadline_s=5.0)
    yield made
    made.close()


def turn_until_ready(pool, restarts):
    def is_ready():
        pool.turn({})
        return pool.restarts >= restarts and pool.described["workers"]["ready"] == 1

    # In a thread: a turn that waits for ever is no condition.
    thread = threading.Thread(target=until, args=(is_ready,), daemon=True)
    thread.start()
    thread.join(40.0)
    assert not thread.is_alive() and pool.restarts == restarts and pool.described["workers"]["ready"] == 1


def test_a_worker_that_is_killed_before_it_reads_its_scene_holds_nobody_up(pool, monkeypatch):
    """The server waited for ever: the pipe to the dead one was full, and the server held its other end itself."""
    spawn, spared = spawn_popen.util.spawnv_passfds, []

    def spawn_and_kill(*arguments):
        number = spawn(*arguments)
        if len(spared) < 2:
            os.kill(number, signal.SIGKILL)
        spared.append(number)
        return number

    monkeypatch.setattr(spawn_popen.util, "spawnv_passfds", spawn_and_kill)
    pool._workers[0].process.kill()
    turn_until_ready(pool, restarts=3)
    assert len(spared) == 3


def test_the_server_does_not_wait_while_a_worker_starts(pool):
    pool._workers[0].process.kill()
    longest, began = 0.0, time.monotonic()
    while pool.restarts < 1 or not pool.described["workers"]["ready"]:
        assert time.monotonic() < began + 60.0
        before = time.monotonic()
        pool.turn({})
        longest = max(longest, time.monotonic() - before)
        time.sleep(0.01)
    assert longest < 0.5 * (time.monotonic() - began)


class Places(workers.WorkerPool):
    """Places without processes, of a pool that serves a scene which was loaded."""

    def __init__(self):
        self._own_scene, self._scene = (b"own", "0"), (b"loaded", "1")
        self.generation, self._n_failed_scenes, self._n_killed_by_scene = 3, 0, 0
        self.restarts, self.outage, self._poller, self._dying = 0, "", None, []


def test_a_loaded_scene_that_kills_the_workers_which_open_it_gives_way_to_the_servers_own():
    """The system kills them for want of memory: the server had none for ever."""
    pool, worker = Places(), workers._Worker()

    def dies(state, generation):
        worker.state, worker.generation = state, generation
        pool._bury(worker)

    for _ in range(20):
        dies("starting", -1)
    assert not pool._is_own_scene, "before it has the scene somebody else kills it"
    for number in range(6):
        assert not pool._is_own_scene
        dies(("starting", "loading")[number % 2], 3)
    assert pool._is_own_scene and pool.generation == 4
    dies("starting", 4)
    assert pool._is_own_scene and pool.generation == 4


def test_a_system_without_room_for_a_worker_is_asked_again(pool, monkeypatch):
    pool._workers[0].process.kill()
    with monkeypatch.context() as patch:
        patch.setattr(workers.socket, "socketpair", mock.Mock(side_effect=OSError(24, "Too many open files")))
        until(lambda: pool.turn({}) or pool.restarts == 2)
        assert not pool.outage
        until(lambda: pool.turn({}) or pool.restarts == 3)
        assert pool.outage
    turn_until_ready(pool, restarts=3)
    assert not pool.outage


def test_a_slot_comes_back_only_when_the_last_view_of_it_is_gone():
    store = slots.SlotStore()
    try:
        slot = store.take(100_000)
        assert slot.size >= 100_000
        for place, text in zip(slots.room(slot, [2, 4]), (b"ab", b"cdef"), strict=True):
            place[:] = text
        place.release()
        (first, second), _ = store.lend(slot, [2, 4])
        assert bytes(first) == b"ab" and bytes(second) == b"cdef"
        other = store.take(100_000)
        assert other.name != slot.name, "in flight: not to be written"
        first = None
        gc.collect()
        assert store.take(100_000).name not in (slot.name, other.name)
        second = None
        gc.collect()
        assert store.take(90_000).name == slot.name
    finally:
        store.close()
