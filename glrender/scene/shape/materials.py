"""The materials of a shape file: the laws and the images of its facets."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...base.errors import error_path
from ...brdf import Law
from .textures import LUMINANCE, REPEATED, linear_grey


@dataclass(frozen=True, kw_only=True, eq=False)
class FileMaterial:
    """One material of a file.

    Attributes
    ----------
    name : str
        Unlike those of the others.
    law : Law or None
        None where the file does not give it.
    fault : str
        Why not.
    notes : tuple of str
        What of it is not drawn as the file has it.
    colour : (3,) float [1]
        Linear factors on an image's red, green and blue.
    image : bytes or None
        Of its base colour.
    wraps : (str, str)
        How the image goes on along u and v: `textures.laid`.
    """

    name: str
    law: Law | None = None
    fault: str = ""
    notes: tuple[str, ...] = ()
    colour: np.ndarray | None = None
    image: bytes | None = None
    wraps: tuple[str, str] = (REPEATED, REPEATED)

    @cached_property
    def albedo_map(self) -> np.ndarray | None:
        """Factors (H, W) float32 [1] on the law's albedo: the colours' grey over that of the factors alone."""
        if self.image is None:
            return None
        grey = grey_of(self.colour)
        with error_path("baseColorTexture"):
            return linear_grey(self.image, self.colour / grey if grey > 0.0 else np.ones(3))


def grey_of(colour: np.ndarray) -> float:
    """The grey [1] of linear red, green and blue (3,): their luminance, which of a grey is the same number."""
    return float(colour[1] + LUMINANCE @ (colour - colour[1]))


def distinct(names: list[str]) -> list[str]:
    """Names, of which those that are there before get their number."""
    made: dict[str, None] = {}
    for number, name in enumerate(names):
        made[f"{name}.{number}" if name in made else name] = None
    return list(made)
