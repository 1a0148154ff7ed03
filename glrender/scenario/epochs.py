"""Epochs, always with their time scale: TDB (SPICE's ET) or UTC."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date, datetime, timedelta
from typing import Any

from glrender_camera.validate import finite, one_of

from ..base.errors import ConfigError

EPOCH_SUFFIXES = ("_tdb", "_utc", "_et_s")
"""Endings that give the time scale of a field: `date_tdb`, `date_utc`, or `date_et_s`, TDB seconds past J2000."""

DATE_STEP_S = 1e-6
"""Step of dates as texts [s]: a file's last date may be earlier than the time it was written of by as much."""
_J2000 = datetime(2000, 1, 1, 12)
_TEXT = re.compile(r"(\d{4})-(\d\d)-(\d\d)(?:[T ](\d\d):(\d\d)(?::(\d\d)(\.\d{1,15})?)?)?(Z?)")
_TT_FROM_TAI_S = 32.184
# First UTC day -> TAI - UTC [s]; IERS Bulletin C, as in NAIF's naif0012.tls. None was added since 2017.
_LEAP_SECONDS = {(1972, 1): 10, (1972, 7): 11, (1973, 1): 12, (1974, 1): 13, (1975, 1): 14, (1976, 1): 15,
                 (1977, 1): 16, (1978, 1): 17, (1979, 1): 18, (1980, 1): 19, (1981, 7): 20, (1982, 7): 21,
                 (1983, 7): 22, (1985, 7): 23, (1988, 1): 24, (1990, 1): 25, (1991, 1): 26, (1992, 7): 27,
                 (1993, 7): 28, (1994, 7): 29, (1996, 1): 30, (1997, 7): 31, (1999, 1): 32, (2006, 1): 33,
                 (2009, 1): 34, (2012, 7): 35, (2015, 7): 36, (2017, 1): 37}


@dataclass(frozen=True, order=True)
class Epoch:
    """An instant: TDB seconds past J2000, in two parts that keep 1e-15 s over centuries.

    Parameters
    ----------
    whole_s : int [s]
    fraction_s : float [s], 0..1
    """

    whole_s: int
    fraction_s: float = 0.0

    @classmethod
    def from_et(cls, et_s: float, name: str = "et_s") -> Epoch:
        """An epoch of SPICE's ET [s]; ConfigError unless it is a finite number."""
        whole = math.floor(et_s := finite(name, et_s))
        return cls(whole, et_s - whole)

    @classmethod
    def from_tdb(cls, value: str | datetime, name: str = "epoch_tdb") -> Epoch:
        """An epoch of a calendar date in TDB, "2029-02-13T12:00:00.5" or a datetime without a zone.

        Raises
        ------
        ConfigError
            A text that is no such date, or that names another scale (a Z, an offset from UTC).
        """
        day, second_of_day, fraction, is_utc = _calendar(name, value)
        if is_utc:
            raise ConfigError(name, "must be TDB, without a Z", str(value), "a time in UTC is given as *_utc")
        if second_of_day >= 86400:
            raise ConfigError(name, "must have seconds below 60: TDB has no leap seconds", str(value))
        return cls((day - _J2000.date()).days * 86400 + second_of_day - 43200, fraction)

    @classmethod
    def from_utc(cls, value: str | datetime, name: str = "epoch_utc") -> Epoch:
        """An epoch of a calendar date in UTC, leap seconds (23:59:60) included.

        Raises
        ------
        ConfigError
            A text that is no such date, a date before 1972, a leap second that there was not.

        Source: TDB - TT = 1.657e-3 s sin(E), E the Earth's eccentric anomaly, as SPICE's `unitim` has it.
        """
        day, second_of_day, fraction, _ = _calendar(name, value)
        leap = _leap_seconds(name, day)
        if second_of_day >= 86400 and _leap_seconds(name, day + timedelta(days=1)) == leap:
            raise ConfigError(name, "has a leap second that there was not", str(value))
        whole = (day - _J2000.date()).days * 86400 + second_of_day - 43200 + leap
        return _of_tt(cls(whole).after(fraction + _TT_FROM_TAI_S))

    @classmethod
    def from_scale(cls, value: str | datetime, scale: str, name: str = "epoch") -> Epoch:
        """An epoch of a calendar date in a named scale: TDB, UTC, TT or TAI.

        Raises
        ------
        ConfigError
            Another scale, or what `from_tdb` and `from_utc` refuse.
        """
        scale = one_of(name, scale, ("TDB", "UTC", "TT", "TAI"))
        if scale == "UTC":
            return cls.from_utc(value, name)
        epoch = cls.from_tdb(value, name)
        if scale == "TDB":
            return epoch
        return _of_tt(epoch.after(_TT_FROM_TAI_S if scale == "TAI" else 0.0))

    @classmethod
    def of_field(cls, table: Mapping[str, Any], stem: str) -> Epoch | None:
        """The epoch of `<stem>_tdb`, `<stem>_utc` or `<stem>_et_s` in a table; None where all are absent.

        Raises
        ------
        ConfigError
            Two are given, or `<stem>` alone: a time without a scale.
        """
        names = [stem + suffix for suffix in EPOCH_SUFFIXES]
        given = [name for name in names if name in table]
        if stem in table:
            raise ConfigError(stem, "has no time scale", table[stem], f"write {names[0]}, {names[1]} or {names[2]}")
        if len(given) > 1:
            raise ConfigError(given[1], f"is given as well as {given[0]}", table[given[1]], "give one")
        read: dict[str, Any] = {names[0]: cls.from_tdb, names[1]: cls.from_utc, names[2]: cls.from_et}
        return read[given[0]](table[given[0]], given[0]) if given else None

    @property
    def et_s(self) -> float:
        """TDB seconds past J2000, to 1e-7 s: SPICE's ET."""
        return self.whole_s + self.fraction_s

    @property
    def tdb(self) -> str:
        """The calendar date in TDB, to the microsecond: "2029-02-13T12:00:00.500000"."""
        return (_J2000 + timedelta(seconds=self.whole_s, microseconds=round(self.fraction_s * 1e6))).isoformat(
            timespec="microseconds")

    @property
    def utc(self) -> str:
        """The calendar date in UTC, to the microsecond, leap seconds (23:59:60) included.

        Raises
        ------
        ConfigError
            A date before 1972.
        """
        same = self
        for _ in range(3):
            same = self.after(Epoch.from_tdb(same.tdb) - Epoch.from_utc(same.tdb))
        late_s = self - Epoch.from_utc(same.tdb)
        if abs(late_s) < 0.5:
            return same.tdb
        last = (same if late_s > 0.0 else same.after(-1.0)).tdb
        return f"{last[:17]}60{last[19:]}"

    def after(self, t_s: float) -> Epoch:
        """The epoch a time later [s]."""
        sum_s = self.fraction_s + t_s
        whole = math.floor(sum_s)
        return Epoch(self.whole_s + whole, sum_s - whole)

    def __sub__(self, other: Epoch) -> float:
        """The time from another epoch to this one [s]."""
        return (self.whole_s - other.whole_s) + (self.fraction_s - other.fraction_s)


def needed(start: Epoch | None) -> Epoch:
    """The start of a scenario; refused where there is none and something turns or moves by the calendar."""
    if start is None:
        raise ConfigError("time.start_tdb", "missing: an orbit, a spin or a kernel needs the date",
                          hint="or give start_utc")
    return start


def _of_tt(tt: Epoch) -> Epoch:
    """The epoch of TT seconds past J2000."""
    mean_anomaly = 6.239996 + 1.99096871e-7 * tt.et_s
    return tt.after(1.657e-3 * math.sin(mean_anomaly + 1.671e-2 * math.sin(mean_anomaly)))


def _calendar(name: str, value: object) -> tuple[date, int, float, bool]:
    """Day, whole second of the day, its fraction [s], and whether UTC was named."""
    is_utc = False
    if isinstance(value, datetime):
        offset = value.utcoffset()
        if offset:
            raise ConfigError(name, "must have no offset from UTC", str(value), "give UTC itself, or TDB")
        is_utc, value = offset is not None, value.replace(tzinfo=None).isoformat()
    elif isinstance(value, date):
        value = value.isoformat()
    match = _TEXT.fullmatch(value) if isinstance(value, str) else None
    hint = 'write "2029-02-13T12:00:00.5"'
    if not match:
        raise ConfigError(name, "must be a date year-month-dayThour:minute:second", value, hint)
    year, month, day, hour, minute, second = (int(part or 0) for part in match.groups()[:6])
    is_leap = second == 60 and (hour, minute) == (23, 59)
    try:
        datetime(year, month, day, hour, minute, 59 if is_leap else second)
    except ValueError as error:
        raise ConfigError(name, f"is no date: {error}", value, hint) from None
    return date(year, month, day), hour * 3600 + minute * 60 + second, float(match[7] or 0.0), is_utc or bool(match[8])


def _leap_seconds(name: str, day: date) -> int:
    """TAI - UTC [s] on a day."""
    passed = [seconds for (year, month), seconds in _LEAP_SECONDS.items() if date(year, month, 1) <= day]
    if not passed:
        raise ConfigError(name, "must not be before 1972, when UTC got its leap seconds", day.isoformat(), "give TDB")
    return passed[-1]
