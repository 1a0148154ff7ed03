"""Requests that compare a client's frame: it comes in the header, and normal equations go back in place of images."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from glrender import ConfigError, ProtocolError
from glrender.capture.comparison import FRAME_DTYPES, MAX_BLUR_PX
from glrender_camera.validate import integer, known_keys, one_of, within

_KEYS = ("pixels", "dtype", "shape", "blur_px", "robust")
COMPARE_KEYS = ("derivatives", "unknown")
"""Fields of a frame that belong to `compare`."""
_WITHOUT = ("seed", "faults", "products")
# Images of a derivative [byte/pixel] while it is made: irradiance, signs apart and spread, digital numbers, weighted.
_BYTES = 40
# A body, and the spacecraft, have 6 parameters.
_MOST_OF_A_NAME = 6


@dataclass(frozen=True, kw_only=True, eq=False)
class Compared:
    """The frame of a `compare`, and how it is compared: options of `glrender.compare_frame`."""

    frame_DN: np.ndarray
    derivatives: tuple[Any, ...]
    unknown: tuple[Any, ...]
    blur_px: Any
    is_robust: bool

    @classmethod
    def from_dict(cls, table: Mapping[str, Any]) -> Compared | None:
        """The one that a frame's fields ask for, if any.

        Raises
        ------
        ConfigError
        """
        if "compare" not in table:
            if found := [name for name in COMPARE_KEYS if name in table]:
                raise ProtocolError(found[0], "belongs to `compare`: images of derivatives are not sent",
                                    table[found[0]], "leave it out")
            return None
        if table.get("output", "dn") != "dn":
            raise ConfigError("output", "must be 'dn', or left out, with `compare`", table["output"])
        if found := [name for name in _WITHOUT if name in table]:
            raise ProtocolError(found[0], "does not go with `compare`, whose reply has no image", table[found[0]],
                                "leave it out")
        fields = known_keys("compare", table["compare"], _KEYS, required=("pixels", "dtype", "shape"))
        if not isinstance(fields.get("robust", False), bool):
            raise ConfigError("compare.robust", "must be true or false", fields["robust"])
        for name in COMPARE_KEYS:
            if not isinstance(table.get(name, []), list):
                raise ProtocolError(name, "must be a list of names", table[name])
        return cls(frame_DN=_frame(fields), derivatives=tuple(table.get("derivatives", ("spacecraft",))),
                   unknown=tuple(table.get("unknown", ("gain", "offset"))), is_robust=fields.get("robust", False),
                   blur_px=within("compare.blur_px", fields.get("blur_px", 0.0), 0.0, MAX_BLUR_PX))

    def peak_bytes(self, n_pixels: int) -> int:
        """Memory [byte] that a comparison takes at its largest."""
        return n_pixels * _BYTES * (_MOST_OF_A_NAME * len(self.derivatives) + 4)

    @property
    def options(self) -> dict[str, Any]:
        """As `glrender.compare_frame` takes them."""
        return vars(self)


def _frame(fields: Mapping[str, Any]) -> np.ndarray:
    """Pixels as numbers (height, width)."""
    pixels, shape = fields["pixels"], fields["shape"]
    dtype = np.dtype(one_of("compare.dtype", fields["dtype"], FRAME_DTYPES)).newbyteorder("<")
    if not isinstance(shape, list) or len(shape) != 2:
        raise ProtocolError("compare.shape", "must be two integers: height, width", shape)
    sides = [integer(f"compare.shape[{k}]", side, 1, 2**20) for k, side in enumerate(shape)]
    if not isinstance(pixels, bytes):
        raise ProtocolError("compare.pixels", "must be bytes (bin), row by row, little-endian", pixels)
    if len(pixels) != (size := math.prod(sides) * dtype.itemsize):
        raise ProtocolError("compare.pixels", f"must have {size} bytes, of {sides[0]} x {sides[1]} {fields['dtype']}",
                            len(pixels))
    return np.frombuffer(pixels, dtype).reshape(sides).astype(dtype.newbyteorder("="))
