"""A camera's model behind images with a margin, in all of its bands, with the light that comes as points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from glrender_camera import Frame, MosaicModel, PinholeCamera, PointSources

from ..engines.small_bodies import CELL_PX
from ..scene.scene import Scene, band_irradiances
from ..view.state import State
from .sky_background import merged, stars_behind


@dataclass(frozen=True, kw_only=True, eq=False)
class PosePoints:
    """One pose of an exposure: its state and the points apart from its image.

    Attributes
    ----------
    state : State
    bodies : PointSources
        Small bodies as points, in the camera's band.
    row_weights : (rows,) float or None
        Weight of the pose in each row of the image; None for a single pose.
    """

    state: State
    bodies: PointSources
    row_weights: np.ndarray | None = None


class Sensor:
    """Exposes images of one camera of a scene.

    Parameters
    ----------
    scene : Scene
    camera : PinholeCamera
        With a model.
    margin_px : int [px]
        Margin of the images.
    """

    def __init__(self, scene: Scene, camera: PinholeCamera, margin_px: int):
        self._scene, self._camera, self._margin_px = scene, camera, margin_px
        self._n_stars = 0

    def stars(self, poses: Sequence[PosePoints]) -> dict[str, PointSources]:
        """The stars of each band, in the mean over some poses."""
        if self._scene.stars is None:
            return {}
        parts: dict[str, list] = {}
        for pose in poses:
            found = stars_behind(self._scene, pose.state, self._camera)
            for letter, points in found.items():
                parts.setdefault(letter, []).append((points, self._share(points, pose)))
            # A star has a place of its own in each pose.
            self._n_stars = max(len(points.xy_px) for points in found.values())
        return {letter: merged(each) for letter, each in parts.items()}

    def bodies(self, poses: Sequence[PosePoints]) -> PointSources:
        """The light of small bodies in the camera's band, in the mean over some poses."""
        return merged([(pose.bodies, self._share(pose.bodies, pose)) for pose in poses])

    def _share(self, points: PointSources, pose: PosePoints) -> np.ndarray | float:
        if pose.row_weights is None:
            return 1.0
        row = np.rint(points.xy_px[:, 1]).astype(int) + self._margin_px
        return pose.row_weights[np.clip(row, 0, len(pose.row_weights) - 1)]

    def stars_text(self) -> str:
        """The stage in words, of the last stars."""
        stars = self._scene.stars
        if stars is None:
            return "skipped: the scene has none"
        if not self._n_stars:
            return "skipped: none is in view"
        return f"{self._n_stars} to magnitude {stars.magnitude_limit:g}" + stars.aberration * ", aberrated"

    def expose(self, irradiance: np.ndarray, seed: int, exposure_s: float | str, roi: tuple[int, int, int, int],
               grey: Sequence[PointSources], stars: dict[str, PointSources], faults: Any = None) -> Frame:
        """The frame. Monochrome light is rendered once and scaled by the Sun's irradiance in each band."""
        model = self._camera.model
        drawn = self._scene.solar_irradiance_of(self._camera)
        is_mosaic = isinstance(model, MosaicModel)
        shares = {letter: own / drawn for letter, own in band_irradiances(model).items()} if is_mosaic else {"": 1.0}
        points = {}
        for letter, share in shares.items():
            parts = [(each, share) for each in grey]
            if letter in stars:
                parts.append((stars[letter], 1.0))
            points[letter] = merged(parts)
        has_points = any(len(each.xy_px) for each in points.values())
        options = {"exposure_s": exposure_s, "roi": roi, "margin_px": self._margin_px, "faults": faults}
        if not is_mosaic:
            return self._camera.expose(irradiance, seed, points=points[""] if has_points else None, **options)
        images = {letter: irradiance * np.float32(share) for letter, share in shares.items()}
        return self._camera.expose(images, seed, points=points if has_points else None, **options)

    def told(self, frame: Frame, n_bodies: int) -> dict[str, str]:
        """The frame's stages, with the number and kind of the points."""
        text = f"{self._n_stars} stars, {n_bodies} bodies of a few pixels or less"
        return {**frame.stages, **({"points": text} if self._n_stars + n_bodies else {})}


def with_points(image: np.ndarray, points: PointSources) -> np.ndarray:
    """An image (h, w) [W/m2] with the light of small bodies' cells, in the pixels that they overlap."""
    if not len(points.xy_px):
        return image
    image = image.copy()
    # Where each cell begins, and its shares of that pixel and of the next.
    start = points.xy_px - 0.5 * CELL_PX
    first = np.rint(start).astype(int)
    share = np.clip((first + 0.5 - start) / CELL_PX, 0.0, 1.0)
    for right in (0, 1):
        for down in (0, 1):
            column, row = first[:, 0] + right, first[:, 1] + down
            light = (points.irradiance_W_m2 * np.abs(right - share[:, 0]) * np.abs(down - share[:, 1]))
            inside = (row >= 0) & (column >= 0) & (row < image.shape[0]) & (column < image.shape[1])
            np.add.at(image, (row[inside], column[inside]), light[inside].astype(np.float32))
    return image
