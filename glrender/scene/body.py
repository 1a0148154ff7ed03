"""A body: a shape with its reflectance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import InitVar, dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from glrender_camera.validate import did_you_mean, name_of, positive

from ..base.errors import ConfigError, error_path
from ..brdf import Lambert, Law, Microfacet
from .detail.config import Detail
from .detail.height_field import Relief
from .shape.convex_hull import Hull
from .shape.equirectangular import corner_coordinates, left_edge_of
from .shape.regions import Region, with_regions
from .shape.shape import Shape
from .shape.textures import laid, read_texture

NO_COORDINATES = ('of a map of longitudes and latitudes say albedo_projection = { kind = "equirectangular", '
                  'left_edge_deg = -180.0 }; else leave it out, or take a shape that has them (`vt` of an OBJ)')
"""The way out where a map has nothing to lie on."""


def albedo_name(law: Any) -> str | None:
    """The name of the albedo that a map scales; None of a law that has none, whose BRDF it scales."""
    return next((each.name for each in fields(law) if each.name.endswith("albedo")), None)


@dataclass(frozen=True, kw_only=True, eq=False)
class Body:
    """A shape with its reflectance.

    Parameters
    ----------
    name : str
    shape : Shape
        Body-fixed, about the origin that a state's pose moves.
    brdf : Law, optional
        Of all facets; where a shape's file has materials, the law of each by default.
    albedo_map : (H, W) float, optional
        Factor on the law's albedo, row 0 on top; needs a shape with texture coordinates.
    smooth_normals : bool
        Interpolated normals; by default each facet has its own, as a shape model is a polyhedron.
    detail : Detail, optional
        Ground finer than the facets, made up: none unless asked for.
    albedo_projection : mapping, optional
        ``{"kind": "equirectangular", "left_edge_deg": -180.0}`` of a map of longitudes and latitudes: the shape then
        needs no texture coordinates, and has those of its places.
    materials : mapping of str to Law, optional
        Laws in place of those that the file gives, by its materials' names; then that of every material. An image of
        the file scales its material's albedo, whosever law it is. None with `brdf`.
    regions : sequence of Region
        Finer shapes of parts, in place of what lies beneath: they become part of `shape`.
    """

    name: str
    shape: Shape
    brdf: Law | None = None
    albedo_map: np.ndarray | None = None
    smooth_normals: bool = False
    detail: Detail | None = None
    albedo_projection: Mapping[str, Any] | None = None
    materials: Mapping[str, Law] | None = None
    regions: InitVar[Sequence[Region]] = ()

    def __post_init__(self, regions: Sequence[Region]) -> None:
        name_of("name", self.name)
        if not isinstance(self.shape, Shape):
            raise ConfigError("shape", "must be a glrender.Shape", self.shape)
        if regions:
            self._set_in(regions)
        self._choose_laws()
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
            for law in self.laws:
                name = albedo_name(law)
                if name and (product := getattr(law, name) * float(albedo_map.mean(dtype=float))) > 1.0:
                    object.__setattr__(self, "shape", self.shape.with_warnings([
                        f"the albedo map times {name} is {product:.3g} on average, where more than 1 counts as 1; "
                        "albedo_texture_gain scales the map"]))
            albedo_map.setflags(write=False)
            object.__setattr__(self, "albedo_map", albedo_map)

    def __repr__(self) -> str:
        laws = ", ".join(dict.fromkeys(type(law).__name__ for law in self.laws))
        return f"<Body {self.name}: {self.shape!r}, {laws}>"

    def _set_in(self, regions: Sequence[Region]) -> None:
        """Set regions into the shape, with their laws as materials where they have their own."""
        if not isinstance(self.brdf, Law):
            raise ConfigError("brdf", "must be a law of glrender.brdf, of a body with regions", self.brdf)
        for key in ("materials", "detail"):
            if getattr(self, key) is not None:
                raise ConfigError(key, "goes without regions", hint="leave one out; a region may have a brdf")
        if self.albedo_map is not None and self.albedo_projection is None:
            raise ConfigError("albedo_map", "goes with regions if it is of longitudes and latitudes",
                              hint="give albedo_projection, or leave it or the regions out")
        shape = with_regions(self.shape.of_one_material(), regions, self.brdf)
        if shape.materials:
            if self.albedo_map is not None:
                raise ConfigError("albedo_map", "goes with regions without a brdf", hint="leave one out")
            object.__setattr__(self, "brdf", None)
        object.__setattr__(self, "shape", shape)

    def _choose_laws(self) -> None:
        """Keep `brdf`, and a shape without its file's materials; or the law of each material."""
        if self.brdf is not None:
            if not isinstance(self.brdf, Law):
                raise ConfigError("brdf", "must be a law of glrender.brdf", self.brdf)
            if self.materials is not None:
                raise ConfigError("materials", "goes without brdf, the law of all facets", self.materials,
                                  "leave one out")
            object.__setattr__(self, "shape", self.shape.of_one_material())
            return
        known = {each.name: each for each in self.shape.materials}
        given: Mapping[str, Law] = {} if self.materials is None else self.materials
        if not isinstance(given, Mapping):
            raise ConfigError("materials", "must map names of materials to laws", given)
        for name, law in given.items():
            if name not in known:
                raise ConfigError("materials", "must be names of the file's materials", name, " ".join((
                    did_you_mean(name, known), f"the file has {', '.join(known) or 'none: give brdf'}")).strip())
            if not isinstance(law, Law):
                raise ConfigError(f"materials.{name}", "must be a law of glrender.brdf", law)
        if not known:
            raise ConfigError("brdf", "missing", hint="this shape's file has no materials: give a law, as "
                              '{ law = "lambert", normal_albedo = 0.1 }')
        for key in ("albedo_map", "detail"):
            if getattr(self, key) is not None:
                raise ConfigError(key, "goes with brdf: this body has the materials of its file", hint="give brdf too")
        laws, notes = {}, []
        for each in (self.shape.materials[number] for number in np.unique(np.asarray(self.shape.material))):
            laws[each.name] = law = given.get(each.name, each.law)
            with error_path(f"materials.{each.name}"):
                if law is None:
                    raise ConfigError("", f"missing: {each.fault}", hint="give its law, or brdf for all facets")
                _ = each.albedo_map
            notes += each.notes
        object.__setattr__(self, "shape", self.shape.with_warnings(notes))
        object.__setattr__(self, "materials", laws)

    @property
    def laws(self) -> tuple[Law, ...]:
        """Its law, or those of its materials."""
        return tuple((self.materials or {}).values()) if self.brdf is None else (self.brdf,)

    @property
    def law_names(self) -> str:
        """The names of its laws, each once."""
        return ", ".join(dict.fromkeys(law.glsl for law in self.laws))

    @cached_property
    def parts(self) -> tuple[Body, ...]:
        """Parts of one look each, which share the body's pose: itself where it has one law."""
        if self.materials is None:
            return (self,)
        return tuple(self._part(number) for number in np.unique(self.looks))

    @cached_property
    def part_facets(self) -> tuple[np.ndarray, ...]:
        """Numbers (F,) of the facets of each of `parts`."""
        if self.materials is None:
            return (np.arange(len(self.shape.facets)),)
        return tuple(np.flatnonzero(self.looks == number) for number in np.unique(self.looks))

    @cached_property
    def looks(self) -> np.ndarray:
        """Number (F,) of the first material that each facet looks like: OpenGL's cost grows with the parts."""
        first: dict[Law, int] = {}
        of_facets, same = np.asarray(self.shape.material), np.arange(len(self.shape.materials))
        for number in np.unique(of_facets):
            material = self.shape.materials[number]
            law = (self.materials or {})[material.name]
            if material.image is None and isinstance(law, Lambert | Microfacet):
                same[number] = first.setdefault(law, number)
        return same[of_facets]

    def _part(self, number: int) -> Body:
        material, shape = self.shape.materials[number], self.shape.part(self.looks == number)
        with error_path(f"materials.{material.name}"):
            if (image := material.albedo_map) is not None and shape.uv is not None:
                image, uv = laid(image, shape.uv, material.wraps)
                shape = replace(shape, uv=uv)
            law = (self.materials or {})[material.name]
            made = replace(self, shape=shape, brdf=law, materials=None, albedo_map=image)
        if self.smooth_normals:
            used = np.unique(self.shape.facets[self.looks == number])
            # Those of the whole: a part alone has others along its border.
            vars(made.drawn_shape)["vertex_normals"] = self.shape.vertex_normals[used]
        return made

    @classmethod
    def from_file(cls, path: str | Path, *, name: str, brdf: Law | None = None, length_unit: str | float | None = None,
                  albedo_texture: str | Path | None = None, albedo_texture_gain: float = 1.0,
                  smooth_normals: bool = False, detail: Detail | None = None, sides: str = "file",
                  albedo_projection: Mapping[str, Any] | None = None, surface: int | None = None,
                  inside: bool = False, materials: Mapping[str, Law] | None = None) -> Body:
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
        brdf, materials
            As of `Body`; a binary glTF and an OBJ with its MTL have materials.

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
                   detail=detail, albedo_projection=albedo_projection, materials=materials)

    @cached_property
    def hull(self) -> Hull:
        """Convex hull of the shape."""
        shape = self.drawn_shape
        return Hull(shape.vertices_m, shape.facets, shape.solid, self.shape.centre_m, shape.sizes)

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
