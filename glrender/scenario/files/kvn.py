"""CCSDS messages in keyword = value notation: segments, whose keywords are used, passed over by name, or refused.

Source: CCSDS 502.0-B-3 section 7, 504.0-B-2 section 7: keywords are in upper case, values all in upper or lower case.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from datetime import date, timedelta
from pathlib import Path

import numpy as np
from glrender_camera.validate import did_you_mean, text

from ...base.errors import ConfigError, error_path
from ..epochs import Epoch
from .state_files import text_of

INERTIAL = ("ICRF", "ICRF2", "ICRF3", "EME2000", "J2000", "GCRF")
"""Frames that are taken for ICRF: EME2000 is ICRF to 0.02 arcseconds, and files do not distinguish the two."""
# Keywords of the header that change no number.
_HEADER = ("CLASSIFICATION", "CREATION_DATE", "ORIGINATOR", "MESSAGE_ID")
_BLOCKS = ("META", "DATA", "COVARIANCE")
_SCALES = ("TDB", "UTC", "TT", "TAI")


@dataclass
class Segment:
    """A block of metadata, and the rows behind it with the numbers of their lines.

    Parameters
    ----------
    line : int
        Line of META_START.
    meta : dict of str to str
        Values by keyword, as the file has them.
    rows : list of (int, list of str)
    """

    line: int
    meta: dict[str, str] = field(default_factory=dict)
    rows: list[tuple[int, list[str]]] = field(default_factory=list)

    def value(self, key: str, allowed: Sequence[str], default: str | None = None, hint: str = "") -> str:
        """The value of a keyword in upper case, one of those allowed; a default stands for a missing one."""
        got = in_capitals(self.meta[key]) if key in self.meta else default
        if got not in allowed:
            raise ConfigError(key, f"must be one of {', '.join(allowed)}", self.meta.get(key), hint)
        return got

    def epoch(self, key: str) -> Epoch | None:
        """The epoch of a keyword, None where the segment has none."""
        return self._epoch(self.meta[key], key) if key in self.meta else None

    def useable(self, epochs: Sequence[Epoch]) -> tuple[Epoch, Epoch]:
        """First and last of the epochs at which rows count: within theirs, and the USEABLE times where these are given.

        Raises
        ------
        ConfigError
            USEABLE times without rows between them.
        """
        first, last = (self.epoch(f"USEABLE_{end}_TIME") for end in ("START", "STOP"))
        first, last = max(first or epochs[0], epochs[0]), min(last or epochs[-1], epochs[-1])
        if not first < last:
            raise ConfigError("USEABLE_START_TIME", "must be before USEABLE_STOP_TIME, with rows between them",
                              f"{first.tdb} to {last.tdb} TDB")
        return first, last

    def table(self, widths: Sequence[int]) -> tuple[list[Epoch], list[list[float]]]:
        """Epochs and numbers of the rows, of some widths each."""
        epochs: list[Epoch] = []
        numbers = []
        for line, (day, *words) in self.rows:
            name = f"line {line}"
            epochs.append(self._epoch(day, name))
            try:
                values = [float(word) for word in words]
            except ValueError:
                raise ConfigError(name, "must be an epoch and numbers", " ".join([day, *words])) from None
            if not np.isfinite(values).all():
                raise ConfigError(name, "must be an epoch and finite numbers", " ".join([day, *words]))
            if len(values) not in widths:
                raise ConfigError(name, f"must have {' or '.join(map(str, widths))} numbers behind the epoch",
                                  len(values))
            if len(epochs) > 1 and not epochs[-1] > epochs[-2]:
                raise ConfigError(name, "must be later than the row before", day)
            numbers.append(values)
        if len(epochs) < 2:
            raise ConfigError(f"line {self.line}", "must begin a segment of at least two rows", len(epochs))
        return epochs, numbers

    def _epoch(self, text: str, name: str) -> Epoch:
        return Epoch.from_scale(_calendar_date(text), self.value("TIME_SYSTEM", _SCALES), name)


def segments_of(path: Path, kind: str, versions: Sequence[str], keywords: Iterable[str]) -> tuple[str, list[Segment]]:
    """The version, one of those that are known, and the segments of a file.

    Parameters
    ----------
    path : path
    kind : "OEM" or "AEM"
    versions : sequence of str
        Those that are known.
    keywords : iterable of str
        Keywords that metadata may have; others are refused, as are keywords among the rows.

    Raises
    ------
    ConfigError
        With the file and the line.
    """
    content = text_of(path)
    if content.lstrip().startswith("<"):
        raise ConfigError(path.name, "is XML; only keyword = value notation is read", str(path))
    segments, header, block = [], {}, ""
    with error_path(path.name):
        for number, line in enumerate(content.splitlines(), 1):
            words, name = line.split(), f"line {number}"
            if not words or words[0] == "COMMENT":
                continue
            begun, _, edge = words[0].rpartition("_")
            if len(words) == 1 and begun in _BLOCKS and edge in ("START", "STOP"):
                if (edge == "START") == bool(block) or edge == "STOP" and block != begun or (
                        begun != "META" and not segments):
                    raise ConfigError(name, f"must not come {f'inside {block}_START' if block else 'here'}", words[0])
                block = begun if edge == "START" else ""
                if words[0] == "META_START":
                    segments.append(Segment(line=number))
            elif "=" in line:
                key, value = (part.strip() for part in line.split("=", 1))
                if block == "META":
                    _add(segments[-1].meta, name, key, value, keywords)
                elif not segments:
                    if re.fullmatch(r"CCSDS_\w+_VERS", key) and key != f"CCSDS_{kind}_VERS":
                        raise ConfigError("", f"must have CCSDS_{kind}_VERS: it is another message", key)
                    _add(header, name, key, value, (f"CCSDS_{kind}_VERS", *_HEADER))
                elif block != "COVARIANCE":
                    raise ConfigError(name, "must be an epoch and numbers: a keyword belongs between META_START and "
                                      "META_STOP", line.strip())
            elif block in ("", "DATA") and segments:
                segments[-1].rows.append((number, words))
            elif block != "COVARIANCE":
                raise ConfigError(name, "must be keyword = value", line.strip())
        if block:
            raise ConfigError(f"{block}_STOP", "missing")
        version = header.get(f"CCSDS_{kind}_VERS")
        if version is None or not segments:
            raise ConfigError("", f"must have CCSDS_{kind}_VERS and a segment", str(path))
        known = [each for each in versions if re.fullmatch(r"\d+(\.\d*)?", version) and float(each) == float(version)]
        if not known:
            raise ConfigError(f"CCSDS_{kind}_VERS", f"must be one of {', '.join(versions)}", version)
    return known[0], segments


def of_one_object(path: Path, segments: list[Segment], name: str | None, bodies: Sequence[str] = ()) -> list[Segment]:
    """The segments about an object.

    Parameters
    ----------
    path : path
    segments : list of Segment
    name : str, optional
        Needed where the file has several objects.
    bodies : sequence of str
        Names that the object may not have where no name is given.

    Raises
    ------
    ConfigError
        With the names that the file has.
    """
    if name is not None:
        text("object_name", name)
    names = list({_bare(name): name for name in (segment.meta.get("OBJECT_NAME", "") for segment in segments)}.values())
    if name is None and len(names) > 1 or name is not None and not any(same(name, other) for other in names):
        way = "each segment needs an OBJECT_NAME"
        if all(names):
            way = (f"it has {', '.join(names)}; write object_name = {' or '.join(map(repr, names))} if it is the one "
                   "that is meant")
        raise ConfigError("object_name", f"must be one of those in {path.name}", name, way)
    if name is None and any(same(names[0], body) for body in bodies):
        raise ConfigError(f"{path.name}.OBJECT_NAME", "must not be another body's", names[0],
                          f"write object_name = {names[0]!r} if it is the one that is meant")
    return [segment for segment in segments if name is None or same(name, segment.meta.get("OBJECT_NAME", ""))]


def centre_of(field: str, in_file: Sequence[str], about: str | Sequence[str], center_name: str | None) -> str:
    """Which of the scenario's names a file's centre has.

    Parameters
    ----------
    field : str
        The file's, for messages.
    in_file : sequence of str
        The file's names for it, in full and in short.
    about : str, or sequence of str
        Names in the scenario; of several the one that is called so.
    center_name : str, optional
        The file's name for `about`, as it was given.

    Raises
    ------
    ConfigError
        Another centre.
    """
    names = [about] if isinstance(about, str) else about
    if center_name is not None:
        if not any(same(text("center_name", center_name), name) for name in in_file):
            raise ConfigError(field, f"must be {center_name!r}, the center_name that is asked for", in_file[0])
        return names[0]
    for name in names:
        if any(same(name, other) for other in in_file):
            return name
    raise ConfigError(field, f"must be {' or '.join(map(repr, names))}", in_file[0],
                      f"write center_name = {in_file[-1]!r} and `about` if one of these is the same place, or give the "
                      "body that it is")


def in_capitals(value: str) -> str:
    """A text in upper case, its blanks as underscores: the standards take both for one."""
    return re.sub(r"[\s_]+", "_", value.strip().upper())


def same(a: str, b: str) -> bool:
    """Whether two names are one, but for case, spaces and punctuation."""
    return _bare(a) == _bare(b)


def _bare(name: str) -> str:
    return re.sub(r"[\W_]+", "", name).upper()


def _add(table: dict[str, str], name: str, key: str, value: str, known: Iterable[str]) -> None:
    known = list(known)
    if key not in known:
        raise ConfigError(name, "has a keyword that is not known here", key, " ".join(
            (did_you_mean(key, known), "known are " + ", ".join(known))).strip())
    if key in table:
        raise ConfigError(name, "gives a keyword a second time", key)
    if not value:
        raise ConfigError(name, "must give the keyword a value", key)
    table[key] = value


def one_value(segments: Sequence[Segment], key: str) -> str:
    """The value of a keyword that all segments must have, the same in all."""
    values = {_bare(segment.meta.get(key, "")): segment.meta.get(key, "") for segment in segments}
    if len(values) > 1 or "" in values:
        raise ConfigError(key, "must be there, and one in the whole file", list(values.values()))
    return next(iter(values.values()))


def since(epochs: Sequence[Epoch]) -> np.ndarray:
    """Times (N,) [s] from the first of epochs."""
    return np.array([epoch - epochs[0] for epoch in epochs])


def _calendar_date(text: str) -> str:
    """A date with its day of the year turned into month and day: 2006-001T00:00:00."""
    day, mark, time = text.removesuffix("Z").partition("T")
    if len(day) == 8 and day[4] == "-" and day.replace("-", "").isdigit() and (year := int(day[:4])) > 0:
        found = date(year, 1, 1) + timedelta(days=int(day[5:]) - 1)
        # A day that the year does not have stays as it is, and is refused with the line.
        day = found.isoformat() if found.year == year else day
    return f"{day}{mark}{time}"
