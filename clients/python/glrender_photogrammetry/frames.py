"""Frames with their poses in the frame of a body: all that a reconstruction knows of a sequence."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from glrender_navigation import Camera, sight
from glrender_navigation.camera import others_px
from glrender_navigation.checks import array, number, refuse

from .mesh import Mesh

# Surfaces seen at more than 80 deg or lit at more than 87 deg from their normal show nothing to match.
LEAST_COS_EMISSION = 0.17
_LEAST_COS_INCIDENCE = 0.05
# Share of the pixels that are brighter than white, and how bright they may be, in roots of it.
_WHITE, _MOST_ROOT = 0.0005, np.float32(1.5)
# Standard deviation of rounding to whole digital numbers.
_ROUNDING_DN = 12.0**-0.5
_SATURATED_SIGMAS = 3.0
# Rays start that many pixels of the nearest frame above the surface, which Embree has in float32.
_LIFT_PX = 0.1


@dataclass(frozen=True, kw_only=True, eq=False)
class PosedFrame:
    """A frame, and where its camera was as a body has it.

    Parameters
    ----------
    name : str
        Name of its file, for messages.
    image : (height, width) numbers
        Digital numbers, or irradiance.
    camera : glrender_navigation.Camera
    body : str
        Name of the body that the pose is of.
    camera_from_body : (3, 3) float
        Rotation.
    r_camera_body_m : (3,) float [m]
        Place of the camera in `body`.
    sun_direction_body : (3,) float
        Unit vector towards the Sun.
    offset : float
        Value of a pixel without light.
    noise : float
        Standard deviation of the same.
    most : float, optional
        Value of a saturated pixel; None where none can be.
    exposure_s : float [s]
        Brightness of vertices is by it; 1 of irradiance.
    others : tuple of str
        Other bodies whose origins lie within the image.
    place_sigma_m : float [m], optional
        Standard deviation of each component of the place, for poses that are a prior.
    """

    name: str
    image: np.ndarray
    camera: Camera
    body: str
    camera_from_body: np.ndarray
    r_camera_body_m: np.ndarray
    sun_direction_body: np.ndarray
    offset: float = 0.0
    noise: float = 0.0
    most: float | None = None
    exposure_s: float = 1.0
    others: tuple[str, ...] = ()
    place_sigma_m: float | None = None

    def __post_init__(self):
        if self.place_sigma_m is not None:
            number("place_sigma_m", self.place_sigma_m, "give metres")
        array("image", self.image, (self.camera.height_px, self.camera.width_px),
              "give one band, its rows from the top down")
        for name, shape in (("camera_from_body", (3, 3)), ("r_camera_body_m", (3,)), ("sun_direction_body", (3,))):
            object.__setattr__(self, name, array(name, getattr(self, name), shape,
                                                 "give the pose, or leave the frame out"))

    @classmethod
    def from_header(cls, name: str, image: np.ndarray, header: Mapping[str, Any], body: str) -> PosedFrame:
        """The frame of a file of `glrender sequence`; a lens that distorts is undone.

        Raises
        ------
        ValueError
            A header without the body's state, or a mosaic.
        """
        table = header["camera"]
        if table.get("mosaic"):
            raise refuse(f"{name}.camera.mosaic", "must be none", table["mosaic"], "draw the sequence by one band")
        camera = Camera.from_hello({**table, "distortion": None})
        if lens := table.get("distortion"):
            told = [lens.get(key, 0.0) for key in ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")]
            image = cv2.undistort(image.astype(np.float32), camera.matrix, np.array(told))
        here = sight(header["state"], camera, body)
        size_px = (camera.width_px - 0.5, camera.height_px - 0.5)
        others = tuple(other for other, at_px in others_px(header["state"], camera, body).items()
                       if (at_px > -0.5).all() and (at_px < size_px).all())
        offset, noise, most = 0.0, 0.0, None
        if header["unit"] == "DN" and (detector := table.get("detector")):
            gain, offset = detector["gain_DN_per_electron"], float(detector["offset_DN"])
            noise = float(np.hypot(gain * detector["read_noise_electrons"], _ROUNDING_DN))
            # Full wells are read with the noise of reading.
            most = min(2.0 ** detector["bit_depth"] - 1.0,
                       offset + gain * detector["full_well_electrons"] - _SATURATED_SIGMAS * noise)
        return cls(name=name, image=image, camera=camera, body=body, camera_from_body=here.camera_from_body,
                   r_camera_body_m=-here.camera_from_body.T @ here.r_body_camera_m,
                   sun_direction_body=here.camera_from_body.T @ here.sun_direction_camera, offset=offset, noise=noise,
                   most=most, exposure_s=header.get("exposure_s") or 1.0, others=others)

    @cached_property
    def signal(self) -> np.ndarray:
        """(height, width) float32, above the offset, 0 at the least."""
        return np.maximum(self.image.astype(np.float32) - np.float32(self.offset), np.float32(0.0))

    @cached_property
    def root(self) -> np.ndarray:
        """(height, width) float32, root of the signal over white: noise of the light is the same at all levels."""
        white = np.float32(max(float(np.quantile(self.signal, 1.0 - _WHITE)), 1e-30))
        return np.minimum(np.sqrt(self.signal / white), _MOST_ROOT)

    @property
    def px_m(self) -> float:
        """Pixel on the ground [m], square on at the body's origin."""
        return float(np.linalg.norm(self.r_camera_body_m)) / self.camera.focal_length_px

    def to_camera(self, r_body_m: np.ndarray) -> np.ndarray:
        """Places (..., 3) [m] in `camera` of places in `body`."""
        return (r_body_m - self.r_camera_body_m) @ self.camera_from_body.T

    def depth(self, mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
        """Depths (height, width) float64 [m] along the boresight, and facets there; -1 where there is none."""
        camera = self.camera
        at_px = np.rint(camera.project(self.to_camera(mesh.used_vertices_m))).astype(int)
        low = np.clip(at_px.min(axis=0) - 1, 0, None)
        high = np.clip(at_px.max(axis=0) + 2, None, (camera.width_px, camera.height_px))
        facet = np.full((camera.height_px, camera.width_px), -1)
        depth_m = np.full(facet.shape, -1.0)
        x, y = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
        unit = camera.direction(np.stack([x.ravel(), y.ravel()], axis=-1)) @ self.camera_from_body
        found = mesh.seen_from(self.r_camera_body_m, unit)
        x, y, unit, found = (each[found >= 0] for each in (x.ravel(), y.ravel(), unit, found))
        normal = mesh.facet_normals[found]
        range_m = (((mesh.corners_m[found, 0] - self.r_camera_body_m) * normal).sum(axis=1)
                   / (unit * normal).sum(axis=1))
        facet[y, x], depth_m[y, x] = found, range_m * (unit @ self.camera_from_body[2])
        return depth_m, facet


def angle_rad(one: PosedFrame, other: PosedFrame) -> float:
    """Angle at the body's origin between two cameras."""
    a, b = one.r_camera_body_m, other.r_camera_body_m
    return float(np.arccos(np.clip(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)), -1.0, 1.0)))


def posed_frames(folder: str | Path, body: str | None = None) -> list[PosedFrame]:
    """The frames of a folder of `glrender sequence` (NPZ or FITS), in its order, posed about a body, the first if None.

    Raises
    ------
    ValueError
        A folder that is no sequence, a body that it does not have, or a frame that cannot be read.
    """
    folder = Path(folder)
    paths = sorted(path for path in folder.glob("frame_*") if path.suffix in _READERS)
    if not paths or not (folder / "manifest.json").is_file():
        raise refuse(str(folder), "must be a folder of `glrender sequence` with frames as npz or fits",
                     sorted(path.name for path in folder.glob("*"))[:3], "glrender sequence SCENARIO --out FOLDER")
    found = []
    for path in paths:
        try:
            image, header = _READERS[path.suffix](path)
            bodies = list(header["bodies"])
            if body in (None, *bodies):
                found.append(PosedFrame.from_header(path.name, image, header, body or bodies[0]))
                continue
        except ImportError:
            raise refuse(path.name, "needs astropy", None, "pip install 'glrender[fits]'") from None
        except Exception as error:  # a file can be broken in as many ways as its readers have errors
            raise refuse(str(path), "must be a frame of a sequence", type(error).__name__, str(error)) from None
        raise refuse("body", f"must be one of {', '.join(bodies)}", body)
    return found


def _npz(path: Path) -> tuple[np.ndarray, dict[str, Any]]:
    with np.load(path, allow_pickle=False) as stored:
        return stored["image"], json.loads(str(stored["header"]))


def _fits(path: Path) -> tuple[np.ndarray, dict[str, Any]]:
    from astropy.io import fits

    with fits.open(path) as parts:
        # FITS counts rows from below.
        stored = np.flipud(parts[0].data)
        return stored.astype(stored.dtype.newbyteorder("=")), json.loads(parts["GLRENDER"].data.tobytes())


_READERS = {".npz": _npz, ".fits": _fits}


def views_in_light(frames: Sequence[PosedFrame], mesh: Mesh, points_m: np.ndarray, normal: np.ndarray) -> Iterator[
        tuple[PosedFrame, np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Each frame, whether it sees points (N, 3) of a mesh lit and not at too flat an angle, and their pixels (N, 2).

    The cosines (N,) of incidence and emission are the last two; `normal` (N, 3) is that of the surface at the points.
    """
    if not frames:
        raise refuse("frames", "must be one or more", 0, "posed_frames(folder)")
    lifted_m = points_m + _LIFT_PX * min(frame.px_m for frame in frames) * normal
    for frame in frames:
        away_m = frame.r_camera_body_m - points_m
        to_camera = away_m / np.linalg.norm(away_m, axis=1, keepdims=True)
        to_sun = np.tile(frame.sun_direction_body, (len(points_m), 1))
        cos_emission, cos_incidence = ((direction * normal).sum(axis=1) for direction in (to_camera, to_sun))
        at_px = np.rint(frame.camera.project(frame.to_camera(points_m))).astype(int)
        seen = ((at_px >= 0) & (at_px < (frame.camera.width_px, frame.camera.height_px))).all(axis=1)
        seen &= (cos_emission > LEAST_COS_EMISSION) & (cos_incidence > _LEAST_COS_INCIDENCE)
        for direction in (to_camera, to_sun):
            here = np.flatnonzero(seen)
            seen[here] = ~mesh.rays.intersects_any(lifted_m[here], direction[here]) if here.size else False
        yield frame, seen, at_px, cos_incidence, cos_emission


def seen_in_light(frames: Sequence[PosedFrame], mesh: Mesh, points_m: np.ndarray, facet: np.ndarray) -> np.ndarray:
    """Number of frames (N,) that see points (N, 3) of the facets (N,) of a mesh lit, neither at too flat an angle."""
    return np.sum([seen for _, seen, *_ in views_in_light(frames, mesh, points_m, mesh.facet_normals[facet])], axis=0)
