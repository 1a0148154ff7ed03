"""States for tests: a body at the origin, a camera at a range, the Sun at a phase angle."""

from __future__ import annotations

from functools import cache

import numpy as np
from glrender import Body, PinholeCamera, Pose, Scene, State, frames, generate
from glrender.base.constants import AU_M

SOLAR_IRRADIANCE_W_M2 = 1000.0


def camera(size_px=256, focal_length_px=1000.0, **kwargs):
    return PinholeCamera(**{"name": "navcam", "width_px": size_px, "height_px": size_px,
                            "focal_length_px": focal_length_px, **kwargs})


def sphere(law, subdivisions=5, radius_m=100.0, name="body", **kwargs):
    """An icosphere of 20 * 4**subdivisions facets."""
    return Body(name=name, shape=generate.icosphere(radius_m=radius_m, subdivisions=subdivisions), brdf=law, **kwargs)


@cache
def binary(seed, subdivisions=6):
    """A contact binary's shape, 100 m in radius, of 20 * 4**subdivisions facets: made once in a process."""
    return generate.contact_binary(radius_m=100.0, seed=seed, subdivisions=subdivisions)


def scene(bodies, cameras, **kwargs):
    return Scene(**{"bodies": bodies, "cameras": cameras, "solar_irradiance_1au_W_m2": SOLAR_IRRADIANCE_W_M2,
                    "max_error": 0.1, **kwargs})


def state(phase_deg=60.0, range_m=2000.0, sun_in_image=(1.0, 0.0), bodies=("body",), target=(0.0, 0.0, 0.0),
          q_body=(1.0, 0.0, 0.0, 0.0), sun_distance_au=1.0, direction=(0.3, -0.8, 0.4)):
    """Camera at `range_m` along `direction` from the origin, looking at `target`.

    The Sun stands at `phase_deg` from the camera as seen from the origin, in the image's direction
    `sun_in_image` (x right, y down).
    """
    direction = np.asarray(direction, float) / np.linalg.norm(direction)
    r_camera = range_m * direction
    q = frames.look_at(r_camera, target)
    right, down = frames.dcm(frames.look_at(r_camera, np.zeros(3)))[:2]
    aside = sun_in_image[0] * right + sun_in_image[1] * down
    aside = aside / np.linalg.norm(aside)
    phase = np.radians(phase_deg)
    r_sun = (np.cos(phase) * direction + np.sin(phase) * aside) * sun_distance_au * AU_M
    return State(t_s=0.0, r_sun_inertial_m=r_sun, spacecraft=Pose(r_inertial_m=r_camera, q_from_inertial=q),
                 bodies={name: Pose(r_inertial_m=np.zeros(3), q_from_inertial=q_body) for name in bodies})


def relative_rms(image, truth):
    """RMS error of the pixels that either lights over the mean of those that the truth does [1]."""
    lit = (truth > 0.0) | (image > 0.0)
    return float(np.sqrt(np.mean((image - truth)[lit] ** 2)) / truth[truth > 0.0].mean())


def rough_body(law):
    """81,920 facets, slopes of some 20 degrees at the smallest scale."""
    shape = generate.gaussian_random_sphere(radius_m=100.0, sigma=0.15, seed=4, subdivisions=4)
    return Body(name="body", shape=generate.subdivide_with_relief(shape, levels=2, relief=0.04, seed=1), brdf=law)


def centroid_px(image):
    """(x, y) centre of brightness [px]."""
    image = image.astype(np.float64)
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    return np.array([(x * image).sum(), (y * image).sum()]) / image.sum()
