"""`glrender top`: one screen for scripts, and one that is renewed while a server comes and goes."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
import serving
import views
from glrender_client import Client, ServerError
from glrender_server import top

STATE = views.state().to_dict()
GLRENDER = str(Path(sys.executable).with_name("glrender"))


def test_once_is_one_screen_for_scripts(tmp_path):
    with serving.server(tmp_path, "--workers", "2") as (endpoint, _), Client(endpoint) as client:
        for _ in range(3):
            client.render(STATE, "bare")
        with pytest.raises(ServerError, match="unknown camera"):
            client.render(STATE, "wac")
        once = subprocess.run([GLRENDER, "top", endpoint, "--once"], capture_output=True, text=True, timeout=60)
    assert once.returncode == 0 and len(once.stdout.splitlines()) <= 24, "one screen"
    lines = {line.split()[0]: line for line in once.stdout.splitlines()}
    assert re.search(r"up \d+:\d\d:\d\d .* by (egl|osmesa)", lines[endpoint])
    assert re.fullmatch(r"requests +4 render(, \d+ \w+)*", lines["requests"])
    assert re.fullmatch(r"errors +1 scene", lines["errors"])
    assert re.fullmatch(r"waiting +0", lines["waiting"]) and re.fullmatch(r"clients +1", lines["clients"])
    assert re.fullmatch(r"workers +[12] of 2 ready, 0 restarts", lines["workers"])
    assert re.search(r"total \d+\.\d\d", lines["last"])
    assert "bare 32 x 32" in lines["cameras"] and "body 5120 facets" in lines["bodies"]
    gone = subprocess.run([GLRENDER, "top", endpoint, "--once", "--timeout", "0.3"], capture_output=True, text=True,
                          timeout=60)
    assert gone.returncode == 1 and "is glrender-server running there?" in gone.stderr and gone.stderr.count("\n") == 1


def test_it_says_how_often_the_server_is_asked_and_outlives_it(tmp_path):
    with serving.server(tmp_path) as (endpoint, process):
        watcher = subprocess.Popen([GLRENDER, "top", endpoint, "--interval", "0.3", "--timeout", "0.4"], text=True,
                                   stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        guard = threading.Timer(30.0, watcher.kill)
        guard.start()
        try:
            rates = (float(found[1]) for line in watcher.stdout if (found := re.search(r"\(([\d.]+) /s\)", line)))
            assert next(rates) == 0.0, "its own requests do not count"
            with Client(endpoint) as client:
                for _ in range(400):
                    client.hello()
            assert max(next(rates) for _ in range(3)) > 100.0
            process.kill()
            assert any(line.startswith(f"{endpoint} did not answer") for line in watcher.stdout)
            watcher.send_signal(signal.SIGINT)
            assert watcher.wait(10.0) == 0 and watcher.stderr.read() == ""
        finally:
            guard.cancel()
            watcher.kill()
            watcher.wait()
            watcher.stdout.close()
            watcher.stderr.close()


@pytest.mark.parametrize("arguments, message", [
    (["--interval", "0"], "--interval: must be > 0"),
    (["--timeout", "nan"], "--timeout: must be a finite number"),
    (["--key", "k"], "key and server_key belong together"),
])
def test_wrong_options_are_told_in_one_line(arguments, message):
    run = subprocess.run([GLRENDER, "top", "--once", *arguments], capture_output=True, text=True, timeout=60)
    assert run.returncode == 1 and message in run.stderr and run.stderr.count("\n") == 1


def test_a_status_without_workers_and_without_a_frame():
    status = {"uptime_s": 3725.9, "gl_renderer": "llvmpipe", "backend": "egl", "requests": {"hello": 1, "render": 7},
              "errors": {}, "waiting": 2, "clients": 0, "last_timings_ms": {}, "cameras": [], "bodies": []}
    lines = list(top.screen("ipc:///x", status, 12.345))
    assert lines[:3] == ["ipc:///x  up 1:02:05  llvmpipe by egl", "requests   7 render, 1 hello  (12.3 /s)",
                         "errors     none"]
    assert "last [ms]  nothing rendered" in lines and not any(line.startswith("workers") for line in lines)
