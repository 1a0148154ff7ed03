"""Motion blur and rolling shutter against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from glrender_camera import ConfigError, time_average


def bar(position_px, shape=(40, 60), width_px=4.0):
    """A vertical bar with exact area coverage, unit irradiance."""
    x = np.arange(shape[1])
    cover = np.clip(np.minimum(x + 0.5, position_px + width_px) - np.maximum(x - 0.5, position_px), 0.0, 1.0)
    return np.tile(cover, (shape[0], 1)).astype(np.float32)


def centroid(rows):
    return (rows * np.arange(rows.shape[1])).sum(axis=1) / rows.sum(axis=1)


def test_a_moving_bar_becomes_a_trapezoid_of_the_same_light():
    """20 px/s for 0.5 s: width 4 + 10 px at the foot, plateau 4 / 10 within 0.01, flux 1e-6."""
    times = np.linspace(0.0, 0.5, 41)
    image = time_average((bar(10.0 + 20.0 * t) for t in times), times, start_s=0.0, exposure_s=0.5)
    np.testing.assert_allclose(image.sum(axis=1), 4.0, rtol=1e-6)
    np.testing.assert_allclose(image[0, 15:20], 0.4, atol=0.01)
    assert not image[:, :10].any() and not image[:, 25:].any()
    np.testing.assert_allclose(centroid(image), 10.0 + 5.0 + 2.0, atol=1e-4)


def test_a_rolling_shutter_leans_what_moves():
    """Row k is seen line_time later: slope of the bar = speed x line time, 1e-3 px a row."""
    times = np.linspace(0.0, 1.0, 81)
    image = time_average((bar(10.0 + 20.0 * t) for t in times), times, start_s=0.0, exposure_s=0.2,
                         line_time_s=0.02)
    expected = 10.0 + 2.0 + 20.0 * (0.1 + 0.02 * np.arange(40))
    np.testing.assert_allclose(centroid(image.astype(np.float64)), expected, atol=1e-3)
    np.testing.assert_allclose(image.sum(axis=1), 4.0, rtol=1e-6)


def test_the_worked_lean_of_a_slewing_camera():
    """1 deg/s, f = 1e4 px, 30 ms from first row to last: 5.24 px (photometry.md section 6), 0.01 px."""
    speed_px_s, rows = np.deg2rad(1.0) * 1e4, 61
    times = np.linspace(0.0, 0.031, 32)
    image = time_average((bar(10.0 + speed_px_s * t, (rows, 60)) for t in times), times, start_s=0.0, exposure_s=1e-3,
                         line_time_s=0.03 / (rows - 1))
    lean = np.ptp(centroid(image.astype(np.float64)))
    np.testing.assert_allclose(lean, 5.236, atol=0.01)


def test_light_linear_in_time_is_averaged_exactly():
    """Uneven samples of 1 + 3 t: each row gets the value at its middle, 1e-6."""
    times = np.array([0.0, 0.1, 0.15, 0.4, 1.0])
    frames = [np.full((5, 3), 1.0 + 3.0 * t, np.float32) for t in times]
    image = time_average(frames, times, start_s=0.05, exposure_s=0.3, line_time_s=0.1)
    np.testing.assert_allclose(image[:, 0], 1.0 + 3.0 * (0.05 + 0.15 + 0.1 * np.arange(5)), rtol=1e-6)


def test_one_sample_stands_still():
    frame = bar(7.3)
    np.testing.assert_array_equal(time_average([frame], [0.0], start_s=0.0, exposure_s=9.0), frame)


@pytest.mark.parametrize("changes, path", [
    (dict(times_s=[0.0, 0.0]), "times_s"), (dict(times_s=[0.0, 0.5]), "times_s"), (dict(times_s=[]), "times_s"),
    (dict(times_s=[0.0, 0.5, 1.0]), "sub_frames"), (dict(exposure_s=0.0), "exposure_s"),
    (dict(start_s=-0.1), "times_s"), (dict(line_time_s=0.1), "times_s"), (dict(start_s=np.nan), "start_s")])
def test_bad_times_are_refused_by_field(changes, path):
    arguments = dict(times_s=[0.0, 1.0], start_s=0.0, exposure_s=1.0) | changes
    with pytest.raises(ConfigError) as error:
        time_average([bar(1.0), bar(2.0)], **arguments)
    assert error.value.path == path


def test_sub_frames_of_different_sizes_are_refused():
    with pytest.raises(ConfigError, match="shape"):
        time_average([bar(1.0), bar(1.0, (3, 3))], [0.0, 1.0], start_s=0.0, exposure_s=1.0)
