"""GeoTIFF: the places of a planet on a map, and the map's values there. Needs rasterio, which has GDAL and PROJ."""

from __future__ import annotations

import contextlib
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates

from ...base.errors import ShapeError

_ELLIPSOID = re.compile(r'(?:SPHEROID|ELLIPSOID)\["[^"]*",\s*([-+.\deE]+),\s*([-+.\deE]+)')
# Metres in the unit of a band of heights, of one or of several; most say none.
_METRES = {"": 1.0, "m": 1.0, "metre": 1.0, "meter": 1.0, "km": 1e3, "kilometre": 1e3, "kilometer": 1e3}
# The IAU's maps of an ellipsoid whose latitudes are about its centre, or whose longitudes run west: GDAL forgets both.
_OF_OTHER_DEGREES = re.compile(r'"([^"]*(?:[Oo]centric|/ Ographic)[^"]*)"')
# Numbers for no data: from that size on, the lowest of 16 bits; if none is named or scaled, customs, two for heights.
_HUGE, _LOWEST, _CUSTOM = 2.0**31, -2.0**15, (-9999.0, -99999.0, 2.0**15 - 1.0, 2.0**16 - 1.0)
# Longitudes and latitudes [deg], whose places show whether a map goes round its planet in equal steps.
_ROUND = np.array([[0.0, 1.0, 45.0, 46.0, 90.0], [0.0, 0.0, 60.0, 60.0, -30.0]])
# Pixels read in a turn, of 20 bytes; the most of a map; distance off it [px], and weight of a pixel, that are none.
_PX_AT_ONCE, _MOST_PX, _NONE = 1 << 23, 1 << 33, 1e-6


class Map:
    """A GeoTIFF on its planet; columns and rows count from 0 in the middle of the top-left pixel.

    Attributes
    ----------
    shape : (int, int) [px]
        Rows and columns.
    radii_m : (float, float) [m]
        Of its datum, at the equator and at the pole.
    turn_px : float [px]
        Columns of 360 deg; 0 of a projection without equal steps of longitude.
    is_round, is_mirrored : bool
        Whether its columns go round the planet; whether north is down where east is right.
    """

    def __init__(self, source: Any, field: str, rasterio: Any):
        self._source, self._field, self._rasterio, self.shape = source, field, rasterio, (source.height, source.width)
        found = None if source.crs is None else _ELLIPSOID.search(source.crs.to_wkt())
        # Steps along columns and rows, and the first pixel's corner, on the projection.
        self._steps, self._corner = np.hsplit(np.array(source.transform).reshape(3, 3)[:2], [2])
        if found is None or source.transform.is_identity or not np.linalg.det(self._steps):
            raise ShapeError(field, "must have a projection with its datum, and a place on it", source.name,
                             "write it with both, as by gdal_translate -a_srs ... -a_ullr ...")
        a_m, inverse_flattening = map(float, found.groups())
        if inverse_flattening and (other := _OF_OTHER_DEGREES.search(source.crs.to_wkt())):
            raise ShapeError(field, "must have longitudes east and latitudes along its ellipsoid's normal", other[1],
                             "gdalwarp -s_srs IAU_2015:... -t_srs '+proj=longlat +a=... +b=...' makes them")
        self.radii_m = a_m, a_m * (1.0 - 1.0 / inverse_flattening) if inverse_flattening else a_m
        self._degrees = rasterio.crs.CRS.from_proj4("+proj=longlat +a={!r} +b={!r} +no_defs".format(*self.radii_m))
        self.turn_px = self._columns_of_a_turn()
        self.is_round, self.is_mirrored = 0.0 < self.turn_px < source.width + 0.5, np.linalg.det(self._steps) > 0.0

    def _columns_of_a_turn(self) -> float:
        x, (per_column, per_row) = np.full(len(_ROUND[0]), np.nan), self._steps[0]
        with contextlib.suppress(ShapeError):
            x, _ = self._projected(*_ROUND)
        # The projection's edge may be between two of these places.
        step = min(x[1] - x[0], x[3] - x[2], key=abs)
        turns = (x - x[0] - step * _ROUND[0]) / (360.0 * step or np.nan)
        turn = abs(360.0 * step) if np.abs(turns - np.round(turns)).max() < _NONE else 0.0
        if per_row and 0.0 < turn < (self.shape[0] + 0.5) * abs(per_row):
            raise ShapeError(self._field, "must go round its planet along its rows", per_row, "gdalwarp turns it")
        return turn / abs(per_column) if per_column else 0.0

    def _projected(self, x: np.ndarray, y: np.ndarray, is_back: bool = False) -> np.ndarray:
        """The map's coordinates (2, N) of longitudes and latitudes (N,) [deg], or the other way."""
        ends = (self._degrees, self._source.crs)
        try:
            return np.array(self._rasterio.warp.transform(*(ends[::-1] if is_back else ends), x, y))
        except Exception as error:  # GDAL's errors have no public class
            raise ShapeError(self._field, f"has a projection that does not show all of the ground: {error}",
                             self._source.name, "give a site and near rings, or a projection about them") from None

    def pixels(self, degrees: np.ndarray) -> np.ndarray:
        """Columns and rows (2, N) float64 [px] of longitudes and latitudes (2, N) [deg]."""
        column, row = np.linalg.solve(self._steps, self._projected(*degrees) - self._corner) - 0.5
        if self.turn_px:
            column -= self.turn_px * np.round((column + 0.5 - 0.5 * self.shape[1]) / self.turn_px)
        return np.stack([column, row])

    def degrees(self, pixel: np.ndarray) -> np.ndarray:
        """Longitudes and latitudes (2, N) float64 [deg] of columns and rows (2, N) [px]."""
        return self._projected(*(self._steps @ (pixel + 0.5) + self._corner), is_back=True)

    @property
    def reach(self) -> str:
        """The longitudes and latitudes of its edges, in words."""
        edges = self._rasterio.warp.transform_bounds(self._source.crs, self._degrees, *self._source.bounds)
        return "{0:.6g} to {2:.6g} deg east, {1:.6g} to {3:.6g} deg north".format(*edges)

    def has(self, pixel: np.ndarray) -> np.ndarray:
        """Whether columns and rows (2, N) [px] are on it: (N,) bool; for the poles a pixel off, where it is round."""
        half, more = 0.5 * np.array([self.shape[::-1]]).T, [[np.inf], [1.0 + _NONE]] if self.is_round else _NONE
        return (np.abs(pixel + 0.5 - half) <= half + more).all(axis=0)

    def heights_m(self, pixel: np.ndarray) -> np.ndarray:
        """Heights (N,) float64 [m] above the datum at columns and rows (2, N) [px], bilinear; NaN where it has none."""
        source, unit, (n_rows, n_columns) = self._source, (self._source.units[0] or "").lower().rstrip("s"), self.shape
        if source.count != 1 or unit not in _METRES:
            raise ShapeError(self._field, "must have one band, of heights in m or km",
                             f"{source.count}, in {unit or 'm'}", "gdal_translate -b takes one out, -scale converts it")
        found, on = np.full(pixel.shape[1], np.nan), np.flatnonzero(self.has(pixel))
        on = on[np.argsort(pixel[1, on], kind="stable")]
        x, y, begin = pixel[0, on], np.clip(pixel[1, on], 0.0, n_rows - 1.0), 0
        x = x % n_columns if self.is_round else np.clip(x, 0.0, n_columns - 1.0)
        left, right = (0, n_columns) if self.is_round else (
            int(x.min(initial=n_columns)), min(int(x.max(initial=0.0)) + 2, n_columns))
        if len(on) and np.ptp(y) * (right - left) > _MOST_PX:
            raise ShapeError(self._field, f"must have at most {_MOST_PX} pixels under the ground", self.shape,
                             "cut it out, or make it coarser, by gdal_translate")
        while begin < len(on):
            bottom = (top := int(y[begin])) + max(_PX_AT_ONCE // (right - left), 1)
            part = slice(begin, begin := int(np.searchsorted(y, bottom)))
            values = self._read(1, (top, min(bottom + 1, n_rows)), (left, right))[0]
            is_none, place = ~np.isfinite(values), (y[part] - top, x[part] - left)
            found[on[part]] = map_coordinates(np.where(is_none, 0.0, values), place, order=1, mode="grid-wrap")
            weight = map_coordinates(is_none.astype(np.float32), place, order=1, mode="grid-wrap")
            found[on[part][weight > _NONE]] = np.nan
        return _METRES[unit] * found

    def grey(self, pixel: np.ndarray, most_px: int) -> tuple[np.ndarray, np.ndarray]:
        """Grey values (H, W) over their full scale around columns and rows (2, N) [px], NaN for none; these in it."""
        if not (on := self.has(pixel)).any():
            raise ShapeError(self._field, "must show some of the ground", self._source.name, "its edges are elsewhere")
        source, begin = self._source, np.maximum(pixel[:, on].min(axis=1).astype(int), 0)
        size = np.minimum(pixel[:, on].max(axis=1).astype(int) + 2, self.shape[::-1]) - begin
        drawn, (right, bottom) = np.maximum((size * min(1.0, most_px / size.max())).astype(int), 1), begin + size
        if source.colorinterp[0].name == "palette":
            raise ShapeError(self._field, "must have grey values or colours, and no palette", source.name,
                             "unfold it by gdal_translate -expand gray")
        grey = self._read(3 if source.count > 2 else 1, (begin[1], bottom), (begin[0], right), drawn[::-1]).mean(axis=0)
        if (kind := np.dtype(source.dtypes[0])).kind in "iu" and (source.scales[0], source.offsets[0]) == (1.0, 0.0):
            bits = source.tags(1, ns="IMAGE_STRUCTURE").get("NBITS", np.iinfo(kind).max.bit_length())
            grey /= 2.0 ** int(bits) - 1.0
        return np.where(grey >= 0.0, grey, np.nan), ((pixel + 0.5).T - begin).T * (drawn / size)[:, None] - 0.5

    def _read(self, n: int, rows: tuple[int, int], columns: tuple[int, int], size: Any = None) -> np.ndarray:
        """Scaled values (n, H, W) float64 of rows and columns, NaN for no data; means, where the size is less."""
        made = self._source.read(list(range(1, n + 1)), window=(rows, columns), masked=True,
                                 resampling=self._rasterio.enums.Resampling.average,
                                 out_shape=None if size is None else (n, *size))
        scales, offsets = (np.array(each[:n])[:, None, None] for each in (self._source.scales, self._source.offsets))
        customs = _CUSTOM[:4 if size is None else 2] if self._source.nodata is None and (scales == 1.0).all() else ()
        is_none = (made <= -_HUGE) | ((made >= _HUGE) & (made < np.inf))
        is_none |= np.logical_or.reduce([made == each for each in (_LOWEST, *customs)])
        if np.ma.any(is_none):
            raise ShapeError(self._field, "must name its number for no data: some pixels have one that is customary",
                             made[np.ma.filled(is_none, False)][0], "gdal_edit.py -a_nodata writes it, or another")
        return np.ma.filled(made.astype(np.float64), np.nan) * scales + offsets


@contextlib.contextmanager
def opened(path: Path, field: str) -> Iterator[Map]:
    """A GeoTIFF that a field names, and no other of GDAL's formats: some lead to other files."""
    try:
        import rasterio.warp
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
            source = rasterio.open(path, driver="GTiff")
        with source:
            yield Map(source, field, rasterio)
    except ImportError:
        raise ShapeError(field, "needs rasterio, which is missing", hint="pip install \"glrender[terrain]\"") from None
    except rasterio.errors.RasterioError as error:
        raise ShapeError(field, f"is no readable GeoTIFF: {error}", str(path),
                         "it may be cut off, or of another format, of which gdal_translate makes a GeoTIFF") from None
