"""Laser ranges along given directions: the public name of what `engines.rays.laser_ranges` does."""

from .engines.rays.laser_ranges import RangeNoise, Ranges, laser_ranges

__all__ = ["RangeNoise", "Ranges", "laser_ranges"]
