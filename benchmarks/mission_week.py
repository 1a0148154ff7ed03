"""A mission's week around a binary asteroid: `python benchmarks/mission_week.py [--frames N] [--out FOLDER]`.

One image a minute, 10,080 of them: 1024 x 1024 px of 8-bit digital numbers, Hapke's law, shadows and eclipses, through
a server with a worker for each core; a limb fit and a Kalman filter take each frame in turn, beside the next ones being
drawn. The scenario is `mission_week/`. Prints wall time and processor time of each part as JSON, and writes
mission_week.json and mission_week.png. SISPO's paper gives about 12 hours for such a week, and 0.7
to 1.0 s for an image.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from glrender.scenario import Scenario, load_scenario
from glrender_client import Client
from glrender_navigation import ESTIMATORS, BelievedBody, Camera, Navigator, sight
from tqdm import tqdm

_FOLDER = Path(__file__).parent / "mission_week"
_PRIMARY, _CAMERA = "didymos", "afc"
_IN_FLIGHT = 4
_PAPERS_WEEK_S = 12.0 * 3600.0
"""Wall time of a week in SISPO's OpenGL loop, most of it of its navigation."""
_WEEK_FRAMES = 10_080
# Known at the start to so much of the range.
_HANDOVER = 0.02


@contextmanager
def served(scene_file: Path) -> Iterator[tuple[str, int]]:
    """A server with a worker for each core: its endpoint and process number."""
    with tempfile.TemporaryDirectory() as folder:
        endpoint = f"ipc://{folder}/glrender"
        command = [sys.executable, "-m", "glrender_server", str(scene_file), "--zmq", endpoint,
                   "--workers", str(os.cpu_count())]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        try:
            with Client(endpoint, timeout_s=180.0) as client:
                client.hello()
            yield endpoint, process.pid
        finally:
            process.terminate()
            process.wait()


def processor_s(pid: int) -> dict[str, float]:
    """Processor time [s] so far: of a server's own process, and of its workers (Linux)."""
    def used(number: int) -> float:
        fields = Path(f"/proc/{number}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    children = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()
    return {"server": used(pid), "workers": sum(used(int(child)) for child in children)}


class Flight:
    """The on-board side: a limb fit and a filter of the spacecraft's place about the primary.

    Attitudes, the Sun, the bodies and the commanded accelerations are known on board.

    Parameters
    ----------
    camera : Camera
    body : BelievedBody
    r_m, v_m_s : (3,) float
        First estimate.
    """

    def __init__(self, camera: Camera, body: BelievedBody, r_m: np.ndarray, v_m_s: np.ndarray):
        self._camera, self._estimator = camera, ESTIMATORS["limb_ellipse"](camera, body)
        self._navigator = Navigator(r_m, v_m_s, sigma_r_m=_HANDOVER * float(np.linalg.norm(r_m)), sigma_v_m_s=0.01,
                                    process_acceleration_m_s2=1e-7)
        self.reasons: Counter[str] = Counter()

    def take(self, frame: np.ndarray, state: dict[str, Any]) -> np.ndarray:
        """The estimated place (3,) [m] after a frame."""
        origin = np.asarray(state["bodies"][_PRIMARY]["r_inertial_m"])
        believed = {**state, "spacecraft": {**state["spacecraft"],
                                            "r_inertial_m": (origin + self._navigator.r_m).tolist()}}
        found = self._estimator.measure(frame, believed, None)
        if found is None:
            self.reasons[self._estimator.reason] += 1
        else:
            self._navigator.update(found, sight(believed, self._camera, _PRIMARY).camera_from_inertial)
        return self._navigator.r_m

    def fly(self, acceleration_m_s2: np.ndarray, step_s: float) -> None:
        """Go on with a commanded acceleration (3,) to the next frame."""
        self._navigator.predict(acceleration_m_s2, step_s)


def fly_week(scenario: Scenario, endpoint: str, pid: int, n_frames: int) -> dict[str, Any]:
    """Draw and measure the first frames of the week; wall and processor times, and errors of the estimate."""
    states = [state.to_dict() for state in scenario.iter_states(scenario.t_s[:n_frames])]
    # From the primary to the spacecraft, and the acceleration that holds it there.
    r_m = np.array([np.subtract(state["spacecraft"]["r_inertial_m"], state["bodies"][_PRIMARY]["r_inertial_m"])
                    for state in states])
    step_s = float(np.diff(scenario.t_s[:2])[0])
    v_m_s = np.gradient(r_m, step_s, axis=0)
    command = 2.0 * (np.diff(r_m, axis=0) - step_s * v_m_s[:-1]) / step_s**2
    shape = next(body.shape for body in scenario.scene.bodies if body.name == _PRIMARY)
    error_m, on_board_s, drawn_ms = np.empty(n_frames), 0.0, []
    with Client(endpoint, timeout_s=60.0, shared_memory=True) as client:
        table = next(each for each in client.hello()["cameras"] if each["name"] == _CAMERA)
        rng = np.random.default_rng(1)
        flight = Flight(Camera.from_hello(table), BelievedBody.from_mesh(_PRIMARY, shape.vertices_m, shape.facets),
                        r_m[0] + _HANDOVER * np.linalg.norm(r_m[0]) * rng.standard_normal(3) / np.sqrt(3.0), v_m_s[0])
        client.render(states[0], camera=_CAMERA, output="dn", seed=0)
        begin, used, own_s = time.perf_counter(), processor_s(pid), time.process_time()
        replies = client.render_many(({"state": state, "camera": _CAMERA, "output": "dn", "seed": k}
                                      for k, state in enumerate(states)), in_flight=_IN_FLIGHT)
        for k, reply in enumerate(tqdm(replies, total=n_frames, unit="frame", desc="mission week")):
            at = time.process_time()
            error_m[k] = np.linalg.norm(flight.take(reply.pixels, states[k]) - r_m[k])
            if k < len(command):
                flight.fly(command[k], step_s)
            on_board_s += time.process_time() - at
            drawn_ms.append(reply.header["timings_ms"]["total"])
            del reply
        wall_s, own_s = time.perf_counter() - begin, time.process_time() - own_s
        used = {name: after - used[name] for name, after in processor_s(pid).items()}
    range_m = np.linalg.norm(r_m, axis=1)
    later = slice(n_frames // 10, None)
    return {"frames": n_frames, "wall_s": wall_s, "frames_per_s": n_frames / wall_s, "cores": os.cpu_count(),
            "load": os.getloadavg()[0],
            "processor_ms_per_frame": {**{name: 1e3 * spent / n_frames for name, spent in used.items()},
                                       "on board": 1e3 * on_board_s / n_frames,
                                       "client": 1e3 * (own_s - on_board_s) / n_frames},
            "drawn_ms": {f"p{share}": float(np.percentile(drawn_ms, share)) for share in (50, 95, 99)},
            "without_measurement": dict(flight.reasons),
            "error_m": {"rms": float(np.sqrt(np.mean(error_m[later] ** 2))), "first": float(error_m[0])},
            "error_of_range": float(np.sqrt(np.mean((error_m / range_m)[later] ** 2))),
            "week_s": wall_s * _WEEK_FRAMES / n_frames,
            "faster_than_the_paper": _PAPERS_WEEK_S / (wall_s * _WEEK_FRAMES / n_frames),
            "error_m_each": error_m.round(2).tolist()}


def plot(told: dict[str, Any], file: Path) -> None:
    """Draw each part's share of the time, and the estimate's error over the week."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 4.6), layout="constrained")
    upper, lower = figure.subplots(2, height_ratios=(1, 2))
    left = 0.0
    for name, spent in told["processor_ms_per_frame"].items():
        upper.barh(0, spent, left=left, label=f"{name}: {spent:.1f} ms")
        left += spent
    upper.set(yticks=[], xlabel="processor time of a frame [ms]",
              title=f"{told['frames']} frames in {told['wall_s']:.0f} s on {told['cores']} cores: "
                    f"a week in {told['week_s'] / 60.0:.1f} min (SISPO: 12 h)")
    upper.legend(ncols=4, loc="lower center", fontsize="small", frameon=False)
    upper.margins(x=0.0)
    upper.set_ylim(-1.6, 0.6)
    days = np.arange(told["frames"]) / 1440.0
    lower.semilogy(days, np.maximum(told["error_m_each"], 0.01), linewidth=0.6)
    lower.set(xlabel="days", ylabel="navigation error [m]", xlim=(0.0, days[-1] or 1.0))
    lower.grid(alpha=0.3)
    figure.savefig(file, dpi=110)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=_WEEK_FRAMES, help="of the week's 10,080")
    parser.add_argument("--out", type=Path, default=Path("out/mission_week"))
    arguments = parser.parse_args()
    if not 2 <= arguments.frames <= _WEEK_FRAMES:
        parser.error(f"--frames: must be 2 to {_WEEK_FRAMES}, got {arguments.frames}")
    arguments.out.mkdir(parents=True, exist_ok=True)
    scenario = load_scenario(_FOLDER / "week.toml")
    with served(_FOLDER / "scene.toml") as (endpoint, pid):
        told = fly_week(scenario, endpoint, pid, arguments.frames)
    (arguments.out / "mission_week.json").write_text(json.dumps(told), encoding="utf-8")
    plot(told, arguments.out / "mission_week.png")
    told.pop("error_m_each")
    sys.stdout.write(json.dumps(told, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
