"""Images of the ground that a frame sees, made of its products: normals, tilts, parts, flow to the next frame."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from glrender_camera import PinholeCamera

from ..base.errors import ConfigError
from ..base.names import PRODUCTS
from ..scene.scene import Scene
from ..view.state import State
from ..view.view import BodyView, view_bodies

MAPS = {"normal": "1", "tilt": "rad", "part_id": "1", "flow": "px"}
"""Images of frames that are written, besides `PRODUCTS`, and their units."""
UNITS = {**PRODUCTS, **MAPS}
_MADE_OF = ("range", "body_id", "facet_id")


def made_of(names: Iterable[str]) -> tuple[str, ...]:
    """The renderer's products, each once, that some names need of `PRODUCTS` and `MAPS`."""
    return tuple(dict.fromkeys(each for name in names for each in (_MADE_OF if name in MAPS else (name,))))


def refuse_flow(names: Iterable[str]) -> None:
    """Refuse a flow of frames that have no next one.

    Raises
    ------
    ConfigError
    """
    if "flow" in names:
        raise ConfigError("products", "must be without flow but in a sequence, whose frames have a next one",
                          list(names), "leave flow out, or use `glrender sequence`")


def surface_maps(scene: Scene, state: State, camera: PinholeCamera, products: Mapping[str, np.ndarray],
                 names: Iterable[str], following: tuple[State, ...] | None = None) -> dict[str, np.ndarray]:
    """Images of the ground at each pixel's centre, by their names out of `MAPS`; NaN, and -1 of numbers, on the sky.

    Parameters
    ----------
    scene : Scene
    state : State
    camera : PinholeCamera
    products : mapping
        With those that `made_of` names.
    names : iterable of str
    following : tuple of State, optional
        The next frame's state, empty for the last frame; None of a frame on its own.

    Returns
    -------
    dict
        `normal` (height, width, 3) float32 [1]: the facet's, in the camera's frame; `tilt` float32 [rad]: its angle to
        the direction from the body's origin; `part_id` int32: number of the facet's part among those of one look;
        `flow` (height, width, 2) float32 [px]: the point's place in the next frame, seen there or not, less its place
        here, x right and y down; NaN behind the camera and in the last frame.

    Raises
    ------
    ConfigError
        A flow without a next frame.
    """
    names = tuple(names)
    if following is None:
        refuse_flow(names)
    body_id = products["body_id"]
    sky = {"normal": (3 * (np.nan,), np.float32), "tilt": (np.nan, np.float32), "part_id": (-1, np.int32),
           "flow": (2 * (np.nan,), np.float32)}
    made = {name: np.full((*body_id.shape, *np.shape(sky[name][0])), *sky[name]) for name in names if name in MAPS}
    hulls = {body.name: body.hull for body in scene.bodies}
    views = [view_bodies(each, camera, hulls) for each in (state, *(following or ()))]
    for number, body in enumerate(scene.bodies):
        seen = body_id == number
        if not seen.any():
            continue
        view, *later = (each[number] for each in views)
        facet, pixel = products["facet_id"][seen], np.argwhere(seen)[:, ::-1].astype(float)
        r_camera_m = camera.directions(pixel) * products["range"][seen][:, None]
        r_m = r_camera_m @ view.camera_from_body + view.r_camera_body_m
        normal, up = body.shape.facet_normals[facet], r_m + view.centre_m
        if "normal" in made:
            made["normal"][seen] = normal @ view.camera_from_body.T
        if "tilt" in made:
            made["tilt"][seen] = np.arctan2(np.linalg.norm(np.cross(normal, up), axis=1), (normal * up).sum(axis=1))
        if "part_id" in made:
            part = np.empty(len(body.shape.facets), np.int32)
            for index, chosen in enumerate(body.part_facets):
                part[chosen] = index
            made["part_id"][seen] = part[facet]
        if "flow" in made:
            for after in later:
                made["flow"][seen] = _places(camera, after, r_m) - pixel
    return made


def _places(camera: PinholeCamera, view: BodyView, r_m: np.ndarray) -> np.ndarray:
    """Places (N, 2) [px] of points (N, 3) [m] about a body's centre; NaN behind the camera."""
    r_camera_m = (r_m - view.r_camera_body_m) @ view.camera_from_body.T
    places, is_before = np.full((len(r_m), 2), np.nan), r_camera_m[:, 2] > 0.0
    places[is_before] = camera.project(r_camera_m[is_before])
    return places
