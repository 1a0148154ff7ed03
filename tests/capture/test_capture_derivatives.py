"""Derivatives of digital numbers: those of the irradiance through point spread, stray light, exposure and gain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import views
from glrender import Body, Renderer, draw_still, generate, take_frame
from glrender.base.errors import ConfigError
from glrender.brdf import Lambert
from glrender.engines.rays.backend import RayTracer
from glrender_camera import BrownConrady, CameraModel, Detector, Optics, StrayLight

# So many electrons that no noise is left.
QUIET = Detector(quantum_efficiency=1.0, full_well_electrons=1e14, gain_DN_per_electron=1e-9, bit_depth=16)
STATE = views.state()


def camera(size_px=48, detector=QUIET, exposure_s=1e-3, **fields):
    optics = Optics(aperture_diameter_m=1.0, psf_sigma_px=0.8, stray_light=StrayLight(veiling_glare=0.02))
    return views.camera(size_px, 300.0, model=CameraModel(optics=optics, detector=detector, exposure_s=exposure_s),
                        **fields)


def scene(pinhole):
    body = Body(name="body", shape=generate.icosphere(radius_m=100.0, subdivisions=3), brdf=Lambert(normal_albedo=0.3))
    return views.scene([body], [pinhole], sun_disc=False)


def test_digital_numbers_change_as_the_frame_of_a_changed_image_does():
    """The camera exposes an even sky with the derivatives added and taken off; noise and rounding are 1e-6 of it."""
    pinhole = camera()
    with Renderer(scene(pinhole)) as renderer:
        image = renderer.render(STATE, derivatives=["spacecraft", "focal_length"])
        taken = take_frame(renderer, STATE, derivatives=["spacecraft", "focal_length"])
    (x0, y0, x1, y1), found = image.jacobian.roi, taken.jacobian
    assert found.roi == (0, 0, 48, 48) and set(found) == {"spacecraft", "focal_length"}
    for name, values in image.jacobian.items():
        for k in range(len(values)):
            step = 1e-3 / np.abs(values[k]).max()
            frames = []
            for sign in (1.0, -1.0):
                sky = np.full((48, 48), 2e-3, np.float32)
                sky[y0:y1, x0:x1] += np.float32(sign * step) * values[k]
                frames.append(pinhole.expose(sky, 3).electrons.astype(float))
            expected = QUIET.gain_DN_per_electron * (frames[0] - frames[1]) / (2.0 * step)
            np.testing.assert_allclose(found[name][k], expected, atol=3e-5 * np.abs(expected).max())


def test_light_from_beyond_the_frame_changes_it():
    """The part of a wider camera's frame that a narrow one has, through whose edge the body reaches."""
    wide, state = camera(64), views.state(target=(0.0, 0.0, 80.0))
    x, y = wide.principal_point_px
    narrow = replace(camera(40), principal_point_px=(x - 24, y - 8))
    narrow, wide = (replace(each, model=replace(each.model, optics=replace(each.model.optics, stray_light=None)))
                    for each in (narrow, wide))
    found = {}
    for each in (wide, narrow):
        with Renderer(scene(each)) as renderer:
            found[each] = take_frame(renderer, state, derivatives=["sun", "spacecraft"]).jacobian["spacecraft"]
    expected = found[wide][:, 8:48, 24:64]
    assert np.abs(expected[0, :, 0]).max() > 0.1 * np.abs(expected[0]).max()
    # A pixel's own obliquity does not depend on the frame.
    np.testing.assert_allclose(found[narrow][0], expected[0], atol=1e-5 * np.abs(expected[0]).max())


def test_full_pixels_have_no_derivatives():
    detector = replace(QUIET, full_well_electrons=1e4, gain_DN_per_electron=0.1, bit_depth=10)
    with Renderer(scene(camera(detector=detector, exposure_s="auto"))) as renderer:
        taken = take_frame(renderer, STATE, exposure_s=1.0, derivatives="sun")
    assert taken.frame.saturated.any() and not taken.jacobian["sun"][:, taken.frame.saturated].any()


def test_a_still_has_those_of_its_irradiance_also_of_a_part():
    with Renderer(scene(camera())) as renderer:
        whole = draw_still(renderer, STATE, derivatives=["spacecraft"])
        part = draw_still(renderer, STATE, roi=(10, 12, 30, 33), derivatives=["spacecraft"])
        image = renderer.render(STATE, derivatives=["spacecraft"])
        assert draw_still(renderer, STATE).jacobian is None
    np.testing.assert_array_equal(whole.jacobian["spacecraft"], image.jacobian["spacecraft"])
    assert whole.jacobian.roi == image.jacobian.roi
    (x0, y0, x1, y1), (left, top, *_) = part.jacobian.roi, whole.jacobian.roi
    expected = whole.jacobian["spacecraft"][:, y0 - top:y1 - top, x0 - left:x1 - left]
    np.testing.assert_allclose(part.jacobian["spacecraft"][0], expected[0], atol=1e-5 * np.abs(expected[0]).max())


def test_what_no_one_image_makes_is_refused():
    moving = replace(STATE, spacecraft=replace(STATE.spacecraft, v_inertial_m_s=[100.0, 0.0, 0.0]))
    with Renderer(scene(camera())) as renderer:
        with pytest.raises(ConfigError, match="stands still.*leave rates"):
            take_frame(renderer, moving, derivatives=["sun"])
    with Renderer(scene(camera(distortion=BrownConrady(k1=-0.1)))) as renderer:
        with pytest.raises(ConfigError, match="a camera that distorts"):
            take_frame(renderer, STATE, derivatives=["sun"])
    with RayTracer(scene(camera())) as renderer, pytest.raises(ConfigError, match="derivatives: is no option"):
        take_frame(renderer, STATE, derivatives=["sun"])
