"""Epochs with their scales, and samplers."""

from __future__ import annotations

import datetime

import numpy as np
import pytest
from glrender import ConfigError
from glrender.scenario import Epoch, EqualTurns, Exponential, FixedRate, Linear, Times
from glrender.scenario.samplers import equal_turns
from missing import needed_module

UTC = ["2016-12-31T23:59:60.5", "2016-12-31T23:59:59", "2017-01-01T00:00:00", "1972-01-01", "2029-02-13T12:34:56.789",
       "1998-12-31T23:59:60", "2014-08-05T20:07:19.02"]


@pytest.mark.parametrize("text", UTC)
def test_utc_is_spices(shared, text):
    """To 1e-6 s by the leap seconds and the TDB - TT of NAIF's naif0012.tls."""
    spice = needed_module("spiceypy", "pip install -e '.[test]'")
    spice.furnsh(str(shared / "kernels" / "naif0012.tls"))
    epoch = Epoch.from_utc(text)
    np.testing.assert_allclose(epoch.et_s, spice.str2et(text), atol=1e-6)
    assert epoch.utc == spice.et2utc(spice.str2et(text), "ISOC", 6)


def test_scales_differ_as_defined():
    """TT - TAI = 32.184 s; TAI - UTC = 37 s since 2017; TDB - TT within 1.7 ms."""
    tdb, tt, tai, utc = (Epoch.from_scale("2022-10-11T00:00:00", scale) for scale in ("TDB", "TT", "TAI", "UTC"))
    assert abs(tt - tdb) < 1.7e-3
    np.testing.assert_allclose([tai - tt, utc - tai], [32.184, 37.0], atol=1e-8)


def test_j2000_is_zero_and_a_date_is_kept():
    assert Epoch.from_tdb("2000-01-01T12:00:00") == Epoch(0)
    epoch = Epoch.from_tdb("2029-02-13T12:34:56.789")
    assert epoch.tdb == "2029-02-13T12:34:56.789000" and Epoch.from_tdb(epoch.tdb) - epoch == pytest.approx(0, abs=1e-9)
    assert Epoch.from_tdb(datetime.datetime(2029, 2, 13, 12)) == Epoch.from_tdb("2029-02-13T12:00:00")
    assert Epoch.of_field({"date_et_s": 12.25}, "date") == Epoch(12, 0.25)


def test_a_difference_keeps_its_digits():
    """A century on, 1 ns is still 1 ns."""
    epoch = Epoch.from_tdb("2099-01-01T00:00:00")
    np.testing.assert_allclose(epoch.after(1e-9) - epoch, 1e-9, rtol=1e-6)


@pytest.mark.parametrize("fields, message", [
    ({"date": "2029-02-13"}, "date: has no time scale, got '2029-02-13'; write date_tdb, date_utc or date_et_s"),
    ({"date_tdb": "2029-02-13T12:00:00Z"}, "date_tdb: must be TDB, without a Z"),
    ({"date_tdb": "13.2.2029"}, "date_tdb: must be a date year-month-dayThour:minute:second"),
    ({"date_tdb": "2029-02-30T00:00:00"}, "date_tdb: is no date: day is out of range for month"),
    ({"date_tdb": "2016-12-31T23:59:60"}, "date_tdb: must have seconds below 60"),
    ({"date_utc": "2015-12-31T23:59:60"}, "date_utc: has a leap second that there was not"),
    ({"date_utc": "1971-12-31"}, "date_utc: must not be before 1972"),
    ({"date_et_s": float("nan")}, "date_et_s: must be a finite number"),
    ({"date_tdb": "2029-02-13", "date_utc": "2029-02-13"}, "date_utc: is given as well as date_tdb"),
    ({"date_utc": datetime.datetime(2029, 1, 1, tzinfo=datetime.timezone(datetime.timedelta(hours=2)))},
     "date_utc: must have no offset from UTC"),
])
def test_a_time_without_a_scale_or_a_date_is_refused(fields, message):
    with pytest.raises(ConfigError) as caught:
        Epoch.of_field(fields, "date")
    assert message in str(caught.value)


def test_linear_ends_and_middle():
    np.testing.assert_array_equal(Linear(duration_s=600.0, frames=601).t_s(), np.arange(601.0))
    assert Linear(duration_s=600.0, frames=1).t_s() == [300.0]


@pytest.mark.parametrize("frames", [25, 26])
def test_exponential_steps_are_as_asked(frames):
    """The step at the ends over that in the middle tends to cosh(s); times are symmetric about the middle."""
    t = Exponential(duration_s=600.0, frames=frames, slow_motion=3.0).t_s()
    np.testing.assert_allclose(t + t[::-1], 600.0, atol=1e-12)
    many = np.diff(Exponential(duration_s=600.0, frames=100_001, slow_motion=3.0).t_s())
    np.testing.assert_allclose(many[0] / many[50_000], np.cosh(3.0), rtol=1e-4)
    x = np.linspace(-1.0, 1.0, frames)
    np.testing.assert_allclose(t, 300.0 * (1.0 + np.sinh(3.0 * x) / np.sinh(3.0)), atol=1e-12)


def test_equal_turns_are_equal():
    """Angles of the line of sight to a body that is passed straight."""
    t = EqualTurns(duration_s=600.0, frames=25, distance_m=2e5, relative_velocity_m_s=1e4).t_s()
    turns = np.diff(np.arctan2(1e4 * (t - 300.0), 2e5))
    np.testing.assert_allclose(turns, turns[0], rtol=1e-12)
    np.testing.assert_allclose(t[[0, 12, -1]], [0.0, 300.0, 600.0], atol=1e-10)


@pytest.mark.parametrize("distance_m", [2e5, 20.0, 1e-3])
def test_equal_turns_of_any_trajectory(distance_m):
    """To a thousandth of the angle between frames, on straight passes as short as 1e-7 s of 600 s, and on a circle."""
    t = equal_turns(lambda t: np.stack([1e4 * (t - 300.0), np.full_like(t, distance_m), 0.0 * t], axis=1),
                    duration_s=600.0, frames=25).t_s()
    turns = np.diff(np.arctan2(1e4 * (t - 300.0), distance_m))
    np.testing.assert_allclose(turns, turns.mean(), rtol=1e-3)
    circle = equal_turns(lambda t: np.stack([np.cos(t), np.sin(t), 0.0 * t], axis=1), duration_s=60.0, frames=7)
    np.testing.assert_allclose(circle.t_s(), np.arange(0.0, 61.0, 10.0), atol=1e-6)
    with pytest.raises(ConfigError, match="sampler: needs a line of sight that turns"):
        equal_turns(lambda t: np.tile([1.0, 0.0, 0.0], (len(t), 1)), duration_s=60.0, frames=7)


def test_rates_and_lists():
    np.testing.assert_allclose(FixedRate(duration_s=0.3, rate_hz=10.0).t_s(), [0.0, 0.1, 0.2, 0.3], atol=1e-15)
    start = Epoch.from_tdb("2029-01-01")
    np.testing.assert_allclose(Times.of_epochs([start, start.after(2.5)], start).t_s(), [0.0, 2.5])


@pytest.mark.parametrize("make, message", [
    (lambda: Linear(duration_s=600.0, frames=0), "frames: must be an integer between 1 and"),
    (lambda: Linear(duration_s=float("nan"), frames=3), "duration_s: must be a finite number"),
    (lambda: Exponential(duration_s=1.0, frames=3, slow_motion=0.0), "slow_motion: must be > 0"),
    (lambda: Times(times_s=[]), "times_s: must be a list of times within 1e+11 s that is not empty"),
    (lambda: Times(times_s=[0.0, 2.0, 1.0]), "times_s[2]: must be later than the one before"),
    (lambda: FixedRate(duration_s=1e9, rate_hz=1e9), "rate_hz: times duration_s must be below"),
])
def test_an_empty_or_endless_sequence_is_refused(make, message):
    with pytest.raises(ConfigError) as caught:
        make()
    assert message in str(caught.value)
