"""Features of frames and their matches, by COLMAP: SIFT of the root of the signal, checked in pairs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from glrender_navigation.checks import refuse

from .frames import PosedFrame

_N_FEATURES = 6000
_CONTRAST = 0.003
# Least angle between a point's rays: at less it has no depth.
_LEAST_ANGLE_DEG = 1.0
_LEAST_TRACK = 3


def needed_pycolmap() -> Any:
    """The module, or a ValueError that says how to install it."""
    try:
        import pycolmap
    except ImportError:
        raise refuse("reconstruct", "needs pycolmap", None, "pip install 'glrender[reconstruction]'") from None
    # It writes each step of its work to the standard error output; what fails is raised here.
    pycolmap.logging.minloglevel = int(pycolmap.logging.FATAL)
    return pycolmap


def name_of(number: int) -> str:
    """The image of a frame by its number."""
    return f"{number:05d}.png"


def number_of(image: Any) -> int:
    """Number of the frame of one of COLMAP's images."""
    return int(image.name[:5])


def matched(frames: Sequence[PosedFrame], pairs: Iterable[tuple[int, int]], folder: Path) -> Path:
    """COLMAP's database of frames and of the matches of pairs that agree with one another; images are in `folder`."""
    pycolmap = needed_pycolmap()
    base, listed, camera = folder / "features.db", folder / "pairs.txt", frames[0].camera
    for k, frame in enumerate(frames):
        cv2.imwrite(str(folder / name_of(k)), (255.0 * np.minimum(frame.root, 1.0)).astype(np.uint8))
    listed.write_text("".join(f"{name_of(one)} {name_of(other)}\n" for one, other in pairs))
    pycolmap.set_random_seed(0)
    reader = pycolmap.ImageReaderOptions()
    # COLMAP's (0, 0) is the corner of the first pixel.
    x, y = camera.matrix[:2, 2] + 0.5
    reader.camera_model, reader.camera_params = "SIMPLE_PINHOLE", f"{camera.focal_length_px},{x},{y}"
    extraction, matching = pycolmap.FeatureExtractionOptions(), pycolmap.FeatureMatchingOptions()
    extraction.use_gpu, extraction.num_threads, matching.use_gpu, matching.num_threads = False, 1, False, 1
    extraction.sift.max_num_features, extraction.sift.peak_threshold = _N_FEATURES, _CONTRAST
    pycolmap.extract_features(base, folder, image_names=[name_of(k) for k in range(len(frames))],
                              camera_mode=pycolmap.CameraMode.SINGLE, reader_options=reader,
                              extraction_options=extraction)
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = listed
    pycolmap.match_image_pairs(base, matching_options=matching, pairing_options=pairing)
    return base


def pipeline(pycolmap: Any) -> Any:
    """COLMAP's options, of a camera that is known."""
    options = pycolmap.IncrementalPipelineOptions()
    options.ba_refine_focal_length = options.ba_refine_extra_params = options.ba_refine_principal_point = False
    options.num_threads = 1
    options.triangulation.min_angle = options.mapper.filter_min_tri_angle = _LEAST_ANGLE_DEG
    return options


def shared_points(model: Any) -> list[Any]:
    """Points of a model of COLMAP that three frames or more share."""
    return [point for point in model.points3D.values() if point.track.length() >= _LEAST_TRACK]
