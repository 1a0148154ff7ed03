"""A frame against the predicted one: its chi-square's own slopes, steps that find a state, and the bound of noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import views
from glrender import Body, Renderer, compare_frame, generate, take_frame
from glrender.base.errors import ConfigError
from glrender.brdf import Lambert
from glrender.view.state import Pose
from glrender_camera import CameraModel, Detector, Optics
from moved_states import moved as moved_both
from scipy.ndimage import gaussian_filter

# Read-out noise is nearly all: weights stay as they are where the state moves.
READ = Detector(quantum_efficiency=0.6, full_well_electrons=5e4, gain_DN_per_electron=0.08, bit_depth=12,
                offset_DN=60.0, read_noise_electrons=3000.0, dark_current_electrons_per_s=50.0)
NOISY = replace(READ, read_noise_electrons=20.0)
BODY = Body(name="body", brdf=Lambert(normal_albedo=0.3), shape=generate.icosphere(radius_m=100.0, subdivisions=3))
STATE = views.state(phase_deg=60.0, range_m=2000.0)


def moved(state, name, k, step):
    return moved_both(state, camera(), name, k, step)[0]


def camera(detector=NOISY, size_px=40):
    return views.camera(size_px, 250.0, model=CameraModel(
        optics=Optics(aperture_diameter_m=0.02, psf_sigma_px=0.8, transmission=7e-6), detector=detector,
        exposure_s=0.004))


@pytest.fixture(scope="module")
def renderer():
    with Renderer(views.scene([BODY], [camera()], sun_disc=False, max_error=0.005)) as renderer:
        yield renderer


def mean_frame(renderer, state, factor=1.0, level=0.0):
    """Numbers that are no whole ones: many frames' mean."""
    detector = renderer.scene.cameras[0].model.detector
    quiet = replace(detector, full_well_electrons=1e14, gain_DN_per_electron=1e-9, bit_depth=16,
                    dark_current_electrons_per_s=0.0, read_noise_electrons=0.0, offset_DN=0.0)
    pinhole = camera(quiet)
    light = pinhole.expose(renderer.render(state).irradiance_W_m2 * np.float32(1e8), 1).electrons.astype(float) * 1e-8
    dark = detector.dark_current_electrons_per_s * 0.004
    return 60.0 + level + 0.08 * (factor * light + dark)


def test_the_vector_is_the_slope_of_chi_square():
    with Renderer(views.scene([BODY], [camera(READ)], sun_disc=False, max_error=0.005)) as renderer:
        frame = mean_frame(renderer, moved(STATE, "spacecraft", 0, 3.0))
        ask = lambda state: compare_frame(renderer, state, frame_DN=frame, unknown=())  # noqa: E731
        here = ask(STATE)
        assert here.names == tuple(f"spacecraft[{k}]" for k in range(6))
        assert here.units == ("m", "m", "m", "rad", "rad", "rad") and (here.gain, here.offset_DN) == (1.0, 0.0)
        for k, step in ((0, 0.5), (1, 0.5), (2, 10.0), (4, 2.5e-4)):
            ends = [ask(moved(STATE, "spacecraft", k, sign * step)).chi2 for sign in (1.0, -1.0)]
            slope = -(ends[0] - ends[1]) / (4.0 * step)
            scale = np.sqrt(here.chi2 * here.matrix[k, k])
            assert abs(here.vector[k] - slope) < 0.01 * scale, (k, here.vector[k], slope, scale)


def test_steps_find_the_state_the_gain_and_the_level(renderer):
    frame, state = mean_frame(renderer, moved(STATE, "spacecraft", 0, 6.0), factor=1.3, level=7.0), STATE
    for _ in range(4):
        found = compare_frame(renderer, state, frame_DN=frame)
        keep = [0, 1, 2, 6, 7]
        step = np.linalg.solve(found.matrix[np.ix_(keep, keep)], found.vector[keep])
        for k in range(3):
            state = moved(state, "spacecraft", k, step[k])
    assert found.names[6:] == ("gain", "offset") and found.units[6:] == ("1", "DN")
    np.testing.assert_allclose([found.gain, found.offset_DN], [1.3, 7.0], rtol=1e-3)
    expected = moved(STATE, "spacecraft", 0, 6.0).spacecraft.r_inertial_m
    np.testing.assert_allclose(state.spacecraft.r_inertial_m, expected, atol=0.05)
    assert found.chi2 / found.n_pixels < 1e-3


def test_it_knows_as_much_as_the_information_and_fits_as_well_as_noise_lets(renderer):
    frame = take_frame(renderer, STATE, seed=5, derivatives=["sun"]).frame.dn  # drawn as what it is compared with
    found = compare_frame(renderer, STATE, frame_DN=frame, derivatives=["spacecraft", "law.normal_albedo"],
                          unknown=["offset"])
    known = renderer.render(STATE, derivatives=["spacecraft", "law.normal_albedo"]).information(unknown=("offset",))
    k = len(found.names) - 1
    left = found.matrix[:k, :k] - np.outer(found.matrix[:k, k], found.matrix[k, :k]) / found.matrix[k, k]
    scale = np.sqrt(np.diag(known.matrix))
    np.testing.assert_allclose(left / np.outer(scale, scale), known.matrix / np.outer(scale, scale), atol=2e-3)
    assert abs(found.chi2 / found.n_pixels - 1.0) < 4.0 * np.sqrt(2.0 / found.n_pixels)
    assert found.n_pixels == 40 * 40


def test_a_part_of_the_frame_is_compared_as_the_whole_is_there(renderer):
    frame, (x0, y0, x1, y1) = take_frame(renderer, STATE, seed=5).frame.dn, (5, 8, 31, 38)
    part = compare_frame(renderer, STATE, frame_DN=frame[y0:y1, x0:x1], roi=(x0, y0, x1, y1), unknown=())
    full = frame.copy()
    full[:y0], full[y1:], full[:, :x0], full[:, x1:] = 4095, 4095, 4095, 4095
    whole = compare_frame(renderer, STATE, frame_DN=full, unknown=())
    assert part.n_pixels == whole.n_pixels == (x1 - x0) * (y1 - y0)  # full pixels do not count
    masked = np.ma.masked_array(frame.astype(float), mask=np.ones((40, 40), bool))
    masked.mask[y0:y1, x0:x1] = False
    masked.data[masked.mask] = np.nan
    hidden = compare_frame(renderer, STATE, frame_DN=masked, unknown=())
    for other in (whole, hidden):
        np.testing.assert_allclose(part.matrix, other.matrix, rtol=1e-12)
        np.testing.assert_allclose(part.chi2, other.chi2, rtol=1e-12)
    assert hidden.n_pixels == part.n_pixels


def test_pixels_that_no_model_explains_pull_less_where_it_is_robust(renderer):
    frame = take_frame(renderer, STATE, seed=5).frame.dn.astype(float)
    frame[12:16, 20:24] += 800.0
    steps = []
    for is_robust in (False, True):
        found = compare_frame(renderer, STATE, frame_DN=frame, is_robust=is_robust)
        keep = [0, 1, 2, 6, 7]
        inverse = np.linalg.inv(found.matrix[np.ix_(keep, keep)])
        steps.append(np.hypot(*(inverse @ found.vector[keep])[:2]))
    assert steps[1] < 0.2 * steps[0]


def test_blurred_pixels_weigh_alike(renderer):
    """The derivatives of the digital numbers, blurred by SciPy."""
    taken = take_frame(renderer, STATE, seed=5, derivatives=["spacecraft"])
    found = compare_frame(renderer, STATE, frame_DN=taken.frame.dn, blur_px=2.0, unknown=())
    blurred = [gaussian_filter(each.astype(float), 2.0, mode="mirror").ravel() for each in taken.jacobian["spacecraft"]]
    expected = np.array(blurred) @ np.array(blurred).T
    scale = np.sqrt(np.diag(expected))
    matrix = found.matrix * (expected[0, 0] / found.matrix[0, 0])
    np.testing.assert_allclose(matrix / np.outer(scale, scale), expected / np.outer(scale, scale), atol=2e-3)


def test_in_the_dark_nothing_is_known(renderer):
    away = moved(STATE, "spacecraft", 3, 2.0)
    found = compare_frame(renderer, away, frame_DN=take_frame(renderer, STATE).frame.dn)
    assert not found.matrix[:7].any() and found.gain == 1.0 and found.warnings


def test_wells_that_are_full_below_the_largest_number_do_not_count(renderer):
    """Their noise, which is read after them, puts half below the level: the gain is that of the other pixels."""
    frame = take_frame(renderer, STATE, seed=5, exposure_s=0.2, derivatives=["sun"]).frame.dn
    assert (frame > 4050).sum() > 300 and frame.max() < 4095
    found = compare_frame(renderer, STATE, frame_DN=frame, exposure_s=0.2)
    assert found.n_pixels <= 1600 - (frame > 4050).sum()
    assert abs(found.gain - 1.0) < 0.01 and found.chi2 / found.n_pixels < 2.0, (found.gain, found.chi2)


@pytest.mark.parametrize("fields", [
    {"dark_current_nonuniformity": 0.2, "dark_current_electrons_per_s": 1e4},
    {"nonlinearity_DN": ((0.0, 0.0), (2000.0, 2000.0), (4095.0, 3500.4))},
    {"nonlinearity_DN": ((0.0, 0.0), (1000.0, 1100.0), (6000.0, 5500.0)), "photo_response_nonuniformity": 0.01}])
def test_at_50_times_the_exposure_residuals_are_of_the_noise_that_is_predicted(fields):
    """Also of dark currents that differ from pixel to pixel, and of a bent characteristic."""
    with Renderer(views.scene([BODY], [camera(replace(NOISY, **fields))], sun_disc=False, max_error=0.005)) as renderer:
        frame = take_frame(renderer, STATE, seed=5, exposure_s=0.2, derivatives=["sun"]).frame
        found = compare_frame(renderer, STATE, frame_DN=frame.dn, exposure_s=0.2)
    assert np.count_nonzero(frame.saturated) > 300
    assert abs(found.chi2 / found.n_pixels - 1.0) < 4.0 * np.sqrt(2.0 / found.n_pixels), found.chi2 / found.n_pixels
    assert abs(found.gain - 1.0) < 0.005 and not [each for each in found.warnings if each.code == "bad_pixels"]


@pytest.mark.parametrize("fields", [{"dead_pixel_fraction": 0.01}, {"cosmic_ray_hits_per_px_s": 0.01},
                                    {"hot_pixel_fraction": 0.01, "hot_pixel_electrons_per_s": 1e4}])
def test_pixels_that_no_prediction_has_are_warned_of_or_weigh_little(fields):
    with Renderer(views.scene([BODY], [camera(replace(NOISY, **fields))], sun_disc=False, max_error=0.005)) as renderer:
        frame = take_frame(renderer, STATE, seed=5, exposure_s=0.2, derivatives=["sun"]).frame.dn
        plain, robust = (compare_frame(renderer, STATE, frame_DN=frame, exposure_s=0.2, is_robust=each)
                         for each in (False, True))
    assert plain.chi2 / plain.n_pixels > 10.0 and robust.chi2 < 0.2 * plain.chi2
    assert abs(robust.gain - 1.0) < 0.005
    assert [[each.path for each in found.warnings if each.code == "bad_pixels"] for found in (plain, robust)] == [
        ["is_robust"], []]


@pytest.mark.parametrize("blur_px", [0.0, 3.0])
def test_a_frame_without_the_bodys_light_or_with_none_that_counts(renderer, blur_px):
    """Even numbers: a level explains all but the predicted light; full ones do not count."""
    even = compare_frame(renderer, STATE, frame_DN=np.full((40, 40), 75.0), blur_px=blur_px)
    assert even.gain > 0.0 and np.isfinite(even.chi2) and np.isfinite(even.matrix).all()
    full = compare_frame(renderer, STATE, frame_DN=np.full((40, 40), 4095, np.uint16), blur_px=blur_px, is_robust=True)
    assert full.n_pixels == 0 and full.chi2 == 0.0 and not full.matrix.any()


def test_lit_pixels_that_do_not_count_are_warned_of(renderer):
    frame = np.rint(mean_frame(renderer, STATE)).astype(np.uint16)
    text = lambda given, **more: [each.message for each in compare_frame(  # noqa: E731
        renderer, STATE, frame_DN=given, **more).warnings if each.code == "lost_pixels"]
    assert not text(frame)
    assert "nothing is known" in text(np.ma.array(frame, mask=True))[0]
    far = take_frame(renderer, moved(STATE, "spacecraft", 0, 40.0), seed=5, exposure_s=0.4, derivatives=["sun"]).frame
    assert "a wrong gain" in text(far.dn, exposure_s=0.4)[0]


@pytest.mark.parametrize(("options", "path", "text"), [
    ({"frame_DN": np.zeros((40, 39))}, "compare", r"shape \(40, 40\).*roi"),
    ({"frame_DN": np.zeros((40, 40), np.int64)}, "compare", "uint16.*int64"),
    ({"frame_DN": np.full((40, 40), np.nan)}, "compare", "finite.*1600 pixels.*mask lost pixels"),
    ({"derivatives": ["spacecaft"]}, "derivatives[0]", "spacecraft"),
    ({"unknown": ["gian"]}, "unknown[0]", "gain"),
    ({"unknown": ["gain", "gain"]}, "unknown[1]", "once"),
    ({"derivatives": []}, "derivatives", "one parameter"),
    ({"frame_DN": np.full((40, 40), -1e300)}, "compare", "within 1e[+]09 DN.*1600 pixels"),
    ({"blur_px": -1.0}, "blur_px", "between 0 and 64"), ({"is_robust": "no"}, "is_robust", "true or false"),
    ({"roi": (0, 0, 50, 40)}, "roi[2]", "40"),
    ({"exposure_s": "auto", "unknown": ()}, "exposure_s", "gain"),
    ({"engine": "rays"}, "engine", "coverage")])
def test_a_wrong_request_is_refused_by_its_field(renderer, options, path, text):
    with pytest.raises(ConfigError, match=text) as caught:
        compare_frame(renderer, STATE, **{"frame_DN": np.zeros((40, 40), np.uint16), **options})
    assert caught.value.path == path


def test_a_state_that_moves_is_refused(renderer):
    craft = STATE.spacecraft
    moving = replace(STATE, spacecraft=Pose(r_inertial_m=craft.r_inertial_m, q_from_inertial=craft.q_from_inertial,
                                            v_inertial_m_s=[1.0, 0.0, 0.0]))
    with pytest.raises(ConfigError, match="stands still"):
        compare_frame(renderer, moving, frame_DN=np.zeros((40, 40), np.uint16))


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_lost_pixels_are_no_light(renderer, share):
    """Pixels that are masked, or beyond the camera's numbers, leave all others in the fit."""
    frame = np.rint(mean_frame(renderer, STATE, factor=0.9)).astype(np.uint16)
    is_lost = np.random.default_rng(2).random(frame.shape) < share
    for given in (np.ma.array(frame, mask=is_lost), np.where(is_lost, np.uint16(65535), frame)):
        fit = compare_frame(renderer, STATE, frame_DN=given)
        assert fit.n_pixels == np.count_nonzero(~is_lost) and fit.gain == pytest.approx(0.9, rel=2e-3)
