"""Who creates a GL resource owns it: moderngl frees nothing by itself."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any, TypeVar

T = TypeVar("T", bound=Any)


class ResourceOwner(ExitStack):
    """A context manager that releases what it owns, last made first."""

    def own(self, resource: T) -> T:
        self.callback(resource.release)
        return resource
