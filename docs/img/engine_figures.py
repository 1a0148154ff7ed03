"""Pictures of the three engines and of derivatives for docs: `python docs/img/engine_figures.py`."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from glrender import Body, PinholeCamera, Pose, Renderer, Scene, State, frames, generate
from glrender.base.constants import AU_M
from glrender.brdf import Lambert
from matplotlib.collections import LineCollection
from PIL import Image

FOLDER = Path(__file__).parent
WIDTH_PX, RANGE_M, RADIUS_M = 256, 20e3, 100.0
# A lobe's shadow on the other: the corner [px] and side [px] of the close-up.
CORNER_PX, SIDE_PX = (104, 92), 20
SUN = np.array([1.0, 0.05, -0.3])


def scene(subdivisions: int) -> Scene:
    shape = generate.contact_binary(radius_m=RADIUS_M, seed=7, subdivisions=subdivisions)
    body = Body(name="body", shape=shape, brdf=Lambert(normal_albedo=0.3))
    camera = PinholeCamera(name="navcam", width_px=WIDTH_PX, height_px=WIDTH_PX,
                           focal_length_px=0.85 * WIDTH_PX * RANGE_M / (2.0 * RADIUS_M))
    return Scene(bodies=[body], cameras=[camera])


def state(r_camera=(0.0, 0.0, -RANGE_M)) -> State:
    r_camera = np.array(r_camera)
    return State(r_sun_inertial_m=AU_M * SUN / np.linalg.norm(SUN),
                 spacecraft=Pose(r_inertial_m=r_camera, q_from_inertial=frames.look_at(r_camera, np.zeros(3))),
                 bodies={"body": Pose(r_inertial_m=np.zeros(3))})


def show(panel, image, title, close_up=True, **options) -> None:
    panel.imshow(image, **{"cmap": "gray", "interpolation": "nearest", **options})
    panel.set_title(title, fontsize=8)
    panel.set_xticks([])
    panel.set_yticks([])
    if close_up:
        (x, y), side = CORNER_PX, SIDE_PX
        panel.set(xlim=(x - 0.5, x + side - 0.5), ylim=(y + side - 0.5, y - 0.5))


def facets(panel, given: Scene) -> None:
    """Outlines of the facets that face the camera."""
    shape, camera = given.bodies[0].shape, given.cameras[0]
    camera_from_body = frames.dcm(state().spacecraft.q_from_inertial)
    r = (shape.vertices_m - state().spacecraft.r_inertial_m) @ camera_from_body.T
    xy = r[:, :2] / r[:, 2:] * camera.focal_length_px + np.array(camera.principal_point_px)
    corner = xy[shape.facets]
    a, b = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    seen = corner[a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] > 0.0]
    panel.add_collection(LineCollection(np.concatenate([seen, seen[:, :1]], axis=1), colors="C1", linewidths=0.4))


def save(figure, name: str) -> None:
    figure.tight_layout(pad=0.6)
    path = FOLDER / f"engine_{name}.png"
    figure.savefig(path, dpi=90)
    # A palette: a third of the bytes.
    Image.open(path).convert("RGB").quantize(128).save(path, optimize=True)
    plt.close(figure)


def derivatives() -> None:
    """A frame, and its changes by the camera's moves across and along the boresight, its roll, and the Sun's turn."""
    with Renderer(scene(6)) as renderer:
        image = renderer.render(state(), max_error=0.005, derivatives=["spacecraft", "sun"])
    found, (x0, y0, x1, y1) = image.jacobian, image.jacobian.roi
    across, _, ahead, *_, roll = found["spacecraft"]
    shown = [("the frame", None), ("moved to the right", across), ("moved ahead", ahead), ("rolled", roll),
             ("Sun turned", found["sun"][0])]
    figure, panels = plt.subplots(1, len(shown), figsize=(10.5, 2.4))
    for panel, (title, values) in zip(panels, shown, strict=True):
        if values is None:
            show(panel, image.irradiance_W_m2[y0:y1, x0:x1], title, close_up=False)
        else:
            most = float(np.percentile(np.abs(values), 99.0))
            show(panel, values, title, close_up=False, cmap="RdBu_r", vmin=-most, vmax=most)
    save(figure, "derivatives")


def main() -> None:
    derivatives()
    given = scene(5)
    with Renderer(given) as renderer:
        def drawn(**options):
            image = renderer.render(state(), **options)
            print(options, image.plan.windows[0].engine, image.plan.windows[0].by_centroids, image.plan.predicted_error)
            return image.irradiance_W_m2

        whole = drawn(engine="coverage", max_error=0.01)
        rough = drawn(engine="coverage", max_error=0.1)
        once, again = drawn(engine="rays", max_error=1.0), drawn(engine="rays", max_error=0.01)
        raster = drawn(engine="raster", max_error=0.05)
        axis = RANGE_M * SUN / np.linalg.norm(SUN)
        depth = renderer.render(state(axis), products=["range"]).products["range"]
    top = dict(vmin=0.0, vmax=float(np.percentile(whole, 99.7)))
    figure, panels = plt.subplots(1, 3, figsize=(8.4, 3.1))
    show(panels[0], whole, "exact area coverage", close_up=False, **top)
    (x, y), side = CORNER_PX, SIDE_PX
    panels[0].add_patch(plt.Rectangle((x - 0.5, y - 0.5), side, side, fill=False, edgecolor="C1"))
    show(panels[1], rough, "each facet lit or dark by its centroid", **top)
    show(panels[2], whole, "facets clipped at the shadow boundary", **top)
    for panel in panels[1:]:
        facets(panel, given)
    save(figure, "coverage")
    figure, panels = plt.subplots(1, 3, figsize=(8.4, 3.1))
    show(panels[0], once, "first pass: 2 x 2 rays a pixel", **top)
    places = np.stack(np.meshgrid(np.arange(x, x + side, 0.5), np.arange(y, y + side, 0.5)), axis=-1).reshape(-1, 2)
    panels[0].plot(*(places - 0.25).T, ".", color="C1", markersize=1.2)
    show(panels[1], once != again, "pixels whose contrast asks for more rays", close_up=False)
    show(panels[2], again, "after the second pass", **top)
    save(figure, "rays")
    figure, panels = plt.subplots(1, 3, figsize=(8.4, 3.1))
    show(panels[0], -depth, "shadow map: depth as the Sun sees it", close_up=False, cmap="viridis")
    show(panels[1], raster, "a pixel is lit where nothing is nearer to the Sun", close_up=False, **top)
    show(panels[2], raster, "shadow boundary after the second pass", **top)
    save(figure, "raster")


if __name__ == "__main__":
    main()
