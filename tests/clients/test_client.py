"""The Python client's other ways: several in flight, asyncio, recording and replay."""

from __future__ import annotations

import asyncio
import contextlib
import gzip
import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
import time
import zlib

import forking
import msgpack
import numpy as np
import pytest
import serving
import views
import zmq
from glrender_client import (
    AsyncClient,
    Client,
    GlrenderClientError,
    RequestTimeout,
    ServerError,
    read_recording,
    replay,
)
from glrender_client.__main__ import main

STATE = views.state().to_dict()


@pytest.fixture(scope="module")
def endpoint(tmp_path_factory):
    with serving.server(tmp_path_factory.mktemp("one")) as (endpoint, _):
        yield endpoint


@pytest.fixture(scope="module")
def pooled(tmp_path_factory):
    """Two workers finish in any order."""
    with serving.server(tmp_path_factory.mktemp("two"), "--workers", "2") as (endpoint, _):
        yield endpoint


def requests(count):
    # Every fifth is much harder than its neighbours.
    return [{"state": {**STATE, "t_s": float(k)}, "camera": "navcam", "output": "dn", "seed": k,
             "samples": 8 if k % 5 == 0 else 1} for k in range(count)]


def test_noise_moves_without_a_seed_and_the_reply_tells_it(endpoint):
    """One count for `render`, `render_frames` and `render_many`; of what has noise alone. A given seed stays exact."""
    noisy = {"camera": "navcam", "output": "dn"}
    with Client(endpoint) as client:
        first, again, given = (client.render(STATE, **noisy, **seed) for seed in ({}, {}, {"seed": 0}))
        assert client.render(STATE, "navcam").header.get("seed") is None
        frames = client.render_frames(STATE, [noisy, {"camera": "bare"}, {**noisy, "seed": 9}, noisy])
        many = list(client.render_many([{"state": STATE, **noisy}] * 2))
    assert [reply.header["seed"] for reply in (first, again, given)] == [0, 1, 0]
    assert {"warnings", "notes", "stages"} <= set(first.header) and first.header["plan"]["predicted"]["centroid_px"] > 0
    np.testing.assert_array_equal(first.pixels, given.pixels)
    assert (first.pixels != again.pixels).mean() > 0.1
    assert [frame.header.get("seed") for frame in frames] == [2, None, 9, 3]
    assert [reply.header["seed"] for reply in many] == [4, 5]

    async def asked():
        async with AsyncClient(endpoint) as client:
            return [(await client.render(STATE, **noisy)).header["seed"] for _ in range(2)]

    assert asyncio.run(asked()) == [0, 1], "a client begins anew, and a program that runs again has the same frames"


def test_temporal_noise_of_a_scene_that_stands_still_is_emvas(tmp_path):
    """100 frames: K^2 (read noise^2 + electrons) + 1/12 DN^2 (EMVA 1288, eq. 16) within 3 %, over all lit pixels."""
    still = serving.SCENE.replace("exposure_s = 0.01", "exposure_s = 3e-7")
    with serving.server(tmp_path, scene=still) as (own, _), Client(own) as client:
        numbers = np.array([client.render(STATE, "navcam", output="dn").pixels for _ in range(100)], float)
    mean, variance = numbers.mean(axis=0), numbers.var(axis=0, ddof=1)
    lit = (mean > 300.0) & (mean < 3000.0)
    gain, read_noise_electrons = 0.1, 10.0
    expected = gain**2 * (read_noise_electrons**2 + mean[lit] / gain) + 1.0 / 12.0
    assert lit.sum() > 400
    np.testing.assert_allclose((variance[lit] / expected).mean(), 1.0, rtol=0.03)


class Proxy:
    """A ROUTER before the server that passes the n-th request on as often as a rule says: 0, 1 or 2 times."""

    def __init__(self, endpoint, rule):
        self._context = zmq.Context()
        self._front = self._context.socket(zmq.ROUTER)
        port = self._front.bind_to_random_port("tcp://127.0.0.1")
        self._server, self.endpoint = endpoint, f"tcp://127.0.0.1:{port}"
        self._rule, self._stop = rule, threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self._stop.set()
        self._thread.join()
        self._context.destroy(0)

    def _run(self):
        poller, backs, count = zmq.Poller(), {}, 0
        poller.register(self._front, zmq.POLLIN)
        while not self._stop.is_set():
            ready = dict(poller.poll(20))
            if self._front in ready:
                identity, message = self._front.recv_multipart()
                if identity not in backs:
                    backs[identity] = self._context.socket(zmq.DEALER)
                    backs[identity].connect(self._server)
                    poller.register(backs[identity], zmq.POLLIN)
                for _ in range(self._rule(count)):
                    backs[identity].send(message)
                count += 1
            for identity, back in backs.items():
                if back in ready:
                    self._front.send_multipart([identity, *back.recv_multipart()])


@pytest.mark.parametrize("in_flight", [1, 4, 16])
def test_many_in_flight_come_in_order_and_are_those_of_one_by_one(pooled, endpoint, in_flight):
    with Client(pooled, timeout_s=60.0) as many, Client(endpoint) as one:
        replies = list(many.render_many(requests(20), in_flight=in_flight))
        assert [reply.header["t_s"] for reply in replies] == list(range(20))
        for reply, request in zip(replies, requests(20), strict=True):
            np.testing.assert_array_equal(reply.pixels, one.render(**request).pixels)
        assert many.render(STATE, "bare").pixels.any(), "the client serves on"


def test_sending_ahead_takes_requests_only_as_they_are_needed(endpoint):
    taken = []

    def states():
        for request in requests(10):
            taken.append(request)
            yield request

    with Client(endpoint) as client:
        replies = client.render_many(states(), in_flight=3)
        assert next(replies).header["t_s"] == 0.0 and len(taken) == 3
        assert next(replies).header["t_s"] == 1.0 and len(taken) == 4
        replies.close()
        assert client.render({**STATE, "t_s": 99.0}, "bare").header["t_s"] == 99.0, "late replies are passed over"


def test_a_refusal_comes_in_its_place(pooled):
    some = requests(6)
    some[3]["camera"] = "wac"
    with Client(pooled, timeout_s=60.0) as client:
        replies = client.render_many(some)
        assert [next(replies).header["t_s"] for _ in range(3)] == [0.0, 1.0, 2.0]
        with pytest.raises(ServerError, match="unknown camera"):
            next(replies)
        assert client.hello()["ok"]


class Busy:
    """A server that says `busy` to the first requests, and that it wants to be asked again in 20 ms."""

    def __init__(self, n_refusals):
        self.n_asked, self.n_refusals, self.headers = 0, n_refusals, []
        self.context = zmq.Context()
        self.socket = self.context.socket(zmq.ROUTER)
        self.endpoint = f"tcp://127.0.0.1:{self.socket.bind_to_random_port('tcp://127.0.0.1')}"
        self.is_open = True
        self.thread = threading.Thread(target=self.serve)
        self.thread.start()

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self.is_open = False
        self.thread.join()
        self.socket.close(0)
        self.context.term()

    def serve(self):
        while self.is_open:
            if self.socket.poll(50):
                identity, message = self.socket.recv_multipart()
                header = msgpack.unpackb(message)
                self.headers.append(header)
                self.n_asked += header["op"] != "close"
                said = ({"ok": True} if self.n_asked > self.n_refusals else {"ok": False, "error": {
                    "code": "busy", "path": "", "message": "others", "retry_after_s": 0.02}})
                self.socket.send_multipart([identity, msgpack.packb({
                    "v": 1, "op": header["op"], "id": header["id"], "client": "", "arrays": [], **said})])


def test_an_older_server_which_names_no_scene_is_asked_for_none():
    """It refuses fields that it does not know; what was loaded from another server is forgotten."""
    with Busy(n_refusals=0) as server, Client(server.endpoint) as client:
        client._pack.scene = "0" * 32
        client.load_scene({})
        client.render(STATE)

        async def ask():
            async with AsyncClient(server.endpoint) as other:
                await other.load_scene({})
                await other.range(STATE, [[0.0, 0.0, 1.0]])

        asyncio.run(ask())
        asked = [header for header in server.headers if header["op"] in ("render", "range")]
        assert len(asked) == 2 and not any("scene" in header for header in asked)


def test_a_busy_server_is_asked_again():
    with Busy(n_refusals=4) as server, Client(server.endpoint) as client:
        assert client.status()["ok"] and server.n_asked == 5
    with Busy(n_refusals=4) as server, Client(server.endpoint) as client:
        assert len(list(client.render_many(requests(3), in_flight=2))) == 3

    async def ask(endpoint):
        async with AsyncClient(endpoint) as client:
            return await client.status()

    with Busy(n_refusals=4) as server:
        assert asyncio.run(ask(server.endpoint))["ok"] and server.n_asked == 5


def test_a_server_that_stays_busy_is_told_in_time():
    with Busy(n_refusals=1000) as server, Client(server.endpoint, timeout_s=0.5) as client:
        began = time.monotonic()
        with pytest.raises(ServerError, match="others") as caught:
            client.status()
        assert caught.value.code == "busy" and caught.value.retry_after_s == 0.02
        assert time.monotonic() - began < 1.5 and 3 < server.n_asked < 12


def test_lost_requests_are_asked_again(endpoint):
    # Three are lost, three come twice.
    with Proxy(endpoint, lambda count: {1: 0, 4: 0, 9: 0, 2: 2, 5: 2, 7: 2}.get(count, 1)) as proxy, \
            Client(proxy.endpoint, timeout_s=1.0, retries=5) as client:
        replies = list(client.render_many([{"state": {**STATE, "t_s": float(k)}, "camera": "bare"} for k in range(12)]))
        assert [reply.header["t_s"] for reply in replies] == list(range(12))


def test_without_a_server_many_time_out_too():
    with Client("tcp://127.0.0.1:1", timeout_s=0.2, retries=1) as client, \
            pytest.raises(RequestTimeout, match="2 times"):
        next(client.render_many(requests(3)))


@pytest.mark.parametrize("in_flight", [0, 17])
def test_too_many_in_flight_are_refused(endpoint, in_flight):
    with Client(endpoint) as client, pytest.raises(ValueError, match="1 to 16"):
        client.render_many([], in_flight=in_flight)


def test_asyncio_requests_at_once_get_their_own_replies(pooled, endpoint):
    async def fly():
        async with AsyncClient(pooled, timeout_s=60.0) as client:
            replies = await asyncio.gather(*(client.render(**request) for request in requests(16)))
            with pytest.raises(ServerError, match="unknown camera") as caught:
                await client.render(STATE, "wac")
            assert caught.value.code == "scene"
            assert (await client.hello())["protocol"] == [1] and (await client.status())["ok"]
            return replies

    replies = asyncio.run(fly())
    assert [reply.header["t_s"] for reply in replies] == list(range(16))
    with Client(endpoint) as one:
        for reply, request in zip(replies, requests(16), strict=True):
            np.testing.assert_array_equal(reply.pixels, one.render(**request).pixels)


def test_asyncio_does_not_block_the_loop_and_can_be_cancelled(endpoint):
    async def fly():
        ticks = 0

        async def tick():
            nonlocal ticks
            while True:
                await asyncio.sleep(0.01)
                ticks += 1

        async with AsyncClient(endpoint, timeout_s=60.0) as client:
            ticker = asyncio.create_task(tick())
            for _ in range(5):
                await client.render(STATE, "navcam", samples=16, products=["r_body"])
            task = asyncio.create_task(client.render(STATE, "navcam", samples=16))
            await asyncio.sleep(0)
            task.cancel()
            assert (await client.render({**STATE, "t_s": 5.0}, "bare")).header["t_s"] == 5.0
            ticker.cancel()
        return ticks

    assert asyncio.run(fly()) > 1


def test_asyncio_retries_and_times_out(endpoint):
    async def lossy(address):
        async with AsyncClient(address, timeout_s=0.5, retries=3) as client:
            return [(await client.render({**STATE, "t_s": float(k)}, "bare")).header["t_s"] for k in range(4)]

    with Proxy(endpoint, lambda count: 0 if count % 2 else 1) as proxy:
        assert asyncio.run(lossy(proxy.endpoint)) == [0.0, 1.0, 2.0, 3.0]

    async def nobody():
        async with AsyncClient("tcp://127.0.0.1:1", timeout_s=0.2, retries=0) as client:
            await client.hello()

    with pytest.raises(RequestTimeout, match="1 times"):
        asyncio.run(nobody())
    with pytest.raises(GlrenderClientError, match="async with"):
        asyncio.run(AsyncClient(endpoint).hello())


def test_a_scene_may_take_longer_than_a_frame():
    """Nobody answers: by the time that was given for it, and what to do."""
    hint = "`load_scene` within 0.3 s, 1 times: nothing listens .* there.; a large shape takes minutes the first"

    async def load():
        async with AsyncClient("tcp://127.0.0.1:1", timeout_s=60.0, retries=0) as client:
            await client.load_scene({}, timeout_s=0.3)

    with pytest.raises(RequestTimeout, match=hint):
        asyncio.run(load())
    with Client("tcp://127.0.0.1:1", timeout_s=60.0, retries=0) as client, pytest.raises(RequestTimeout, match=hint):
        client.load_scene({}, timeout_s=0.3)
    with Client("tcp://127.0.0.1:1") as client, pytest.raises(ValueError, match="timeout_s must be > 0, got 0.0"):
        client.load_scene({}, timeout_s=0.0)


@pytest.fixture
def recording(endpoint, tmp_path):
    path = tmp_path / "flight.glr"
    with Client(endpoint, record=path) as client:
        client.hello()
        client.render(STATE, "navcam", output="dn", seed=3, products=["range", "r_body"])
        client.render(STATE, "navcam", order="F")
        with pytest.raises(ServerError):
            client.render(STATE, "wac")
        list(client.render_many(requests(5)))
    return path


def test_a_recording_holds_what_went_over_the_wire(recording, endpoint):
    exchanges = list(read_recording(recording))
    assert [msgpack.unpackb(request)["op"] for request, _ in exchanges] == ["hello"] + 8 * ["render"] + ["close"]
    with Client(endpoint) as client:
        reply = client.render(STATE, "navcam", output="dn", seed=3)
    assert exchanges[1].reply[1] == reply.pixels.tobytes()
    assert msgpack.unpackb(exchanges[3].reply[0])["error"]["code"] == "scene"
    with pytest.raises(FileExistsError, match="record: .*flight.glr is there already, .* give the name of a new file"):
        Client(endpoint, record=recording)
    with pytest.raises(FileNotFoundError, match="record: .*none/flight.glr cannot be made: .* a folder that is there"):
        Client(endpoint, record=recording.parent / "none" / "flight.glr")


def test_an_empty_recording_is_no_comparison(endpoint, tmp_path, capsys):
    """Nothing was asked: "0 differ" would be a lie."""
    Client(endpoint, record=tmp_path / "empty.glr").close()
    with pytest.raises(GlrenderClientError, match="empty.glr holds no exchange"):
        list(replay(tmp_path / "empty.glr", endpoint))
    assert main([str(tmp_path / "empty.glr"), endpoint]) == 1
    said = capsys.readouterr()
    assert "holds no exchange" in said.err and "differ" not in said.out


def test_a_state_is_sent_as_its_dictionary(endpoint):
    """glrender's State, or poses of it within a dictionary; what cannot be sent is named with what can."""
    state = views.state()
    with Client(endpoint) as client:
        plain = client.render(STATE, "navcam").pixels
        for given in (state, {**STATE, "spacecraft": state.spacecraft}):
            assert client.render(given, "navcam").pixels.tobytes() == plain.tobytes()
        assert next(client.render_many([{"state": state, "camera": "navcam"}])).pixels.tobytes() == plain.tobytes()
        assert client.range(state, [[0.0, 0.0, 1.0]], "navcam").arrays["range"].shape == (1,)
        with pytest.raises(TypeError, match="object cannot be sent; give numbers, .* or what has `to_dict`"):
            client.render(object(), "navcam")
        with pytest.raises(ValueError, match="integers must be between .* got 18446744073709551616"):
            client.render(state, "navcam", output="dn", seed=2**64)

    async def asked():
        async with AsyncClient(endpoint) as client:
            return (await client.render(state, "navcam")).pixels

    assert asyncio.run(asked()).tobytes() == plain.tobytes()


@contextlib.contextmanager
def _listeners():
    """Endpoints of a ROUTER that answers nothing, one with CURVE, and a bare TCP socket."""
    context, bare = zmq.Context(), socket.create_server(("127.0.0.1", 0))
    with bare:
        routers = [context.socket(zmq.ROUTER) for _ in range(2)]
        routers[1].curve_publickey, routers[1].curve_secretkey = zmq.curve_keypair()
        routers[1].curve_server = True
        ports = [router.bind_to_random_port("tcp://127.0.0.1") for router in routers]
        yield [f"tcp://127.0.0.1:{port}" for port in (*ports, bare.getsockname()[1])]
    context.destroy(0)


def test_a_busy_server_an_absent_one_and_a_stranger_are_told_apart(tmp_path):
    """By what listens there; each way of asking says it."""
    busy, absent = "there, and busy, .* longer `timeout_s`", "nothing listens there; is glrender-server running there"
    strange = "does not greet as glrender-server does: .* stopped, .* CURVE, which needs `key` and `server_key`"

    async def hello(address):
        async with AsyncClient(address, timeout_s=0.1, retries=0) as client:
            await client.hello()

    with _listeners() as (silent, curve, bare):
        for address, said in ((silent, busy), (curve, strange), (bare, strange), ("tcp://127.0.0.1:1", absent),
                              (f"ipc://{tmp_path}/none", absent)):
            with Client(address, timeout_s=0.1, retries=1) as client:
                with pytest.raises(RequestTimeout, match=f"did not answer `hello` within 0.1 s, 2 times: .*{said}"):
                    client.hello()
                with pytest.raises(RequestTimeout, match=said):
                    next(client.render_many([{"state": STATE}]))
        for address, said in ((silent, busy), ("tcp://127.0.0.1:1", absent)):
            with pytest.raises(RequestTimeout, match=said):
                asyncio.run(hello(address))


def test_a_server_that_draws_is_busy_and_a_stopped_one_is_not(tmp_path):
    """A real one, in a frame of seconds; then held by a signal, when even the system's part of it says nothing."""
    with serving.server(tmp_path) as (endpoint, process):
        frames = [{"camera": "navcam", "max_error": 1e-4}] * 10
        with Client(endpoint, timeout_s=0.1, retries=0) as client:
            with pytest.raises(RequestTimeout, match="`render` within 0.1 s, 1 times: a server is there, and busy"):
                client.render_frames(STATE, frames, backend="raytrace")
            process.send_signal(signal.SIGSTOP)
            with pytest.raises(RequestTimeout, match="does not greet as glrender-server does"):
                client.status()


def test_threads_that_share_a_client_are_told_at_once(endpoint):
    """The thread that used it first, or the next after that one's end; any other is refused before it waits."""
    with Client(endpoint) as client:
        told, used, done = [], threading.Event(), threading.Event()

        def first():
            client.hello()
            used.set()
            done.wait(30.0)

        thread = threading.Thread(target=first, name="first")
        thread.start()
        assert used.wait(30.0)
        for ask in (client.hello, lambda: client.render(STATE, "navcam"), lambda: next(client.render_many([])),
                    client.close):
            began = time.monotonic()
            with pytest.raises(GlrenderClientError, match="used by thread 'first', .* make one client in each thread"):
                ask()
            told.append(time.monotonic() - began)
        assert max(told) < 1.0
        done.set()
        thread.join()
        assert client.hello()["ok"], "the first has ended"


def test_a_child_is_told_that_a_client_is_its_parents(endpoint):
    """Forked, it is refused at once, closes nothing of its parent's, and makes its own; sent, it cannot be pickled."""
    with Client(endpoint) as client:
        before = client.render(STATE, "navcam").pixels.tobytes()

        def child():
            with client:
                with pytest.raises(GlrenderClientError, match=f"belongs to process {os.getppid()}, .* make one client"):
                    client.hello()
            with Client(endpoint) as own:
                return zlib.crc32(own.render(STATE, "navcam").pixels)

        assert forking.in_child(child) == zlib.crc32(before)
        assert client.render(STATE, "navcam").pixels.tobytes() == before
        for each in (client, AsyncClient(endpoint)):
            with pytest.raises(TypeError, match="send the endpoint, and make one client in each process"):
                pickle.dumps(each)


def test_a_replay_gives_the_same_bytes_on_another_server(recording, pooled, endpoint, tmp_path, capsys):
    with serving.server(tmp_path) as (other, _):
        assert list(replay(recording, other)) == [None] * 10
    assert main([str(recording), endpoint]) == 0
    assert capsys.readouterr().out == "10 exchanges, 0 differ\n"


def test_a_replay_draws_anew(recording, endpoint):
    with Client(endpoint) as client:
        before = client.status()["requests"]["render"]
        list(replay(recording, endpoint))
        assert client.status()["requests"]["render"] == before + 8


def test_a_replay_finds_another_scene_and_a_changed_byte(recording, tmp_path, capsys, endpoint):
    brighter = serving.SCENE.replace("normal_albedo = 0.2", "normal_albedo = 0.21")
    with serving.server(tmp_path, scene=brighter) as (other, _):
        found = [result for result in replay(recording, other) if result is not None]
        # All frames differ, and hello by its scene's digest; the refusal does not.
        assert [difference.index for difference in found] == [0, 1, 2, 4, 5, 6, 7, 8]
        assert found[0].what.startswith("scene: ")
        assert main([str(recording), other]) == 1
    data = bytearray(gzip.decompress(recording.read_bytes()))
    second = list(read_recording(recording))[1].reply[1]
    data[data.index(second) + len(second) // 2] ^= 1
    (tmp_path / "changed").write_bytes(gzip.compress(data))
    found = list(replay(tmp_path / "changed", endpoint))
    assert found[1] == (1, 2, "pixels of image") and found.count(None) == 9


def test_a_recording_cut_short_says_so(recording, tmp_path, rng):
    data = recording.read_bytes()
    plain = gzip.decompress(data)
    for content, size in [*((data, size) for size in rng.integers(10, len(data) - 1, 20)),
                          *((plain, size) for size in rng.integers(1, len(plain) - 1, 20))]:
        cut = content[:size]
        (tmp_path / "cut").write_bytes(cut if content is data else gzip.compress(cut))
        with pytest.raises(GlrenderClientError, match="has no end" if content is data else "ends within a message"):
            for whole, exchange in enumerate(read_recording(tmp_path / "cut")):
                assert whole < 10 and exchange.reply
    for foreign in (b"PNG and more", gzip.compress(b"PNG and more"), data[:40] + bytes(40) + data[80:]):
        (tmp_path / "none").write_bytes(foreign)
        with pytest.raises(GlrenderClientError, match="is no recording|has no end"):
            list(read_recording(tmp_path / "none"))


@pytest.mark.parametrize("request_bytes", [b"xx", msgpack.packb({}), msgpack.packb([1])])
def test_a_recording_of_other_messages_says_so(tmp_path, capsys, request_bytes):
    message = b"GLR1" + bytes([1, 0, 0, 0, len(request_bytes), 0, 0, 0]) + request_bytes
    (tmp_path / "other.glr").write_bytes(gzip.compress(message + message[:6] + b"\1" + message[7:]))
    assert main([str(tmp_path / "other.glr"), "tcp://127.0.0.1:9"]) == 1
    assert "other.glr, exchange 0: holds no request of a client" in capsys.readouterr().err


def recorded_apart(endpoint, path, code):
    """A process that records with its `client`, and ends as `code` has it."""
    code = f"import os, resource, time; from glrender_client import Client\n{code}".replace(
        "CLIENT", f"Client({endpoint!r}, record={str(path)!r})")
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)


def test_a_killed_client_leaves_what_it_recorded(endpoint, tmp_path):
    recorded_apart(endpoint, tmp_path / "killed.glr", "client = CLIENT\nfor _ in range(3): client.status()\n"
                                                      "time.sleep(2.0); os.kill(os.getpid(), 9)")
    found = []
    with pytest.raises(GlrenderClientError, match="who recorded it was killed, or still records"):
        for exchange in read_recording(tmp_path / "killed.glr"):
            found.append(exchange)
    assert len(found) == 3


def test_a_full_disk_ends_the_loop_that_records(endpoint, tmp_path):
    run = recorded_apart(endpoint, tmp_path / "full.glr", "resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))\n"
                                                          "with CLIENT as client:\n"
                                                          "    for _ in range(1000): client.status()")
    assert run.returncode == 1 and "File too large" in run.stderr, run.stderr


@pytest.mark.parametrize("address", ["nonsense", "", "tcp://127.0.0.1", "tcp://127.0.0.1:port"])
def test_what_is_no_address_is_refused_at_once(address, tmp_path):
    """A socket that is connected to nothing would block whoever sends, and the end of the program."""
    with Client(address, retries=0) as client, pytest.raises(GlrenderClientError, match="endpoint must be tcp://HOST"):
        client.hello()

    async def ask():
        async with AsyncClient(address) as client:
            await client.hello()

    with pytest.raises(GlrenderClientError, match="endpoint must be tcp://HOST"):
        asyncio.run(ask())
    with pytest.raises(GlrenderClientError, match="endpoint must be tcp://HOST"):
        list(replay(tmp_path / "none", address))


def test_a_very_long_time_is_allowed(endpoint):
    with Client(endpoint, timeout_s=1e300) as client:
        assert client.hello()["ok"]
