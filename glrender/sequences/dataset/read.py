"""Frames of a data set read back, from any of its formats."""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ...base.errors import ConfigError
from ..folder import MANIFEST
from .shards import FORMATS


@dataclass(frozen=True, kw_only=True, eq=False)
class LabelledFrame:
    """One frame of a data set.

    Attributes
    ----------
    image : (height, width) uint8, uint16 [DN] or float32 [W/m2]
    mask : (height, width) uint8
        0 on the sky, k + 1 at body k.
    products : mapping of str to array
        Those that were asked for; none of BOP's.
    labels : mapping
        The frame's record: `index`, `state`, `labels`, `exposure_s`, `seed`, `warnings`.
    """

    image: np.ndarray
    mask: np.ndarray
    products: Mapping[str, np.ndarray]
    labels: Mapping[str, Any]


def read_frame(folder: str | Path, index: int) -> LabelledFrame:
    """A frame of a data set's folder, by its number.

    Raises
    ------
    ConfigError
        A folder without a manifest, or a number that it does not have.
    """
    folder = Path(folder)
    try:
        manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError("folder", f"is no data set: {error}", str(folder)) from None
    if not 0 <= index < manifest["n_frames"]:
        raise ConfigError("index", f"must be 0 to {manifest['n_frames'] - 1}", index)
    number, row = divmod(index, manifest["frames_a_shard"])
    shard = folder / FORMATS[manifest["format"]].name(number)
    lines = (folder / "labels" / f"{number:05d}.jsonl").read_text(encoding="utf-8").splitlines()
    image, mask, products = _READERS[manifest["format"]](shard, index, row)
    return LabelledFrame(image=image, mask=mask, products=products, labels=json.loads(lines[row]))


def _of_tar(shard: Path, index: int, row: int) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    with tarfile.open(shard) as tar:
        parts = {member.name.split(".", 1)[1]: tar.extractfile(member).read() for member in tar
                 if member.name.split(".", 1)[0] == f"{index:06d}"}
    image = _pixels(parts["png"]) if "png" in parts else np.load(io.BytesIO(parts["npy"]), allow_pickle=False)
    return image, _pixels(parts["mask.png"]), _products(parts.get("products.npz"))


def _of_hdf5(shard: Path, index: int, row: int) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    import h5py

    with h5py.File(shard) as file:
        products = {name: array[row] for name, array in file.get("products", {}).items()}
        return file["image"][row], file["mask"][row], products


def _of_coco(shard: Path, index: int, row: int) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    products = shard / f"{index:06d}.products.npz"
    return (_pixels((shard / f"{index:06d}.png").read_bytes()), _pixels((shard / f"{index:06d}.mask.png").read_bytes()),
            _products(products.read_bytes() if products.exists() else None))


def _of_bop(shard: Path, index: int, row: int) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    image = _pixels((shard / "gray" / f"{index:06d}.png").read_bytes())
    mask = np.zeros(image.shape, np.uint8)
    for number, file in enumerate(sorted((shard / "mask_visib").glob(f"{index:06d}_*.png"))):
        mask[_pixels(file.read_bytes()) > 0] = number + 1
    return image, mask, {}


def _pixels(content: bytes) -> np.ndarray:
    with Image.open(io.BytesIO(content)) as picture:
        return np.asarray(picture)


def _products(content: bytes | None) -> dict[str, np.ndarray]:
    if content is None:
        return {}
    with np.load(io.BytesIO(content), allow_pickle=False) as stored:
        return dict(stored)


_READERS = {"webdataset": _of_tar, "hdf5": _of_hdf5, "coco": _of_coco, "bop": _of_bop}
