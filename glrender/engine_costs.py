"""What drawing costs on this machine: a facet, a sample, a ray, an area, measured once and kept."""

from __future__ import annotations

import hashlib
import logging
import math
import os
import resource
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path

import numpy as np
from glrender_camera import PinholeCamera

from . import frames, generate
from .area_engine import AreaEngine
from .brdf import Lambert
from .cache import cache_folder, cached_arrays
from .costs import AREAS_CALL_NS, EngineCosts
from .errors import ConfigError
from .gl.context import Context
from .gl.mesh import IRRADIANCE_STAGE, Mesh, SurfaceVariant
from .gl.targets import Target
from .ray_engine import RAYS_AT_ONCE, RayEngine
from .refine import pixel_errors
from .scene import Body, Scene
from .shape import Shape
from .state import Pose, State
from .view import view_bodies

_log = logging.getLogger(__name__)
_NAME = "costs9-"
# Frames of each kind in a round, fewest and most rounds, and how nearly alike the two fastest are on a quiet machine.
_FRAMES, _LEAST_ROUNDS, _ROUNDS, _MET_AGAIN = 8, 4, 12, 1.08
# Times a second that other work takes a core from it: 60 to 112 on a quiet machine of two, 735 to 1063 beside one
# process that is busy.
_SWITCHES_PER_S = 300.0
_SUBDIVISIONS = 6
_SIZE_PX, _SAMPLES = 1024, 4
# Pixels of the sphere by areas; what real bodies take more, whose horizons are high and whose facets cover samples.
_SPHERE_PX, _REAL_AREAS, _REAL_FACETS = 8600.0, 2.5, 1.8
# Rays along the side of a square that keeps all threads busy.
_MANY_SIDE = 256
_CAMERA = PinholeCamera(name="costs", width_px=128, height_px=128, focal_length_px=600.0)
_STATE = State(r_sun_inertial_m=[1e11, 0.0, -1e11], spacecraft=Pose(r_inertial_m=[0.0, 0.0, -10.0]),
               bodies={"sphere": Pose(r_inertial_m=np.zeros(3))})


def engine_costs(context: Context, with_rays: bool, cache: Path | None = None) -> EngineCosts:
    """Costs of this OpenGL and this processor, from the fastest frames of each kind.

    They are kept by the names of both and rounded to quarter powers of two: a plan must not change
    from run to run with the weather. Where $GLRENDER_ENGINE_COSTS gives them, as `EngineCosts.text`
    writes them, nothing is measured: the same plans on every machine.

    Parameters
    ----------
    context : Context
    with_rays : bool
        Whether rays can be cast; without, they cost infinitely much.

    Raises
    ------
    ConfigError
        If $GLRENDER_ENGINE_COSTS is not five positive numbers.
    """
    if os.environ.get("GLRENDER_ENGINE_COSTS"):
        given = _given(os.environ["GLRENDER_ENGINE_COSTS"])
        return given if with_rays else replace(given, ray_ns=math.inf, lone_ray_ns=math.inf, area_ns=math.inf)
    machine = f"{context.info['gl_renderer']} {context.info['gl_version']} {os.cpu_count()} {with_rays}"
    name = f"{_NAME}{hashlib.sha256(machine.encode()).hexdigest()[:16]}"
    made = cached_arrays(name, ["ns"], lambda: {"ns": _measured(context, with_rays)}, cache)
    facet, sample, ray, lone_ray, area = (float(2.0 ** (np.round(4.0 * np.log2(x)) / 4.0)) for x in made["ns"])
    return EngineCosts(facet_ns=facet, sample_ns=sample, ray_ns=ray, lone_ray_ns=lone_ray, area_ns=area)


def _given(text: str) -> EngineCosts:
    try:
        facet, sample, ray, lone_ray, area = numbers = [float(word) for word in text.split()]
    except ValueError:
        numbers = [math.nan]
    if not all(ns > 0.0 for ns in numbers):
        raise ConfigError("GLRENDER_ENGINE_COSTS",
                          "must be five positive numbers [ns]: facet, sample, ray, lone ray, area", text)
    return EngineCosts(facet_ns=facet, sample_ns=sample, ray_ns=ray, lone_ray_ns=lone_ray, area_ns=area)


def _measured(context: Context, with_rays: bool) -> np.ndarray:
    # With a dent: by areas no ray would be cast at a convex body.
    sphere = generate.icosphere(radius_m=1.0, subdivisions=_SUBDIVISIONS)
    vertices_m, n_facets = sphere.vertices_m.copy(), len(sphere.facets)
    vertices_m[0] *= 0.9
    body = Body(name="sphere", shape=Shape.from_arrays(vertices_m, sphere.facets), brdf=Lambert(normal_albedo=0.5))
    scene, size = Scene(bodies=[body], cameras=[_CAMERA]), (_CAMERA.width_px, _CAMERA.height_px)
    views, n_hits = view_bodies(_STATE, _CAMERA, scene.hulls), []
    with ExitStack() as stack:
        target = stack.enter_context(Target(context, [1]))
        mesh = stack.enter_context(Mesh(context, vertices_m, sphere.facets, body.brdf))
        draws = [lambda: _draw(context, target, mesh, 16),
                 # With what comes after: reading it back, and what it tells of its own error.
                 lambda: pixel_errors(_draw(context, target, mesh, _SIZE_PX), _SAMPLES)]
        if with_rays:
            engine = stack.enter_context(closing(RayEngine(scene)))
            areas = stack.enter_context(closing(AreaEngine(scene, engine)))
            for side in (_MANY_SIDE, math.isqrt(RAYS_AT_ONCE)):
                pixel = _pixels(side)
                n_hits.append(np.count_nonzero(np.isfinite(engine.ranges(pixel, _CAMERA, views))))
                draws.append(lambda pixel=pixel: engine.irradiance(pixel, _CAMERA, views))
            draws.append(lambda: areas.draw(("sphere",), _CAMERA, views, _CAMERA.bounds_px, size, 0.1))
        facets_s, samples_s, *others_s = _fastest(draws)
    # The sphere fills 0.78 of the square that it is drawn in.
    found = [_REAL_FACETS * facets_s / n_facets, max(samples_s - facets_s, 1e-6) / (0.78 * _SIZE_PX**2)]
    if not with_rays:
        return 1e9 * np.array([*found, np.inf, np.inf, np.inf])
    *rays_s, areas_s = others_s
    # The Sun and the camera are 39 deg apart.
    unit = EngineCosts(facet_ns=0.0, sample_ns=0.0, ray_ns=0.0, area_ns=1.0)
    n_units = unit.areas_ns(n_facets, 0.39 * n_facets, _SPHERE_PX, math.sqrt(2.0 * _SPHERE_PX / n_facets), 0.0, 0.7,
                            0.1) - AREAS_CALL_NS
    # Calls may take less than that: no more than half of the time is theirs.
    area_s = _REAL_AREAS * max(areas_s - 1e-9 * AREAS_CALL_NS, 0.5 * areas_s) / n_units
    return 1e9 * np.array([*found, *np.divide(rays_s, n_hits), area_s])


def _pixels(side: int) -> np.ndarray:
    """As many rays along each side of the image, (side^2, 2) [px]."""
    place = (np.arange(side) + 0.5) * (_CAMERA.width_px / side) - 0.5
    return np.stack([np.tile(place, side), np.repeat(place, side)]).T


def _draw(context: Context, target: Target, mesh: Mesh, size_px: int) -> np.ndarray:
    """A sphere of radius 1 that fills a square, (size, size) float32."""
    target.begin(size_px, size_px)
    clip = frames.clip_from_camera(4.97 * size_px, (0.5 * size_px - 0.5,) * 2,
                                   (-0.5, -0.5, size_px - 0.5, size_px - 0.5), 8.0, 12.0)
    mesh.draw_surface(IRRADIANCE_STAGE, SurfaceVariant(shadows=False), {
        "clip_from_surface": clip @ frames.transform(np.eye(3), np.array([0.0, 0.0, 10.0])),
        "shadow_from_body": np.eye(4), "r_camera_body": np.array([0.0, 0.0, -10.0]),
        "r_camera_body_low": np.zeros(3), "sun_direction_body": np.array([0.6, 0.0, -0.8]),
        "boresight_body": np.array([0.0, 0.0, 1.0]), "irradiance_scale": 1.0, "shadow_bias_per_texel": 0.0,
        "body_id": 0}, None, np.ones(len(mesh.chunks), bool))
    return target.read()


def _fastest(draws: Sequence[Callable[[], object]]) -> np.ndarray:
    """Seconds of the fastest frame of each, once the machine is quiet and another round has met it again."""
    for draw in draws:
        draw()
    rounds = []
    while len(rounds) < _ROUNDS:
        began, switches = time.perf_counter(), _switches()
        rounds.append([min(_seconds(draw) for _ in range(_FRAMES)) for draw in draws])
        is_quiet = _switches() - switches <= _SWITCHES_PER_S * (time.perf_counter() - began)
        seconds = np.sort(rounds, axis=0)
        if len(rounds) >= _LEAST_ROUNDS and is_quiet and (seconds[1] <= _MET_AGAIN * seconds[0]).all():
            return seconds[0]
    _log.warning("Other work slows this machine: what its engines cost may be wrong, and frames slower than they need "
                 "be; delete %s* in %s when it is quiet, or give $GLRENDER_ENGINE_COSTS", _NAME, cache_folder())
    return seconds[0]


def _switches() -> int:
    """How often other work took a core from this process."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_nivcsw


def _seconds(draw: Callable[[], object]) -> float:
    began = time.perf_counter()
    draw()
    return time.perf_counter() - began
