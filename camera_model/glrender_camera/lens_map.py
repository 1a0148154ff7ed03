"""The image of a camera whose lens distorts, as a map of the plane: to places in the image and back, and its areas."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from . import lens_loops
from .distortion import BrownConrady, frame_border

# Places along each side of the frame, or of a box, at which the map is looked at.
_NODES = 17
# Pixels around the frame that the map holds for: bilinear neighbours of its edge.
_RIM_PX = 2
# Distance [px] by which the image of a straight line may leave a straight line.
_MOST_BENT_PX = 0.01
# Shortest line [px] that is looked at for its bend.
_SHORTEST_PX = 0.25
# Step [1/rim] of the differences that give the map's second derivative.
_STEP = 1e-4


class LensMap:
    """The map from X / Z, Y / Z in `camera` to places in the image of a camera that distorts.

    It is that of the camera's distortion in the circle around all that the frame sees, and goes on straight beyond, so
    that each direction before the camera has a place, and none from beyond has one in the frame.

    Parameters
    ----------
    distortion : BrownConrady
    size_px : (int, int) [px]
        Width and height of the frame.
    focal_length_px : float [px]
    principal_point_px : (2,) float [px]

    Attributes
    ----------
    stretch : float [1]
        The largest factor by which the frame magnifies a length.
    straight_px : float [px]
        The length in the image up to which straight lines stay straight to a hundredth of a pixel.
    """

    def __init__(self, distortion: BrownConrady, size_px: tuple[int, int], focal_length_px: float,
                 principal_point_px: tuple[float, float]):
        self._distortion, self._size_px, self._focal_length_px = distortion, size_px, focal_length_px
        self._principal_point_px = np.array(principal_point_px, float)
        border = self.normalised(frame_border(*size_px, _RIM_PX))
        most, reach = distortion.max_radius, float(np.nanmax(np.hypot(*border.T)))
        self._lens = distortion.numbers(min(1.001 * reach, 0.5 * (reach + most)))
        self.stretch, self.straight_px = self._extremes()

    def _extremes(self) -> tuple[float, float]:
        rim, (x, y) = self._lens[9], (np.linspace(-0.5, size - 0.5, _NODES) for size in self._size_px)
        xy = self.normalised(np.stack(np.broadcast_arrays(x, y[:, None]), axis=-1).reshape(-1, 2))
        xy = xy[np.hypot(*xy.T) < (1.0 - 2.0 * _STEP) * rim]
        jacobian, step = self._distortion.jacobian(xy), _STEP * rim
        curved = sum(((self._distortion.jacobian(xy + aside) - self._distortion.jacobian(xy - aside))
                      / (2.0 * step)) ** 2 for aside in step * np.eye(2)).sum(axis=(1, 2))
        least, most = np.linalg.svd(jacobian, compute_uv=False).T[::-1]
        # A line of a length l bends by the second derivative times l^2 / 8.
        bend_per_px = float((np.sqrt(curved) / least**2).max()) / self._focal_length_px
        return float(most.max()), max(math.sqrt(8.0 * _MOST_BENT_PX / max(bend_per_px, 1e-300)), _SHORTEST_PX)

    def places_px(self, xy: np.ndarray) -> np.ndarray:
        """Places (2, N) float64 [px] of X / Z, Y / Z (2, N) [1]."""
        found = np.empty((2, xy.shape[1]))
        lens_loops.distort(xy, self._lens, found)
        found *= self._focal_length_px
        found += self._principal_point_px[:, None]
        return found

    def normalised(self, pixel: np.ndarray) -> np.ndarray:
        """X / Z, Y / Z (N, 2) float64 [1] of places in the image (N, 2) [px]; NaN where no direction is imaged."""
        return self._distortion.undistort((pixel - self._principal_point_px) / self._focal_length_px)

    def most_bent_px(self, sides_px: np.ndarray) -> np.ndarray:
        """Distance (N,) [px] by which images of lines between corners of boxes, of sides (2, N) [px], leave them."""
        long_px = np.hypot(*sides_px)
        return np.minimum(_MOST_BENT_PX * (long_px / self.straight_px) ** 2, long_px)

    def area_scales(self, xy: np.ndarray) -> np.ndarray:
        """Areas (N,) float64 [1] that the lens makes of an area 1 at X / Z, Y / Z (2, N) [1]."""
        found = np.empty(xy.shape[1])
        lens_loops.area_scales(xy, self._lens, found)
        return found

    def solid_angles(self, xy: np.ndarray) -> np.ndarray:
        """Solid angles (N,) float64 of pixels at X / Z, Y / Z (2, N) [1], over that on the boresight without a lens."""
        return (1.0 + xy[0] ** 2 + xy[1] ** 2) ** -1.5 / self.area_scales(xy)

    @cached_property
    def pixels_solid_angles(self) -> np.ndarray:
        """The same of all pixels, (height, width)."""
        x = np.arange(self._size_px[0], dtype=np.float64)
        # A row at a time: all at once would take many times the frame's memory.
        return np.array([self.solid_angles(self.normalised(np.stack(np.broadcast_arrays(x, float(row)), axis=-1)).T)
                         for row in range(self._size_px[1])])

    def box_px(self, xy: np.ndarray) -> np.ndarray:
        """Box (4,) float64 [px], x0, y0, x1, y1, around the image of the convex hull of X / Z, Y / Z (2, N) [1]."""
        sides = [np.linspace(low, high, _NODES) for low, high in zip(xy.min(axis=1), xy.max(axis=1), strict=True)]
        around = np.array(np.meshgrid(*sides)).reshape(2, -1)
        image, flat = self.places_px(around), self.places_px(xy)
        # The image of a line between corners leaves the box of theirs by no more than twice the map's distance from a
        # linear one; and it is within the image of the corners' box, up to how that bends between two of its nodes.
        centred = around - around.mean(axis=1, keepdims=True)
        centred /= np.maximum(np.abs(centred).max(axis=1, keepdims=True), 1e-300)
        terms = np.concatenate([centred, np.ones((1, around.shape[1]))])
        linear = np.linalg.lstsq(terms.T, image.T, rcond=None)[0].T @ terms
        bent = np.abs(image - linear).max(axis=1)
        low = np.maximum(flat.min(axis=1) - 2.0 * bent, image.min(axis=1) - bent / _NODES)
        high = np.minimum(flat.max(axis=1) + 2.0 * bent, image.max(axis=1) + bent / _NODES)
        return np.concatenate([low, high])

    def unevenness_per_px(self, box_px: np.ndarray) -> float:
        """Largest relative change of the pixels' solid angle from one to the next [1/px] in the frame's part of a box.

        Of none the change at the frame's nearest place.
        """
        size = np.array(self._size_px)
        low, high = np.clip(np.reshape(box_px, (2, 2)), 0.5, np.maximum(size - 1.5, 0.5))
        nodes = np.stack(np.meshgrid(*np.linspace(low, high, 5).T), axis=-1).reshape(-1, 2)
        changes = [np.log(self.solid_angles(self.normalised(nodes + aside).T)
                          / self.solid_angles(self.normalised(nodes - aside).T)) for aside in 0.5 * np.eye(2)]
        return float(np.hypot(*changes).max())
