"""Poses of frames from nothing but their features, by COLMAP, laid on the poses that the frames were given."""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from glrender_navigation.checks import refuse
from glrender_navigation.features import jacobian
from scipy import sparse
from scipy.spatial.transform import Rotation

from .features import matched, needed_pycolmap, number_of, pipeline, shared_points
from .frames import PosedFrame

_log = logging.getLogger(__name__)
# Frames after each one that it is matched with.
_OVERLAP = 4
# Least angle between the views of the first two frames.
_FIRST_ANGLE_DEG = 4.0
_LEAST_MATCHES = 15
# RMS of the given attitudes about the found ones, and of places over the length of the pass: more is no datum.
_MOST_TURN_RAD, _MOST_PLACE = np.radians(10.0), 0.5
# Sigma of what is seen, as COLMAP counts it, and the least of attitudes.
_SIGMA_PX = 1.0
# Steps of the adjustment; the last one turns no camera by so many pixels.
_MOST_STEPS, _ENOUGH_PX = 30, 0.001


def mapped(frames: Sequence[PosedFrame], is_prior: bool = False) -> dict[str, np.ndarray]:
    """Poses and points by incremental mapping of frames in the order of their pass, laid on the given poses.

    The turn of the whole is the mean over the attitudes, as places on a straight line leave one free; scale and shift
    are those of the places. With a prior all are then `adjusted`.

    Returns
    -------
    dict of `index` (n,) of the frames that were registered, `camera_from_body` (n, 3, 3), `r_camera_body_m` (n, 3),
    `points_m` (N, 3) [m] that three frames or more share, and `turn_rad` and `place_m`, RMS of the given poses about
    these.

    Raises
    ------
    ValueError
        Without pycolmap, of frames of which fewer than three hang together, or given poses that contradict each other.

    Source: Schoenberger and Frahm (2016), Structure-from-Motion Revisited.
    """
    pycolmap = needed_pycolmap()
    with tempfile.TemporaryDirectory() as folder:
        model = _colmap(pycolmap, frames, Path(folder))
    images = sorted((image for image in model.images.values() if image.has_pose), key=lambda image: image.name)
    index, points = [number_of(image) for image in images], shared_points(model)
    found = laid([frames[k] for k in index], np.array([image.cam_from_world().rotation.matrix() for image in images]),
                 np.array([image.projection_center() for image in images]), np.array([p.xyz for p in points]))
    if is_prior:
        own = {image.image_id: k for k, image in enumerate(images)}
        seen = [(own[part.image_id], k, *model.images[part.image_id].points2D[part.point2D_idx].xy - 0.5)
                for k, point in enumerate(points) for part in point.track.elements]
        found = adjusted([frames[k] for k in index], found, np.array(seen))
    return {"index": np.array(index), **found}


def laid(frames: Sequence[PosedFrame], rotations: np.ndarray, places: np.ndarray,
         points: np.ndarray) -> dict[str, np.ndarray]:
    """Rotations (n, 3, 3) to cameras, their places (n, 3) and points (N, 3) of any axes and unit, by the given poses.

    Returns all that `mapped` does but `index`, with its errors.
    """
    given_m = np.array([frame.r_camera_body_m for frame in frames])
    datum = _turns(frames, rotations).mean()
    turned = datum.apply(places)
    arms, given_arms = turned - turned.mean(axis=0), given_m - given_m.mean(axis=0)
    scale = float((arms * given_arms).sum() / (arms**2).sum())
    shift_m = given_m.mean(axis=0) - scale * turned.mean(axis=0)
    found = _about(frames, rotations @ datum.as_matrix().T, scale * turned + shift_m,
                   scale * datum.apply(points.reshape(-1, 3)) + shift_m)
    turn_rad, place_m = found["turn_rad"], found["place_m"]
    length_m = float(np.sqrt((given_arms**2).sum(axis=1).mean()))
    if not (scale > 0.0 and turn_rad < _MOST_TURN_RAD and place_m < _MOST_PLACE * length_m):
        raise refuse("frames", "must have attitudes within 10 deg of the found ones, RMS, and places within half of "
                     f"their spread, {length_m:.4g} m, at a scale above 0", f"{np.degrees(turn_rad):.1f} deg, "
                     f"{place_m:.4g} m, {scale:.3g}", "give them in the body's axes, in the order of the pass")
    return found


def adjusted(frames: Sequence[PosedFrame], found: dict[str, np.ndarray], seen: np.ndarray) -> dict[str, np.ndarray]:
    """Poses and points as `laid` returns them, by least squares of the given poses and of all that is seen.

    Places count by their `place_sigma_m`, attitudes by their own RMS about the found ones, or 1 px if that is more:
    places alone hardly hold a turn of all cameras, which in a narrow field is a shift of the points. `seen` (K, 4) has
    the numbers of a frame and of a point, and the pixel there.
    """
    camera, given_m = frames[0].camera, np.array([frame.r_camera_body_m for frame in frames])
    given = Rotation.from_matrix([frame.camera_from_body for frame in frames])
    place_weights = np.tile([[frame.place_sigma_m] for frame in frames], 3) ** -2.0
    turns, places_m = Rotation.from_matrix(found["camera_from_body"]), found["r_camera_body_m"]
    points_m, n = found["points_m"], len(frames)
    own, point = seen[:, :2].astype(int).T
    columns = np.hstack([6 * own[:, None] + np.arange(6), 6 * n + 3 * point[:, None] + np.arange(3)])
    shape = 2 * len(seen), 6 * n + 3 * len(points_m)
    prior = sparse.eye_array(6 * n, shape[1])
    for _ in range(_MOST_STEPS):
        matrix = turns.as_matrix()
        at_m = np.einsum("kij,kj->ki", matrix[own], points_m[point] - places_m[own])
        by_turn, by_place = np.split(jacobian(camera.focal_length_px, at_m, np.zeros(3)).reshape(-1, 2, 6), 2, axis=2)
        by_point = by_place @ matrix[own]
        rows = sparse.vstack([prior, sparse.csr_array((
            np.concatenate([by_turn, -by_point, by_point], axis=2).ravel(), np.repeat(columns, 2, axis=0).ravel(),
            9 * np.arange(shape[0] + 1)), shape)])
        off_rad, off_px = (turns * given.inv()).as_rotvec(), camera.project(at_m) - seen[:, 2:]
        sigma_rad = max(float(np.sqrt(np.mean(off_rad**2))), _SIGMA_PX / camera.focal_length_px)
        weights = [np.hstack([np.full((n, 3), sigma_rad**-2.0), place_weights]).ravel(),
                   np.repeat(1.0 / (_SIGMA_PX**2 + (off_px**2).sum(axis=1)), 2)]
        left = np.concatenate([np.hstack([off_rad, places_m - given_m]).ravel(), off_px.ravel()])
        weighed = rows.T * np.concatenate(weights)
        normal, pull = (weighed @ rows).tocsr(), -weighed @ left
        # Points hang together by the frames alone: their blocks are eliminated first.
        blocks, across = normal[6 * n:, 6 * n:].tobsr((3, 3)), normal[:6 * n, 6 * n:]
        inverse = sparse.bsr_array((np.linalg.inv(blocks.data), blocks.indices, blocks.indptr))
        step = np.linalg.solve((normal[:6 * n, :6 * n] - across @ inverse @ across.T).toarray(),
                               pull[:6 * n] - across @ (inverse @ pull[6 * n:]))
        points_m = points_m + (inverse @ (pull[6 * n:] - across.T @ step)).reshape(-1, 3)
        moved = step.reshape(-1, 6)
        turns, places_m = Rotation.from_rotvec(moved[:, :3]) * turns, places_m + moved[:, 3:]
        if (turned_px := camera.focal_length_px * np.abs(moved[:, :3]).max()) < _ENOUGH_PX:
            break
    else:
        _log.warning("poses with a prior still turn by %.2g px after %d steps: look at the places and at place_sigma_m",
                     turned_px, _MOST_STEPS)
    return _about(frames, turns.as_matrix(), places_m, points_m)


def _about(frames: Sequence[PosedFrame], rotations: np.ndarray, places_m: np.ndarray,
           points_m: np.ndarray) -> dict[str, np.ndarray]:
    """Poses and points, with the RMS of the given poses about them."""
    turn_rad = _turns(frames, rotations).magnitude()
    away_m = np.linalg.norm(places_m - [frame.r_camera_body_m for frame in frames], axis=1)
    return {"camera_from_body": rotations, "r_camera_body_m": places_m, "points_m": points_m,
            "turn_rad": np.sqrt(np.mean(turn_rad**2)), "place_m": np.sqrt(np.mean(away_m**2))}


def _turns(frames: Sequence[PosedFrame], rotations: np.ndarray) -> Rotation:
    """Turns of the axes of rotations (n, 3, 3) to those of the given ones."""
    return Rotation.from_matrix([frame.camera_from_body.T for frame in frames] @ rotations)


def reposed(frames: Sequence[PosedFrame], found: dict[str, np.ndarray]) -> list[PosedFrame]:
    """The frames that were registered, with the poses that were found."""
    return [replace(frames[k], camera_from_body=turn, r_camera_body_m=place_m) for k, turn, place_m in zip(
        found["index"], found["camera_from_body"], found["r_camera_body_m"], strict=True)]


def _colmap(pycolmap: Any, frames: Sequence[PosedFrame], folder: Path) -> Any:
    """The reconstruction with the most frames."""
    base, models = matched(frames, [(i, j) for i in range(len(frames)) for j in range(
        i + 1, min(i + _OVERLAP, len(frames) - 1) + 1)], folder), folder / "models"
    models.mkdir()
    options = pipeline(pycolmap)
    options.min_num_matches, options.mapper.init_min_tri_angle = _LEAST_MATCHES, _FIRST_ANGLE_DEG
    found = pycolmap.incremental_mapping(base, folder, models, options).values()
    best = max(found, key=lambda model: model.num_reg_images(), default=None)
    if best is None or best.num_reg_images() < 3:
        raise refuse("frames", "must hang together, three of them by their features",
                     0 if best is None else best.num_reg_images(), "take steps of 15 deg or less, away from opposition")
    return best
