"""Direct alignment: the pose that lays a body's ground, of all pixels of the believed frame, on the frame's light."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from .believed import Drawn, blurred, grown
from .body import BelievedBody
from .camera import Camera
from .features import jacobian
from .measurement import N_STRETCHES, NotFound

# Light is compared less its mean nearby [px]: over larger areas relief that the belief lacks changes the law of light.
_NEAR_PX = 2.0
# Such relief moves the edges of shadows and the terminator: ground that is darker than a tenth of the brightest is left
# out, and what is within 2 px of it.
_DARK, _EDGE_PX = 0.1, 2
# It moves outlines outwards, and the light within 3 px of them.
_OUTLINE_PX = 3.0
# Light at the frame's border is left out [px].
_BORDER_PX = 4
# Steps of least squares [px], root mean square over the ground.
_ENOUGH_PX, _MOST_STEPS = 0.002, 40
# Pixels that are needed, and compared: more take memory.
_LEAST_USED, _MOST_USED = 500, 100_000
# The frame's contrast over the believed frame's, after exposure: less is other ground.
_LEAST_GAIN = 0.1
# Share of a height's square that moves ground along each axis of the image: at outlines, which count most.
_ACROSS = 0.5
# Parts of the region to each side, whose residuals count as independent.
_N_BLOCKS = 8


def aligned(frame: np.ndarray, drawn: Drawn, camera: Camera,
            body: BelievedBody) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rotation (3, 3) and place (3,) [m] of the body in `camera`, and their covariance (6, 6) [rad, m].

    Light on the ground stays as it is where only the camera moves, so that a pixel of the believed frame has its place
    in the frame by the camera's pose: least squares of the ground's light less its mean nearby, by the gradients of the
    believed frame, which has no noise. Solved for are the pose, gain, blur that the camera's point spread function
    lacks, and how far outlines lie outwards of the believed ones. Pixels of other light weigh less (Cauchy).

    Parameters
    ----------
    frame : (height, width) array
    drawn : Drawn
        With `r_body`, a pixel or two off at most.
    camera : Camera
    body : BelievedBody
        Its `shape_error_m` counts.

    Raises
    ------
    NotFound
        Too little ground is lit and inside the frame, or the frame's light is not the ground's.

    Source: Irani and Anandan (1999), All about direct methods; Engel, Koltun and Cremers (2018), Direct sparse
    odometry; Baker and Matthews (2004), Lucas-Kanade 20 years on; the covariance by Liang
    and Zeger (1986).
    """
    ground = _Ground(frame, drawn, camera)
    turn, place_m, covariance = ground.fitted(drawn.here.r_body_camera_m)
    shape_px2 = _ACROSS * (camera.focal_length_px * body.shape_error_m / place_m[2])**2
    return (turn.as_matrix() @ drawn.here.camera_from_body, place_m,
            covariance + shape_px2 / N_STRETCHES * ground.of_one_px())


class _Ground:
    """The lit ground of a believed frame, and the light of the frame."""

    def __init__(self, frame: np.ndarray, drawn: Drawn, camera: Camera):
        (x, y), (height, width) = drawn.corner_px, drawn.pixels.shape
        region = np.s_[y : y + height, x : x + width]
        is_inner = np.zeros(frame.shape, bool)
        is_inner[_BORDER_PX:-_BORDER_PX, _BORDER_PX:-_BORDER_PX] = True
        self._is_ground = is_ground = np.isfinite(drawn.products["r_body"][..., 0])
        is_own = is_ground & drawn.is_clear & is_inner[region]
        top = np.quantile(drawn.pixels[is_own], 0.999) if is_own.any() else np.inf
        self._is_used = is_own & ~grown(is_ground & (drawn.pixels < _DARK * top), _EDGE_PX)
        if (n_used := np.count_nonzero(self._is_used)) < _LEAST_USED:
            raise NotFound(f"{n_used} pixels of the believed frame are lit ground inside the frame, {_LEAST_USED} are "
                           "needed")
        self._mask = self._is_used.astype(np.float32)
        self._spread = np.maximum(blurred(self._mask, _NEAR_PX), 1e-3)
        light = np.asarray(frame, np.float32) - np.float32(np.quantile(frame[::4, ::4], 0.05))
        sums = [max(float(image[self._is_used].sum()), 1e-30) for image in (light[region], drawn.pixels)]
        self._light, self._drawn = light / sums[0], drawn.pixels / sums[1]
        self._camera, self._arms_m = camera, drawn.products["r_body"][self._is_used] @ drawn.here.camera_from_body.T
        self._every = np.s_[:: n_used // _MOST_USED + 1]
        self._by_pose = jacobian(camera.focal_length_px, self._arms_m[self._every], drawn.here.r_body_camera_m)

    def fitted(self, place_m: np.ndarray) -> tuple[Rotation, np.ndarray, np.ndarray]:
        """Turn, place (3,) [m] and their covariance (6, 6) by the residuals, from where the body is drawn.

        Raises
        ------
        NotFound
        """
        gradients = [cv2.Sobel(self._drawn, cv2.CV_32F, *order, scale=0.125) for order in ((1, 0), (0, 1))]
        moves = np.einsum("kn,nki->in", [self._local(each) for each in gradients], self._by_pose.reshape(-1, 2, 6))
        template, turn, looks = self._looks(*gradients), Rotation.identity(), np.array([1.0, 0.0, 0.0])
        for _ in range(_MOST_STEPS):
            left = self._local(self._seen(turn, place_m)) - looks @ template
            rows = np.concatenate([looks[0] * moves, -template])
            # Where no outline is in the light, nothing says how far it has moved.
            rows = rows if rows[-1].any() else rows[:-1]
            weights = 1.0 / (1.0 + (left / (1.4826 * np.median(np.abs(left)) + 1e-30))**2)
            inverse = np.linalg.inv(weights * rows @ rows.T)
            step = -inverse @ (rows @ (weights * left))
            turn, place_m = Rotation.from_rotvec(step[:3]) * turn, place_m + step[3:6]
            looks[:len(step) - 6] += step[6:]
            if not (looks[0] > _LEAST_GAIN and place_m[2] > 0.0):
                raise NotFound(f"the frame has {looks[0]:.2f} of the believed frame's contrast, {_LEAST_GAIN:g} is "
                               "needed")
            if np.sqrt(np.mean((self._by_pose @ step[:6])**2)) < _ENOUGH_PX:
                break
        return turn, place_m, (inverse @ self._spread_of(rows * weights * left) @ inverse)[:6, :6]

    def of_one_px(self) -> np.ndarray:
        """Covariance (6, 6) of a pose by a single pixel of ground, of the mean over all, that errs by 1 px."""
        return np.linalg.inv(self._by_pose.T @ self._by_pose) * len(self._by_pose) / 2.0

    def _local(self, image: np.ndarray) -> np.ndarray:
        """Light (N,) of the ground less the mean of the ground nearby."""
        light = image - blurred(image * self._mask, _NEAR_PX) / self._spread
        return light[self._is_used][self._every].astype(float)

    def _looks(self, right: np.ndarray, down: np.ndarray) -> np.ndarray:
        """Light (3, N) of the believed frame, and its change by blur [1/px2] and by outlines that are moved [1/px]."""
        # The sky around the region, so that ground which fills it has an end too.
        padded = np.pad(self._is_ground.astype(np.uint8), 1)
        inside_px, outside_px = (cv2.distanceTransform(mask, cv2.DIST_L2, 5)[1:-1, 1:-1]
                                 for mask in (padded, 1 - padded))
        normal = np.gradient(blurred(outside_px - inside_px, 1.0))
        outwards = np.where(inside_px <= _OUTLINE_PX, -right * normal[1] - down * normal[0], 0.0).astype(np.float32)
        images = self._drawn, cv2.Laplacian(self._drawn, cv2.CV_32F) / 2.0, outwards
        return np.stack([self._local(image) for image in images])

    def _seen(self, turn: Rotation, place_m: np.ndarray) -> np.ndarray:
        """The frame's light (h, w) at the pixels that the ground of the believed frame has by a pose."""
        at_px = np.zeros((*self._is_used.shape, 2), np.float32)
        at_px[self._is_used] = self._camera.project(turn.apply(self._arms_m) + place_m)
        return cv2.remap(self._light, at_px[..., 0], at_px[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)

    def _spread_of(self, scores: np.ndarray) -> np.ndarray:
        """Covariance (9, 9) of the sum of scores (9, N), which are alike over parts of the image."""
        rows, columns = (at[self._every] for at in np.nonzero(self._is_used))
        height, width = self._is_used.shape
        block = (rows * _N_BLOCKS // height) * _N_BLOCKS + columns * _N_BLOCKS // width
        parts = np.stack([np.bincount(block, score, _N_BLOCKS**2) for score in scores])
        return parts @ parts.T
