"""The planner's choice for areas: of which levels of detail, what they cost, and what they do not tell of. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial

from glrender_camera import PinholeCamera

from .costs import AREAS_CALL_NS, MIDDLES_CALL_NS, EngineCosts
from .eclipses import PENUMBRA_SHARE, sun_steps
from .error_model import BodyTraits, thin_penumbra
from .level_tables import AreaLevel, is_kept
from .render_plan import BodyPlan, LevelPlan
from .view import BodyView

# What a facet's light varies by where it is seen from, over its angle, and a pixel's solid angle within it, over its
# angle.
_UNEVEN, _PIXEL_ERROR = 0.3, 0.3
# Of a level of detail: of the budget, what its image may take, and its flux's error, of which there may be so many
# times the scatter between aspects; and pixels that its centre of brightness may be off, over the budget squared:
# 0.01 px at a budget of 0.02. Of budgets beyond that one, so much of what is beyond in diameters, if that is more.
_LEVEL_SHARE, _FLUX_SHARE, _FLUX_SCATTERS, _CENTRE_PX = 0.8, 0.1, 2.0, 25.0
_USUAL_BUDGET, _CENTRE_SIZES = 0.02, 0.02
# Of facets as lit as their middles: what their errors are more from other sides than those that were measured; what
# their image may take of the budget, to which drawing adds nothing, and the scatters of the flux, as above; their least
# error; and the largest phase angle at which they are drawn so.
_OTHER_SIDES, _MIDDLES_SHARE, _MIDDLES_SCATTERS, _MIDDLES_LEAST, _MIDDLES_RAD = 1.3, 0.9, 3.0, 0.003, 2.15
# Of frames that tell their error, what they tell over the mean of the sides that were measured: the deviation of its
# logarithm.
_TOLD_SPREAD = 0.3
# Squared error that is left along a pixel of an edge of another body, or of its shadow, over the area of the facets, or
# of the largest parts, that are cut there [px2]; what cutting one costs, in those of a facet.
_EDGE_ERROR, _MOST_CUT_PX, _CUT = 0.01, 6.0, 40.0
# Facets that face camera and Sun of which all are looked at closer, and what the edges of shadows cost more then.
_FEW, _OF_FEW = 3000, 2.5
# Radii from the body from which levels are as they were measured, from afar.
_LEAST_RANGE = 8.0
# The cost of areas of several bodies together, over that of as many facets of one.
_SEVERAL = 1.4
# Frames in which large shapes are shaded anew: in others Sun and camera are still near the same nodes.
_ANEW = 0.5
# Of levels by middles that cost nearly as little, so many times the least, the one with the least error.
_NEARLY = 1.2
# The cost of a normal that a facet stands for, in those of a facet; and of any for a facet, in those of a normal.
_NORMAL, _RELIEF = 0.06, 15.0


@dataclass(frozen=True, kw_only=True)
class AreasChoice:
    """What areas would make of bodies that are drawn together.

    Attributes
    ----------
    ns : float [ns]
        Infinite where facets are not as bright everywhere, penumbras are wide, or not all is before the camera.
    error : float [1]
        What they do not tell of themselves.
    levels : tuple of LevelPlan
        Of each body.
    """

    ns: float
    error: float
    levels: tuple[LevelPlan, ...]


def choose_areas(members: Sequence[BodyView], traits: Mapping[str, BodyTraits], drawn: Sequence[BodyPlan],
                 camera: PinholeCamera, budget: float, error_gain: float, costs: EngineCosts, *, n_px: float,
                 shown_share: float, cells_per_px: float = 1.0) -> AreasChoice:
    """The levels of detail with which areas cost least.

    Parameters
    ----------
    members : sequence of BodyView
    traits : mapping of str to BodyTraits
    drawn : sequence of BodyPlan
        Of the members.
    camera : PinholeCamera
    budget : float [1]
        Before the camera's PSF.
    error_gain : float [1]
        What that leaves of it.
    costs : EngineCosts
    n_px : float [px]
        That the bodies cover.
    shown_share : float [1]
        Of the bodies, what the image shows.
    cells_per_px : float [1/px]
        Of a grid of their own, along a side.
    """
    bodies = [_Candidates(view, traits, body, members, camera, budget, error_gain, cells_per_px)
              for view, body in zip(members, drawn, strict=True)]

    @cache
    def cost(*chosen: tuple[_Candidates, AreaLevel | None]) -> tuple[float, float]:
        return _cost(chosen, budget, costs, n_px, shown_share)

    def best_middles(body: _Candidates) -> AreaLevel:
        choices = [(level, *cost((body, level))) for level in body.middles]
        most_ns = _NEARLY * min(ns for _, ns, _ in choices)
        return min(choices, key=lambda choice: (choice[1] > most_ns, choice[2]))[0]

    options = []
    if all(body.middles for body in bodies):
        options.append([(body, best_middles(body)) for body in bodies])
    fewest = sum(body.fewest_facets for body in bodies)
    if not options or cost(*options[0])[0] > costs.areas_ns(
            fewest, fewest * facing_share(max(body.view.phase_rad for body in bodies)) * shown_share):
        options.append([(body, None) for body in bodies])
        if any(body.fit for body in bodies):
            options.append([(body, min([None, *body.fit], key=lambda level, body=body: cost((body, level))[0]))
                            for body in bodies])
    best = min(options, key=lambda chosen: cost(*chosen)[0])
    ns, error = cost(*best)
    return AreasChoice(ns=ns, error=error, levels=tuple(body.plan(level) for body, level in best))


def facing_share(phase_rad: float) -> float:
    """Of a body's facets, those that face both camera and Sun, about."""
    return (math.pi - phase_rad) / (2.0 * math.pi)


class _Candidates:
    """A body, and the levels of detail that leave something of the budget: `fit` by areas, `middles` by their middles.

    A point spread function averages pixels' errors, not that of the flux.
    """

    def __init__(self, view: BodyView, traits: Mapping[str, BodyTraits], body: BodyPlan, members: Sequence[BodyView],
                 camera: PinholeCamera, budget: float, error_gain: float, cells_per_px: float):
        self.view, self.traits = view, traits[view.name]
        self.eclipse_error, self._is_alone = body.eclipse.error, len(traits) == 1
        # Of middles, which have hard edges of shadows.
        self._least_error = math.hypot(_MIDDLES_LEAST, body.penumbra_error)
        px_per_m = camera.focal_length_px / view.range_m
        self._size_px = 2.0 * self.traits.radius_m * px_per_m
        self._cells = self._size_px * cells_per_px
        self._wide = math.hypot(thin_penumbra(view) if body.penumbra_error else 0.0,
                                _PIXEL_ERROR * (1.0 + 3.0 * _off_axis(view, camera)) / camera.focal_length_px)
        # Of what casts shadows on it, and of what is before it: edges, and what is taken of its light, at most.
        cast_px = [2.0 * traits[name].radius_m * px_per_m for name in body.casters]
        before = [_overlap_px(view, other) for other in members if other.range_m < view.range_m]
        self._edges_px = (math.pi * sum(min(other_px, self._size_px) for other_px in cast_px)
                          + sum(2.0 * sum(sides) for sides in before))
        taken = sum((other_px / self._size_px) ** 2 for other_px in cast_px) + sum(
            math.prod(sides) / math.prod(_sides_px(view)) for sides in before if all(sides))
        self.lit_px = 0.3 * self._size_px**2 * (1.0 + math.cos(view.phase_rad))
        self.left_px = self.lit_px * max(1.0 - taken, 0.0)
        self.light = self.lit_px * self.traits.reflectance
        told = budget * error_gain
        self._errors: dict[AreaLevel | None, float] = {None: 0.0}
        # They were measured of whole bodies: what is left of one in a shadow, or at the frame's edge, errs by more.
        is_as_measured = view.is_whole and view.range_m >= _LEAST_RANGE * self.traits.radius_m
        # What is farthest from the Sun as seen from the body is lit in slivers, of which facets have parts.
        may_be_by_middles = view.phase_rad + self.traits.radius_m / view.range_m <= _MIDDLES_RAD
        self._fitting = partial(self._fits, budget=budget, told=told)
        self._measured = self.traits.area_levels if is_as_measured else ()
        self._has_casters = bool(body.casters)
        self.middles = [level for level in self._measured
                        if level.kind.by_middles and may_be_by_middles and (self._is_alone or not level.kind.n_points)
                        and self._fitting(level)]

    @property
    def fewest_facets(self) -> int:
        """Of the full shape and its levels by areas."""
        return min([self.n_facets(None), *(level.n_facets for level in self._measured if not level.kind.by_middles)])

    @cached_property
    def fit(self) -> list[AreaLevel]:
        """Levels by areas; worked out where they are asked for."""
        return [level for level in self._measured
                if not (level.kind.by_middles or self._has_casters) and self._fitting(level)]

    def _fits(self, level: AreaLevel, budget: float, told: float) -> bool:
        """Whether a level leaves something of the budget, and of what is left of it for the flux and the centre.

        Frames that tell of themselves need no margin: where it does not do, they are cut.
        """
        share, scatters = ((_MIDDLES_SHARE, _MIDDLES_SCATTERS) if level.kind.by_middles
                           else (_LEVEL_SHARE, _FLUX_SCATTERS))
        if self.tells(level):
            share = _OTHER_SIDES
        if level.kind.n_points:
            scatters = _FLUX_SCATTERS
        return (self.error(level) <= share * budget
                and scatters * level.flux_at(self.view.phase_rad, self._cells)[1] <= _FLUX_SHARE * told
                and level.centre_at(self.view.phase_rad) * self._size_px <= max(
                    _CENTRE_PX * told**2, _CENTRE_SIZES * (told - _USUAL_BUDGET) * self._size_px))

    def n_facets(self, level: AreaLevel | None) -> int:
        return self.traits.levels[0].n_facets if level is None else level.n_facets

    def crease_rad(self, level: AreaLevel | None) -> float:
        return self.traits.levels[0].crease_rad if level is None else level.crease_rad

    def error(self, level: AreaLevel | None) -> float:
        if level not in self._errors:
            error = level.error_at(self.view.phase_rad, self._size_px)
            self._errors[level] = (math.hypot(_OTHER_SIDES * error, self._least_error) if level.kind.by_middles
                                   else error)
        return self._errors[level]

    def tells(self, level: AreaLevel | None) -> bool:
        """Whether its image tells of its error."""
        return self._is_alone and level is not None and level.kind.tells_error

    def untold(self, level: AreaLevel | None) -> float:
        """The same of what the image does not tell itself once it is drawn."""
        return self._least_error if self.tells(level) else self.error(level)

    def missed_share(self, level: AreaLevel, budget: float) -> float:
        """Of frames that tell of their error, those that tell of more than a budget, and are cut."""
        told = level.told_at(self.view.phase_rad, self._size_px)
        return 0.5 * math.erfc(math.log(budget / told) / (_TOLD_SPREAD * math.sqrt(2.0))) if told else 0.0

    def cutting_ns(self, level: AreaLevel, costs: EngineCosts) -> float:
        """Of facets that edges of other bodies, and of their shadows, go through; large ones are divided before."""
        if not self._edges_px:
            return 0.0
        facet_px = self._facet_px(level)
        n_cut = self._edges_px * max(1.0 / facet_px, 2.0 * facet_px / _MOST_CUT_PX)
        return AREAS_CALL_NS + _CUT * n_cut * costs.area_ns

    def edges_squared(self, level: AreaLevel) -> float:
        """Squared error that middles leave there, over that of their mean [px]."""
        return _EDGE_ERROR * self._edges_px * min(self._facet_px(level) ** 2, _MOST_CUT_PX)

    def _facet_px(self, level: AreaLevel) -> float:
        """Side of its facets in the image."""
        return self._size_px * math.sqrt(1.2 / level.n_facets)

    def floor(self, level: AreaLevel | None) -> float:
        """What areas do not tell of themselves, but for a level of detail."""
        facet_m = self.traits.even_facet_m * math.sqrt(self.n_facets(None) / self.n_facets(level))
        return math.hypot(self._wide, _UNEVEN * facet_m / self.view.depth_m[0])

    def plan(self, level: AreaLevel | None) -> LevelPlan:
        if level is None:
            return LevelPlan()
        return replace(level.kind, flux_ratio=level.flux_at(self.view.phase_rad, self._cells)[0])


def _cost(each: Sequence[tuple[_Candidates, AreaLevel | None]], budget: float, costs: EngineCosts, n_px: float,
          shown_share: float) -> tuple[float, float]:
    """Nanoseconds of bodies with their levels, and the error that areas do not tell of themselves."""
    body, level = each[0]
    by_middles = level is not None and level.kind.by_middles
    floor, error = (max(getattr(body, what)(level) for body, level in each) for what in ("floor", "untold"))
    if len(each) > 1:
        error *= _unlike([body for body, _ in each])
    if by_middles:
        # What others hide and shade is left out of the mean, too.
        lit_px, left_px, light = (sum(getattr(body, name) for body, _ in each)
                                  for name in ("lit_px", "left_px", "light"))
        squared = error**2 * lit_px + (lit_px / light) ** 2 * sum(
            body.traits.reflectance**2 * body.edges_squared(level) for body, level in each)
        error = math.sqrt(squared / left_px) if left_px else math.inf
    left = math.sqrt(max(budget**2 - floor**2 - error**2, 0.0))
    ns = math.inf
    eclipse_error = max(body.eclipse_error for body, _ in each)
    steps = (1, 1.0) if eclipse_error <= PENUMBRA_SHARE * budget else sun_steps(eclipse_error, budget)
    if left and steps and floor <= PENUMBRA_SHARE * budget and not (by_middles and error > _MIDDLES_SHARE * budget):
        phase_rad = max(body.view.phase_rad for body, _ in each)
        facing = facing_share(phase_rad)
        n_facets = sum(body.n_facets(level) for body, level in each)
        n_facing = max(n_facets * facing * shown_share, 1.0)
        crease_rad = max(body.crease_rad(level) for body, level in each)
        if any(level for _, level in each) and n_facing < _FEW:
            crease_rad *= _OF_FEW
        facet_px = math.sqrt(2.0 * facing * n_px / n_facing)
        anew = 1.0
        if level is not None and level.kind.n_points:
            ns = costs.points_ns(n_facets, n_facing)
        elif by_middles:
            if all(is_kept(level.n_facets, body.view, body.traits.radius_m) for body, level in each):
                anew = _ANEW
            ns = (costs.middles_ns(n_facets, n_facing, n_px, facet_px, anew)
                  + (len(each) - 1) * MIDDLES_CALL_NS
                  + sum(body.cutting_ns(level, costs) for body, level in each))
        else:
            ns = ((_SEVERAL if len(each) > 1 else 1.0) * steps[0]
                  * costs.areas_ns(n_facets, n_facing, n_px, facet_px, crease_rad, phase_rad, left))
        if n_normals := sum(level.n_normals for _, level in each if level):
            ns += anew * (n_normals + _RELIEF * n_facets) * facing * shown_share * _NORMAL * costs.area_ns
    if len(each) == 1:
        error = body.untold(level)
    if math.isfinite(ns) and body.tells(level):
        ns += body.missed_share(level, left) * _cost([(body, None)], budget, costs, n_px, shown_share)[0]
    return ns, math.hypot(floor, error)


def _unlike(bodies: Sequence[_Candidates]) -> float:
    """What the errors of bright bodies are more, over the mean of them and of dark ones that are drawn together."""
    lit_px, light = sum(body.lit_px for body in bodies), sum(body.light for body in bodies)
    return math.sqrt(lit_px * sum(body.light * body.traits.reflectance for body in bodies)) / light if light else 1.0


def _sides_px(view: BodyView) -> tuple[float, float]:
    """Of the outline's box: infinite where it has none."""
    if view.bounds_px is None:
        return math.inf, math.inf
    x0, y0, x1, y1 = view.bounds_px.tolist()
    return x1 - x0, y1 - y0


def _overlap_px(view: BodyView, other: BodyView) -> tuple[float, float]:
    """Sides of what two outlines' boxes share: of one that has none, all of the other."""
    if view.bounds_px is None or other.bounds_px is None:
        return _sides_px(other if view.bounds_px is None else view)
    (a, b, c, d), (e, f, g, h) = view.bounds_px.tolist(), other.bounds_px.tolist()
    across, down = min(c, g) - max(a, e), min(d, h) - max(b, f)
    return (across, down) if across > 0.0 and down > 0.0 else (0.0, 0.0)


def _off_axis(view: BodyView, camera: PinholeCamera) -> float:
    """Tangent of the angle between the boresight and the farthest corner of a body's box."""
    if view.bounds_px is None:
        return math.inf
    return max(math.hypot(x - camera.principal_point_px[0], y - camera.principal_point_px[1])
               for x in view.bounds_px[::2] for y in view.bounds_px[1::2]) / camera.focal_length_px
