"""The pinhole camera: where a direction lands on the detector, and how much sky a pixel sees.

Frame `camera`: +Z boresight, +X to the right of the image, +Y down. Frame `pixel`:
(0, 0) is the centre of the top-left pixel, x to the right, y down.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from .camera import CameraModel, Frame
from .detector import MAX_SEED
from .distortion import BrownConrady, frame_border
from .errors import ConfigError
from .faults.fault import Fault
from .lateral import magnified, magnified_points
from .lens_map import LensMap
from .mosaic import MosaicModel
from .pattern import seed_of
from .points import PointSources
from .validate import integer, name_of, position, unit_quaternion, vector, within

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

MAX_IMAGE_PX = 16384
"""Widest image [px]: the texture limit of every OpenGL that glrender runs on."""
# From one wide pixel that sees half the sky to a picoradian a pixel.
_FOCAL_LENGTHS_PX = (1e-3, 1e12)
# float64 resolves places to 1e-11 px there.
_MAX_PRINCIPAL_POINT_PX = 1e5

# A margin changes a frame's aspect by a few percent; height for width is a mistake.
_ASPECT_TOLERANCE = 0.05
# Before they are checked: the mounting, the place, and the image's centre as the principal point.
_IDENTITY: Any = (1.0, 0.0, 0.0, 0.0)
_ORIGIN: Any = (0.0, 0.0, 0.0)
_CENTRE: Any = None


@dataclass(frozen=True, kw_only=True, eq=False)
class PinholeCamera:
    """A camera on the spacecraft, rectilinear but for its distortion.

    Parameters
    ----------
    name : str
    width_px, height_px : int [px], 1..16384
    focal_length_px : float [px], 1e-3..1e12
        Focal length over pixel pitch; pixels are square.
    principal_point_px : (2,) float [px], optional
        (x, y) of the boresight in `pixel`, within 1e5 px; default is the image centre,
        ((width - 1) / 2, (height - 1) / 2).
    q_camera_from_spacecraft : (4,) float, optional
        Mounting, unit quaternion [w, x, y, z]; default identity.
    r_camera_spacecraft_m : (3,) float [m], optional
        Position of the projection centre in `spacecraft`; default zero.
    model : CameraModel or MosaicModel, optional
        Optics, detector and exposure; without it the camera gives irradiance only.
    distortion : BrownConrady, optional
        Distortion of the lens.

    Raises
    ------
    ConfigError
        With the field's name, the rule and the value; also where the frame sees beyond the radius at which the
        distortion folds over, with the radius.
    """

    name: str
    width_px: int
    height_px: int
    focal_length_px: float
    principal_point_px: tuple[float, float] = _CENTRE
    q_camera_from_spacecraft: np.ndarray = field(default=_IDENTITY)
    r_camera_spacecraft_m: np.ndarray = field(default=_ORIGIN)
    model: CameraModel | MosaicModel | None = None
    distortion: BrownConrady | None = None

    if TYPE_CHECKING:  # lists of numbers go in, arrays come out
        def __init__(self, *, name: str, width_px: int, height_px: int, focal_length_px: float,
                     principal_point_px: ArrayLike | None = None, q_camera_from_spacecraft: ArrayLike = ...,
                     r_camera_spacecraft_m: ArrayLike = ..., model: CameraModel | MosaicModel | None = None,
                     distortion: BrownConrady | None = None) -> None: ...

    def __post_init__(self):
        put = lambda name, value: object.__setattr__(self, name, value)  # noqa: E731 (frozen dataclass)
        name_of("name", self.name)
        put("width_px", integer("width_px", self.width_px, 1, MAX_IMAGE_PX))
        put("height_px", integer("height_px", self.height_px, 1, MAX_IMAGE_PX))
        put("focal_length_px", within("focal_length_px", self.focal_length_px, *_FOCAL_LENGTHS_PX))
        centre = self.principal_point_px
        if centre is None:
            centre = ((self.width_px - 1) / 2.0, (self.height_px - 1) / 2.0)
        x, y = vector("principal_point_px", centre, 2).tolist()
        centre = (x, y)
        if max(map(abs, centre)) > _MAX_PRINCIPAL_POINT_PX:
            raise ConfigError("principal_point_px", f"must be within {_MAX_PRINCIPAL_POINT_PX:g} px", centre)
        put("principal_point_px", centre)
        put("q_camera_from_spacecraft",
            unit_quaternion("q_camera_from_spacecraft", self.q_camera_from_spacecraft))
        put("r_camera_spacecraft_m", position("r_camera_spacecraft_m", self.r_camera_spacecraft_m))
        if self.model is not None and not isinstance(self.model, (CameraModel, MosaicModel)):
            raise ConfigError("model", "must be a CameraModel or a MosaicModel", self.model)
        for letter, band in self.model.bands.items() if self.model else ():
            lens = band.optics.aberrations
            if lens and lens.varies and not abs(lens.aspect * self.height_px / self.width_px - 1.0) < _ASPECT_TOLERANCE:
                rule = f"must be width / height, {self.width_px / self.height_px:.4g}, within {_ASPECT_TOLERANCE:.0%}"
                raise ConfigError(f"model.optics.{letter and letter + '.'}aberrations.aspect", rule, lens.aspect)
        if self.distortion is not None:
            if not isinstance(self.distortion, BrownConrady):
                raise ConfigError("distortion", "must be a BrownConrady", self.distortion)
            put("distortion", self.distortion if self.distortion.is_any else None)
        if self.distortion is not None:
            self.distortion.require_seen(self.normalised(frame_border(self.width_px, self.height_px)))

    def project(self, r_camera: np.ndarray) -> np.ndarray:
        """Pixel coordinates of points or directions.

        Parameters
        ----------
        r_camera : (..., 3) float
            In `camera`; points behind the camera (z <= 0), or beyond the fold of its distortion, return NaN.

        Returns
        -------
        (..., 2) float64 [px]
        """
        r = np.asarray(r_camera, dtype=np.float64)
        z = r[..., 2:]
        ahead = z > 0.0
        ratio = r[..., :2] / np.where(ahead, z, 1.0)
        if self.distortion is not None:
            ratio = self.distortion.distort(ratio)
        return np.where(ahead, self.focal_length_px * ratio + np.array(self.principal_point_px), np.nan)

    def directions(self, pixel: np.ndarray) -> np.ndarray:
        """Unit vectors in `camera` through pixel coordinates; the inverse of `project`.

        Parameters
        ----------
        pixel : (..., 2) float [px]

        Returns
        -------
        (..., 3) float64 [1]
        """
        offset = self.normalised(pixel)
        x, y = offset[..., 0], offset[..., 1]
        # Columns: NumPy works along them several times as fast.
        ray = np.empty((3, *x.shape))
        ray[2] = 1.0 / np.sqrt(x * x + y * y + 1.0)
        ray[0], ray[1] = x * ray[2], y * ray[2]
        return np.moveaxis(ray, 0, -1)

    def normalised(self, pixel: np.ndarray) -> np.ndarray:
        """X / Z, Y / Z in `camera` (..., 2) float64 [1] of pixel coordinates (..., 2) [px].

        NaN where a distortion images no direction.
        """
        pixel = np.asarray(pixel, dtype=np.float64)
        columns = np.array([(pixel[..., k] - middle) / self.focal_length_px
                            for k, middle in enumerate(self.principal_point_px)])
        offset = np.moveaxis(columns, 0, -1)
        return offset if self.distortion is None else self.distortion.undistort(offset)

    @cached_property
    def seen(self) -> np.ndarray:
        """X / Z, Y / Z in `camera` at each pixel's centre.

        Returns
        -------
        (height, width, 2) float64 [1], read-only
        """
        x, y = np.arange(self.width_px), np.arange(self.height_px)
        # Some rows at a time: a row alone is mostly calls, and all at once would take many times the frame's memory.
        some = np.split(y[:, None], range(8, self.height_px, 8))
        seen = np.concatenate([self.normalised(np.stack(np.broadcast_arrays(x, rows), axis=-1)) for rows in some])
        seen.setflags(write=False)
        return seen

    @cached_property
    def lens_map(self) -> LensMap | None:
        """The map of the lens; None of one that does not distort."""
        return None if self.distortion is None else LensMap(
            self.distortion, (self.width_px, self.height_px), self.focal_length_px, self.principal_point_px)

    @property
    def without_distortion(self) -> PinholeCamera:
        """The camera without distortion, of the same pixels."""
        return self if self.distortion is None else replace(self, distortion=None)

    @cached_property
    def rectilinear(self) -> PinholeCamera:
        """The camera without distortion, of the same focal length, that sees all that this one sees."""
        if self.distortion is None:
            return self
        border = self.normalised(frame_border(self.width_px, self.height_px, 1))
        place = border[np.isfinite(border).all(axis=1)] * self.focal_length_px
        low, high = np.floor(place.min(axis=0)) - 1.0, np.ceil(place.max(axis=0)) + 1.0
        width, height = (int(side) for side in high - low + 1.0)
        return replace(self, width_px=min(width, MAX_IMAGE_PX), height_px=min(height, MAX_IMAGE_PX),
                       principal_point_px=tuple(-low), distortion=None, model=None)

    @cached_property
    def least_cosine(self) -> float:
        """Least cosine [1] of the angle off the boresight in the frame: in a corner, or where the lens's field ends."""
        x0, y0, x1, y1 = self.bounds_px
        least = float(self.directions(np.array([[x0, y0], [x1, y0], [x0, y1], [x1, y1]]))[:, 2].min())
        return least if self.distortion is None or not math.isnan(least) else 1.0 / math.hypot(
            1.0, self.distortion.max_radius)

    def places_px(self, xy: np.ndarray) -> np.ndarray:
        """Places (2, N) float64 [px] of X / Z, Y / Z in `camera` (2, N) [1]: the inverse of `normalised`.

        Beyond what a lens images they are somewhere beyond the frame.
        """
        if self.lens_map is not None:
            return self.lens_map.places_px(xy)
        return self.focal_length_px * xy + np.array(self.principal_point_px)[:, None]

    def solid_angle_sr(self) -> np.ndarray:
        """Solid angle of each pixel: cos^3(theta) / f^2, over what a distortion magnifies areas by.

        Returns
        -------
        (height, width) float64 [sr]
            The midpoint rule; its relative error is below 1 / (4 f^2), f in pixels.
        """
        if self.lens_map is not None:
            return self.lens_map.pixels_solid_angles / self.focal_length_px**2
        return self._cosine**3 / self.focal_length_px**2

    @property
    def _cosine(self) -> np.ndarray:
        """Cosine of each pixel's field angle (height, width) float64 [1]."""
        if self.distortion is not None:
            return (1.0 + np.sum(self.seen**2, axis=-1)) ** -0.5
        x = (np.arange(self.width_px) - self.principal_point_px[0]) / self.focal_length_px
        y = (np.arange(self.height_px) - self.principal_point_px[1]) / self.focal_length_px
        return (1.0 + x[None, :] ** 2 + y[:, None] ** 2) ** -0.5

    @cached_property
    def cos_field_angle(self) -> np.ndarray:
        """Foreshortening of the aperture seen from each pixel's direction.

        Returns
        -------
        (height, width) float32 [1], read-only
        """
        cosine = self._cosine.astype(np.float32)
        cosine.setflags(write=False)
        return cosine

    @property
    def bounds_px(self) -> tuple[float, float, float, float]:
        """Edges x0, y0, x1, y1 of the image [px]: its outermost pixels reach half a pixel beyond their centres."""
        return (-0.5, -0.5, self.width_px - 0.5, self.height_px - 0.5)

    def with_margin(self, margin_px: int) -> PinholeCamera:
        """The same camera with so many more pixels on each side, to render what lies beyond the frame."""
        return self if margin_px == 0 else _with_margin(self, integer("margin_px", margin_px, 0, MAX_IMAGE_PX))

    def noise_seed(self, seed: int) -> int:
        """The seed of this camera's noise in a frame of a seed: cameras of other names have noise of their own."""
        return seed_of(integer("seed", seed, 0, MAX_SEED), self.name)

    @cached_property
    def own_model(self) -> CameraModel | MosaicModel:
        """The model with the fixed pattern of this camera's own sensor."""
        model: Any = self.model
        detector = model.detector
        return replace(model, detector=replace(detector, sensor_seed=seed_of(detector.sensor_seed, self.name)))

    def expose(self, irradiance_W_m2: np.ndarray | Mapping[str, np.ndarray], seed: int = 0, *,
               exposure_s: float | str | None = None, roi: tuple[int, int, int, int] | None = None,
               previous: Frame | None = None, margin_px: int = 0,
               points: PointSources | Mapping[str, PointSources] | None = None,
               faults: Sequence[Fault | Mapping[str, Any]] | None = None) -> Frame:
        """Expose one frame of this camera: `CameraModel.expose` with the aperture foreshortened off axis.

        With `margin_px` the image is one of `with_margin(margin_px)`. Behind a mosaic irradiance and points are
        those of each letter's band: `MosaicModel.expose`.

        Noise and fixed pattern are this camera's own: they are made of the seeds and of its name, so that two cameras
        with detectors of one type and one seed share neither.

        Raises
        ------
        ConfigError
            Also when the camera has no model, or the image is not of its size.
        """
        if self.model is None:
            raise ConfigError("model", "missing", hint="give the camera a CameraModel, or ask for irradiance")
        seen = self.with_margin(margin_px)
        for image in irradiance_W_m2.values() if isinstance(irradiance_W_m2, Mapping) else (irradiance_W_m2,):
            if np.shape(image) != (seen.height_px, seen.width_px):
                raise ConfigError("irradiance_W_m2", f"must have shape ({seen.height_px}, {seen.width_px})",
                                  np.shape(image))
        if isinstance(self.model, MosaicModel) and self.model.magnification:
            sizes = self.model.magnification
            images, given = cast(Mapping[str, np.ndarray], irradiance_W_m2), cast(Mapping[str, PointSources], points)
            irradiance_W_m2 = {letter: magnified(image, sizes[letter], seen.principal_point_px) if letter in sizes
                               else image for letter, image in images.items()}
            points = given and {letter: magnified_points(each, sizes[letter], self.principal_point_px)
                                if letter in sizes else each for letter, each in given.items()}
            roi = None
        # A mosaic takes those of each band.
        frame = cast(Any, self.own_model).expose(
            irradiance_W_m2, self.noise_seed(seed), exposure_s=exposure_s, roi=roi, previous=previous, points=points,
            relative_illumination=seen.cos_field_angle, margin_px=margin_px, faults=faults)
        return replace(frame, seed=seed)


@lru_cache(maxsize=8)
def _with_margin(camera: PinholeCamera, margin_px: int) -> PinholeCamera:
    x, y = camera.principal_point_px
    return replace(camera, width_px=camera.width_px + 2 * margin_px, height_px=camera.height_px + 2 * margin_px,
                   principal_point_px=(x + margin_px, y + margin_px))
