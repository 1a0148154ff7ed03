"""From an undistorted, oversampled image to the frame of a lens that distorts: light is moved, none is made."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property, lru_cache

import numpy as np
from scipy.sparse import csr_array

from .distortion import BrownConrady, frame_border
from .errors import ConfigError
from .projection import MAX_IMAGE_PX, PinholeCamera
from .validate import integer, positive

# Cells rendered beyond the frame's edge: one, and its neighbour for interpolation.
_RIM_PX = 2
_BAND_ROWS = 32
_MAX_OVERSAMPLING = 8
# Places along the frame's sides where the lens's largest magnification is looked for.
_STRETCH_NODES = 65


class DistortingLens:
    """A camera's frame behind its distortion, and the pinhole camera to render for it.

    Each cell of the rendered image is moved to its distorted place, stretched by the Jacobian there,
    and shared out by area to the pixels that it covers, at most four. All of its light arrives: a
    point source keeps its flux wherever it falls. An evenly bright sky comes out as each distorted
    pixel's own solid angle.

    Parameters
    ----------
    camera : PinholeCamera
        Camera of the frame; its focal length and principal point are those of the distortion's model.
    distortion : BrownConrady
    oversampling : int, 1..8, optional
        Cells per pixel and axis in the rendered image. A cell must stay smaller than a pixel; by default the
        least from 2 on with which it does.
    magnification : float [1], > 0
        Scale of the image about the principal point: of one colour over another's (lateral
        chromatic aberration). Default 1.

    Raises
    ------
    ConfigError
        Where the frame sees beyond the radius at which the model folds over, with the radius; or
        where a cell is stretched beyond a pixel.
    """

    def __init__(self, camera: PinholeCamera, distortion: BrownConrady, oversampling: int | None = None,
                 magnification: float = 1.0):
        self.camera = replace(camera, distortion=None)
        self.distortion = distortion
        self.magnification = positive("magnification", magnification)
        self.oversampling = (self._least_oversampling() if oversampling is None
                             else integer("oversampling", oversampling, 1, _MAX_OVERSAMPLING))
        self.source = self._source()

    def _least_oversampling(self) -> int:
        """Least number of cells a pixel, from 2 on, with which no cell is stretched beyond a pixel."""
        x, y = (np.linspace(-_RIM_PX, size - 1 + _RIM_PX, _STRETCH_NODES)
                for size in (self.camera.width_px, self.camera.height_px))
        seen = self.undistort(np.stack(np.broadcast_arrays(x, y[:, None]), axis=-1).reshape(-1, 2))
        self.distortion.require_seen(seen)
        stretch = float(self._sizes(seen, 1).max())
        # A per cent more, as the nodes may miss the most stretched place.
        least = max(2, math.ceil(1.01 * stretch))
        if least > _MAX_OVERSAMPLING:
            raise ConfigError("distortion", f"must magnify by at most {_MAX_OVERSAMPLING}, magnifies by", stretch)
        return least

    def _sizes(self, cells: np.ndarray, oversampling: int) -> np.ndarray:
        """Width and height [px] of cells at undistorted places (N, 2) [1], as upright rectangles of their area.

        These tile the plane without gaps where the map is affine.
        """
        jacobian = self.distortion.jacobian(cells) * (self.magnification / oversampling)
        wide, lean, rise, high = jacobian.reshape(-1, 4).T
        return np.stack([wide, high - lean * rise / wide], axis=-1)

    def _source(self) -> PinholeCamera:
        """The pinhole camera that sees all that the frame sees, its cells a fraction of a pixel."""
        seen = self.undistort(frame_border(self.camera.width_px, self.camera.height_px, _RIM_PX))
        self.distortion.require_seen(seen)
        place = seen * self.camera.focal_length_px + np.array(self.camera.principal_point_px)
        low, high = np.floor(place.min(axis=0)).astype(int), np.ceil(place.max(axis=0)).astype(int)
        n = self.oversampling
        # Cell centres: pixel p holds the cells p - 1/2 + (k + 1/2) / n.
        principal = n * (np.array(self.camera.principal_point_px) - low) + 0.5 * (n - 1)
        size = n * (high - low + 1)
        if size.max() > MAX_IMAGE_PX:
            raise ConfigError("distortion", f"must be drawn on at most {MAX_IMAGE_PX} cells a side, {n} a pixel, needs",
                              int(size.max()), "give the camera fewer pixels")
        return replace(self.camera, width_px=int(size[0]), height_px=int(size[1]),
                       focal_length_px=n * self.camera.focal_length_px, principal_point_px=tuple(principal), model=None)

    def distort(self, xy: np.ndarray) -> np.ndarray:
        """Undistorted normalised coordinates (..., 2) [1] to places in the frame (..., 2) [px]; NaN beyond the fold."""
        return (self.distortion.distort(xy) * (self.magnification * self.camera.focal_length_px)
                + np.array(self.camera.principal_point_px))

    def undistort(self, pixel: np.ndarray) -> np.ndarray:
        """Places in the frame (..., 2) [px] to undistorted normalised coordinates (..., 2) [1], or NaN."""
        offset = np.asarray(pixel, np.float64) - np.array(self.camera.principal_point_px)
        return self.distortion.undistort(offset / (self.magnification * self.camera.focal_length_px))

    @cached_property
    def cos_field_angle(self) -> np.ndarray:
        """Foreshortening of the aperture from each pixel's direction: (H, W) float32 [1]."""
        y, x = np.indices((self.camera.height_px, self.camera.width_px))
        seen = self.undistort(np.stack([x, y], axis=-1))
        return (1.0 / np.sqrt(1.0 + np.sum(seen**2, axis=-1))).astype(np.float32)

    def reached_box(self, box: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
        """The part of the frame, x0, y0, x1, y1 [px], that light from a part of the rendered image reaches."""
        x0, y0, x1, y1 = box
        if x0 >= x1 or y0 >= y1:
            return 0, 0, 0, 0
        corner = np.array([x0, y0]) - 0.5 - np.array(self.source.principal_point_px)
        around = (frame_border(x1 - x0 + 1, y1 - y0 + 1) + corner) / self.source.focal_length_px
        place = self.distort(around)
        if np.isnan(place).any():
            return 0, 0, self.camera.width_px, self.camera.height_px
        limits = np.array([self.camera.width_px, self.camera.height_px])
        low = np.clip(np.floor(place.min(axis=0)).astype(int) - 1, 0, limits)
        high = np.clip(np.ceil(place.max(axis=0)).astype(int) + 2, 0, limits)
        return int(low[0]), int(low[1]), int(high[0]), int(high[1])

    def apply(self, image: np.ndarray, box: tuple[int, int, int, int] | None = None) -> np.ndarray:
        """The distorted frame.

        Parameters
        ----------
        image : (h, w) float32 [W/m2]
            Irradiance from each cell's solid angle, as rendered for `source`.
        box : (x0, y0, x1, y1) int [px], optional
            A promise that it is dark outside columns x0..x1-1 and rows y0..y1-1: it saves time.

        Returns
        -------
        (H, W) float32 [W/m2]
        """
        shape = self.source.height_px, self.source.width_px
        if np.shape(image) != shape:
            raise ConfigError("irradiance_W_m2", f"must have shape {shape}, the source's", np.shape(image))
        height, width = self.camera.height_px, self.camera.width_px
        _, top, _, bottom = (0, 0, width, height) if box is None else self.reached_box(box)
        frame = np.zeros((height, width), np.float32)
        if top < bottom:
            weights = self._weights
            first, last = weights.indptr[[top * width, bottom * width]]
            rows = csr_array((weights.data[first:last], weights.indices[first:last],
                              weights.indptr[top * width:bottom * width + 1] - first),
                             shape=((bottom - top) * width, weights.shape[1]))
            frame[top:bottom] = (rows @ np.asarray(image, np.float32).ravel()).reshape(bottom - top, width)
        return frame

    def prepare(self) -> None:
        """Prepare what the first frame would wait for: 2.5 s a megapixel."""
        self._weights  # noqa: B018 (a cached property)

    @cached_property
    def _weights(self) -> csr_array:
        """Share of each cell's light that each pixel gets: (H W, h w) float32."""
        source, camera = self.source, self.camera
        x = (np.arange(source.width_px) - source.principal_point_px[0]) / source.focal_length_px
        y = (np.arange(source.height_px) - source.principal_point_px[1]) / source.focal_length_px
        # A band of rows at a time stays in the cache.
        parts = [self._band(x, y[row:row + _BAND_ROWS], row * x.size) for row in range(0, y.size, _BAND_ROWS)]
        rows, columns, shares = (np.concatenate([part[i] for part in parts]) for i in range(3))
        return csr_array((shares, (rows, columns)), shape=(camera.width_px * camera.height_px, x.size * y.size))

    def _band(self, x: np.ndarray, y: np.ndarray, first_cell: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pixels, cells and shares of the cells at the normalised coordinates x and y."""
        camera = self.camera
        cells = np.stack(np.broadcast_arrays(x, y[:, None]), axis=-1).reshape(-1, 2)
        place = self.distort(cells)
        used = np.flatnonzero(((place > -1.5) & (place < (camera.width_px + 0.5, camera.height_px + 0.5))).all(axis=1))
        place = place[used]
        size = self._sizes(cells[used], self.oversampling)
        if not (size <= 1.0).all():
            raise ConfigError("oversampling", f"a cell is stretched to {size.max():.4g} pixels, must be <= 1",
                              self.oversampling, "oversample more")
        if not used.size:
            return np.empty(0, np.int32), np.empty(0, np.int32), np.empty(0, np.float32)
        low = np.rint(place - 0.5 * size).astype(np.int64)
        # The part of the cell, along each axis, before the boundary between two pixels.
        before = np.clip((low + 0.5 - (place - 0.5 * size)) / size, 0.0, 1.0)
        rows, columns, shares = [], [], []
        for dy in (0, 1):
            for dx in (0, 1):
                column, row = low[:, 0] + dx, low[:, 1] + dy
                share = (before[:, 0] if dx == 0 else 1.0 - before[:, 0]) * (
                    before[:, 1] if dy == 0 else 1.0 - before[:, 1])
                kept = np.flatnonzero((share > 0.0) & (column >= 0) & (column < camera.width_px)
                                      & (row >= 0) & (row < camera.height_px))
                rows.append((row[kept] * camera.width_px + column[kept]).astype(np.int32))
                columns.append((used[kept] + first_cell).astype(np.int32))
                shares.append(share[kept].astype(np.float32))
        return np.concatenate(rows), np.concatenate(columns), np.concatenate(shares)


@lru_cache(maxsize=16)
def lens_of(camera: PinholeCamera) -> DistortingLens | None:
    """The lens of a camera that distorts, made once; None of one that does not."""
    return None if camera.distortion is None else DistortingLens(camera, camera.distortion)
