"""Light from beyond the image that stray light brings in: the Sun and bodies beside it, or partly beside it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from glrender_camera import PinholeCamera, PointSources, StrayLight

from . import frames
from .background import Place, merged, sun_box
from .constants import AU_M, SUN_RADIUS_M
from .ranging import laser_ranges
from .state import State
from .view import BodyView, view_bodies

# A body beside the image is drawn with so many pixels across, put together to so many sources.
_BODY_PX, _BODY_SOURCES = 32, 8
_WIDEST_RAD = 1.0
# Rays to the Sun's disc: its middle, and rings around it.
_RINGS, _PLACES = (0, 1, 2), (1, 6, 12)


def light_beyond(renderer: Any, state: State, camera: PinholeCamera, margin_px: int) -> tuple[PointSources, str]:
    """Sources beyond an image, and what they are in words.

    Parameters
    ----------
    renderer
        Of `glrender.open_renderer`.
    state : State
    camera : PinholeCamera
        One of the scene's, with a model.
    margin_px : int [px]
        Of the image.

    Returns
    -------
    points : PointSources
        In the frame's `pixel` were there no distortion; irradiance in the camera's band.
    text : str
    """
    stray = [band.optics.stray_light for band in camera.model.bands.values() if band.optics.stray_light is not None]
    nothing = PointSources([], [])
    if not stray:
        return nothing, "skipped: the optics have no stray light"
    wide = replace(camera, distortion=None).with_margin(margin_px)
    parts = {"the Sun": _sun(renderer, state, wide, stray)}
    for index, view in enumerate(view_bodies(state, wide, renderer.scene.hulls)):
        if not view.is_whole:
            parts[view.name] = _body(renderer, state, wide, view, index)
    found = {name: _kept(points, wide, stray, margin_px) for name, points in parts.items() if points is not None}
    found = {name: points for name, points in found.items() if points.irradiance_W_m2.any()}
    if not found:
        return nothing, "skipped: there is none that the baffle lets in"
    points = merged([(each, np.ones(len(each.xy_px))) for each in found.values()])
    return points, f"{', '.join(found)}: {points.irradiance_W_m2.sum():.3g} W/m2"


def _kept(points: PointSources, wide: PinholeCamera, stray: list[StrayLight], margin_px: int) -> PointSources:
    """What is beside the image and before the baffle's edge, in the frame's pixels."""
    x0, y0, x1, y1 = wide.bounds_px
    x, y = points.xy_px.T
    beside = (x < x0) | (y < y0) | (x >= x1) | (y >= y1)
    cosine = wide.directions(points.xy_px)[:, 2]
    beside &= cosine > np.cos(np.radians(max(each.baffle_deg for each in stray)))
    # The exposure dims what lies beside the image as its nearest pixel; the aperture is foreshortened more.
    nearest = np.clip(points.xy_px, 0.0, np.array([wide.width_px, wide.height_px]) - 1.0)
    light = points.irradiance_W_m2 * cosine / wide.directions(nearest)[:, 2]
    return PointSources(points.xy_px[beside] - margin_px, light[beside])


def _sun(renderer: Any, state: State, wide: PinholeCamera, stray: list[StrayLight]) -> PointSources | None:
    if sun_box(state, wide) is not None:
        return None
    place = Place.of(state, wide)
    r_sun = place.camera_from_inertial @ (state.r_sun_inertial_m - place.r_inertial_m)
    distance_m = float(np.linalg.norm(r_sun))
    direction = r_sun / distance_m
    if not direction[2] > np.cos(np.radians(max(each.baffle_deg for each in stray))):
        return None
    across = np.linalg.svd(direction[None, :])[2][1:]
    ring = np.repeat(_RINGS, _PLACES)
    radius = ring / (len(_RINGS) - 0.5) * SUN_RADIUS_M / distance_m
    angle = np.concatenate([np.arange(n) * (2.0 * np.pi / n) for n in _PLACES])
    rays = direction + radius[:, None] * (np.stack([np.cos(angle), np.sin(angle)], axis=1) @ across)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    seen = float((laser_ranges(renderer.scene, state, rays, wide.name).body_id < 0).mean())
    irradiance = renderer.scene.solar_irradiance_of(wide) * (AU_M / distance_m) ** 2 * seen
    return PointSources(wide.project(direction)[None, :], [irradiance])


def _body(renderer: Any, state: State, wide: PinholeCamera, view: BodyView, index: int) -> PointSources | None:
    """A body by a camera of its own that looks at it: what is beside the image is what lies there."""
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
    ahead = rays[..., 2] > 1e-3
    if not (light[ahead] > 0.0).any():
        return None
    size = _BODY_PX // _BODY_SOURCES
    cell = (y // size) * _BODY_SOURCES + x // size
    total = np.bincount(cell[ahead], light[ahead], _BODY_SOURCES**2)
    lit = total > 0.0
    mean = np.stack([np.bincount(cell[ahead], light[ahead] * rays[ahead][:, axis], _BODY_SOURCES**2)[lit]
                     for axis in range(3)], axis=1)
    return PointSources(wide.project(mean), total[lit])
