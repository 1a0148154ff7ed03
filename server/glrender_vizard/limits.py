"""Every bound of the adapter in one place: those of the server's scenes, and those for Basilisk alone."""

from __future__ import annotations

from glrender_server.limits import MAX_SCENE_BODIES, MAX_SCENE_CAMERAS, MAX_SCENE_PIXELS

__all__ = ["MAX_SCENE_BODIES", "MAX_SCENE_CAMERAS", "MAX_SCENE_PIXELS"]

MAX_MESSAGE_BYTES = 1 << 22
"""Largest update: some ten thousand spacecraft."""
MAX_FIELDS = 60_000
"""Fields of one message and of all inside it: a thousand spacecraft have 30,000."""
MAX_NAME_CHARACTERS = 128
"""Longest name of a body, a spacecraft or a camera's parent, as for the server's clients."""
MAX_PATH_CHARACTERS = 4096
"""Longest path of a custom model's file: Linux's PATH_MAX."""
MAX_BODIES = MAX_SCENE_BODIES + 1
"""Bodies of an update: those of a scene, and the Sun."""
MAX_MODELS = 1024
"""Custom models of an update: each may be a spacecraft's."""
MAX_SPACECRAFT = 10_000

MAX_SIMULATIONS = 1024
"""Whose last update is kept; Basilisk's every reset makes a new connection and leaves the old one."""
MAX_UPDATE_BYTES = 1 << 28
"""All updates that are kept, and the settings that still hold."""
MAX_CACHED_BYTES = 1 << 26
"""Pictures that are kept, as they may be asked for again: Basilisk's examples ask twice."""
MAX_SCENES = 8
"""Scenes that are open together: each has a process at least."""
LEAST_WORKER_BYTES = 3 << 29
"""Data of a process that draws, where fewer scenes are open for it: a small scene has 0.8 GiB."""
MAX_NOTE_CHARACTERS = 300
"""Longest line of the log about a simulation."""
