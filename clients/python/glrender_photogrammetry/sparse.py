"""Points of the surface from features that several frames share, by poses that are known."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from glrender_navigation.checks import refuse

from .features import matched, needed_pycolmap, number_of, pipeline, shared_points
from .frames import PosedFrame, angle_rad

# Frames nearer to each other, as the body sees them, tell no depth; further apart too few matches are right.
_NEIGHBOURS_RAD = (np.radians(0.5), np.radians(16.0))
_EPIPOLAR_PX = 0.7
_REPROJECTION_PX = 1.5
# Least share of the matches within the check [1]: right poses leave 0.01 outside.
_LEAST_SHARE_RIGHT = 0.5


def sparse_points(frames: Sequence[PosedFrame]) -> dict[str, np.ndarray]:
    """`points_m` (N, 3) [m] that three frames or more share, triangulated by the frames' poses.

    Raises
    ------
    ValueError
        Without pycolmap, of frames without neighbours 0.5 to 16 deg apart, without common features, or poses that
        contradict the matches.
    """
    apart = {(i, j): angle_rad(frames[i], frames[j]) for i in range(len(frames)) for j in range(i + 1, len(frames))}
    low, high = _NEIGHBOURS_RAD
    pairs = [pair for pair, angle in apart.items() if low < angle < high]
    if not pairs:
        least = min((angle for angle in apart.values() if angle > low), default=0.0)
        raise refuse("frames", "must have neighbours 0.5 to 16 deg apart about the body",
                     f"{np.degrees(least):.1f} deg at the least", "take more frames on the way")
    pycolmap = needed_pycolmap()
    model = pycolmap.Reconstruction()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        base = matched(frames, pairs, folder)
        with pycolmap.Database.open(base) as database:
            images = {number_of(image): image for image in database.read_all_images()}
            camera = database.read_all_cameras()[0]
            model.add_camera_with_trivial_rig(camera)
            at_px, poses, errors_px = {}, [], []
            for k, frame in enumerate(frames):
                at_px[k] = database.read_keypoints(images[k].image_id)[:, :2].astype(float)
                poses.append(pycolmap.Rigid3d(np.column_stack(
                    [frame.camera_from_body, -frame.camera_from_body @ frame.r_camera_body_m])))
                model.add_image_with_trivial_frame(pycolmap.Image(
                    name=images[k].name, keypoints=at_px[k], camera_id=images[k].camera_id,
                    image_id=images[k].image_id), poses[k])
            for i, j in pairs:
                ids = images[i].image_id, images[j].image_id
                if database.exists_two_view_geometry(*ids):
                    a, b = database.read_two_view_geometry(*ids).inlier_matches.T
                    errors_px.append(camera.focal_length * np.sqrt(pycolmap.compute_squared_sampson_error(
                        camera.cam_from_img(at_px[i][a]), camera.cam_from_img(at_px[j][b]),
                        pycolmap.essential_matrix_from_pose(poses[j] * poses[i].inverse()))))
        _check(np.concatenate([np.empty(0), *errors_px]))
        options = pipeline(pycolmap)
        options.mapper.filter_max_reproj_error = _REPROJECTION_PX
        model = pycolmap.triangulate_points(model, base, folder, folder, options=options)
        return {"points_m": np.array([point.xyz for point in shared_points(model)]).reshape(-1, 3)}


def _check(errors_px: np.ndarray) -> None:
    if not errors_px.size:
        raise refuse("frames", "must share features", 0, "check exposure and phase: near opposition nothing shows")
    share_wrong = float((errors_px >= _EPIPOLAR_PX).mean())
    if share_wrong > 1.0 - _LEAST_SHARE_RIGHT:
        raise refuse("frames", f"must have poses that the matches agree with: {100 * share_wrong:.0f} % fail the "
                     f"epipolar check of {_EPIPOLAR_PX:g} px", f"{np.median(errors_px):.1f} px in the median",
                     'poses that are not known well: poses="free"')
