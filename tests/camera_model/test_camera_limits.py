"""Limits of the camera model: what would not end, or would pass in silence, is refused by name."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import MISSING, fields

import numpy as np
import pytest
import views
from glrender import ConfigError, Pose, Scene, State
from glrender.brdf import Lambert
from glrender.capture.motion_path import path_of
from glrender.scene.body import Body
from glrender_camera import AutoExposure, BrownConrady, CameraModel, Detector


def model(optics=(), **detector):
    return CameraModel.from_dict({
        "optics": {"aperture_diameter_m": 0.01, "psf_sigma_px": 0.7, **dict(optics)}, "exposure_s": 0.01,
        "detector": {"quantum_efficiency": 0.5, "full_well_electrons": 1e5, "gain_DN_per_electron": 0.04,
                     "bit_depth": 12, **detector}})


@pytest.mark.parametrize("detector, path", [
    ({"offset_DN": 5000.0}, "offset_DN"), ({"temperature_K": 1e5}, "temperature_K"),
    ({"gain_DN_per_electron": 1e300}, "gain_DN_per_electron"), ({"full_well_electrons": 1e300}, "full_well_electrons"),
])
def test_a_detector_has_ranges(detector, path):
    with pytest.raises(ConfigError, match=path):
        model(**detector)


DETECTOR = {f.name: f.default for f in fields(Detector) if f.default is not MISSING and f.default is not None}
MODEL = {
    "exposure_s": "auto", "auto_exposure": {f.name: f.default for f in fields(AutoExposure)},
    "optics": {
        "aperture_diameter_m": 0.0151, "transmission": 0.8, "band_nm": [600.0, 650.0], "psf_sigma_px": 0.7,
        "f_number": 10.0, "pixel_pitch_m": 10e-6, "central_obscuration": 0.1, "psf_radius_px": 5,
        "aberrations": {"defocus_nm": 30.0, "spherical_nm": 1.0, "zernike_nm": [[6, 20.0]], "coma_nm": 60.0,
                        "tangential_nm": 120.0, "sagittal_nm": -40.0, "aspect": 1.0, "grid": [3, 3]},
        "stray_light": {"wing_fraction": 0.01, "wing_core_px": 20.0, "wing_exponent": 2.5, "veiling_glare": 0.002,
                        "veiling_glare_beyond": 1e-6, "baffle_deg": 40.0}},
    "detector": {"quantum_efficiency": 0.5, "full_well_electrons": 1e5, "gain_DN_per_electron": 0.04,
                 "bit_depth": 12, **DETECTOR}}
TABLES = {"distortion": {f.name: 1e-4 for f in fields(BrownConrady)}, "model": MODEL}
# What one number cannot be blamed for alone: the field of view, the rule of two fields.
SHARED = {"distortion": "distortion", "pixel_pitch_m": "f_number"}


def places(table, path=()):
    for key, value in table.items():
        yield (*path, key)
        if isinstance(value, dict):
            yield from places(value, (*path, key))


def loaded(path=None, value=None):
    """The scene with one value replaced."""
    tables = deepcopy(TABLES)
    if path:
        table = tables
        for key in path[:-1]:
            table = table[key]
        table[path[-1]] = value
    return Scene.from_dict({
        "bodies": [{"name": "moonlet", "generated": {"kind": "icosphere", "radius_m": 50.0, "subdivisions": 0},
                    "brdf": {"law": "lambert", "normal_albedo": 0.2}}],
        "cameras": [{"name": "wide", "width_px": 16, "height_px": 16, "focal_length_px": 120.0, **tables}]})


@pytest.mark.parametrize("path", [*places(TABLES)], ids=".".join)
def test_every_documented_field_refuses_what_is_wrong_by_name(path):
    """NaN, infinity, 1e300, -1e300, text, truth, an empty list's list: the path of the field in the message."""
    assert loaded().cameras[0].model is not None
    for value in (float("nan"), float("inf"), 1e300, -1e300, "no", True, [[]], [1.0, "x"]):
        with pytest.raises(ConfigError) as told:
            loaded(path, value)
        named = {path[-1], SHARED.get(path[-1]), SHARED.get(path[0])} - {None}
        assert any(name in str(told.value).split(": ")[0] for name in named), (path, value, str(told.value))


@pytest.mark.parametrize("shape", [(1, 1), (1, 4), (4, 1), (3, 5)])
@pytest.mark.parametrize("bit_depth", [2, 8, 12, 16])
def test_numbers_end_at_the_largest(shape, bit_depth):
    detector = Detector(quantum_efficiency=0.5, full_well_electrons=1e6, gain_DN_per_electron=1.0, bit_depth=bit_depth)
    dn, _, saturated = detector.read(np.full(shape, 1e5, np.float32), 1.0, 1)
    assert (dn == 2**bit_depth - 1).all() and saturated.all()


def test_an_aperture_has_a_range():
    with pytest.raises(ConfigError, match="aperture_diameter_m"):
        model(optics={"aperture_diameter_m": 1e300})


@pytest.mark.parametrize("exposure_s", [1e7, 1e30])
def test_an_exposure_has_a_range(exposure_s):
    with pytest.raises(ConfigError, match="exposure_s"):
        model().expose(np.zeros((8, 8), np.float32), exposure_s=exposure_s)


def test_so_many_cosmic_rays_are_refused_at_once():
    """A million seconds at 1e-3 hits would take minutes, and a server with it."""
    with pytest.raises(ConfigError, match="cosmic-ray hits"):
        model(cosmic_ray_hits_per_px_s=1e-3).expose(np.zeros((96, 128), np.float32), exposure_s=1e6)
    frame = model(cosmic_ray_hits_per_px_s=1e-3).expose(np.zeros((96, 128), np.float32), exposure_s=10.0)
    assert frame.electrons.max() > 100.0


def test_what_is_beside_the_region_is_dark_whatever_it_holds():
    irradiance = np.full((64, 64), 1e-6, np.float32)
    irradiance[19, 19] = np.nan
    inside = np.zeros_like(irradiance)
    inside[20:40, 20:40] = 1e-6
    frame = model().expose(irradiance, 3, roi=(20, 20, 40, 40))
    np.testing.assert_array_equal(frame.electrons, model().expose(inside, 3).electrons)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -1.0])
def test_relative_illumination_is_checked(bad):
    irradiance, falloff = np.full((16, 16), 1e-6, np.float32), np.ones((16, 16))
    falloff[3, 4] = bad
    with pytest.raises(ConfigError, match="relative_illumination"):
        model().expose(irradiance, relative_illumination=falloff)


def test_a_veil_does_not_depend_on_the_margin():
    """The same frame, with darkness drawn beside it and without: a corner's mean is the same."""
    camera = model(optics={"stray_light": {"veiling_glare": 0.05}})
    frame = np.zeros((64, 64), np.float32)
    frame[24:40, 24:40] = 1e-5
    corner = [camera.expose(np.pad(frame, margin), 1, margin_px=margin).electrons[:16, :16].mean()
              for margin in (0, 15)]
    assert corner[0] > 100.0
    np.testing.assert_allclose(corner[1], corner[0], rtol=0.01)


@pytest.mark.parametrize("turns, least", [(0.5, 60.0), (1.0, 200.0), (2.0, 400.0), (4.0, 800.0), (150.0, 1e4)])
def test_whole_turns_move(turns, least):
    """A body that spins about the boresight: its rim goes round, however many whole turns end where they began."""
    body = Body(name="body", shape=views.binary(1, 3), brdf=Lambert(
        normal_albedo=0.2))
    camera = views.camera(256, 1000.0)
    scene = views.scene([body], [camera])
    state = State(r_sun_inertial_m=[1.5e11, 0.0, -1.5e11], spacecraft=Pose(r_inertial_m=[0.0, 0.0, -2000.0]),
                  bodies={"body": Pose(r_inertial_m=np.zeros(3),
                                       angular_velocity_rad_s=[0.0, 0.0, 2.0 * np.pi * turns])})
    # A chord for each piece of arc: within 3 % of a circle of 45 px or more.
    assert path_of(scene, state, camera, 0.5).length_px > least
