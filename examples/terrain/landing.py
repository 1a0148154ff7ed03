"""A landing from 30 km to 2 m on a made-up map like that of Apollo 15: pictures, and errors by height.

    python examples/terrain/landing.py [FOLDER]

It writes the map (`apollo15.tif`, 20 m a pixel: a rille, a mountain front, craters), draws nine heights with made-up
ground finer than its facets, and again without, against rays about the camera (`benchmarks/descent.py`). Needs
`pip install 'glrender[terrain,demo]'`.
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib
import numpy as np
import rasterio
from glrender import Body, PinholeCamera, Renderer, Scene
from glrender.brdf import Lambert
from glrender.scene.formats.terrain import patch

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
from descent import ALBEDO, DETAIL, HEIGHTS_M, MOON_M, Truth, descent_state, errors

matplotlib.use("Agg")
import matplotlib.pyplot as plt

SITE_DEG, SIDE_M, PX_M = (3.63, 26.13), 64e3, 20.0
RINGS_M = [[500.0, 5.0], [4000.0, 20.0], [30_000.0, 120.0]]


def write_map(path: Path, seed: int = 15) -> None:
    """Heights [m] around the site, equirectangular on the Moon's sphere."""
    rng, n = np.random.default_rng(seed), round(SIDE_M / PX_M)
    along = PX_M * (np.arange(n) + 0.5) - 0.5 * SIDE_M
    east, north = np.meshgrid(along, -along)
    rille_m = east + 1800.0 - 900.0 * np.sin(north / 2600.0) - 500.0 * np.sin(north / 900.0)
    height = -320.0 * np.exp(-(rille_m / 550.0) ** 2)
    front_m = 0.6 * east - 0.8 * north - 6500.0 + 1200.0 * np.sin(east / 4000.0)
    height += 2800.0 / (1.0 + np.exp(-front_m / 900.0))
    for _ in range(70):
        length_m, way = 200.0 * 30.0 ** rng.random(), rng.uniform(0.0, 2.0 * np.pi)
        height += 4e-3 * length_m * np.sin(2.0 * np.pi * ((np.cos(way) * east + np.sin(way) * north) / length_m
                                                          + rng.random()))
    for _ in range(4000):
        radius_m = min(45.0 * rng.random() ** -0.5, 1500.0)
        x, y = rng.uniform(-0.5 * SIDE_M, 0.5 * SIDE_M, 2)
        middle = np.array([0.5 * SIDE_M - y, x + 0.5 * SIDE_M])
        low, high = (middle + side * 2.0 * radius_m for side in (-1, 1))
        low, high = low / PX_M, high / PX_M
        part = tuple(slice(max(int(a), 0), max(int(b) + 1, 0)) for a, b in zip(low, high, strict=True))
        r = np.hypot(east[part] - x, north[part] - y) / radius_m
        height[part] += radius_m * np.where(r < 1.0, 0.35 * (r * r - 1.0) + 0.07, 0.07 * np.exp(-4.0 * (r - 1.0)))
    lon, lat = np.radians(SITE_DEG)
    left, top = MOON_M * lon * np.cos(np.radians(26.0)) - 0.5 * SIDE_M, MOON_M * lat + 0.5 * SIDE_M
    with rasterio.open(path, "w", driver="GTiff", width=n, height=n, count=1, dtype="float32", compress="deflate",
                       crs=rasterio.CRS.from_string(f"+proj=eqc +lat_ts=26 +R={MOON_M} +units=m"),
                       transform=rasterio.transform.from_origin(left, top, PX_M, PX_M)) as made:
        made.write(height.astype(np.float32), 1)


def main() -> None:
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    write_map(folder / "apollo15.tif")
    ground = patch(folder / "apollo15.tif", site_deg=SITE_DEG, rings=RINGS_M)
    camera = PinholeCamera(name="camera", width_px=512, height_px=512, focal_length_px=550.0)
    pictures, rows = {}, []
    for detail in (DETAIL, None):
        body = Body(name="ground", shape=ground, brdf=Lambert(normal_albedo=ALBEDO), detail=detail)
        scene = Scene(bodies=[body], cameras=[camera], max_error=0.05)
        with Renderer(scene) as renderer:
            for height_m in HEIGHTS_M:
                state = descent_state(height_m)
                image = renderer.render(state)
                if detail is not None:
                    pictures[height_m] = image.irradiance_W_m2
                    continue
                row, column = np.nonzero(image.irradiance_W_m2 > 0.0)
                some = np.random.default_rng(1).permutation(len(row))[:4000]
                pixel = np.stack([column[some], row[some]], axis=1)
                truth, own = Truth(ground.vertices_m, ground.facets, state)(
                    camera, pixel, scene.solar_irradiance_of(camera))
                rows.append((height_m, image.plan.predicted_error, *errors(image.irradiance_W_m2, truth, own,
                                                                           pixel).values()))
    height_m, predicted, rms, own, flux = np.array(rows).T
    figure = plt.figure(figsize=(13.0, 6.6), layout="constrained")
    grid = figure.add_gridspec(2, 4)
    for index, each_m in enumerate((30e3, 3e3, 1e3, 100.0, 10.0, 2.0)):
        axes = figure.add_subplot(grid[divmod(index, 3)])
        white = np.percentile(pictures[each_m], 99.7)
        axes.imshow(np.clip(pictures[each_m] / white, 0.0, 1.0) ** (1.0 / 2.2), cmap="gray")
        axes.set(title=f"{each_m:g} m", xticks=[], yticks=[])
    axes = figure.add_subplot(grid[:, 3])
    axes.loglog(height_m, 100.0 * predicted, "k--", label="predicted")
    axes.loglog(height_m, 100.0 * rms, "o-", label="RMS to rays about the camera")
    axes.loglog(height_m, 100.0 * own, ":", label="noise of those rays")
    axes.loglog(height_m, 100.0 * np.abs(flux), "s-", label="flux")
    axes.set(xlabel="height [m]", ylabel="error [% of the mean lit pixel]", ylim=(1e-3, 10.0))
    axes.legend()
    figure.savefig(folder / "terrain_landing.png", dpi=80)
    for row in rows:
        sys.stdout.write("{:g} m: predicted {:.4f}, RMS {:.4f} (noise of truth {:.4f}), flux {:+.5f}\n".format(*row))


if __name__ == "__main__":
    main()
