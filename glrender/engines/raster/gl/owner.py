"""The creator of a GL resource owns it: moderngl frees nothing by itself."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any, TypeVar

T = TypeVar("T", bound=Any)


class ResourceOwner(ExitStack):
    """A context manager that releases what it owns, last made first.

    Parameters
    ----------
    context : Context, optional
        Made current before each release: the numbers of GL's objects mean something in their own
        context only, and would delete another renderer's.
    """

    def __init__(self, context: Any = None):
        super().__init__()
        self._context = context

    def own(self, resource: T) -> T:
        self.callback(self._release, resource)
        return resource

    def _release(self, resource: Any) -> None:
        if self._context is not None:
            self._context.make_current()
        resource.release()
