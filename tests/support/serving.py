"""A real server in its own process, for tests: ephemeral loopback port, stopped whatever happens."""

from __future__ import annotations

import os
import select
import socket
import struct
import subprocess
import sys
import time
from contextlib import contextmanager

import processes

SCENE = """
max_error = 0.1
[[bodies]]
name = "body"
generated = { kind = "three_lobes", radius_m = 100.0, subdivisions = 4 }
brdf = { law = "lunar_lambert", normal_albedo = 0.2, weight = "mcewen" }
[[cameras]]
name = "navcam"
width_px = 96
height_px = 64
focal_length_px = 400.0
[cameras.model]
exposure_s = 0.01
optics = { aperture_diameter_m = 0.01, psf_sigma_px = 0.5 }
detector = { quantum_efficiency = 0.5, full_well_electrons = 30000.0, gain_DN_per_electron = 0.1, bit_depth = 12, \
read_noise_electrons = 10.0 }
[[cameras]]
name = "bare"
width_px = 32
height_px = 32
focal_length_px = 100.0
"""


def wait_for_line(process, start, seconds):
    """The line of a process's standard output that begins with `start`; what came so far is `process.said`."""
    deadline, text = time.monotonic() + seconds, b""
    while time.monotonic() < deadline:
        if select.select([process.stdout], [], [], 0.1)[0]:
            chunk = os.read(process.stdout.fileno(), 4096)
            text += chunk
            process.said = text.decode()
            for line in text.decode().splitlines():
                if line.startswith(start):
                    return line
            if not chunk:
                break
    raise AssertionError(f"no line {start!r} within {seconds} s, but: {text!r}; exit code {process.poll()}")


@contextmanager
def server(folder, *arguments, scene=SCENE):
    """Yields (endpoint, process) of a server of `scene`."""
    file = folder / "scene.toml"
    file.write_text(scene)
    with open(folder / "server.log", "wb") as log:
        process = subprocess.Popen([sys.executable, "-m", "glrender_server", str(file), "--zmq", "tcp://127.0.0.1:*",
                                    *arguments], stdout=subprocess.PIPE, stderr=log)
        try:
            process.ready_line = wait_for_line(process, "glrender-server ready on", 180.0)
            yield process.ready_line.split()[3], process
        finally:
            process.kill()
            process.wait()
            process.stdout.close()


def children(process):
    """Process numbers of a server's workers."""
    return processes.children(process.pid, b"spawn_main")


def until(condition, seconds=90.0):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it did not come to pass"
        time.sleep(0.05)


def tcp_address(process):
    """(host, port) of the framed TCP of a server that was started with --tcp."""
    host, _, port = process.ready_line.split(" and ")[1].split()[0].rpartition(":")
    return host, int(port)


class Framed:
    """A bare TCP client of docs/protocol.md, written from that page and sharing no line with the server."""

    def __init__(self, address, receive_buffer=None):
        self.socket = socket.socket()
        if receive_buffer:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        self.socket.settimeout(30.0)
        self.socket.connect(address)

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self.socket.close()

    @staticmethod
    def frame(*parts, magic=b"GLR1", flags=0):
        head = magic + struct.pack("<HH", len(parts), flags) + struct.pack(f"<{len(parts)}I", *map(len, parts))
        return head + b"".join(parts)

    def send(self, *parts):
        self.socket.sendall(self.frame(*parts))

    def exactly(self, size):
        data = bytearray()
        while len(data) < size:
            chunk = self.socket.recv(size - len(data))
            if not chunk:
                raise EOFError(f"the server hung up after {len(data)} of {size} bytes")
            data += chunk
        return bytes(data)

    def receive(self):
        magic, n_parts, flags = struct.unpack("<4sHH", self.exactly(8))
        assert (magic, flags) == (b"GLR1", 0)
        return [self.exactly(size) for size in struct.unpack(f"<{n_parts}I", self.exactly(4 * n_parts))]

    def ask(self, *parts):
        self.send(*parts)
        return self.receive()
