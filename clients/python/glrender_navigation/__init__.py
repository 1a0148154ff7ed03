"""On-board vision and navigation about small bodies, by OpenCV and SciPy. ::

    from glrender_navigation import ESTIMATORS, BelievedBody, Camera, Navigator
    estimator = ESTIMATORS["limb_shape"](camera, body)
    found = estimator.measure(frame, believed_state, partial(client.render, camera="navcam", max_error=0.1))
    found or estimator.reason

It knows frames and believed states, a client's `render` of the believed scene, and nothing of the renderer or of the
truth. Each name is loaded when it is first asked for.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .body import BelievedBody
    from .camera import Camera, Sight, moved, sight
    from .estimators import ESTIMATORS
    from .filter import Innovation, Navigator
    from .measurement import Estimator, Measurement, NotFound

_NAMES = {".body": ("BelievedBody",), ".camera": ("Camera", "Sight", "moved", "sight"), ".estimators": ("ESTIMATORS",),
          ".filter": ("Innovation", "Navigator"), ".measurement": ("Estimator", "Measurement", "NotFound")}
_HOMES = {name: module for module, names in _NAMES.items() for name in names}
__all__ = ["ESTIMATORS", "BelievedBody", "Camera", "Estimator", "Innovation", "Measurement", "Navigator", "NotFound",
           "Sight", "moved", "sight"]


def __getattr__(name: str):
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = found = getattr(import_module(_HOMES[name], __name__), name)
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
