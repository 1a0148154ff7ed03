"""Vector tables of JPL's Horizons, as its web page and its API write them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...base.constants import AU_M, FIRST_YEAR
from ...base.errors import ConfigError, error_path
from ..epochs import Epoch
from ..kepler import EQUATORIAL_FROM_ECLIPTIC
from ..paths import Trajectory
from .kvn import centre_of, same, since
from .state_files import date_of, text_of
from .tables import TrajectoryTable

# Metres and metres a second of the output units.
_UNITS = {"KM-S": (1e3, 1e3), "AU-D": (AU_M, AU_M / 86400.0), "KM-D": (1e3, 1e3 / 86400.0)}
_SCALES = {"TDB": "TDB", "UT": "UTC", "TT": "TT"}
_FRAMES = {"ICRF": np.eye(3), "ICRF/J2000.0": np.eye(3), "Ecliptic of J2000.0": EQUATORIAL_FROM_ECLIPTIC}
# Systems of tables before 2020, whose frame is ICRF/J2000.0.
_SYSTEMS = {"Earth Mean Equator and Equinox of Reference Epoch": np.eye(3),
            "Ecliptic and Mean Equinox of Reference Epoch": EQUATORIAL_FROM_ECLIPTIC}
_DATE = re.compile(r"(A\.D\.|B\.C\.)\s+(\d{4}-[A-Z][a-z]{2}-\d\d\s+\d\d:\d\d(?::\d\d)?)(\.\d+)?")


def trajectory_of_horizons(path: str | Path, about: str | Sequence[str], object_name: str | None = None, *,
                           center_name: str | None = None, bodies: Sequence[str] = ()) -> Trajectory:
    """The trajectory of a vector table of Horizons, in lines or comma-separated.

    Parameters
    ----------
    path : path
        Text; geometric states, of types 1 (positions), 2 or 3.
    about : str, or sequence of str
        The name in the scenario of the centre; of several the one that is called so.
    object_name : str, optional
        The target, with or without its number: "Didymos" of "65803 Didymos (1996 GT)".
    center_name : str, optional
        The file's name for `about`, where it has another one there.
    bodies : sequence of str
        Names that the target may not have where no `object_name` is given.

    Raises
    ------
    ConfigError
        With the file and the line: states that are apparent or of an observatory, a frame that is neither ICRF nor
        the ecliptic of J2000, another target or centre, rows that are no numbers.

    Source: JPL, Horizons manual, "Vector tables"; the ecliptic's obliquity is 84381.448 arcseconds.
    """
    path = Path(path)
    lines = text_of(path).splitlines()
    with error_path(path.name):
        begin, end = (_line_of(lines, mark) for mark in ("$$SOE", "$$EOE"))
        head = {key.strip(): value.strip() for line in lines[:begin] for key, mark, value in [line.partition(":")]
                if mark and value.strip()}
        _of_field(head, "Output type", ("GEOMETRIC cartesian states",))
        _of_field(head, "Center-site name", ("BODY CENTER",))
        frame = _of_field(head, "Reference frame", tuple(_FRAMES))
        axes = (_SYSTEMS[_of_field(head, "Coordinate systm", tuple(_SYSTEMS))] if "Coordinate systm" in head
                else _FRAMES[frame])
        scales = _UNITS[_of_field(head, "Output units", tuple(_UNITS))]
        _check_target(_called(head, "Target body name"), object_name, bodies)
        centre = centre_of("Center body name", _called(head, "Center body name"), about, center_name)
        names, is_csv, scale = _columns(lines[:begin])
        epochs, rows = _rows(lines, begin + 1, end, names, is_csv, scale)
    table = np.array(rows)
    parts = [table[:, [names.index(axis) for axis in group]] @ axes.T * factor
             for group, factor in zip((("X", "Y", "Z"), ("VX", "VY", "VZ")), scales, strict=True)
             if set(group) <= set(names)]
    return TrajectoryTable(times_s=since(epochs), about=centre, epoch=epochs[0], r_m=parts[0],
                           v_m_s=parts[1] if len(parts) > 1 else None)


def _line_of(lines: list[str], mark: str) -> int:
    for number, line in enumerate(lines):
        if line.strip() == mark:
            return number
    raise ConfigError(mark, "missing", hint="save the whole answer of Horizons, of a vector table as text")


def _of_field(head: dict[str, str], key: str, allowed: Sequence[str]) -> str:
    if head.get(key) not in allowed:
        raise ConfigError(key, f"must be {' or '.join(map(repr, allowed))}", head.get(key),
                          "ask Horizons for such a table")
    return head[key]


def _called(head: dict[str, str], key: str) -> list[str]:
    """Names of a body: with its numbers, and without those and the origin of its places."""
    full = re.sub(r"\s*\{.*", "", head.get(key, ""))
    if not full:
        raise ConfigError(key, "missing")
    short = re.sub(r"\s*\([^)]*\)", "", full).strip()
    return [full, short, re.sub(r"^\d+\s+", "", short)]


def _check_target(called: list[str], object_name: str | None, bodies: Sequence[str]) -> None:
    if object_name is not None and not any(same(str(object_name), name) for name in called):
        raise ConfigError("object_name", "must be the target of the table", object_name, f"it is {called[0]}; write "
                          f"object_name = {called[-1]!r} if it is the one that is meant")
    if object_name is None and any(same(body, name) for body in bodies for name in called):
        raise ConfigError("Target body name", "must not be another body's", called[0],
                          f"write object_name = {called[-1]!r} if it is the one that is meant")


def _columns(head: list[str]) -> tuple[list[str], bool, str]:
    """The names of a row's numbers behind its date, whether commas part them, and the time scale of dates."""
    titles = [(k, found[1]) for k, line in enumerate(head) if (found := re.match(r"\s*JD(TDB|UT|TT)\b", line))]
    if not titles:
        raise ConfigError("JDTDB", "missing: no line names the columns")
    at, kind = titles[-1]
    first, scale = head[at], _SCALES[kind]
    is_csv = "," in first
    names = ([name.strip() for name in first.rstrip(" ,").split(",")][2:] if is_csv
             else " ".join(line for line in head[at + 1:] if "*" not in line).split())
    if not {"X", "Y", "Z"} <= set(names) or {"VX", "VY", "VZ"} & set(names) not in (set(), {"VX", "VY", "VZ"}):
        raise ConfigError("Output format", "must be of type 1, 2 or 3: positions, with velocities or not", names)
    return names, is_csv, scale


def _rows(lines: list[str], begin: int, end: int, names: list[str], is_csv: bool,
          scale: str) -> tuple[list[Epoch], list[list[float]]]:
    """Epochs and numbers of the rows; a row takes several lines where no commas part it."""
    epochs: list[Epoch] = []
    rows: list[tuple[int, list[float]]] = []
    for number, line in enumerate(lines[begin:end], begin + 1):
        name, date = f"line {number}", _DATE.search(line)
        if date:
            epochs.append(_epoch(date, scale, name))
            if len(epochs) > 1 and not epochs[-1] > epochs[-2]:
                raise ConfigError(name, "must be later than the row before", date[0])
            rows.append((number, []))
            line = line[date.end():] if is_csv else ""
        try:
            values = [float(word) for word in (line.replace(",", " ") if is_csv
                                               else re.sub(r"\b[A-Z]+\s*=", " ", line)).split()]
            if values and not (rows and np.isfinite(values).all()):
                raise ValueError
        except ValueError:
            raise ConfigError(name, "must be a date, or finite numbers of a row", line.strip()) from None
        if values:
            rows[-1][1].extend(values)
    for number, values in rows:
        if len(values) != len(names):
            raise ConfigError(f"line {number}", f"must begin a row of {len(names)} numbers", len(values))
    if len(epochs) < 2:
        raise ConfigError("$$SOE", "must be followed by at least two rows", len(epochs))
    return epochs, [values for _, values in rows]


def _epoch(date: re.Match, scale: str, name: str) -> Epoch:
    try:
        moment = date_of(date[2].replace("-", " ") + (date[3] or ""))
    except ValueError:
        raise ConfigError(name, "must be a date that there is", date[0]) from None
    # The calendar is Gregorian from then on, whatever the table's mode.
    if date[1] != "A.D." or int(moment[:4]) < FIRST_YEAR:
        raise ConfigError(name, f"must be a date of the years from {FIRST_YEAR} on", date[0])
    return Epoch.from_scale(moment, scale, name)
