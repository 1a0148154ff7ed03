"""The interface of estimators: a frame and a believed state go in, a measurement or a reason comes out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from .body import BelievedBody
from .camera import Camera, Sight, StateLike, sight

# Standard deviation along an axis that nothing measured, over the believed range [1].
_UNKNOWN = 10.0
# Share of the lit pixels beyond which a frame is blinded; heights between sky and brightest pixel from which one is
# saturated, and lit; and the least height [DN] at which such shares mean something.
_MOST_SATURATED = 0.5
_SATURATED = 0.998
_LIT = 0.1
_LEAST_RANGE_DN = 100.0
_LEAST_LIT_PX = 4
# Share of the body's radius within which a find is the body's own, by its believed place.
_OWN = 0.25
N_STRETCHES = 8.0
"""Number of stretches of a surface whose errors count as independent: within each they are alike."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Measurement:
    """A body's origin found in a frame.

    Attributes
    ----------
    direction_camera : (3,) float64
        Unit vector from the camera towards the body's origin.
    sigma_rad : float [rad]
        Standard deviation of the direction, of each axis across; infinite where it was not measured.
    center_px : (float, float) [px]
        The direction as a pixel.
    range_m : float [m] or None
    sigma_range : float [1] or None
        Standard deviation of the range, relative to itself.
    r_camera_m : (3,) float64 [m] or None
        The body's place in `camera`, of methods that solve for it.
    covariance_m2 : (3, 3) float64 [m2] or None
        Covariance of `r_camera_m`.
    q_camera_from_body : (4,) float64 or None
        The body's attitude in `camera`, [w, x, y, z], of methods that solve for it.
    pose_covariance : (6, 6) float64 [rad2, rad m, m2] or None
        Covariance of small turns of the body about its origin, along the axes of `camera`, and of `r_camera_m`.
    is_by_size : bool
        Whether the range is of the body's apparent size, so that it errs as the believed size does.
    doubt : str
        Why the place may be of a wrong match; empty where nothing speaks against it, and of methods that cannot tell.
    """

    direction_camera: np.ndarray
    sigma_rad: float
    center_px: tuple[float, float]
    range_m: float | None = None
    sigma_range: float | None = None
    r_camera_m: np.ndarray | None = None
    covariance_m2: np.ndarray | None = None
    q_camera_from_body: np.ndarray | None = None
    pose_covariance: np.ndarray | None = None
    is_by_size: bool = True
    doubt: str = ""

    @classmethod
    def of_center(cls, camera: Camera, center_px: np.ndarray, sigma_px: float, range_m: float | None = None,
                  sigma_range: float | None = None) -> Measurement:
        """A measurement of the body's centre [px], and of its range."""
        return cls(direction_camera=camera.direction(center_px), sigma_rad=float(sigma_px) / camera.focal_length_px,
                   center_px=(float(center_px[0]), float(center_px[1])), sigma_range=sigma_range,
                   range_m=None if range_m is None else float(range_m))

    @classmethod
    def of_place(cls, camera: Camera, r_camera_m: np.ndarray, covariance_m2: np.ndarray, *,
                 is_by_size: bool = True) -> Measurement:
        """A measurement of the body's place, with its direction and range."""
        range_m = float(np.linalg.norm(r_camera_m))
        along = r_camera_m / range_m
        variance_m2 = float(along @ covariance_m2 @ along)
        across_m2 = 0.5 * (float(np.trace(covariance_m2)) - variance_m2)
        return cls(direction_camera=along, sigma_rad=across_m2**0.5 / range_m, range_m=range_m,
                   sigma_range=variance_m2**0.5 / range_m, center_px=tuple(map(float, camera.project(r_camera_m))),
                   r_camera_m=r_camera_m, covariance_m2=covariance_m2, is_by_size=is_by_size)

    def place(self, believed_range_m: float) -> tuple[np.ndarray, np.ndarray]:
        """Place (3,) [m] and covariance (3, 3) [m2] in `camera`; an axis not measured is as wide as ten ranges."""
        if self.r_camera_m is not None:
            return self.r_camera_m, self.covariance_m2
        range_m = believed_range_m if self.range_m is None else self.range_m
        along = np.outer(self.direction_camera, self.direction_camera)
        across_m = range_m * min(self.sigma_rad, _UNKNOWN)
        along_m = range_m * (_UNKNOWN if self.sigma_range is None else min(self.sigma_range, _UNKNOWN))
        return range_m * self.direction_camera, across_m**2 * (np.eye(3) - along) + along_m**2 * along


class NotFound(Exception):
    """A frame without a measurement; the message is the reason."""


class Estimator:
    """The base of estimators.

    Parameters
    ----------
    camera : Camera
    body : BelievedBody

    Attributes
    ----------
    name : str
        In `ESTIMATORS`.
    reason : str
        Why the last frame gave None; empty after a measurement.
    """

    name = ""

    def __init__(self, camera: Camera, body: BelievedBody):
        self.camera, self.body, self.reason = camera, body, ""

    def measure(self, frame: np.ndarray, believed: StateLike, render: Callable[..., Any]) -> Measurement | None:
        """Measure a body in a frame.

        Parameters
        ----------
        frame : (height, width) array
            Digital numbers or irradiance.
        believed : State or its dictionary
            The estimated state at the frame's time.
        render : callable
            ``render(state, *, products=(), roi=None)`` draws the believed scene by the on-board camera and returns a
            reply with `pixels` and `arrays`: ``functools.partial(client.render, camera="navcam", max_error=0.1)``.

        Returns
        -------
        Measurement or None
            None where nothing is found; `reason` says why.

        Raises
        ------
        ValueError
            With the field: a frame of another shape, or a state without the body or with a value that is no number.
        """
        self.reason = ""
        try:
            return self._measured(self._checked(frame), believed, sight(believed, self.camera, self.body.name), render)
        except NotFound as error:
            self.reason = str(error)
        except (cv2.error, np.linalg.LinAlgError) as error:
            self.reason = f"the solution broke down: {str(error).strip().splitlines()[-1]}"
        return None

    def _measured(self, frame: np.ndarray, believed: StateLike, here: Sight,
                  render: Callable[..., Any]) -> Measurement:
        raise NotImplementedError

    def placed(self, place_m: np.ndarray, covariance_m2: np.ndarray, excess: float = 1.0) -> Measurement:
        """A measurement against the believed shape, whose own error counts too: in place, and in size for the range.

        `excess` [1] is the variance of the shape's error over the believed one.
        """
        range_m = float(np.linalg.norm(place_m))
        along = np.outer(place_m, place_m) / range_m**2
        across_m2 = excess * self.body.shape_error_m**2 / N_STRETCHES
        along_m2 = across_m2 * (range_m / self.body.mean_radius_m)**2
        return Measurement.of_place(self.camera, place_m,
                                    covariance_m2 + across_m2 * (np.eye(3) - along) + along_m2 * along)

    def _checked(self, frame: np.ndarray) -> np.ndarray:
        """The frame, if something can be seen in it."""
        shape = (self.camera.height_px, self.camera.width_px)
        if frame.shape != shape:
            raise ValueError(f"frame: must have the camera's shape {shape}, got {frame.shape}; cut or resize it")
        top, sky = frame.max(), frame.min()
        if not np.isfinite(top) or not np.isfinite(sky):
            raise NotFound("the frame has pixels that are no numbers")
        if top == sky:
            raise NotFound(f"every pixel of the frame is {top:g}: it is dark, saturated or lost")
        if frame.dtype.kind in "ui":
            # Share of the lit pixels that are within read noise of the top.
            height = np.ma.filled((frame[::2, ::2] - float(sky)) / (float(top) - float(sky)), 0.0)
            share = np.count_nonzero(height > _SATURATED) / max(np.count_nonzero(height > _LIT), 1)
            if share > _MOST_SATURATED and float(top) - float(sky) > _LEAST_RANGE_DN:
                raise NotFound(f"{share:.0%} of the lit pixels are saturated: expose it shorter")
        return frame


def lit_pixels(frame: np.ndarray, least: float | None = None) -> np.ndarray:
    """The frame above its sky (H, W) float32, zero where it is not lit.

    The threshold above the sky is seven times the noise, and `least`, or a fiftieth of the brightest pixels.

    Raises
    ------
    NotFound
        Fewer than four pixels are lit.
    """
    # The body may fill most of the frame: the sky is its darkest twentieth.
    sky = np.float32(np.quantile(frame[::4, ::4], 0.05))
    values = np.maximum(frame, sky, dtype=np.float32) - sky
    # Neighbours' differences are sqrt(2) times as noisy; the sky was taken 1.6 sigma below its mean.
    noise = 1.4826 / 2**0.5 * float(np.median(np.abs(np.diff(frame[::8].astype(np.float32), axis=1))))
    least = max(7.0 * noise, 0.02 * float(np.quantile(values[::2, ::2], 0.999)) if least is None else least)
    values[values <= least] = 0.0
    if (n_lit := int(np.count_nonzero(values))) < _LEAST_LIT_PX:
        raise NotFound(f"no body stands out of the dark: {n_lit} pixels are lit, {_LEAST_LIT_PX} are needed")
    return values


def is_anothers(found_px: np.ndarray, believed_px: np.ndarray, others_px: dict[str, np.ndarray],
                radius_px: float) -> np.ndarray:
    """Which places found (..., 2) [px] are nearer to where another body is believed than to where this one is.

    A find within a quarter of the body's radius of its believed place is not.
    """
    off_px = np.linalg.norm(found_px - believed_px, axis=-1)
    nearest_px = np.min([np.linalg.norm(found_px - px, axis=-1) for px in others_px.values()], axis=0, initial=np.inf)
    return (nearest_px < off_px) & (off_px > _OWN * radius_px)


def brightness_center_px(values: np.ndarray) -> np.ndarray:
    """Centre of brightness (2,) [px] of lit pixels."""
    of_columns, of_rows = values.sum(axis=0, dtype=np.float64), values.sum(axis=1, dtype=np.float64)
    return np.array([np.average(np.arange(len(sums)), weights=sums) for sums in (of_columns, of_rows)])
