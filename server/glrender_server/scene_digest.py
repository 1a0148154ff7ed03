"""The name of a scene by its content, as an ETag: replies carry it, requests may ask for it."""

from __future__ import annotations

import dataclasses
import hashlib
import pickle
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from glrender import Scene

_N_CHARACTERS = 32


def scene_digest(scene: Scene) -> str:
    """A digest of all that a scene is made of, the content of its shapes and textures too [32 hexadecimal digits].

    A scene of the same file has the same digest in every process of one version of the program.
    """
    content = _Hash()
    _Content(content, pickle.HIGHEST_PROTOCOL).dump(scene)
    return content.hash.hexdigest()[:_N_CHARACTERS]


class _Content(pickle.Pickler):
    """Pickles the fields of objects, without the values that they cache."""

    def __init__(self, *arguments: Any):
        super().__init__(*arguments)
        # No references to what came before: whether two equal values are one object is no content.
        self.fast = True

    def reducer_override(self, thing: Any) -> Any:
        """Fields of data classes alone; arrays in one order of bytes, whatever their flags."""
        if isinstance(thing, np.ndarray):
            return _Content, (thing.dtype.str, thing.shape, thing.tobytes())
        if dataclasses.is_dataclass(thing) and not isinstance(thing, type):
            fields = [(each.name, getattr(thing, each.name)) for each in dataclasses.fields(thing) if each.init]
            return _Content, (type(thing).__qualname__, fields)
        return NotImplemented


class _Hash:
    """A file of which the hash alone is kept."""

    def __init__(self):
        self.hash = hashlib.sha256()

    def write(self, data: Any) -> int:
        """Add bytes, as a file does; a large array comes as a buffer."""
        self.hash.update(data)
        return memoryview(data).nbytes
