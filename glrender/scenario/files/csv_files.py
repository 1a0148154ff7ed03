"""CSV files of trajectories and attitudes."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ...base.errors import ConfigError
from ..epochs import EPOCH_SUFFIXES, Epoch
from ..paths import Trajectory
from .tables import AttitudeTable, TrajectoryTable

_TIMES = ("t_s", *(f"epoch{suffix}" for suffix in EPOCH_SUFFIXES))
_R, _V = ("r_x_m", "r_y_m", "r_z_m"), ("v_x_m_s", "v_y_m_s", "v_z_m_s")
_Q = ("q_w", "q_x", "q_y", "q_z")


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
    columns, epoch = _columns(Path(path), _R)
    velocity = np.stack([columns[name] for name in _V], axis=1) if set(_V) <= columns.keys() else None
    return TrajectoryTable(times_s=columns["t_s"], r_m=np.stack([columns[name] for name in _R], axis=1),
                           v_m_s=velocity, about=about, epoch=epoch)


def attitude_of_csv(path: str | Path, interpolation: str = "spline") -> AttitudeTable:
    """Attitudes of a CSV file: a time as in `trajectory_of_csv`, and `q_w`, `q_x`, `q_y`, `q_z` from inertial."""
    columns, epoch = _columns(Path(path), _Q)
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


def _columns(path: Path, required: Sequence[str]) -> tuple[Mapping[str, np.ndarray], Epoch | None]:
    """The columns of a CSV file by name, times in `t_s`; and the epoch that they count from, if any."""
    rows = list(csv.DictReader(text_of(path).splitlines(), skipinitialspace=True))
    if len(rows) < 2:
        raise ConfigError(path.name, "must have a line of column names and at least two rows", len(rows))
    names = list(rows[0])
    timed = [name for name in _TIMES if name in names]
    if len(timed) != 1:
        raise ConfigError(path.name, "must have exactly one column of times", names, f"one of {', '.join(_TIMES)}")
    for name in names:
        if name not in (*_TIMES, *_R, *_V, *_Q):
            raise ConfigError(f"{path.name}.{name}", "unknown column", hint=f"known are {', '.join(_R + _V + _Q)}")
    for name in required:
        if name not in names:
            raise ConfigError(f"{path.name}.{name}", "missing")
    columns = {name: np.array([_cell(path, line, name, row[name]) for line, row in enumerate(rows, 2)])
               for name in names if name not in _TIMES or name == "t_s"}
    if timed == ["t_s"]:
        return columns, None
    epochs = [Epoch.of_field({timed[0]: row[timed[0]] if timed[0] != "epoch_et_s"
                              else float(_cell(path, line, timed[0], row[timed[0]]))}, "epoch")
              for line, row in enumerate(rows, 2)]
    return {**columns, "t_s": np.array([epoch - epochs[0] for epoch in epochs])}, epochs[0]


def _cell(path: Path, line: int, name: str, value: object) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ConfigError(f"{path.name}:{line}.{name}", "must be a number", value) from None
