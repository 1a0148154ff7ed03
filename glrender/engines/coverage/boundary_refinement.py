"""The sunlit areas of a body: facets that boundaries of light cross are divided as the tolerance asks, then clipped.

Between corners that differ runs the edge of a shadow, or of what hides the rest, which is nearly straight within a
small triangle. Where another body or a far part may hide light between corners that agree, large facets are divided.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...planner.error_budget import MISSED_SHARE, UNDIVIDED_SHARE
from ..rays.mesh import dot
from . import sunlit_error
from .boundary_clip import FacetCutter
from .corner_visibility import FEW, CornerVisibility
from .sub_triangles import FacetParts
from .sunlit_areas import SunlitAreas
from .sunlit_error import CLIPPED_ERROR, pixels_squared

# Bisections by which ends of cuts are found: of many triangles, and of few, whose errors do not cancel.
_BISECTIONS, _BISECTIONS_OF_FEW = 2, 6
# The part of the error of boundaries between corners that agree that is left where the facets with such corners are
# divided too, and that each division more leaves of that [1]: 12 frames at tolerances of 0.004 to 0.01, compared with
# rays, have less. The most such divisions; and the most parts, twice those of long facets, a round choice of 1 s.
_STILL_MISSED, _STILL_MISSED_LATER = 0.36, 0.5
_MOST_NEXT = 3
_MOST_PARTS = 2_500_000
# Squared light of a facet over the squared tolerance from which it is divided first [1]: of few facets, and of many.
_LARGE = 0.15
_LARGE_OF_MANY = 20.0
# Most divisions of a triangle by four: a round choice.
_MOST_DIVISIONS = 6
# Triangles that are too many to be divided again: a round choice.
_MANY = 120_000
# Length of a part over its facet's width [1] up to which corners show what is between them: a round choice, tried with
# two layers of ten bars, 1 : 400 to 1 : 50.
_LONG = 1.5


def find_areas(seen: CornerVisibility, most_squared: float, flux_weight: float) -> SunlitAreas:
    """Clip facets, and divide them before, until the squared error is small enough, or no more are divided.

    Parameters
    ----------
    seen : CornerVisibility
    most_squared : float
        The largest squared error.
    flux_weight : float
        Weight of the squared bias in it.
    """
    seen, large = _divide_large(seen, most_squared)
    triangles, lit, whole = seen.boundary, [], seen.whole
    squared = float(seen.squared_light(triangles).sum())
    bias = sunlit_error.clipped_bias(seen.radiance.of(triangles.facet) * triangles.area_px)
    missed = sunlit_error.missed(squared / seen.safety_squared, seen.facets.crease_rad, seen.view.phase_rad)
    behind = _missed_behind(seen)
    between = behind + CLIPPED_ERROR * float(seen.squared_light(large).sum())
    error = CLIPPED_ERROR * squared + missed + between
    if error + flux_weight * bias**2 > most_squared:
        is_missed = missed > MISSED_SHARE * most_squared
        if is_missed or not seen.is_alone:
            beside, is_next = seen.whole_facets()
            if not (is_missed and len(seen.facing) <= _MANY):
                beside, is_next = beside.at(np.flatnonzero(is_next)), is_next[is_next]
            whole = np.setdiff1d(whole, beside.facet)
            done, triangles, missed = _divide_with_beside(seen, beside, is_next, missed,
                                                          MISSED_SHARE * most_squared - between)
            lit.append(done)
        done, triangles, error = _divide(seen, triangles, missed + between, most_squared)
        lit, bias = lit + done, 0.0
    n_bisections = _BISECTIONS if len(triangles.facet) > FEW else _BISECTIONS_OF_FEW
    polygons = [(each.corner, each.facet) for each in lit] + seen.cutter.cut_off(triangles, n_bisections)
    uniform, _ = seen.cutter.sorted(seen.uniform)
    return SunlitAreas(seen=seen, whole=whole, polygons=[*polygons, (uniform.corner, uniform.facet)],
                       clipped=triangles, large=large, missed=missed, behind=behind, squared=error, bias=bias)


def _missed_behind(seen: CornerVisibility) -> float:
    """Squared error of what other bodies that are smaller than facets may hide or shade between corners."""
    if not seen.may_stand_before:
        return 0.0
    facet = np.concatenate([seen.whole, seen.uniform.facet])
    area_px = np.concatenate([seen.facet_px(seen.whole), seen.uniform.area_px])
    return sunlit_error.missed_behind(pixels_squared(seen.radiance.of(facet), area_px))


def _divide_with_beside(seen: CornerVisibility, beside: FacetParts, is_next: np.ndarray, missed: float,
                        most_left: float) -> tuple[FacetParts, FacetParts, float]:
    """Lit and mixed parts of boundary triangles and of others, and the error left: boundaries bend, or begin anew.

    The others (N,) are divided once; then boundaries, old and new, and those that are next to an old one (N,), until
    the error is small enough or parts are too many.
    """
    cutter, missed = seen.cutter, _STILL_MISSED * missed
    beside, is_next = cutter.quarters(beside), np.tile(is_next, 4)
    whole, begun = cutter.sorted(beside.at(np.flatnonzero(~is_next)))
    beside = beside.at(np.flatnonzero(is_next))
    triangles = FacetParts.joined([seen.boundary, begun])
    for _ in range(_MOST_NEXT - 1):
        if missed <= most_left or 4 * (len(triangles.facet) + len(beside.facet)) > _MOST_PARTS:
            break
        triangles, beside = cutter.quarters(triangles), cutter.quarters(beside)
        missed *= _STILL_MISSED_LATER
    lit, mixed = cutter.sorted(FacetParts.joined([triangles, beside]))
    return FacetParts.joined([whole, lit]), mixed, missed


def _divide(seen: CornerVisibility, triangles: FacetParts, missed: float, most_squared: float
            ) -> tuple[list[FacetParts], FacetParts, float]:
    """Divide triangles until clipping, with the error `missed`, errs by no more than a square.

    Lit parts, mixed ones, and their error.
    """
    lit, left, error = [], [], missed
    allowed = missed if missed > most_squared else most_squared - missed
    for _ in range(_MOST_DIVISIONS):
        squared = CLIPPED_ERROR * seen.squared_light(triangles)
        if squared.sum() <= allowed:
            break
        # The dimmest ones stay as they are.
        order = np.argsort(squared)
        n_left = int(np.searchsorted(np.cumsum(squared[order]), UNDIVIDED_SHARE * allowed))
        left.append(triangles.at(order[:n_left]))
        rest = float(squared[order[:n_left]].sum())
        error, allowed = error + rest, allowed - rest
        done, triangles = seen.cutter.sorted(seen.cutter.quarters(triangles.at(order[n_left:])))
        lit.append(done)
    error += CLIPPED_ERROR * float(seen.squared_light(triangles).sum())
    return lit, FacetParts.joined([*left, triangles]), error


def _divide_large(seen: CornerVisibility, most_squared: float) -> tuple[CornerVisibility, FacetParts]:
    """Divide facets that have more light than may be missed, few facets sooner: parts find light between corners.

    Long ones of few are halved before. And the parts whose corners agree that would have to be divided further.
    """
    cutter = seen.cutter
    if cutter.is_free:
        return seen, FacetParts.none()
    least = _LARGE if len(seen.facing) <= FEW else _LARGE_OF_MANY
    # A sheet that turns its back to the camera shades unseen, as another body may.
    always = _LARGE_OF_MANY if seen.is_alone and not seen.facets.solid.has_backs else least
    of_hidden = least / max(int(seen.may_hide_light.sum()), 1)

    def are_large(facet: np.ndarray, area_px: np.ndarray, radiance: np.ndarray | float, least: float) -> np.ndarray:
        most = np.where(seen.may_hide_light.take(facet), of_hidden, least) * most_squared
        return pixels_squared(radiance, area_px) > most

    area_px = seen.facet_px(seen.facing)
    large = np.flatnonzero(are_large(seen.facing, area_px, seen.brightest, least))
    facet = seen.facing[large]
    large = large[are_large(facet, area_px[large], seen.radiance.of(facet), least)]
    long, width_m = _long(seen, area_px, least * most_squared)
    large = np.union1d(large, long)
    if not len(large):
        return seen, FacetParts.none()
    parts = seen.parts_of(large)
    is_large = np.zeros(seen.facets.n_facets, bool)
    is_large[parts.facet] = True
    boundary = seen.boundary.at(np.flatnonzero(~is_large.take(seen.boundary.facet)))
    small = []
    if len(long):
        parts = _halved(cutter, parts, width_m)
    for division in range(_MOST_DIVISIONS + 1):
        # A boundary that passes between corners that agree goes on in a neighbouring part whose corners differ, but
        # for those that another body, or a far part, makes in the middle of a facet.
        is_beside = np.zeros(cutter.points.r_m.shape[1], bool)
        for each in (parts, boundary):
            is_beside[each.corner[:, cutter.are_mixed(each)]] = True
        light = parts.facet, parts.area_px, seen.radiance.of(parts.facet)
        goes_on, is_first = is_beside.take(parts.corner).any(axis=0), division == 0
        goes_on = are_large(*light, least) & (is_first | goes_on | are_large(*light, always)) | (
            is_first & goes_on & np.isfinite(width_m.take(parts.facet)))
        small.append(parts.at(np.flatnonzero(~goes_on)))
        parts = parts.at(np.flatnonzero(goes_on))
        if division == _MOST_DIVISIONS or not 0 < len(parts.facet) <= _MANY:
            break
        parts = cutter.quarters(parts)
    small = FacetParts.joined([*small, parts])
    is_boundary = cutter.are_mixed(small)
    seen = replace(seen, whole=seen.whole[~is_large.take(seen.whole)], facing=np.delete(seen.facing, large),
                   corner=np.delete(seen.corner, large, axis=-1),
                   boundary=FacetParts.joined([boundary, small.at(np.flatnonzero(is_boundary))]),
                   uniform=small.at(np.flatnonzero(~is_boundary)))
    left = [parts, small.at(np.flatnonzero(_are_long(cutter, small, width_m)))] if len(long) else [parts]
    left = FacetParts.joined(left)
    return seen, left.at(np.flatnonzero(~cutter.are_mixed(left)))


def _long(seen: CornerVisibility, area_px: np.ndarray, least_squared: float) -> tuple[np.ndarray, np.ndarray]:
    """Facets of few that are much longer than wide, with more squared light than they may miss, by their numbers.

    And their widths [m] among those of the body's facets (F,), which are infinite. Bars of a truss hide and shade each
    other between corners that agree.
    """
    facets, width_m = seen.facets, np.full(seen.facets.n_facets, np.inf)
    if len(seen.facing) > FEW:
        return np.zeros(0, np.intp), width_m
    a, b, c = facets.corner_m(seen.facing)
    across = np.cross(b - a, c - a, axis=0)
    length_squared = FacetParts(facets.corners.take(seen.facing, axis=1), seen.facing, area_px).sides_squared(
        facets.vertices_m).max(axis=0)
    long = np.flatnonzero(length_squared > 2.0 * _LONG * np.sqrt(dot(across, across)))
    squared = pixels_squared(seen.radiance.of(seen.facing.take(long)), area_px.take(long))
    long = long[squared * len(long) > least_squared]
    width_m[seen.facing.take(long)] = np.sqrt(dot(across, across) / length_squared).take(long)
    return long, width_m


def _are_long(cutter: FacetCutter, parts: FacetParts, width_m: np.ndarray) -> np.ndarray:
    """Whether parts (N,) are longer than their facets, of widths (F,) [m], are wide."""
    return parts.sides_squared(cutter.points.r_m).max(axis=0) > (_LONG * width_m.take(parts.facet)) ** 2


def _halved(cutter: FacetCutter, parts: FacetParts, width_m: np.ndarray) -> FacetParts:
    """Parts, divided across until none is longer than its facet is wide, or they are too many."""
    done, n_parts = [], len(parts.facet)
    while 4 * n_parts <= _MOST_PARTS:
        is_long = _are_long(cutter, parts, width_m)
        if not is_long.any():
            break
        done.append(parts.at(np.flatnonzero(~is_long)))
        parts = cutter.halves(parts.at(np.flatnonzero(is_long)))
        n_parts += len(parts.facet) // 2
    return FacetParts.joined([*done, parts])
