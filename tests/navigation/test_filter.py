"""The filter is consistent: errors over covariance (NEES) and innovations (NIS) are chi-square distributed."""

from __future__ import annotations

import numpy as np
import pytest
from glrender_navigation import Measurement, Navigator
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

STEP_S = 60.0
GM_M3_S2 = 5.0


def fly(seed, n_steps=40, *, noise=1.0, outliers=(), kind="center", is_gated=True):
    """A free orbit with random accelerations: NEES of each step, and the filter."""
    rng = np.random.default_rng(seed)
    r, v = np.array([3000.0, 500.0, -200.0]), np.array([0.0, 0.02, 0.03])
    navigator = Navigator(r + 60.0 * rng.standard_normal(3), v + 0.01 * rng.standard_normal(3), sigma_r_m=60.0,
                          sigma_v_m_s=0.01, gm_m3_s2=GM_M3_S2, process_acceleration_m_s2=2e-6, is_gated=is_gated)
    nees = []
    for step in range(n_steps):
        camera_from_inertial = Rotation.random(random_state=rng).as_matrix()
        place = -camera_from_inertial @ r
        range_m, along = np.linalg.norm(place), place / np.linalg.norm(place)
        across = np.linalg.svd(along[None])[2][1:]
        seen = along + noise * 1e-3 * rng.standard_normal(2) @ across
        if step in outliers:
            seen = along + 0.1 * across[0]
        seen /= np.linalg.norm(seen)
        measured_m = range_m * (1.0 + noise * 0.02 * rng.standard_normal())
        if kind == "center":
            found = Measurement(direction_camera=seen, sigma_rad=1e-3, center_px=(0.0, 0.0), range_m=measured_m,
                                sigma_range=0.02)
        elif kind == "direction":
            found = Measurement(direction_camera=seen, sigma_rad=1e-3, center_px=(0.0, 0.0))
        else:
            covariance = (1e-3 * range_m)**2 * np.eye(3)
            covariance += ((0.02 * range_m)**2 - covariance[0, 0]) * np.outer(along, along)
            found = Measurement(direction_camera=seen, sigma_rad=1e-3, center_px=(0.0, 0.0),
                                r_camera_m=measured_m * seen, covariance_m2=covariance)
        navigator.update(found, camera_from_inertial)
        error = np.concatenate([navigator.r_m - r, navigator.v_m_s - v])
        nees.append(error @ np.linalg.solve(navigator.covariance, error))
        command = 1e-5 * np.array([1.0, -0.5, 0.2])
        navigator.predict(command, STEP_S)
        # The truth in five short steps, with an acceleration of its own that the filter knows by its size.
        actual = command + np.hypot(2e-6, 0.02 * 1e-5) * rng.standard_normal(3)
        for _ in range(5):
            v = v + 0.5 * STEP_S / 5 * (actual - GM_M3_S2 * r / np.linalg.norm(r)**3)
            r = r + STEP_S / 5 * v
            v = v + 0.5 * STEP_S / 5 * (actual - GM_M3_S2 * r / np.linalg.norm(r)**3)
    return np.array(nees), navigator


@pytest.mark.parametrize("kind", ["center", "direction", "place"])
def test_errors_are_those_of_the_covariance(kind):
    """The last NEES of 60 flights, and their mean over all steps; 99.8 % bounds of chi-square."""
    flights = [fly(seed, kind=kind, is_gated=False) for seed in range(60)]
    low, high = chi2.ppf([0.001, 0.999], 6 * len(flights)) / len(flights)
    for step in (0, 10, 39):
        assert low < np.mean([nees[step] for nees, _ in flights]) < high, step
    innovations = [innovation.squared for _, navigator in flights for innovation in navigator.innovations]
    freedom = 2 if kind == "direction" else 3
    low, high = chi2.ppf([0.001, 0.999], freedom * len(innovations)) / len(innovations)
    assert low < np.mean(innovations) < high


def test_the_check_sees_a_filter_that_is_sure_of_too_much():
    """Noise twice what the measurements say: the NEES leaves its bounds."""
    flights = [fly(seed, noise=2.0, is_gated=False) for seed in range(30)]
    assert np.mean([nees[-1] for nees, _ in flights]) > 1.3 * chi2.ppf(0.999, 6 * 30) / 30


def test_outliers_are_refused_and_do_no_harm():
    """Six measurements 100 sigma off: refused, and the errors stay those of the covariance; not so without the gate."""
    nees, navigator = fly(1, outliers=(8, 13, 20, 27, 31, 38))
    refused = [step for step, innovation in enumerate(navigator.innovations) if not innovation.is_accepted]
    assert refused == [8, 13, 20, 27, 31, 38]
    assert nees.max() < chi2.ppf(0.9999, 6)
    nees, navigator = fly(1, outliers=(8, 13, 20, 27, 31, 38), is_gated=False)
    assert all(innovation.is_accepted for innovation in navigator.innovations)
    assert nees[8] > 100.0 * chi2.ppf(0.9999, 6)


def test_a_filter_that_is_sure_and_wrong_finds_back():
    """A first estimate 500 m off with a sigma of 1 m: refused three times, then the estimate is doubted."""
    navigator = Navigator([3500.0, 0.0, 0.0], np.zeros(3), sigma_r_m=1.0, sigma_v_m_s=1e-4)
    found = Measurement(direction_camera=np.array([-1.0, 0.0, 0.0]), sigma_rad=1e-3, center_px=(0.0, 0.0),
                        range_m=3000.0, sigma_range=0.01)
    taken = []
    for _ in range(12):
        taken.append(navigator.update(found, np.eye(3)))
        navigator.predict(np.zeros(3), STEP_S)
    assert not any(taken[:3]) and taken[-1]
    assert abs(navigator.r_m[0] - 3000.0) < 60.0


def test_an_altimeter_tells_that_the_body_is_smaller_than_believed():
    """Ranges by size 1 % too long, of a sigma of 0.1 %: the size's error and the place come out within three sigma."""
    rng, r = np.random.default_rng(2), np.array([3000.0, 0.0, 0.0])
    finds = []
    for sigma_size in (0.02, 0.0):
        navigator = Navigator(r + [40.0, 3.0, -5.0], np.zeros(3), sigma_r_m=50.0, sigma_v_m_s=1e-4,
                              sigma_size=sigma_size, is_gated=False)
        for _ in range(20):
            across = 1e-4 * rng.standard_normal(2)
            seen = np.array([-1.0, *across])
            by_size = 3000.0 * 1.01 * (1.0 + 1e-3 * rng.standard_normal())
            navigator.update(Measurement(direction_camera=seen / np.linalg.norm(seen), sigma_rad=1e-4, range_m=by_size,
                                         sigma_range=1e-3, center_px=(0.0, 0.0)), np.eye(3))
            navigator.update(Measurement(direction_camera=np.array([-1.0, 0.0, 0.0]), sigma_rad=np.inf, range_m=3000.0
                                         + rng.standard_normal(), sigma_range=1.0 / 3000.0, center_px=(0.0, 0.0),
                                         is_by_size=False), np.eye(3))
        error = navigator.r_m - r
        finds.append((error @ np.linalg.solve(navigator.covariance[:3, :3], error), navigator.size_error))
    assert finds[0][0] < chi2.ppf(0.999, 3)
    assert finds[0][1][0] == pytest.approx(0.01, abs=3.0 * finds[0][1][1]) and finds[0][1][1] < 1e-3
    # A filter that takes the size for exact is sure of a wrong place.
    assert finds[1][0] > 10.0 * chi2.ppf(0.999, 3) and finds[1][1] == (0.0, 0.0)


def test_a_cameras_place_in_the_spacecraft_is_taken_off():
    navigator = Navigator([1000.0, 0.0, 0.0], np.zeros(3), sigma_r_m=100.0, sigma_v_m_s=1.0)
    found = Measurement(direction_camera=np.array([-1.0, 0.0, 0.0]), sigma_rad=1e-9, center_px=(0.0, 0.0),
                        range_m=1000.0, sigma_range=1e-9)
    navigator.update(found, np.eye(3), r_camera_inertial_m=[2.0, 0.0, 0.0])
    np.testing.assert_allclose(navigator.r_m, [998.0, 0.0, 0.0], atol=1e-3)
