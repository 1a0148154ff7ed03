"""Scenes and scenarios that a program makes while it is watched: none has an improbable field."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import wraps
from unittest import mock

from glrender import Scene
from glrender.scenario import Scenario


def doubts(made) -> list[str]:
    """Sentences of the fields of a scene or a scenario that are improbable."""
    found = made.doubts if isinstance(made, Scenario) else [told for each in made.doubts.values() for told in each]
    return [str(advice) for advice in found]


@contextmanager
def all_likely() -> Iterator[list]:
    """Watch what is made within, and fail at its end where a field is improbable; gives what was made."""
    made: list = []

    def watched(kind):
        own = kind.__post_init__

        @wraps(own)
        def after(self):
            own(self)
            made.append(self)

        return mock.patch.object(kind, "__post_init__", after)

    with watched(Scene), watched(Scenario):
        yield made
    assert not (told := [text for each in made for text in doubts(each)]), told
