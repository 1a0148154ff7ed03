"""The world of these examples: a true and a believed renderer, a camera, and a flight round a contact binary."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from glrender import (
    Body,
    Comparison,
    PinholeCamera,
    Pose,
    Renderer,
    Scene,
    Shape,
    State,
    compare_frame,
    draw_still,
    frames,
    generate,
    laser_ranges,
    take_frame,
)
from glrender.base.constants import AU_M
from glrender.brdf import Hapke
from glrender_camera import CameraModel
from glrender_navigation import BelievedBody, Camera

PSF_SIGMA_PX = 0.6
_FOCAL_LENGTH_PX_PER_WIDTH = 3.2
_SPIN_PERIOD_S = 4.0 * 3600.0


@dataclass(frozen=True)
class Reply:
    """A frame as `glrender_client.Reply` has it."""

    pixels: np.ndarray
    arrays: dict[str, np.ndarray]
    comparison: Comparison | None = None


class Local:
    """Draws a scene in this process with the arguments and replies of `Client.render` and `Client.range`."""

    def __init__(self, scene: Scene, **options: Any):
        self.scene, self._renderer, self._options = scene, Renderer(scene), options

    def __enter__(self) -> Local:
        return self

    def __exit__(self, *exception) -> None:
        self._renderer.close()

    def render(self, state: Any, *, output: str = "irradiance", products: Any = (), roi: Any = None,
               compare: np.ndarray | None = None, robust: bool = False, **options: Any) -> Reply:
        state, options = _state(state), {**self._options, **options}
        if compare is not None:
            return Reply(compare, {}, compare_frame(self._renderer, state, frame_DN=compare, roi=roi, is_robust=robust,
                                                    **options))
        if output == "dn":
            capture = take_frame(self._renderer, state, products=products, **options)
            return Reply(capture.frame.dn, capture.products)
        capture = draw_still(self._renderer, state, products=products, roi=roi, **options)
        x0, y0, x1, y1 = roi or (0, 0, *capture.irradiance_W_m2.shape[::-1])
        return Reply(capture.irradiance_W_m2[y0:y1, x0:x1],
                     {name: array[y0:y1, x0:x1] for name, array in capture.products.items()})

    def range(self, state: Any, directions_camera: np.ndarray) -> np.ndarray:
        return laser_ranges(self.scene, _state(state), directions_camera).range_m


def _state(state: Any) -> State:
    return state if isinstance(state, State) else State.from_dict(state)


def shape(subdivisions: int = 6) -> Shape:
    return generate.contact_binary(radius_m=300.0, seed=1, subdivisions=subdivisions)


def scene(shape: Shape, size_px: int, max_error: float = 0.01) -> Scene:
    """A dark body before a camera of 12 bits."""
    law = Hapke(single_scattering_albedo=0.33, b=0.25, c=1.0, shoe_amplitude=1.0, shoe_width=0.05, roughness_deg=28.0)
    model = CameraModel.from_dict({
        "exposure_s": "auto",
        "optics": {"aperture_diameter_m": 6e-6 * size_px, "transmission": 0.8, "psf_sigma_px": PSF_SIGMA_PX},
        "detector": {"quantum_efficiency": 0.5, "full_well_electrons": 40000.0, "gain_DN_per_electron": 0.1,
                     "bit_depth": 12, "offset_DN": 50.0, "read_noise_electrons": 20.0,
                     "dark_current_electrons_per_s": 20.0, "photo_response_nonuniformity": 0.01}})
    navcam = PinholeCamera(name="navcam", width_px=size_px, height_px=size_px, model=model,
                           focal_length_px=_FOCAL_LENGTH_PX_PER_WIDTH * size_px)
    return Scene(bodies=[Body(name="body", shape=shape, brdf=law)], cameras=[navcam], max_error=max_error)


def camera(size_px: int) -> Camera:
    return Camera(width_px=size_px, height_px=size_px, focal_length_px=_FOCAL_LENGTH_PX_PER_WIDTH * size_px,
                  psf_sigma_px=PSF_SIGMA_PX)


def body(shape: Shape) -> BelievedBody:
    return BelievedBody.from_mesh("body", shape.vertices_m, shape.facets)


def views(n: int, seed: int = 1, off: float = 0.01) -> Iterator[tuple[State, State]]:
    """True and believed states: a flight from 25 to 100 degrees of phase, from 6 to 2.2 km.

    The believed place errs by the share `off` of the range along each axis; the camera points to where the body is
    believed.
    """
    rng = np.random.default_rng(seed)
    for share in np.linspace(0.0, 1.0, n):
        phase, tilt = np.radians(25.0 + 75.0 * share), 0.25 * np.sin(2.0 * np.pi * share)
        range_m = 6000.0 * (2200.0 / 6000.0)**share
        r_m = range_m * np.array([np.cos(phase), np.sin(phase), tilt]) / np.hypot(1.0, tilt)
        believed_r_m = r_m + off * range_m * rng.standard_normal(3)
        q = frames.look_at(believed_r_m, np.zeros(3))
        yield state(3.0 * share * _SPIN_PERIOD_S, r_m, q), state(3.0 * share * _SPIN_PERIOD_S, believed_r_m, q)


def state(t_s: float, r_m: np.ndarray, q_camera_from_inertial: np.ndarray) -> State:
    """The spacecraft at a place (3,) [m] about the body, which turns once in four hours; the Sun along +X."""
    spin = 2.0 * np.pi * t_s / _SPIN_PERIOD_S
    turned = [np.cos(spin / 2.0), 0.0, 0.0, -np.sin(spin / 2.0)]
    return State(t_s=t_s, r_sun_inertial_m=np.array([AU_M, 0.0, 0.0]),
                 spacecraft=Pose(r_inertial_m=r_m, q_from_inertial=q_camera_from_inertial),
                 bodies={"body": Pose(r_inertial_m=np.zeros(3), q_from_inertial=turned)})
