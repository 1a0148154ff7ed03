"""The error tolerance of a command line: ``0.02``, or ``centroid_px=0.05,flux=0.001``."""

from __future__ import annotations

from glrender import ConfigError
from glrender.scene.tolerance import checked_max_error


def read_max_error(text: str | None, name: str = "max_error") -> float | dict[str, float] | None:
    """The tolerance that a text says; None stays so.

    Raises
    ------
    ConfigError
        It is neither a number nor units with one each; or as of `checked_max_error`.
    """
    if text is None:
        return None
    pairs = [part.split("=", 1) for part in text.split(",")] if "=" in text else [("", text)]
    try:
        numbers = {unit.strip(): float(number) for unit, number in pairs}
    except ValueError:
        numbers = {}
    if len(numbers) < len(pairs) or ("=" in text and "" in numbers):
        raise ConfigError(name, "must be a number, or units with one each", text,
                          "as 0.02, or centroid_px=0.05,flux=0.001")
    return checked_max_error(numbers if "=" in text else numbers[""], name)
