"""Stray light against the closed form of its encircled energy; flux, no wrap-around, bad input."""

from __future__ import annotations

import numpy as np
import pytest
from glrender_camera import CameraModel, ConfigError, Detector, Optics, PointSources, StrayLight


def star(shape, row, column):
    image = np.zeros(shape, np.float32)
    image[row, column] = 1.0
    return image


def distances(shape, row, column):
    rows, columns = np.indices(shape)
    return np.hypot(rows - row, columns - column)


@pytest.mark.parametrize("core_px, exponent", [(3.0, 2.5), (12.0, 3.0), (40.0, 2.2), (90.0, 4.0)])
def test_the_wings_encircled_energy(core_px, exponent):
    """1 - (1 + R^2/a^2)^(1 - s/2) at three radii: 2 % of the wing."""
    stray = StrayLight(wing_fraction=0.1, wing_core_px=core_px, wing_exponent=exponent)
    light = stray.add(star((600, 640), 300, 320))
    light[300, 320] -= 0.9
    distance = distances(light.shape, 300, 320)
    for radius in (core_px, 3.0 * core_px, 250.0):
        inside = light[distance <= radius].sum(dtype=np.float64) / 0.1
        expected = 1.0 - (1.0 + (radius / core_px) ** 2) ** (1.0 - exponent / 2.0)
        np.testing.assert_allclose(inside, expected, atol=0.02)


def test_the_wing_keeps_its_flux_on_a_frame_that_holds_it():
    """What the closed form puts beyond circles in and around the frame brackets what is lost."""
    stray = StrayLight(wing_fraction=0.2, wing_core_px=8.0, wing_exponent=3.0)
    lost = 1.0 - stray.add(star((513, 513), 256, 256)).sum(dtype=np.float64)
    beyond = [0.2 * (1.0 + (r / 8.0) ** 2) ** -0.5 for r in (256.5 * np.sqrt(2.0), 256.5)]
    assert beyond[0] < lost < beyond[1]


def test_the_wing_does_not_wrap_around():
    """A corner's star at the opposite corner is what the profile gives there, 5 %, and not more."""
    stray = StrayLight(wing_fraction=0.1, wing_core_px=16.0, wing_exponent=3.0)
    light = stray.add(star((256, 300), 4, 4))
    far = np.s_[-12:, -12:]
    profile = 0.1 / (2.0 * np.pi * 16.0**2) * (1.0 + distances(light.shape, 4, 4) ** 2 / 16.0**2) ** -1.5
    np.testing.assert_allclose(light[far].sum(), profile[far].sum(), rtol=0.05)
    assert (light >= 0.0).all()


def test_the_veil_is_even_and_keeps_the_flux():
    image = np.random.default_rng(1).random((64, 96)).astype(np.float32)
    veiled = StrayLight(veiling_glare=0.03).add(image)
    np.testing.assert_allclose(veiled, 0.97 * image + 0.03 * image.mean(), rtol=1e-5)
    np.testing.assert_allclose(veiled.sum(dtype=np.float64), image.sum(dtype=np.float64), rtol=1e-6)


def test_stray_light_reaches_dark_sky_through_the_whole_chain():
    """A small bright disc: electrons far away are the wing's and the veil's, 3 %, and a region hint changes no byte."""
    stray = StrayLight(wing_fraction=0.02, wing_core_px=20.0, wing_exponent=2.5, veiling_glare=0.01)
    model = CameraModel(optics=Optics(aperture_diameter_m=0.015, psf_sigma_px=0.7, stray_light=stray),
                        detector=Detector(quantum_efficiency=0.5, full_well_electrons=1e6, gain_DN_per_electron=0.01,
                                          bit_depth=16), exposure_s=0.1)
    image = np.where(distances((256, 256), 100, 90) < 6.0, np.float32(2e-8), np.float32(0.0))
    frame = model.expose(image, 1)
    assert frame.dn.tobytes() == model.expose(image, 1, roi=(80, 90, 100, 110)).dn.tobytes()
    per_W_m2 = model.optics.aperture_area_m2 * model.electrons_per_joule * 0.1
    far = distances(image.shape, 100, 90) > 60.0
    profile = 0.02 * 0.25 / (np.pi * 400.0) * (1.0 + distances(image.shape, 100, 90) ** 2 / 400.0) ** -1.25
    expected = (profile[far].sum() + 0.01 * far.mean()) * image.sum() * per_W_m2
    np.testing.assert_allclose(frame.electrons[far].sum(), expected, rtol=0.03)
    assert frame.stages["stray_light"] == "0.02 in a wing of core 20 px, power 2.5, 0.01 as a veil"
    assert model.expose(0.0 * image, 1).stages["stray_light"] == "skipped: no pixel is lit"


@pytest.mark.parametrize("table, path", [
    ({}, "wing_fraction"), (dict(wing_fraction=0.6), "wing_fraction"), (dict(veiling_glare=-0.1), "veiling_glare"),
    (dict(wing_fraction=0.1, wing_exponent=2.0), "wing_exponent"), (dict(wing_fraction=0.1, wing_core_px=0.0),
                                                                    "wing_core_px"),
    (dict(wing_fraction=float("nan")), "wing_fraction"), (dict(ghost=1), "ghost")])
def test_bad_stray_light_is_refused_by_name(table, path):
    with pytest.raises(ConfigError) as error:
        Optics.from_dict({"aperture_diameter_m": 0.01, "stray_light": table})
    assert error.value.path == f"stray_light.{path}"


@pytest.mark.parametrize("row, column", [(-30.0, 60.0), (40.0, 400.0), (-3000.0, -2000.0)])
def test_a_source_beyond_the_image_throws_its_wing_into_it(row, column):
    """The wing's profile at each pixel's centre, 3 %; its own veil evenly."""
    stray = StrayLight(wing_fraction=0.1, wing_core_px=20.0, wing_exponent=2.5)
    light = np.zeros((128, 160), np.float32)
    stray.add_from_beyond(light, [[column, row]], [2.0])
    profile = 0.2 * 0.25 / (np.pi * 400.0) * (1.0 + distances(light.shape, row, column) ** 2 / 400.0) ** -1.25
    np.testing.assert_allclose(light, profile, rtol=0.03)
    veil = StrayLight(veiling_glare_beyond=0.01)
    even = np.zeros((20, 30), np.float32)
    veil.add_from_beyond(even, [[column, row]], [2.0], margin_px=5)
    np.testing.assert_allclose(even, 0.02 / (10 * 20), rtol=1e-6)


def test_a_source_that_leaves_the_image_keeps_its_wing():
    """A star just inside the margin's edge, and just beyond: the wing's profile far from it, 8 % and 1 %."""
    stray = StrayLight(wing_fraction=0.05, wing_core_px=12.0, wing_exponent=2.5)
    model = CameraModel(optics=Optics(aperture_diameter_m=0.015, psf_sigma_px=0.7, stray_light=stray),
                        detector=Detector(quantum_efficiency=0.5, full_well_electrons=1e9, gain_DN_per_electron=1e-4,
                                          bit_depth=16), exposure_s=0.1)
    frames = [model.expose(np.zeros((100, 120), np.float32), 1, margin_px=4, points=PointSources([[x, 40.0]], [1e-4]))
              for x in (114.0, 116.0)]
    per_W_m2 = model.optics.aperture_area_m2 * model.electrons_per_joule * 0.1
    for frame, x, tolerance in zip(frames, (114.0, 116.0), (0.08, 0.01), strict=True):
        profile = 0.05 * 0.25 / (np.pi * 144.0) * (1.0 + distances((92, 112), 40.0, x) ** 2 / 144.0) ** -1.25
        np.testing.assert_allclose(frame.electrons[:, :90].sum(dtype=np.float64),
                                   1e-4 * per_W_m2 * profile[:, :90].sum(), rtol=tolerance)
    assert "0 W/m2 from the frame's own sky, 0.0001 from beyond it" in frames[1].stages["light"]


def test_the_account_of_the_light_tells_what_is_cut_off():
    """What fell on the frame is what came, less the kernel's cut and the wing beyond the frame: 1e-5."""
    optics = Optics(aperture_diameter_m=0.015, f_number=8.0, pixel_pitch_m=5.5e-6, psf_radius_px=7,
                    stray_light=StrayLight(wing_fraction=0.2, wing_core_px=8.0, wing_exponent=3.0))
    model = CameraModel(optics=optics, detector=Detector(quantum_efficiency=0.5, full_well_electrons=1e9,
                                                         gain_DN_per_electron=1e-4, bit_depth=16), exposure_s=0.1)
    image = 1e-6 * star((129, 129), 64, 64)
    text = model.expose(image, 1).stages["light"]
    own, beyond, on_frame = (float(text.split()[i]) for i in (0, 7, 11))
    spread = 1e-6 * (1.0 - optics.psf_energy_cut)
    wing = optics.stray_light.add(star((129, 129), 64, 64)).sum(dtype=np.float64)
    np.testing.assert_allclose([own, beyond], [1e-6, 0.0], rtol=1e-5)
    np.testing.assert_allclose(on_frame, spread * wing, rtol=1e-3)
    assert on_frame < 0.99 * own
    assert model.expose(0.0 * image, 1).stages["light"] == "skipped: it is dark"
