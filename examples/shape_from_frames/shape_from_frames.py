"""A blurred shape, sharpened by 16 frames of the true one: shape_from_frames.py SHAPE [--out PNG]"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from glrender import Body, PinholeCamera, Pose, Renderer, Scene, Shape, State, frames
from glrender.brdf import Lambert
from glrender.scenario.belief.decimation import decimated
from PIL import Image
from scipy.optimize import minimize
from scipy.sparse import coo_array, csr_array, diags_array, eye_array
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

LAW, SIDE_PX, FOCAL_LENGTH_PX = Lambert(normal_albedo=0.06), 256, 2000.0
N_FRAMES, PHASES_DEG, NOISE = 16, (30.0, 50.0, 70.0, 90.0), 0.01
# Frames are fitted in bins of 2 x 2 px, with that error, in so many steps.
BINNED, MAX_ERROR, STEPS = 2, 0.1, 40
# Moves of vertices are smoothed by (1 + SMOOTHED L)^-1, L the graph's Laplacian; one unit of the optimiser [m].
SMOOTHED, UNIT_M = 1.0, 30.0


def camera(binned: int = 1) -> PinholeCamera:
    side_px = SIDE_PX // binned
    return PinholeCamera(name="navcam", width_px=side_px, height_px=side_px, focal_length_px=FOCAL_LENGTH_PX / binned)


def renderer(shape: Shape, binned: int = 1, max_error: float = 0.005) -> Renderer:
    body = Body(name="body", shape=shape, brdf=LAW)
    return Renderer(Scene(bodies=[body], cameras=[camera(binned)], sun_disc=False, max_error=max_error))


def view(radius_m: float, seed: int, across_px: float = 200.0) -> State:
    """A random side of the body, so many pixels across."""
    q, phase_rad = np.random.default_rng(seed).standard_normal(4), np.radians(PHASES_DEG[seed % len(PHASES_DEG)])
    r_m = 2.0 * radius_m * FOCAL_LENGTH_PX / across_px * np.array([np.cos(phase_rad), np.sin(phase_rad), 0.0])
    return State(r_sun_inertial_m=[1.5e11, 0.0, 0.0],
                 spacecraft=Pose(r_inertial_m=r_m, q_from_inertial=frames.look_at(r_m, np.zeros(3))),
                 bodies={"body": Pose(r_inertial_m=np.zeros(3), q_from_inertial=q / np.linalg.norm(q))})


def noisy_frames(shape: Shape, views: Sequence[State]) -> np.ndarray:
    """Frames (N, rows, columns) [W/m2] of a shape, with noise of 1 % of the mean lit pixel."""
    with renderer(shape) as drawn:
        images = np.array([drawn.render(state).irradiance_W_m2 for state in views], float)
    return images + NOISE * images[images > 0.0].mean() * np.random.default_rng(7).standard_normal(images.shape)


def laplacian(shape: Shape) -> csr_array:
    """The Laplacian (V, V) of the graph of a closed shape's edges."""
    start, end = shape.facets.ravel(), np.roll(shape.facets, -1, axis=1).ravel()
    linked = coo_array((np.ones(len(start)), (start, end)), shape=2 * (len(shape.vertices_m),)).tocsr()
    return diags_array(linked.sum(axis=1)) - linked


def blurred(shape: Shape, times: int = 12) -> Shape:
    """Each vertex halfway to the mean of its neighbours, several times."""
    edges, vertices_m = laplacian(shape), shape.vertices_m
    for _ in range(times):
        vertices_m = vertices_m - 0.5 * (edges @ vertices_m) / edges.diagonal()[:, None]
    return shape.with_vertices(vertices_m)


def fitted(shape: Shape, views: Sequence[State], images: np.ndarray) -> Shape:
    """The shape whose frames are nearest to images (N, rows, columns), by L-BFGS in smoothed moves of its vertices."""
    seen = images.reshape(len(images), SIDE_PX // BINNED, BINNED, -1, BINNED).sum(axis=(2, 4))
    scale, smooth = np.abs(seen).max(), splu((eye_array(len(shape.vertices_m)) + SMOOTHED * laplacian(shape)).tocsc())

    def moved(x: np.ndarray) -> Shape:
        return shape.with_vertices(shape.vertices_m + UNIT_M * smooth.solve(x.reshape(-1, 3)))

    def cost(x: np.ndarray) -> tuple[float, np.ndarray]:
        total, by_vertex = 0.0, np.zeros_like(shape.vertices_m)
        with renderer(moved(x), BINNED, MAX_ERROR) as drawn:
            for state, image in zip(views, seen, strict=True):
                found = drawn.gradient(state, lambda light, image=image: 2.0 * (light - image) / scale**2)
                total += (((found.irradiance_W_m2 - image) / scale) ** 2).sum()
                by_vertex += found["body"].vertices_m
        return total, UNIT_M * smooth.solve(by_vertex).ravel()

    return moved(minimize(cost, np.zeros(shape.vertices_m.size), jac=True, method="L-BFGS-B",
                          options={"maxiter": STEPS}).x)


def surface_points(shape: Shape, count: int, seed: int) -> np.ndarray:
    """Points (N, 3) [m], evenly over a shape's surface."""
    rng, areas = np.random.default_rng(seed), shape.facet_areas_m2
    corners = shape.vertices_m[shape.facets[rng.choice(len(areas), count, p=areas / areas.sum())]]
    return np.einsum("nk,nki->ni", rng.dirichlet(np.ones(3), count), corners)


def distance_m(shape: Shape, truth: cKDTree) -> float:
    """RMS distance [m] of a shape's surface from the truth's points."""
    return float(np.sqrt(np.mean(truth.query(surface_points(shape, 20_000, 1))[0] ** 2)))


def main(arguments: argparse.Namespace) -> None:
    truth = Shape.from_file(arguments.shape, length_unit="km")
    fewer = decimated(truth, min(3000 / len(truth.facets), 1.0))
    points, views = cKDTree(surface_points(truth, 600_000, 0)), [view(truth.radius_m, k) for k in range(N_FRAMES)]
    before, images, began_s = blurred(fewer), noisy_frames(truth, views), time.process_time()
    after = fitted(before, views, images)
    sys.stdout.write(f"{distance_m(before, points):.1f} m RMS before, {distance_m(after, points):.1f} m after "
                     f"{time.process_time() - began_s:.0f} s of processor time; the truth of as few facets: "
                     f"{distance_m(fewer, points):.1f} m\n")
    made, unseen = [], view(truth.radius_m, N_FRAMES, 240.0)
    for shape in (before, after, truth):
        with renderer(shape) as drawn:
            made.append(drawn.render(unseen).irradiance_W_m2)
    grey = (np.hstack(made) / np.max(made)) ** 0.6
    Image.fromarray((255.0 * grey).astype(np.uint8)).save(arguments.out)
    sys.stdout.write(f"{arguments.out}\n")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("shape", type=Path)
    parser.add_argument("--out", type=Path, default=Path("shape.png"))
    main(parser.parse_args())
