"""Deviation of a surface from the true one: nearest points, alignment, and how much of the truth is there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from glrender_navigation.checks import number, refuse
from scipy.spatial.transform import Rotation

from .frames import PosedFrame, seen_in_light
from .mesh import Closest, HasFacets, Mesh

ALIGNMENTS = ("none", "attitudes", "similarity")
# Points of the truth for its completeness, and of the model for its alignment.
_N_SAMPLES, _N_ALIGNED = 20_000, 10_000
# Share of the points, the nearer ones, that count for the alignment: others are gaps in a surface, or outliers.
_SHARE_ALIGNED = 0.9
_MOST_STEPS = 40
# A step that moves the surface by less than this share of its radius is the last.
_SETTLED = 1e-7
# A model that is more times larger is in another unit, as is one more times smaller that lies off the truth.
_MOST_TIMES_LARGER = 10.0
# So is one that alignment scales by more, or by less than the inverse.
_MOST_SCALE = 2.0
_UNIT_HINT = "one of them is in another unit: give metres"
_MAD_OF_NORMAL = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Deviation:
    """The deviation of a model from the truth: signed distances of its vertices, positive outside of the truth.

    Attributes
    ----------
    mean_m, sigma_m : float [m]
    mad_m : float [m]
        Median absolute deviation from the median, times 1.4826: sigma of a normal distribution.
    p95_m, max_m : float [m]
        95th percentile and maximum of the distances without sign.
    complete_1px, complete_2px : float [1], None without `px_m`
        Share of the truth's area (of which frames saw in light, where frames are given) that lies within one and two
        pixels of the model.
    seen : float [1]
        Share of the truth's area that three frames or more saw in light; 1 without frames.
    scale, turn_rad, shift_m : float
        Scale, turn and shift of the alignment that was applied to the model, about the body's origin.
    per_vertex_m : (V,) float64 [m]
    mesh : Mesh
        The model as aligned.
    """

    mean_m: float
    sigma_m: float
    mad_m: float
    p95_m: float
    max_m: float
    complete_1px: float | None
    complete_2px: float | None
    seen: float
    scale: float
    turn_rad: float
    shift_m: float
    per_vertex_m: np.ndarray
    mesh: Mesh


def deviation(model: HasFacets, truth: HasFacets, *, px_m: float | None = None, align: str = "none",
              frames: Sequence[PosedFrame] | None = None) -> Deviation:
    """The deviation of a model's vertices from the truth's facets.

    Parameters
    ----------
    model, truth : Mesh or glrender.Shape
        In the same axes, in metres.
    px_m : float [m], optional
        Pixel on the ground, of which completeness is reported.
    align : {"none", "attitudes", "similarity"}
        Alignment that is taken off first: none; scale and shift, where attitudes are known; scale, shift and turn.
    frames : sequence of PosedFrame, optional
        Completeness is of what three of them or more saw in light; else of the whole truth.

    Raises
    ------
    ValueError
        Surfaces that do not overlap, of other units by their sizes, no frames at all, or an unknown alignment.
    """
    model, truth = Mesh.of(model), Mesh.of(truth)
    if align not in ALIGNMENTS:
        raise refuse("align", f"must be one of {', '.join(ALIGNMENTS)}", align)
    if px_m is not None:
        px_m = number("px_m", px_m, "give metres on the ground")
    closest = Closest(truth)
    _check_size(model, closest)
    scale, turn, shift_m = (1.0, np.eye(3), np.zeros(3)) if align == "none" else _aligned(model, closest, align)
    if not 1.0 / _MOST_SCALE < scale < _MOST_SCALE:
        raise refuse("model", f"must be of the truth's scale to {_MOST_SCALE:g} times", f"{scale:.4g} by alignment",
                     _UNIT_HINT)
    mesh = Mesh(vertices_m=scale * model.vertices_m @ turn.T + shift_m, facets=model.facets)
    (low, high), (least, most) = ((each.used_vertices_m.min(axis=0), each.used_vertices_m.max(axis=0))
                                  for each in (mesh, truth))
    if (np.minimum(high, most) < np.maximum(low, least)).any():
        raise refuse("model", f"must overlap the truth, which lies from {least.round(1).tolist()} to "
                     f"{most.round(1).tolist()} m", low.round(1).tolist(), "align it, or check axes and origin")
    distance_m, _, _ = closest(mesh.vertices_m)
    used_m = distance_m[np.unique(mesh.facets)]
    points_m, facet = truth.sample(_N_SAMPLES)
    seen = np.ones(len(points_m), bool)
    if frames is not None:
        seen = seen_in_light(frames, truth, points_m, facet) >= 3
    complete: list[float | None] = [None, None]
    if px_m is not None and seen.any():
        gap_m = np.abs(Closest(mesh)(points_m[seen])[0])
        complete = [float((gap_m <= pixels * px_m).mean()) for pixels in (1, 2)]
    return Deviation(mean_m=float(used_m.mean()), sigma_m=float(used_m.std()),
                     mad_m=float(_MAD_OF_NORMAL * np.median(np.abs(used_m - np.median(used_m)))),
                     p95_m=float(np.quantile(np.abs(used_m), 0.95)), max_m=float(np.abs(used_m).max()),
                     complete_1px=complete[0], complete_2px=complete[1], seen=float(seen.mean()), scale=scale,
                     turn_rad=float(Rotation.from_matrix(turn).magnitude()), shift_m=float(np.linalg.norm(shift_m)),
                     per_vertex_m=distance_m, mesh=mesh)


def _size_m(mesh: Mesh) -> float:
    """Diagonal of the box around the surface [m]."""
    return float(np.linalg.norm(np.ptp(mesh.used_vertices_m, axis=0)))


def _check_size(model: Mesh, closest: Closest) -> None:
    """A patch may be small, but lies within its own size of the truth."""
    size_m, true_m = _size_m(model), _size_m(closest.mesh)
    is_small = size_m * _MOST_TIMES_LARGER < true_m
    if size_m > _MOST_TIMES_LARGER * true_m or (is_small and np.abs(closest(model.sample(200)[0])[0]).min() > size_m):
        raise refuse("model", f"must be of the truth's size, {true_m:.6g} m across", size_m, _UNIT_HINT)


def _aligned(model: Mesh, closest: Closest, align: str) -> tuple[float, np.ndarray, np.ndarray]:
    """Scale, rotation (3, 3) and shift (3,) that lay the model on the truth; from the best of two starts."""
    points_m, true_m = (mesh.sample(_N_ALIGNED)[0] for mesh in (model, closest.mesh))
    middle_m, true_middle_m = points_m.mean(axis=0), true_m.mean(axis=0)
    larger = float((true_m - true_middle_m).std() / (points_m - middle_m).std())
    starts = [(1.0, np.zeros(3)), (larger, true_middle_m - larger * middle_m)]
    far_m = [np.median(np.abs(closest(scale * points_m[::20] + shift_m)[0])) for scale, shift_m in starts]
    scale, shift_m = starts[int(far_m[1] < 0.5 * far_m[0])]
    return _closest_points(points_m, closest, scale, shift_m, align == "similarity")


def _closest_points(points_m: np.ndarray, closest: Closest, scale: float, shift_m: np.ndarray,
                    is_turned: bool) -> tuple[float, np.ndarray, np.ndarray]:
    """Iterated least squares of the distances along the normals, trimmed.

    Source: Chen and Medioni (1992), point to plane; Chetverikov et al. (2002), trimmed.
    """
    turn, radius_m = np.eye(3), _size_m(closest.mesh) / 2.0
    for _ in range(_MOST_STEPS):
        here = scale * points_m @ turn.T + shift_m
        _, place_m, facet = closest(here)
        gap, normal = place_m - here, closest.mesh.facet_normals[facet]
        length = np.linalg.norm(gap, axis=1)
        kept = length <= np.quantile(length, _SHARE_ALIGNED)
        middle = here[kept].mean(axis=0)
        arm, normal, gap = (here[kept] - middle) / radius_m, normal[kept], gap[kept]
        columns = [normal, (arm * normal).sum(axis=1)[:, None], *([np.cross(arm, normal)] if is_turned else [])]
        # Turns that leave a surface in itself, as a sphere's, are cut off.
        step = np.linalg.lstsq(np.hstack(columns), (gap * normal).sum(axis=1), rcond=1e-4)[0] / [radius_m]
        small = Rotation.from_rotvec(step[4:] if is_turned else np.zeros(3)).as_matrix()
        factor = 1.0 + step[3]
        shift_m = factor * small @ (shift_m - middle) + middle + step[:3] * radius_m
        turn, scale = small @ turn, factor * scale
        if np.abs(step).max() < _SETTLED:
            break
    return float(scale), turn, shift_m
