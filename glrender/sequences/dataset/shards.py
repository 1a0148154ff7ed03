"""Formats of a data set's shards, and the two that hold arrays: WebDataset tar files, and HDF5."""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np

from ...base.errors import ConfigError
from ...scene.scene import Scene
from ...view.state import State
from ..formats import FrameFile
from ..options import FrameOptions
from ..surface_maps import UNITS
from .bop import BopWriter
from .coco import CocoWriter
from .images import kept, mask, npy, npz, png

Files = bytes | Mapping[str, bytes]
"""A shard: the content of its file, or those of the files of its folder, by their names in it."""


class TarWriter:
    """Writes a shard as WebDataset reads it: the files of a frame have its number as the name before the first dot."""

    def __init__(self, scene: Scene, options: FrameOptions, number: int):
        self._stream = io.BytesIO()
        self._tar = tarfile.open(fileobj=self._stream, mode="w", format=tarfile.USTAR_FORMAT)

    def add(self, index: int, state: State, frame: FrameFile, record: Mapping[str, Any]) -> None:
        """Add a frame."""
        is_dn = frame.unit == "DN"
        self._add(f"{index:06d}.{'png' if is_dn else 'npy'}", png(frame.pixels) if is_dn else npy(frame.pixels))
        self._add(f"{index:06d}.mask.png", png(mask(frame.products["body_id"])))
        if products := kept(frame.products):
            self._add(f"{index:06d}.products.npz", npz(products))
        self._add(f"{index:06d}.json", json.dumps(record).encode())

    def files(self) -> bytes:
        """The shard."""
        self._tar.close()
        return self._stream.getvalue()

    def _add(self, name: str, content: bytes) -> None:
        # A TarInfo has no owner and the date 0: equal frames are equal bytes.
        entry = tarfile.TarInfo(name)
        entry.size = len(content)
        self._tar.addfile(entry, io.BytesIO(content))


class Hdf5Writer:
    """Writes a shard as HDF5: `image`, `mask`, products and poses, one row a frame, and headers as JSON in `labels`."""

    def __init__(self, scene: Scene, options: FrameOptions, number: int):
        self._rows: dict[str, list] = {"index": [], "image": [], "mask": [], "labels": []}
        self._bodies = [body.name for body in scene.bodies]
        self._unit = options.unit

    def add(self, index: int, state: State, frame: FrameFile, record: Mapping[str, Any]) -> None:
        """Add a frame."""
        bodies = [record["labels"]["bodies"][name] for name in self._bodies]
        row = {"index": index, "image": frame.pixels, "mask": mask(frame.products["body_id"]),
               "labels": json.dumps(record), **{f"products/{name}": array for name, array in kept(
                   frame.products).items()},
               "sun_direction_camera": np.array(record["labels"]["sun_direction_camera"]),
               **{name: np.array([body[name] for body in bodies], float) for name in (
                   "r_camera_m", "q_camera_from_body")}}
        for name, value in row.items():
            self._rows.setdefault(name, []).append(value)

    def files(self) -> bytes:
        """The shard."""
        import h5py

        stream = io.BytesIO()
        with h5py.File(stream, "w") as file:
            file.attrs["bodies"] = self._bodies
            for name, rows in self._rows.items():
                if name == "labels":
                    file.create_dataset(name, data=rows, dtype=h5py.string_dtype())
                    continue
                data = np.stack(rows)
                packed = {} if data.ndim < 3 or name in ("r_camera_m", "q_camera_from_body") else {
                    "chunks": (1, *data.shape[1:]), "compression": "gzip", "compression_opts": 1, "shuffle": True}
                file.create_dataset(name, data=data, **packed)
            units = {f"products/{name}": UNITS[name] for name in file.get("products", {})}
            for name, unit in {"image": self._unit, **units, "r_camera_m": "m", "mask": "1", "index": "1",
                               "q_camera_from_body": "1", "sun_direction_camera": "1"}.items():
                file[name].attrs["unit"] = unit
        return stream.getvalue()


def _check_hdf5() -> None:
    if find_spec("h5py") is None:
        raise ConfigError("format", "hdf5 needs h5py", hint="pip install 'glrender[hdf5]'")


@dataclass(frozen=True)
class Format:
    """A format: the name of a shard's file or folder, what writes one, and whether its library is there."""

    name: Callable[[int], str]
    writer: Callable[[Scene, FrameOptions, int], Any]
    check: Callable[[], None] = lambda: None


FORMATS = {"webdataset": Format(lambda number: f"shard_{number:05d}.tar", TarWriter),
           "hdf5": Format(lambda number: f"shard_{number:05d}.h5", Hdf5Writer, _check_hdf5),
           "coco": Format(lambda number: f"images/{number:05d}", CocoWriter),
           "bop": Format(lambda number: f"train/{number:06d}", BopWriter)}
