"""Poses of frames from nothing but their features, by COLMAP, laid on the poses that the frames were given."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from glrender_navigation.checks import number, refuse
from scipy.spatial.transform import Rotation

from .features import matched, needed_pycolmap, number_of, pipeline, shared_points
from .frames import PosedFrame

# Frames after each one that it is matched with.
_OVERLAP = 4
# Least angle between the views of the first two frames.
_FIRST_ANGLE_DEG = 4.0
_LEAST_MATCHES = 15
# RMS of the given attitudes about the found ones, and of places over the length of the pass: more is no datum.
_MOST_TURN_RAD, _MOST_PLACE = np.radians(10.0), 0.5
# RMS of places about a straight line [sigma], at the least: errors alone leave 1, and a turn about the line is free.
_LEAST_BEND_SIGMAS = 5.0
# Distance of an adjusted place from the given one [sigma]: of 10 million places with normal errors one is further.
_MOST_AWAY_SIGMAS = 6.0


def mapped(frames: Sequence[PosedFrame], is_prior: bool = False) -> dict[str, np.ndarray]:
    """Poses and points by incremental mapping, whose turn, scale and shift are then those of the given poses.

    Parameters
    ----------
    frames : sequence of PosedFrame
        In the order of the pass. Their poses are the datum: a turn is the mean over the attitudes, as places on a
        straight line leave one free; scale and shift are those of the places.
    is_prior : bool, optional
        The given places count in the adjustment too, each by its `place_sigma_m`, and are then the only datum.

    Returns
    -------
    dict of `index` (n,) of the frames that were registered, `camera_from_body` (n, 3, 3), `r_camera_body_m` (n, 3),
    `points_m` (N, 3) [m] that three frames or more share, and `turn_rad` and `place_m`, RMS of the given poses about
    these.

    Raises
    ------
    ValueError
        Without pycolmap, of frames of which fewer than three hang together, given poses that contradict each other, or
        places that are a prior and lie on a straight line or far from where the adjustment leaves them.

    Source: Schoenberger and Frahm (2016), Structure-from-Motion Revisited.
    """
    shift_m = _off_plane_m(frames) if is_prior else np.zeros(3)
    pycolmap = needed_pycolmap()
    with tempfile.TemporaryDirectory() as folder:
        model = _colmap(pycolmap, frames, Path(folder))
    if is_prior:
        _adjust(pycolmap, model, frames, shift_m)
    found = sorted((image for image in model.images.values() if image.has_pose), key=lambda image: image.name)
    index = np.array([number_of(image) for image in found])
    return {"index": index, **laid([frames[k] for k in index], np.array(
        [image.cam_from_world().rotation.matrix() for image in found]), np.array(
        [image.projection_center() for image in found]), shared_points(model), is_prior)}


def laid(frames: Sequence[PosedFrame], rotations: np.ndarray, places: np.ndarray, points: np.ndarray,
         is_in_body: bool = False) -> dict[str, np.ndarray]:
    """Rotations (n, 3, 3) to cameras, their places (n, 3) and points (N, 3) of any axes and unit, by the given poses.

    Returns all that `mapped` does but `index`, with its errors. Those that are in the body's axes and metres already
    stay as they are.
    """
    given_m = np.array([frame.r_camera_body_m for frame in frames])
    turn = Rotation.from_matrix([frame.camera_from_body.T @ own for frame, own in zip(frames, rotations, strict=True)])
    datum = Rotation.identity() if is_in_body else turn.mean()
    turned = datum.apply(places)
    arms, given_arms = turned - turned.mean(axis=0), given_m - given_m.mean(axis=0)
    scale = 1.0 if is_in_body else float((arms * given_arms).sum() / (arms**2).sum())
    shift_m = np.zeros(3) if is_in_body else given_m.mean(axis=0) - scale * turned.mean(axis=0)
    turn_rad = float(np.sqrt(np.mean((datum.inv() * turn).magnitude() ** 2)))
    place_m = float(np.sqrt(((scale * turned + shift_m - given_m) ** 2).sum(axis=1).mean()))
    length_m = float(np.sqrt((given_arms**2).sum(axis=1).mean()))
    if not (scale > 0.0 and turn_rad < _MOST_TURN_RAD and place_m < _MOST_PLACE * length_m):
        raise refuse("frames", "must have attitudes within 10 deg of the found ones, RMS, and places within half of "
                     f"their spread, {length_m:.4g} m, at a scale above 0", f"{np.degrees(turn_rad):.1f} deg, "
                     f"{place_m:.4g} m, {scale:.3g}", "give them in the body's axes, in the order of the pass")
    return {"camera_from_body": rotations @ datum.as_matrix().T, "r_camera_body_m": scale * turned + shift_m,
            "points_m": scale * datum.apply(points) + shift_m, "turn_rad": np.array(turn_rad),
            "place_m": np.array(place_m)}


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


def _off_plane_m(frames: Sequence[PosedFrame]) -> np.ndarray:
    """Shift (3,) [m] of the given places out of any plane through the origin; places on a line are refused."""
    given_m = np.array([frame.r_camera_body_m for frame in frames])
    sigma_m = max(number("place_sigma_m", frame.place_sigma_m, "give metres") for frame in frames)
    _, spread_m, axes = np.linalg.svd(given_m - given_m.mean(axis=0))
    length_m, bend_m = spread_m[:2] / np.sqrt(len(frames))
    if not bend_m > _LEAST_BEND_SIGMAS * sigma_m:
        raise refuse("frames", f"must leave a straight line by more than {_LEAST_BEND_SIGMAS:g} place_sigma_m, RMS, "
                     f"where places are a prior: {_LEAST_BEND_SIGMAS * sigma_m:.4g} m", f"{bend_m:.4g} m",
                     'use poses="free", which takes the turn about the line from the attitudes')
    return length_m * axes[2] - given_m.mean(axis=0)


def _adjust(pycolmap: Any, model: Any, frames: Sequence[PosedFrame], shift_m: np.ndarray) -> None:
    """Move places and points to where features and given places agree best, each by its sigma.

    COLMAP lays the model on the places first, and drops them where their rank is 2, as in a plane through the origin:
    the shift (3,) [m] is added to them before the adjustment, and taken off the model after it.
    """
    options, priors = pycolmap.BundleAdjustmentOptions(), pycolmap.PosePriorBundleAdjustmentOptions()
    options.refine_focal_length = options.refine_extra_params = options.print_summary = False
    options.ceres.solver_options.num_threads = 1
    # The model is laid on the given places first: none is an outlier there.
    priors.alignment_ransac.max_error = max(float(np.linalg.norm(frame.r_camera_body_m)) for frame in frames)
    config, places = pycolmap.BundleAdjustmentConfig(), []
    for image in model.images.values():
        if image.has_pose:
            frame = frames[number_of(image)]
            config.add_image(image.image_id)
            places.append(pycolmap.PosePrior(
                corr_data_id=image.data_id, position=frame.r_camera_body_m + shift_m,
                position_covariance=frame.place_sigma_m**2 * np.eye(3),
                coordinate_system=pycolmap.PosePriorCoordinateSystem.CARTESIAN))
    pycolmap.create_pose_prior_bundle_adjuster(options, priors, config, places, model).solve()
    model.transform(pycolmap.Sim3d(1.0, pycolmap.Rotation3d(), -shift_m))
    away = max(float(np.linalg.norm(image.projection_center() - frame.r_camera_body_m)) / frame.place_sigma_m
               for image in model.images.values() if image.has_pose for frame in [frames[number_of(image)]])
    if not away < _MOST_AWAY_SIGMAS:
        raise refuse("frames", f"must have places within {_MOST_AWAY_SIGMAS:g} place_sigma_m of the adjusted ones",
                     f"{away:.4g}", 'give the place_sigma_m that places are known to, or use poses="free"')
