"""The scene that a `load_scene` request asks for, refused by name where it would take too much to make."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from glrender import ConfigError, Scene
from glrender.capture.static_exposure import drawn_pixels
from glrender.emission.sources.tail import Tail
from glrender.emission.sources.volume import Volume
from glrender.scene.shape.files import MAX_FACETS
from glrender.scene.shape.generate import MAX_SUBDIVISIONS
from glrender.scene.shape.glb_files import pixels_of_images
from glrender.scene.shape.grids import WHOLE_FACETS, checked_rings, n_facets_of
from glrender.scene.shape.textures import MAX_TEXTURE_PX, texture_pixels
from glrender_camera.validate import integer, known_keys

from . import limits
from .envelope import ENVELOPE


def scene_asked(header: Mapping[str, Any], shape_dir: Path | None) -> Scene:
    """The scene of a `load_scene` request, within the bounds of `limits`.

    Raises
    ------
    ConfigError, ShapeError
        Messages name shape files without their folder, which is the server's own matter.
    """
    known_keys("", header, (*ENVELOPE, "scene"), required=("scene",))
    table = header["scene"]
    if isinstance(table, Mapping):
        _check_counts(table)
        _check_emission(table)
        if shape_dir is not None:
            _check_textures(table, shape_dir)
    try:
        scene = Scene.from_dict(table, shape_dir=shape_dir, restricted=True)
    except ConfigError as error:
        if shape_dir is not None:
            _hide(error, shape_dir)
        raise
    n_pixels = sum(camera.width_px * camera.height_px for camera in scene.cameras)
    n_drawn = sum(drawn_pixels(camera) for camera in scene.cameras)
    if n_pixels > limits.MAX_SCENE_PIXELS or n_drawn > 2 * limits.MAX_SCENE_PIXELS:
        raise ConfigError("scene.cameras", f"must have at most {limits.MAX_SCENE_PIXELS} pixels together, and twice as "
                          "many where margins and distortion are drawn", max(n_pixels, n_drawn))
    n_facets = sum(len(body.shape.facets) for body in scene.bodies)
    if n_facets > limits.MAX_SCENE_FACETS:
        raise ConfigError("scene.bodies", f"must have at most {limits.MAX_SCENE_FACETS} facets together", n_facets)
    n_cells = sum(source.cross_section_per_m.size * source.refine**3 for emission in scene.emission
                  for source in getattr(emission, "sources", ()) if isinstance(source, Volume))
    _check_sum("emission", n_cells, limits.MAX_SCENE_CELLS, "cells of dust")
    return scene


def _hide(error: ConfigError, folder: Path) -> None:
    """Take a folder out of all that an error says."""
    for name in ("path", "rule", "hint", "got"):
        value = getattr(error, name)
        if isinstance(value, str | Path):
            setattr(error, name, str(value).replace(f"{folder.resolve()}/", "").replace(f"{folder}/", ""))


def _check_counts(table: Mapping[str, Any]) -> None:
    """Refuse a scene before it is made, if its table shows that it is too large."""
    for name, most in (("bodies", limits.MAX_SCENE_BODIES), ("cameras", limits.MAX_SCENE_CAMERAS),
                       ("lamps", limits.MAX_SCENE_SOURCES)):
        if isinstance(table.get(name), list) and len(table[name]) > most:
            raise ConfigError(f"scene.{name}", f"must be at most {most}", len(table[name]))
    sides = [(c.get("width_px"), c.get("height_px")) for c in table.get("cameras") or () if isinstance(c, Mapping)]
    n_pixels = sum(w * h for w, h in sides if isinstance(w, int | float) and isinstance(h, int | float))
    if n_pixels > limits.MAX_SCENE_PIXELS:
        raise ConfigError("scene.cameras", f"must have at most {limits.MAX_SCENE_PIXELS} pixels together", n_pixels)
    shapes = list(_shapes(table))
    if len(shapes) > limits.MAX_SCENE_BODIES:
        raise ConfigError("scene.bodies", f"must be, with their regions, at most {limits.MAX_SCENE_BODIES}",
                          len(shapes))
    n_facets = sum(map(_facets_asked, shapes))
    if n_facets > limits.MAX_SCENE_FACETS:
        raise ConfigError("scene.bodies", f"must have at most {limits.MAX_SCENE_FACETS} facets together", n_facets)


def _shapes(table: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """Tables that have shapes: bodies' and their regions'."""
    for body in _tables(table.get("bodies")):
        yield body
        yield from _tables(body.get("regions"))


def _facets_asked(body: Mapping[str, Any]) -> float:
    """Facets that a body's table asks for, of which those of a file are unknown; 0 of one that is refused anyway."""
    made, ground = body.get("generated"), body.get("terrain")
    with contextlib.suppress(ConfigError):
        if isinstance(made, Mapping):
            return 20 * 4 ** integer("subdivisions", made.get("subdivisions", 0), 0, MAX_SUBDIVISIONS)
        if isinstance(ground, Mapping):
            if "rings" in ground:
                return n_facets_of(checked_rings(ground["rings"], MAX_FACETS))
            return integer("facets", ground.get("facets", WHOLE_FACETS), 0, MAX_FACETS)
    return 0


def _check_emission(table: Mapping[str, Any]) -> None:
    """Refuse sources that together take minutes; the scene checks each alone."""
    sources = [source for emission in _tables(table.get("emission")) for source in _tables(emission.get("sources"))]
    _check_sum("emission", len(sources), limits.MAX_SCENE_SOURCES, "sources")
    tails = [source for source in sources if source.get("model") == "tail"]
    for name, power, most, what in (("particles", 1, limits.MAX_SCENE_GRAINS, "grains"),
                                    ("cells", 3, limits.MAX_SCENE_CELLS, "cells of dust")):
        given = [tail.get(name, getattr(Tail, name)) for tail in tails]
        _check_sum("emission", sum(n**power for n in given if isinstance(n, int | float) and 0 < n < 1e9), most, what)


def _check_textures(table: Mapping[str, Any], folder: Path) -> None:
    """Refuse textures that are too large before a pixel is read; the reader refuses those that it cannot read."""
    n_pixels = 0
    for body in _shapes(table):
        ground = body.get("terrain")
        photo = ground.get("orthophoto") if isinstance(ground, Mapping) else None
        for key, name, counted in (("", body.get("albedo_texture"), texture_pixels), ("", photo, _drawn_pixels),
                                   ("shape", body.get("shape"), pixels_of_images)):
            # Names that lead elsewhere are refused by who opens them.
            if isinstance(name, str) and (key != "shape" or name.lower().endswith(".glb")):
                place = folder / Path(name).name
                n_pixels += counted(place) if place.is_file() else 0
    _check_sum("bodies", n_pixels, limits.MAX_SCENE_TEXTURE_PIXELS, "pixels of textures")


def _drawn_pixels(path: Path) -> int:
    """Pixels of an orthophoto that may be drawn: of one too large for a texture it is a part, as large as one."""
    return texture_pixels(path) or MAX_TEXTURE_PX


def _check_sum(name: str, total: float, most: int, what: str) -> None:
    if total > most:
        raise ConfigError(f"scene.{name}", f"must have at most {most} {what} together", total)


def _tables(value: object) -> Iterator[Mapping[str, Any]]:
    yield from (each for each in value if isinstance(each, Mapping)) if isinstance(value, list | tuple) else ()
