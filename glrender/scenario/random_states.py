"""Random states of a scene: stratified samples of range, light, attitude and pointing, without empty views."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy  # whose parts are imported where they are first used: this one takes a third of a second
from glrender_camera import PinholeCamera
from glrender_camera.validate import integer, one_of
from scipy.spatial.transform import Rotation

from ..base.constants import AU_M
from ..base.errors import ConfigError, SceneError
from ..base.rotations import sun_from_body
from ..scene.scene import Scene
from ..view.state import State
from ..view.view import BodyView, view_bodies
from .attitude import Geometry, Pointing
from .checks import unit
from .distributions import Distribution, distribution
from .samplers import MAX_FRAMES
from .scenario import SPACECRAFT, SUN, Scenario

SAMPLERS = ("latin_hypercube", "sobol", "independent")
NUMBERS: Mapping[str, tuple[float, float, Any]] = {
    "range_m": (1e-3, 1e16, None), "phase_angle_deg": (0.0, 180.0, [0.0, 120.0]), "off_pointing_deg": (0.0, 180.0, 0.0),
    "roll_deg": (-360.0, 360.0, [0.0, 360.0]), "sun_distance_au": (0.01, 1000.0, 1.0), "time_s": (-1e11, 1e11, 0.0)}
"""Numbers that are drawn: their bounds, and the default distribution."""
# One column of the samples for each number, and for: azimuth of the view about the Sun's line, of the off-pointing;
# the body's attitude (3), the Sun's direction (2). A range that changes changes no other column.
_COLUMNS = (*NUMBERS, "azimuth", "off_azimuth", "turn_1", "turn_2", "turn_3", "sun_z", "sun_azimuth")
# It is given up where fewer than one in 20 views show anything, once 1000 were looked at.
_MOST_TRIES, _FIRST_TRIES = 20, 50
# Lit area that counts as none [px], and facets of a large shape from which it is estimated.
_LEAST_LIT_PX, _FACETS_LOOKED_AT = 1.0, 20_000


@dataclass(frozen=True, kw_only=True, eq=False)
class RandomStates:
    """States of a scene that are drawn by chance; the same seed gives the same.

    Parameters
    ----------
    setting : Scenario
        The scene, and where bodies and the Sun are at a time; its spacecraft stands at `body`.
    camera : PinholeCamera
        A camera of the scene: bodies in its field count.
    body : str
        Body that the camera looks at; range and phase angle are those of its origin.
    range_m, phase_angle_deg, off_pointing_deg, roll_deg, sun_distance_au, time_s : Distribution
        Off-pointing is the angle between boresight and body, in any direction; the roll is as of `Pointing`; the time
        is that of bodies which move.
    attitude : "uniform" or "own"
        The body's: any rotation, uniform on SO(3), or that of the setting at the time.
    sun_direction : "uniform", "own" or (3,) float
        From the body, ICRF axes: any, that of the setting at the time, or this one. "own" has its own distance.
    up : str or (3,) float
        As of `Pointing`: the direction that is up in the image at roll 0.
    in_field : "part" or "whole"
        How much of the body must be in the field.
    sampler : "latin_hypercube", "sobol" or "independent"
        More frames of "sobol" leave the first ones as they are.
    frames : int, 1..1e7
    seed : int

    Raises
    ------
    ConfigError
    """

    setting: Scenario
    camera: PinholeCamera
    body: str
    range_m: Distribution
    phase_angle_deg: Distribution = field(default=distribution(NUMBERS["phase_angle_deg"][2], 0.0, 180.0))
    off_pointing_deg: Distribution = field(default=distribution(0.0, 0.0, 180.0))
    roll_deg: Distribution = field(default=distribution(NUMBERS["roll_deg"][2], -360.0, 360.0))
    sun_distance_au: Distribution = field(default=distribution(1.0, 0.01, 1000.0))
    time_s: Distribution = field(default=distribution(0.0, -1e11, 1e11))
    attitude: str = "uniform"
    sun_direction: str | np.ndarray = "uniform"
    up: str | np.ndarray = "north"
    in_field: str = "part"
    sampler: str = "latin_hypercube"
    frames: int = 1000
    seed: int = 0

    def __post_init__(self):
        one_of("body", self.body, self.scene.hulls)
        one_of("attitude", self.attitude, ("uniform", "own"))
        one_of("in_field", self.in_field, ("part", "whole"))
        one_of("sampler", self.sampler, SAMPLERS)
        integer("frames", self.frames, 1, MAX_FRAMES)
        integer("seed", self.seed, 0, 2**63)
        if isinstance(self.sun_direction, str):
            one_of("sun_direction", self.sun_direction, ("uniform", "own"))
        else:
            object.__setattr__(self, "sun_direction", unit("sun_direction", self.sun_direction))
        self._pointing  # noqa: B018 (its check of `up`)
        inner, least = self.scene.hulls[self.body].inner_radius_m, self.range_m.span[0]
        if not least > inner:
            raise ConfigError("range_m", f"must be above {inner:.6g} m: {self.body!r} is larger", least,
                              f"it reaches {self.scene.hulls[self.body].radius_m:.6g} m from its origin")

    @property
    def scene(self) -> Scene:
        """The setting's scene."""
        return self.setting.scene

    @property
    def output(self) -> Mapping[str, Any]:
        """The setting's table [output]."""
        return self.setting.output

    @property
    def keypoints(self) -> Mapping[str, Mapping[str, np.ndarray]]:
        """The setting's keypoints."""
        return self.setting.keypoints

    def states(self) -> list[State]:
        """The states, each with something to see.

        Raises
        ------
        SceneError
            Where hardly any view shows anything: with the commonest reasons.
        """
        return self._drawn[0]

    def iter_states(self) -> Iterator[State]:
        """The states, one after the other."""
        return iter(self.states())

    @property
    def rejected(self) -> Mapping[str, int]:
        """Numbers of the views that were drawn and rejected, by their reason."""
        return self._drawn[1]

    def told(self) -> dict[str, Any]:
        """The distributions, as plain data."""
        sun = self.sun_direction if isinstance(self.sun_direction, str) else self.sun_direction.tolist()
        used = [name for name in NUMBERS if name != "sun_distance_au" or sun != "own"]
        up = self.up if isinstance(self.up, str) else np.asarray(self.up).tolist()
        return {"body": self.body, "camera": self.camera.name, "sampler": self.sampler, "frames": self.frames,
                "seed": self.seed, **{name: str(getattr(self, name)) for name in used}, "attitude": self.attitude,
                "sun_direction": sun, "up": up, "in_field": self.in_field}

    def check(self) -> list[str]:
        """Warnings, in sentences: views rejected, a body that is small at its farthest."""
        warnings, n = [*self.setting.notes, *map(str, self.setting.doubts)], len(self.states())
        if self.rejected:
            all_of = n + sum(self.rejected.values())
            reasons = ", ".join(f"{reason} {count / all_of:.1%}" for reason, count in self.rejected.items())
            warnings.append(f"[random]: {1.0 - n / all_of:.1%} of {all_of} views were rejected: {reasons}")
        size_px = 2.0 * self.scene.hulls[self.body].radius_m * self.camera.focal_length_px / self.range_m.span[1]
        if size_px < 1.0:
            warnings.append(f"[random] range_m: {self.body!r} is {size_px:.2g} px at {self.range_m.span[1]:g} m")
        return warnings

    @cached_property
    def _pointing(self) -> Pointing:
        return Pointing(target=self.body, up=self.up)

    @cached_property
    def _drawn(self) -> tuple[list[State], Counter]:
        states: list[State] = []
        rejected: Counter = Counter()
        for state in self._candidates():
            reason = self._refusal(state)
            if reason is None:
                states.append(state)
                if len(states) == self.frames:
                    break
            else:
                rejected[reason] += 1
                if rejected.total() > _MOST_TRIES * (len(states) + _FIRST_TRIES):
                    self._give_up(len(states), rejected)
        return states, rejected

    def _candidates(self) -> Iterator[State]:
        """States without end, in blocks of stratified samples."""
        d, block = len(_COLUMNS), 0
        sobol = scipy.stats.qmc.Sobol(d, seed=np.random.default_rng(self.seed))
        while True:
            rng = np.random.default_rng([self.seed, block])
            if self.sampler == "sobol":
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", UserWarning)  # of balance: it is of powers of 2
                    share = sobol.random(1 << max(self.frames - 1, 1).bit_length())
            elif self.sampler == "latin_hypercube":
                share = scipy.stats.qmc.LatinHypercube(d, seed=rng).random(self.frames)
            else:
                share = rng.random((self.frames, d))
            yield from self._states_of(dict(zip(_COLUMNS, share.T, strict=True)))
            block += 1

    def _states_of(self, share: Mapping[str, np.ndarray]) -> Iterator[State]:
        """States of samples (N,) in 0..1 of each column."""
        drawn = {name: getattr(self, name).of(share[name]) for name in NUMBERS}
        order = np.argsort(drawn["time_s"], kind="stable")  # integrated motions go on with the time
        moments = dict(zip(order.tolist(), self.setting.states(drawn["time_s"][order]), strict=True))
        base = [moments[k] for k in range(len(order))]
        r_body = np.array([state.bodies[self.body].r_inertial_m for state in base])
        r_sun = np.array([state.r_sun_inertial_m for state in base])
        to_sun = (r_sun - r_body) / np.linalg.norm(r_sun - r_body, axis=1, keepdims=True)
        if not isinstance(self.sun_direction, str) or self.sun_direction == "uniform":
            to_sun = (_on_sphere(share["sun_z"], share["sun_azimuth"]) if isinstance(self.sun_direction, str)
                      else np.tile(self.sun_direction, (len(base), 1)))
            r_sun = r_body + drawn["sun_distance_au"][:, None] * AU_M * to_sun
        phase, azimuth = np.radians(drawn["phase_angle_deg"]), 2.0 * np.pi * share["azimuth"]
        aside = np.stack([np.sin(phase) * np.cos(azimuth), np.sin(phase) * np.sin(azimuth), np.cos(phase)], axis=1)
        # Rows of the matrix are axes about the Sun's line.
        to_camera = np.array([way @ sun_from_body(sun) for way, sun in zip(aside, to_sun, strict=True)])
        r_camera = r_body + drawn["range_m"][:, None] * to_camera
        still = np.zeros_like(r_camera)
        geometry = Geometry(start=None, t_s=drawn["time_s"], v_m_s=dict.fromkeys((SUN, SPACECRAFT, self.body), still),
                            r_m={SUN: r_sun, SPACECRAFT: r_camera, self.body: r_body})
        camera = (_aside(np.radians(drawn["off_pointing_deg"]), 2.0 * np.pi * share["off_azimuth"])
                  * Rotation.from_euler("z", -drawn["roll_deg"][:, None], degrees=True)
                  * Rotation.from_quat(self._pointing.at(geometry, SPACECRAFT)[0], scalar_first=True))
        craft = Rotation.from_quat(self.camera.q_camera_from_spacecraft, scalar_first=True).inv() * camera
        # SciPy takes no array that is read-only.
        r_craft = r_camera - craft.inv().apply(np.array(self.camera.r_camera_spacecraft_m))
        q_craft = craft.as_quat(scalar_first=True)
        q_body = _rotations(share["turn_1"], share["turn_2"], share["turn_3"])
        for k, state in enumerate(base):
            bodies = state.bodies
            if self.attitude == "uniform":
                bodies = {**bodies, self.body: replace(bodies[self.body], q_from_inertial=q_body[k])}
            yield replace(state, r_sun_inertial_m=r_sun[k], bodies=bodies, spacecraft=replace(
                state.spacecraft, r_inertial_m=r_craft[k], q_from_inertial=q_craft[k]))

    def _refusal(self, state: State) -> str | None:
        """The reason for which a state does not show the body as asked for; None where it does."""
        try:
            views = view_bodies(state, self.camera, self.scene.hulls)
        except SceneError:
            return "inside a body"
        own = next(view for view in views if view.name == self.body)
        if not (own.is_whole if self.in_field == "whole" else own.is_visible):
            return "out of the field"
        lit_px = sum(self._lit_px(view) for view in views if view.is_visible)
        # A body of less than a pixel is a point of light, in the field or not.
        return "nothing lit" if lit_px < min(_LEAST_LIT_PX, 1e-2 * own.size_px**2) else None

    def _lit_px(self, view: BodyView) -> float:
        """Area in the image [px] that faces the Sun and the camera, without what hides it from either."""
        centroids, normals, areas = self._facets[view.name]
        to_camera = view.r_camera_body_m - centroids
        facing = np.flatnonzero((normals @ view.sun_direction_body > 0.0)
                                & (np.einsum("ij,ij->i", normals, to_camera) > 0.0))
        if not facing.size:
            return 0.0
        to_camera = to_camera[facing]
        distance = np.linalg.norm(to_camera, axis=1)
        middle = self.camera.project(-to_camera @ view.camera_from_body.T)
        # A facet may be in the field where its middle is not.
        margin = np.sqrt(areas[facing, None]) / distance[:, None] * self.camera.focal_length_px + 0.5
        is_in = ((middle > -margin) & (middle < margin + (self.camera.width_px - 1, self.camera.height_px - 1))).all(1)
        seen = areas[facing] * np.einsum("ij,ij->i", normals[facing], to_camera) / distance**3
        return float(seen[is_in].sum()) * self.camera.focal_length_px**2

    @cached_property
    def _facets(self) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Centroids, normals and areas of bodies' facets; of a large shape every few."""
        found = {}
        for body in self.scene.bodies:
            shape = body.drawn_shape
            step = -(-len(shape.facets) // _FACETS_LOOKED_AT)
            found[body.name] = (shape.vertices_m[shape.facets[::step]].mean(axis=1), shape.facet_normals[::step],
                                step * shape.facet_areas_m2[::step])
        return found

    def _give_up(self, n_states: int, rejected: Counter) -> None:
        reason, count = rejected.most_common(1)[0]
        camera = self.camera
        half_deg = np.degrees(np.arctan(0.5 * min(camera.width_px, camera.height_px) / camera.focal_length_px))
        size_deg = np.degrees(np.arcsin(min(self.scene.hulls[self.body].radius_m / self.range_m.span[0], 1.0)))
        field, hint = {
            "out of the field": ("off_pointing_deg", f"the field reaches {half_deg:.3g} deg off the boresight, the "
                                 f"body {size_deg:.3g} deg off its middle at {self.range_m.span[0]:g} m: lower "
                                 "off_pointing_deg" + (", or raise range_m" if self.in_field == "whole" else "")),
            "nothing lit": ("phase_angle_deg", "lower its upper end: nearly the night side is seen"),
            "inside a body": ("range_m", "raise its lower end")}[reason]
        total = n_states + rejected.total()
        raise SceneError(f"random.{field}", f"leaves {n_states} of {total} views with anything to see; "
                         f"{count} are rejected: {reason}", str(getattr(self, field)), hint)


def _on_sphere(share_z: np.ndarray, share_azimuth: np.ndarray) -> np.ndarray:
    """Unit vectors (N, 3), uniform on the sphere, of samples (N,) in 0..1."""
    z, azimuth = 2.0 * share_z - 1.0, 2.0 * np.pi * share_azimuth
    flat = np.sqrt(np.maximum(1.0 - z * z, 0.0))
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), z], axis=1)


def _rotations(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Quaternions (N, 4), uniform on SO(3), of samples (N,) in 0..1.

    Source: Shoemake (1992), Uniform random rotations, Graphics Gems III.
    """
    low, high = np.sqrt(1.0 - a), np.sqrt(a)
    return np.stack([low * np.sin(2.0 * np.pi * b), low * np.cos(2.0 * np.pi * b),
                     high * np.sin(2.0 * np.pi * c), high * np.cos(2.0 * np.pi * c)], axis=1)


def _aside(angle_rad: np.ndarray, azimuth_rad: np.ndarray) -> Rotation:
    """Rotations that put what was on the boresight an angle off it, in a direction of the image."""
    axis = np.stack([-np.sin(azimuth_rad), np.cos(azimuth_rad), np.zeros_like(azimuth_rad)], axis=1)
    return Rotation.from_rotvec(angle_rad[:, None] * axis)
