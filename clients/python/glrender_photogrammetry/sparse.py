"""Points of the surface from features that several frames share, by poses that are known."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np
from glrender_navigation.checks import refuse
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from .frames import PosedFrame, angle_rad

# Frames nearer to each other, as the body sees them, tell no depth; further apart too few matches are right.
_NEIGHBOURS_RAD = (np.radians(0.5), np.radians(16.0))
_N_FEATURES = 8000
_CONTRAST = 0.01
# Ratio of the best match's distance to the second best's (Lowe 2004 has 0.8; the epipolar check takes off the rest).
_RATIO = 0.85
_EPIPOLAR_PX = 1.0
_REPROJECTION_PX = 1.5
_LEAST_TRACK = 3
# Sum of the squared angles between a point's rays and their mean: three frames that are 2 deg apart.
_LEAST_SPREAD = 2.0 * np.sin(np.radians(2.0)) ** 2
# Least share of the matches within the check [1]: right poses leave 0.15 to 0.4 outside.
_LEAST_SHARE_RIGHT = 0.5


def sparse_points(frames: Sequence[PosedFrame],
                  progress: Callable[[float], None] = lambda done: None) -> dict[str, np.ndarray]:
    """Points that three frames or more share, triangulated by the frames' poses.

    Parameters
    ----------
    frames : sequence of PosedFrame
        Frames of one body and camera.
    progress : function of float, optional
        Is called with the share of the work that is done.

    Returns
    -------
    dict of `points_m` (N, 3) [m] in `body`, and `n_frames` (N,) int that each is seen in

    Raises
    ------
    ValueError
        Frames without neighbours 0.5 to 16 deg apart, without common features, or poses that contradict the matches.
    """
    apart = {(i, j): angle_rad(frames[i], frames[j]) for i in range(len(frames)) for j in range(i + 1, len(frames))}
    low, high = _NEIGHBOURS_RAD
    pairs = [pair for pair, angle in apart.items() if low < angle < high]
    if not pairs:
        least = min((angle for angle in apart.values() if angle > low), default=0.0)
        raise refuse("frames", "must have neighbours 0.5 to 16 deg apart about the body",
                     f"{np.degrees(least):.1f} deg at the least", "take more frames on the way")
    n_steps = len(frames) + len(pairs)
    sift = cv2.SIFT_create(_N_FEATURES, contrastThreshold=_CONTRAST)
    places, features = [], []
    for k, frame in enumerate(frames):
        grey = (255.0 * np.minimum(frame.root, 1.0)).astype(np.uint8)
        found, described = sift.detectAndCompute(grey, None)
        described = np.zeros((0, 128), np.float32) if described is None else described
        places.append(np.array([point.pt for point in found]).reshape(-1, 2))
        features.append(described / np.maximum(np.linalg.norm(described, axis=1, keepdims=True), 1e-12))
        progress((k + 1) / n_steps)
    first = np.cumsum([0] + [len(place) for place in places])
    edges, errors_px = [], []
    for k, (i, j) in enumerate(pairs):
        a, b = _matches(features[i], features[j])
        error_px = _epipolar_px(frames[i], frames[j], places[i][a], places[j][b])
        errors_px.append(error_px)
        right = error_px < _EPIPOLAR_PX
        edges.append(np.stack([first[i] + a[right], first[j] + b[right]]))
        progress((len(frames) + k + 1) / n_steps)
    errors = np.concatenate(errors_px)
    if not errors.size:
        raise refuse("frames", "must share features", 0, "check exposure and phase: near opposition nothing shows")
    share_right = float((errors < _EPIPOLAR_PX).mean())
    if share_right < _LEAST_SHARE_RIGHT:
        raise refuse("frames", f"must have poses that the matches agree with: {100 * (1 - share_right):.0f} % fail the "
                     f"epipolar check of {_EPIPOLAR_PX:g} px", f"{np.median(errors):.1f} px in the median",
                     'poses that are not known well: poses="free"')
    points_m, n_frames = _tracks(frames, np.concatenate(edges, axis=1), np.concatenate(places), first)
    return {"points_m": points_m, "n_frames": n_frames}


def _matches(one: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of features that are each other's best, and better than the second best by the ratio."""
    if len(one) < 2 or len(other) < 2:
        return np.empty(0, int), np.empty(0, int)
    alike = one @ other.T
    back = alike.argmax(axis=0)
    best, rows = alike.argmax(axis=1), np.arange(len(one))
    most = alike[rows, best]
    alike[rows, best] = -1.0
    # For unit vectors the squared distance is 2 - 2 cos.
    is_clear = 1.0 - most < _RATIO**2 * (1.0 - alike.max(axis=1))
    kept = np.flatnonzero(is_clear & (back[best] == rows))
    return kept, best[kept]


def _epipolar_px(one: PosedFrame, other: PosedFrame, at_px: np.ndarray, other_px: np.ndarray) -> np.ndarray:
    """Distances (N,) [px] of points in the other frame from the lines on which they are by the poses."""
    turn = other.camera_from_body @ one.camera_from_body.T
    x, y, z = other.to_camera(one.r_camera_body_m)
    essential = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ turn
    line = one.camera.direction(at_px) @ essential.T @ np.linalg.inv(other.camera.matrix)
    return np.abs((line[:, :2] * other_px).sum(axis=1) + line[:, 2]) / np.linalg.norm(line[:, :2], axis=1)


def _tracks(frames: Sequence[PosedFrame], edges: np.ndarray, at_px: np.ndarray,
            first: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) [m] nearest to the rays of their features, and numbers (N,) of frames."""
    n = len(at_px)
    graph = coo_array((np.ones(edges.shape[1], np.int8), tuple(edges)), shape=(n, n))
    n_tracks, track = connected_components(graph, directed=False)
    owner = np.repeat(np.arange(len(frames)), np.diff(first))
    length = np.bincount(track, minlength=n_tracks)
    n_owners = np.bincount(np.unique(track * len(frames) + owner) // len(frames), minlength=n_tracks)
    # Twice in one frame is once wrong.
    is_good = (length >= _LEAST_TRACK) & (n_owners == length)
    kept = np.flatnonzero(is_good[track])
    number = np.cumsum(is_good) - 1
    track, owner, at_px, count = number[track[kept]], owner[kept], at_px[kept], int(is_good.sum())
    rays = np.empty((len(kept), 3))
    for k, frame in enumerate(frames):
        rays[owner == k] = frame.camera.direction(at_px[owner == k]) @ frame.camera_from_body
    r_camera_m = np.array([frame.r_camera_body_m for frame in frames])[owner]
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    normal_matrix, right_side = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(normal_matrix, track, across)
    np.add.at(right_side, track, np.einsum("nij,nj->ni", across, r_camera_m))
    is_wide = np.linalg.eigvalsh(normal_matrix)[:, 0] > _LEAST_SPREAD
    normal_matrix[~is_wide] = np.eye(3)
    points_m = np.linalg.solve(normal_matrix, right_side[..., None])[..., 0]
    worst_px = np.where(is_wide, 0.0, np.inf)
    for k, frame in enumerate(frames):
        own = owner == k
        here_m = frame.to_camera(points_m[track[own]])
        error_px = np.linalg.norm(frame.camera.project(here_m) - at_px[own], axis=1)
        np.maximum.at(worst_px, track[own], np.where(here_m[:, 2] > 0.0, error_px, np.inf))
    good = worst_px < _REPROJECTION_PX
    return points_m[good], length[is_good][good]
