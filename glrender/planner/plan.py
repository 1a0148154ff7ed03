"""The plan of a frame: what is modelled, what is left out, and the predicted error. Plain data."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from glrender_camera.notebook import table

from .error_budget import Budget
from .error_model import centroids
from .penumbra import Penumbra

Target = Literal["region", "own_grid", "point"]
"""What of an image a window draws: pixels; a small body's own grid, whose light its pixels share; or points of that."""
# Lines of a plan as text.
_MOST_LINES = 10
ONE_DIRECTION, SLIVERS, CENTROIDS = "one direction to the Sun", "slivers", "centroids"
"""Causes of error: one that no point spread function averages, and two of which all of a body's light errs."""
UNEVEN = "uneven facets"
"""The cause of error that rays may cure in the pixels that they settle."""
LEAK, HARD = "shadow map", "hard edges"
"""Causes of error that rays measure where a part of a body is seen: light that leaks through its shadow map, and hard
edges in place of penumbras."""
PASSED_BY = "parts between samples"
"""The cause of error that rays from facets cure."""
EMISSION_LEFT_OUT = "emission around"
"""How a plan begins to say that light which no surface scatters is not in the image."""


@dataclass(frozen=True, kw_only=True)
class BodyPlan:
    """The features of one body that are modelled."""

    name: str
    is_visible: bool
    n_facets: int
    law: str
    shadow_map_px: int | None
    """Texels of the shadow map across the body; None where nothing can cast on it, or no map is needed."""
    shadow_map_reused: bool
    relative_to_camera: bool
    """Whether OpenGL's coordinates are relative to the camera, or body-fixed."""
    normal_lookup: bool
    """Whether normals are looked up by facet, or are screen-space derivatives."""
    size_px: float
    """Larger side of the outline's box [px]."""
    modelled: Mapping[str, float] = field(default_factory=dict)
    """RMS errors [1] by OpenGL that samples do not cure, by cause, before the camera's PSF: of coordinates, shadow maps
    and hard edges."""
    penumbra: Penumbra = Penumbra()
    casters: tuple[str, ...] = ()
    """Other bodies that may cast a shadow on it."""
    shadow_map_drawn_px: tuple[int, int] = (0, 0)
    """Texels of the shadow map that were drawn, along x and y: those of the part of the body that is seen."""
    detail_m: float | None = None
    """Scale of the finest surface detail that is drawn [m]; None without any."""
    detail_layers: int = 0


@dataclass(frozen=True, kw_only=True)
class WindowPlan:
    """One region of the image: bodies whose outlines' boxes overlap are drawn together.

    Attributes
    ----------
    bodies : tuple of str
    engine : "coverage", "rays" or "raster"
        Exact area coverage of visible, sunlit facets; rays; or OpenGL with shadow maps.
    roi : (int, int, int, int) [px]
        Pixels of the region: x0, y0, x1, y1, one past the last.
    target : "region", "own_grid" or "point"
        Its pixels; a small body's own grid of cells or samples; or the same, which is then not in the image.
    samples : int
        Along each side of a pixel; 1 of coverage, which takes each pixel as a whole; 0 of a grid of its own.
    bounds_px : (float, float, float, float) [px]
        What is drawn: the region's edges, or the small body's box.
    grid : (int, int)
        Samples or cells across and down.
    budget : Budget
        Of errors before the camera's PSF; of a drawn frame after it.
    modelled : mapping of str to float [1]
        RMS errors that samples do not cure, by cause; of a drawn frame after the camera's PSF.
    modelled_flux : mapping of str to float [1]
        Errors of the total light that samples do not cure, by cause; no PSF averages them.
    drawn : mapping of str to float [1]
        RMS errors of the drawing, by cause, once it is drawn; likewise.
    by_centroids : bool
        Of coverage: whether each facet is lit or dark by its centroid, or clipped at shadow boundaries.
    has_planes : bool
        Of coverage: whether the radiance of a facet varies linearly, or is that of its centroid.
    shadow_share : float [1]
        Of one sample's squared error, what the shadow map's texels leave.
    noise : (float, float) [rad], [1]
        RMS angle between neighbouring facets, and facets a pixel: arguments of `error_model.noise_gain`.
    refined_samples : int
        Samples along the side of the pixels that were drawn again, by rays where coverage drew first; 0 for none.
    refined_share : float [1]
        Of the region's pixels or cells, those that were drawn again.
    eclipse_px : float [px]
        Width of the widest penumbra of another body that its rays meet; 0 for none.
    flux_error : float [1]
        Error of the total by points of the Sun's disc, or by hard edges of shadows, in other bodies' penumbras.
    why : str
        The reason for which this engine was chosen.
    """

    bodies: tuple[str, ...]
    engine: str
    roi: tuple[int, int, int, int]
    samples: int
    bounds_px: tuple[float, float, float, float]
    grid: tuple[int, int]
    budget: Budget
    target: Target = "region"
    modelled: Mapping[str, float] = field(default_factory=dict)
    modelled_flux: Mapping[str, float] = field(default_factory=dict)
    drawn: Mapping[str, float] = field(default_factory=dict)
    by_centroids: bool = False
    has_planes: bool = False
    shadow_share: float = 0.0
    noise: tuple[float, float] = (0.0, 0.0)
    refined_samples: int = 0
    refined_share: float = 0.0
    eclipse_px: float = 0.0
    flux_error: float = 0.0
    why: str = ""

    @property
    def modelling_error(self) -> float:
        """RMS error [1] that samples do not cure; errors of the total over its share, as the tolerance judges them."""
        return self.budget.rms_of(self.modelled, self.modelled_flux)

    @property
    def causes(self) -> dict[str, float]:
        """The parts [1] of `predicted_error` by cause."""
        of_flux = {cause: self.budget.rms_of({}, {cause: error}) for cause, error in self.modelled_flux.items()}
        return {**self.modelled, **of_flux, **self.drawn}

    @property
    def predicted_error(self) -> float:
        """RMS error [1] over the mean of the lit pixels."""
        return math.hypot(*self.causes.values())

    @property
    def how(self) -> str:
        """The engine; "centroids", or "rough centroids" of rough facets."""
        return centroids(self.noise[0]) if self.by_centroids else self.engine

    @property
    def method(self) -> str:
        """How it is drawn, in words."""
        if self.engine == "coverage":
            how = "lit or dark by their centroids" if self.by_centroids else "clipped at shadow boundaries"
            settled = f", {100.0 * self.refined_share:.2g} % of the pixels by rays" if self.refined_share else ""
            return f"exact area coverage, facets {how}{settled}"
        name = {"rays": "rays", "raster": "OpenGL"}[self.engine]
        grid = f"a grid of {self.grid[0]} x {self.grid[1]}" if self.target != "region" else \
            f"{self.samples} x {self.samples} samples a pixel"
        return f"{name}, {grid}"


@dataclass(frozen=True, kw_only=True)
class EmissionPlan:
    """The account of one emission, for the plan that a reply carries.

    Attributes
    ----------
    kind, body : str
    modelled : dict
        Plain data: models, steps, resolution, ...
    predicted_error : float [1]
        RMS error of its light over the light's mean.
    milliseconds : float [ms]
        What it cost.
    left_out : tuple of str
    """

    kind: str
    body: str
    modelled: dict[str, Any]
    predicted_error: float
    milliseconds: float
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class RenderPlan:
    """A frame's account of its models, of those that it leaves out, and of the error that is expected.

    Attributes
    ----------
    roi : (int, int, int, int) [px]
        Region outside which the image is zero: x0, y0, x1, y1, one past the last; all zero when
        nothing is in view.
    windows : tuple of WindowPlan
        What is drawn of it.
    max_error : float [1]
        RMS error that the frame was drawn for: what was asked for in other units amounts to that at least.
    predicted_error : float [1]
        RMS irradiance error over the mean of the lit pixels.
    navigation : mapping
        The same in the further units of `tolerance.UNITS`: of the region that has most of each.
    asked : mapping
        The tolerance by unit; `max_error` as `rms` by default.
    promised : mapping
        The least error by unit that is predicted of any frame of this view: no tolerance below it is met.
    way_out : str
        For the caller of a frame that misses its tolerance; empty where that is no surprise, as of samples that were
        asked for.
    left_out : tuple of str
    warnings : tuple of str
        What is used beyond its range.
    emission : tuple of EmissionPlan
        What plug-ins added to it.
    milliseconds : float [ms]
        What the frame took.
    jacobian_error : mapping of str to float [1]
        Errors expected of the derivatives that were asked for, by name: RMS over their own RMS, before the PSF.
        Most of it is in a hundredth of the lit pixels: shadows that pass between corners unseen, as in the image.
    memory_bytes : mapping of str to int [byte]
        What the frame took beyond the memory that the renderer opened with: `near_facets`, which rays meet about the
        camera, without Embree's tree, and `shadow_maps`.
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
    navigation: Mapping[str, float] = field(default_factory=dict)
    asked: Mapping[str, float] = field(default_factory=dict)
    jacobian_error: Mapping[str, float] = field(default_factory=dict)
    promised: Mapping[str, float] = field(default_factory=dict)
    way_out: str = ""
    milliseconds: float = field(default=0.0, compare=False)
    memory_bytes: Mapping[str, int] = field(default_factory=dict, compare=False)

    def __post_init__(self):
        if not self.asked:
            object.__setattr__(self, "asked", {"rms": self.max_error})

    @property
    def predicted(self) -> dict[str, float]:
        """Predicted errors by unit: `tolerance.UNITS`."""
        return {"rms": self.predicted_error, **self.navigation}

    @property
    def missed(self) -> tuple[str, ...]:
        """Units whose predicted error exceeds the tolerance that was asked for."""
        predicted = self.predicted
        return tuple(unit for unit, most in self.asked.items() if predicted.get(unit, 0.0) > most * (1.0 + 1e-6))

    def misses(self) -> dict[str, str]:
        """A warning for each unit of `missed`; none where there is no way out."""
        return {unit: self.miss(unit, self.way_out) for unit in self.missed if self.way_out}

    def miss(self, unit: str, way_out: str) -> str:
        """A warning of a unit that is missed, with the least error that is predicted in place of a vain way out."""
        asked, least = self.asked[unit], self.promised.get(unit, 0.0)
        end = f"the least predicted of any frame of this view is {least:.2g}" if asked <= least else way_out
        name = "error" if unit == "rms" else unit
        return f"predicted {name} {self.predicted[unit]:.2g} exceeds max_error {asked:g}; {end}"

    @property
    def excess(self) -> float:
        """The largest ratio [1] of a predicted error to the tolerance that was asked for."""
        predicted = self.predicted
        return max(predicted.get(unit, 0.0) / most for unit, most in self.asked.items())

    @property
    def samples(self) -> int:
        """Most samples along a pixel's side in any window."""
        return max((window.samples for window in self.windows), default=0)

    def __str__(self) -> str:
        """At most ten lines: errors, engines and why, bodies, what is left out, warnings."""
        told = {unit: f"{unit.removesuffix('_px')} {_amount(unit, error)}"
                + (f" ({_amount(unit, self.asked[unit])} allowed)" if unit in self.asked else "")
                for unit, error in self.predicted.items()}
        lines = [f"camera {self.camera}: predicted RMS error{told.pop('rms')[3:]} of the mean lit pixel; "
                 f"{self.milliseconds:.3g} ms"]
        if told:
            lines.append(f"predicted {', '.join(told.values())}")
        if self.jacobian_error:
            each = ", ".join(f"{name} {_amount('rms', error)}" for name, error in self.jacobian_error.items())
            lines.append(f"predicted error of derivatives: {each}")
        if not any(body.is_visible for body in self.bodies):
            lines.append("nothing is in view")
        sizes = {body.name: f"{body.name} ({body.n_facets} facets, {body.size_px:.0f} px, {body.law})"
                 for body in self.bodies}
        lines += [f"{', '.join(sizes[name] for name in window.bodies)}: {window.method}, "
                  f"{100.0 * window.predicted_error:.2g} %{_spent(window)}{f'; {window.why}' if window.why else ''}"
                  for window in self.windows]
        lines += [f"emission of {added.body}: {added.kind}, {100.0 * added.predicted_error:.2g} %"
                  for added in self.emission]
        if self.left_out:
            lines.append(f"left out: {', '.join(self.left_out)}")
        lines += [f"warning: {text}" for text in self.warnings]
        return "\n".join(lines if len(lines) <= _MOST_LINES else
                         [*lines[:_MOST_LINES - 1], f"and {len(lines) - _MOST_LINES + 1} more: to_dict() has all"])

    def _repr_html_(self) -> str:
        """For notebooks: the lines of the plan as a table."""
        first, *lines = str(self).splitlines()
        return table(first, (line.partition(": ")[::2] for line in lines))

    def to_dict(self) -> dict[str, Any]:
        """Plain data, for the wire: None in place of infinite numbers, which JSON does not have."""
        told = asdict(self)
        del told["navigation"], told["way_out"]
        if not self.jacobian_error:
            del told["jacobian_error"]
        windows = [{**each, "predicted_error": window.predicted_error}
                   for each, window in zip(told["windows"], self.windows, strict=True)]
        bodies = [{**each, "penumbra_px": body.penumbra.width_px}
                  for each, body in zip(told["bodies"], self.bodies, strict=True)]
        return _finite({**told, "windows": windows, "bodies": bodies, "predicted": self.predicted,
                        "missed": self.missed})


def _finite(value: Any) -> Any:
    """Plain data with None in place of each number that is not finite."""
    if isinstance(value, dict):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(_finite(each) for each in value)
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _spent(window: WindowPlan) -> str:
    """The causes of a window's error, the largest first, without those below a tenth of it."""
    causes = sorted(window.causes.items(), key=lambda each: -each[1])
    told = [f"{cause} {100.0 * error:.2g}" for cause, error in causes if error > 0.1 * window.predicted_error]
    return f" ({', '.join(told)})" if len(told) > 1 else ""


def _amount(unit: str, error: float) -> str:
    return f"{error:.2g} px" if unit.endswith("_px") else f"{100.0 * error:.2g} %"
