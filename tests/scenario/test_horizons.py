"""Vector tables of Horizons: all layouts are the orbit that they were written of, and others are refused by name."""

from __future__ import annotations

import _strptime
import calendar

import numpy as np
import orbits
import pytest
from glrender import ConfigError
from glrender.base.constants import AU_M
from glrender.scenario import scenario_of_table, trajectory_of_horizons
from glrender.scenario.kepler import EQUATORIAL_FROM_ECLIPTIC
from orbits import DATE
from scipy.spatial.transform import Rotation

HEAD = """API VERSION: 1.2
API SOURCE: NASA/JPL Horizons API
*******************************************************************************
JPL/HORIZONS                   65803 Didymos (1996 GT)     2024-Mar-01 12:00:00
Rec #:   65803 (+COV) Soln.date: 2023-Aug-22
*******************************************************************************
Ephemeris / API_USER Fri Mar  1 12:00:00 2024 Pasadena, USA      / Horizons
*******************************************************************************
Target body name: {target}   {{source: HERA_v01}}
Center body name: {center}       {{source: DE441}}
Center-site name: BODY CENTER
*******************************************************************************
Start time      : A.D. 2022-Oct-11 00:00:00.0000 TDB
Output units    : {units}
Output type     : GEOMETRIC cartesian states
Output format   : 3 (position, velocity, LT, range, range-rate)
Reference frame : {frame}
*******************************************************************************
"""
LINES = "JDTDB\n   X     Y     Z\n   VX    VY    VZ\n   LT    RG    RR\n" + "*" * 79 + "\n$$SOE\n"
COMMAS = ("            JDTDB,            Calendar Date (TDB),                      X,                      Y,"
          "                      Z,                     VX,                     VY,                     VZ,\n"
          + "*" * 99 + "\n$$SOE\n")
MONTHS = "Jan Feb Mar Apr May Jun Jul Aug Sep Oct Nov Dec".split()


def date(epoch):
    text = epoch.tdb
    return f"A.D. {text[:4]}-{MONTHS[int(text[5:7]) - 1]}-{text[8:10]} {text[11:24]}"


def table(folder, layout="labels", units="KM-S", frame="ICRF", target="Hera (spacecraft) (-91)", center="Didymos",
          more="", count=13):
    """A small orbit, rows every five minutes, in the frame and the units of the table."""
    times = 300.0 * np.arange(count)
    r, v = orbits.small_orbit().at(DATE, times)
    turn = np.eye(3) if frame.startswith("ICRF") and "Ecliptic" not in more else EQUATORIAL_FROM_ECLIPTIC.T
    length, speed = {"KM-S": (1e3, 1e3), "AU-D": (AU_M, AU_M / 86400.0), "KM-D": (1e3, 1e3 / 86400.0)}[units]
    rows = []
    for t, place, velocity in zip(times, r @ turn.T / length, v @ turn.T / speed, strict=True):
        x, u = ([f"{value:.15E}" for value in part] for part in (place, velocity))
        day = date(DATE.after(t))
        if layout == "commas":
            rows.append(f"2459863.500000000, {day},  {', '.join((*x, *u))},")
        elif layout == "labels":
            rows.append(f"2459863.500000000 = {day} TDB [del_T=     69.183909 s]\n X ={x[0]} Y ={x[1]} Z ={x[2]}\n "
                        f"VX={u[0]} VY={u[1]} VZ={u[2]}\n LT= 1.0E+00 RG= 2.0E+00 RR=-3.0E+00")
        else:
            rows.append(f"2459863.500000000 = {day} TDB \n   {' '.join(x)}\n   {' '.join(u)}\n   1.0E+00 2.0E+00 -3.0")
    head = HEAD.format(units=units, frame=frame, target=target, center=center)
    (folder / "hera.txt").write_text(
        head.replace("Output units", f"{more}Output units") + (COMMAS if layout == "commas" else LINES)
        + "\n".join(rows) + "\n$$EOE\n" + "*" * 79 + "\n\nTIME\n\n  JDTDB: x\n")
    return folder / "hera.txt"


@pytest.mark.parametrize("layout", ["labels", "plain", "commas"])
@pytest.mark.parametrize("units", ["KM-S", "AU-D", "KM-D"])
@pytest.mark.parametrize("frame, more", [
    ("ICRF", ""), ("Ecliptic of J2000.0", ""),
    ("ICRF/J2000.0", "Coordinate systm: Ecliptic and Mean Equinox of Reference Epoch\n"),
    ("ICRF/J2000.0", "Coordinate systm: Earth Mean Equator and Equinox of Reference Epoch\n")])
def test_a_table_is_the_orbit_it_was_written_of(tmp_path, layout, units, frame, more):
    path = trajectory_of_horizons(table(tmp_path, layout, units, frame, more=more), "didymos")
    t = np.linspace(50.0, 3500.0, 71)
    # Dates have 0.1 ms: at 0.2 m/s that is 20 um.
    for got, truth, within in zip(path.at(DATE, t), orbits.small_orbit().at(DATE, t), (1e-3, 1e-5), strict=True):
        np.testing.assert_allclose(got, truth, atol=within)
    assert path.about == "didymos" and path.epoch == DATE


def test_the_ecliptic_is_horizons(tmp_path):
    """Its obliquity is 84381.448 arcseconds."""
    turn = Rotation.from_euler("x", 84381.448 / 3600.0, degrees=True).as_matrix()
    np.testing.assert_allclose(EQUATORIAL_FROM_ECLIPTIC, turn, atol=1e-15)


def test_dates_in_ut_and_tables_of_positions(tmp_path):
    path = table(tmp_path, "commas")
    text = path.read_text()
    path.write_text(text.replace("JDTDB,  ", "JDUT,   ").replace("(TDB)", "(UT)"))
    np.testing.assert_allclose(trajectory_of_horizons(path, "didymos").epoch - DATE, 69.184, atol=2e-3)
    rows = [line.rsplit(",", 4)[0] + "," if line.startswith("2459") else line for line in text.splitlines()]
    path.write_text("\n".join(rows).replace("VX,                     VY,                     VZ,", ""))
    made = trajectory_of_horizons(path, "didymos")
    assert made.v_m_s is None
    np.testing.assert_allclose(made.at(DATE, np.array([1500.0]))[0], orbits.small_orbit().at(DATE, [1500.0])[0],
                               atol=1e-3)


@pytest.mark.parametrize("old, new, message", [
    ("GEOMETRIC cartesian", "AIRLESS-APPARENT cartesian", "Output type: must be 'GEOMETRIC cartesian states'"),
    ("BODY CENTER", "Pan-STARRS 1", "Center-site name: must be 'BODY CENTER', got 'Pan-STARRS 1'"),
    ("frame : ICRF", "frame : FK4/B1950.0", "Reference frame: must be 'ICRF' or "),
    ("Reference frame : ICRF\n", "", "Reference frame: must be 'ICRF'"),
    ("KM-S", "MI-S", "Output units: must be 'KM-S'"),
    ("name: Didymos ", "name: Earth (399) ", "Center body name: must be 'didymos', got 'Earth (399)'"),
    ("$$SOE", "$$SOO", "$$SOE: missing; save the whole answer"), ("$$EOE", "", "$$EOE: missing"),
    ("JDTDB\n   X", "   X", "JDTDB: missing"),
    ("   VX    VY    VZ\n", "   VX\n", "Output format: must be of type 1, 2 or 3"),
    ("   LT    RG    RR\n", "", "line 24: must begin a row of 6 numbers, got 9"),
    (" Y =", " Y = nan ", "line 26: must be a date, or finite numbers"),
    (" LT= 1.0E+00 RG", "VENUS\n LT= 1.0E+00 RG", "line 28: must be a date, or finite numbers of a row, got 'VENUS'"),
    ("11 00:05:00", "11 00:00:00", "line 29: must be later than the row before"),
    ("2022-Oct-11 00:05:00", "1022-Oct-11 00:05:00", "line 29: must be a date of the years from 1583 on"),
    ("2022-Oct-11 00:05:00", "2022-Feb-30 00:05:00", "line 29: must be a date that there is, got 'A.D. 2022-Feb-30"),
    ("2022-Oct-11 00:05:00", "2022-Okt-11 00:05:00", "line 29: must be a date that there is"),
    ("2022-Oct-11 00:05:00", "2022-Oct-11 25:05:00", "line 29: must be a date that there is"),
    ("2022-Oct-11 00:05:00", "0000-Oct-11 00:05:00", "line 29: must be a date that there is"),
    ("11 00:05:00.", "11 00:05.", "line 29: must be a date that there is"),
])
def test_another_table_is_refused_by_its_field(tmp_path, old, new, message):
    path = table(tmp_path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ConfigError) as caught:
        trajectory_of_horizons(path, "didymos")
    assert str(caught.value).startswith("hera.txt.") and message in str(caught.value), str(caught.value)


def test_months_are_english_in_any_locale(tmp_path, monkeypatch):
    """In Germany's the tenth is called Okt."""
    german = [name.replace("Oct", "Okt") for name in ("", *MONTHS)]
    for names in ("month_abbr", "month_name"):
        monkeypatch.setattr(calendar, names, german)
    monkeypatch.setattr(_strptime, "_TimeRE_cache", _strptime.TimeRE())
    monkeypatch.setattr(_strptime, "_regex_cache", {})
    assert trajectory_of_horizons(table(tmp_path), "didymos").epoch == DATE


def test_a_table_is_of_its_target_about_its_centre(tmp_path):
    """In a scenario: names with and without numbers; a moon's table does not move the spacecraft."""
    body = {"generated": {"kind": "icosphere", "radius_m": 10.0, "subdivisions": 1},
            "brdf": {"law": "lambert", "normal_albedo": 0.1}}
    moon = {"name": "dimorphos", **body, "trajectory": {"kind": "horizons", "file": "moon.txt"}}
    scene = {"bodies": [{"name": "didymos", **body}, moon], "sun": {"r_m": [1.5e11, 0.0, 0.0]},
             "cameras": [{"name": "c", "width_px": 64, "height_px": 64, "focal_length_px": 64.0}],
             "trajectory": {"kind": "horizons", "file": "hera.txt"},
             "time": {"start_tdb": "2022-10-11T00:00:00", "times_s": [900.0]}}
    table(tmp_path, target="Dimorphos (120065803)", center="65803 Didymos (1996 GT)").rename(tmp_path / "moon.txt")
    table(tmp_path, center="65803 Didymos (1996 GT)")
    (state,) = scenario_of_table(scene, folder=tmp_path).states()
    truth = orbits.small_orbit().at(DATE, [900.0])[0][0]
    for pose in (state.bodies["dimorphos"], state.spacecraft):
        np.testing.assert_allclose(pose.r_inertial_m - state.bodies["didymos"].r_inertial_m, truth, atol=1e-3)
    with pytest.raises(ConfigError, match="moon.txt.Target body name: must not be another body's, got 'Dimor"):
        scenario_of_table({**scene, "trajectory": {"kind": "horizons", "file": "moon.txt"}}, folder=tmp_path)
    moon["trajectory"]["file"] = "hera.txt"
    with pytest.raises(ConfigError, match="object_name: must be the target of the table, got 'dimorphos'; it is Hera.*"
                       "; write object_name = '.+' if it is the one that is meant"):
        scenario_of_table(scene, folder=tmp_path)
