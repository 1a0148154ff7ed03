"""A typed program that uses the public names as a mission's code would: mypy has nothing to say of it."""

from pathlib import Path

import glrender
import numpy as np
from glrender import (
    Body,
    PinholeCamera,
    Pose,
    Renderer,
    Scene,
    State,
    draw_still,
    frames,
    generate,
    laser_ranges,
    load_scene,
    open_renderer,
    take_frame,
)
from glrender.brdf import Hapke, Lambert, LunarLambert
from glrender.scenario import AtRest, Fixed, Pointing, Scenario, Times, load_scenario
from glrender.sequences.sequence import FrameOptions, FrameSequence
from glrender_camera import BrownConrady, CameraModel, Detector, Frame, Optics
from glrender_client import AsyncClient, Busy, Client, GlrenderClientError, Reply
from glrender_client.notebook import stretched
from glrender_photogrammetry import Mesh, deviation, posed_frames, reconstruct


def scene(shape: Path) -> Scene:
    law = Hapke(single_scattering_albedo=0.05, b=0.3, c=0.8, roughness_deg=25.0)
    model = CameraModel(optics=Optics(aperture_diameter_m=0.05, band_nm=(500.0, 700.0)), exposure_s="auto",
                        detector=Detector(quantum_efficiency=0.5, full_well_electrons=1e5, gain_DN_per_electron=0.04,
                                          bit_depth=12))
    camera = PinholeCamera(name="navcam", width_px=512, height_px=512, focal_length_px=2500.0, model=model,
                           principal_point_px=[255.5, 255.5], q_camera_from_spacecraft=[1.0, 0.0, 0.0, 0.0],
                           distortion=BrownConrady(k1=-0.1))
    across: float = camera.principal_point_px[0]
    bodies = [Body.from_file(shape, name="body", length_unit="km", brdf=law),
              Body(name="moon", shape=generate.icosphere(radius_m=across), brdf=Lambert(normal_albedo=0.1)),
              Body(name="other", shape=generate.three_lobes(radius_m=10.0), brdf=LunarLambert(normal_albedo=0.1))]
    return Scene(bodies=bodies, cameras=[camera], max_error=0.02)


def state(t_s: float) -> State:
    place = np.array([0.0, 0.0, -3000.0])
    return State(t_s=t_s, r_sun_inertial_m=[1.5e11, 0.0, 0.0], bodies={"body": Pose(r_inertial_m=(0.0, 0.0, 0.0))},
                 spacecraft=Pose(r_inertial_m=place, q_from_inertial=frames.look_at(place, [0.0, 0.0, 0.0]),
                                 v_inertial_m_s=[0.0, 0.0, 1.0]))


def total(given: Scene) -> float:
    with Renderer(given) as renderer:
        image = renderer.render(state(0.0), camera="navcam", products=["range"])
        error: float = image.plan.predicted_error
        nearest = float(np.nanmin(image.products["range"]))
        ranges = laser_ranges(given, state(0.0), [[0.0, 0.0, 1.0]], "navcam").range_m
        still = draw_still(renderer, state(0.0))
    with open_renderer(given, "raytrace") as reference:
        frame: Frame = take_frame(reference, state(0.0), seed=1).frame
    speed: np.ndarray | None = state(0.0).spacecraft.v_inertial_m_s
    return error + nearest + float(ranges.sum()) + still.irradiance_W_m2.sum() + frame.dn.max() + (
        0.0 if speed is None else float(speed @ state(0.0).spacecraft.r_inertial_m))


def fly(folder: Path) -> list[int]:
    loaded = load_scenario(folder / "flyby.toml")
    own = Scenario(trajectories={"spacecraft": AtRest(r_m=np.zeros(3), about="body")}, origin="body",
                   sampler=Times(times_s=[0.0]), attitudes={"spacecraft": Pointing(target="body"), "body": Fixed()})
    options = FrameOptions(camera="navcam", format="npz")
    sequence = FrameSequence(scene=loaded.scene, states=own.states(), folder=folder, options=options)
    return list(sequence.draw())


def compared(folder: Path, truth: glrender.Shape) -> float:
    frames = posed_frames(folder, body="body")
    made = reconstruct(frames, body="body", poses="free", prior=truth, folder=folder / "made")
    made.shape.to_file(folder / "model.ply")
    found = deviation(Mesh.from_file(folder / "model.ply"), truth, px_m=frames[0].px_m, align="similarity")
    return found.sigma_m + float(found.per_vertex_m.max()) + (found.complete_2px or 0.0)


def loop(address: str, given: Scene) -> Reply:
    try:
        with Client(address, timeout_s=5.0) as client:
            client.load_scene({"bodies": [], "cameras": []})
            reply = client.render(state(0.0), camera="navcam", output="dn", exposure_s=0.1, seed=7)
            brightest: int = int(reply.pixels.max())
            stretched(reply)
            for warning in reply.warnings:
                print(warning.code, brightest)
            return client.render(state(1.0).to_dict(), roi=(0, 0, 10, 10))
    except Busy as busy:
        raise GlrenderClientError(str(busy.retry_after_s)) from None


async def many(address: str) -> Reply:
    async with AsyncClient(address) as client:
        return await client.render(state(0.0), "navcam")


def refused() -> str:
    try:
        load_scene("scene.toml")
    except glrender.ConfigError as error:
        return error.path
    return glrender.__version__
