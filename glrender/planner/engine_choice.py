"""The engines that may draw each region of an image, in the order in which they are tried. Pure.

The rule is the same on every machine. Exact coverage draws bodies of flat facets that are wholly before the camera: by
centroids first, and clipped where the estimated error exceeds the tolerance. Rays draw large shapes of which more than
`MOST_FACETS_PER_PX` facets share a pixel. OpenGL draws the rest, or rays where no shadow map is fine enough. With a GPU
OpenGL comes first.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from glrender_camera import PinholeCamera

from ..view.regions import Group
from ..view.view import BodyView
from .error_budget import PENUMBRA_SHARE, SAMPLES_SHARE, Budget
from .error_model import (
    CRESCENT_RAD,
    FEWEST_CENTROIDS,
    SMOOTH_PER_RAD,
    centroids,
    facets_per_px,
    parallel_error,
    ray_rounding_error,
)
from .plan import CENTROIDS, HARD, ONE_DIRECTION, SLIVERS, UNEVEN, BodyPlan, Target, WindowPlan
from .request import MAX_SAMPLES, Request
from .seen import Seen
from .small_body_grid import MAX_RAYS_ACROSS, own_cells, samples_across, sampling_errors

MOST_FACETS_PER_PX = 300.0
"""Facets that face Sun and camera, a pixel, from which rays are cheaper than coverage, by the cells of
benchmarks/bench_cells.py."""
MOST_FIRST_SAMPLES = 2**20
"""Rays of a whole region at first: of 1024 x 1024 px one each tells as much (benchmarks/cliffs.py), in 0.3 s. By OpenGL
four times as many samples take less."""
FEWEST_FACETS_FOR_RAYS = 100_000
"""Facets from which that holds: fewer cost coverage no more than the rays that a flux asks for, by the same cells."""
FACETS_PER_PX_BY_RAYS = 2.0
"""Facets over pixels of the image, of ground that reaches behind the camera, from which rays are cheaper than OpenGL,
which draws every facet: at 500,000 of 512 x 512 px they cost the same (benchmarks/descent.py)."""
# Side [px] of an outline below which a body has a grid of its own.
_SMALL_PX = 4.0
# Side [px] of an outline up to which the samples must hold the flux as well: larger bodies have enough for the image.
_FLUX_PX = 32.0
# Widest of a crescent apart over a full disc apart [1]: its own grid has only so many samples.
_MOST_LARGER = 4.0
# First samples along a pixel's side; and of narrow crescents and eclipses, whose light, or its loss, is in few pixels.
_FIRST_SAMPLES = 2
_MORE_SAMPLES = 4
# RMS distance from the centroid of an equilateral triangle over the root of its area [1]: 0.31 along each axis.
_UNEVEN_FACET = 0.44
# Displacement of a facet's light [px] from which its radiance varies linearly: a thirtieth of the centre that is asked
# for by those who ask for most.
_MOST_UNEVEN_PX = 0.01
# Variation of a pixel's solid angle within it over its angle [1]: above 3 tan(theta) / sqrt(12), off the boresight.
_UNEVEN_PIXEL = 0.3
# Error of the flux [1] times the cube of the angle from a phase of 180 deg [rad^3]: a rough binary at 165, 172, 175 deg
# loses 0.37, 0.86, 3.5 % of its light.
_CRESCENT_LOSS = 6.6e-5
# Phase angle [rad] anywhere on a body beyond which a facet's centroid does not tell of slivers of light on it.
_CENTROIDS_RAD = 2.15
CENTROIDS_LEAST = 6e-4
"""Error of the flux [1] by centroid visibility that the image does not show, at a phase of 60 deg: cells of
benchmarks/bench_cells.py."""
# Its power of the tangent of half the phase: a rough binary at 100 deg (seed 178 of benchmarks/heldout.py).
_CENTROIDS_POWER = 3.0
# Fewest facets a pixel [1]: of larger ones few are at the boundary of light (seed 100 of
# benchmarks/heldout.py).
_LEAST_FACETS_PER_PX = 0.05
# Rays that the first samples of an eclipse may take.
_ECLIPSE_RAYS = 100_000
# A body's own penumbras by rays are noise: crease [rad] and facets a pixel that say so to `error_model.noise_gain`.
_PENUMBRA_NOISE = (math.inf, math.inf)


def ways_to_draw(group: Group, bodies: Sequence[Seen], plans: Sequence[BodyPlan], request: Request,
                 apart_px: float = 0.0) -> list[WindowPlan]:
    """The ways to draw bodies together, in the order in which they are tried; none where `engine` cannot draw them.

    Parameters
    ----------
    group : Group
    bodies : sequence of Seen
        Those of the group.
    plans : sequence of BodyPlan
        Likewise.
    request : Request
    apart_px : float [px]
        Bodies of a smaller `apart_size_px` are points.
    """
    part = _Part(group=group, bodies=tuple(bodies), request=request, target=_target(group, request, apart_px))
    worst = max((plan.modelled for plan in plans), key=lambda errors: math.hypot(*errors.values()))
    if request.samples is not None:
        return [replace(_raster(part, worst), why="samples were asked for")]
    made, is_crowded = [name for name in request.engines if request.engine in (None, name)], _is_crowded(bodies)
    coverage = _coverage(part) if "coverage" in made else []
    if request.has_derivatives:
        return [replace(option, why="derivatives were asked for") for option in coverage[-1:]]
    # Areas that err by more than is asked for, however they are clipped, are for where samples err by more still.
    coarse = coverage[-1:] if _are_coarse(coverage) else []
    coverage = [] if coarse else coverage
    rays = _rays(part) if "rays" in made else []
    raster = [_raster(part, worst)] if "raster" in made else []
    is_in_penumbra = part.is_in_penumbra(request.budget(group, "raster"))
    is_fine_enough = (raster and raster[0].modelling_error <= raster[0].budget.tolerance and not is_in_penumbra)
    if request.engine is not None:
        options, why = [*coverage, *rays, *raster], "asked for"
    elif request.has_gpu and is_fine_enough:
        options, why = [*raster, *coverage, *rays], "there is a GPU, and its shadow map is fine enough"
    elif "raster" not in request.engines:
        options, why = rays, "rays alone draw lamps"
    elif is_crowded:
        options = [*rays, *coverage, *([] if rays else raster)]
        why = f"more than {MOST_FACETS_PER_PX:g} facets that face Sun and camera share a pixel"
    elif rays and _is_dense(part):
        options = rays
        why = f"more than {FACETS_PER_PX_BY_RAYS:g} facets for each pixel of the image, all of which OpenGL would draw"
    elif coverage:
        options, why = [*coverage, *rays], "evenly bright facets that are all before the camera"
    else:
        options, why = [*raster, *rays], _no_coverage(part)
        if not is_fine_enough:
            options = rays or raster
            why = "a wide penumbra is on it" if is_in_penumbra else f"{why}, and no shadow map is fine enough"
    options = [*options, *coarse]
    names = ["coverage by centroids" if option.by_centroids else option.engine for option in options]
    return [replace(option, why=f"{' and '.join(names[:index])} would miss the tolerance" if index else why)
            for index, option in enumerate(options)]


def apart_limit(groups: Iterable[Group], apart_px: float) -> float:
    """`apart_size_px` below which groups are apart, so that together they cover no more than a body of `apart_px`.

    They have a point for each 0.3 px: what spreads them is to cost as much for many bodies as for one.
    """
    covered = 0.0
    for size_px in sorted(size for group in groups if (size := _apart_size_px(group)) < apart_px):
        covered += size_px**2
        if covered > apart_px**2:
            return size_px
    return apart_px


def apart_size_px(size_px: float, phase_rad: float) -> float:
    """Size [px] of the full disc that has as much light as a body of a size [px] at a phase angle [rad], about.

    A crescent has few pixels, and an image errs the more: at 24 px by 0.4 % of its mean at 20 deg, 7 % at 150 deg.
    """
    return max(size_px * math.cos(0.5 * phase_rad), size_px / _MOST_LARGER)


def _apart_size_px(group: Group) -> float:
    """That of bodies that are drawn together."""
    return apart_size_px(group.size_px, min(view.phase_rad for view in group.views))


@dataclass(frozen=True, kw_only=True)
class _Part:
    """A part of a frame: the bodies of a group, and where they are drawn."""

    group: Group
    bodies: tuple[Seen, ...]
    request: Request
    target: Target

    def is_in_penumbra(self, budget: Budget) -> bool:
        """Whether a body may be within another's penumbra, which sharpens no edge on it, or which ends beside it."""
        return any(body.penumbra.surrounds(body.view.size_px, budget) for body in self.bodies)

    @property
    def hard_flux(self) -> float:
        """Error of the total light [1] with hard edges in place of other bodies' penumbras."""
        return max(body.penumbra.hard_flux for body in self.bodies)

    def whole(self, count: int) -> dict[str, Any]:
        """Bounds [px] and grid of the region with so many samples along a pixel's side."""
        x0, y0, x1, y1 = self.group.roi
        return {"samples": count, "bounds_px": (x0 - 0.5, y0 - 0.5, x1 - 0.5, y1 - 0.5),
                "grid": ((x1 - x0) * count, (y1 - y0) * count)}

    def own_grid(self, per_px: float) -> dict[str, Any]:
        """Bounds [px] of a small body's own grid, with a margin, and the grid with so many cells a pixel."""
        margin, (x0, y0, x1, y1) = 0.02 * self.group.size_px, self.group.outline
        bounds = (x0 - margin, y0 - margin, x1 + margin, y1 + margin)
        sides = (bounds[2] - bounds[0], bounds[3] - bounds[1])
        return {"samples": 0, "bounds_px": bounds, "grid": tuple(max(math.ceil(per_px * side), 8) for side in sides)}

    def own_cells(self) -> dict[str, Any]:
        """Bounds [px] and grid of a small body's own cells."""
        bounds_px, grid, _ = own_cells(self.group.outline, self.group.size_px)
        return {"samples": 0, "bounds_px": bounds_px, "grid": grid}

    def window(self, engine: str, budget: Budget, modelled: Mapping[str, float], **fields: Any) -> WindowPlan:
        """A window with the errors that all have: one direction to the Sun, which no PSF averages; rays' rounding."""
        always = {ONE_DIRECTION: max(parallel_error(body.view, body.traits) for body in self.bodies)
                  / self.request.use.error_gain}
        if engine != "raster":
            always["rounding"] = max(ray_rounding_error(body.view, body.traits) for body in self.bodies)
        return WindowPlan(bodies=self.group.names, engine=engine, budget=budget, roi=self.group.roi,
                          target=self.target, modelled={**modelled, **always}, noise=self.noise(engine), **fields)

    def noise(self, engine: str) -> tuple[float, float]:
        """RMS angle between neighbouring facets [rad], and facets a pixel: `WindowPlan.noise`."""
        if engine != "raster" and any(body.penumbra.own_px > 1.0 for body in self.bodies):
            return _PENUMBRA_NOISE
        return (max(body.traits.crease_rad for body in self.bodies),
                max(facets_per_px(body.view, body.traits.n_facets) for body in self.bodies))


def _target(group: Group, request: Request, apart_px: float) -> Target:
    """Where bodies are drawn."""
    if request.samples is not None or request.has_derivatives:
        return "region"
    if _apart_size_px(group) < apart_px:
        return "point"
    return "own_grid" if group.size_px < _SMALL_PX else "region"


def _no_coverage(part: _Part) -> str:
    """The reason for which coverage does not draw bodies."""
    reasons = {"Embree is missing": "coverage" not in part.request.engines,
               "it reaches beside the camera": part.group.outline is None,
               "surface detail is drawn": any(body.detail_layers for body in part.bodies),
               "texture or smooth normals vary within facets": any(math.isinf(body.traits.facet_m)
                                                                   for body in part.bodies)}
    return next((why for why, holds in reasons.items() if holds), "facets are too large to be evenly bright")


def _is_crowded(bodies: Sequence[Seen]) -> bool:
    """Whether so many facets that face camera and Sun share a pixel that rays are cheaper than any that visits each."""
    # A lune of the directions faces both.
    n_facing = sum(body.traits.n_facets * (math.pi - body.view.phase_rad) / (2.0 * math.pi) for body in bodies)
    n_px = sum(0.6 * min(body.view.size_px, 1e5) ** 2 for body in bodies)
    return (n_facing > MOST_FACETS_PER_PX * n_px
            and sum(body.traits.n_facets for body in bodies) >= FEWEST_FACETS_FOR_RAYS)


def _is_dense(part: _Part) -> bool:
    """Whether bodies that reach behind the camera have so many facets that OpenGL costs more than rays."""
    x0, y0, x1, y1 = part.group.roi
    most = max(FACETS_PER_PX_BY_RAYS * (x1 - x0) * (y1 - y0), FEWEST_FACETS_FOR_RAYS)
    return part.group.outline is None and sum(body.traits.n_facets for body in part.bodies) > most


def _coverage(part: _Part) -> list[WindowPlan]:
    """By exact coverage: by centroids first where that may do, then clipped; none where it cannot draw the bodies."""
    group, bodies, request = part.group, part.bodies, part.request
    budget = request.budget(group, "coverage")
    if group.outline is None or any(not math.isfinite(body.traits.facet_m) or body.detail_layers for body in bodies):
        return []
    is_smooth = request.camera.lens_map is None and max(
        body.traits.view_slope(body.view.phase_rad) for body in bodies) <= SMOOTH_PER_RAD
    has_planes = is_smooth and not request.has_derivatives and max(
        _uneven_px(body, request.camera) for body in bodies) > _MOST_UNEVEN_PX
    # A few points of the Sun's disc do not tell how much of it is left of a body within another's penumbra.
    if part.is_in_penumbra(budget):
        return []
    where = part.whole(1) if part.target == "region" else part.own_cells()
    cell_px = (where["bounds_px"][2] - where["bounds_px"][0]) / where["grid"][0]
    modelled = {UNEVEN: max(_unevenness(body, request.camera, has_planes, cell_px) for body in bodies)}
    # Light falls in slivers far smaller than facets: what none of their corners sees is lost.
    below_rad = min((math.pi - body.view.phase_rad for body in bodies if not body.traits.is_convex), default=math.inf)
    of_flux = {SLIVERS: _CRESCENT_LOSS / max(below_rad**3, _CRESCENT_LOSS)}
    clipped = part.window("coverage", budget, modelled, modelled_flux=of_flux, flux_error=part.hard_flux,
                          has_planes=has_planes, **where)
    half_rad = min(0.5 * group.phase_rad, 1.5)
    least = CENTROIDS_LEAST * max(math.tan(half_rad) / math.tan(math.radians(30.0)), 1.0) ** _CENTROIDS_POWER
    view, traits = bodies[0].view, bodies[0].traits
    allowed = request.budget(group, centroids(part.noise("coverage")[0]))
    modelled[HARD] = max(body.penumbra.hard_error for body in bodies)
    of_flux = {**of_flux, CENTROIDS: least}
    is_too_much = allowed.rms_of(modelled, of_flux) > PENUMBRA_SHARE * allowed.tolerance
    # Where bodies hide or shade each other facets are clipped at the edges anyway; a table is of one law.
    if (is_too_much or has_planes or len(bodies) > 1 or bodies[0].casters or not traits.is_of_one_look
            or traits.n_facets < FEWEST_CENTROIDS or facets_per_px(view, traits.n_facets) < _LEAST_FACETS_PER_PX
            or view.phase_rad + traits.radius_m / view.range_m > _CENTROIDS_RAD):
        return [clipped]
    by_centroids = part.window("coverage", allowed, modelled, modelled_flux=of_flux, by_centroids=True,
                               flux_error=part.hard_flux, **where)
    return [by_centroids, clipped]


def _are_coarse(windows: Sequence[WindowPlan]) -> bool:
    """Whether facets of one radiance each take most of the tolerance by themselves."""
    return any(not each.has_planes and each.modelled[UNEVEN] > PENUMBRA_SHARE * each.budget.tolerance
               for each in windows[-1:])


def _unevenness(body: Seen, camera: PinholeCamera, has_planes: bool, cell_px: float) -> float:
    """RMS variation [1] of the light of a facet, unless it is drawn as a plane, and of a cell, about their middles."""
    pixel = (3.0 * _off_axis(body.view, camera) / camera.focal_length_px if camera.lens_map is None
             else camera.lens_map.unevenness_per_px(body.view.bounds_px))
    return math.hypot(0.0 if has_planes else _UNEVEN_FACET * _change(body), _UNEVEN_PIXEL * cell_px * pixel)


def _uneven_px(body: Seen, camera: PinholeCamera) -> float:
    """Displacement [px] of the light of a facet, if it is as bright all over as its centroid."""
    facet_px = body.traits.facet_m / body.view.depth_m[0] * camera.focal_length_px
    return _change(body) * facet_px / 12.0


def _change(body: Seen) -> float:
    """Relative change of the radiance [1] along a side of a facet."""
    return body.traits.view_slope(body.view.phase_rad) * body.traits.facet_m / body.view.depth_m[0]


def _rays(part: _Part) -> list[WindowPlan]:
    """By rays; none with surface detail, which they would take a minute for."""
    if any(body.detail_layers for body in part.bodies):
        return []
    eclipse_px = max(body.penumbra.sampled_px(body.view.size_px) for body in part.bodies)
    return [_sampled("rays", part, {}, eclipse_px=eclipse_px)]


def _raster(part: _Part, modelled: Mapping[str, float]) -> WindowPlan:
    """By OpenGL, with the shadow maps that were planned: the errors of the body whose are largest."""
    return _sampled("raster", part, modelled, flux_error=part.hard_flux)


def _sampled(engine: str, part: _Part, modelled: Mapping[str, float], *, eclipse_px: float = 0.0,
             flux_error: float = 0.0) -> WindowPlan:
    """On a regular grid of samples, the first of them few: the image itself tells where more are needed."""
    group, request = part.group, part.request
    budget = request.budget(group, engine)
    eclipsed = [(body.view, body.traits, body.penumbra.noise(body.view.size_px)) for body in part.bodies]
    window = partial(part.window, engine, eclipse_px=eclipse_px, flux_error=flux_error)
    if request.samples is None and part.target != "region":
        pixels = min(SAMPLES_SHARE * budget.tolerance, budget.left_after(math.hypot(*modelled.values())))
        # Each body asks for its own samples, whatever part of the grid it has.
        per_px = max(samples_across(view, traits, budget.flux, pixels, noise) / max(view.size_px, 1e-9)
                     for view, traits, noise in eclipsed)
        per_px = min(per_px, MAX_RAYS_ACROSS / group.size_px)
        # The samples tell of an eclipse's own noise, once they are drawn.
        error = max(sampling_errors(view, traits, per_px * view.size_px, 0.0 if eclipse_px else noise)[1]
                    for view, traits, noise in eclipsed)
        return window(budget, modelled, drawn={"samples": error}, **part.own_grid(per_px))
    count = request.samples
    if count is not None:
        budget = Budget(tolerance=math.inf)
    else:
        count = _first_samples(engine, part)
        x0, y0, x1, y1 = group.roi
        if eclipse_px:
            most = math.isqrt(_ECLIPSE_RAYS // max((x1 - x0) * (y1 - y0), 1))
            count = max(count, min(most, _MORE_SAMPLES))
        if group.size_px < _FLUX_PX:
            n_across = max(samples_across(view, traits, budget.flux, math.inf, noise)
                           for view, traits, noise in eclipsed)
            most = MAX_RAYS_ACROSS / group.size_px if engine == "rays" else MAX_SAMPLES
            count = max(count, math.ceil(min(n_across / group.size_px, most)))
    return window(budget, modelled, **part.whole(count))


def _first_samples(engine: str, part: _Part) -> int:
    """First samples along a pixel's side: more in crescents, fewer in a large region."""
    # Near a body the phase angle is another one on each side of it.
    is_crescent = max(body.view.phase_rad + body.traits.radius_m / body.view.range_m
                      for body in part.bodies) > CRESCENT_RAD
    fewest = 1
    if part.group.phase_rad > CRESCENT_RAD:
        # Rays pass over what faces away from the Sun, where that is known.
        is_known = part.group.outline is not None and all(math.isfinite(body.traits.facet_m) for body in part.bodies)
        fewest = _MORE_SAMPLES if engine == "rays" and is_known else _FIRST_SAMPLES
    x0, y0, x1, y1 = part.group.roi
    most = math.isqrt((1 if engine == "rays" else 4) * MOST_FIRST_SAMPLES // max((x1 - x0) * (y1 - y0), 1))
    return min(_MORE_SAMPLES if is_crescent else _FIRST_SAMPLES, max(most, fewest))


def _off_axis(view: BodyView, camera: PinholeCamera) -> float:
    """Tangent of the angle between the boresight and the farthest corner of a body's box."""
    return max(math.hypot(x - camera.principal_point_px[0], y - camera.principal_point_px[1])
               for x in view.bounds_px[::2] for y in view.bounds_px[1::2]) / camera.focal_length_px
