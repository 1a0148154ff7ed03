"""Light from beyond the image that stray light brings in: the Sun, and bodies or parts of bodies outside the image."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from glrender_camera import PinholeCamera, PointSources, StrayLight

from ..base import rotations as frames
from ..base.constants import AU_M, SUN_RADIUS_M
from ..engines.rays.laser_ranges import laser_ranges
from ..view.state import State
from ..view.view import BodyView, view_bodies
from .sky_background import Place, merged

# A body outside the image is drawn with so many pixels across, put together to so many sources.
_BODY_PX, _BODY_SOURCES = 32, 8
_WIDEST_RAD = 1.0
# Rays to the Sun's disc: its middle, and rings around it.
_RINGS, _PLACES = (0, 1, 2), (1, 6, 12)
# Least cosine of the field angle, at a baffle of 90 degrees.
_LEAST_COSINE = 1e-3


def light_beyond(renderer: Any, camera: PinholeCamera, margin_px: int,
                 poses: Sequence[tuple[State, Container[str], float]]) -> tuple[PointSources, str]:
    """Sources beyond an image in the mean over some poses, and their names in words.

    Parameters
    ----------
    renderer
        A renderer of `glrender.open_renderer`.
    camera : PinholeCamera
        One of the scene's, with a model.
    margin_px : int [px]
        Margin of the image.
    poses : sequence of (State, names, float)
        With the names of bodies whose whole light is given as points already, and a pose's weight.

    Returns
    -------
    points : PointSources
        In the frame's `pixel`; what the lens images nowhere lies as much farther out as the fold in its direction.
    text : str
    """
    stray = [band.optics.stray_light for band in camera.model.bands.values() if band.optics.stray_light is not None]
    nothing = PointSources([], [])
    if not stray:
        return nothing, "skipped: the optics have no stray light"
    plain = camera.without_distortion.with_margin(margin_px)
    found: dict[str, list[tuple[PointSources, float]]] = {}
    for state, apart, weight in poses:
        parts = {"the Sun": _sun(renderer, state, plain)}
        for index, view in enumerate(view_bodies(state, plain, renderer.scene.hulls)):
            # The part of the image behind a distorting lens is not known beforehand.
            if view.name not in apart and not (view.is_whole and camera.distortion is None):
                parts[view.name] = _body(renderer, state, plain, view, index)
        for name, part in parts.items():
            if part is not None and (points := _kept(*part, camera.with_margin(margin_px), stray,
                                                     margin_px)).irradiance_W_m2.any():
                found.setdefault(name, []).append((points, weight))
    if not found:
        return nothing, "skipped: there is none that the baffle lets in"
    points = merged([each for parts in found.values() for each in parts])
    text = f"{', '.join(found)}: {points.irradiance_W_m2.sum():.3g} W/m2"
    return points, text if len(poses) == 1 else f"{text}, mean of {len(poses)} poses"


def _kept(rays: np.ndarray, light: np.ndarray, wide: PinholeCamera, stray: list[StrayLight],
          margin_px: int) -> PointSources:
    """Sources in the frame, of light (N,) from unit vectors (N, 3) from outside the image and within the baffle."""
    chosen = rays[:, 2] > max(_LEAST_COSINE, np.cos(np.radians(max(each.baffle_deg for each in stray))))
    rays, light = rays[chosen], light[chosen]
    xy, cosine = _place_px(rays, wide), rays[:, 2]
    x0, y0, x1, y1 = wide.bounds_px
    x, y = xy.T
    beside = (x < x0) | (y < y0) | (x >= x1) | (y >= y1)
    # The exposure dims light from outside the image as its nearest pixel; the aperture is foreshortened more.
    nearest = np.clip(xy, 0.0, np.array([wide.width_px, wide.height_px]) - 1.0)
    light = light * cosine / wide.directions(nearest)[:, 2]
    return PointSources(xy[beside] - margin_px, light[beside])


def _place_px(rays: np.ndarray, wide: PinholeCamera) -> np.ndarray:
    """Places of rays (N, 3) in a lens's image [px]; rays at k > 1 times its fold lie at k times the fold's place."""
    lens, ratio = wide.distortion, rays[:, :2] / rays[:, 2:]
    if lens is not None:
        times = np.maximum(np.hypot(*ratio.T) / (lens.max_radius * (1.0 - 1e-9)), 1.0)[:, None]
        ratio = lens.distort(ratio / times) * times
    return wide.focal_length_px * ratio + np.array(wide.principal_point_px)


def _sun(renderer: Any, state: State, wide: PinholeCamera) -> tuple[np.ndarray, np.ndarray] | None:
    """Rays to the Sun's disc that no body stops, each with its share of the light."""
    place = Place.of(state, wide)
    r_sun = place.camera_from_inertial @ (state.r_sun_inertial_m - place.r_inertial_m)
    distance_m = float(np.linalg.norm(r_sun))
    direction = r_sun / distance_m
    if not direction[2] > 0.0:
        return None
    across = np.linalg.svd(direction[None, :])[2][1:]
    ring = np.repeat(_RINGS, _PLACES)
    radius = ring / (len(_RINGS) - 0.5) * SUN_RADIUS_M / distance_m
    angle = np.concatenate([np.arange(n) * (2.0 * np.pi / n) for n in _PLACES])
    rays = direction + radius[:, None] * (np.stack([np.cos(angle), np.sin(angle)], axis=1) @ across)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    is_seen = laser_ranges(renderer.scene, state, rays, wide.name).body_id < 0
    irradiance = renderer.scene.solar_irradiance_of(wide) * (AU_M / distance_m) ** 2
    return rays, is_seen * (irradiance / len(rays))


def _body(renderer: Any, state: State, wide: PinholeCamera, view: BodyView,
          index: int) -> tuple[np.ndarray, np.ndarray] | None:
    """A body by a camera of its own that looks at it: its parts outside the image."""
    towards = -view.camera_from_body @ view.r_camera_body_m
    range_m = float(np.linalg.norm(towards))
    radius_m = renderer.scene.hulls[view.name].radius_m
    half_rad = _WIDEST_RAD if radius_m >= range_m else min(np.arcsin(radius_m / range_m), _WIDEST_RAD)
    up = np.array([0.0, 1.0, 0.0]) if abs(towards[1]) < 0.9 * range_m else np.array([1.0, 0.0, 0.0])
    aimed_from_camera = frames.dcm(frames.look_at(np.zeros(3), towards, up))
    mounted = aimed_from_camera @ frames.dcm(wide.q_camera_from_spacecraft)
    aimed = replace(wide, width_px=_BODY_PX, height_px=_BODY_PX, principal_point_px=None,
                    focal_length_px=0.5 * _BODY_PX / np.tan(1.05 * half_rad),
                    q_camera_from_spacecraft=frames.quaternion(mounted))
    image = renderer.render(state, aimed, products=("body_id",))
    light, body_id = image.irradiance_W_m2.astype(np.float64), image.products["body_id"]
    # A pixel on the outline has light and, at its centre, no body; one of another body is not this one's.
    light[(body_id >= 0) & (body_id != index)] = 0.0
    y, x = np.indices(light.shape)
    rays = aimed.directions(np.stack([x, y], axis=-1)) @ aimed_from_camera
    ahead = rays[..., 2] > _LEAST_COSINE
    if not (light[ahead] > 0.0).any():
        return None
    size = _BODY_PX // _BODY_SOURCES
    cell = (y // size) * _BODY_SOURCES + x // size
    total = np.bincount(cell[ahead], light[ahead], _BODY_SOURCES**2)
    lit = total > 0.0
    mean = np.stack([np.bincount(cell[ahead], light[ahead] * rays[ahead][:, axis], _BODY_SOURCES**2)[lit]
                     for axis in range(3)], axis=1)
    return mean / np.linalg.norm(mean, axis=1, keepdims=True), total[lit]
