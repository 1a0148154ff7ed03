"""A real server in its own process, for tests: ephemeral loopback port, stopped whatever happens."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from contextlib import contextmanager

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
    """The line of a process's standard output that begins with `start`."""
    deadline, text = time.monotonic() + seconds, b""
    while time.monotonic() < deadline:
        if select.select([process.stdout], [], [], 0.1)[0]:
            chunk = os.read(process.stdout.fileno(), 4096)
            text += chunk
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
            yield wait_for_line(process, "glrender-server ready on", 60.0).split()[3], process
        finally:
            process.kill()
            process.wait()
            process.stdout.close()
