"""Levels of detail as areas draw them: flat facets, and how far they are from the full shape, measured on each.

A level has the full shape's flux by a ratio, the mean over aspects. What is left depends on the shape's relief, so that
it is told by tables of size and phase angle rather than by a formula.
"""

from __future__ import annotations

import hashlib
import logging
import math
import time
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from glrender_camera import PinholeCamera

from .area_engine import AreaEngine
from .cache import cached_arrays, tell_of_wait
from .constants import AU_M
from .errors import DeviceError
from .facet_relief import LevelShape
from .facet_tables import has_middles, point_counts
from .frames import look_at
from .level_tables import PHASES_RAD, SIZES_PX, AreaLevel
from .lod import Level
from .lod_flux import aspect_directions
from .ray_engine import RayEngine
from .refine import pixel_means
from .render_plan import LevelPlan
from .scene import Body, Scene
from .state import Pose, State
from .surface import Surface
from .view import view_bodies

_log = logging.getLogger(__name__)

_ASPECTS, _RANGE_RADII = 8, 50.0
# Of both images that are compared.
_BUDGET = 0.02
# Size [px] at which facets' middles have another flux than where they are many pixels wide: there it is seen where they
# overlap, and taken off. In between by the size's logarithm.
_SMALL_PX = 16.0
# What measuring takes a facet of the full shape, with tables of horizons, about.
_FACET_S = 7e-5
# What is told where an image cannot be made.
_UNKNOWN = 1e3
# Arrays of an `AreaLevel`.
_NAMES = ("error", "flux_ratio", "flux_scatter", "centre", "told")


def area_levels(body: Body, levels: Sequence[Level], cache: Path | None = None
                ) -> tuple[tuple[LevelShape, ...], tuple[AreaLevel, ...]]:
    """A body's levels of detail as shapes, and what each costs; kept in the cache with the levels.

    None of a body that is not drawn by areas, as one with a texture, nor without rays.
    """
    if not levels or not Surface(body).is_even:
        return (), ()
    made = tuple(LevelShape.of(body.drawn_shape, level) for level in levels)
    shapes = [body.drawn_shape, *(level.shape for level in made)]
    # Each flat, and with relief; by areas, and by middles. The full shape by areas is the truth.
    kinds = [LevelPlan(number=number, has_relief=has_relief, by_middles=by_middles)
             for number, shape in enumerate(shapes) for has_relief in (False, True) for by_middles in (False, True)
             if (by_middles or number) and (number or not has_relief) and (has_middles(shape) or not by_middles)]
    kinds += [LevelPlan(by_middles=True, n_points=n_points) for n_points in point_counts(len(body.shape.facets))]
    digest = hashlib.sha256(f"{body.shape.content_hash} {body.brdf!r} {[each.shape.content_hash for each in made]} "
                            f"{kinds} {_ASPECTS} {_RANGE_RADII} {_BUDGET} {_SMALL_PX} {SIZES_PX.tolist()} "
                            f"{PHASES_RAD.tolist()}".encode())
    names = [f"{name}_{k}" for k in range(len(kinds)) for name in _NAMES]
    with warnings.catch_warnings():
        # Of laws beyond their phases.
        warnings.simplefilter("ignore", UserWarning)
        try:
            arrays = cached_arrays(f"areas12-{digest.hexdigest()[:32]}", names, lambda: _measured(body, made, kinds),
                                   cache)
        except DeviceError:
            return (), ()
    return made, tuple(AreaLevel(kind=kind, n_facets=kind.n_points or len(shapes[kind.number].facets),
                                 crease_rad=shapes[kind.number].crease_rad,
                                 n_normals=len(made[kind.number - 1].normal) if kind.has_relief else 0,
                                 **{name: arrays[f"{name}_{k}"] for name in _NAMES})
                       for k, kind in enumerate(kinds))


def _measured(body: Body, levels: Sequence[LevelShape], kinds: Sequence[LevelPlan]) -> dict[str, np.ndarray]:
    began, side = time.perf_counter(), int(SIZES_PX[-1])
    camera = PinholeCamera(name="far", width_px=side, height_px=side, focal_length_px=0.5 * side * _RANGE_RADII)
    scene = Scene(bodies=[body], cameras=[camera], sun_disc=False)
    rays = RayEngine(scene)
    # Not before: where there are no rays nothing is measured.
    tell_of_wait(_log, "measuring levels of detail", len(body.shape.facets), _FACET_S)
    areas = AreaEngine(scene, rays, {body.name: levels}, keeps_areas=False)
    # Of each shape, aspect and phase: the flux, where it is large and where it is small, its centre [px], and sums over
    # the image at each size.
    flux = np.full((1 + len(kinds), _ASPECTS, len(PHASES_RAD)), math.nan)
    small = np.full(flux.shape, math.nan)
    centre = np.zeros((*flux.shape, 2))
    sums = np.zeros((len(kinds), _ASPECTS, len(PHASES_RAD), len(SIZES_PX), 4))
    told_at = np.zeros((len(kinds), len(PHASES_RAD), len(SIZES_PX)))
    for aspect, phase in np.ndindex(flux.shape[1:]):
        state, seen = _state(body, aspect, PHASES_RAD[phase]), {}
        for px in (side, _SMALL_PX):
            near = _at_size(camera, px)
            views = view_bodies(state, near, scene.hulls)
            x0, y0, x1, y1 = _box(views[0].bounds_px, side)
            seen[px] = near, views, (x0 - 0.5, y0 - 0.5, x1 - 0.5, y1 - 0.5), (x1 - x0, y1 - y0)
        full = None
        for k, kind in enumerate((LevelPlan(), *kinds)):
            image, told = areas.draw((body.name,), *seen[side], _BUDGET, {body.name: kind})
            total = image.sum()
            if math.isinf(told) or not total > 0.0:
                continue
            flux[k, aspect, phase] = total
            is_even = not kind.by_middles or kind.n_points
            small[k, aspect, phase] = total if is_even else areas.draw(
                (body.name,), *seen[_SMALL_PX], _BUDGET, {body.name: kind})[0].sum()
            centre[k, aspect, phase] = [image.sum(axis=axis) @ np.arange(image.shape[1 - axis]) / total
                                        for axis in range(2)]
            if not k:
                full = image
            elif full is not None:
                sums[k - 1, aspect, phase] = _compared(full, image)
            if kind.tells_error:
                for size, px in enumerate(SIZES_PX.tolist()):
                    near = _at_size(camera, px)
                    _, told = areas.draw((body.name,), near, view_bodies(state, near, scene.hulls), near.bounds_px,
                                         (1, 1), 0.0, {body.name: kind}, True)
                    told_at[k - 1, phase, size] += told / _ASPECTS
    areas.close()
    rays.close()
    with np.errstate(invalid="ignore", divide="ignore"):
        large = np.clip(np.log2(SIZES_PX / _SMALL_PX) / np.log2(side / _SMALL_PX), 0.0, 1.0)
        ratio = flux[0, ..., None] / (small[1:, ..., None] * (1.0 - large) + flux[1:, ..., None] * large)
        mean = ratio.mean(axis=1)
        # Of smaller sizes the images are those of the largest, made coarser.
        even = mean[:, None, :, -1:]
        squared = sums[..., 0] - 2.0 * even * sums[..., 1] + even**2 * sums[..., 2]
        errors = np.sqrt(np.max(np.maximum(squared, 0.0) / sums[..., 3], axis=1))
        shift = np.sqrt(np.max(np.sum((centre[1:] - centre[0])**2, axis=-1), axis=1)) / side
        scatter = ratio.std(axis=1, ddof=1) / mean
    made = {}
    for k in range(len(kinds)):
        known = (np.isfinite(mean[k]) & np.isfinite(errors[k])).all(axis=1)
        made |= {f"error_{k}": np.where(known[:, None], errors[k], _UNKNOWN),
                 f"flux_ratio_{k}": np.where(known[:, None], mean[k], 1.0),
                 f"flux_scatter_{k}": np.where(known[:, None], scatter[k], _UNKNOWN),
                 f"centre_{k}": np.where(known, shift[k], _UNKNOWN), f"told_{k}": told_at[k]}
    _log.info("levels of detail of %d facets by areas measured in %.1f s", body.shape.report.n_facets,
              time.perf_counter() - began)
    return made


def _at_size(camera: PinholeCamera, px: float) -> PinholeCamera:
    """A camera in which what fills another's image is so many pixels wide, in as large an image."""
    return replace(camera, focal_length_px=camera.focal_length_px * px / camera.width_px)


def _box(bounds_px: np.ndarray, side: int) -> tuple[int, int, int, int]:
    """Pixels of an outline, in whole blocks of the coarsest size's pixels."""
    block = side // int(SIZES_PX[0])
    low, high = np.reshape((bounds_px + 0.5) / block, (2, 2))
    return tuple(int(edge) for edge in np.clip([*np.floor(low), *np.ceil(high)], 0, side // block) * block)


def _state(body: Body, aspect: int, phase_rad: float) -> State:
    to_camera, aside = aspect_directions(aspect, _ASPECTS)
    place_m = _RANGE_RADII * body.hull.radius_m * to_camera
    return State(r_sun_inertial_m=AU_M * (math.cos(phase_rad) * to_camera + math.sin(phase_rad) * aside),
                 spacecraft=Pose(r_inertial_m=place_m, q_from_inertial=look_at(place_m, np.zeros(3))),
                 bodies={body.name: Pose(r_inertial_m=np.zeros(3))})


def _compared(full: np.ndarray, level: np.ndarray) -> np.ndarray:
    """Of each size, finest last: sums (S, 4) of full^2, full * level, level^2, and what a squared error is divided by.

    That is the number of lit pixels times the square of their mean in the full shape's image.
    """
    found = np.zeros((len(SIZES_PX), 4))
    for k in reversed(range(len(SIZES_PX))):
        lit = full > 0.0
        n_lit = np.count_nonzero(lit)
        found[k] = ((full * full).sum(), (full * level).sum(), (level * level).sum(),
                    np.count_nonzero(lit | (level > 0.0)) * (full.sum() / max(n_lit, 1)) ** 2)
        if k:
            full, level = (pixel_means(image, 2) for image in (full, level))
    return found
