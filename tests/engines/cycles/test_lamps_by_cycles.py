"""Lamps by Blender's Cycles: a sphere around one, with and without light between its walls, in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from glrender import Body, ConfigError, Lamp, PinholeCamera, Pose, Scene, Shape, State, frames, generate
from glrender.brdf import Lambert, LommelSeeliger
from glrender.engines.cycles import Cycles

RADIUS_M, ALBEDO, INTENSITY_W_SR = 5.0, 0.5, 3.0


def scene(law, **lamp):
    ball = generate.icosphere(radius_m=RADIUS_M, subdivisions=5)
    room = Body(name="room", shape=Shape.from_arrays(ball.vertices_m, ball.facets[:, ::-1], inside=True), brdf=law)
    camera = PinholeCamera(name="c", width_px=32, height_px=32, focal_length_px=40.0,
                           r_camera_spacecraft_m=[0.5, 0.0, 0.0])
    return Scene(bodies=[room], cameras=[camera], lamps=[Lamp(name="a", intensity_W_sr=INTENSITY_W_SR, **lamp)])


@pytest.mark.slow
@pytest.mark.usefixtures("blender")
def test_light_between_the_walls_of_a_sphere_is_the_closed_series():
    """A I / (pi R^2), and 1 / (1 - A) times as much with bounces, within 1 %; a cone ends where it should."""
    q = frames.look_at([0.0, 0.0, 0.0], [1.0, 0.0, 0.0])
    state = State(r_sun_inertial_m=[1.5e11, 0.0, 0.0], bodies={"room": Pose(r_inertial_m=np.zeros(3))},
                  spacecraft=Pose(r_inertial_m=np.zeros(3), q_from_inertial=q))
    expected = ALBEDO / np.pi * INTENSITY_W_SR / RADIUS_M**2 / 40.0**2
    with Cycles(scene(Lambert(normal_albedo=ALBEDO)), bounces=0) as cycles:
        for bounces, times in ((0, 1.0), (16, 1.0 / (1.0 - ALBEDO))):
            image = cycles.render(state, samples=24, bounces=bounces)
            np.testing.assert_allclose(image.irradiance_W_m2[14:18, 14:18].mean(), times * expected, rtol=0.01)
    with Cycles(scene(Lambert(normal_albedo=ALBEDO), half_angle_deg=15.0), bounces=0) as cycles:
        image = cycles.render(state, samples=8).irradiance_W_m2
    # The lamp is 0.5 m left of the camera, which is 5 m from the wall.
    middle_px, half_px = 15.5 - 40.0 * 0.5 / RADIUS_M, 40.0 * np.tan(np.radians(15.0))
    row = np.flatnonzero(image[16] > 0.5 * expected)
    assert abs(row[0] - (middle_px - half_px)) < 1.5 and abs(row[-1] - (middle_px + half_px)) < 1.5


def test_another_law_is_refused():
    with pytest.raises(ConfigError, match="lamps: shine on Lambert's law alone in the backend cycles"):
        Cycles(scene(LommelSeeliger(single_scattering_albedo=0.3)))
