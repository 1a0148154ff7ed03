"""Stars and the Sun behind the bodies of a state, hidden where bodies cover them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from glrender_camera import MosaicModel, PinholeCamera, PointSources, StarCatalogue, stars_in_view, sun_in_view
from glrender_camera.distortion import frame_border
from glrender_camera.stars import aberrated

from ..base import rotations as frames
from ..base.constants import AU_M, SUN_RADIUS_M
from ..base.errors import SceneError
from ..base.names import MAX_DIRECTIONS
from ..engines.rays.laser_ranges import laser_ranges
from ..scene.scene import Scene, band_irradiances
from ..view.state import State
from ..view.view import BodyView, view_bodies

# The Sun's disc behind a body is drawn with so many cells a pixel and axis, while it is not larger than this.
_SUN_CELLS, _MAX_FINE_SUN_PX = 4, 128


@dataclass(frozen=True, kw_only=True, eq=False)
class Place:
    """The place and attitude of a camera at a state: `camera_from_inertial` (3, 3), `r_inertial_m` (3,)."""

    camera_from_inertial: np.ndarray
    r_inertial_m: np.ndarray

    @classmethod
    def of(cls, state: State, camera: PinholeCamera) -> Place:
        craft_from_inertial = frames.dcm(state.spacecraft.q_from_inertial)
        return cls(camera_from_inertial=frames.dcm(camera.q_camera_from_spacecraft) @ craft_from_inertial,
                   r_inertial_m=state.spacecraft.r_inertial_m + craft_from_inertial.T @ camera.r_camera_spacecraft_m)


def stars_behind(scene: Scene, state: State, camera: PinholeCamera) -> dict[str, PointSources]:
    """The stars that a camera sees between the bodies, in each of its bands.

    A star is a point: the ray to it meets a facet or it does not, wherever in a pixel.

    Parameters
    ----------
    scene : Scene
        With stars.
    state : State
    camera : PinholeCamera
        One of the scene's, with a model.

    Raises
    ------
    SceneError
        Aberration is asked for and the state does not have the spacecraft's velocity.
    """
    catalogue, place = scene.stars.catalogue, Place.of(state, camera)
    direction = catalogue.direction
    if scene.stars.aberration:
        if state.spacecraft.v_inertial_m_s is None:
            raise SceneError("state.spacecraft.v_inertial_m_s", "missing: the scene's stars have aberration = true")
        direction = aberrated(direction, state.spacecraft.v_inertial_m_s)
    near = np.flatnonzero(direction @ place.camera_from_inertial[2] > _cosine_of_rim(camera))
    ray_camera = direction[near] @ place.camera_from_inertial.T
    seen = ~_is_hidden(scene, state, camera, ray_camera)
    chosen = near[seen]
    visible = StarCatalogue(direction[chosen], np.zeros((len(chosen), 3)), catalogue.v_magnitude[chosen],
                            catalogue.b_v[chosen], catalogue.year)
    q_camera_from_inertial = frames.quaternion(place.camera_from_inertial)
    own = scene.solar_irradiance_of(camera)
    irradiances = band_irradiances(camera.model) if isinstance(camera.model, MosaicModel) else {"": own}
    return {letter: stars_in_view(_in_band(camera, letter), q_camera_from_inertial, catalogue=visible,
                                  year=catalogue.year, solar_irradiance_1au_W_m2=irradiance)
            for letter, irradiance in irradiances.items()}


def merged(parts: list[tuple[PointSources, np.ndarray | float]]) -> PointSources:
    """The points of several sources together, the irradiance of each times its weights (N,) [1], or times one."""
    return PointSources(np.concatenate([points.xy_px for points, _ in parts]),
                        np.concatenate([points.irradiance_W_m2 * weight for points, weight in parts]))


def sun_box(state: State, camera: PinholeCamera) -> tuple[int, int, int, int] | None:
    """Part of the image x0, y0, x1, y1 [px] that the Sun's disc may touch, or None."""
    place = Place.of(state, camera)
    r_sun = place.camera_from_inertial @ (state.r_sun_inertial_m - place.r_inertial_m)
    distance_m = float(np.linalg.norm(r_sun))
    if not distance_m > SUN_RADIUS_M:
        raise SceneError("state.spacecraft.r_inertial_m", f"must be a solar radius, {SUN_RADIUS_M:g} m, from the Sun",
                         state.spacecraft.r_inertial_m.tolist())
    centre = camera.project(r_sun)
    if not np.isfinite(centre).all():
        return None
    # The disc is longer than it is wide off axis, by the cosine squared at most.
    cosine = r_sun[2] / distance_m
    reach = camera.focal_length_px * np.tan(np.arcsin(SUN_RADIUS_M / distance_m)) / cosine**2
    reach = reach * (1.0 if camera.lens_map is None else camera.lens_map.stretch) + 2.0
    size = np.array([camera.width_px, camera.height_px])
    low, high = np.clip([centre - reach, centre + reach + 1.0], 0, size).astype(int)
    return (int(low[0]), int(low[1]), int(high[0]), int(high[1])) if (low < high).all() else None


def sunlight(renderer: Any, state: State, camera: PinholeCamera, box: tuple[int, int, int, int]) -> np.ndarray:
    """The Sun's disc where no body covers it.

    Parameters
    ----------
    renderer
        As of `glrender.open_renderer`.
    state : State
    camera : PinholeCamera
        Draws for one of the scene's.
    box : (x0, y0, x1, y1) int [px]
        Of `sun_box`.

    Returns
    -------
    (y1 - y0, x1 - x0) float32 [W/m2]
        Covered in part by a sixteenth of a pixel, or by whole pixels of a disc wider than 128.
    """
    x0, y0, x1, y1 = box
    n = _SUN_CELLS if max(x1 - x0, y1 - y0) <= _MAX_FINE_SUN_PX else 1
    principal = n * (np.array(camera.principal_point_px) - (x0, y0)) + 0.5 * (n - 1)
    fine = replace(camera, width_px=n * (x1 - x0), height_px=n * (y1 - y0), principal_point_px=tuple(principal),
                   focal_length_px=n * camera.focal_length_px, model=None)
    place = Place.of(state, camera)
    r_sun = state.r_sun_inertial_m - place.r_inertial_m
    irradiance = renderer.scene.solar_irradiance_of(camera) * (AU_M**2 / float(r_sun @ r_sun))
    light = sun_in_view(fine, place.camera_from_inertial @ r_sun, irradiance)
    if any(_overlap(view, x0, y0, x1, y1) for view in view_bodies(state, camera, renderer.scene.hulls)):
        covered = renderer.render(state, fine, samples=1, products=("body_id",)).products["body_id"] >= 0
        light[covered] = 0.0
    return light.reshape(y1 - y0, n, x1 - x0, n).sum(axis=(1, 3))


def _overlap(view: BodyView, x0: float, y0: float, x1: float, y1: float) -> bool:
    if view.bounds_px is None:
        return view.is_visible
    left, top, right, bottom = view.bounds_px
    return left < x1 and right > x0 - 1.0 and top < y1 and bottom > y0 - 1.0


def _is_hidden(scene: Scene, state: State, camera: PinholeCamera, ray_camera: np.ndarray) -> np.ndarray:
    """(N,) bool: whether a body stands before the direction (N, 3)."""
    hidden = np.zeros(len(ray_camera), bool)
    pinhole = camera.without_distortion
    xy = pinhole.project(ray_camera)
    for view in view_bodies(state, pinhole, scene.hulls):
        if view.bounds_px is not None:
            hidden |= ((xy >= view.bounds_px[:2]) & (xy <= view.bounds_px[2:])).all(axis=1)
        elif view.depth_m[1] > 0.0:
            hidden[:] = True
    # So far these are those that may be.
    may_be = np.flatnonzero(hidden)
    for part in np.array_split(may_be, -(-len(may_be) // MAX_DIRECTIONS) or 1):
        if len(part):
            hidden[part] = laser_ranges(scene, state, ray_camera[part], camera.name).body_id >= 0
    return hidden


@lru_cache(maxsize=16)
def _in_band(camera: PinholeCamera, letter: str) -> PinholeCamera:
    return replace(camera, model=camera.model.bands[letter]) if letter else camera


@lru_cache(maxsize=16)
def _cosine_of_rim(camera: PinholeCamera) -> float:
    """Cosine of the angle from the boresight within which sources lie whose light reaches the frame."""
    corner = np.arccos(camera.directions(frame_border(camera.width_px, camera.height_px))[:, 2].min())
    reach_px = 2.0 + camera.model.psf_margin_px
    return float(np.cos(min(corner + np.arctan(2.0 * reach_px / camera.focal_length_px), np.pi)))
