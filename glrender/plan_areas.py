"""The planner's choice for areas: of which levels of detail, what they cost, and what they do not tell of. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from glrender_camera import PinholeCamera

from .costs import EngineCosts
from .error_model import BodyTraits, thin_penumbra
from .level_tables import AreaLevel
from .render_plan import BodyPlan, LevelPlan
from .view import BodyView

# Of the budget, what penumbras may cost; what a facet's light varies by where it is seen from, over its angle, and a
# pixel's solid angle within it, over its angle.
_FLOOR, _UNEVEN, _PIXEL_ERROR = 0.7, 0.3, 0.3
# What steps leave of an eclipse's penumbra, before anything is drawn: areas tell it themselves.
_ECLIPSE_STEPS = 0.25
# Of a level of detail: of the budget, what its image may take, and its flux's error, of which there may be so many
# times the scatter between aspects; and pixels that its centre of brightness may be off, over the budget squared:
# 0.01 px at a budget of 0.02. Of budgets beyond that one, so much of what is beyond in diameters, if that is more.
_LEVEL_SHARE, _FLUX_SHARE, _FLUX_SCATTERS, _CENTRE_PX = 0.8, 0.1, 2.0, 25.0
_USUAL_BUDGET, _CENTRE_SIZES = 0.02, 0.02
# Of facets as lit as their middles: what their errors are more from other sides than those that were measured; what
# their image may take of the budget, to which drawing adds nothing, and the scatters of the flux, as above; their least
# error; and the largest phase angle at which they are drawn so.
_OTHER_SIDES, _MIDDLES_SHARE, _MIDDLES_SCATTERS, _MIDDLES_LEAST, _MIDDLES_RAD = 1.3, 0.9, 4.0, 0.003, 2.15
# Facets that face camera and Sun of which all are looked at closer, and what the edges of shadows cost more then.
_FEW, _OF_FEW = 3000, 2.5
# Radii from the body from which levels are as they were measured, from afar.
_LEAST_RANGE = 8.0
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
                 shown_share: float) -> AreasChoice:
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
    """
    bodies = [_Candidates(view, traits[view.name], body, camera, budget, error_gain, len(members) == 1)
              for view, body in zip(members, drawn, strict=True)]

    def together(chosen: Sequence[AreaLevel | None]) -> AreasChoice:
        return _together(bodies, chosen, budget, costs, n_px, shown_share)

    full = together([None] * len(bodies))
    if not any(body.fit for body in bodies):
        return full
    # Each body by itself: what is best of it.
    alone = [min((None, *body.fit), key=lambda level, body=body: _together(
        [body], [level], budget, costs, n_px, shown_share).ns) for body in bodies]
    return min(full, together(alone), key=lambda choice: choice.ns)


def facing_share(phase_rad: float) -> float:
    """Of a body's facets, those that face both camera and Sun, about."""
    return (math.pi - phase_rad) / (2.0 * math.pi)


class _Candidates:
    """A body, and the levels of detail that leave something of the budget.

    A point spread function averages pixels' errors, not that of the flux.
    """

    def __init__(self, view: BodyView, traits: BodyTraits, body: BodyPlan, camera: PinholeCamera, budget: float,
                 error_gain: float, is_alone: bool):
        self.view, self.traits = view, traits
        self.eclipse_error, self._penumbra_error = body.eclipse_error, body.penumbra_error
        self._size_px = 2.0 * traits.radius_m * camera.focal_length_px / view.range_m
        self._wide = math.hypot(thin_penumbra(view) if body.penumbra_error else 0.0,
                                _PIXEL_ERROR * (1.0 + 3.0 * _off_axis(view, camera)) / camera.focal_length_px)
        told = budget * error_gain
        # They were measured of whole bodies: what is left of one in a shadow, or at the frame's edge, errs by more.
        is_as_measured = (view.is_whole and not body.may_be_eclipsed
                          and view.range_m >= _LEAST_RANGE * traits.radius_m)
        # What is farthest from the Sun as seen from the body is lit in slivers, of which facets have parts.
        may_be_by_middles = is_alone and view.phase_rad + traits.radius_m / view.range_m <= _MIDDLES_RAD
        self.fit = [level for level in traits.area_levels if is_as_measured and self._fits(level, budget, told)
                    and (may_be_by_middles or not level.kind.by_middles)]

    def _fits(self, level: AreaLevel, budget: float, told: float) -> bool:
        """Whether a level leaves something of the budget, and of what is left of it for the flux and the centre."""
        share, scatters = ((_MIDDLES_SHARE, _MIDDLES_SCATTERS) if level.kind.by_middles
                           else (_LEVEL_SHARE, _FLUX_SCATTERS))
        return (self.error(level) <= share * budget
                and scatters * level.flux_at(self.view.phase_rad)[1] <= _FLUX_SHARE * told
                and level.centre_at(self.view.phase_rad) * self._size_px <= max(
                    _CENTRE_PX * told**2, _CENTRE_SIZES * (told - _USUAL_BUDGET) * self._size_px))

    def n_facets(self, level: AreaLevel | None) -> int:
        return self.traits.levels[0].n_facets if level is None else level.n_facets

    def crease_rad(self, level: AreaLevel | None) -> float:
        return self.traits.levels[0].crease_rad if level is None else level.crease_rad

    def error(self, level: AreaLevel | None) -> float:
        if level is None:
            return 0.0
        error = level.error_at(self.view.phase_rad, self._size_px)
        # Middles have hard edges of shadows, and do not tell of it.
        return (math.hypot(_OTHER_SIDES * error, _MIDDLES_LEAST, self._penumbra_error) if level.kind.by_middles
                else error)

    def floor(self, level: AreaLevel | None) -> float:
        """What areas do not tell of themselves, but for a level of detail."""
        facet_m = self.traits.even_facet_m * math.sqrt(self.n_facets(None) / self.n_facets(level))
        return math.hypot(self._wide, _UNEVEN * facet_m / self.view.depth_m[0])

    def plan(self, level: AreaLevel | None) -> LevelPlan:
        if level is None:
            return LevelPlan()
        return replace(level.kind, flux_ratio=level.flux_at(self.view.phase_rad)[0])


def _together(bodies: Sequence[_Candidates], chosen: Sequence[AreaLevel | None], budget: float, costs: EngineCosts,
              n_px: float, shown_share: float) -> AreasChoice:
    each = list(zip(bodies, chosen, strict=True))
    floor, error = (max(getattr(body, what)(level) for body, level in each) for what in ("floor", "error"))
    left = math.sqrt(max(budget**2 - floor**2 - error**2, 0.0))
    ns = math.inf
    if left and max(floor, _ECLIPSE_STEPS * max(body.eclipse_error for body in bodies)) <= _FLOOR * budget:
        phase_rad = max(body.view.phase_rad for body in bodies)
        facing = facing_share(phase_rad)
        n_facets = sum(body.n_facets(level) for body, level in each)
        n_facing = max(n_facets * facing * shown_share, 1.0)
        crease_rad = max(body.crease_rad(level) for body, level in each)
        if any(chosen) and n_facing < _FEW:
            crease_rad *= _OF_FEW
        facet_px = math.sqrt(2.0 * facing * n_px / n_facing)
        if chosen[0] is not None and chosen[0].kind.by_middles:
            ns = costs.middles_ns(n_facets, n_facing, n_px, facet_px)
        else:
            ns = costs.areas_ns(n_facets, n_facing, n_px, facet_px, crease_rad, phase_rad, left)
        if n_normals := sum(level.n_normals for level in chosen if level):
            ns += (n_normals + _RELIEF * n_facets) * facing * shown_share * _NORMAL * costs.area_ns
    return AreasChoice(ns=ns, error=math.hypot(floor, error), levels=tuple(body.plan(level) for body, level in each))


def _off_axis(view: BodyView, camera: PinholeCamera) -> float:
    """Tangent of the angle between the boresight and the farthest corner of a body's box."""
    if view.bounds_px is None:
        return math.inf
    return max(math.hypot(x - camera.principal_point_px[0], y - camera.principal_point_px[1])
               for x in view.bounds_px[::2] for y in view.bounds_px[1::2]) / camera.focal_length_px
