"""Maps of longitudes and latitudes on shapes without texture coordinates. Truth: rays of this test at a sphere."""

from __future__ import annotations

import numpy as np
import pytest
import views
from cells import slow_but
from glrender import Body, ConfigError, Pose, Renderer, Scene, State, frames, generate
from glrender.base.constants import AU_M
from glrender.brdf import Lambert
from PIL import Image

RADIUS_M, RANGE_M = 100.0, 2000.0
MAP = {"kind": "equirectangular", "left_edge_deg": -180.0}


def albedo(longitude, latitude):
    """A grey that differs from place to place, and is one at each pole [rad]."""
    return 0.5 + 0.3 * np.cos(latitude) * np.sin(3.0 * longitude + 1.0) + 0.15 * np.sin(2.0 * latitude)


def chart(left_edge_deg, height=512):
    longitude = np.radians(left_edge_deg + (np.arange(2 * height) + 0.5) * 180.0 / height)
    return albedo(longitude, np.radians(90.0 - (np.arange(height)[:, None] + 0.5) * 180.0 / height))


def looking_from(direction):
    r_camera = RANGE_M * np.asarray(direction, float)
    up = np.array([1.0, 0.0, 0.0]) if abs(direction[2]) > 0.9 else np.array([0.0, 0.0, 1.0])
    aside = np.cross(direction, up)
    return State(r_sun_inertial_m=AU_M * (np.cos(0.5) * np.asarray(direction) + np.sin(0.5) * aside),
                 bodies={"body": Pose(r_inertial_m=np.zeros(3))},
                 spacecraft=Pose(r_inertial_m=r_camera, q_from_inertial=frames.look_at(r_camera, np.zeros(3), up)))


def truth(state, camera, n=4):
    """Irradiance (H, W) of a Lambertian sphere with the albedo, by n x n rays a pixel."""
    at = (np.arange(camera.width_px * n) + 0.5) / n - 0.5
    x, y = np.meshgrid(at, at)
    ray = np.stack([(x - camera.principal_point_px[0]) / camera.focal_length_px,
                    (y - camera.principal_point_px[1]) / camera.focal_length_px, np.ones_like(x)], axis=-1)
    length = np.linalg.norm(ray, axis=-1)
    ray = (ray / length[..., None]) @ frames.dcm(state.spacecraft.q_from_inertial)
    start = state.spacecraft.r_inertial_m
    along = ray @ start
    root = along**2 - start @ start + RADIUS_M**2
    place = start + ray * (-along - np.sqrt(np.maximum(root, 0.0)))[..., None]
    normal = place / RADIUS_M
    sun = state.r_sun_inertial_m / np.linalg.norm(state.r_sun_inertial_m)
    grey = albedo(np.arctan2(normal[..., 1], normal[..., 0]), np.arcsin(np.clip(normal[..., 2], -1.0, 1.0)))
    light = np.where(root > 0.0, 0.4 * grey / np.pi * np.maximum(normal @ sun, 0.0), 0.0)
    light *= views.SOLAR_IRRADIANCE_W_M2 / (length**3 * camera.focal_length_px**2)
    return light.reshape(camera.height_px, n, camera.width_px, n).mean(axis=(1, 3))


@pytest.mark.parametrize("options, left_edge_deg", slow_but([
    ({"max_error": 0.02}, -180.0), ({"samples": 4}, 0.0), ({"engine": "rays"}, -180.0)], 0, 1))
def test_a_map_lies_where_its_longitudes_and_latitudes_are(options, left_edge_deg):
    """At longitude 0, at the seam and at both poles: RMS within the predicted error and 1 %, flux 0.2 %."""
    shape = generate.icosphere(radius_m=RADIUS_M, subdivisions=5)
    body = Body(name="body", shape=shape, brdf=Lambert(normal_albedo=0.4), albedo_map=chart(left_edge_deg),
                albedo_projection={**MAP, "left_edge_deg": left_edge_deg})
    camera = views.camera(96, 800.0)
    with Renderer(views.scene([body], [camera], sun_disc=False)) as renderer:
        for direction in ((1.0, 0, 0), (-1.0, 0, 0), (0, 0, 1.0), (0, 0, -1.0)):
            state = looking_from(direction)
            image, expected = renderer.render(state, **options), truth(state, camera)
            rms = views.relative_rms(image.irradiance_W_m2.astype(float), expected)
            assert rms < image.plan.predicted_error + 0.01, direction
            assert image.irradiance_W_m2.sum(dtype=float) == pytest.approx(expected.sum(), rel=2e-3), direction


def test_corners_have_their_own_longitudes_across_the_seam_and_at_a_pole():
    """Of each facet the corners are within half a turn; each is at its place, but for poles, which have none."""
    shape = generate.icosphere(radius_m=1.0, subdivisions=3)
    body = Body(name="body", shape=shape, brdf=Lambert(normal_albedo=0.4), albedo_map=chart(30.0, 16),
                albedo_projection={**MAP, "left_edge_deg": 30.0})
    uv, place = body.shape.uv.astype(float), shape.vertices_m[shape.facets]
    is_pole = np.hypot(place[..., 0], place[..., 1]) < 1e-9
    off = uv[..., 0] - (np.degrees(np.arctan2(place[..., 1], place[..., 0])) - 30.0) / 360.0
    np.testing.assert_allclose((off - np.round(off))[~is_pole], 0.0, atol=1e-6)
    np.testing.assert_allclose(uv[..., 1], 0.5 + np.arcsin(place[..., 2]) / np.pi, atol=1e-6)
    near = np.abs(place[..., 2]).max(axis=1) < 0.9
    assert np.ptp(uv[near][..., 0], axis=1).max() < 0.1
    poles = np.flatnonzero(is_pole.any(axis=1))
    for facet in poles:
        pole, = np.flatnonzero(is_pole[facet])
        np.testing.assert_allclose(uv[facet, pole, 0], np.delete(uv[facet, :, 0], pole).mean(), atol=1e-6)


def scene_table(folder, **more):
    Image.fromarray((255 * chart(-180.0, 16)).astype(np.uint8)).save(folder / "map.png")
    return {"bodies": [{"name": "body", "generated": {"kind": "icosphere", "radius_m": 1.0}, **more,
                        "albedo_texture": "map.png", "brdf": {"law": "lambert", "normal_albedo": 0.4}}],
            "cameras": [{"name": "navcam", "width_px": 64, "height_px": 64, "focal_length_px": 100.0}]}


def test_a_scene_file_names_the_projection_and_the_refusal_names_the_key(tmp_path):
    made = Scene.from_dict(scene_table(tmp_path, albedo_projection=MAP), shape_dir=tmp_path)
    assert made.bodies[0].shape.uv.shape == (*made.bodies[0].shape.facets.shape, 2)
    for projection, message in (
            (None, r"bodies\[0\].albedo_texture: .*albedo_projection = \{ kind = \"equirectangular\""),
            ({"kind": "mercator"}, "albedo_projection.kind: must be one of 'equirectangular'"),
            ({**MAP, "left_edge_deg": 400.0}, "albedo_projection.left_edge_deg"),
            ({"kind": "equirectangular", "left": 0.0}, "albedo_projection.left: unknown key"),
            ("equirectangular", "albedo_projection")):
        more = {} if projection is None else {"albedo_projection": projection}
        with pytest.raises(ConfigError, match=message):
            Scene.from_dict(scene_table(tmp_path, **more), shape_dir=tmp_path)
    shape, grey = generate.icosphere(radius_m=1.0), Lambert(normal_albedo=0.4)
    with pytest.raises(ConfigError, match="albedo_projection: goes with an albedo map"):
        Body(name="body", shape=shape, brdf=grey, albedo_projection=MAP)
    with pytest.raises(ConfigError, match="albedo_map: .*albedo_projection"):
        Body(name="body", shape=shape, brdf=grey, albedo_map=chart(0.0, 16))
