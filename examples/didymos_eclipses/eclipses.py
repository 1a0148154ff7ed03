"""Brightness of Dimorphos, and when geometry says that it is eclipsed or hidden: eclipses.py OUT.png [--frames N]

The prediction is of spheres with the shapes' volumes and a point Sun: the share of the satellite's disc that the
primary's outline leaves free, as the Sun sees it and as the spacecraft sees it.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from glrender import Renderer, State
from glrender.scenario import Scenario, load_scenario
from matplotlib.figure import Figure

PRIMARY, SATELLITE = "didymos", "dimorphos"
SCENARIO = Path(__file__).parent / "didymos.toml"


def free_share(eye_m: np.ndarray, primary_m: np.ndarray, satellite_m: np.ndarray, radius_m: float,
               satellite_radius_m: float) -> float:
    """The share 0..1 of a satellite's disc that is seen past its primary, from a far eye; places (3,) [m]."""
    line = eye_m - satellite_m
    range_m = np.linalg.norm(line)
    offset = primary_m - satellite_m
    along = offset @ line / range_m
    if along < 0.0:
        return 1.0
    # Projected from the eye on the satellite's plane.
    scale = range_m / (range_m - along)
    r, big = satellite_radius_m, radius_m * scale
    d = scale * float(np.linalg.norm(offset - along * line / range_m))
    if d >= r + big:
        return 1.0
    if d <= abs(big - r):
        return max(0.0, 1.0 - (big / r)**2)
    cut_r = np.arccos((d * d + r * r - big * big) / (2.0 * d * r))
    cut_big = np.arccos((d * d + big * big - r * r) / (2.0 * d * big))
    overlap = r * r * (cut_r - 0.5 * np.sin(2.0 * cut_r)) + big * big * (cut_big - 0.5 * np.sin(2.0 * cut_big))
    return float(1.0 - overlap / (np.pi * r * r))


def predicted(scenario: Scenario, t_s: np.ndarray) -> np.ndarray:
    """Shares (N, 2) of the satellite that the Sun and the spacecraft see, at times (N,) [s]."""
    volumes = {body.name: body.shape.report.volume_m3 for body in scenario.scene.bodies}
    radii_m = [(3.0 * volumes[name] / (4.0 * np.pi))**(1.0 / 3.0) for name in (PRIMARY, SATELLITE)]

    def of(state: State) -> list[float]:
        places = (state.bodies[PRIMARY].r_inertial_m, state.bodies[SATELLITE].r_inertial_m)
        return [free_share(eye, *places, *radii_m) for eye in (state.r_sun_inertial_m, state.spacecraft.r_inertial_m)]

    return np.array([of(state) for state in scenario.iter_states(t_s)])


def spans_h(t_s: np.ndarray, is_on: np.ndarray) -> list[tuple[float, float]]:
    """Begin and end [h] of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_on, [False]]).astype(int)))
    return [(t_s[begin] / 3600.0, t_s[end - 1] / 3600.0) for begin, end in zip(edges[::2], edges[1::2], strict=True)]


def drawn(scenario: Scenario, t_s: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
    """Irradiance (N,) [W/m2] of the satellite's pixels, and the frames."""
    index = [body.name for body in scenario.scene.bodies].index(SATELLITE)
    sums, frames = [], []
    with Renderer(scenario.scene) as renderer:
        for state in scenario.iter_states(t_s):
            image = renderer.render(state, products=["body_id"])
            is_satellite = image.products["body_id"] == index
            sums.append(float(image.irradiance_W_m2[is_satellite].sum(dtype=float)))
            frames.append(image.irradiance_W_m2)
    return np.array(sums), frames


def main(out: Path, scenario: Scenario, n_frames: int) -> None:
    begin, end = scenario.t_s[0], scenario.t_s[-1]
    fine = np.arange(begin, end + 5.0, 10.0)
    shares = predicted(scenario, fine)
    t_s = np.linspace(begin, end, n_frames)
    light, frames = drawn(scenario, t_s)
    events = {"eclipse": spans_h(fine, shares[:, 0] < 1.0), "behind Didymos": spans_h(fine, shares[:, 1] < 1.0)}
    for name, spans in events.items():
        for first, last in spans:
            sys.stdout.write(f"{name}: {first:.2f} h to {last:.2f} h\n")
    _figure(out, fine, shares, t_s, light, frames, events)
    sys.stdout.write(f"{out}\n")


def _figure(out, fine, shares, t_s, light, frames, events) -> None:
    figure = Figure(figsize=(11.0, 7.0), layout="constrained")
    grid = figure.add_gridspec(2, 5, height_ratios=(1.0, 1.3))
    (first, last), *_ = events["eclipse"]
    quarter = 0.25 * (last - first)
    white = np.quantile(frames[0], 0.999)
    for column, hour in enumerate((first - quarter, first + quarter, 0.5 * (first + last), last - quarter,
                                   last + quarter)):
        index = int(np.argmin(np.abs(t_s / 3600.0 - hour)))
        axis = figure.add_subplot(grid[0, column])
        axis.imshow((frames[index] / white).clip(0.0, 1.0)**(1.0 / 2.2), cmap="gray", vmin=0.0, vmax=1.0)
        axis.set(title=f"{t_s[index] / 3600.0:.2f} h", xticks=[], yticks=[])
    axis = figure.add_subplot(grid[1, :])
    scale = np.median(light[light > 0.5 * light.max()])
    axis.plot(fine / 3600.0, shares.prod(axis=1), color="0.6", label="predicted of spheres: free to Sun and camera")
    axis.plot(t_s / 3600.0, light / scale, ".", color="k", label="drawn: light of Dimorphos' pixels, over its median")
    for (name, spans), colour in zip(events.items(), ("tab:orange", "tab:blue"), strict=True):
        for index, span in enumerate(spans):
            axis.axvspan(*span, color=colour, alpha=0.2, label=None if index else f"{name}, predicted")
    axis.set(xlabel="time [h]", ylabel="brightness of Dimorphos", ylim=(-0.03, 1.35), xlim=(t_s[0] / 3600.0,
                                                                                        t_s[-1] / 3600.0))
    axis.grid(True, alpha=0.3)
    axis.legend(loc="upper center", ncols=2, fontsize=9)
    figure.savefig(out, dpi=80)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--scenario", type=Path, default=SCENARIO)
    parser.add_argument("--frames", type=int, default=145)
    arguments = parser.parse_args()
    main(arguments.out, load_scenario(arguments.scenario), arguments.frames)
