"""What drawing costs on a machine, as the planner reckons it. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from .ray_engine import RAYS_AT_ONCE

RASTER_CALL_NS, RAYS_CALL_NS = 1.2e6, 4e5
"""Nanoseconds whatever is drawn, of a pass of OpenGL (an image, a shadow map) or of rays."""


@dataclass(frozen=True, kw_only=True)
class EngineCosts:
    """Nanoseconds that drawing takes on a machine: measured by `engine_costs`.

    Attributes
    ----------
    facet_ns : float
        Of a facet in a pass of OpenGL, whether seen or not.
    sample_ns : float
        Of a sample that OpenGL shades.
    ray_ns : float
        Of a sample that meets a body, with its ray to the Sun, by all threads; infinite without rays.
    lone_ray_ns : float
        Of one among few, which a single thread casts.
    """

    facet_ns: float
    sample_ns: float
    ray_ns: float
    lone_ray_ns: float = 0.0

    def rays_ns(self, n_rays: float) -> float:
        """Of a window with so many samples that meet a body."""
        return RAYS_CALL_NS + max(n_rays * self.ray_ns, min(n_rays, RAYS_AT_ONCE) * self.lone_ray_ns)
