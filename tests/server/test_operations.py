"""Running the server: keys, metrics, logs, the unit and the image, a context that was lost."""

from __future__ import annotations

import json
import os
import re
import shlex
import socket
import stat
import struct
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest
import serving
import views
import zmq.auth
from glrender import ConfigError, DeviceError, load_scene
from glrender_cli.__main__ import main as glrender
from glrender_client import Client, RequestTimeout
from glrender_server import __main__ as command
from glrender_server import keys, limits, operations
from glrender_server.metrics import MetricsServer

STATE = views.state().to_dict()
EXAMPLES = Path(__file__).parents[2] / "examples" / "service"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("keys") / "curve"
    assert glrender(["keygen", str(folder), "--client", "simulink", "--client", "loop-1"]) == 0
    return folder


@pytest.fixture(scope="module")
def guarded(folder, tmp_path_factory):
    with serving.server(tmp_path_factory.mktemp("guarded"), "--curve", str(folder)) as (endpoint, process):
        assert "CURVE" in process.ready_line
        yield endpoint


def test_keygen_makes_each_pair_once_and_secrets_are_private(folder, capsys):
    files = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    assert files == ["clients/loop-1.key", "clients/simulink.key", "loop-1.key_secret", "server.key",
                     "server.key_secret", "simulink.key_secret"]
    for path in folder.glob("*_secret"):
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
    before = (folder / "server.key").read_bytes()
    assert glrender(["keygen", str(folder), "--client", "simulink"]) == 0
    assert (folder / "server.key").read_bytes() == before and capsys.readouterr().out == ""


def test_a_client_with_its_key_is_served(guarded, folder):
    with Client(guarded, key=folder / "simulink.key_secret", server_key=folder / "server.key") as client:
        assert client.render(STATE, "bare").pixels.any()


def test_strangers_hear_nothing(guarded, folder, tmp_path):
    """No key, an unknown client's key, the wrong server's key: each times out, and a known client is served still."""
    glrender(["keygen", str(tmp_path / "other"), "--client", "stranger"])
    for options in ({}, {"key": tmp_path / "other" / "stranger.key_secret", "server_key": folder / "server.key"},
                    {"key": folder / "simulink.key_secret", "server_key": tmp_path / "other" / "server.key"}):
        with Client(guarded, timeout_s=0.7, retries=0, **options) as client, pytest.raises(RequestTimeout):
            client.hello()
    with Client(guarded, key=folder / "loop-1.key_secret", server_key=folder / "server.key") as client:
        assert client.hello()["ok"]


def test_with_keys_the_server_may_leave_this_machine_and_tcp_still_may_not():
    assert command.checked_endpoint("tcp://0.0.0.0:5555", True)
    with pytest.raises(ConfigError, match="--curve with keys"):
        command.checked_endpoint("tcp://0.0.0.0:5555", False)
    with pytest.raises(ConfigError, match="--tcp: leads beyond"):
        command.checked_address("0.0.0.0:5556", False)


@pytest.mark.parametrize("spoil, message", [
    (lambda f: None, "is no key file"),
    (lambda f: keys.generate(f, []), "admits no client"),
    (lambda f: (keys.generate(f, ["a"]), os.chmod(f / "server.key_secret", 0o644)), "readable by its owner alone"),
    (lambda f: (keys.generate(f, ["a"]), (f / "server.key_secret").write_text("nothing")), "is no key file"),
])
def test_a_folder_without_sound_keys_is_refused_at_the_start(tmp_path, spoil, message, capfd):
    (tmp_path / "scene.toml").write_text(serving.SCENE)
    (tmp_path / "keys").mkdir()
    spoil(tmp_path / "keys")
    assert command.main([str(tmp_path / "scene.toml"), "--zmq", "tcp://127.0.0.1:*", "--curve",
                         str(tmp_path / "keys")]) == 1
    assert message in capfd.readouterr().err


def test_keygen_refuses_half_a_pair_and_odd_names(tmp_path):
    keys.generate(tmp_path, ["a"])
    (tmp_path / "a.key_secret").unlink()
    with pytest.raises(ConfigError, match="one half of a pair"):
        keys.generate(tmp_path, ["a"])
    for name in ("../x", "server", "", "a b"):
        with pytest.raises(ConfigError, match="letters, digits"):
            keys.generate(tmp_path, [name])
    for options in ({"key": tmp_path / "server.key_secret"}, {"server_key": tmp_path / "server.key"}):
        with pytest.raises(ValueError, match="belong together"):
            Client("tcp://127.0.0.1:5", **options)
    assert zmq.auth.load_certificate(tmp_path / "server.key")[1] is None, "the public file holds no secret"


def test_memory_is_that_of_the_control_group(tmp_path):
    """A service of systemd's has its limit in a group of its own, a container at the root, a slice above both."""
    groups, root = tmp_path / "cgroup", tmp_path / "fs"
    own = root / "system.slice" / "glrender.service"
    own.mkdir(parents=True)
    groups.write_text("0::/system.slice/glrender.service\n")
    whole = command._memory_bytes(groups, root)
    assert whole == os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    (own / "memory.max").write_text("max\n")
    assert command._memory_bytes(groups, root) == whole
    (own / "memory.max").write_text("3000000\n")
    assert command._memory_bytes(groups, root) == 3_000_000
    (own.parent / "memory.max").write_text("2000000\n")
    assert command._memory_bytes(groups, root) == 2_000_000
    (root / "memory.max").write_text("1000000\n")
    assert command._memory_bytes(groups, root) == 1_000_000
    assert command._memory_bytes(tmp_path / "none", root) == whole


def test_the_unit_leaves_memory_for_the_server_beside_its_workers():
    text = (EXAMPLES / "glrender.service").read_text()
    most = int(re.search(r"MemoryMax=(\d+)G", text)[1])
    workers, each = (float(re.search(rf"--{name} ([\d.]+)", text)[1]) for name in ("workers", "worker-memory"))
    # One GiB of frames in shared memory, and one of replies that nobody takes.
    assert workers * each + 2.0 <= most


@pytest.fixture
def scraped():
    """(host, port) of metrics of one line."""
    served = MetricsServer(0, lambda: ["one 1"])
    yield "127.0.0.1", int(served.endpoint.split(":")[2].split("/")[0])
    served.close()


def scrape(address, host="127.0.0.1:1"):
    with socket.create_connection(address, 5.0) as peer:
        peer.sendall(f"GET /metrics HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n".encode())
        return int(peer.makefile("rb").readline().split()[1])


def test_silent_connections_keep_no_scrape_out(scraped):
    held = [socket.create_connection(scraped, 5.0) for _ in range(2 * limits.MAX_METRICS_CONNECTIONS)]
    assert scrape(scraped) == 200
    for peer in held:
        peer.settimeout(5.0)
        assert not peer.recv(1), "who says nothing within a second is closed"
        peer.close()


@pytest.mark.parametrize("host, code", [("127.0.0.1", 200), ("localhost:9", 200), ("evil.example:80", 403), ("", 403)])
def test_metrics_are_read_by_the_names_of_this_machine(scraped, host, code):
    assert scrape(scraped, host) == code


def test_a_scrape_that_is_broken_off_writes_no_line(scraped, capfd):
    for _ in range(20):
        with socket.create_connection(scraped, 5.0) as peer:
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            peer.sendall(b"GET /metrics HTTP/1.1\r\nHost: 127.0.0.1:1\r\n\r\n" * 3)
    assert scrape(scraped) == 200
    time.sleep(0.2)
    assert capfd.readouterr().err == ""


def test_metrics_count_what_was_asked_and_how_long_it_took(tmp_path):
    with serving.server(tmp_path, "--metrics", "0") as (endpoint, process), Client(endpoint) as client:
        url = re.search(r"http://127\.0\.0\.1:\d+/metrics", process.ready_line)[0]
        for k in range(3):
            client.render(STATE, "bare", max_error=0.1 + 0.01 * k)
        with pytest.raises(Exception, match="unknown camera"):
            client.render(STATE, "wac")
        text = urllib.request.urlopen(url, timeout=5).read().decode()
        values = dict(line.rsplit(" ", 1) for line in text.splitlines() if not line.startswith("#"))
        assert values['glrender_requests_total{op="render"}'] == "4"
        assert values['glrender_errors_total{code="scene"}'] == "1"
        assert values['glrender_request_seconds_count{op="render"}'] == "4"
        assert values['glrender_request_seconds_bucket{op="render",le="+Inf"}'] == "4"
        assert values['glrender_stage_seconds_count{stage="surface"}'] == "3"
        assert 0.0 < float(values['glrender_request_seconds_sum{op="render"}']) < 10.0
        buckets = [int(values[f'glrender_request_seconds_bucket{{op="render",le="{le}"}}'])
                   for le in ("0.001", "0.1", "60")]
        assert buckets == sorted(buckets) and buckets[-1] == 4
        for line in text.splitlines():
            assert re.fullmatch(r'(# TYPE \w+ \w+|\w+(\{\w+="[^"]*"(,\w+="[^"]*")*\})? [-+.\deE]+)', line), line
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(url.replace("metrics", "etc/passwd"), timeout=5)


def test_a_log_for_programs_is_one_object_a_line(tmp_path):
    with serving.server(tmp_path, "--log-format", "json", "-v", "--workers", "2") as (endpoint, process), \
            Client(endpoint) as client:
        client.render(STATE, "bare")
        process.terminate()
        assert process.wait(20.0) == 0
    records = [json.loads(line) for line in (tmp_path / "server.log").read_text().splitlines()]
    (request,) = [record for record in records if record["message"] == "request"]
    assert (request["op"], request["code"], request["level"]) == ("render", "", "DEBUG") and request["ms"] > 0.0
    assert {"t", "level", "logger", "process", "message"} <= set(records[0])
    assert len({record["process"] for record in records}) > 1, "the workers' lines are of the same kind"


@pytest.mark.parametrize("text", [
    re.search(r"^ExecStart=(.*)$", (EXAMPLES / "glrender.service").read_text(), re.M)[1],
    "glrender-server " + " ".join(json.loads(re.search(r"^CMD (.*)$", (EXAMPLES / "Dockerfile").read_text(), re.M)[1])),
])
def test_the_example_commands_are_ones_that_the_server_takes(text, tmp_path):
    """As written, but with the files of this test: it starts and is ready."""
    words = shlex.split(text)[1:]
    (tmp_path / "scene.toml").write_text(serving.SCENE)
    words[0] = str(tmp_path / "scene.toml")
    for option, value in (("--shape-dir", str(tmp_path)), ("--tcp", "127.0.0.1:0"), ("--metrics", "0"),
                          ("--zmq", "tcp://127.0.0.1:*")):
        if option in words:
            words[words.index(option) + 1] = value
    if "--zmq" not in words:
        words += ["--zmq", "tcp://127.0.0.1:*"]
    process = subprocess.Popen([sys.executable, "-m", "glrender_server", *words], stdout=subprocess.PIPE,
                               stderr=subprocess.DEVNULL)
    try:
        assert serving.wait_for_line(process, "glrender-server ready on", 60.0)
        process.terminate()
        assert process.wait(20.0) == 0
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def test_a_lost_context_is_made_anew_and_the_request_answered(tmp_path, monkeypatch):
    (tmp_path / "scene.toml").write_text(serving.SCENE)
    served = operations.Operations(load_scene(tmp_path / "scene.toml"))
    header = {"v": 1, "op": "render", "id": 1, "client": "c", "state": STATE, "camera": "bare"}
    try:
        first, code, *_ = served.answer(header)
        assert not code
        lost = served._renderer

        def fail(*args, **kwargs):
            raise DeviceError("GL_CONTEXT_LOST")

        monkeypatch.setattr(lost, "render", fail)
        again, code, *_ = served.answer(header)
        assert not code and served._renderer is not lost and bytes(again[1]) == bytes(first[1])
        monkeypatch.setattr(type(lost), "render", fail)
        assert served.answer(header)[1] == "device", "a device that fails twice is told"
    finally:
        served.close()


@pytest.mark.parametrize("arguments, message", [
    (["--workers", "0"], "--workers: must be an integer between 1 and 64"),
    (["--workers", "2", "--deadline", "0"], "--deadline: must be > 0"),
    (["--deadline", "nan"], "--deadline: must be a finite number"),
    (["--metrics", "70000"], "--metrics: must be an integer between 0 and 65535"),
])
def test_wrong_options_are_refused(tmp_path, arguments, message, capfd):
    (tmp_path / "scene.toml").write_text(serving.SCENE)
    assert command.main([str(tmp_path / "scene.toml"), "--zmq", "tcp://127.0.0.1:*", *arguments]) == 1
    assert message in capfd.readouterr().err
