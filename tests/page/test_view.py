"""The page of a server's frames, in Chromium and by its bare conversation: what it shows, and what it costs nobody."""

from __future__ import annotations

import asyncio
import json
import os
import re
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
import tomllib
import urllib.error
import urllib.request
from contextlib import ExitStack, contextmanager
from pathlib import Path

import browser
import glrender_view
import msgpack
import numpy as np
import processes
import pytest
import serving
import views
from glrender_cli.__main__ import main
from glrender_client import Client, ServerError
from glrender_server import background, limits
from glrender_server.tap import Tap
from missing import needed_module

GLRENDER = str(Path(sys.executable).with_name("glrender"))
# Not saturated, unlike the room's own scene.
SCENE = serving.SCENE.replace("exposure_s = 0.01", "exposure_s = 3e-7")
# The page's process has the lowest priority: beside other tests it waits for a core.
PATIENCE_S = 120.0


def state(step=0):
    return views.state(phase_deg=50.0, range_m=1500.0 + 2.0 * step).to_dict()


def address_of(process):
    """On a line of its own, which a terminal opens as it is."""
    return re.search(r"^view on (http://127\.0\.0\.1:\d+/\?token=\S+)$", process.said, re.M)[1]


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """(endpoint, address of the page, process) of a server with its view, which every client may watch."""
    with serving.server(tmp_path_factory.mktemp("view"), "--view", "0", "--watch", scene=SCENE) as (endpoint, process):
        yield endpoint, address_of(process), process


@pytest.fixture(scope="module")
def window(shown, tmp_path_factory):
    """A browser."""
    with browser.browser(tmp_path_factory.mktemp("chromium")) as driver:
        yield driver


@contextmanager
def looping(endpoint, camera="navcam", output="dn", pause_s=0.05):
    """A client that asks for frames, in a thread; yields the list of their times."""
    times, ended = [], threading.Event()

    def loop():
        with Client(endpoint, timeout_s=60.0) as client:
            while not ended.is_set():
                client.render(state(len(times) % 100), camera, output=output)
                times.append(time.monotonic())
                time.sleep(pause_s)

    thread = threading.Thread(target=loop)
    thread.start()
    try:
        yield times
    finally:
        ended.set()
        thread.join(60.0)


def frame_number(driver):
    return int(driver.execute_script("return document.body.dataset.frame") or 0)


def opened(driver, address):
    driver.get(address)
    serving.until(lambda: driver.find_element("id", "light").text == "connected", PATIENCE_S)


class Page:
    """What a page does, without a browser."""

    def __init__(self, address, **options):
        client = needed_module("websockets.sync.client", "pip install 'glrender[view]'")
        self._connection = client.connect(address.replace("http", "ws").replace("/?", "/stream?"), max_size=None,
                                          proxy=None, open_timeout=PATIENCE_S, **options)

    def __enter__(self):
        self.peer = self._connection.__enter__()
        return self

    def __exit__(self, *exception):
        self._connection.__exit__(*exception)

    def ask(self, kind, **fields):
        self.peer.send(json.dumps({"ask": kind, **fields}))

    def answer(self):
        """(head, pixels) of the next answer; without pixels None."""
        data = self.peer.recv(timeout=PATIENCE_S)
        if isinstance(data, str):
            return json.loads(data), None
        (size,) = struct.unpack_from("<I", data)
        head = json.loads(data[4:4 + size])
        return head, np.frombuffer(data, head["dtype"], offset=4 + size).reshape(head["height"], head["width"])


def test_frames_appear_as_they_are_drawn(shown, window):
    endpoint, address, _ = shown
    opened(window, address)
    with looping(endpoint):
        serving.until(lambda: frame_number(window) > 0, PATIENCE_S)
        first = frame_number(window)
        serving.until(lambda: frame_number(window) > first + 3, PATIENCE_S)
        serving.until(lambda: window.find_element("id", "rate").text not in ("–", "0.0"), PATIENCE_S)
    facts = window.find_element("id", "frame").text
    assert "96 × 64" in facts and "navcam" in facts
    assert "predicted error" in window.find_element("id", "plan").text
    # The body is on the canvas, and black space beside it.
    grey = window.execute_script("""
        const canvas = document.getElementById("picture"), context = canvas.getContext("2d");
        const at = (x, y) => context.getImageData(x * canvas.width, y * canvas.height, 1, 1).data[0];
        return [at(0.5, 0.5), at(0.25, 0.1)];""")
    assert grey[0] > 60 and grey[1] < 10
    assert not [entry for entry in window.get_log("browser") if entry["level"] == "SEVERE"]


def test_values_under_the_cursor_are_the_servers(shown, window):
    """What the page says of a pixel, against what a client gets that asks for it itself."""
    endpoint, address, _ = shown
    products = ["range", "incidence", "emission", "phase"]
    with Client(endpoint) as client:
        direct = client.render(state(), "navcam", products=products, roi=(48, 32, 49, 33))
        digital = client.render(state(), "navcam", output="dn", seed=5)
        hello = client.hello()
    opened(window, address)
    serving.until(lambda: frame_number(window) > 0, PATIENCE_S)
    canvas = window.find_element("id", "picture")
    canvas.send_keys("\ue014\ue012")  # right and left: the pixel in the middle
    serving.until(lambda: "body" in values_of(window) and values_of(window)["range"] != "–", PATIENCE_S)
    assert window.find_element("id", "place").text == "48, 32"
    told, expected = values_of(window), {name: array[0, 0] for name, array in direct.arrays.items()}
    dn = int(digital.pixels[32, 48])
    detector = next(camera["detector"] for camera in hello["cameras"] if camera["name"] == "navcam")
    assert told["signal"] == f"{dn}DN" and told["body"] == "body"
    electrons = (dn - detector["offset_DN"]) / detector["gain_DN_per_electron"]
    assert told["electrons"].replace("\u2009", "") == f"{electrons:.0f}e⁻"
    assert told["range"] == f"{expected['range']:.3f}m"
    for name in ("incidence", "emission", "phase"):
        assert float(told[name].rstrip("°")) == pytest.approx(np.degrees(expected[name]), abs=0.0051)
    assert number(told["irradiance"]) == pytest.approx(expected["image"], rel=1e-5)


def values_of(driver):
    """The rows below `Pixel`, as {name: value with its unit}."""
    return driver.execute_script("""
        const cells = [...document.getElementById("pixel").children].map(cell => cell.textContent), rows = {};
        for (let k = 0; k < cells.length; k += 2) rows[cells[k]] = cells[k + 1];
        return rows;""")


def number(text):
    mantissa, power = re.match(r"([\d.]+)(?: × 10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+))?", text).groups()
    return float(mantissa) * 10.0 ** int((power or "⁰").translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")))


def test_bytes_and_pixels_are_exact(shown):
    """An irradiance frame byte for byte; range and angles at every tenth pixel as the client's own products."""
    endpoint, address, _ = shown
    products = ["range", "body_id", "incidence", "emission", "phase"]
    with Client(endpoint) as client, Page(address) as page:
        page.ask("frame", after=0, stream=None)
        reply = client.render(state(7), "bare", products=products)
        while True:
            head, pixels = page.answer()
            if head["stream"][1] == "bare" and pixels.tobytes() == reply.pixels.tobytes():
                break
            page.ask("frame", after=head["number"], stream=None)
        assert head["unit"] == "W/m2" and head["plan"]["predicted_error"] == reply.header["plan"]["predicted_error"]
        n_seen = 0
        for x, y in [(x, y) for x in range(6, 32, 10) for y in range(6, 32, 10)]:
            page.ask("pixel", number=head["number"], x=x, y=y)
            told, _ = page.answer()
            alone = client.render(state(7), "bare", products=products, roi=(x, y, x + 1, y + 1))
            at = {name: array[0, 0] for name, array in alone.arrays.items()}
            assert (told["x"], told["y"]) == (x, y) and told["irradiance_W_m2"] == at["image"]
            if at["body_id"] < 0:
                assert told["body"] is None and told["range_m"] is None and told["phase_deg"] is None
                continue
            n_seen += 1
            assert told["body"] == "body" and told["range_m"] == at["range"]
            assert told["range_m"] == pytest.approx(reply.arrays["range"][y, x], rel=1e-7)
            for name in ("incidence", "emission", "phase"):
                assert told[f"{name}_deg"] == np.degrees(float(at[name]))
        assert n_seen > 0


@pytest.mark.slow
def test_ten_pages_at_once(shown, window):
    endpoint, address, _ = shown
    others = []
    try:
        opened(window, address)
        home = window.current_window_handle
        for _ in range(9):
            window.switch_to.new_window("window")
            others.append(window.current_window_handle)
            window.get(address)
        with looping(endpoint):
            for handle in (home, *others):
                window.switch_to.window(handle)
                first = frame_number(window)
                serving.until(lambda first=first: frame_number(window) > first, PATIENCE_S)
            serving.until(lambda: re.search(r"pages open\s+10", window.find_element("id", "server").text), PATIENCE_S)
    finally:
        for handle in others:
            window.switch_to.window(handle)
            window.close()
        window.switch_to.window(home)


def test_a_frozen_browser_holds_up_nobody(shown, window, tmp_path):
    endpoint, address, _ = shown
    with browser.browser(tmp_path / "profile") as cold, looping(endpoint) as times:
        opened(cold, address)
        opened(window, address)
        serving.until(lambda: frame_number(cold) > 0, PATIENCE_S)
        with browser.frozen(tmp_path / "profile"):
            n_before, before = len(times), frame_number(window)
            serving.until(lambda: len(times) > n_before + 20 and frame_number(window) > before + 5, PATIENCE_S)
        thawed = frame_number(cold)
        serving.until(lambda: frame_number(cold) > thawed, PATIENCE_S)


def test_a_page_that_takes_nothing_skips_frames(shown):
    """It asks for one, reads nothing for a while, and gets one, then the newest."""
    endpoint, address, _ = shown
    with Page(address) as slow, Page(address) as quick, Client(endpoint) as client:
        slow.ask("frame", after=0, stream=None)
        for step in range(12):
            client.render(state(step), "bare")
            time.sleep(0.1)
        last = state(77)
        client.render(last, "bare")
        after = 0
        while True:
            quick.ask("frame", after=after, stream=None)
            head, _ = quick.answer()
            after = head["number"]
            if head["geometry"]["range_m"] == pytest.approx(np.linalg.norm(last["spacecraft"]["r_inertial_m"])):
                break
        first, _ = slow.answer()
        slow.ask("frame", after=first["number"], stream=None)
        assert slow.answer()[0]["number"] == after > first["number"]


@pytest.mark.parametrize("change, status", [
    (lambda url: url.split("?")[0], 403), (lambda url: url[:-1] + ("A" if url[-1] != "A" else "B"), 403),
    (lambda url: url.replace("/?", "/nothing?"), 404), (lambda url: url.replace("/?", "/../serving.py?"), 404)])
def test_without_its_token_there_is_no_page(shown, change, status):
    with pytest.raises(urllib.error.HTTPError) as caught:
        urllib.request.urlopen(change(shown[1]), timeout=PATIENCE_S)
    assert caught.value.code == status


def test_other_names_and_methods_are_refused(shown):
    """DNS rebinding sends a foreign Host; a foreign page its Origin, or a POST."""
    _, address, _ = shown
    for headers, method, status in (({"Host": "evil.example"}, "GET", 400), ({}, "POST", 405), ({}, "PUT", 405)):
        with pytest.raises(urllib.error.HTTPError) as caught:
            urllib.request.urlopen(urllib.request.Request(address, headers=headers, method=method, data=b""
                                                          if method != "GET" else None), timeout=PATIENCE_S)
        assert caught.value.code == status
    with urllib.request.urlopen(urllib.request.Request(address, headers={"Origin": "http://evil.example"}),
                                timeout=PATIENCE_S) as found:
        assert "Access-Control-Allow-Origin" not in found.headers
        assert "default-src 'none'" in found.headers["Content-Security-Policy"]
    exceptions = needed_module("websockets.exceptions", "pip install 'glrender[view]'")
    for wrong, options in ((address[:-1] + "?", {}), (address, {"origin": "http://evil.example"}),
                           (address, {"additional_headers": {"Host": "evil.example"}})):
        with pytest.raises(exceptions.InvalidHandshake), Page(wrong, **options):
            pass


@pytest.mark.parametrize("said", ["", "nothing", "[]", "{}", '{"ask": "shell"}', '{"ask": "frame", "stream": 3}',
                                  '{"ask": ["frame"]}', "[" * 4000, "9" * 5000])
def test_what_is_no_question_ends_that_page_alone(shown, said):
    exceptions = needed_module("websockets.exceptions", "pip install 'glrender[view]'")
    with Page(shown[1]) as page, Page(shown[1]) as other:
        page.peer.send(said)
        with pytest.raises(exceptions.ConnectionClosed) as caught:
            page.peer.recv(timeout=PATIENCE_S)
        assert caught.value.rcvd.code == (1009 if len(said) > 4096 else 1003)
        other.ask("status")
        assert other.answer()[0]["kind"] == "status"


@pytest.mark.parametrize("question", [
    {"ask": "pixel", "number": 1, "x": -1, "y": 0}, {"ask": "pixel", "number": "x", "x": 1, "y": 0},
    {"ask": "free", "azimuth_deg": "a", "elevation_deg": 0, "range_m": 1, "camera": "navcam", "body": "body"},
    {"ask": "free", "azimuth_deg": 0, "elevation_deg": 0, "range_m": 1, "camera": "no", "body": "body"},
    {"ask": "free", "azimuth_deg": float("nan"), "elevation_deg": 0, "range_m": 1, "camera": "navcam", "body": "body"},
    {"ask": "free", "azimuth_deg": 1e308, "elevation_deg": 0, "range_m": -1e308, "camera": "navcam", "body": "no"},
    {"ask": "frame", "after": None}, {"ask": "frame", "after": float("inf")}])
def test_a_senseless_question_is_answered_so(shown, question):
    with Page(shown[1]) as page:
        page.ask("status")
        while not page.answer()[0]["status"]:
            time.sleep(0.1)
            page.ask("status")
        page.peer.send(json.dumps(question))
        told = page.answer()[0]["trouble"]
        assert told and "the view failed" not in told


@pytest.mark.parametrize("bug", [KeyError("x"), TypeError("x"), ValueError("x")])
def test_a_bug_is_logged_as_one(caplog, bug):
    """The same kinds of errors while a question is answered are the view's own, not the page's."""
    needed_module("uvicorn", "pip install 'glrender[view]'")
    from glrender_view.serving import _Viewer

    class Source:
        @property
        def status(self):
            raise bug

    answer = asyncio.run(_Viewer(None, Source(), set())._answered("status", {}))
    assert "the view failed on this" in answer["trouble"] and "Traceback" in caplog.text


@pytest.mark.slow
def test_connections_that_ask_nothing_keep_nobody_out(tmp_path):
    """Whoever reaches loopback, and has no token, can open them; what is sent in bits never ends either."""
    with serving.server(tmp_path, "--view", "0", scene=SCENE) as (_, process), ExitStack() as stack:
        address = address_of(process)
        port = int(re.search(r":(\d+)/", address)[1])
        (number,) = processes.children(process.pid, b"glrender_server.view")
        begin = lambda: stack.enter_context(socket.create_connection(("127.0.0.1", port)))  # noqa: E731
        page = stack.enter_context(Page(address))
        for k in range(300):
            begin().sendall((b"", b"GET / HTTP/1.1\r\nX", b"nonsense\r\n\r\n")[k % 3])
        serving.until(lambda: len(os.listdir(f"/proc/{number}/fd")) < 100, PATIENCE_S)
        assert answers(address)
        page.ask("status")
        assert page.answer()[0]["viewers"] == 1
        last = begin()
        last.settimeout(PATIENCE_S)
        assert last.recv(1) == b"", "it is hung up on after some seconds"
        page.ask("status")
        assert page.answer()[0]["viewers"] == 1
    assert "WARNING" not in (tmp_path / "server.log").read_text()


def test_the_free_camera_disturbs_no_clients_bytes(shown, window):
    endpoint, address, _ = shown
    asked = [{"state": state(step), "camera": "navcam", "output": "dn", "seed": step} for step in range(12)]
    with Client(endpoint) as client:
        alone = [client.render(**request).pixels.tobytes() for request in asked]
        opened(window, address)
        serving.until(lambda: frame_number(window) > 0, PATIENCE_S)
        # It is enabled once the page knows the bodies.
        serving.until(window.find_element("id", "free").is_enabled, PATIENCE_S)
        window.find_element("id", "free").click()
        serving.until(lambda: "free camera" in window.find_element("id", "frame").text, PATIENCE_S)
        before = client.status()["requests"]["render"]
        canvas = window.find_element("id", "picture")
        beside = []
        for request in asked:
            canvas.send_keys("\ue012+")
            beside.append(client.render(**request).pixels.tobytes())
        serving.until(lambda: client.status()["requests"]["render"] > before + len(asked), PATIENCE_S)
        assert beside == alone
        # Nobody sees the frames of the free camera but its own page.
        assert "free" not in str(client.watch().streams)
    window.find_element("id", "live").click()
    serving.until(lambda: "navcam" in window.find_element("id", "frame").text, PATIENCE_S)


def test_without_a_frame_the_free_camera_shows_the_scene(tmp_path):
    with serving.server(tmp_path, "--view", "0", scene=SCENE) as (endpoint, process), Page(address_of(process)) as page:
        page.ask("frame", after=0, stream=None)
        page.ask("status")
        while not (told := page.answer()[0])["status"]:
            page.ask("status")
        assert told["streams"] == [] and told["status"]["renders"] == {}
        page.ask("free", azimuth_deg=10, elevation_deg=20, range_m=1500, camera="bare", body="body")
        head, pixels = page.answer()
        assert head["kind"] == "free" and head["geometry"]["range_m"] == pytest.approx(1500.0)
        assert head["geometry"]["off_boresight_deg"] == pytest.approx(0.0, abs=1e-6) and (pixels > 0.0).sum() > 20
        with Client(endpoint) as client, pytest.raises(ServerError, match="by its own --view alone"):
            client.watch()


def test_a_scene_that_was_replaced_is_not_asked_about_old_frames(tmp_path):
    with serving.server(tmp_path, "--view", "0", "--watch", scene=SCENE) as (endpoint, process), \
            Page(address_of(process)) as page, Client(endpoint, timeout_s=60.0) as client:
        client.render(state(), "bare")
        page.ask("frame", after=0, stream=None)
        old, _ = page.answer()
        scene = tomllib.loads(SCENE)
        scene["bodies"][0]["generated"]["radius_m"] = 50.0
        client.load_scene(scene)
        assert client.watch().streams == []
        page.ask("pixel", number=old["number"], x=16, y=16)  # at once: the page's process has not asked for anything
        assert "replaced" in page.answer()[0]["trouble"]
        client.render(state(), "bare")
        page.ask("frame", after=old["number"], stream=["nobody", "bare"])
        page.ask("frame", after=old["number"], stream=None)
        new, _ = page.answer()
        assert new["geometry"]["radius_m"] == pytest.approx(0.5 * old["geometry"]["radius_m"])
        page.ask("pixel", number=new["number"], x=16, y=16)
        assert page.answer()[0]["range_m"] == client.render(
            state(), "bare", products=["range"], roi=(16, 16, 17, 17)).arrays["range"][0, 0]


def test_the_view_ends_with_its_server(tmp_path):
    with serving.server(tmp_path, "--view", "0", scene=SCENE) as (_, process):
        address = address_of(process)
        with Page(address) as page:
            page.ask("status")
            page.answer()
        process.kill()
        process.wait()
        serving.until(lambda: not answers(address), PATIENCE_S)


@pytest.mark.slow
def test_a_browser_finds_the_view_that_took_anothers_place(tmp_path, window):
    """Which counts frames anew: the page asks for the first again."""
    with serving.server(tmp_path, "--view", "0", scene=SCENE) as (endpoint, process), Client(endpoint) as client:
        opened(window, address_of(process))
        for step in range(3):
            client.render(state(step), "bare")
            serving.until(lambda step=step: frame_number(window) == step + 1, PATIENCE_S)
        (number,) = processes.children(process.pid, b"glrender_server.view")
        os.kill(number, signal.SIGKILL)
        serving.until(lambda: frame_number(window) == 1, PATIENCE_S)


def test_a_server_serves_on_without_its_view(tmp_path):
    with serving.server(tmp_path, "--view", "0", scene=SCENE) as (endpoint, process), Client(endpoint) as client:
        before = client.render(state(), "bare").pixels.tobytes()
        (number,) = processes.children(process.pid, b"glrender_server.view")
        os.kill(number, signal.SIGKILL)
        log = tmp_path / "server.log"
        serving.until(lambda: "the page's process has ended (-9); frames are served on" in log.read_text())
        assert client.render(state(), "bare").pixels.tobytes() == before
        # Another shows them, under the same address.
        with Page(address_of(process)) as page:
            page.ask("frame", after=0, stream=None)
            assert page.answer()[1].tobytes() == before
        assert processes.children(process.pid, b"glrender_server.view") != [number]
        process.send_signal(signal.SIGTERM)
        assert process.wait(60.0) == 0


def answers(address):
    try:
        urllib.request.urlopen(address, timeout=PATIENCE_S).close()
    except OSError:
        return False
    return True


def test_the_command_shows_a_server_that_lets_it(shown, tmp_path):
    endpoint, _, _ = shown
    with subprocess.Popen([GLRENDER, "view", endpoint], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        try:
            line = serving.wait_for_line(process, "glrender view of", PATIENCE_S)
            with Page(line.split()[-1]) as page, Client(endpoint) as client:
                client.render(state(3), "bare")
                page.ask("frame", after=0, stream=None)
                assert page.answer()[0]["camera"]["name"] in ("bare", "navcam")
            process.send_signal(signal.SIGTERM)
            assert process.wait(PATIENCE_S) == 0 and process.stderr.read() == b""
        finally:
            process.kill()


@pytest.mark.slow
def test_the_command_ends_beside_a_server_that_hangs(tmp_path):
    with serving.server(tmp_path, "--watch", scene=SCENE) as (endpoint, server), \
            subprocess.Popen([GLRENDER, "view", endpoint], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        try:
            with Page(serving.wait_for_line(process, "glrender view of", PATIENCE_S).split()[-1]) as page:
                page.ask("status")
                while not page.answer()[0]["status"]:
                    page.ask("status")
                server.send_signal(signal.SIGSTOP)
                page.ask("free", azimuth_deg=0, elevation_deg=0, range_m=1500, camera="bare", body="body")
                page.ask("status")
                page.answer()
                process.send_signal(signal.SIGINT)
                # The frame would be waited for for 20 s.
                assert process.wait(12.0) == 0 and process.stderr.read() == b""
        finally:
            process.kill()


def test_the_command_says_what_is_wrong_in_one_line(tmp_path, capfd):
    with serving.server(tmp_path, scene=SCENE) as (endpoint, _):
        for arguments, message in (([endpoint], "this server shows its frames to nobody; start it with --watch"),
                                   (["nonsense"], "endpoint must be tcp://HOST:PORT"),
                                   ([endpoint, "--key", "k"], "key and server_key belong together")):
            assert main(["view", *arguments]) == 1
            told = capfd.readouterr().err
            assert message in told and told.count("\n") == 1


def test_a_port_that_is_taken_is_told_before_anything_is_loaded(shown, tmp_path):
    (tmp_path / "scene.toml").write_text(SCENE)
    port = re.search(r":(\d+)/", shown[1])[1]
    told = subprocess.run([sys.executable, "-m", "glrender_server", str(tmp_path / "scene.toml"), "--zmq",
                           "tcp://127.0.0.1:*", "--view", port], capture_output=True, text=True, timeout=60)
    assert told.returncode == 1 and f"cannot listen on 127.0.0.1:{port}" in told.stderr and "--view 0" in told.stderr


@pytest.mark.slow
def test_with_curve_the_view_has_a_key(tmp_path):
    keys = tmp_path / "keys"
    assert main(["keygen", str(keys), "--client", "loop", "--client", "view"]) == 0
    with serving.server(tmp_path, "--view", "0", "--curve", str(keys), scene=SCENE) as (endpoint, process):
        with Client(endpoint, key=keys / "loop.key_secret", server_key=keys / "server.key") as client, \
                Page(address_of(process)) as page:
            reply = client.render(state(), "bare")
            page.ask("frame", after=0, stream=None)
            assert page.answer()[1].tobytes() == reply.pixels.tobytes()
            with pytest.raises(ServerError, match="forbidden"):
                client.watch()
    (keys / "view.key_secret").unlink()
    (tmp_path / "scene.toml").write_text(SCENE)
    told = subprocess.run([sys.executable, "-m", "glrender_server", str(tmp_path / "scene.toml"), "--zmq",
                           "tcp://127.0.0.1:*", "--view", "0", "--curve", str(keys)], capture_output=True, text=True,
                          timeout=60)
    assert told.returncode == 1 and f"glrender keygen {keys} --client view" in told.stderr


def test_the_page_has_nothing_from_elsewhere():
    """No address beyond this machine stands in what the browser loads."""
    page = Path(glrender_view.__file__).with_name("page")
    found = [entry for entry in page.iterdir() if re.search(
        rb"(?:https?:)?//[a-z]", entry.read_bytes().replace(b"http://www.w3.org/2000/svg", b""))]
    assert len(list(page.iterdir())) > 8 and not found


# What the server keeps for those who watch.

REQUEST = {"v": 1, "op": "watch", "id": 1, "client": "viewer"}


def kept(tap, client, n_bytes=10, camera="navcam"):
    tap.keep(client, [camera], b"asked", [b"head", bytes(n_bytes)], None)


def test_the_newest_frame_of_each_camera_is_kept_within_bounds():
    tap = Tap()
    for k in range(3 * limits.MAX_WATCHED_FRAMES):
        kept(tap, f"client {k // 2}", camera=f"camera {k % 2}")
    told = msgpack.unpackb(tap.answer(REQUEST, False, 0)[0])
    assert len(told["streams"]) == limits.MAX_WATCHED_FRAMES and told["number"] == 3 * limits.MAX_WATCHED_FRAMES
    kept(tap, "large", limits.MAX_WATCHED_BYTES + 1)
    assert len(msgpack.unpackb(tap.answer({**REQUEST, "after": 999}, False, 0)[0])["streams"]) == 1


def test_only_what_is_newer_and_of_the_right_camera_is_told():
    tap = Tap()
    kept(tap, "a", camera="wide")
    kept(tap, "b")
    ask = lambda **fields: tap.answer({**REQUEST, **fields}, False, 0)  # noqa: E731
    newest, of_a = ask(), ask(of_client="a", camera="wide")
    assert msgpack.unpackb(newest[0])["of_client"] == "b" and msgpack.unpackb(of_a[0])["number"] == 1
    assert len(ask(after=2)) == 1 and len(ask(after=1)) == 2 and len(ask(of_client="a", camera="navcam")) == 1
    assert len(ask(after=77)) == 2, "the number of a server that was here before"


def test_what_all_watchers_get_over_sockets_is_bounded_by_the_second(monkeypatch):
    tap, now = Tap(), 1000.0
    monkeypatch.setattr("glrender_server.tap.time.monotonic", lambda: now)
    kept(tap, "a", 1 << 22)
    sent = 0
    for _ in range(4000):
        now += 0.001
        sent += sum(map(len, (tap.answer(REQUEST, False, 0) or [b""])[1:]))
    assert 0.9 < sent / (5.0 * limits.WATCHED_BYTES_PER_S) < 1.1
    n_encrypted = sum(tap.answer(REQUEST, True, 0) is not None for now in 2000.0 + 0.001 * np.arange(4000))
    assert n_encrypted * limits.CURVE_COST << 22 < 6.1 * limits.WATCHED_BYTES_PER_S


def test_the_background_takes_half_a_percent_of_the_time_of_others():
    """A client asks every 50 ms; frames of the background take 20 ms each."""
    place, now, drawn = background.Background(), 0.0, 0
    while now < 100.0:
        place.others_ask(now)
        place.put("viewer", "frame")
        if place.get(now) is not None:
            now += 0.02
            drawn += 1
            place.ended(now)
        now += 0.05
    assert 0.004 < 0.02 * drawn / 100.0 <= 0.0055


def test_the_background_is_free_while_nobody_asks():
    place, now, drawn = background.Background(), 0.0, 0
    while now < 10.0:
        place.put("viewer", "frame")
        if place.get(now) is not None:
            drawn, now = drawn + 1, now + 0.02
            place.ended(now)
        now += 0.01
    # The first is followed by a pause: nobody knew how long it would take.
    assert drawn > 200
    assert place.put("viewer", "newer") == ["frame"] or place.drop() == "newer"
    assert place.put("a", 1) == [] and place.put("b", 2) == [2] and place.put("a", 3) == [1] and place.drop() == 3
    assert not place and place.get(1e9) is None


def test_a_background_frame_goes_with_no_backend(shown):
    with Client(shown[0]) as client, pytest.raises(ServerError, match="background.*backend"):
        client.render(state(), "bare", background=True, backend="raytrace")
    with Client(shown[0]) as client:
        assert client.render(state(), "bare", background=True).pixels.tobytes() == client.render(
            state(), "bare").pixels.tobytes()
