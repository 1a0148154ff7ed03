"""What a frame models, what it leaves out, and the error that is expected of it: plain data."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from .eclipses import NO_ECLIPSE, Eclipse
from .emission_frame import EmissionPlan

EMISSION_LEFT_OUT = "emission around"
"""How a plan begins to say that light which no surface scatters is not in the image."""


@dataclass(frozen=True, kw_only=True)
class BodyPlan:
    """What is modelled of one body."""

    name: str
    is_visible: bool
    n_facets: int
    level: int
    """Level of detail: 0 is the full shape."""
    law: str
    shadow_map_px: int | None
    """Texels of the shadow map across the body; None where nothing can cast on it."""
    shadow_map_reused: bool
    relative_to_camera: bool
    normal_lookup: bool
    size_px: float
    """Larger side of the outline's box [px]."""
    flux_ratio: float = 1.0
    """Of the full shape over the level: the level's irradiance is multiplied by it."""
    modelling_error: float = 0.0
    """RMS error that samples do not cure: of the level, of the shadow map's texels."""
    penumbra_px: float = 0.0
    """Width of the widest penumbra [px]: rays have them, shadow maps and areas have hard edges."""
    penumbra_error: float = 0.0
    """RMS error of hard edges in its place, before anything is drawn: areas tell better."""
    casters: tuple[str, ...] = ()
    """Other bodies that may cast a shadow on it."""
    eclipse: Eclipse = NO_ECLIPSE
    """What those shadows do to it; its error is a part of the penumbras'."""
    shown_share: float = 1.0
    """Of the facets, those in chunks that are not out of view."""
    shadow_map_drawn_px: tuple[int, int] = (0, 0)
    """Texels that there are of the shadow map: of what is seen of the body, along x and y."""
    detail_m: float | None = None
    """Scale of the finest surface detail that is drawn [m]; None without any."""
    detail_layers: int = 0
    detail_slope: float = 0.0
    """RMS slope of that detail."""


@dataclass(frozen=True, kw_only=True)
class LevelPlan:
    """What areas draw of a body: its full shape, or a level of detail."""

    number: int = 0
    """0 is the full shape."""
    has_relief: bool = False
    """Whether its facets are as bright as what they stand for, or flat."""
    by_middles: bool = False
    """Whether facets are as lit as their middles are, or cut at the edges of light."""
    flux_ratio: float = 1.0
    """Of the full shape over the level: its light is multiplied by it."""
    n_points: int = 0
    """Of the middles, so many that stand for all: 0 for all of them."""

    @property
    def tells_error(self) -> bool:
        """Whether an image of a body that is alone in its scene tells its error: that of others is measured once."""
        return self.by_middles and not self.number and not self.n_points


@dataclass(frozen=True, kw_only=True)
class WindowPlan:
    """One part of the image that is drawn at once: bodies whose outlines' boxes touch.

    Attributes
    ----------
    bodies : tuple of str
    engine : "raster", "rays" or "areas"
        Triangles drawn by OpenGL, rays cast at them, or their sunlit areas shared among the pixels: whichever is
        fastest here.
    roi : (int, int, int, int) [px]
        Pixels that it touches: x0, y0, x1, y1, one past the last.
    samples : int
        Along each side of a pixel, 1 of areas, which take each pixel as a whole; 0 for a body so small that it has a
        grid of its own.
    bounds_px : (float, float, float, float) [px]
        What is drawn: the region's edges, or the small body's box.
    grid : (int, int)
        Samples across and down.
    budget : float [1]
        Error above which pixels are drawn again with more samples; infinite for never.
    modelling_error : float [1]
        What samples do not cure, but for the edges of shadows: levels of detail, light that leaks, penumbras.
    shadow_share : float [1]
        Of one sample's squared error, as the image tells it: left by the shadow maps' texels.
    texel_share : float [1]
        The same of what of it sits at the edges of shadows.
    noise : (float, float) [rad], [1]
        Angle of the creases between facets, and facets a pixel: arguments of `noise_gain`.
    predicted_error : float [1]
    levels : tuple of LevelPlan
        Of areas: what is drawn of each body; empty otherwise.
    """

    bodies: tuple[str, ...]
    engine: str
    roi: tuple[int, int, int, int]
    samples: int
    bounds_px: tuple[float, float, float, float]
    grid: tuple[int, int]
    budget: float
    modelling_error: float
    noise: tuple[float, float]
    shadow_share: float
    texel_share: float
    predicted_error: float
    rays_at_facing: bool = False
    """Whether rays are cast only where an image without shadows sees something that faces the Sun."""
    refined_samples: int = 0
    """Samples along the side of the pixels that were drawn again; 0 for none."""
    refined_share: float = 0.0
    """Of the region's pixels."""
    levels: tuple[LevelPlan, ...] = ()
    flux_error: float = 0.0
    """At most, of an own grid with fewer samples than a flux within a tenth of the budget asks for; 0 elsewhere."""


@dataclass(frozen=True, kw_only=True)
class RenderPlan:
    """What a frame models, what it leaves out, and the error that is expected of it.

    Attributes
    ----------
    roi : (int, int, int, int) [px]
        Region outside which the image is zero: x0, y0, x1, y1, one past the last; all zero when
        nothing is in view.
    windows : tuple of WindowPlan
        What is drawn of it.
    predicted_error : float [1]
        RMS irradiance error over the mean of the lit pixels.
    left_out : tuple of str
    warnings : tuple of str
        What is used beyond its range.
    emission : tuple of EmissionPlan
        What plug-ins added to it.
    """

    camera: str
    max_error: float
    roi: tuple[int, int, int, int]
    windows: tuple[WindowPlan, ...]
    predicted_error: float
    bodies: tuple[BodyPlan, ...]
    left_out: tuple[str, ...] = field(default=())
    warnings: tuple[str, ...] = field(default=())
    emission: tuple[EmissionPlan, ...] = field(default=())

    @property
    def samples(self) -> int:
        """Most samples along a pixel's side in any window."""
        return max((window.samples for window in self.windows), default=0)

    def to_dict(self) -> dict[str, Any]:
        """Plain data, for the wire."""
        return asdict(self)
