"""Reflectance laws in float64, one file each; no GL."""

from .lambert import Lambert
from .law import Law

__all__ = ["Lambert", "Law"]
