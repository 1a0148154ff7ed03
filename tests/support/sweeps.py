"""Stability sweeps: one number for each place where methods fail. Tests bound them, benchmarks/stability.py plots them.

Truths: sums over the facets of convex bodies, closed forms of solids, and rays.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import solids
import views
from glrender import Body, Pose, Renderer, Shape, State, frames, generate
from glrender.base.constants import AU_M
from glrender.brdf import Lambert, LommelSeeliger
from glrender.engines.rays.backend import RayTracer

GREY = Lambert(normal_albedo=0.4)
# Rolled, so that no edge of a solid runs along the rows of samples.
ROLL = (np.cos(0.2), 0.0, 0.0, np.sin(0.2))


def flux(image) -> float:
    """Irradiance [W/m2] of a whole frame."""
    return float(image.irradiance_W_m2.sum(dtype=np.float64))


def facet_flux(shape: Shape, state: State, law=GREY) -> float:
    """Irradiance [W/m2] of a convex body at the origin, a sum over its facets, each at its own range."""
    centre = shape.vertices_m[shape.facets].mean(axis=1)
    to_camera = state.spacecraft.r_inertial_m - centre
    distance = np.linalg.norm(to_camera, axis=1)
    to_camera /= distance[:, None]
    sun_distance = np.linalg.norm(state.r_sun_inertial_m)
    sun = state.r_sun_inertial_m / sun_distance
    mu0 = np.maximum(shape.facet_normals @ sun, 0.0)
    mu = np.maximum(np.einsum("ij,ij->i", shape.facet_normals, to_camera), 0.0)
    seen = (mu0 > 0.0) & (mu > 0.0)
    value = law.brdf(sun, to_camera[seen], shape.facet_normals[seen]) * (mu0 * mu * shape.facet_areas_m2
                                                                         / distance**2)[seen]
    return float(value.sum()) * views.SOLAR_IRRADIANCE_W_M2 / (sun_distance / AU_M) ** 2


@cache
def dented_sphere() -> Shape:
    """A sphere of 100 m, its vertex at +Z pressed in by 3 m: no longer convex, so that its shadows are drawn."""
    sphere = generate.icosphere(radius_m=100.0, subdivisions=5)
    vertices = sphere.vertices_m.copy()
    vertices[np.argmax(vertices[:, 2])] *= 0.97
    return Shape.from_arrays(vertices, sphere.facets)


def false_shadow(phase_deg: float, size_px: float = 200.0, samples: int | None = None) -> float:
    """Share of the lit flux that a convex body's own shadow map takes, the dent being on the dark side."""
    range_m = 4000.0
    state = views.state(phase_deg=phase_deg, range_m=range_m)
    away = frames.look_at(np.zeros(3), -state.r_sun_inertial_m)
    state = views.state(phase_deg=phase_deg, range_m=range_m, q_body=away)
    camera = views.camera(256, size_px * range_m / 200.0)
    lit = []
    for shape in (dented_sphere(), generate.icosphere(radius_m=100.0, subdivisions=5)):
        with Renderer(views.scene([Body(name="body", shape=shape, brdf=GREY)], [camera])) as renderer:
            image = renderer.render(state, samples=samples, max_error=0.02)
        lit.append(flux(image))
    return 1.0 - lit[0] / lit[1]


def pillar_shadow(phase_deg: float, samples: int | None = 8, max_error: float = 0.02) -> float:
    """Excess length of a pillar's shadow [px] across the slab that it stands on, by its area (`solids.slab_flux`).

    Seen against the Sun, incidence = emission; a metre of the slab is 0.88 px across.
    """
    half, pillar, range_m, angle = 100.0, (10.0, 3.0), 1e6, 0.5 * np.radians(phase_deg)
    camera = views.camera(256, 256 / 290.0 * range_m, q_camera_from_spacecraft=ROLL)
    state = views.state(range_m=range_m, direction=(-np.sin(angle), 0.0, np.cos(angle)))
    state = State(r_sun_inertial_m=AU_M * np.array([np.sin(angle), 0.0, np.cos(angle)]), spacecraft=state.spacecraft,
                  bodies=state.bodies)
    light = []
    for stands in (pillar, None):
        body = Body(name="body", shape=solids.slab(half, pillar_m=stands), brdf=GREY)
        with Renderer(views.scene([body], [camera])) as renderer:
            light.append(flux(renderer.render(state, samples=samples, max_error=max_error)))
    per_area = (views.SOLAR_IRRADIANCE_W_M2 * GREY.normal_albedo / np.pi * np.cos(angle) ** 2 / range_m**2)
    strips = 2.0 * pillar[0] * pillar[1] * np.tan(angle)
    return float((light[1] - light[0]) / per_area - strips) / pillar[0] * camera.focal_length_px / range_m


@cache
def _light_of_a_binary(phase_deg: float) -> tuple[np.ndarray, State, float]:
    """A contact binary's light by rays, 300 px across, its state and its focal length [px] there."""
    focal_length_px = 300.0 * 2000.0 / 200.0
    state = views.state(phase_deg=phase_deg)
    with RayTracer(views.scene([binary()], [views.camera(340, focal_length_px)])) as tracer:
        image = tracer.render(state, samples=4).irradiance_W_m2.astype(np.float64)
    return image, state, focal_length_px


@cache
def binary(subdivisions: int = 5) -> Body:
    return Body(name="body", shape=views.binary(2, subdivisions),
                brdf=GREY)


def small_body(size_px: float, phase_deg: float, offset_px: tuple[float, float], **how) -> tuple[float, float]:
    """Relative flux error and distance [px] of the centre of brightness of a body `size_px` across.

    Truth: the body's light by rays at 300 px, put into this image's pixels. The geometry is one and the same;
    only the focal length changes, so the flux must not.
    """
    light, state, fine_px = _light_of_a_binary(phase_deg)
    side = 40
    focal_length_px = size_px * 2000.0 / 200.0
    place = (0.5 * (side - 1) + offset_px[0], 0.5 * (side - 1) + offset_px[1])
    camera = views.camera(side, focal_length_px, principal_point_px=place)
    edges = (np.arange(light.shape[0] + 1) - 0.5 * light.shape[0]) * focal_length_px / fine_px
    columns, rows = (_shares(edges + p + 0.5, side) for p in place)
    truth = rows.T @ light @ columns
    with Renderer(views.scene([binary()], [camera])) as renderer:
        image = renderer.render(state, **how).irradiance_W_m2.astype(np.float64)
    if not image.sum() > 0.0:
        return -1.0, np.inf
    return (float(image.sum() / truth.sum() - 1.0),
            float(np.linalg.norm(views.centroid_px(image) - views.centroid_px(truth))))


def _shares(edges: np.ndarray, side: int) -> np.ndarray:
    """(N, side): how much of each interval between edges [px] lies in each pixel."""
    low, high = edges[:-1, None], edges[1:, None]
    pixel = np.arange(side)
    return np.clip(np.minimum(high, pixel + 1) - np.maximum(low, pixel), 0.0, None) / (high - low)


def limb_offsets(n_sectors: int = 36, size_px: float = 200.0, max_error: float = 0.02) -> np.ndarray:
    """Displacement of the limb [px] in each sector of a full disc that is equally bright everywhere.

    Lommel-Seeliger at phase 0 from far; truth: the area of the outline's polygon, the hull of the projected vertices.
    """
    from scipy.spatial import ConvexHull

    law, range_m = LommelSeeliger(single_scattering_albedo=0.3), 1e8
    shape = generate.icosphere(radius_m=100.0, subdivisions=5)
    camera = views.camera(256, size_px * range_m / 200.0, principal_point_px=(127.31, 127.77))
    state = views.state(phase_deg=0.0, range_m=range_m)
    with Renderer(views.scene([Body(name="body", shape=shape, brdf=law)], [camera])) as renderer:
        image = renderer.render(state, max_error=max_error).irradiance_W_m2.astype(np.float64)
    full = image[118:138, 118:138].mean()
    seen = (shape.vertices_m - state.spacecraft.r_inertial_m) @ frames.dcm(state.spacecraft.q_from_inertial).T
    outline = camera.project(seen)
    outline = outline[ConvexHull(outline).vertices]
    cover = _polygon_coverage(outline, image.shape, 16)
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    x, y = x - camera.principal_point_px[0], y - camera.principal_point_px[1]
    near = np.abs(np.hypot(x, y) - 0.5 * size_px) < 3.0
    sector = ((np.arctan2(y, x) / (2.0 * np.pi) % 1.0) * n_sectors).astype(int)
    excess = np.bincount(sector[near], (image / full - cover)[near], n_sectors)
    return excess / (np.pi * size_px / n_sectors)


def _polygon_coverage(outline: np.ndarray, shape: tuple[int, int], n: int) -> np.ndarray:
    """Share of each pixel inside a convex polygon, by n x n samples."""
    offsets = (np.arange(n) + 0.5) / n - 0.5
    x = (np.arange(shape[1])[:, None] + offsets).ravel()
    y = (np.arange(shape[0])[:, None] + offsets).ravel()
    start, end = outline, np.roll(outline, -1, axis=0)
    # Where each row of samples enters and leaves the polygon.
    low, high = np.full(len(y), np.inf), np.full(len(y), -np.inf)
    for (x0, y0), (x1, y1) in zip(start, end, strict=True):
        inside = (y >= min(y0, y1)) & (y < max(y0, y1))
        crossing = x0 + (y[inside] - y0) * (x1 - x0) / (y1 - y0)
        low[inside], high[inside] = np.minimum(low[inside], crossing), np.maximum(high[inside], crossing)
    covered = (x >= low[:, None]) & (x < high[:, None])
    return covered.reshape(shape[0], n, shape[1], n).mean(axis=(1, 3))


def crescent(phase_deg: float, is_rough: bool, max_error: float = 0.02) -> tuple[float, float, bool]:
    """Relative flux error of a thin crescent, the error predicted for it, and whether the plan warns.

    A sphere, lit from a point, against the sum over its facets; a rough body against 12 x 12 rays a pixel.
    """
    # From far: near by, parallax alone changes a thin crescent.
    range_m = 1e6
    camera, state = views.camera(160, 140.0 * range_m / 200.0), views.state(phase_deg=phase_deg, range_m=range_m)
    body = binary() if is_rough else views.sphere(GREY, 6)
    scene = views.scene([body], [camera], sun_disc=is_rough)
    if is_rough:
        with RayTracer(scene) as tracer:
            exact = flux(tracer.render(state, samples=12))
    else:
        exact = facet_flux(body.shape, state)
    with Renderer(scene) as renderer:
        image = renderer.render(state, max_error=max_error)
    assert np.isfinite(image.irradiance_W_m2).all() and (image.irradiance_W_m2 >= 0.0).all()
    return flux(image) / exact - 1.0 if exact > 0.0 else np.nan, image.plan.predicted_error, bool(image.plan.warnings)


def sliver_sphere(n_sectors: int, n_rings: int = 12) -> Shape:
    """A sphere of 100 m of long thin facets: aspect about n_sectors / n_rings, needles at the poles."""
    polar = np.linspace(0.0, np.pi, n_rings + 1)[1:-1]
    around = np.linspace(0.0, 2.0 * np.pi, n_sectors, endpoint=False)
    ring = np.stack(np.broadcast_arrays(np.sin(polar)[:, None] * np.cos(around), np.sin(polar)[:, None]
                                        * np.sin(around), np.cos(polar)[:, None]), axis=-1).reshape(-1, 3)
    vertices = 100.0 * np.concatenate([ring, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]])
    this, after = np.arange(n_sectors), np.roll(np.arange(n_sectors), -1)
    facets = [np.stack([np.full(n_sectors, len(ring)), this, after], axis=1)]
    for k in range(n_rings - 2):
        top, bottom = k * n_sectors, (k + 1) * n_sectors
        facets += [np.stack([top + this, bottom + this, bottom + after], axis=1),
                   np.stack([top + this, bottom + after, top + after], axis=1)]
    last = (n_rings - 2) * n_sectors
    facets.append(np.stack([np.full(n_sectors, len(ring) + 1), last + after, last + this], axis=1))
    return Shape.from_arrays(vertices, np.concatenate(facets))


def turned(state: State, q: np.ndarray, shift_m: np.ndarray) -> State:
    """A scene turned into another inertial frame: turned by `q_new_from_old`, then shifted [m]."""
    rotation = frames.dcm(q)

    def pose(p: Pose) -> Pose:
        return Pose(r_inertial_m=rotation @ p.r_inertial_m + shift_m,
                    q_from_inertial=frames.quaternion(frames.dcm(p.q_from_inertial) @ rotation.T))

    return State(t_s=state.t_s, r_sun_inertial_m=rotation @ state.r_sun_inertial_m + shift_m,
                 spacecraft=pose(state.spacecraft), bodies={name: pose(p) for name, p in state.bodies.items()})


def traced_by_hand(bodies, camera, state: State, samples: int = 4, law=GREY) -> np.ndarray:
    """Irradiance (rows, columns) [W/m2] of Lambert bodies of few facets, the Sun a point: in float64, facet by facet.

    Each ray is held against every facet's edges. Places are about the camera, so that no ratio of sizes is lost.
    """
    camera_from_inertial = frames.dcm(state.spacecraft.q_from_inertial)
    corners, to_sun = [], []
    for body in bodies:
        pose, shape = state.bodies[body.name], body.shape
        middle = 0.5 * (shape.vertices_m.min(axis=0) + shape.vertices_m.max(axis=0))
        inertial_from_body = frames.dcm(pose.q_from_inertial).T
        place = pose.r_inertial_m + inertial_from_body @ middle - state.spacecraft.r_inertial_m
        corners.append(((shape.vertices_m - middle) @ inertial_from_body.T + place)[shape.facets])
        away = state.r_sun_inertial_m - state.spacecraft.r_inertial_m - place
        to_sun += [away] * len(shape.facets)
    corners, to_sun = np.concatenate(corners), np.array(to_sun)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    offsets = (np.arange(samples) + 0.5) / samples - 0.5
    n_y, n_x = camera.height_px, camera.width_px
    y, x = (np.add.outer(np.arange(n), offsets).ravel() for n in (n_y, n_x))
    rays = camera.directions(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    cosine, rays = rays[:, 2], rays @ camera_from_inertial
    distance = np.stack([_distances_by_hand(corner, away, np.zeros(3), rays)
                         for corner, away in zip(corners, normal, strict=True)])
    facet = np.argmin(distance, axis=0)
    sun_m = np.linalg.norm(to_sun, axis=1)
    cos_incidence = np.einsum("ij,ij->i", normal, to_sun) / sun_m
    seen = np.isfinite(distance.min(axis=0)) & (np.einsum("ij,ij->i", normal[facet], rays) < 0.0)
    lit = np.flatnonzero(seen & (cos_incidence[facet] > 0.0))
    facet, point = facet[lit], rays[lit] * distance[facet[lit], lit, None]
    is_lit, sun = np.ones(len(lit), bool), to_sun[facet] / sun_m[facet, None]
    for i, (corner, away) in enumerate(zip(corners, normal, strict=True)):
        is_lit &= (facet == i) | np.isinf(_distances_by_hand(corner, away, point, sun))
    value = np.zeros(len(rays))
    value[lit] = is_lit * cos_incidence[facet] * cosine[lit] ** 3 / (sun_m[facet] / AU_M) ** 2
    value *= law.normal_albedo / np.pi * views.SOLAR_IRRADIANCE_W_M2 / camera.focal_length_px**2
    return value.reshape(n_y, samples, n_x, samples).mean(axis=(1, 3))


def _distances_by_hand(corner: np.ndarray, normal: np.ndarray, start: np.ndarray, ray: np.ndarray) -> np.ndarray:
    """Distances (N,) along rays (N, 3) from points (N, 3) to a facet (3, 3), infinite beside it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (corner[0] - start) @ normal / (ray @ normal)
        point = start + t[:, None] * ray
    # What starts on a facet meets no neighbour where it starts.
    inside = t > 1e-9 * np.linalg.norm(corner[1] - corner[0])
    for k in range(3):
        edge = np.cross(normal, corner[(k + 1) % 3] - corner[k])
        inside &= (point - corner[k]) @ edge >= 0.0
    return np.where(inside, t, np.inf)


def pillar_on_ground(ratio: float) -> Shape:
    """A pillar of 1 x 1 x 1 m, sunk into a slab that is larger by a ratio: half of its side, and a tenth deep."""
    return solids.several(((-ratio, -ratio, -0.2 * ratio), (ratio, ratio, 0.0)), ((-0.5, -0.5, -0.1), (0.5, 0.5, 1.0)))


def before_the_pillar(centre_m=(0.0, 0.0, 0.0), names=("body",)) -> State:
    """A camera 8 m from the pillar, which the Sun shades on its left, wherever the pillar's foot stands [m]."""
    centre = np.asarray(centre_m, float)
    place = np.array([-4.0, -3.0, 6.0])
    sun = np.array([0.5, 0.35, 0.6])
    return State(r_sun_inertial_m=centre + AU_M * sun / np.linalg.norm(sun),
                 spacecraft=Pose(r_inertial_m=centre + place, q_from_inertial=frames.look_at(place, np.zeros(3))),
                 bodies={name: Pose(r_inertial_m=centre) for name in names})
