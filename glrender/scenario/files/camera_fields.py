"""Cameras of a scenario file that kernels or ISDs describe: `instrument` or `isd` in [[cameras]]."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from glrender_camera import PinholeCamera
from glrender_camera.validate import known_keys, text

from ...base.errors import ConfigError, error_path
from ..instruments.isd import Isd
from ..spice.instrument import camera_of_kernel
from ..spice.kernels import Spice

_KERNEL_KEYS = ("instrument", "spacecraft_frame", "width_px", "height_px", "focal_length_px", "image_right", "lens",
                "principal_point_px")
_ISD_KEYS = ("isd", "lens")


def read_cameras(table: dict[str, Any], folder: Path, spice: Spice | None) -> list[str]:
    """Replace cameras of kernels and ISDs, in a scene's table, by those described there; returns notes to warn of."""
    notes: list[str] = []
    if isinstance(cameras := table.get("cameras"), list):
        table["cameras"] = [_camera(entry, f"cameras[{index}]", folder, spice, notes)
                            for index, entry in enumerate(cameras)]
    return notes


def _camera(entry: object, path: str, folder: Path, spice: Spice | None, notes: list[str]) -> object:
    if not isinstance(entry, Mapping) or not ({"instrument", "isd"} & entry.keys()):
        return entry
    with error_path(path):
        if "isd" in entry:
            known_keys("", entry, ("name", "model", *_ISD_KEYS))
            image = Isd.from_file(folder / text("isd", entry["isd"]), entry.get("lens"))
            made = image.focal_plane.camera(entry.get("name", image.name))
            notes += [*image.notes, *made.notes()]
            return _table(made.camera, entry, _ISD_KEYS)
        if spice is None:
            raise ConfigError("instrument", "needs [spice] with its kernels", entry["instrument"])
        of_kernel = {key: entry[key] for key in _KERNEL_KEYS if key in entry}
        if "distortion" in entry:
            of_kernel.setdefault("lens", {"model": "none"})
        made = camera_of_kernel(spice, name=entry.get("name", str(entry["instrument"])), **of_kernel)
        notes += made.notes()
        return _table(made.camera, entry, _KERNEL_KEYS)


def _table(camera: PinholeCamera, entry: Mapping[str, Any], replaced: tuple[str, ...]) -> dict[str, Any]:
    """The table of a camera in a scene file, with the entry's other fields."""
    described = {"name": camera.name, "width_px": camera.width_px, "height_px": camera.height_px,
                 "focal_length_px": camera.focal_length_px, "principal_point_px": list(camera.principal_point_px),
                 "q_camera_from_spacecraft": camera.q_camera_from_spacecraft.tolist()}
    if camera.distortion is not None:
        described["distortion"] = dataclasses.asdict(camera.distortion)
    return {**described, **{key: value for key, value in entry.items() if key not in replaced}}
