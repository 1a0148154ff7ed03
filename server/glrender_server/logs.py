"""How the server writes its log: lines for people, or one JSON object a line for programs."""

from __future__ import annotations

import json
import logging
import sys

FORMATS = ("text", "json")
_STANDARD = frozenset(logging.makeLogRecord({}).__dict__) | {"message", "asctime"}


class JsonFormatter(logging.Formatter):
    """`{"t", "level", "logger", "process", "message", ...}`, with whatever the record carries beside."""

    def format(self, record: logging.LogRecord) -> str:
        """One line."""
        fields = {"t": round(record.created, 6), "level": record.levelname, "logger": record.name,
                  "process": record.process, "message": record.getMessage()}
        fields |= {name: value for name, value in record.__dict__.items() if name not in _STANDARD}
        if record.exc_info:
            fields["traceback"] = self.formatException(record.exc_info)
        return json.dumps(fields, default=str)


def set_up(level: int, form: str) -> None:
    """Write the log of this process to standard error.

    Parameters
    ----------
    level : int
        As of `logging`.
    form : "text" or "json"
    """
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonFormatter() if form == "json" else logging.Formatter(
        "%(asctime)s %(levelname)s %(name)s[%(process)d]: %(message)s"))
    handler.addFilter(is_ours)
    logging.basicConfig(level=level, handlers=[handler], force=True)


def is_ours(record: logging.LogRecord) -> bool:
    """Whether a program writes a record: warnings of a shape's file it gives itself, once and with the body's name."""
    return record.levelno > logging.WARNING or not record.name.startswith("glrender.scene.shape")
