"""Requests of the background: one waits until nobody else does, and takes half a percent of the time of others."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable
from typing import Any

from . import limits
from .job import QUICK_S


class Background:
    """The place where one request of the background waits, and the account of what they took."""

    def __init__(self):
        self._waiting: tuple[Hashable, Any] | None = None
        self._asked, self._began, self._free_at = -math.inf, None, -math.inf
        self._is_quick = False

    def __bool__(self) -> bool:
        return self._waiting is not None

    def put(self, sender: Hashable, item: Any) -> list[Any]:
        """Let an item wait. Returns the items refused: the sender's own before it, or this one behind another's."""
        if self._waiting is not None and self._waiting[0] != sender:
            return [item]
        refused = [] if self._waiting is None else [self._waiting[1]]
        self._waiting = sender, item
        return refused

    def others_ask(self, now_s: float) -> None:
        """Take note that a request came that is none of the background."""
        self._asked = now_s

    def get(self, now_s: float, is_free: Callable[[Any], bool] = lambda item: True) -> Any | None:
        """The item that waits, if it may begin now: it is the caller's then, who says when it has `ended`."""
        if self._waiting is None or self._began is not None or not is_free(self._waiting[1]):
            return None
        nobody_asks = now_s - self._asked > limits.BACKGROUND_IDLE_S and self._is_quick
        if not (nobody_asks or now_s >= self._free_at):
            return None
        item, self._waiting, self._began = self._waiting[1], None, now_s
        return item

    def drop(self) -> Any | None:
        """The item that waits, which is not begun."""
        item = None if self._waiting is None else self._waiting[1]
        self._waiting = None
        return item

    def ended(self, now_s: float) -> None:
        """Take note that the item is done; the next waits according to how long this one took."""
        seconds = now_s - (now_s if self._began is None else self._began)
        self._began, self._is_quick = None, seconds < QUICK_S
        self._free_at = now_s + seconds / limits.BACKGROUND_SHARE
