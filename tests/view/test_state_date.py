"""The date of a state: the scenario's, to the microsecond, through dictionaries, time and what is believed."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from glrender import ConfigError, Pose, State
from glrender.scenario import Belief, scenario_of_table

TABLE = {"cameras": [{"name": "navcam", "width_px": 33, "height_px": 32, "focal_length_px": 150.0}],
         "bodies": [{"name": "moon", "generated": {"kind": "icosphere", "radius_m": 100.0},
                     "brdf": {"law": "lambert", "normal_albedo": 0.1}}],
         "sun": {"r_m": [1.5e11, 0.0, 0.0]}, "trajectory": {"kind": "at_rest", "r_m": [2000.0, 0.0, 500.0]},
         "time": {"times_s": [0.0, 1e-6, 90.25]}}


def state(**more):
    return State(r_sun_inertial_m=[1e11, 0.0, 0.0], bodies={}, **more, spacecraft=Pose(
        r_inertial_m=[0.0, 0.0, 0.0], v_inertial_m_s=[1.0, 0.0, 0.0]))


# TDB is 69.184 s after UTC since 2017, within 2 ms.
@pytest.mark.parametrize("field, dates", [
    ("start_tdb", ("2019-12-31T23:59:00.000000", "2019-12-31T23:59:00.000001", "2020-01-01T00:00:30.250000")),
    ("start_utc", ("2020-01-01T00:00:09.18", "2020-01-01T00:00:09.18", "2020-01-01T00:01:39.43"))])
def test_states_of_a_scenario_have_its_date(field, dates):
    made = scenario_of_table(TABLE | {"time": TABLE["time"] | {field: "2019-12-31T23:59:00"}})
    assert [found.date_tdb[:len(date)] for found, date in zip(made.states(), dates, strict=True)] == list(dates)


def test_without_a_start_there_is_none_and_the_dictionary_has_no_entry():
    for found in scenario_of_table(TABLE).states():
        assert found.date_tdb is None and "date_tdb" not in found.to_dict()


def test_a_date_goes_through_json_and_time():
    made = State.from_dict(json.loads(json.dumps(state(t_s=3.0, date_tdb="2029-02-13T12:00:00.5").to_dict())))
    assert made.date_tdb == "2029-02-13T12:00:00.500000"
    assert made.after(86400.75).date_tdb == "2029-02-14T12:00:01.250000"
    assert made.after(-0.5).date_tdb == "2029-02-13T12:00:00.000000" and state().after(1.0).date_tdb is None
    assert replace(made, t_s=0.0).date_tdb == made.date_tdb
    believed = Belief().state(made, Pose(r_inertial_m=[0.0, 0.0, 1.0]))
    assert (believed.date_tdb, believed.t_s) == (made.date_tdb, 3.0)


@pytest.mark.parametrize("date, dt_s, later", [("1583-01-01T00:00:00", 3600.0, "1583-01-01T01:00:00.000000"),
                                               ("9998-12-31T23:59:59.5", -3600.0, "9998-12-31T22:59:59.500000")])
def test_a_state_of_the_first_and_the_last_year_moves(date, dt_s, later):
    """Where no calendar leads it is refused by its field."""
    made = state(date_tdb=date)
    assert made.after(dt_s).date_tdb == later
    for far in (-1e5 * dt_s, 1e12):
        with pytest.raises(ConfigError, match="^date_tdb: must be of the years 1583 to 9998, got"):
            made.after(far)


@pytest.mark.parametrize("date, rule", [
    ("2029-02-13T12:00:00Z", "must be TDB, without a Z or an offset"),
    ("2029-02-13T12:00:00+01:00", "must be TDB, without a Z or an offset"),
    ("13 Feb 2029", "must be a date"), ("2029-02-30T00:00:00", "must be a date"), (3.0, "must be a date"),
    ("", "must be a date"), ("9999-12-31T23:59:59.9", "must be of the years 1583 to 9998, got '9999"),
    ("0001-01-01T00:00:00", "must be of the years"), ("1582-12-31T23:59:59", "must be of the years")])
def test_what_is_no_date_in_tdb_is_refused(date, rule):
    with pytest.raises(ConfigError, match=f"^state.date_tdb: {rule}"):
        State.from_dict({**state().to_dict(), "date_tdb": date})
