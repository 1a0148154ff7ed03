"""Tables of states in CSV and Parquet files: trajectories and attitudes, with the same columns."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import ConfigError
from ..epochs import EPOCH_SUFFIXES, Epoch, needed
from ..paths import Trajectory
from .tables import AttitudeTable, TrajectoryTable

_TIMES = ("t_s", *(f"epoch{suffix}" for suffix in EPOCH_SUFFIXES))
_R, _V = ("r_x_m", "r_y_m", "r_z_m"), ("v_x_m_s", "v_y_m_s", "v_z_m_s")
_Q = ("q_w", "q_x", "q_y", "q_z")

_MONTHS = ("JAN", "FEB", "MAR", "APR", "MAY", "JUN", "JUL", "AUG", "SEP", "OCT", "NOV", "DEC")

Cells = Mapping[str, Sequence[Any]]
"""Columns by name, of one length: texts or numbers."""
Rows = Sequence[int]
"""How messages count the rows: lines of a text, or rows from 0."""


def trajectory_of_csv(path: str | Path, about: str) -> Trajectory:
    """A trajectory of a CSV file.

    Its first line names the columns: `t_s` (from the scenario's start), `epoch_tdb`, `epoch_utc` or `epoch_et_s`;
    `r_x_m`, `r_y_m`, `r_z_m`; and `v_x_m_s`, `v_y_m_s`, `v_z_m_s` where velocities are known. Columns of an attitude
    may stand with them.

    Raises
    ------
    ConfigError
        With the file, the line and the column.
    """
    return _trajectory(Path(path), _of_csv, about)


def attitude_of_csv(path: str | Path, interpolation: str = "spline") -> AttitudeTable:
    """Attitudes of a CSV file: a time as in `trajectory_of_csv`, and `q_w`, `q_x`, `q_y`, `q_z` from inertial."""
    return _attitude(Path(path), _of_csv, interpolation)


def trajectory_of_parquet(path: str | Path, about: str) -> Trajectory:
    """A trajectory of a Parquet file, with the columns of `trajectory_of_csv`; epochs may be texts or timestamps.

    Raises
    ------
    ConfigError
        With the file, the row from 0 and the column; no pyarrow.
    """
    return _trajectory(Path(path), _of_parquet, about)


def attitude_of_parquet(path: str | Path, interpolation: str = "spline") -> AttitudeTable:
    """Attitudes of a Parquet file, with the columns of `attitude_of_csv`."""
    return _attitude(Path(path), _of_parquet, interpolation)


def _trajectory(path: Path, read: Callable[[Path], tuple[Cells, Rows]], about: str) -> Trajectory:
    columns, epoch = _columns(path, read, _R)
    velocity = np.stack([columns[name] for name in _V], axis=1) if set(_V) <= columns.keys() else None
    return TrajectoryTable(times_s=columns["t_s"], r_m=np.stack([columns[name] for name in _R], axis=1),
                           v_m_s=velocity, about=about, epoch=epoch)


def _attitude(path: Path, read: Callable[[Path], tuple[Cells, Rows]], interpolation: str) -> AttitudeTable:
    columns, epoch = _columns(path, read, _Q)
    return AttitudeTable(times_s=columns["t_s"], q_from_inertial=np.stack([columns[name] for name in _Q], axis=1),
                         epoch=epoch, interpolation=interpolation)


def date_of(text: str) -> str:
    """A date in ISO 8601, of one with an English month: "2022 OCT 11 00:05:00.5", with seconds or without.

    Raises
    ------
    ValueError
        A date that there is not.
    """
    found = re.fullmatch(r"(\d{4})\s+(\w{3})\s+(\d{1,2})\s+(\d{1,2}):(\d{1,2})(?::(\d{1,2})(?:\.(\d*))?)?",
                         text.strip(), re.ASCII)
    if not found or found[2].upper() not in _MONTHS:
        raise ValueError(text)
    day, hour, minute, second = (int(found[k] or 0) for k in (3, 4, 5, 6))
    moment = datetime(int(found[1]), _MONTHS.index(found[2].upper()) + 1, day, hour, minute, second)
    return moment.isoformat() + (f".{found[7]}" if found[7] else "")


def text_of(path: Path) -> str:
    """The text of a file; ConfigError with its name if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise ConfigError(path.name, f"cannot be read: {error.strerror}", str(path),
                          "in a scenario file names are relative to that") from None
    except UnicodeDecodeError as error:
        raise ConfigError(path.name, f"is no text: {error.reason}", str(path)) from None


def csv_rows(path: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """The names of a CSV file's columns, and its rows that are not empty with the numbers of their lines.

    Raises
    ------
    ConfigError
        With the line: a name that is given twice or is empty, a row with more or fewer cells than names.
    """
    reader = csv.reader(text_of(path).splitlines(), skipinitialspace=True)
    rows = [(reader.line_num, [cell.strip() for cell in row]) for row in reader if "".join(row).strip()]
    if not rows:
        return [], []
    (line, names), *rows = rows
    if wrong := [name for name in names if not name or names.count(name) > 1]:
        raise ConfigError(f"{path.name}:{line}", "must name each column once", wrong[0])
    for line, row in rows:
        if len(row) != len(names):
            hint = "decimals have a point, not a comma" if len(row) > len(names) else ""
            raise ConfigError(f"{path.name}:{line}", f"must have {len(names)} cells, one a column", len(row), hint)
    return names, rows


def _of_csv(path: Path) -> tuple[Cells, Rows]:
    names, rows = csv_rows(path)
    return {name: [row[k] for _, row in rows] for k, name in enumerate(names)}, [line for line, _ in rows]


def _of_parquet(path: Path) -> tuple[Cells, Rows]:
    try:
        arrow, parquet = import_module("pyarrow"), import_module("pyarrow.parquet")
    except ImportError as error:
        raise ConfigError(path.name, f"needs pyarrow: {error}", hint="pip install 'glrender[parquet]'") from None
    try:
        table = parquet.read_table(path)
    except OSError as error:
        raise ConfigError(path.name, f"cannot be read: {error.strerror or error}", str(path)) from None
    except arrow.ArrowException as error:
        raise ConfigError(path.name, f"is no Parquet file: {error}", str(path)) from None
    if wrong := [name for name in table.column_names if table.column_names.count(name) > 1]:
        raise ConfigError(path.name, "must name each column once", wrong[0])
    cells = {name: _arrow_cells(path, name, table.column(name), arrow) for name in table.column_names}
    return cells, range(table.num_rows)


def _arrow_cells(path: Path, name: str, column: Any, arrow: Any) -> Sequence[Any]:
    """The cells of a column; timestamps as texts, whose nanoseconds a datetime would lose."""
    if not arrow.types.is_timestamp(column.type):
        return column.to_pylist()
    if column.type.tz is not None and name != "epoch_utc":
        raise ConfigError(f"{path.name}.{name}", "must be timestamps without a zone", str(column.type),
                          "times in UTC are given as epoch_utc")
    return np.datetime_as_string(column.to_numpy().astype("datetime64[ns]")).tolist()


def _columns(path: Path, read: Callable[[Path], tuple[Cells, Rows]],
             required: Sequence[str]) -> tuple[Mapping[str, np.ndarray], Epoch | None]:
    """The columns of a file by name, times in `t_s`; and the epoch that they count from, if any."""
    cells, lines = read(path)
    count = len(next(iter(cells.values()), ()))
    if count < 2:
        raise ConfigError(path.name, "must have column names and at least two rows", count)
    timed = [name for name in _TIMES if name in cells]
    if len(timed) != 1:
        raise ConfigError(path.name, "must have exactly one column of times", list(cells),
                          f"one of {', '.join(_TIMES)}"
                          + ("; commas are between columns" if any(";" in name for name in cells) else ""))
    for name in cells:
        if name not in (*_TIMES, *_R, *_V, *_Q):
            raise ConfigError(f"{path.name}.{name}", "unknown column", hint=f"known are {', '.join(_R + _V + _Q)}")
    for name in (*required, *(name for group in (_R, _V, _Q) if set(group) & cells.keys() for name in group)):
        if name not in cells:
            raise ConfigError(f"{path.name}.{name}", "missing")
    columns = {name: np.array([_cell(path, line, name, value) for line, value in zip(lines, cells[name], strict=True)])
               for name in cells if name not in _TIMES or name == "t_s"}
    if timed == ["t_s"]:
        return columns, None
    epochs = [needed(Epoch.of_field({timed[0]: value if timed[0] != "epoch_et_s"
                              else _cell(path, line, timed[0], value)}, "epoch"))
              for line, value in zip(lines, cells[timed[0]], strict=True)]
    return {**columns, "t_s": np.array([epoch - epochs[0] for epoch in epochs])}, epochs[0]


def _cell(path: Path, line: int, name: str, value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ConfigError(f"{path.name}:{line}.{name}", "must be a number", value) from None
