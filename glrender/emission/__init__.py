"""Coma emission, a plug-in of the group `glrender.emission`: dust around a body, by a line integral on the GPU."""

from .coma import Coma
from .dust import Dust

__all__ = ["Coma", "Dust"]
