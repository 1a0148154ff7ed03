"""COCO: images in folders and one `annotations.json` of boxes, masks and keypoints.

An image's `header` is its frame's, without the labels; `date_captured` is TDB.
A body that no pixel's centre sees, but whose light is seen, has the box of that light, and it as its mask.
Boxes are [x, y, width, height] from the image's corner, masks are run lengths down the columns, keypoints are
[x, y, v] with (0, 0) the centre of the top-left pixel: v is 0 out of the image, 1 hidden, 2 seen.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...scene.scene import Scene
from ...view.state import State
from ..formats import FrameFile
from ..labels import Keypoints
from ..options import FrameOptions
from .images import kept, mask, npz, png

_PART = "annotations.json"


class CocoWriter:
    """Writes a shard as a folder of images with its part of the annotations."""

    def __init__(self, scene: Scene, options: FrameOptions, number: int):
        self._bodies, self._number = [body.name for body in scene.bodies], number
        self._files: dict[str, bytes] = {}
        self._images: list[dict[str, Any]] = []
        self._annotations: list[dict[str, Any]] = []

    def add(self, index: int, state: State, frame: FrameFile, record: Mapping[str, Any]) -> None:
        """Add a frame."""
        self._files[f"{index:06d}.png"] = png(frame.pixels)
        self._files[f"{index:06d}.mask.png"] = png(mask(frame.products["body_id"]))
        if products := kept(frame.products):
            self._files[f"{index:06d}.products.npz"] = npz(products)
        height, width = frame.pixels.shape
        self._images.append({"id": index, "file_name": f"images/{self._number:05d}/{index:06d}.png", "width": width,
                             "height": height, "date_captured": record["date_tdb"] or "",
                             "header": {name: value for name, value in record.items() if name != "labels"}})
        for number, name in enumerate(self._bodies):
            label = record["labels"]["bodies"][name]
            if label["n_px"] or label["light_box_px"]:
                self._annotations.append(_annotation(index, number, len(self._bodies), label,
                                                     frame.products["body_id"] == number))

    def files(self) -> dict[str, bytes]:
        """The shard."""
        part = {"images": self._images, "annotations": self._annotations}
        return {**self._files, _PART: json.dumps(part).encode()}


def merged(scene: Scene, keypoints: Keypoints, shards: Sequence[Path]) -> bytes:
    """The annotations of all shards as one file."""
    whole: dict[str, Any] = {
        "info": {"description": "made by glrender"}, "licenses": [], "images": [], "annotations": [],
        "categories": [{"id": number + 1, "name": body.name, "supercategory": "body",
                        "keypoints": list(keypoints.get(body.name, {})), "skeleton": []}
                       for number, body in enumerate(scene.bodies)]}
    for shard in shards:
        part = json.loads((shard / _PART).read_text(encoding="utf-8"))
        for name, entries in part.items():
            whole[name] += entries
    return json.dumps(whole).encode()


def _annotation(index: int, number: int, n_bodies: int, label: Mapping[str, Any], is_seen: np.ndarray
                ) -> dict[str, Any]:
    x0, y0, x1, y1 = label["box_px"] or label["light_box_px"]
    if not label["n_px"]:
        is_seen = np.zeros_like(is_seen)
        is_seen[y0:y1, x0:x1] = True
    keypoints = []
    for point in label["keypoints"].values():
        keypoints += [*point["px"], 2 if point["is_seen"] else 1] if point["is_in_view"] else [0, 0, 0]
    return {"id": index * n_bodies + number + 1, "image_id": index, "category_id": number + 1, "iscrowd": 0,
            "area": int(is_seen.sum()), "bbox": [x0, y0, x1 - x0, y1 - y0],
            "segmentation": {"size": list(is_seen.shape), "counts": run_lengths(is_seen)},
            "keypoints": keypoints, "num_keypoints": sum(v > 0 for v in keypoints[2::3]),
            "r_camera_m": label["r_camera_m"], "q_camera_from_body": label["q_camera_from_body"]}


def run_lengths(mask: np.ndarray) -> list[int]:
    """Run lengths of a mask down its columns, first of pixels outside."""
    flat = np.concatenate([[False], mask.ravel(order="F")])
    ends = np.flatnonzero(flat[1:] != flat[:-1])
    return np.diff(np.concatenate([[0], ends, [mask.size]])).tolist()
