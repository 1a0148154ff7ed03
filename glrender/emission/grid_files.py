"""Density grids on disk: glrender's own .npz, NumPy arrays, and OpenEXR tile sheets as ComaCreator writes for SISPO.

An .npz holds `density` (n_x, n_y, n_z), and its box as `low_m` and `high_m` (3,) [m] from the body's origin.

A tile sheet is a JSON file that names an OpenEXR image: `tiles_file`, `resolution` n, `tiles_x`, `tiles_y`, and
the box's sides `dimensions` [km] about the body's origin. Slice i of x is the tile in row i // tiles_x and column
i % tiles_x; in it, rows are y and columns z. Gas is the image's blue channel, dust its green (OpenCV writes them as
its first and second), each scaled to a largest value of 1.

Source: SISPO-developers/ComaCreator, src/ToBlender/convert_to_exr.pyx (read for the format; no code taken).
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from glrender_camera.validate import integer, one_of, positive, vector

from ..base.errors import ConfigError, DeviceError

MAX_CELLS = 256**3
# Largest array [bytes]: float64, and its header.
_MAX_ARRAY_BYTES = 8 * MAX_CELLS + 4096
CHANNELS = {"dust": "G", "gas": "B"}


@dataclass(frozen=True, kw_only=True, eq=False)
class Grid:
    """Densities (n_x, n_y, n_z) float32 in a box [m]."""

    density: np.ndarray
    low_m: np.ndarray
    high_m: np.ndarray


def read_grid(path: Path, channel: str = "dust", locate: Callable[[str], Path] | None = None) -> Grid:
    """A grid from `.npz` or a tile sheet's `.json`.

    Parameters
    ----------
    path : path
    channel : {"dust", "gas"}
        Of a tile sheet.
    locate : callable, optional
        Bare name of the sheet's image to its path; by default in the JSON file's folder.

    Raises
    ------
    ConfigError
        The file is missing or not such a grid.
    DeviceError
        A tile sheet, and OpenEXR is not installed.
    """
    path = Path(path)
    if path.suffix == ".npz":
        return _read_npz(path)
    if path.suffix == ".json":
        return _read_tile_sheet(path, channel, locate or (lambda name: path.parent / name))
    raise ConfigError("", "must be a .npz, or a .json of a tile sheet", str(path))


def write_grid(path: Path, grid: Grid) -> None:
    """Write an `.npz`."""
    np.savez_compressed(path, density=np.asarray(grid.density, np.float32), low_m=grid.low_m, high_m=grid.high_m)


def _read_npz(path: Path) -> Grid:
    try:
        with np.load(path, allow_pickle=False) as file:
            # A few bytes may unpack to any number of bytes.
            unpacked = max((member.file_size for member in file.zip.infolist()), default=0)
            if unpacked > _MAX_ARRAY_BYTES:
                raise ConfigError("density", f"must be at most {MAX_CELLS} cells", hint=f"{unpacked} bytes: {path}")
            arrays = {name: file[name] for name in ("density", "low_m", "high_m")}
    except ConfigError:
        raise
    except KeyError as error:
        raise ConfigError("", f"lacks the array {error.args[0].split()[0]}", str(path)) from None
    except (OSError, ValueError, EOFError) as error:
        raise ConfigError("", f"is no readable .npz: {error}", str(path)) from None
    except Exception as error:  # a broken archive raises zipfile's and zlib's own
        raise ConfigError("", f"is no readable .npz: {error}", str(path)) from None
    density = arrays["density"]
    if density.ndim != 3 or density.dtype.kind not in "fiu" or not 0 < density.size <= MAX_CELLS:
        raise ConfigError("density", f"must be three-dimensional, numbers, at most {MAX_CELLS} cells", density.shape)
    for name in ("low_m", "high_m"):
        if arrays[name].shape != (3,):
            raise ConfigError(name, "must have shape (3,)", arrays[name].shape)
    return Grid(density=density.astype(np.float32), low_m=vector("low_m", arrays["low_m"].tolist()),
                high_m=vector("high_m", arrays["high_m"].tolist()))


def _read_tile_sheet(path: Path, channel: str, locate: Callable[[str], Path]) -> Grid:
    one_of("channel", channel, CHANNELS)
    try:
        about = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError("", f"is no readable JSON: {error}", str(path)) from None
    if not isinstance(about, dict):
        raise ConfigError("", "must be a JSON object", str(path))
    for key in ("resolution", "tiles_x", "tiles_y", "tiles_file", "dimensions"):
        if key not in about:
            raise ConfigError(key, "missing", hint=str(path))
    n = integer("resolution", about["resolution"], 2, round(MAX_CELLS ** (1 / 3)))
    across, down = (integer(key, about[key], 1, n) for key in ("tiles_x", "tiles_y"))
    if across * down < n:
        raise ConfigError("tiles_x", f"tiles_x times tiles_y must be at least the resolution, {n}", across)
    sides = vector("dimensions", about["dimensions"])
    for k, side in enumerate(sides):
        positive(f"dimensions[{k}]", float(side))
    name = about["tiles_file"]
    if not isinstance(name, str) or not name:
        raise ConfigError("tiles_file", "must be a file name", name)
    # Only the name: the folder is that of whoever wrote it.
    sheet = read_exr(locate(Path(name.replace("\\", "/")).name), CHANNELS[channel], (n * down, n * across))
    cells = sheet.reshape(down, n, across, n).transpose(0, 2, 1, 3).reshape(down * across, n, n)[:n]
    return Grid(density=np.ascontiguousarray(cells, np.float32), low_m=-500.0 * sides, high_m=500.0 * sides)


def read_exr(path: Path, channel: str, shape: tuple[int, int]) -> np.ndarray:
    """One channel float32 of an OpenEXR image, which must have the shape (height, width)."""
    file = _openexr().File
    if not path.is_file():
        raise ConfigError("tiles_file", "no such file", str(path))
    try:
        # Its size first: a small file may unpack to any.
        with file(str(path), header_only=True) as image:
            low, high = image.header()["dataWindow"]
            found = (int(high[1] - low[1]) + 1, int(high[0] - low[0]) + 1)
        if found != shape:
            raise ConfigError("tiles_file", f"must be an image of {shape[1]} x {shape[0]} pixels", found[::-1])
        with file(str(path), separate_channels=True) as image:
            channels = image.channels()
            if channel not in channels:
                raise ConfigError("tiles_file", f"must have a channel {channel}", sorted(channels))
            pixels = np.array(channels[channel].pixels, np.float32)
    except ConfigError:
        raise
    except Exception as error:  # a broken image raises any of its library's errors
        raise ConfigError("tiles_file", f"is no readable OpenEXR image: {error}", str(path)) from None
    if pixels.shape != shape:
        raise ConfigError("tiles_file", "must have a value of the channel in each pixel", pixels.shape[::-1])
    return pixels


def _openexr():
    try:
        import OpenEXR
    except ImportError as error:
        raise DeviceError("tile sheets need OpenEXR: pip install 'glrender[exr]'") from error
    return OpenEXR
