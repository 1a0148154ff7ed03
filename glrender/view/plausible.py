"""Finds improbable values in a state: rates of another unit, bodies within each other."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import combinations

import numpy as np

from ..base import rotations as frames
from ..base.plausible import FASTEST_CRAFT_RAD_S, Advice, doubt, improbable, kind_of_body, way_out
from ..scene.shape.convex_hull import Hull
from .state import State

FOLLOWING = 10.0
"""Ratio of a spacecraft's rate to the speed over the range of what it looks after, up to which it follows that: a roll
that keeps a direction up in the image may be some times faster than the line of sight."""
TOUCHING = 0.01
"""Share of the smaller of two bodies' radii by which they may be within each other: bodies that touch are apart."""


def state_doubts(state: State, hulls: Mapping[str, Hull]) -> list[Advice]:
    """Warnings of a state's rates and of bodies that overlap."""
    found = [] if _follows(state) else improbable("spacecraft", state.spacecraft, "state.spacecraft")
    for name, pose in state.bodies.items():
        if pose.angular_velocity_rad_s is not None and name in hulls:
            found += improbable(kind_of_body(hulls[name].radius_m), pose, f"state.bodies.{name}")
    return found + [overlap_doubt(f"state.bodies.{second}.r_inertial_m", first, second, distance_m)
                    for first, second, distance_m in overlaps(state, hulls)]


def overlaps(state: State, hulls: Mapping[str, Hull]) -> list[tuple[str, str, float]]:
    """Pairs of bodies that are within each other for certain, and the distance of their centres [m].

    Spheres within the surfaces decide: bodies that touch, a ring about a planet and panels about a bus are apart.
    """
    if len(hulls) < 2:
        return []
    places = {name: _centre_m(state, name, hull) for name, hull in hulls.items()}
    found = []
    for first, second in combinations(hulls, 2):
        distance_m = math.dist(places[first], places[second])
        if distance_m < hulls[first].radius_m + hulls[second].radius_m:
            radii_m = hulls[first].solid_radius_m, hulls[second].solid_radius_m
            if min(radii_m) > 0.0 and distance_m < sum(radii_m) - TOUCHING * min(radii_m):
                found.append((first, second, distance_m))
    return found


def overlap_doubt(path: str, first: str, second: str, distance_m: float, when: str = "") -> Advice:
    """The warning of two bodies that overlap, under the field that places the second."""
    return doubt(path, f"bodies {first!r} and {second!r} are likely apart, and overlap{when}: the distance of their "
                 "centres [m]", distance_m, "in km? positions are in metres", "overlap")


def sun_way_out(r_m: np.ndarray) -> str:
    """The way out of a position of the Sun (3,) [m] that cannot be."""
    return (f"{way_out('orbit about the Sun', 'r_m', r_m)}; it is a position in metres, from the same origin as the "
            "bodies', not a direction")


def _follows(state: State) -> bool:
    """Whether a spacecraft turns no faster than to look after a body that it passes."""
    craft = state.spacecraft
    if craft.angular_velocity_rad_s is None:
        return True
    rate_rad_s = math.hypot(*craft.angular_velocity_rad_s.tolist())
    if rate_rad_s <= FASTEST_CRAFT_RAD_S:
        return True
    still = np.zeros(3)
    v_craft = still if craft.v_inertial_m_s is None else craft.v_inertial_m_s
    return any(rate_rad_s * float(np.linalg.norm(pose.r_inertial_m - craft.r_inertial_m)) <= FOLLOWING * float(
        np.linalg.norm((still if pose.v_inertial_m_s is None else pose.v_inertial_m_s) - v_craft))
        for pose in state.bodies.values())


def _centre_m(state: State, name: str, hull: Hull) -> list[float]:
    pose = state.bodies[name]
    if not hull.centre_m.any():
        return pose.r_inertial_m.tolist()
    return (pose.r_inertial_m + frames.dcm(pose.q_from_inertial).T @ hull.centre_m).tolist()
