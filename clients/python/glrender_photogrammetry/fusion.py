"""A surface of points: depths that several frames agree on, thinned, and Poisson's surface, cut where there is none."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import trimesh
from glrender_navigation.checks import refuse
from scipy.spatial import cKDTree

from .features import needed_pycolmap
from .frames import PosedFrame, angle_rad
from .mesh import Mesh

# Frames further apart share hardly a depth.
_SHARED_RAD = np.radians(53.0)
_N_AGREE = 3
# Points and their mean distance from so many others; further by so many sigmas is an outlier.
_N_AROUND, _N_SIGMA = 16, 2.0
_N_FOR_NORMAL = 24
# Octree of Poisson's surface: 2^7 to 2^11 cells a side.
_DEPTHS = (7, 11)
_LEAST_POINTS = 100
"""Points, below which there is no surface."""
_LEAST_PIECE = 0.01
"""Facets of a piece over those of the largest; smaller ones go."""


def enough(points_m: np.ndarray, least: int = _LEAST_POINTS) -> None:
    """Check that points are not too few for a surface."""
    if len(points_m) < least:
        raise refuse("frames", f"must agree in threes on {least} points of the surface or more", len(points_m),
                     "take more frames, no more than 15 deg apart; check poses and prior")


def fused(frames: Sequence[PosedFrame], depths_m: Mapping[int, np.ndarray], tolerance_m: float,
          every_px: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) [m] on which three depth maps agree, averaged, and places (N, 3) [m] of cameras that see them."""
    points, cameras = [], []
    for index, own_m in depths_m.items():
        frame = frames[index]
        y, x = every_px * np.array(np.nonzero(own_m[::every_px, ::every_px]))
        unit = frame.camera.direction(np.stack([x, y], axis=-1))
        here_m = (unit * (own_m[y, x] / unit[:, 2])[:, None]) @ frame.camera_from_body + frame.r_camera_body_m
        total_m, count = here_m.copy(), np.ones(len(here_m))
        for other_index, depth_m in depths_m.items():
            other = frames[other_index]
            if other_index == index or angle_rad(frame, other) > _SHARED_RAD:
                continue
            there_m = other.to_camera(here_m)
            column, row = np.rint(other.camera.project(there_m)).astype(int).T
            inside = (column >= 0) & (column < depth_m.shape[1]) & (row >= 0) & (row < depth_m.shape[0])
            found_m = np.where(inside, depth_m[row * inside, column * inside], 0.0)
            gap_m = found_m - there_m[:, 2]
            agrees = (found_m > 0.0) & (np.abs(gap_m) < tolerance_m)
            # Along the other frame's ray.
            moved_m = (here_m - other.r_camera_body_m) * (gap_m / there_m[:, 2])[:, None]
            total_m[agrees] += (here_m + moved_m)[agrees]
            count += agrees
        kept = count >= min(_N_AGREE, len(depths_m))
        points.append(total_m[kept] / count[kept, None])
        cameras.append(np.broadcast_to(frame.r_camera_body_m, points[-1].shape))
    return np.concatenate(points), np.concatenate(cameras)


def surface_of(points_m: np.ndarray, cameras_m: np.ndarray, voxel_m: float, cut_m: float) -> Mesh:
    """Poisson's surface of points that cameras see, cut off where no point is within `cut_m`.

    Source: Kazhdan and Hoppe (2013), Screened Poisson surface reconstruction; COLMAP's.

    Raises
    ------
    ValueError
        Without pycolmap, or of points that make no surface.
    """
    pycolmap = needed_pycolmap()
    enough(points_m)
    points_m, to_camera = _thinned(points_m, cameras_m - points_m, voxel_m)
    tree = cKDTree(points_m)
    _, around = tree.query(points_m, k=min(_N_FOR_NORMAL, len(points_m)), workers=-1)
    normals = trimesh.points.plane_fit(points_m[around])[1]
    normals *= np.where((normals * to_camera).sum(axis=1, keepdims=True) < 0.0, -1.0, 1.0)
    with tempfile.TemporaryDirectory() as folder:
        cloud, surface = Path(folder) / "points.ply", Path(folder) / "surface.ply"
        trimesh.Trimesh(points_m, np.empty((0, 3), int), vertex_normals=normals, process=False).export(
            cloud, vertex_normal=True)
        options = pycolmap.PoissonMeshingOptions()
        size_m = float(np.ptp(points_m, axis=0).max()) * 1.1
        # Cells of one to two voxels: half of that gives four times the facets of the same deviation.
        options.depth = int(np.clip(np.log2(size_m / voxel_m), *_DEPTHS))
        # Its threads wait for each other by spinning: on cores that others use too, one is faster than two.
        options.num_threads, options.trim, options.color = 1, 0.0, False
        pycolmap.poisson_meshing(cloud, surface, options)
        mesh = Mesh.from_file(surface)
    near_m, _ = tree.query(mesh.vertices_m, workers=-1)
    return _pieces(mesh, (near_m < cut_m)[mesh.facets].all(axis=1))


def _thinned(points_m: np.ndarray, to_camera_m: np.ndarray, voxel_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Means of the points of each voxel, without outliers, and of their directions to cameras."""
    cell = np.floor((points_m - points_m.min(axis=0)) / voxel_m).astype(np.int64)
    cell = np.ravel_multi_index(tuple(cell.T), cell.max(axis=0) + 1)
    _, number, count = np.unique(cell, return_inverse=True, return_counts=True)
    towards = to_camera_m / np.linalg.norm(to_camera_m, axis=1, keepdims=True)
    points_m, towards = (np.stack([np.bincount(number, column) for column in each.T], axis=1) / count[:, None]
                         for each in (points_m, towards))
    enough(points_m, _N_FOR_NORMAL)
    away_m = cKDTree(points_m).query(points_m, k=_N_AROUND + 1, workers=-1)[0][:, 1:].mean(axis=1)
    kept = away_m < away_m.mean() + _N_SIGMA * away_m.std()
    return points_m[kept], towards[kept]


def _pieces(mesh: Mesh, kept: np.ndarray) -> Mesh:
    """The larger connected pieces of the facets that are kept, and their vertices alone."""
    facets = mesh.facets[kept]
    if not len(facets):
        raise refuse("frames", "must give points that make a surface", 0, "take more frames, nearer to each other")
    links = trimesh.graph.face_adjacency(facets)
    label = trimesh.graph.connected_component_labels(links, node_count=len(facets))
    size = np.bincount(label)
    used, numbers = np.unique(facets[size[label] >= _LEAST_PIECE * size.max()], return_inverse=True)
    return Mesh(vertices_m=mesh.vertices_m[used], facets=numbers.reshape(-1, 3))
