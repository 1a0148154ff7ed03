"""The engines that may draw each region of an image, in the order in which they are tried. Pure.

The rule is the same on every machine. Exact coverage draws bodies of flat facets that are wholly before the camera: by
centroids first, and clipped where the estimated error exceeds the tolerance. Rays draw large shapes of which more than
`MOST_FACETS_PER_PX` facets share a pixel. OpenGL draws the rest, or rays where no shadow map is fine enough. With a GPU
OpenGL comes first.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from glrender_camera import PinholeCamera

from ..view.regions import outline, outline_px, region, touching
from ..view.view import BodyView
from .error_budget import CELL_SHARE, FLUX_SHARE, PENUMBRA_SHARE, SAMPLES_SHARE, Budget
from .error_model import CRESCENT_RAD, BodyTraits, facets_per_px, parallel_error, ray_rounding_error
from .plan import ONE_DIRECTION, BodyPlan, WindowPlan
from .predicted import allowed_rms
from .small_body_grid import CELL_PX, MAX_RAYS_ACROSS, cell_error, cell_size, samples_across, sampling_errors

ENGINES = ("coverage", "rays", "raster")
"""Names that `engine=` may have."""
MAX_SAMPLES = 16
"""Most samples along a pixel's side by OpenGL."""
MOST_FACETS_PER_PX = 300.0
"""Facets that face Sun and camera, a pixel, from which rays are cheaper than coverage, by the cells of
benchmarks/bench_cells.py."""
MOST_FIRST_SAMPLES = 2**20
"""Rays of a whole region at first: of 1024 x 1024 px one each tells as much (benchmarks/cliffs.py), in 0.3 s. By OpenGL
four times as many samples take less."""
FEWEST_FACETS_FOR_RAYS = 100_000
"""Facets from which that holds: fewer cost coverage no more than the rays that a flux asks for, by the same cells."""
# Side [px] of an outline below which a body has a grid of its own.
_SMALL_PX = 4.0
# Side [px] of an outline up to which the samples must hold the flux as well: larger bodies have enough for the image.
_FLUX_PX = 32.0
# Widest of a crescent apart over a full disc apart [1]: its own grid has only so many samples.
_MOST_LARGER = 4.0
# Error of cells of several bodies over that of one [1]: pairs with a gap between them (test_small_bodies.py).
_SEVERAL_CELLS = 2.7
# Cells across a small body's own grid, at most.
_MOST_CELLS = 2048
# First samples along a pixel's side; and of narrow crescents and eclipses, whose light, or its loss, is in few pixels.
_FIRST_SAMPLES = 2
_MORE_SAMPLES = 4
# RMS distance from the centroid of an equilateral triangle over the root of its area [1]: 0.31 along each axis.
_UNEVEN_FACET = 0.44
# Variation of a pixel's solid angle within it over its angle [1]: above 3 tan(theta) / sqrt(12), off the boresight.
_UNEVEN_PIXEL = 0.3
# RMS error (ten times that of the flux) times the cube of the angle from a phase of 180 deg [rad^3]: a rough binary at
# 165, 172, 175 deg loses 0.37, 0.86, 3.5 % of its light.
_CRESCENT_LOSS = 6.6e-4
# Phase angle [rad] anywhere on a body beyond which a facet's centroid does not tell of slivers of light on it.
_CENTROIDS_RAD = 2.15
# Error [1] of centroid visibility that the image does not tell, ten times that of the flux: at a phase of 60 deg (cells
# of benchmarks/bench_cells.py), and its power of the tangent of half the phase (a rough binary at 100 deg: seed 178 of
# benchmarks/heldout.py).
_CENTROIDS_LEAST = 0.006
_CENTROIDS_POWER = 3.0
# Fewest facets a pixel [1]: of larger ones few are at the boundary of light (seed 100 of
# benchmarks/heldout.py).
_LEAST_FACETS_PER_PX = 0.05
# Rays that the first samples of an eclipse may take.
_ECLIPSE_RAYS = 100_000
# A body's own penumbras by rays are noise: crease [rad] and facets a pixel that say so to `error_model.noise_gain`.
_PENUMBRA_NOISE = (math.inf, math.inf)


@dataclass(frozen=True, kw_only=True)
class Request:
    """A frame's demands on all its regions.

    Attributes
    ----------
    camera : PinholeCamera
    budget : Budget
        Of its errors before the camera's PSF, which leaves that of the flux as it is.
    error_gain : float [1]
        What the PSF leaves of an error that is independent from pixel to pixel.
    engines : tuple of str
        Out of `ENGINES`: those that are there.
    has_gpu : bool
    samples : int or None
        Along a pixel's side, asked for instead of the planner's choice: drawn by OpenGL.
    engine : str or None
        The only engine that may draw.
    apart_px : float [px]
        Bodies of a smaller `apart_size_px` have a grid of their own in any case.
    asked : mapping, optional
        Tolerances by unit, in place of the budget's, which follows from them for each engine and its bodies.
    """

    camera: PinholeCamera
    budget: Budget
    error_gain: float = 1.0
    engines: tuple[str, ...] = ENGINES
    has_gpu: bool = False
    samples: int | None = None
    engine: str | None = None
    apart_px: float = 0.0
    asked: Mapping[str, float] | None = None

    def of(self, members: Sequence[BodyView], how: str) -> Request:
        """The request with the RMS error that bodies may have which are drawn so: "centroids", or an engine's name."""
        if self.asked is None:
            return self
        allowed, bare = (allowed_rms(self.asked, members, self.camera, how, gain) for gain in (self.error_gain, 1.0))
        return replace(self, budget=Budget(tolerance=allowed, flux=FLUX_SHARE * bare,
                                           flux_asked=self.asked.get("flux", math.inf)))


def plan_windows(views: Sequence[BodyView], traits: Mapping[str, BodyTraits], bodies: Sequence[BodyPlan],
                 request: Request) -> list[list[WindowPlan]]:
    """For each region of overlapping bodies, the ways to draw it in the order in which they are tried.

    Bodies far apart in the image are drawn apart, so that the cost follows their pixels; a body smaller than a few
    pixels is drawn on a grid of its own that fits its outline. A region has no way where `engine` cannot draw it.
    """
    plans = {body.name: body for body in bodies}
    return [_options(members, traits, [plans[view.name] for view in members], request)
            for members in touching(views, request.camera)]


def apart_limit(views: Sequence[BodyView], apart_px: float) -> float:
    """`apart_size_px` below which bodies are apart, so that together they cover no more than one of `apart_px`.

    A body has a point for each 0.3 px: what spreads them is to cost as much for many bodies as for one.
    """
    covered = 0.0
    for size_px in sorted(size for view in views if view.is_visible and (size := apart_size_px([view])) < apart_px):
        covered += size_px**2
        if covered > apart_px**2:
            return size_px
    return apart_px


def apart_size_px(views: Sequence[BodyView]) -> float:
    """Size [px] of the full disc that has as much light as bodies that are drawn together, about.

    A crescent has few pixels, and an image errs the more: at 24 px by 0.4 % of its mean at 20 deg, 7 % at 150 deg.
    """
    size_px = outline_px(views)
    return max(size_px * max(math.cos(0.5 * view.phase_rad) for view in views), size_px / _MOST_LARGER)


def facing_share(phase_rad: float) -> float:
    """The share of a body's facets that faces both camera and Sun, about."""
    return (math.pi - phase_rad) / (2.0 * math.pi)


def _options(members: Sequence[BodyView], traits: Mapping[str, BodyTraits], drawn: Sequence[BodyPlan],
             request: Request) -> list[WindowPlan]:
    """Ways to draw bodies together, in order."""
    known = [_with_detail(traits[view.name], view, body, request.camera)
             for view, body in zip(members, drawn, strict=True)]
    if request.samples is not None:
        return [replace(_raster(members, known, drawn, request), why="samples were asked for")]
    makers = {"coverage": _coverage, "rays": _rays, "raster": _raster}
    made = {name: makers[name](members, known, drawn, request.of(members, name)) for name in request.engines
            if request.engine in (None, name)}
    coverage = made.get("coverage", [])
    rays = [made["rays"]] if made.get("rays") is not None else []
    raster = [made["raster"]] if "raster" in made else []
    is_in_penumbra = _are_in_penumbra(members, drawn, request.of(members, "raster"))
    is_fine_enough = (raster and raster[0].modelling_error <= raster[0].budget.tolerance and not is_in_penumbra)
    if request.engine is not None:
        options, why = [*coverage, *rays, *raster], "asked for"
    elif request.has_gpu and is_fine_enough:
        options, why = [*raster, *coverage, *rays], "there is a GPU, and its shadow map is fine enough"
    elif _is_crowded(members, known):
        options = [*rays, *coverage, *([] if rays else raster)]
        why = f"more than {MOST_FACETS_PER_PX:g} facets that face Sun and camera share a pixel"
    elif coverage:
        options, why = [*coverage, *rays], "evenly bright facets that are all before the camera"
    else:
        options, why = [*raster, *rays], _no_coverage(members, known, drawn, request.engines)
        if not is_fine_enough:
            options = rays or raster
            why = "a wide penumbra is on it" if is_in_penumbra else f"{why}, and no shadow map is fine enough"
    names = ["coverage by centroids" if option.by_centroids else option.engine for option in options]
    return [replace(option, why=f"{' and '.join(names[:index])} would miss the tolerance" if index else why)
            for index, option in enumerate(options)]


def _no_coverage(members: Sequence[BodyView], known: Sequence[BodyTraits], drawn: Sequence[BodyPlan],
                 engines: Sequence[str]) -> str:
    """The reason for which coverage does not draw bodies."""
    reasons = {"Embree is missing": "coverage" not in engines,
               "it reaches beside the camera": any(view.bounds_px is None for view in members),
               "surface detail is drawn": any(body.detail_layers for body in drawn),
               "texture or smooth normals vary within facets": any(math.isinf(traits.facet_m) for traits in known)}
    return next((why for why, holds in reasons.items() if holds), "facets are too large to be evenly bright")


def _with_detail(traits: BodyTraits, view: BodyView, body: BodyPlan, camera: PinholeCamera) -> BodyTraits:
    """A body with the slope of the surface detail that is drawn."""
    if not body.detail_layers or traits.relief is None:
        return traits
    return replace(traits, detail_slope=traits.relief.slope_rms(view.depth_m[0] / camera.focal_length_px))


def _is_crowded(members: Sequence[BodyView], known: Sequence[BodyTraits]) -> bool:
    """Whether so many facets that face camera and Sun share a pixel that rays are cheaper than any that visits each."""
    n_facing = sum(traits.n_facets * facing_share(view.phase_rad) for view, traits in zip(members, known, strict=True))
    n_px = sum(0.6 * min(view.size_px, 1e5) ** 2 for view in members)
    return (n_facing > MOST_FACETS_PER_PX * n_px
            and sum(traits.n_facets for traits in known) >= FEWEST_FACETS_FOR_RAYS)


def _coverage(members: Sequence[BodyView], known: Sequence[BodyTraits], drawn: Sequence[BodyPlan],
              request: Request) -> list[WindowPlan]:
    """By exact coverage: by centroids first where that may do, then clipped; none where it cannot draw the bodies."""
    camera, tolerance = request.camera, request.budget.tolerance
    if any(view.bounds_px is None or not math.isfinite(traits.facet_m) or body.detail_layers
           for view, traits, body in zip(members, known, drawn, strict=True)):
        return []
    uneven = max(math.hypot(_UNEVEN_FACET * traits.view_slope(view.phase_rad) * traits.facet_m / view.depth_m[0],
                            _UNEVEN_PIXEL * 3.0 * _off_axis(view, camera) / camera.focal_length_px)
                 for view, traits in zip(members, known, strict=True))
    modelled = {"uneven facets": uneven}
    where = _whole(members, camera, 1)
    if _is_small(members, request):
        bounds, sides = _own_bounds(members)
        size_px, phase_rad = outline_px(members), max(view.phase_rad for view in members)
        is_apart = apart_size_px(members) < request.apart_px
        several = _SEVERAL_CELLS if len(members) > 1 else 1.0
        cell_px = CELL_PX if is_apart else min(CELL_PX, cell_size(CELL_SHARE * tolerance / several, phase_rad))
        grid = tuple(max(math.ceil(side / max(cell_px, size_px / _MOST_CELLS)), 8) for side in sides)
        if not is_apart:
            cell_px = max(side / count for side, count in zip(sides, grid, strict=True))
            modelled["cells"] = several * cell_error(cell_px, phase_rad)
        where = {"samples": 0, "bounds_px": bounds, "grid": grid}
    # Light falls in slivers far smaller than facets: what none of their corners sees is lost.
    below_rad = min((math.pi - view.phase_rad for view, traits in zip(members, known, strict=True)
                     if not traits.is_convex), default=math.inf)
    # A few points of the Sun's disc do not tell how much of it is left of a body within another's penumbra.
    if math.hypot(*modelled.values()) > PENUMBRA_SHARE * tolerance or _are_in_penumbra(members, drawn, request):
        return []
    modelled["slivers"] = _CRESCENT_LOSS / max(below_rad, 1e-3) ** 3
    where["flux_error"] = max(body.penumbra.hard_flux for body in drawn)
    clipped = _window("coverage", members, known, request, modelled, **where)
    half_rad = min(0.5 * max(view.phase_rad for view in members), 1.5)
    least = _CENTROIDS_LEAST * max(math.tan(half_rad) / math.tan(math.radians(30.0)), 1.0) ** _CENTROIDS_POWER
    modelled |= {"centroids": least, "hard edges": max(body.penumbra.hard_error for body in drawn)}
    view, traits, allowed = members[0], known[0], request.of(members, "centroids")
    is_too_much = math.hypot(*modelled.values()) > PENUMBRA_SHARE * allowed.budget.tolerance
    # Where bodies hide or shade each other facets are clipped at the edges anyway.
    if (is_too_much or len(members) > 1 or drawn[0].casters or not traits.has_centroids
            or facets_per_px(view, traits.n_facets) < _LEAST_FACETS_PER_PX
            or view.phase_rad + traits.radius_m / view.range_m > _CENTROIDS_RAD):
        return [clipped]
    return [_window("coverage", members, known, allowed, modelled, by_centroids=True, **where), clipped]


def _rays(members: Sequence[BodyView], known: Sequence[BodyTraits], drawn: Sequence[BodyPlan],
          request: Request) -> WindowPlan | None:
    """By rays; None with surface detail, which they would take a minute for."""
    if any(body.detail_layers for body in drawn):
        return None
    eclipse_px = max(body.penumbra.sampled_px(view.size_px) for view, body in zip(members, drawn, strict=True))
    return _sampled("rays", members, known, drawn, request, {}, eclipse_px=eclipse_px)


def _raster(members: Sequence[BodyView], known: Sequence[BodyTraits], drawn: Sequence[BodyPlan],
            request: Request) -> WindowPlan:
    """By OpenGL, with the shadow maps that were planned."""
    worst = max((body.modelled for body in drawn), key=lambda errors: math.hypot(*errors.values()))
    return _sampled("raster", members, known, drawn, request, worst,
                    flux_error=max(body.penumbra.hard_flux for body in drawn))


def _sampled(engine: str, members: Sequence[BodyView], known: Sequence[BodyTraits], drawn: Sequence[BodyPlan],
             request: Request, modelled: Mapping[str, float], *, eclipse_px: float = 0.0,
             flux_error: float = 0.0) -> WindowPlan:
    """On a regular grid of samples, the first of them few: the image itself tells where more are needed."""
    pairs, size_px, budget = list(zip(members, known, strict=True)), outline_px(members), request.budget
    eclipsed = [body.penumbra.noise(view.size_px) for view, body in zip(members, drawn, strict=True)]
    told = {"eclipse_px": eclipse_px, "flux_error": flux_error}
    if request.samples is None and _is_small(members, request):
        bounds, sides = _own_bounds(members)
        pixels = min(SAMPLES_SHARE * budget.tolerance, budget.left_after(math.hypot(*modelled.values())))
        # Of each body, whatever part of the grid it has.
        per_px = max(samples_across(view, traits, budget.flux, pixels, noise) / max(view.size_px, 1e-9)
                     for (view, traits), noise in zip(pairs, eclipsed, strict=True))
        per_px = min(per_px, MAX_RAYS_ACROSS / size_px)
        # The samples tell of an eclipse's own noise, once they are drawn.
        error = max(sampling_errors(view, traits, per_px * view.size_px, 0.0 if eclipse_px else noise)[1]
                    for (view, traits), noise in zip(pairs, eclipsed, strict=True))
        grid = tuple(max(math.ceil(per_px * side), 8) for side in sides)
        return _window(engine, members, known, request, modelled, samples=0, bounds_px=bounds, grid=grid,
                       drawn={"samples": error}, **told)
    count = request.samples
    if count is not None:
        request = replace(request, budget=Budget(tolerance=math.inf))
    else:
        count = _first_samples(engine, pairs, request.camera)
        if eclipse_px:
            x0, y0, x1, y1 = region(members, request.camera)
            most = math.isqrt(_ECLIPSE_RAYS // max((x1 - x0) * (y1 - y0), 1))
            count = max(count, min(most, _MORE_SAMPLES))
        if size_px < _FLUX_PX:
            n_across = max(samples_across(view, traits, budget.flux, math.inf, noise)
                           for (view, traits), noise in zip(pairs, eclipsed, strict=True))
            most = MAX_RAYS_ACROSS / size_px if engine == "rays" else MAX_SAMPLES
            count = max(count, math.ceil(min(n_across / size_px, most)))
    noise = (max(traits.crease_rad for traits in known),
             max(facets_per_px(view, traits.n_facets) for view, traits in pairs))
    if engine == "rays" and any(body.penumbra.own_px > 1.0 for body in drawn):
        noise = _PENUMBRA_NOISE
    return _window(engine, members, known, request, modelled, noise=noise, **_whole(members, request.camera, count),
                   **told)


def _first_samples(engine: str, pairs: Sequence[tuple[BodyView, BodyTraits]], camera: PinholeCamera) -> int:
    """First samples along a pixel's side: more in crescents, fewer in a large region."""
    # Near a body the phase angle is another one on each side of it.
    is_crescent = max(view.phase_rad + traits.radius_m / view.range_m for view, traits in pairs) > CRESCENT_RAD
    fewest = 1
    if max(view.phase_rad for view, _ in pairs) > CRESCENT_RAD:
        # Rays pass over what faces away from the Sun, where that is known.
        is_known = all(view.bounds_px is not None and math.isfinite(traits.facet_m) for view, traits in pairs)
        fewest = _MORE_SAMPLES if engine == "rays" and is_known else _FIRST_SAMPLES
    x0, y0, x1, y1 = region([view for view, _ in pairs], camera)
    most = math.isqrt((1 if engine == "rays" else 4) * MOST_FIRST_SAMPLES // max((x1 - x0) * (y1 - y0), 1))
    return min(_MORE_SAMPLES if is_crescent else _FIRST_SAMPLES, max(most, fewest))


def _are_in_penumbra(members: Sequence[BodyView], drawn: Sequence[BodyPlan], request: Request) -> bool:
    """Whether a body may be within another's penumbra, which sharpens no edge on it, or which ends beside it."""
    return any(body.penumbra.surrounds(view.size_px, request.budget)
               for view, body in zip(members, drawn, strict=True))


def _window(engine: str, members: Sequence[BodyView], known: Sequence[BodyTraits], request: Request,
            modelled: Mapping[str, float], **told) -> WindowPlan:
    """A window with the errors that all have: one direction to the Sun, which no PSF averages, and rays' rounding."""
    pairs = list(zip(members, known, strict=True))
    always = {ONE_DIRECTION: max(parallel_error(*pair) for pair in pairs) / request.error_gain}
    if engine != "raster":
        always["rounding"] = max(ray_rounding_error(*pair) for pair in pairs)
    return WindowPlan(bodies=tuple(view.name for view in members), engine=engine, budget=request.budget,
                      roi=region(members, request.camera), modelled={**modelled, **always}, **told)


def _is_small(members: Sequence[BodyView], request: Request) -> bool:
    """Whether bodies have a grid of their own."""
    return outline_px(members) < _SMALL_PX or apart_size_px(members) < request.apart_px


def _whole(members: Sequence[BodyView], camera: PinholeCamera, count: int) -> dict:
    """Bounds [px] and grid of the region with so many samples along a pixel's side."""
    x0, y0, x1, y1 = region(members, camera)
    return {"samples": count, "bounds_px": (x0 - 0.5, y0 - 0.5, x1 - 0.5, y1 - 0.5),
            "grid": ((x1 - x0) * count, (y1 - y0) * count)}


def _own_bounds(members: Sequence[BodyView]) -> tuple[tuple[float, float, float, float], tuple[float, float]]:
    """Box of a small body's own grid [px], with a margin, and that box's sides."""
    margin = 0.02 * outline_px(members)
    left, top, right, bottom = (float(edge + beyond) for edge, beyond in zip(
        outline(members), (-margin, -margin, margin, margin), strict=True))
    return (left, top, right, bottom), (right - left, bottom - top)


def _off_axis(view: BodyView, camera: PinholeCamera) -> float:
    """Tangent of the angle between the boresight and the farthest corner of a body's box."""
    return max(math.hypot(x - camera.principal_point_px[0], y - camera.principal_point_px[1])
               for x in view.bounds_px[::2] for y in view.bounds_px[1::2]) / camera.focal_length_px
