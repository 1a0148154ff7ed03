"""The adapter for Basilisk: time added to rendering, and the order of a thousand frames of three simulations.

Peers speak Basilisk's half of the protocol (tests/support/vizard_peer.py); Basilisk itself takes part in tests/vizard.
A body's place in the image tells simulation and step. One JSON line: the adapter's own processor time a frame, its
wall time around the renderer's (one simulation, from the request's coming to the picture's going), and the frames
that were lost or were another's. Run: python benchmarks/bench_vizard.py [--frames 1000]
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
import vizard_peer as peer

SIDE_PX, RADIUS_M, N_ALONE, N_SIMULATIONS = 1024, 60.0, 60, 3


def place_px(number: int, k: int) -> np.ndarray:
    """The body's place in the image of a simulation's step, off the boresight: no two are within a pixel."""
    index = N_SIMULATIONS * k + number
    return np.array([-380.0 + 23.0 * (index % 34), -380.0 + 23.0 * (index // 34 % 34)])


def fly(endpoint: str, number: int, n_frames: int, wrong: list, seconds: list) -> None:
    """One simulation: an update and an image at each step."""
    with peer.Peer(endpoint) as one:
        for k in range(n_frames):
            xy = place_px(number, k)
            if one.update(peer.scene(xy, t_ns=k * 10**9 + number, side_px=SIDE_PX, radius_m=RADIUS_M)) != [b"OK"]:
                wrong.append((number, k, "update"))
            began = time.perf_counter()
            image = one.image()
            seconds.append(time.perf_counter() - began)
            # Spheres that are off the boresight are seen a little farther off: their near side counts more.
            if image is None or np.abs(peer.centroid_px(image) / [1.0, 1.0] - 512.0 - xy * 1.012).max() > 8.0:
                wrong.append((number, k, None if image is None else peer.centroid_px(image).tolist()))


def processor_s(pid: int) -> float:
    """Processor time of a process, its children's left out."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=1000, help="of all simulations together (1000)")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, peer.adapter(
            Path(folder), "-v", "--log-format", "json") as (endpoint, process):
        wrong, seconds = [], []
        fly(endpoint, 0, 3, wrong, [])  # the scene is opened
        skipped = len(timed(folder))
        before = processor_s(process.pid)
        fly(endpoint, 1, N_ALONE, wrong, seconds)
        alone_s = processor_s(process.pid) - before
        lines = timed(folder)[skipped:]
        added_ms = np.array([line["ms"] - line["draw_ms"] for line in lines])
        before, began = processor_s(process.pid), time.perf_counter()
        each = -(-arguments.frames // N_SIMULATIONS)
        threads = [threading.Thread(target=fly, args=(endpoint, number, each, wrong, []))
                   for number in range(N_SIMULATIONS)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        together_s, wall_s = processor_s(process.pid) - before, time.perf_counter() - began
    n_frames = N_SIMULATIONS * each
    sys.stdout.write(json.dumps({
        "side_px": SIDE_PX, "simulations": N_SIMULATIONS, "frames": n_frames, "wrong": wrong[:5], "n_wrong": len(wrong),
        "adapter_processor_ms": 1e3 * together_s / n_frames, "adapter_processor_alone_ms": 1e3 * alone_s / N_ALONE,
        # On a machine with other work the tenth percentile is nearest to a quiet one's median.
        **{f"added_wall_p{p}_ms": float(np.percentile(added_ms, p)) for p in (10, 50, 95)},
        "draw_p50_ms": float(np.median([line["draw_ms"] for line in lines])),
        "round_trip_p50_ms": 1e3 * float(np.median(seconds)), "frames_per_s": n_frames / wall_s,
        "load": os.getloadavg()[0]}) + "\n")


def timed(folder: str) -> list[dict]:
    """The log's lines of frames."""
    lines = map(json.loads, (Path(folder) / "vizard.log").read_text().splitlines())
    return [line for line in lines if line["message"] == "image"]


if __name__ == "__main__":
    main()
