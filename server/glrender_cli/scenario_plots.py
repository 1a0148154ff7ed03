"""Plots of a scenario: range, phase angle, Sun, field of view, and the paths about the body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path

import numpy as np
from glrender import PinholeCamera, Scene, State, frames
from matplotlib.figure import Figure
from matplotlib.patches import Circle

_M_PER_KM = 1e3
_TIMES = ((86400.0, "d"), (3600.0, "h"), (60.0, "min"), (1.0, "s"))
_SUN, _BODIES = "tab:orange", ("tab:blue", "tab:green", "tab:red", "tab:purple", "tab:brown")
_FEW = 60
"""Frames up to which each has a dot."""


@dataclass(frozen=True, kw_only=True)
class Track:
    """One body as a camera sees it along a sequence of N states.

    Parameters
    ----------
    range_m : (N,) float [m]
        From the camera to the body's origin.
    phase_deg : (N,) float [deg]
        At the body's origin.
    off_axis_m : (N,) float [m]
        Distance of the body's origin from the boresight.
    sub_camera_deg, subsolar_deg : (N, 2) float [deg]
        Longitude, -180..180, and latitude of the camera and of the Sun in the body's frame.
    """

    range_m: np.ndarray
    phase_deg: np.ndarray
    off_axis_m: np.ndarray
    sub_camera_deg: np.ndarray
    subsolar_deg: np.ndarray


def track_of(states: Sequence[State], camera: PinholeCamera, body: str) -> Track:
    """The track of a body, by float64 geometry: no light time, no aberration."""
    rows = []
    for state in states:
        pose = state.bodies[body]
        q_body = frames.dcm(pose.q_from_inertial)
        to_camera = _camera_r_m(state, camera) - pose.r_inertial_m
        to_sun = state.r_sun_inertial_m - pose.r_inertial_m
        aside = _camera_axes(state, camera) @ -to_camera
        rows.append([np.linalg.norm(to_camera), _angle_deg(to_camera, to_sun), np.hypot(aside[0], aside[1]),
                     *_longitude_latitude_deg(q_body @ to_camera), *_longitude_latitude_deg(q_body @ to_sun)])
    columns = np.array(rows)
    return Track(range_m=columns[:, 0], phase_deg=columns[:, 1], off_axis_m=columns[:, 2],
                 sub_camera_deg=columns[:, 3:5], subsolar_deg=columns[:, 5:7])


def sun_in_camera_deg(states: Sequence[State], camera: PinholeCamera) -> np.ndarray:
    """Angle of the Sun from the boresight, and its direction in the image from +x to +y (N, 2) [deg]."""
    found = []
    for state in states:
        x, y, z = _camera_axes(state, camera) @ (state.r_sun_inertial_m - _camera_r_m(state, camera))
        found.append([np.degrees(np.arctan2(np.hypot(x, y), z)), np.degrees(np.arctan2(y, x))])
    return np.array(found)


def scenario_plot(path: Path, title: str, scene: Scene, states: Sequence[State], camera: PinholeCamera) -> None:
    """Six panels show range, phase angle, the Sun, the field of view, the path in ICRF, and the path over the body.

    Parameters
    ----------
    path : path
        .png, .pdf or another format of matplotlib's.
    title : str
    scene : Scene
    states : sequence of State, at least one
    camera : PinholeCamera
    """
    t_s = np.array([state.t_s for state in states])
    per_unit, unit = _unit(np.ptp(t_s))
    time = t_s / per_unit
    tracks = {body.name: track_of(states, camera, body.name) for body in scene.bodies}
    style = {"marker": "." if len(states) <= _FEW else None, "markersize": 4}
    figure = Figure(figsize=(15.0, 8.6), layout="constrained")
    axes = figure.subplots(2, 3)
    figure.suptitle(title)
    (ranges, phases, sun), (field, icrf, ground) = axes
    colours = dict(zip(tracks, cycle(_BODIES), strict=False))
    farthest_m = max(track.range_m.max() for track in tracks.values())
    size, length = _length(farthest_m)
    for name, track in tracks.items():
        ranges.plot(time, track.range_m / size, color=colours[name], label=name, **style)
        phases.plot(time, track.phase_deg, color=colours[name], label=name, **style)
    ranges.set(title="Range to the body's origin", ylabel=f"range [{length}]", ylim=(0.0, 1.05 * farthest_m / size))
    phases.set(title="Phase angle", ylabel="phase [deg]")
    _sun_panel(sun, time, sun_in_camera_deg(states, camera), camera, style)
    _field_panel(field, time, tracks, scene, camera, colours, style)
    _icrf_panel(icrf, states, camera, scene, colours, style)
    _ground_panel(ground, tracks, colours, style)
    for axis in (ranges, phases, sun, field):
        axis.set_xlabel(f"time [{unit}]")
    for axis in axes.flat:
        axis.grid(True, alpha=0.3)
        if axis is not field:
            axis.legend(fontsize=8)
    figure.savefig(path, dpi=90)


def _sun_panel(axis, time, sun_deg, camera, style) -> None:
    half = np.degrees(np.arctan(0.5 * np.hypot(camera.width_px, camera.height_px) / camera.focal_length_px))
    axis.plot(time, sun_deg[:, 0], color=_SUN, label="from the boresight", **style)
    axis.plot(*_cut(time, sun_deg[:, 1]), color=_SUN, linestyle=":", label="in the image, from +x to +y", **style)
    axis.axhspan(0.0, half, color="0.85", label=f"field of {camera.name!r}, to the corner")
    axis.set(title="Direction to the Sun", ylabel="angle [deg]", ylim=(-185.0, 185.0), yticks=range(-180, 181, 60))


def _field_panel(axis, time, tracks, scene, camera, colours, style) -> None:
    half = 0.5 * min(camera.width_px, camera.height_px) / camera.focal_length_px
    size, unit = _length(half * max(track.range_m.max() for track in tracks.values()))
    for name, track in tracks.items():
        colour = colours[name]
        axis.plot(time, half * track.range_m / size, color=colour, label=f"half the field: {name}", **style)
        axis.axhline(scene.hulls[name].radius_m / size, color=colour, linestyle="--", label=f"radius: {name}")
        axis.plot(time, track.off_axis_m / size, color=colour, linestyle=":", label=f"off axis: {name}", **style)
    axis.set(title=f"Field of view of {camera.name!r}, {2 * np.degrees(np.arctan(half)):.3g} deg",
             ylabel=f"length at the body [{unit}]", ylim=(0.0, 1.4 * axis.dataLim.y1))
    axis.legend(loc="upper left", fontsize=7.5, ncols=min(len(tracks), 2))


def _icrf_panel(axis, states, camera, scene, colours, style) -> None:
    """The plane of two ICRF axes in which the paths are largest."""
    craft = np.array([_camera_r_m(state, camera) for state in states])
    bodies = {name: np.array([state.bodies[name].r_inertial_m for state in states]) for name in colours}
    foot = next(iter(bodies.values()))[0]
    extent = np.ptp(np.concatenate([craft, *bodies.values()]), axis=0)
    first, second = np.sort(np.argsort(extent)[1:])
    size, unit = _length(extent.max())
    axis.plot(craft[:, first] / size, craft[:, second] / size, color="k", label="spacecraft", **style)
    axis.plot(*craft[0, [first, second]] / size, "o", color="k", fillstyle="none", label="start")
    for name, r in bodies.items():
        axis.plot(r[:, first] / size, r[:, second] / size, color=colours[name])
        axis.add_patch(Circle(r[0, [first, second]] / size, scene.hulls[name].radius_m / size, color=colours[name],
                              alpha=0.5, label=f"{name}, at the start"))
    sun = states[0].r_sun_inertial_m - foot
    tip = foot + 0.4 * np.linalg.norm(craft - foot, axis=1).max() * sun / np.linalg.norm(sun)
    axis.annotate("", xy=tip[[first, second]] / size, xytext=foot[[first, second]] / size,
                  arrowprops={"arrowstyle": "->", "color": _SUN})
    axis.plot(*tip[[first, second]] / size, color=_SUN, label="to the Sun, at the start")
    names = "xyz"
    axis.set(title="Path in ICRF", xlabel=f"{names[first]} [{unit}]", ylabel=f"{names[second]} [{unit}]")
    axis.set_aspect("equal", adjustable="datalim")


def _ground_panel(axis, tracks, colours, style) -> None:
    for name, track in tracks.items():
        for points, colour, text in ((track.subsolar_deg, _SUN, "under the Sun"),
                                     (track.sub_camera_deg, colours[name], "under the spacecraft")):
            line = ":" if colour == _SUN and name != next(iter(tracks)) else "-"
            latitude, longitude = _cut(points[:, 1], points[:, 0])
            axis.plot(longitude, latitude, color=colour, linestyle=line, label=f"{name}: {text}", **style)
            axis.plot(*points[0], "o", color=colour, fillstyle="none")
    axis.set(title="Path in the body's frame (o: start)", xlabel="longitude [deg]", ylabel="latitude [deg]",
             xlim=(-180.0, 180.0), ylim=(-90.0, 90.0), xticks=range(-180, 181, 60), yticks=range(-90, 91, 30))


def _cut(along: np.ndarray, angle_deg: np.ndarray) -> np.ndarray:
    """Both (2, N + n) with a gap at the n places where the angle goes from 180 to -180 degrees."""
    gaps = np.nonzero(np.abs(np.diff(angle_deg)) > 180.0)[0] + 1
    return np.insert(np.stack([along, angle_deg]), gaps, np.nan, axis=1)


def _camera_axes(state: State, camera: PinholeCamera) -> np.ndarray:
    return frames.dcm(camera.q_camera_from_spacecraft) @ frames.dcm(state.spacecraft.q_from_inertial)


def _camera_r_m(state: State, camera: PinholeCamera) -> np.ndarray:
    craft = state.spacecraft
    return craft.r_inertial_m + frames.dcm(craft.q_from_inertial).T @ camera.r_camera_spacecraft_m


def _angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def _longitude_latitude_deg(r: np.ndarray) -> tuple[float, float]:
    return float(np.degrees(np.arctan2(r[1], r[0]))), float(np.degrees(np.arctan2(r[2], np.hypot(r[0], r[1]))))


def _unit(duration_s: float) -> tuple[float, str]:
    return next(((s, name) for s, name in _TIMES if duration_s >= 2.0 * s), _TIMES[-1])


def _length(largest_m: float) -> tuple[float, str]:
    return (_M_PER_KM, "km") if largest_m >= 2.0 * _M_PER_KM else (1.0, "m")
