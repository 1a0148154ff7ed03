"""`glrender top`: one screen for scripts, and one that is renewed while a server comes and goes."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import threading
import time
from pathlib import Path

import pytest
import serving
import views
from glrender_cli.__main__ import main
from glrender_cli.commands import top
from glrender_client import Client, ServerError

STATE = views.state().to_dict()
CLEAR = b"\x1b[H\x1b[J"
GLRENDER = str(Path(sys.executable).with_name("glrender"))


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    with serving.server(tmp_path_factory.mktemp("top")) as (endpoint, _):
        yield endpoint


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


@pytest.mark.slow
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
    (["--interval", "0"], "--interval: must be between 0.001 and 86400"),
    (["--interval", "1e300"], "--interval: must be between 0.001 and 86400"),
    (["--timeout", "nan"], "--timeout: must be a finite number"),
    (["--timeout", "1e300"], "--timeout: must be between 0.001 and 86400"),
    (["--key", "k"], "key and server_key belong together"),
])
def test_wrong_options_are_told_in_one_line(arguments, message, capfd):
    assert main(["top", "--once", *arguments]) == 1
    told = capfd.readouterr().err
    assert message in told and told.count("\n") == 1


@pytest.mark.parametrize("address", ["nonsense", "", "tcp://127.0.0.1", "tcp://127.0.0.1:port", "ipc://" + "x" * 200])
def test_what_is_no_address_is_told_in_one_line(address, capfd):
    assert main(["top", address, "--once"]) == 1
    told = capfd.readouterr().err
    assert told.count("\n") == 1 and f"endpoint must be tcp://HOST:PORT or ipc://PATH, got {address!r}" in told


def on_a_terminal(columns, lines, *arguments):
    """Some screens of `glrender top` on a terminal of this size, and its exit code after Ctrl-C."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))
    environment = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")}
    process = subprocess.Popen([GLRENDER, "top", *arguments], stdout=theirs, stderr=theirs, env=environment)
    os.close(theirs)
    written, deadline, is_told = b"", time.monotonic() + 60.0, False
    try:
        while time.monotonic() < deadline:
            if written.count(CLEAR) > 4 and not is_told:
                process.send_signal(signal.SIGINT)
                is_told = True
            if select.select([ours], [], [], 0.1)[0]:
                try:
                    written += os.read(ours, 65536)
                except OSError:  # the other end is closed
                    break
        return written.split(CLEAR)[1:-1], process.wait(10.0)
    finally:
        process.kill()
        process.wait()
        os.close(ours)


@pytest.mark.parametrize("columns, lines", [(120, 40), (20, 40), (80, 4), (1, 2)])
def test_a_screen_fits_its_terminal(live, columns, lines):
    """A line that is broken in two, or one too many, would leave what is above it standing."""
    screens, code = on_a_terminal(columns, lines, live, "--interval", "0.1")
    assert code == 0 and len(screens) > 3
    for one in screens:
        shown = one.decode().replace("\r", "").splitlines()
        assert len(shown) == min(9, lines - 1) and max(map(len, shown)) <= columns
        assert shown[0] == f"{live}  up"[:columns] + shown[0][len(f"{live}  up"):]


def test_who_reads_one_line_hears_no_complaint(live):
    with subprocess.Popen([GLRENDER, "top", live, "--interval", "0.1"], text=True, stdout=subprocess.PIPE,
                          stderr=subprocess.PIPE) as watcher:
        assert watcher.stdout.readline().startswith(live)
        watcher.stdout.close()
        assert watcher.wait(10.0) == 0 and watcher.stderr.read() == ""


def test_a_server_that_is_closing_is_shown_and_waited_for(monkeypatch, capsys):
    class Closing:
        def __init__(self, *arguments, **options):
            self.count = 0

        __enter__ = lambda self: self  # noqa: E731
        __exit__ = lambda self, *exception: None  # noqa: E731

        def status(self):
            self.count += 1
            if self.count < 3:
                raise ServerError("closing", "", "the server is shutting down")
            raise KeyboardInterrupt

    monkeypatch.setattr(top, "Client", Closing)
    assert main(["top", "--interval", "0.01"]) == 0
    assert capsys.readouterr().out == 2 * "[closing] the server is shutting down\n"


def test_a_status_without_workers_and_without_a_frame():
    status = {"uptime_s": 3725.9, "gl_renderer": "llvmpipe", "backend": "egl", "requests": {"hello": 1, "render": 7},
              "errors": {}, "waiting": 2, "clients": 0, "last_timings_ms": {}, "cameras": [], "bodies": []}
    lines = list(top.screen("ipc:///x", status, 12.345))
    assert lines[:3] == ["ipc:///x  up 1:02:05  llvmpipe by egl", "requests   7 render, 1 hello  (12.3 /s)",
                         "errors     none"]
    assert "last [ms]  nothing rendered" in lines and not any(line.startswith("workers") for line in lines)
