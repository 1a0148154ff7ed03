"""What a server answers, without one."""

from __future__ import annotations

import tomllib

import msgpack
import pytest
import serving
from glrender import Scene
from glrender_server.operations import Operations


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """ask(op, **fields): the header of a reply, its arrays' bytes behind it, from what serves in a server."""
    operations = Operations(Scene.from_dict(tomllib.loads(serving.SCENE)))

    def ask(op, **fields):
        parts, *_ = operations.answer({"v": 1, "id": 1, "client": "test", "op": op, **fields})
        return msgpack.unpackb(parts[0]), [bytes(part) for part in parts[1:]]

    yield ask
    operations.close()
