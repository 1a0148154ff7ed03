"""The server's log: lines for people, or one JSON object a line for programs."""

from __future__ import annotations

import json
import logging
import os
import sys
import time

from .limits import LOG_LINES, LOG_PERIOD_S

FORMATS = ("text", "json")
# Control characters, also those of eight bits, and what separates lines in Unicode.
_CONTROL = {code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160))} | {
    code: f"\\u{code:04x}" for code in (0x2028, 0x2029, *range(0x202A, 0x202F), *range(0x2066, 0x206A))}
_MAX_KINDS = 256
_STANDARD = frozenset(logging.makeLogRecord({}).__dict__) | {"message", "asctime"}


class JsonFormatter(logging.Formatter):
    """`{"t", "level", "logger", "process", "message", ...}`, with whatever else the record carries."""

    def format(self, record: logging.LogRecord) -> str:
        """One line."""
        fields = {"t": round(record.created, 6), "level": record.levelname, "logger": record.name,
                  "process": record.process, "message": record.getMessage()}
        fields |= {name: value for name, value in record.__dict__.items() if name not in _STANDARD}
        if record.exc_info:
            fields["traceback"] = self.formatException(record.exc_info)
        return json.dumps(fields, default=str)


def say(line: str) -> None:
    """Print a line that scripts wait for; whoever started the program may have closed the pipe."""
    try:
        sys.stdout.write(line + "\n")
        sys.stdout.flush()
    except OSError:
        # The rest of the buffer would be written, and fail, again at the end.
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def printable(text: str) -> str:
    """A text in one line that moves nothing on a terminal: control characters are escaped."""
    return text.translate(_CONTROL)


class TextFormatter(logging.Formatter):
    """Lines for people. What a client wrote can neither forge a line nor reach a terminal as a control character."""

    def formatMessage(self, record: logging.LogRecord) -> str:
        """One line."""
        record.message = printable(record.message)
        return super().formatMessage(record)

    def formatException(self, info) -> str:
        """A traceback, each line set in, so that none looks like a record."""
        return "\n".join("    " + printable(line) for line in super().formatException(info).split("\n"))


class Sparing(logging.Filter):
    """Passes a few lines of one kind in a while; the next that passes says how many were left out.

    A kind is a message before its values are set in, or a warning's code. Debug lines, of each request, all pass.
    """

    def __init__(self):
        super().__init__()
        # Start of each kind's period, the lines written in it, and those left out.
        self._kinds: dict[tuple[str, str, str], list[float]] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether a record is written."""
        if record.levelno <= logging.DEBUG:
            return True
        now, kind = time.monotonic(), (record.name, str(record.msg), getattr(record, "code", ""))
        if kind not in self._kinds and len(self._kinds) >= _MAX_KINDS:
            self._kinds.clear()
        known = self._kinds.setdefault(kind, [now, 0, 0])
        if now - known[0] > LOG_PERIOD_S:
            known[:2] = now, 0
        known[1] += 1
        if known[1] > LOG_LINES:
            known[2] += 1
            return False
        if known[2]:
            record.msg, record.args = f"{record.getMessage()} ({known[2]:.0f} more like it were left out)", ()
            known[2] = 0
        return True


def formatter(form: str) -> logging.Formatter:
    """The formatter of lines for people ("text") or for programs ("json")."""
    return JsonFormatter() if form == "json" else TextFormatter(
        "%(asctime)s %(levelname)s %(name)s[%(process)d]: %(message)s")


def set_up(level: int, form: str) -> None:
    """Write the log of this process to standard error.

    Parameters
    ----------
    level : int
        As of `logging`.
    form : "text" or "json"
    """
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(formatter(form))
    handler.addFilter(is_ours)
    handler.addFilter(Sparing())
    logging.basicConfig(level=level, handlers=[handler], force=True)


def is_ours(record: logging.LogRecord) -> bool:
    """Whether a program writes a record: warnings of a shape's file it gives itself, once and with the body's name."""
    return record.levelno > logging.WARNING or not record.name.startswith("glrender.scene.shape")
