"""A plane by lamps, in closed form: all laws, textures, lenses, parts of an image, and cones as narrow as a pixel."""

from __future__ import annotations

import numpy as np
import pytest
from cells import slow_but
from glrender import Body, Lamp, PinholeCamera, Pose, Renderer, Scene, Shape, State, draw_still
from glrender.brdf import (
    Akimov,
    Hapke,
    Lambert,
    LommelSeeliger,
    LunarLambert,
    Microfacet,
    Minnaert,
    OrenNayar,
    Rolo,
)
from glrender_camera import BrownConrady

Z_M, HALF_M, PX, FOCAL_PX, FINE = 20.0, 30.0, 64, 48.0, 8
GREY = Lambert(normal_albedo=0.2)
LAMPS = (Lamp(name="a", intensity_W_sr=1e3, r_spacecraft_m=[2.0, -1.0, 1.0], half_angle_deg=20.0,
              direction=[0.1, 0.1, 1.0]), Lamp(name="b", intensity_W_sr=300.0, r_spacecraft_m=[-6.0, 3.0, 0.0]))
STATE = State(r_sun_inertial_m=[0.0, 0.0, 1.5e11], bodies={"p": Pose(r_inertial_m=np.zeros(3))},
              spacecraft=Pose(r_inertial_m=np.zeros(3)))


def plane():
    """A square of two facets before the camera, and the texture coordinates of its corners."""
    uv = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    facets = np.array([[0, 2, 1], [0, 3, 2]])
    vertices = np.concatenate([HALF_M * (2.0 * uv - 1.0), np.full((4, 1), Z_M)], axis=1)
    return Shape.from_arrays(vertices, facets, uv=uv[facets].astype(np.float32))


def scene(law=GREY, lamps=LAMPS, albedo_map=None, **camera):
    pinhole = PinholeCamera(name="c", width_px=PX, height_px=PX, focal_length_px=FOCAL_PX, **camera)
    return Scene(bodies=[Body(name="p", shape=plane(), brdf=law, albedo_map=albedo_map)], cameras=[pinhole],
                 lamps=lamps, solar_irradiance_1au_W_m2=1e-6)


def truth(law=GREY, albedo=None, k1=0.0):
    """Irradiance (H, W) [W/m2] of pixels by FINE x FINE places in each; of a lens that distorts by k1."""
    u = ((np.arange(PX * FINE) + 0.5) / FINE - 0.5 * PX) / FOCAL_PX
    x, y = x0, y0 = np.meshgrid(u, u)
    for _ in range(60):
        scale = 1.0 + k1 * (x * x + y * y)
        x, y = x0 / scale, y0 / scale
    scale = 1.0 + k1 * (x * x + y * y)
    area = (scale * (scale + 2.0 * k1 * (x * x + y * y))).ravel()
    ray = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
    length, place_m, total = np.linalg.norm(ray, axis=1), Z_M * ray, np.zeros(len(ray))
    for lamp in LAMPS:
        to_lamp = lamp.r_spacecraft_m - place_m
        away_m = np.linalg.norm(to_lamp, axis=1)
        to_lamp /= away_m[:, None]
        is_in = -to_lamp @ lamp.direction >= np.cos(np.radians(lamp.half_angle_deg))
        brdf = law.brdf(to_lamp, -ray / length[:, None], np.tile([0.0, 0.0, -1.0], (len(ray), 1)))
        total += brdf * -to_lamp[:, 2] * lamp.intensity_W_sr / away_m**2 * is_in / length**3 / FOCAL_PX**2 / area
    total *= 1.0 if albedo is None else albedo(place_m)
    return total.reshape(PX, FINE, PX, FINE).mean(axis=(1, 3))


def check(image, expected, part=np.s_[:]):
    """RMS within the predicted error and 1 %, flux within a tenth of max_error and 0.2 %; dark elsewhere."""
    found, inside = image.irradiance_W_m2.astype(float), np.zeros_like(expected)
    inside[part] = expected[part]
    assert not found[inside == 0.0].any() and image.plan.predicted_error <= 0.02 and not image.warnings
    rms = np.sqrt(np.mean((found - inside)[inside > 0.0] ** 2)) / inside[inside > 0.0].mean()
    assert rms < image.plan.predicted_error + 0.01
    assert abs(found.sum() / inside.sum() - 1.0) < 0.1 * 0.02 + 0.002


@pytest.mark.parametrize("law", slow_but([
    Akimov(normal_albedo=0.2), GREY, LommelSeeliger(single_scattering_albedo=0.3), OrenNayar(
        normal_albedo=0.2, roughness_deg=20.0), Hapke(single_scattering_albedo=0.4, b=0.3, c=0.5, roughness_deg=15.0),
    LunarLambert(normal_albedo=0.2, weight=(0.5,)), Minnaert(normal_albedo=0.2, exponent=0.7),
    Rolo(surge=(0.02, 0.1), coefficients=(0.07, -6e-4)), Microfacet(base_albedo=0.3, metalness=0.0, roughness=0.5)], 4),
    ids=lambda law: law.glsl)
def test_each_law(law):
    """Also beyond a cone's edge."""
    with Renderer(scene(law)) as renderer:
        check(renderer.render(STATE), truth(law))


def test_a_part_of_the_image_has_the_whole_ones_light():
    expected = truth()
    with Renderer(scene()) as renderer:
        for x0, y0, x1, y1 in ((10, 20, 50, 40), (0, 60, 64, 64)):
            check(draw_still(renderer, STATE, roi=(x0, y0, x1, y1)), expected, np.s_[y0:y1, x0:x1])


def test_a_lens_and_a_texture():
    wave = 2.0 * np.pi * (np.arange(64) + 0.5) / 64
    albedo_map = (0.5 + 0.4 * np.sin(wave)[None, :] * np.cos(wave)[:, None]).astype(np.float32)
    with Renderer(scene(albedo_map=albedo_map)) as renderer:
        check(renderer.render(STATE), truth(albedo=lambda r_m: 0.5 + 0.4 * np.sin(np.pi * (r_m[:, 0] / HALF_M + 1.0))
                                            * np.cos(np.pi * (1.0 - r_m[:, 1] / HALF_M))))
    with Renderer(scene(distortion=BrownConrady(k1=-0.15))) as renderer:
        check(draw_still(renderer, STATE), truth(k1=-0.15))


@pytest.mark.parametrize("half_angle_deg", [0.2, 0.7, 2.0, 3.0])
def test_a_cone_as_narrow_as_pixels_is_warned(half_angle_deg):
    """Where samples miss light, a spot in closed form: at 0.3 px all of it; and the light that they see, without."""
    spot = 0.2 / np.pi * 1e4 / Z_M**2 * np.pi * np.tan(np.radians(half_angle_deg)) ** 2
    lamp = Lamp(name="a", intensity_W_sr=1e4, r_spacecraft_m=[0.05, 0.05, 0.0], half_angle_deg=half_angle_deg)
    with Renderer(scene(lamps=[lamp])) as renderer:
        image = renderer.render(STATE)
    is_warned = "lamp_cone" in [each.code for each in image.warnings]
    assert is_warned == (half_angle_deg < 2.3)
    assert is_warned or abs(image.irradiance_W_m2.sum(dtype=float) / spot - 1.0) < 0.01
