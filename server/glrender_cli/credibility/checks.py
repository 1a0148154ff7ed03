"""The named checks: each compares frames that are drawn now with a closed form or with float64 rays."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib import resources
from typing import Any

import numpy as np
from glrender import Body, PinholeCamera, Pose, Scene, Shape, State, generate, open_renderer
from glrender.base.constants import AU_M
from glrender.base.rotations import dcm
from glrender.brdf import Lambert, LommelSeeliger
from glrender_camera import CameraModel

from ..new_files import EXAMPLE

RANGE_M, RADIUS_M = 1.0e7, 100.0
PLACE_M = (7.31, -4.27, 0.0)
AXES, TURN = (1.0, 0.7, 0.5), (0.5, 0.5, -0.5, 0.5)
PHASES_DEG = (20.0, 60.0, 100.0)
MAX_ERROR, TRUTH_ERROR = 0.02, 0.008
"""Tolerance [1] of the frames that are judged, and of the rays that judge them."""
N_FRAMES = 64
"""Frames that stand still, whose variance is compared: its standard error is 18 % a pixel, below 0.1 % of all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """A requirement, and the number that this machine found for it.

    Attributes
    ----------
    name, requirement, reference, domain : str
        The quantity, the rule, the independent source, and the cases to which the number belongs.
    number, most : float
        The check holds where the number is at most this; NaN fails.
    """

    name: str
    requirement: str
    reference: str
    domain: str
    number: float
    most: float

    @property
    def holds(self) -> bool:
        """The verdict."""
        return bool(self.number <= self.most)


def checks(backend: str = "auto") -> Iterator[Check]:
    """All checks, one after the other.

    Parameters
    ----------
    backend : str
        As of `open_renderer`.
    """
    yield from _sphere(backend)
    yield from _facets(backend)
    yield _rays(backend)
    yield _noise()


def _state(phase_deg: float, body: str, range_m: float) -> State:
    """A camera that looks along +Z at the origin, and the Sun at 1 au to the right."""
    phase = np.radians(phase_deg)
    return State(r_sun_inertial_m=AU_M * np.array([np.sin(phase), 0.0, -np.cos(phase)]),
                 spacecraft=Pose(r_inertial_m=[0.0, 0.0, -range_m]), bodies={body: Pose(r_inertial_m=np.zeros(3))})


def _sphere(backend: str) -> Iterator[Check]:
    """Total light of a Lambert sphere, p = 2 A / 3 and its phase law, and where its light lies."""
    albedo, shape = 0.3, generate.icosphere(radius_m=RADIUS_M, subdivisions=6)
    camera = PinholeCamera(name="camera", width_px=128, height_px=128, focal_length_px=5.0e6)
    scene = Scene(bodies=[Body(name="sphere", shape=shape, brdf=Lambert(normal_albedo=albedo))], cameras=[camera],
                  solar_irradiance_1au_W_m2=1.0, sun_disc=False, max_error=0.005)
    worst_flux, worst_bytes = 0.0, 0.0
    with open_renderer(scene, backend) as renderer:
        for phase_deg in PHASES_DEG:
            state, g = _state(phase_deg, "sphere", RANGE_M), np.radians(phase_deg)
            image = renderer.render(state).irradiance_W_m2
            law = 2.0 / 3.0 * albedo * (np.sin(g) + (np.pi - g) * np.cos(g)) / np.pi
            exact = law * (RADIUS_M / RANGE_M)**2
            worst_flux = max(worst_flux, abs(image.sum(dtype=float) / exact - 1.0))
            worst_bytes = max(worst_bytes, float(image.tobytes() != renderer.render(state).irradiance_W_m2.tobytes()))
        state = replace(_state(0.0, "sphere", RANGE_M), bodies={"sphere": Pose(r_inertial_m=np.array(PLACE_M))})
        image = renderer.render(state).irradiance_W_m2.astype(float)
    place_px = 63.5 + camera.focal_length_px * np.array(PLACE_M[:2]) / RANGE_M
    places = np.stack([image.sum(axis=0) @ np.arange(128.0), image.sum(axis=1) @ np.arange(128.0)]) / image.sum()
    domain = "a Lambert sphere, 100 px across, at 100,000 radii, phase angles 20, 60 and 100 deg"
    yield Check(name="total light", requirement="relative error of the flux", number=worst_flux, most=6e-4,
                reference="closed form of a Lambert sphere; its facets lack 1e-4 of the light", domain=domain)
    yield Check(name="place", requirement="centre of brightness off the projected centre [px]", most=3e-4,
                number=float(np.linalg.norm(places - place_px)), reference="pinhole projection",
                domain="the same sphere at phase 0")
    yield Check(name="determinism", requirement="frames whose bytes change when they are drawn again",
                number=worst_bytes, most=0.0, reference="the frame itself", domain=domain)


def _facets(backend: str) -> Iterator[Check]:
    """True errors of flux and centre over predicted ones, of a convex body, by each engine."""
    ball = generate.icosphere(radius_m=RADIUS_M, subdivisions=5)
    body = Body(name="body", shape=Shape.from_arrays(ball.vertices_m * AXES, ball.facets),
                brdf=Lambert(normal_albedo=0.3))
    camera = PinholeCamera(name="camera", width_px=128, height_px=128, focal_length_px=5.0e6)
    scene = Scene(bodies=[body], cameras=[camera], solar_irradiance_1au_W_m2=1.0, sun_disc=False, max_error=MAX_ERROR)
    worst = {"flux": 0.0, "centroid_px": 0.0}
    with open_renderer(scene, backend) as renderer:
        engines = renderer.info.get("engines", (None,))
        for phase_deg in PHASES_DEG:
            state = replace(_state(phase_deg, "body", RANGE_M), bodies={"body": Pose(
                r_inertial_m=np.array(PLACE_M), q_from_inertial=TURN)})
            flux, place_px = _light_of_facets(body, camera, state)
            for engine in engines:
                image = renderer.render(state, **({} if engine is None else {"engine": engine}))
                light = image.irradiance_W_m2.astype(float)
                found_px = np.stack([light.sum(axis=0) @ np.arange(128.0), light.sum(axis=1) @ np.arange(128.0)])
                errors = {"flux": abs(float(light.sum() / flux) - 1.0),
                          "centroid_px": float(np.linalg.norm(found_px / light.sum() - place_px))}
                worst = {unit: max(ratio, errors[unit] / image.plan.predicted[unit]) for unit, ratio in worst.items()}
    for unit, ratio in worst.items():
        yield Check(name=f"predicted {unit}", requirement="largest true error over the predicted one", number=ratio,
                    most=1.0, reference="sum over the facets of a convex body, each all lit or dark: exact to 1e-9",
                    domain=f"an ellipsoid of 20,480 facets, axes 1, 0.7, 0.5, 100 px long, phase angles 20, 60 and "
                    f"100 deg, max_error {MAX_ERROR}, each engine: {', '.join(map(str, engines))}")


def _light_of_facets(body: Body, camera: PinholeCamera, state: State) -> tuple[float, np.ndarray]:
    """Irradiance [W/m2] of a convex body of Lambert's law from afar, and the centre (2,) [px] of its light."""
    pose = state.bodies[body.name]
    vertices_m = body.shape.vertices_m @ dcm(pose.q_from_inertial) + pose.r_inertial_m - state.spacecraft.r_inertial_m
    corners_m = vertices_m[body.shape.facets]
    areas_m2 = 0.5 * np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    middles_m, to_sun_m = corners_m.mean(axis=1), state.r_sun_inertial_m - pose.r_inertial_m
    range_m, sun_m = np.linalg.norm(middles_m, axis=1), np.linalg.norm(to_sun_m)
    seen_m2 = np.maximum(-np.einsum("ij,ij->i", areas_m2, middles_m) / range_m, 0.0)
    cosines = np.maximum(areas_m2 @ to_sun_m / sun_m, 0.0) / np.linalg.norm(areas_m2, axis=1)
    light = 0.3 / np.pi * cosines * seen_m2 / range_m**2 * (AU_M / sun_m) ** 2
    return float(light.sum()), light @ camera.project(middles_m) / light.sum()


def _rays(backend: str) -> Check:
    """True RMS errors over predicted ones: Itokawa of 12,288 facets against float64 rays."""
    with resources.as_file(resources.files("glrender") / "data" / EXAMPLE) as path:
        shape = Shape.from_file(path, length_unit="km")
    camera = PinholeCamera(name="camera", width_px=96, height_px=96, focal_length_px=800.0)
    scene = Scene(bodies=[Body(name="body", shape=shape, brdf=LommelSeeliger(single_scattering_albedo=0.1))],
                  cameras=[camera], max_error=MAX_ERROR)
    ratio = 0.0
    with (open_renderer(scene, backend) as renderer,
          open_renderer(replace(scene, max_error=TRUTH_ERROR), "raytrace") as rays):
        for phase_deg in PHASES_DEG:
            state = _state(phase_deg, "body", 5000.0)
            image, true = renderer.render(state), rays.render(state)
            drawn, exact = (each.irradiance_W_m2.astype(float) for each in (image, true))
            error = np.sqrt(np.mean((drawn - exact)[(drawn > 0.0) | (exact > 0.0)] ** 2)) / exact[exact > 0.0].mean()
            excess = np.sqrt(max(error**2 - true.plan.predicted["rms"] ** 2, 0.0))
            ratio = max(ratio, float(excess / image.plan.predicted["rms"]))
    return Check(name="predicted rms", requirement="largest true error over the predicted one", number=ratio,
                 most=1.0, reference="backend raytrace, whose own error is subtracted in squares",
                 domain=f"Itokawa, 90 px long, phase angles 20, 60 and 100 deg, max_error {MAX_ERROR}")


def _noise() -> Check:
    """Temporal variance of frames that stand still against shot, read and rounding noise."""
    model = CameraModel.from_dict({"preset": "generic_navigation_camera"})
    light = np.zeros((64, 64), np.float32)
    exposure_s = float(model.expose(light, 0, exposure_s=0.1).exposure_s)
    # Half of the full well, by the response that two levels of light show.
    probe = np.full_like(light, 1e-9)
    slope = float(np.mean(model.expose(probe, 1, exposure_s=exposure_s).dn.astype(float))
                  - np.mean(model.expose(light, 1, exposure_s=exposure_s).dn.astype(float))) / 1e-9
    detector: Any = model.detector
    level = np.full_like(light, 0.5 * detector.max_DN / slope)
    frames = np.stack([model.expose(level, seed, exposure_s=exposure_s).dn.astype(float) for seed in range(N_FRAMES)])
    mean, gain = frames.mean() - detector.offset_DN, detector.gain_DN_per_electron
    expected = gain * mean + (gain * detector.read_noise_electrons)**2 + 1.0 / 12.0
    return Check(name="temporal noise", requirement="relative error of the variance",
                 number=abs(float(frames.var(axis=0, ddof=1).mean()) / expected - 1.0), most=0.03,
                 reference="EMVA 1288: gain times signal, read noise, rounding",
                 domain=f"the preset generic_navigation_camera at half of its range, {N_FRAMES} frames")
