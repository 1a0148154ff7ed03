"""Errors of an image in the units that a navigator asks for: flux, centre of brightness, limb and range."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from glrender import Body, Pose, Renderer, Scene, State, frames, generate
from glrender.brdf import Lambert
from glrender.engines.rays.engine import RayEngine, draws
from glrender.view.regions import region
from glrender.view.view import view_bodies

from .metrics import centroid_px
from .random_scenes import Draw, draw

LightOf = Callable[[np.ndarray, np.ndarray], np.ndarray]
UNITS = ("rms", "flux", "centroid_px", "limb_px", "range")
# Points along the limb that a mean is worth; and how far along its normal the half-light contour is looked for [px].
_FEWEST_POINTS = 12
_REACH_PX, _STEP_PX = 1.5, 0.02
# Samples along a pixel's side, of all pixels at least, and at most of those that still scatter; the scatter, over the
# mean of the lit pixels, that is left; and the share of all rays that the first round takes.
_LEAST, _MOST, _LEFT = 5, 135, 2e-4
_FIRST_SHARE = 0.06


def draw_small(seed: int, bodies: list[str] | None = None, sides_px: Sequence[int] = (64, 96, 128, 192)) -> Draw:
    """A random scene in a small frame, of a body of 3 px to 1.5 frames, with a tolerance of 0.005 to 0.1."""
    frame_px = int(np.random.default_rng([7, seed]).choice(sides_px))
    return draw(seed, bodies, frame_px=frame_px, sizes_px=(3.0, 1.5 * frame_px), budgets=(0.005, 0.1))


def draw_tiny(seed: int) -> Draw:
    """A random scene of a body of 0.3 to 3 px, with a tolerance of 0.005 to 0.1."""
    return draw(seed, frame_px=32, sizes_px=(0.3, 3.0), budgets=(0.005, 0.1))


def draw_neighbours(seed: int) -> Draw:
    """A scene of `draw_small` with a sphere beside the body, in the image and in range; they may hide each other."""
    case, rng = draw_small(seed), np.random.default_rng([17, seed])
    body, place = case.scene.bodies[0], case.state.spacecraft
    radius_m = body.shape.radius_m
    size_m, turn = radius_m * 0.2 * 5.0 ** rng.random(), rng.uniform(0.0, 2.0 * np.pi)
    right, down, along = frames.dcm(place.q_from_inertial)
    off_m = (radius_m + size_m) * rng.uniform(0.6, 1.6)
    r_sphere_m = off_m * (np.cos(turn) * right + np.sin(turn) * down) + (radius_m + size_m) * rng.uniform(0.9, 1.2) * (
        rng.choice([-1.0, 1.0]) * along)
    sphere = Body(name="sphere", shape=generate.icosphere(radius_m=size_m, subdivisions=5),
                  brdf=Lambert(normal_albedo=0.3))
    scene = Scene(bodies=[body, sphere], cameras=list(case.scene.cameras))
    return replace(case, scene=scene, state=replace(case.state, bodies={
        **case.state.bodies, "sphere": Pose(r_inertial_m=r_sphere_m)}))


def check_units(case: Draw, most_rays: float = 4e6, light_of: LightOf | None = None) -> dict | None:
    """True and predicted errors of a frame in each of `UNITS`, as a row of the table; None where nothing is lit."""
    exact = dense_truth(case.scene, case.state, most_rays, light_of)
    if exact is None:
        return None
    with Renderer(case.scene) as renderer:
        image = renderer.render(case.state, max_error=case.max_error)
    return {"body": case.body, "body_px": case.body_px, "phase_deg": case.phase_deg,
            "max_error": case.max_error, "engine": image.plan.windows[0].how, "predicted": image.plan.predicted,
            "true": exact.errors(image.irradiance_W_m2), "own": exact.own}


def summary(rows: list[dict]) -> dict[str, dict[str, float]]:
    """Frames by unit, the share whose true error is within the predicted one, median and largest of their ratio.

    To the predicted error that of the truth is added in squares; `own` is the median of their ratio.
    """
    told = {}
    for unit in UNITS:
        ratio = np.array([row["true"][unit] / np.hypot(row["predicted"][unit], row["own"][unit]) for row in rows
                          if np.isfinite(row["true"][unit])])
        told[unit] = {"frames": len(ratio), "within": float((ratio <= 1.0).mean()), "median": float(np.median(ratio)),
                      "largest": float(ratio.max()), "own": float(np.nanmedian(
                          [row["own"][unit] / row["predicted"][unit] for row in rows]))}
    return told


@dataclass(frozen=True, kw_only=True, eq=False)
class DenseTruth:
    """A frame by float64 rays, most where neighbouring samples differ.

    Attributes
    ----------
    exact : (H, W) float64 [W/m2]
    body : (H, W) bool
        Whether a pixel's centre shows a body.
    own : dict
        The truth's own error in each of `UNITS`: its difference from a third of the samples, carried on by n^-1.5.
    """

    exact: np.ndarray
    body: np.ndarray
    own: dict[str, float]

    def errors(self, image: np.ndarray) -> dict[str, float]:
        """Errors of an image in each of `UNITS`: the truth's own are in them."""
        return unit_errors(image, self.exact, self.body)


def dense_truth(scene: Scene, state: State, most_rays: float = 4e6,
                light_of: LightOf | None = None) -> DenseTruth | None:
    """The truth of a scene's only camera, by about so many rays at most; None where nothing is lit.

    The light (N,) [W/m2 per pixel] of places (N, 2) [px] by draws (N,) of the Sun's disc is that of rays by default.
    """
    camera = scene.cameras[0]
    views = view_bodies(state, camera, scene.hulls)
    engine, shape = RayEngine(scene), (camera.height_px, camera.width_px)
    light_of = light_of or (lambda pixel, draw: engine.irradiance(pixel, camera, views, draw))
    y, x = (axis.ravel() for axis in np.mgrid[:shape[0], :shape[1]])
    last = mean = np.zeros(shape)
    x0, y0, x1, y1 = region([view for view in views if view.is_visible], camera)
    active, cast = np.flatnonzero((x >= x0) & (x < x1) & (y >= y0) & (y < y1)), 0
    first_count = (_FIRST_SHARE * most_rays / max(len(active), 1)) ** 0.5
    first_count = 2 * int(0.5 * min(max(first_count, _LEAST), _MOST / 3)) + 1
    for count in (first_count, 3 * first_count, 9 * first_count, 27 * first_count):
        cast += len(active) * count**2
        if not len(active) or count > 3 * first_count and (cast > most_rays or count > _MOST):
            break
        last, mean = mean, mean.copy()
        first, second = np.zeros((2, len(active)))
        place = np.arange(count)
        for row in range(count):
            at = np.stack(np.broadcast_arrays(x[active][:, None] + (place + 0.5) / count - 0.5,
                                              (y[active] + (row + 0.5) / count - 0.5)[:, None]), axis=-1)
            draw = np.broadcast_to(draws(np.full(count, row), place, count), at.shape[:2])
            light = light_of(at.reshape(-1, 2), draw.ravel()).reshape(at.shape[:2])
            first += light.sum(axis=1)
            second += np.square(light).sum(axis=1)
        first, second = first / count**2, second / count**2
        mean.flat[active] = first
        scatter = np.zeros(mean.size)
        scatter[active] = 0.3 * np.sqrt(np.maximum(second - first**2, 0.0)) * count**-1.5
        if not (mean > 0.0).any():
            return None
        near = cv2.dilate(scatter.reshape(shape), np.ones((3, 3), np.uint8)).ravel()
        active = np.flatnonzero(near > _LEFT * mean[mean > 0.0].mean())
    body = engine.products(np.stack([x, y], axis=1).astype(float), camera, views)["body_id"] >= 0
    engine.close()
    rough = unit_errors(last, mean, body.reshape(shape))
    return DenseTruth(exact=mean, body=body.reshape(shape), own={unit: 3.0**-1.5 * rough[unit] for unit in UNITS})


def unit_errors(image: np.ndarray, exact: np.ndarray, body: np.ndarray) -> dict[str, float]:
    """Errors of an image (H, W) beside the true one, in each of `UNITS`.

    Parameters
    ----------
    image, exact : (H, W) float [W/m2]
    body : (H, W) bool
        Pixels whose centre shows the body.

    Returns
    -------
    dict
        rms : root mean square over the lit pixels, over their mean [1];
        flux : of the total, relative [1];
        centroid_px : between the centres of brightness [px];
        limb_px : root mean square displacement of the half-light contour along the lit limb [px];
        range : mean of that displacement over the limb's mean distance from the body's middle, as a fit of the
        apparent size would take it for range [1]. The last two are NaN where less than twelve points of the lit limb
        are in view.
    """
    image, exact = np.asarray(image, float), np.asarray(exact, float)
    lit = exact > 0.0
    offsets, radii = limb_offsets(image, exact, body)
    few = len(offsets) < _FEWEST_POINTS
    return {
        "rms": float(np.sqrt(np.mean((image - exact)[lit | (image > 0.0)] ** 2)) / exact[lit].mean()),
        "flux": abs(float(image.sum() / exact.sum() - 1.0)),
        "centroid_px": float(np.linalg.norm(centroid_px(image) - centroid_px(exact))),
        "limb_px": np.nan if few else float(np.sqrt(np.mean(offsets**2))),
        "range": np.nan if few else abs(float(offsets.mean() / radii.mean())),
    }


def limb_offsets(image: np.ndarray, exact: np.ndarray, body: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Displacements (N,) [px] of the half-light contour at points of the lit limb, and their distances (N,) [px]."""
    nothing = np.zeros(0), np.zeros(0)
    if not body.any():
        return nothing
    middle = centroid_px(body.astype(float))
    inner = cv2.erode(body.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=1)
    # Light of the body's inside next to each pixel.
    level = 0.5 * cv2.dilate(np.where(inner > 0, exact, 0.0), np.ones((5, 5), np.uint8))
    outer = cv2.distanceTransform(1 - np.pad(body, 1, mode="edge").astype(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1]
    inside = cv2.distanceTransform(np.pad(body, 1, mode="edge").astype(np.uint8), cv2.DIST_L2, 5)[1:-1, 1:-1]
    smooth = cv2.GaussianBlur(outer - inside, (0, 0), 1.0)
    rise_y, rise_x = np.gradient(smooth)
    y, x = np.nonzero((np.abs(smooth) < 0.75) & (level > 0.15 * exact[exact > 0.0].mean()))
    height, width = body.shape
    within = (x > 2) & (x < width - 3) & (y > 2) & (y < height - 3)
    y, x = y[within], x[within]
    norm = np.hypot(rise_x[y, x], rise_y[y, x])
    y, x, norm = y[norm > 0.3], x[norm > 0.3], norm[norm > 0.3]
    if not len(x):
        return nothing
    along = np.arange(-2.0 * _REACH_PX, 2.0 * _REACH_PX + 1e-9, _STEP_PX)
    px = (x[:, None] + rise_x[y, x][:, None] / norm[:, None] * along).astype(np.float32)
    py = (y[:, None] + rise_y[y, x][:, None] / norm[:, None] * along).astype(np.float32)
    true, drawn = (cv2.remap(each / exact.max(), px, py, cv2.INTER_LINEAR) for each in (exact, image))
    half = (level[y, x] / exact.max())[:, None]
    place = _crossing(true, half, along, np.zeros(len(x)))
    found = np.isfinite(place) & (np.abs(place) < _REACH_PX)
    place, drawn, half = place[found], drawn[found], half[found]
    moved = _crossing(drawn, half, along, place) - place
    # Where the drawn image has no contour near, its excess at the true one over the true image's slope.
    rows, at = np.arange(len(place)), np.clip(np.searchsorted(along, place), 25, len(along) - 26)
    slope = (true[found][rows, at - 25] - true[found][rows, at + 25]) / (50 * _STEP_PX)
    excess = (drawn[rows, at] - true[found][rows, at]) / np.maximum(slope, 0.2 * half[:, 0])
    offset = np.where(np.abs(moved) <= _REACH_PX, moved, np.clip(excess, -_REACH_PX, _REACH_PX))
    return offset, np.hypot(x[found] - middle[0], y[found] - middle[1])


def _crossing(profile: np.ndarray, level: np.ndarray, along: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Places where profiles (N, P) along normals fall below a level, the nearest to a place (N,) each, or NaN."""
    falls = (profile[:, :-1] >= level) & (profile[:, 1:] < level)
    share = (profile[:, :-1] - level) / np.maximum(profile[:, :-1] - profile[:, 1:], 1e-30)
    place = np.where(falls, along[:-1] + share * (along[1] - along[0]), np.inf)
    nearest = np.argmin(np.abs(place - near[:, None]), axis=1)
    chosen = place[np.arange(len(place)), nearest]
    return np.where(np.isfinite(chosen), chosen, np.nan)
