"""From an epoch of Basilisk's to a request for a frame, and from the frame to the picture that Basilisk reads."""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import msgpack
import numpy as np
from glrender import ConfigError, PinholeCamera, Scene, SceneError, from_basilisk_mrp
from glrender.base.constants import AU_M, SUN_RADIUS_M, TOTAL_SOLAR_IRRADIANCE_W_M2
from glrender_camera.errors import error_path
from glrender_server.codec import VERSION
from scipy.spatial.transform import Rotation

from .bodies import BodyMap, is_primitive, modelled, sphere
from .limits import MAX_SCENE_BODIES, MAX_SCENE_CAMERAS, MAX_SCENE_PIXELS
from .messages import Camera, CelestialBody, CustomModel, Spacecraft, Update

_ALL_SPACECRAFT = "ALL_SPACECRAFT"
# From OpNav's camera axes (z the boresight, x right, y down) to Vizard's, by which Basilisk multiplies before it sends.
_CU_FROM_C = Rotation.from_quat(from_basilisk_mrp([1 / 3, 1 / 3, -1 / 3]), scalar_first=True)
# How far a matrix may be from a rotation.
_ORTHONORMAL = 1e-3
# The brightest pixel of an automatic picture.
_AUTO_DN = 204.0
# Solid angles of larger images are made for each frame: four bytes a pixel.
_MOST_KEPT_PX = 2**22
_ROWS_AT_ONCE = 256


@dataclass(frozen=True)
class BodyKey:
    """A drawn body: of the map, of a custom model's file, or a sphere."""

    name: str
    sent: CelestialBody | None = None
    model: CustomModel | None = None
    radius_m: float = 0.0


@dataclass(frozen=True, eq=False)
class SceneKey:
    """The unchanging part of a simulation: one object for equal scenes, which share a renderer."""

    bodies: tuple[BodyKey, ...]
    cameras: tuple[Camera, ...]


@dataclass(frozen=True)
class FrameOrder:
    """A frame to draw: its scene, the request that a renderer takes, and how its light becomes a picture."""

    scene: SceneKey
    fields: Mapping[str, Any]
    pinhole: PinholeCamera
    white_radf: float | str
    sun_irradiance_W_m2: float
    notes: tuple[str, ...]

    @property
    def message(self) -> bytes:
        """The request as the workers read it (`pictures`): equal ones make equal pictures."""
        return msgpack.packb({**self.fields, "picture": {"white_radf": self.white_radf,
                                                         "sun_irradiance_W_m2": self.sun_irradiance_W_m2}})


# Numbers beyond 1e154 have infinite squares: the renderer refuses their state, and no warning is needed.
@np.errstate(over="ignore", invalid="ignore")
def ordered(update: Update, models: Sequence[CustomModel], camera_id: int, body_map: BodyMap) -> FrameOrder:
    """The frame of a camera at an epoch.

    Parameters
    ----------
    update : Update
    models : sequence of CustomModel
        Of the last message that had settings.
    camera_id : int
    body_map : BodyMap

    Raises
    ------
    SceneError, ConfigError
        No such camera, no spacecraft that carries it, or a field that breaks a rule.
    """
    sent = next((each for each in update.cameras if each.id == camera_id), None)
    if sent is None:
        raise SceneError("camera", "is none of the last update's", camera_id,
                         f"it has {', '.join(str(each.id) for each in update.cameras) or 'none'}")
    pinhole = _pinhole(body_map, _still([sent])[0])
    carrier = _carrier(update, sent)
    notes: list[str] = []
    drawn = _drawn_bodies(update, models, carrier, body_map, notes)
    if not drawn:
        raise SceneError("bodies", "the last update has none to draw but the Sun")
    body_from = Rotation.from_quat(from_basilisk_mrp(carrier.sigma_BN), scalar_first=True)
    mounting = _mounting(sent.sigma_CuB)
    r_camera_m = np.array(carrier.r_inertial_m) + body_from.inv().apply(sent.r_camera_body_m)
    r_sun_m = _sun(update, [pose["r_inertial_m"] for _, pose in drawn], r_camera_m, body_map, notes)
    state = {"t_s": 1e-9 * update.t_ns, "r_sun_inertial_m": r_sun_m.tolist(),
             "spacecraft": {"r_inertial_m": r_camera_m.tolist(),
                            "q_from_inertial": (mounting * body_from).as_quat(scalar_first=True).tolist()},
             "bodies": {key.name: pose for key, pose in drawn}}
    fields = {"v": VERSION, "op": "render", "id": 0, "client": "vizard", "camera": pinhole.name, "state": state}
    if pinhole.model is not None:
        fields |= {"output": "dn", "seed": zlib.crc32(b"%d:%d" % (update.t_ns, camera_id))}
    distance_au = float(np.linalg.norm(r_sun_m - r_camera_m)) / AU_M
    if not distance_au > 0.0:
        # The Sun, 1 au away, is at its own place by float64: of a camera that is 1e27 m from the origin.
        raise SceneError(f"camera {camera_id}", "must not be at the Sun's place", r_camera_m.tolist(),
                         "numbers beyond 1e26 m leave no room for 1 au")
    if len(drawn) > MAX_SCENE_BODIES:
        raise SceneError("bodies", f"must be at most {MAX_SCENE_BODIES}, spacecraft too", len(drawn))
    key = _scene_key(tuple(key for key, _ in drawn), _still(update.cameras))
    return FrameOrder(scene=key, fields=fields, pinhole=pinhole, white_radf=body_map.white_radf_of(camera_id),
                      sun_irradiance_W_m2=TOTAL_SOLAR_IRRADIANCE_W_M2 / distance_au**2, notes=tuple(notes))


def make_scene(key: SceneKey, body_map: BodyMap) -> Scene:
    """The scene of a key; of its cameras those that can be drawn.

    Raises
    ------
    ConfigError, ShapeError
    """
    cameras = []
    for sent in key.cameras:
        try:
            cameras.append(body_map.camera(sent))
        except ConfigError:
            continue  # the request for its image gets the error
    n_pixels = sum(camera.width_px * camera.height_px for camera in cameras)
    if n_pixels > MAX_SCENE_PIXELS or len(cameras) > MAX_SCENE_CAMERAS:
        raise ConfigError("cameras", f"must be at most {MAX_SCENE_CAMERAS}, of {MAX_SCENE_PIXELS} pixels together",
                          n_pixels)
    if len(key.bodies) > MAX_SCENE_BODIES:
        raise ConfigError("bodies", f"must be at most {MAX_SCENE_BODIES}", len(key.bodies))
    return Scene(bodies=[_body(each, body_map) for each in key.bodies], cameras=cameras, max_error=body_map.max_error,
                 solar_irradiance_1au_W_m2=None)


def picture(pinhole: PinholeCamera, white_radf: float | str, sun_irradiance_W_m2: float, header: Mapping[str, Any],
            pixels: Any) -> np.ndarray:
    """The picture of a rendered frame: (height, width) uint8, or uint16 of a detector with more than eight bits.

    Digital numbers fill the upper bits, which Basilisk keeps. Light is linear in I/F: white is `white_radf`.

    Parameters
    ----------
    pinhole : PinholeCamera
    white_radf : float [1], or "auto"
    sun_irradiance_W_m2 : float [W/m2]
        At the camera.
    header : mapping
        Of the renderer's reply.
    pixels : buffer
    """
    array = header["arrays"][0]
    image = np.frombuffer(pixels, array["dtype"]).reshape(array["shape"])
    model = pinhole.model
    if model is not None:
        n_bits = model.detector.bit_depth
        return image << ((8 if n_bits <= 8 else 16) - n_bits)
    shown = np.zeros(image.shape, np.uint8)
    x0, y0, x1, y1 = header["plan"]["roi"]
    if not (x0 < x1 and y0 < y1):
        return shown
    # All else is dark.
    light = image[y0:y1, x0:x1]
    is_kept = pinhole.width_px * pinhole.height_px <= _MOST_KEPT_PX
    radf_per = (_kept_radf if is_kept else _radf_of_irradiance)(pinhole)[y0:y1, x0:x1]
    white, full = white_radf, 255.0
    if white == "auto":
        white, full = float(cv2.minMaxLoc(cv2.multiply(light, radf_per))[1]) / sun_irradiance_W_m2, _AUTO_DN
    if white > 0.0:
        scale = full / (white * sun_irradiance_W_m2)
        cv2.multiply(light, radf_per, dst=shown[y0:y1, x0:x1], scale=scale, dtype=cv2.CV_8U)
    return shown


def encoded(image: np.ndarray) -> memoryview:
    """The bytes of a picture as PGM, which Basilisk's OpenCV reads: 1 megapixel takes 0.1 ms, as a stored PNG 7."""
    head = b"P5\n%d %d\n%d\n" % (*image.shape[::-1], np.iinfo(image.dtype).max)
    whole = np.empty(len(head) + image.nbytes, np.uint8)
    whole[:len(head)] = np.frombuffer(head, np.uint8)
    np.frombuffer(whole.data[len(head):], image.dtype.newbyteorder(">")).reshape(image.shape)[...] = image
    return whole.data


def _radf_of_irradiance(pinhole: PinholeCamera) -> np.ndarray:
    """I/F of a pixel for each W/m2 in it, where the Sun gives 1 W/m2: pi over its solid angle, cos^3 / f^2."""
    focal_px, centre_px = pinhole.focal_length_px, pinhole.principal_point_px
    x = (np.arange(pinhole.width_px) - centre_px[0]) / focal_px
    y = (np.arange(pinhole.height_px) - centre_px[1]) / focal_px
    found = np.empty((pinhole.height_px, pinhole.width_px), np.float32)
    # Rows at a time: in float64 an image of 64 megapixels would take gigabytes.
    for top in range(0, pinhole.height_px, _ROWS_AT_ONCE):
        rows = y[top:top + _ROWS_AT_ONCE, None]
        found[top:top + _ROWS_AT_ONCE] = math.pi * focal_px**2 * (1.0 + x**2 + rows**2)**1.5
    return found


_kept_radf = lru_cache(maxsize=4)(_radf_of_irradiance)


@lru_cache(maxsize=64)
def _scene_key(bodies: tuple[BodyKey, ...], cameras: tuple[Camera, ...]) -> SceneKey:
    return SceneKey(bodies, cameras)


@lru_cache(maxsize=256)
def _pinhole(body_map: BodyMap, sent: Camera) -> PinholeCamera:
    return body_map.camera(sent)


@lru_cache(maxsize=256)
def _mounting(sigma_CuB: tuple[float, ...]) -> Rotation:
    """From the spacecraft's axes to a camera's."""
    return _CU_FROM_C.inv() * Rotation.from_quat(from_basilisk_mrp(sigma_CuB), scalar_first=True)


@lru_cache(maxsize=256)
def _quaternion(dcm: tuple[float, ...]) -> list[float]:
    matrix = np.array(dcm).reshape(3, 3)
    if not np.abs(matrix @ matrix.T - np.eye(3)).max() < _ORTHONORMAL or np.linalg.det(matrix) < 0.0:
        raise SceneError("rotation", "must be a rotation matrix", matrix.tolist())
    return Rotation.from_matrix(matrix).as_quat(scalar_first=True).tolist()


def _carrier(update: Update, sent: Camera) -> Spacecraft:
    """The spacecraft that carries a camera: its parent, the first where it names none."""
    named = [each for each in update.spacecraft if each.name == sent.parent or not sent.parent]
    if not named:
        raise SceneError(f"camera {sent.id}.parentName", "is no spacecraft of the last update", sent.parent)
    return named[0]


def _drawn_bodies(update: Update, models: Sequence[CustomModel], carrier: Spacecraft, body_map: BodyMap,
                  notes: list[str]) -> list[tuple[BodyKey, dict[str, Any]]]:
    """Keys and poses of all bodies but the Sun and the camera's own spacecraft."""
    drawn = []
    for each in update.bodies:
        if _is_sun(each.name):
            continue
        key = _body_key(each.name, each.radius_m, _model_of(each.name, models, False), each, body_map, notes)
        if key is not None:
            with error_path(f"body {each.name!r}"):
                q = _quaternion(each.dcm_body_from_inertial)
            drawn.append((key, {"r_inertial_m": list(each.r_inertial_m), "q_from_inertial": q}))
    for each in update.spacecraft:
        if each is carrier:
            continue
        key = _body_key(each.name, 0.0, _model_of(each.name, models, True), None, body_map, notes)
        if key is not None:
            q = from_basilisk_mrp(each.sigma_BN)
            drawn.append((key, {"r_inertial_m": list(each.r_inertial_m), "q_from_inertial": q.tolist()}))
    return drawn


def _body_key(name: str, radius_m: float, model: CustomModel | None, sent: CelestialBody | None, body_map: BodyMap,
              notes: list[str]) -> BodyKey | None:
    if name in body_map.bodies:
        return BodyKey(name)
    if model is not None and not is_primitive(model):
        if body_map.models is not None:
            return BodyKey(name, model=model, radius_m=radius_m)
        notes.append(f"{name!r} has the custom model {model.path!r}, and the map names no folder of models: it is "
                     f"{'drawn as a sphere' if radius_m > 0.0 else 'not drawn'}")
    if radius_m > 0.0:
        # Place and attitude are the state's.
        still = CelestialBody(name, (), (), sent.radius_m, sent.polar_ratio)
        return BodyKey(name, sent=still)
    notes.append(f"{name!r} has neither a radius nor an entry in the map: it is not drawn")
    return None


def _body(key: BodyKey, body_map: BodyMap) -> Any:
    if key.name in body_map.bodies:
        return body_map.bodies[key.name]
    if key.model is not None:
        return modelled(key.name, key.radius_m, key.model, body_map.model_file(key.model))
    return sphere(key.sent)


def _model_of(name: str, models: Sequence[CustomModel], is_spacecraft: bool) -> CustomModel | None:
    """The last custom model that Basilisk gives a body, as Vizard applies them."""
    return next((model for model in reversed(models) if name in model.bodies
                 or (is_spacecraft and model.bodies[:1] == (_ALL_SPACECRAFT,))), None)


def _is_sun(name: str) -> bool:
    """Whether a body is the Sun: Basilisk names it "sun", and its messages of older scripts "sun_planet_data"."""
    return name.lower() in ("sun", "sun_planet_data")


def _still(cameras: Sequence[Camera]) -> tuple[Camera, ...]:
    """Cameras without what the state has: places, attitudes, and whose they are."""
    return tuple(Camera(each.id, "", each.fov_deg, each.width_px, each.height_px, (), (), 0, each.mode)
                 for each in cameras)


def _sun(update: Update, places: Sequence[Sequence[float]], r_camera_m: np.ndarray, body_map: BodyMap,
         notes: list[str]) -> np.ndarray:
    """Where the Sun is; without one, or with one inside a body, 1 au away in the map's direction."""
    sun = next((np.array(each.r_inertial_m) for each in update.bodies if _is_sun(each.name)), None)
    if sun is not None and all(np.linalg.norm(sun - place) > SUN_RADIUS_M for place in (*places, r_camera_m)):
        return sun
    notes.append(f"the simulation has no Sun, or one without a place of its own: light comes from "
                 f"{list(body_map.sun_direction_inertial)}, 1 au away (`sun_direction_inertial` of the map)")
    return r_camera_m + AU_M * np.array(body_map.sun_direction_inertial)


