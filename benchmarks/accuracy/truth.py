"""Ray-traced truth of a scene and state, kept under out/truth by the hash of all that goes into it."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from glrender import Scene, State, open_renderer

FOLDER = Path(__file__).parent.parent.parent / "out" / "truth"
PRODUCTS = ("body_id", "facet_id", "incidence", "sunlit")
_VERSION = b"4"
# Odd: its samples stand where no drawn grid of 1, 2, 4 or 8 has its own, but the centre.
_LEAST, _MOST = 9, 101


@dataclass(frozen=True, kw_only=True, eq=False)
class Truth:
    """The truth by rays.

    Attributes
    ----------
    irradiance_W_m2 : (H, W) float64
    products : dict
        At the pixels' centres: `PRODUCTS`.
    samples : int
        Along a pixel's side.
    own_error : float [1]
        RMS sampling error of the truth over the mean of the lit pixels: its difference from a coarser
        grid, carried to its own by n^-1.5.
    """

    irradiance_W_m2: np.ndarray
    products: dict[str, np.ndarray]
    samples: int
    own_error: float


def truth(scene: Scene, state: State, n_rays: float = 30e6, most_error: float = math.inf) -> Truth:
    """The truth with about `n_rays` rays, 9 x 9 to 101 x 101 a pixel; from the cache if it is there.

    With as many more as it takes where its own error is above the most that it may be.
    """
    made = _kept(scene, state, n_rays)
    if made.own_error <= most_error or made.samples >= _MOST:
        return made
    return _kept(scene, state, n_rays, made.samples * (made.own_error / most_error) ** (2.0 / 3.0))


def _kept(scene: Scene, state: State, n_rays: float, least_samples: float = _LEAST) -> Truth:
    path = FOLDER / f"{_key(scene, state, n_rays, least_samples)}.npz"
    if not path.is_file():
        FOLDER.mkdir(parents=True, exist_ok=True)
        made = _trace(scene, state, n_rays, least_samples)
        part = path.with_suffix(".part.npz")
        np.savez_compressed(part, irradiance_W_m2=made.irradiance_W_m2, samples=made.samples,
                            own_error=made.own_error, **made.products)
        part.replace(path)
    with np.load(path) as stored:
        return Truth(irradiance_W_m2=stored["irradiance_W_m2"], products={name: stored[name] for name in PRODUCTS},
                     samples=int(stored["samples"]), own_error=float(stored["own_error"]))


def _trace(scene: Scene, state: State, n_rays: float, least_samples: float) -> Truth:
    with open_renderer(scene, backend="raytrace") as tracer:
        first = tracer.render(state, samples=1, products=PRODUCTS)
        x0, y0, x1, y1 = first.roi
        samples = math.sqrt(n_rays / max((x1 - x0) * (y1 - y0), 1))
        samples = min(max(2 * int(0.5 * samples) + 1, 2 * math.ceil(0.5 * (least_samples - 1.0)) + 1), _MOST)
        coarse = 2 * (samples // 4) + 1
        fine, rough = (tracer.render(state, samples=n).irradiance_W_m2.astype(np.float64) for n in (samples, coarse))
    lit = fine > 0.0
    difference = np.sqrt(np.mean((fine - rough)[lit] ** 2)) / fine[lit].mean() if lit.any() else 0.0
    ratio = (samples / coarse) ** -1.5
    return Truth(irradiance_W_m2=fine, products=first.products, samples=samples,
                 own_error=float(difference * ratio / math.sqrt(1.0 + ratio**2)))


def _key(scene: Scene, state: State, n_rays: float, least_samples: float) -> str:
    digest = hashlib.sha256(_VERSION)
    for body in scene.bodies:
        pose = state.bodies[body.name]
        for part in (body.shape.vertices_m, body.shape.facets, pose.r_inertial_m, pose.q_from_inertial):
            digest.update(np.ascontiguousarray(part).tobytes())
        digest.update(repr((body.name, body.brdf, body.smooth_normals)).encode())
    digest.update(repr((state.to_dict(), scene.solar_irradiance_1au_W_m2, scene.sun_disc, n_rays,
                        least_samples)).encode())
    for camera in scene.cameras:
        digest.update(repr((camera.width_px, camera.height_px, camera.focal_length_px,
                            tuple(np.ravel(camera.principal_point_px)), tuple(camera.q_camera_from_spacecraft),
                            tuple(camera.r_camera_spacecraft_m))).encode())
    return digest.hexdigest()[:24]
