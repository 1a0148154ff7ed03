"""Terrain from maps of heights (GeoTIFF): posts in squares around a site, over a map, or on a cube around a globe."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from glrender_camera.validate import integer, known_keys, vector, within

from ...base.errors import ShapeError
from ...base.rotations import quaternion
from ..shape.ellipsoid import degrees_around, degrees_towards, east_north_up, places_m
from ..shape.files import MAX_FACETS, FileMesh
from ..shape.grids import WHOLE_FACETS, cells, checked_rings, cube, nested
from ..shape.shape import Shape
from ..shape.textures import MAX_TEXTURE_PX
from .geotiff import Map, opened

_log = logging.getLogger(__name__)
# Heights over the datum's radius [1] that are radii; relative difference of radii that is of another flattening.
_LIKE_RADIUS, _LIKE_DATUM = 0.5, 1e-3
# Longest side [px] of an orthophoto, of which a square is a texture with a pixel around it; pixels [1] read as one.
_PHOTO_PX, _COARSER = math.isqrt(MAX_TEXTURE_PX) - 2, 1.001


@dataclass(frozen=True, kw_only=True, eq=False)
class Terrain(Shape):
    """Ground of a map: a shape that knows its place on its planet.

    Attributes
    ----------
    q_site_from_planet : (4,) float64
        From the planet's axes, longitudes from +X, to the site's: +X east, +Y north, +Z up. Without a site none.
    r_site_planet_m : (3,) float64 [m]
        The ground at the site, the shape's origin. Without a site zero.
    albedo_map : (H, W) float32 or None
        The orthophoto's grey values over their full scale.
    """

    q_site_from_planet: np.ndarray
    r_site_planet_m: np.ndarray
    albedo_map: np.ndarray | None = None


class GeoTiff:
    """The reader of `.tif` and `.tiff`, and of `[bodies.terrain]`."""

    glrender_api = 1
    length_unit = "m"

    @staticmethod
    def read(path: Path, max_facets: int) -> FileMesh:
        """The whole map about its planet's centre."""
        made = patch(path, facets=min(WHOLE_FACETS, max_facets))
        return FileMesh(made.vertices_m, made.facets, warnings=made.report.warnings)

    @staticmethod
    def from_table(table: object, path_of: Callable[[str, object], Path]) -> Terrain:
        """The terrain of its table in a scene file; `path_of` gives the path of a field's file."""
        known_keys("", table, ("heights", "site_deg", "rings", "facets", "orthophoto"), required=("heights",))
        files = {key: path_of(key, table[key]) for key in ("heights", "orthophoto") if key in table}
        return patch(files.pop("heights"), **{key: table[key] for key in table if key != "heights"} | files)


def patch(path: str | Path, *, site_deg: Sequence[float] | None = None, rings: Sequence[Sequence[float]] | None = None,
          facets: int | None = None, orthophoto: str | Path | None = None) -> Terrain:
    """Ground around a site of a map, or all of the map.

    Parameters
    ----------
    path : path
        GeoTIFF with one band of heights [m] above its datum.
    site_deg : (2,) float [deg], optional
        Longitude, east, and latitude, planetographic on an ellipsoid, of the shape's origin. By default that is the
        planet's centre, and the axes are the planet's.
    rings : sequence of (float, float) [m], optional
        Half the side of a square and the distance of its posts, from the innermost outwards. By default the whole map.
    facets : int, 100..20,000,000, optional
        Of the whole map, about: 1,000,000 by default.
    orthophoto : path, optional
        GeoTIFF whose grey value over its full scale scales the law's albedo.

    Raises
    ------
    ShapeError, ConfigError
    """
    if rings is not None and (site_deg is None or facets is not None):
        wrong = ("site_deg", "missing") if site_deg is None else ("facets", "goes with the whole map", facets)
        raise ShapeError(*wrong, hint="rings are around a site, and have facets of their own")
    n_facets = integer("facets", WHOLE_FACETS if facets is None else facets, 100, MAX_FACETS)
    around, axes, origin_m = None if rings is None else checked_rings(rings, MAX_FACETS), np.eye(3), np.zeros(3)
    with opened(Path(path), "heights") as heights:
        if site_deg is not None:
            site, origin_m = _site(heights, site_deg)
            axes = east_north_up(site)
        if around is None:
            degrees, posts = _whole(heights, n_facets)
        elif around[-1][0] < min(heights.radii_m):
            away_m, posts = nested(around)
            degrees = degrees_around(site, away_m, heights.radii_m)
        else:
            raise ShapeError("rings", f"must end within {min(heights.radii_m):g} m, the datum's radius", around[-1][0],
                             "leave rings out for the whole map")
        height_m = heights.heights_m(heights.pixels(degrees))
    is_there, warnings, uv, albedo_map = np.isfinite(height_m), (), None, None
    kept, like_m = posts[is_there[posts].all(axis=1)], np.median(height_m[is_there]) if is_there.any() else 0.0
    if not len(kept):
        raise ShapeError("heights", "must have data where posts are", Path(path).name, "choose another site, or rings")
    if abs(like_m) > _LIKE_RADIUS * heights.radii_m[0]:
        raise ShapeError("heights", "must be above the sphere or ellipsoid of the datum", like_m,
                         f"of radii subtract {heights.radii_m[0]:.10g} m, or give the band that as its offset")
    if n := int((~is_there).sum()):
        warnings = (f"{n} posts, {100.0 * n / len(is_there):.3g} % of all, have no data or are off the map: holes",)
    if orthophoto is not None:
        with opened(Path(orthophoto), "orthophoto") as photo:
            albedo_map, uv, more = _albedo(photo, degrees, kept)
        if not np.allclose(photo.radii_m, heights.radii_m, rtol=_LIKE_DATUM):
            more += (f"the orthophoto's datum has radii of {photo.radii_m} m, the map's {heights.radii_m} m: its "
                     "latitudes may be of another kind, and its places off",)
        warnings += more
    for text in warnings:
        _log.warning("%s: %s", Path(path).name, text)
    places = places_m(degrees, np.where(is_there, height_m, 0.0), heights.radii_m)
    shape = Shape.from_arrays((axes @ (places - origin_m[:, None])).T, kept, uv=uv)
    made = {field.name: getattr(shape, field.name) for field in fields(Shape)}
    return Terrain(**made | {"report": replace(shape.report, warnings=warnings)}, albedo_map=albedo_map,
                   q_site_from_planet=quaternion(axes), r_site_planet_m=origin_m)


def _site(heights: Map, site_deg: Sequence[float]) -> tuple[np.ndarray, np.ndarray]:
    """A site (2,) [deg], checked, and its ground (3,) [m]."""
    lon, lat = vector("site_deg", site_deg, 2)
    site = np.array([within("site_deg[0]", lon, -360.0, 360.0), within("site_deg[1]", lat, -90.0, 90.0)])
    height_m = heights.heights_m(heights.pixels(site[:, None]))
    if not np.isfinite(height_m).all():
        raise ShapeError("site_deg", f"must be where the map, which reaches {heights.reach}, has data", site.tolist(),
                         "longitude east, then latitude, in degrees")
    return site, places_m(site[:, None], height_m, heights.radii_m)[:, 0]


def _whole(heights: Map, n_facets: int) -> tuple[np.ndarray, np.ndarray]:
    """Longitudes and latitudes (2, N) [deg] of a whole map's posts, and facets (F, 3) between them."""
    if heights.is_round:
        direction, facets = cube(max(round(math.sqrt(n_facets / 12.0)), 1))
        return degrees_towards(direction, heights.radii_m), facets
    if min(heights.shape) < 2:
        raise ShapeError("heights", "must have two rows and columns at least", heights.shape, "give a site and rings")
    coarser = max(math.sqrt(2.0 * math.prod(n - 1 for n in heights.shape) / n_facets), 1.0)
    down, across = (np.linspace(0.0, n - 1.0, max(round((n - 1) / coarser), 1) + 1) for n in heights.shape)
    pixel = np.stack(np.meshgrid(across, down[::1 if heights.is_mirrored else -1], indexing="ij"))
    return heights.degrees(pixel.reshape(2, -1)), cells(np.arange(pixel[0].size).reshape(pixel.shape[1:]))


def _albedo(photo: Map, degrees: np.ndarray, facets: np.ndarray) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Grey values, the mean where the photo has none, texture coordinates (F, 3, 2) of posts (2, N) [deg], warnings."""
    pixel = photo.pixels(degrees)[:, facets]
    if photo.turn_px:  # a facet across the map's edge goes on beyond it
        pixel[0] -= photo.turn_px * np.round((pixel[0] - pixel[0, :, :1]) / photo.turn_px)
    grey, place = photo.grey(pixel := pixel.reshape(2, -1), _PHOTO_PX)
    is_none, mean = np.isnan(grey), float(np.nanmean(grey)) if np.isfinite(grey).any() else 1.0
    size = np.array(grey.shape[::-1])[:, None]
    column, row = np.clip(np.rint(place), 0, size - 1).astype(int)
    off = 100.0 * float((is_none[row, column] | ~photo.has(pixel)).mean())
    warnings = (f"{off:.3g} % of the ground is off the orthophoto, and has its mean albedo",) if off else ()
    if (coarser := float(np.ptp(pixel[0]) / np.ptp(place[0]))) > _COARSER:
        warnings += (f"the orthophoto is read in means of {coarser:.3g} of its pixels a side: an albedo has at most "
                     f"{_PHOTO_PX} a side; give rings, or a part of the photo, for more",)
    grey = np.pad(np.where(is_none, mean, grey), 1, constant_values=mean).astype(np.float32)
    if photo.is_round:
        grey[:, [0, -1]] = grey[:, [-2, 1]]
    u, v = np.clip(place + 1.5, 0.5, size + 1.5) / (size + 2.0)
    return grey, np.stack([u, 1.0 - v], axis=-1).astype(np.float32).reshape(-1, 3, 2), warnings
