"""Light along rays: what each place of an image sees of a scene, in float64.

The ray tracer backend and the renderer's windows of rays are drawn by it; it shares no line with
the OpenGL passes.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from glrender_camera import PinholeCamera, threads

from ...base.rotations import angle_between, sun_from_body
from ...scene.lamp import ALL_ROUND_DEG, Lamp
from ...scene.scene import Body, Scene
from ...scene.shape.facet_blocks import FacetBlocks
from ...scene.surface import Surface
from ...view.view import FINE_FOOTPRINT, BodyView, between, lamp_in
from .exact_loops import ALL_SIDES, FACING, TURNED
from .mesh import ANY_REACH, LEAST_LIFT, LIFT, Hits, RayMesh, dot
from .near_mesh import NearMesh

RAYS_AT_ONCE = 1 << 13
"""Most rays of a part, which one thread casts: what it needs stays in a core's cache."""
# Reach of coordinates about the camera over that within which a pixel sees less than `FINE_FOOTPRINT` [1]: what is cut
# off there has a third of the error.
_REACH = 3.0
# Places of a lattice at once, of some 80 bytes.
_PLACES_AT_ONCE = 1 << 19
R2 = np.array([0.7548776662466927, 0.5698402909980532])
"""Steps of Roberts' sequence, in two dimensions [1]."""
# Distance [m] of a lamp from ground, at least, so that its light is finite.
_LEAST_M = 1e-9
# Factor of a congruential generator.
_FACTOR = 1664525

BESIDE: dict[str, Any] = {"range": np.nan, "body_id": -1, "facet_id": -1, "incidence": np.nan, "emission": np.nan,
                          "phase": np.nan, "r_body": np.full(3, np.nan), "sunlit": 0.0}
"""Products of a place that sees no body."""
_DTYPES = {name: np.int32 if name.endswith("_id") else np.float64 for name in BESIDE}


def draws(row: np.ndarray, column: np.ndarray, across: int) -> np.ndarray:
    """Number of the Sun's draw that each place of a lattice has, with `across` places along a pixel's side."""
    return row % across * across + column % across


def places_in(row: np.ndarray, column: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns (K n^2,) of the n x n places of a lattice in each of some cells, by its row and column (K,)."""
    within = np.arange(n)
    down, across = np.broadcast_arrays(n * row[:, None, None] + within[:, None], n * column[:, None, None] + within)
    return down.ravel(), across.ravel()


class RayEngine:
    """A scene's acceleration structures; rays are cast at them by a thread for each core that is allowed.

    Parameters
    ----------
    scene : Scene

    Raises
    ------
    DeviceError
        embreex is not installed.
    """

    def __init__(self, scene: Scene):
        self.scene = scene
        self._solids = {body.name: _Solid(body) for body in scene.bodies}
        self._near: dict[str, NearMesh] = {}
        self._lock = threading.Lock()

    def solid(self, name: str) -> RayMesh:
        """The full shape of a body."""
        return self._solids[name]

    def near_bytes(self, views: Sequence[BodyView]) -> int:
        """Memory [byte] of the facets near a frame's camera: `NearMesh.memory_bytes`."""
        nears = [(view, self._near.get(view.name)) for view in views]
        return sum(near.memory_bytes for view, near in nears if near is not None and near.is_at(view.r_camera_body_m))

    def close(self) -> None:
        """Release the acceleration structures."""
        self._solids.clear()
        self._near.clear()

    def irradiance(self, pixel: np.ndarray, camera: PinholeCamera, views: list[BodyView],
                   draw: np.ndarray | int = 0) -> np.ndarray:
        """Irradiance (N,) float64 [W/m2 per pixel] of places in the image (N, 2) [px].

        If the scene's Sun has a disc, each place is lit by one of its points, the `draw`-th (N,) of the
        pixel: the mean of a pixel's draws 0, 1, 2, ... has penumbras.
        """
        value, draw = np.zeros(len(pixel)), np.broadcast_to(draw, len(pixel))

        def trace(part: slice) -> None:
            self._trace(value[part], pixel[part], camera, views, draw[part])

        threads.run_in_parts(trace, len(pixel), RAYS_AT_ONCE)
        return value

    def lattice(self, x_px: np.ndarray, y_px: np.ndarray, camera: PinholeCamera, views: list[BodyView],
                across: int) -> np.ndarray:
        """Irradiance (M, N) float64 [W/m2 per pixel] of columns (N,) and rows (M,) of places [px].

        `across` places in a row share a pixel's draws of the Sun's disc.
        """
        value = np.empty((len(y_px), len(x_px)))
        column, at_once = np.arange(len(x_px)), max(_PLACES_AT_ONCE // len(x_px), 1)
        for first in range(0, len(y_px), at_once):
            rows = slice(first, first + at_once)
            pixel = np.stack(np.meshgrid(x_px, y_px[rows]), axis=-1).reshape(-1, 2)
            draw = draws(np.arange(len(y_px))[rows, None], column, across).ravel()
            value[rows] = self.irradiance(pixel, camera, views, draw).reshape(-1, len(x_px))
        return value

    def are_lit(self, pixel: np.ndarray, camera: PinholeCamera, views: list[BodyView], draw: np.ndarray) -> np.ndarray:
        """Whether places in the image (N, 2) [px] show ground in sunlight, by draws (N,) as of `irradiance`: (N,)."""
        found = np.zeros(len(pixel), bool)

        def look(part: slice) -> None:
            on_disc = self._on_disc(pixel[part], camera, draw[part])
            for view, hits in self._first(camera.directions(pixel[part]).T, views):
                facing, *_, is_lit = self._facing(hits, view, views, on_disc)
                found[part][facing.place] = is_lit & (dot(facing.normal, facing.ray) < 0.0)

        threads.run_in_parts(look, len(pixel), RAYS_AT_ONCE)
        return found

    def ranges(self, pixel: np.ndarray, camera: PinholeCamera, views: Sequence[BodyView]) -> np.ndarray:
        """Distances (N,) float64 [m] of the first surface at places in the image (N, 2) [px], or infinity."""
        distance_m = np.full(len(pixel), np.inf)
        for _, hits in self._first(camera.directions(pixel).T, views):
            distance_m[hits.place] = hits.distance_m
        return distance_m

    def sunlit(self, r_body_m: np.ndarray, view: BodyView, views: list[BodyView]) -> np.ndarray:
        """Whether points (N, 3) [m] in a body's frame have a free line (N,) bool to the Sun's middle."""
        return self._has_free_line(r_body_m.T, view.sun_direction_body, view, views)

    def in_light(self, r_body_m: np.ndarray, facet: np.ndarray, view: BodyView, views: list[BodyView],
                 is_asked: np.ndarray, is_open: np.ndarray | None = None, to_sun: np.ndarray | None = None
                 ) -> np.ndarray:
        """Whether points (3, N) [m] of a body's facets (N,) see the Sun's middle, (N,) bool; only points asked for.

        Or a place of its disc each, in directions (3, N). Of some points it may be known that nothing of their own body
        hides it, (N,) bool.
        """
        return self._are_free(r_body_m, facet, view, views, is_asked, is_open, None, to_sun)

    def in_view(self, r_body_m: np.ndarray, facet: np.ndarray, view: BodyView, views: list[BodyView],
                is_asked: np.ndarray, is_open: np.ndarray | None = None) -> np.ndarray:
        """Whether the camera sees points (3, N) [m] of a body's facets (N,), (N,) bool; only points asked for.

        As of `in_light`.
        """
        return self._are_free(r_body_m, facet, view, views, is_asked, is_open, view.r_camera_body_m)

    def _are_free(self, r_body_m: np.ndarray, facet: np.ndarray, view: BodyView, views: list[BodyView],
                  is_asked: np.ndarray, is_open: np.ndarray | None, place_m: np.ndarray | None,
                  to_sun: np.ndarray | None = None) -> np.ndarray:
        asked, own, is_free = np.flatnonzero(is_asked), self._mesh(view), np.zeros(len(facet), bool)

        def ask(part: slice) -> None:
            some = asked[part]
            start, number = r_body_m.take(some, axis=1), facet.take(some)
            above = start + own.lift_m(start, number, LIFT) * own.normals.take(number, axis=0).T
            towards, reach_m = view.sun_direction_body if to_sun is None else to_sun.take(some, axis=1), ANY_REACH
            sides = ALL_SIDES
            if place_m is not None:
                # A back hides nothing from a camera, and shades all the same.
                towards, sides = place_m[:, None] - start, TURNED
                reach_m = np.sqrt(dot(towards, towards))
                towards /= reach_m
            is_free[some] = self._has_free_line(above, towards, view, views, reach_m,
                                                None if is_open is None else is_open.take(some), sides)

        threads.run_in_parts(ask, len(asked), RAYS_AT_ONCE)
        return is_free

    def shades(self, r_body_m: np.ndarray, facet: np.ndarray, view: BodyView, views: list[BodyView]
               ) -> tuple[np.ndarray, np.ndarray]:
        """Distances (N,) [m] from points (3, N) [m] of a body's facets (N,) to what hides the Sun, or infinity.

        And which of the body's facets (N,) that is; -1 of another body's, or none.
        """
        return self._nearest(r_body_m, facet, view, views, view.sun_direction_body[:, None], ALL_SIDES)

    def hides(self, r_body_m: np.ndarray, facet: np.ndarray, view: BodyView, views: list[BodyView]
              ) -> tuple[np.ndarray, np.ndarray]:
        """Distances (N,) [m] from points (3, N) [m] of a body's facets (N,) to what hides them from the camera.

        And which of the body's facets (N,) that is, as `shades` has them. A back hides nothing.
        """
        towards = view.r_camera_body_m[:, None] - r_body_m
        reach_m = np.sqrt(dot(towards, towards))
        found, by = self._nearest(r_body_m, facet, view, views, towards / reach_m, TURNED)
        return np.where(found < reach_m, found, np.inf), np.where(found < reach_m, by, -1)

    def _nearest(self, r_body_m: np.ndarray, facet: np.ndarray, view: BodyView, views: list[BodyView],
                 towards: np.ndarray, sides: int) -> tuple[np.ndarray, np.ndarray]:
        """Distances (N,) [m] from points (3, N) [m] of facets (N,) to what is nearest in directions (3, N or 1).

        And which of the body's own facets (N,) that is, or -1.
        """
        found, by, own = np.full(len(facet), np.inf), np.full(len(facet), -1), self._mesh(view)
        above = r_body_m + own.lift_m(r_body_m, facet, LIFT) * own.normals.take(facet, axis=0).T
        for other in views:
            turn, shift_m = between(view, other)
            rays = np.broadcast_to(turn @ towards, above.shape)
            hits = self._mesh(other).first(turn @ above + shift_m[:, None], rays, sides)
            hits = hits.at(np.flatnonzero(hits.distance_m < found.take(hits.place)))
            found[hits.place] = hits.distance_m
            by[hits.place] = hits.facet if other.name == view.name else -1
        return found, by

    def products(self, pixel: np.ndarray, camera: PinholeCamera, views: list[BodyView]) -> dict[str, np.ndarray]:
        """Products at places in the image (N, 2) [px], by the names of `BESIDE`."""
        made = {name: np.full((len(pixel), *np.shape(value)), value, _DTYPES[name]) for name, value in BESIDE.items()}
        names = {view.name: index for index, view in enumerate(views)}

        def look(part: slice) -> None:
            for view, hits in self._first(camera.directions(pixel[part]).T, views):
                normal, ray = hits.normal.T, hits.ray.T
                facing, *_, is_lit = self._facing(hits, view, views)
                made["sunlit"][part][facing.place] = is_lit
                values = {"range": hits.distance_m, "body_id": names[view.name], "facet_id": hits.facet,
                          "incidence": angle_between(normal, view.sun_direction_body),
                          "emission": angle_between(normal, -ray),
                          "phase": angle_between(-ray, view.sun_direction_body),
                          "r_body": _points(hits, view).T + view.centre_m}
                for name, value in values.items():
                    made[name][part][hits.place] = value

        threads.run_in_parts(look, len(pixel), RAYS_AT_ONCE)
        return made

    def _trace(self, value: np.ndarray, pixel: np.ndarray, camera: PinholeCamera, views: list[BodyView],
               draw: np.ndarray) -> None:
        """Write the irradiance (N,) of places (N, 2) [px]."""
        ray, on_disc = camera.directions(pixel).T, self._on_disc(pixel, camera, draw)

        def per_pixel(radiance: np.ndarray, place: np.ndarray) -> np.ndarray:
            off_axis = ray[2].take(place)
            # A pixel's solid angle falls off as cos^3 of its angle from the boresight.
            light = radiance * (off_axis * off_axis * off_axis) / camera.focal_length_px**2
            return light if camera.lens_map is None else light / camera.lens_map.area_scales(
                (ray[:2] / ray[2]).take(place, axis=1))

        for view, met in self._first(ray, views):
            # Points in shadow are shaded too: leaving them out would cost more.
            hits, r_body, to_sun, is_lit = self._facing(met, view, views, on_disc)
            radiance = self.radiance(hits.facet, r_body, hits.normal, -hits.ray, to_sun, hits.distance_m, view, camera)
            value[hits.place] = per_pixel(is_lit * radiance, hits.place)
            for lamp in self.scene.lamps:
                hits, radiance = self._lit_by(lamp, met, view, views, camera)
                value[hits.place] += per_pixel(radiance, hits.place)

    def _lit_by(self, lamp: Lamp, hits: Hits, view: BodyView, views: list[BodyView], camera: PinholeCamera
                ) -> tuple[Hits, np.ndarray]:
        """Hits that face a lamp and are in its cone, and their radiance (K,) [W/m2/sr] in its light."""
        place_m, axis = lamp_in(view, lamp, camera)
        to_lamp = place_m[:, None] - _points(hits, view)
        distance_m = np.maximum(np.sqrt(dot(to_lamp, to_lamp)), _LEAST_M)
        to_lamp /= distance_m
        is_in_cone = lamp.half_angle_deg == ALL_ROUND_DEG or dot(axis[:, None], to_lamp) <= -lamp.least_cosine
        chosen = np.flatnonzero((dot(hits.normal, to_lamp) > 0.0) & is_in_cone)
        hits, to_lamp, distance_m = hits.at(chosen), to_lamp.take(chosen, axis=1), distance_m.take(chosen)
        r_body = _points(hits, view)
        above = self._mesh(view).raised(r_body, hits.facet, hits.normal, LEAST_LIFT)
        is_lit = self._has_free_line(above, to_lamp, view, views, distance_m)
        light = self._reflected(hits.facet, r_body, hits.normal, -hits.ray, to_lamp, hits.distance_m, view, camera)
        return hits, is_lit * light * lamp.intensity_W_sr / distance_m**2

    def radiance(self, facet: np.ndarray, r_body_m: np.ndarray, normal: np.ndarray, to_camera: np.ndarray,
                 to_sun: np.ndarray, range_m: np.ndarray, view: BodyView, camera: PinholeCamera) -> np.ndarray:
        """Radiance (N,) [W/m2/sr] of points (3, N) [m] of a body's facets (N,) in sunlight, at ranges (N,) [m].

        By unit vectors (3, N): the facets' normals, those towards the camera, and towards the Sun (3,) or (3, N).
        """
        solar = self.scene.solar_irradiance_of(camera) / view.sun_distance_au**2
        return solar * self._reflected(facet, r_body_m, normal, to_camera, to_sun, range_m, view, camera)

    def mean_radiance(self, facet: np.ndarray, to_sun: np.ndarray, view: BodyView, camera: PinholeCamera) -> np.ndarray:
        """Radiance (N,) [W/m2/sr] of facets (N,) in sunlight, the mean of three points of each.

        The Sun is towards (3,) or (3, N). One point does not do: smooth normals may leave a facet's middle dark.
        """
        mesh, found = self._solids[view.name], np.zeros(len(facet))
        corner_m, normal = mesh.vertices_m[mesh.facets[facet]], mesh.normals[facet].T
        for weights in (np.ones((3, 3)) + 3.0 * np.eye(3)) / 6.0:
            r_body_m = np.einsum("k,nki->in", weights, corner_m)
            to_camera = view.r_camera_body_m[:, None] - r_body_m
            range_m = np.sqrt(dot(to_camera, to_camera))
            found += self.radiance(facet, r_body_m, normal, to_camera / range_m, to_sun, range_m, view, camera)
        return found / 3.0

    def _reflected(self, facet: np.ndarray, r_body_m: np.ndarray, normal: np.ndarray, to_camera: np.ndarray,
                   to_light: np.ndarray, range_m: np.ndarray, view: BodyView, camera: PinholeCamera) -> np.ndarray:
        """Radiance (N,) [1/sr] as of `radiance`, for 1 W/m2 across the light."""
        solid = self._solids[view.name]
        surface, to_camera = solid.surface, to_camera.T
        weights = surface.weights(facet, r_body_m.T) if solid.needs_weights else None
        normal = surface.normals(facet, weights, to_camera) if surface.body.smooth_normals else normal.T
        if (relief := surface.body.relief) is not None:
            normal = relief.normals(normal, r_body_m.T, range_m / camera.focal_length_px, to_camera)
        brdf = surface.brdf(to_light.T, to_camera, normal, surface.albedo_scale(facet, weights), facet)
        return brdf * np.maximum(dot(normal.T, to_light), 0.0)

    def _on_disc(self, pixel: np.ndarray, camera: PinholeCamera, draw: np.ndarray
                 ) -> Callable[[np.ndarray], np.ndarray] | None:
        """Places on the Sun's disc as `_facing` takes them; None of a point Sun."""
        return partial(_on_disc, pixel, camera.principal_point_px, draw) if self.scene.sun_disc else None

    def _facing(self, hits: Hits, view: BodyView, views: list[BodyView],
                on_disc: Callable[[np.ndarray], np.ndarray] | None = None
                ) -> tuple[Hits, np.ndarray, np.ndarray, np.ndarray]:
        """Hits that face the Sun, their points (3, K) [m] on the body, the Sun's direction and whether it is free (K,).

        The direction is that of the Sun's middle (3,), or of a place on its disc for each hit (3, K), which `on_disc`
        gives by the rays' numbers: each place lights facets that face it, also where the Sun's middle has set.
        """
        to_sun = view.sun_direction_body
        if on_disc is not None:
            to_sun = to_sun[:, None] + view.sun_radius_rad * (sun_from_body(to_sun)[:2].T @ on_disc(hits.place))
            to_sun /= np.sqrt(dot(to_sun, to_sun))
        chosen = np.flatnonzero(dot(hits.normal, to_sun) > 0.0)
        facing, to_sun = hits.at(chosen), to_sun if on_disc is None else to_sun.take(chosen, axis=1)
        r_body = _points(facing, view)
        above = self._mesh(view).raised(r_body, facing.facet, facing.normal, LEAST_LIFT)
        return facing, r_body, to_sun, self._has_free_line(above, to_sun, view, views)

    def _first(self, ray_camera: np.ndarray, views: Sequence[BodyView]) -> list[tuple[BodyView, Hits]]:
        """First hits of rays (3, N) from the camera: those of each body that no other body hides."""
        met = [(view, self._mesh(view).first(view.r_camera_body_m, view.camera_from_body.T @ ray_camera, FACING))
               for view in views if view.is_visible]
        if len(met) < 2:
            return met
        nearest, body = np.full(ray_camera.shape[1], np.inf), np.full(ray_camera.shape[1], -1)
        for index, (_, hits) in enumerate(met):
            nearer = hits.distance_m < nearest[hits.place]
            place = hits.place[nearer]
            nearest[place], body[place] = hits.distance_m[nearer], index
        return [(view, hits.at(np.flatnonzero(body[hits.place] == index))) for index, (view, hits) in enumerate(met)]

    def _mesh(self, view: BodyView) -> RayMesh:
        """A body's full shape, for a camera so near that its own float32 coordinates may be too coarse for pixels."""
        solid = self._solids[view.name]
        if view.footprint_m > FINE_FOOTPRINT * solid.radius_m:
            return solid
        focal_length_px = view.depth_m[0] / view.footprint_m
        place_m, reach_m = view.r_camera_body_m, _REACH * FINE_FOOTPRINT * solid.radius_m * focal_length_px
        with self._lock:
            near = self._near.get(view.name)
            if near is None or near.reach_m != reach_m or not near.is_at(place_m):
                near = self._near[view.name] = NearMesh(solid, place_m, reach_m, focal_length_px)
            return near

    def _has_free_line(self, above: np.ndarray, towards: np.ndarray, view: BodyView, views: list[BodyView],
                       reach_m: np.ndarray = ANY_REACH, is_open: np.ndarray | None = None, sides: int = ALL_SIDES
                       ) -> np.ndarray:
        """Whether points (3, N) [m] above a body's surface have a free line in a direction (3,), or in one each (3, N).

        Facets of some sides are in its way: those of the body itself but for points that are known to have one there
        (N,). Other bodies may touch it.
        """
        is_free = np.ones(above.shape[1], bool)
        for other in views:
            is_own = other.name == view.name
            rest = np.flatnonzero(is_free & ~is_open if is_own and is_open is not None else is_free)
            rotation, offset = between(view, other)
            place, direction = above.take(rest, axis=1), towards
            if towards.ndim > 1:
                direction = towards.take(rest, axis=1)
            if not is_own:
                place, direction = rotation @ place + offset[:, None], rotation @ direction
            is_free[rest] = ~self._mesh(other).blocks(
                place.T, direction.T, reach_m if len(reach_m) == 1 else reach_m.take(rest), sides)
        return is_free


class _Solid(RayMesh):
    """A body that rays may meet."""

    def __init__(self, body: Body):
        shape = body.drawn_shape
        super().__init__(shape.vertices_m, shape.facets,
                         not shape.report.is_watertight or shape.other_side is not None or shape.inside, shape.sizes)
        self.surface = Surface(body)
        self.needs_weights = not self.surface.is_even
        self.is_uneven = self.needs_weights or body.relief is not None

    @property
    def facet_blocks(self) -> FacetBlocks:
        return self.surface.body.hull.blocks


def _points(hits: Hits, view: BodyView) -> np.ndarray:
    """Points (3, K) [m] at which rays from the camera meet a body, in its frame."""
    return view.r_camera_body_m[:, None] + hits.ray * hits.distance_m


def _on_disc(pixel: np.ndarray, middle_px: tuple[float, float], draw: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Points (2, K) of a disc of radius 1, for some of the places (N, 2) [px]: Roberts' R2 sequence by draws (N,).

    It is shifted from pixel to pixel: by a hash of the pixel's distance from the principal point, so that a part of a
    frame has the whole frame's. Source: pcg2d of Jarzynski and Olano (2020), with another increment.
    """
    x, y = shift = np.array([(np.rint(pixel[:, k].take(place)) - math.floor(middle_px[k])).astype(np.int64)
                             for k in range(2)]).astype(np.uint32) * _FACTOR + 1
    for _ in range(2):
        x += y * _FACTOR
        y += x * _FACTOR
        shift ^= shift >> 16
    shift = shift * 2.0**-32 + R2[:, None] * draw.take(place)
    # Embree takes float32 anyway, and its sines are ten times as fast.
    u, v = (shift - np.floor(shift)).astype(np.float32)
    radius, angle = np.sqrt(u), np.float32(2.0 * np.pi) * v
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)])
