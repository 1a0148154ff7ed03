"""Estimator by all pixels: least squares of the frame itself, by normal equations that the renderer sends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from .believed import Drawn, Refined, blurred, placed, shift_between
from .body import BelievedBody
from .camera import Camera, Sight, StateLike, moved
from .measurement import Estimator, Measurement, NotFound

# Tolerance of the first frames, which are shifted and scaled until they fit, blurred by a deviation [px], in steps; and
# how far [px] the last of them is drawn from where it fits.
_COARSE, _BLUR_PX, _N_SHIFTS, _NEAR_PX = 0.1, 1.5, 4, 0.5
# Deviations of the blur [px] of the first comparisons of an attitude that is not known; the tolerance of all, which err
# by less than the noise lets be known.
_BLURS_PX, _FINE = (4.0, 1.5), 0.005
# A step moves centre and limb by no more [px], as derivatives reach no farther, plus so many deviations of the blur; it
# is the last where it moves them by less than `_ENOUGH_PX`: the next would by a twentieth of that.
_REACH_PX, _PER_BLUR, _ENOUGH_PX, _MOST_STEPS = 2.0, 2.0, 0.03, 10
# Largest change of a drawn frame's size in a step [1].
_REACH_SCALE = 0.04
# Below this correlation the frame does not show the believed body.
_LEAST_CORRELATION = 0.6
# Share of the frame's light [1], by its square and beyond the noise, that believed shapes leave: 1280 facets for 20480
# left 0.001 to 0.05, and from 0.005 on erred by more than 1.2 of their sigmas.
_USUALLY_LEFT = 0.005
# The part that is compared reaches beyond the body by a share of its radius [1] and some pixels, for the sky's level;
# and the most bytes of it, as a client sends them.
_WIDER, _SKY_PX, _MOST_BYTES = 1.2, 16.0, 1_000_000


class _Step(NamedTuple):
    """Changes (K,) of the spacecraft's place [m] and attitude [rad] along the camera's axes, and their covariance.

    `left` is the share of the frame's light [1], by its square, that neither prediction nor noise explains.
    """

    change: np.ndarray
    covariance: np.ndarray
    left: float


class AllPixels(Estimator):
    """The frame's digital numbers against the predicted ones: least squares of the pose, a gain and a level.

    The believed frame's light is shifted and scaled until it fits. Then comparisons give steps of Gauss and Newton, of
    limited length; the first are blurred where the attitude is solved for too. Pixels that differ by much more than
    most weigh less. The covariance is of the camera's noise, or of what is left where that is more, and of the believed
    shape (`BelievedBody.shape_error_m`). Where more of the light is left than shapes leave, as the believed attitude,
    shape or law is wrong, or the match, the measurement has a `doubt`, and the shape's part grows with it.

    Parameters
    ----------
    camera, body
        As of `Estimator`. `render` must take ``compare`` as `glrender_client.Client.render` does, of a camera with a
        detector, and without other bodies in the way.
    is_attitude_known : bool
        Whether the place alone is solved for; else the camera's attitude too.

    Source: Huber (1964), Robust estimation of a location parameter; docs/derivatives.md of glrender.
    """

    name = "all_pixels"

    def __init__(self, camera: Camera, body: BelievedBody, is_attitude_known: bool = True):
        super().__init__(camera, body)
        self._count = 3 if is_attitude_known else 6

    def _measured(self, frame: np.ndarray, believed: StateLike, here: Sight,
                  render: Callable[..., Any]) -> Measurement:
        if frame.dtype not in (np.uint8, np.uint16):
            frame = frame.astype(np.float32)
        refined = Refined(np.ma.filled(frame, frame.min()), believed, self.camera, self.body,
                          partial(render, max_error=_COARSE), enough_px=_NEAR_PX)
        pose = here.camera_from_body, refined(partial(self._fitting, refined.frame))[0]
        for blur_px in _BLURS_PX if self._count == 6 else ():
            step = self._step(frame, believed, pose, render, blur_px)
            pose = self._after(pose, step.change, _REACH_PX + _PER_BLUR * blur_px)
        for _ in range(_MOST_STEPS):
            step = self._step(frame, believed, pose, render, 0.0)
            before, pose = pose, self._after(pose, step.change, _REACH_PX)
            if (moved_px := self._size_px(before, pose)) < _ENOUGH_PX:
                return self._found(pose, step)
        raise NotFound(f"the place still moves by {moved_px:.2f} px after {_MOST_STEPS} steps, {_ENOUGH_PX} is allowed")

    def _fitting(self, frame: np.ndarray, drawn: Drawn, number: int) -> tuple[np.ndarray, None]:
        """The place (3,) [m] where a drawn frame's light fits best, shifted and scaled, with a gain and a level."""
        (x, y), (height, width) = drawn.corner_px, drawn.pixels.shape
        first, seen = (blurred(image, _BLUR_PX) for image in (drawn.pixels, frame[y:y + height, x:x + width]))
        first = first / first.max()
        center_px = self.camera.project(drawn.here.r_body_camera_m) - drawn.corner_px
        shift_px, scale = np.zeros(2), 1.0
        for _ in range(_N_SHIFTS):
            back = np.column_stack([np.eye(2) / scale, center_px - (center_px + shift_px) / scale])
            light = cv2.warpAffine(first, back, (width, height), flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
                                   borderMode=cv2.BORDER_REPLICATE)
            down, right = np.gradient(light)
            off_x, off_y = np.arange(width) - center_px[0], np.arange(height)[:, None] - center_px[1]
            design = np.stack([each[drawn.is_clear] for each in (
                right, down, off_x * right + off_y * down, light, np.ones_like(light))])
            *change, gain, _ = np.linalg.solve(design @ design.T, design @ seen[drawn.is_clear])
            if not gain > 0.0:
                raise NotFound("the frame does not show the light of the believed one")
            shift_px = shift_px - np.clip(np.array(change[:2]) / gain, -_REACH_PX, _REACH_PX)
            scale *= float(np.exp(-np.clip(change[2] / gain, -_REACH_SCALE, _REACH_SCALE)))
        return placed(self.camera, center_px + drawn.corner_px + shift_px, drawn.here.range_m / scale), None

    def _step(self, frame: np.ndarray, believed: StateLike, pose: tuple[np.ndarray, np.ndarray],
              render: Callable[..., Any], blur_px: float) -> _Step:
        """One step from a pose.

        Raises
        ------
        NotFound
        """
        camera = self.camera
        state = moved(believed, camera, self.body.name, pose[1], pose[0] if self._count == 6 else None)
        x0, y0, x1, y1 = roi = self._region(pose[1], frame.dtype.itemsize)
        try:
            fit = render(state, compare=frame[y0:y1, x0:x1], roi=roi, derivatives=["spacecraft"], blur_px=blur_px,
                         unknown=["gain", "offset"], robust=True, max_error=_FINE).comparison
        except Exception as error:
            # A renderer's, or a client's: where other bodies may hide this one there are no derivatives.
            if getattr(error, "path", "") != "derivatives":
                raise
            raise NotFound(str(error)) from error
        keep = [*range(self._count), len(fit.names) - 2, len(fit.names) - 1]
        matrix, vector = fit.matrix[np.ix_(keep, keep)], fit.vector[keep]
        scale = np.sqrt(np.diag(matrix))
        if not (scale > 0.0).all():
            raise NotFound("the predicted frame is dark, or out of the image")
        # The light that gain and level explain, and what is left.
        light = fit.gain**2 * (matrix[-2, -2] - matrix[-2, -1]**2 / matrix[-1, -1])
        correlation = float(np.sqrt(max(light, 0.0) / max(light + fit.chi2, 1e-300)))
        if not correlation > _LEAST_CORRELATION:
            raise NotFound(f"the frame correlates with the predicted one by {correlation:.2f}, {_LEAST_CORRELATION} is "
                           "needed")
        inverse = np.linalg.inv(matrix / np.outer(scale, scale)) / np.outer(scale, scale)
        noise = max(fit.chi2 / max(fit.n_pixels - len(keep), 1), 1.0)
        return _Step((inverse @ vector)[:self._count], noise * inverse[:self._count, :self._count],
                     max(fit.chi2 - fit.n_pixels, 0.0) / (light + fit.chi2))

    def _region(self, place_m: np.ndarray, n_bytes: int) -> list[int]:
        """The part of the frame that is compared: x0, y0, x1, y1 [px]."""
        camera, depth_m = self.camera, max(place_m[2], 1.01 * self.body.bounding_radius_m)
        reach_px = camera.focal_length_px * self.body.bounding_radius_m / (depth_m - self.body.bounding_radius_m)
        reach_px = min(_WIDER * reach_px + _SKY_PX, 0.5 * (_MOST_BYTES / n_bytes)**0.5 - 2.0)
        center_px, size_px = camera.project(place_m), np.array([camera.width_px, camera.height_px])
        low = np.clip(np.floor(center_px - reach_px), 0, size_px)
        high = np.clip(np.ceil(center_px + reach_px), 0, size_px)
        if not (high - low > 1.0).all():
            raise NotFound("the solution went astray, out of the image")
        return [int(edge) for edge in (*low, *high)]

    def _after(self, pose: tuple[np.ndarray, np.ndarray], step: np.ndarray,
               reach_px: float) -> tuple[np.ndarray, np.ndarray]:
        """The pose after a step of the spacecraft, which is shortened to what derivatives reach."""
        after = self._stepped(pose, step)
        if (size_px := self._size_px(pose, after)) > reach_px:
            after = self._stepped(pose, step * reach_px / size_px)
        return after

    def _stepped(self, pose: tuple[np.ndarray, np.ndarray], step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        camera_from_body, place_m = pose
        turn = Rotation.from_rotvec(-np.append(step, np.zeros(3))[3:6]).as_matrix()
        mounted_m = self._mounted_m
        return turn @ camera_from_body, turn @ (place_m + mounted_m - step[:3]) - mounted_m

    @property
    def _mounted_m(self) -> np.ndarray:
        """The camera's place (3,) [m] about the spacecraft's origin, which it turns about, in `camera`."""
        return Rotation.from_quat(self.camera.q_camera_from_spacecraft, scalar_first=True).apply(
            self.camera.r_camera_spacecraft_m)

    def _size_px(self, before: tuple[np.ndarray, np.ndarray], after: tuple[np.ndarray, np.ndarray]) -> float:
        """How far [px] a step moves centre and limb."""
        if not np.isfinite(after[1]).all() or not after[1][2] > 0.0:
            raise NotFound("the solution went astray")
        shift_px, scale = shift_between(self.camera, before[1], after[1])
        turn_rad = Rotation.from_matrix(after[0] @ before[0].T).magnitude()
        return shift_px + (scale + turn_rad) * self.camera.focal_length_px * self.body.mean_radius_m / after[1][2]

    def _found(self, pose: tuple[np.ndarray, np.ndarray], last: _Step) -> Measurement:
        """The measurement of a pose."""
        camera_from_body, place_m = pose
        by_place = np.hstack([-np.eye(3), _cross(place_m + self._mounted_m)])[:, :self._count]
        doubt = "" if not last.left > _USUALLY_LEFT else (
            f"{last.left:.1%} of the frame's light, by its square, is neither the predicted frame's nor noise, "
            f"{_USUALLY_LEFT:.1%} is usual: the believed attitude, shape or law may be wrong, or the match")
        found = replace(self.placed(place_m, by_place @ last.covariance @ by_place.T,
                                    max(last.left / _USUALLY_LEFT, 1.0)), doubt=doubt)
        if self._count == 3:
            return found
        by_pose = np.vstack([np.hstack([np.zeros((3, 3)), -np.eye(3)]), by_place])
        of_pose = by_pose @ last.covariance @ by_pose.T
        of_pose[3:, 3:] = found.covariance_m2
        return replace(found, pose_covariance=of_pose, q_camera_from_body=Rotation.from_matrix(
            camera_from_body).as_quat(scalar_first=True))


def _cross(vector: np.ndarray) -> np.ndarray:
    """The matrix (3, 3) of the vector product with a vector."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
