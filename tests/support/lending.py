"""A scene whose images are large enough to be left in shared memory, and parts lent in a slot of it."""

from __future__ import annotations

import serving
from glrender_server import slots
from glrender_server.slots import offsets, room

# Images above the size from which they are left in place.
SCENE = serving.SCENE.replace("= 96", "= 256").replace("= 64", "= 192").replace("= 32\n", "= 160\n")
ENOUGH = slots.MIN_SHARED_BYTES
STATE = {"t_s": 0.0, "r_sun_inertial_m": [1e11, 0.0, -1.1e11],
         "spacecraft": {"r_inertial_m": [0.0, 0.0, -2000.0], "q_from_inertial": [1.0, 0.0, 0.0, 0.0]},
         "bodies": {"body": {"r_inertial_m": [0.0, 0.0, 0.0], "q_from_inertial": [1.0, 0.0, 0.0, 0.0]}}}


def lent(store, *parts):
    """Parts in a slot of a store: the store's own views, and the place."""
    sizes = [len(part) for part in parts]
    slot = store.take(offsets(sizes)[-1])
    for place, part in zip(room(slot, sizes), parts, strict=True):
        place[:] = part
    return store.lend(slot, sizes)
