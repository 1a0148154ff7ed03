"""Frames from 30 km to 2 m above made-up ground: `python benchmarks/descent.py [--facets N] [--engine NAME]`.

Prints one JSON line a height: processor time [s] of the first and the second frame, predicted and true RMS error,
flux error, and the truth's own RMS error. The truth casts jittered rays at the ground about the camera, finds facets by
Embree there, where float32 is finest, and points by the facets' planes in float64. Exits 1 where `wrongs` finds one.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import sys
import time

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh
from glrender import (
    Body,
    Boulders,
    Craters,
    Detail,
    Noise,
    PinholeCamera,
    Pose,
    Renderer,
    Scene,
    Shape,
    State,
    frames,
    generate,
)
from glrender.base.constants import AU_M, SUN_RADIUS_M
from glrender.brdf import Lambert

HEIGHTS_M = (30e3, 10e3, 3e3, 1e3, 300.0, 100.0, 30.0, 10.0, 2.0)
MOST_TIMES = 5.0
"""Largest processor time over the median of a descent."""
LOW_M, MOST_TIMES_BALL = 1000.0, 80.0
"""Height [m] below which the time is also compared, and its most over that of a ball of 82k facets and 500 px."""
LARGE, OPENING_S, OPENING_GIB, LOW_S, LOW_GIB = 7.9e6, 60.0, 6.0, 2.0, 0.5
"""Facets from which opening has a limit [s], [GiB], and so have frames at 2 m: [s], [GiB] beyond opening."""
SIDE_M, MOON_M, ALBEDO = 20e3, 1_737_400.0, 0.2
SUN_AZIMUTH, SUN_HEIGHT = math.radians(115.0), math.radians(18.0)
DETAIL = Detail(seed=5, noise=Noise(amplitude_m=0.12, longest_m=6.0, shortest_m=0.05, exponent=0.8),
                craters=Craters(largest_m=8.0, smallest_m=0.25, coverage=0.08, depth=0.12),
                boulders=Boulders(largest_m=1.0, smallest_m=0.1, coverage=0.02))


def ground(n_facets: float, roughness: float = 1.0, seed: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) [m] and facets (F, 3) of curved ground with hills and craters; the middle is at the origin."""
    rng, n = np.random.default_rng(seed), round(math.sqrt(0.5 * n_facets)) + 1
    x = np.linspace(-0.5 * SIDE_M, 0.5 * SIDE_M, n)
    east, north = np.meshgrid(x, x, indexing="ij")
    height = np.zeros((n, n))
    for _ in range(60):
        length = 300.0 * 20.0 ** rng.random()
        way = rng.uniform(0.0, 2.0 * np.pi)
        along = (math.cos(way) * east + math.sin(way) * north) / length + rng.random()
        height += roughness * 6e-3 * length * np.sin(2.0 * np.pi * along)
    for _ in range(600):
        radius = min(30.0 * rng.random() ** -0.5, 600.0)
        middle = rng.uniform(-0.5 * SIDE_M, 0.5 * SIDE_M, 2)
        low = np.searchsorted(x, middle - 2.0 * radius)
        high = np.searchsorted(x, middle + 2.0 * radius)
        part = slice(low[0], high[0]), slice(low[1], high[1])
        r = np.hypot(east[part] - middle[0], north[part] - middle[1]) / radius
        bowl, rim = 0.4 * (r * r - 1.0) + 0.08, 0.08 * np.exp(-4.0 * (r - 1.0))
        height[part] += roughness * radius * np.where(r < 1.0, bowl, rim)
    height -= height[n // 2, n // 2]
    radius_m = MOON_M + height
    vertices = np.stack([radius_m * np.sin(east / MOON_M), radius_m * np.sin(north / MOON_M),
                         radius_m * np.cos(east / MOON_M) * np.cos(north / MOON_M) - MOON_M], axis=-1).reshape(-1, 3)
    vertices -= vertices[(n // 2) * n + n // 2]
    corner = np.arange(n * n).reshape(n, n)
    a, b, c, d = (each.ravel() for each in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]))
    return vertices, np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def descent_state(height_m: float) -> State:
    """Above the middle: straight down from 3 km on, at 45 deg from 1 km, at 8 deg below, with the horizon in view."""
    pitch = math.radians(90.0 if height_m >= 3e3 else 45.0 if height_m > 300.0 else 8.0)
    place = np.array([3.0, 2.0, height_m])
    look = np.array([math.cos(pitch), 0.0, -math.sin(pitch)])
    up = (1.0, 0.0, 0.0) if pitch > 1.5 else (0.0, 0.0, 1.0)
    sun = np.array([math.cos(SUN_HEIGHT) * math.cos(SUN_AZIMUTH), math.cos(SUN_HEIGHT) * math.sin(SUN_AZIMUTH),
                    math.sin(SUN_HEIGHT)])
    return State(r_sun_inertial_m=AU_M * sun, bodies={"ground": Pose(r_inertial_m=np.zeros(3))},
                 spacecraft=Pose(r_inertial_m=place, q_from_inertial=frames.look_at(place, place + look, up)))


class Truth:
    """Lambert ground in the light of the Sun's disc, by rays about a camera.

    Parameters
    ----------
    vertices_m : (V, 3) [m]
    facets : (F, 3) int
    state : State
    """

    def __init__(self, vertices_m: np.ndarray, facets: np.ndarray, state: State):
        self._corners = (vertices_m - state.spacecraft.r_inertial_m)[facets]
        self._sun_m = state.r_sun_inertial_m - state.spacecraft.r_inertial_m
        self._inertial_from_camera = frames.dcm(state.spacecraft.q_from_inertial).T
        self._scene = rtcore_scene.EmbreeScene()
        TriangleMesh(self._scene, self._corners.astype(np.float32))

    def __call__(self, camera: PinholeCamera, pixel: np.ndarray, solar_irradiance_W_m2: float, n: int = 8,
                 ) -> tuple[np.ndarray, float]:
        """Irradiance (N,) [W/m2] of pixels (N, 2) by n x n rays, and its own RMS error [W/m2]."""
        rng, half = np.random.default_rng(0), np.zeros((2, len(pixel)))
        for k in range(n * n):
            place = pixel - 0.5 + (np.array([k % n, k // n]) + rng.random(pixel.shape)) / n
            half[(k % n + k // n) % 2] += self._light(camera.directions(place), camera, rng)
        half *= solar_irradiance_W_m2 / (n * n)
        return half.sum(axis=0), float(np.sqrt(np.mean((half[0] - half[1]) ** 2)))

    def _light(self, ray_camera: np.ndarray, camera: PinholeCamera, rng: np.random.Generator) -> np.ndarray:
        value, ray = np.zeros(len(ray_camera)), ray_camera @ self._inertial_from_camera.T
        facet = self._first(np.zeros_like(ray), ray)
        hit = np.flatnonzero(facet >= 0)
        a, b, c = (self._corners[facet[hit], k] for k in range(3))
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        across = (normal * ray[hit]).sum(axis=1)
        hit, normal, a = hit[across < 0.0], normal[across < 0.0], a[across < 0.0]
        range_m = (a * normal).sum(axis=1) / across[across < 0.0]
        point = ray[hit] * range_m[:, None]
        to_sun = self._sun_m - point
        aside = rng.normal(size=point.shape)
        aside -= (aside * to_sun).sum(axis=1)[:, None] * to_sun / (to_sun**2).sum(axis=1)[:, None]
        aside *= (SUN_RADIUS_M * np.sqrt(rng.random(len(point))) / np.linalg.norm(aside, axis=1))[:, None]
        distance_m = np.linalg.norm(to_sun, axis=1)
        to_sun += aside
        to_sun /= np.linalg.norm(to_sun, axis=1)[:, None]
        mu0 = (normal * to_sun).sum(axis=1)
        lit = np.flatnonzero(mu0 > 0.0)
        start = point[lit] + normal[lit] * (1e-6 * range_m[lit])[:, None]
        lit = lit[self._first(start, to_sun[lit]) < 0]
        # A pixel's solid angle falls off as the cube of the cosine off the boresight.
        value[hit[lit]] = (ALBEDO / np.pi * mu0[lit] * (AU_M / distance_m[lit]) ** 2
                           * ray_camera[hit[lit], 2] ** 3 / camera.focal_length_px**2)
        return value

    def _first(self, start: np.ndarray, ray: np.ndarray) -> np.ndarray:
        return self._scene.run(np.ascontiguousarray(start, np.float32), np.ascontiguousarray(ray, np.float32))


def errors(image: np.ndarray, truth: np.ndarray, own: float, pixel: np.ndarray) -> dict[str, float]:
    """RMS and flux error [1] of an image (H, W) in pixels (N, 2), and the RMS error of the truth (N,) itself.

    That has twice the standard error by the choice of pixels: where few err much, some thousand do not show how many.
    """
    found = image[pixel[:, 1], pixel[:, 0]].astype(float)
    mean = truth[truth > 0.0].mean()
    squared = (found - truth)[(truth > 0.0) | (found > 0.0)] ** 2
    return {"rms": math.sqrt(squared.mean()) / mean,
            "own": math.sqrt(own**2 + 2.0 * squared.std() / math.sqrt(len(squared))) / mean,
            "flux": float(found.sum() / truth.sum() - 1.0)}


def wrongs(opening: dict, rows: list[dict], ball_s: float) -> list[str]:
    """What is beyond its limit in the rows of a descent, as `main` prints them; of fewer than three no median."""
    found, median_s = [], float(np.median([row["second_s"] for row in rows]))
    for row in rows:
        at = f"at {row['height_m']:g} m: "
        if "rms" in row and not row["rms"] <= math.hypot(row["predicted"], row["own"]):
            found.append(f"{at}RMS {row['rms']:.3g}, and {row['predicted']:.3g} predicted")
        if len(rows) > 2 and not row["second_s"] <= MOST_TIMES * median_s:
            found.append(f"{at}{row['second_s']:.3g} s, the median {median_s:.3g} s")
        if row["height_m"] < LOW_M and not row["second_s"] <= MOST_TIMES_BALL * ball_s:
            found.append(f"{at}{row['second_s']:.3g} s, a ball {ball_s:.3g} s")
        if opening["facets"] >= LARGE and row["height_m"] <= HEIGHTS_M[-1]:
            more_GiB = row["memory_GiB"] - opening["memory_GiB"]
            if not (row["second_s"] <= LOW_S and more_GiB <= LOW_GIB):
                found.append(f"{at}{row['second_s']:.3g} s, and {more_GiB:.3g} GiB more")
    if opening["facets"] >= LARGE and not (opening["opening_s"] <= OPENING_S
                                           and opening["memory_GiB"] <= OPENING_GIB):
        found.append(f"opening: {opening['opening_s']:.3g} s, {opening['memory_GiB']:.3g} GiB")
    return found


def _ball_s(max_error: float) -> float:
    """Median processor time [s] of frames of a ball of 82k facets, 500 px across, by the same tolerance."""
    body = Body(name="ground", shape=generate.icosphere(radius_m=500.0, subdivisions=6),
                brdf=Lambert(normal_albedo=ALBEDO))
    camera = PinholeCamera(name="camera", width_px=512, height_px=512, focal_length_px=550.0)
    look, seconds = np.array([0.0, 0.0, -1.0]), []
    place = -1100.0 * look
    state = State(r_sun_inertial_m=AU_M * np.array([0.8, 0.0, 0.6]), bodies={"ground": Pose(r_inertial_m=np.zeros(3))},
                  spacecraft=Pose(r_inertial_m=place, q_from_inertial=frames.look_at(place, place + look, (1.0, 0, 0))))
    with Renderer(Scene(bodies=[body], cameras=[camera], max_error=max_error)) as renderer:
        for _ in range(6):
            begin = time.process_time()
            renderer.render(state)
            seconds.append(time.process_time() - begin)
    return float(np.median(seconds[1:]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--facets", type=float, default=500e3)
    parser.add_argument("--heights", type=float, nargs="+", default=HEIGHTS_M)
    parser.add_argument("--engine", default=None)
    parser.add_argument("--error", type=float, default=0.05)
    parser.add_argument("--px", type=int, default=512)
    parser.add_argument("--truth-px", type=int, default=20000, help="pixels of the truth; 0 for none")
    parser.add_argument("--detail", action="store_true", help="with surface detail, which the truth lacks")
    parser.add_argument("--roughness", type=float, default=1.0)
    arguments = parser.parse_args()
    vertices, facets = ground(arguments.facets, arguments.roughness)
    begin = time.process_time()
    body = Body(name="ground", shape=Shape.from_arrays(vertices, facets), brdf=Lambert(normal_albedo=ALBEDO),
                detail=DETAIL if arguments.detail else None)
    camera = PinholeCamera(name="camera", width_px=arguments.px, height_px=arguments.px,
                           focal_length_px=550.0 / 512.0 * arguments.px)
    scene = Scene(bodies=[body], cameras=[camera], max_error=arguments.error)
    rows = []
    with Renderer(scene) as renderer:
        opening = {"facets": len(facets), "opening_s": time.process_time() - begin, "memory_GiB": _memory_GiB()}
        _say(opening)
        for height_m in arguments.heights:
            state, seconds = descent_state(height_m), []
            for _ in range(2):
                begin = time.process_time()
                image = renderer.render(state, engine=arguments.engine)
                seconds.append(time.process_time() - begin)
            row = {"height_m": height_m, "first_s": seconds[0], "second_s": seconds[1],
                   "memory_GiB": _memory_GiB(),  # the truth takes some more
                   "engines": [(window.how, window.refined_samples, round(window.refined_share, 3))
                               for window in image.plan.windows], "predicted": image.plan.predicted_error}
            if arguments.truth_px and not arguments.detail:
                row_px, column_px = np.nonzero(image.irradiance_W_m2 > 0.0)
                some = np.random.default_rng(9).permutation(len(row_px))[:arguments.truth_px]
                pixel = np.stack([column_px[some], row_px[some]], axis=1)
                truth, own = Truth(vertices, facets, state)(camera, pixel, scene.solar_irradiance_of(camera))
                row |= errors(image.irradiance_W_m2, truth, own, pixel)
            rows.append(row | {"warnings": list(image.plan.warnings)})
            _say(rows[-1])
    ball_s = _ball_s(arguments.error)
    found = wrongs(opening, rows, ball_s)
    _say({"ball_s": ball_s, "wrong": found})
    sys.exit(1 if found else 0)


def _memory_GiB() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def _say(row: dict) -> None:
    told = {key: float(f"{value:.4g}") if isinstance(value, float) else value for key, value in row.items()}
    sys.stdout.write(json.dumps(told) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
