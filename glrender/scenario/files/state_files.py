"""Tables of states in CSV and Parquet files: trajectories and attitudes, with the same columns."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
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

Cells = Mapping[str, Sequence[Any]]
"""Columns by name, of one length: texts or numbers."""


def trajectory_of_csv(path: str | Path, about: str) -> Trajectory:
    """A trajectory of a CSV file.

    Its first line names the columns: `t_s` (from the scenario's start), `epoch_tdb`, `epoch_utc` or `epoch_et_s`;
    `r_x_m`, `r_y_m`, `r_z_m`; and `v_x_m_s`, `v_y_m_s`, `v_z_m_s` where velocities are known. Columns of an attitude
    may stand beside them.

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


def _trajectory(path: Path, read: Callable[[Path], Cells], about: str) -> Trajectory:
    columns, epoch = _columns(path, read, _R)
    velocity = np.stack([columns[name] for name in _V], axis=1) if set(_V) <= columns.keys() else None
    return TrajectoryTable(times_s=columns["t_s"], r_m=np.stack([columns[name] for name in _R], axis=1),
                           v_m_s=velocity, about=about, epoch=epoch)


def _attitude(path: Path, read: Callable[[Path], Cells], interpolation: str) -> AttitudeTable:
    columns, epoch = _columns(path, read, _Q)
    return AttitudeTable(times_s=columns["t_s"], q_from_inertial=np.stack([columns[name] for name in _Q], axis=1),
                         epoch=epoch, interpolation=interpolation)


def text_of(path: Path) -> str:
    """The text of a file; ConfigError with its name if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise ConfigError(path.name, f"cannot be read: {error.strerror}", str(path)) from None
    except UnicodeDecodeError as error:
        raise ConfigError(path.name, f"is no text: {error.reason}", str(path)) from None


def _of_csv(path: Path) -> Cells:
    rows = list(csv.DictReader(text_of(path).splitlines(), skipinitialspace=True))
    return {name: [row[name] for row in rows] for name in rows[0]} if rows else {}


def _of_parquet(path: Path) -> Cells:
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
    return {name: _arrow_cells(path, name, table.column(name), arrow) for name in table.column_names}


def _arrow_cells(path: Path, name: str, column: Any, arrow: Any) -> Sequence[Any]:
    """The cells of a column; timestamps as texts, whose nanoseconds a datetime would lose."""
    if not arrow.types.is_timestamp(column.type):
        return column.to_pylist()
    if column.type.tz is not None and name != "epoch_utc":
        raise ConfigError(f"{path.name}.{name}", "must be timestamps without a zone", str(column.type),
                          "times in UTC are given as epoch_utc")
    return np.datetime_as_string(column.to_numpy().astype("datetime64[ns]")).tolist()


def _columns(path: Path, read: Callable[[Path], Cells],
             required: Sequence[str]) -> tuple[Mapping[str, np.ndarray], Epoch | None]:
    """The columns of a file by name, times in `t_s`; and the epoch that they count from, if any."""
    cells, first = read(path), 2 if read is _of_csv else 0
    count = len(next(iter(cells.values()), ()))
    if count < 2:
        raise ConfigError(path.name, "must have column names and at least two rows", count)
    timed = [name for name in _TIMES if name in cells]
    if len(timed) != 1:
        raise ConfigError(path.name, "must have exactly one column of times", list(cells),
                          f"one of {', '.join(_TIMES)}")
    for name in cells:
        if name not in (*_TIMES, *_R, *_V, *_Q):
            raise ConfigError(f"{path.name}.{name}", "unknown column", hint=f"known are {', '.join(_R + _V + _Q)}")
    for name in required:
        if name not in cells:
            raise ConfigError(f"{path.name}.{name}", "missing")
    columns = {name: np.array([_cell(path, line, name, value) for line, value in enumerate(cells[name], first)])
               for name in cells if name not in _TIMES or name == "t_s"}
    if timed == ["t_s"]:
        return columns, None
    epochs = [needed(Epoch.of_field({timed[0]: value if timed[0] != "epoch_et_s"
                              else _cell(path, line, timed[0], value)}, "epoch"))
              for line, value in enumerate(cells[timed[0]], first)]
    return {**columns, "t_s": np.array([epoch - epochs[0] for epoch in epochs])}, epochs[0]


def _cell(path: Path, line: int, name: str, value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ConfigError(f"{path.name}:{line}.{name}", "must be a number", value) from None
