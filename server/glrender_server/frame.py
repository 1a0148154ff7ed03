"""The frames that a `render` request asks for: their fields, checked before anything is drawn."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from glrender import ConfigError, PinholeCamera, ProtocolError, Scene
from glrender.capture.outputs import checked_output, has_exposure
from glrender.capture.static_exposure import checked_region, drawn_pixels
from glrender.engines.image import peak_bytes
from glrender.scene.tolerance import checked_deadline
from glrender_camera.faults.fault import Fault
from glrender_camera.faults.frame_faults import checked_faults
from glrender_camera.validate import integer, known_keys, positive

from .compared import COMPARE_KEYS, Compared
from .limits import MAX_ARRAYS, MAX_FRAME_BYTES

FRAME_KEYS = ("camera", "output", "exposure_s", "seed", "max_error", "samples", "products", "roi", "faults",
              "deadline_s", "compare", *COMPARE_KEYS)
"""Fields of a frame: of the request itself, or of an entry of its `frames`."""
_OF_THE_REQUEST = ("state", "backend", "shared")


@dataclass(frozen=True, kw_only=True)
class FrameRequest:
    """One camera's frame, as it is asked for.

    `max_error` and `samples` are the renderer's to check. `path` leads to the fields in the request; it is empty where
    they are the request's own. `peak_bytes` is the memory that the frame takes at its largest.
    """

    path: str
    camera: PinholeCamera
    output: str
    exposure_s: float | str | None
    seed: int
    max_error: Any
    samples: Any
    products: list[Any]
    roi: tuple[int, int, int, int] | None
    peak_bytes: int
    faults: tuple[Fault, ...] | None = None
    deadline_s: float | None = None
    compared: Compared | None = None

    @classmethod
    def from_dict(cls, table: Mapping[str, Any], scene: Scene, path: str = "") -> FrameRequest:
        """A frame of the fields `FRAME_KEYS` of a map; others are the caller's to refuse.

        Raises
        ------
        ConfigError
        """
        camera = scene.camera(table.get("camera"))
        compared = Compared.from_dict(table)
        output = checked_output(table.get("output", "irradiance") if compared is None else "dn", camera)
        products = table.get("products", [])
        if not isinstance(products, list):
            raise ProtocolError("products", "must be a list of names", products)
        exposure_s, seed, faults = table.get("exposure_s"), table.get("seed", 0), None
        if has_exposure(output):
            if exposure_s not in (None, "auto"):
                exposure_s = positive("exposure_s", exposure_s)
            seed = integer("seed", seed, 0, 2**64 - 1)
            faults = checked_faults("faults", table["faults"]) if "faults" in table else None
        elif found := [name for name in ("exposure_s", "seed", "faults") if name in table]:
            raise ProtocolError(found[0], "belongs to output 'dn' or 'compressed'", output)
        if output == "compressed" and "roi" in table:
            raise ConfigError("roi", "goes with no output 'compressed': a stream is of the whole frame", table["roi"],
                              "leave it out and cut the decoded frame, or ask for output 'dn'")
        roi = checked_region(table["roi"], camera) if "roi" in table else None
        deadline_s = checked_deadline(table["deadline_s"]) if "deadline_s" in table else None
        n_pixels = drawn_pixels(camera)
        peak = peak_bytes(n_pixels, products) + (0 if compared is None else compared.peak_bytes(n_pixels))
        return cls(path=path, camera=camera, output=output, exposure_s=exposure_s, seed=seed,
                   max_error=table.get("max_error"), samples=table.get("samples"), products=products, roi=roi,
                   peak_bytes=peak, faults=faults, deadline_s=deadline_s, compared=compared)

    @property
    def is_sent_as_drawn(self) -> bool:
        """Whether all that is sent is an image as a renderer draws it."""
        return self.output == "irradiance" and not (self.products or self.roi or self.camera.distortion)

    @contextmanager
    def named_errors(self) -> Iterator[None]:
        """Errors raised inside name the field's place in the request; fields that all frames share keep theirs."""
        with _named(self.path):
            yield

    def cut(self, array: np.ndarray) -> np.ndarray:
        """The region of interest of a (height, width[, 3]) array."""
        if self.roi is None:
            return array
        x0, y0, x1, y1 = self.roi
        return array[y0:y1, x0:x1]


def frames_asked(header: Mapping[str, Any], scene: Scene) -> list[FrameRequest]:
    """The frames of a request: its `frames`, or the one that its own fields describe.

    Raises
    ------
    ConfigError
        With the path of the field, e.g. ``frames[1].roi[2]``; or all together take too much memory.
    """
    if "frames" not in header:
        asked = [FrameRequest.from_dict(header, scene)]
    else:
        for key in FRAME_KEYS:
            if key in header:
                raise ProtocolError(key, "belongs into the entries of `frames`")
        if not isinstance(header["frames"], list) or not header["frames"]:
            raise ProtocolError("frames", "must be a list of maps that is not empty", header["frames"])
        asked = []
        for index, table in enumerate(header["frames"]):
            path = f"frames[{index}]"
            known_keys(path, table, FRAME_KEYS)
            with _named(path):
                asked.append(FrameRequest.from_dict(table, scene, path))
    n_arrays = sum(1 + len(frame.products) for frame in asked)
    if n_arrays > MAX_ARRAYS:
        raise ProtocolError("frames", f"must have at most {MAX_ARRAYS} images and products together", n_arrays)
    needed = sum(frame.peak_bytes for frame in asked)
    if needed > MAX_FRAME_BYTES:
        raise ConfigError("frames" if "frames" in header else "products", f"must take at most {MAX_FRAME_BYTES} bytes "
                          "of memory while they are made", needed, "ask for fewer at a time")
    return asked


@contextmanager
def _named(path: str) -> Iterator[None]:
    try:
        yield
    except ConfigError as error:
        if path and error.path.split(".")[0] not in _OF_THE_REQUEST:
            error.path = f"{path}.{error.path}"
        raise

