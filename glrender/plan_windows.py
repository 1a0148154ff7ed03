"""The planner's choice for each part of an image: triangles, rays or areas, and how many samples first. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from glrender_camera import PinholeCamera

from .area_grid import CELL_PX
from .costs import RASTER_CALL_NS, EngineCosts
from .error_model import (
    BodyTraits,
    LevelTraits,
    facets_per_px,
    lit_share,
    rounding_px,
    shadow_share,
    squared_errors,
    texel_share,
    usual_edges,
)
from .first_samples import MAX_SAMPLES, Expected, first_samples
from .grouping import outline, outline_px, region, touching
from .lattice import Lattice, Lattices, cell_error, cell_size
from .plan_areas import choose_areas, facing_share
from .render_plan import BodyPlan, WindowPlan
from .view import BodyView

FACING_SAMPLES = 3
"""Fewest along a pixel's side of that image; it has as many as the rays."""
# Rays that cost less than an image of what faces the Sun, whatever its facets.
_FEW_RAYS = 100_000
# A body that is smaller has a grid of its own; one that is alone and not much larger (its grid is then no finer than 64
# samples along a pixel's side) where 16 x 16 samples a pixel would leave too much of its flux or its centre.
_SMALL_PX, _LARGEST_OWN_PX = 4.0, 32.0
# A crescent that is apart is so many times as wide as a full disc, at most: its own grid has only so many samples.
_MOST_LARGER = 4.0
# Of the budget, what its pixels may take there, its flux, as everywhere, and, in pixels, its centre of light: 0.01 px
# at a budget of 0.02.
_PIXELS_SHARE, _FLUX_SHARE, _CENTRE_SHARE = 0.9, 0.1, 0.5
# Samples across it: fewest (they cost no more than the call), most for flux and centre, and most (half a second by
# rays); and the most cells of areas.
_LEAST_ACROSS, _MOST_FOR_SUMS, _MOST_ACROSS, _MOST_CELLS = 64, 1024, 2048, 2048
# Error with the most samples, over the budget, from which on they are not taken: a crescent at 173 deg has ten times.
_HOPELESS = 4.0
# Most rays across a body that is small, but not so small: of many rough facets 16 x 16 a pixel may not do. No second
# pass has more than these, so that the first takes more than is expected to do.
_MOST_RAYS_ACROSS, _NO_SECOND = 1024, 1.2
# Cost of a sample passed over, in samples that are shaded; and of a ray that meets no lit facet, in rays that do.
_PASSED_OVER_COST, _UNLIT_COST = 0.45, 0.35
# Share of a body's disc that rays meet lit at least, of crescents as well.
_LEAST_LIT = 0.05
# Cost of a texel of a shadow map, in samples: of 108 maps of 256 to 1024 texels.
_TEXEL_COST = 0.15
# Cost of a layer of surface detail, in samples.
_LAYER_COST = 1.5
# Cost of a facet and of a sample of a level of detail, which has texels with normals and vertices for each facet, over
# one of the full shape.
_LEVEL_FACET, _LEVEL_SAMPLE = 2.6, 1.5
# Fewest samples along a pixel's side of a low Sun's slivers, where the budget would notice one that is missed: from one
# phase on, and more per radian beyond another.
_SLIVER_SAMPLES, _SLIVER_PHASE_RAD, _SLIVER_BUDGET = 3.0, 1.4, 0.03
_THIN_SAMPLES_PER_RAD, _THIN_PHASE_RAD = 4.0, 2.15
# Of larger bodies, samples across times the budget: the centre of light is as good, where RMS alone asks for few.
_CENTRE = 2.2
# Of the budget, what cells of a small body that is added to the image may take, and they and areas' other modelling:
# what is drawn errs, too.
_CELL_SHARE, _MOST_MODELLING = 0.3, 0.9
# Penumbras by rays are noise: creases and facets a pixel that say so; and fewest samples along a pixel's side.
_PENUMBRA_NOISE, _PENUMBRA_SAMPLES = (0.4, 1e4), 2


@dataclass(frozen=True, kw_only=True)
class WindowChoice:
    """How a window is drawn; the rays that take over where its image tells that it is too coarse, and the areas where
    theirs does.
    """

    first: WindowPlan
    by_rays: WindowPlan | None = None
    by_areas: WindowPlan | None = None


def plan_windows(views: Sequence[BodyView], traits: Mapping[str, BodyTraits], bodies: Sequence[BodyPlan],
                 camera: PinholeCamera, max_error: float, error_gain: float, costs: EngineCosts,
                 samples: int | None, apart_px: float = 0.0) -> list[WindowChoice]:
    """Split the image into windows, each with the engine and the samples that its bodies need first.

    Bodies far apart in the image are drawn apart, so that the cost follows their pixels; a body
    smaller than a few pixels is drawn on a grid of its own that fits its outline.

    Parameters
    ----------
    error_gain : float [1]
        What the camera's PSF leaves of an error that is independent from pixel to pixel.
    costs : EngineCosts
    samples : int or None
        Asked for instead of the planner's choice: drawn by OpenGL.
    apart_px : float [px]
        Bodies of a smaller `apart_size_px` together have a grid of their own in any case.
    """
    plans = {body.name: body for body in bodies}
    return [_Window(members, traits, plans, camera, max_error / error_gain, error_gain, costs,
                    apart_px).choice(samples)
            for members in touching(views, camera)]


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


def _dear_share(lit: float) -> float:
    """Cost of rays of which such a share meets lit facets, over that of as many that all do."""
    return lit + _UNLIT_COST * (1.0 - lit)


def _detailed(level: LevelTraits, body: BodyPlan) -> LevelTraits:
    """A level with the surface detail that is drawn on it."""
    return replace(level, detail_slope=body.detail_slope) if body.detail_slope else level


class _Window:
    """Bodies that are drawn together, and what each engine would make of them."""

    def __init__(self, members: Sequence[BodyView], traits: Mapping[str, BodyTraits], plans: Mapping[str, BodyPlan],
                 camera: PinholeCamera, budget: float, error_gain: float, costs: EngineCosts, apart_px: float):
        self._members, self._budget, self._gain = members, budget, error_gain
        self._drawn = [plans[view.name] for view in members]
        n_layers = max(body.detail_layers for body in self._drawn)
        of_level = _LEVEL_SAMPLE if any(body.level for body in self._drawn) else 1.0
        self._sample_ns = costs.sample_ns * (of_level + _LAYER_COST * n_layers)
        # Surface detail is OpenGL's: by rays, in NumPy, it takes a minute a frame.
        self._costs = costs = replace(costs, ray_ns=math.inf) if n_layers else costs
        self._levels, self._full = ([_detailed(traits[view.name].levels[level], body)
                                     for view, body, level in zip(members, self._drawn, levels, strict=True)]
                                    for levels in ([body.level for body in self._drawn], [0] * len(members)))
        self._roi = x0, y0, x1, y1 = region(members, camera)
        self._box_px = (x1 - x0) * (y1 - y0)
        self._n_px = min(sum(0.6 * min(view.size_px, 1e5) ** 2 for view in members), self._box_px)
        self._largest_px = max(view.size_px for view in members)
        self._outline_px = outline_px(members)
        self._phase_rad = max(view.phase_rad for view in members)
        self._lit = lit_share(self._phase_rad, _LEAST_LIT)
        # Where OpenGL puts what faces the Sun; it is drawn two pixels larger.
        self._rounding_px = max(rounding_px(view, traits[view.name], body.relative_to_camera)
                                for view, body in zip(members, self._drawn, strict=True))
        # Facets of the full shapes that face camera and Sun and are shown, about.
        shown = min(self._box_px / (0.8 * min(self._largest_px, 1e5) ** 2), 1.0)
        self._n_facing = max(
            sum(level.n_facets for level in self._full) * facing_share(self._phase_rad) * shown, 1.0)
        self._lattices = Lattices([
            Lattice.of(view, level, reflectance=traits[view.name].reflectance, eclipse=body.eclipse)
            for view, level, body in zip(members, self._full, self._drawn, strict=True)], min(self._outline_px, 1e5))
        self._is_apart = apart_size_px(members) < apart_px
        # No PSF smooths the error of the flux or of the centre.
        self._asked = asked = budget * error_gain
        is_few = self._is_apart or self._largest_px < _LARGEST_OWN_PX
        per_px = self._lattices.samples_per_px(flux=_FLUX_SHARE * asked,
                                               centre_px=_CENTRE_SHARE * asked if is_few else math.inf)
        self._across = min(max(min(self._outline_px, 1e5) * per_px, _LEAST_ACROSS), _MOST_FOR_SUMS)
        # Slivers of light between samples tell nothing of themselves.
        slivers = 1.0
        if self._phase_rad > _SLIVER_PHASE_RAD and budget < _SLIVER_BUDGET:
            slivers = _SLIVER_SAMPLES + _THIN_SAMPLES_PER_RAD * max(self._phase_rad - _THIN_PHASE_RAD, 0.0)
        centre = 0.0 if is_few else _CENTRE / (asked * self._largest_px)
        self._least = math.ceil(min(max(self._across / self._outline_px, slivers, centre), MAX_SAMPLES))
        # Areas have no lattice to err in the flux: they need cells of their own only for what is apart or tiny.
        self._areas_have_own = self._outline_px < _SMALL_PX or self._is_apart
        self._by_areas = choose_areas(members, traits, self._drawn, camera, budget, error_gain, costs,
                                      n_px=self._n_px, shown_share=shown,
                                      cells_per_px=1.0 / CELL_PX if self._areas_have_own else 1.0)
        # Of shadow maps and levels of detail: rays have neither. And without the edges of shadows, or with usual ones.
        self._floor = max(body.modelling_error for body in self._drawn)
        maps = [(view, body, sum(squared_errors(view, level)), texel_share(view, body.shadow_map_px),
                 shadow_share(view, body.shadow_map_px, bool(body.casters)))
                for view, body, level in zip(members, self._drawn, self._levels, strict=True)
                if body.shadow_map_px is not None]
        self._texel_share = max((texels for _, _, _, texels, _ in maps), default=0.0)
        self._shadow_share = max((share for *_, share in maps), default=0.0)
        smooth = max([body.modelling_error**2 for body in self._drawn if body.shadow_map_px is None] + [
            body.modelling_error**2 - share * errors for _, body, errors, _, share in maps])
        self._smooth_floor = math.sqrt(max(smooth, 0.0))
        edges = max((usual_edges(view) * texels * errors for view, _, errors, texels, _ in maps), default=0.0)
        self._least_floor = math.hypot(self._smooth_floor, math.sqrt(edges))
        self._facets_ns = costs.facet_ns * sum(
            body.n_facets * body.shown_share * (_LEVEL_FACET if body.level else 1.0) for body in self._drawn)
        self._shadows_ns = sum(RASTER_CALL_NS + body.n_facets * body.shown_share * costs.facet_ns
                               + math.prod(body.shadow_map_drawn_px) * _TEXEL_COST * costs.sample_ns
                               for _, body, *_ in maps)

    def choice(self, samples: int | None) -> WindowChoice:
        has_rays = math.isfinite(self._costs.ray_ns)
        is_small = self._outline_px < _SMALL_PX or self._is_apart or (
            min(self._across / MAX_SAMPLES, _LARGEST_OWN_PX) > self._outline_px)
        areas_ns = self._by_areas.ns if has_rays and samples is None else math.inf
        if samples is None and is_small:
            grid_ns, grid = self._own_grid(has_rays)
            if math.isinf(areas_ns):
                return WindowChoice(first=grid)
            areas = self._small_areas() if self._areas_have_own else self._areas()
            is_enough = grid.predicted_error <= self._gain * self._budget
            # Areas that leave the budget nothing would give up, and the grid be drawn after all.
            if (grid_ns < areas_ns and is_enough) or areas.modelling_error > _MOST_MODELLING * self._budget:
                return WindowChoice(first=grid)
            return WindowChoice(first=areas, by_rays=self._own_grid(has_rays, has_raster=False)[1])
        if not has_rays or samples is not None:
            return WindowChoice(first=self._raster(samples)[1])
        rays_ns, rays = self._rays()
        by_areas = None if math.isinf(areas_ns) else self._areas()
        # What OpenGL's facets cost alone may be more.
        if areas_ns < min(RASTER_CALL_NS + self._facets_ns, rays_ns):
            return WindowChoice(first=by_areas, by_rays=rays)
        raster_ns, raster = self._raster(samples)
        if areas_ns < min(raster_ns, rays_ns):
            return WindowChoice(first=by_areas, by_rays=rays)
        if rays_ns < raster_ns or self._least_floor > self._budget:
            return WindowChoice(first=rays, by_areas=by_areas)
        return WindowChoice(first=raster, by_rays=rays, by_areas=by_areas)

    def _areas(self) -> WindowPlan:
        return self._areas_plan(samples=1, **self._whole(1))

    def _small_areas(self) -> WindowPlan:
        bounds, sides = self._own_bounds()
        asked_px = CELL_PX if self._is_apart else min(CELL_PX, cell_size(_CELL_SHARE * self._budget, self._phase_rad))
        grid = tuple(max(math.ceil(side / max(asked_px, self._outline_px / _MOST_CELLS)), 8) for side in sides)
        cell_px = max(side / count for side, count in zip(sides, grid, strict=True))
        of_cells = 0.0 if self._is_apart else cell_error(cell_px, self._phase_rad)
        return self._areas_plan(of_cells, samples=0, grid=grid, bounds_px=bounds)

    def _areas_plan(self, of_cells: float = 0.0, **told) -> WindowPlan:
        return self._plan("areas", modelling_error=math.hypot(self._by_areas.error, of_cells),
                          predicted_error=self._budget, levels=self._by_areas.levels, **told)

    def _own_bounds(self) -> tuple[tuple[float, float, float, float], tuple[float, float]]:
        """Box of a small body's own grid [px], with a margin, and that box's sides."""
        margin = 0.02 * self._outline_px
        left, top, right, bottom = (float(edge + beyond) for edge, beyond in zip(
            outline(self._members), (-margin, -margin, margin, margin), strict=True))
        return (left, top, right, bottom), (right - left, bottom - top)

    def _own_grid(self, has_rays: bool, has_raster: bool = True) -> tuple[float, WindowPlan]:
        bounds, sides = self._own_bounds()
        enough = self._lattices.samples_per_px(pixels=_PIXELS_SHARE * self._budget)
        # Crescents of a few slivers are beyond any grid.
        is_beyond = self._lattices.error(_MOST_ACROSS / self._outline_px) > _HOPELESS * self._budget
        most = _MOST_FOR_SUMS if is_beyond else _MOST_ACROSS
        per_px = max(self._across, min(self._outline_px * enough, most)) / self._outline_px
        grid = tuple(max(math.ceil(per_px * side), 8) for side in sides)
        raster_ns = (RASTER_CALL_NS + self._facets_ns + self._shadows_ns
                     + math.prod(grid) * self._sample_ns)
        rays_ns = self._costs.rays_ns(math.prod(grid) * _dear_share(self._lit), self._n_facing)
        sampling, flux_error = self._lattices.error(per_px), self._lattices.flux_error(per_px)
        is_rays = not has_raster or rays_ns < raster_ns or (
            has_rays and math.hypot(self._floor, sampling) > self._budget)
        floor = 0.0 if is_rays else self._floor
        return rays_ns if is_rays else raster_ns, self._plan(
            "rays" if is_rays else "raster", samples=0, grid=grid, bounds_px=bounds, modelling_error=floor,
            flux_error=flux_error if flux_error > _FLUX_SHARE * self._asked * (1.0 + 1e-6) else 0.0,
            predicted_error=math.hypot(floor, sampling))

    def _raster(self, samples: int | None) -> tuple[float, WindowPlan]:
        """By OpenGL, with the levels of detail and the shadow maps that were planned; its nanoseconds."""
        budget = math.sqrt(max(self._budget**2 - self._floor**2, (0.3 * self._budget) ** 2))
        errors, noise = self._errors(self._levels), self._noise(self._levels)
        shaded, count = first_samples(
            self._expected(self._levels), self._n_px, (self._facets_ns + RASTER_CALL_NS) / self._sample_ns,
            _PASSED_OVER_COST, self._least, budget)
        asked = {} if samples is None else {"budget": math.inf}
        window = self._sampled("raster", count if samples is None else samples, errors, self._floor, noise=noise,
                               shadow_share=self._shadow_share, texel_share=self._texel_share,
                               modelling_error=self._smooth_floor, **asked)
        return shaded * self._sample_ns + self._shadows_ns, window

    def _rays(self) -> tuple[float, WindowPlan]:
        """By rays, at the full shape; its nanoseconds."""
        errors, noise, least = self._errors(self._full), self._noise(self._full), self._least
        expected = self._expected(self._full)
        if max(body.penumbra_px for body in self._drawn) > 1.0:
            # A ramp of many samples that are each lit or not.
            noise, least = _PENUMBRA_NOISE, max(least, _PENUMBRA_SAMPLES)
            expected = replace(expected, facets_per_px=_PENUMBRA_NOISE[1])
        n_lit = self._lit * self._n_px
        most = max(int(_MOST_RAYS_ACROSS / self._largest_px), MAX_SAMPLES)
        cast, count = first_samples(expected, n_lit, 0.0, 0.0, least, self._budget, most)
        if count > MAX_SAMPLES:
            few, count = count, min(math.ceil(_NO_SECOND * count), most)
            cast *= (count / few) ** 2
        n_facets = sum(level.n_facets * body.shown_share for level, body in zip(self._full, self._drawn, strict=True))
        facing_ns = (self._costs.rays_ns(cast, self._n_facing) + n_facets * self._costs.facet_ns
                     + max(FACING_SAMPLES, count) ** 2 * self._n_px * self._costs.sample_ns)
        lit = n_lit / self._box_px
        all_ns = self._costs.rays_ns(cast / lit * _dear_share(lit), self._n_facing)
        is_facing = self._box_px * count**2 > _FEW_RAYS and facing_ns < all_ns and self._rounding_px < 1.0
        return facing_ns if is_facing else all_ns, self._sampled(
            "rays", count, errors, noise=noise, rays_at_facing=is_facing)

    def _sampled(self, engine: str, count: int, errors: tuple[float, float], floor: float = 0.0,
                 **told) -> WindowPlan:
        return self._plan(engine, samples=count, **self._whole(count),
                          predicted_error=math.hypot(floor, math.sqrt(sum(errors) * count**-3)), **told)

    def _whole(self, count: int) -> dict[str, tuple[float, ...]]:
        """Bounds [px] and grid of the region with so many cells along a pixel's side."""
        x0, y0, x1, y1 = self._roi
        return {"bounds_px": (x0 - 0.5, y0 - 0.5, x1 - 0.5, y1 - 0.5),
                "grid": ((x1 - x0) * count, (y1 - y0) * count)}

    def _plan(self, engine: str, *, predicted_error: float, **told) -> WindowPlan:
        told = {"budget": self._budget, "modelling_error": 0.0, "noise": (0.0, 0.0), "shadow_share": 0.0,
                "texel_share": 0.0} | told
        return WindowPlan(bodies=tuple(view.name for view in self._members), engine=engine, roi=self._roi,
                          predicted_error=self._gain * predicted_error, **told)

    def _errors(self, levels: Sequence[LevelTraits]) -> tuple[float, float]:
        """Squared errors of one sample a pixel, of the worst body: of outlines, of creases."""
        limb, creases = zip(*(squared_errors(view, level) for view, level in zip(self._members, levels, strict=True)),
                            strict=True)
        return max(limb), max(creases)

    def _expected(self, levels: Sequence[LevelTraits]) -> Expected:
        return Expected.worst(Expected.of(view, level) for view, level in zip(self._members, levels, strict=True))

    def _noise(self, levels: Sequence[LevelTraits]) -> tuple[float, float]:
        return (max(level.crease_rad for level in levels),
                max(facets_per_px(view, level.n_facets) for view, level in zip(self._members, levels, strict=True)))
