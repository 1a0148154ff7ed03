"""From an undistorted, oversampled image to the frame of a lens that distorts: light is moved, none is made."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from .distortion import BrownConrady
from .errors import ConfigError
from .projection import PinholeCamera
from .validate import integer, positive

# Between the frame's edge and what is rendered: a cell's width and its neighbour's.
_RIM_PX = 2
_BAND_ROWS = 32


class DistortingLens:
    """A camera's frame behind its distortion, and the pinhole camera to render for it.

    Each cell of the rendered image is moved to its distorted place, stretched by the Jacobian there,
    and shared out by area to the pixels that it covers, at most four. All of its light arrives: a
    point source keeps its flux wherever it falls. An evenly bright sky comes out as each distorted
    pixel's own solid angle.

    Parameters
    ----------
    camera : PinholeCamera
        Of the frame; its focal length and principal point are those of the distortion's model.
    distortion : BrownConrady
    oversampling : int, 1..8
        Cells per pixel and axis in the rendered image. A cell must stay smaller than a pixel.
    magnification : float [1], > 0
        Scale of the image about the principal point: of one colour over another's (lateral
        chromatic aberration). Default 1.

    Raises
    ------
    ConfigError
        Where the frame sees beyond the radius at which the model folds over, with the radius; or
        where a cell is stretched beyond a pixel.
    """

    def __init__(self, camera: PinholeCamera, distortion: BrownConrady, oversampling: int = 2,
                 magnification: float = 1.0):
        self.camera = camera
        self.distortion = distortion
        self.oversampling = integer("oversampling", oversampling, 1, 8)
        self.magnification = positive("magnification", magnification)
        self.source = self._source()

    def _source(self) -> PinholeCamera:
        """The pinhole camera that sees all that the frame sees, its cells a fraction of a pixel."""
        width, height = self.camera.width_px, self.camera.height_px
        x, y = np.arange(-_RIM_PX, width + _RIM_PX), np.arange(-_RIM_PX, height + _RIM_PX)
        border = np.concatenate([np.stack(np.broadcast_arrays(x, edge), axis=-1) for edge in (y[0], y[-1])]
                                + [np.stack(np.broadcast_arrays(edge, y), axis=-1) for edge in (x[0], x[-1])])
        seen = self.undistort(border)
        if np.isnan(seen).any():
            # Where the edge is the image of nothing, the radius that it would need is beyond the fold.
            self.distortion.require_field(np.inf)
        self.distortion.require_field(float(np.hypot(*seen.T).max()))
        place = seen * self.camera.focal_length_px + np.array(self.camera.principal_point_px)
        low, high = np.floor(place.min(axis=0)).astype(int), np.ceil(place.max(axis=0)).astype(int)
        n = self.oversampling
        # Cell centres: pixel p holds the cells p - 1/2 + (k + 1/2) / n.
        principal = n * (np.array(self.camera.principal_point_px) - low) + 0.5 * (n - 1)
        size = n * (high - low + 1)
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

    def apply(self, image: np.ndarray) -> np.ndarray:
        """The distorted frame.

        Parameters
        ----------
        image : (h, w) float32 [W/m2]
            Irradiance from each cell's solid angle, as rendered for `source`.

        Returns
        -------
        (H, W) float32 [W/m2]
        """
        shape = self.source.height_px, self.source.width_px
        if np.shape(image) != shape:
            raise ConfigError("irradiance_W_m2", f"must have shape {shape}, the source's", np.shape(image))
        moved = self._weights @ np.asarray(image, np.float32).ravel()
        return moved.reshape(self.camera.height_px, self.camera.width_px)

    @cached_property
    def _weights(self) -> csr_array:
        """Share of each cell's light that each pixel gets: (H W, h w) float32."""
        source, camera = self.source, self.camera
        x = (np.arange(source.width_px) - source.principal_point_px[0]) / source.focal_length_px
        y = (np.arange(source.height_px) - source.principal_point_px[1]) / source.focal_length_px
        # A band of rows at a time: what is in the cache is fast.
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
        jacobian = self.distortion.jacobian(cells[used]) * (self.magnification / self.oversampling)
        # Upright rectangles of the cell's area tile the plane without gaps where the map is affine.
        wide, lean, rise, high = jacobian.reshape(-1, 4).T
        size = np.stack([wide, high - lean * rise / wide], axis=-1)
        if not (size <= 1.0).all():
            raise ConfigError("oversampling", f"a cell is stretched to {size.max():.4g} pixels, must be <= 1",
                              self.oversampling, "oversample more")
        if not used.size:
            return np.empty(0, np.int32), np.empty(0, np.int32), np.empty(0, np.float32)
        low = np.rint(place - 0.5 * size).astype(np.int64)
        # Of each axis: the part of the cell before the boundary between two pixels.
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
