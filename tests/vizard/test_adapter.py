"""The adapter against the tests' own half of the protocol: every message is answered, whatever others send."""

from __future__ import annotations

import os
import re
import signal
import struct
import sys
import threading
import time

import cv2
import numpy as np
import pytest
import serving
import vizard_peer as peer
import zmq
from glrender import GlrenderError
from glrender_server import logs
from glrender_server.front import Request
from glrender_vizard.__main__ import main
from glrender_vizard.bodies import BodyMap
from glrender_vizard.dispatcher import MAX_SIMULATIONS, MAX_UPDATE_BYTES, VizardDispatcher
from glrender_vizard.engines import MAX_SCENES, Engines, memory_shares
from glrender_vizard.messages import read_update
from vizard_peer import Peer, scene


def test_every_message_has_its_answer_in_the_order_that_basilisk_waits_for(adapter):
    """PING, PING, then update, input (liveStream) or image and PING (noDisplay): vizInterface.cpp."""
    with Peer(adapter.endpoint) as one:
        assert one.ask(b"PING") == [b"PONG"] and one.ask(b"PING") == [b"PONG"]
        for k in range(3):  # the first updates of noDisplay ask for no image
            assert one.update(scene(t_ns=k * 10**9)) == [b"OK"]
            assert one.ask(b"PING") == [b"PONG"]
        assert one.ask(b"REQUEST_INPUT") == [b"VIZARD_INPUT", b""]
        length, image = one.ask(b"REQUEST_IMAGE_1")
        assert struct.unpack(">i", length)[0] == len(image) > 64 * 64
        assert cv2.imdecode(np.frombuffer(image, np.uint8), cv2.IMREAD_COLOR).shape == (64, 64, 3)


def test_a_frame_that_is_asked_for_twice_is_drawn_once(adapter):
    """By another simulation too; another time is another frame."""
    with Peer(adapter.endpoint) as one, Peer(adapter.endpoint) as other:
        data = scene((3.0, 2.0))
        one.update(data)
        other.update(data)
        first, before = one.image_bytes(), adapter.count("image_again")
        assert first == one.image_bytes() == other.image_bytes() and len(first) > 64 * 64
        assert adapter.count("image_again") == before + 2
        other.update(scene((3.0, 2.0), t_ns=2 * 10**9))
        assert other.image_bytes() == first and adapter.count("image_again") == before + 2


def test_simulations_do_not_cross(adapter):
    """Five at once, each with its own state in each frame: the body's place in the image."""
    wrong = []

    def fly(number):
        with Peer(adapter.endpoint) as one:
            for k in range(12):
                xy = np.array([4.0 * number - 10.0, 1.5 * k - 8.0])
                image = one.frame(scene(xy, t_ns=k * 10**9, radius_m=20.0))
                if np.abs(peer.centroid_px(image) - 32.0 - xy).max() > 0.5:
                    wrong.append((number, k, peer.centroid_px(image) - 32.0))

    threads = [threading.Thread(target=fly, args=(number,)) for number in range(5)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(120.0)
    assert not wrong and not any(thread.is_alive() for thread in threads)


def test_settings_hold_until_others_come(adapter):
    """Basilisk sends them with the first message alone in liveStream: here a model without a folder, told once."""
    with Peer(adapter.endpoint) as one:
        for k in range(3):
            models = [peer.model("lost.obj", "moonlet")] if k == 0 else None
            assert one.frame(scene(t_ns=k * 10**9, models=models)).max() > 100
    assert adapter.log.count("custom model 'lost.obj'") == 1 and "came before" not in adapter.log
    with Peer(adapter.endpoint) as one:
        assert one.frame(scene(models=None)).max() > 100
    assert adapter.log.count("its settings came before the adapter did") == 1


@pytest.mark.parametrize("data, said", [
    (scene().replace(peer.text(2, "craft"), peer.text(2, "ghost")), "is no spacecraft of the last update"),
    (scene(radius_m=2500.0), "must be outside body"),
    (scene(side_px=20000), "width_px"),
    (peer.message(peer.body("b", (0.0, 0.0, 1e3), 10.0), peer.craft("craft", (0.0,) * 3), peer.camera(mode=1)),
     "depth maps are not drawn"),
    (peer.message(peer.craft("craft", (0.0,) * 3), peer.camera()), "none to draw")])
def test_a_frame_that_cannot_be_made_is_empty_and_told_once(adapter, data, said):
    """Basilisk goes on with an invalid image; another frame is drawn next."""
    before = len(adapter.log)
    with Peer(adapter.endpoint) as one:
        for _ in range(3):
            assert one.update(data) == [b"OK"] and one.image() is None
        assert one.frame(scene()).max() > 100
    told = [line for line in adapter.log[before:].splitlines() if said in line]
    assert len(told) == 1, adapter.log[before:]


def test_an_image_of_nothing_is_empty(adapter):
    with Peer(adapter.endpoint) as one:
        assert one.image() is None
        one.update(scene())
        assert one.image(7) is None and one.image() is not None
        for request in (b"REQUEST_IMAGE_", b"REQUEST_IMAGE_one", b"REQUEST_IMAGE_" + b"9" * 40, b"REQUEST_IMAGE_-1"):
            assert one.ask(request) == [bytes(4), b""]


def test_wrong_messages_stop_nobody(adapter):
    """Each is answered, or its connection closed; beside them a simulation gets its frames, in time."""
    rng = np.random.default_rng(5)
    golden = scene(side_px=64)
    wrong = [(b"SIM_UPDATE",), (b"SIM_UPDATE", b"", b"", b"\xff" * 50), (b"SIM_UPDATE", b"", b"", golden[:-7]),
             (b"SIM_UPDATE", b"", b"", bytes(5 << 20)), (b"",), (b"HELLO",), (b"REQUEST_IMAGE_1",), (bytes(100_000),),
             *((rng.bytes(rng.integers(1, 300)),) for _ in range(30)),
             *((b"SIM_UPDATE", b"", b"", bytes(_mutated(golden, rng))) for _ in range(60))]
    with Peer(adapter.endpoint) as good, Peer(adapter.endpoint) as bad:
        for k, parts in enumerate(wrong):
            answer = bad.ask(*parts)
            assert answer in ([b"OK"], [b"ERROR"]) or parts[0].startswith(b"REQUEST_IMAGE")
            # Each that is read may be a scene of its own, which takes seconds to open.
            if answer == [b"OK"] and k % 6 == 0:
                bad.image()
            if k % 10 == 0:
                began = time.monotonic()
                assert good.frame(scene(t_ns=k * 10**9)).max() > 100
                assert time.monotonic() - began < 20.0


def _mutated(data, rng):
    data = bytearray(data)
    for _ in range(rng.integers(1, 6)):
        data[rng.integers(len(data))] = rng.integers(256)
    return data


def test_what_is_far_too_large_or_has_many_parts_is_hung_up_on(adapter):
    """By ZeroMQ's bounds: whoever sends that has no answer, and everybody else has."""
    with Peer(adapter.endpoint, 1.0) as large, Peer(adapter.endpoint, 1.0) as many, Peer(adapter.endpoint) as good:
        for one, parts in ((large, (b"SIM_UPDATE", b"", b"", bytes(8 << 20))), (many, [b"SIM_UPDATE"] + [b""] * 20)):
            one.socket.send_multipart(parts)
            assert good.frame(scene()).max() > 100
            with pytest.raises(zmq.Again):
                one.socket.recv_multipart()


def test_a_simulation_that_ends_vizard_is_forgotten(adapter):
    with Peer(adapter.endpoint) as one:
        assert one.update(scene()) == [b"OK"]
        assert one.update(scene() + peer.record(10, peer.whole(3, 1))) == [b"OK"]
        assert one.image() is None


def test_who_asks_and_goes_leaves_nothing(adapter):
    """A simulation that is killed while its frame is drawn."""
    for k in range(4):
        gone = Peer(adapter.endpoint)
        gone.update(scene(side_px=512, radius_m=300.0, t_ns=k))
        gone.socket.send(b"REQUEST_IMAGE_1")
        time.sleep(0.02)
        gone.__exit__()
    with Peer(adapter.endpoint) as one:
        assert one.frame(scene((1.0, 0.0))).max() > 100
    assert adapter.process.poll() is None


def test_a_flood_of_one_keeps_nobody_out(adapter):
    """A thousand images asked for at once and not taken; the others' turn comes."""
    flood = Peer(adapter.endpoint, kind=zmq.DEALER)
    flood.socket.sndhwm = 10_000
    flood.socket.send_multipart([b"", b"SIM_UPDATE", b"", b"", scene()])
    for _ in range(1000):
        flood.socket.send_multipart([b"", b"REQUEST_IMAGE_1"])
    with Peer(adapter.endpoint) as one:
        began = time.monotonic()
        for k in range(3):
            assert one.frame(scene((k, 1.0), t_ns=k)).max() > 100
        assert time.monotonic() - began < 30.0
    flood.__exit__()


@pytest.mark.slow
def test_a_worker_that_dies_is_replaced_and_its_frame_drawn(tmp_path):
    """Nothing is lost; what overruns the deadline is an empty image."""
    with peer.adapter(tmp_path, "--deadline", "20") as (endpoint, process), Peer(endpoint) as one:
        assert one.frame(scene()).max() > 100
        one.update(scene(side_px=1024, radius_m=340.0, t_ns=5))
        assert one.image() is not None  # the scene of this camera is open
        one.update(scene((5.0, 5.0), side_px=1024, radius_m=340.0, t_ns=6))
        one.socket.send(b"REQUEST_IMAGE_1")
        time.sleep(0.03)
        for worker in serving.children(process):
            os.kill(worker, signal.SIGKILL)
        length, image = one.socket.recv_multipart()
        assert struct.unpack(">i", length)[0] == len(image) > 1 << 20


def test_an_overrun_is_an_empty_image(tmp_path):
    with peer.adapter(tmp_path, "--deadline", "0.001") as (endpoint, process), Peer(endpoint) as one:
        assert one.update(scene(side_px=1024, radius_m=340.0)) == [b"OK"] and one.image() is None
        assert "overran its deadline" in (tmp_path / "vizard.log").read_text()


def test_the_end_waits_for_what_is_drawn(tmp_path):
    """SIGTERM: the image under way comes, the exit code is 0."""
    with peer.adapter(tmp_path) as (endpoint, process), Peer(endpoint) as one:
        assert one.frame(scene(side_px=1024, radius_m=340.0)).max() > 100
        one.update(scene((5.0, 5.0), side_px=1024, radius_m=340.0, t_ns=6))
        one.socket.send(b"REQUEST_IMAGE_1")
        time.sleep(0.02)
        process.terminate()
        assert len(one.socket.recv_multipart()[1]) > 1 << 20
        assert process.wait(30) == 0


CELESTIAL = read_update(scene()).bodies[0]


def test_what_is_kept_of_simulations_is_bounded():
    """Of those that say nothing more, of those with large updates, and of small ones that are large when read."""
    dispatcher = VizardDispatcher(Engines(lambda key: None), BodyMap())
    answers = []

    def send(sender, *parts):
        dispatcher.submit(Request(sender, list(parts), answers.append))

    for sender in range(2 * MAX_SIMULATIONS):
        send(sender, b"PING")
    assert len(dispatcher._simulations) == MAX_SIMULATIONS and answers == [[b"PONG"]] * 2 * MAX_SIMULATIONS
    for sender in range(150):
        send(sender, b"SIM_UPDATE", b"", b"", peer.message(models=[*[peer.model("x" * 4096, "a")] * 730]))
        assert answers[-1] == [b"OK"]
        send(sender, b"SIM_UPDATE", b"", b"", peer.message(models=None))
    kept = list(dispatcher._simulations.values())
    assert dispatcher._update_bytes == sum(each.n_bytes for each in kept) <= MAX_UPDATE_BYTES
    assert 0 < sum(len(model.path) for each in kept for model in each.models or ()) <= MAX_UPDATE_BYTES
    send("many", b"SIM_UPDATE", b"", b"", peer.record(3, b"") * 5000)
    assert list(dispatcher._simulations.values())[-1].n_bytes > 5000 * sys.getsizeof(CELESTIAL)


class Opened:
    """An engine that is never busy, or always."""

    outage, is_idle, closed, is_ended, may_close = "", True, False, False, threading.Event()
    may_close.set()

    def has_room(self, job):
        return self.is_idle

    def start(self, job):
        pass

    def end(self):
        self.is_ended = True

    def close(self):
        assert self.may_close.wait(20.0)
        self.closed = True


def test_closing_an_engine_keeps_nobody_waiting():
    """It ends at once and is closed beside the loop; until then no other takes its place, and the rest go on."""
    opened = {}
    engines = Engines(lambda key: opened.setdefault(key, Opened()))
    for key in range(MAX_SCENES):
        serving.until(lambda key=key: engines.has_room(key, None))
        assert engines.start(key, None) == ""
    opened[0].may_close = threading.Event()
    began = time.monotonic()
    for _ in range(3):
        assert not engines.has_room("new", None) and engines.has_room(1, None)
    assert time.monotonic() - began < 5.0 and opened[0].is_ended and not opened[0].closed and "new" not in opened
    opened[0].may_close.set()
    serving.until(lambda: engines.has_room("new", None))
    assert opened[0].closed and not any(opened[key].is_ended for key in range(1, MAX_SCENES))
    engines.close()


@pytest.mark.parametrize("all_gib, n_workers, given_gib, n_scenes, gib", [
    (64, 1, None, 8, 8.0), (8, 1, None, 5, 1.6), (1, 1, None, 1, 1.0), (8, 2, None, 2, 2.0),
    (8, 1, 4.0, 2, 4.0), (8, 4, 4.0, 1, 4.0), (64, 1, 0.5, 8, 0.5)])
def test_the_processes_of_all_scenes_share_one_bound_of_memory(all_gib, n_workers, given_gib, n_scenes, gib):
    """Each of eight scenes had four fifths of the machine's memory for itself."""
    given = None if given_gib is None else int(given_gib * 2**30)
    found, each = memory_shares(all_gib * 2**30, n_workers, given)
    assert (found, each / 2**30) == (n_scenes, pytest.approx(gib, abs=1e-6))
    assert found == 1 or found * n_workers * each <= all_gib * 2**30


def test_fewer_scenes_are_open_where_the_memory_is_small():
    engines = Engines(lambda key: Opened(), max_scenes=2)
    for key in range(2):
        serving.until(lambda key=key: engines.has_room(key, None))
    assert not engines.has_room("third", None), "who had the others opened comes soon"
    engines.close()


def test_scenes_beyond_the_bound_replace_the_longest_unused():
    """One at work is left alone, and others wait for their place; a scene that fails says why, and is tried again."""
    opened = {}

    def make(key):
        if key == "wrong":
            raise GlrenderError("no such file")
        return opened.setdefault(key, Opened())

    engines = Engines(make)
    for key in range(MAX_SCENES + 1):
        serving.until(lambda key=key: engines.has_room(key, None))
        assert engines.start(key, None) == ""
    assert [key for key, each in opened.items() if each.closed] == [0]
    for each in opened.values():
        each.is_idle = False
    assert not engines.has_room("new", None) and "new" not in opened
    opened[3].is_idle = True
    serving.until(lambda: engines.has_room("wrong", None))
    assert engines.start("wrong", None) == "no such file" and opened[3].closed
    engines.close()
    assert all(each.closed for each in opened.values())


@pytest.mark.parametrize("arguments, said", [
    (["--zmq", "tcp://0.0.0.0:5556"], "leads beyond this machine"), (["missing.toml"], "cannot be read"),
    (["--deadline", "0"], "--deadline"), (["--workers", "0"], "--workers"),
    (["--replay", "missing.bin"], "missing.bin"),
    (["--tap", "127.0.0.1:1"], "--tap: must be")])
def test_a_wrong_command_says_why(tmp_path, monkeypatch, capsys, arguments, said):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(logs, "set_up", lambda *_: None)
    assert main(arguments) == 1 and said in capsys.readouterr().err


def test_vizards_flags_are_taken(tmp_path):
    """As Basilisk's examples start it: BSK_OpNav.py, run_vizard."""
    port = re.search(r":(\d+)$", _free()).group(1)
    with peer.adapter(tmp_path, "--args", "-noDisplay", f"tcp://localhost:{port}") as (endpoint, _), Peer(
            f"tcp://127.0.0.1:{port}") as one:
        assert endpoint.endswith(port) and one.ask(b"PING") == [b"PONG"]


def _free():
    with zmq.Context() as context, context.socket(zmq.REP) as socket:
        socket.bind("tcp://127.0.0.1:*")
        return socket.getsockopt_string(zmq.LAST_ENDPOINT)


def test_a_scene_that_was_opened_is_used_before_it_makes_room():
    """With more scenes than places each opens in turn; none is closed before the frame that it was opened for."""
    engines = Engines(lambda key: Opened())

    def opened(key):
        serving.until(lambda: engines.has_room(key, None), 10.0)

    for key in range(MAX_SCENES):
        opened(key)
    assert not engines.has_room("another", None)
    assert all(engines.has_room(key, None) for key in range(MAX_SCENES))
    assert engines.start(3, None) == ""
    opened("another")
    assert engines.has_room(0, None) and not engines.has_room(3, None)
    engines.close()
