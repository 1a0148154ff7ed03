"""A body: a shape with its reflectance."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from glrender_camera.projection import MAX_IMAGE_PX
from glrender_camera.validate import name_of, positive

from ..base.errors import ConfigError, ShapeError, error_path
from ..brdf import Law
from .detail.config import Detail
from .detail.height_field import Relief
from .shape.convex_hull import Hull
from .shape.equirectangular import corner_coordinates, left_edge_of
from .shape.shape import Shape

NO_COORDINATES = ('of a map of longitudes and latitudes say albedo_projection = { kind = "equirectangular", '
                  'left_edge_deg = -180.0 }; else leave it out, or take a shape that has them (`vt` of an OBJ)')
"""The way out where a map has nothing to lie on."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Body:
    """A shape with its reflectance.

    Parameters
    ----------
    name : str
    shape : Shape
        Body-fixed, about the origin that a state's pose moves.
    brdf : Law
    albedo_map : (H, W) float, optional
        Factor on the law's albedo, row 0 on top; needs a shape with texture coordinates.
    smooth_normals : bool
        Interpolated normals; by default each facet has its own, as a shape model is a polyhedron.
    detail : Detail, optional
        Ground finer than the facets, made up: none unless asked for.
    albedo_projection : mapping, optional
        ``{"kind": "equirectangular", "left_edge_deg": -180.0}`` of a map of longitudes and latitudes: the shape then
        needs no texture coordinates, and has those of its places.
    """

    name: str
    shape: Shape
    brdf: Law
    albedo_map: np.ndarray | None = None
    smooth_normals: bool = False
    detail: Detail | None = None
    albedo_projection: Mapping[str, Any] | None = None

    def __post_init__(self):
        name_of("name", self.name)
        if not isinstance(self.shape, Shape):
            raise ConfigError("shape", "must be a glrender.Shape", self.shape)
        if not isinstance(self.brdf, Law):
            raise ConfigError("brdf", "must be a law of glrender.brdf", self.brdf)
        if not isinstance(self.smooth_normals, bool):
            raise ConfigError("smooth_normals", "must be true or false", self.smooth_normals)
        if not isinstance(self.detail, Detail | None):
            raise ConfigError("detail", "must be a glrender.Detail", self.detail)
        with error_path("detail"):
            _ = self.relief
        if self.albedo_projection is not None:
            with error_path("albedo_projection"):
                left_edge_deg = left_edge_of(self.albedo_projection)
            if self.albedo_map is None:
                raise ConfigError("albedo_projection", "goes with an albedo map", hint="leave it out")
            uv = corner_coordinates(self.shape.vertices_m, self.shape.facets, left_edge_deg)
            object.__setattr__(self, "shape", replace(self.shape, uv=uv))
        if self.albedo_map is not None:
            if self.shape.uv is None:
                raise ConfigError("albedo_map", "needs a shape with texture coordinates", hint=NO_COORDINATES)
            try:
                albedo_map = np.array(self.albedo_map, dtype=np.float32)
            except (TypeError, ValueError, OverflowError):
                raise ConfigError("albedo_map", "must be a 2-D array of numbers", self.albedo_map) from None
            fits = albedo_map.ndim == 2 and albedo_map.size
            if not fits or not np.isfinite(albedo_map).all() or albedo_map.min() < 0.0:
                raise ConfigError("albedo_map", "must be a 2-D array of finite numbers >= 0, not empty")
            albedo_map.setflags(write=False)
            object.__setattr__(self, "albedo_map", albedo_map)

    @classmethod
    def from_file(cls, path: str | Path, *, name: str, brdf: Law, length_unit: str | float | None = None,
                  albedo_texture: str | Path | None = None, albedo_texture_gain: float = 1.0,
                  smooth_normals: bool = False, detail: Detail | None = None, sides: str = "file",
                  albedo_projection: Mapping[str, Any] | None = None, surface: int | None = None,
                  inside: bool = False) -> Body:
        """A body from a shape file.

        Parameters
        ----------
        path : path
            OBJ, PLY, STL, PDS plate model (.tab, .plt), ICQ, binary glTF, OFF or SPICE DSK: docs/shapes.md.
        length_unit : "m", "km" or float
            Length unit of the file; metres per unit when a number. A DSK has its own.
        surface : int, optional
            SPICE's number of the surface, of a DSK with several.
        albedo_texture : path, optional
            Image whose grey value over its full scale, times `albedo_texture_gain`, scales the albedo.
        sides : {"file", "front", "both"}
            Sides of open shells: `Shape.from_file`.
        albedo_projection : mapping, optional
            Of a texture of longitudes and latitudes, as of `Body`.
        inside : bool
            Closed shells are rooms: `Shape.from_file`.

        Raises
        ------
        ShapeError
        """
        albedo_map = None
        if albedo_texture is not None:
            gain = positive("albedo_texture_gain", albedo_texture_gain)
            with error_path("albedo_texture"):
                albedo_map = read_texture(Path(albedo_texture)) * np.float32(gain)
        shape = Shape.from_file(path, length_unit=length_unit, sides=sides, surface=surface, inside=inside)
        return cls(name=name, shape=shape, brdf=brdf, albedo_map=albedo_map, smooth_normals=smooth_normals,
                   detail=detail, albedo_projection=albedo_projection)

    @cached_property
    def hull(self) -> Hull:
        """Convex hull of the shape."""
        return Hull(self.drawn_shape.vertices_m, self.drawn_shape.facets, self.shape.solid, self.shape.centre_m)

    @cached_property
    def drawn_shape(self) -> Shape:
        """The shape about its `centre_m`: what all engines draw, and what a `BodyView` is about."""
        if not self.shape.centre_m.any():
            return self.shape
        vertices_m = self.shape.vertices_m - self.shape.centre_m
        vertices_m.setflags(write=False)
        return replace(self.shape, vertices_m=vertices_m)

    @cached_property
    def relief(self) -> Relief | None:
        """The height field of the body's surface detail."""
        if self.detail is None:
            return None
        return Relief(self.detail, math.sqrt(self.shape.facet_areas_m2.mean() * 4.0 / math.sqrt(3.0)),
                      self.drawn_shape.radius_m)


MAX_TEXTURE_PX = 2**27
"""Most pixels of a texture: 16384 x 8192, 0.5 GiB as float32."""
# Pillow's formats that are pictures alone: others start programs (EPS) or unpack to any size.
_TEXTURE_FORMATS = ("PNG", "TIFF", "JPEG", "JPEG2000", "BMP", "PPM", "WEBP")


def texture_pixels(path: Path) -> int:
    """Number of pixels in an image file's header; 0 for one that `read_texture` refuses."""
    from PIL import Image

    Image.MAX_IMAGE_PIXELS = None
    try:
        with Image.open(path, formats=_TEXTURE_FORMATS) as image:
            return image.width * image.height
    except Exception:  # broken images raise anything
        return 0


def read_texture(path: Path) -> np.ndarray:
    """(H, W) float32 [1]: an image's grey value over its full scale.

    Raises
    ------
    ShapeError
    """
    from PIL import Image

    # Planetary maps are large: our own limit is checked before a pixel is decoded.
    Image.MAX_IMAGE_PIXELS = None
    try:
        with Image.open(path, formats=_TEXTURE_FORMATS) as image:
            if max(image.size) > MAX_IMAGE_PX or image.width * image.height > MAX_TEXTURE_PX:
                raise ShapeError("", f"must be a texture of at most {MAX_IMAGE_PX} pixels a side and "
                                 f"{MAX_TEXTURE_PX} in all", image.size, "make it coarser")
            values = np.asarray(image if image.mode in ("L", "I;16", "I", "F") else image.convert("L"))
    except ShapeError:
        raise
    except Exception as error:  # broken images raise anything
        raise ShapeError("", f"texture cannot be read: {error}", str(path)) from None
    if values.dtype.kind == "f":
        return values.astype(np.float32)
    full_scale = 65535.0 if values.dtype.itemsize > 1 else 255.0
    return values.astype(np.float32) / np.float32(full_scale)
