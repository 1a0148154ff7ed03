"""Rays by Embree: visibility, laser ranges, the reference ray tracer."""
