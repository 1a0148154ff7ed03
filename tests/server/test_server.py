"""A live server: one reply to every request, typed errors, retries, load, shutdown; and it serves on."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
import tracemalloc
from contextlib import closing
from pathlib import Path

import msgpack
import numpy as np
import pytest
import serving
import views
import zmq
from glrender import Renderer, State, load_scene
from glrender.brdf import Lambert
from glrender.engines.image import peak_bytes
from glrender.planner.request import ImageUse
from glrender_client import Busy, Client, GlrenderClientError, RequestTimeout, ServerError
from glrender_server import limits
from glrender_server.dispatcher import Dispatcher
from glrender_server.front import FairQueue, Request
from glrender_server.operations import Operations
from glrender_server.zmq_front import ZmqFront

STATE = views.state().to_dict()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("server")


@pytest.fixture(scope="module")
def endpoint(folder):
    with serving.server(folder, "--shape-dir", str(folder)) as (endpoint, _):
        yield endpoint


@pytest.fixture
def client(endpoint):
    with Client(endpoint, timeout_s=30.0) as client:
        yield client


class Raw:
    """A bare socket, to send what no client would."""

    def __init__(self, endpoint, kind=zmq.DEALER):
        self.context = zmq.Context()
        self.socket = self.context.socket(kind)
        self.socket.set(zmq.LINGER, 0)
        self.socket.connect(endpoint)

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self.socket.close()
        self.context.term()

    def ask(self, *parts):
        self.socket.send_multipart(parts)
        assert self.socket.poll(20_000), "no reply"
        return self.socket.recv_multipart()


def request(**changes):
    header = {"v": 1, "op": "render", "id": 1, "client": "raw", "state": STATE, "camera": "navcam", **changes}
    return msgpack.packb({key: value for key, value in header.items() if value is not ...})


def test_five_lines_get_a_frame(endpoint, folder):
    script = (f"from glrender_client import Client\nstate = {STATE!r}\n"
              f"with Client({endpoint!r}) as client:\n"
              f"    reply = client.render(state, camera='navcam', output='dn')\n"
              f"    print(reply.pixels.shape, reply.pixels.dtype, reply)\n")
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60)
    assert run.stdout.startswith("(64, 96) uint16 <Reply navcam t=0.0 s: 96 x 64 uint16 [DN]"), run.stderr


def test_a_request_above_the_limit_is_refused_before_it_is_sent(client):
    """ZeroMQ would drop it unanswered, and the client would wait out its timeouts."""
    limit = client.hello()["limits"]["max_header_bytes"]
    began = time.monotonic()
    with pytest.raises(GlrenderClientError, match=f"at most {limit} bytes, `load_scene` has"):
        client.load_scene({"bodies": [], "cameras": [], "note": "x" * (limit + 2048)})
    assert time.monotonic() - began < 5.0
    with pytest.raises(ServerError, match="note: unknown key"):
        client.load_scene({"bodies": [], "cameras": [], "note": "x" * (limit - 2048)})


def test_a_request_just_above_the_limit_gets_a_reply(endpoint):
    with Raw(endpoint) as raw:
        header = msgpack.unpackb(raw.ask(request(note="x" * (1 << 20)))[0])
        assert header["error"]["code"] == "protocol" and "must not exceed 1048576 bytes" in header["error"]["message"]


def test_hello_tells_what_is_there(client):
    hello = client.hello()
    assert hello["protocol"] == [1] and hello["protocol_minor"] >= 1
    assert [camera["name"] for camera in hello["cameras"]] == ["navcam", "bare"]
    assert hello["cameras"][0]["has_model"] and not hello["cameras"][1]["has_model"]
    assert hello["bodies"][0]["name"] == "body" and hello["bodies"][0]["n_facets"] == 5120
    assert hello["gl_renderer"]


def test_pixels_are_the_renderers_own(client, folder):
    """Over the wire and in process: the same bytes, for every product, in both orders."""
    products = ["range", "body_id", "facet_id", "incidence", "emission", "phase", "r_body", "sunlit"]
    with Renderer(load_scene(folder / "scene.toml")) as renderer:
        image = renderer.render(State.from_dict(STATE), camera="navcam", products=products)
        camera = renderer.scene.camera("navcam")
        softer = renderer.render(State.from_dict(STATE), camera="navcam",
                                 use=ImageUse(error_gain=camera.model.psf_noise_gain))
        frame = camera.expose(softer.irradiance_W_m2, 7, exposure_s=0.02, roi=softer.roi)
    for order in ("C", "F"):
        reply = client.render(STATE, camera="navcam", products=products, order=order)
        np.testing.assert_array_equal(reply.pixels, image.irradiance_W_m2)
        for name in products:
            np.testing.assert_array_equal(reply.arrays[name], image.products[name])
            assert reply.arrays[name].dtype == image.products[name].dtype
        reply = client.render(STATE, camera="navcam", output="dn", exposure_s=0.02, seed=7, order=order)
        np.testing.assert_array_equal(reply.pixels, frame.dn)
    assert reply.header["exposure_s"] == 0.02 and reply.header["plan"]["predicted_error"] > 0.0


def test_a_plan_on_the_wire_tells_every_unit_and_why(client):
    """Tolerances by unit are asked for and told, of an image and of a frame, whose point spread function averages."""
    asked = {"centroid_px": 0.05, "flux": 0.001}
    for output in ("irradiance", "dn"):
        plan = client.render(STATE, camera="navcam", output=output, max_error=asked).header["plan"]
        assert plan["asked"] == asked and plan["missed"] == [] and plan["milliseconds"] > 0.0
        assert list(plan["predicted"]) == ["rms", "flux", "centroid_px", "limb_px", "range"]
        assert plan["predicted"]["rms"] == plan["predicted_error"] <= plan["max_error"]
        assert all(0.0 < plan["predicted"][unit] <= most for unit, most in asked.items())
        assert all(window["why"] for window in plan["windows"])


def test_the_same_seed_gives_the_same_bytes_and_another_does_not(client):
    frames = [client.render(STATE, camera="navcam", output="dn", seed=seed).pixels.tobytes() for seed in (5, 5, 6)]
    assert frames[0] == frames[1] != frames[2]


def test_numpy_arrays_are_welcome_in_a_state(client):
    state = {**STATE, "t_s": np.float64(3.0), "r_sun_inertial_m": np.array(STATE["r_sun_inertial_m"])}
    assert client.render(state, camera="bare").header["t_s"] == 3.0


@pytest.mark.parametrize("changes, code, path, message", [
    ({"state": {**STATE, "t_s": float("nan")}}, "config", "state.t_s", "must be a finite number"),
    ({"state": {**STATE, "spacecraft": {"r_inertial_m": [0, 0, -9e3], "q_from_inertial": [1, 1, 0, 0]}}}, "config",
     "state.spacecraft.q_from_inertial", "norm must be 1"),
    ({"state": {**STATE, "bodies": {}}}, "scene", "state.bodies.body", "missing"),
    ({"state": {**STATE, "gamma": 1}}, "config", "state.gamma", "unknown key"),
    ({"state": {**STATE, "spacecraft": {"r_inertial_m": [0, 0, 0], "q_from_inertial": [1, 0, 0, 0]}}}, "scene",
     "state.spacecraft.r_inertial_m", "camera must be outside body"),
    ({"state": "here"}, "config", "state", "must be a table"),
    ({"state": ...}, "config", "state", "missing"),
    ({"camera": "wac"}, "scene", "camera", "unknown camera, got 'wac'; the scene has navcam, bare"),
    ({"camera": ...}, "scene", "camera", "unknown camera"),
    ({"output": "png"}, "config", "output", "must be one of"),
    ({"output": "dn", "camera": "bare"}, "config", "output", "no optics and detector"),
    ({"output": "dn", "exposure_s": 0.0}, "config", "exposure_s", "must be > 0, got 0.0"),
    ({"output": "dn", "exposure_s": -1.0}, "config", "exposure_s", "must be > 0"),
    ({"output": "dn", "exposure_s": float("inf")}, "config", "exposure_s", "finite"),
    ({"output": "dn", "seed": -1}, "config", "seed", "integer"),
    ({"exposure_s": 0.1}, "protocol", "exposure_s", "belongs to output 'dn'"),
    ({"max_error": 0}, "config", "max_error", "must be > 0"),
    ({"max_error": {"centroid": 0.1}}, "config", "max_error.centroid", "did you mean 'centroid_px'?"),
    ({"max_error": {"flux": 1e-9}}, "config", "max_error.flux", "must be at least 6e-08"),
    ({"samples": 99}, "config", "samples", "between 1 and 16"),
    ({"products": ["depth"]}, "config", "products[0]", "must be one of"),
    ({"products": "range"}, "protocol", "products", "must be a list"),
    ({"products": [["range"]]}, "config", "products[0]", "must be one of"),
    ({"order": "Z"}, "config", "order", "must be one of 'C', 'F'"),
    ({"exposure": 0.1}, "config", "exposure", "unknown key"),
    ({"op": "explode"}, "config", "op", "must be one of 'hello', 'render'"),
    ({"op": 7}, "config", "op", "must be one of"),
    ({"op": ...}, "protocol", "op", "missing"),
    ({"v": True}, "protocol", "v", "speaks version 1, got True"),
    ({"v": 2}, "protocol", "v", "speaks version 1, got 2"),
    ({"v": ...}, "protocol", "v", "missing"),
    ({"id": "one"}, "config", "id", "integer"),
    ({"id": ...}, "protocol", "id", "missing"),
    ({"client": ""}, "protocol", "client", "name of 1 to 128"),
    ({"client": "x" * 200}, "protocol", "client", "name of 1 to 128"),
    ({"op": "load_scene", "scene": {"bodies": [], "cameras": []}, "state": ..., "camera": ...}, "config",
     "scene.bodies", "must be a list of tables"),
    ({"op": "load_scene", "state": ..., "camera": ..., "scene": {
        "bodies": [{"name": "b", "shape": "../../etc/passwd", "length_unit": "m",
                    "brdf": {"law": "lambert", "normal_albedo": 0.1}}],
        "cameras": [{"name": "c", "width_px": 8, "height_px": 8, "focal_length_px": 9.0}]}}, "config",
     "scene.bodies[0].shape", "bare file name"),
    ({"op": "load_scene", "state": ..., "camera": ..., "scene": {
        "bodies": [{"name": "b", "generated": {"kind": "icosphere", "radius_m": 1.0},
                    "brdf": {"law": "lambert", "normal_albedo": 0.1}}],
        "cameras": [{"name": "c", "width_px": 16000, "height_px": 16000, "focal_length_px": 9.0}]}}, "config",
     "scene.cameras", "at most 67108864 pixels"),
])
def test_what_is_wrong_is_answered_by_code_path_and_message(endpoint, changes, code, path, message):
    with Raw(endpoint) as raw:
        header = msgpack.unpackb(raw.ask(request(**changes))[0])
        assert not header["ok"]
        assert (header["error"]["code"], header["error"]["path"]) == (code, path)
        assert message in header["error"]["message"]
        assert msgpack.unpackb(raw.ask(request(id=2))[0])["ok"], "the server serves on"


@pytest.mark.parametrize("parts", [[b"garbage"], [b"\xc1"], [b""], [b"a", b"b"], [b"\x80"]])
def test_garbage_is_answered_and_survived(endpoint, parts):
    with Raw(endpoint) as raw:
        header = msgpack.unpackb(raw.ask(*parts)[-1])
        assert header["error"]["code"] == "protocol" and header["id"] == 0
        assert msgpack.unpackb(raw.ask(request())[0])["ok"]


def test_a_message_too_long_ends_that_connection_alone(endpoint, client):
    with Raw(endpoint) as raw:
        raw.socket.send(b"x" * (1 << 22))
        assert client.hello()["ok"]


def test_a_req_socket_is_served_too(endpoint):
    with Raw(endpoint, zmq.REQ) as raw:
        assert msgpack.unpackb(raw.ask(request())[0])["ok"]


def test_a_retry_is_answered_from_the_last_reply(endpoint, client):
    with Raw(endpoint) as raw:
        message = request(client="retry", id=9, output="dn", seed=1)
        first = raw.ask(message)
        before = client.status()["requests"]["render"]
    with Raw(endpoint) as again:
        assert again.ask(message) == first
        assert client.status()["requests"]["render"] == before, "nothing was drawn twice"
        other = again.ask(request(client="retry", id=9, output="dn", seed=2))
        assert other[1] != first[1], "the same id with other words is another request"


def test_many_waiting_requests_are_answered_each_once_or_told_busy(endpoint):
    with Raw(endpoint) as raw:
        for number in range(300):
            raw.socket.send(request(id=number + 1, samples=4))
        seen = {}
        while len(seen) < 300 and raw.socket.poll(20_000):
            header = msgpack.unpackb(raw.socket.recv_multipart()[0])
            assert header["id"] not in seen, "one reply for every request"
            seen[header["id"]] = "ok" if header["ok"] else header["error"]["code"]
        assert len(seen) == 300 and set(seen.values()) <= {"ok", "busy"} and "ok" in seen.values()
        assert raw.socket.poll(200) == 0


class Occupied:
    """An engine that is busy for ever."""

    described, outage, draws_here, is_idle, generation = {}, "", False, False, 0

    def has_room(self, job):
        return False


def test_one_that_fills_the_queue_keeps_nobody_out():
    dispatcher, told = Dispatcher(Occupied()), []

    def submit(sender, number):
        parts = [msgpack.packb({"v": 1, "op": "render", "id": number, "client": sender, "state": STATE})]
        dispatcher.submit(Request(sender, parts, lambda reply: told.append(msgpack.unpackb(reply[0]))))

    places = limits.MAX_WAITING
    for number in range(places + 8):
        submit("greedy", number)
    assert [reply["id"] for reply in told] == list(range(places, places + 8)), "its own further ones"
    assert all(0.0 < reply["error"]["retry_after_s"] <= 5.0 for reply in told)
    told.clear()
    for number in range(3):
        submit("other", number)
    submit("greedy", places - 1)  # again: its last was not kept
    assert [(reply["client"], reply["id"], reply["error"]["code"]) for reply in told] == [
        ("greedy", number, "busy") for number in (places - 1, places - 2, places - 3, places - 1)]
    assert dispatcher.errors["busy"] == 12


def test_what_is_not_done_in_time_is_told_that_the_server_ends():
    dispatcher, told = Dispatcher(Occupied()), []
    for number in range(3):
        parts = [msgpack.packb({"v": 1, "op": "render", "id": number, "client": "late", "state": STATE})]
        dispatcher.submit(Request("late", parts, lambda reply: told.append(msgpack.unpackb(reply[0]))))
    assert not told
    dispatcher.give_up()
    assert [(reply["id"], reply["error"]["code"]) for reply in told] == [(0, "closing"), (1, "closing"), (2, "closing")]


def test_a_full_queue_refuses_the_newest_of_who_has_most_waiting():
    queue = FairQueue(6, 100)
    assert [queue.put("a", k) for k in range(5)] == 5 * [[]] and queue.put("b", 10) == []
    assert queue.put("a", 5) == [5], "its own, who has most already"
    assert queue.put("b", 11) == [4] and queue.put("c", 20) == [3]
    assert queue.put("b", 12) == [12], "three of a, two of b: it would only turn round"
    assert queue.put("c", 21) == [2] and queue.put("c", 22) == [22] and len(queue) == 6
    assert [queue.get() for _ in range(7)] == [0, 10, 20, 1, 11, 21, None] and len(queue) == 0


def test_a_queue_is_bounded_by_bytes_too():
    queue = FairQueue(100, 10)
    assert [queue.put("a", k, n_bytes=3) for k in range(4)] == [[], [], [], [3]]
    assert queue.put("b", 10, n_bytes=4) == [2] and queue.n_bytes == 10
    assert queue.put("c", 20, n_bytes=2) == [1], "of who has most bytes, however few requests"
    assert [queue.get() for _ in range(3)] == [0, 10, 20] and queue.n_bytes == 0


def test_an_item_that_is_held_back_holds_up_its_sender_alone():
    queue = FairQueue(10, 100)
    for sender, item in (("a", 1), ("a", 2), ("b", 3)):
        queue.put(sender, item)
    assert queue.get(lambda item: item != 1) == 3 and queue.get(lambda item: item != 1) is None
    assert queue.get() == 1


def test_clients_do_not_get_each_others_frames(endpoint):
    failures = []

    def fly(t_s):
        try:
            with Client(endpoint, timeout_s=30.0) as client:
                for k in range(10):
                    reply = client.render({**STATE, "t_s": t_s + k}, camera="bare")
                    assert reply.header["t_s"] == t_s + k
        except Exception as error:
            failures.append(error)

    threads = [threading.Thread(target=fly, args=(1000.0 * i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failures


def test_who_comes_when_another_leaves_is_answered():
    """Its connection has the other's descriptor, and is another nevertheless."""
    with closing(ZmqFront("tcp://127.0.0.1:*")) as front, zmq.Context() as context:
        front.start(zmq.Poller())

        def asked():
            peer = context.socket(zmq.REQ)
            peer.linger, peer.rcvtimeo = 0, 5000
            peer.connect(front.endpoint)
            peer.send(b"question")
            return peer

        def request():
            frames = []
            serving.until(lambda: frames.append(front._message()) or frames[-1])
            return front._request(frames[-1])

        with asked() as first:
            request().answer([b"1"])
            assert first.recv() == b"1"
            front._peers.patrol()
            (gone,) = front._peers._all()
        serving.until(lambda: not gone.is_there)
        with asked() as second:
            request().answer([b"2"])
            assert second.recv() == b"2"
            (there,) = front._peers._all()
            assert there.descriptor == gone.descriptor and there.n_owed == 0


@pytest.mark.slow
def test_a_thousand_requests_leave_no_descriptor_and_little_memory(tmp_path):
    with serving.server(tmp_path) as (endpoint, process), Client(endpoint, timeout_s=30.0) as client:

        def usage():
            pages = int(Path(f"/proc/{process.pid}/statm").read_text().split()[1])
            return len(os.listdir(f"/proc/{process.pid}/fd")), pages * os.sysconf("SC_PAGE_SIZE") / 2**20

        for _ in range(100):
            client.render(STATE, camera="bare")
        before = usage()
        for k in range(1000):
            client.render({**STATE, "t_s": float(k)}, camera="bare")
            if k % 50 == 0:
                with Client(endpoint) as other:
                    other.hello()
        after = usage()
        assert after[0] <= before[0] + 2
        assert after[1] - before[1] < 20.0, "MiB"


def test_load_scene_replaces_the_scene_and_a_bad_one_leaves_the_old(tmp_path):
    with serving.server(tmp_path) as (endpoint, _), Client(endpoint, timeout_s=30.0) as client:
        scene = {"bodies": [{"name": "ball", "generated": {"kind": "icosphere", "radius_m": 50.0, "subdivisions": 3},
                             "brdf": {"law": "lambert", "normal_albedo": 0.5}}],
                 "cameras": [{"name": "eye", "width_px": 20, "height_px": 10, "focal_length_px": 50.0}]}
        bad = {**scene, "bodies": [{**scene["bodies"][0], "brdf": {"law": "lambert", "normal_albedo": 7.0}}]}
        with pytest.raises(ServerError, match=r"scene\.bodies\[0\]\.brdf\.normal_albedo"):
            client.load_scene(bad)
        assert client.hello()["bodies"][0]["name"] == "body"
        assert client.load_scene(scene)["bodies"][0]["name"] == "ball"
        reply = client.render({**STATE, "bodies": {"ball": STATE["bodies"]["body"]}})
        assert reply.pixels.shape == (10, 20) and reply.pixels.max() > 0.0


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_after_the_request_in_flight(tmp_path, number):
    with serving.server(tmp_path) as (endpoint, process), Raw(endpoint) as raw:
        raw.ask(request())
        for k in range(3):
            raw.socket.send(request(id=10 + k, samples=16, products=["range"]))
        time.sleep(0.05)
        process.send_signal(number)
        replies = []
        while len(replies) < 3 and raw.socket.poll(20_000):
            replies.append(msgpack.unpackb(raw.socket.recv_multipart()[0]))
        assert [reply["id"] for reply in replies] == [10, 11, 12]
        assert process.wait(timeout=20.0) == 0
        assert b"stopped" in process.stdout.read()


PRODUCTS = ["range", "body_id", "facet_id", "incidence", "emission", "phase", "r_body", "sunlit"]


def test_products_of_a_large_image_are_bounded_by_their_memory():
    """67 megapixels with all products would take 9 GB; the request is refused before anything is drawn."""
    served = Operations(views.scene([views.sphere(Lambert(normal_albedo=0.2), 1)], [views.camera(size_px=8192)]))
    try:
        header = msgpack.unpackb(request(camera="navcam", products=PRODUCTS))
        error = msgpack.unpackb(served.answer(header)[0][0])["error"]
        assert (error["code"], error["path"]) == ("config", "products")
        assert f"at most {4 * 1024**3} bytes of memory while they are made, got {144 * 8192**2}" in error["message"]
    finally:
        served.close()


@pytest.mark.parametrize("products", [[], ["body_id"], PRODUCTS])
def test_the_memory_of_a_frame_is_what_it_is_bounded_by(products):
    scene = views.scene([views.sphere(Lambert(normal_albedo=0.2), 5)], [views.camera(1024, 4e3)])
    served = Operations(scene)
    try:
        served.answer(msgpack.unpackb(request(camera="navcam", samples=1)))
        tracemalloc.start()
        reply, code, *_ = served.answer(msgpack.unpackb(request(
            camera="navcam", products=products, samples=1, order="F")))
        assert not code and reply
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
        served.close()
    assert 0.5 < peak / peak_bytes(1024**2, products) < 1.5


def test_a_port_in_use_says_so_and_what_to_do(endpoint, folder):
    run = subprocess.run([sys.executable, "-m", "glrender_server", str(folder / "scene.toml"), "--zmq", endpoint],
                         capture_output=True, text=True, timeout=60)
    assert run.returncode == 1
    assert "cannot listen on" in run.stderr and "--zmq" in run.stderr and "Traceback" not in run.stderr


@pytest.mark.parametrize("arguments, message", [
    (["none.toml"], "cannot be read"),
    (["scene.toml", "--zmq", "tcp://0.0.0.0:5555"], "leads beyond this machine"),
    (["scene.toml", "--zmq", "tcp://*:5555"], "leads beyond this machine"),
    (["scene.toml", "--zmq", "tcp://example.org:5555"], "leads beyond this machine"),
    (["scene.toml", "--zmq", "http://x"], "must be tcp://HOST:PORT"),
    (["scene.toml", "--backend", "vulkan"], "backend: must be one of auto, egl, osmesa"),
    (["scene.toml", "--shape-dir", "nowhere"], "must be a folder"),
])
def test_a_wrong_start_says_why_in_one_line(tmp_path, arguments, message):
    (tmp_path / "scene.toml").write_text(serving.SCENE)
    run = subprocess.run([sys.executable, "-m", "glrender_server", *arguments], cwd=tmp_path, capture_output=True,
                         text=True, timeout=60)
    assert run.returncode == 1
    assert message in run.stderr.splitlines()[-1] and "Traceback" not in run.stderr


def test_without_a_server_the_client_says_so_in_time():
    began = time.monotonic()
    with Client("tcp://127.0.0.1:1", timeout_s=0.2, retries=1) as client:
        with pytest.raises(RequestTimeout, match="did not answer `hello` within 0.2 s, 2 times"):
            client.hello()
    assert time.monotonic() - began < 5.0


def test_the_client_finds_a_server_that_comes_back(tmp_path):
    with serving.server(tmp_path) as (endpoint, process):
        client = Client(endpoint, timeout_s=1.0, retries=30)
        first = client.render(STATE, camera="bare").pixels
        process.kill()
        process.wait()
    again = [sys.executable, "-m", "glrender_server", str(tmp_path / "scene.toml"), "--zmq", endpoint]
    second = subprocess.Popen(again, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        np.testing.assert_array_equal(client.render(STATE, camera="bare").pixels, first)
        client.close()
    finally:
        second.kill()
        second.wait()


def test_a_closed_client_and_wrong_arguments_are_refused(endpoint):
    client = Client(endpoint)
    client.close()
    client.close()
    with pytest.raises(GlrenderClientError, match="closed"):
        client.hello()
    with pytest.raises(ValueError, match="timeout_s"):
        Client(endpoint, timeout_s=0.0)
    assert issubclass(Busy, ServerError)
