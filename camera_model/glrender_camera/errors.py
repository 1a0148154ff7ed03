"""The roots of glrender's one error tree, and how a message finds the field that is wrong."""

from __future__ import annotations

import reprlib
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_NO_VALUE = object()
_PREFIX: ContextVar[str] = ContextVar("path of the field being checked", default="")


class GlrenderError(Exception):
    """Base of every error that glrender raises on purpose."""

    code = "error"


class ConfigError(GlrenderError, ValueError):
    """A field of a configuration, a state or a request breaks a rule.

    Parameters
    ----------
    path : str
        Dotted path of the field, e.g. ``bodies[1].q_from_inertial``; empty for the whole.
    rule : str
        The rule that must hold.
    got : object, optional
        The value received.
    hint : str, optional
        The way out.
    """

    code = "config"

    def __init__(self, path: str, rule: str, got: object = _NO_VALUE, hint: str = ""):
        self.path, self.rule, self.got, self.hint = path, rule, got, hint
        super().__init__(path, rule, got, hint)

    def __str__(self) -> str:
        text = f"{self.path}: {self.rule}" if self.path else self.rule
        if self.got is not _NO_VALUE:
            text += f", got {_short(self.got)}"
        if self.hint:
            text += f"; {self.hint}"
        return text

    def __reduce__(self):
        got = () if self.got is _NO_VALUE else (self.got,)
        return (_rebuild, (type(self), self.path, self.rule, self.hint, *got))


def _rebuild(kind: type, path: str, rule: str, hint: str, *got: object) -> ConfigError:
    return kind(path, rule, *(got or (_NO_VALUE,)), hint)


class _Brief(reprlib.Repr):
    """Writes values for messages in few characters, however large a stranger's value is."""

    def __init__(self):
        super().__init__()
        self.maxlevel, self.maxdict, self.maxlist, self.maxtuple, self.maxstring, self.maxother = 3, 6, 16, 16, 120, 200

    def repr1(self, x: object, level: int) -> str:
        """A number of NumPy is written as one of Python."""
        is_number = type(x).__module__ == "numpy" and getattr(x, "shape", None) == ()
        return super().repr1(x.item() if is_number else x, level)  # type: ignore[attr-defined]

    def repr_bytes(self, value: bytes, level: int) -> str:
        return repr(value[:24]) + ("..." if len(value) > 24 else "")

    repr_bytearray = repr_bytes


_MAX_CHARACTERS = 200


def _short(value: object) -> str:
    return shortened(" ".join(_Brief().repr(value).split()), _MAX_CHARACTERS)


def shortened(text: str, most: int) -> str:
    """A text of at most so many characters."""
    return text if len(text) <= most else text[:most - 3] + "..."


@contextmanager
def error_path(prefix: str) -> Iterator[None]:
    """Put `prefix` in front of the field path of any ConfigError raised inside, and of any `path_of`."""
    token = _PREFIX.set(path_of(prefix))
    try:
        yield
    except ConfigError as error:
        error.path = _joined(prefix, error.path)
        raise
    finally:
        _PREFIX.reset(token)


def path_of(field: str) -> str:
    """The dotted path of a field that is checked inside `error_path`."""
    return _joined(_PREFIX.get(), field)


def _joined(prefix: str, path: str) -> str:
    return f"{prefix}{'' if not prefix or not path or path.startswith('[') else '.'}{path}"
