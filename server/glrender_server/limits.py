"""Every bound of the service in one place: `hello` sends them, `docs/service.md` lists them.

A client that exceeds one is answered `busy` with the time after which to ask again, is refused by name, or is hung up
on; the others are served meanwhile.
"""

from __future__ import annotations

import functools
import resource
from collections.abc import Callable

MAX_HEADER_BYTES = 1 << 20
"""Largest header of a request."""
MAX_VALUES = 60_000
"""Entries of all lists and maps of a header together: the 10,000 directions of a `range` have 40,000."""
MAX_FIELDS = 64
"""Fields of a header itself: the operation with most has 24."""
MAX_DEPTH = 16
"""Lists and maps of a header inside each other: a scene has 6."""

MAX_WAITING = 1024
"""Requests that wait for a renderer, of all clients: more than there may be connections, so that each has a place."""
MAX_WAITING_BYTES = 1 << 26
"""Their headers together."""
MAX_COPIES = 16
"""Copies of one request under way that get its reply."""
SPARE_OPERATIONS = ("hello", "status", "close")
"""Operations that are answered where all connections are at work."""
MAX_TURN = 32
"""Connections that are accepted over TCP before others have their turn."""

MAX_UNTAKEN_BYTES = 1 << 26
"""Replies that one client has not taken; its next frame is answered `busy`."""
MAX_UNTAKEN_BYTES_IN_ALL, FEW_UNTAKEN_BYTES = 15 << 26, 1 << 20
"""Untaken replies of all clients together, 1 GiB with the objects around them; beyond it only clients that have few
left to take get frames."""


def is_too_much(own: int, in_all: Callable[[], int]) -> bool:
    """Whether no reply may be added to these bytes that a client has not taken, of those that all have not taken."""
    return own > MAX_UNTAKEN_BYTES or (own > FEW_UNTAKEN_BYTES and in_all() > MAX_UNTAKEN_BYTES_IN_ALL)


MAX_UNFINISHED_BYTES = 1 << 23
"""Parts of a message that one client has begun over ZeroMQ and not finished."""
MAX_UNFINISHED_BYTES_IN_ALL = 1 << 26
MAX_KEPT_REPLIES, MAX_KEPT_BYTES = 64, 1 << 28
"""The last replies that are kept for clients that ask again."""

MAX_WATCHED_FRAMES, MAX_WATCHED_BYTES = 8, 1 << 27
"""The newest frames that are kept for those who watch, each of another client or other cameras."""
WATCHED_BYTES_PER_S, CURVE_COST = 1 << 26, 16
"""Pixels for all who watch that go over sockets: a hundredth of one core; an encrypted byte counts as so many. Those
that are read in shared memory are not counted."""
BACKGROUND_SHARE, BACKGROUND_IDLE_S = 0.005, 2.0
"""The part of the time that frames of the background may take while others ask, and the time without a request after
which nobody does."""

MAX_FRAME_BYTES = 4 * 1024**3
"""Most memory that one request's images and products may take while they are made."""
MAX_ARRAYS = 15
"""Images and products of one reply: a message has at most 16 parts, and the first is the header."""

MAX_SCENE_PIXELS = 1 << 26
"""All cameras of a scene that came over the wire; with margins and the cells of distortion twice as many."""
MAX_SCENE_FACETS = 10_000_000
MAX_SCENE_BODIES = 64
MAX_SCENE_CAMERAS = 64
MAX_SCENE_SOURCES = 64
"""Sources of all comae of a scene, and its lamps."""
MAX_SCENE_GRAINS = 5_000_000
"""Grains of all tails of a scene: as many as one tail may have."""
MAX_SCENE_CELLS = 1 << 24
"""Cells of all tails and grids of dust: as many as one grid may have, or four of the finest tails."""
MAX_SCENE_TEXTURE_PIXELS = 1 << 27
"""Pixels of all textures of a scene: as many as one may have, half a gibibyte."""

LOG_LINES, LOG_PERIOD_S = 10, 10.0
"""Lines of one kind that are logged in a period; the next one says how many were left out."""
MAX_METRICS_CONNECTIONS = 16

_MAX_CONNECTIONS, _MAX_TCP_CONNECTIONS = 512, 128
# A worker takes about eight descriptors, a slot of shared memory two.
_SHARE_OF_DESCRIPTORS = 0.4


@functools.cache
def max_connections() -> tuple[int, int]:
    """Connections over ZeroMQ and over TCP for which this process has descriptors; it first asks for all it may have.

    Beyond them the connection that has been silent longest is closed for a new one.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY and soft < hard:
        soft = min(hard, 1 << 16)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    of_zmq = min(_MAX_CONNECTIONS, int(_SHARE_OF_DESCRIPTORS * soft))
    return of_zmq, min(_MAX_TCP_CONNECTIONS, of_zmq // 2)


def described() -> dict[str, int | float]:
    """The bounds as `hello` sends them."""
    of_zmq, of_tcp = max_connections()
    return {"max_header_bytes": MAX_HEADER_BYTES, "max_values": MAX_VALUES, "max_depth": MAX_DEPTH,
            "max_waiting": MAX_WAITING, "max_untaken_bytes": MAX_UNTAKEN_BYTES, "max_connections": of_zmq,
            "max_tcp_connections": of_tcp, "max_image_pixels": MAX_SCENE_PIXELS, "max_scene_facets": MAX_SCENE_FACETS,
            "max_scene_bodies": MAX_SCENE_BODIES, "max_scene_cameras": MAX_SCENE_CAMERAS,
            "max_scene_sources": MAX_SCENE_SOURCES, "max_scene_grains": MAX_SCENE_GRAINS,
            "max_scene_cells": MAX_SCENE_CELLS, "max_scene_texture_pixels": MAX_SCENE_TEXTURE_PIXELS,
            "max_fields": MAX_FIELDS, "max_frame_bytes": MAX_FRAME_BYTES, "max_arrays": MAX_ARRAYS}
