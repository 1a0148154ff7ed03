"""Materials of binary glTF: metal and roughness as they are, colours as one grey, images of the base colour.

Source: Khronos (2021), glTF 2.0, 3.9 and 5.19 to 5.30; KHR_texture_transform.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...base.errors import ShapeError, error_path
from ...brdf import Microfacet
from .glb_json import entry_at, extension, listed, table_in
from .materials import FileMaterial, distinct, grey_of
from .textures import HELD, MAX_TEXTURE_PX, MIRRORED, REPEATED, channel_means, image_pixels

_EXPORT = "export it as one .glb with all its images"
# The least roughness that the law has: a narrower lobe is narrower than the Sun.
_LEAST_ROUGHNESS = 0.1
# The extension by which a material's colours are elsewhere.
_OTHER_COLOURS = "KHR_materials_pbrSpecularGlossiness"
# How textures go on beyond their edges, and how those do that do not say it.
_WRAPS, _USUAL_WRAP = {10497: REPEATED, 33071: HELD, 33648: MIRRORED}, 10497
# Most characters of a name.
_LONGEST_NAME = 100


@dataclass(frozen=True, kw_only=True)
class GlbMaterial:
    """A material, and how its facets have their two sides and their texture coordinates.

    Attributes
    ----------
    surface : FileMaterial
    is_double_sided : bool
    uv_set : int
        Number of the texture coordinates that its image is laid by.
    uv_from : (2, 3) float64
        From those to the image's, row 0 on top.
    """

    surface: FileMaterial
    is_double_sided: bool
    uv_set: int = 0
    uv_from: np.ndarray = field(default_factory=lambda: np.eye(2, 3))


def read_materials(about: dict, image_bytes: Callable[[object], bytes]) -> list[GlbMaterial]:
    """All materials of a file, and last the one that the format has for facets without.

    Parameters
    ----------
    about : dict
        The file's JSON.
    image_bytes : callable
        The bytes that the number of a buffer's view leads to.

    Raises
    ------
    ShapeError
        A factor out of range; a texture or image that is not there, is outside the file, or too large.
    """
    tables = listed(about, "materials")
    names = distinct([str(table.get("name") or f"material {number}")[:_LONGEST_NAME] for number, table
                      in enumerate(tables)] + ["default"])
    images, made = _Images(*(listed(about, key) for key in ("textures", "images", "samplers")), image_bytes), []
    for number, (table, name) in enumerate(zip([*tables, {}], names, strict=True)):
        with error_path(f"materials[{number}]"):
            made.append(_material(table, name, images))
    return made


class _Images:
    """The images that textures lead to, checked by their headers.

    Parameters
    ----------
    textures, images, samplers : list of dict
    image_bytes : callable
    """

    def __init__(self, textures: list[dict], images: list[dict], samplers: list[dict],
                 image_bytes: Callable[[object], bytes]):
        self._textures, self._images, self._samplers, self._image_bytes = textures, images, samplers, image_bytes
        self._read: dict[int, bytes] = {}
        self._means: dict[int, np.ndarray] = {}
        self._n_pixels = 0

    def of(self, texture: dict) -> bytes:
        """The bytes of a texture's image."""
        return self._read[self._number(texture)]

    def wraps(self, texture: dict) -> tuple[str, str]:
        """How a texture goes on along u and v."""
        entry = entry_at(self._textures, texture.get("index"), "index", _EXPORT)
        sampler = entry_at(self._samplers, entry["sampler"], "sampler", _EXPORT) if "sampler" in entry else {}
        given = [sampler.get(key, _USUAL_WRAP) for key in ("wrapS", "wrapT")]
        for value in given:
            if value not in _WRAPS:
                raise ShapeError("samplers", f"must wrap by one of {', '.join(map(str, _WRAPS))}", value)
        return _WRAPS[given[0]], _WRAPS[given[1]]

    def means(self, texture: dict) -> np.ndarray:
        """Means (3,) of its channels."""
        number = self._number(texture)
        if number not in self._means:
            self._means[number] = channel_means(self._read[number])
        return self._means[number]

    def _number(self, texture: dict) -> int:
        entry = entry_at(self._textures, texture.get("index"), "index", _EXPORT)
        number = entry.get("source", extension(entry, "EXT_texture_webp").get("source"))
        if number is None:
            raise _UnknownImageError
        image = entry_at(self._images, number, "source", _EXPORT)
        if number not in self._read:
            if "uri" in image:
                raise ShapeError("images.uri", "must not be there: images are read from the file alone", image["uri"],
                                 _EXPORT)
            data = self._image_bytes(image.get("bufferView"))
            self._n_pixels += image_pixels(data)
            if self._n_pixels > MAX_TEXTURE_PX:
                raise ShapeError("images", f"must have at most {MAX_TEXTURE_PX} pixels together", self._n_pixels,
                                 "make them coarser")
            self._read[number] = data
        return number


class _UnknownImageError(Exception):
    """An image that is none of PNG, JPEG and WebP."""


def _material(table: dict, name: str, images: _Images) -> GlbMaterial:
    is_double = table.get("doubleSided", False)
    if type(is_double) is not bool:
        raise ShapeError("doubleSided", "must be true or false", is_double)
    left_out = [key for key in ("normalTexture", "occlusionTexture", "emissiveTexture") if key in table]
    left_out += ["emissiveFactor"] if any(_factors(table, "emissiveFactor", (0.0, 0.0, 0.0))) else []
    left_out += ["alphaMode"] if table.get("alphaMode", "OPAQUE") != "OPAQUE" else []
    left_out += [key for key in map(str, table_in(table, "extensions")) if key != _OTHER_COLOURS]
    notes = [f"{', '.join(left_out)} left out"] if left_out else []
    with error_path("pbrMetallicRoughness"):
        about = table_in(table, "pbrMetallicRoughness")
        colour = _factors(about, "baseColorFactor", (1.0, 1.0, 1.0, 1.0))[:3]
        (metalness,), (roughness,) = (_factors(about, key, (1.0,)) for key in ("metallicFactor", "roughnessFactor"))
        image, wraps, laid = None, (REPEATED, REPEATED), {}
        try:
            if "metallicRoughnessTexture" in about:
                texture = table_in(about, "metallicRoughnessTexture")
                with error_path("metallicRoughnessTexture"):
                    _, green, blue = images.means(texture)
                metalness, roughness = metalness * blue, roughness * green
                notes.append(f"metalness {metalness:.3g} and roughness {roughness:.3g} are the means of its image")
            if "baseColorTexture" in about:
                texture = table_in(about, "baseColorTexture")
                with error_path("baseColorTexture"):
                    image, wraps, laid = images.of(texture), images.wraps(texture), _coordinates(texture)
        except _UnknownImageError:
            fault = f"its image is none of PNG, JPEG and WebP: {_EXPORT}"
        else:
            fault = f"its colours are those of {_OTHER_COLOURS}: export it with metal and roughness" \
                if _OTHER_COLOURS in table_in(table, "extensions") else ""
    if roughness < _LEAST_ROUGHNESS:
        notes.append(f"roughness {roughness:.3g} is drawn as {_LEAST_ROUGHNESS}: its highlight is narrower than the "
                     "Sun")
    law = Microfacet(base_albedo=min(grey_of(colour), 1.0), metalness=metalness,
                     roughness=max(roughness, _LEAST_ROUGHNESS))
    surface = FileMaterial(name=name, law=None if fault else law, fault=fault, colour=colour, image=image,
                           wraps=wraps, notes=tuple(f"material {name}: {note}" for note in notes))
    return GlbMaterial(surface=surface, is_double_sided=is_double, **laid)


def _coordinates(texture: dict) -> dict[str, Any]:
    """`uv_set` and `uv_from` of an image."""
    moved = extension(texture, "KHR_texture_transform")
    uv_set = moved.get("texCoord", texture.get("texCoord", 0))
    if type(uv_set) is not int or uv_set < 0:
        raise ShapeError("texCoord", "must be a whole number", uv_set)
    offset, scale = (_vector(moved, key, default) for key, default in (("offset", (0.0, 0.0)), ("scale", (1.0, 1.0))))
    (turn,) = _vector(moved, "rotation", (0.0,))
    cos, sin = math.cos(turn), math.sin(turn)
    return {"uv_set": uv_set, "uv_from": np.column_stack([np.array([[cos, sin], [-sin, cos]]) * scale, offset])}


def _factors(table: dict, key: str, default: tuple[float, ...]) -> np.ndarray:
    values = _vector(table, key, default)
    if not ((values >= 0.0) & (values <= 1.0)).all():
        raise ShapeError(key, "must be within 0..1", table[key])
    return values


def _vector(table: dict, key: str, default: tuple[float, ...]) -> np.ndarray:
    """Numbers (N,), as many as the default has, of which one stands alone."""
    given = table.get(key, default if len(default) > 1 else default[0])
    values = given if isinstance(given, list | tuple) else [given]
    are_numbers = all(type(value) in (int, float) and math.isfinite(value) for value in values)
    if not are_numbers or len(values) != len(default):
        raise ShapeError(key, f"must be {len(default)} numbers", given)
    return np.array(values, np.float64)
