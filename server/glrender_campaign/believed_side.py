"""The on-board side: the believed scene, its camera and body, and a function that draws it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
from glrender import PinholeCamera, Scene, State, compare_frame, draw_still, take_frame
from glrender.base.errors import error_path
from glrender.scenario import Belief, CameraBelief
from glrender_camera import BrownConrady
from glrender_navigation import BelievedBody, Camera


def onboard_scene(truth: Scene, belief: Belief) -> Scene:
    """The believed scene of a true one, its cameras without distortion: frames are undistorted first.

    Raises
    ------
    ConfigError
    """
    with error_path("belief"):
        scene = belief.scene(truth)
    return replace(scene, cameras=[replace(camera, distortion=None) for camera in scene.cameras])


def believed_distortion(camera: PinholeCamera, belief: Belief) -> BrownConrady | None:
    """The distortion that a true camera is believed to have."""
    return belief.cameras.get(camera.name, CameraBelief()).camera(camera).distortion


def camera_of(camera: PinholeCamera) -> Camera:
    """A camera of a scene, as estimators have it."""
    model = camera.model
    sigma_px = max((band.optics.psf_sigma_px or 0.0) for band in model.bands.values())
    return Camera(width_px=camera.width_px, height_px=camera.height_px, focal_length_px=camera.focal_length_px,
                  principal_point_px=tuple(camera.principal_point_px), psf_sigma_px=sigma_px,
                  q_camera_from_spacecraft=tuple(camera.q_camera_from_spacecraft),
                  r_camera_spacecraft_m=tuple(camera.r_camera_spacecraft_m))


def body_of(scene: Scene, name: str) -> BelievedBody:
    """A body of a scene, as estimators have it."""
    shape = next(body for body in scene.bodies if body.name == name).shape
    return BelievedBody.from_mesh(name, shape.vertices_m, shape.facets)


def undistortion(camera: PinholeCamera, k: BrownConrady | None) -> Callable[[np.ndarray], np.ndarray]:
    """A function that takes a believed distortion out of a frame: estimators know pinholes alone."""
    if k is None:
        return lambda frame: frame
    (cx, cy), f = camera.principal_point_px, camera.focal_length_px
    matrix = np.array([[f, 0.0, cx], [0.0, f, cy], [0.0, 0.0, 1.0]])
    coefficients = np.array([k.k1, k.k2, k.p1, k.p2, k.k3, k.k4, k.k5, k.k6])
    maps = cv2.initUndistortRectifyMap(matrix, coefficients, None, matrix, (camera.width_px, camera.height_px),
                                       cv2.CV_32FC1)
    # Lanczos is the one of OpenCV's interpolations that widens edges least.
    return lambda frame: cv2.remap(frame, *maps, cv2.INTER_LANCZOS4)


def render_of(renderer: Any, camera: str, max_error: float) -> Callable[..., Any]:
    """A function that draws a scene as `Client.render` does: of a state and options to a reply with its arrays.

    Parameters
    ----------
    renderer
        Of `open_renderer`.
    camera : str
    max_error : float [1]
        Where the caller asks for no other.
    """

    def render(state: Any, *, output: str = "irradiance", products: tuple[str, ...] = (), roi: Any = None,
               compare: np.ndarray | None = None, robust: bool = False, **options: Any) -> SimpleNamespace:
        state = state if isinstance(state, State) else State.from_dict(state)
        if compare is not None:
            options = {"max_error": max_error, **options}
            return SimpleNamespace(comparison=compare_frame(renderer, state, camera, frame_DN=compare, roi=roi,
                                                            is_robust=robust, **options))
        options = {"max_error": max_error, "products": products, **options}
        if output == "dn":
            capture = take_frame(renderer, state, camera, **options)
            image = capture.frame.dn
        else:
            capture = draw_still(renderer, state, camera, roi=roi, **options)
            image = capture.irradiance_W_m2
        x0, y0, x1, y1 = roi or (0, 0, *image.shape[::-1])
        arrays = {name: array[y0:y1, x0:x1] for name, array in {"image": image, **capture.products}.items()}
        return SimpleNamespace(pixels=arrays["image"], arrays=arrays)

    return render
