"""The variables of the unit, and a step: a frame from a running server, measured."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from glrender_client import Client, GlrenderClientError

from .measure import Measured, measured

BODIES_FILE = "glrender_bodies.json"
"""Names of the bodies that are inputs, beside the unit's code."""
PARAMETERS = {
    "endpoint": ("tcp://127.0.0.1:5555", "where glrender-server listens"),
    "camera": ("", "name of a camera of the server's scene; empty: its only one"),
    "target": ("", "name of the body that is measured; empty: the first one"),
    "target_radius_m": (0.0, "radius of the target, for its range [m]; 0: the farthest vertex of the server's shape"),
    "exposure_s": (0.0, "exposure [s]; 0: the camera's own"),
    "seed": (0, "seed of the noise, 0 to 2^32 - 1; steps of two seeds share none"),
    "deadline_s": (0.0, "time [s] after which nothing more of a frame is begun; 0: none"),
    "timeout_s": (5.0, "how long a frame may take [s]; it is asked for twice"),
}
OUTPUTS = {
    "brightness_x_px": "centre of brightness [px], x right, 0 in the middle of the first pixel",
    "brightness_y_px": "centre of brightness [px], y down",
    "limb_x_px": "centre of the sphere that fits the lit limb [px]",
    "limb_y_px": "centre of the sphere that fits the lit limb [px]",
    "limb_radius_px": "focal length times the tangent of the angular radius [px]",
    "limb_residual_px": "RMS distance of the limb's points from the fit [px]",
    "range_m": "distance to the centre, by the limb and the target's radius [m]",
    "saturated_share": "share of saturated pixels [1]",
    "max_dn": "brightest pixel [DN]",
    "predicted_error": "error that the renderer predicts, RMS over the mean of lit pixels [1]",
    "used_exposure_s": "exposure of the frame, also where the camera chose it [s]",
    "n_warnings": "number of the frame's warnings; the unit's log has each kind once [1]",
}
_POSITION, _QUATERNION = ("r_x_m", "r_y_m", "r_z_m"), ("q_w", "q_x", "q_y", "q_z")
_AU_M = 149597870700.0
# Seeds of the service that one of ours takes: frames of two seeds never have the same.
_FRAMES_A_SEED = 2**32
_MOST_SEEDS = 2**64 // _FRAMES_A_SEED


class Kinds(NamedTuple):
    """One version's classes of variables, and its words for them."""

    number: type
    whole: type
    text: type
    flag: type
    causality: Any
    variability: Any
    initial: Any


class UnitError(Exception):
    """The server's scene and the unit do not agree; the message says on what, and the way out."""


class CameraUnit:
    """Inputs, parameters and outputs of one camera, and its connection.

    Parameters
    ----------
    resources : path
        Folder of the unit, with `BODIES_FILE`.

    Attributes
    ----------
    parameters, outputs : dict of str to value
    inputs : dict of str to float
        ``sun.r_x_m``, ``spacecraft.q_w``, ``<body>.r_z_m``, ...; inertial, and from inertial to the frame's own.
    is_valid : bool
        Whether the last frame has a lit limb of a body near a sphere.
    is_late : bool
        Whether the last frame took longer than `deadline_s`.
    """

    def __init__(self, resources: str | Path):
        self._bodies: list[str] = json.loads((Path(resources) / BODIES_FILE).read_text(encoding="utf-8"))
        self.parameters: dict[str, Any] = {name: start for name, (start, _) in PARAMETERS.items()}
        self.inputs = {f"sun.{name}": 0.0 for name in _POSITION}
        self.inputs["sun.r_x_m"] = _AU_M
        for frame in ("spacecraft", *map(_name, self._bodies)):
            self.inputs |= {f"{frame}.{name}": float(name == "q_w") for name in (*_POSITION, *_QUATERNION)}
        self.outputs = dict.fromkeys(OUTPUTS, math.nan)  # before the first frame
        self.is_valid = self.is_late = False
        self._told: set[str] = set()
        self._client: Client | None = None
        self._camera: dict[str, Any] = {}
        self._radius_m, self._n_frames = 0.0, 0

    def declare(self, slave: Any, kinds: Kinds) -> None:
        """Register all variables with an instance of pythonfmu's or pythonfmu3's."""
        causality, variability, initial = kinds.causality, kinds.variability, kinds.initial
        of_type = {float: kinds.number, int: kinds.whole, str: kinds.text}

        def settable(kind: type, name: str, table: dict[str, Any], **more: Any) -> None:
            slave.register_variable(kind(name, getter=lambda: table[name],
                                         setter=lambda value: table.__setitem__(name, value), **more))

        for name, (start, text) in PARAMETERS.items():
            settable(of_type[type(start)], name, self.parameters, description=text, causality=causality.parameter,
                     variability=variability.fixed, initial=initial.exact)
        for name in self.inputs:
            settable(kinds.number, name, self.inputs, causality=causality.input, variability=variability.continuous)
        output = {"causality": causality.output, "variability": variability.discrete, "initial": initial.calculated}
        for name, text in OUTPUTS.items():
            slave.register_variable(kinds.number(name, description=text, getter=lambda name=name: self.outputs[name],
                                                 **output))
        slave.register_variable(kinds.flag("is_valid", getter=lambda: self.is_valid, **output, description=(
            "whether the last frame has a lit limb of a body near a sphere")))
        slave.register_variable(kinds.flag("is_late", getter=lambda: self.is_late, **output, description=(
            "whether the last frame took longer than deadline_s")))

    def step(self, t_s: float) -> list[str]:
        """Take a frame of the inputs, which hold at a time, and put its measurements into the outputs.

        Returns the warnings of kinds that no earlier frame had, for the log.

        Raises
        ------
        GlrenderClientError, UnitError
            The outputs are not valid then.
        """
        self.is_valid = self.is_late = False
        if self._client is None:
            self._connect()
        exposure_s, deadline_s = self.parameters["exposure_s"], self.parameters["deadline_s"]
        reply = self._client.render(self._state(t_s), self._camera["name"], output="dn",
                                    exposure_s=None if exposure_s == 0.0 else exposure_s,
                                    deadline_s=None if deadline_s == 0.0 else deadline_s,
                                    seed=self.parameters["seed"] * _FRAMES_A_SEED + self._n_frames)
        self._n_frames += 1
        dn = np.asarray(reply.pixels, float)
        found = measured(dn, self._camera, self._sun_direction_camera(), self._radius_m)
        self._put(found, saturated_share=reply.header["n_saturated_px"] / dn.size, max_dn=float(dn.max()),
                  predicted_error=float(reply.header["plan"]["predicted_error"]),
                  used_exposure_s=float(reply.header["exposure_s"]), n_warnings=float(len(reply.warnings)))
        self.is_late = bool(reply.header.get("is_late", False))
        new = {warning.code: f"{warning.code}: {warning.message}" for warning in reversed(reply.warnings)
               if warning.code not in self._told}
        self._told |= new.keys()
        return list(new.values())

    def close(self) -> None:
        """Close the connection."""
        if self._client is not None:
            self._client.close()
        self._client = None

    @property
    def _target(self) -> str:
        return self.parameters["target"] or self._bodies[0]

    def _connect(self) -> None:
        timeout_s = self.parameters["timeout_s"]
        if not 0.0 < timeout_s < math.inf:
            raise UnitError(f"timeout_s: must be > 0, got {timeout_s!r}")
        seed = self.parameters["seed"]
        if not 0 <= seed < _MOST_SEEDS:
            raise UnitError(f"seed: must be from 0 to {_MOST_SEEDS - 1}, got {seed!r}")
        client = Client(self.parameters["endpoint"], timeout_s=timeout_s, retries=1, shared_memory=False)
        try:
            self._check(client.hello())
        except BaseException:
            client.close()
            raise
        self._client = client

    def _check(self, hello: dict[str, Any]) -> None:
        cameras = {each["name"]: each for each in hello["cameras"]}
        name = self.parameters["camera"] or (next(iter(cameras)) if len(cameras) == 1 else "")
        if name not in cameras:
            raise UnitError(f"camera: must be one of the server's, {', '.join(cameras)}, got {name!r}")
        camera = cameras[name]
        for key, says in (("distortion", "have no distortion: its limbs are not those of a pinhole"),
                          ("mosaic", "have no colour mosaic")):
            if camera[key] is not None:
                raise UnitError(f"camera: must {says}; name another of the server's, got {name!r}")
        if not camera["has_model"]:
            raise UnitError(f"camera: must have a detector; give {name!r} a `model` in the server's scene")
        bodies = {each["name"]: each for each in hello["bodies"]}
        if set(bodies) != set(self._bodies):
            raise UnitError(f"the unit was built for the bodies {', '.join(self._bodies)}, and the server has "
                            f"{', '.join(bodies)}; build it anew for these")
        if self._target not in bodies:
            raise UnitError(f"target: must be one of {', '.join(bodies)}, got {self._target!r}")
        self._camera = camera
        self._radius_m = self.parameters["target_radius_m"] or float(bodies[self._target]["radius_m"])

    def _numbers(self, frame: str, names: tuple[str, ...]) -> list[float]:
        return [self.inputs[f"{frame}.{name}"] for name in names]

    def _state(self, t_s: float) -> dict[str, Any]:
        def pose(frame: str) -> dict[str, Any]:
            return {"r_inertial_m": self._numbers(frame, _POSITION),
                    "q_from_inertial": self._numbers(frame, _QUATERNION)}

        return {"t_s": t_s, "r_sun_inertial_m": self._numbers("sun", _POSITION), "spacecraft": pose("spacecraft"),
                "bodies": {name: pose(_name(name)) for name in self._bodies}}

    def _sun_direction_camera(self) -> np.ndarray:
        towards = np.subtract(self._numbers("sun", _POSITION), self._numbers(_name(self._target), _POSITION))
        for q in (self._numbers("spacecraft", _QUATERNION), self._camera["q_camera_from_spacecraft"]):
            axis = np.array(q[1:])
            towards = towards + 2.0 * np.cross(axis, q[0] * towards + np.cross(axis, towards))
        return towards

    def _put(self, found: Measured, **more: float) -> None:
        self.outputs = {"brightness_x_px": found.brightness_px[0], "brightness_y_px": found.brightness_px[1],
                        "limb_x_px": found.limb_px[0], "limb_y_px": found.limb_px[1],
                        "limb_radius_px": found.limb_radius_px, "limb_residual_px": found.limb_residual_px,
                        "range_m": found.range_m, **more}
        self.is_valid = found.is_valid


def _name(body: str) -> str:
    """A body's name as FMI's structured names take it: in quotes, unless it is an identifier."""
    return body if body.isidentifier() and body.isascii() else "'" + body.replace("\\", "").replace("'", "") + "'"


ERRORS = (GlrenderClientError, UnitError)
"""Errors of a step, which its unit answers with FMI's status of an error."""
