"""Time that the service adds to a rendered frame: per transport, client and size, the median, p95 and p99.

The time of a request at its client, less the time that the server spent on the frame. The reach, on two quiet
cores: Python, 4 MiB, 1.5 ms over tcp, 0.8 ms over ipc or shared memory; C 3 ms; Octave 5 ms for 1 MiB, 12 ms for 4 MiB.
Beside it, in the same run, the floor: as many bytes from a bare socket (tcp; ipc) of a process that, like a renderer,
was busy for 4 ms before. Prints one JSON line; clients that cannot run here are named under `not_run`.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from glrender_client import Client

REPOSITORY = Path(__file__).resolve().parents[1]
SIMULINK = REPOSITORY / "clients" / "simulink"
N_FRAMES, N_WARM_UP = int(os.environ.get("GLRENDER_BENCH_FRAMES") or "60"), 5
MODEL = """[cameras.model]
exposure_s = 0.01
optics = { aperture_diameter_m = 0.01, psf_sigma_px = 0.5 }
detector = { quantum_efficiency = 0.5, full_well_electrons = 30000.0, gain_DN_per_electron = 0.006, bit_depth = 8 }
"""
RENDER_S = 0.004
# Camera: (size in pixels, output, bytes).
CAMERAS = {"small": (64, "irradiance", 64**2 * 4), "u8_1024": (1024, "dn", 1024**2),
           "f4_1024": (1024, "irradiance", 1024**2 * 4), "u8_2048": (2048, "dn", 2048**2)}
SCENE = """
max_error = 1.0
[[bodies]]
name = "body"
generated = { kind = "icosphere", radius_m = 100.0, subdivisions = 3 }
brdf = { law = "lambert", normal_albedo = 0.2 }
""" + "".join(f"""[[cameras]]
name = "{name}"
width_px = {size}
height_px = {size}
focal_length_px = {2.0 * size}
{MODEL if output == "dn" else ""}""" for name, (size, output, _) in CAMERAS.items())
STATE = {"t_s": 0.0, "r_sun_inertial_m": [1e11, 0.0, -1.1e11],
         "spacecraft": {"r_inertial_m": [0.0, 0.0, -2000.0], "q_from_inertial": [1.0, 0.0, 0.0, 0.0]},
         "bodies": {"body": {"r_inertial_m": [0.0, 0.0, 0.0], "q_from_inertial": [1.0, 0.0, 0.0, 0.0]}}}


def main() -> None:
    record = {"benchmark": "transport", "frames": N_FRAMES, "load_average": os.getloadavg()[0], "added_ms": {},
              "floor_ms": {}, "not_run": []}
    for family in ("tcp", "ipc"):
        record["floor_ms"][family] = {name: percentiles(floor_ms(n_bytes, family))
                                      for name, (_, _, n_bytes) in CAMERAS.items()}
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        (folder / "scene.toml").write_text(SCENE)
        (folder / "state.json").write_text(json.dumps(STATE))
        native = native_clients(folder, record)
        ways = {"ipc, shared memory": True, "ipc, socket": False}
        for arguments, kinds in [
                (["--zmq", "tcp://127.0.0.1:*"], {"tcp": False}), (["--zmq", f"ipc://{folder}/z"], ways),
                (["--zmq", f"ipc://{folder}/w", "--workers", "2"],
                 {f"{name}, two workers": shared for name, shared in ways.items()})]:
            with_server(folder, kinds, arguments, native if "tcp" in kinds else {}, record)
    sys.stdout.write(json.dumps(record) + "\n")


def with_server(folder: Path, kinds: dict[str, bool], arguments: list[str], native: dict, record: dict) -> None:
    """Every client of a server; the Python client by each of `kinds`: with shared memory or without."""
    log = folder / "log"
    with open(log, "wb") as file:
        process = subprocess.Popen(
            [sys.executable, "-m", "glrender_server", str(folder / "scene.toml"), "--tcp", "127.0.0.1:0", *arguments,
             "--log-format", "json", "-v"], stdout=subprocess.PIPE, stderr=file, text=True)
        try:
            line = process.stdout.readline()
            port = int(line.split(" and ")[1].split()[0].rpartition(":")[2])
            for kind, shared in kinds.items():
                with Client(line.split()[3], timeout_s=60.0, shared_memory=shared) as client:
                    record["gl_renderer"] = client.hello()["gl_renderer"]
                    for name, (_, output, _) in CAMERAS.items():
                        told, rendered = zip(*(python_frame(client, name, output, k)
                                               for k in range(N_FRAMES + N_WARM_UP)), strict=True)
                        note(record, f"python {kind}", name, told, rendered)
            for who, command in native.items():
                for name, (_, output, _) in CAMERAS.items():
                    told = command("127.0.0.1", port, name, output)
                    rendered = [entry["render_ms"] for entry in map(json.loads, log.read_text().splitlines())
                                if entry["message"] == "request"][-len(told):]
                    note(record, who, name, told, rendered)
        finally:
            process.terminate()
            process.wait(timeout=20.0)


def python_frame(client: Client, camera: str, output: str, k: int) -> tuple[float, float]:
    """Milliseconds of a request, and of the server's work on its frame."""
    began = time.perf_counter()
    reply = client.render({**STATE, "t_s": float(k)}, camera, output=output)
    return 1e3 * (time.perf_counter() - began), reply.header["timings_ms"]["total"]


def native_clients(folder: Path, record: dict) -> dict:
    """Commands that run the C and the Octave client: each gives the milliseconds of every frame."""
    found = {}
    compiler, octave = shutil.which("cc"), shutil.which("octave-cli")
    if compiler:
        library = sorted(SIMULINK.glob("glr_*.c"))
        subprocess.run([compiler, "-std=c99", "-O2", f"-I{SIMULINK}", REPOSITORY / "benchmarks" / "transport_client.c",
                        *library, "-o", folder / "client"], check=True)
        pose = lambda p: [*p["r_inertial_m"], *p["q_from_inertial"]]  # noqa: E731
        numbers = np.array([*STATE["r_sun_inertial_m"], *pose(STATE["spacecraft"]), *pose(STATE["bodies"]["body"])])
        found["c framed tcp"] = lambda host, port, camera, output: run(
            [folder / "client", host, port, camera, int(output == "dn"), N_FRAMES + N_WARM_UP], numbers.tobytes())
    if octave:
        found["octave shared memory"] = octave_client(octave, folder, "class")
        found["octave framed tcp"] = octave_client(octave, folder, "class socket")
    if octave and shutil.which("mkoctfile"):
        subprocess.run([octave, "-q", "--no-history", "--path", SIMULINK, "--eval", f"build_glrender_mex('{folder}')"],
                       check=True, capture_output=True)
        found["octave mex framed tcp"] = octave_client(octave, folder, "mex")
    record["not_run"] += [who for who in ("c framed tcp", "octave shared memory", "octave mex framed tcp")
                          if who not in found]
    return found


def octave_client(octave: str, folder: Path, kind: str):
    return lambda host, port, camera, output: run(
        [octave, "-q", "--no-history", "--path", SIMULINK, "--path", folder,
         REPOSITORY / "benchmarks" / "transport_client.m", host, port, camera, output, N_FRAMES + N_WARM_UP,
         folder / "state.json", kind])


def run(command: list, data: bytes = b"") -> list[float]:
    done = subprocess.run(list(map(str, command)), input=data, capture_output=True, check=True, timeout=600)
    return [float(line) for line in done.stdout.split()]


def floor_ms(n_bytes: int, family: str) -> list[float]:
    """Round trips of 512 bytes against `n_bytes` over a bare loopback or Unix socket, less the other side's work."""
    kind = {"tcp": socket.AF_INET, "ipc": socket.AF_UNIX}[family]
    with socket.socket(kind) as listener:
        listener.bind(("127.0.0.1", 0) if family == "tcp" else "")
        listener.listen(1)
        process = get_context("spawn").Process(target=serve_bytes, args=(kind, listener.getsockname(), n_bytes),
                                               daemon=True)
        process.start()
        peer, _ = listener.accept()
        milliseconds, buffer = [], bytearray(8 + n_bytes)
        with peer:
            for _ in range(N_FRAMES + N_WARM_UP):
                began = time.perf_counter()
                peer.sendall(bytes(512))
                view = memoryview(buffer)
                while view:
                    view = view[peer.recv_into(view):]
                milliseconds.append(1e3 * (time.perf_counter() - began - np.frombuffer(buffer, float, 1)[0]))
        process.join()
    return milliseconds


def serve_bytes(kind: int, address: tuple[str, int] | bytes, n_bytes: int) -> None:
    data = np.zeros(n_bytes, np.uint8)
    with socket.socket(kind) as peer:
        # As the server's own: see LOOPBACK_BUFFER in front.py.
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 18 if kind == socket.AF_INET else 1 << 22)
        peer.connect(address)
        if kind == socket.AF_INET:
            peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        while peer.recv(512, socket.MSG_WAITALL):
            began = time.perf_counter()
            while time.perf_counter() - began < RENDER_S:
                data[:] += 1
            peer.sendall(np.float64(time.perf_counter() - began).tobytes())
            peer.sendall(data)


def percentiles(milliseconds) -> dict[str, float]:
    kept = np.asarray(milliseconds)[N_WARM_UP:]
    return {f"p{q}": round(float(np.percentile(kept, q)), 3) for q in (50, 95, 99)}


def note(record: dict, who: str, camera: str, told, rendered) -> None:
    """The frame's own time beside the added time: where it is far above the shortest, other work had the cores."""
    found = percentiles(np.subtract(told, rendered))
    found["render_p50"] = percentiles(rendered)["p50"]
    floor = record["floor_ms"]["ipc" if "ipc" in who else "tcp"][camera]["p50"]
    found["p50_over_floor"] = round(found["p50"] / floor, 2)
    record["added_ms"].setdefault(who, {})[camera] = found


if __name__ == "__main__":
    main()
