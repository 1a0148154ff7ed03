"""One flight: the true scene gives frames, the on-board side navigates by them, and the error is the difference."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from glrender import DeviceError, PinholeCamera, Pose, State, frames, take_frame
from glrender.scenario import Belief, SpacecraftBelief
from glrender_camera.pattern import seed_of
from glrender_navigation import Measurement, Navigator

from .believed_side import believed_distortion, body_of, camera_of, render_of, undistortion
from .campaign_file import Case, Setup
from .onboard import OF_FRAMES, OnBoard
from .pictures import Frame, strip_of

RESULT_KEYS = {"id", "values", "status", "reason", "frames", "accepted", "error_m", "error_over_range", "worst_frame",
               "track", "processor_s", "frame_ms", "on_board_ms"}
"""Fields of a flight's result."""
# Beyond this share of the range the body is lost.
_LOST = 0.1
# Reason given for a frame that was measured in vain.
_REFUSED = "the filter refused the measurement"
# Standard deviation of the first velocity, of the first position's over a step.
_HANDOVER_RATE = 2e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class Flight:
    """A flight's record: its result, plain data, and a picture (PNG) of its first, worst and last frame."""

    result: dict[str, Any]
    picture: bytes


def fly(setup: Setup, case: Case, truth: Any, believed: Any,
        told: Callable[[Frame], None] = lambda frame: None) -> Flight:
    """Fly one case.

    Parameters
    ----------
    setup : Setup
    case : Case
    truth, believed : renderers of `open_renderer`
        Of the true scene and of the case's believed one. The on-board side has the second alone.
    told : callable
        Called with each `Frame`.

    Raises
    ------
    ConfigError, SceneError, DeviceError
        A frame of the true scene that cannot be drawn. What fails on board is the flight's result.
    """
    began, values, belief = time.process_time(), case.values, case.belief
    true_camera, camera = setup.scene.camera(setup.camera), believed.scene.camera(setup.camera)
    r, v = (np.array(each) for each in zip(*(_relative(state, setup.body) for state in setup.states), strict=True))
    steps_s = np.diff([state.t_s for state in setup.states])
    rng = np.random.default_rng(values["seed"])
    estimator = OF_FRAMES[values["estimator"]](camera_of(camera), body_of(believed.scene, setup.body))
    onboard = OnBoard(estimator, _first_estimate(setup, belief.spacecraft, r[0], v[0], steps_s[0], rng),
                      render_of(believed, setup.camera, values["onboard_max_error"]))
    undistorted = undistortion(camera, believed_distortion(true_camera, belief))
    track, reason, accepted, ms = [], "", [], {"frame": [], "on_board": []}
    for index, state in enumerate(setup.states):
        if setup.pointing == "estimate":
            state = _pointed(state, true_camera, onboard.r_m, setup.body)
        lap = time.perf_counter()
        pixels = take_frame(truth, state, setup.camera, seed=seed_of(values["seed"], index),
                            max_error=values["max_error"], faults=values["faults"]).frame.dn
        ms["frame"].append(1e3 * (time.perf_counter() - lap))
        lap, found = time.perf_counter(), None
        try:
            found = _taken(onboard, undistorted(pixels), belief, state, setup.body)
        except DeviceError:
            raise
        except Exception as error:  # an estimator's mistake is the result of its flight
            reason = f"frame {index}: {type(error).__name__}: {error}"
        ms["on_board"].append(1e3 * (time.perf_counter() - lap))
        why = reason or onboard.reason or _REFUSED * (not onboard.is_accepted)
        frame = Frame(pixels=pixels, offset_DN=true_camera.model.detector.offset_DN, t_s=state.t_s,
                      range_m=float(np.linalg.norm(r[index])),
                      error_m=float(np.linalg.norm(onboard.r_m - r[index])),
                      true_px=_seen_px(state, true_camera, setup.body), reason=why,
                      found_px=None if found is None else found.center_px)
        track.append(frame)
        accepted.append(onboard.is_accepted)
        told(frame)
        if reason:
            break
        if index < len(steps_s):
            # The acceleration that leads from one true state to the next: known on board but for its error.
            acceleration = 2.0 * (r[index + 1] - r[index] - v[index] * steps_s[index]) / steps_s[index] ** 2
            onboard.fly(acceleration * (1.0 + setup.acceleration_error * rng.standard_normal(3)), steps_s[index])
    errors, reason = _errors(track), reason or _lost(track, accepted)
    shown = sorted({0, errors["worst_frame"], len(track) - 1})
    return Flight(picture=strip_of([track[index] for index in shown]), result={
        "id": case.id, "values": dict(values), "status": "lost" if reason else "kept", "reason": reason,
        "frames": len(track), "accepted": sum(accepted), **errors,
        "processor_s": round(time.process_time() - began, 3),
        **{f"{name}_ms": round(float(np.median(laps)), 2) for name, laps in ms.items()}})


def _first_estimate(setup: Setup, craft: SpacecraftBelief, r_m: np.ndarray, v_m_s: np.ndarray, step_s: float,
                    rng: np.random.Generator) -> Navigator:
    """The filter at the handover: off by chance, and by the spacecraft's believed ephemeris."""
    sigma_r_m = setup.handover * np.linalg.norm(r_m)
    sigma_v_m_s = _HANDOVER_RATE * sigma_r_m / step_s
    return Navigator(r_m + craft.r_offset_m + sigma_r_m * rng.standard_normal(3) / np.sqrt(3.0),
                     v_m_s + craft.v_offset_m_s + sigma_v_m_s * rng.standard_normal(3) / np.sqrt(3.0),
                     sigma_r_m=max(sigma_r_m, np.linalg.norm(craft.r_offset_m), 1e-3),
                     sigma_v_m_s=max(sigma_v_m_s, np.linalg.norm(craft.v_offset_m_s), 1e-9),
                     thruster_error=max(setup.acceleration_error, 1e-3))


def _lost(track: list[Frame], accepted: list[bool]) -> str:
    """Why a flight lost the body; empty where it did not."""
    last, settled, reasons = track[-1], _settled(track), []
    if last.error_m >= _LOST * last.range_m:
        percent = 100.0 * last.error_m / last.range_m
        reasons.append(f"the error at the end is {percent:.3g} % of the range, above {100.0 * _LOST:g} %")
    if not any(accepted[settled]):
        reasons.append(f"none of the last {len(track[settled])} frames gave a measurement that the filter accepted")
    if reasons and last.reason:
        reasons.append(f"the last frame: {last.reason}")
    return "; ".join(reasons)


def _taken(onboard: OnBoard, frame: np.ndarray, belief: Belief, state: State, body: str) -> Measurement | None:
    """Give the on-board side a frame, and the believed state that its own estimate makes of the ephemerides."""
    q = belief.spacecraft.attitude(state.spacecraft.q_from_inertial)
    here = belief.state(state, Pose(r_inertial_m=np.zeros(3), q_from_inertial=q))
    place = Pose(r_inertial_m=here.bodies[body].r_inertial_m + onboard.r_m, q_from_inertial=q)
    return onboard.take(frame, belief.state(state, place))


def _relative(state: State, body: str) -> tuple[np.ndarray, np.ndarray]:
    """Place (3,) [m] and velocity (3,) [m/s] of the spacecraft from a body."""
    craft, about = state.spacecraft, state.bodies[body]
    still = np.zeros(3)
    rates = [still if pose.v_inertial_m_s is None else pose.v_inertial_m_s for pose in (craft, about)]
    return craft.r_inertial_m - about.r_inertial_m, rates[0] - rates[1]


def _pointed(state: State, camera: PinholeCamera, r_m: np.ndarray, body: str) -> State:
    """The state, standing still, with the camera turned to where the estimate has the body."""
    mounting = frames.dcm(camera.q_camera_from_spacecraft)
    q = frames.quaternion(mounting.T @ frames.dcm(frames.look_at(r_m, np.zeros(3))))
    still = {name: Pose(r_inertial_m=pose.r_inertial_m, q_from_inertial=pose.q_from_inertial)
             for name, pose in state.bodies.items()}
    return replace(state, bodies=still, spacecraft=Pose(r_inertial_m=state.spacecraft.r_inertial_m, q_from_inertial=q))


def _seen_px(state: State, camera: PinholeCamera, body: str) -> tuple[float, float] | None:
    craft = state.spacecraft
    r = frames.dcm(craft.q_from_inertial) @ (state.bodies[body].r_inertial_m - craft.r_inertial_m)
    pixel = camera.project(frames.dcm(camera.q_camera_from_spacecraft) @ (r - camera.r_camera_spacecraft_m))
    return tuple(map(float, pixel)) if np.isfinite(pixel).all() else None


def _errors(track: list[Frame]) -> dict[str, Any]:
    error_m = np.array([frame.error_m for frame in track])
    share = error_m / [frame.range_m for frame in track]
    settled = _settled(track)
    return {"error_m": {"rms_settled": _number(np.sqrt(np.mean(error_m[settled] ** 2))), "last": _number(error_m[-1])},
            "error_over_range": {"rms_settled": _number(np.sqrt(np.mean(share[settled] ** 2))),
                                 "last": _number(share[-1])},
            "worst_frame": settled.start + int(np.argmax(share[settled])),
            "track": [_number(each) for each in share]}


def _settled(track: list[Frame]) -> slice:
    """The frames by which the loop has converged."""
    return slice(len(track) // 3, None)


def _number(value: float) -> float:
    """Six digits."""
    return float(f"{value:.6g}")
