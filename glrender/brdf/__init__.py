"""Reflectance laws in float64, one file each; no GL."""

from .curve import Table
from .hapke import Hapke
from .lambert import Lambert
from .law import Law
from .lommel_seeliger import LommelSeeliger
from .lunar_lambert import LunarLambert

__all__ = ["Hapke", "Lambert", "Law", "LommelSeeliger", "LunarLambert", "Table"]
