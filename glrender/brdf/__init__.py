"""Reflectance laws in float64, one file each; no GL."""

from .akimov import Akimov
from .curve import Table
from .hapke import Hapke
from .lambert import Lambert
from .law import GlslText, Law
from .lommel_seeliger import LommelSeeliger
from .lunar_lambert import LunarLambert
from .microfacet import Microfacet
from .minnaert import Minnaert
from .oren_nayar import OrenNayar
from .rolo import Rolo

__all__ = ["Akimov", "GlslText", "Hapke", "Lambert", "Law", "LommelSeeliger", "LunarLambert", "Microfacet",
           "Minnaert", "OrenNayar", "Rolo", "Table"]
