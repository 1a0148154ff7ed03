"""Terrain from GeoTIFFs that are written here by rasterio: waves in closed form, on spheres and on an ellipsoid."""

from __future__ import annotations

import re
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from glrender import Body, ConfigError, Region, Scene, Shape, frames
from glrender.brdf import Lambert
from glrender.scene.formats.terrain import GeoTiff, patch
from glrender.scene.plugins.registry import shape_readers
from glrender.scene.shape.files import MAX_FACETS
from glrender.scene.shape.grids import checked_rings, nested
from glrender.scene.surface import Surface
from missing import missing, needed_module
from scipy.spatial import cKDTree

MOON_M, MARS_M = 1_737_400.0, (3_396_190.0, 3_376_200.0)
EQUIRECTANGULAR = f"+proj=eqc +lat_ts=26 +R={MOON_M} +units=m"
POLAR = f"+proj=stere +lat_0=-90 +lat_ts=-90 +R={MOON_M} +units=m"
LONG_LAT = f"+proj=longlat +R={MOON_M}"
# Longitude and latitude of a site, and its place on each projection by the projection's own formula.
APOLLO, POLE = (3.63, 26.13), (18.0, -88.0)
ON_POLAR_M = 2.0 * MOON_M * np.tan(0.25 * np.pi + np.radians(-88.0) / 2.0) * np.array(
    [np.sin(np.radians(18.0)), np.cos(np.radians(18.0))])
ON_PLANE_M = MOON_M * np.radians(APOLLO) * [np.cos(np.radians(26.0)), 1.0]
TABLE = {"cameras": [{"name": "c", "width_px": 8, "height_px": 8, "focal_length_px": 20.0}]}
BRDF = {"law": "lambert", "normal_albedo": 0.1}


def rasterio():
    needed_module("rasterio.warp", "pip install \"glrender[terrain]\"")
    return needed_module("rasterio", "pip install \"glrender[terrain]\"")


def write(path, heights, crs, left_top, px, *, nodata=None, scale=None, offset=None, unit=None, bands=1, **options):
    """A GeoTIFF of heights (H, W), its top-left corner and the size of a pixel on its projection."""
    gdal = rasterio()
    place = None if left_top is None else gdal.transform.from_origin(*left_top, px, px)
    with gdal.open(path, "w", driver="GTiff", height=heights.shape[0], width=heights.shape[1], count=bands,
                   dtype=heights.dtype, crs=None if crs is None else gdal.CRS.from_string(crs), transform=place,
                   nodata=nodata, **options) as made:
        for band in range(1, bands + 1):
            made.write(heights, band)
        if scale is not None:
            made.scales, made.offsets = (scale,), (offset,)
        if unit is not None:
            made.set_band_unit(1, unit)
    return path


def waves(lon_deg, lat_deg):
    """Heights [m] of waves of some 300 m."""
    x, y, z = place(np.radians(lon_deg), np.radians(lat_deg))
    return 8.0 * np.sin(2.0 * np.pi * x / 300.0) * np.cos(2.0 * np.pi * (y + z) / 520.0) + 40.0


def place(lon, lat):
    return MOON_M * np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])


def map_of_waves(path, projection, px=15.0, half_m=3000.0, **options):
    """Waves around a site, their places by each projection's own formula."""
    middle = ON_PLANE_M if projection == EQUIRECTANGULAR else ON_POLAR_M
    n = round(2.0 * half_m / px)
    x = middle[0] - half_m + px * (np.arange(n) + 0.5)
    y = middle[1] + half_m - px * (np.arange(n) + 0.5)
    x, y = np.meshgrid(x, y)
    if projection == EQUIRECTANGULAR:
        lon, lat = np.degrees(x / MOON_M / np.cos(np.radians(26.0))), np.degrees(y / MOON_M)
    else:
        lon, lat = np.degrees(np.arctan2(x, y)), 2.0 * np.degrees(np.arctan(np.hypot(x, y) / (2.0 * MOON_M))) - 90.0
    return write(path, waves(lon, lat).astype(np.float32), projection, (middle[0] - half_m, middle[1] + half_m), px,
                 **options)


def on_planet(ground):
    """Longitudes and latitudes [deg] and distances from the planet's centre [m] of the ground's vertices."""
    x, y, z = (ground.vertices_m @ frames.dcm(ground.q_site_from_planet) + ground.r_site_planet_m).T
    radius_m = np.sqrt(x * x + y * y + z * z)
    return np.degrees(np.arctan2(y, x)), np.degrees(np.arcsin(z / radius_m)), radius_m


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("maps")
    for name, projection in (("plane.tif", EQUIRECTANGULAR), ("polar.tif", POLAR)):
        map_of_waves(folder / name, projection)
    return folder


@pytest.mark.parametrize("name, site", [("plane.tif", APOLLO), ("polar.tif", POLE)])
def test_the_ground_is_the_maps_in_its_place(files, name, site):
    """0.15 m RMS and 1 m at most, to closed form; the site at the origin, x east, y north, z up; no crack."""
    rings = [[300.0, 15.0], [900.0, 37.0], [2000.0, 60.0]]
    ground = patch(files / name, site_deg=site, rings=rings)
    lon, lat, radius_m = on_planet(ground)
    off_m = radius_m - MOON_M - waves(lon, lat)
    assert np.sqrt(np.mean(off_m**2)) < 0.15 and np.abs(off_m).max() < 1.0
    assert np.linalg.norm(ground.vertices_m, axis=1).min() < 1e-6
    np.testing.assert_allclose(ground.r_site_planet_m,
                               place(*np.radians(site)) * (1.0 + waves(*site) / MOON_M), atol=1.0)
    near = np.abs(ground.vertices_m[:, :2]).max(axis=1) < 200.0
    north_m, east_m = MOON_M * np.radians(lat - site[1]), MOON_M * np.radians(lon - site[0]) * np.cos(np.radians(lat))
    np.testing.assert_allclose(ground.vertices_m[near, 0], east_m[near], atol=1.0)
    np.testing.assert_allclose(ground.vertices_m[near, 1], north_m[near], atol=1.0)
    report = ground.report
    last = 34
    assert (report.n_shells, report.n_flipped, report.n_open_edges, report.warnings) == (1, 0, 8 * last, ())
    assert (ground.facet_normals[:, 2] > 0.5).all()
    assert np.abs(ground.vertices_m[:, :2]).max() == pytest.approx(60.0 * last, abs=2.0)


@pytest.mark.parametrize("rings", [[(10.0, 1.0), (40.0, 4.0)], [(10.0, 1.0), (12.0, 7.0), (90.0, 30.0)],
                                   [(9.5, 3.0), (10.0, 3.0)], [(1.0, 5.0)]])
def test_squares_around_each_other_leave_no_gap(rings):
    """Their triangles' areas, each with a sign, add up to the largest square's, and each is one way round."""
    places, facets = nested(rings)
    a, b, c = (places[:, facets[:, k]] for k in range(3))
    area = 0.5 * ((b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0])
    side = np.ptp(places[0])
    assert side >= 2.0 * rings[-1][0] and np.ptp(places[1]) == side and area.min() > 0.0
    np.testing.assert_allclose(area.sum(), side**2, rtol=1e-12)
    assert len(np.unique(facets)) == places.shape[1]


def globe(path, crs, left_deg, per_deg, left, n_columns=180):
    """A map of all longitudes and latitudes, of a bulge that no edge of a map interrupts."""
    step = 360.0 / n_columns
    along = step * (np.arange(n_columns) + 0.5)
    heights = bulge(*np.meshgrid(left_deg + along, 90.0 - along[:n_columns // 2])).astype(np.float32)
    return write(path, heights, crs, (left, 90.0 * per_deg), step * per_deg)


def bulge(lon_deg, lat_deg):
    lon, lat = np.radians(lon_deg), np.radians(lat_deg)
    return 2000.0 * np.cos(lat) ** 2 * np.sin(2.0 * lon) + 1000.0 * np.sin(lat)


def test_a_map_whose_parallels_shorten_is_no_globe(tmp_path):
    """A sinusoidal map of the whole Moon: its corners are off the planet, and nothing is wrapped."""
    along = (np.arange(180) + 0.5) * 2.0
    x, y = np.meshgrid(along - 180.0, 90.0 - along[:90])
    lon = x / np.cos(np.radians(y))
    heights = np.where(np.abs(lon) < 180.0, bulge(lon, y), -32768.0).astype(np.float32)
    per_deg = np.pi * MOON_M / 180.0
    path = write(tmp_path / "sinusoidal.tif", heights, f"+proj=sinu +R={MOON_M} +units=m",
                 (-180.0 * per_deg, 90.0 * per_deg), 2.0 * per_deg, nodata=-32768.0)
    ground = patch(path, site_deg=[40.0, 50.0], rings=[[300e3, 10e3]])
    lon, lat, radius_m = on_planet(ground)
    np.testing.assert_allclose(radius_m - MOON_M, bulge(lon, lat), atol=40.0)


@pytest.mark.parametrize("crs, left_deg, middle_deg, per_deg", [
    (LONG_LAT, -180.0, 0.0, 1.0), (LONG_LAT, 0.0, 0.0, 1.0), (LONG_LAT, -360.0, 0.0, 1.0),
    *((f"+proj=eqc +lon_0={middle} +R={MOON_M} +units=m", middle - 180.0, middle, np.pi * MOON_M / 180.0)
      for middle in (180.0, 200.0, 180.5)),
    (f"+proj=eqc +R={MOON_M} +units=m", 0.0, 0.0, np.pi * MOON_M / 180.0),
    (f"+proj=eqc +R={MOON_M} +units=km", -180.0, 0.0, np.pi * MOON_M / 180e3)])
def test_a_globe_is_closed(tmp_path, crs, left_deg, middle_deg, per_deg):
    """Across the map's edge and the poles, with the facets that are asked for; planet's axes about its centre."""
    path = globe(tmp_path / "globe.tif", crs, left_deg, per_deg, (left_deg - middle_deg) * per_deg)
    ground = patch(path, facets=30_000)
    lon, lat, radius_m = on_planet(ground)
    assert ground.report.is_watertight and ground.report.n_shells == 1 and ground.report.warnings == ()
    assert len(ground.facets) == 30_000 and not ground.r_site_planet_m.any()
    np.testing.assert_allclose(radius_m - MOON_M, bulge(lon, lat), atol=40.0)
    assert ground.report.volume_m3 > 0.0
    # At a pole, and where the map begins: no hole.
    for site in ([40.0, -90.0], [left_deg, 12.0]):
        assert patch(path, site_deg=site, rings=[[2e5, 2e4]]).report.n_open_edges == 80


def test_a_globe_whose_meridians_are_its_rows_is_refused(tmp_path):
    """It was taken for a map that ends at its edges, with a seam; where columns run west, it is read as it is."""
    heights = bulge(*np.meshgrid(-179.0 + 2.0 * np.arange(180), 89.0 - 2.0 * np.arange(90))).astype(np.float32)
    for name, values, steps in (("turned.tif", heights.T, (0.0, 2.0, -180.0, -2.0, 0.0, 90.0)),
                                ("west.tif", heights[:, ::-1], (-2.0, 0.0, 180.0, 0.0, -2.0, 90.0))):
        with rasterio().open(tmp_path / name, "w", driver="GTiff", width=values.shape[1], height=values.shape[0],
                             count=1, dtype="float32", crs=rasterio().CRS.from_string(LONG_LAT),
                             transform=rasterio().Affine(*steps)) as made:
            made.write(values, 1)
    with pytest.raises(ConfigError, match="^heights: must go round its planet along its rows.*; gdalwarp turns it"):
        patch(tmp_path / "turned.tif", facets=3000)
    lon, lat, radius_m = on_planet(ground := patch(tmp_path / "west.tif", facets=3000))
    np.testing.assert_allclose(radius_m - MOON_M, bulge(lon, lat), atol=40.0)
    assert ground.report.is_watertight and ground.report.volume_m3 > 0.0


def test_an_orthophoto_that_is_read_coarse_says_so(tmp_path):
    """One wider than an albedo may be, under the globe; a part of it is read as it is."""
    heights = globe(tmp_path / "globe.tif", LONG_LAT, -180.0, 1.0, -180.0)
    place = rasterio().Affine(360.0 / 23_166, 0.0, -180.0, 0.0, -18.0, 90.0)
    with rasterio().open(tmp_path / "wide.tif", "w", driver="GTiff", width=23_166, height=10, count=1, dtype="uint8",
                         crs=rasterio().CRS.from_string(LONG_LAT), transform=place) as made:
        made.write(np.full((10, 23_166), 99, np.uint8), 1)
    (text,) = patch(heights, facets=2000, orthophoto=tmp_path / "wide.tif").report.warnings
    assert text.startswith("the orthophoto is read in means of 2 of its pixels a side: an albedo has at most 11583")
    near = patch(heights, orthophoto=tmp_path / "wide.tif", site_deg=(10.0, 5.0), rings=[[60e3, 4e3]])
    assert near.report.warnings == ()


@pytest.mark.parametrize("unit", ["km", "Kilometers", "kilometre"])
def test_numbers_of_a_band_become_metres(tmp_path, unit):
    """Scale, offset and kilometres, by any of the unit's names."""
    heights = np.round(bulge(*np.meshgrid(-179.0 + 2.0 * np.arange(180), 89.0 - 2.0 * np.arange(90))) / 0.5)
    path = write(tmp_path / "scaled.tif", (heights + 4000.0).astype(np.int16), LONG_LAT, (-180.0, 90.0), 2.0,
                 scale=0.0005, offset=-2.0, unit=unit)
    lon, lat, radius_m = on_planet(patch(path, facets=5000))
    np.testing.assert_allclose(radius_m - MOON_M, bulge(lon, lat), atol=40.0)


def test_an_ellipsoid_is_under_the_heights(tmp_path):
    """Of Mars: vertices on the ellipsoid that is 100 m higher along its normal, and z along the normal at the site."""
    a, b = MARS_M
    path = write(tmp_path / "mars.tif", np.full((200, 200), 100.0, np.float32), f"+proj=longlat +a={a} +b={b}",
                 (135.0, -3.0), 0.02)
    ground = patch(path, site_deg=[137.4, -4.6], rings=[[2000.0, 100.0], [40_000.0, 2000.0]])
    r_m = ground.vertices_m @ frames.dcm(ground.q_site_from_planet) + ground.r_site_planet_m
    normal = r_m / [a**2, a**2, b**2]
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    below = r_m - 100.0 * normal
    np.testing.assert_allclose(((below / [a, a, b]) ** 2).sum(axis=1), 1.0, atol=1e-9)
    lat, lon = np.radians([-4.6, 137.4])
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    np.testing.assert_allclose(frames.dcm(ground.q_site_from_planet)[2], up, atol=1e-12)
    assert np.abs(ground.vertices_m[:, 2]).max() == pytest.approx(2.0 * 40_000.0**2 / (2.0 * a), rel=0.1)


def test_a_whole_map_that_goes_not_round(files):
    """Facets as asked for, about the centre or about a site; the same file by its ending."""
    for site in (None, POLE):
        ground = patch(files / "polar.tif", facets=20_000, site_deg=site)
        lon, lat, radius_m = on_planet(ground)
        off_m = radius_m - MOON_M - waves(lon, lat)
        assert np.sqrt(np.mean(off_m**2)) < 0.15 and len(ground.facets) == pytest.approx(20_000, rel=0.02)
        planet_from_site = frames.dcm(ground.q_site_from_planet).T
        outward = ground.r_site_planet_m + ground.vertices_m[ground.facets[:, 0]] @ planet_from_site.T
        normals = ground.facet_normals @ planet_from_site.T
        assert (np.einsum("ij,ij->i", normals, outward) > 0.0).all()


def test_maps_that_are_turned_or_mirrored_face_up(tmp_path):
    """A whole map whose rows run north, east or askew: outward facets at their places."""
    n, on = 60, f"+proj=tmerc +lon_0=3.63 +R={MOON_M}"
    x0, y0 = 0.0, MOON_M * np.radians(26.13)
    for steps in ((10.0, 0.0, 0.0, 10.0), (0.0, 10.0, 10.0, 0.0), (8.0, 6.0, 6.0, -8.0), (-10.0, 0.0, 0.0, 10.0)):
        a, b, d, e = steps
        at = rasterio().Affine(a, b, x0 - 0.5 * n * (a + b), d, e, y0 - 0.5 * n * (d + e))
        with rasterio().open(tmp_path / "turned.tif", "w", driver="GTiff", width=n, height=n, count=1, dtype="float32",
                             crs=rasterio().CRS.from_string(on), transform=at) as made:
            made.write(np.fromfunction(lambda row, column: row + 0.5 * column, (n, n)).astype(np.float32), 1)
        ground = patch(tmp_path / "turned.tif", site_deg=APOLLO)
        assert (ground.facet_normals[:, 2] > 0.5).all() and len(ground.facets) == 2 * 59**2
        # The height rises by 1 m a row and 0.5 m a column.
        rise = np.linalg.solve(np.array([[a, d], [b, e]]), [0.5, 1.0])
        np.testing.assert_allclose(np.polynomial.polynomial.polyval2d(
            *ground.vertices_m[:, :2].T, np.array([[0.0, rise[1]], [rise[0], 0.0]])), ground.vertices_m[:, 2], atol=0.3)


def test_ground_without_data_is_a_hole_and_is_reported(tmp_path, caplog):
    """How much of it, in the report and in the log: data that is missing, and ground off the map."""
    n = 200
    heights = np.zeros((n, n), np.float32)
    heights[50:60, 80:100] = -9999.0
    at = ON_PLANE_M + [-1000.0, 1000.0]
    path = write(tmp_path / "holes.tif", heights, EQUIRECTANGULAR, at, 10.0, nodata=-9999.0)
    ground = patch(path, site_deg=APOLLO, rings=[[900.0, 10.0]])
    missing_m2 = (2 * 900.0) ** 2 - ground.facet_areas_m2.sum()
    # Posts are at most a pixel off the hole's 200 m x 100 m.
    assert 190.0 * 90.0 < missing_m2 < 220.0 * 120.0
    (text,) = ground.report.warnings
    assert "231 posts, 0.705 %" in text and "no data or are off the map" in text and text in caplog.text
    beyond = patch(path, site_deg=APOLLO, rings=[[2000.0, 20.0]])
    assert 3.8e6 < beyond.facet_areas_m2.sum() < 4e6 and "75.7 %" in beyond.report.warnings[0]
    nan = write(tmp_path / "nan.tif", np.where(heights < 0.0, np.float32(np.nan), heights), EQUIRECTANGULAR,
                ON_PLANE_M + [-1000.0, 1000.0], 10.0)
    assert len(patch(nan, site_deg=APOLLO, rings=[[900.0, 10.0]]).facets) == len(ground.facets)


@pytest.mark.parametrize("options, message", [
    ({"rings": [[100.0, 10.0]]}, "site_deg: missing; rings are around a site"),
    ({"site_deg": APOLLO, "rings": [[100.0, 10.0]], "facets": 1000}, "facets: goes with the whole map, got 1000; "),
    ({"site_deg": (8.0, 26.0), "rings": [[100.0, 10.0]]}, r"site_deg: must be where the map, which reaches 3.5\d+ to "
     r"3.7\d+ deg east, 26.0\d+ to 26.2\d+ deg north, has data, got \[8.0, 26.0\]; longitude east"),
    ({"site_deg": (26.13, 3.63)}, "site_deg: must be where the map"),
    ({"site_deg": (3.63, 91.0)}, r"site_deg\[1\]: must be .*90"), ({"site_deg": 3.0}, "site_deg: must be 2 numbers"),
    ({"site_deg": APOLLO, "rings": []}, "rings: must be 1 to 32 pairs"),
    ({"site_deg": APOLLO, "rings": [[100.0]]}, r"rings\[0\]: must have shape \(2,\)"),
    ({"site_deg": APOLLO, "rings": [[100.0, 0.0]]}, r"rings\[0\]: must be.*> 0"),
    ({"site_deg": APOLLO, "rings": [[-100.0, 2.0]]}, r"rings\[0\]: must be.*> 0"),
    ({"site_deg": APOLLO, "rings": [[float("nan"), 2.0]]}, r"rings\[0\]: must be finite"),
    ({"site_deg": APOLLO, "rings": [[100.0, 10.0], [50.0, 20.0]]}, r"rings\[1\]: must reach farther .*innermost"),
    ({"site_deg": APOLLO, "rings": [[100.0, 10.0], [200.0, 2.0]]}, r"rings\[1\]: .*posts no nearer"),
    ({"site_deg": APOLLO, "rings": [[30_000.0, 10.0]]}, "rings: must make at most 20000000 facets, got 72000000; set "
     "posts farther apart"),
    ({"site_deg": APOLLO, "rings": [[2e6, 5e4]]}, "rings: must end within 1.7374e.06 m, the datum's.*leave rings out"),
    ({"site_deg": APOLLO, "rings": [[1e300, 1e-300]]}, "rings: must make at most 20000000 facets, got inf"),
    ({"site_deg": APOLLO, "rings": np.array([[100.0, 10.0], [50.0, 20.0]])}, r"rings\[1\]: must reach farther"),
    ({"site_deg": (3.63, 89.0)}, "site_deg: must be where"),
    ({"facets": 0}, "facets: must be an integer between 100 and 20000000")])
def test_what_breaks_a_rule_is_refused_with_a_way_out(files, options, message):
    with pytest.raises(ConfigError, match=f"^{message}"):
        patch(files / "plane.tif", **options)


def test_maps_that_are_none_are_refused(tmp_path):
    flat, at = np.zeros((20, 20), np.float32), (0.0, 20.0)
    wrong = {
        "place.tif": (write(tmp_path / "place.tif", flat, None, at, 1.0), "must have a projection with its datum.*got "
                      ".*; write it with both"),
        "scale.tif": (write(tmp_path / "scale.tif", flat, LONG_LAT, None, 1.0), "must have a projection"),
        "bands.tif": (write(tmp_path / "bands.tif", flat, LONG_LAT, at, 1.0, bands=2), "must have one band.*got '2"),
        "feet.tif": (write(tmp_path / "feet.tif", flat, LONG_LAT, at, 1.0, unit="ft"), "must have one band.*in ft"),
        "radii.tif": (write(tmp_path / "radii.tif", flat + MOON_M, LONG_LAT, at, 1.0),
                      "must be above the sphere or ellipsoid.*got 17374.*of radii subtract 1737400 m"),
        "none.tif": (write(tmp_path / "none.tif", flat, LONG_LAT, at, 1.0, nodata=0.0), "must have data where posts"),
        "row.tif": (write(tmp_path / "row.tif", flat[:1], LONG_LAT, at, 1.0), "must have two rows.*give a site and"),
        "least.tif": (write(tmp_path / "least.tif", np.where(flat + np.arange(20) < 3, -32768, 9).astype(np.int16),
                            LONG_LAT, at, 1.0), "must name its number for no data.*got -32768; gdal_edit"),
        "low.tif": (write(tmp_path / "low.tif", np.where(flat + np.arange(20) < 3, np.float32(-3.4e38), flat),
                          LONG_LAT, at, 1.0), "must name its number for no data.*; gdal_edit"),
        "custom.tif": (write(tmp_path / "custom.tif", np.where(flat + np.arange(20) < 3, np.float32(-9999.0), flat),
                             LONG_LAT, at, 1.0), "must name its number for no data.*got -9999"),
        "top.tif": (write(tmp_path / "top.tif", np.where(flat + np.arange(20) < 3, 32767, 9).astype(np.int16),
                          LONG_LAT, at, 1.0), "must name its number for no data.*got 32767"),
        "most.tif": (write(tmp_path / "most.tif", np.where(flat + np.arange(20) < 3, 65535, 9).astype(np.uint16),
                           LONG_LAT, at, 1.0), "must name its number for no data.*got 65535"),
        "long.tif": (write(tmp_path / "long.tif", np.where(flat + np.arange(20) < 3, -99999, 9).astype(np.int32),
                           LONG_LAT, at, 1.0), "must name its number for no data.*got -99999"),
        "centric.tif": (write(tmp_path / "centric.tif", flat, "IAU_2015:49902", at, 1.0),
                        r"must have longitudes east.*got 'Mars \(2015\) / Ocentric'; gdalwarp -s_srs"),
        "west.tif": (write(tmp_path / "west.tif", flat, "IAU_2015:49901", at, 1.0),
                     "must have longitudes east.*Ographic"),
        "high.tif": (write(tmp_path / "high.tif", np.where(flat + np.arange(20) < 3, np.float32(1e38), flat),
                           LONG_LAT, at, 1.0), "must name its number for no data.*; gdal_edit"),
        "disc.tif": (write(tmp_path / "disc.tif", flat, f"+proj=ortho +R={MOON_M}", (-2e6, 2e6), 2e5),
                     "has a projection that does not show all.*; give a site and near rings"),
        "gone.tif": (tmp_path / "gone.tif", "is no readable GeoTIFF.*No such file"),
        "note.tif": (tmp_path / "note.tif", "is no readable GeoTIFF.*gdal_translate")}
    (tmp_path / "note.tif").write_text("heights")
    whole = map_of_waves(tmp_path / "whole.tif", EQUIRECTANGULAR, px=30.0).read_bytes()
    (tmp_path / "cut.tif").write_bytes(whole[:len(whole) // 2])
    wrong["cut.tif"] = tmp_path / "cut.tif", "is no readable GeoTIFF.*cut off"
    # A format of GDAL's that leads to other files.
    (tmp_path / "leads.tif").write_text('<VRTDataset rasterXSize="20" rasterYSize="20"><VRTRasterBand band="1">'
                                        f'<SimpleSource><SourceFilename>{tmp_path / "whole.tif"}</SourceFilename>'
                                        '</SimpleSource></VRTRasterBand></VRTDataset>')
    wrong["leads.tif"] = tmp_path / "leads.tif", "is no readable GeoTIFF"
    for path, message in wrong.values():
        with pytest.raises(ConfigError, match=f"^heights: {message}"):
            patch(path)
    with pytest.raises(ConfigError, match="^site_deg: must be where the map"):
        patch(wrong["none.tif"][0], site_deg=(10.0, 10.0))


def test_a_sphere_has_latitudes_of_one_kind(tmp_path):
    path = write(tmp_path / "sphere.tif", np.zeros((20, 20), np.float32), "IAU_2015:49900", (0.0, 20.0), 1.0)
    np.testing.assert_allclose(np.linalg.norm(patch(path).vertices_m, axis=1), MARS_M[0], rtol=1e-12)


@pytest.mark.parametrize("site", [None, APOLLO, (3.65, 26.14)])
def test_a_map_is_a_region_in_its_place(files, site):
    """On ground about its planet's centre, about the same site, and about another: in place to a micrometre."""
    around = patch(files / "plane.tif", **({"facets": 20_000} if site is None else {
        "site_deg": site, "rings": [[2000.0, 100.0]]}))
    fine = patch(files / "plane.tif", site_deg=APOLLO, rings=[[200.0, 15.0]])
    body = Body(name="ground", shape=around, brdf=Lambert(normal_albedo=0.1), regions=[Region(shape=fine)])
    on_planet_m = fine.vertices_m @ frames.dcm(fine.q_site_from_planet) + fine.r_site_planet_m
    there = (on_planet_m - around.r_site_planet_m) @ frames.dcm(around.q_site_from_planet).T
    off_m, _ = cKDTree(body.shape.vertices_m).query(there)
    assert off_m.max() < 1e-6 and body.shape.report.seams[0].gap_max_m < 6.0


def test_a_missing_rasterio_is_said(files, monkeypatch):
    monkeypatch.setitem(sys.modules, "rasterio.warp", None)
    with pytest.raises(ConfigError, match=r"^heights: needs rasterio.*; pip install .glrender\[terrain\]"):
        patch(files / "plane.tif")


def test_an_orthophoto_is_the_albedo(tmp_path, files):
    """In its place to a tenth of a grey value, its mean beyond its edges, with a warning that says how much."""
    x, y = np.meshgrid(np.arange(300), np.arange(300))
    grey = np.where(x + y < 300, 50 + x // 4, 180 - y // 4).astype(np.uint8)
    photo = write(tmp_path / "photo.tif", grey, EQUIRECTANGULAR, ON_PLANE_M + [-1500.0, 1500.0], 10.0)
    ground = patch(files / "plane.tif", site_deg=APOLLO, rings=[[1000.0, 50.0]], orthophoto=photo)
    surface = Surface(Body(name="a", shape=ground, brdf=Lambert(normal_albedo=0.1), albedo_map=ground.albedo_map))
    facet = np.arange(len(ground.facets))
    scale = surface.albedo_scale(facet, np.tile([1.0, 0.0, 0.0], (len(facet), 1)))
    lon, lat, _ = on_planet(ground)
    column = (MOON_M * np.cos(np.radians(26.0)) * np.radians(lon) - ON_PLANE_M[0] + 1500.0) / 10.0 - 0.5
    row = (ON_PLANE_M[1] + 1500.0 - MOON_M * np.radians(lat)) / 10.0 - 0.5
    corner = ground.facets[:, 0]
    even = np.abs(column + row - 299.0)[corner] > 3.0
    expected = np.where(column + row < 299.0, 50.0 + column / 4.0 - 0.375, 180.0 - row / 4.0 + 0.375)[corner] / 255.0
    np.testing.assert_allclose(scale[even], expected[even], atol=0.5 / 255.0)
    assert ground.report.warnings == ()
    wide = patch(files / "plane.tif", site_deg=APOLLO, rings=[[2500.0, 50.0]], orthophoto=photo)
    (text,) = wide.report.warnings
    assert "64" in text and "off the orthophoto, and has its mean albedo" in text
    surface = Surface(Body(name="a", shape=wide, brdf=Lambert(normal_albedo=0.1), albedo_map=wide.albedo_map))
    outside = np.flatnonzero((np.abs(wide.vertices_m[wide.facets][..., :2]) > 1700.0).any(axis=2).all(axis=1))
    beyond = surface.albedo_scale(outside)
    np.testing.assert_allclose(beyond[[0, -1]], grey.mean() / 255.0, atol=0.005)
    with pytest.raises(ConfigError, match="^orthophoto: must show some of the ground"):
        patch(files / "plane.tif", site_deg=APOLLO, rings=[[100.0, 50.0]], orthophoto=files / "polar.tif")


def shade(lon_deg, lat_deg):
    """An albedo that varies once in 90 deg of longitude."""
    lon, lat = np.radians(lon_deg), np.radians(lat_deg)
    return 0.5 + 0.3 * np.sin(4.0 * lon) * np.cos(lat) ** 2 + 0.1 * np.sin(3.0 * lat)


def shades(path, per_one, dtype, **options):
    """A map of `shade` around the Moon, from 0 deg east, in numbers of which so many are 1."""
    along = (np.arange(720) + 0.5) / 2.0
    return write(path, np.round(per_one * shade(*np.meshgrid(along, 90.0 - along[:360]))).astype(dtype), LONG_LAT,
                 (0.0, 90.0), 0.5, **options)


def factors(ground, rng):
    """Factors on the albedo at three random places of each facet, and longitudes and latitudes [deg] of these."""
    facet, body = np.repeat(np.arange(len(ground.facets)), 3), Body(
        name="a", shape=ground, brdf=Lambert(normal_albedo=0.1), albedo_map=ground.albedo_map)
    weights = rng.dirichlet([1.0, 1.0, 1.0], len(facet))
    places = np.einsum("fc,fcx->fx", weights, ground.vertices_m[ground.facets[facet]])
    lon, lat, _ = on_planet(replace(ground, vertices_m=places))
    return Surface(body).albedo_scale(facet, weights), lon, lat


@pytest.mark.parametrize("site", [(0.0, 5.0), (360.0, -40.0), (33.0, -12.0), (0.0, 90.0), None])
def test_an_orthophoto_goes_on_across_its_edge(tmp_path, site):
    """A photo of the whole Moon under sites at its seam, elsewhere, at the pole, and under the globe: no streak."""
    heights = globe(tmp_path / "globe.tif", LONG_LAT, -180.0, 1.0, -180.0)
    around = {"facets": 20_000} if site is None else {"site_deg": site, "rings": [[60e3, 4e3], [150e3, 10e3]]}
    ground = patch(heights, orthophoto=shades(tmp_path / "photo.tif", 255, np.uint8), **around)
    scale, lon, lat = factors(ground, np.random.default_rng(1))
    assert ground.report.warnings == ()
    # A facet of the globe has 1.6 deg, across which the shade varies by 0.03; a streak would be off by 0.3.
    np.testing.assert_allclose(scale, shade(lon, lat), atol=0.03 if site is None else 0.006)


@pytest.mark.parametrize("per_one, dtype, options", [
    (10_000, np.int16, {"scale": 1e-4, "offset": 0.0}), (65_535, np.uint16, {}), (4095, np.uint16, {"nbits": 12}),
    (32_767, np.int16, {})])
def test_an_orthophotos_numbers_are_over_their_full_scale_or_scaled_as_it_says(tmp_path, per_one, dtype, options):
    heights = globe(tmp_path / "globe.tif", LONG_LAT, -180.0, 1.0, -180.0)
    photo = shades(tmp_path / "photo.tif", per_one, dtype, **options)
    ground = patch(heights, orthophoto=photo, site_deg=(33.0, -12.0), rings=[[100e3, 10e3]])
    scale, lon, lat = factors(ground, np.random.default_rng(1))
    np.testing.assert_allclose(scale, shade(lon, lat), atol=0.003)


def test_an_orthophoto_without_data_of_another_datum_or_with_a_palette(tmp_path, files):
    """How much has none is said, another flattening too; numbers of colours are no grey values."""
    around = {"site_deg": APOLLO, "rings": [[1000.0, 50.0]]}
    grey = np.tile(np.where(np.arange(300) < 150, 0, 200), (300, 1)).astype(np.uint8)
    half = write(tmp_path / "half.tif", grey, EQUIRECTANGULAR, ON_PLANE_M + [-1500.0, 1500.0], 10.0, nodata=0)
    (text,) = patch(files / "plane.tif", orthophoto=half, **around).report.warnings
    assert 49.0 < float(text.split(" %")[0]) < 52.0 and "off the orthophoto, and has its mean albedo" in text
    other = write(tmp_path / "other.tif", grey + np.uint8(1), f"+proj=longlat +a={MARS_M[0]} +b={MARS_M[1]}",
                  (3.0, 27.0), 0.01)
    (text,) = patch(files / "plane.tif", orthophoto=other, **around).report.warnings
    assert "the orthophoto's datum has radii of (3396190.0, 33762" in text and "latitudes may be of another" in text
    coloured = write(tmp_path / "colours.tif", grey, EQUIRECTANGULAR, ON_PLANE_M + [-1500.0, 1500.0], 10.0,
                     photometric="PALETTE")
    with rasterio().open(coloured, "r+") as made:
        made.write_colormap(1, {value: (255 - value, 0, 0, 255) for value in range(256)})
    with pytest.raises(ConfigError, match="^orthophoto: must have grey values.*no palette.*; unfold it by gdal_trans"):
        patch(files / "plane.tif", orthophoto=coloured, **around)


def test_the_pages_tables_are_taken(files):
    """Those of docs/terrain.md: of the terrain with another map and fewer posts."""
    page = (Path(__file__).parents[2] / "docs" / "terrain.md").read_text(encoding="utf-8")
    terrain, lamps = (tomllib.loads(text) for text in re.findall(r"```toml\n(.*?)```", page, re.S))
    table = terrain["bodies"]["terrain"]
    assert len(checked_rings(table["rings"], MAX_FACETS)) == 3
    ground = GeoTiff.from_table(table | {"rings": [[600.0, 60.0]]}, lambda field, name: files / "plane.tif")
    assert ground.albedo_map is not None and len(ground.facets) == 800
    body = {"name": "a", "generated": {"kind": "icosphere", "radius_m": 5.0, "subdivisions": 1}, "brdf": BRDF}
    assert len(Scene.from_dict({**TABLE, "bodies": [body], **lamps}).lamps) == 1


def test_a_scene_file_asks_for_terrain(files, tmp_path):
    """By the entry point of the file's ending, as the function makes it; refused with the way to the field."""
    if "tif" not in shape_readers():
        missing("ENTRY POINT glrender.shape.tif", "make setup")
    rings = [[300.0, 30.0]]
    terrain = {"heights": "plane.tif", "site_deg": list(APOLLO), "rings": rings, "orthophoto": "plane.tif"}

    def made(**body):
        return Scene.from_dict({**TABLE, "bodies": [{"name": "a", "brdf": BRDF, **body}]}, shape_dir=files).bodies[0]

    body = made(terrain=terrain, albedo_texture_gain=0.5)
    ground = patch(files / "plane.tif", site_deg=APOLLO, rings=rings, orthophoto=files / "plane.tif")
    np.testing.assert_array_equal(body.shape.vertices_m, ground.vertices_m)
    np.testing.assert_array_equal(body.albedo_map, np.float32(0.5) * ground.albedo_map)
    assert len(Shape.from_file(files / "plane.tif", max_facets=2000).facets) == pytest.approx(2000, rel=0.05)
    for wrong, message in (({"ring": rings}, r"bodies\[0\].terrain.ring: unknown key; did you mean 'rings'"),
                           ({"heights": "gone.tif"}, r"bodies\[0\].terrain.heights: is no readable GeoTIFF"),
                           ({"rings": [[0.0, 1.0]]}, r"bodies\[0\].terrain.rings\[0\]: must be")):
        with pytest.raises(ConfigError, match=message):
            made(terrain={**terrain, **wrong})
    with pytest.raises(ConfigError, match=r"bodies\[0\].length_unit: goes with `shape`, a file"):
        made(terrain=terrain, length_unit="m")
    for body in ({"terrain": terrain, "regions": []}, {"generated": {"kind": "icosphere", "radius_m": 9e3}, "regions": [
            {"terrain": terrain}]}):
        with pytest.raises(ConfigError, match="terrain.orthophoto: goes with ground .*; leave it .*albedo_projection"):
            made(**body)
    with pytest.raises(ConfigError, match=r"bodies\[0\]: needs exactly one of"):
        made(terrain=terrain, shape="plane.tif")
    with pytest.raises(ConfigError, match=r"albedo_texture: goes with ground without an orthophoto"):
        made(terrain=terrain, albedo_texture="plane.tif")
    # About a site its own places have other longitudes and latitudes than the planet's.
    del terrain["orthophoto"]
    with pytest.raises(ConfigError, match=r"albedo_projection: goes with ground about its planet's centre"):
        made(terrain=terrain, albedo_projection={"kind": "equirectangular"}, albedo_texture="plane.png")
    with pytest.raises(ConfigError, match=r"terrain: must be a table"):
        made(terrain=5, albedo_projection={"kind": "equirectangular"}, albedo_texture="plane.png")
    with pytest.raises(ConfigError, match="must be a bare file name"):
        Scene.from_dict({**TABLE, "bodies": [{"name": "a", "brdf": BRDF, "terrain": {"heights": "../plane.tif"}}]},
                        shape_dir=files, restricted=True)
