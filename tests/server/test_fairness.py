"""What one client asks for leaves the others served: its slow frames, scenes, floods, and what it does not read."""

from __future__ import annotations

import itertools
import math
import threading
import time
import tomllib
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import msgpack
import pytest
import serving
import views
import zmq
from glrender_client import Client, ServerError
from glrender_server import dispatcher, workers
from glrender_server.dispatcher import Dispatcher
from glrender_server.front import Request
from glrender_server.job import Done, Job
from glrender_server.workers import WorkerPool, _Task, _Worker

STATE = views.state().to_dict()
LARGE = serving.SCENE + """
[[cameras]]
name = "large"
width_px = 2048
height_px = 2048
focal_length_px = 12000.0
"""
COSTLY = {"camera": "large", "samples": 10}


def head(op, number, client, **fields):
    return msgpack.packb({"v": 1, "op": op, "id": number, "client": client, **fields})


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """A server of two workers."""
    with serving.server(tmp_path_factory.mktemp("pair"), "--workers", "2", "--slow-deadline", "8",
                        scene=LARGE) as (endpoint, process):
        with Client(endpoint, timeout_s=60.0) as client:
            serving.until(lambda: client.status()["workers"]["ready"] == 2)
        yield endpoint, process


@pytest.fixture
def greedy(pair):
    """A connection that sends ahead and reads nothing by itself."""
    with zmq.Context() as context, context.socket(zmq.DEALER) as socket:
        socket.set(zmq.LINGER, 0)
        socket.set(zmq.RCVHWM, 1)
        socket.connect(pair[0])
        yield socket


def longest_s(client, n_frames=5):
    waits = []
    for number in range(n_frames):
        began = time.monotonic()
        assert client.render({**STATE, "t_s": float(number)}, "bare").pixels.any()
        waits.append(time.monotonic() - began)
    return max(waits)


def test_costly_frames_of_one_client_leave_a_worker_for_others(pair, greedy):
    with Client(pair[0], timeout_s=60.0) as client:
        assert client.render(STATE, "bare").pixels.any()
        for number in range(4):
            greedy.send(head("render", number, "greedy", state={**STATE, "t_s": float(number)}, **COSTLY))
        time.sleep(0.3)
        alone, beside = client.status()["waiting"], longest_s(client)
        assert alone == 3, "one is drawn"
        assert beside < 3.0
        for number in range(4):
            assert greedy.poll(60_000)
            assert msgpack.unpackb(greedy.recv_multipart()[0])["id"] == number


def test_the_old_scene_is_served_while_a_new_one_is_loaded(pair):
    scene = tomllib.loads(LARGE)
    scene["bodies"] = [{"name": f"b{k}", "generated": {"kind": "icosphere", "radius_m": 10.0 + k, "subdivisions": 8},
                        "brdf": scene["bodies"][0]["brdf"]} for k in range(6)]
    told = []

    def load():
        with Client(pair[0], timeout_s=60.0, retries=0) as operator:
            try:
                told.append(operator.load_scene(scene)["bodies"])
            except ServerError as error:
                told.append(error.code)

    # All clients of this process are one account, which a quick frame so long after its last slow one makes quick.
    time.sleep(dispatcher._SLOW_FOR_S)
    with Client(pair[0], timeout_s=60.0) as client:
        client.render(STATE, "bare")
        loading = threading.Thread(target=load)
        loading.start()
        time.sleep(0.3)
        assert longest_s(client) < 3.0 and loading.is_alive(), "it takes longer than its deadline"
        loading.join()
        assert told == ["poison"], "and is not tried twice"
        assert client.hello()["bodies"][0]["name"] == "body"


def test_a_new_scene_shows_in_every_reply_after_it(pair):
    scene = tomllib.loads(LARGE)
    dark = {**scene, "bodies": [{**scene["bodies"][0], "brdf": {"law": "lambert", "normal_albedo": 0.02}}]}
    request = head("render", 7, "bench", state=STATE, camera="bare")
    with zmq.Context() as context, context.socket(zmq.DEALER) as socket, Client(pair[0], timeout_s=60.0) as client:
        socket.set(zmq.LINGER, 0)
        socket.connect(pair[0])

        def pixels():
            socket.send(request)
            assert socket.poll(30_000)
            return socket.recv_multipart()[1]

        before = pixels()
        assert pixels() == before
        client.load_scene(dark)
        after = pixels()
        assert after == client.render(STATE, "bare").pixels.tobytes() != before
        client.load_scene(scene)
        assert pixels() == before


def test_status_is_answered_while_the_only_worker_draws(tmp_path):
    with serving.server(tmp_path, scene=LARGE) as (endpoint, _), Client(endpoint, timeout_s=60.0) as client, \
            zmq.Context() as context, context.socket(zmq.DEALER) as socket:
        socket.set(zmq.LINGER, 0)
        socket.connect(endpoint)
        client.hello()
        socket.send(head("render", 1, "other", state=STATE, **COSTLY))
        time.sleep(0.5)
        began = time.monotonic()
        client.hello()
        assert client.status()["workers"]["ready"] == 1 and time.monotonic() - began < 1.0
        assert not socket.poll(0), "it is still drawn"
        assert socket.poll(60_000)


def test_who_does_not_read_is_told_busy_and_keeps_no_memory(pair, greedy):
    def held_bytes():
        status = Path(f"/proc/{pair[1].pid}/status").read_text().splitlines()
        return 1024 * sum(int(line.split()[1]) for line in status if line.startswith(("RssAnon", "RssShmem")))

    with Client(pair[0], timeout_s=60.0) as client:
        client.render(STATE, "large", samples=1)
        before, errors = held_bytes(), client.status()["errors"].get("busy", 0)
        for number in range(40):  # of 16 MiB
            state = {**STATE, "t_s": float(number)}
            greedy.send(head("render", number, "greedy", state=state, camera="large", samples=1))
            client.render(state, "bare")
        serving.until(lambda: client.status()["waiting"] == 0)
        assert held_bytes() - before < 200 * 2**20, "64 MiB untaken, those under way, and what is kept for retries"
        assert client.status()["errors"].get("busy", 0) - errors > 20


class Pool(WorkerPool):
    """Workers of which only the states are looked at."""

    def __init__(self, *jobs):
        self._workers = [_Worker(state="idle" if job is None else "busy", task=job and _Task(job)) for job in jobs]
        self._again, self.generation, self._quick_at = [], 0, -math.inf


def job(sender, op="render", is_quick=True, account=None, **fields):
    return Job({"op": op, "is_slow": False, **fields}, b"", lambda done: None, sender,
               account or sender, is_quick)


def test_the_last_free_worker_is_kept_for_who_is_quick_however_many_connections_others_have():
    pool = Pool(job("a", is_quick=False), None)
    assert pool.has_room(job("b", is_quick=False)), "nobody who is quick has asked"
    pool._quick_at = time.monotonic()
    assert not pool.has_room(job("b", is_quick=False)) and pool.has_room(job("c"))
    beside_quick = Pool(job("a"), None)
    beside_quick._quick_at = pool._quick_at
    assert beside_quick.has_room(job("b", is_quick=False)), "a new client waits for no quick one"
    pool._quick_at -= workers._KEPT_FOR_QUICK_S
    assert pool.has_room(job("b", is_quick=False))


def test_a_client_is_quick_once_it_has_been_and_not_soon_after_a_slow_frame(monkeypatch):
    """New ones are believed to be where eight have been: else 256 at once would wait for one worker of two."""
    served, now = Dispatcher(SimpleNamespace(described={}, make_room=None)), [100.0]
    monkeypatch.setattr(dispatcher.time, "monotonic", lambda: now[0])

    def request_of(sender, ms):
        served._remember(sender, Done([], "", {"total": ms} if ms else {}), now[0])

    for number in range(20):
        request_of(number, 7.0)
        assert served._is_quick(number) and served._is_quick("new") == (number >= 7)
    request_of(0, 2000.0)
    assert not served._is_quick("new") and not served._is_quick(0), "any slow frame ends the belief"
    waited = job("new", is_quick=False)
    assert served._known_by_now(waited) is waited
    request_of("new", 7.0)
    waited = served._known_by_now(waited)
    assert waited.is_quick
    request_of("new", 2000.0)
    assert not served._known_by_now(waited).is_quick, "it was when it came"
    request_of("new", 7.0)
    assert not served._is_quick("new"), "a quick frame between two slow ones makes no quick client"
    now[0] += 4.0
    assert not served._is_quick("new") and served._is_quick(1)
    now[0] += 1.0
    assert not served._is_quick("new"), "time alone makes none either"
    request_of("new", 7.0)
    assert served._is_quick("new")
    served._remember("new", Done([], "poison", {}), now[0])
    assert not served._is_quick("new")


def test_a_clients_slow_frames_are_known_of_all_its_connections():
    """Each new connection was a new client, which might have every worker."""
    started = []
    engine = SimpleNamespace(described={}, make_room=None, outage="", is_full=False, draws_here=False, generation=0,
                             has_room=lambda job: True, start=started.append)
    served = Dispatcher(engine)

    def is_known_to_be_quick(sender, number, ms, account=None):
        served.submit(Request(sender, [head("render", number, "x")], lambda reply: None, account=account))
        served.work()
        started[-1].done(Done([b"\x80"], "", {"total": ms}))
        return started[-1].is_quick

    assert not is_known_to_be_quick("first", 0, 7.0, "process")
    assert is_known_to_be_quick("first", 1, 2000.0, "process")
    assert not is_known_to_be_quick("second", 2, 7.0, "process")
    assert not is_known_to_be_quick("alone", 3, 7.0) and is_known_to_be_quick("alone", 4, 7.0)
    assert {job.account for job in started} == {"process", "alone"}
    assert {job.sender for job in started} == {"first", "second", "alone"}


class Simulated(Pool):
    """Two workers whose frames take the seconds that their requests name as their client."""

    described, make_room, outage, draws_here = {}, None, "", False

    def __init__(self, now):
        super().__init__(None, None)
        self._now, self.begun = now, []

    def start(self, job):
        worker = next(worker for worker in self._workers if worker.state == "idle")
        worker.state, worker.task = "busy", _Task(job)
        worker.deadline = self._now[0] + float(job.header["client"])
        self.begun.append((self._now[0], job.sender))
        if job.is_quick:
            self._quick_at = self._now[0]

    def turn(self):
        for worker in self._workers:
            if worker.state == "busy" and worker.deadline <= self._now[0]:
                asked, worker.state, worker.task = worker.task.job, "idle", None
                asked.done(Done([b"\x80"], "", {"total": 1e3 * float(asked.header["client"])}))


@pytest.mark.parametrize("n_ahead", [1, 3])
def test_quick_clients_that_turn_slow_have_one_turn_each_before_who_stays_quick(n_ahead, monkeypatch):
    """They were quick again 5 s after a frame, for which the next had waited, and for all that they had sent before."""
    now, number, waits = [100.0], itertools.count(), []
    for module in (dispatcher, workers):
        monkeypatch.setattr(module.time, "monotonic", lambda: now[0])
    engine = Simulated(now)
    served = Dispatcher(engine)

    def ask(sender, seconds, n_times=1):
        for _ in range(n_times):
            served.submit(Request(sender, [head("render", next(number), str(seconds))],
                                  partial(answered, sender, now[0])))

    def answered(sender, asked, reply):
        if sender == "quick":
            waits.append(now[0] - asked)
        elif now[0] > 110.0:
            ask(sender, 10.0)

    def pass_until(end):
        while now[0] < end:
            engine.turn()
            served.work()
            now[0] += 0.125

    for sender in ("a", "b", "c", "d", "quick"):
        ask(sender, 0.125)
    pass_until(111.0)
    for sender in "abcd":
        ask(sender, 10.0, n_ahead)
    for _ in range(60):
        ask("quick", 0.125)
        pass_until(now[0] + 1.0)
    pass_until(now[0] + 20.0)
    assert len(waits) == 61 and max(waits) <= 20.25, "two turns of two"
    assert max(waits[30:]) < 1.0
    assert {sender for began, sender in engine.begun if began > 140.0} == {"a", "b", "c", "d", "quick"}


def test_no_frame_is_drawn_for_who_has_gone():
    """Some hundred clients that asked and went had their turns before those who waited: 60 s on a busy machine."""
    started, there = [], {"gone": False}
    served = Dispatcher(SimpleNamespace(described={}, make_room=None, outage="", is_full=True, draws_here=False,
                                        generation=0, has_room=lambda job: True, start=started.append))

    def ask(sender, op, client):
        served.submit(Request(sender, [head(op, 1, client)], lambda reply: None,
                              is_there=lambda: there.get(sender, True)))

    for sender, op, client in (("gone", "render", "a"), ("gone", "load_scene", "b"), ("gone", "render", "c"),
                               ("again", "render", "c"), ("here", "render", "d"), ("gone", "range", "e")):
        ask(sender, op, client)
    assert not started and not served.is_idle
    served._engine.is_full = False
    served.work()
    assert {each.header["client"] for each in started} == {"b", "c", "d"}
    for each in started:
        each.done(Done([b"\x80"], "", {"total": 7.0}))
    assert not served._under_way
    there["gone"] = True
    ask("gone", "render", "a")
    served.work()
    assert started[-1].header["client"] == "a", "a retry is drawn"


def test_while_a_worker_starts_the_other_is_kept_for_who_is_quick():
    """A slow frame that overran its deadline was followed by the next on the worker that was left: 55 s for others."""
    pool = Pool(None, None)
    slow, new, quick = job("a", is_slow=True), job("b", is_quick=False), job("c")

    def have_room():
        return [pool.has_room(each) for each in (slow, new, quick)]

    assert have_room() == [True, True, True]
    pool._workers[0].state = "starting"
    assert have_room() == [True, True, True], "somebody killed it"
    pool._workers[0].is_after_overrun = True
    for state in ("starting", "loading", "down"):
        now, pool._workers[0].state = time.monotonic(), state
        pool._workers[0].deadline, pool._workers[0].deadline_s, pool._workers[0].start_at = now + 50.0, 60.0, now + 0.5
        assert have_room() == [False, True, True], "nobody quick has asked"
        pool._quick_at = time.monotonic()
        assert have_room() == [False, False, True]
        pool._quick_at = -math.inf
    for state in ("starting", "loading", "down"):
        pool._workers[0].state, pool._workers[0].deadline, pool._workers[0].start_at = state, now + 20.0, now + 20.0
        assert have_room() == [True, True, True], "one that comes late is not waited for"
    lone = Pool(None)
    assert lone.has_room(slow) and lone.has_room(new)


def test_who_is_slow_has_the_last_worker_where_the_other_is_killed_again_and_again():
    """A container whose memory holds one worker kills the other at each start: slow frames waited for ever."""
    pool = Pool(None, job("a", is_slow=True, id=1, client="a"))
    pool._scene = pool._own_scene = b"", "0"
    pool._poller, pool._dying, pool.restarts, pool.outage = None, [], 0, ""
    other = pool._workers[1]
    other.overran = True
    pool._bury(other)
    assert not pool.has_room(job("b", is_slow=True)), "it may be ready in seconds"
    # As a process that has begun, and that a signal ended.
    other.state, other.overran = "starting", False
    other.deadline, other.deadline_s = time.monotonic() + 60.0, 60.0
    pool._bury(other)
    for other.state in ("down", "starting"):
        assert pool.has_room(job("b", is_slow=True))


def test_a_pool_is_full_where_no_job_at_all_has_room():
    assert Pool(job("a")).is_full and not Pool(job("a"), None).is_full
    behind = Pool(None)
    behind.generation = 1
    assert behind.is_full and not behind.has_room(job("a")), "it has still to load the scene that is served"


@pytest.mark.parametrize("under_way, asked, has_room", [
    ([None], job("a", is_quick=False), True),
    ([job("a")], job("b"), False),
    ([job("a"), None], job("a"), True),
    ([job("a"), None], job("a", is_quick=False), False),
    ([job("a"), None], job("b", is_quick=False), True),
    ([job("a"), None, None], job("a", is_quick=False), True),
    ([job("a"), job("a"), None], job("a", is_quick=False), False),
    ([job("a"), job("b"), None], job("a", is_quick=False), True),
    ([job("a", is_slow=True), None], job("b", is_slow=True), False),
    ([job("a", is_slow=True), None], job("b"), True),
    ([job("a", "load_scene"), None], job("b", "load_scene"), False),
    ([job("a", "load_scene"), None], job("a"), False),
    ([job("a", "load_scene"), None], job("b"), True),
    ([job("a", "load_scene", account="process"), None], job("b", account="process"), True),
    ([job("a", account="process"), None], job("b", is_quick=False, account="process"), False),
])
def test_the_last_free_worker_is_kept_from_who_has_the_others(under_way, asked, has_room):
    assert Pool(*under_way).has_room(asked) is has_room
